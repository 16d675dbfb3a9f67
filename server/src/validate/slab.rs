//! The path tracer against discrete ordinates: light reflected by plane-parallel slabs that absorb nothing, over black ground.

use serde_json::json;
use welkin_shaders::cpu::light::path_tracer::{Scatterer, slab};
use welkin_shaders::cpu::light::phase_table::PhaseChoice;

use super::{Aim, Context, Figure, Findings, ValidateError};

/// Optical depths of the rows of [`REFLECTED`].
pub(crate) const DEPTHS: [f64; 4] = [1.0, 4.0, 16.0, 64.0];
/// Asymmetry and cosine of the sun of its columns.
pub(crate) const COLUMNS: [[f64; 2]; 4] = [[0.0, 1.0], [0.0, 0.5], [0.85, 1.0], [0.85, 0.5]];
/// Reflected share of the flux, by 64 streams.
pub(crate) const REFLECTED: [[f64; 4]; 4] = [
    [0.34133, 0.49838, 0.04232, 0.16488],
    [0.69093, 0.78554, 0.19092, 0.41602],
    [0.90363, 0.93329, 0.55721, 0.69741],
    [0.97434, 0.98224, 0.84628, 0.89497],
];
/// Optical depth, asymmetry, cosine of the sun, radiance straight up for a beam of unit irradiance across it.
const NADIR: [[f64; 4]; 4] = [
    [1.0, 0.0, 1.0, 0.0857],
    [4.0, 0.0, 0.5, 0.1124],
    [4.0, 0.85, 0.5, 0.0373],
    [16.0, 0.85, 0.5, 0.0899],
];
/// Half a unit of the last digit of the figures.
const REFLECTED_DIGIT: f64 = 5e-6;
const NADIR_DIGIT: f64 = 5e-5;

/// Henyey and Greenstein's function for the tracer.
fn scatterer(asymmetry: f64) -> Scatterer {
    Scatterer::new(PhaseChoice::HenyeyGreenstein {
        asymmetry: asymmetry as f32,
    })
}

pub(super) fn run(context: &Context) -> Result<Findings, ValidateError> {
    let paths = if context.quick { 20_000 } else { 400_000 };
    let rows = (DEPTHS.len() * COLUMNS.len() + NADIR.len()) as f64;
    let (mut figures, mut data) = (Vec::new(), Vec::new());
    let mut put = |what: String, ours: slab::Estimate, published: f64, digit: f64| {
        if !(context.progress)(&what, figures.len() as f64, rows) {
            return Err(ValidateError::Interrupted);
        }
        data.push(json!({ "what": what, "mean": ours.mean, "standard_error": ours.error }));
        // Three standard errors: one row in 370 may miss by chance.
        let aim = Aim::Within {
            distance: 3.0 * ours.error + digit,
        };
        figures.push(Figure::beside(what, "1", ours.mean, published).aimed(aim));
        Ok(())
    };
    for (depth, row) in DEPTHS.iter().zip(REFLECTED) {
        for ([asymmetry, sun], published) in COLUMNS.iter().zip(row) {
            let ours = slab::reflectance(*depth, *sun, 1.0, &scatterer(*asymmetry), paths);
            let what = format!("reflected, optical depth {depth}, g {asymmetry}, mu0 {sun}");
            put(what, ours, published, REFLECTED_DIGIT)?;
        }
    }
    for [depth, asymmetry, sun, published] in NADIR {
        let ours = slab::nadir_radiance(depth, sun, &scatterer(asymmetry), paths);
        let what = format!("nadir radiance, optical depth {depth}, g {asymmetry}, mu0 {sun}");
        put(what, ours, published, NADIR_DIGIT)?;
    }
    Ok(Findings {
        figures,
        notes: vec![format!(
            "{paths} paths a figure; an aim is three standard errors and half a unit of the published last digit"
        )],
        data: json!(data),
        plots: Vec::new(),
    })
}
