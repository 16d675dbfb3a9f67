//! The two bubbles of Bryan and Fritsch (2002): dry, and inside a saturated neutral cloud.
//!
//! The scalar of the moist case is equivalent potential temperature. Ours is that of the reference's formula, after the air has been
//! brought to 1000 hPa along the simulation's own reversible adiabat: the simulation neglects the heat capacity of water, so the
//! formula taken in place would drift by 4 K over the box's height in air that has only moved.

use rayon::prelude::*;
use serde_json::json;
use welkin_proto::presets;
use welkin_shaders::catalogue::Field;

use super::{Aim, Context, Figure, Findings, Plot, ValidateError, extremes, field, lopsided};
use crate::base_state;
use crate::plot::{self, Chart, Mark, Panel, Picture, Series};
use crate::world::World;

/// When the reference is taken, s.
const END_S: f64 = 1000.0;
/// The reference's cell size, m.
const REFERENCE_M: f64 = 100.0;
/// Runge-Kutta steps that bring air to 1000 hPa.
const DESCENT_STEPS: usize = 24;

struct Published {
    scalar: [f64; 2],
    w: [f64; 2],
    /// Share of the published largest w that ours may differ by.
    share: f64,
}

/// One run.
struct Run {
    cell_m: f64,
    cells: [usize; 2],
    scalar: Vec<f32>,
    w: Vec<f32>,
    lopsided: [f64; 2],
    updraught: Vec<[f64; 2]>,
}

pub(super) fn dry(context: &Context) -> Result<Findings, ValidateError> {
    let published = Published {
        scalar: [-0.1444, 2.0718],
        w: [-8.58, 14.54],
        share: 0.05,
    };
    both(context, "dry-bubble", "theta'", published, dry_scalar)
}

pub(super) fn moist(context: &Context) -> Result<Findings, ValidateError> {
    let published = Published {
        scalar: [-0.306, 4.095],
        w: [-9.93, 15.71],
        share: 0.08,
    };
    both(context, "moist-bubble", "theta_e'", published, moist_scalar)
}

fn dry_scalar(world: &World) -> Vec<f32> {
    let base = &world.parameters().base_heat_k;
    let plane = world.parameters().grid.plane();
    let heat = field(world, Field::Heat);
    heat.iter().enumerate().map(|(i, t)| t - base[i / plane]).collect()
}

fn moist_scalar(world: &World) -> Vec<f32> {
    let p = world.parameters();
    let (plane, reference) = (p.grid.plane(), f64::from(p.heat_reference_k));
    let (heat, water) = (field(world, Field::Heat), field(world, Field::Water));
    let exner = &world.base_state().exner;
    let at_ground = |exner: f64, theta_l: f64, water: f64| {
        let theta_l = base_state::theta_l_after_ascent(exner, 1.0, theta_l, water, DESCENT_STEPS);
        let (temperature_k, ..) = base_state::cloudy_air(1.0, theta_l, water);
        base_state::reversible_equivalent_potential_temperature_k(1e5, temperature_k, water / (1.0 - water))
    };
    let base = world.base_state();
    let still: Vec<f64> = base
        .liquid_water_potential_temperature_k
        .iter()
        .zip(&base.total_water_kg_per_kg)
        .enumerate()
        .map(|(z, (theta_l, water))| at_ground(exner[z], *theta_l, *water))
        .collect();
    (0..heat.len())
        .into_par_iter()
        .map(|i| {
            let z = i / plane;
            (at_ground(exner[z], reference + f64::from(heat[i]), f64::from(water[i])) - still[z]) as f32
        })
        .collect()
}

fn one(context: &Context, preset: &str, cell_m: f64, scalar: fn(&World) -> Vec<f32>) -> Result<Run, ValidateError> {
    let mut scene = presets::find(preset)?;
    let finer = REFERENCE_M / cell_m;
    for axis in [0, 2] {
        scene.domain.cells[axis] = (f64::from(scene.domain.cells[axis]) * finer).round() as u32;
    }
    scene.domain.cell_size_m = [cell_m; 3];
    let mut world = context.world(scene)?;
    let mut updraught = vec![[0.0, 0.0]];
    let what = format!("{preset}, {cell_m:.0} m");
    context.advance(&mut world, END_S, &what, |world| {
        updraught.push([world.simulated_s(), world.numbers().updraught_max_m_s]);
    })?;
    let cells = [world.parameters().grid.cells[0], world.parameters().grid.cells[2]];
    let (scalar, w) = (scalar(&world), field(&world, Field::VelocityZ));
    Ok(Run {
        cell_m,
        cells,
        lopsided: [lopsided(&scalar, cells[0]), lopsided(&w, cells[0])],
        scalar,
        w,
        updraught,
    })
}

fn both(
    context: &Context,
    preset: &str,
    name: &str,
    published: Published,
    scalar: fn(&World) -> Vec<f32>,
) -> Result<Findings, ValidateError> {
    let sizes: &[f64] = if context.quick {
        &[200.0, 100.0]
    } else {
        &[200.0, 100.0, 50.0]
    };
    let mut runs = Vec::new();
    for &size in sizes {
        runs.push(one(context, preset, size, scalar)?);
    }
    let mut figures = Vec::new();
    for run in &runs {
        let at = format!("{:.0} m", run.cell_m);
        let held = run.cell_m == REFERENCE_M;
        let ([least, most], [down, up]) = (extremes(&run.scalar), extremes(&run.w));
        let updraught = Figure::beside(format!("w max, {at}"), "m/s", up, published.w[1]);
        figures.push(if held {
            updraught.aimed(Aim::WithinShare { share: published.share })
        } else {
            updraught
        });
        figures.push(Figure::beside(format!("w min, {at}"), "m/s", down, published.w[0]));
        figures.push(Figure::beside(
            format!("{name} max, {at}"),
            "K",
            most,
            published.scalar[1],
        ));
        figures.push(Figure::beside(
            format!("{name} min, {at}"),
            "K",
            least,
            published.scalar[0],
        ));
        for (what, value) in [(name, run.lopsided[0]), ("w", run.lopsided[1])] {
            let figure = Figure::alone(format!("asymmetry of {what}, {at}"), "1", value);
            figures.push(if held {
                figure.aimed(Aim::Between { least: 0.0, most: 1e-4 })
            } else {
                figure
            });
        }
    }
    let series = runs
        .iter()
        .enumerate()
        .map(|(i, run)| Series::line(format!("{:.0} m", run.cell_m), i, run.updraught.clone()));
    let chart = Chart {
        title: format!("{preset}: largest updraught"),
        axes: ["simulated time, s".into(), "w, m/s".into()],
        legend: [true, true],
        series: series
            .chain([Series::line("published at 1000 s", 6, vec![[END_S, published.w[1]]]).drawn(Mark::Rings)])
            .collect(),
        ..Chart::default()
    };
    let mut panels = vec![Panel::Chart(chart)];
    let shown = runs.iter().find(|r| r.cell_m == REFERENCE_M);
    if let Some(run) = shown {
        panels.push(picture(run, &run.scalar, format!("{name} at 1000 s, 100 m, K")));
        panels.push(picture(run, &run.w, "w at 1000 s, 100 m, m/s".into()));
    }
    let data = json!(
        runs.iter()
            .map(|run| json!({ "cell_size_m": run.cell_m, "updraught_max_by_s": run.updraught }))
            .collect::<Vec<_>>()
    );
    Ok(Findings {
        figures,
        notes: vec![
            "the reference is fully compressible; ours is anelastic: what refinement does not remove is the difference between the two \
             sets of equations and between the advection schemes"
                .into(),
            "WENO faces cap the scalar's overshoots that the reference's linear scheme shows: its extremes are not an aim".into(),
        ],
        data,
        plots: vec![Plot {
            name: preset.to_owned(),
            png: plot::png(&panels, 3, [560, 400])?,
        }],
    })
}

/// The middle of a field, where the bubble is.
fn picture(run: &Run, values: &[f32], title: String) -> Panel {
    let [nx, nz] = run.cells;
    let (from, to) = (nx / 4, nx - nx / 4);
    let values: Vec<f32> = values.chunks_exact(nx).flat_map(|row| row[from..to].to_vec()).collect();
    let [low, high] = extremes(&values);
    let km = |cells: usize| cells as f64 * run.cell_m / 1000.0;
    Panel::Picture(Picture {
        title,
        axes: ["x, km".into(), "z, km".into()],
        extent: [[km(from), km(to)], [0.0, km(nz)]],
        values,
        width: to - from,
        range: [low.min(-0.05 * high), high],
    })
}
