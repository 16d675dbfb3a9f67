//! What the march's scattering sends out of balls of cloud, of what they take from the sun's beam: a ball ends sideways, as clouds do and level slabs do not.
//!
//! A ball stands alone in a dark, wide box. Directions all around, closer about the beam's way, have a picture each, whose radiance times a pixel's area at the ball's distance is what is sent there; the way's own march draws it, so that
//! all that a rung does to light counts. What the ball takes is the shadow that it throws.

use serde::Serialize;
use welkin_shaders::Grid;
use welkin_shaders::cpu::light::phase::directions_around;
use welkin_shaders::cpu::light::sky_visibility::sky_visibility;
use welkin_shaders::cpu::light::slab_tables::SlabSources;
use welkin_shaders::cpu::light::sun_optical_depth::SunLight;
use welkin_shaders::cpu::view::Scattering;
use welkin_shaders::cpu::view::march::{PACKET_ROWS, radiance_rows};
use welkin_shaders::cpu::view::shape::Shape;

use super::slabs::{Camera, Night, Way};
use crate::clouds::ball_in;

/// Optical depths through the middle.
const DEPTHS: [f64; 5] = [0.01, 0.8, 4.0, 16.0, 80.0];
/// Of Henyey and Greenstein's function.
const ASYMMETRY: f64 = 0.85;
/// Towards the sun, and two directions across it.
const SUN: [f32; 3] = [0.48, 0.36, 0.8];
const AROUND_SUN: [[f32; 3]; 3] = [[0.6, -0.8, 0.0], [0.64, 0.48, -0.6], SUN];
const CELLS: [usize; 3] = [96, 96, 16];
const CELL_M: f32 = 80.0;
const RADIUS_M: f32 = 400.0;
/// Of pictures: how many in a ring around the sun, how far from the ball's middle, what half of one spans there, and its pixels.
const AROUND: usize = 8;
const DISTANCE_M: f32 = 4_000.0;
const HALF_M: f32 = 600.0;
const SIDE: usize = 40;

/// One ball.
#[derive(Clone, Debug, Serialize)]
pub struct BallRow {
    /// Through its middle.
    pub optical_depth: f64,
    /// Of Henyey and Greenstein's function.
    pub asymmetry: f64,
    /// What each rung sends out of what the ball takes: above 1 where light is made, below 1 where it is lost.
    pub sent_out: Vec<(String, f64)>,
}

/// All balls with the march of these ways through cloud.
pub(super) fn all(ways: &[(Scattering, u32)]) -> Vec<BallRow> {
    let night = Night::new();
    let sources = SlabSources::kept(ASYMMETRY as f32);
    let grid = Grid {
        cells: CELLS,
        cell_size_m: [CELL_M; 3],
    };
    let middle_m = CELLS.map(|n| n as f32 * 0.5 * CELL_M);
    let directions = directions_around(&AROUND_SUN, ASYMMETRY as f32, AROUND);
    let mut rows = Vec::new();
    for depth in DEPTHS {
        let ball = ball_in(grid, middle_m, RADIUS_M, depth as f32 / (2.0 * RADIUS_M));
        let Some(shape) = Shape::new(&ball) else { continue };
        let seen = sky_visibility(&shape.slab_per_m, [CELLS[0], CELLS[1]], grid.cell_size_m);
        let sun_light = SunLight::new(&shape, &seen, false, false, SUN);
        let [across, up] = [shape.stride[0], shape.stride[1]];
        let shadow = |n: usize| {
            let inner = (1..across - 1).contains(&(n % across)) && (1..up - 1).contains(&(n / across));
            if inner {
                1.0 - f64::from(-sun_light.shadow[n]).exp()
            } else {
                0.0
            }
        };
        let point_m2 = f64::from(shape.point_spacing_m[0] * shape.point_spacing_m[1]);
        let taken_m2 = (0..across * up).map(shadow).sum::<f64>() * point_m2 * f64::from(SUN[2]);
        let sent_out = ways.iter().map(|way| {
            let made = Way::new(*way, (&shape, &sun_light), SUN, ASYMMETRY, &sources);
            let mut sent_m2 = 0.0;
            for towards in &directions {
                let ahead = towards.d;
                // No direction is vertical.
                let [east, north, rise] = ahead;
                let level = east.hypot(north);
                let right = [north / level, -east / level, 0.0];
                let above = [-rise * east / level, -rise * north / level, level];
                let camera = Camera {
                    position_m: [0, 1, 2].map(|a| middle_m[a] - DISTANCE_M * ahead[a]),
                    axes: [right, above, ahead],
                    half_height: HALF_M / DISTANCE_M,
                    side: SIDE,
                };
                let frame = night.look((&shape, &sun_light), &made, SUN, &camera);
                let mut pixels = vec![[0.0f32; 3]; SIDE * SIDE];
                for (row, out) in pixels.chunks_mut(SIDE * PACKET_ROWS).enumerate() {
                    radiance_rows(&frame, row * PACKET_ROWS, out);
                }
                let pixel_m2 = f64::from(2.0 * HALF_M / SIDE as f32).powi(2);
                let light = pixels.iter().map(|p| f64::from(p[1])).sum::<f64>();
                sent_m2 += light * pixel_m2 * f64::from(towards.even);
            }
            (super::rungs::scattering_name(*way), sent_m2 / taken_m2)
        });
        rows.push(BallRow {
            optical_depth: depth,
            asymmetry: ASYMMETRY,
            sent_out: sent_out.collect(),
        });
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ladder::light::rungs::SCATTERINGS;

    /// What each rung sends out of balls, thin to thick. The sums themselves are good to 0.01 (the thinnest ball by single scattering, where 0.997 is exact). Octaves are balanced over columns from one place a cell,
    /// and in the densest ball, where light ends within a cell, lose a seventh.
    #[test]
    fn balls_send_out_what_they_take() {
        let rows = all(&SCATTERINGS);
        assert_eq!(rows.len(), DEPTHS.len());
        for row in &rows {
            println!("{row:?}");
            for (rung, sent_out) in &row.sent_out {
                let allowed = match rung.as_str() {
                    "single" | "multiple_forward" => 0.05..1.03,
                    "diffusion" => 0.97..1.03,
                    // In the densest ball most light turns within a point's box.
                    "slab" | "slab_collector" => 0.95..1.03,
                    _ if row.optical_depth > 50.0 => 0.83..1.03,
                    _ => 0.97..1.03,
                };
                assert!(
                    allowed.contains(sent_out),
                    "{rung} at {}: {sent_out}",
                    row.optical_depth
                );
            }
        }
        let (thinnest, single) = (&rows[0], &rows[0].sent_out[0]);
        assert!(single.0 == "single" && (single.1 - 0.997).abs() < 0.01, "{thinnest:?}");
    }
}
