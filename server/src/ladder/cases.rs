//! What the rungs are run on.

use serde_json::{Value, json};
use welkin_proto::scene::{Accuracy, BaseState, Pressure, Scene};
use welkin_proto::{ApiError, presets};
use welkin_shaders::catalogue::{Field, Ladder};

use super::{Case, Context, LadderError, run};
use crate::validate::{extremes, field};
use crate::world::World;

/// Makes a case, with its truth.
type Make = fn(&Context) -> Result<Case, LadderError>;

pub(super) const ALL: &[Make] = &[carried_blob, dry_bubble, solved_bubble, cumulus];

/// Warmth of the blob that is carried, K: so little that it does not lift itself within the run.
const BLOB_K: f64 = 1e-4;

fn keep_nothing(_: &World, _: &mut Vec<Vec<f64>>) {}

fn start_as_it_is(_: &mut World) -> Result<(), ApiError> {
    Ok(())
}

/// Replaces what was kept by the last state of the scalar.
fn keep_last_heat(world: &World, kept: &mut Vec<Vec<f64>>) {
    let (base, plane) = (&world.parameters().base_heat_k, world.parameters().grid.plane());
    let heat = field(world, Field::Heat);
    let excess = heat.iter().enumerate().map(|(i, t)| f64::from(t - base[i / plane]));
    *kept = vec![excess.collect()];
}

/// Distance of two fields over the size of the second, both by their squares.
fn relative(ours: &[f64], truth: &[f64]) -> f64 {
    let size: f64 = truth.iter().map(|t| t * t).sum();
    let distance: f64 = ours.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum();
    (distance / size).sqrt()
}

/// A smooth blob is carried once through a periodic box, slantwise: at the end it must stand where it began.
fn carried_blob(context: &Context) -> Result<Case, LadderError> {
    let mut scene = presets::find("dry-bubble")?;
    let n = if context.quick { 24 } else { 48 };
    scene.domain.cells = [n, n, 4];
    scene.domain.cell_size_m = [100.0, 100.0, 100.0];
    scene.base_state = BaseState::Isentropic {
        surface_pressure_pa: 1e5,
        potential_temperature_k: 300.0,
        wind_x_m_s: 10.0,
        wind_y_m_s: 5.0,
    };
    scene.effects.bubble = None;
    let start: fn(&mut World) -> Result<(), ApiError> = |world| {
        let blob = blob(world);
        world.write_field(Field::Heat, &blob)
    };
    // Twice around along x, once along y.
    let end_s = f64::from(n) * 100.0 / 5.0;
    let world = World::new(scene.clone(), context.machine.clone())?;
    let truth: Vec<f64> = blob(&world).into_iter().map(f64::from).collect();
    Ok(Case {
        name: "carried-blob",
        what: format!(
            "a Gaussian blob of 4 cells' width goes through a periodic box of {n} x {n} cells at 10 and 5 m/s; the truth is exact"
        ),
        error: "relative error of the scalar (root mean square)",
        ladders: &[Ladder::Advection],
        scene,
        // No whole number of cells: a method that looks back by whole cells would find them unspoilt.
        tick_s: 17.0,
        end_s,
        start,
        watch: keep_last_heat,
        judge: Box::new(move |kept| {
            let ours = kept.last().map_or(&[][..], Vec::as_slice);
            let most = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
            let least = ours.iter().copied().fold(0.0, f64::min);
            let figures = json!({
                "largest_over_exact": most(ours) / most(&truth),
                "undershoot_over_exact": least / most(&truth),
                "sum_over_exact": ours.iter().sum::<f64>() / truth.iter().sum::<f64>(),
            });
            (relative(ours, &truth), figures)
        }),
        chance: None,
    })
}

/// A Gaussian of four cells' width, the same on every level.
fn blob(world: &World) -> Vec<f32> {
    let grid = world.parameters().grid;
    let [nx, ny, _] = grid.cells;
    (0..grid.len())
        .map(|i| {
            let from_middle = |at: usize, n: usize| (at as f64 + 0.5 - 0.5 * n as f64) / 4.0;
            let (x, y) = (from_middle(i % nx, nx), from_middle(i / nx % ny, ny));
            (BLOB_K * (-(x * x + y * y)).exp()) as f32
        })
        .collect()
}

/// The dry bubble at 200 m against our own run at 50 m (100 m if quick), averaged to the coarse cells.
fn dry_bubble(context: &Context) -> Result<Case, LadderError> {
    let finer = if context.quick { 2 } else { 4 };
    let coarse = bubble_at(200.0)?;
    let mut case = Case {
        name: "dry-bubble",
        what: format!(
            "the dry bubble of Bryan and Fritsch (2002) at 200 m to 1000 s; the truth is our own run with accuracy reference at {} m",
            200 / finer
        ),
        error: "relative error of theta' (root mean square)",
        ladders: &[Ladder::Advection, Ladder::Subgrid],
        scene: coarse,
        tick_s: 20.0,
        end_s: 1000.0,
        start: start_as_it_is,
        watch: keep_last_heat_and_updraught,
        judge: Box::new(|_| (f64::NAN, Value::Null)),
        chance: None,
    };
    let mut fine = bubble_at(200.0 / finer as f64)?;
    fine.accuracy = Accuracy::Reference;
    let nx = fine.domain.cells[0] as usize;
    let truth = run(context, &case, fine, "dry-bubble: the truth")?
        .map_err(|_| LadderError::Reference("dry-bubble"))?
        .kept;
    let means = coarsened(&truth[0], nx, finer);
    let w = truth[1].clone();
    case.judge = Box::new(move |kept| {
        let figures = json!({ "updraught_max_m_s": kept[1][1], "updraught_max_of_truth_m_s": w[1] });
        (relative(&kept[0], &means), figures)
    });
    Ok(case)
}

/// The bubble's scene with square cells.
fn bubble_at(cell_m: f64) -> Result<Scene, LadderError> {
    let mut scene = presets::find("dry-bubble")?;
    scene.domain.cells = [(20_000.0 / cell_m) as u32, 1, (10_000.0 / cell_m) as u32];
    scene.domain.cell_size_m = [cell_m; 3];
    Ok(scene)
}

fn keep_last_heat_and_updraught(world: &World, kept: &mut Vec<Vec<f64>>) {
    keep_last_heat(world, kept);
    kept.push(extremes(&field(world, Field::VelocityZ)).to_vec());
}

/// What a pressure solver leaves undone: the same bubble on the same grid, against the direct solve.
fn solved_bubble(context: &Context) -> Result<Case, LadderError> {
    let cell_m = if context.quick { 200.0 } else { 100.0 };
    let mut scene = bubble_at(cell_m)?;
    scene.methods.pressure = Some(Pressure::Direct {});
    let mut case = Case {
        name: "solved-bubble",
        what: format!(
            "the dry bubble of Bryan and Fritsch (2002) at {cell_m:.0} m to 1000 s; the truth is the direct solve on the same grid,              which therefore has no error here"
        ),
        error: "relative error of theta' (root mean square)",
        ladders: &[Ladder::Pressure],
        scene: scene.clone(),
        tick_s: 20.0,
        end_s: 1000.0,
        start: start_as_it_is,
        watch: keep_last_heat_and_updraught,
        judge: Box::new(|_| (f64::NAN, Value::Null)),
        chance: None,
    };
    let truth = run(context, &case, scene, "solved-bubble: the truth")?
        .map_err(|_| LadderError::Reference("solved-bubble"))?
        .kept;
    case.judge = Box::new(move |kept| {
        let figures = json!({ "updraught_max_m_s": kept[1][1], "updraught_max_of_truth_m_s": truth[1][1] });
        (relative(&kept[0], &truth[0]), figures)
    });
    Ok(case)
}

/// Means over squares of `by` by `by` cells of a field of rows of `nx` in x and z.
fn coarsened(fine: &[f64], nx: usize, by: usize) -> Vec<f64> {
    let (columns, rows) = (nx / by, fine.len() / nx / by);
    let mut means = vec![0.0; columns * rows];
    for (i, value) in fine.iter().enumerate() {
        let (x, z) = (i % nx / by, i / nx / by);
        means[z * columns + x] += value / (by * by) as f64;
    }
    means
}

/// Shallow cumulus in a small box, judged by its mean profile of cloud water; chaotic, so that chance is measured too.
fn cumulus(context: &Context) -> Result<Case, LadderError> {
    let scene_at = |cells: [u32; 3], cell_size_m: [f64; 3]| -> Result<Scene, LadderError> {
        let mut scene = presets::find("fair-weather-cumulus")?;
        scene.domain.cells = cells;
        scene.domain.cell_size_m = cell_size_m;
        Ok(scene)
    };
    let coarse = scene_at([32, 32, 50], [100.0, 100.0, 60.0])?;
    let end_s = if context.quick { 3600.0 } else { 5400.0 };
    let truth_is = if context.quick {
        "the same grid with accuracy reference"
    } else {
        "our own balanced run at 50 m and 30 m"
    };
    let mut case = Case {
        name: "cumulus",
        what: format!(
            "shallow cumulus (BOMEX, Siebesma et al. 2003) in 32 x 32 columns at 100 m and 60 m to {:.1} h, mean over the second half; \
             the truth is {truth_is}",
            end_s / 3600.0
        ),
        error: "relative error of the mean profile of cloud water (root mean square)",
        ladders: &[Ladder::Advection, Ladder::Pressure, Ladder::Subgrid],
        scene: coarse.clone(),
        tick_s: 20.0,
        end_s,
        start: start_as_it_is,
        watch: keep_nothing,
        judge: Box::new(|_| (f64::NAN, Value::Null)),
        chance: None,
    };
    // A profile of cloud water a tick, then cover and path; the reference has its own levels.
    case.watch = |world, kept| {
        let plane = world.parameters().grid.plane();
        let mean = |level: &[f32]| level.iter().map(|&q| f64::from(q)).sum::<f64>() / plane as f64;
        let mut row: Vec<f64> = field(world, Field::CloudWater).chunks_exact(plane).map(mean).collect();
        let numbers = world.numbers();
        row.push(numbers.cloud_cover.unwrap_or(0.0));
        row.push(numbers.liquid_water_path_kg_m2.unwrap_or(0.0));
        kept.push(row);
    };
    let (mut fine, levels_in_one) = if context.quick {
        (coarse, 1)
    } else {
        (scene_at([64, 64, 100], [50.0, 50.0, 30.0])?, 2)
    };
    if context.quick {
        fine.accuracy = Accuracy::Reference;
    }
    let truth = run(context, &case, fine, "cumulus: the truth")?
        .map_err(|_| LadderError::Reference("cumulus"))?
        .kept;
    let (profile, rest) = second_half(&truth, levels_in_one);
    case.judge = Box::new(move |kept| {
        let (ours, numbers) = second_half(kept, 1);
        let figures = json!({
            "cloud_cover": numbers[0], "cloud_cover_of_truth": rest[0],
            "liquid_water_path_kg_m2": numbers[1], "liquid_water_path_of_truth_kg_m2": rest[1],
        });
        (relative(&ours, &profile), figures)
    });
    let mut other = case.scene.clone();
    other.seed = other.seed.wrapping_add(1);
    let balanced = run(context, &case, case.scene.clone(), "cumulus: chance")?;
    let reseeded = run(context, &case, other, "cumulus: chance")?;
    if let (Ok(a), Ok(b)) = (balanced, reseeded) {
        case.chance = Some(relative(&second_half(&a.kept, 1).0, &second_half(&b.kept, 1).0));
    }
    Ok(case)
}

/// The mean profile over the second half of the ticks, levels taken together by `by`, and the two numbers behind it.
fn second_half(kept: &[Vec<f64>], by: usize) -> (Vec<f64>, [f64; 2]) {
    let late = &kept[kept.len() / 2..];
    let width = late.first().map_or(2, Vec::len);
    let mean = |i: usize| late.iter().map(|row| row[i]).sum::<f64>() / late.len().max(1) as f64;
    let profile: Vec<f64> = (0..width - 2).map(mean).collect();
    let profile = profile
        .chunks(by)
        .map(|levels| levels.iter().sum::<f64>() / levels.len() as f64)
        .collect();
    (profile, [mean(width - 2), mean(width - 1)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coarsening_takes_means_of_squares() {
        let fine = [1.0, 3.0, 0.0, 0.0, 5.0, 7.0, 4.0, 0.0];
        assert_eq!(coarsened(&fine, 4, 2), [4.0, 1.0]);
    }

    #[test]
    fn a_profile_is_the_mean_of_the_second_half() {
        let rows = [
            vec![9.0, 9.0, 9.0, 9.0],
            vec![9.0, 9.0, 9.0, 9.0],
            vec![1.0, 3.0, 0.2, 5.0],
            vec![3.0, 5.0, 0.4, 7.0],
        ];
        let (profile, [cover, path]) = second_half(&rows, 1);
        assert_eq!(profile, [2.0, 4.0]);
        assert!((cover - 0.3).abs() < 1e-12 && path == 6.0);
        assert_eq!(second_half(&rows, 2).0, [3.0]);
    }
}
