//! The Monte Carlo study of light in plane-parallel slabs behind `methods.scattering: slab`: every slab of the tables, with what is finished kept so that an interrupted run goes on.

mod parts;

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use serde::Serialize;
use serde_json::json;
use welkin_shaders::cpu::light::path_tracer::Scatterer;
use welkin_shaders::cpu::light::path_tracer::slab::Estimate;
use welkin_shaders::cpu::light::phase_table::PhaseChoice;
use welkin_shaders::cpu::light::slab_photons::{DEPTHS, LEAVING, SETS, SlabStudy, study};
use welkin_shaders::cpu::light::slab_tables::{ASYMMETRIES, CASES, case, encode, encode_case};

use parts::Parts;

/// Flights of photons that each slab of the kept tables was followed for.
pub const FLIGHTS: u64 = 3_000_000;
/// Seed of the kept tables.
pub const SEED: u64 = 1;
/// Fluences below this, over the beam's irradiance, are left out where errors are summed up: nobody sees them.
const SEEN: f64 = 1e-3;

/// Why tables were not made.
#[derive(Debug, thiserror::Error)]
pub enum TablesError {
    /// What is kept for another time cannot be read or written.
    #[error("cannot use {0}: {1}")]
    Parts(String, std::io::Error),
    /// The parts are of another study.
    #[error("{0} holds the parts of another study ({1}); name another file or delete it")]
    Others(String, String),
    /// Somebody wants it to end.
    #[error("interrupted")]
    Interrupted,
}

/// What is to be made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// Flights of photons a slab.
    pub flights: u64,
    /// Of the random numbers.
    pub seed: u64,
}

impl Order {
    /// The command that makes the same tables again.
    pub fn command(&self) -> String {
        format!("welkin tables --flights {} --seed {}", self.flights, self.seed)
    }
}

/// One slab's finished study, as it is kept and shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// Its bytes in the tables.
    pub bytes: Vec<u8>,
    /// What is shown of it.
    pub summary: Summary,
}

/// What is shown of a slab.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Photons followed.
    pub photons: u64,
    /// Share of the flux that is sent back, and its standard error.
    pub reflected: [f64; 2],
    /// Share that passes, straight or not, and its standard error.
    pub transmitted: [f64; 2],
    /// Shares sent back by how often they were scattered: once, then the sets.
    pub reflected_sets: [f64; LEAVING],
    /// The same of what passes scattered.
    pub transmitted_sets: [f64; LEAVING],
    /// Relative standard error of fluences above a thousandth of the beam's: the mean square's root, and the largest.
    pub fluence_error: [f64; 2],
    /// Standard error of mean directions, in the mean square.
    pub direction_error: f64,
}

/// Follows the photons of slab `n`. Each slab has random numbers of its own.
pub fn follow(order: &Order, n: usize) -> SlabStudy {
    let (asymmetry, slab) = case(n);
    let scatterer = Scatterer::new(PhaseChoice::HenyeyGreenstein {
        asymmetry: asymmetry as f32,
    });
    let stream = order.seed.wrapping_mul(CASES as u64).wrapping_add(n as u64);
    study(&scatterer, &slab, stream, order.flights)
}

fn summary(n: usize, found: &SlabStudy) -> Summary {
    let (_, slab) = case(n);
    let sum = |shares: &[Estimate; LEAVING]| -> f64 { shares.iter().map(|e| e.mean).sum() };
    // All that comes in leaves: what is sent back and what passes are known equally well.
    let [sent_back, passed] = [sum(&found.reflected), sum(&found.transmitted)];
    let straight = (-slab.optical_depth / slab.sun_cosine).exp();
    let error = (sent_back * passed / found.photons.max(1) as f64).max(0.0).sqrt();
    let seen = found.layers.iter().filter(|layer| layer[0].mean > SEEN);
    let (mut count, mut square, mut largest, mut direction) = (0.0, 0.0, 0.0f64, 0.0);
    for layer in seen {
        let relative = layer[0].error / layer[0].mean;
        count += 1.0;
        square += relative * relative;
        largest = largest.max(relative);
        direction += layer[2].error.powi(2);
    }
    let count = f64::max(count, 1.0);
    Summary {
        photons: found.photons,
        reflected: [sent_back, error],
        transmitted: [passed + straight, error],
        reflected_sets: found.reflected.map(|e| e.mean),
        transmitted_sets: found.transmitted.map(|e| e.mean),
        fluence_error: [(square / count).sqrt(), largest],
        direction_error: (direction / count).sqrt(),
    }
}

/// What was made.
#[derive(Clone, Debug)]
pub struct Made {
    /// The file.
    pub file: Vec<u8>,
    /// One a slab, in order.
    pub slabs: Vec<Summary>,
}

/// Makes the tables: the same bytes for any number of threads and however often it was interrupted. `progress` is told how many slabs are done; `false` ends it, and what is finished stays in `parts`.
/// Errors: [`TablesError`].
pub fn make(
    order: &Order,
    parts: Option<&Path>,
    progress: &(dyn Fn(usize, usize) -> bool + Sync),
) -> Result<Made, TablesError> {
    let (parts, mut finished) = match parts {
        Some(path) => {
            let (parts, finished) = Parts::open(path, &provenance(order, None))?;
            (Some(parts), finished)
        }
        None => (None, vec![None; CASES]),
    };
    let done = AtomicUsize::new(finished.iter().flatten().count());
    if !progress(done.load(Ordering::Relaxed), CASES) {
        return Err(TablesError::Interrupted);
    }
    let parts = Mutex::new(parts);
    // The longest first, so that no thread is left with one at the end.
    let mut missing: Vec<usize> = (0..CASES).filter(|n| finished[*n].is_none()).collect();
    missing.sort_by(|a, b| case(*b).1.optical_depth.total_cmp(&case(*a).1.optical_depth));
    let found: Result<Vec<(usize, Finished)>, TablesError> = missing
        .into_par_iter()
        .map(|n| {
            if !progress(done.load(Ordering::Relaxed), CASES) {
                return Err(TablesError::Interrupted);
            }
            let found = follow(order, n);
            let slab = Finished {
                bytes: encode_case(&found),
                summary: summary(n, &found),
            };
            let mut parts = parts.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            if let Some(parts) = parts.as_mut() {
                parts.keep(n, &slab)?;
            }
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, CASES);
            Ok((n, slab))
        })
        .collect();
    for (n, slab) in found? {
        finished[n] = Some(slab);
    }
    let finished: Vec<Finished> = finished.into_iter().flatten().collect();
    let slabs: Vec<Summary> = finished.iter().map(|f| f.summary).collect();
    let bytes: Vec<Vec<u8>> = finished.into_iter().map(|f| f.bytes).collect();
    Ok(Made {
        file: encode(&provenance(order, Some(&slabs)), &bytes),
        slabs,
    })
}

/// The tables' own account of themselves, without any date: the same run gives the same bytes.
fn provenance(order: &Order, slabs: Option<&[Summary]>) -> String {
    let mut told = json!({
        "what": "light in plane-parallel slabs without absorption, by sets of orders of scattering",
        "command": order.command(),
        "version": env!("CARGO_PKG_VERSION"),
        "method": "photons from the lit side, first collision forced, track-length estimator",
        "phase": "Henyey and Greenstein",
        "asymmetries": ASYMMETRIES,
        "sets": ["2", "3", "4", "5-6", "7-9", "10-15", "16 and more"],
        "axes": "asymmetry, sun's cosine, thickness, set, layer",
        "layers": [SETS, DEPTHS],
        "flights_per_slab": order.flights,
        "seed": order.seed,
    });
    if let (Some(slabs), Some(object)) = (slabs, told.as_object_mut()) {
        let photons: u64 = slabs.iter().map(|s| s.photons).sum();
        let square = slabs.iter().map(|s| s.fluence_error[0].powi(2)).sum::<f64>() / slabs.len().max(1) as f64;
        object.insert("photons".to_owned(), photons.into());
        object.insert(
            "fluence_relative_error".to_owned(),
            json!((square.sqrt() * 1e5).round() / 1e5),
        );
    }
    told.to_string()
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use welkin_shaders::cpu::light::slab_photons::SlabCase;
    use welkin_shaders::cpu::light::slab_tables::SlabTables;

    use super::*;
    use crate::validate::slab::{COLUMNS, DEPTHS as PUBLISHED_DEPTHS, REFLECTED};

    fn file(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("welkin-{name}-{}", std::process::id()))
    }

    /// What the sets of orders send back in sum is what discrete ordinates do, and the rest passes.
    #[test]
    fn orders_add_up_to_the_published_slabs() {
        for (optical_depth, row) in PUBLISHED_DEPTHS.iter().zip(REFLECTED) {
            for ([asymmetry, sun_cosine], published) in COLUMNS.iter().zip(row) {
                let scatterer = Scatterer::new(PhaseChoice::HenyeyGreenstein {
                    asymmetry: *asymmetry as f32,
                });
                let slab = SlabCase {
                    optical_depth: *optical_depth,
                    sun_cosine: *sun_cosine,
                };
                let found = study(&scatterer, &slab, 17, 600_000);
                let ours: f64 = found.reflected.iter().map(|e| e.mean).sum();
                let passed: f64 =
                    found.transmitted.iter().map(|e| e.mean).sum::<f64>() + (-optical_depth / sun_cosine).exp();
                // Four standard errors of a share of so many photons: none of 16 rows misses by chance.
                let error = (published * (1.0 - published) / found.photons as f64).sqrt();
                let what =
                    format!("depth {optical_depth}, g {asymmetry}, mu0 {sun_cosine}: {ours} {published} {error}");
                assert!((ours - published).abs() < 4.0 * error + 1e-5, "{what}");
                assert!((passed - (1.0 - published)).abs() < 4.0 * error + 1e-5, "{what}");
                assert!(error < 0.015, "{what}");
            }
        }
    }

    /// Other photons give the kept numbers within the errors of both.
    #[test]
    fn kept_tables_are_found_again() {
        let kept = SlabTables::kept().unwrap();
        let order = Order {
            flights: FLIGHTS / 10,
            seed: SEED + 8,
        };
        let (mut compared, mut far) = (0, 0);
        for n in [0, 50, 130, 200, 243, 300, 383] {
            let found = follow(&order, n);
            for (i, layer) in found.layers.iter().enumerate() {
                let numbers = kept.numbers(n, i / DEPTHS, i % DEPTHS);
                if layer[0].mean < 0.01 {
                    continue;
                }
                compared += 1;
                // The kept ones have ten times the flights; a step of the fluence's logarithm is 3e-4, one of a direction 1/127.
                let fluence = numbers[0].exp2();
                let apart = (layer[0].mean - fluence).abs() / (1.05 * layer[0].error + 3e-4 * fluence);
                let inward = (layer[2].mean - numbers[2]).abs() / (1.05 * layer[2].error + 0.5 / 127.0);
                far += usize::from(apart > 3.5) + usize::from(inward > 3.5);
                assert!(apart < 8.0 && inward < 8.0, "slab {n}, {i}: {layer:?} {numbers:?}");
            }
        }
        // Errors from sixteen batches are themselves uncertain: beyond 3.5 lies one in 300.
        assert!(compared > 200 && far * 50 < compared, "{far} of {compared}");
    }

    /// The kept tables are what the command makes. On another machine's logarithms and sines a photon in some thousands goes another way.
    #[test]
    fn the_same_photons_give_the_kept_bytes() {
        let kept = SlabTables::kept().unwrap();
        let order = Order {
            flights: FLIGHTS,
            seed: SEED,
        };
        assert!(kept.provenance.contains(&order.command()), "{}", kept.provenance);
        let n = 240;
        let found = follow(&order, n);
        let bytes = encode_case(&found);
        let same = bytes.iter().zip(kept.case_bytes(n)).filter(|(a, b)| a == b).count();
        assert!(same * 100 > bytes.len() * 97, "{same} of {}", bytes.len());
    }

    #[test]
    fn an_interrupted_run_goes_on_to_the_same_bytes() {
        let order = Order { flights: 200, seed: 5 };
        let whole = make(&order, None, &|_, _| true).unwrap();
        let path = file("tables.parts");
        let _ = std::fs::remove_file(&path);
        let ended = make(&order, Some(&path), &|done, _| done < 100);
        assert!(matches!(ended, Err(TablesError::Interrupted)));
        // Killed in the middle of a record.
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 7]).unwrap();
        let least = Mutex::new(CASES);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let again = pool.install(|| {
            make(&order, Some(&path), &|done, _| {
                let mut least = least.lock().unwrap();
                *least = done.min(*least);
                true
            })
        });
        let again = again.unwrap();
        assert!((90..CASES).contains(&*least.lock().unwrap()), "{least:?} were there");
        assert!(again.file == whole.file && again.slabs == whole.slabs);
        let other = Order { seed: 6, ..order };
        let refused = make(&other, Some(&path), &|_, _| true);
        assert!(matches!(refused, Err(TablesError::Others(..))));
        std::fs::remove_file(&path).unwrap();
    }
}
