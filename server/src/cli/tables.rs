//! `welkin tables`.

use std::path::PathBuf;
use std::sync::atomic::Ordering;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use welkin_shaders::cpu::light::slab_photons::SET_BEGINS;
use welkin_shaders::cpu::light::slab_tables::{ASYMMETRIES, CASES, SUNS, THICKNESSES, case};

use super::{Failure, Outcome, columns, interrupt_flag, print_line, write_file};
use crate::tables::{FLIGHTS, Made, Order, SEED, Summary, TablesError, make};

pub(super) const EXAMPLES: &str = "\
What it does: light enters a level slab of cloud from one side; photons are followed until they leave. For 4 asymmetries of
the phase function, 8 heights of the sun and 12 thicknesses it notes, in 14 layers and for each set of orders of scattering
(2, 3, 4, 5-6, 7-9, 10-15, 16 and more), how much light is there, where it heads and where it came in. The method
`slab` of scattering reads these tables. It prints what slabs send back, set by set, and the standard errors.

Examples:
  welkin tables --out slab-tables.bin            the tables that this program holds, byte for byte; some minutes of a core
  welkin tables --flights 20000 --out rough.bin  a hundredth of a second a slab: rough
  welkin tables --parts study.parts --out slab-tables.bin    interrupt it, run it again: it goes on";

#[derive(Args)]
pub(super) struct Options {
    /// File for the tables.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// File where finished slabs are kept, and found again by the next run of the same study.
    #[arg(long, value_name = "FILE")]
    parts: Option<PathBuf>,
    /// Flights between two scatterings that are followed in each slab; four times as many halve the errors.
    #[arg(long, value_name = "N", default_value_t = FLIGHTS, value_parser = clap::value_parser!(u64).range(1_000..=1_000_000_000_000))]
    flights: u64,
    /// Seed of the random numbers.
    #[arg(long, value_name = "N", default_value_t = SEED)]
    seed: u64,
    /// Worker threads; as many as the machine has cores unless given. They change no bit.
    #[arg(long, value_name = "N")]
    threads: Option<std::num::NonZeroUsize>,
}

pub(super) fn run(options: Options) -> Result<Outcome, Failure> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(options.threads.map_or(0, Into::into));
    let pool = pool
        .build()
        .map_err(|error| Failure(format!("cannot start threads: {error}")))?;
    let interrupted = interrupt_flag();
    let bar = ProgressBar::new(CASES as u64);
    if let Ok(style) = ProgressStyle::with_template("slabs [{bar:40}] {pos}/{len}, {elapsed} gone, {eta} to go") {
        bar.set_style(style.progress_chars("=> "));
    }
    let progress = |done: usize, _: usize| {
        bar.set_position(done as u64);
        !interrupted.load(Ordering::Relaxed)
    };
    let order = Order {
        flights: options.flights,
        seed: options.seed,
    };
    let made = pool.install(|| make(&order, options.parts.as_deref(), &progress));
    bar.finish_and_clear();
    let made = match made {
        Ok(made) => made,
        Err(TablesError::Interrupted) => return Ok(Outcome::Interrupted),
        Err(error) => return Err(Failure(error.to_string())),
    };
    write_file(&options.out, &made.file)?;
    print_line(table(&made).trim_end())?;
    print_line(&format!("{}: {} bytes", options.out.display(), made.file.len()))?;
    Ok(Outcome::Done)
}

fn table(made: &Made) -> String {
    let mut text = String::from("share of the flux sent back, with its standard error, and by orders of scattering\n");
    let names = SET_BEGINS.windows(2).map(|pair| {
        if pair[1] - pair[0] == 1 {
            pair[0].to_string()
        } else {
            format!("{}-{}", pair[0], pair[1] - 1)
        }
    });
    let mut head = ["G", "MU0", "DEPTH", "BACK", "+-", "PASSES", "FLUENCE +-", "WORST", "1"]
        .map(str::to_owned)
        .to_vec();
    head.extend(names);
    head.push(format!("{}+", SET_BEGINS[SET_BEGINS.len() - 1]));
    let mut rows = vec![row(head)];
    for n in 0..CASES {
        let (sun, thickness) = (n / THICKNESSES % SUNS, n % THICKNESSES);
        // Every other thickness under two suns; errors are of all.
        if ![SUNS / 2 - 1, SUNS - 1].contains(&sun) || thickness.is_multiple_of(2) {
            continue;
        }
        let (asymmetry, slab) = case(n);
        let Summary {
            reflected,
            transmitted,
            reflected_sets,
            fluence_error,
            ..
        } = made.slabs[n];
        let mut cells = vec![
            asymmetry.to_string(),
            slab.sun_cosine.to_string(),
            format!("{:.3}", slab.optical_depth),
            format!("{:.4}", reflected[0]),
            format!("{:.4}", reflected[1]),
            format!("{:.4}", transmitted[0]),
            format!("{:.4}", fluence_error[0]),
            format!("{:.3}", fluence_error[1]),
        ];
        cells.extend(reflected_sets.map(|v| format!("{v:.4}")));
        rows.push(row(cells));
    }
    text += &columns(rows, [true; 16]);
    let photons: u64 = made.slabs.iter().map(|s| s.photons).sum();
    text += &format!("{CASES} slabs, {:.0} million photons\n", photons as f64 / 1e6);
    for (n, slabs) in made.slabs.chunks(SUNS * THICKNESSES).enumerate() {
        let mean = |value: &dyn Fn(&Summary) -> f64| {
            (slabs.iter().map(|s| value(s).powi(2)).sum::<f64>() / slabs.len() as f64).sqrt()
        };
        text += &format!(
            "asymmetry {}: standard error of fluences {:.4} of their value, of mean directions {:.4}, in the mean square\n",
            ASYMMETRIES[n],
            mean(&|s| s.fluence_error[0]),
            mean(&|s| s.direction_error),
        );
    }
    text
}

fn row(cells: Vec<String>) -> [String; 16] {
    let mut cells = cells.into_iter();
    std::array::from_fn(|_| cells.next().unwrap_or_default())
}
