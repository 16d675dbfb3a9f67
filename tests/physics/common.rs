//! What physics tests share: air for kernels by themselves, and numbers that look random.

// Each test binary uses a part of it.
#![allow(dead_code)]

use welkin_shaders::Grid;
use welkin_shaders::cpu::sim::Parameters;

/// Air of constant density, or of density that falls to 1/e over `scale_height_m`; exner 1, no effect present.
pub fn air(grid: Grid, scale_height_m: Option<f64>) -> Parameters {
    let n = grid.cells[2];
    let density = |z_m: f64| scale_height_m.map_or(1.0, |h| 1.2 * (-z_m / h).exp()) as f32;
    let dz = grid.cell_size_m[2] as f64;
    Parameters {
        grid,
        density_kg_m3: (0..n).map(|z| density((z as f64 + 0.5) * dz)).collect(),
        density_at_z_face_kg_m3: (0..=n).map(|z| density(z as f64 * dz)).collect(),
        pressure_pa: vec![1e5; n],
        exner: vec![1.0; n],
        virtual_potential_temperature_k: vec![300.0; n],
        heat_reference_k: 300.0,
        base_heat_k: vec![0.0; n],
        base_wind_x_m_s: vec![0.0; n],
        base_wind_y_m_s: vec![0.0; n],
        turbulence: None,
        constant_viscosity: None,
        body_force: None,
        surface: None,
        coriolis: None,
        large_scale: None,
        sponge: None,
        droplet_number_per_m3: 1e8,
        methods: Default::default(),
    }
}

/// A number in [-1, 1) that looks random.
pub fn noise(i: usize) -> f32 {
    let mut h = (i as u32).wrapping_mul(0x9e37_79b9) ^ 0x5bd1_e995;
    h = (h ^ (h >> 15)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    (h ^ (h >> 16)) as f32 / 2_147_483_648.0 - 1.0
}
