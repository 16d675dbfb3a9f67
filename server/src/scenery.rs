//! What a client needs to draw a world's pictures itself: the kernels, and what a world tells them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use welkin_proto::view::{
    BindingKind, Scenery, SceneryStars, ShaderBinding, ShaderKernel, ShaderMember, ShaderModule, ShaderStruct,
    UniformValue, ViewShaders,
};
use welkin_proto::{ApiError, Camera};
use welkin_shaders::cpu::light::analytic_sky::SkyMethod;
use welkin_shaders::cpu::light::march_phase::MarchPhase;
use welkin_shaders::cpu::light::stars::StarTable;
use welkin_shaders::gpu::Bind;
use welkin_shaders::gpu::view_kernels::{LIGHT_KERNELS, VIEW_KERNELS, VIEW_STRUCTS, reflect, view_constants};
use welkin_shaders::gpu::view_octave_balance::OctaveBalancing;
use welkin_shaders::gpu::view_stages::{Air, MARCH_PHASE, SkyLightAsk, SkyView, SunMarch, ViewFrame};
use welkin_shaders::view::{Look, PhaseKey};
use welkin_shaders::wgsl::{self, Layout, Literal};

use crate::world::Snapshot;
use crate::{moon, picture};

/// Members of uniforms that depend on neither camera, sun nor cloud.
const SCENERY: &[(&str, &[&str])] = &[
    ("Air", &["surface_altitude_m", "aerosol_per_m"]),
    ("SkyView", &["scattered_glow", "layer_glow"]),
    ("SkyLightAsk", &["ground_albedo", "scattered_glow", "layer_glow"]),
    ("SunMarch", &["carved", "margin_m"]),
    (
        "ViewFrame",
        &[
            "ground_albedo",
            "ground_tint",
            "detail_offset_m",
            "detail_push",
            "detail_blend",
            "detail_tiles_per_m",
            "octaves",
            "shadow",
            "sea",
            "haze_on_cloud",
            "night",
            "secondary_steps",
            "shaft_samples",
            "step_depth",
            "segments",
            "depth_scale",
            "map_side",
            "map_numbers",
            "similarity",
        ],
    ),
    ("MarchPhase", &["quads"]),
    ("OctaveBalancing", &["rings", "carved", "octaves"]),
];

/// The kernels of the view, generated from what the GPU device runs. Errors: `internal` where a module's text is not what it should be.
pub fn view_shaders() -> Result<ViewShaders, ApiError> {
    let broken = |what: &str| ApiError::new("internal", format!("the kernels' {what} cannot be read"));
    let mut modules = BTreeMap::new();
    let mut kernels = BTreeMap::new();
    let now = VIEW_KERNELS.iter().map(|k| (k, false));
    for (kernel, late) in now.chain(LIGHT_KERNELS.iter().map(|k| (k, true))) {
        let text = wgsl::source(kernel.module).ok_or_else(|| broken("text"))?;
        let said = reflect(&text).ok_or_else(|| broken("bindings"))?;
        let (_, workgroup_size) = said
            .entries
            .iter()
            .find(|(name, _)| name == kernel.entry)
            .ok_or_else(|| broken("entries"))?;
        let found = ShaderKernel {
            module: kernel.module.to_owned(),
            entry: kernel.entry.to_owned(),
            workgroup_size: *workgroup_size,
            late,
        };
        kernels.insert(kernel.name.to_owned(), found);
        let bindings = said.bindings.into_iter().map(|b| ShaderBinding {
            name: b.name,
            binding: b.binding,
            kind: match b.bind {
                Bind::Uniform => BindingKind::Uniform,
                Bind::Read => BindingKind::Read,
                Bind::Write => BindingKind::Write,
            },
            uniform: b.uniform,
        });
        let bindings = bindings.collect();
        modules.insert(kernel.module.to_owned(), ShaderModule { wgsl: text, bindings });
    }
    let constants = view_constants().into_iter().map(|c| {
        let value = match c.value {
            Literal::F32(v) => v.into(),
            Literal::U32(v) => v.into(),
            Literal::I32(v) => v.into(),
        };
        (c.name.to_owned(), value)
    });
    Ok(ViewShaders {
        modules,
        kernels,
        structs: VIEW_STRUCTS.iter().map(|s| (s.name.to_owned(), layout(s))).collect(),
        constants: constants.collect(),
    })
}

fn layout(layout: &Layout) -> ShaderStruct {
    let members = layout.members.iter().map(|m| ShaderMember {
        name: m.name.to_owned(),
        kind: m.kind.to_owned(),
        offset_bytes: m.offset as u32,
        size_bytes: m.size as u32,
    });
    ShaderStruct {
        size_bytes: layout.size as u32,
        members: members.collect(),
    }
}

/// The phase function that was told last: pages ask again and again, and Mie's takes a while.
static PHASE: Mutex<Option<(PhaseKey, Arc<MarchPhase>)>> = Mutex::new(None);

fn phase_of(key: PhaseKey) -> Arc<MarchPhase> {
    let mut kept = PHASE.lock().unwrap_or_else(PoisonError::into_inner);
    match kept.as_ref().filter(|(k, _)| *k == key) {
        Some((_, phase)) => phase.clone(),
        None => {
            let phase = Arc::new(MarchPhase::new(key.0, key.1, key.2));
            *kept = Some((key, phase.clone()));
            phase
        }
    }
}

/// What a world tells the kernels that is neither its cloud, nor the camera's, nor the sun's. Errors: `method_needs_cpu` where the scene chose a
/// method that no kernel of a page's has.
pub fn scenery(snapshot: &Snapshot) -> Result<Scenery, ApiError> {
    // Any camera does: what depends on it is left out.
    let camera = Camera {
        position_m: [0.0, 0.0, 100.0],
        azimuth_deg: 0.0,
        elevation_deg: 0.0,
        vertical_fov_deg: 60.0,
        exposure_ev: 0.0,
    };
    let settings = picture::settings(snapshot, &snapshot.scene, &camera, [1, 1]);
    let look = Look::new(&settings, [0.0; 3]);
    if look.lighting.needs_cpu() {
        let message =
            "the scene lights its clouds by a method that only the server's processor has; ask for its frames";
        return Err(ApiError::new("method_needs_cpu", message));
    }
    let phase = phase_of(look.phase_key());
    let air = Air::new(&look.air);
    let mut frame = ViewFrame::new(&look, &settings, true, 1, phase.depth_scale);
    frame.tell_light(&look, phase.asymmetry);
    let sun = look.sources().sun;
    let view = SkyView::new(&sun, look.position_m[2]);
    let ask = SkyLightAsk::new(&sun, look.ground, [0.0; 2]);
    let march = SunMarch::new(&look);
    let balance = OctaveBalancing::new(look.table_beam, look.detail.is_some(), phase.asymmetry, look.octaves);
    let of = |name: &str| match name {
        "Air" => (&Air::LAYOUT, air.bytes()),
        "SkyView" => (&SkyView::LAYOUT, view.bytes()),
        "SkyLightAsk" => (&SkyLightAsk::LAYOUT, ask.bytes()),
        "SunMarch" => (&SunMarch::LAYOUT, march.bytes()),
        "OctaveBalancing" => (&OctaveBalancing::LAYOUT, balance.bytes()),
        "MarchPhase" => (&MARCH_PHASE, phase.bytes()),
        _ => (&ViewFrame::LAYOUT, frame.bytes()),
    };
    let uniforms = SCENERY.iter().map(|(name, wanted)| {
        let (layout, bytes) = of(name);
        let members = layout.members.iter().filter(|m| wanted.contains(&m.name));
        let values = members.map(|m| (m.name.to_owned(), value(&m.numbers(bytes))));
        (name.to_string(), values.collect())
    });
    let scene = &snapshot.scene;
    Ok(Scenery {
        uniforms: uniforms.collect(),
        server_draws: (look.sky != SkyMethod::ScatteringTables).then(|| {
            let rung = "its sky is a formula's, which the server computes (methods.sky)";
            rung.to_owned()
        }),
        stars: scene.effects.stars.as_ref().map(|stars| SceneryStars {
            latitude_deg: scene.domain.latitude_deg,
            faintest_magnitude: stars.faintest_magnitude,
            years_since_2000: moon::years_since_2000(scene).into(),
        }),
    })
}

/// The words of the table of stars over a world, little endian; none where it has no stars.
pub fn star_words(snapshot: &Snapshot) -> Option<Vec<u8>> {
    let scene = &snapshot.scene;
    let stars = scene.effects.stars.as_ref()?;
    let table = StarTable::new(stars.faintest_magnitude as f32, moon::years_since_2000(scene));
    Some(table.words().iter().flat_map(|w| w.to_le_bytes()).collect())
}

fn value(numbers: &[f64]) -> UniformValue {
    match numbers {
        [number] => UniformValue::Number(*number),
        more => UniformValue::Vector(more.to_vec()),
    }
}
