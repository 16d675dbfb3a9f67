//! Stage `transmittance_table`: how much of the sun's light reaches a height through clear air.
//!
//! Reads: [`Atmosphere`]. Writes: table of transmittance, `[height 48][direction 128]`, three colours, 0 to 1.
//! Scheme: midpoint sums of the optical depth over 48 steps; directions spaced by the distance to the top of the
//! atmosphere (Bruneton and Neyret 2008, section 4). Second order in the step. Source: Hillaire (2020), section 5.1.

use super::atmosphere::{AIR_DEPTH_M, Atmosphere, EARTH_RADIUS_M, distance_to_shell_m, height_along_m};

crate::constants! {
    /// Rows of the table.
    pub const TRANSMITTANCE_HEIGHTS: usize = 48;
    /// Columns of the table.
    pub const TRANSMITTANCE_DIRECTIONS: usize = 128;
    const TRANSMITTANCE_STEPS: usize = 48;
    /// Half the sun's angular width, rad.
    pub const SUN_ANGULAR_RADIUS: f32 = 0.004_65;
}

/// See the module.
#[derive(Clone, Debug)]
pub struct TransmittanceTable {
    values: Vec<[f32; 3]>,
}

fn horizon_distance_m(height_m: f32) -> f32 {
    (height_m * (2.0 * EARTH_RADIUS_M + height_m)).max(0.0).sqrt()
}

impl TransmittanceTable {
    /// Computes the table; about 2 ms.
    pub fn new(air: &Atmosphere) -> TransmittanceTable {
        let mut values = Vec::with_capacity(TRANSMITTANCE_HEIGHTS * TRANSMITTANCE_DIRECTIONS);
        let top = horizon_distance_m(AIR_DEPTH_M);
        for j in 0..TRANSMITTANCE_HEIGHTS {
            let rho = top * j as f32 / (TRANSMITTANCE_HEIGHTS - 1) as f32;
            let r = (rho as f64 * rho as f64 + EARTH_RADIUS_M as f64 * EARTH_RADIUS_M as f64).sqrt();
            let height_m = (r - EARTH_RADIUS_M as f64) as f32;
            for i in 0..TRANSMITTANCE_DIRECTIONS {
                let (d_min, d_max) = (AIR_DEPTH_M - height_m, rho + top);
                let d = (d_min + (d_max - d_min) * i as f32 / (TRANSMITTANCE_DIRECTIONS - 1) as f32).max(1.0) as f64;
                let mu = ((top as f64 * top as f64 - rho as f64 * rho as f64 - d * d) / (2.0 * r * d)).clamp(-1.0, 1.0);
                values.push(through(air, height_m, mu as f32));
            }
        }
        TransmittanceTable { values }
    }
    /// All texels, `[height][direction]`.
    pub fn texels(&self) -> &[[f32; 3]] {
        &self.values
    }
    /// Transmittance from `height_m` to space along a direction whose cosine to the zenith is `mu`, not looking at whether the
    /// ground is in the way.
    pub fn to_space(&self, height_m: f32, mu: f32) -> [f32; 3] {
        let height_m = height_m.clamp(0.0, AIR_DEPTH_M - 1.0);
        let top = horizon_distance_m(AIR_DEPTH_M);
        let rho = horizon_distance_m(height_m);
        let d = distance_to_shell_m(height_m, mu, AIR_DEPTH_M);
        let (d_min, d_max) = (AIR_DEPTH_M - height_m, rho + top);
        let x = ((d - d_min) / (d_max - d_min)).clamp(0.0, 1.0) * (TRANSMITTANCE_DIRECTIONS - 1) as f32;
        let y = (rho / top).clamp(0.0, 1.0) * (TRANSMITTANCE_HEIGHTS - 1) as f32;
        bilinear(&self.values, TRANSMITTANCE_DIRECTIONS, TRANSMITTANCE_HEIGHTS, x, y)
    }
    /// Share of the sun's light that reaches `height_m` when the cosine of the sun's zenith angle there is `mu`; falls to 0 as
    /// the disc sets behind the horizon.
    pub fn of_sun(&self, height_m: f32, mu: f32) -> [f32; 3] {
        let r = EARTH_RADIUS_M + height_m.max(0.0);
        let dip = horizon_distance_m(height_m.max(0.0)) / r;
        let risen = ((mu + dip) / (2.0 * SUN_ANGULAR_RADIUS) + 0.5).clamp(0.0, 1.0);
        if risen == 0.0 {
            return [0.0; 3];
        }
        self.to_space(height_m, mu)
            .map(|t| t * risen * risen * (3.0 - 2.0 * risen))
    }
}

fn through(air: &Atmosphere, height_m: f32, mu: f32) -> [f32; 3] {
    let whole = distance_to_shell_m(height_m, mu, AIR_DEPTH_M);
    let mut depth = [0.0f32; 3];
    let mut before = 0.0;
    for s in 0..TRANSMITTANCE_STEPS {
        // Steps grow with the square of their number: air is densest at the near end.
        let f = (s + 1) as f32 / TRANSMITTANCE_STEPS as f32;
        let after = whole * f * f;
        let c = air.at(height_along_m(height_m, mu, 0.5 * (before + after)).max(0.0));
        for k in 0..3 {
            depth[k] += c.extinction_per_m[k] * (after - before);
        }
        before = after;
    }
    depth.map(|t| (-t).exp())
}

/// Linear interpolation in a table `[y][x]` at fractional indices.
pub(crate) fn bilinear(values: &[[f32; 3]], width: usize, height: usize, x: f32, y: f32) -> [f32; 3] {
    let i = (x as usize).min(width - 2);
    let j = (y as usize).min(height - 2);
    let (fx, fy) = (x - i as f32, y - j as f32);
    let row = j * width + i;
    [0, 1, 2].map(|c| {
        let low = values[row][c] + (values[row + 1][c] - values[row][c]) * fx;
        let high = values[row + width][c] + (values[row + width + 1][c] - values[row + width][c]) * fx;
        low + (high - low) * fy
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zenith_transmittance_is_that_of_exponential_air() {
        let air = Atmosphere::new(0.0, None);
        let table = TransmittanceTable::new(&air);
        let t = table.to_space(0.0, 1.0);
        // Vertical optical depth: Rayleigh 13.558e-6 * 8000, aerosol 4.4e-6 * 1200, ozone 1.881e-6 * 15000.
        let wanted = (-(13.558e-6f32 * 8_000.0 + 4.4e-6 * 1_200.0 + 1.881e-6 * 15_000.0)).exp();
        assert!((t[1] - wanted).abs() < 0.005, "{} wanted {wanted}", t[1]);
        let low = table.of_sun(0.0, 0.01);
        assert!(low[0] > 3.0 * low[2], "the low sun is red: {low:?}");
        assert_eq!(table.of_sun(0.0, -0.1), [0.0; 3]);
    }
}
