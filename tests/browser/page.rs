//! The web page in a real browser against a real server: `page.mjs` and `local.mjs` drive a headless Chromium, without and with WebGPU; this side finds
//! the tools, runs the server, and takes it away and brings it back when a driver asks for that.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use futures_util::StreamExt;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use welkin_client::volume::{VolumeEvent, VolumeOptions, subscribe};
use welkin_proto::volume::subscribe::Subscription;
use welkin_proto::{Scene, presets};
use welkin_server::http::{AppState, serve_until};
use welkin_server::limits::Limits;
use welkin_server::watchdog::{Damage, Fault};
use welkin_shaders::catalogue::Field;

/// The driver ends by itself after four minutes; this is for a driver that does not.
const DRIVER_LIMIT: Duration = Duration::from_secs(270);

/// A server that can be stopped and started again on the same port.
struct Server {
    stop: oneshot::Sender<()>,
    serving: JoinHandle<std::io::Result<()>>,
    address: SocketAddr,
    state: AppState,
}

impl Server {
    async fn start(address: SocketAddr, scene: Scene) -> Self {
        let listener = TcpListener::bind(address).await.expect("the port is free");
        let address = listener.local_addr().expect("a bound listener has an address");
        let state = AppState::new(Limits::default(), None).expect("the server starts");
        state.create_world(scene).await.expect("the scene is good");
        let (stop, stopped) = oneshot::channel();
        let worlds = state.clone();
        let stopping = async move {
            let _ = stopped.await; // a sender that was dropped stops it too
        };
        let serving = tokio::spawn(serve_until(listener, state, stopping));
        Self {
            stop,
            serving,
            address,
            state: worlds,
        }
    }

    /// Makes a tick of every world fail for good.
    fn strike(&self) {
        for host in self.state.worlds() {
            let fault = Fault {
                tick: host.summary().numbers.tick + 8,
                substep: 0,
                field: Field::VelocityX,
                damage: Damage::Cell(0, f32::NAN),
                strikes: u32::MAX,
            };
            host.inject(fault).expect("the world runs");
        }
    }

    async fn stop(self) {
        let _ = self.stop.send(());
        self.serving
            .await
            .expect("the server does not panic")
            .expect("serving ends well");
    }
}

/// Native clients who ask for what the page asks for, and what they hold: a hash of all values by tick.
#[derive(Clone, Default)]
struct Natives {
    held: Arc<Mutex<Vec<BTreeMap<u64, u32>>>>,
}

impl Natives {
    /// Ten, who come one after another.
    async fn subscribe(&self, address: SocketAddr) {
        for n in 0..10 {
            let options = VolumeOptions {
                subscription: Subscription {
                    rate_hz: 4.0,
                    ..Subscription::default()
                },
                ..VolumeOptions::default()
            };
            let mut volumes = subscribe(&format!("http://{address}"), options).expect("a good URL");
            let held = Arc::clone(&self.held);
            held.lock().expect("nobody panics").push(BTreeMap::new());
            tokio::spawn(async move {
                while let Some(event) = volumes.next().await {
                    if let VolumeEvent::Volume { field, .. } = event {
                        let values = field.channels[0].values();
                        // FNV-1a, as the driver has it.
                        let hash = values
                            .iter()
                            .flat_map(|v| v.to_le_bytes())
                            .fold(0x811c_9dc5, |hash: u32, byte| {
                                (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)
                            });
                        held.lock().expect("nobody panics")[n].insert(field.moment.tick, hash);
                    }
                }
            });
            tokio::time::sleep(Duration::from_millis(150)).await;
        }
    }

    /// Compares what a browser holds; says how much of it natives hold too.
    fn compare(&self, json: &str) -> String {
        let theirs: BTreeMap<u64, u32> = serde_json::from_str(json).expect("hashes by tick");
        let held = self.held.lock().expect("nobody panics");
        let pairs = held.iter().flat_map(|client| {
            let common = client
                .iter()
                .filter_map(|(tick, hash)| theirs.get(tick).map(|t| (tick, t, hash)));
            common.collect::<Vec<_>>()
        });
        let pairs: Vec<_> = pairs.collect();
        let clients = held
            .iter()
            .filter(|client| client.keys().any(|tick| theirs.contains_key(tick)));
        match pairs.iter().find(|(_, theirs, ours)| theirs != ours) {
            Some((tick, ..)) => format!("OTHER at tick {tick}"),
            None if clients.clone().count() < 10 => format!("FEW: {} clients", clients.count()),
            None => format!("SAME {} fields of {} clients", pairs.len(), clients.count()),
        }
    }
}

/// Fair-weather cumulus on few cells, so that the browser and the server get by on two cores.
fn small_scene() -> Scene {
    let mut scene = presets::find(presets::DEFAULT).expect("the default preset is there");
    scene.name = "small cumulus".to_owned();
    scene.domain.cells = [32, 32, 40];
    scene.domain.cell_size_m = [100.0, 100.0, 75.0];
    scene.time.spin_up_s = 600.0;
    // Eight ticks a second: a picture is drawn when there is something new to show.
    scene.time.time_scale = 16.0;
    scene.time.tick_s = 2.0;
    scene.camera.position_m = [1600.0, 1600.0, 100.0];
    scene
}

fn on_path(names: &[&str]) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let places: Vec<PathBuf> = std::env::split_paths(&path).collect();
    names
        .iter()
        .find_map(|name| places.iter().map(|place| place.join(name)).find(|file| file.is_file()))
}

/// Browser and node, or what is missing.
fn tools(here: &Path) -> Result<(PathBuf, PathBuf), String> {
    let browser = on_path(&["chromium", "chromium-browser", "google-chrome"]);
    let node = on_path(&["node"]);
    let driver = here.join("node_modules/playwright-core/package.json").is_file();
    let mut missing = Vec::new();
    if browser.is_none() {
        missing.push("a browser (chromium, chromium-browser or google-chrome)");
    }
    if node.is_none() {
        missing.push("node");
    }
    if !driver {
        missing.push("playwright-core (npm ci in tests/browser)");
    }
    match (browser, node, driver) {
        (Some(browser), Some(node), true) => Ok((browser, node)),
        _ => Err(missing.join(", ")),
    }
}

/// Ends the driver whatever happens to the test.
struct Driver(Child);

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.0.kill(); // it has ended already where all is well
        let _ = self.0.wait();
    }
}

/// Chromium and node, or `None` after a loud skip. Fails where `WELKIN_REQUIRE` names `browser`.
fn tools_or_skip(here: &Path) -> Option<(PathBuf, PathBuf)> {
    match tools(here) {
        Ok(tools) => Some(tools),
        Err(missing) => {
            welkin_tests::skip("the web page", "browser", missing);
            None
        }
    }
}

/// Runs a driver against a server of its own; it must pass and leave these pictures.
fn drive(script: &str, scene: &Scene, pictures: &[&str]) {
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("browser");
    let Some((browser, node)) = tools_or_skip(&here) else {
        return;
    };
    let runtime = Runtime::new().expect("a runtime");
    let mut server = Some(runtime.block_on(Server::start(([127, 0, 0, 1], 0).into(), scene.clone())));
    let address = server.as_ref().expect("it was started above").address;

    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("browser");
    let mut driver = Driver(
        Command::new(node)
            .arg(here.join(script))
            .arg(format!("http://{address}"))
            .arg(&out)
            .env("WELKIN_CHROMIUM", browser)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("node starts"),
    );
    let mut to_driver = driver.0.stdin.take().expect("it is piped");
    let from_driver = BufReader::new(driver.0.stdout.take().expect("it is piped"));
    let (sender, lines) = channel();
    std::thread::spawn(move || {
        for line in from_driver.lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                break;
            }
        }
    });

    let natives = Natives::default();
    let end = Instant::now() + DRIVER_LIMIT;
    let mut passed = false;
    loop {
        let line = match lines.recv_timeout(end.saturating_duration_since(Instant::now())) {
            Ok(line) => line,
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => panic!("the driver did not end within {} s", DRIVER_LIMIT.as_secs()),
        };
        match line.as_str() {
            "STOP" => {
                let running = server.take().expect("STOP comes while it runs");
                runtime.block_on(running.stop());
                writeln!(to_driver, "STOPPED").expect("the driver listens");
            }
            "START" => {
                server = Some(runtime.block_on(Server::start(address, scene.clone())));
                writeln!(to_driver, "STARTED").expect("the driver listens");
            }
            "STRIKE" => {
                server.as_ref().expect("STRIKE comes while it runs").strike();
                writeln!(to_driver, "STRUCK").expect("the driver listens");
            }
            "NATIVES" => {
                runtime.block_on(natives.subscribe(address));
                writeln!(to_driver, "SUBSCRIBED").expect("the driver listens");
            }
            "PASSED" => passed = true,
            compare if compare.starts_with("COMPARE ") => {
                let said = natives.compare(&compare["COMPARE ".len()..]);
                writeln!(to_driver, "{said}").expect("the driver listens");
            }
            other => println!("{other}"),
        }
    }
    let status = driver.0.wait().expect("the driver can be waited for");
    assert!(
        status.success() && passed,
        "the page failed a check, see above; pictures are in {}",
        out.display()
    );
    if let Some(running) = server.take() {
        runtime.block_on(running.stop());
    }
    for picture in pictures {
        let bytes = std::fs::metadata(out.join(picture)).map(|m| m.len()).unwrap_or(0);
        assert!(bytes > 5_000, "{picture} has {bytes} bytes");
    }
}

#[test]
fn the_page_shows_a_live_sky_and_survives_the_loss_of_its_server() {
    drive(
        "page.mjs",
        &small_scene(),
        &[
            "desktop.png",
            "layers.png",
            "lost.png",
            "arrows.png",
            "degraded.png",
            "phone.png",
            "phone-panel.png",
            "phone-arrows.png",
        ],
    );
}

#[test]
fn the_page_draws_the_same_sky_itself() {
    let mut scene = small_scene();
    // Forty minutes in long ticks: clouds are there after some seconds.
    scene.time.spin_up_s = 2400.0;
    scene.time.tick_s = 20.0;
    scene.time.time_scale = 40.0;
    drive("local.mjs", &scene, &["here.png", "server.png", "window.png"]);
}

/// Runs a script of the page's own modules without a browser; it must pass.
fn run_by_node(script: &str, arguments: &[PathBuf]) {
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("browser");
    let Some((_, node)) = tools_or_skip(&here) else {
        return;
    };
    let ran = Command::new(node)
        .arg(here.join(script))
        .args(arguments)
        .output()
        .expect("node starts");
    let said = String::from_utf8_lossy(&ran.stdout).into_owned();
    let complaints = String::from_utf8_lossy(&ran.stderr).into_owned();
    assert!(ran.status.success() && said.contains("PASSED"), "{said}{complaints}");
}

/// The page's decoder of volumes on the vectors of the protocol.
#[test]
fn the_page_reads_volumes_as_the_protocol_says() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    run_by_node("volume.mjs", &[fixtures.join("volume")]);
}

/// The page's clock, its playing between two volumes and its past.
#[test]
fn the_page_plays_volumes_as_the_protocol_says() {
    run_by_node("playout.mjs", &[]);
}
