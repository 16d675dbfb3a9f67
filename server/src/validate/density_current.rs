//! The density current of Straka et al. (1993): a cold bubble falls, touches down and runs along the ground.
//!
//! Their grid-converged solution at 25 m has constant mixing of 75 m2/s. The front is where the lowest level's theta' crosses -1 K; our
//! lowest centres lie half a cell above the ground.

use serde_json::json;
use welkin_proto::presets;
use welkin_shaders::catalogue::Field;

use super::compressible::Compressible;
use super::{Aim, Context, Figure, Findings, Plot, ValidateError, extremes, field, lopsided};
use crate::plot::{self, Chart, Mark, Panel, Picture, Series};

/// When the reference is taken, s.
const END_S: f64 = 900.0;
/// Half the box, where the bubble falls, m.
const MIDDLE_M: f64 = 25_600.0;
/// The front's potential temperature excess, K.
const FRONT_K: f64 = -1.0;
/// Published at 25 m.
const FRONT_M: f64 = 15_537.0;
const THETA_MIN_K: f64 = -9.77;
const U: [f64; 2] = [-15.19, 36.46];
const W: [f64; 2] = [-15.95, 12.93];

struct Run {
    cell_m: f64,
    cells: [usize; 2],
    excess: Vec<f32>,
    front_m: f64,
    front_by_s: Vec<[f64; 2]>,
    u: [f64; 2],
    w: [f64; 2],
    lopsided: f64,
}

/// Distance of the outermost place where the row crosses the front's excess from the middle, m; 0 where it never does.
fn front_m(row: &[f32], cell_m: f64) -> f64 {
    let cold = |i: usize| f64::from(row[i]) <= FRONT_K;
    let Some(last) = (0..row.len().saturating_sub(1)).rev().find(|&i| cold(i)) else {
        return 0.0;
    };
    let (a, b) = (f64::from(row[last]), f64::from(row[last + 1]));
    (last as f64 + 0.5 + (FRONT_K - a) / (b - a)) * cell_m - MIDDLE_M
}

/// The same current in a compressible flow of ours: what of a difference from the published solution is the anelastic core's.
fn compressible(context: &Context, cell_m: f64) -> Result<Run, ValidateError> {
    let cells = [(2.0 * MIDDLE_M / cell_m) as usize, (6400.0 / cell_m) as usize];
    let cold = |x_m: f64, z_m: f64| {
        let distance = (((x_m - MIDDLE_M) / 4000.0).powi(2) + ((z_m - 3000.0) / 2000.0).powi(2)).sqrt();
        if distance < 1.0 {
            -7.5 * ((std::f64::consts::PI * distance).cos() + 1.0)
        } else {
            0.0
        }
    };
    let mut flow = Compressible::new(cells, cell_m, 75.0, 300.0, cold);
    let mut front_by_s = vec![[0.0, 0.0]];
    let what = format!("density current, compressible, {cell_m:.0} m");
    let done = flow.advance_to(END_S, |flow| {
        front_by_s.push([flow.seconds, front_m(&flow.excess_k()[..cells[0]], cell_m)]);
        (context.progress)(&what, flow.seconds, END_S)
    });
    if !done {
        return Err(ValidateError::Interrupted);
    }
    let excess = flow.excess_k();
    let [u, w] = flow.velocities_m_s();
    Ok(Run {
        cell_m,
        cells,
        front_m: front_m(&excess[..cells[0]], cell_m),
        front_by_s,
        u: extremes(&right_half(&u, cells[0])),
        w: extremes(&w),
        lopsided: lopsided(&excess, cells[0]),
        excess,
    })
}

/// The right half of each row.
fn right_half(values: &[f32], columns: usize) -> Vec<f32> {
    let rows = values.chunks_exact(columns);
    rows.flat_map(|row| row[columns / 2..].to_vec()).collect()
}

fn one(context: &Context, cell_m: f64) -> Result<Run, ValidateError> {
    let mut scene = presets::find("density-current")?;
    scene.domain.cells = [(2.0 * MIDDLE_M / cell_m) as u32, 1, (6400.0 / cell_m) as u32];
    scene.domain.cell_size_m = [cell_m; 3];
    let mut world = context.world(scene)?;
    let nx = world.parameters().grid.cells[0];
    let base = f64::from(world.parameters().base_heat_k[0]);
    let mut front_by_s = vec![[0.0, 0.0]];
    context.advance(&mut world, END_S, &format!("density current, {cell_m:.0} m"), |world| {
        let row = &field(world, Field::Heat)[..nx];
        front_by_s.push([world.simulated_s(), front_m(row, cell_m)]);
    })?;
    let excess: Vec<f32> = field(&world, Field::Heat).iter().map(|t| t - base as f32).collect();
    Ok(Run {
        cell_m,
        cells: [nx, world.parameters().grid.cells[2]],
        front_m: front_m(&excess[..nx], cell_m),
        front_by_s,
        u: extremes(&right_half(&field(&world, Field::VelocityX), nx)),
        w: extremes(&field(&world, Field::VelocityZ)),
        lopsided: lopsided(&excess, nx),
        excess,
    })
}

pub(super) fn run(context: &Context) -> Result<Findings, ValidateError> {
    let sizes: &[f64] = if context.quick {
        &[400.0, 200.0, 100.0]
    } else {
        &[400.0, 200.0, 100.0, 50.0]
    };
    let mut runs = Vec::new();
    for &size in sizes {
        runs.push(one(context, size)?);
    }
    let sizes: &[f64] = if context.quick {
        &[400.0]
    } else {
        &[400.0, 200.0, 100.0]
    };
    let mut truths = Vec::new();
    for &size in sizes {
        truths.push(compressible(context, size)?);
    }
    let mut figures = Vec::new();
    for run in &runs {
        let at = format!("{:.0} m", run.cell_m);
        let held = run.cell_m == 100.0;
        let aimed = |figure: Figure, aim: Aim| if held { figure.aimed(aim) } else { figure };
        let truth = truths.iter().find(|truth| truth.cell_m == run.cell_m);
        if let Some(truth) = truth {
            let published = Figure::beside(format!("front, compressible, {at}"), "m", truth.front_m, FRONT_M);
            figures.push(aimed(published, Aim::Within { distance: 250.0 }));
        }
        figures.push(Figure::beside(format!("front, {at}"), "m", run.front_m, FRONT_M));
        if let Some(truth) = truth {
            let beside = format!("front, {at}, beside the compressible one");
            figures.push(Figure::beside(beside, "m", run.front_m, truth.front_m));
            for (what, unit, ours, published) in [
                ("theta' min", "K", extremes(&truth.excess)[0], THETA_MIN_K),
                ("u max", "m/s", truth.u[1], U[1]),
                ("w max", "m/s", truth.w[1], W[1]),
                ("w min", "m/s", truth.w[0], W[0]),
            ] {
                figures.push(Figure::beside(
                    format!("{what}, compressible, {at}"),
                    unit,
                    ours,
                    published,
                ));
            }
        }
        figures.push(aimed(
            Figure::beside(format!("theta' min, {at}"), "K", extremes(&run.excess)[0], THETA_MIN_K),
            Aim::Within { distance: 0.5 },
        ));
        figures.push(aimed(
            Figure::alone(format!("asymmetry of theta', {at}"), "1", run.lopsided),
            Aim::Between { least: 0.0, most: 1e-4 },
        ));
        for (what, ours, published) in [
            ("u max", run.u[1], U[1]),
            ("u min", run.u[0], U[0]),
            ("w max", run.w[1], W[1]),
            ("w min", run.w[0], W[0]),
        ] {
            figures.push(Figure::beside(format!("{what}, {at}"), "m/s", ours, published));
        }
    }
    let fronts = runs.iter().map(|run| [run.cell_m, run.front_m]).collect();
    let compressible_fronts = truths.iter().map(|run| [run.cell_m, run.front_m]).collect();
    let converge = Chart {
        title: "Front after 900 s, by cell size".into(),
        axes: ["cell, m".into(), "front, m".into()],
        log: [true, false],
        series: vec![
            Series::line("here", 0, fronts).drawn(Mark::Dots),
            Series::line("compressible", 1, compressible_fronts).drawn(Mark::Dots),
            Series::line("published, 25 m", 6, vec![[25.0, FRONT_M], [400.0, FRONT_M]]).drawn(Mark::Dashes),
        ],
        bands: vec![[FRONT_M - 250.0, FRONT_M + 250.0]],
        legend: [false, true],
        ..Chart::default()
    };
    let course = Chart {
        title: "Front over time".into(),
        axes: ["simulated time, s".into(), "front, m".into()],
        series: runs
            .iter()
            .enumerate()
            .map(|(i, run)| Series::line(format!("{:.0} m", run.cell_m), i, run.front_by_s.clone()))
            .chain([Series::line("published at 900 s", 6, vec![[END_S, FRONT_M]]).drawn(Mark::Rings)])
            .collect(),
        legend: [false, false],
        ..Chart::default()
    };
    let mut panels = vec![Panel::Chart(converge), Panel::Chart(course)];
    for run in &runs {
        panels.push(picture(run));
    }
    let data = json!(
        runs.iter()
            .map(|r| json!({ "cell_size_m": r.cell_m, "front_m_by_s": r.front_by_s }))
            .collect::<Vec<_>>()
    );
    Ok(Findings {
        figures,
        notes: vec![
            "the published solution is compressible, ours anelastic; the compressible flow of the same case beside it is of fifth order as well, and \
             tells what of the difference is the anelastic equations'"
                .into(),
            "the box holds both halves; u's extremes are those of the right one".into(),
        ],
        data,
        plots: vec![Plot {
            name: "density-current".into(),
            png: plot::png(&panels, 2, [700, 330])?,
        }],
    })
}

/// The right half, as it is usually shown.
fn picture(run: &Run) -> Panel {
    let [nx, nz] = run.cells;
    let to = nx / 2 + (19_200.0 / run.cell_m) as usize;
    let top = (4800.0 / run.cell_m) as usize;
    let values: Vec<f32> = run
        .excess
        .chunks_exact(nx)
        .take(top.min(nz))
        .flat_map(|row| row[nx / 2..to].to_vec())
        .collect();
    Panel::Picture(Picture {
        title: format!("theta' after 900 s, {:.0} m, K", run.cell_m),
        axes: ["x, km".into(), "z, km".into()],
        extent: [[0.0, 19.2], [0.0, 4.8]],
        values,
        width: to - nx / 2,
        range: [-10.0, 0.0],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_found_between_cells() {
        // Cells of 12.8 km: centres at 6.4, 19.2, 32, 44.8 km. From -3 K to 1 K the excess is -1 K half way, at 38.4 km.
        assert_eq!(front_m(&[0.0, -5.0, -3.0, 1.0], 12_800.0), 12_800.0);
        assert_eq!(front_m(&[0.0; 4], 12_800.0), 0.0);
    }
}
