//! What a world says of itself: its numbers, snapshots, copies of its fields, and the plan.

use std::sync::Arc;

use welkin_proto::wire::{FieldReport, LadderReport, Numbers, PassReport, PlanReport};
use welkin_shaders::CloudVolume;
use welkin_shaders::catalogue::{Field, VIEW_STAGES};

use super::{Snapshot, World};
use crate::weather::{Copied, FieldSet};
use crate::{moon, sun};

impl World {
    /// The world's numbers. What its host knows better (speed, time scale, pause, milliseconds a frame) is left at its default.
    pub fn numbers(&self) -> Numbers {
        let unix_s = self.start_unix_s + self.simulated_s;
        let [sun_elevation_deg, sun_azimuth_deg] = sun::position_deg(&self.scene.sun, &self.scene.domain, unix_s);
        let moon = moon::of_scene(&self.scene, unix_s);
        let stars = self.scene.effects.stars.as_ref();
        let cloud = self.cloud;
        Numbers {
            tick: self.tick,
            simulated_s: self.simulated_s,
            utc: welkin_proto::time::format_utc(unix_s),
            tick_ms: self.tick_ms,
            substeps: self.substeps,
            substep_s: self.substep_s,
            time_scale: self.scene.time.time_scale,
            spinning_up: self.spinning_up(),
            cloud_cover: cloud.map(|c| c.cover),
            cloud_base_m: cloud.and_then(|c| c.base_m),
            cloud_top_m: cloud.and_then(|c| c.top_m),
            liquid_water_path_kg_m2: cloud.map(|c| c.liquid_water_path_kg_m2),
            total_water_path_kg_m2: cloud.map(|c| c.total_water_path_kg_m2),
            updraught_max_m_s: self.reductions.updraught_max_m_s as f64,
            wind_max_m_s: self.reductions.wind_max_m_s as f64,
            courant: self.reductions.courant_rate_per_s as f64 * self.substep_s,
            divergence_max_per_s: self.vitals.divergence_max_per_s as f64,
            sun_elevation_deg,
            sun_azimuth_deg,
            moon_elevation_deg: moon.map(|m| m.elevation_deg),
            moon_azimuth_deg: moon.map(|m| m.azimuth_deg),
            moon_distance_m: moon.map(|m| m.distance_m),
            sidereal_deg: stars.map(|_| moon::sidereal_rad(unix_s, self.scene.domain.longitude_deg).to_degrees()),
            health: self.watchdog.health(),
            trouble_code: self.watchdog.trouble().map(|(_, t)| t.code.to_owned()),
            trouble_message: self.watchdog.trouble().map(|(_, t)| t.message.clone()),
            trouble_tick: self.watchdog.trouble().map(|(tick, _)| tick),
            retries: self.watchdog.retries(),
            restores: self.watchdog.restores(),
            ..Numbers::default()
        }
    }

    /// A copy of the state's fields that are wanted, with the drawn cloud that goes with them. Waits for a device that lags. None where the
    /// device is lost.
    pub fn weather(&self, wanted: FieldSet, volume: Option<Arc<CloudVolume>>) -> Option<Copied> {
        let mut state: [Vec<f32>; 5] = Default::default();
        for (place, field) in Field::STATE.into_iter().enumerate() {
            if wanted.fields().any(|f| f == field) && self.plan.fields.contains(&field) {
                state[place] = self.device.read(field)?.into_owned();
            }
        }
        (volume.is_some() || self.scene.effects.moisture.is_none()).then(|| Copied {
            tick: self.tick,
            simulated_s: self.simulated_s,
            utc_unix_s: self.start_unix_s + self.simulated_s,
            scene: Arc::clone(&self.scene),
            parameters: Arc::clone(&self.parameters),
            volume,
            held: wanted,
            state,
        })
    }

    /// What views need, as it is now.
    pub fn snapshot(&self) -> Snapshot {
        let numbers = self.numbers();
        let volume = self
            .device
            .read(Field::Extinction)
            .zip(self.cloud)
            .map(|(extinction, cloud)| {
                // The displacement is kept small: the detail noise repeats far below a million metres, f32 resolves centimetres there.
                let displacement = self.air_displacement_m.map(|d| (d % 1.0e6) as f32);
                Arc::new(CloudVolume {
                    grid: self.parameters.grid,
                    extinction_per_m: extinction.to_vec(),
                    cloudy_levels: cloud.lit_levels,
                    air_displacement_m: [displacement[0], displacement[1], 0.0],
                })
            });
        Snapshot {
            sun_direction: sun::direction([numbers.sun_elevation_deg, numbers.sun_azimuth_deg]),
            numbers,
            volume,
            scene: Arc::clone(&self.scene),
            plan: Arc::clone(&self.report),
            timings: Arc::clone(&self.timings),
        }
    }

    /// The plan with what each pass has cost so far. The view's stages are named with the effect that asks for them;
    /// what they cost, the renderer knows.
    pub fn plan_report(&self) -> PlanReport {
        let names = |fields: &[Field]| {
            fields
                .iter()
                .filter(|f| self.plan.fields.contains(f))
                .map(|f| f.name().to_owned())
                .collect()
        };
        let chosen = &self.plan.chosen;
        let ladders = chosen.choices.iter().map(|choice| {
            let info = choice.rung.info();
            LadderReport {
                ladder: info.ladder.name().to_owned(),
                rung: info.name.to_owned(),
                why: choice.why.clone(),
                what: info.what.to_owned(),
                keeps: info.keeps.to_owned(),
                rungs: info
                    .ladder
                    .rungs()
                    .filter(|r| r.is_there())
                    .map(|r| r.info().name.to_owned())
                    .collect(),
            }
        });
        let mut passes: Vec<PassReport> = self
            .plan
            .passes
            .iter()
            .map(|pass| {
                let info = pass.info();
                let mut why = info.needs.iter().map(|e| e.name()).collect::<Vec<_>>().join(" + ");
                for choice in chosen.choices.iter().filter(|c| info.rungs.contains(&c.rung)) {
                    let rung = choice.rung.info();
                    why += &format!(", {} {}", rung.ladder.name(), rung.name);
                }
                PassReport {
                    stage: info.name.to_owned(),
                    phase: info.phase.name().to_owned(),
                    why: format!("effect {why}: {}", info.what),
                    reads: names(info.reads),
                    writes: names(info.writes),
                    bytes_per_cell: Some(self.device.bytes_per_cell(*pass, &self.plan.fields)),
                    mean_ms: None,
                    runs: 0,
                }
            })
            .collect();
        passes.extend(
            VIEW_STAGES
                .iter()
                .filter(|s| s.needs.iter().all(|e| self.plan.effects.contains(e)))
                .filter(|s| s.rungs.is_empty() || chosen.choices.iter().any(|c| s.rungs.contains(&c.rung)))
                .map(|stage| PassReport {
                    stage: stage.name.to_owned(),
                    phase: "view".to_owned(),
                    why: {
                        let mut why = match stage.needs {
                            [] => "every picture".to_owned(),
                            needs => {
                                let names: Vec<_> = needs.iter().map(|e| e.name()).collect();
                                format!("effect {}", names.join(" + "))
                            }
                        };
                        for choice in chosen.choices.iter().filter(|c| stage.rungs.contains(&c.rung)) {
                            let rung = choice.rung.info();
                            why += &format!(", {} {}", rung.ladder.name(), rung.name);
                        }
                        format!("{why}: {}", stage.what)
                    },
                    reads: stage.reads.iter().map(|s| (*s).to_owned()).collect(),
                    writes: stage.writes.iter().map(|s| (*s).to_owned()).collect(),
                    bytes_per_cell: None,
                    mean_ms: None,
                    runs: 0,
                }),
        );
        let cell_bytes = 4 * self.parameters.grid.len() as u64;
        let mut fields: Vec<FieldReport> = self
            .plan
            .fields
            .iter()
            .map(|f| FieldReport {
                name: f.name().to_owned(),
                place: f.place().name().to_owned(),
                unit: f.unit().to_owned(),
                bytes: cell_bytes,
            })
            .collect();
        if self.device.solver_bytes() > 0 {
            fields.push(FieldReport {
                name: "pressure_solver_spectra_and_factors".to_owned(),
                place: "spectrum".to_owned(),
                unit: "1".to_owned(),
                bytes: self.device.solver_bytes() as u64,
            });
        }
        fields.push(FieldReport {
            name: "watchdog_states".to_owned(),
            place: "slot".to_owned(),
            unit: "1".to_owned(),
            bytes: self.device.saved_bytes() as u64,
        });
        let bytes = fields.iter().map(|f| f.bytes).sum();
        let mut report = PlanReport {
            device: self.device.name(),
            ladders: ladders.collect(),
            courant_max: chosen.courant_max,
            passes,
            fields,
            bytes,
        };
        self.timings.put(&mut report);
        report
    }
}
