//! `volume`, `record`, `replay`: a volume stream in a line a volume, into a file, out of a file.

use std::io::BufWriter;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, ValueEnum};
use futures_util::StreamExt;
use welkin_client::Next;
use welkin_client::record::{Writer, replay};
use welkin_client::volume::{VolumeEvent, VolumeOptions, Volumes, subscribe, subscribe_and_record};
use welkin_proto::volume::subscribe::{RegionM, Subscription, VolumeServerMessage};
use welkin_proto::volume::{Bits, Compression, DecodeLimits, VolumeField};

use super::{Failure, print_line};

/// Which volumes.
#[derive(Args, Clone, Debug)]
pub struct Wish {
    /// Channels, with commas between.
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        default_value = "extinction_per_m"
    )]
    pub channels: Vec<String>,
    /// A cell is the mean of 2^mip of the world's cells along each edge.
    #[arg(long, value_name = "0..6", default_value_t = 0)]
    pub mip: u8,
    /// At most so many volumes a second.
    #[arg(long, value_name = "HZ", default_value_t = 2.0)]
    pub rate: f64,
    /// At most so many bytes a second.
    #[arg(long, value_name = "N")]
    pub bytes_per_s: Option<f64>,
    /// Bits a value.
    #[arg(long, value_name = "8|16", default_value = "8", value_parser = bits)]
    pub bits: Bits,
    /// How volumes are packed.
    #[arg(long, value_enum, default_value = "zstd")]
    pub compression: Packing,
    /// Only the box from x,y,z to x,y,z, m from the world's south-west corner on the ground.
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", value_parser = region)]
    pub region: Option<RegionM>,
}

/// See [`Compression`].
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Packing {
    /// Not at all.
    None,
    /// zlib.
    Deflate,
    /// Zstandard.
    Zstd,
}

impl Wish {
    /// As the library has it.
    pub fn subscription(&self) -> Subscription {
        Subscription {
            channels: self.channels.clone(),
            region_m: self.region,
            mip: self.mip,
            rate_hz: self.rate,
            bytes_per_s: self.bytes_per_s,
            bits: self.bits,
            compression: match self.compression {
                Packing::None => Compression::None,
                Packing::Deflate => Compression::Deflate,
                Packing::Zstd => Compression::Zstd,
            },
            ..Subscription::default()
        }
    }
}

fn bits(text: &str) -> Result<Bits, String> {
    text.parse::<u8>().map_err(|e| e.to_string()).and_then(Bits::try_from)
}

fn region(text: &str) -> Result<RegionM, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, z, to_x, to_y, to_z]) => Ok(RegionM {
            from: [x, y, z],
            to: [to_x, to_y, to_z],
        }),
        _ => Err("a region is six numbers with commas between, such as 0,0,0,3200,3200,1500".to_owned()),
    }
}

/// `volume`.
#[derive(Args)]
pub struct Volume {
    /// The server, such as http://127.0.0.1:8080.
    url: String,
    /// The world's id; otherwise the server's first.
    #[arg(long, value_name = "ID")]
    world: Option<String>,
    #[command(flatten)]
    wish: Wish,
    #[command(flatten)]
    end: Ending,
}

/// `record`.
#[derive(Args)]
pub struct Record {
    /// The server, such as http://127.0.0.1:8080.
    url: String,
    /// The file to write.
    file: PathBuf,
    /// The world's id; otherwise the server's first.
    #[arg(long, value_name = "ID")]
    world: Option<String>,
    #[command(flatten)]
    wish: Wish,
    #[command(flatten)]
    end: Ending,
}

/// `replay`.
#[derive(Args)]
pub struct Replay {
    /// The file to read.
    file: PathBuf,
    /// So many times as fast as it was recorded; `inf` as fast as it can be read.
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    speed: f64,
    #[command(flatten)]
    end: Ending,
}

/// When to end.
#[derive(Args)]
struct Ending {
    /// End after so many volumes.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    volumes: Option<u64>,
    /// End after so long, such as 30s, 5m or 2h.
    #[arg(long = "for", value_name = "TIME", value_parser = crate::duration)]
    duration: Option<Duration>,
}

/// Runs `volume`.
pub async fn volume(arguments: &Volume) -> Result<(), Failure> {
    let volumes = subscribe(&arguments.url, options(&arguments.world, &arguments.wish))?;
    show(volumes, &arguments.end).await
}

/// Runs `record`.
pub async fn record(arguments: &Record) -> Result<(), Failure> {
    let failed = |source| Failure::Write {
        path: arguments.file.clone(),
        source,
    };
    let file = std::fs::File::create(&arguments.file).map_err(failed)?;
    let mut writer = Writer::new(BufWriter::new(file)).map_err(failed)?;
    let options = options(&arguments.world, &arguments.wish);
    let volumes = subscribe_and_record(&arguments.url, options, move |record| writer.write(record))?;
    show(volumes, &arguments.end).await
}

/// Runs `replay`.
pub async fn play(arguments: &Replay) -> Result<(), Failure> {
    let volumes = replay(&arguments.file, arguments.speed, DecodeLimits::default())?;
    show(volumes, &arguments.end).await
}

fn options(world: &Option<String>, wish: &Wish) -> VolumeOptions {
    VolumeOptions {
        world: world.clone(),
        subscription: wish.subscription(),
        ..VolumeOptions::default()
    }
}

/// Prints what comes until the end.
async fn show(mut volumes: Volumes, ending: &Ending) -> Result<(), Failure> {
    let over = async {
        match ending.duration {
            Some(duration) => tokio::time::sleep(duration).await,
            None => std::future::pending().await,
        }
    };
    tokio::pin!(over);
    let mut seen = 0;
    loop {
        let event = tokio::select! {
            event = volumes.next() => event,
            () = &mut over => return Ok(()),
            _ = tokio::signal::ctrl_c() => return Ok(()),
        };
        let line = match event {
            None => return Ok(()),
            Some(VolumeEvent::Error {
                error,
                next: Next::Ends,
            }) => return Err(error.into()),
            Some(VolumeEvent::Error { error, next }) => format!("{error} ({next})"),
            Some(VolumeEvent::Hello(message) | VolumeEvent::Subscribed(message)) => said(&message),
            Some(VolumeEvent::Volume { field, bytes, .. }) => {
                seen += 1;
                let age = volumes
                    .server_unix_s()
                    .map(|now_s| now_s - field.moment.published_unix_s);
                told(&field, bytes, age)
            }
        };
        if !print_line(&line)? || ending.volumes.is_some_and(|most| seen >= most) {
            return Ok(());
        }
    }
}

fn said(message: &VolumeServerMessage) -> String {
    match message {
        VolumeServerMessage::Hello {
            world,
            scene,
            cells,
            channels,
            ..
        } => {
            let channels: Vec<&str> = channels.iter().map(|c| c.name()).collect();
            let [x, y, z] = cells;
            format!(
                "world {world}: {scene}, {x} x {y} x {z} cells; channels {}",
                channels.join(", ")
            )
        }
        VolumeServerMessage::Subscribed { view, cells, .. } => {
            let [x, y, z] = cells;
            format!("view {view}: {x} x {y} x {z} cells")
        }
        other => format!("{other:?}"),
    }
}

/// A volume in a line.
fn told(field: &VolumeField, bytes: usize, age_s: Option<f64>) -> String {
    let age = age_s.map_or(String::new(), |s| format!(", {:.0} ms old", 1e3 * s));
    let mut line = format!(
        "tick {}, {:.1} simulated s: {bytes} bytes{age}",
        field.moment.tick, field.moment.simulated_s
    );
    for channel in &field.channels {
        let values = channel.values();
        let (low, high) = values
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len().max(1) as f64;
        line += &format!(" | {} {low:.4} to {high:.4}, mean {mean:.4}", channel.name);
    }
    line
}
