//! Clouds, suns and a camera made by arithmetic alone, so that every machine has the same: for measurements and for tests of pictures.

use welkin_shaders::cpu::view::{Detail, Ground, Lighting, Scattering, ViewSettings};
use welkin_shaders::{CloudVolume, Grid};

/// A small repeatable random number from 0 to 1.
#[derive(Clone, Copy, Debug)]
pub struct Random(pub u32);

impl Random {
    /// The next one.
    #[allow(clippy::should_implement_trait, reason = "it never ends")]
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let mut h = self.0 ^ (self.0 >> 15);
        h = h.wrapping_mul(0x85eb_ca6b);
        ((h ^ (h >> 13)) >> 8) as f32 / 16_777_216.0
    }
}

/// A volume from cells, with its cloudy levels found.
pub fn volume(grid: Grid, extinction_per_m: Vec<f32>) -> CloudVolume {
    let plane = grid.plane();
    let full: Vec<usize> = (0..grid.cells[2])
        .filter(|k| extinction_per_m[k * plane..][..plane].iter().any(|v| *v > 0.0))
        .collect();
    let cloudy_levels = match (full.first(), full.last()) {
        (Some(first), Some(last)) => [*first, last + 1],
        _ => [0, 0],
    };
    CloudVolume {
        grid,
        extinction_per_m,
        cloudy_levels,
        air_displacement_m: [0.0; 3],
    }
}

/// A field of broken cumulus on the grid of the BOMEX case: each a heap of bubbles over a flat base at 600 m, ragged from cell to cell.
pub fn cumulus_field(seed: u32, clouds: usize) -> CloudVolume {
    let grid = Grid {
        cells: [64, 64, 75],
        cell_size_m: [100.0, 100.0, 40.0],
    };
    let mut random = Random(seed);
    let mut bubbles: Vec<[f32; 4]> = Vec::new();
    for _ in 0..clouds {
        let centre = [random.next() * 6400.0, random.next() * 6400.0];
        let width = 150.0 + 420.0 * random.next() * random.next();
        let mut z = 640.0;
        let mut radius = width;
        for _ in 0..(3 + (width / 90.0) as usize) {
            for _ in 0..2 {
                let away = radius * 0.7;
                let x = centre[0] + (random.next() - 0.5) * 2.0 * away;
                let y = centre[1] + (random.next() - 0.5) * 2.0 * away;
                bubbles.push([
                    x,
                    y,
                    z + radius * (0.2 + 0.3 * random.next()),
                    radius * (0.6 + 0.4 * random.next()),
                ]);
            }
            z += radius * (0.35 + 0.3 * random.next());
            radius *= 0.72 + 0.2 * random.next();
        }
    }
    let mut cells = vec![0.0f32; grid.len()];
    for k in 15..75 {
        let z = (k as f32 + 0.5) * 40.0;
        for j in 0..64 {
            for i in 0..64 {
                let (x, y) = ((i as f32 + 0.5) * 100.0, (j as f32 + 0.5) * 100.0);
                let mut deepest = -1.0f32;
                for b in &bubbles {
                    let wrap = |d: f32| d - 6400.0 * (d / 6400.0).round();
                    let (dx, dy, dz) = (wrap(x - b[0]), wrap(y - b[1]), z - b[2]);
                    deepest = deepest.max(1.0 - (dx * dx + dy * dy + dz * dz).sqrt() / b[3]);
                }
                let ragged = deepest + 0.25 * (random.next() - 0.5);
                if ragged > 0.0 {
                    // Liquid water grows with height above the base.
                    let core = 0.02 + 0.07 * ((z - 600.0) / 900.0).clamp(0.0, 1.0);
                    cells[grid.index(i, j, k)] = core * (ragged * 3.0).min(1.0);
                }
            }
        }
    }
    volume(grid, cells)
}

/// Heaps over a flat base at 600 m wherever a sum of waves is above `threshold`, the higher the further above: the lower the threshold, the more of the sky is cloud, all of it at
/// -4 and nothing at 4. The waves are 500 to 1300 m long and sum up to a mean of 0 with a standard deviation of 1.
pub fn broken_layer(seed: u32, threshold: f32) -> CloudVolume {
    const WAVES: usize = 24;
    let grid = Grid {
        cells: [64, 64, 75],
        cell_size_m: [100.0, 100.0, 40.0],
    };
    let mut random = Random(seed);
    // Whole waves across the box east and north, and where they begin.
    let waves: [[f32; 3]; WAVES] = std::array::from_fn(|_| {
        let turn = std::f32::consts::TAU * random.next();
        let count = 5.0 + 8.0 * random.next();
        [
            (count * turn.cos()).round(),
            (count * turn.sin()).round(),
            std::f32::consts::TAU * random.next(),
        ]
    });
    let mut cells = vec![0.0f32; grid.len()];
    for j in 0..64 {
        for i in 0..64 {
            let [x, y] = [i, j].map(|n| std::f32::consts::TAU * (n as f32 + 0.5) / 64.0);
            let sum: f32 = waves
                .iter()
                .map(|[east, north, from]| (east * x + north * y + from).cos())
                .sum();
            let above = sum * (2.0 / WAVES as f32).sqrt() - threshold;
            if above <= 0.0 {
                continue;
            }
            let top_m = 600.0 + (200.0 + 500.0 * above).min(1200.0);
            for k in 15..75 {
                let z = (k as f32 + 0.5) * 40.0;
                if z < top_m {
                    let core = 0.02 + 0.07 * ((z - 600.0) / 900.0).clamp(0.0, 1.0);
                    cells[grid.index(i, j, k)] = core * (above * 3.0).min(1.0);
                }
            }
        }
    }
    volume(grid, cells)
}

/// One round thick cloud in the middle of the box: centre height and radius in m, extinction in 1/m.
pub fn ball(centre_height_m: f32, radius_m: f32, extinction_per_m: f32) -> CloudVolume {
    let grid = Grid {
        cells: [64, 64, 60],
        cell_size_m: [100.0, 100.0, 50.0],
    };
    ball_in(grid, [3200.0, 3200.0, centre_height_m], radius_m, extinction_per_m)
}

/// One round cloud: its centre and radius in m, extinction in 1/m.
pub fn ball_in(grid: Grid, centre_m: [f32; 3], radius_m: f32, extinction_per_m: f32) -> CloudVolume {
    let [nx, ny, _] = grid.cells;
    let cells = (0..grid.len()).map(|n| {
        let place = [n % nx, n / nx % ny, n / grid.plane()];
        let d = [0, 1, 2].map(|a| (place[a] as f32 + 0.5) * grid.cell_size_m[a] - centre_m[a]);
        if (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt() < radius_m {
            extinction_per_m
        } else {
            0.0
        }
    });
    volume(grid, cells.collect())
}

/// The sun at an elevation and azimuth in degrees.
pub fn sun(elevation_deg: f32, azimuth_deg: f32) -> [f32; 3] {
    let (e, a) = (elevation_deg.to_radians(), azimuth_deg.to_radians());
    [e.cos() * a.sin(), e.cos() * a.cos(), e.sin()]
}

/// A camera near the ground that looks north and a little up, by day.
pub fn settings(width: usize, height: usize) -> ViewSettings {
    ViewSettings {
        camera_position_m: [3200.0, 300.0, 2.0],
        azimuth_deg: 0.0,
        elevation_deg: 18.0,
        vertical_fov_deg: 55.0,
        exposure_ev: 0.0,
        width,
        height,
        sun_direction: sun(45.0, 130.0),
        detail: Some(Detail {
            strength: 0.6,
            scale_m: 220.0,
        }),
        multiple_scattering_octaves: 6,
        // As scenes are lit unless they say otherwise.
        lighting: Lighting {
            scattering: Scattering::Diffusion,
            ..Lighting::default()
        },
        steps: Default::default(),
        ground: Ground::Land,
        cloud_shadow: true,
        light_shafts: 0,
        visibility_m: Some(40_000.0),
        seed: 1,
        surface_altitude_m: 0.0,
        moon: None,
        stars: None,
        sky: Default::default(),
        sampling: Default::default(),
    }
}
