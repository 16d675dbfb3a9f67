//! `welkin bench --beside`: the same pictures by the CPU device and by an adapter, in turns within one process.
//!
//! Two runs of a benchmark on a shared machine differ by more than what they are to tell apart. So the devices draw in pairs, one right after the other, and what is reported is the
//! ratio of each pair: what slows the machine for longer than a picture slows both. Of an adapter that is software (Mesa's lavapipe) this tells what Rust gains over the same WGSL on the
//! same cores; of a GPU, what it is worth.
//!
//! Two kinds of pictures. Where the tick is *kept*, tables are those of the picture before, and what is timed is the march. Where it is *new*, cloud and sun are other ones than before,
//! so that everything that depends on them (shape, optical depths, diffuse light, sky) is made again within the time.

use std::time::Instant;

use serde::Serialize;
use welkin_proto::ApiError;
use welkin_shaders::CloudVolume;
use welkin_shaders::cpu::view::{Lighting, Prepared, Scattering, ViewSampling, ViewSettings, render};
use welkin_shaders::gpu::GpuView;

use super::BenchError;
use crate::clouds::{ball, cumulus_field, settings};
use crate::machine::{Adapter, Compute, gpu_failure};

/// Sizes of pictures, the page's first.
const SIZES: [[usize; 2]; 2] = [[640, 360], [1280, 720]];
/// How far the sun goes along y in a new tick, in parts of its unit vector: a degree, as in the ladder of light.
const NEW_SUN: f32 = 0.02;
/// What a new tick makes of its cloud's extinction: not to be seen, but another cloud.
const NEW_EXTINCTION: f32 = 1.001;
/// A difference of bytes that twins may have by rounding.
const ROUNDING: u8 = 1;

/// Whether a picture finds its tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Tick {
    /// Cloud and sun are those of the picture before.
    Kept,
    /// Both are others.
    New,
}

/// A cloud, a camera and light.
struct Sight {
    name: &'static str,
    volume: CloudVolume,
    settings: ViewSettings,
}

/// What is drawn, `width` by `height` pixels.
fn sights([width, height]: [usize; 2]) -> [Sight; 3] {
    let base = settings(width, height);
    [
        Sight {
            name: "cumulus, diffusion",
            volume: cumulus_field(7, 12),
            settings: base,
        },
        Sight {
            name: "cumulus, octaves",
            volume: cumulus_field(7, 12),
            settings: ViewSettings {
                lighting: Lighting {
                    scattering: Scattering::Octaves,
                    ..base.lighting
                },
                ..base
            },
        },
        // As the ladder of light has it: within the ball's thin edge, cloud on every pixel.
        Sight {
            name: "inside, diffusion",
            volume: ball(1500.0, 700.0, 0.01),
            settings: ViewSettings {
                camera_position_m: [3200.0, 3700.0, 1700.0],
                ..base
            },
        },
    ]
}

/// Wall milliseconds of one picture on each device, one right after the other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pair {
    /// On the CPU device.
    pub cpu_ms: f64,
    /// On the adapter, with the way of the picture's bytes back.
    pub adapter_ms: f64,
}

impl Pair {
    fn ratio(&self) -> f64 {
        self.adapter_ms / self.cpu_ms
    }
}

/// How far two devices' pictures are apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Apart {
    /// Largest difference of bytes.
    pub largest: u8,
    /// Share of bytes that differ by more than one.
    pub share: f64,
}

impl Apart {
    /// Of two pictures of one size.
    fn of(a: &[u8], b: &[u8]) -> Apart {
        let differences = || a.iter().zip(b).map(|(a, b)| a.abs_diff(*b));
        let more = differences().filter(|d| *d > ROUNDING).count();
        Apart {
            largest: differences().max().unwrap_or_default(),
            share: more as f64 / a.len().max(1) as f64,
        }
    }

    /// The worse of each.
    fn or_worse(self, other: Apart) -> Apart {
        Apart {
            largest: self.largest.max(other.largest),
            share: self.share.max(other.share),
        }
    }
}

/// One picture, measured.
#[derive(Clone, Debug, Serialize)]
pub struct Case {
    /// What it is of, and how its cloud scatters light.
    pub picture: &'static str,
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// How many of them are marched: all, or one in four and those between which they disagree.
    pub sampling: &'static str,
    /// Whether it finds its tables.
    pub tick: Tick,
    /// Median milliseconds on the CPU device.
    pub cpu_ms: f64,
    /// Median milliseconds on the adapter.
    pub adapter_ms: f64,
    /// Median of the pairs' ratios, the adapter's milliseconds over the CPU's: more than 1 where the CPU is faster.
    pub ratio: f64,
    /// The least and the largest ratio of a pair.
    pub ratio_range: [f64; 2],
    /// How far the pictures are apart, the worst of the pairs.
    pub apart: Apart,
    /// The pairs, in the order in which they were drawn.
    pub pairs: Vec<Pair>,
}

impl Case {
    /// From at least one pair.
    fn new(sight: &Sight, sampling: &'static str, tick: Tick, pairs: Vec<Pair>, apart: Apart) -> Case {
        let sorted = |of: fn(&Pair) -> f64| {
            let mut values: Vec<f64> = pairs.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let ratios = sorted(Pair::ratio);
        Case {
            picture: sight.name,
            width: sight.settings.width,
            height: sight.settings.height,
            sampling,
            tick,
            cpu_ms: median(&sorted(|pair| pair.cpu_ms)),
            adapter_ms: median(&sorted(|pair| pair.adapter_ms)),
            ratio: median(&ratios),
            ratio_range: [ratios[0], ratios[ratios.len() - 1]],
            apart,
            pairs,
        }
    }
}

/// The middle of sorted values, of an even number of them the mean of the two in the middle.
fn median(sorted: &[f64]) -> f64 {
    let n = sorted.len();
    0.5 * (sorted[(n - 1) / 2] + sorted[n / 2])
}

/// Both devices, with what they keep from picture to picture.
struct Painters<'a> {
    threads: &'a rayon::ThreadPool,
    prepared: Prepared,
    gpu: GpuView,
}

impl Painters<'_> {
    /// A picture by the one, then by the other; the time of each and how far they are apart. Errors: the adapter's.
    fn pair(&mut self, volume: &CloudVolume, settings: &ViewSettings) -> Result<(Pair, Apart), BenchError> {
        let began = Instant::now();
        let by_cpu = self
            .threads
            .install(|| render(Some(volume), settings, &mut self.prepared));
        let cpu_ms = began.elapsed().as_secs_f64() * 1e3;
        let began = Instant::now();
        let by_adapter = self
            .gpu
            .render(Some(volume), settings, &mut |_| {})
            .map_err(|error| gpu_failure(&error))?;
        let adapter_ms = began.elapsed().as_secs_f64() * 1e3;
        Ok((Pair { cpu_ms, adapter_ms }, Apart::of(&by_cpu, &by_adapter)))
    }

    /// One pair that isn't counted, which makes tables and compiles what is compiled when it is first asked for, then so many that are. Errors: the adapter's.
    fn case(
        &mut self,
        sight: &Sight,
        (way, sampling): (ViewSampling, &'static str),
        tick: Tick,
        count: usize,
    ) -> Result<Case, BenchError> {
        let now = ViewSettings {
            sampling: way,
            ..sight.settings
        };
        let mut later = now;
        later.sun_direction[1] += NEW_SUN;
        let mut grown = sight.volume.clone();
        grown.extinction_per_m.iter_mut().for_each(|e| *e *= NEW_EXTINCTION);
        let ticks = [(&sight.volume, now), (&grown, later)];
        self.pair(&sight.volume, &now)?;
        let (mut pairs, mut apart) = (Vec::with_capacity(count), Apart::default());
        for n in 0..count {
            let (volume, settings) = match tick {
                Tick::Kept => &ticks[0],
                Tick::New => &ticks[(n + 1) % 2],
            };
            let (pair, difference) = self.pair(volume, settings)?;
            pairs.push(pair);
            apart = apart.or_worse(difference);
        }
        Ok(Case::new(sight, sampling, tick, pairs, apart))
    }
}

/// The adapter that goes by `name` on the command line, and its own name. Errors: `no_adapter`, with those that are there, and `adapter_insufficient`.
pub fn adapter(name: &str) -> Result<(Adapter, String), ApiError> {
    let compute = Compute::choose(name)?;
    let own_name = compute.name();
    match compute {
        Compute::Gpu(adapter) => Ok((adapter, own_name)),
        Compute::Cpu => Err(ApiError::new(
            "no_adapter",
            format!("{name:?} is the CPU device here; name an adapter to draw beside it, or gpu for any"),
        )),
    }
}

/// Draws every case on the CPU device and on the adapter, `pairs` times (1 or more). Errors: the adapter's, and a system that gives no threads.
pub fn measure(
    adapter: &Adapter,
    threads: Option<std::num::NonZeroUsize>,
    pairs: usize,
) -> Result<Vec<Case>, BenchError> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads.map_or(0, Into::into))
        .build()
        .map_err(|error| BenchError::System("cannot start threads", std::io::Error::other(error)))?;
    eprintln!("compiling shaders");
    let stages = adapter.view_stages().map_err(|error| gpu_failure(&error))?;
    let mut painters = Painters {
        threads: &pool,
        prepared: Prepared::new(),
        gpu: GpuView::new(stages).map_err(|error| gpu_failure(&error))?,
    };
    let whole = (ViewSampling::EveryPixel, "every_pixel");
    let half = (ViewSampling::HalfResolution, "half_resolution");
    let mut cases = Vec::new();
    for size in SIZES {
        for sight in sights(size) {
            for (way, tick) in [(whole, Tick::Kept), (half, Tick::Kept), (whole, Tick::New)] {
                let [width, height] = size;
                eprintln!(
                    "drawing {}, {width}x{height}, {}, {}",
                    sight.name,
                    way.1,
                    words_of(tick)
                );
                cases.push(painters.case(&sight, way, tick, pairs)?);
            }
        }
    }
    Ok(cases)
}

fn words_of(tick: Tick) -> &'static str {
    match tick {
        Tick::Kept => "tick kept",
        Tick::New => "new tick",
    }
}

/// The table for people.
pub fn table(cases: &[Case]) -> String {
    let mut text = format!(
        "{:<20} {:>9}  {:<15}  {:<9} {:>9} {:>10} {:>6} {:>13} {:>7} {:>9}\n",
        "PICTURE", "SIZE", "MARCHED", "TABLES", "CPU MS", "ADAPTER MS", "RATIO", "FROM - TO", "LARGEST", "APART"
    );
    for case in cases {
        let [from, to] = case.ratio_range;
        text += &format!(
            "{:<20} {:>9}  {:<15}  {:<9} {:>9.1} {:>10.1} {:>6.2} {:>13} {:>7} {:>7.3} %\n",
            case.picture,
            format!("{}x{}", case.width, case.height),
            case.sampling,
            words_of(case.tick),
            case.cpu_ms,
            case.adapter_ms,
            case.ratio,
            format!("{from:.2} - {to:.2}"),
            case.apart.largest,
            100.0 * case.apart.share
        );
    }
    text + "Milliseconds are medians. RATIO is the median of the pairs' ratios, the adapter's time over the CPU's: more than 1 where the CPU is\n\
            faster. LARGEST is the largest difference of the two pictures' bytes, APART the share of bytes that differ by more than one.\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(cpu_ms: f64, adapter_ms: f64) -> Pair {
        Pair { cpu_ms, adapter_ms }
    }

    #[test]
    fn medians_are_of_the_middle() {
        assert_eq!(median(&[3.0]), 3.0);
        assert_eq!(median(&[1.0, 2.0, 9.0]), 2.0);
        assert_eq!(median(&[1.0, 2.0, 4.0, 9.0]), 3.0);
    }

    /// The machine became slower during the run: the quotient of the medians, 3, would tell of it; the ratio doesn't.
    #[test]
    fn a_case_reports_the_ratio_of_pairs_not_of_medians() {
        let [sight, ..] = sights([64, 36]);
        let pairs = vec![pair(10.0, 20.0), pair(30.0, 60.0), pair(20.0, 60.0)];
        let case = Case::new(&sight, "every_pixel", Tick::Kept, pairs, Apart::default());
        assert_eq!((case.cpu_ms, case.adapter_ms), (20.0, 60.0));
        assert_eq!((case.ratio, case.ratio_range), (2.0, [2.0, 3.0]));
    }

    #[test]
    fn pictures_are_apart_by_their_bytes() {
        assert_eq!(Apart::of(&[], &[]), Apart::default());
        let apart = Apart::of(&[10, 20, 30, 40], &[11, 20, 25, 40]);
        assert_eq!((apart.largest, apart.share), (5, 0.25));
        let other = Apart { largest: 2, share: 0.5 };
        assert_eq!(apart.or_worse(other), Apart { largest: 5, share: 0.5 });
    }

    #[test]
    fn a_table_has_a_row_a_case_in_columns() {
        let [sight, ..] = sights(SIZES[1]);
        let apart = Apart {
            largest: 3,
            share: 0.000_25,
        };
        let cases = [Tick::Kept, Tick::New]
            .map(|tick| Case::new(&sight, "half_resolution", tick, vec![pair(100.0, 250.0)], apart));
        let text = table(&cases);
        let rows: Vec<&str> = text.lines().take(3).collect();
        assert!(rows[0].starts_with("PICTURE") && rows[0].ends_with("APART"), "{text}");
        for (row, tick) in rows[1..].iter().zip(["tick kept", "new tick"]) {
            for cell in [
                "cumulus, diffusion",
                "1280x720",
                "half_resolution",
                tick,
                "2.50",
                "0.025 %",
            ] {
                assert!(row.contains(cell), "{cell:?} is not in {row:?}");
            }
            assert_eq!(
                row.find("1280x720").map(|at| at + 8),
                rows[0].find("SIZE").map(|at| at + 4)
            );
        }
    }

    #[test]
    fn the_cpu_is_no_adapter() {
        assert_eq!(adapter("cpu").unwrap_err().code, "no_adapter");
    }

    #[test]
    fn an_adapter_that_is_not_there_is_an_error_that_names_it() {
        let error = adapter("no such adapter anywhere").unwrap_err();
        assert_eq!(error.code, "no_adapter");
        assert!(error.message.contains("no such adapter anywhere"), "{}", error.message);
    }
}
