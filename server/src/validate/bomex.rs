//! BOMEX, shallow cumulus (Siebesma et al. 2003): six hours, judged over the last three.
//!
//! Published ranges: projected cover 8 to 17 %, largest cloud fraction about 6 % near base, base 500 to 600 m, tops 1.5 to 2 km, liquid
//! water path about 4 to 10 g/m2. The case is made to be steady: fluxes, subsidence, radiation and drying balance, so that mean profiles
//! stay near those of the start. How near (0.5 K, 0.7 g/kg below 1300 m, 1.5 m/s above the layer that the ground slows) is general knowledge of the intercomparison's figures,
//! not digitised from them, and therefore wide.

use serde_json::json;
use welkin_proto::presets;
use welkin_shaders::catalogue::Field;

use super::{Aim, Context, Figure, Findings, Plot, ValidateError, field};
use crate::plot::{self, Chart, Mark, Panel, Series};
use crate::world::World;

/// Ticks of a run that nobody watches are 20 s; profiles are taken at every third.
const PROFILE_EVERY: usize = 3;
/// Cloud water that counts as cloud, kg/kg; as in the cover that the world reports.
const CLOUDY_KG_PER_KG: f32 = 1e-6;

#[derive(Default)]
struct History {
    time_s: Vec<f64>,
    cover: Vec<f64>,
    path_g_m2: Vec<f64>,
    base_m: Vec<Option<f64>>,
    top_m: Vec<Option<f64>>,
}

/// Sums over samples, by level.
struct Profiles {
    samples: usize,
    sums: [Vec<f64>; 6],
}

const NAMES: [&str; 6] = [
    "liquid_water_potential_temperature_k",
    "total_water_kg_per_kg",
    "wind_x_m_s",
    "wind_y_m_s",
    "cloud_water_kg_per_kg",
    "cloud_fraction",
];

impl Profiles {
    fn new(levels: usize) -> Self {
        Self {
            samples: 0,
            sums: std::array::from_fn(|_| vec![0.0; levels]),
        }
    }

    fn add(&mut self, world: &World) {
        let p = world.parameters();
        let plane = p.grid.plane();
        let fields = [
            Field::Heat,
            Field::Water,
            Field::VelocityX,
            Field::VelocityY,
            Field::CloudWater,
        ];
        for (i, which) in fields.into_iter().enumerate() {
            let values = field(world, which);
            for (sum, level) in self.sums[i].iter_mut().zip(values.chunks_exact(plane)) {
                let mean = level.iter().map(|&v| f64::from(v)).sum::<f64>() / plane as f64;
                *sum += mean + if i == 0 { f64::from(p.heat_reference_k) } else { 0.0 };
            }
            if which == Field::CloudWater {
                for (sum, level) in self.sums[5].iter_mut().zip(values.chunks_exact(plane)) {
                    *sum += level.iter().filter(|&&q| q > CLOUDY_KG_PER_KG).count() as f64 / plane as f64;
                }
            }
        }
        self.samples += 1;
    }

    fn mean(&self, which: usize) -> Vec<f64> {
        self.sums[which]
            .iter()
            .map(|s| s / self.samples.max(1) as f64)
            .collect()
    }
}

pub(super) fn run(context: &Context) -> Result<Findings, ValidateError> {
    let mut scene = presets::find("fair-weather-cumulus")?;
    let (end_s, from_s) = if context.quick {
        scene.domain.cells = [32, 32, 75];
        (7200.0, 3600.0)
    } else {
        (21_600.0, 10_800.0)
    };
    let mut world = context.world(scene)?;
    let levels = world.parameters().grid.cells[2];
    let heights: Vec<f64> = (0..levels)
        .map(|z| world.parameters().grid.centre_height_m(z))
        .collect();
    let mut start = Profiles::new(levels);
    start.add(&world);
    let (mut late, mut series, mut ticks) = (Profiles::new(levels), History::default(), 0);
    context.advance(&mut world, end_s, "bomex", |world| {
        let numbers = world.numbers();
        series.time_s.push(numbers.simulated_s);
        series.cover.push(100.0 * numbers.cloud_cover.unwrap_or(0.0));
        series
            .path_g_m2
            .push(1000.0 * numbers.liquid_water_path_kg_m2.unwrap_or(0.0));
        series.base_m.push(numbers.cloud_base_m);
        series.top_m.push(numbers.cloud_top_m);
        ticks += 1;
        if numbers.simulated_s > from_s && ticks % PROFILE_EVERY == 0 {
            late.add(world);
        }
    })?;

    let after = |values: &[f64]| {
        let late: Vec<f64> = series
            .time_s
            .iter()
            .zip(values)
            .filter(|(t, _)| **t > from_s)
            .map(|(_, v)| *v)
            .collect();
        late.iter().sum::<f64>() / late.len() as f64
    };
    let there = |values: &[Option<f64>]| {
        let late: Vec<f64> = series
            .time_s
            .iter()
            .zip(values)
            .filter(|(t, _)| **t > from_s)
            .filter_map(|(_, v)| *v)
            .collect();
        late.iter().sum::<f64>() / late.len() as f64
    };
    let fraction: Vec<f64> = late.mean(5).iter().map(|f| 100.0 * f).collect();
    let (most_at, most) = fraction
        .iter()
        .enumerate()
        .fold((0, 0.0), |best, (z, f)| if *f > best.1 { (z, *f) } else { best });
    // The short form's hour is not the published ones: its figures are shown and not judged.
    let between = |what: &str, unit, ours, least, most| {
        let figure = Figure::alone(what, unit, ours);
        if context.quick {
            figure
        } else {
            figure.aimed(Aim::Between { least, most })
        }
    };
    let mut figures = vec![
        between("projected cloud cover, mean", "%", after(&series.cover), 8.0, 17.0),
        between("largest cloud fraction of a level, mean", "%", most, 4.0, 8.0),
        between(
            "height of the largest cloud fraction",
            "m",
            heights[most_at],
            500.0,
            800.0,
        ),
        between(
            "cloud base (lowest cloudy cell), mean",
            "m",
            there(&series.base_m),
            500.0,
            600.0,
        ),
        between(
            "cloud top (highest cloudy cell), mean",
            "m",
            there(&series.top_m),
            1500.0,
            2000.0,
        ),
        between("liquid water path, mean", "g/m2", after(&series.path_g_m2), 4.0, 10.0),
    ];
    let drift = |which: usize, above_m: f64, below_m: f64| {
        let (was, is) = (start.mean(which), late.mean(which));
        (0..levels)
            .filter(|&z| (above_m..below_m).contains(&heights[z]))
            .map(|z| (is[z] - was[z]).abs())
            .fold(0.0, f64::max)
    };
    figures.push(between(
        "largest drift of mean theta_l below 1300 m",
        "K",
        drift(0, 0.0, 1300.0),
        0.0,
        0.5,
    ));
    figures.push(between(
        "largest drift of mean q_t below 1300 m",
        "g/kg",
        1000.0 * drift(1, 0.0, 1300.0),
        0.0,
        0.7,
    ));
    figures.push(between(
        "largest drift of mean u above 300 m",
        "m/s",
        drift(2, 300.0, 3000.0),
        0.0,
        1.5,
    ));

    let profile = |label: &str, colour, values: Vec<f64>, scale: f64| {
        Series::line(
            label,
            colour,
            values.iter().zip(&heights).map(|(v, z)| [scale * v, *z]).collect(),
        )
    };
    let pair = |which: usize, title: &str, unit: &str, scale: f64| {
        Panel::Chart(Chart {
            title: title.into(),
            axes: [unit.into(), "height, m".into()],
            series: vec![
                profile("start", 6, start.mean(which), scale).drawn(Mark::Dashes),
                profile("mean of the second half", 0, late.mean(which), scale),
            ],
            ..Chart::default()
        })
    };
    let time = |title: &str, unit: &str, values: &[f64], band: [f64; 2]| {
        let points = series
            .time_s
            .iter()
            .zip(values)
            .map(|(t, v)| [t / 3600.0, *v])
            .collect();
        Panel::Chart(Chart {
            title: title.into(),
            axes: ["simulated time, h".into(), unit.into()],
            series: vec![Series::line("", 0, points)],
            bands: vec![band],
            ..Chart::default()
        })
    };
    let panels = [
        time(
            "Projected cloud cover; shaded: published",
            "%",
            &series.cover,
            [8.0, 17.0],
        ),
        time(
            "Liquid water path; shaded: published",
            "g/m2",
            &series.path_g_m2,
            [4.0, 10.0],
        ),
        Panel::Chart(Chart {
            title: "Cloud fraction, mean of the second half".into(),
            axes: ["%".into(), "height, m".into()],
            series: vec![profile("", 0, fraction.clone(), 1.0)],
            bands: vec![[500.0, 600.0], [1500.0, 2000.0]],
            ..Chart::default()
        }),
        pair(0, "Liquid-water potential temperature", "theta_l, K", 1.0),
        pair(1, "Total water", "q_t, g/kg", 1000.0),
        pair(2, "Wind towards the east", "u, m/s", 1.0),
    ];
    let profiles: serde_json::Map<String, serde_json::Value> = NAMES
        .iter()
        .enumerate()
        .map(|(i, name)| {
            (
                (*name).to_owned(),
                json!({ "start": start.mean(i), "mean": late.mean(i) }),
            )
        })
        .collect();
    let mut notes = vec![
        "base and top are those of the single lowest and highest cloudy cell (above 1e-6 kg/kg) of a moment, averaged over time".to_owned(),
        "the bounds of theta_l, q_t and u are general knowledge of the case, not digitised".to_owned(),
    ];
    if context.quick {
        notes.push(
            "short: 32 x 32 columns, the second of two hours; the published figures are for the last three of six"
                .to_owned(),
        );
    }
    Ok(Findings {
        figures,
        notes,
        data: json!({
            "height_m": heights, "profiles": profiles,
            "time_s": series.time_s, "cloud_cover_percent": series.cover, "liquid_water_path_g_m2": series.path_g_m2,
            "cloud_base_m": series.base_m, "cloud_top_m": series.top_m,
        }),
        plots: vec![Plot {
            name: "bomex".into(),
            png: plot::png(&panels, 3, [520, 400])?,
        }],
    })
}
