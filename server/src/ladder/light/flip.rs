//! FLIP: how different two pictures look when they are shown in turn (Andersson et al. 2020, "FLIP: A Difference Evaluator for
//! Alternating Images"), written from the paper's formulas.
//!
//! Colours are filtered as the eye filters contrast at 67 pixels a degree, compared in a Lab space with Hunt's adjustment; edges and points that only one
//! picture has count besides. 0 is no difference, 1 the largest.

/// Pixels a degree: a monitor 0.7 m wide with 3840 pixels, seen from 0.7 m.
const PIXELS_PER_DEGREE: f64 = 67.02;
/// Contrast sensitivity of luminance, red-green, blue-yellow: two Gaussians each, `a` and `b`.
const SENSITIVITY: [[[f64; 2]; 2]; 3] = [
    [[1.0, 0.0047], [0.0, 1e-5]],
    [[1.0, 0.0053], [0.0, 1e-5]],
    [[34.1, 0.04], [13.5, 0.025]],
];
const COLOUR_EXPONENT: f64 = 0.7;
const BEND_AT: f64 = 0.4;
const BEND_TO: f64 = 0.95;
const FEATURE_WIDTH_DEG: f64 = 0.082;
const FEATURE_EXPONENT: f64 = 0.5;
/// White of sRGB, X, Y, Z.
const WHITE: [f64; 3] = [0.950_428_545, 1.0, 1.088_900_371];
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [0.412_390_799, 0.357_584_339, 0.180_480_788],
    [0.212_639_006, 0.715_168_679, 0.072_192_315],
    [0.019_330_819, 0.119_194_780, 0.950_532_152],
];
const RGB_FROM_XYZ: [[f64; 3]; 3] = [
    [3.240_969_942, -1.537_383_178, -0.498_610_760],
    [-0.969_243_636, 1.875_967_502, 0.041_555_057],
    [0.055_630_080, -0.203_976_959, 1.056_971_514],
];

fn times(m: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn linear(byte: u8) -> f64 {
    let v = f64::from(byte) / 255.0;
    if v <= 0.040_45 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

/// Luminance and two opponent colours, linear.
fn opponent(rgb: [f64; 3]) -> [f64; 3] {
    let xyz = times(&XYZ_FROM_RGB, rgb);
    let [x, y, z] = [0, 1, 2].map(|i| xyz[i] / WHITE[i]);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn from_opponent([l, red_green, blue_yellow]: [f64; 3]) -> [f64; 3] {
    let y = (l + 16.0) / 116.0;
    let xyz = [
        (y + red_green / 500.0) * WHITE[0],
        y * WHITE[1],
        (y - blue_yellow / 200.0) * WHITE[2],
    ];
    times(&RGB_FROM_XYZ, xyz)
}

/// Lab, the colours dimmed with the luminance (Hunt).
fn adjusted_lab(rgb: [f64; 3]) -> [f64; 3] {
    let xyz = times(&XYZ_FROM_RGB, rgb);
    let f = |v: f64| {
        const DELTA: f64 = 6.0 / 29.0;
        if v > DELTA.powi(3) {
            v.cbrt()
        } else {
            v / (3.0 * DELTA * DELTA) + 4.0 / 29.0
        }
    };
    let [x, y, z] = [0, 1, 2].map(|i| f(xyz[i] / WHITE[i]));
    let l = 116.0 * y - 16.0;
    [l, 0.01 * l * 500.0 * (x - y), 0.01 * l * 200.0 * (y - z)]
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).abs() + ((a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2)).sqrt()
}

/// Sums over a square of weights; what lies outside is the nearest pixel.
fn filtered(plane: &[f64], width: usize, kernel: &[f64], radius: i64) -> Vec<f64> {
    let height = plane.len() / width;
    let side = 2 * radius + 1;
    let bounded = |v: i64, n: usize| v.clamp(0, n as i64 - 1) as usize;
    let mut out = vec![0.0; plane.len()];
    for (n, to) in out.iter_mut().enumerate() {
        let (x, y) = ((n % width) as i64, (n / width) as i64);
        let mut sum = 0.0;
        for dy in -radius..=radius {
            let row = bounded(y + dy, height) * width;
            for dx in -radius..=radius {
                let weight = kernel[((dy + radius) * side + dx + radius) as usize];
                sum += weight * plane[row + bounded(x + dx, width)];
            }
        }
        *to = sum;
    }
    out
}

fn kernel(radius: i64, f: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    let span = -radius..=radius;
    span.clone()
        .flat_map(|y| span.clone().map(move |x| (x, y)))
        .map(|(x, y)| f(x as f64, y as f64))
        .collect()
}

/// Positive weights made to sum to 1, negative ones to -1.
fn balanced(mut kernel: Vec<f64>) -> Vec<f64> {
    let sum = |sign: f64| kernel.iter().map(|v| (sign * v).max(0.0)).sum::<f64>();
    let (up, down) = (sum(1.0), sum(-1.0));
    kernel.iter_mut().for_each(|v| *v /= if *v > 0.0 { up } else { down });
    kernel
}

struct Seen {
    lab: Vec<[f64; 3]>,
    edges: Vec<f64>,
    points: Vec<f64>,
}

fn seen(rgb8: &[u8], width: usize) -> Seen {
    let colours: Vec<[f64; 3]> = rgb8
        .chunks_exact(3)
        .map(|p| opponent([linear(p[0]), linear(p[1]), linear(p[2])]))
        .collect();
    let mut planes: Vec<Vec<f64>> = (0..3).map(|c| colours.iter().map(|p| p[c]).collect()).collect();
    let pi2 = std::f64::consts::PI.powi(2);
    // Features are those of the unfiltered luminance, scaled to 0 to 1.
    let luminance: Vec<f64> = planes[0].iter().map(|l| (l + 16.0) / 116.0).collect();
    let deviation = 0.5 * FEATURE_WIDTH_DEG * PIXELS_PER_DEGREE;
    let radius = (3.0 * deviation).ceil() as i64;
    let gauss = |x: f64, y: f64| (-(x * x + y * y) / (2.0 * deviation * deviation)).exp();
    let length = |weights: &dyn Fn(f64, f64) -> f64| {
        let along_x = filtered(&luminance, width, &balanced(kernel(radius, weights)), radius);
        let along_y = filtered(
            &luminance,
            width,
            &balanced(kernel(radius, |x, y| weights(y, x))),
            radius,
        );
        along_x
            .iter()
            .zip(&along_y)
            .map(|(a, b)| a.hypot(*b))
            .collect::<Vec<f64>>()
    };
    let edges = length(&|x, y| -x * gauss(x, y));
    let points = length(&|x, y| (x * x / (deviation * deviation) - 1.0) * gauss(x, y));
    let widest = SENSITIVITY.iter().flatten().map(|s| s[1]).fold(0.0, f64::max);
    let radius = (3.0 * (widest / (2.0 * pi2)).sqrt() * PIXELS_PER_DEGREE).ceil() as i64;
    for (plane, [first, second]) in planes.iter_mut().zip(SENSITIVITY) {
        let mut weights = kernel(radius, |x, y| {
            let squared = (x * x + y * y) / PIXELS_PER_DEGREE.powi(2);
            let part = |[a, b]: [f64; 2]| a * (std::f64::consts::PI / b).sqrt() * (-pi2 * squared / b).exp();
            part(first) + part(second)
        });
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|v| *v /= sum);
        *plane = filtered(plane, width, &weights, radius);
    }
    let lab = (0..colours.len())
        .map(|n| adjusted_lab(from_opponent([planes[0][n], planes[1][n], planes[2][n]]).map(|v| v.clamp(0.0, 1.0))))
        .collect();
    Seen { lab, edges, points }
}

/// Mean of FLIP over two pictures of the same size, RGB bytes of sRGB.
pub fn flip(ours: &[u8], truth: &[u8], width: usize) -> f64 {
    if ours.len() < 3 || ours.len() != truth.len() || width == 0 {
        return f64::NAN;
    }
    let (a, b) = (seen(ours, width), seen(truth, width));
    let largest = distance(adjusted_lab([0.0, 1.0, 0.0]), adjusted_lab([0.0, 0.0, 1.0])).powf(COLOUR_EXPONENT);
    let bend = BEND_AT * largest;
    let sum: f64 = (0..a.lab.len())
        .map(|n| {
            let colour = distance(a.lab[n], b.lab[n]).powf(COLOUR_EXPONENT);
            let colour = if colour < bend {
                BEND_TO / bend * colour
            } else {
                BEND_TO + (colour - bend) / (largest - bend) * (1.0 - BEND_TO)
            };
            let feature = (a.edges[n] - b.edges[n]).abs().max((a.points[n] - b.points[n]).abs());
            let feature = (feature * std::f64::consts::FRAC_1_SQRT_2).powf(FEATURE_EXPONENT);
            colour.clamp(0.0, 1.0).powf(1.0 - feature.min(1.0))
        })
        .sum();
    sum / a.lab.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(level: u8) -> Vec<u8> {
        vec![level; 3 * 24 * 18]
    }

    #[test]
    fn equal_pictures_differ_by_nothing_and_black_from_white_by_all() {
        assert_eq!(flip(&grey(90), &grey(90), 24), 0.0);
        let [slight, much] = [100, 255].map(|level| flip(&grey(0), &grey(level), 24));
        assert!(slight < much && much > 0.9 && much <= 1.0, "{slight} {much}");
        assert!((much - flip(&grey(255), &grey(0), 24)).abs() < 1e-12);
        assert!(flip(&grey(1), &[], 24).is_nan());
    }

    /// The same share of changed pixels: a line is seen, a slight tint all over hardly, and colours turn back into themselves.
    #[test]
    fn lines_count_where_they_are() {
        let mut line = grey(90);
        for y in 0..18 {
            line[3 * (y * 24 + 12)..][..3].fill(255);
        }
        let all = flip(&line, &grey(90), 24);
        assert!(all > 0.05 && all < 0.6, "{all}");
        let rgb = [0.2, 0.5, 0.9];
        let back = from_opponent(opponent(rgb));
        assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-6), "{back:?}");
    }
}
