//! What a world says of its air: channels against the fields that they are made of, samples against what is known in advance,
//! and weather only for those who ask.

use std::sync::Arc;
use std::time::Duration;

use serde_json::{Value, json};
use welkin_proto::sample::Quantity;
use welkin_proto::wire::Command;
use welkin_proto::{Channel, Scene};
use welkin_server::host::Host;
use welkin_server::sample::{Moments, When, sample};
use welkin_server::weather::{FieldSet, LINGER, Reach, Weather};
use welkin_server::world::World;
use welkin_shaders::catalogue::Field;

#[path = "common.rs"]
mod common;

fn scene(change: impl FnOnce(&mut Value)) -> Scene {
    let mut scene = common::scene();
    scene["domain"]["cells"] = json!([8, 6, 10]);
    scene["domain"]["surface_altitude_m"] = json!(350.0);
    change(&mut scene);
    serde_json::from_value(scene).unwrap()
}

fn weather(world: &mut World) -> Arc<Weather> {
    world.add_wind(0.0, 0.0); // the cloud of a state that was written is made by a command
    let volume = world.snapshot().volume;
    Arc::new(Weather::new(world.weather(FieldSet::ALL, volume).unwrap(), 1))
}

fn at(weather: &Arc<Weather>, quantity: Quantity, place: [f64; 3]) -> f64 {
    f64::from(sample(&Moments::at(weather), &[quantity], &[place]).unwrap()[0][0])
}

fn channel(weather: &Arc<Weather>, channel: Channel, place: [f64; 3]) -> f64 {
    at(weather, Quantity::Channel(channel), place)
}

/// Values of a field by the place of each value, which lies `ahead` cells from its cell's south-west lower corner.
fn by_place(world: &World, ahead: [f64; 3], value: impl Fn([f64; 3]) -> f64) -> Vec<f32> {
    let grid = world.parameters().grid;
    let [nx, ny, _] = grid.cells;
    let place = |i: usize| {
        let cell = [i % nx, i / nx % ny, i / (nx * ny)];
        [0, 1, 2].map(|a| (cell[a] as f64 + ahead[a]) * f64::from(grid.cell_size_m[a]))
    };
    (0..grid.len()).map(|i| value(place(i)) as f32).collect()
}

const CENTRE: [f64; 3] = [0.5, 0.5, 0.5];

#[test]
fn what_is_linear_in_space_comes_back_to_rounding() {
    let mut world = World::new(scene(|_| {}), Some(1)).unwrap();
    let water = |[x, y, z]: [f64; 3]| 1e-3 + 1e-6 * x + 2e-6 * y - 5e-7 * z;
    let wind = |[x, y, z]: [f64; 3]| 2.0 + 1e-3 * x - 2e-3 * y + 5e-3 * z;
    for (field, ahead, value) in [
        (Field::Water, CENTRE, &water as &dyn Fn([f64; 3]) -> f64),
        (Field::VelocityX, [0.0, 0.5, 0.5], &wind),
        (Field::VelocityY, [0.5, 0.0, 0.5], &wind),
        (Field::VelocityZ, [0.5, 0.5, 0.0], &|[_, _, z]| 1e-3 * z),
    ] {
        let values = by_place(&world, ahead, value);
        world.write_field(field, &values).unwrap();
    }
    let weather = weather(&mut world);
    // Where the linear field does not meet itself over the box's side: between the second centre and the last but one.
    for i in 0..200 {
        let share = |n: usize| (i * n % 200) as f64 / 200.0;
        let place = [
            300.0 + 1000.0 * share(7),
            300.0 + 600.0 * share(11),
            75.0 + 1350.0 * share(13),
        ];
        // Rounding of 32-bit fields: 6e-8 of the largest value.
        let got = channel(&weather, Channel::TotalWaterKgKg, place);
        assert!(
            (got - water(place)).abs() < 6e-8 * 6e-3,
            "{place:?} {got} {}",
            water(place)
        );
        for c in [Channel::WindXMS, Channel::WindYMS] {
            let got = channel(&weather, c, place);
            assert!(
                (got - wind(place)).abs() < 3e-6,
                "{place:?} {} {got} {}",
                c.name(),
                wind(place)
            );
        }
        // The lid's face has no w: the highest cell's centre knows of it.
        if place[2] < 1275.0 {
            let got = channel(&weather, Channel::WindZMS, place);
            assert!((got - 1e-3 * place[2]).abs() < 3e-7, "{place:?} {got}");
        }
    }
    // Below the lowest centre the vertical wind goes on to nothing at the ground, as it does between faces.
    for z in [0.0, 20.0, 74.0] {
        let got = channel(&weather, Channel::WindZMS, [800.0, 600.0, z]);
        assert!((got - 1e-3 * z).abs() < 1e-7, "{z} {got}");
    }
    assert_eq!(channel(&weather, Channel::WindZMS, [800.0, 600.0, 1500.0]), 0.0);
}

#[test]
fn a_uniform_wind_is_uniform_also_beside_the_box_and_at_ground_and_lid() {
    let mut world = World::new(
        scene(|s| {
            s["effects"].as_object_mut().unwrap().remove("bubble");
        }),
        Some(1),
    )
    .unwrap();
    world.add_wind(-8.0, -4.0); // to the 5 m/s of the base state
    let weather = weather(&mut world);
    for place in [
        [0.0, 0.0, 0.0],
        [-1.0, 7e5, 1500.0],
        [1599.99, 1200.0, 750.0],
        [1e6, -1e6, 3.0],
    ] {
        assert_eq!(channel(&weather, Channel::WindXMS, place), -3.0, "{place:?}");
        assert_eq!(channel(&weather, Channel::WindYMS, place), -4.0, "{place:?}");
        assert_eq!(at(&weather, Quantity::WindSpeedMS, place), 5.0);
        // From the north-east: atan2(3, 4) east of north.
        assert!((at(&weather, Quantity::WindFromDeg, place) - 36.869_897_6).abs() < 1e-4);
    }
    for place in [[0.0, 0.0, -0.01], [0.0, 0.0, 1500.01], [0.0, 0.0, 1e5]] {
        for quantity in [
            Quantity::WindSpeedMS,
            Quantity::Channel(Channel::VisibilityM),
            Quantity::WindFromDeg,
        ] {
            assert!(at(&weather, quantity, place).is_nan(), "{place:?}");
        }
    }
}

#[test]
fn the_box_repeats_as_it_does_in_pictures() {
    let mut world = World::new(scene(|_| {}), Some(1)).unwrap();
    let uneven = by_place(&world, CENTRE, |[x, y, z]| {
        1e-3 * (1.0 + (x * 0.37 + y * 0.11 + z * 0.07).sin())
    });
    world.write_field(Field::Water, &uneven).unwrap();
    let weather = weather(&mut world);
    for place in [[10.0, 10.0, 400.0], [850.0, 1190.0, 777.0]] {
        let here = channel(&weather, Channel::TotalWaterKgKg, place);
        for [east, north] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 3.0], [-2.0, -5.0]] {
            let there = [place[0] + 1600.0 * east, place[1] + 1200.0 * north, place[2]];
            assert_eq!(channel(&weather, Channel::TotalWaterKgKg, there), here, "{there:?}");
        }
    }
    // Across the side: half-way between the last centre and the first.
    let field = weather.field(Channel::TotalWaterKgKg).unwrap();
    let grid = *weather.grid();
    let mean = 0.5 * (f64::from(field[grid.index(7, 2, 3)]) + f64::from(field[grid.index(0, 2, 3)]));
    assert!((channel(&weather, Channel::TotalWaterKgKg, [0.0, 500.0, 525.0]) - mean).abs() < 1e-10);
}

#[test]
fn derived_channels_are_those_of_the_tick_and_of_the_picture() {
    let turbulent = |s: &mut Value| {
        s["domain"]["cells"] = json!([16, 16, 16]);
        s["effects"]["turbulence"] = json!({ "smagorinsky_coefficient": 0.2, "turbulent_prandtl_number": 0.33 });
        s["effects"]["aerial_perspective"] = json!({ "visibility_m": 20000.0 });
        s["domain"]["surface_altitude_m"] = json!(0.0);
    };
    let mut world = World::new(scene(turbulent), Some(1)).unwrap();
    world.advance_by(120.0);
    let weather = weather(&mut world);
    let field = |c: Channel| weather.field(c).unwrap();
    let volume = weather.volume.clone().unwrap();
    assert!(
        volume.cloudy_levels[0] < volume.cloudy_levels[1],
        "the bubble must have made a cloud"
    );
    assert_eq!(field(Channel::ExtinctionPerM)[..], volume.extinction_per_m[..]);
    let device = |f: Field| world.device().read(f).unwrap().into_owned();
    // The same kernel on the same state: the same bits.
    assert_eq!(field(Channel::LiquidWaterKgKg)[..], device(Field::CloudWater)[..]);
    assert_eq!(field(Channel::TotalWaterKgKg)[..], device(Field::Water)[..]);

    let p = &weather.parameters;
    let names = [
        Channel::TemperatureK,
        Channel::PressurePa,
        Channel::RelativeHumidity,
        Channel::VapourKgKg,
        Channel::EffectiveRadiusM,
        Channel::VisibilityM,
        Channel::EddyDissipationRateM23S,
    ];
    let [temperature, pressure, humidity, vapour, radius, visibility, dissipation] = names.map(field);
    let cloud = field(Channel::LiquidWaterKgKg);
    let mut cloudy = 0;
    for i in 0..cloud.len() {
        let saturated =
            welkin_shaders::constants::saturation_specific_humidity(pressure[i].into(), temperature[i].into());
        // Over q_s instead of over e_s the humidity differs by a share 1 - epsilon of the water, 2 % at most.
        let by_mass = f64::from(vapour[i]) / saturated;
        assert!((f64::from(humidity[i]) - by_mass).abs() < 0.02 * (1.0 - by_mass).abs() + 1e-4);
        if cloud[i] > 1e-6 {
            cloudy += 1;
            // The adjustment leaves 1e-3 K, which is 7e-5 of the saturation.
            assert!((humidity[i] - 1.0).abs() < 2e-4, "{i} {}", humidity[i]);
            // Geometric optics: beta = 3 rho q / (2 rho_w r_e).
            let density = p.density_kg_m3[i / weather.grid().plane()];
            let beta = 1.5 * density * cloud[i] / (1000.0 * radius[i]);
            assert!((beta / volume.extinction_per_m[i] - 1.0).abs() < 1e-5);
            assert!(visibility[i] < 3.0 / volume.extinction_per_m[i]);
        } else {
            assert!(humidity[i] <= 1.0 + 2e-4 && (cloud[i] > 0.0 || radius[i] == 0.0));
        }
        assert!(dissipation[i] >= 0.0 && dissipation[i] < 1.0);
    }
    assert!(cloudy > 10, "{cloudy} cloudy cells");
    assert!(dissipation.iter().any(|&d| d > 0.01), "a rising bubble is turbulent");

    // At its centre a cell's sample is the cell's value; in clear air at the ground visibility is what the scene says.
    let brightest = (0..cloud.len()).max_by(|&a, &b| cloud[a].total_cmp(&cloud[b])).unwrap();
    let cell = [brightest % 16, brightest / 16 % 16, brightest / 256];
    let centre = [0, 1, 2].map(|a| (cell[a] as f64 + 0.5) * [200.0, 200.0, 150.0][a]);
    for c in weather.channels().into_iter().filter(|&c| c != Channel::PressurePa) {
        let (got, there) = (channel(&weather, c, centre), f64::from(field(c)[brightest]));
        assert!((got - there).abs() <= 2e-7 * there.abs(), "{} {got} {there}", c.name());
    }
    let clear = channel(&weather, Channel::VisibilityM, [100.0, 100.0, 0.0]);
    // 3 over the aerosol's and the molecules' share, to rounding of 32-bit floats; ozone near the ground is none.
    assert!((clear / 20_000.0 - 1.0).abs() < 1e-5, "{clear}");
}

#[test]
fn turbulence_is_that_of_lilly_in_a_steady_shear() {
    let mut world = World::new(
        scene(|s| {
            s["effects"] = json!({
                "flow": { "courant_max": 1.0 },
                "turbulence": { "smagorinsky_coefficient": 0.2, "turbulent_prandtl_number": 0.33 },
            });
            s["base_state"] =
                json!({ "kind": "isentropic", "surface_pressure_pa": 100000.0, "potential_temperature_k": 300.0 });
        }),
        Some(1),
    )
    .unwrap();
    let shear_per_s = 0.01;
    let wind = by_place(&world, [0.0, 0.5, 0.5], |[_, _, z]| shear_per_s * z);
    world.write_field(Field::VelocityX, &wind).unwrap();
    let weather = weather(&mut world);
    for level in 2..8 {
        // Smagorinsky without stability: epsilon = l^2 S^3, with Mason's length near the wall.
        let z = 150.0 * (level as f64 + 0.5);
        let free = 0.2 * (200.0f64 * 200.0 * 150.0).cbrt();
        let length_squared = 1.0 / (free.powi(-2) + (0.4 * z).powi(-2));
        let rate = (length_squared * shear_per_s.powi(3)).cbrt();
        let got = channel(&weather, Channel::EddyDissipationRateM23S, [300.0, 300.0, z]);
        // The isentropic base state is neutral to 1e-7 1/s2, against S^2 = 1e-4.
        assert!((got / rate - 1.0).abs() < 2e-3, "{level} {got} {rate}");
    }
    // What the scene lacks is refused by name and reason, in the field and in the sample.
    for c in [
        Channel::TotalWaterKgKg,
        Channel::RelativeHumidity,
        Channel::ExtinctionPerM,
    ] {
        let error = weather.field(c).unwrap_err();
        assert_eq!(error.code, "channel_unavailable");
        assert!(
            error.message.contains("moisture") && error.message.contains(c.name()),
            "{error}"
        );
        let error = sample(&Moments::at(&weather), &[Quantity::Channel(c)], &[[0.0; 3]]).unwrap_err();
        assert_eq!(error.code, "channel_unavailable");
    }
    assert!(
        channel(&weather, Channel::VisibilityM, [0.0, 0.0, 10.0]) > 1e5,
        "clean air is clear"
    );
    // Without `heat` the air is the base state's: isentropic, 300 K at 1000 hPa.
    let surface = channel(&weather, Channel::TemperatureK, [0.0; 3]);
    assert!((surface - 300.0).abs() < 0.01, "{surface}");
}

#[test]
fn temperature_and_pressure_go_on_to_the_ground_and_the_lid() {
    let neutral = |s: &mut Value| {
        s["base_state"] =
            json!({ "kind": "isentropic", "surface_pressure_pa": 98000.0, "potential_temperature_k": 300.0 });
        s["effects"] = json!({ "flow": { "courant_max": 1.0 }, "heat": {} });
    };
    let mut world = World::new(scene(neutral), Some(1)).unwrap();
    let weather = weather(&mut world);
    let (r, cp, g) = (287.04, 1004.64, 9.81);
    let exner_0 = (98_000.0f64 / 1e5).powf(r / cp);
    for i in 0..=100 {
        // Dry neutral air is known in closed form: T = 300 Pi_0 - g z / c_p, p = 1e5 (T / 300)^(c_p / R).
        let z = 15.0 * f64::from(i);
        let temperature = 300.0 * exner_0 - g / cp * z;
        let pressure = 1e5 * (temperature / 300.0).powf(cp / r);
        let got = channel(&weather, Channel::TemperatureK, [1.0, 2.0, z]);
        // 32-bit floats of 300 K.
        assert!((got - temperature).abs() < 1e-4, "{z} {got} {temperature}");
        let got = channel(&weather, Channel::PressurePa, [1.0, 2.0, z]);
        // The Exner function in 32-bit floats, times c_p / R: 2e-7 of 1e5 Pa.
        assert!((got - pressure).abs() < 0.05, "{z} {got} {pressure}");
    }
}

#[test]
fn a_moment_is_found_by_tick_or_second_or_refused() {
    let mut world = World::new(scene(|_| {}), Some(1)).unwrap();
    let mut past: Arc<[Arc<Weather>]> = Arc::default();
    for wind in [0.0, 10.0, 30.0] {
        world.add_wind(wind, 0.0); // 5, 15, 45 m/s, less what the ticks change
        let weather = weather(&mut world);
        past = welkin_server::weather::remember(&past, &weather, usize::MAX);
        world.advance_by(2.0);
        world.advance_by(2.0);
    }
    assert_eq!(
        past.iter().map(|w| (w.tick, w.simulated_s)).collect::<Vec<_>>(),
        [(0, 0.0), (2, 4.0), (4, 8.0)]
    );
    let wind = |when| {
        let moments = Moments::find(&past, when)?;
        let value = sample(&moments, &[Quantity::WindSpeedMS], &[[0.0, 0.0, 75.0]])?[0][0];
        Ok::<_, welkin_proto::ApiError>((moments.moment().tick, moments.moment().simulated_s, value))
    };
    let [a, b, c] = [0, 2, 4].map(|tick| wind(When::Tick(tick)).unwrap());
    assert_eq!([a.0, b.0, c.0], [0, 2, 4]);
    assert_eq!(wind(When::Now).unwrap(), c);
    assert_eq!(wind(When::Simulated(4.0)).unwrap(), b);
    let between = wind(When::Simulated(5.0)).unwrap();
    assert_eq!((between.0, between.1), (2, 5.0));
    assert!(
        (between.2 - (b.2 + 0.25 * (c.2 - b.2))).abs() < 1e-5,
        "{between:?} {b:?} {c:?}"
    );
    assert!(c.2 > b.2 + 20.0, "{c:?}");
    for (when, code) in [
        (When::Tick(3), "tick_not_kept"),
        (When::Tick(5), "not_yet"),
        (When::Simulated(8.5), "not_yet"),
        (When::Simulated(-1.0), "too_old"),
    ] {
        assert_eq!(wind(when).unwrap_err().code, code, "{when:?}");
    }
    // Room for one and a half: the newest stays. A world that went back forgets what lies ahead.
    let newest = past.last().unwrap();
    let short = welkin_server::weather::remember(&past[..2], newest, newest.bytes() * 3 / 2);
    assert_eq!(short.len(), 1);
    assert_eq!(Moments::find(&short, When::Tick(0)).unwrap_err().code, "too_old");
    let back = welkin_server::weather::remember(&past, &past[1], usize::MAX);
    assert_eq!(back.iter().map(|w| w.tick).collect::<Vec<_>>(), [0, 2]);
    assert_eq!(Moments::find(&[], When::Now).unwrap_err().code, "weather_unavailable");
}

/// Prints what a copy and each channel cost for the default scene at full size; holds what they hold in memory.
#[test]
fn what_weather_costs() {
    let scene = welkin_proto::presets::find(welkin_proto::presets::DEFAULT).unwrap();
    let mut world = World::new(scene, Some(2)).unwrap();
    world.advance_by(1.0);
    let volume = world.snapshot().volume;
    let cells = world.parameters().grid.len();
    let ms = |begin: std::time::Instant| begin.elapsed().as_secs_f64() * 1e3;
    let mut least = f64::INFINITY;
    for _ in 0..5 {
        let begin = std::time::Instant::now();
        drop(world.weather(FieldSet::ALL, volume.clone()).unwrap());
        least = least.min(ms(begin));
    }
    println!("a copy of {cells} cells: {least:.2} ms");
    let weather = Weather::new(world.weather(FieldSet::ALL, volume.clone()).unwrap(), 1);
    assert_eq!(weather.bytes(), 6 * 4 * cells, "five fields and the drawn cloud");
    let all = weather.channels();
    for &c in &all {
        let begin = std::time::Instant::now();
        let first = weather.field(c).unwrap();
        println!("{:32}{:.2} ms", c.name(), ms(begin));
        assert!(Arc::ptr_eq(&first, &weather.field(c).unwrap()), "derived once");
    }
    // Wall time is the machine's mood; processor time is the work.
    let before = common::processor_s();
    for _ in 0..20 {
        let weather = Weather::new(world.weather(FieldSet::ALL, volume.clone()).unwrap(), 1);
        all.iter().for_each(|&c| drop(weather.field(c).unwrap()));
    }
    let each_ms = (common::processor_s() - before) / 20.0 * 1e3;
    println!("a copy and all {} channels: {each_ms:.1} ms of a core", all.len());
    assert_eq!(all.len(), Channel::ALL.len(), "the default scene has every channel");
    let wind = FieldSet::of(&[Channel::WindXMS]);
    assert_eq!(
        Weather::new(world.weather(wind, volume).unwrap(), 1).bytes(),
        4 * 4 * cells
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn weather_is_copied_for_those_who_want_it_and_for_nobody_else() {
    let host = Host::spawn("w1", scene(|_| {}), Some(1)).unwrap();
    let view = host.view();
    let settled = async |done: &dyn Fn() -> bool, within: Duration| {
        let end = tokio::time::Instant::now() + within;
        while !done() && tokio::time::Instant::now() < end {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        assert!(done());
    };
    let mut published = view.published.clone();
    for _ in 0..3 {
        published.changed().await.unwrap();
        let p = published.borrow_and_update();
        assert!(
            p.weather.is_none() && p.past.is_empty() && p.wanted.is_none(),
            "nobody asked"
        );
    }
    view.command(Command::Pause {}).unwrap();
    settled(&|| view.newest().snapshot.numbers.paused, common::PATIENCE).await;
    // A world that stands answers too, once, and with no more than was asked for.
    let water = FieldSet::of(&[Channel::TotalWaterKgKg]);
    let wish = view.want_fields(water, Reach::Newest);
    let first = view.weather(water).await.unwrap();
    let weather = first.weather.as_ref().unwrap();
    assert_eq!(weather.tick, first.snapshot.numbers.tick);
    assert!(weather.field(Channel::TotalWaterKgKg).is_ok());
    assert_eq!(weather.field(Channel::WindXMS).unwrap_err().code, "weather_not_kept");
    // Moving the sun changes no air: it is not copied again.
    let sun = json!({ "command": "sun", "sun": { "from": "fixed", "elevation_deg": 10.0, "azimuth_deg": 90.0 } });
    view.command(serde_json::from_value(sun).unwrap()).unwrap();
    settled(&|| view.newest().revision > first.revision, common::PATIENCE).await;
    assert!(Arc::ptr_eq(view.newest().weather.as_ref().unwrap(), weather));
    // Whoever wants the newest alone makes the world keep no more of it.
    view.command(Command::Resume {}).unwrap();
    settled(&|| view.newest().revision > first.revision + 6, common::PATIENCE).await;
    let running = view.newest();
    assert!(running.weather.as_ref().unwrap().tick > weather.tick);
    assert_eq!(running.past.len(), 1);
    view.command(Command::Pause {}).unwrap();
    settled(&|| view.newest().snapshot.numbers.paused, common::PATIENCE).await;
    // More is copied for whoever wants more, and a wind that a command adds is seen.
    let more = view.want_weather();
    let second = view.weather(FieldSet::ALL).await.unwrap();
    assert!(second.weather.as_ref().unwrap().field(Channel::WindXMS).is_ok());
    view.command(Command::Wind {
        add_x_m_s: 7.0,
        add_y_m_s: 0.0,
    })
    .unwrap();
    settled(&|| view.newest().revision > second.revision, common::PATIENCE).await;
    let newest = view.newest().weather.clone().unwrap();
    let calm = channel(second.weather.as_ref().unwrap(), Channel::WindXMS, [10.0, 10.0, 75.0]);
    assert!((channel(&newest, Channel::WindXMS, [10.0, 10.0, 75.0]) - calm - 7.0).abs() < 1e-4);
    // While it runs each publication carries its own, and the past grows.
    view.command(Command::Resume {}).unwrap();
    settled(&|| view.newest().past.len() >= 3, common::PATIENCE).await;
    let p = view.newest();
    assert_eq!(p.weather.as_ref().unwrap().tick, p.snapshot.numbers.tick);
    assert!(p.past.windows(2).all(|w| w[0].simulated_s < w[1].simulated_s));
    // Those who leave are waited for some seconds, also by a world that stands; then its memory is given back.
    view.command(Command::Pause {}).unwrap();
    drop((wish, more));
    let left = std::time::Instant::now();
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert!(view.newest().weather.is_some());
    settled(&|| view.newest().weather.is_none(), LINGER + Duration::from_secs(15)).await;
    assert!(left.elapsed() >= LINGER && view.newest().past.is_empty());
    host.shut_down();
    assert_eq!(view.weather(FieldSet::NONE).await.unwrap_err().code, "world_stopped");
}
