//! A long run with its books kept: what came in as water, what is there, how fast the air moves, how warm it is.

use std::time::Instant;

use serde::Serialize;
use welkin_proto::wire::HealthState;
use welkin_proto::{ApiError, Scene};
use welkin_shaders::catalogue::Field;

use crate::world::World;

/// What a long run came to.
#[derive(Clone, Debug, Serialize)]
pub struct Endurance {
    /// Ticks that ran.
    pub ticks: u64,
    /// Simulated seconds.
    pub simulated_s: f64,
    /// Wall seconds.
    pub wall_s: f64,
    /// The watchdog's verdict at the end.
    pub health: HealthState,
    /// Ticks that were tried again.
    pub retries: u64,
    /// Times that an earlier state was restored.
    pub restores: u64,
    /// Mean path of all water at the start, kg/m2; 0 where the scene has none.
    pub water_start_kg_m2: f64,
    /// The same at the end.
    pub water_end_kg_m2: f64,
    /// What the named sources gave, integrated over the ticks, kg/m2.
    pub water_given_kg_m2: f64,
    /// Largest departure of the path from start and sources so far, as a share of the start.
    pub water_error_max: f64,
    /// Least and largest mass-weighted mean of the potential temperature's excess over the scene's reference, K.
    pub heat_range_k: [f64; 2],
    /// Largest mean kinetic energy, J/kg.
    pub kinetic_energy_max_j_kg: f64,
    /// Kinetic energy of the last sample, J/kg.
    pub kinetic_energy_end_j_kg: f64,
    /// Fastest horizontal wind component at a tick's end, m/s.
    pub wind_max_m_s: f64,
    /// Fastest updraught at a tick's end, m/s.
    pub updraught_max_m_s: f64,
    /// Largest divergence at a tick's end, 1/s.
    pub divergence_max_per_s: f64,
}

/// Ticks between samples of energy and heat, which read whole fields.
const SAMPLE_EVERY: u64 = 100;

/// Runs `ticks` ticks of the scene's own length from its start, without a spin-up. `progress` is told the ticks so far and ends the run by `false`.
///
/// Errors: those of [`World::new`].
pub fn run(
    mut scene: Scene,
    ticks: u64,
    threads: Option<usize>,
    mut progress: impl FnMut(u64) -> bool + Send,
) -> Result<Endurance, ApiError> {
    scene.time.spin_up_s = 0.0;
    let tick_s = scene.time.tick_s;
    let mut world = World::new(scene, threads)?;
    let began = Instant::now();
    let path = |world: &World| world.cloud().map_or(0.0, |c| c.total_water_path_kg_m2);
    let rate = |world: &World| world.cloud().map_or(0.0, |c| c.water_source_kg_m2_s);
    let start = path(&world);
    let mut books = Endurance {
        ticks: 0,
        simulated_s: 0.0,
        wall_s: 0.0,
        health: HealthState::Good,
        retries: 0,
        restores: 0,
        water_start_kg_m2: start,
        water_end_kg_m2: start,
        water_given_kg_m2: 0.0,
        water_error_max: 0.0,
        heat_range_k: [f64::INFINITY, f64::NEG_INFINITY],
        kinetic_energy_max_j_kg: 0.0,
        kinetic_energy_end_j_kg: 0.0,
        wind_max_m_s: 0.0,
        updraught_max_m_s: 0.0,
        divergence_max_per_s: 0.0,
    };
    world.on_threads(|world| {
        while books.ticks < ticks && !world.is_halted() && progress(books.ticks) {
            let before = rate(world);
            world.advance_by(tick_s);
            books.ticks += 1;
            books.water_given_kg_m2 += 0.5 * (before + rate(world)) * tick_s;
            books.water_end_kg_m2 = path(world);
            if start > 0.0 {
                let error = (books.water_end_kg_m2 - start - books.water_given_kg_m2).abs() / start;
                books.water_error_max = books.water_error_max.max(error);
            }
            let numbers = world.numbers();
            books.wind_max_m_s = books.wind_max_m_s.max(numbers.wind_max_m_s);
            books.updraught_max_m_s = books.updraught_max_m_s.max(numbers.updraught_max_m_s);
            books.divergence_max_per_s = books.divergence_max_per_s.max(numbers.divergence_max_per_s);
            if books.ticks.is_multiple_of(SAMPLE_EVERY) || books.ticks == ticks {
                let [energy, heat] = means(world);
                books.kinetic_energy_end_j_kg = energy;
                books.kinetic_energy_max_j_kg = books.kinetic_energy_max_j_kg.max(energy);
                books.heat_range_k = [books.heat_range_k[0].min(heat), books.heat_range_k[1].max(heat)];
            }
        }
    });
    let numbers = world.numbers();
    books.simulated_s = numbers.simulated_s;
    books.wall_s = began.elapsed().as_secs_f64();
    books.health = numbers.health;
    books.retries = numbers.retries;
    books.restores = numbers.restores;
    Ok(books)
}

/// Mass-weighted means over the box: kinetic energy (J/kg, each component at its own face) and heat (K).
fn means(world: &World) -> [f64; 2] {
    let parameters = world.parameters();
    let plane = parameters.grid.plane();
    let density = &parameters.density_kg_m3;
    let mean = |field: Field, of: fn(f64) -> f64| {
        let Some(values) = world.device().read(field) else {
            return 0.0;
        };
        let levels = values.chunks_exact(plane).zip(density);
        let sum: f64 = levels
            .map(|(level, &rho)| rho as f64 * level.iter().map(|&v| of(v as f64)).sum::<f64>())
            .sum();
        let mass: f64 = density.iter().map(|&rho| rho as f64).sum();
        sum / (mass * plane as f64)
    };
    let energy = [Field::VelocityX, Field::VelocityY, Field::VelocityZ]
        .map(|field| mean(field, |v| 0.5 * v * v))
        .iter()
        .sum();
    [energy, mean(Field::Heat, |v| v)]
}
