//! A game's main loop that shares its sky with everybody else: volumes come in on a thread of their own, each frame takes what is to be
//! shown now, smoothly between two of them, in step with all other clients.
//!
//! `cargo run -p welkin-client --example game_loop -- http://127.0.0.1:8080 5` runs for five seconds.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use welkin_client::clock::{Delay, Playout};
use welkin_client::volume::{VolumeEvent, VolumeOptions, subscribe, unix_now_s};
use welkin_proto::volume::subscribe::Subscription;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let url = std::env::args().nth(1).unwrap_or("http://127.0.0.1:8080".to_owned());
    let seconds = std::env::args().nth(2).map_or(Ok(5.0), |text| text.parse())?;
    // Everybody plays half a second behind the server, so that everybody sees the same at the same moment.
    let sky = Arc::new(Mutex::new((Playout::new(Delay::Fixed(0.5)), None)));
    let network = Arc::clone(&sky);
    std::thread::spawn(move || -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        runtime.block_on(async {
            let channels = ["extinction_per_m", "wind_x_m_s", "wind_y_m_s", "wind_z_m_s"];
            let subscription = Subscription {
                channels: channels.map(str::to_owned).to_vec(),
                mip: 1,
                rate_hz: 4.0,
                ..Subscription::default()
            };
            let mut volumes = subscribe(
                &url,
                VolumeOptions {
                    subscription,
                    ..VolumeOptions::default()
                },
            )?;
            while let Some(event) = volumes.next().await {
                match event {
                    VolumeEvent::Volume { field, .. } => {
                        let Ok(mut sky) = network.lock() else { break };
                        let server_s = volumes.server_unix_s();
                        sky.0.push(field, server_s.unwrap_or_else(unix_now_s));
                        sky.1 = server_s.map(|server_s| server_s - unix_now_s()); // what to add to our clock
                    }
                    VolumeEvent::Error { error, next } => eprintln!("{error} ({next})"),
                    VolumeEvent::Hello(_) | VolumeEvent::Subscribed(_) => {}
                }
            }
            Ok(())
        })
    });

    let began = Instant::now();
    let mut glider_m = [3200.0, 3200.0, 900.0];
    while began.elapsed().as_secs_f64() < seconds {
        if let Ok(mut sky) = sky.lock()
            && let Some(offset_s) = sky.1
            && let Some(shown) = sky.0.at(unix_now_s() + offset_s)
        {
            let air =
                ["wind_x_m_s", "wind_y_m_s", "wind_z_m_s"].map(|name| shown.value_at(name, glider_m).unwrap_or(0.0));
            (0..3).for_each(|axis| glider_m[axis] += f64::from(air[axis]) / 60.0);
            glider_m[2] = glider_m[2].clamp(0.0, 2900.0);
            let extinction_per_m = shown.value_at("extinction_per_m", glider_m).unwrap_or(0.0);
            println!(
                "{:.2} s: glider at {glider_m:.1?} m, air {air:.2?} m/s, visibility {:.0} m",
                shown.simulated_s,
                3.0 / extinction_per_m.max(1e-4)
            );
        }
        std::thread::sleep(Duration::from_millis(16)); // here the game draws
    }
    Ok(())
}
