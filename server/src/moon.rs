//! Where the moon stands, and how the sky of stars is turned.
//!
//! The moon: the truncated series of Chapront's ELP-2000/82 in Meeus, "Astronomical Algorithms" (2nd edition, 1998), chapter 47, down to terms of 0.003 degrees,
//! with the largest terms of nutation (chapter 22) and parallax (chapter 40): about 0.01 degrees from 1900 to 2100. Sidereal time: chapter 12.
//! No refraction, as for the sun. No kept crate of a size that fits has the moon under a licence that fits.

use welkin_proto::scene::{self, Domain, Scene};
use welkin_proto::time::parse_utc;

use crate::sun::{self, DELTA_T_S, JULIAN_DATE_OF_UNIX_EPOCH};

/// Julian date of 2000-01-01T12:00.
const J2000: f64 = 2_451_545.0;
const DAYS_A_CENTURY: f64 = 36_525.0;
/// Mean distance of the moon, m: the distance of one that is placed by hand.
pub const MOON_MEAN_DISTANCE_M: f64 = 385_000_560.0;
/// Equatorial radius of the Earth and its flattening (IAU 1976).
const EARTH_EQUATOR_M: f64 = 6_378_140.0;
const EARTH_POLE_SHARE: f64 = 0.996_647_19;

/// Multiples of D, M, M', F; longitude's sine in 1e-6 degrees; distance's cosine in m.
#[rustfmt::skip]
const LONGITUDE_DISTANCE: &[([i8; 4], f64, f64)] = &[
    ([0, 0, 1, 0], 6_288_774.0, -20_905_355.0),
    ([2, 0, -1, 0], 1_274_027.0, -3_699_111.0),
    ([2, 0, 0, 0], 658_314.0, -2_955_968.0),
    ([0, 0, 2, 0], 213_618.0, -569_925.0),
    ([0, 1, 0, 0], -185_116.0, 48_888.0),
    ([0, 0, 0, 2], -114_332.0, -3_149.0),
    ([2, 0, -2, 0], 58_793.0, 246_158.0),
    ([2, -1, -1, 0], 57_066.0, -152_138.0),
    ([2, 0, 1, 0], 53_322.0, -170_733.0),
    ([2, -1, 0, 0], 45_758.0, -204_586.0),
    ([0, 1, -1, 0], -40_923.0, -129_620.0),
    ([1, 0, 0, 0], -34_720.0, 108_743.0),
    ([0, 1, 1, 0], -30_383.0, 104_755.0),
    ([2, 0, 0, -2], 15_327.0, 10_321.0),
    ([0, 0, 1, 2], -12_528.0, 0.0),
    ([0, 0, 1, -2], 10_980.0, 79_661.0),
    ([4, 0, -1, 0], 10_675.0, -34_782.0),
    ([0, 0, 3, 0], 10_034.0, -23_210.0),
    ([4, 0, -2, 0], 8_548.0, -21_636.0),
    ([2, 1, -1, 0], -7_888.0, 24_208.0),
    ([2, 1, 0, 0], -6_766.0, 30_824.0),
    ([1, 0, -1, 0], -5_163.0, -8_379.0),
    ([1, 1, 0, 0], 4_987.0, -16_675.0),
    ([2, -1, 1, 0], 4_036.0, -12_831.0),
    ([2, 0, 2, 0], 3_994.0, -10_445.0),
    ([4, 0, 0, 0], 3_861.0, -11_650.0),
    ([2, 0, -3, 0], 3_665.0, 14_403.0),
];
/// The same multiples; latitude's sine in 1e-6 degrees.
#[rustfmt::skip]
const LATITUDE: &[([i8; 4], f64)] = &[
    ([0, 0, 0, 1], 5_128_122.0),
    ([0, 0, 1, 1], 280_602.0),
    ([0, 0, 1, -1], 277_693.0),
    ([2, 0, 0, -1], 173_237.0),
    ([2, 0, -1, 1], 55_413.0),
    ([2, 0, -1, -1], 46_271.0),
    ([2, 0, 0, 1], 32_573.0),
    ([0, 0, 2, 1], 17_198.0),
    ([2, 0, 1, -1], 9_266.0),
    ([0, 0, 2, -1], 8_822.0),
    ([2, -1, 0, -1], 8_216.0),
    ([2, 0, -2, -1], 4_324.0),
    ([2, 0, 1, 1], 4_200.0),
    ([2, 1, 0, -1], -3_359.0),
];

/// The moon as seen from a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moon {
    /// Degrees above the horizon.
    pub elevation_deg: f64,
    /// Degrees clockwise from north.
    pub azimuth_deg: f64,
    /// Distance from the place, m.
    pub distance_m: f64,
}

/// Nutation in longitude and in obliquity, and the true obliquity of the ecliptic, degrees.
struct Ecliptic {
    nutation_deg: f64,
    obliquity_deg: f64,
}

fn ecliptic(centuries: f64) -> Ecliptic {
    let t = centuries;
    let node = (125.044_52 - 1_934.136_261 * t).to_radians();
    let sun = (280.466_5 + 36_000.769_8 * t).to_radians();
    let moon = (218.316_5 + 481_267.881_3 * t).to_radians();
    let nutation_s =
        -17.20 * node.sin() - 1.32 * (2.0 * sun).sin() - 0.23 * (2.0 * moon).sin() + 0.21 * (2.0 * node).sin();
    let tilt_s = 9.20 * node.cos() + 0.57 * (2.0 * sun).cos() + 0.10 * (2.0 * moon).cos() - 0.09 * (2.0 * node).cos();
    let mean_deg = 23.439_291_1 - (46.815 * t + 0.000_59 * t * t - 0.001_813 * t * t * t) / 3_600.0;
    Ecliptic {
        nutation_deg: nutation_s / 3_600.0,
        obliquity_deg: mean_deg + tilt_s / 3_600.0,
    }
}

/// Geometric longitude and latitude of date, degrees, and distance, m, seen from the Earth's centre.
fn geocentric(centuries: f64) -> [f64; 3] {
    let t = centuries;
    let powers = |c: [f64; 5]| c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4])));
    // Mean longitude, elongation, the sun's and the moon's anomaly, argument of latitude.
    let mean = powers([
        218.316_447_7,
        481_267.881_234_21,
        -0.001_578_6,
        1.0 / 538_841.0,
        -1.0 / 65_194_000.0,
    ]);
    let d = powers([
        297.850_192_1,
        445_267.111_403_4,
        -0.001_881_9,
        1.0 / 545_868.0,
        -1.0 / 113_065_000.0,
    ]);
    let m = powers([357.529_109_2, 35_999.050_290_9, -0.000_153_6, 1.0 / 24_490_000.0, 0.0]);
    let n = powers([
        134.963_396_4,
        477_198.867_505_5,
        0.008_741_4,
        1.0 / 69_699.0,
        -1.0 / 14_712_000.0,
    ]);
    let f = powers([
        93.272_095_0,
        483_202.017_523_3,
        -0.003_653_9,
        -1.0 / 3_526_000.0,
        1.0 / 863_310_000.0,
    ]);
    let sine = |degrees: f64| degrees.to_radians().sin();
    // The sun's orbit gets rounder.
    let round: f64 = 1.0 - t * (0.002_516 + t * 0.000_007_4);
    let argument = |k: &[i8; 4]| {
        let [a, b, c, e] = k.map(f64::from);
        (a * d + b * m + c * n + e * f).to_radians()
    };
    let weight = |k: &[i8; 4]| round.powi(i32::from(k[1].abs()));
    let (mut longitude, mut distance, mut latitude) = (0.0, 0.0, 0.0);
    for (k, along, away) in LONGITUDE_DISTANCE {
        let (sin, cos) = argument(k).sin_cos();
        longitude += weight(k) * along * sin;
        distance += weight(k) * away * cos;
    }
    for (k, up) in LATITUDE {
        latitude += weight(k) * up * argument(k).sin();
    }
    let venus = 119.75 + 131.849 * t;
    let jupiter = 53.09 + 479_264.290 * t;
    let flattening = 313.45 + 481_266.484 * t;
    longitude += 3_958.0 * sine(venus) + 1_962.0 * sine(mean - f) + 318.0 * sine(jupiter);
    latitude += -2_235.0 * sine(mean)
        + 382.0 * sine(flattening)
        + 175.0 * (sine(venus - f) + sine(venus + f))
        + 127.0 * sine(mean - n)
        - 115.0 * sine(mean + n);
    [
        (mean + longitude * 1e-6).rem_euclid(360.0),
        latitude * 1e-6,
        MOON_MEAN_DISTANCE_M + distance,
    ]
}

fn julian_date(unix_s: f64) -> f64 {
    unix_s / 86_400.0 + JULIAN_DATE_OF_UNIX_EPOCH
}

/// Apparent sidereal time at a longitude, radians from 0 to a turn: the right ascension that culminates.
pub fn sidereal_rad(unix_s: f64, longitude_deg: f64) -> f64 {
    let days = julian_date(unix_s) - J2000;
    let t = days / DAYS_A_CENTURY;
    let Ecliptic {
        nutation_deg,
        obliquity_deg,
    } = ecliptic(t);
    let greenwich = 280.460_618_37 + 360.985_647_366_29 * days + t * t * (0.000_387_933 - t / 38_710_000.0);
    let apparent = greenwich + nutation_deg * obliquity_deg.to_radians().cos();
    (apparent + longitude_deg).rem_euclid(360.0).to_radians()
}

/// Rows that turn a direction of the world (east, north, up) into one of the equator of date (towards the equinox, a quarter turn east of
/// it, the pole).
pub fn equatorial_from_world(sidereal_rad: f64, latitude_deg: f64) -> [[f32; 3]; 3] {
    let (s, c) = sidereal_rad.sin_cos();
    let (up, north) = latitude_deg.to_radians().sin_cos();
    [[-s, -up * c, north * c], [c, -up * s, north * s], [0.0, north, up]].map(|row| row.map(|v| v as f32))
}

/// The moon by the clock, from the domain's place.
pub fn by_clock(domain: &Domain, unix_s: f64) -> Moon {
    let t = (julian_date(unix_s) + DELTA_T_S / 86_400.0 - J2000) / DAYS_A_CENTURY;
    let Ecliptic {
        nutation_deg,
        obliquity_deg,
    } = ecliptic(t);
    let [longitude_deg, latitude_deg, distance_m] = geocentric(t);
    let (l, b) = ((longitude_deg + nutation_deg).to_radians(), latitude_deg.to_radians());
    let (tilt, upright) = obliquity_deg.to_radians().sin_cos();
    let moon = [
        distance_m * b.cos() * l.cos(),
        distance_m * (b.cos() * l.sin() * upright - b.sin() * tilt),
        distance_m * (b.cos() * l.sin() * tilt + b.sin() * upright),
    ];
    // The place on the ellipsoid (chapter 11).
    let sidereal = sidereal_rad(unix_s, domain.longitude_deg);
    let latitude = domain.latitude_deg.to_radians();
    let reduced = (EARTH_POLE_SHARE * latitude.tan()).atan();
    let height_m = domain.surface_altitude_m;
    let axis_m = EARTH_EQUATOR_M * reduced.cos() + height_m * latitude.cos();
    let place = [
        axis_m * sidereal.cos(),
        axis_m * sidereal.sin(),
        EARTH_EQUATOR_M * EARTH_POLE_SHARE * reduced.sin() + height_m * latitude.sin(),
    ];
    let away = [0, 1, 2].map(|a| moon[a] - place[a]);
    let (s, c) = sidereal.sin_cos();
    let outwards = away[0] * c + away[1] * s;
    let east = away[1] * c - away[0] * s;
    let north = away[2] * latitude.cos() - outwards * latitude.sin();
    let up = away[2] * latitude.sin() + outwards * latitude.cos();
    let distance_m = (east * east + north * north + up * up).sqrt();
    Moon {
        elevation_deg: (up / distance_m).asin().to_degrees(),
        azimuth_deg: east.atan2(north).to_degrees().rem_euclid(360.0),
        distance_m,
    }
}

/// The scene's moon at a time; none where the scene has no moon.
pub fn of_scene(scene: &Scene, unix_s: f64) -> Option<Moon> {
    scene.effects.moon.as_ref().map(|moon| match moon {
        scene::Moon::Clock {} => by_clock(&scene.domain, unix_s),
        scene::Moon::Fixed {
            elevation_deg,
            azimuth_deg,
        } => Moon {
            elevation_deg: *elevation_deg,
            azimuth_deg: *azimuth_deg,
            distance_m: MOON_MEAN_DISTANCE_M,
        },
    })
}

/// Unit vector towards it: x east, y north, z up.
pub fn direction(moon: &Moon) -> [f32; 3] {
    sun::direction([moon.elevation_deg, moon.azimuth_deg])
}

/// Unix seconds of a scene's start; 2000-01-01T12:00Z where its time cannot be read, which validation rules out.
pub fn start_unix_s(scene: &Scene) -> f64 {
    parse_utc(&scene.time.start_utc).unwrap_or((J2000 - JULIAN_DATE_OF_UNIX_EPOCH) * 86_400.0)
}

/// Julian years from 2000 to a scene's start, to the tenth: where precession has brought the stars.
pub fn years_since_2000(scene: &Scene) -> f32 {
    let days = julian_date(start_unix_s(scene)) - J2000;
    ((days / 36.525).round() / 10.0) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn domain(latitude_deg: f64, longitude_deg: f64) -> Domain {
        Domain {
            cells: [1, 1, 2],
            cell_size_m: [1.0; 3],
            latitude_deg,
            longitude_deg,
            surface_altitude_m: 0.0,
            ground: Default::default(),
        }
    }
    fn unix_s(utc: &str) -> f64 {
        parse_utc(utc).unwrap()
    }
    fn towards(elevation_deg: f64, azimuth_deg: f64) -> [f64; 3] {
        sun::direction([elevation_deg, azimuth_deg]).map(f64::from)
    }
    /// Degrees between the scene's sun and moon.
    fn apart_deg(place: &Domain, utc: &str) -> f64 {
        let moon = by_clock(place, unix_s(utc));
        let [elevation, azimuth] = sun::position_deg(&scene::Sun::Clock, place, unix_s(utc));
        let (a, b) = (
            towards(moon.elevation_deg, moon.azimuth_deg),
            towards(elevation, azimuth),
        );
        let chord = [0, 1, 2].map(|i| (a[i] - b[i]).powi(2)).iter().sum::<f64>().sqrt();
        2.0 * (0.5 * chord).asin().to_degrees()
    }

    /// Meeus, example 47.a: 1992 April 12, 0h dynamical time.
    #[test]
    fn the_moon_of_meeus() {
        let t = (2_448_724.5 - J2000) / DAYS_A_CENTURY;
        let [longitude, latitude, distance] = geocentric(t);
        // The terms that are left out are at most 0.003 degrees each, a dozen of them of that size.
        assert!((longitude - 133.162_655).abs() < 0.01, "{longitude}");
        assert!((latitude + 3.229_126).abs() < 0.01, "{latitude}");
        assert!((distance - 368_409_700.0).abs() < 40_000.0, "{distance}");
        let tilt = ecliptic(t);
        assert!((tilt.nutation_deg - 0.004_610).abs() < 2e-4);
        assert!((tilt.obliquity_deg - 23.440_636).abs() < 2e-4);
    }

    /// Meeus, examples 12.a and 12.b: 1987 April 10, 0h and 19h21m at Greenwich.
    #[test]
    fn sidereal_time_of_meeus() {
        let apparent = sidereal_rad(unix_s("1987-04-10T00:00:00Z"), 0.0).to_degrees();
        assert!((apparent - 197.692_230).abs() < 1e-4, "{apparent}");
        let mean = sidereal_rad(unix_s("1987-04-10T19:21:00Z"), 0.0).to_degrees();
        assert!((mean - 128.737_873_4).abs() < 0.002, "{mean}");
    }

    /// The total eclipse of 2024 April 8 was greatest at 18:17:20 UT at 25.29 north, 104.14 west (NASA's eclipse catalogue), with the moon 1.0566
    /// times as wide as the sun: parallax of a degree and the time of both must be right.
    #[test]
    fn the_moon_covers_the_sun_of_2024() {
        let place = domain(25.29, -104.14);
        let apart = apart_deg(&place, "2024-04-08T18:17:20Z");
        assert!(apart < 0.02, "{apart} degrees apart");
        let moon = by_clock(&place, unix_s("2024-04-08T18:17:20Z"));
        let width = (1_737_400.0 / moon.distance_m) / (0.266_56 / 1.001_4_f64).to_radians();
        assert!((width - 1.056_6).abs() < 0.004, "{width}");
        // An hour before and after the disc does not touch the sun's middle.
        assert!(apart_deg(&place, "2024-04-08T17:17:20Z") > 0.3);
    }

    /// The total lunar eclipse of 2025 March 14 was greatest at 06:58:43 UT with the shadow's axis 0.3485 Earth radii off the moon's centre, and the moon in the
    /// zenith of 3 degrees north, 102 west (NASA).
    #[test]
    fn the_moon_of_march_2025_is_full() {
        let place = domain(3.0, -102.0);
        let utc = "2025-03-14T06:58:43Z";
        let moon = by_clock(&place, unix_s(utc));
        assert!(moon.elevation_deg > 88.0, "{moon:?}");
        let from_opposite = 180.0 - apart_deg(&place, utc);
        assert!(from_opposite < 1.5, "{from_opposite}");
    }

    #[test]
    fn the_pole_stands_as_high_as_the_latitude() {
        let rows = equatorial_from_world(1.234, 48.0);
        let (north, up) = (48f32.to_radians().cos(), 48f32.to_radians().sin());
        assert!((rows[2][1] - north).abs() < 1e-6 && (rows[2][2] - up).abs() < 1e-6);
        // What culminates in the south has the sidereal time as its right ascension.
        let south_high = [0.0, -up, north];
        let [x, y, z] = rows.map(|r| (0..3).map(|a| r[a] * south_high[a]).sum::<f32>());
        assert!((y.atan2(x) - 1.234).abs() < 1e-5 && z.abs() < 1e-6);
    }
}
