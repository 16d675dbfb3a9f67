//! `welkin bench`: what the default scene costs on this machine. It reports and does not judge.

mod beside;
mod scaling;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rayon::prelude::*;
use serde::Serialize;
use welkin_proto::wire::{Command as WorldCommand, FrameFormat, PassReport};
use welkin_proto::{ApiError, presets};
use welkin_shaders::gpu;

use crate::cli::DeviceFlag;
use crate::host::renderer::{FrameRequest, RenderService, Viewer};
use crate::host::{Host, View};
use crate::machine::{Compute, Machine, gpu_failure};

/// The page's frames: size, and how many a second it asks for.
const PAGE_SIZE: [u32; 2] = [640, 360];
/// Sizes of frames that are measured alone, the page's first.
const SIZES: [[u32; 2]; 3] = [PAGE_SIZE, [1280, 720], [1920, 1080]];
const PAGE_FRAMES_PER_S: f64 = 5.0;
/// Pairs of pictures of a case that is drawn on two devices, unless told otherwise.
const PAIRS: u16 = 7;
/// A started server that shows nothing for so long has failed.
const FIRST_FRAME_MAX: Duration = Duration::from_secs(60);

pub(crate) const EXAMPLES: &str = "\
Examples:
  welkin bench --json bench.json            how fast this machine is
  welkin bench --scaling                    what a cell costs by the size of the grid
  welkin bench --beside llvmpipe            the CPU's march beside the same WGSL on the CPU (Mesa's lavapipe)
  welkin bench --beside gpu --pairs 15      what a GPU is worth in pictures, each drawn fifteen times on both

What --beside does: pictures of broken cumulus and of the inside of a cloud are drawn on the CPU and on the adapter in turns, with
every pixel marched and at half the resolution, with the tables of the picture before and with new ones. A first pair that
compiles shaders and makes tables is not counted. The ratio is the adapter's time over the CPU's just before it, the median of the
pairs, so that a machine that others use too tells much the same; it is more than 1 where the CPU is faster. --threads is the CPU
device's; an adapter that is software has its own threads.";

/// What to measure.
#[derive(clap::Args, Clone, Debug)]
pub struct BenchOptions {
    /// Scene: a preset's name.
    #[arg(long, value_name = "PRESET", default_value = presets::DEFAULT)]
    pub scene: String,
    /// Simulated seconds that the scene runs before anything is measured; its spin-up unless given.
    #[arg(long, value_name = "SECONDS")]
    pub after: Option<f64>,
    /// Wall seconds of each measurement.
    #[arg(long, value_name = "SECONDS", default_value_t = 10.0)]
    pub seconds: f64,
    /// Worker threads; as many as the machine has cores unless given.
    #[arg(long, value_name = "N")]
    pub threads: Option<std::num::NonZeroUsize>,
    #[command(flatten)]
    pub(crate) device: DeviceFlag,
    /// Measure instead what a cell costs on grids from 32 to 256 cubed; the largest takes 3 GiB and half a minute.
    #[arg(long)]
    pub scaling: bool,
    /// Measure instead the same pictures on the CPU and on this adapter, in turns: a part of its name, or gpu (any adapter, software too).
    #[arg(long, value_name = "ADAPTER", conflicts_with_all = ["scaling", "scene", "after", "seconds", "device"])]
    pub beside: Option<String>,
    /// Pairs of pictures that are counted, a case.
    #[arg(long, value_name = "N", default_value_t = PAIRS, requires = "beside", value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub pairs: u16,
    /// Also write the report as JSON.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// The commit that is measured, for the report.
    #[arg(long, value_name = "HASH")]
    pub commit: Option<String>,
}

/// Simulation over one measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Simulation {
    /// Ticks a wall second.
    pub ticks_per_s: f64,
    /// Simulated seconds a wall second.
    pub times_real_time: f64,
    /// Mean wall milliseconds a tick, waiting included.
    pub tick_ms: f64,
    /// Cells advanced by one substep, a wall second; the substeps of the last tick stand for all.
    pub cell_substeps_per_s: f64,
}

/// Frames over one measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Frames {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Frames that came.
    pub count: usize,
    /// Frames a wall second.
    pub per_s: f64,
    /// Mean milliseconds to render.
    pub render_ms_mean: f64,
    /// Milliseconds to render that 95 in 100 frames stay below.
    pub render_ms_p95: f64,
    /// Mean milliseconds to encode as JPEG.
    pub encode_ms_mean: f64,
    /// Mean bytes of a frame.
    pub bytes_mean: f64,
}

/// A pass of the simulation.
#[derive(Clone, Debug, Serialize)]
pub struct PassCost {
    /// Its name in the catalogue.
    pub pass: String,
    /// Mean milliseconds a run, by the device's clock where it has one.
    pub mean_ms: f64,
    /// Runs a substep.
    pub runs_per_substep: f64,
    /// Bytes a cell that it must move.
    pub bytes_per_cell: u64,
    /// Those bytes over the time, for the whole grid, a second.
    pub bytes_per_s: f64,
    /// That over what a copy reaches on this device. More than 1 means that fields stay in cache.
    pub share_of_copy: f64,
}

/// The whole report.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The program's version.
    pub version: String,
    /// The commit, if it was told.
    pub commit: Option<String>,
    /// What the world ran on.
    pub device: String,
    /// Bytes that a copy reads and writes a second on the device, more than its caches hold.
    pub copy_bytes_per_s: f64,
    /// Bytes a cell that the passes of a substep must move, each value once a pass.
    pub bytes_per_cell_substep: f64,
    /// Cell substeps a second that would leave nothing but those bytes to wait for.
    pub cell_substeps_per_s_floor: f64,
    /// The passes, in order.
    pub passes: Vec<PassCost>,
    /// The processor's name, where the system tells it.
    pub processor: Option<String>,
    /// Cores that the system offers.
    pub cores: usize,
    /// The scene's name.
    pub scene: String,
    /// Cells east, north, up.
    pub cells: [u32; 3],
    /// Wall seconds from the start of the server's process to the first frame's last byte.
    pub first_frame_s: f64,
    /// Resident memory of the serving process after its first frame, MiB, where the system tells it.
    pub resident_first_frame_mib: Option<f64>,
    /// Simulated second at which the measurements below begin.
    pub measured_from_s: f64,
    /// Wall seconds to get there.
    pub spin_up_wall_s: f64,
    /// Share of columns with cloud when the measurements begin.
    pub cloud_cover: Option<f64>,
    /// Simulation with nobody looking, as fast as it can.
    pub simulation_alone: Simulation,
    /// Simulation as fast as it can while the page's frames are served.
    pub simulation_with_page: Simulation,
    /// Those frames.
    pub page_frames: Frames,
    /// Frames of a paused world that moves its camera, as fast as they come, in three sizes.
    pub frames_alone: Vec<Frames>,
    /// Resident memory of this process at the end, MiB, where the system tells it.
    pub resident_mib: Option<f64>,
}

/// Why a benchmark could not be run.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The scene or a frame was refused.
    #[error(transparent)]
    Refused(#[from] ApiError),
    /// The system refused something.
    #[error("{0}: {1}")]
    System(&'static str, std::io::Error),
    /// The server that was started did not behave.
    #[error("the server that was started {0}")]
    Server(&'static str),
}

/// Measures, prints the report, and writes it as JSON if asked.
///
/// Errors: see [`BenchError`].
pub fn run(options: &BenchOptions) -> Result<(), BenchError> {
    if let Some(name) = &options.beside {
        return run_beside(options, name);
    }
    if options.scaling {
        return run_scaling(options);
    }
    let report = measure(options)?;
    print(&report);
    write_json(options, &report)
}

fn write_json(options: &BenchOptions, report: &impl Serialize) -> Result<(), BenchError> {
    if let Some(path) = &options.json {
        let text =
            serde_json::to_string_pretty(report).map_err(|e| BenchError::System("cannot write JSON", e.into()))?;
        std::fs::write(path, text).map_err(|e| BenchError::System("cannot write the JSON report", e))?;
    }
    Ok(())
}

fn run_scaling(options: &BenchOptions) -> Result<(), BenchError> {
    let scene = presets::find(&options.scene)?;
    let (machine, copy_bytes_per_s) = machine(options)?;
    // Four sizes share what one measurement takes otherwise.
    let window = Duration::try_from_secs_f64(0.25 * options.seconds).unwrap_or_default();
    let sizes = scaling::measure(&scene, &machine, copy_bytes_per_s, window)?;
    println!(
        "welkin {} on {}, scene {}",
        env!("CARGO_PKG_VERSION"),
        machine.compute.name(),
        scene.name
    );
    print!("{}", scaling::table(&sizes, copy_bytes_per_s));
    write_json(
        options,
        &serde_json::json!({
            "version": env!("CARGO_PKG_VERSION"), "commit": options.commit, "device": machine.compute.name(),
            "processor": proc_value("/proc/cpuinfo", "model name"), "scene": scene.name,
            "copy_bytes_per_s": copy_bytes_per_s, "sizes": sizes,
        }),
    )
}

fn run_beside(options: &BenchOptions, name: &str) -> Result<(), BenchError> {
    let (adapter, adapter_name) = beside::adapter(name)?;
    let cases = beside::measure(&adapter, options.threads, options.pairs.into())?;
    let processor = proc_value("/proc/cpuinfo", "model name");
    let cores: usize = std::thread::available_parallelism().map_or(1, Into::into);
    println!(
        "welkin {}, cpu ({}) beside {}",
        env!("CARGO_PKG_VERSION"),
        processor.as_deref().unwrap_or("processor unknown"),
        adapter_name
    );
    println!(
        "{cores} cores; commit {}; {} pairs a case",
        options.commit.as_deref().unwrap_or("not given"),
        options.pairs
    );
    print!("{}", beside::table(&cases));
    write_json(
        options,
        &serde_json::json!({
            "version": env!("CARGO_PKG_VERSION"), "commit": options.commit, "device": "cpu", "beside": adapter_name,
            "processor": processor, "cores": cores, "threads": options.threads, "pairs": options.pairs, "cases": cases,
        }),
    )
}

/// What to compute on, and what a copy reaches there, bytes a second.
fn machine(options: &BenchOptions) -> Result<(Machine, f64), BenchError> {
    let machine = Machine {
        threads: options.threads.map(Into::into),
        compute: Compute::choose(&options.device.device)?,
    };
    eprintln!("measuring a copy");
    let copy_bytes_per_s = match machine.compute.context() {
        Some(context) => gpu::bandwidth::copy_bytes_per_s(&context).map_err(|e| gpu_failure(&e))?,
        None => cpu_copy_bytes_per_s(),
    };
    Ok((machine, copy_bytes_per_s))
}

fn measure(options: &BenchOptions) -> Result<Report, BenchError> {
    let scene = presets::find(&options.scene)?;
    eprintln!("starting a server for its first frame");
    let (first_frame_s, resident_first_frame_mib) = first_frame(options)?;

    let (machine, copy_bytes_per_s) = machine(options)?;
    let compute = machine.compute.clone();
    let host = Host::spawn("bench", scene.clone(), machine)?;
    let view = host.view();
    let renderer =
        RenderService::start(compute, 1.0).map_err(|e| BenchError::System("cannot start the render thread", e))?;
    view.command(WorldCommand::TimeScale { time_scale: 1000.0 })?;
    let from_s = options.after.unwrap_or(scene.time.spin_up_s);
    eprintln!("running the scene to simulated second {from_s}");
    let began = Instant::now();
    while view.newest().snapshot.numbers.simulated_s < from_s {
        if !view.is_running() {
            return Err(BenchError::Server("has stopped by itself"));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let spin_up_wall_s = began.elapsed().as_secs_f64();
    let start = view.newest();
    let window = Duration::try_from_secs_f64(options.seconds).unwrap_or(Duration::from_secs(10));

    eprintln!("measuring the simulation alone");
    let simulation_alone = simulation(view, || {
        std::thread::sleep(window);
        Ok(())
    })?
    .0;
    eprintln!("measuring it while the page's frames are served");
    let (simulation_with_page, page_frames) = simulation(view, || {
        frames(
            view,
            &renderer,
            PAGE_SIZE,
            window,
            Some(Duration::from_secs_f64(1.0 / PAGE_FRAMES_PER_S)),
        )
    })?;
    eprintln!("measuring frames alone");
    view.command(WorldCommand::Pause {})?;
    while !view.newest().snapshot.numbers.paused {
        std::thread::sleep(Duration::from_millis(5));
    }
    let frames_alone = SIZES
        .iter()
        .map(|size| frames(view, &renderer, *size, window / SIZES.len() as u32, None))
        .collect::<Result<_, _>>()?;
    let passes = passes(view, copy_bytes_per_s);
    let bytes_per_cell_substep = passes
        .iter()
        .map(|p| p.bytes_per_cell as f64 * p.runs_per_substep)
        .sum();

    Ok(Report {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        commit: options.commit.clone(),
        device: host.view().device().to_owned(),
        copy_bytes_per_s,
        bytes_per_cell_substep,
        cell_substeps_per_s_floor: copy_bytes_per_s / bytes_per_cell_substep,
        passes,
        processor: proc_value("/proc/cpuinfo", "model name"),
        cores: std::thread::available_parallelism().map_or(1, Into::into),
        scene: scene.name,
        cells: scene.domain.cells,
        first_frame_s,
        resident_first_frame_mib,
        measured_from_s: start.snapshot.numbers.simulated_s,
        spin_up_wall_s,
        cloud_cover: start.snapshot.numbers.cloud_cover,
        simulation_alone,
        simulation_with_page,
        page_frames,
        frames_alone,
        resident_mib: resident_mib("/proc/self/status"),
    })
}

/// What the passes have cost so far.
fn passes(view: &View, copy_bytes_per_s: f64) -> Vec<PassCost> {
    let cells: f64 = view.scene.domain.cells.iter().map(|n| f64::from(*n)).product();
    let plan = view.plan();
    let substeps = plan.passes.iter().filter(|p| p.phase == "step").map(|p| p.runs).max();
    let substeps = substeps.unwrap_or(0);
    let cost = |pass: &PassReport| {
        let (mean_ms, bytes_per_cell) = (pass.mean_ms?, pass.bytes_per_cell?);
        let bytes_per_s = cells * bytes_per_cell as f64 / (mean_ms * 1e-3).max(1e-9);
        Some(PassCost {
            pass: pass.stage.clone(),
            mean_ms,
            runs_per_substep: if pass.phase == "publish" {
                0.0
            } else {
                pass.runs as f64 / substeps.max(1) as f64
            },
            bytes_per_cell,
            bytes_per_s,
            share_of_copy: bytes_per_s / copy_bytes_per_s,
        })
    };
    plan.passes.iter().filter_map(cost).collect()
}

/// Bytes that copying 128 MiB on all threads reads and writes a second, the best of eight.
fn cpu_copy_bytes_per_s() -> f64 {
    let from = vec![1u8; 128 << 20];
    let mut to = vec![0u8; from.len()];
    let mut best = 0.0f64;
    for _ in 0..8 {
        let began = Instant::now();
        to.par_chunks_mut(1 << 20)
            .zip(from.par_chunks(1 << 20))
            .for_each(|(to, from)| to.copy_from_slice(from));
        best = best.max(2.0 * from.len() as f64 / began.elapsed().as_secs_f64());
    }
    std::hint::black_box(&to);
    best
}

/// How far the world comes while `meanwhile` runs, from publication to publication, by one tick at least.
fn simulation<T>(
    view: &View,
    meanwhile: impl FnOnce() -> Result<T, BenchError>,
) -> Result<(Simulation, T), BenchError> {
    let first = view.newest();
    let made = meanwhile()?;
    let mut last = view.newest();
    // Where a tick takes longer than that, the next one is waited for.
    while last.snapshot.numbers.tick == first.snapshot.numbers.tick && view.is_running() {
        std::thread::sleep(Duration::from_millis(20));
        last = view.newest();
    }
    let wall_s = (last.at - first.at).as_secs_f64();
    let (from, to) = (&first.snapshot.numbers, &last.snapshot.numbers);
    let ticks = (to.tick - from.tick) as f64;
    let cells: f64 = view.scene.domain.cells.iter().map(|n| f64::from(*n)).product();
    let simulation = Simulation {
        ticks_per_s: ticks / wall_s,
        times_real_time: (to.simulated_s - from.simulated_s) / wall_s,
        tick_ms: 1e3 * wall_s / ticks,
        cell_substeps_per_s: cells * ticks * f64::from(to.substeps) / wall_s,
    };
    Ok((simulation, made))
}

/// Asks for frames one after another for so long, each `between` after the last began; the camera turns, so that none is
/// answered from what is kept.
fn frames(
    view: &View,
    renderer: &RenderService,
    [width, height]: [u32; 2],
    window: Duration,
    between: Option<Duration>,
) -> Result<Frames, BenchError> {
    let began = Instant::now();
    let (mut render_ms, mut encode_ms, mut bytes) = (Vec::new(), 0.0, 0);
    let mut due = began;
    while began.elapsed() < window {
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        due = (due + between.unwrap_or_default()).max(Instant::now());
        let mut camera = view.scene.camera.clone();
        camera.azimuth_deg += render_ms.len() as f64;
        camera.azimuth_deg %= 360.0;
        let request = FrameRequest {
            width,
            height,
            format: FrameFormat::Jpeg,
            camera,
            still: false,
            whole: false,
            past: None,
            layers: None,
        };
        let ticket = renderer.request(Viewer::SNAPSHOTS, view, request, 1)?;
        let frame = ticket
            .answer
            .blocking_recv()
            .map_err(|_| BenchError::Server("lost its renderer"))??;
        render_ms.push(frame.render_ms);
        encode_ms += frame.encode_ms;
        bytes += frame.bytes.len();
    }
    let count = render_ms.len();
    let n = count as f64;
    render_ms.sort_by(f64::total_cmp);
    Ok(Frames {
        width,
        height,
        count,
        per_s: n / began.elapsed().as_secs_f64(),
        render_ms_mean: render_ms.iter().sum::<f64>() / n,
        render_ms_p95: render_ms.get((0.95 * n) as usize).copied().unwrap_or_default(),
        encode_ms_mean: encode_ms / n,
        bytes_mean: bytes as f64 / n,
    })
}

/// Ends the process when dropped.
struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        // One that has ended already cannot be killed, which is as well.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts this program as a server of its own and asks for a frame until there is one. Seconds since the process was
/// started, and the memory that it then holds.
fn first_frame(options: &BenchOptions) -> Result<(f64, Option<f64>), BenchError> {
    let program = std::env::current_exe().map_err(|e| BenchError::System("cannot find this program", e))?;
    let began = Instant::now();
    let mut command = Command::new(program);
    command.args(["serve", "--listen", "127.0.0.1:0", "--scene", &options.scene]);
    command.args(["--device", &options.device.device]);
    if let Some(threads) = options.threads {
        command.arg("--threads").arg(threads.to_string());
    }
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn();
    let mut server = Server(child.map_err(|e| BenchError::System("cannot start a server", e))?);
    let stdout = server.0.stdout.take().ok_or(BenchError::Server("has no output"))?;
    let mut line = String::new();
    BufReader::new(stdout)
        .read_line(&mut line)
        .map_err(|e| BenchError::System("cannot read the server's output", e))?;
    let address = line.split("http://").nth(1).and_then(|rest| rest.split('/').next());
    let address = address.ok_or(BenchError::Server("did not say its address"))?;
    let [width, height] = PAGE_SIZE;
    let path = format!("/v1/worlds/w1/frame?format=jpeg&width={width}&height={height}");
    loop {
        if get_status(address, &path).map_err(|e| BenchError::System("cannot ask for a frame", e))? == 200 {
            let status = format!("/proc/{}/status", server.0.id());
            return Ok((began.elapsed().as_secs_f64(), resident_mib(&status)));
        }
        if began.elapsed() > FIRST_FRAME_MAX {
            return Err(BenchError::Server("did not show a frame in time"));
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// The status of a GET whose answer has been read to its end.
fn get_status(address: &str, path: &str) -> std::io::Result<u16> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(FIRST_FRAME_MAX))?;
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n"
    )?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer)?;
    let status = answer
        .split(|b| *b == b' ')
        .nth(1)
        .and_then(|word| std::str::from_utf8(word).ok());
    status
        .and_then(|s| s.parse().ok())
        .ok_or_else(|| std::io::Error::other("the answer is not HTTP"))
}

/// Resident memory from a `/proc` status file, MiB; `None` where there is no such file.
fn resident_mib(status: &str) -> Option<f64> {
    let value = proc_value(status, "VmRSS")?;
    value
        .split_whitespace()
        .next()?
        .parse::<f64>()
        .ok()
        .map(|kib| kib / 1024.0)
}

fn proc_value(path: &str, key: &str) -> Option<String> {
    let text = std::fs::read_to_string(path).ok()?;
    let line = text.lines().find(|line| line.starts_with(key))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

fn print(report: &Report) {
    let [x, y, z] = report.cells;
    let memory = |mib: Option<f64>| mib.map_or_else(|| "unknown".to_owned(), |mib| format!("{mib:.0} MiB"));
    println!(
        "welkin {} on {} ({})",
        report.version,
        report.device,
        report.processor.as_deref().unwrap_or("processor unknown")
    );
    println!(
        "{} cores; commit {}",
        report.cores,
        report.commit.as_deref().unwrap_or("not given")
    );
    println!("scene {}, {x} x {y} x {z} cells", report.scene);
    println!(
        "first frame            {:.2} s after the process started, {} resident",
        report.first_frame_s,
        memory(report.resident_first_frame_mib)
    );
    let cover = report
        .cloud_cover
        .map_or_else(|| "no clouds".to_owned(), |cover| format!("cloud cover {cover:.2}"));
    println!(
        "measured from          {:.0} simulated s ({:.1} s of wall time to get there; {cover})",
        report.measured_from_s, report.spin_up_wall_s
    );
    for (name, s) in [
        ("simulation alone", &report.simulation_alone),
        ("... with the page", &report.simulation_with_page),
    ] {
        println!(
            "{name:<22} {:.2} ticks/s, {:.1} times real time, {:.1} ms a tick, {:.1} M cell substeps/s",
            s.ticks_per_s,
            s.times_real_time,
            s.tick_ms,
            s.cell_substeps_per_s / 1e6
        );
    }
    let alone = report.frames_alone.iter().map(|f| ("frames alone", f));
    for (name, f) in std::iter::once(("the page's frames", &report.page_frames)).chain(alone) {
        println!(
            "{name:<22} {}x{}: {:.1} frames/s, {:.1} ms to render (95 %: {:.1}), {:.1} ms to encode, {:.0} kB",
            f.width,
            f.height,
            f.per_s,
            f.render_ms_mean,
            f.render_ms_p95,
            f.encode_ms_mean,
            f.bytes_mean / 1e3
        );
    }
    println!(
        "a copy moves           {:.1} GB/s; a substep must move {:.0} bytes a cell: at most {:.1} M cell substeps/s by that",
        report.copy_bytes_per_s / 1e9,
        report.bytes_per_cell_substep,
        report.cell_substeps_per_s_floor / 1e6
    );
    println!("PASS                         MS A RUN  A SUBSTEP  BYTES A CELL    GB/S  OF A COPY");
    for p in &report.passes {
        println!(
            "{:<28} {:>8.3} {:>10.1} {:>13} {:>7.2} {:>9.0} %",
            p.pass,
            p.mean_ms,
            p.runs_per_substep,
            p.bytes_per_cell,
            p.bytes_per_s / 1e9,
            100.0 * p.share_of_copy
        );
    }
    println!("resident at the end    {}", memory(report.resident_mib));
}
