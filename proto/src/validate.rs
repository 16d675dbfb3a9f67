//! Reading a scene from a stranger's text, and judging whether it can be run.
//!
//! Stable error codes: `bad_json`, `bad_scene`, `unknown_version`, `out_of_range`, `not_rising`, `effect_needs`, `effect_conflict`,
//! `bad_time`, `bad_sounding`. All but `bad_json` name the JSON pointer of the one place that is to blame, where there is one.

use serde_json::Value;

use crate::camera::Camera;
use crate::error::ApiError;
use crate::scene::{
    BaseState, Effects, Methods, Moon, Phase, Pressure, Profile, ProfileLevel, SCENE_VERSION, Scene, Sun, SunOcclusion,
    ViewSteps,
};
use crate::wire::Command;

mod structure;

/// What a server allows beyond what a scene can mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// Most cells in a domain; 16 777 216 (256 cubed) unless told otherwise.
    pub max_cells: u64,
    /// Most bytes of a scene's text; 4 MiB unless told otherwise.
    pub max_scene_bytes: usize,
    /// Most rows in one profile; 10 000 unless told otherwise.
    pub max_profile_rows: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_cells: 256 * 256 * 256,
            max_scene_bytes: 4 << 20,
            max_profile_rows: 10_000,
        }
    }
}

/// The JSON Schema (2020-12) of [`Scene`], generated from the types.
pub fn schema() -> Value {
    schemars::schema_for!(Scene).to_value()
}

/// Reads and judges a scene.
///
/// Errors: `too_large`, `bad_json` (with line and column), `unknown_version`, `bad_scene` (a field is missing, unknown or of
/// the wrong type), and all those of [`validate`].
pub fn parse_scene(text: &str, limits: &Limits) -> Result<Scene, ApiError> {
    if text.len() > limits.max_scene_bytes {
        let message = format!(
            "the scene has {} bytes; at most {} are allowed",
            text.len(),
            limits.max_scene_bytes
        );
        return Err(ApiError::new("too_large", message));
    }
    let document: Value = serde_json::from_str(text).map_err(|error| {
        let message = format!("not JSON at line {}, column {}: {error}", error.line(), error.column());
        ApiError::new("bad_json", message)
    })?;
    // A scene of another version is built otherwise: say so rather than complain of its fields.
    if let Some(version) = document.get("version").and_then(Value::as_u64)
        && version != u64::from(SCENE_VERSION)
    {
        return Err(unknown_version(version));
    }
    structure::check(&document, &schema(), "bad_scene")?;
    let scene: Scene =
        serde_json::from_str(text).map_err(|error| ApiError::new("bad_scene", format!("not a scene: {error}")))?;
    validate(&scene, limits)?;
    Ok(scene)
}

fn unknown_version(version: u64) -> ApiError {
    ApiError::new(
        "unknown_version",
        format!("scene version {version} is unknown; this build reads version {SCENE_VERSION}"),
    )
    .at("/version")
}

/// Judges a scene: every number against its range, every profile's order, every effect's needs.
///
/// Errors: the first thing found, with its JSON pointer: `unknown_version`, `out_of_range`, `not_rising`, `effect_needs`,
/// `effect_conflict`, `bad_time`, `bad_sounding`.
pub fn validate(scene: &Scene, limits: &Limits) -> Result<(), ApiError> {
    if scene.version != SCENE_VERSION {
        return Err(unknown_version(u64::from(scene.version)));
    }
    text_length("/name", &scene.name, 1, 100)?;
    text_length("/description", &scene.description, 0, 2000)?;
    let lid_m = domain(scene, limits)?;
    range("/domain/latitude_deg", scene.domain.latitude_deg, -90.0, 90.0)?;
    range("/domain/longitude_deg", scene.domain.longitude_deg, -180.0, 180.0)?;
    range(
        "/domain/surface_altitude_m",
        scene.domain.surface_altitude_m,
        -500.0,
        9000.0,
    )?;
    crate::time::parse_utc(&scene.time.start_utc).map_err(|error| error.at("/time/start_utc"))?;
    range("/time/tick_s", scene.time.tick_s, 0.01, 600.0)?;
    range("/time/time_scale", scene.time.time_scale, 0.01, 1000.0)?;
    range("/time/spin_up_s", scene.time.spin_up_s, 0.0, 1e6)?;
    base_state(&scene.base_state, limits)?;
    effects(&scene.effects, lid_m, limits)?;
    methods(&scene.methods, &scene.effects)?;
    sun(&scene.sun, "/sun")?;
    camera(&scene.camera, "/camera")
}

/// Judges a camera found at `pointer` of a document. Errors: `out_of_range`.
pub fn camera(camera: &Camera, pointer: &str) -> Result<(), ApiError> {
    for (axis, value) in camera.position_m.into_iter().enumerate() {
        range(&format!("{pointer}/position_m/{axis}"), value, -1e6, 1e6)?;
    }
    range(&format!("{pointer}/azimuth_deg"), camera.azimuth_deg, -720.0, 720.0)?;
    range(&format!("{pointer}/elevation_deg"), camera.elevation_deg, -90.0, 90.0)?;
    range(
        &format!("{pointer}/vertical_fov_deg"),
        camera.vertical_fov_deg,
        1.0,
        150.0,
    )?;
    range(&format!("{pointer}/exposure_ev"), camera.exposure_ev, -20.0, 20.0)
}

/// Judges a sun found at `pointer` of a document. Errors: `out_of_range`.
pub fn sun(sun: &Sun, pointer: &str) -> Result<(), ApiError> {
    match sun {
        Sun::Clock => Ok(()),
        Sun::Fixed {
            elevation_deg,
            azimuth_deg,
        } => {
            range(&format!("{pointer}/elevation_deg"), *elevation_deg, -90.0, 90.0)?;
            range(&format!("{pointer}/azimuth_deg"), *azimuth_deg, -720.0, 720.0)
        }
    }
}

/// Judges a command by itself. Errors: `out_of_range`, with a pointer into the command's own document. Effects depend on the world's scene: those are
/// judged there.
pub fn command(command: &Command) -> Result<(), ApiError> {
    match command {
        Command::Pause {} | Command::Resume {} | Command::Effects { .. } => Ok(()),
        Command::TimeScale { time_scale } => range("/time_scale", *time_scale, 0.01, 1000.0),
        Command::Sun { sun: source } => sun(source, "/sun"),
        Command::Wind { add_x_m_s, add_y_m_s } => {
            range("/add_x_m_s", *add_x_m_s, -100.0, 100.0)?;
            range("/add_y_m_s", *add_y_m_s, -100.0, 100.0)
        }
    }
}

/// Holds where `least <= value <= most`; nothing else does, not a number least of all.
fn range(pointer: &str, value: f64, least: f64, most: f64) -> Result<(), ApiError> {
    if value >= least && value <= most {
        return Ok(());
    }
    let message = format!("{value} is out of range; allowed is {least} to {most}");
    Err(ApiError::new("out_of_range", message).at(pointer))
}

fn text_length(pointer: &str, text: &str, least: usize, most: usize) -> Result<(), ApiError> {
    let length = text.chars().count();
    if (least..=most).contains(&length) {
        return Ok(());
    }
    let message = format!("{length} characters are out of range; allowed is {least} to {most}");
    Err(ApiError::new("out_of_range", message).at(pointer))
}

/// The lid's height, m.
fn domain(scene: &Scene, limits: &Limits) -> Result<f64, ApiError> {
    let domain = &scene.domain;
    for (axis, count) in domain.cells.into_iter().enumerate() {
        // One cell across makes a scene two-dimensional; upwards there is no cloud without two levels, because buoyancy and
        // the pressure's vertical gradient act on the face between two of them.
        let (least, why) = if axis == 2 {
            (2, " (air needs two levels at least to rise)")
        } else {
            (1, "")
        };
        if count < least || count > 1024 {
            let message = format!("{count} is out of range; allowed is {least} to 1024 cells{why}");
            return Err(ApiError::new("out_of_range", message).at(format!("/domain/cells/{axis}")));
        }
    }
    let cells: u64 = domain.cells.iter().map(|&count| u64::from(count)).product();
    if cells > limits.max_cells {
        let message = format!(
            "{cells} cells are out of range; allowed is 2 to {} in all",
            limits.max_cells
        );
        return Err(ApiError::new("out_of_range", message).at("/domain/cells"));
    }
    for (axis, size_m) in domain.cell_size_m.into_iter().enumerate() {
        range(&format!("/domain/cell_size_m/{axis}"), size_m, 0.1, 1e5)?;
    }
    let lid_m = f64::from(domain.cells[2]) * domain.cell_size_m[2];
    if lid_m > 50_000.0 {
        let message = format!("a lid at {lid_m} m is out of range; allowed is 0.2 to 50000 m (cells times cell size)");
        return Err(ApiError::new("out_of_range", message).at("/domain/cell_size_m/2"));
    }
    Ok(lid_m)
}

fn rows(pointer: &str, count: usize, least: usize, limits: &Limits) -> Result<(), ApiError> {
    if (least..=limits.max_profile_rows).contains(&count) {
        return Ok(());
    }
    let message = format!(
        "{count} rows are out of range; allowed is {least} to {}",
        limits.max_profile_rows
    );
    Err(ApiError::new("out_of_range", message).at(pointer))
}

fn rising(pointer: String, below_m: Option<f64>, height_m: f64) -> Result<(), ApiError> {
    match below_m {
        Some(below_m) if height_m <= below_m => {
            let message = format!("height {height_m} m must be above {below_m} m, the row before");
            Err(ApiError::new("not_rising", message).at(pointer))
        }
        _ => Ok(()),
    }
}

/// A profile of values from `-most` to `most`.
fn profile(pointer: &str, profile: &Profile, least: usize, most: f64, limits: &Limits) -> Result<(), ApiError> {
    rows(pointer, profile.len(), least, limits)?;
    let mut below_m = None;
    for (i, &[height_m, value]) in profile.iter().enumerate() {
        range(&format!("{pointer}/{i}/0"), height_m, 0.0, 1e5)?;
        rising(format!("{pointer}/{i}/0"), below_m, height_m)?;
        range(&format!("{pointer}/{i}/1"), value, -most, most)?;
        below_m = Some(height_m);
    }
    Ok(())
}

const WIND_MAX_M_S: f64 = 150.0;

fn base_state(base: &BaseState, limits: &Limits) -> Result<(), ApiError> {
    let pressure = |value: f64| range("/base_state/surface_pressure_pa", value, 3e4, 1.1e5);
    let wind = |x: f64, y: f64| {
        range("/base_state/wind_x_m_s", x, -WIND_MAX_M_S, WIND_MAX_M_S)?;
        range("/base_state/wind_y_m_s", y, -WIND_MAX_M_S, WIND_MAX_M_S)
    };
    match base {
        BaseState::Profile {
            surface_pressure_pa,
            levels,
        } => {
            pressure(*surface_pressure_pa)?;
            profile_levels(levels, limits)
        }
        BaseState::Sounding { text } => crate::sounding::parse(text)
            .map(|_| ())
            .map_err(|error| error.at("/base_state/text")),
        BaseState::Isentropic {
            surface_pressure_pa,
            potential_temperature_k,
            wind_x_m_s,
            wind_y_m_s,
        } => {
            pressure(*surface_pressure_pa)?;
            range(
                "/base_state/potential_temperature_k",
                *potential_temperature_k,
                200.0,
                400.0,
            )?;
            wind(*wind_x_m_s, *wind_y_m_s)
        }
        BaseState::ConstantStability {
            surface_pressure_pa,
            surface_potential_temperature_k,
            buoyancy_frequency_per_s,
            relative_humidity,
            wind_x_m_s,
            wind_y_m_s,
        } => {
            pressure(*surface_pressure_pa)?;
            let pointer = "/base_state/surface_potential_temperature_k";
            range(pointer, *surface_potential_temperature_k, 200.0, 400.0)?;
            range(
                "/base_state/buoyancy_frequency_per_s",
                *buoyancy_frequency_per_s,
                0.0,
                0.05,
            )?;
            range("/base_state/relative_humidity", *relative_humidity, 0.0, 1.0)?;
            wind(*wind_x_m_s, *wind_y_m_s)
        }
        BaseState::WeismanKlemp {
            surface_pressure_pa,
            mixing_ratio_cap_kg_per_kg,
            wind_shear_m_s,
        } => {
            pressure(*surface_pressure_pa)?;
            range(
                "/base_state/mixing_ratio_cap_kg_per_kg",
                *mixing_ratio_cap_kg_per_kg,
                0.0,
                0.05,
            )?;
            range(
                "/base_state/wind_shear_m_s",
                *wind_shear_m_s,
                -WIND_MAX_M_S,
                WIND_MAX_M_S,
            )
        }
        BaseState::SaturatedNeutral {
            surface_pressure_pa,
            surface_equivalent_potential_temperature_k,
            total_water_mixing_ratio_kg_per_kg,
            wind_x_m_s,
            wind_y_m_s,
        } => {
            pressure(*surface_pressure_pa)?;
            let pointer = "/base_state/surface_equivalent_potential_temperature_k";
            range(pointer, *surface_equivalent_potential_temperature_k, 230.0, 450.0)?;
            let pointer = "/base_state/total_water_mixing_ratio_kg_per_kg";
            range(pointer, *total_water_mixing_ratio_kg_per_kg, 0.0, 0.05)?;
            wind(*wind_x_m_s, *wind_y_m_s)
        }
    }
}

fn profile_levels(levels: &[ProfileLevel], limits: &Limits) -> Result<(), ApiError> {
    rows("/base_state/levels", levels.len(), 2, limits)?;
    let mut below_m = None;
    for (i, level) in levels.iter().enumerate() {
        let at = |field: &str| format!("/base_state/levels/{i}/{field}");
        range(&at("height_m"), level.height_m, 0.0, 1e5)?;
        rising(at("height_m"), below_m, level.height_m)?;
        let field = "liquid_water_potential_temperature_k";
        range(&at(field), level.liquid_water_potential_temperature_k, 150.0, 2000.0)?;
        range(&at("total_water_kg_per_kg"), level.total_water_kg_per_kg, 0.0, 0.05)?;
        range(&at("wind_x_m_s"), level.wind_x_m_s, -WIND_MAX_M_S, WIND_MAX_M_S)?;
        range(&at("wind_y_m_s"), level.wind_y_m_s, -WIND_MAX_M_S, WIND_MAX_M_S)?;
        below_m = Some(level.height_m);
    }
    Ok(())
}

/// Whether a method is there and allows the scene's Courant number, the server's catalogue knows.
fn methods(methods: &Methods, effects: &Effects) -> Result<(), ApiError> {
    let flow = effects.flow.is_some();
    let moisture = effects.moisture.is_some();
    needs(
        "/methods/scattering",
        methods.scattering.is_some(),
        effects.multiple_scattering.is_some(),
        "multiple_scattering",
    )?;
    needs(
        "/methods/sun_occlusion",
        methods.sun_occlusion.is_some(),
        moisture,
        "moisture",
    )?;
    needs("/methods/phase", methods.phase.is_some(), moisture, "moisture")?;
    needs(
        "/methods/view_steps",
        methods.view_steps.is_some(),
        moisture,
        "moisture",
    )?;
    match methods.view_steps {
        None | Some(ViewSteps::ByDistance {}) => {}
        Some(ViewSteps::ByOpticalDepth { optical_depth }) => {
            range("/methods/view_steps/optical_depth", optical_depth, 0.02, 4.0)?;
        }
        Some(ViewSteps::LogarithmicSegments { segments }) => {
            range("/methods/view_steps/segments", f64::from(segments), 2.0, 512.0)?;
        }
    }
    needs(
        "/methods/view_sampling",
        methods.view_sampling.is_some(),
        moisture,
        "moisture",
    )?;
    match methods.sun_occlusion {
        None | Some(SunOcclusion::LightGrid {}) => {}
        Some(SunOcclusion::SecondaryMarch { steps }) => {
            range("/methods/sun_occlusion/steps", f64::from(steps), 1.0, 512.0)?;
        }
        Some(
            SunOcclusion::ExponentialShadowMap { side }
            | SunOcclusion::BeerShadowMap { side }
            | SunOcclusion::FourierOpacityMap { side },
        ) => range("/methods/sun_occlusion/side", f64::from(side), 16.0, 4096.0)?,
    }
    let asymmetry = |field: &str, value: f64| range(&format!("/methods/phase/{field}"), value, -0.999, 0.999);
    match methods.phase {
        None | Some(Phase::Rayleigh {}) => {}
        Some(Phase::HenyeyGreenstein { asymmetry: value }) => asymmetry("asymmetry", value)?,
        Some(Phase::DoubleHenyeyGreenstein {
            forward_asymmetry,
            backward_asymmetry,
            forward_share,
        }) => {
            asymmetry("forward_asymmetry", forward_asymmetry)?;
            asymmetry("backward_asymmetry", backward_asymmetry)?;
            range("/methods/phase/forward_share", forward_share, 0.0, 1.0)?;
        }
        Some(Phase::Droplets { diameter_um }) => range("/methods/phase/diameter_um", diameter_um, 5.0, 50.0)?,
        Some(Phase::Mie { effective_radius_um }) => {
            range("/methods/phase/effective_radius_um", effective_radius_um, 1.0, 50.0)?;
        }
        Some(Phase::Ice { aspect_ratio }) => range("/methods/phase/aspect_ratio", aspect_ratio, 0.05, 20.0)?,
    }
    needs("/methods/advection", methods.advection.is_some(), flow, "flow")?;
    needs("/methods/pressure", methods.pressure.is_some(), flow, "flow")?;
    let sweep_range = |sweeps: u32| range("/methods/pressure/sweeps", f64::from(sweeps), 1.0, 1e4);
    match methods.pressure {
        None | Some(Pressure::Direct {}) => Ok(()),
        Some(Pressure::Jacobi { sweeps }) => sweep_range(sweeps),
        Some(Pressure::RedBlackSor { sweeps, relaxation }) => {
            sweep_range(sweeps)?;
            range("/methods/pressure/relaxation", relaxation, 0.1, 1.99)
        }
        Some(Pressure::Multigrid { cycles }) => range("/methods/pressure/cycles", f64::from(cycles), 1.0, 100.0),
    }
}

/// A number that does something only with another effect is refused without it: a knob that nothing reads misleads.
fn needs(pointer: &str, wanted: bool, there: bool, need: &str) -> Result<(), ApiError> {
    if !wanted || there {
        return Ok(());
    }
    let message = format!("this needs the effect `{need}`, which the scene does not name");
    Err(ApiError::new("effect_needs", message).at(pointer))
}

fn effect_needs(effects: &Effects) -> Result<(), ApiError> {
    let flow = effects.flow.is_some();
    let heat = effects.heat.is_some();
    let moisture = effects.moisture.is_some();
    needs("/effects/heat", heat, flow, "flow")?;
    needs("/effects/moisture", moisture, heat, "heat")?;
    needs("/effects/turbulence", effects.turbulence.is_some(), flow, "flow")?;
    let constant = effects.constant_viscosity.as_ref();
    needs("/effects/constant_viscosity", constant.is_some(), flow, "flow")?;
    if let Some(constant) = constant {
        if effects.turbulence.is_some() {
            let message = "this excludes the effect `turbulence`, which the scene names too: only one can mix";
            return Err(ApiError::new("effect_conflict", message).at("/effects/constant_viscosity"));
        }
        let wanted = constant.diffusivity_m2_s != 0.0;
        needs("/effects/constant_viscosity/diffusivity_m2_s", wanted, heat, "heat")?;
    }
    needs("/effects/body_force", effects.body_force.is_some(), flow, "flow")?;
    needs("/effects/surface", effects.surface.is_some(), flow, "flow")?;
    needs("/effects/coriolis", effects.coriolis.is_some(), flow, "flow")?;
    needs("/effects/large_scale", effects.large_scale.is_some(), heat, "heat")?;
    needs("/effects/sponge", effects.sponge.is_some(), flow, "flow")?;
    needs("/effects/noise", effects.noise.is_some(), heat, "heat")?;
    needs("/effects/bubble", effects.bubble.is_some(), heat, "heat")?;
    needs(
        "/effects/cloud_detail",
        effects.cloud_detail.is_some(),
        moisture,
        "moisture",
    )?;
    needs(
        "/effects/multiple_scattering",
        effects.multiple_scattering.is_some(),
        moisture,
        "moisture",
    )?;
    needs(
        "/effects/cloud_shadow",
        effects.cloud_shadow.is_some(),
        moisture,
        "moisture",
    )?;
    needs(
        "/effects/light_shafts",
        effects.light_shafts.is_some(),
        moisture,
        "moisture",
    )?;
    needs(
        "/effects/light_shafts",
        effects.light_shafts.is_some(),
        effects.aerial_perspective.is_some(),
        "aerial_perspective",
    )?;
    if let Some(surface) = &effects.surface {
        needs(
            "/effects/surface/heat_flux_k_m_s",
            surface.heat_flux_k_m_s != 0.0,
            heat,
            "heat",
        )?;
        needs(
            "/effects/surface/moisture_flux_m_s",
            surface.moisture_flux_m_s != 0.0,
            moisture,
            "moisture",
        )?;
    }
    if let Some(large_scale) = &effects.large_scale {
        let wanted = !large_scale.moistening_per_s.is_empty();
        needs("/effects/large_scale/moistening_per_s", wanted, moisture, "moisture")?;
    }
    if let Some(noise) = &effects.noise {
        let wanted = noise.total_water_kg_per_kg != 0.0;
        needs("/effects/noise/total_water_kg_per_kg", wanted, moisture, "moisture")?;
    }
    if let Some(bubble) = &effects.bubble {
        let wanted = bubble.total_water_kg_per_kg != 0.0;
        needs("/effects/bubble/total_water_kg_per_kg", wanted, moisture, "moisture")?;
    }
    Ok(())
}

fn effects(effects: &Effects, lid_m: f64, limits: &Limits) -> Result<(), ApiError> {
    effect_needs(effects)?;
    if let Some(flow) = &effects.flow {
        range("/effects/flow/courant_max", flow.courant_max, 0.05, 50.0)?;
    }
    if let Some(moisture) = &effects.moisture {
        range(
            "/effects/moisture/droplet_number_per_m3",
            moisture.droplet_number_per_m3,
            1e6,
            1e10,
        )?;
    }
    if let Some(turbulence) = &effects.turbulence {
        range(
            "/effects/turbulence/smagorinsky_coefficient",
            turbulence.smagorinsky_coefficient,
            0.0,
            0.5,
        )?;
        range(
            "/effects/turbulence/turbulent_prandtl_number",
            turbulence.turbulent_prandtl_number,
            0.1,
            10.0,
        )?;
    }
    if let Some(constant) = &effects.constant_viscosity {
        let at = |field: &str| format!("/effects/constant_viscosity/{field}");
        range(&at("viscosity_m2_s"), constant.viscosity_m2_s, 0.0, 1e5)?;
        range(&at("diffusivity_m2_s"), constant.diffusivity_m2_s, 0.0, 1e5)?;
    }
    if let Some(force) = &effects.body_force {
        let at = |field: &str, axis: usize| format!("/effects/body_force/{field}/{axis}");
        for axis in 0..3 {
            range(&at("lower_m", axis), force.lower_m[axis], -1e6, 1e6)?;
            range(&at("upper_m", axis), force.upper_m[axis], -1e6, 1e6)?;
            range(
                &at("acceleration_m_s2", axis),
                force.acceleration_m_s2[axis],
                -10.0,
                10.0,
            )?;
            if force.upper_m[axis] <= force.lower_m[axis] {
                let message = format!(
                    "the upper corner's {} m must be above the lower one's {} m",
                    force.upper_m[axis], force.lower_m[axis]
                );
                return Err(ApiError::new("not_rising", message).at(at("upper_m", axis)));
            }
        }
        range("/effects/body_force/drag_per_s", force.drag_per_s, 0.0, 10.0)?;
    }
    if let Some(surface) = &effects.surface {
        range("/effects/surface/heat_flux_k_m_s", surface.heat_flux_k_m_s, -1.0, 1.0)?;
        range(
            "/effects/surface/moisture_flux_m_s",
            surface.moisture_flux_m_s,
            -1e-3,
            1e-3,
        )?;
        range(
            "/effects/surface/friction_velocity_m_s",
            surface.friction_velocity_m_s,
            0.0,
            3.0,
        )?;
    }
    if let Some(coriolis) = &effects.coriolis {
        if let Some(parameter_per_s) = coriolis.parameter_per_s {
            range("/effects/coriolis/parameter_per_s", parameter_per_s, -1e-3, 1e-3)?;
        }
        if let Some(wind) = &coriolis.geostrophic_wind_x_m_s {
            profile(
                "/effects/coriolis/geostrophic_wind_x_m_s",
                wind,
                1,
                WIND_MAX_M_S,
                limits,
            )?;
        }
        if let Some(wind) = &coriolis.geostrophic_wind_y_m_s {
            profile(
                "/effects/coriolis/geostrophic_wind_y_m_s",
                wind,
                1,
                WIND_MAX_M_S,
                limits,
            )?;
        }
    }
    if let Some(large) = &effects.large_scale {
        profile(
            "/effects/large_scale/vertical_wind_m_s",
            &large.vertical_wind_m_s,
            0,
            1.0,
            limits,
        )?;
        profile(
            "/effects/large_scale/heating_k_per_s",
            &large.heating_k_per_s,
            0,
            0.01,
            limits,
        )?;
        profile(
            "/effects/large_scale/moistening_per_s",
            &large.moistening_per_s,
            0,
            1e-5,
            limits,
        )?;
    }
    if let Some(sponge) = &effects.sponge {
        range("/effects/sponge/depth_m", sponge.depth_m, 0.1, lid_m)?;
        range("/effects/sponge/rate_per_s", sponge.rate_per_s, 0.0, 1.0)?;
    }
    if let Some(noise) = &effects.noise {
        range("/effects/noise/depth_m", noise.depth_m, 0.0, 1e5)?;
        range(
            "/effects/noise/potential_temperature_k",
            noise.potential_temperature_k,
            0.0,
            10.0,
        )?;
        range(
            "/effects/noise/total_water_kg_per_kg",
            noise.total_water_kg_per_kg,
            0.0,
            0.01,
        )?;
    }
    if let Some(bubble) = &effects.bubble {
        for axis in 0..3 {
            range(
                &format!("/effects/bubble/centre_m/{axis}"),
                bubble.centre_m[axis],
                -1e6,
                1e6,
            )?;
            range(
                &format!("/effects/bubble/radius_m/{axis}"),
                bubble.radius_m[axis],
                0.1,
                1e6,
            )?;
        }
        range(
            "/effects/bubble/potential_temperature_k",
            bubble.potential_temperature_k,
            -50.0,
            50.0,
        )?;
        range("/effects/bubble/temperature_k", bubble.temperature_k, -50.0, 50.0)?;
        let pointer = "/effects/bubble/virtual_potential_temperature_share";
        range(pointer, bubble.virtual_potential_temperature_share, -0.2, 0.2)?;
        range(
            "/effects/bubble/total_water_kg_per_kg",
            bubble.total_water_kg_per_kg,
            -0.05,
            0.05,
        )?;
    }
    if let Some(detail) = &effects.cloud_detail {
        range("/effects/cloud_detail/strength", detail.strength, 0.0, 1.0)?;
        range("/effects/cloud_detail/scale_m", detail.scale_m, 1.0, 1e5)?;
    }
    if let Some(octaves) = effects.multiple_scattering.as_ref().and_then(|m| m.octaves) {
        range("/effects/multiple_scattering/octaves", f64::from(octaves), 1.0, 8.0)?;
    }
    if let Some(shafts) = &effects.light_shafts {
        range("/effects/light_shafts/samples", f64::from(shafts.samples), 4.0, 128.0)?;
    }
    if let Some(aerial) = &effects.aerial_perspective {
        range(
            "/effects/aerial_perspective/visibility_m",
            aerial.visibility_m,
            50.0,
            1e6,
        )?;
    }
    if let Some(Moon::Fixed {
        elevation_deg,
        azimuth_deg,
    }) = effects.moon
    {
        range("/effects/moon/elevation_deg", elevation_deg, -90.0, 90.0)?;
        range("/effects/moon/azimuth_deg", azimuth_deg, -720.0, 720.0)?;
    }
    if let Some(stars) = &effects.stars {
        range("/effects/stars/faintest_magnitude", stars.faintest_magnitude, -2.0, 6.0)?;
    }
    Ok(())
}
