//! Stage `path_tracer`: the truth that every other way to light a cloud is held against. CPU only: it is for offline comparison and for
//! pictures that somebody is willing to wait for, it needs 64-bit sums, and its paths part from each other, which a GPU's groups do badly.
//!
//! Reads: a [`Medium`] (the very cloud that the march draws, [`volume::Volume`], or a plane-parallel slab, [`slab::Slab`]), a phase function, the
//! sun's direction, the albedo of single scattering. Writes: [`Film`]: sums and sums of squares of radiance a pixel. Scheme: paths from
//! the camera; delta tracking with a majorant a brick (Woodcock et al. 1965), light from the sun by next-event estimation with ratio tracking
//! (Novak et al. 2014), sky and ground where a path ends there, Russian roulette on what is left. The forward peak of droplets would make
//! next-event estimation noisy beyond use: a path that happens to head for the sun sees thousands of times the mean. So the function is split
//! into peak and rest, and of all scatterings the last unbroken run by the peak is drawn from the sun's side: their angles by the peak around the sun's
//! direction, their number geometric, and the rest's value is taken at the vertex before. That sums over the same paths, and no
//! large value is left but for the sun's aureole on rays that the peak alone has turned, where it belongs. Order: none, the
//! estimate is unbiased up to rounding, paths of more than 20,000 scatterings and the places that [`volume`] names; the error falls with the square root of the samples, and
//! [`Film::relative_error`] says how large it is.
//!
//! Random numbers are a hash of pixel, sample and count: results are the same bits for any number of threads. Sixteen paths advance
//! abreast, so that the cloud is looked up by packets.

pub(crate) mod sampler;
pub mod slab;
pub mod volume;

use rayon::prelude::*;

pub use sampler::Scatterer;
use sampler::{Random, dot, turned};

use crate::cpu::view::lanes::LANES;

/// Scatterings in a row by the peak on the sun's side, at most: with half the light in the peak more come once in 2^48 times.
const RUN_MAX: usize = 48;
/// A path ends after so many scatterings: it stands in cloud so thick (an optical depth beyond 300) that it would not come out.
const SCATTERINGS_MAX: u32 = 20_000;
/// Throughput below which roulette is played.
const ROULETTE_BELOW: f64 = 0.1;
/// Pixels that one thread takes at a time.
const PIXELS: usize = 32;

/// Where a flight ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Flight {
    /// A collision that is real with the probability extinction over this majorant, 1/m.
    Candidate(f64),
    /// It left for the sky.
    Sky,
    /// It met the ground.
    Ground,
}

/// What light goes through. Positions in m (or in the slab's depth), directions are unit vectors along the path, away from the camera.
pub trait Medium: Sync {
    /// Moves `at` along `along` to the next event, or to where the majorant changes (none). `random`, 0 to 1, chooses the free path. `reach` is how
    /// far it may go before the rest counts as clear, and is lowered.
    fn fly(&self, at: &mut [f64; 3], along: &[f64; 3], reach: &mut f64, random: f64) -> Option<Flight>;
    /// Extinction at sixteen places, 1/m.
    fn extinction(&self, at: &[[f64; 3]; LANES]) -> [f64; LANES];
    /// The sun's irradiance across its beam at a place, cloud left out.
    fn sun(&self, at: &[f64; 3]) -> [f64; 3];
    /// Radiance of the sky where a path ends that was turned last in cloud or, with `from_ground`, by the ground.
    fn sky(&self, along: &[f64; 3], from_ground: bool) -> [f64; 3];
    /// The same where the camera looks straight at it.
    fn background(&self, along: &[f64; 3]) -> [f64; 3] {
        self.sky(along, true)
    }
    /// What the air before the first collision adds, and the share that it lets pass.
    fn air(&self, _at: &[f64; 3], _along: &[f64; 3]) -> [[f64; 3]; 2] {
        [[0.0; 3], [1.0; 3]]
    }
    /// For the ground where the camera sees it: what is added (air, mirrored sky), and the factor on what it throws back.
    fn seen_ground(&self, _at: &[f64; 3], _along: &[f64; 3]) -> [[f64; 3]; 2] {
        [[0.0; 3], [0.0; 3]]
    }
    /// The same where a scattered path meets it: its albedo.
    fn ground_albedo(&self) -> [f64; 3] {
        [0.0; 3]
    }
    /// How far the camera sees cloud, and how far scattered light may go.
    fn reaches(&self) -> [f64; 2] {
        [f64::INFINITY; 2]
    }
}

/// Sums of what the paths of each pixel brought.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Paths a pixel.
    pub samples: u32,
    sum: Vec<[f64; 3]>,
    square: Vec<[f64; 3]>,
}

impl Film {
    /// Nothing yet.
    pub fn new(pixels: usize) -> Film {
        Film {
            samples: 0,
            sum: vec![[0.0; 3]; pixels],
            square: vec![[0.0; 3]; pixels],
        }
    }
    /// The sums as bytes, to go on from another time.
    pub fn to_bytes(&self) -> Vec<u8> {
        let numbers = self.sum.iter().chain(&self.square).flatten();
        let mut bytes = self.samples.to_le_bytes().to_vec();
        bytes.extend(numbers.flat_map(|v| v.to_le_bytes()));
        bytes
    }
    /// A film of so many pixels from such bytes; none where they are of another size or hold what no film does.
    pub fn from_bytes(pixels: usize, bytes: &[u8]) -> Option<Film> {
        let (samples, numbers) = bytes.split_first_chunk::<4>()?;
        let numbers: Vec<f64> = numbers
            .chunks_exact(8)
            .filter_map(|b| Some(f64::from_le_bytes(b.try_into().ok()?)))
            .collect();
        if bytes.len() != 4 + 48 * pixels || numbers.iter().any(|v| !(v.is_finite() && *v >= 0.0)) {
            return None;
        }
        let colours: Vec<[f64; 3]> = numbers.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let (sum, square) = colours.split_at(pixels);
        Some(Film {
            samples: u32::from_le_bytes(*samples),
            sum: sum.to_vec(),
            square: square.to_vec(),
        })
    }
    /// Mean radiance of each pixel.
    pub fn radiance(&self) -> Vec<[f64; 3]> {
        let n = f64::from(self.samples.max(1));
        self.sum.iter().map(|s| s.map(|v| v / n)).collect()
    }
    /// Square of the standard error of each pixel's mean.
    pub fn squared_error(&self) -> Vec<[f64; 3]> {
        let n = f64::from(self.samples);
        let pairs = self.sum.iter().zip(&self.square);
        pairs
            .map(|(s, q)| {
                [0, 1, 2].map(|c| {
                    if self.samples < 2 {
                        f64::INFINITY
                    } else {
                        ((q[c] - s[c] * s[c] / n) / (n - 1.0) / n).max(0.0)
                    }
                })
            })
            .collect()
    }
    /// Standard error of the pixels in the mean square, over their radiance in the mean square.
    pub fn relative_error(&self) -> f64 {
        let total = |v: Vec<[f64; 3]>| v.into_iter().flatten().sum::<f64>();
        let light = total(self.radiance().into_iter().map(|p| p.map(|v| v * v)).collect());
        if light > 0.0 {
            (total(self.squared_error()) / light).sqrt()
        } else {
            0.0
        }
    }
}

/// Where a pixel's path begins: place and direction.
pub type Start<'a> = &'a (dyn Fn(usize) -> [[f64; 3]; 2] + Sync);

/// See the module.
pub struct PathTracer<'a, M> {
    /// What light goes through.
    pub medium: &'a M,
    /// How it is turned there.
    pub scatterer: &'a Scatterer,
    /// Unit vector towards the sun; none for no sun.
    pub sun_direction: Option<[f64; 3]>,
    /// Share of extinction that is scattering, 0 to 1.
    pub albedo: f64,
}

#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Idle,
    Walk,
    TowardsSun,
}

/// One path.
#[derive(Clone, Copy)]
struct Path {
    pixel: usize,
    stage: Stage,
    random: Random,
    at: [f64; 3],
    along: [f64; 3],
    reach: f64,
    majorant: f64,
    throughput: [f64; 3],
    light: [f64; 3],
    scatterings: u32,
    /// Nothing was met yet.
    fresh: bool,
    /// The ground has turned it last.
    from_ground: bool,
    /// Only the peak has turned it yet.
    peak_only: bool,
    /// Where the walk goes on after a look at the sun.
    resume: [[f64; 3]; 2],
    carried: [f64; 3],
    /// Directions of the run towards the sun, the sun's own first.
    run: [[f64; 3]; RUN_MAX + 1],
    run_left: usize,
}

impl Path {
    fn idle() -> Path {
        Path {
            pixel: 0,
            stage: Stage::Idle,
            random: Random::new(0, 0),
            at: [0.0; 3],
            along: [0.0, 0.0, 1.0],
            reach: 0.0,
            majorant: 1.0,
            throughput: [1.0; 3],
            light: [0.0; 3],
            scatterings: 0,
            fresh: true,
            from_ground: false,
            peak_only: true,
            resume: [[0.0; 3]; 2],
            carried: [0.0; 3],
            run: [[0.0; 3]; RUN_MAX + 1],
            run_left: 0,
        }
    }
    fn gain(&mut self, radiance: &[f64; 3]) {
        for c in 0..3 {
            self.light[c] += self.throughput[c] * radiance[c];
        }
    }
    fn weaken(&mut self, factor: &[f64; 3]) {
        for c in 0..3 {
            self.throughput[c] *= factor[c];
        }
    }
}

impl<M: Medium> PathTracer<'_, M> {
    /// Adds `samples` paths to every pixel of the film.
    pub fn trace(&self, film: &mut Film, start: Start<'_>, samples: u32) {
        let first = film.samples;
        let sums = film.sum.par_chunks_mut(PIXELS).zip(film.square.par_chunks_mut(PIXELS));
        sums.enumerate().for_each(|(n, (sum, square))| {
            self.chunk(n * PIXELS, first, samples, start, sum, square);
        });
        film.samples += samples;
    }

    fn chunk(
        &self,
        first_pixel: usize,
        first_sample: u32,
        samples: u32,
        start: Start<'_>,
        sum: &mut [[f64; 3]],
        square: &mut [[f64; 3]],
    ) {
        let tasks = sum.len() as u64 * u64::from(samples);
        let mut taken = 0u64;
        let mut paths = [Path::idle(); LANES];
        loop {
            let mut places = [[0.0; 3]; LANES];
            let mut flying = [false; LANES];
            for (l, path) in paths.iter_mut().enumerate() {
                // Until a candidate is met, or there is nothing left to do.
                loop {
                    if path.stage == Stage::Idle {
                        if taken == tasks {
                            break;
                        }
                        let pixel = (taken / u64::from(samples)) as usize;
                        let sample = u64::from(first_sample) + taken % u64::from(samples);
                        taken += 1;
                        *path = self.begin(first_pixel + pixel, sample, start);
                    }
                    match self.fly(path) {
                        Flight::Candidate(majorant) => {
                            path.majorant = majorant;
                            places[l] = path.at;
                            flying[l] = true;
                            break;
                        }
                        end => self.leave(path, end),
                    }
                    if path.stage == Stage::Idle {
                        let pixel = path.pixel - first_pixel;
                        for c in 0..3 {
                            sum[pixel][c] += path.light[c];
                            square[pixel][c] += path.light[c] * path.light[c];
                        }
                    }
                }
            }
            if !flying.contains(&true) {
                break;
            }
            let extinction = self.medium.extinction(&places);
            for (l, path) in paths.iter_mut().enumerate().filter(|(l, _)| flying[*l]) {
                self.decide(path, (extinction[l] / path.majorant).min(1.0));
                if path.stage == Stage::Idle {
                    let pixel = path.pixel - first_pixel;
                    for c in 0..3 {
                        sum[pixel][c] += path.light[c];
                        square[pixel][c] += path.light[c] * path.light[c];
                    }
                }
            }
        }
    }

    fn begin(&self, pixel: usize, sample: u64, start: Start<'_>) -> Path {
        let [at, along] = start(pixel);
        Path {
            pixel,
            stage: Stage::Walk,
            random: Random::new(pixel as u64, sample),
            at,
            along,
            reach: self.medium.reaches()[0],
            ..Path::idle()
        }
    }

    /// To the next event; bricks without a collision are crossed one by one.
    fn fly(&self, path: &mut Path) -> Flight {
        loop {
            let random = path.random.next();
            if let Some(flight) = self.medium.fly(&mut path.at, &path.along, &mut path.reach, random) {
                return flight;
            }
        }
    }

    fn leave(&self, path: &mut Path, end: Flight) {
        match (path.stage, end) {
            (Stage::Walk, Flight::Ground) => self.on_ground(path),
            (Stage::Walk, _) => {
                let radiance = if path.fresh {
                    self.medium.background(&path.along)
                } else {
                    self.medium.sky(&path.along, path.from_ground)
                };
                path.gain(&radiance);
                path.stage = Stage::Idle;
            }
            (_, Flight::Sky) if path.run_left == 0 => {
                for c in 0..3 {
                    path.light[c] += path.carried[c];
                }
                self.resume(path);
            }
            _ => self.resume(path),
        }
    }

    fn resume(&self, path: &mut Path) {
        [path.at, path.along] = path.resume;
        path.reach = self.medium.reaches()[1];
        path.stage = Stage::Walk;
    }

    /// Judges a candidate that is real with the probability `real`.
    fn decide(&self, path: &mut Path, real: f64) {
        if path.stage == Stage::TowardsSun && path.run_left == 0 {
            let passed = 1.0 - real;
            let carried = path.carried.map(|v| v * passed);
            path.carried = carried;
            let most = carried[0].max(carried[1]).max(carried[2]);
            let before = path.throughput[0].max(path.throughput[1]).max(path.throughput[2]);
            if most < 1e-3 * before {
                // Little is left: half the looks end, the others count twice.
                if path.random.next() < 0.5 {
                    self.resume(path);
                } else {
                    path.carried = carried.map(|v| 2.0 * v);
                }
            }
        } else if path.random.next() < real {
            if path.stage == Stage::TowardsSun {
                path.run_left -= 1;
                path.along = path.run[path.run_left];
                if path.run_left == 0 {
                    self.put_sun(path);
                }
            } else {
                self.in_cloud(path);
            }
        }
    }

    fn in_cloud(&self, path: &mut Path) {
        if path.fresh {
            let [added, passed] = self.medium.air(&path.at, &path.along);
            path.gain(&added);
            path.weaken(&passed);
            path.fresh = false;
        }
        path.weaken(&[self.albedo; 3]);
        path.scatterings += 1;
        if path.scatterings > SCATTERINGS_MAX || !self.survives(path) {
            path.stage = Stage::Idle;
            return;
        }
        let (peak, rest) = (&self.scatterer.peak, &self.scatterer.rest);
        let by_peak = path.random.next() * (peak.share + rest.share) < peak.share;
        let part = if by_peak { peak } else { rest };
        let along = path.along;
        let at = path.at;
        // The chance of the part cancels against its share: values are those of the part scaled to 1.
        let (mu, weights) = part.draw(&mut path.random);
        let next = turned(&along, mu, &mut path.random);
        let mut looks = false;
        if let Some(sun) = self.sun_direction {
            if !by_peak {
                looks = self.draw_run(path, sun);
                let first = path.run[path.run_left];
                let value = rest.value(dot(&along, &first));
                for c in 0..3 {
                    path.carried[c] *= value[c] / rest.share;
                }
            } else if path.peak_only {
                let value = peak.value(dot(&along, &sun));
                path.run[0] = sun;
                path.run_left = 0;
                looks = value[3] > 0.0;
                for c in 0..3 {
                    path.carried[c] = path.throughput[c] * value[c] / peak.share;
                }
            }
        }
        path.peak_only &= by_peak;
        path.from_ground = false;
        path.weaken(&weights);
        path.resume = [at, next];
        self.look_or_go_on(path, looks);
    }

    fn on_ground(&self, path: &mut Path) {
        if path.fresh {
            let [added, factor] = self.medium.seen_ground(&path.at, &path.along);
            path.gain(&added);
            path.weaken(&factor);
            path.fresh = false;
        } else {
            let albedo = self.medium.ground_albedo();
            path.weaken(&albedo);
        }
        path.peak_only = false;
        path.from_ground = true;
        if !self.survives(path) {
            path.stage = Stage::Idle;
            return;
        }
        let at = path.at;
        let next = turned(&[0.0, 0.0, 1.0], path.random.next().sqrt(), &mut path.random);
        let mut looks = false;
        if let Some(sun) = self.sun_direction {
            looks = self.draw_run(path, sun);
            let rise = path.run[path.run_left][2];
            looks &= rise > 0.0;
            path.carried = path.carried.map(|v| v * rise / std::f64::consts::PI);
        }
        path.resume = [at, next];
        self.look_or_go_on(path, looks);
    }

    fn look_or_go_on(&self, path: &mut Path, looks: bool) {
        if !looks {
            self.resume(path);
            return;
        }
        path.stage = Stage::TowardsSun;
        path.along = path.run[path.run_left];
        path.reach = self.medium.reaches()[1];
        if path.run_left == 0 {
            self.put_sun(path);
        }
    }

    /// Multiplies by the sun's light where the last way to it begins.
    fn put_sun(&self, path: &mut Path) {
        let sun = self.medium.sun(&path.at);
        for c in 0..3 {
            path.carried[c] *= sun[c];
        }
    }

    /// Draws how many times the peak turns light between the sun and here, and how; sets what it weighs.
    fn draw_run(&self, path: &mut Path, sun: [f64; 3]) -> bool {
        let peak = &self.scatterer.peak;
        let again = peak.share / (peak.share + self.scatterer.rest.share);
        path.carried = path.throughput.map(|v| v / (1.0 - again));
        path.run[0] = sun;
        path.run_left = 0;
        while again > 0.0 && path.random.next() < again {
            if path.run_left == RUN_MAX {
                return false;
            }
            let (mu, weights) = peak.draw(&mut path.random);
            let next = turned(&path.run[path.run_left], mu, &mut path.random);
            path.run_left += 1;
            path.run[path.run_left] = next;
            for c in 0..3 {
                path.carried[c] *= weights[c] * self.albedo;
            }
        }
        true
    }

    /// Russian roulette.
    fn survives(&self, path: &mut Path) -> bool {
        let most = path.throughput[0].max(path.throughput[1]).max(path.throughput[2]);
        if most >= ROULETTE_BELOW {
            return true;
        }
        if most <= 0.0 || path.random.next() * ROULETTE_BELOW >= most {
            return false;
        }
        path.throughput = path.throughput.map(|v| v * ROULETTE_BELOW / most);
        true
    }
}
