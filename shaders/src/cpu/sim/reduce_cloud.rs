//! Stage `reduce_cloud`: a tick's few numbers on the cloud.
//!
//! Reads `CloudWater`, `Water` (kg/kg) and `Extinction` (1/m) at centres and the horizontal velocities; gives cover, base, top, paths and the mean
//! wind of the cloudy air. Sums are made a level in f64 and joined in level order: bit-identical for any number of threads.

use rayon::prelude::*;

use super::parameters::Parameters;
use crate::device::CloudReductions;

crate::constants! {
    /// Cloud water that counts as cloud, kg/kg.
    pub const CLOUDY_KG_PER_KG: f32 = 1e-6;
}

/// One level's sums over its cells.
#[derive(Clone, Copy, Debug, Default)]
pub struct Level {
    /// Whether any cell counts as cloud.
    pub cloudy: bool,
    /// Whether any cell has extinction.
    pub lit: bool,
    /// Cloud water, kg/kg.
    pub liquid: f64,
    /// Total water, kg/kg.
    pub water: f64,
    /// Cloud water times the wind east and north, kg/kg m/s.
    pub momentum: [f64; 2],
}

/// Rate at which the ground and the larger weather change the mean path of all water, kg/m2/s, by the sums of water a level. Both are linear in
/// the field, so that the sums tell what the stages `surface_flux` and `large_scale` will add; what those do is repeated here on means.
fn water_source_kg_m2_s(parameters: &Parameters, levels: &[Level]) -> f64 {
    let plane = parameters.grid.plane() as f64;
    let dz = parameters.grid.cell_size_m[2] as f64;
    let ground = parameters.surface.as_ref().map_or(0.0, |s| {
        s.moisture_flux_m_s as f64 * parameters.density_at_z_face_kg_m3[0] as f64
    });
    let weather = parameters.large_scale.as_ref().map_or(0.0, |weather| {
        (0..levels.len())
            .map(|z| {
                let w = weather.vertical_wind_m_s[z] as f64;
                let upper = if w < 0.0 {
                    (z + 1).min(levels.len() - 1)
                } else {
                    z.max(1)
                };
                let gradient = (levels[upper].water - levels[upper - 1].water) / plane / dz;
                let rate_per_s = weather.moistening_per_s[z] as f64 - w * gradient;
                parameters.density_kg_m3[z] as f64 * dz * rate_per_s
            })
            .sum()
    });
    ground + weather
}

/// Reduces; `extinction` is what views will see, so levels that hold any of it are reported too. `levels` is scratch, one a level.
pub fn run(
    parameters: &Parameters,
    cloud: &[f32],
    water: &[f32],
    extinction: &[f32],
    wind: [&[f32]; 2],
    levels: &mut [Level],
) -> CloudReductions {
    let grid = &parameters.grid;
    let plane = grid.plane();
    levels.par_iter_mut().enumerate().for_each(|(z, out)| {
        let at = z * plane..(z + 1) * plane;
        let (cloud, u, v) = (&cloud[at.clone()], &wind[0][at.clone()], &wind[1][at.clone()]);
        let mut level = Level {
            water: water[at.clone()].iter().map(|&q| q as f64).sum(),
            ..Level::default()
        };
        for i in 0..plane {
            if cloud[i] > 0.0 {
                let liquid = cloud[i] as f64;
                level.cloudy |= cloud[i] > CLOUDY_KG_PER_KG;
                level.liquid += liquid;
                level.momentum[0] += liquid * u[i] as f64;
                level.momentum[1] += liquid * v[i] as f64;
            }
        }
        level.lit = level.liquid > 0.0 && extinction[at].iter().any(|&e| e > 0.0);
        *out = level;
    });
    let columns: usize = (0..grid.cells[1])
        .into_par_iter()
        .map(|y| {
            let nx = grid.cells[0];
            (0..nx)
                .filter(|x| (0..grid.cells[2]).any(|z| cloud[z * plane + y * nx + x] > CLOUDY_KG_PER_KG))
                .count()
        })
        .sum();
    join(parameters, levels, columns)
}

/// Joins the levels' sums, in order, and the number of columns with cloud.
pub fn join(parameters: &Parameters, levels: &[Level], columns: usize) -> CloudReductions {
    let plane = parameters.grid.plane();
    let dz = parameters.grid.cell_size_m[2] as f64;
    let mut total = CloudReductions {
        cover: columns as f64 / plane as f64,
        water_source_kg_m2_s: water_source_kg_m2_s(parameters, levels),
        ..CloudReductions::default()
    };
    let (mut mass, mut momentum) = (0.0, [0.0; 2]);
    for (z, level) in levels.iter().enumerate() {
        let weight = parameters.density_kg_m3[z] as f64 * dz / plane as f64;
        total.liquid_water_path_kg_m2 += level.liquid * weight;
        total.total_water_path_kg_m2 += level.water * weight;
        mass += level.liquid * weight;
        momentum[0] += level.momentum[0] * weight;
        momentum[1] += level.momentum[1] * weight;
        if level.cloudy {
            total.base_m.get_or_insert(z as f64 * dz);
            total.top_m = Some((z + 1) as f64 * dz);
        }
        if level.lit {
            if total.lit_levels[1] == 0 {
                total.lit_levels[0] = z;
            }
            total.lit_levels[1] = z + 1;
        }
    }
    total.wind_m_s = (mass > 0.0).then(|| momentum.map(|m| m / mass));
    total
}
