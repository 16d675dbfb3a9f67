//! Pictures on the GPU device: the same stages, tables and picture as [`crate::cpu::view`], within the tolerances of the catalogue.
//!
//! Tables are kept and made again only when what they depend on changes, by the same keys as on the CPU. The volume goes up once a
//! tick; of a picture only its bytes come back.

use std::sync::Arc;

use super::view_octave_balance::OctaveBalancing;
use super::view_stages::{Air, ShapeGrid, SkyLightAsk, SkyLightValues, SkyView, SunMarch, ViewFrame, ViewStages};
use super::view_sun_map::SunMapping;
use super::view_upsample::Sampling;
use super::{Context, GpuError, Kernel};
use crate::CloudVolume;
use crate::cpu::light::diffusion::similarity;
use crate::cpu::light::march_phase::MarchPhase;
use crate::cpu::light::multiple_scattering_table::MultipleScatteringTable;
use crate::cpu::light::sky_light::SkyLight;
use crate::cpu::light::sky_table::{SkyTable, horizon_sine, sun_azimuth};
use crate::cpu::light::stars::StarTable;
use crate::cpu::light::sun_map::map_side;
use crate::cpu::light::sun_optical_depth::marched_direction;
use crate::cpu::light::transmittance_table::TransmittanceTable;
use crate::cpu::view::haze::Haze;
use crate::view::{
    BalanceKey, DiffuseKey, Ground, LightKey, Look, PhaseKey, Scattering, SkyKey, Slab, SunLightKey, SunMapKey,
    SunOcclusion, ViewSampling, ViewSettings, fingerprint,
};

/// Pixels that one submission draws at most: a slow GPU's watchdog ends what runs for seconds.
const BAND_PIXELS: usize = 1 << 18;

/// Buffers that are kept from one cloud to the next and grow when they must.
#[derive(Default)]
struct CloudBuffers {
    extinction: Option<wgpu::Buffer>,
    largest: Option<wgpu::Buffer>,
    words: Option<wgpu::Buffer>,
    along_x: Option<wgpu::Buffer>,
    along_xy: Option<wgpu::Buffer>,
    occupancy: Option<wgpu::Buffer>,
    above: Option<wgpu::Buffer>,
    below: Option<wgpu::Buffer>,
    light_words: Option<wgpu::Buffer>,
    shadow: Option<wgpu::Buffer>,
    conductance: Option<wgpu::Buffer>,
    numbers: Option<wgpu::Buffer>,
    columns: Option<wgpu::Buffer>,
}

/// A cloud's shape on the GPU.
struct Cloud {
    grid: ShapeGrid,
    uniform: wgpu::Buffer,
    words: wgpu::Buffer,
    occupancy: wgpu::Buffer,
    above: wgpu::Buffer,
    below: wgpu::Buffer,
}

/// Optical depths on the GPU. Behind the shadow map and its share lies what else the march looks up of light, for it binds all eight storage buffers that WebGPU grants: the
/// diffuse light's fluence or the octaves' balance, then a map of the sun's rays, where the scene wants them.
struct CloudLight {
    words: wgpu::Buffer,
    shadow: wgpu::Buffer,
    /// What the fluence was made for.
    diffuse: Option<DiffuseKey>,
    /// What the octaves' balance was made for.
    balance: Option<BalanceKey>,
    /// What the map was made for.
    map: Option<SunMapKey>,
}

/// What optical depths depend on, and the bytes of the fluence or the balance and of the map behind them.
type CloudLightKey = (SunLightKey, [u64; 2]);

/// Tables of the clear air on the GPU.
struct AirTables {
    air: wgpu::Buffer,
    transmittance: wgpu::Buffer,
    multiple: wgpu::Buffer,
}

/// Draws pictures on a GPU; keeps what pictures of the same tick or sky share.
pub struct GpuView {
    context: Arc<Context>,
    stages: Arc<ViewStages>,
    blank: wgpu::Buffer,
    noise: Option<wgpu::Buffer>,
    air: Option<(crate::cpu::light::Atmosphere, AirTables)>,
    formula_air: Option<(
        crate::cpu::light::Atmosphere,
        TransmittanceTable,
        MultipleScatteringTable,
    )>,
    sky: Option<(SkyKey, wgpu::Buffer)>,
    light: Option<(LightKey, wgpu::Buffer)>,
    stars: Option<([f32; 2], wgpu::Buffer)>,
    buffers: CloudBuffers,
    shape: Option<(u64, Option<Cloud>)>,
    sun_light: Option<(CloudLightKey, CloudLight)>,
    phase: Option<(PhaseKey, f32, wgpu::Buffer)>,
    /// The phase function's.
    asymmetry: f32,
    frame: wgpu::Buffer,
    picture: Option<wgpu::Buffer>,
}

impl GpuView {
    /// The adapter that it draws on.
    pub fn context(&self) -> &Arc<Context> {
        &self.context
    }

    /// The stages that it draws by.
    pub(super) fn stages(&self) -> Arc<ViewStages> {
        self.stages.clone()
    }

    /// Draws by compiled stages, on their adapter. Errors: those of memory and loss.
    pub fn new(stages: Arc<ViewStages>) -> Result<GpuView, GpuError> {
        let context = stages.context().clone();
        let blank = context.storage("an empty table", 64)?;
        let frame = context.uniform("the frame", bytemuck::bytes_of(&ViewFrame::default()))?;
        Ok(GpuView {
            context,
            stages,
            blank,
            noise: None,
            air: None,
            formula_air: None,
            sky: None,
            light: None,
            stars: None,
            buffers: CloudBuffers::default(),
            shape: None,
            sun_light: None,
            phase: None,
            asymmetry: 0.0,
            frame,
            picture: None,
        })
    }

    /// Draws a picture: RGB, `width * height * 3` bytes, sRGB, rows from top to bottom. An empty volume gives what none gives. Calls
    /// `after` with a stage's name when the stage is done; `march` includes ground, haze, tone map and the way back.
    ///
    /// Errors: `TooLarge` for a volume or a picture beyond the adapter's limits; those of memory and loss. What failed is made anew
    /// with the next picture.
    pub fn render(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<u8>, GpuError> {
        if settings.width == 0 || settings.height == 0 {
            return Ok(Vec::new());
        }
        self.draw(volume, settings, after).map_err(|error| self.cause(error))
    }

    /// A device that is gone refuses first and is reported lost when it is asked.
    pub(super) fn cause(&self, error: GpuError) -> GpuError {
        match error {
            GpuError::Other { .. } => self.context.wait().err().unwrap_or(error),
            error => error,
        }
    }

    fn draw(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<u8>, GpuError> {
        let look = self.prepare(volume, settings, after)?;
        self.march(&look, settings, after)
    }

    /// Makes what a picture needs and is not there yet. Errors: `NoShader` for light that is the CPU's alone, and those of memory and loss.
    pub(super) fn prepare(
        &mut self,
        volume: Option<&CloudVolume>,
        settings: &ViewSettings,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Look, GpuError> {
        let look = Look::new(settings, volume.map_or([0.0; 3], |v| v.air_displacement_m));
        if look.lighting.needs_cpu() {
            return Err(GpuError::NoShader { pass: "march" });
        }
        self.prepare_phase(&look, after)?;
        self.prepare_noise(after)?;
        self.prepare_air(&look, after)?;
        let key = volume.map_or(0, fingerprint);
        self.prepare_shape(key, volume, after)?;
        self.prepare_formula_air(&look);
        self.prepare_sky(&look, after)?;
        self.prepare_stars(&look, after)?;
        self.prepare_light(&look, after)?;
        self.prepare_sun_light(&look, key, after)?;
        self.prepare_diffusion(&look, key, after)?;
        self.prepare_octave_balance(&look, key, after)?;
        self.prepare_sun_map(&look, key, after)?;
        Ok(look)
    }

    fn prepare_phase(&mut self, look: &Look, after: &mut dyn FnMut(&'static str)) -> Result<(), GpuError> {
        let key = look.phase_key();
        if self.phase.as_ref().is_none_or(|(k, ..)| *k != key) {
            let phase = MarchPhase::new(key.0, key.1, key.2);
            let buffer = self.context.uniform("the phase function", phase.bytes())?;
            self.asymmetry = phase.asymmetry;
            self.phase = Some((key, phase.depth_scale, buffer));
            after("march_phase");
        }
        Ok(())
    }

    fn prepare_noise(&mut self, after: &mut dyn FnMut(&'static str)) -> Result<(), GpuError> {
        if self.noise.is_none() {
            let words = self.context.storage("the detail tile", ViewStages::DETAIL_BYTES)?;
            self.stages.detail_noise(&words)?;
            self.context.wait()?;
            self.noise = Some(words);
            after("detail_noise");
        }
        Ok(())
    }

    fn prepare_air(&mut self, look: &Look, after: &mut dyn FnMut(&'static str)) -> Result<(), GpuError> {
        if self.air.as_ref().is_some_and(|(air, _)| *air == look.air) {
            return Ok(());
        }
        let context = &self.context;
        let tables = AirTables {
            air: context.uniform("the air", bytemuck::bytes_of(&Air::new(&look.air)))?,
            transmittance: context.storage("the transmittance table", ViewStages::TRANSMITTANCE_BYTES)?,
            multiple: context.storage("the multiple scattering table", ViewStages::MULTIPLE_BYTES)?,
        };
        self.stages.transmittance_table(&tables.air, &tables.transmittance)?;
        context.wait()?;
        after("transmittance_table");
        self.stages
            .multiple_scattering_table(&tables.air, &tables.transmittance, &tables.multiple)?;
        context.wait()?;
        after("multiple_scattering_table");
        self.air = Some((look.air, tables));
        Ok(())
    }

    fn prepare_sky(&mut self, look: &Look, after: &mut dyn FnMut(&'static str)) -> Result<(), GpuError> {
        let key = look.sky_key();
        let (Some((_, air)), false) = (&self.air, self.sky.as_ref().is_some_and(|(k, _)| *k == key)) else {
            return Ok(());
        };
        let table = match self.sky.take() {
            Some((_, table)) => table,
            None => self.context.storage("the sky table", ViewStages::SKY_BYTES)?,
        };
        let sources = look.sources();
        let mut views = vec![SkyView::new(&sources.sun, look.position_m[2])];
        if let Some((moon, _)) = &sources.moon {
            views.push(SkyView {
                first_texel: ViewStages::SKY_TEXELS as u32,
                ..SkyView::new(moon, look.position_m[2])
            });
        }
        for view in &views {
            self.stages
                .sky_table(&air.air, view, &air.transmittance, &air.multiple, &table)?;
        }
        if let (Some(formula), Some((air, transmittance, multiple))) = (&sources.analytic, &self.formula_air) {
            // The sun is up, so the moon has no sky: nothing of the table is the GPU's own.
            let height_m = look.position_m[2];
            let made = SkyTable::new(air, transmittance, multiple, &sources.sun, Some(formula), height_m);
            let [red, green, blue] = made.planes();
            let texels: Vec<[f32; 4]> = (0..red.len()).map(|n| [red[n], green[n], blue[n], 0.0]).collect();
            self.context
                .queue
                .write_buffer(&table, 0, bytemuck::cast_slice(&texels));
        }
        self.context.wait()?;
        self.sky = Some((key, table));
        after("sky_table");
        Ok(())
    }

    /// The air's tables on the CPU, where a formula's sky is made there.
    fn prepare_formula_air(&mut self, look: &Look) {
        let made = self.formula_air.as_ref().is_some_and(|(air, ..)| *air == look.air);
        if look.sources().analytic.is_some() && !made {
            let transmittance = TransmittanceTable::new(&look.air);
            let multiple = MultipleScatteringTable::new(&look.air, &transmittance);
            self.formula_air = Some((look.air, transmittance, multiple));
        }
    }

    fn prepare_stars(&mut self, look: &Look, after: &mut dyn FnMut(&'static str)) -> Result<(), GpuError> {
        let Some(places) = look.stars else { return Ok(()) };
        let key = [places.faintest, places.years_since_2000];
        if self.stars.as_ref().is_none_or(|(k, _)| *k != key) {
            let table = StarTable::new(places.faintest, places.years_since_2000);
            let words = self.context.uniform("the stars", bytemuck::cast_slice(table.words()))?;
            self.stars = Some((key, words));
            after("stars");
        }
        Ok(())
    }

    fn prepare_light(&mut self, look: &Look, after: &mut dyn FnMut(&'static str)) -> Result<(), GpuError> {
        let cloud = self.shape.as_ref().and_then(|(_, c)| c.as_ref());
        let key = look.light_key(cloud.map(|c| [c.grid.bottom_m, c.grid.top_m]));
        let (Some((_, air)), false) = (&self.air, self.light.as_ref().is_some_and(|(k, _)| *k == key)) else {
            return Ok(());
        };
        let values = match self.light.take() {
            Some((_, values)) => values,
            None => self.stages.sky_light_buffer()?,
        };
        let (.., base_top_m) = key;
        let sources = look.sources();
        let mut asks = vec![SkyLightAsk::new(&sources.sun, look.ground, base_top_m)];
        if let Some((moon, beam_share)) = &sources.moon {
            asks.push(SkyLightAsk::moon(moon, *beam_share, look.ground, base_top_m));
        }
        for ask in &asks {
            self.stages
                .sky_light(&air.air, ask, &air.transmittance, &air.multiple, &values)?;
        }
        if let (Some(formula), Some((air, transmittance, multiple))) = (&sources.analytic, &self.formula_air) {
            let albedo = look.ground.albedo();
            let light = SkyLight::new(
                air,
                transmittance,
                multiple,
                albedo,
                &sources.sun,
                Some(formula),
                base_top_m,
            );
            let light = SkyLightValues::new(&light);
            self.context.queue.write_buffer(&values, 0, light.bytes());
        }
        self.context.wait()?;
        self.light = Some((key, values));
        after("sky_light");
        Ok(())
    }

    fn prepare_shape(
        &mut self,
        key: u64,
        volume: Option<&CloudVolume>,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<(), GpuError> {
        if self.shape.as_ref().is_some_and(|(k, _)| *k == key) {
            return Ok(());
        }
        self.shape = None;
        self.sun_light = None;
        let Some(slab) = volume.and_then(Slab::new) else {
            self.shape = Some((key, None));
            return Ok(());
        };
        let context = &self.context;
        let buffers = &mut self.buffers;
        let grid = ShapeGrid::new(&slab);
        let cells = slab.extinction_per_m.len() as u64 * 4;
        let extinction = fit(context, &mut buffers.extinction, "the cloud's extinction", cells)?;
        let largest = fit(context, &mut buffers.largest, "the largest extinction around", cells)?;
        let words = fit(context, &mut buffers.words, "the cloud's shape", grid.word_bytes())?;
        let along_x = fit(context, &mut buffers.along_x, "distances along x", cells)?;
        let along_xy = fit(context, &mut buffers.along_xy, "distances along x and y", cells)?;
        let occupancy = fit(context, &mut buffers.occupancy, "the occupancy", grid.occupancy_bytes())?;
        let above = fit(context, &mut buffers.above, "the sky's visibility", cells)?;
        let below = fit(context, &mut buffers.below, "the ground's visibility", cells)?;
        let uniform = context.uniform("the cloud's grid", bytemuck::bytes_of(&grid))?;
        context
            .queue
            .write_buffer(&extinction, 0, bytemuck::cast_slice(&slab.extinction_per_m));
        self.stages.shape(&grid, &uniform, &extinction, &largest, &words)?;
        self.stages
            .occupancy(&grid, &uniform, &largest, [&along_x, &along_xy], &occupancy)?;
        context.wait()?;
        after("shape");
        self.stages.sky_visibility(&slab, &extinction, &above, &below)?;
        context.wait()?;
        after("sky_visibility");
        let cloud = Cloud {
            grid,
            uniform,
            words,
            occupancy,
            above,
            below,
        };
        self.shape = Some((key, Some(cloud)));
        Ok(())
    }

    fn prepare_sun_light(
        &mut self,
        look: &Look,
        volume: u64,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<(), GpuError> {
        let Some((_, Some(cloud))) = &self.shape else {
            return Ok(());
        };
        let behind = [
            scattered_bytes(look, &cloud.grid),
            mapping(look, &cloud.grid).map_or(0, |map| map.map_bytes()),
        ];
        let key = (look.sun_light_key(volume), behind);
        if self.sun_light.as_ref().is_some_and(|(k, _)| *k == key) {
            return Ok(());
        }
        self.sun_light = None;
        let (context, buffers) = (&self.context, &mut self.buffers);
        let grid = &cloud.grid;
        let light = CloudLight {
            words: fit(
                context,
                &mut buffers.light_words,
                "the cloud's light",
                grid.word_bytes(),
            )?,
            shadow: fit(
                context,
                &mut buffers.shadow,
                "the shadow map and what lies behind it",
                grid.shadow_bytes() + behind[0] + behind[1],
            )?,
            diffuse: None,
            balance: None,
            map: None,
        };
        let march = SunMarch::new(look);
        self.stages.sun_optical_depth(
            grid,
            &cloud.uniform,
            &march,
            [&cloud.words, &cloud.occupancy, &cloud.above, &cloud.below],
            &light.words,
            &light.shadow,
        )?;
        context.wait()?;
        self.sun_light = Some((key, light));
        after("sun_optical_depth");
        Ok(())
    }

    fn prepare_diffusion(
        &mut self,
        look: &Look,
        volume: u64,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<(), GpuError> {
        let (Some(key), Some((_, Some(cloud))), Some((_, light))) =
            (look.diffuse_key(volume), &self.shape, &mut self.sun_light)
        else {
            return Ok(());
        };
        if light.diffuse == Some(key) {
            return Ok(());
        }
        light.diffuse = None;
        let (context, buffers) = (&self.context, &mut self.buffers);
        let bytes = ViewStages::diffusion_bytes(&cloud.grid);
        let conductance = fit(context, &mut buffers.conductance, "what diffuse light passes", bytes)?;
        let numbers = fit(context, &mut buffers.numbers, "the diffuse light's grids", bytes)?;
        self.stages.diffusion(
            &cloud.grid,
            &cloud.uniform,
            (look.detail.is_some(), self.asymmetry),
            [&cloud.words, &cloud.occupancy, &light.words],
            [&conductance, &numbers],
            &light.shadow,
        )?;
        context.wait()?;
        light.diffuse = Some(key);
        after("diffusion");
        Ok(())
    }

    fn prepare_octave_balance(
        &mut self,
        look: &Look,
        volume: u64,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<(), GpuError> {
        let (Some(key), Some((_, _, phase)), Some((_, Some(cloud))), Some((_, light))) =
            (look.balance_key(volume), &self.phase, &self.shape, &mut self.sun_light)
        else {
            return Ok(());
        };
        if light.balance == Some(key) {
            return Ok(());
        }
        light.balance = None;
        let grid = &cloud.grid;
        let bytes = u64::from(grid.cells_x) * u64::from(grid.cells_y) * 12;
        let columns = fit(&self.context, &mut self.buffers.columns, "sums over columns", bytes)?;
        let told = OctaveBalancing::new(look.table_beam, look.detail.is_some(), self.asymmetry, look.octaves);
        self.stages.octave_balance(
            grid,
            [&cloud.uniform, phase],
            &told,
            [&cloud.words, &cloud.occupancy, &light.words],
            &columns,
            &light.shadow,
        )?;
        self.context.wait()?;
        light.balance = Some(key);
        after("octave_balance");
        Ok(())
    }

    fn prepare_sun_map(
        &mut self,
        look: &Look,
        volume: u64,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<(), GpuError> {
        let (Some(key), Some(noise), Some((_, Some(cloud))), Some((_, light))) =
            (look.sun_map_key(volume), &self.noise, &self.shape, &mut self.sun_light)
        else {
            return Ok(());
        };
        let Some(map) = mapping(look, &cloud.grid).filter(|_| light.map != Some(key)) else {
            return Ok(());
        };
        light.map = None;
        let buffers = [&cloud.words, &cloud.occupancy, noise];
        self.stages.sun_map(&cloud.uniform, &map, buffers, &light.shadow)?;
        self.context.wait()?;
        light.map = Some(key);
        after("sun_map");
        Ok(())
    }

    /// Draws what is prepared, on its own. Errors: those of memory and loss.
    pub(super) fn march(
        &mut self,
        look: &Look,
        settings: &ViewSettings,
        after: &mut dyn FnMut(&'static str),
    ) -> Result<Vec<u8>, GpuError> {
        let size = [settings.width, settings.height];
        let picture_words = row_words(size[0]) * size[1];
        let half = self.has_cloud() && settings.sampling == ViewSampling::HalfResolution;
        let stages = self.stages.clone();
        let picture;
        if half {
            let sampling = Sampling::new(size, picture_words, 2, [0, 0]);
            picture = self.picture_buffer((picture_words + sampling.words()) as u64 * 4)?;
            let uniform = self.context.uniform("the sampling", sampling.bytes())?;
            let kernel = stages.samples_kernel()?;
            self.in_bands(kernel, look, settings, sampling.size(), &picture, &[&uniform])?;
            self.context.wait()?;
            after("march");
            let kernel = stages.upsampled_kernel()?;
            self.in_bands(kernel, look, settings, size, &picture, &[&uniform])?;
        } else {
            picture = self.picture_buffer(picture_words as u64 * 4)?;
            self.in_bands(&stages.march, look, settings, size, &picture, &[])?;
        }
        let rgb8 = self.read_picture(&picture, size)?;
        after(if half { "upsample" } else { "march" });
        Ok(rgb8)
    }

    /// The bytes of a picture that was drawn. Errors: those of loss.
    pub(super) fn read_picture(
        &self,
        picture: &wgpu::Buffer,
        [width, height]: [usize; 2],
    ) -> Result<Vec<u8>, GpuError> {
        let row_bytes = row_words(width) * 4;
        let mut rgb8 = self.context.read(picture, (row_bytes * height) as u64)?;
        if row_bytes != width * 3 {
            for row in 1..height {
                let from = row * row_bytes;
                rgb8.copy_within(from..from + width * 3, row * width * 3);
            }
        }
        rgb8.truncate(width * height * 3);
        Ok(rgb8)
    }

    /// What tells a cloud with its light from another, and the heights between which it lies, m; none where there is none.
    pub(super) fn cloud(&self) -> Option<(u64, [f32; 2])> {
        let (key, cloud) = self.shape.as_ref()?;
        let grid = &cloud.as_ref().filter(|_| self.sun_light.is_some())?.grid;
        Some((*key, [grid.bottom_m, grid.top_m]))
    }

    /// Whether there is cloud with its light.
    fn has_cloud(&self) -> bool {
        self.cloud().is_some()
    }

    /// Runs a kernel that binds what the march does, and uniforms of its own where it has some, on `columns` by `rows` invocations; in bands of rows, of
    /// which the frame tells it.
    pub(super) fn in_bands(
        &self,
        kernel: &Kernel,
        look: &Look,
        settings: &ViewSettings,
        size: [usize; 2],
        picture: &wgpu::Buffer,
        own: &[&wgpu::Buffer],
    ) -> Result<(), GpuError> {
        self.in_bands_then(kernel, look, settings, size, (picture, own), |_, _| ())
    }

    /// The same, and calls `after` with a band's first row and how many it has when that has been submitted.
    pub(super) fn in_bands_then(
        &self,
        kernel: &Kernel,
        look: &Look,
        settings: &ViewSettings,
        [columns, rows]: [usize; 2],
        (picture, own): (&wgpu::Buffer, &[&wgpu::Buffer]),
        mut after: impl FnMut(usize, usize),
    ) -> Result<(), GpuError> {
        let (Some(noise), Some((_, air)), Some((_, sky)), Some((_, light)), Some((_, depth_scale, phase))) =
            (&self.noise, &self.air, &self.sky, &self.light, &self.phase)
        else {
            return Err(GpuError::Other {
                message: "a table of the view is missing".to_owned(),
            });
        };
        let shape = self.shape.as_ref().and_then(|(_, shape)| shape.as_ref());
        let cloud = shape.zip(self.sun_light.as_ref().map(|(_, light)| light));
        let row_words = row_words(settings.width);
        let mut frame = ViewFrame::new(look, settings, cloud.is_some(), row_words, *depth_scale);
        if let Some((cloud, _)) = &cloud {
            frame.tell_light(look, self.asymmetry);
            if let Some(map) = mapping(look, &cloud.grid) {
                (frame.map_sun, frame.map_at) = (map.map_sun, map.map_at);
            }
        }
        let blank = &self.blank;
        let (grid, words, occupancy, light_words, shadow) = match &cloud {
            Some((c, l)) => (&c.uniform, &c.words, &c.occupancy, &l.words, &l.shadow),
            None => (&self.stages.no_cloud, blank, blank, blank, blank),
        };
        let stars = self.stars.as_ref().map_or(&self.stages.no_stars, |(_, words)| words);
        let shared = [
            &self.frame,
            light,
            grid,
            &air.transmittance,
            sky,
            words,
            occupancy,
            light_words,
            shadow,
            noise,
            picture,
            stars,
            phase,
        ];
        let buffers: Vec<&wgpu::Buffer> = shared.into_iter().chain(own.iter().copied()).collect();
        let bound = kernel.bind(&self.context, &buffers);
        let band = band_rows(columns);
        for first_row in (0..rows).step_by(band) {
            frame.first_row = first_row as u32;
            self.context
                .queue
                .write_buffer(&self.frame, 0, bytemuck::bytes_of(&frame));
            let rows = band.min(rows - first_row);
            self.stages.tiles(kernel, &bound, [columns, rows])?;
            after(first_row, rows);
        }
        Ok(())
    }

    /// The buffer that pictures are drawn into, of at least so many bytes.
    pub(super) fn picture_buffer(&mut self, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        fit(&self.context, &mut self.picture, "the picture", bytes)
    }
}

/// Words of a row of a picture: filled up to whole ones.
pub(super) fn row_words(width: usize) -> usize {
    width.div_ceil(4) * 3
}

/// Rows of so many columns that one submission draws.
pub(super) fn band_rows(columns: usize) -> usize {
    (BAND_PIXELS / columns).next_multiple_of(8).max(8)
}

/// Bytes of the fluence, or of the octaves' balance, that lie behind the shadow map and its share.
fn scattered_bytes(look: &Look, grid: &ShapeGrid) -> u64 {
    let fluence = look.diffuse_key(0).map_or(0, |_| grid.fluence_bytes());
    fluence + look.balance_key(0).map_or(0, |_| grid.balance_bytes())
}

/// The map of the sun's rays that a picture wants, if any: behind the shadow map, its share and what light the clouds scatter.
fn mapping(look: &Look, grid: &ShapeGrid) -> Option<SunMapping> {
    let (_, detail, kind, side, sun) = look.sun_map_key(0)?;
    let map_at = (grid.shadow_bytes() + scattered_bytes(look, grid)) / 4;
    Some(SunMapping::new(grid, sun, detail, kind, side, map_at))
}

/// The buffer kept in `slot`, made anew if it is smaller than `bytes`.
fn fit(context: &Context, slot: &mut Option<wgpu::Buffer>, what: &str, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
    if let Some(buffer) = slot.as_ref().filter(|b| b.size() >= bytes) {
        return Ok(buffer.clone());
    }
    // The old one is freed first: there may not be room for both.
    *slot = None;
    let buffer = context.storage(what, bytes)?;
    *slot = Some(buffer.clone());
    Ok(buffer)
}

fn wide(v: [f32; 3], last: f32) -> [f32; 4] {
    [v[0], v[1], v[2], last]
}

impl ViewFrame {
    /// What the march is told of a picture; `first_row` is 0. `depth_scale` is the phase function's.
    pub fn new(look: &Look, settings: &ViewSettings, cloud: bool, row_words: usize, depth_scale: f32) -> ViewFrame {
        let haze = Haze::new(&look.air, look.position_m[2]);
        let [right, up, ahead] = look.axes;
        let [east, north] = sun_azimuth(look.table_sun);
        let moon_sky = look.sources().moon;
        let [moon_east, moon_north] = moon_sky.map_or([0.0; 2], |(moon, _)| sun_azimuth(moon.direction));
        let moon = look.moon;
        let equator = look.stars.map_or([[0.0; 3]; 3], |s| s.equatorial_from_world);
        let detail = look.detail;
        ViewFrame {
            position_m: wide(look.position_m, 0.0),
            right: wide(right, 0.0),
            up: wide(up, 0.0),
            ahead: wide(ahead, 0.0),
            sun_direction: wide(look.sun_direction, 0.0),
            beam_direction: wide(look.beam_direction, 0.0),
            marched_beam: wide(marched_direction(look.beam_direction), 0.0),
            sky_sun: [east, north, moon_east, moon_north],
            moon_direction: moon.map_or([0.0; 4], |m| wide(m.direction, m.angular_radius)),
            moon_light: wide(moon.map_or([0.0; 3], |m| m.irradiance), 0.0),
            equator_x: wide(equator[0], 0.0),
            equator_y: wide(equator[1], 0.0),
            equator_z: wide(equator[2], 0.0),
            haze_per_m: wide(haze.rayleigh_per_m, haze.aerosol_per_m),
            ground_albedo: wide(look.ground.albedo(), 0.0),
            ground_tint: wide(look.ground.tint(), 0.0),
            detail_offset_m: wide(detail.map_or([0.0; 3], |d| d.offset_m), 0.0),
            width: settings.width as u32,
            height: settings.height as u32,
            first_row: 0,
            row_words: row_words as u32,
            radians_per_pixel: 2.0 * look.half_height / settings.height as f32,
            horizon_sine: horizon_sine(look.position_m[2]),
            exposure_gain: look.exposure_gain,
            detail_push: detail.map_or(0.0, |d| d.push),
            detail_blend: detail.map_or(0.0, |d| d.blend),
            detail_tiles_per_m: detail.map_or(0.0, |d| d.tiles_per_m),
            octaves: look.octaves as u32,
            cloud: cloud as u32,
            shadow: (cloud && settings.cloud_shadow) as u32,
            sea: (look.ground == Ground::Sea) as u32,
            haze_on_cloud: settings.visibility_m.is_some() as u32,
            night: look.night as u32,
            moon_sky: moon_sky.is_some() as u32,
            stars: look.stars.is_some() as u32,
            secondary_steps: look.secondary_steps(),
            shaft_samples: if cloud { look.shaft_samples } else { 0 },
            depth_scale,
            step_depth: look.steps.0,
            segments: look.steps.1,
            ..Default::default()
        }
    }
    /// Tells of diffuse light, by the phase function's asymmetry, and of a map of the sun's rays, where they are wanted; where the map lies is not said.
    pub fn tell_light(&mut self, look: &Look, asymmetry: f32) {
        if look.lighting.scattering == Scattering::Diffusion {
            self.similarity = similarity(asymmetry);
        }
        if let SunOcclusion::ShadowMap { kind, side } = look.lighting.sun_occlusion {
            (self.map_side, self.map_numbers) = (map_side(side) as u32, kind.numbers() as u32);
        }
    }
}
