//! The light of what stage `march` meets in cloud.
//!
//! Where a ray samples cloud, and how much each sample hides of what lies behind, does not hang on the light there. So the march goes its way and only notes its samples; the light is made of what is
//! noted, sixteen samples at a time, of whichever rays of the packet. Of the lanes that the march keeps going together 0.45 have cloud at once in a whole picture of broken cumulus, and 0.30 in one of half
//! resolution; here some 0.8 have. Samples that take the finer steps towards the sun stand in a list of their own. They are a ray's first ones (the steps fade with distance and with what the ray has met, and never come back), so
//! that each ray adds its samples up in their order, and its light does not hang on which rays share its packet.
//!
//! Scheme, units and source of the light: [`super::march`], whose second half this is. Reads: [`Frame`]. Writes: radiance of three colours a ray.

use multiversion::multiversion;

use super::lanes::{Indices, LANES, Lanes};
use super::march::{Frame, NEAR_DETAIL_M, OCTAVES_MAX, Occlusion, Rays, carved_extinction, extinction};
use super::shape::{Shape, trilinear};
use crate::cpu::light::octave_shares::{level_share, passage};
use crate::cpu::light::sun_optical_depth::{DEPTH_UNIT, SUN_MARCH_REACH_M, SunLight, marched_direction};

crate::constants! {
    /// Distances of the two finer steps towards the sun and their lengths, m: there what the detail adds to the mean cloud, which the stored depth is of, is taken. Their own extinction in its place would make light, for they
    /// are 2 to 3 optical depths long in dense cloud, and light falls convexly.
    const FINE_FIRST_M: f32 = 18.0;
    const FINE_FIRST_LENGTH_M: f32 = 36.0;
    const FINE_SECOND_M: f32 = 63.0;
    const FINE_SECOND_LENGTH_M: f32 = 54.0;
    /// Finer steps are left out beyond the first distance, m, and fade over the second.
    const FINE_REACH_M: f32 = 7_000.0;
    const FINE_FADE_M: f32 = 1_000.0;
    /// Finer steps are left out below this transmittance, and are whole at twice as much.
    const FINE_DIMMED: f32 = 0.25;
    /// Share of the ground's light that clouds can take by their shadow.
    const COVERED_GROUND: f32 = 0.6;
}
/// The two finer steps: distance and length, m.
const FINE_STEPS_M: [[f32; 2]; 2] = [
    [FINE_FIRST_M, FINE_FIRST_LENGTH_M],
    [FINE_SECOND_M, FINE_SECOND_LENGTH_M],
];

/// Samples that a list holds: most packets' all, so that few lanes go empty, in 5 KiB.
const ROOM: usize = 20 * LANES;
/// What a ray adds up: light of single scattering and of the rest, each at the slab's base and what it gains up to its top, the shares of the sky's and of the ground's light.
const SUMS: usize = 6;

/// Samples that wait for their light.
struct Waiting {
    count: usize,
    /// Lane of the ray.
    ray: [u32; ROOM + 1],
    /// Distance, m.
    t: [f32; ROOM + 1],
    /// Share of what the camera sees.
    share: [f32; ROOM + 1],
    /// Weight of the finer steps towards the sun.
    fade: [f32; ROOM + 1],
}

impl Waiting {
    const NONE: Waiting = Waiting {
        count: 0,
        ray: [0; ROOM + 1],
        t: [0.0; ROOM + 1],
        share: [0.0; ROOM + 1],
        fade: [0.0; ROOM + 1],
    };
    /// Whether another packet may not fit.
    #[inline(always)]
    fn is_full(&self) -> bool {
        self.count + LANES > ROOM
    }
    /// Those of a packet that are `wanted`.
    #[inline(always)]
    fn push(&mut self, t: Lanes, share: Lanes, fade: Lanes, wanted: [bool; LANES]) {
        for l in 0..LANES {
            // Written in any case, and written over if it was not wanted: no branch.
            let at = self.count;
            self.ray[at] = l as u32;
            self.t[at] = t.0[l];
            self.share[at] = share.0[l];
            self.fade[at] = fade.0[l];
            self.count += usize::from(wanted[l]);
        }
    }
}

/// What a packet's rays have met, and the light of it so far.
pub(super) struct Noted {
    fine: Waiting,
    plain: Waiting,
    /// What rays scatter towards the camera at each order; made with the first light.
    phases: Option<[Lanes; OCTAVES_MAX + 1]>,
    sums: [[f32; SUMS]; LANES],
}

impl Noted {
    #[inline(always)]
    pub(super) fn new() -> Noted {
        Noted {
            fine: Waiting::NONE,
            plain: Waiting::NONE,
            phases: None,
            sums: [[0.0; SUMS]; LANES],
        }
    }

    /// Notes samples at distances `t` (m), of which the camera sees the shares `share`, as rays that let `through` pass so far.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        frame: &Frame<'_>,
        cloud: (&Shape, &SunLight),
        rays: &Rays,
        t: Lanes,
        through: Lanes,
        share: Lanes,
    ) {
        let mut fade = Lanes::splat(0.0);
        if matches!(frame.occlusion, Occlusion::Grid) {
            // Faded by what the ray itself has met, so that it does not matter which rays share its packet.
            let undimmed = ((through - FINE_DIMMED) * (1.0 / FINE_DIMMED)).clamp(0.0, 1.0);
            fade = (Lanes::splat(FINE_REACH_M) - t).clamp(0.0, FINE_FADE_M) * (1.0 / FINE_FADE_M) * undimmed;
        }
        let (mut fine, mut plain) = ([false; LANES], [false; LANES]);
        for l in 0..LANES {
            fine[l] = share.0[l] > 0.0 && fade.0[l] > 0.0;
            plain[l] = share.0[l] > 0.0 && fade.0[l] <= 0.0;
        }
        self.fine.push(t, share, fade, fine);
        self.plain.push(t, share, fade, plain);
        if self.fine.is_full() || self.plain.is_full() {
            self.make(frame, cloud, rays);
        }
    }

    /// Makes the light of all that is noted.
    fn make(&mut self, frame: &Frame<'_>, cloud: (&Shape, &SunLight), rays: &Rays) {
        let phases = self.phases.get_or_insert_with(|| {
            let mut phases = [Lanes::splat(0.0); OCTAVES_MAX + 1];
            for (octave, phase) in phases.iter_mut().enumerate().take(frame.octaves + 1) {
                *phase = Lanes::from_fn(|l| frame.phase.octave(octave, rays.turn.0[l]));
            }
            phases
        });
        for waiting in [&mut self.fine, &mut self.plain] {
            add_light(frame, cloud, rays, waiting, phases, &mut self.sums);
            waiting.count = 0;
        }
    }

    /// Radiance of the cloud, all samples together, as if no air lay before it.
    #[inline(always)]
    pub(super) fn light(mut self, frame: &Frame<'_>, cloud: (&Shape, &SunLight), rays: &Rays) -> [Lanes; 3] {
        let mut radiance = [Lanes::splat(0.0); 3];
        if self.phases.is_none() && self.fine.count + self.plain.count == 0 {
            return radiance;
        }
        self.make(frame, cloud, rays);
        let mut sums = [Lanes::splat(0.0); SUMS];
        for (n, sum) in sums.iter_mut().enumerate() {
            for l in 0..LANES {
                sum.0[l] = self.sums[l][n];
            }
        }
        let [once_base, once_rise, sun_base, sun_rise, from_sky, from_ground] = sums;
        // Light that was scattered once has colours, what was scattered further the colours' mean.
        let mut once = [Lanes::splat(0.0); 3];
        for l in 0..LANES {
            let first = frame.phase.first(rays.turn.0[l]);
            for c in 0..3 {
                once[c].0[l] = first[c];
            }
        }
        let light = frame.light;
        let covered = 1.0 - COVERED_GROUND + COVERED_GROUND * cloud.1.sunlit_share;
        for c in 0..3 {
            radiance[c] = (once_base * once[c] + sun_base) * light.sun_at_base[c]
                + (once_rise * once[c] + sun_rise) * (light.sun_at_top[c] - light.sun_at_base[c])
                + from_sky * light.sky_radiance[c]
                + from_ground * (light.ground_radiance[c] * covered);
        }
        radiance
    }
}

/// Adds the light of samples to their rays' sums.
#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn add_light(
    frame: &Frame<'_>,
    (shape, sun_light): (&Shape, &SunLight),
    rays: &Rays,
    waiting: &Waiting,
    phases: &[Lanes; OCTAVES_MAX + 1],
    sums: &mut [[f32; SUMS]; LANES],
) {
    let zero = Lanes::splat(0.0);
    let [ox, oy, oz] = frame.position_m;
    let slowest = -std::f32::consts::LOG2_E * frame.phase.depth_scale * 0.5f32.powi(frame.octaves as i32);
    let sun = marched_direction(frame.beam_direction);
    let shares = frame.phase.level_shares();
    let per_depth = 1.0 / (shape.top_m - shape.bottom_m);
    for first in (0..waiting.count).step_by(LANES) {
        let count = LANES.min(waiting.count - first);
        let mut ray = Indices([0; LANES]);
        let (mut t, mut share, mut fade) = (zero, zero, zero);
        for l in 0..LANES {
            let at = first + l.min(count - 1);
            ray.0[l] = waiting.ray[at];
            t.0[l] = waiting.t[at];
            share.0[l] = waiting.share[at];
            fade.0[l] = waiting.fade[at];
        }
        let of_ray = |values: &Lanes| ray.gather_f32(&values.0);
        let d = [of_ray(&rays.d[0]), of_ray(&rays.d[1]), of_ray(&rays.d[2])];
        let p = [d[0] * t + ox, d[1] * t + oy, t * (d[2] + of_ray(&rays.curve) * t) + oz];
        let mut depth = zero;
        if let (Some(detail), true) = (&frame.detail, fade.any_above(0.0)) {
            for [reach, length] in FINE_STEPS_M {
                let q = [p[0] + sun[0] * reach, p[1] + sun[1] * reach, p[2] + sun[2] * reach];
                let (cover, amplitude) = shape.sample(q[0], q[1], q[2]);
                let carved = carved_extinction(frame.noise, detail, [cover, amplitude], &q, t, NEAR_DETAIL_M);
                depth = depth + (carved - shape.mean_extinction(cover, amplitude, true)) * length;
            }
            depth = depth * fade;
        }
        let (index, f) = shape.place(p[0], p[1], p[2]);
        let corners = shape.corners(&sun_light.words, index);
        depth = match frame.occlusion {
            Occlusion::Grid => (depth + trilinear(&corners, 0, 0xffff, &f) * DEPTH_UNIT).max(zero),
            Occlusion::Steps(steps) => secondary_march(frame, shape, &p, &sun, steps, t),
            Occlusion::Map(map) => map.optical_depth(p[0], p[1], p[2]),
        };
        let sky_seen = trilinear(&corners, 16, 0xff, &f) * (1.0 / 255.0);
        let ground_seen = trilinear(&corners, 24, 0xff, &f) * (1.0 / 255.0);
        // The last octave's transmittance; squaring gives the one before.
        let mut passed = (depth * slowest).exp2();
        let mut scattered = zero;
        for octave in (1..=frame.octaves).rev() {
            scattered = scattered + of_ray(&phases[octave]) * passed;
            passed = passed * passed;
        }
        let passage = passage(sky_seen, ground_seen);
        if let Some(diffuse) = frame.diffuse {
            let fluence = diffuse.towards(shape, &p, &d);
            scattered = (scattered + of_ray(&phases[0]) * passed).max(zero) + fluence * (0.25 / std::f32::consts::PI);
        }
        if frame.octaves > 0 {
            scattered = scattered * level_share(shares, sun[2], depth, sky_seen, passage);
        }
        if let Some(balance) = frame.balance {
            scattered = scattered * balance.factor(shape, p[0], p[1]);
        }
        if let Some(slab) = frame.slab {
            scattered = slab.towards(shape, &p, &d, depth, of_ray(&rays.turn));
        }
        let height = ((p[2] - shape.bottom_m) * per_depth).clamp(0.0, 1.0);
        let added = [
            share * passed,
            share * passed * height,
            share * scattered,
            share * scattered * height,
            share * diffuse_share(passage, ground_seen),
            share * diffuse_share(passage, sky_seen),
        ];
        for l in 0..count {
            let sum = &mut sums[ray.0[l] as usize % LANES];
            for (to, from) in sum.iter_mut().zip(&added) {
                *to += from.0[l];
            }
        }
    }
}

/// What light that is even on one side of the cloud brings a place, over its radiance; `other` is the share that comes from the other side. Two streams without absorption: the share that passes
/// goes down from place to place, all else turns back. Both sides together bring 1, so that light that is the same everywhere stays so.
#[inline(always)]
fn diffuse_share(passage: Lanes, other: Lanes) -> Lanes {
    passage * (Lanes::splat(1.0) / other.max(Lanes::splat(1e-3)) - 0.5)
}

/// Optical depth from `p` towards the sun by a march of `steps` steps, each longer than the one before by the same length; midpoint rule.
#[inline(always)]
fn secondary_march(frame: &Frame<'_>, shape: &Shape, p: &[Lanes; 3], sun: &[f32; 3], steps: u32, t: Lanes) -> Lanes {
    let reach = ((Lanes::splat(shape.top_m) - p[2]) * (1.0 / sun[2])).clamp(0.0, SUN_MARCH_REACH_M);
    let unit = reach * (1.0 / (steps * steps) as f32);
    let mut depth = Lanes::splat(0.0);
    for n in 0..steps {
        let n = n as f32;
        let at = unit * (n * n + n + 0.5);
        let q = [p[0] + at * sun[0], p[1] + at * sun[1], p[2] + at * sun[2]];
        depth = depth + extinction(frame, shape, &q, t, NEAR_DETAIL_M) * unit * (2.0 * n + 1.0);
    }
    depth
}
