//! The cloud of a picture for the path tracer: the very field that the march samples, detail and all.
//!
//! What is the march's own approximation is taken over where it is not about light in cloud, so that both draw the same world: the clear air lies only
//! between the camera and the first thing met, with the sky table's light; a path that was turned in cloud meets the sky as it is midway between the clouds' base and top, one
//! that the ground turned as it is there (stage `sky_light` has the same heights); the sun is a point whose light grows linearly from the cloud's base to its top; detail fades with the distance from the camera. The Earth's
//! curvature is kept (rays are straight, the cloud bends down). No cloud is met beyond 60 km from the camera, nor by light that has
//! gone 100 km.

use multiversion::multiversion;

use super::{Film, Flight, Medium, PathTracer, Scatterer};
use crate::cpu::light::atmosphere::EARTH_RADIUS_M;
use crate::cpu::light::sky_table::SkyTable;
use crate::cpu::view::detail_noise::DetailNoise;
use crate::cpu::view::lanes::{LANES, Lanes};
use crate::cpu::view::march::{
    CARVE_RAMP, DETAIL_FINE, DETAIL_FINEST, DETAIL_HELD, DETAIL_SMALL, DRAW_DISTANCE_M, Frame, SKY_DISTANCE_M,
    detailed_extinction,
};
use crate::cpu::view::shape::{CARVE_EDGE, Shape};
use crate::cpu::view::{Ground, ground};
use crate::view::FrameDetail;

/// Points along an edge of a brick.
const BRICK_POINTS: usize = 4;
/// How far scattered light goes through cloud, m.
const REACH_M: f64 = 100_000.0;
/// Step over a brick's border, m.
const OVER_BORDER_M: f64 = 1e-3;

/// Skies that paths end in: the sun's, and the moon's if it lights one.
pub struct Skies {
    /// As the ground sees it.
    pub at_ground: (SkyTable, Option<SkyTable>),
    /// As it is midway between the clouds' base and top.
    pub at_clouds: (SkyTable, Option<SkyTable>),
}

/// See the module.
pub struct Volume<'a> {
    frame: &'a Frame<'a>,
    skies: &'a Skies,
    bricks: Option<Bricks<'a>>,
}

struct Bricks<'a> {
    shape: &'a Shape,
    count: [usize; 3],
    size_m: [f64; 3],
    period_m: [f64; 2],
    majorant: Vec<f32>,
}

impl<'a> Bricks<'a> {
    fn new(shape: &'a Shape, detail: Option<FrameDetail>) -> Bricks<'a> {
        let points = shape.points;
        // A side shorter than a brick is one brick.
        let along = [0, 1, 2].map(|a| BRICK_POINTS.min(points[a]));
        let count = [0, 1, 2].map(|a| points[a].div_ceil(along[a]));
        let mut majorant = vec![0.0f32; count[0] * count[1] * count[2]];
        for (n, brick) in majorant.iter_mut().enumerate() {
            let at = [n % count[0], n / count[0] % count[1], n / (count[0] * count[1])];
            let (mut cover, mut amplitude) = (0.0f32, 0.0f32);
            // Stored rows and columns begin one point before the first: with a margin of one point on either side.
            let span = |a: usize| {
                let first = at[a] * along[a];
                let last = (first + along[a] + 1).min(points[a] + 1);
                if a < 2 {
                    first..=last
                } else {
                    first.saturating_sub(1)..=(first + along[a]).min(points[a] - 1)
                }
            };
            for k in span(2) {
                for j in span(1) {
                    for i in span(0) {
                        let (c, a) = shape.at_point(i, j, k);
                        cover = cover.max(c);
                        amplitude = amplitude.max(a);
                    }
                }
            }
            *brick = amplitude * most_of(cover, detail);
        }
        Bricks {
            shape,
            count,
            size_m: [0, 1, 2].map(|a| f64::from(shape.point_spacing_m[a]) * along[a] as f64),
            period_m: [0, 1].map(|a| f64::from(shape.point_spacing_m[a]) * points[a] as f64),
            majorant,
        }
    }
}

/// The largest share of the amplitude that cover up to `cover` can give.
fn most_of(cover: f32, detail: Option<FrameDetail>) -> f32 {
    let Some(detail) = detail else { return cover };
    // Each noise is one half above its mean at most.
    let push = 0.5 * (1.0 + DETAIL_SMALL + DETAIL_FINE + DETAIL_FINEST) * detail.push;
    let level = cover + push * (cover * DETAIL_HELD).clamp(0.0, 1.0) - CARVE_EDGE;
    let t = (level / CARVE_RAMP).clamp(0.0, 1.0);
    let carved = t * t * (3.0 - 2.0 * t);
    // A thousandth for rounding.
    1.001 * (cover + (carved - cover) * detail.blend).max(0.0) + 1e-6
}

impl<'a> Volume<'a> {
    /// Of a picture's frame.
    pub fn new(frame: &'a Frame<'a>, skies: &'a Skies) -> Volume<'a> {
        Volume {
            frame,
            skies,
            bricks: frame.cloud.map(|(shape, _)| Bricks::new(shape, frame.detail)),
        }
    }
    /// Height above the curved ground.
    fn height_m(&self, at: &[f64; 3]) -> f64 {
        at[2] + self.across(at, at).max(0.0) * 0.5
    }
    /// `(at - camera) . (way - camera)` over the level, over the Earth's radius.
    fn across(&self, at: &[f64; 3], way: &[f64; 3]) -> f64 {
        let o = self.frame.position_m;
        let part = |a: usize| (at[a] - f64::from(o[a])) * (way[a] - f64::from(o[a]));
        (part(0) + part(1)) / f64::from(EARTH_RADIUS_M)
    }
    fn rise(&self, at: &[f64; 3], along: &[f64; 3]) -> f64 {
        let o = self.frame.position_m;
        let part = |a: usize| (at[a] - f64::from(o[a])) * along[a];
        along[2] + (part(0) + part(1)) / f64::from(EARTH_RADIUS_M)
    }
    fn distance_m(&self, at: &[f64; 3]) -> f64 {
        let o = self.frame.position_m.map(f64::from);
        [0, 1, 2].map(|a| (at[a] - o[a]).powi(2)).iter().sum::<f64>().sqrt()
    }
    /// Distance to the ground, if the ray meets it.
    fn to_ground(&self, height: f64, rise: f64, curve: f64) -> Option<f64> {
        let under_root = rise * rise - 4.0 * curve * height;
        (rise < 0.0 && under_root >= 0.0).then(|| 2.0 * height.max(0.0) / (under_root.sqrt() - rise))
    }
    fn end(&self, at: &mut [f64; 3], along: &[f64; 3], height: f64, rise: f64, curve: f64) -> Flight {
        match self.to_ground(height, rise, curve) {
            Some(distance) => {
                go(at, along, distance);
                Flight::Ground
            }
            None => Flight::Sky,
        }
    }
    /// Where a ray of view ends and what the haze lets pass to there and to `distance`.
    fn haze(&self, along: &[f64; 3], distance: f64) -> [[f64; 3]; 2] {
        let frame = self.frame;
        let height = f64::from(frame.position_m[2]);
        let curve = curve(along);
        let end = self
            .to_ground(height, along[2], curve)
            .unwrap_or(f64::from(SKY_DISTANCE_M));
        let passed = |distance: f64| {
            let t = frame
                .haze
                .transmittance(Lanes::splat(distance as f32), Lanes::splat(along[2] as f32));
            t.map(|c| f64::from(c.0[0]))
        };
        [passed(end.min(f64::from(SKY_DISTANCE_M))), passed(distance)]
    }
    fn look(&self, along: &[f64; 3], below: bool) -> [f64; 3] {
        look([Some(self.frame.sky), self.frame.moon_sky], along, below)
    }
}

/// Radiance of skies added; `below` looks at the ground, else what lies below the horizon is the horizon.
fn look(skies: [Option<&SkyTable>; 2], along: &[f64; 3], below: bool) -> [f64; 3] {
    let mut light = [0.0; 3];
    for sky in skies.into_iter().flatten() {
        let z = along[2] as f32;
        let z = if below { z } else { z.max(sky.horizon_sine + 2e-4) };
        let own = sky.look(&[along[0] as f32, along[1] as f32, z].map(Lanes::splat));
        for c in 0..3 {
            light[c] += f64::from(own[c].0[0]);
        }
    }
    light
}

fn go(at: &mut [f64; 3], along: &[f64; 3], distance: f64) {
    for a in 0..3 {
        at[a] += along[a] * distance;
    }
}

fn curve(along: &[f64; 3]) -> f64 {
    (1.0 - along[2] * along[2]).max(0.0) * 0.5 / f64::from(EARTH_RADIUS_M)
}

impl Medium for Volume<'_> {
    fn fly(&self, at: &mut [f64; 3], along: &[f64; 3], reach: &mut f64, random: f64) -> Option<Flight> {
        let mut height = self.height_m(at);
        let mut rise = self.rise(at, along);
        let curve = curve(along);
        let Some(bricks) = &self.bricks else {
            return Some(self.end(at, along, height, rise, curve));
        };
        if *reach <= 0.0 {
            return Some(self.end(at, along, height, rise, curve));
        }
        let (bottom, top) = (f64::from(bricks.shape.bottom_m), f64::from(bricks.shape.top_m));
        let leap = if height >= top {
            let under_root = rise * rise - 4.0 * curve * (height - top);
            if rise >= 0.0 || under_root < 0.0 {
                return Some(Flight::Sky);
            }
            2.0 * (height - top) / (under_root.sqrt() - rise)
        } else if height < bottom {
            if self.to_ground(height, rise, curve).is_some() {
                return Some(self.end(at, along, height, rise, curve));
            }
            let root = (rise * rise + 4.0 * curve * (bottom - height)).sqrt();
            2.0 * (bottom - height) / (root + rise)
        } else {
            0.0
        };
        if leap > 0.0 {
            if !leap.is_finite() || leap >= *reach {
                *reach = 0.0;
                return Some(self.end(at, along, height, rise, curve));
            }
            go(at, along, leap);
            *reach -= leap;
            height = self.height_m(at).clamp(bottom, top);
            rise = self.rise(at, along);
        }
        // The brick here, and the way through it.
        let mut index = [0usize; 3];
        let mut exit = *reach;
        for a in 0..2 {
            let inside = at[a].rem_euclid(bricks.period_m[a]);
            let n = ((inside / bricks.size_m[a]) as usize).min(bricks.count[a] - 1);
            index[a] = n;
            if bricks.count[a] > 1 {
                let low = n as f64 * bricks.size_m[a];
                let high = (low + bricks.size_m[a]).min(bricks.period_m[a]);
                exit = exit.min(until(inside, along[a], low, high));
            }
        }
        let above = height - bottom;
        index[2] = ((above / bricks.size_m[2]) as usize).min(bricks.count[2] - 1);
        let low = index[2] as f64 * bricks.size_m[2];
        exit = exit.min(until(above, rise, low, low + bricks.size_m[2]));
        if rise < 0.0 {
            let ground = height.max(0.0) / -rise;
            if ground <= exit {
                exit = ground;
            }
        }
        let majorant = bricks.majorant[(index[2] * bricks.count[1] + index[1]) * bricks.count[0] + index[0]];
        let free = -(1.0 - random).ln() / f64::from(majorant);
        if majorant > 0.0 && free < exit {
            go(at, along, free);
            *reach -= free;
            return Some(Flight::Candidate(f64::from(majorant)));
        }
        if rise < 0.0 && height - exit * -rise <= OVER_BORDER_M {
            go(at, along, exit);
            return Some(Flight::Ground);
        }
        go(at, along, exit + OVER_BORDER_M);
        *reach -= exit + OVER_BORDER_M;
        None
    }

    fn extinction(&self, at: &[[f64; 3]; LANES]) -> [f64; LANES] {
        let Some(bricks) = &self.bricks else {
            return [0.0; LANES];
        };
        let mut p = [Lanes::splat(0.0); 3];
        let mut t = Lanes::splat(0.0);
        for l in 0..LANES {
            p[0].0[l] = at[l][0] as f32;
            p[1].0[l] = at[l][1] as f32;
            p[2].0[l] = self.height_m(&at[l]) as f32;
            t.0[l] = self.distance_m(&at[l]) as f32;
        }
        let lanes = look_up(bricks.shape, self.frame.noise, self.frame.detail, &p, t);
        lanes.0.map(f64::from)
    }

    fn sun(&self, at: &[f64; 3]) -> [f64; 3] {
        let light = self.frame.light;
        match &self.bricks {
            Some(bricks) => {
                let (bottom, top) = (f64::from(bricks.shape.bottom_m), f64::from(bricks.shape.top_m));
                let height = self.height_m(at);
                // On the ground under the cloud.
                if height < bottom - 1.0 {
                    return light.sun_at_ground.map(f64::from);
                }
                let share = ((height - bottom) / (top - bottom)).clamp(0.0, 1.0);
                [0, 1, 2].map(|c| {
                    let (base, top) = (f64::from(light.sun_at_base[c]), f64::from(light.sun_at_top[c]));
                    base + (top - base) * share
                })
            }
            None => light.sun_at_ground.map(f64::from),
        }
    }

    fn sky(&self, along: &[f64; 3], from_ground: bool) -> [f64; 3] {
        let skies = self.skies;
        let (sun, moon) = if from_ground {
            &skies.at_ground
        } else {
            &skies.at_clouds
        };
        look([Some(sun), moon.as_ref()], along, false)
    }

    fn background(&self, along: &[f64; 3]) -> [f64; 3] {
        let frame = self.frame;
        let mut light = self.look(along, false);
        let beyond = frame.beyond_air(&along.map(|v| Lanes::splat(v as f32)), Lanes::splat(1.0));
        for c in 0..3 {
            light[c] += f64::from(beyond[c].0[0]);
        }
        light
    }

    fn air(&self, at: &[f64; 3], along: &[f64; 3]) -> [[f64; 3]; 2] {
        if !self.frame.haze_on_cloud {
            return [[0.0; 3], [1.0; 3]];
        }
        let [whole, passed] = self.haze(along, self.distance_m(at));
        let below = self
            .to_ground(f64::from(self.frame.position_m[2]), along[2], curve(along))
            .is_some();
        let sky = self.look(along, below);
        let added = [0, 1, 2].map(|c| sky[c] * ((1.0 - passed[c]) / (1.0 - whole[c]).max(1e-6)).min(1.0));
        [added, passed]
    }

    fn seen_ground(&self, at: &[f64; 3], along: &[f64; 3]) -> [[f64; 3]; 2] {
        let frame = self.frame;
        let distance = self.distance_m(at);
        let [whole, _] = self.haze(along, distance);
        let mut added = self.look(along, true);
        let d = along.map(|v| Lanes::splat(v as f32));
        let albedo = ground::albedo(
            frame.ground,
            frame.noise,
            Lanes::splat(at[0] as f32),
            Lanes::splat(at[1] as f32),
            Lanes::splat(distance as f32),
        );
        let mut factor = [0, 1, 2].map(|c| f64::from(albedo[c].0[0]) * whole[c]);
        if frame.ground == Ground::Sea {
            let share = f64::from(ground::mirror_share(d[2]).0[0]);
            let mirrored = frame.sky_look(&ground::mirrored(&d));
            for c in 0..3 {
                added[c] += whole[c] * share * f64::from(mirrored[c].0[0]);
                factor[c] *= 1.0 - share;
            }
        }
        [added, factor]
    }

    fn ground_albedo(&self) -> [f64; 3] {
        self.frame.ground.albedo().map(f64::from)
    }

    fn reaches(&self) -> [f64; 2] {
        [f64::from(DRAW_DISTANCE_M), REACH_M]
    }
}

/// Distance until a coordinate leaves its range. What is slower than a nanometre a metre does not: along an axis on a border rounding would else say
/// at each step that the next brick begins here.
fn until(at: f64, speed: f64, low: f64, high: f64) -> f64 {
    const STANDS: f64 = 1e-9;
    let distance = if speed > STANDS {
        (high - at) / speed
    } else if speed < -STANDS {
        (low - at) / speed
    } else {
        f64::INFINITY
    };
    distance.max(0.0)
}

#[multiversion(targets(
    "x86_64+avx512f+avx512bw+avx512dq+avx512vl+avx2+fma",
    "x86_64+avx2+fma",
    "aarch64+neon"
))]
fn look_up(shape: &Shape, noise: &DetailNoise, detail: Option<FrameDetail>, p: &[Lanes; 3], t: Lanes) -> Lanes {
    detailed_extinction(shape, noise, detail, p, t, t.smallest())
}

/// Adds `samples` paths through the middle of every pixel of a frame's picture to its film.
pub fn trace(frame: &Frame<'_>, skies: &Skies, scatterer: &Scatterer, albedo: f64, film: &mut Film, samples: u32) {
    let medium = Volume::new(frame, skies);
    let sun = frame.beam_direction.map(f64::from);
    let length = (sun[0] * sun[0] + sun[1] * sun[1] + sun[2] * sun[2]).sqrt();
    let lit = [
        frame.light.sun_at_top,
        frame.light.sun_at_base,
        frame.light.sun_at_ground,
    ];
    let tracer = PathTracer {
        medium: &medium,
        scatterer,
        sun_direction: lit.iter().flatten().any(|v| *v > 0.0).then(|| sun.map(|v| v / length)),
        albedo: albedo.clamp(0.0, 1.0),
    };
    let [right, up, ahead] = frame.axes.map(|a| a.map(f64::from));
    let scale = 2.0 * f64::from(frame.half_height) / frame.height as f64;
    let start = |pixel: usize| {
        let x = (pixel % frame.width) as f64 + 0.5 - 0.5 * frame.width as f64;
        let y = (pixel / frame.width) as f64 + 0.5 - 0.5 * frame.height as f64;
        let d = [0, 1, 2].map(|a| scale * (x * right[a] - y * up[a]) + ahead[a]);
        let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        [frame.position_m.map(f64::from), d.map(|v| v / length)]
    };
    tracer.trace(film, &start, samples);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::light::Atmosphere;
    use crate::cpu::light::march_phase::MarchPhase;
    use crate::cpu::light::multiple_scattering_table::MultipleScatteringTable;
    use crate::cpu::light::path_tracer::slab::Estimate;
    use crate::cpu::light::phase_table::PhaseChoice;
    use crate::cpu::light::sky_light::SkyLight;
    use crate::cpu::light::sky_table::SkySource;
    use crate::cpu::light::sun_optical_depth::SunLight;
    use crate::cpu::light::sun_optical_depth::tests::{fine_depth, ragged, shape_of};
    use crate::cpu::light::transmittance_table::TransmittanceTable;
    use crate::cpu::view::haze::Haze;
    use crate::cpu::view::march::Occlusion;
    use crate::view::Scattering;

    /// A night without air and a sun of irradiance 1 on clouds alone.
    struct Night {
        skies: Skies,
        noise: DetailNoise,
        light: SkyLight,
        phase: MarchPhase,
        lit: SunLight,
    }

    impl Night {
        fn new() -> Night {
            let air = Atmosphere::new(0.0, None);
            let transmittance = TransmittanceTable::new(&air);
            let multiple = MultipleScatteringTable::new(&air, &transmittance);
            let source = SkySource::sun([0.0, 0.0, -1.0], false);
            let sky = || {
                (
                    SkyTable::new(&air, &transmittance, &multiple, &source, None, 10.0),
                    None,
                )
            };
            Night {
                skies: Skies {
                    at_ground: sky(),
                    at_clouds: sky(),
                },
                noise: DetailNoise::new(),
                light: SkyLight::BEAM_ON_CLOUDS,
                phase: MarchPhase::new(PhaseChoice::Rayleigh, Scattering::Octaves, 0),
                lit: SunLight {
                    words: Vec::new(),
                    shadow: Vec::new(),
                    sunlit_share: 1.0,
                },
            }
        }
        fn frame<'a>(&'a self, shape: &'a Shape, detail: Option<FrameDetail>, position_m: [f32; 3]) -> Frame<'a> {
            Frame {
                width: 1,
                height: 1,
                position_m,
                axes: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
                half_height: 0.5,
                sun_direction: [0.0, 0.0, 1.0],
                beam_direction: [0.0, 0.0, 1.0],
                exposure: 1.0,
                sky: &self.skies.at_ground.0,
                moon_sky: None,
                moon: None,
                stars: None,
                light: &self.light,
                haze: Haze {
                    rayleigh_per_m: [0.0; 3],
                    aerosol_per_m: 0.0,
                },
                haze_on_cloud: false,
                cloud: Some((shape, &self.lit)),
                ground: Ground::Land,
                shaft_samples: 0,
                steps: (0.0, 0),
                shadow: false,
                noise: &self.noise,
                detail,
                octaves: 0,
                phase: &self.phase,
                occlusion: Occlusion::Grid,
                diffuse: None,
                balance: None,
                slab: None,
                sun_disc: [0.0; 3],
            }
        }
    }

    /// Numbers from 0 to 1, for ever.
    struct Numbers(u64);

    impl Numbers {
        fn next(&mut self) -> f64 {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }
    }

    /// The majorant that a flight from a place is tracked with, and the place (a border is stepped over).
    fn tracked(volume: &Volume<'_>, place: [f64; 3], along: &[f64; 3]) -> (f64, [f64; 3]) {
        let mut here = place;
        for _ in 0..8 {
            let before = here;
            // A free path of no length, so that the candidate is here.
            match volume.fly(&mut here, along, &mut 1e5, 0.0) {
                Some(Flight::Candidate(majorant)) => return (majorant, here),
                Some(_) => return (0.0, before),
                None if (0..3).any(|a| (here[a] - before[a]).abs() > 2.0 * OVER_BORDER_M) => return (0.0, before),
                None => {}
            }
        }
        panic!("no flight leaves {place:?}");
    }

    /// Delta tracking is true to the cloud only where no extinction is above the majorant: at random places, on bricks' borders, several periods on,
    /// near the camera and far from it. In solid cloud the majorant is within a hundredth of the extinction, so that one a twentieth too low is found.
    #[test]
    fn no_extinction_is_above_its_majorant() {
        let night = Night::new();
        let block = shape_of([12, 12, 20], [80.0, 60.0, 40.0], |[i, j, k]| {
            if (2..9).contains(&i) && (3..10).contains(&j) && (4..17).contains(&k) {
                0.01
            } else {
                0.0
            }
        });
        // Points don't fill the last brick of either.
        let shapes = [block, ragged([11, 9, 15], [100.0, 100.0, 40.0])];
        let detail = |strength: f32, scale_m: f32| FrameDetail {
            push: 1.6 * strength,
            blend: (4.0 * strength).min(1.0),
            tiles_per_m: 1.0 / (4.0 * scale_m),
            offset_m: [13.0, 170.0, 55.0],
        };
        for detail in [
            None,
            Some(detail(0.1, 150.0)),
            Some(detail(0.6, 220.0)),
            Some(detail(1.0, 90.0)),
        ] {
            let mut closest: f64 = 0.0;
            for shape in &shapes {
                for position_m in [[300.0, 400.0, 500.0], [40_000.0, -9_000.0, 2.0]] {
                    let frame = night.frame(shape, detail, position_m);
                    let volume = Volume::new(&frame, &night.skies);
                    let bricks = volume.bricks.as_ref().unwrap();
                    let mut numbers = Numbers(7);
                    let mut cloudy = 0;
                    for n in 0..40_000 {
                        let (bottom, top) = (f64::from(shape.bottom_m), f64::from(shape.top_m));
                        let mut place = [
                            (3.0 * numbers.next() - 1.5) * bricks.period_m[0],
                            (3.0 * numbers.next() - 1.5) * bricks.period_m[1],
                            numbers.next() * (top - bottom),
                        ];
                        // Some on borders between bricks.
                        for a in 0..3 {
                            if n % (5 + a) == 0 {
                                place[a] = (place[a] / bricks.size_m[a]).round() * bricks.size_m[a];
                            }
                        }
                        // A hair within: on the slab's own edge rounding says which side it is.
                        place[2] = (place[2] + bottom).clamp(bottom + 0.01, top - 0.01);
                        // The cloud bends down with the Earth.
                        place[2] -= volume.height_m(&place) - place[2];
                        let z = 2.0 * numbers.next() - 1.0;
                        let (east, north) = (std::f64::consts::TAU * numbers.next()).sin_cos();
                        let flat = (1.0 - z * z).sqrt();
                        let (majorant, here) = tracked(&volume, place, &[flat * east, flat * north, z]);
                        let extinction = volume.extinction(&[here; LANES])[0];
                        assert!(
                            extinction <= majorant * (1.0 + 1e-6),
                            "{detail:?}, {here:?}: {extinction} above {majorant}"
                        );
                        cloudy += usize::from(extinction > 0.0);
                        if majorant > 0.0 {
                            closest = closest.max(extinction / majorant);
                        }
                    }
                    assert!(cloudy > 2_000, "{cloudy} places in cloud");
                }
            }
            assert!(closest > 0.99, "{detail:?}: majorants are loose, {closest}");
        }
    }

    /// A volume's cloud over black ground, under a black sky or under an even one.
    struct OverBlack<'a> {
        volume: &'a Volume<'a>,
        from_above: f64,
    }

    impl Medium for OverBlack<'_> {
        fn fly(&self, at: &mut [f64; 3], along: &[f64; 3], reach: &mut f64, random: f64) -> Option<Flight> {
            self.volume.fly(at, along, reach, random)
        }
        fn extinction(&self, at: &[[f64; 3]; LANES]) -> [f64; LANES] {
            self.volume.extinction(at)
        }
        fn sun(&self, at: &[f64; 3]) -> [f64; 3] {
            self.volume.sun(at)
        }
        fn sky(&self, along: &[f64; 3], _from_ground: bool) -> [f64; 3] {
            [if along[2] > 0.0 { self.from_above } else { 0.0 }; 3]
        }
        fn reaches(&self) -> [f64; 2] {
            self.volume.reaches()
        }
    }

    /// A level slab as cells of cloud sends back what discrete ordinates of 64 streams say: along the beam's way under an even sky (reciprocity; the
    /// tracking alone), and up to all sides under the sun (the looks at the sun too). A slab's reflection depends on its depth alone, so that the
    /// spline's soft edges cost nothing; its depth is 4 to 2 parts in a thousand, and no row changes by more than 0.2 a unit of depth.
    #[test]
    fn a_slab_of_cells_sends_back_what_a_slab_does() {
        const RAYS: usize = 1024;
        const DISCRETISATION: f64 = 0.2 * 0.002 * 4.0;
        let shape = shape_of([4, 4, 60], [3_000.0, 3_000.0, 20.0], |[_, _, k]| {
            if (5..55).contains(&k) { 0.004 } else { 0.0 }
        });
        let depth = fine_depth(&shape, [0.0, 0.0, 1.0], [0.0, 0.0, f64::from(shape.bottom_m)]);
        assert!((depth - 4.0).abs() < 0.002 * 4.0, "{depth}");
        let night = Night::new();
        let frame = night.frame(&shape, None, [100.0, 100.0, shape.top_m + 1.0]);
        let volume = Volume::new(&frame, &night.skies);
        let start = frame.position_m.map(f64::from);
        let estimate =
            |tracer: &PathTracer<'_, OverBlack<'_>>, along: &(dyn Fn(usize) -> [f64; 3] + Sync), scale: f64| {
                let mut film = Film::new(RAYS);
                // Looks at the sun are noisier.
                let paths = if tracer.sun_direction.is_some() { 400 } else { 200 };
                tracer.trace(&mut film, &|pixel| [start, along(pixel)], paths);
                let n = RAYS as f64;
                Estimate {
                    mean: scale * film.radiance().iter().map(|p| p[1]).sum::<f64>() / n,
                    error: scale * film.squared_error().iter().map(|p| p[1]).sum::<f64>().sqrt() / n,
                }
            };
        for (asymmetry, sun_cosine, published) in [
            (0.0, 1.0, 0.69093),
            (0.0, 0.5, 0.78554),
            (0.85, 1.0, 0.19092),
            (0.85, 0.5, 0.41602),
        ] {
            let scatterer = Scatterer::new(PhaseChoice::HenyeyGreenstein { asymmetry });
            let sun = [f64::sqrt(1.0 - sun_cosine * sun_cosine), 0.0, sun_cosine];
            for by_sun in [false, true] {
                let medium = OverBlack {
                    volume: &volume,
                    from_above: if by_sun { 0.0 } else { 1.0 },
                };
                let tracer = PathTracer {
                    medium: &medium,
                    scatterer: &scatterer,
                    sun_direction: by_sun.then_some(sun),
                    albedo: 1.0,
                };
                let ours = if by_sun {
                    // Down into the slab, as often as their cosine asks for, evenly spread; pi times the mean is the flux that leaves.
                    let spread = |pixel: usize| {
                        let square = (pixel as f64 + 0.5) / RAYS as f64;
                        let (east, north) = (2.399_963_229_728_653 * pixel as f64).sin_cos();
                        let flat = (1.0 - square).sqrt();
                        [flat * east, flat * north, -square.sqrt()]
                    };
                    estimate(&tracer, &spread, std::f64::consts::PI / sun_cosine)
                } else {
                    estimate(&tracer, &|_| sun.map(|v| -v), 1.0)
                };
                let allowed = 3.0 * ours.error + DISCRETISATION;
                assert!(
                    (ours.mean - published).abs() < allowed && allowed < 0.015,
                    "g {asymmetry}, mu0 {sun_cosine}, by the sun {by_sun}: {ours:?}, not {published}"
                );
            }
        }
    }
}
