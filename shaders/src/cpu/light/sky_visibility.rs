//! Stage `sky_visibility`: how much of the light of sky and ground reaches the inside of clouds.
//!
//! Reads: extinction at cell centres, 1/m, `[level][y][x]`, periodic in x and y. Writes: two fields of the same shape, 0 to 1, one for
//! light from above and one for light from below. Scheme: optical depth carried level by level along five slanted directions
//! each way (one vertical, four at 50 degrees), linear interpolation; diffuse light that passes an optical depth t of droplets
//! is 1 / (1 + 3/4 (1 - g) t), the two-stream result for no absorption, g = 0.86. Carrying level by level smooths sideways,
//! which suits diffuse light.

use rayon::prelude::*;

crate::constants! {
    /// 3/4 (1 - g).
    pub const DIFFUSE_VISIBILITY: f32 = 0.105;
    /// Tangent of the slanted directions' angle from the vertical.
    pub const SLANT_SIDEWAYS: f32 = 1.19;
    /// One over its cosine.
    pub const SLANT_PATH: f32 = 1.556;
}

/// Light from above and from below; see the module. `extinction` holds whole levels of `cells[0] * cells[1]`.
pub fn sky_visibility(extinction: &[f32], cells: [usize; 2], cell_size_m: [f32; 3]) -> [Vec<f32>; 2] {
    let plane = cells[0] * cells[1];
    let levels = extinction.len() / plane.max(1);
    let directions = [[0i32, 0], [1, 0], [-1, 0], [0, 1], [0, -1]];
    let sweeps: Vec<Vec<f32>> = (0..10usize)
        .into_par_iter()
        .map(|n| sweep(extinction, cells, cell_size_m, levels, directions[n % 5], n < 5))
        .collect();
    [0, 5].map(|first| {
        (0..extinction.len())
            .map(|i| (0..5).map(|d| sweeps[first + d][i]).sum::<f32>() * 0.2)
            .collect()
    })
}

/// Length in m of a slanted path through a level, and the cells that it goes sideways along `axis`.
pub(crate) fn slanted_path(size_m: [f32; 3], axis: usize) -> (f32, f32) {
    (size_m[2] * SLANT_PATH, SLANT_SIDEWAYS * size_m[2] / size_m[axis])
}

fn sweep(
    extinction: &[f32],
    cells: [usize; 2],
    size_m: [f32; 3],
    levels: usize,
    way: [i32; 2],
    from_above: bool,
) -> Vec<f32> {
    let (nx, ny) = (cells[0], cells[1]);
    let plane = nx * ny;
    let slanted = way != [0, 0];
    let (path_m, reach) = if slanted {
        slanted_path(size_m, if way[0] != 0 { 0 } else { 1 })
    } else {
        (size_m[2], 0.0)
    };
    let whole = reach.floor();
    let fraction = reach - whole;
    let shift = |i: usize, by: i32, n: usize| (i as i64 + by as i64).rem_euclid(n as i64) as usize;
    let steps = [whole as i32, whole as i32 + 1];
    let mut out = vec![1.0f32; extinction.len()];
    let mut above = vec![0.0f32; plane];
    let mut here = vec![0.0f32; plane];
    for level in 0..levels {
        let k = if from_above { levels - 1 - level } else { level };
        for y in 0..ny {
            let rows = steps.map(|s| shift(y, s * way[1], ny) * nx);
            for x in 0..nx {
                let columns = steps.map(|s| if way[0] == 0 { x } else { shift(x, s * way[0], nx) });
                let before = above[rows[0] + columns[0]] * (1.0 - fraction) + above[rows[1] + columns[1]] * fraction;
                let own = extinction[k * plane + y * nx + x] * path_m;
                here[y * nx + x] = before + own;
                out[k * plane + y * nx + x] = 1.0 / (1.0 + DIFFUSE_VISIBILITY * (before + 0.5 * own));
            }
        }
        std::mem::swap(&mut above, &mut here);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_uniform_slab_dims_from_above_and_below_alike() {
        let [up, down] = sky_visibility(&vec![0.02; 8 * 8 * 10], [8, 8], [100.0, 100.0, 40.0]);
        let top = up[9 * 64];
        assert!(top > up[0] && up[0] > 0.3 && up[0] < 0.7, "{} {}", up[0], top);
        assert!((down[0] - top).abs() < 1e-5);
    }
}
