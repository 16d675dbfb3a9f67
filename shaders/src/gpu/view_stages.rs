//! The stages of light and view in WGSL: compiled, with the structs that they are told things by.
//!
//! Every stage submits its own work and does not wait for it.

use std::sync::Arc;

use super::view_diffusion::DiffusionKernels;
use super::view_kernels::{LateKernel, compiled};
use super::{Context, GpuError, Kernel};
use crate::cpu::light::Atmosphere;
use crate::cpu::light::march_phase::PHASE_QUADS;
use crate::cpu::light::multiple_scattering_table::{MULTIPLE_HEIGHTS, MULTIPLE_SUNS};
use crate::cpu::light::sky_light::SkyLight;
use crate::cpu::light::sky_table::{SKY_COLUMNS, SKY_HALF_ROWS, SkySource, horizon_sine};
use crate::cpu::light::sky_visibility::slanted_path;
use crate::cpu::light::stars::STAR_WORDS;
use crate::cpu::light::sun_optical_depth::{marched_direction, margin_m};
use crate::cpu::light::transmittance_table::{TRANSMITTANCE_DIRECTIONS, TRANSMITTANCE_HEIGHTS};
use crate::cpu::view::detail_noise::TILE_POINTS;
use crate::view::{Ground, Look, Slab};
use crate::wgsl::{Layout, Member};

crate::constants! {
    /// Cells of whole lines that a workgroup of `sky_visibility` keeps; four numbers each.
    pub const VISIBILITY_TILE: usize = 1024;
}

crate::gpu_struct! {
    /// The clear air over a place.
    pub struct Air {
        /// As in the twin.
        pub surface_altitude_m: f32,
        /// As in the twin.
        pub aerosol_per_m: f32,
        /// Fills 16 bytes.
        pub unused_0: f32,
        /// Fills 16 bytes.
        pub unused_1: f32,
    }
}

crate::gpu_struct! {
    /// What the sky table is told.
    pub struct SkyView {
        /// Towards sun or moon.
        pub direction: [f32; 4],
        /// Its irradiance over the sun's.
        pub strength: [f32; 4],
        /// Even light that the air scatters besides.
        pub scattered_glow: [f32; 4],
        /// Light of the layer above the air.
        pub layer_glow: [f32; 4],
        /// Sine of the horizon's elevation.
        pub horizon_sine: f32,
        /// The camera's height, m.
        pub height_m: f32,
        /// Where its part of the table begins.
        pub first_texel: u32,
        /// Fills 16 bytes.
        pub unused_0: f32,
    }
}

crate::gpu_struct! {
    /// What the light on clouds and ground is told.
    pub struct SkyLightAsk {
        /// Towards sun or moon.
        pub direction: [f32; 4],
        /// Its irradiance over the sun's.
        pub strength: [f32; 4],
        /// Even light that the air scatters besides.
        pub scattered_glow: [f32; 4],
        /// Light of the layer above the air.
        pub layer_glow: [f32; 4],
        /// Share of light that the ground gives back.
        pub ground_albedo: [f32; 4],
        /// The clouds' base, m.
        pub base_m: f32,
        /// Their top, m.
        pub top_m: f32,
        /// Share of the moon's beam that is let in.
        pub beam_share: f32,
        /// Whether it is added to what is there: the moon's light to the sun's.
        pub adds: u32,
    }
}

crate::gpu_struct! {
    /// Light for clouds and ground, the fields of the twin's `SkyLight`; fourth numbers are 0.
    pub struct SkyLightValues {
        /// Irradiance of the sun, or by night of the moon, across its beam at the clouds' base.
        pub sun_at_base: [f32; 4],
        /// The same at the clouds' top.
        pub sun_at_top: [f32; 4],
        /// The same at the ground.
        pub sun_at_ground: [f32; 4],
        /// Mean radiance of the upper half of the sky.
        pub sky_radiance: [f32; 4],
        /// Irradiance of level ground by the sky without the sun.
        pub sky_irradiance: [f32; 4],
        /// Mean radiance that comes up from ground without clouds.
        pub ground_radiance: [f32; 4],
    }
}

crate::gpu_struct! {
    /// One sweep of `sky_visibility`.
    pub struct VisibilitySweep {
        /// Cells east.
        pub cells_x: u32,
        /// Cells north.
        pub cells_y: u32,
        /// Levels.
        pub levels: u32,
        /// 0 carries along x, 1 along y.
        pub axis: u32,
        /// Lines of cells that a workgroup takes.
        pub lines_per_tile: u32,
        /// Length of the path through a level, m.
        pub path_m: f32,
        /// Cells that the path goes sideways in a level.
        pub reach: f32,
        /// Factor on the sum so far.
        pub scale: f32,
    }
}

crate::gpu_struct! {
    /// The slab of cells with cloud and the points that its shape is made on.
    pub struct ShapeGrid {
        /// Points east.
        pub points_x: u32,
        /// Points north.
        pub points_y: u32,
        /// Points up.
        pub points_z: u32,
        /// Points along an edge of a cell.
        pub finer: u32,
        /// Row length as stored: one more point on each side.
        pub stride_x: u32,
        /// Rows of a level as stored.
        pub stride_y: u32,
        /// Cells east.
        pub cells_x: u32,
        /// Cells north.
        pub cells_y: u32,
        /// Levels of cells.
        pub levels: u32,
        /// Words of occupancy that a row of workgroups writes.
        pub occupancy_row: u32,
        /// Lowest height with cloud, m.
        pub bottom_m: f32,
        /// Highest height with cloud, m.
        pub top_m: f32,
        /// Distance between points, m.
        pub point_spacing_x_m: f32,
        /// Distance between points, m.
        pub point_spacing_y_m: f32,
        /// Distance between points, m.
        pub point_spacing_z_m: f32,
        /// Amplitude a unit, 1/m.
        pub amplitude_unit_per_m: f32,
        /// One over the period, 1/m.
        pub per_period_x: f32,
        /// One over the period, 1/m.
        pub per_period_y: f32,
        /// Cell size, m.
        pub cell_size_x_m: f32,
        /// Cell size, m.
        pub cell_size_y_m: f32,
        /// Cell size, m.
        pub cell_size_z_m: f32,
        /// Fills 16 bytes.
        pub unused_0: f32,
        /// Fills 16 bytes.
        pub unused_1: f32,
        /// Fills 16 bytes.
        pub unused_2: f32,
    }
}

crate::gpu_struct! {
    /// What the march towards the sun is told.
    pub struct SunMarch {
        /// The direction that is marched to.
        pub direction: [f32; 4],
        /// Whether detail carves the cloud.
        pub carved: u32,
        /// Points farther than this from cloud are left empty, m.
        pub margin_m: f32,
        /// Fills 16 bytes.
        pub unused_0: u32,
        /// Fills 16 bytes.
        pub unused_1: u32,
    }
}

/// How clouds turn light, the twin's `MarchPhase`: a uniform, for the march binds all the storage that it may.
pub const MARCH_PHASE: Layout = Layout {
    name: "MarchPhase",
    members: &[Member {
        name: "quads",
        kind: "array<vec4<f32>, PHASE_QUADS>",
        offset: 0,
        size: 16 * PHASE_QUADS,
    }],
    size: 16 * PHASE_QUADS,
};

crate::gpu_struct! {
    /// What the march of a picture is told.
    pub struct ViewFrame {
        /// Camera, m.
        pub position_m: [f32; 4],
        /// Unit vector to the right.
        pub right: [f32; 4],
        /// Unit vector up.
        pub up: [f32; 4],
        /// Unit vector ahead.
        pub ahead: [f32; 4],
        /// Towards the sun.
        pub sun_direction: [f32; 4],
        /// Towards what throws shadows: the sun, by night the moon.
        pub beam_direction: [f32; 4],
        /// The same, never too low to march to.
        pub marched_beam: [f32; 4],
        /// East and north of the sun that the sky table is made for, then of the moon.
        pub sky_sun: [f32; 4],
        /// Towards the moon, and its angular radius; 0 where there is none.
        pub moon_direction: [f32; 4],
        /// Its irradiance over the sun's.
        pub moon_light: [f32; 4],
        /// Rows that turn a direction of the world into the equator's frame of date.
        pub equator_x: [f32; 4],
        /// See `equator_x`.
        pub equator_y: [f32; 4],
        /// See `equator_x`.
        pub equator_z: [f32; 4],
        /// Scattering by molecules at the camera, and extinction by aerosol, 1/m.
        pub haze_per_m: [f32; 4],
        /// The ground's mean albedo.
        pub ground_albedo: [f32; 4],
        /// How strongly patches change it.
        pub ground_tint: [f32; 4],
        /// Added to positions for the detail, m.
        pub detail_offset_m: [f32; 4],
        /// The sun that a map of its rays is made for, and their length, m.
        pub map_sun: [f32; 4],
        /// Pixels.
        pub width: u32,
        /// Pixels.
        pub height: u32,
        /// First row that is drawn.
        pub first_row: u32,
        /// Words of a row of the picture.
        pub row_words: u32,
        /// Tangent of a pixel's height.
        pub radians_per_pixel: f32,
        /// Sine of the horizon's elevation.
        pub horizon_sine: f32,
        /// Factor on the exposure.
        pub exposure_gain: f32,
        /// How far detail pushes the edge, in cover.
        pub detail_push: f32,
        /// Share of the carved cloud; 0 is no detail.
        pub detail_blend: f32,
        /// One over the detail tile's edge, 1/m.
        pub detail_tiles_per_m: f32,
        /// Octaves after the first.
        pub octaves: u32,
        /// Whether there is a cloud.
        pub cloud: u32,
        /// Whether the ground shows its shadow.
        pub shadow: u32,
        /// Whether the ground is the sea.
        pub sea: u32,
        /// Whether haze lies between camera and cloud.
        pub haze_on_cloud: u32,
        /// Whether pictures adapt to the dark.
        pub night: u32,
        /// Whether the sky table has the moon's part.
        pub moon_sky: u32,
        /// Whether stars are drawn.
        pub stars: u32,
        /// Steps of the march from each sample towards the sun; 0 takes the stored depths.
        pub secondary_steps: u32,
        /// Factor on optical depths towards the sun.
        pub depth_scale: f32,
        /// Samples of the clouds' shadows in the air; 0 where they are not wanted.
        pub shaft_samples: u32,
        /// Optical depth of a step; 0 where it does not go by that.
        pub step_depth: f32,
        /// Logarithmic segments; 0 where it does not go by them.
        pub segments: u32,
        /// Rays along the side of a map of the sun's rays; 0 where there is none.
        pub map_side: u32,
        /// Numbers that it keeps of a ray.
        pub map_numbers: u32,
        /// 1 less the phase function's asymmetry, where light diffuses; else 0.
        pub similarity: f32,
        /// Where it lies behind the shadow map.
        pub map_at: u32,
        /// Fills 16 bytes.
        pub unused_0: u32,
    }
}

impl Air {
    /// From the twin's.
    pub fn new(air: &Atmosphere) -> Air {
        Air {
            surface_altitude_m: air.surface_altitude_m,
            aerosol_per_m: air.aerosol_per_m,
            ..Default::default()
        }
    }
}

impl SkyView {
    /// For a source and a camera's height in m; `first_texel` is 0.
    pub fn new(source: &SkySource, height_m: f32) -> SkyView {
        SkyView {
            direction: padded(source.direction),
            strength: padded(source.strength),
            scattered_glow: padded(source.scattered_glow),
            layer_glow: padded(source.layer_glow),
            horizon_sine: horizon_sine(height_m),
            height_m,
            ..Default::default()
        }
    }
}

impl SkyLightValues {
    /// From the twin's.
    pub fn new(light: &SkyLight) -> SkyLightValues {
        SkyLightValues {
            sun_at_base: padded(light.sun_at_base),
            sun_at_top: padded(light.sun_at_top),
            sun_at_ground: padded(light.sun_at_ground),
            sky_radiance: padded(light.sky_radiance),
            sky_irradiance: padded(light.sky_irradiance),
            ground_radiance: padded(light.ground_radiance),
        }
    }
}

impl SkyLightAsk {
    /// For a source, a ground, and the clouds' base and top in m.
    pub fn new(source: &SkySource, ground: Ground, base_top_m: [f32; 2]) -> SkyLightAsk {
        SkyLightAsk {
            direction: padded(source.direction),
            strength: padded(source.strength),
            scattered_glow: padded(source.scattered_glow),
            layer_glow: padded(source.layer_glow),
            ground_albedo: padded(ground.albedo()),
            base_m: base_top_m[0],
            top_m: base_top_m[1],
            ..Default::default()
        }
    }
    /// For the moon, whose light is added to the sun's.
    pub fn moon(moon: &SkySource, beam_share: f32, ground: Ground, base_top_m: [f32; 2]) -> SkyLightAsk {
        SkyLightAsk {
            beam_share,
            adds: 1,
            ..SkyLightAsk::new(moon, ground, base_top_m)
        }
    }
}

fn padded([x, y, z]: [f32; 3]) -> [f32; 4] {
    [x, y, z, 0.0]
}

impl SunMarch {
    /// For a picture's beam.
    pub fn new(look: &Look) -> SunMarch {
        SunMarch::along(look.table_beam, look.detail.is_some(), look.lit_everywhere())
    }
    /// Towards a sun, with or without detail, near cloud or everywhere.
    pub fn along(sun: [f32; 3], carved: bool, everywhere: bool) -> SunMarch {
        let [x, y, z] = marched_direction(sun);
        SunMarch {
            direction: [x, y, z, 0.0],
            carved: carved as u32,
            margin_m: margin_m(everywhere),
            ..Default::default()
        }
    }
}

impl ShapeGrid {
    /// Of a slab.
    pub fn new(slab: &Slab) -> ShapeGrid {
        let [nx, ny, levels] = slab.cells.map(|n| n as u32);
        let [px, py, pz] = slab.points().map(|n| n as u32);
        let [sx, sy, sz] = slab.point_spacing_m();
        let [per_x, per_y] = slab.per_period();
        ShapeGrid {
            points_x: px,
            points_y: py,
            points_z: pz,
            finer: slab.finer as u32,
            stride_x: px + 2,
            stride_y: py + 2,
            cells_x: nx,
            cells_y: ny,
            levels,
            occupancy_row: (nx * ny * levels).div_ceil(4).min(1 << 20),
            bottom_m: slab.bottom_m,
            top_m: slab.top_m,
            point_spacing_x_m: sx,
            point_spacing_y_m: sy,
            point_spacing_z_m: sz,
            amplitude_unit_per_m: slab.amplitude_unit_per_m(),
            per_period_x: per_x,
            per_period_y: per_y,
            cell_size_x_m: slab.cell_size_m[0],
            cell_size_y_m: slab.cell_size_m[1],
            cell_size_z_m: slab.cell_size_m[2],
            ..Default::default()
        }
    }
    /// Cells of the slab.
    pub fn cells(&self) -> u64 {
        self.cells_x as u64 * self.cells_y as u64 * self.levels as u64
    }
    /// Bytes of the shape's points, and of the light's.
    pub fn word_bytes(&self) -> u64 {
        self.stride_x as u64 * self.stride_y as u64 * self.points_z as u64 * 4
    }
    /// Bytes of the diffuse light: a word a cell, with one more on each side in x and y.
    pub fn fluence_bytes(&self) -> u64 {
        (self.cells_x as u64 + 2) * (self.cells_y as u64 + 2) * self.levels as u64 * 4
    }
    /// Bytes of the octaves' balance: a number a column of cells, with one more on each side.
    pub fn balance_bytes(&self) -> u64 {
        (self.cells_x as u64 + 2) * (self.cells_y as u64 + 2) * 4
    }
    /// Bytes of the occupancy.
    pub fn occupancy_bytes(&self) -> u64 {
        self.cells().div_ceil(4) * 4
    }
    /// Bytes of the shadow map and the share behind it.
    pub fn shadow_bytes(&self) -> u64 {
        (self.stride_x as u64 * self.stride_y as u64 + 1) * 4
    }
}

/// The stages of light and view, compiled.
#[derive(Debug)]
pub struct ViewStages {
    context: Arc<Context>,
    transmittance: Kernel,
    multiple: Kernel,
    sky: Kernel,
    light: Kernel,
    straight: Kernel,
    slanted: Kernel,
    neighbours: Kernel,
    points: Kernel,
    nearest: [Kernel; 3],
    sun_points: Kernel,
    ground_shadow: Kernel,
    sunlit_share: Kernel,
    noise: [Kernel; 3],
    pub(super) march: Kernel,
    pub(super) samples: LateKernel,
    pub(super) upsampled: LateKernel,
    pub(super) reprojected: LateKernel,
    pub(super) impostors: [LateKernel; 3],
    pub(super) layers: LateKernel,
    pub(super) diffusion: DiffusionKernels,
    pub(super) sun_map: [LateKernel; 2],
    pub(super) octave_balance: [LateKernel; 5],
    /// The grid of no cloud.
    pub no_cloud: wgpu::Buffer,
    /// A table of no stars.
    pub no_stars: wgpu::Buffer,
}

impl ViewStages {
    /// Bytes of the transmittance table, `[height][direction]`, four numbers a texel.
    pub const TRANSMITTANCE_BYTES: u64 = (TRANSMITTANCE_HEIGHTS * TRANSMITTANCE_DIRECTIONS * 16) as u64;
    /// Bytes of the multiple scattering table, `[height][sun]`, four numbers a texel.
    pub const MULTIPLE_BYTES: u64 = (MULTIPLE_HEIGHTS * MULTIPLE_SUNS * 16) as u64;
    /// Texels of the sky table by one source.
    pub const SKY_TEXELS: usize = 2 * SKY_HALF_ROWS * SKY_COLUMNS;
    /// Bytes of the sky table, `[sun, moon][row][column]`, four numbers a texel.
    pub const SKY_BYTES: u64 = (2 * Self::SKY_TEXELS * 16) as u64;
    /// Bytes of the detail tile.
    pub const DETAIL_BYTES: u64 = (TILE_POINTS * TILE_POINTS * TILE_POINTS * 4) as u64;

    /// Compiles all. Errors: `Shader`, and those of memory and loss.
    pub fn new(context: Arc<Context>) -> Result<ViewStages, GpuError> {
        let c = &context;
        let kernel = |name| compiled(c, name);
        Ok(ViewStages {
            transmittance: kernel("transmittance")?,
            multiple: kernel("multiple_scattering")?,
            sky: kernel("sky")?,
            light: kernel("sky_light")?,
            straight: kernel("visibility_straight")?,
            slanted: kernel("visibility_slanted")?,
            neighbours: kernel("shape_neighbours")?,
            points: kernel("shape_points")?,
            nearest: [kernel("nearest_x")?, kernel("nearest_xy")?, kernel("nearest_xyz")?],
            sun_points: kernel("sun_points")?,
            ground_shadow: kernel("ground_shadow")?,
            sunlit_share: kernel("sunlit_share")?,
            noise: [kernel("noise_values")?, kernel("noise_spread")?, kernel("noise_pack")?],
            march: kernel("march")?,
            samples: LateKernel::new("samples"),
            upsampled: LateKernel::new("upsampled"),
            reprojected: LateKernel::new("reprojected"),
            impostors: ["far_mark", "far_tiles", "impostors"].map(LateKernel::new),
            layers: LateKernel::new("layers"),
            diffusion: DiffusionKernels::new(),
            sun_map: [LateKernel::new("sun_map_rays"), LateKernel::new("sun_map_mean")],
            octave_balance: [
                "balance_sums",
                "balance_brought_along_x",
                "balance_left_over_brought",
                "balance_shares_along_x",
                "balance_factors",
            ]
            .map(LateKernel::new),
            no_cloud: c.uniform("no cloud", bytemuck::bytes_of(&ShapeGrid::default()))?,
            no_stars: c.uniform("no stars", &[0; 4 * STAR_WORDS])?,
            context,
        })
    }

    /// The adapter that they are compiled for.
    pub fn context(&self) -> &Arc<Context> {
        &self.context
    }

    pub(super) fn submit(&self, record: impl FnOnce(&mut wgpu::ComputePass<'_>)) -> Result<(), GpuError> {
        let mut encoder = self.context.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            record(&mut pass);
        }
        self.context.queue.submit([encoder.finish()]);
        self.context.check()
    }

    /// Stage `transmittance_table`. Errors: those of memory and loss, as of all stages.
    pub fn transmittance_table(&self, air: &wgpu::Buffer, table: &wgpu::Buffer) -> Result<(), GpuError> {
        let texels = (TRANSMITTANCE_HEIGHTS * TRANSMITTANCE_DIRECTIONS) as u32;
        self.submit(|pass| {
            self.transmittance
                .record(pass, &self.context, &[air, table], [texels.div_ceil(64), 1, 1]);
        })
    }

    /// Stage `multiple_scattering_table`.
    pub fn multiple_scattering_table(
        &self,
        air: &wgpu::Buffer,
        transmittance: &wgpu::Buffer,
        table: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let texels = (MULTIPLE_HEIGHTS * MULTIPLE_SUNS) as u32;
        self.submit(|pass| {
            self.multiple
                .record(pass, &self.context, &[air, transmittance, table], [texels, 1, 1]);
        })
    }

    /// Stage `sky_table`.
    pub fn sky_table(
        &self,
        air: &wgpu::Buffer,
        view: &SkyView,
        transmittance: &wgpu::Buffer,
        multiple: &wgpu::Buffer,
        table: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let texels = Self::SKY_TEXELS as u32;
        let view = self.context.uniform("the view of the sky", bytemuck::bytes_of(view))?;
        self.submit(|pass| {
            let buffers = [air, &view, transmittance, multiple, table];
            self.sky
                .record(pass, &self.context, &buffers, [texels.div_ceil(64), 1, 1]);
        })
    }

    /// A buffer for the result of [`ViewStages::sky_light`], which the march binds as a uniform.
    pub fn sky_light_buffer(&self) -> Result<wgpu::Buffer, GpuError> {
        use wgpu::BufferUsages as Usage;
        let usage = Usage::STORAGE | Usage::UNIFORM | Usage::COPY_SRC | Usage::COPY_DST;
        let bytes = std::mem::size_of::<SkyLightValues>() as u64;
        self.context.buffer("the light on clouds and ground", bytes, usage)
    }

    /// Stage `sky_light`.
    pub fn sky_light(
        &self,
        air: &wgpu::Buffer,
        ask: &SkyLightAsk,
        transmittance: &wgpu::Buffer,
        multiple: &wgpu::Buffer,
        values: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let ask = self
            .context
            .uniform("the sun, ground and heights", bytemuck::bytes_of(ask))?;
        self.submit(|pass| {
            let buffers = [air, &ask, transmittance, multiple, values];
            self.light.record(pass, &self.context, &buffers, [1, 1, 1]);
        })
    }

    /// Stage `sky_visibility`. Errors besides: `TooLarge` for more cells along a side than a workgroup can keep.
    pub fn sky_visibility(
        &self,
        slab: &Slab,
        extinction: &wgpu::Buffer,
        above: &wgpu::Buffer,
        below: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let [nx, ny, levels] = slab.cells;
        if nx.max(ny) > VISIBILITY_TILE {
            return Err(GpuError::TooLarge {
                what: "a line of cells of sky_visibility".to_owned(),
                needed: nx.max(ny) as u64 * 16,
                allowed: VISIBILITY_TILE as u64 * 16,
            });
        }
        let sweep = VisibilitySweep {
            cells_x: nx as u32,
            cells_y: ny as u32,
            levels: levels as u32,
            lines_per_tile: 1,
            path_m: slab.cell_size_m[2],
            scale: 1.0,
            ..Default::default()
        };
        let uniform = |sweep: &VisibilitySweep| self.context.uniform("a sweep", bytemuck::bytes_of(sweep));
        let straight = uniform(&sweep)?;
        let slanted = |axis: usize| {
            let (path_m, reach) = slanted_path(slab.cell_size_m, axis);
            // One cell an invocation where lines are short; eight columns beside each other are read at once.
            let lines = (256 / slab.cells[axis]).max(8).min(VISIBILITY_TILE / slab.cells[axis]);
            let sweep = VisibilitySweep {
                axis: axis as u32,
                lines_per_tile: lines as u32,
                path_m,
                reach,
                // The second of the two ends the mean over five directions.
                scale: if axis == 0 { 1.0 } else { 0.2 },
                ..sweep
            };
            let tiles = slab.cells[1 - axis].div_ceil(lines) as u32;
            uniform(&sweep).map(|buffer| (buffer, tiles))
        };
        let (along_x, tiles_x) = slanted(0)?;
        let (along_y, tiles_y) = slanted(1)?;
        let c = &self.context;
        self.submit(|pass| {
            let groups = ((nx * ny) as u32).div_ceil(64);
            self.straight
                .record(pass, c, &[&straight, extinction, above, below], [groups, 2, 1]);
            self.slanted
                .record(pass, c, &[&along_x, extinction, above, below], [tiles_x, 2, 1]);
            self.slanted
                .record(pass, c, &[&along_y, extinction, above, below], [tiles_y, 2, 1]);
        })
    }

    /// Stage `shape`.
    pub fn shape(
        &self,
        grid: &ShapeGrid,
        uniform: &wgpu::Buffer,
        extinction: &wgpu::Buffer,
        largest: &wgpu::Buffer,
        words: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let cells = [grid.cells_x, grid.cells_y, grid.levels];
        let groups = |size: [u32; 3]| [0, 1, 2].map(|a| cells[a].div_ceil(size[a]));
        self.submit(|pass| {
            let buffers = [uniform, extinction, largest, words];
            self.neighbours
                .record(pass, &self.context, &buffers, groups([32, 2, 2]));
            self.points.record(pass, &self.context, &buffers, groups([16, 4, 4]));
        })
    }

    /// Stage `occupancy`; `along` are its squared distances along x, and along x and y.
    pub fn occupancy(
        &self,
        grid: &ShapeGrid,
        uniform: &wgpu::Buffer,
        largest: &wgpu::Buffer,
        along: [&wgpu::Buffer; 2],
        words: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let row = grid.occupancy_row;
        let rows = (grid.cells().div_ceil(4) as u32).div_ceil(row);
        let cells = [grid.cells_x.div_ceil(64), grid.cells_y, grid.levels];
        self.submit(|pass| {
            let buffers = [uniform, largest, along[0], along[1], words];
            for (kernel, groups) in self.nearest.iter().zip([cells, cells, [row.div_ceil(64), rows, 1]]) {
                kernel.record(pass, &self.context, &buffers, groups);
            }
        })
    }

    /// Stage `sun_optical_depth`; `cloud` is the shape, the occupancy, and the visibility of sky and of ground.
    pub fn sun_optical_depth(
        &self,
        grid: &ShapeGrid,
        uniform: &wgpu::Buffer,
        march: &SunMarch,
        cloud: [&wgpu::Buffer; 4],
        words: &wgpu::Buffer,
        shadow: &wgpu::Buffer,
    ) -> Result<(), GpuError> {
        let march = self.context.uniform("the sun", bytemuck::bytes_of(march))?;
        let [shape, occupancy, above, below] = cloud;
        let flat = [grid.stride_x.div_ceil(32), grid.stride_y.div_ceil(2), 1];
        self.submit(|pass| {
            let buffers = [uniform, &march, shape, occupancy, above, below, words, shadow];
            let c = &self.context;
            self.sun_points
                .record(pass, c, &buffers, [flat[0], flat[1], grid.points_z.div_ceil(2)]);
            self.ground_shadow.record(pass, c, &buffers, flat);
            self.sunlit_share.record(pass, c, &buffers, [1, 1, 1]);
        })
    }

    /// Stage `detail_noise`.
    pub fn detail_noise(&self, words: &wgpu::Buffer) -> Result<(), GpuError> {
        let points = (TILE_POINTS * TILE_POINTS * TILE_POINTS) as u32;
        let groups = points / 256;
        let values = self.context.storage("the billows", points as u64 * 8)?;
        let sums = self.context.storage("the billows' sums", groups as u64 * 16)?;
        self.submit(|pass| {
            for (kernel, groups) in self.noise.iter().zip([groups, 1, groups]) {
                kernel.record(pass, &self.context, &[&values, &sums, words], [groups, 1, 1]);
            }
        })
    }
}
