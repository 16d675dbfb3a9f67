//! Error beside cost, one panel a case and ladder; an error of less than 1e-6 is drawn there.

use super::Report;
use crate::plot::{self, Chart, Mark, Panel, PlotError, Series};

/// The plot as PNG. Errors: [`PlotError`].
pub fn png(report: &Report) -> Result<Vec<u8>, PlotError> {
    let mut panels = Vec::new();
    for case in &report.cases {
        let mut ladders: Vec<&str> = Vec::new();
        for row in &case.rows {
            if !ladders.contains(&row.ladder) {
                ladders.push(row.ladder);
            }
        }
        for ladder in ladders {
            let rows = || case.rows.iter().filter(|r| r.ladder == ladder);
            let point = |ms: Option<f64>, error: Option<f64>| ms.zip(error).map(|(ms, error)| [ms, error.max(1e-6)]);
            let all: Vec<[f64; 2]> = rows().filter_map(|r| point(r.ms_per_tick, r.error)).collect();
            let mut front: Vec<[f64; 2]> = rows()
                .filter(|r| r.pareto)
                .filter_map(|r| point(r.ms_per_tick, r.error))
                .collect();
            front.sort_by(|a, b| a[0].total_cmp(&b[0]));
            let mut notes: Vec<([f64; 2], String)> = rows()
                .filter_map(|r| point(r.ms_per_tick, r.error).map(|at| (at, r.rung.clone())))
                .collect();
            notes.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
            let mut series = vec![
                Series::line("", 0, all).drawn(Mark::Dots),
                Series::line("", 1, front.clone()).drawn(Mark::Rings),
                Series::line("Pareto front", 1, front).drawn(Mark::Dashes),
            ];
            if let Some(chance) = case.chance {
                let ends = [0, 1].map(|end| {
                    let costs = || rows().filter_map(|r| r.ms_per_tick);
                    let cost = if end == 0 {
                        costs().fold(f64::INFINITY, f64::min)
                    } else {
                        costs().fold(0.0, f64::max)
                    };
                    [cost, chance]
                });
                series.push(Series::line("chance", 6, ends.to_vec()).drawn(Mark::Dashes));
            }
            panels.push(Panel::Chart(Chart {
                title: format!("{}: {ladder}", case.case),
                axes: [
                    format!("ms a tick of {:.0} s", case.tick_s),
                    case.error.split(" (").next().unwrap_or_default().to_owned(),
                ],
                log: [true, true],
                series,
                notes,
                legend: [false, true],
                ..Chart::default()
            }));
        }
    }
    plot::png(&panels, 2, [760, 470])
}
