//! The wind tunnel of seed 004 (chapter 7): 100 x 40 x 40 cells, a fan, a cloud that drifts, and a guide point that goes with the air.
//!
//! The seed prints pictures and no figures, so nothing is published to stand beside ours. What can be held: that the fan's air comes nearer to the speed at
//! which its push and its drag balance and not past it; and that what guides the cloud stays with it. The seed moves a guide point by the wind at one point
//! (its equation 7.13, which lacks the time step). One point leaves its cloud as soon as the cloud's own air turns over; the mean wind of the cloud's
//! water, by which published clouds move their detail, does not. And: what the seed's solver costs and misses beside flux form with the direct solver.

use serde_json::json;
use welkin_proto::presets;
use welkin_proto::scene::{Advection, Pressure};
use welkin_shaders::catalogue::Field;

use super::{Aim, Context, Figure, Findings, Plot, ValidateError, field};
use crate::plot::{self, Chart, Mark, Panel, Picture, Series};
use crate::sample::Stencil;
use crate::world::World;

/// How long the tunnel runs, s.
const END_S: f64 = 600.0;
/// The mean wind of the water may part from the water by this share of its way: fluxes and means over cells differ, ticks are 20 s long.
const PARTING_SHARE: f64 = 0.1;

struct Run {
    name: &'static str,
    guide_m: Vec<[f64; 2]>,
    mean_m: Vec<[f64; 2]>,
    cloud_m: Vec<[f64; 2]>,
    fan_m_s: Vec<[f64; 2]>,
    /// Mean over the box, along x.
    stream_m_s: f64,
    divergence_per_s: f64,
    substeps: u32,
    wall_ms: f64,
    slice: Vec<f32>,
    cells: [usize; 3],
    cell_m: f64,
    fan_balance_m_s: f64,
}

/// A point that the air carries.
struct Guide {
    at_m: [f64; 3],
    gone_m: f64,
}

impl Guide {
    /// Goes with the wind for `seconds`: the midpoint rule in space, the newest wind in time.
    fn drift(&mut self, world: &World, seconds: f64) {
        let grid = world.parameters().grid;
        let components = [Field::VelocityX, Field::VelocityY, Field::VelocityZ].map(|f| field(world, f));
        let wind = |at_m: [f64; 3]| {
            [0, 1, 2].map(|axis| {
                // A component lies half a cell before the centres along its own axis.
                let mut as_if_m = at_m;
                as_if_m[axis] += 0.5 * f64::from(grid.cell_size_m[axis]);
                Stencil::new(&grid, as_if_m).mean(&components[axis])
            })
        };
        let here = wind(self.at_m);
        let middle = wind([0, 1, 2].map(|a| self.at_m[a] + 0.5 * seconds * here[a]));
        self.gone_m += seconds * middle[0];
        self.at_m = [0, 1, 2].map(|a| self.at_m[a] + seconds * middle[a]);
    }
}

/// The water above the base state's: where it lies along x, as an angle about the periodic box, m, and its mean wind along x, m/s.
fn water_along_x(world: &World) -> [f64; 2] {
    let grid = world.parameters().grid;
    let (water, u) = (field(world, Field::Water), field(world, Field::VelocityX));
    let base = &world.base_state().total_water_kg_per_kg;
    let (nx, size_m) = (grid.cells[0], f64::from(grid.size_m()[0]));
    let (mut sums, mut carried, mut all) = ([0.0; 2], 0.0, 0.0);
    for (i, q) in water.iter().enumerate() {
        // A gram a kilogram: the bubble, not what the ground evaporates.
        let more = (f64::from(*q) - base[i / grid.plane()] - 1e-3).max(0.0);
        let east = if i % nx + 1 == nx { i + 1 - nx } else { i + 1 };
        let angle = 2.0 * std::f64::consts::PI * ((i % nx) as f64 + 0.5) / nx as f64;
        sums = [sums[0] + more * angle.cos(), sums[1] + more * angle.sin()];
        carried += more * 0.5 * f64::from(u[i] + u[east]);
        all += more;
    }
    let turn = 2.0 * std::f64::consts::PI;
    [
        sums[1].atan2(sums[0]).rem_euclid(turn) / turn * size_m,
        carried / all.max(1e-30),
    ]
}

fn one(context: &Context, name: &'static str, seed: bool) -> Result<Run, ValidateError> {
    let mut scene = presets::find("wind-tunnel")?;
    if !seed {
        scene.methods.advection = Some(Advection::FluxForm);
        scene.methods.pressure = Some(Pressure::Direct {});
        if let Some(flow) = &mut scene.effects.flow {
            flow.courant_max = 1.0;
        }
    }
    let bubble = scene.effects.bubble.clone();
    let fan = scene.effects.body_force.clone();
    let end_s = if context.quick { 0.2 * END_S } else { END_S };
    let mut world = context.world(scene)?;
    let grid = world.parameters().grid;
    let size_m = f64::from(grid.size_m()[0]);
    let mut guide = Guide {
        at_m: bubble.map_or([0.0; 3], |b| b.centre_m),
        gone_m: 0.0,
    };
    let [mut last_m, mut last_m_s] = water_along_x(&world);
    let (mut gone_m, mut mean_gone_m, mut last_s) = (0.0, 0.0, 0.0);
    let [mut guide_m, mut mean_m, mut cloud_m] = [(); 3].map(|()| vec![[0.0; 2]]);
    let mut fan_m_s = Vec::new();
    let (mut substeps, mut wall_ms) = (0, 0.0);
    let fan_cells = fan
        .as_ref()
        .map_or(0, |f| (f.upper_m[0] / f64::from(grid.cell_size_m[0])) as usize);
    let mean_x = |world: &World, cells: usize| {
        let rows = field(world, Field::VelocityX);
        let rows = rows.chunks_exact(grid.cells[0]);
        let sum: f64 = rows.flat_map(|row| &row[..cells]).map(|&u| f64::from(u)).sum();
        sum / (cells * grid.cells[1] * grid.cells[2]) as f64
    };
    context.advance(&mut world, end_s, &format!("wind tunnel, {name}"), |world| {
        let now_s = world.simulated_s();
        guide.drift(world, now_s - last_s);
        let [here_m, here_m_s] = water_along_x(world);
        gone_m += (here_m - last_m + 0.5 * size_m).rem_euclid(size_m) - 0.5 * size_m;
        mean_gone_m += 0.5 * (last_m_s + here_m_s) * (now_s - last_s);
        (last_m, last_m_s, last_s) = (here_m, here_m_s, now_s);
        guide_m.push([now_s, guide.gone_m]);
        mean_m.push([now_s, mean_gone_m]);
        cloud_m.push([now_s, gone_m]);
        fan_m_s.push([now_s, mean_x(world, fan_cells)]);
        let numbers = world.numbers();
        substeps += numbers.substeps;
        wall_ms += numbers.tick_ms;
    })?;
    let row = grid.cells[1] / 2;
    let water = field(&world, Field::Water);
    let base = &world.base_state().total_water_kg_per_kg;
    let slice = (0..grid.cells[2])
        .flat_map(|z| {
            let at = grid.index(0, row, z);
            let less = base[z] as f32;
            water[at..at + grid.cells[0]]
                .iter()
                .map(move |q| 1e3 * (q - less))
                .collect::<Vec<_>>()
        })
        .collect();
    Ok(Run {
        name,
        guide_m,
        mean_m,
        cloud_m,
        fan_m_s,
        stream_m_s: mean_x(&world, grid.cells[0]),
        divergence_per_s: world.numbers().divergence_max_per_s,
        substeps,
        wall_ms,
        slice,
        cells: grid.cells,
        cell_m: f64::from(grid.cell_size_m[0]),
        fan_balance_m_s: fan.map_or(f64::NAN, |f| f.acceleration_m_s2[0] / f.drag_per_s),
    })
}

fn last(series: &[[f64; 2]]) -> f64 {
    series.last().map_or(f64::NAN, |point| point[1])
}

pub(super) fn run(context: &Context) -> Result<Findings, ValidateError> {
    let runs = [
        one(context, "the seed's solver", true)?,
        one(context, "flux form, direct", false)?,
    ];
    let mut figures = Vec::new();
    for run in &runs {
        let of = |what: &str| format!("{what}, {}", run.name);
        let (mean, cloud) = (last(&run.mean_m), last(&run.cloud_m));
        figures.push(Figure::alone(of("way of the cloud's water"), "m", cloud));
        figures.push(Figure::alone(
            of("way by the wind at one point"),
            "m",
            last(&run.guide_m),
        ));
        figures.push(Figure::alone(of("way by the mean wind of the water"), "m", mean));
        let parted = (mean - cloud).abs() / cloud.abs().max(run.cell_m);
        figures.push(
            Figure::alone(of("how far the mean wind parts from the water"), "1", parted).aimed(Aim::Between {
                least: 0.0,
                most: PARTING_SHARE,
            }),
        );
        figures.push(
            Figure::alone(
                of("air in the fan over what balances it"),
                "1",
                last(&run.fan_m_s) / run.fan_balance_m_s,
            )
            .aimed(Aim::Between { least: 0.0, most: 1.0 }),
        );
        figures.push(Figure::alone(of("mean stream"), "m/s", run.stream_m_s));
        figures.push(Figure::alone(of("divergence left"), "1/s", run.divergence_per_s));
        figures.push(Figure::alone(
            of("wall time a substep"),
            "ms",
            run.wall_ms / f64::from(run.substeps),
        ));
        figures.push(Figure::alone(of("wall time in all"), "s", 1e-3 * run.wall_ms));
    }
    let ways = runs.iter().enumerate().flat_map(|(i, run)| {
        [
            Series::line(format!("water, {}", run.name), i, run.cloud_m.clone()),
            Series::line(format!("mean wind of the water, {}", run.name), i, run.mean_m.clone()).drawn(Mark::Dashes),
            Series::line(format!("one point, {}", run.name), 2 + i, run.guide_m.clone()),
        ]
    });
    let fans = runs.iter().enumerate();
    let mut panels = vec![
        Panel::Chart(Chart {
            title: "Way along the tunnel".into(),
            axes: ["simulated time, s".into(), "m".into()],
            series: ways.collect(),
            legend: [false, false],
            ..Chart::default()
        }),
        Panel::Chart(Chart {
            title: "Air in the fan".into(),
            axes: ["simulated time, s".into(), "m/s".into()],
            series: fans
                .map(|(i, run)| Series::line(run.name, i, run.fan_m_s.clone()))
                .collect(),
            legend: [false, false],
            ..Chart::default()
        }),
    ];
    for run in &runs {
        let km = |n: usize| 1e-3 * n as f64 * run.cell_m;
        panels.push(Panel::Picture(Picture {
            title: format!("Water above the base state's, g/kg, {}", run.name),
            axes: ["x, km".into(), "z, km".into()],
            extent: [[0.0, km(run.cells[0])], [0.0, km(run.cells[2])]],
            values: run.slice.clone(),
            width: run.cells[0],
            range: [0.0, 4.0],
        }));
    }
    let data = json!(
        runs.iter()
            .map(|r| json!({ "run": r.name, "one_point_m_by_s": r.guide_m, "mean_wind_m_by_s": r.mean_m, "water_m_by_s": r.cloud_m, "fan_m_s_by_s": r.fan_m_s }))
            .collect::<Vec<_>>()
    );
    Ok(Findings {
        figures,
        notes: vec![
            "seed 004 prints no figures of its tunnel; what is held are the guide of the cloud and the fan's balance"
                .into(),
            "water counts where it exceeds the base state's by a gram a kilogram".into(),
        ],
        data,
        plots: vec![Plot {
            name: "wind-tunnel".into(),
            png: plot::png(&panels, 2, [700, 330])?,
        }],
    })
}
