//! The state at simulated second 0: the base state, a bubble, noise.

use welkin_proto::Scene;
use welkin_shaders::Device;
use welkin_shaders::catalogue::Field;
use welkin_shaders::cpu::sim::Parameters;

use crate::base_state::{self, BaseState};

/// Writes the initial state into a device's planned fields.
pub fn write(scene: &Scene, base: &BaseState, parameters: &Parameters, device: &mut dyn Device) {
    let grid = parameters.grid;
    let plane = grid.plane();
    let by_level = |values: &dyn Fn(usize) -> f32| (0..grid.len()).map(|i| values(i / plane)).collect::<Vec<f32>>();
    device.write(Field::VelocityX, &by_level(&|z| parameters.base_wind_x_m_s[z]));
    device.write(Field::VelocityY, &by_level(&|z| parameters.base_wind_y_m_s[z]));
    device.write(Field::VelocityZ, &vec![0.0; grid.len()]);
    let mut heat = by_level(&|z| parameters.base_heat_k[z]);
    let mut water = by_level(&|z| base.total_water_kg_per_kg[z] as f32);
    let cell = |i: usize| [i % grid.cells[0], i / grid.cells[0] % grid.cells[1], i / plane];
    if let Some(bubble) = &scene.effects.bubble {
        let size = grid.size_m();
        for i in 0..grid.len() {
            let at = cell(i);
            let distance_squared: f64 = (0..3)
                .map(|a| {
                    let mut d = (at[a] as f64 + 0.5) * grid.cell_size_m[a] as f64 - bubble.centre_m[a];
                    // A bubble near the side reaches over it; a direction of one cell has no distance.
                    if a < 2 {
                        let n = size[a] as f64;
                        d -= n * (d / n).round();
                    }
                    if grid.cells[a] == 1 {
                        0.0
                    } else {
                        (d / bubble.radius_m[a]).powi(2)
                    }
                })
                .sum();
            if distance_squared < 1.0 {
                let shape = (0.5 * std::f64::consts::PI * distance_squared.sqrt()).cos().powi(2);
                let exner = base.exner[at[2]];
                water[i] += (bubble.total_water_kg_per_kg * shape) as f32;
                let warmer_k = (bubble.potential_temperature_k + bubble.temperature_k / exner) * shape;
                heat[i] += warmer_k as f32;
                let share = bubble.virtual_potential_temperature_share * shape;
                if share != 0.0 {
                    let reference_k = f64::from(parameters.heat_reference_k);
                    let total = f64::from(water[i].max(0.0));
                    let theta_l = base.liquid_water_potential_temperature_k[at[2]] + warmer_k;
                    let theta_v = base_state::cloudy_air(exner, theta_l, total).2 * (1.0 + share);
                    heat[i] = (base_state::theta_l_of_theta_v(exner, theta_v, total, theta_l) - reference_k) as f32;
                }
            }
        }
    }
    if let Some(noise) = &scene.effects.noise {
        for i in 0..grid.len() {
            if grid.centre_height_m(i / plane) < noise.depth_m {
                heat[i] += (noise.potential_temperature_k * uniform(scene.seed, i as u32, 0)) as f32;
                water[i] += (noise.total_water_kg_per_kg * uniform(scene.seed, i as u32, 1)) as f32;
            }
        }
    }
    water.iter_mut().for_each(|w| *w = w.max(0.0));
    device.write(Field::Heat, &heat);
    device.write(Field::Water, &water);
}

/// A number in [-1, 1) from a seed, a cell and a stream: three rounds of a 32-bit multiply-xorshift hash, no state, so that it is the
/// same on any device and for any number of threads.
fn uniform(seed: u32, cell: u32, stream: u32) -> f64 {
    let mut h = seed ^ 0x9e37_79b9;
    for word in [cell, stream, 0x85eb_ca6b] {
        h ^= word;
        h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
        h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
        h ^= h >> 16;
    }
    h as f64 / 2_147_483_648.0 - 1.0
}

#[cfg(test)]
mod tests {
    use super::uniform;

    #[test]
    fn noise_is_uniform_and_uncorrelated() {
        let n = 100_000;
        let values: Vec<f64> = (0..n).map(|i| uniform(7, i, 0)).collect();
        let mean = values.iter().sum::<f64>() / n as f64;
        let variance = values.iter().map(|v| v * v).sum::<f64>() / n as f64;
        let lag = values.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n as f64;
        // Standard errors: 0.0018, 0.0009, 0.0011.
        assert!(
            mean.abs() < 0.009 && (variance - 1.0 / 3.0).abs() < 0.005 && lag.abs() < 0.006,
            "{mean} {variance} {lag}"
        );
        assert_ne!(uniform(7, 3, 0), uniform(8, 3, 0));
        assert_ne!(uniform(7, 3, 0), uniform(7, 3, 1));
    }
}
