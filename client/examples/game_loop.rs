//! A game's loop that shares its sky with everybody else: volumes come in on a thread of their own, each frame takes what is to be shown now, in step with all
//! other clients. `cargo run -p welkin-client --example game_loop -- http://127.0.0.1:8080 5` runs for five seconds.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use welkin_client::clock::{Delay, Playout};
use welkin_client::volume::{VolumeEvent, VolumeOptions, subscribe, unix_now_s};

const WIND: [&str; 3] = ["wind_x_m_s", "wind_y_m_s", "wind_z_m_s"];

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let url = std::env::args().nth(1).unwrap_or("http://127.0.0.1:8080".to_owned());
    let seconds = std::env::args().nth(2).map_or(Ok(5.0), |text| text.parse())?;
    let mut options = VolumeOptions::default();
    options.subscription.channels.extend(WIND.map(str::to_owned));
    let mut volumes = subscribe(&url, options)?;
    // Everybody plays a second behind the server, so that everybody sees the same at the same moment.
    let sky = Arc::new(Mutex::new((Playout::new(Delay::Fixed(1.0)), 0.0)));
    let network = Arc::clone(&sky);
    tokio::spawn(async move {
        while let Some(event) = volumes.next().await {
            if let (VolumeEvent::Volume { field, .. }, Ok(mut sky)) = (event, network.lock()) {
                let server_s = volumes.server_unix_s().unwrap_or_else(unix_now_s);
                sky.0.push(field, server_s);
                sky.1 = server_s - unix_now_s(); // what to add to our clock
            }
        }
    });
    let began = Instant::now();
    let mut glider_m = [3200.0, 3200.0, 900.0];
    while began.elapsed().as_secs_f64() < seconds {
        let shown = sky.lock().ok().and_then(|mut sky| {
            let now_s = unix_now_s() + sky.1;
            sky.0.at(now_s)
        });
        if let Some(shown) = shown {
            let air = WIND.map(|name| shown.value_at(name, glider_m).unwrap_or(0.0));
            (0..3).for_each(|axis| glider_m[axis] += f64::from(air[axis]) / 60.0);
            println!(
                "{:.2} s: glider at {glider_m:.1?} m, air {air:.2?} m/s",
                shown.simulated_s
            );
        }
        std::thread::sleep(Duration::from_millis(16)); // here the game draws
    }
    Ok(())
}
