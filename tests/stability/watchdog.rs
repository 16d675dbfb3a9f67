//! The watchdog: passing faults are got over, lasting ones end in a good state and are told, and nothing bad is ever shown.

#[path = "../service/common.rs"]
mod common;

use std::time::Instant;

use common::{PATIENCE, Server, empty_server, next_of};
use serde_json::{Value, json};
use welkin_proto::wire::{Command, HealthState};
use welkin_proto::{Scene, presets};
use welkin_server::host::Host;
use welkin_server::limits::Limits;
use welkin_server::watchdog::{self, Bounds, Damage, Fault, GOOD_AGAIN_S, KEEP_EVERY_S, KEPT, Watchdog};
use welkin_server::world::World;
use welkin_shaders::catalogue::Field;
use welkin_shaders::{CloudReductions, Reductions, Vitals};

/// Cumulus on few cells, with every effect of the scene.
fn cumulus() -> Scene {
    let mut scene = presets::find("fair-weather-cumulus").expect("a preset");
    scene.domain.cells = [12, 12, 50];
    scene.domain.cell_size_m = [150.0, 150.0, 60.0];
    scene.time.spin_up_s = 0.0;
    scene
}

fn world() -> World {
    World::new(cumulus(), Some(2)).expect("a world")
}

/// A cell in the middle of the twentieth level.
const CELL: usize = (20 * 12 + 6) * 12 + 6;

fn fault(tick: u64, field: Field, damage: Damage, strikes: u32) -> Fault {
    Fault {
        tick,
        substep: 0,
        field,
        damage,
        strikes,
    }
}

fn bits(world: &World) -> Vec<u32> {
    let fields = Field::STATE
        .into_iter()
        .chain([Field::CloudWater, Field::Extinction])
        .filter_map(|f| world.device().read(f));
    let mut bits = Vec::new();
    fields.for_each(|values| bits.extend(values.iter().map(|v| v.to_bits())));
    bits
}

fn assert_shows_only_good_values(world: &World, what: &str) {
    let snapshot = world.snapshot();
    let volume = snapshot.volume.expect("the scene has moisture");
    assert!(
        volume
            .extinction_per_m
            .iter()
            .all(|e| e.is_finite() && (0.0..10.0).contains(e)),
        "{what}: a bad cloud is shown"
    );
    let n = snapshot.numbers;
    let numbers = [
        n.updraught_max_m_s,
        n.wind_max_m_s,
        n.courant,
        n.divergence_max_per_s,
        n.total_water_path_kg_m2.expect("moist"),
        n.liquid_water_path_kg_m2.expect("moist"),
    ];
    assert!(numbers.iter().all(|v| v.is_finite()), "{what}: {numbers:?}");
    assert!(n.wind_max_m_s < 50.0, "{what}: wind {}", n.wind_max_m_s);
    for field in Field::STATE {
        let values = world.device().read(field).expect("planned");
        assert!(values.iter().all(|v| v.is_finite()), "{what}: {}", field.name());
    }
}

#[test]
fn a_restored_state_continues_bit_for_bit() {
    // Ticks of one substep and of several, and states kept on the way.
    let lengths_s = [1.0, 20.0, 60.0, 1.0, 45.0, 20.0, 20.0];
    let go_on = |world: &mut World| lengths_s.iter().for_each(|l| world.advance_by(*l));
    let mut world = world();
    go_on(&mut world);
    let slot = Watchdog::slots().end;
    let mark = world.save(slot);
    let saved = bits(&world);
    go_on(&mut world);
    // A command changes what the passes are told, too.
    world.add_wind(3.0, -1.0);
    go_on(&mut world);
    let (first, simulated_s) = (bits(&world), world.simulated_s());
    assert_ne!(saved, first);

    assert!(world.restore(slot, &mark));
    assert_eq!(bits(&world), saved);
    assert_eq!(world.simulated_s(), mark.simulated_s);
    go_on(&mut world);
    world.add_wind(3.0, -1.0);
    go_on(&mut world);
    assert!(bits(&world) == first, "the continuation differs");
    assert_eq!(world.simulated_s(), simulated_s);
    assert!(!world.restore(slot + 1, &mark), "an empty slot was restored");
    assert!(bits(&world) == first, "an empty slot changed something");
}

#[test]
fn a_passing_fault_is_got_over_by_a_retry() {
    let cases = [
        (
            "NaN in u",
            fault(4, Field::VelocityX, Damage::Cell(CELL, f32::NAN), 1),
            "not_finite",
        ),
        (
            "NaN in v",
            fault(4, Field::VelocityY, Damage::Cell(CELL, f32::NAN), 1),
            "not_finite",
        ),
        (
            "infinite w",
            fault(4, Field::VelocityZ, Damage::Cell(CELL, f32::INFINITY), 1),
            "not_finite",
        ),
        (
            "NaN in heat",
            fault(4, Field::Heat, Damage::Cell(CELL, f32::NAN), 1),
            "not_finite",
        ),
        (
            "NaN in water",
            fault(4, Field::Water, Damage::Cell(CELL, f32::NAN), 1),
            "not_finite",
        ),
        (
            "-inf in water",
            fault(4, Field::Water, Damage::Cell(CELL, f32::NEG_INFINITY), 1),
            "not_finite",
        ),
        (
            "a wind twenty times as strong",
            fault(4, Field::VelocityX, Damage::Scale(20.0), 1),
            "courant_exceeded",
        ),
        (
            "a wind that no projection saw",
            fault(4, Field::VelocityX, Damage::Cell(CELL, 5.0), 1),
            "divergence_exceeded",
        ),
        (
            "half the water gone",
            fault(4, Field::Water, Damage::Scale(0.5), 1),
            "water_budget_broken",
        ),
        (
            "a permille of the water made",
            fault(4, Field::Water, Damage::Scale(1.001), 1),
            "water_budget_broken",
        ),
        (
            "negative water",
            fault(4, Field::Water, Damage::Cell(CELL, -0.005), 1),
            "negative_water",
        ),
    ];
    let clean = {
        let mut world = world();
        (0..8).for_each(|_| world.advance_by(2.0));
        world.numbers()
    };
    assert_eq!((clean.retries, clean.trouble_code.as_deref()), (0, None));
    for (what, fault, code) in cases {
        let mut world = world();
        world.inject(fault);
        for _ in 0..8 {
            world.advance_by(2.0);
            assert_shows_only_good_values(&world, what);
        }
        let n = world.numbers();
        assert_eq!(
            (
                n.health,
                n.trouble_code.as_deref(),
                n.trouble_tick,
                n.retries,
                n.restores
            ),
            (HealthState::Good, Some(code), Some(4), 1, 0),
            "{what}"
        );
        assert_eq!(
            (n.tick, n.simulated_s),
            (clean.tick, clean.simulated_s),
            "{what}: time was lost"
        );
        // The tick that was tried again took two substeps in place of one: the third order of Runge-Kutta leaves next to nothing of that.
        let water = |n: &welkin_proto::wire::Numbers| n.total_water_path_kg_m2.expect("moist");
        assert!((water(&n) / water(&clean) - 1.0).abs() < 1e-6, "{what}");
        assert!((n.wind_max_m_s - clean.wind_max_m_s).abs() < 1e-3, "{what}");
    }
    // Half-way through a tick of several substeps the start is restored, not the substep.
    let mut world = world();
    let mut late = fault(2, Field::VelocityZ, Damage::Cell(CELL, f32::NAN), 1);
    late.substep = 2;
    world.inject(late);
    world.advance_by(60.0);
    assert!(world.numbers().substeps > 2, "the tick has a third substep");
    world.advance_by(60.0);
    let n = world.numbers();
    assert_eq!((n.simulated_s, n.retries, n.health), (120.0, 1, HealthState::Good));
}

#[test]
fn a_lasting_fault_ends_in_the_last_good_state_with_its_reason() {
    let mut world = world();
    let mut shown = Vec::new();
    let record = |world: &World, shown: &mut Vec<(f64, Vec<u32>)>| shown.push((world.simulated_s(), bits(world)));
    record(&world, &mut shown);
    for _ in 0..15 {
        world.advance_by(20.0);
        record(&world, &mut shown);
    }
    // It strikes every try of one tick.
    world.inject(fault(16, Field::Heat, Damage::Cell(CELL, f32::NAN), u32::MAX));
    world.advance_by(20.0);
    let n = world.numbers();
    assert_eq!((n.tick, n.health, n.restores), (16, HealthState::Degraded, 1));
    assert_eq!(n.retries, u64::from(watchdog::HALVINGS));
    assert_eq!(
        (n.trouble_code.as_deref(), n.trouble_tick),
        (Some("not_finite"), Some(16))
    );
    assert!(
        n.trouble_message.as_deref().is_some_and(|m| m.contains("went back to")),
        "{n:?}"
    );
    // It went back by no more than the interval and a tick, to a state that was shown before, bit for bit.
    assert!(
        (300.0 - KEEP_EVERY_S - 20.0..300.0).contains(&n.simulated_s),
        "{}",
        n.simulated_s
    );
    let (_, then) = shown
        .iter()
        .find(|(s, _)| *s == n.simulated_s)
        .expect("a state that was shown");
    assert!(bits(&world) == *then, "another state than the one kept");
    assert_shows_only_good_values(&world, "degraded");
    // It goes on, and is good again once it has gone well for long enough.
    while world.simulated_s() < 300.0 + GOOD_AGAIN_S {
        assert_eq!(world.watchdog().health(), HealthState::Degraded);
        world.advance_by(20.0);
    }
    world.advance_by(20.0);
    let n = world.numbers();
    assert_eq!((n.health, n.restores, n.trouble_tick), (HealthState::Good, 1, Some(16)));
    assert_eq!(world.watchdog().caution(), 1.0);
}

#[test]
fn a_world_that_fails_at_once_again_halts_and_can_be_resumed() {
    let mut world = world();
    (0..20).for_each(|_| world.advance_by(20.0));
    for tick in 21..=21 + KEPT as u64 {
        world.inject(fault(tick, Field::Water, Damage::Scale(0.5), u32::MAX));
    }
    let mut went_back_to = Vec::new();
    for _ in 0..KEPT {
        world.advance_by(20.0);
        assert_eq!(world.watchdog().health(), HealthState::Degraded);
        went_back_to.push(world.simulated_s());
        assert_shows_only_good_values(&world, "degraded");
    }
    assert!(
        went_back_to[1] <= went_back_to[0] - KEEP_EVERY_S,
        "the second state is an older one: {went_back_to:?}"
    );
    world.advance_by(20.0);
    assert_eq!(world.watchdog().health(), HealthState::Halted);
    assert_eq!(world.simulated_s(), went_back_to[1]);
    assert_shows_only_good_values(&world, "halted");
    let error = world.halted_error().expect("it is halted");
    assert_eq!(error.code, "unstable");
    assert!(error.message.contains("kg/m2 of water"), "{}", error.message);
    let (before, n) = (bits(&world), world.numbers());
    world.advance_by(20.0);
    assert!(
        bits(&world) == before && world.numbers().tick == n.tick,
        "a halted world ticked"
    );
    let reached = world.simulated_s();
    world.advance_to(1e6, |_| true); // must come back
    assert_eq!(world.simulated_s(), reached);

    world.resume();
    assert_eq!(world.watchdog().health(), HealthState::Degraded);
    while world.simulated_s() < 400.0 + GOOD_AGAIN_S + 20.0 {
        world.advance_by(20.0);
    }
    assert_eq!(world.watchdog().health(), HealthState::Good);
}

#[test]
fn a_state_that_is_bad_before_the_tick_is_not_retried() {
    let mut world = world();
    (0..10).for_each(|_| world.advance_by(20.0));
    let mut water = world.device().read(Field::Water).expect("planned").to_vec();
    water[CELL] = f32::NAN;
    world.write_field(Field::Water, &water).expect("planned");
    world.advance_by(20.0);
    let n = world.numbers();
    assert_eq!((n.health, n.retries, n.restores), (HealthState::Degraded, 0, 1));
    assert_shows_only_good_values(&world, "after a poisoned write");
}

#[test]
fn bounds_judge_numbers_at_their_edges() {
    let parameters = world().parameters().methods.clone();
    let bounds = Bounds::new(1.0, &parameters, false);
    let well = Reductions {
        courant_rate_per_s: 0.1,
        finite: true,
        ..Reductions::default()
    };
    assert!(bounds.substep(&well, 14.9).is_ok());
    assert_eq!(bounds.substep(&well, 15.1).unwrap_err().code, "courant_exceeded");
    let vitals = |divergence_max_per_s, water_min_kg_per_kg, finite| Vitals {
        finite,
        divergence_max_per_s,
        water_min_kg_per_kg,
    };
    for (vitals, code) in [
        (vitals(9e-5, -9e-5, true), None),
        (vitals(2e-4, 0.0, true), Some("divergence_exceeded")),
        (vitals(0.0, -2e-4, true), Some("negative_water")),
        (vitals(0.0, 0.0, false), Some("not_finite")),
    ] {
        assert_eq!(bounds.state(&well, &vitals).err().map(|t| t.code), code, "{vitals:?}");
    }
    let cloud = |total_water_path_kg_m2, water_source_kg_m2_s| CloudReductions {
        total_water_path_kg_m2,
        water_source_kg_m2_s,
        ..CloudReductions::default()
    };
    // A source of 6e-5 kg/m2/s, BOMEX's, gives 6e-4 in ten seconds; without it the same change is trouble.
    assert!(bounds.water(&cloud(35.0, 6e-5), &cloud(35.0006, 6e-5), 10.0, 1).is_ok());
    for after in [35.0006, 34.9994, f64::NAN] {
        let judged = bounds.water(&cloud(35.0, 0.0), &cloud(after, 0.0), 10.0, 1);
        assert_eq!(judged.unwrap_err().code, "water_budget_broken");
    }
}

/// A server with the small cumulus, ticking as fast as it can in ticks of a second.
async fn cumulus_server() -> (Server, std::sync::Arc<Host>) {
    let server = empty_server(Limits::default()).await;
    let mut scene = cumulus();
    scene.time.tick_s = 10.0;
    scene.time.time_scale = 400.0;
    let host = server.state.create_world(scene).await.unwrap();
    (server, host)
}

/// Waits until `/healthz` satisfies `probe`; returns status and body.
async fn health_when(server: &Server, probe: impl Fn(&Value) -> bool) -> (u16, Value) {
    let began = Instant::now();
    loop {
        let answer = server.get("/healthz").await;
        let body = answer.json();
        if probe(&body["worlds"][0]) {
            return (answer.status, body);
        }
        assert!(began.elapsed() < PATIENCE, "{body}");
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn health_is_told_over_http_and_the_stream_and_no_bad_field_is_published() {
    let (server, host) = cumulus_server().await;
    // Every publication from here on is looked at.
    let mut published = host.view().published.clone();
    let watcher = tokio::spawn(async move {
        let mut seen = 0;
        while published.changed().await.is_ok() {
            let newest = published.borrow_and_update().clone();
            let volume = newest.snapshot.volume.as_ref().expect("moist");
            let extinction = &volume.extinction_per_m;
            assert!(extinction.iter().all(|e| e.is_finite()), "NaN in publication {seen}");
            assert!(newest.snapshot.numbers.wind_max_m_s < 50.0, "publication {seen}");
            seen += 1;
        }
        seen
    });
    let (status, body) = health_when(&server, |w| w["tick"].as_u64() > Some(20)).await;
    assert_eq!(
        (status, &body["status"], &body["worlds"][0]["health"]),
        (200, &json!("ok"), &json!("good"))
    );
    assert!(body["worlds"][0]["trouble_code"].is_null());
    let mut socket = server.stream("w1").await;

    // A fault that passes is got over and counted.
    let soon = |body: &Value| body["worlds"][0]["tick"].as_u64().unwrap() + 30;
    let passing = fault(soon(&body), Field::VelocityZ, Damage::Cell(CELL, f32::NAN), 1);
    host.inject(passing).unwrap();
    let (status, body) = health_when(&server, |w| w["retries"] == 1).await;
    assert_eq!(
        (status, &body["status"], &body["worlds"][0]["health"]),
        (200, &json!("ok"), &json!("good"))
    );
    assert_eq!(body["worlds"][0]["trouble_code"], "not_finite");

    // One that stays for a tick costs some weather: the world is degraded, and still served.
    host.inject(fault(soon(&body), Field::Water, Damage::Scale(0.9), u32::MAX))
        .unwrap();
    let (status, body) = health_when(&server, |w| w["health"] == "degraded").await;
    assert_eq!((status, &body["status"]), (200, &json!("degraded")));
    let told = &body["worlds"][0];
    assert_eq!(
        (&told["trouble_code"], &told["restores"]),
        (&json!("water_budget_broken"), &json!(1))
    );
    assert!(told["trouble_message"].as_str().unwrap().contains("went back"));
    let summary = &server.get("/v1/worlds").await.json()[0];
    assert_eq!(summary["numbers"]["trouble_code"], "water_budget_broken");
    assert_eq!(server.get("/v1/worlds/w1").await.json()["numbers"]["restores"], 1);
    loop {
        let numbers = next_of(&mut socket, "tick").await["numbers"].clone();
        if numbers["health"] == "degraded" {
            assert_eq!(numbers["trouble_code"], "water_budget_broken");
            break;
        }
    }

    // Faults in tick after tick: the world halts, says so, and goes on showing its last good sky.
    let from = soon(&body);
    for tick in from..from + 1 + KEPT as u64 {
        host.inject(fault(tick, Field::Heat, Damage::Cell(CELL, f32::NAN), u32::MAX))
            .unwrap();
    }
    let (status, body) = health_when(&server, |w| w["health"] == "halted").await;
    assert_eq!((status, &body["status"]), (503, &json!("halted")));
    let told = &body["worlds"][0];
    assert_eq!((&told["running"], &told["paused"]), (&json!(true), &json!(true)));
    let halted_at = told["tick"].as_u64();
    let frame = server.get("/v1/worlds/w1/frame?format=png&width=64&height=36").await;
    assert_eq!(frame.status, 200);
    let image = image::load_from_memory(&frame.body).unwrap().to_luma8();
    let spread = image.iter().max().unwrap() - image.iter().min().unwrap();
    assert!(spread > 5, "the halted sky is blank");
    loop {
        let numbers = next_of(&mut socket, "tick").await["numbers"].clone();
        if numbers["health"] == "halted" {
            assert_eq!(numbers["paused"], true);
            break;
        }
    }

    // An operator lets it go on.
    host.view().command(Command::Resume {}).unwrap();
    let (status, body) = health_when(&server, |w| w["tick"].as_u64() > halted_at.map(|t| t + 2)).await;
    assert_eq!((status, &body["status"]), (200, &json!("degraded")));
    drop(socket);
    assert_eq!(server.delete("/v1/worlds/w1").await.status, 204);
    drop(host);
    assert!(watcher.await.unwrap() > 10);
}
