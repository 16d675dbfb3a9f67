//! Stage `large_scale`: what weather larger than the box does to a field.
//!
//! Reads a field at levels (centres in z), adds to its held tendency: `-w_s d(field)/dz`, first-order upwind (the profile that is
//! carried is smooth, and upwind keeps it monotone), and a given source by height. Not in flux form: it brings air in from aloft, so
//! the box's sums change, as they do in nature. At the lid the gradient below continues; at the ground w_s is 0 in sane scenes and the
//! gradient above continues. Errors: none. Bytes a cell: 12.

use rayon::prelude::*;

use super::parameters::Parameters;

/// Runs the stage on one field with its source profile (empty for none); nothing if the parameters have no larger weather.
pub fn run(parameters: &Parameters, field: &[f32], source: &[f32], slow: &mut [f32]) {
    let Some(weather) = &parameters.large_scale else { return };
    let grid = &parameters.grid;
    let (plane, levels) = (grid.plane(), grid.cells[2]);
    let per_dz = 1.0 / grid.cell_size_m[2];
    slow.par_chunks_mut(plane).enumerate().for_each(|(z, slow)| {
        let w = weather.vertical_wind_m_s[z];
        let source = source.get(z).copied().unwrap_or(0.0);
        let upper = if w < 0.0 { (z + 1).min(levels - 1) } else { z.max(1) };
        let lower = upper - 1;
        let (a, b) = (
            &field[lower * plane..(lower + 1) * plane],
            &field[upper * plane..(upper + 1) * plane],
        );
        for i in 0..plane {
            slow[i] += source - w * (b[i] - a[i]) * per_dz;
        }
    });
}
