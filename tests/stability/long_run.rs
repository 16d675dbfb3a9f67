//! The default scene over many ticks: energy and water stay bounded, and the watchdog has nothing to do.
//!
//! The long version, 100,000 ticks, is run by hand: `cargo test --release -p welkin-tests --test long_run -- --ignored --nocapture`.

use welkin_proto::wire::HealthState;
use welkin_proto::{Scene, presets};
use welkin_server::endurance::{self, Endurance};

fn assert_bounded(run: &Endurance, ticks: u64) {
    println!("{run:#?}");
    assert_eq!(run.ticks, ticks);
    assert_eq!((run.health, run.restores), (HealthState::Good, 0));
    // Ticks need no second try either: the substep is chosen so that they don't.
    assert_eq!(run.retries, 0);
    // Rounding of 32-bit water, 6e-8 a stage, sums as a random walk over a level; the sources are integrated by trapezoids.
    assert!(run.water_error_max < 1e-4, "water drifts by {:e}", run.water_error_max);
    // The trade wind is 8.75 m/s, 38 J/kg; drag and Coriolis turn it but feed it nothing, and eddies of the convection add less than 1 J/kg.
    assert!(run.kinetic_energy_max_j_kg < 50.0);
    // Coriolis oscillation about the geostrophic wind of 10 m/s, and eddies.
    assert!(run.wind_max_m_s < 20.0 && run.updraught_max_m_s < 15.0);
    // Fluxes of 0.008 K m/s and radiation of 2 K a day: over 28 h they shift the mean by less than 5 K, and subsidence warms against it.
    let [low, high] = run.heat_range_k;
    assert!(high - low < 5.0, "the mean temperature ranges from {low} to {high} K");
    assert!(run.divergence_max_per_s < 1e-5);
}

fn scene(cells: [u32; 3]) -> Scene {
    let mut scene = presets::find(presets::DEFAULT).expect("the default preset is there");
    let size = [0, 1, 2].map(|a| f64::from(scene.domain.cells[a]) * scene.domain.cell_size_m[a]);
    scene.domain.cells = cells;
    scene.domain.cell_size_m = [0, 1, 2].map(|a| size[a] / f64::from(cells[a]));
    scene
}

#[test]
fn some_hundred_ticks_of_a_coarse_sky_stay_bounded() {
    let mut coarse = scene([16, 16, 25]);
    // Ten simulated seconds each: the half hour in which convection sets in, and an hour with it.
    coarse.time.tick_s = 10.0;
    let run = endurance::run(coarse, 600, None, |_| true).expect("it runs");
    assert_bounded(&run, 600);
    assert!(run.updraught_max_m_s > 0.3, "nothing rises");
}

#[test]
#[ignore = "takes half an hour of two free cores: a hundred thousand ticks of the default scene"]
fn a_hundred_thousand_ticks_stay_bounded() {
    let cells: [u32; 3] = match std::env::var("WELKIN_LONG_RUN_CELLS") {
        Ok(text) => {
            let cells: Vec<u32> = text.split('x').map(|n| n.parse().expect("NxNxN")).collect();
            cells.try_into().expect("NxNxN")
        }
        Err(_) => {
            presets::find(presets::DEFAULT)
                .expect("the default preset is there")
                .domain
                .cells
        }
    };
    let began = std::time::Instant::now();
    let run = endurance::run(scene(cells), 100_000, None, |ticks| {
        if ticks % 10_000 == 0 {
            println!("{ticks} ticks, {:.0} s", began.elapsed().as_secs_f64());
        }
        true
    });
    assert_bounded(&run.expect("it runs"), 100_000);
}
