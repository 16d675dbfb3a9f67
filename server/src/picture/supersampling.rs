//! Four rays a pixel to one pixel.

use std::sync::LazyLock;

use rayon::prelude::*;

/// Steps of light from black to white that are told apart on the way back to bytes; the darkest byte is 15 of them wide.
const STEPS: usize = 50_000;

/// Light of each sRGB byte, 0 to 1 (IEC 61966-2-1).
static LIGHT: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|byte| {
        let value = byte as f32 / 255.0;
        if value <= 0.040_45 {
            value / 12.92
        } else {
            ((value + 0.055) / 1.055).powf(2.4)
        }
    })
});

/// The sRGB byte of each step of light.
static BYTES: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..=STEPS)
        .map(|step| {
            let light = step as f32 / STEPS as f32;
            let value = if light <= 0.003_130_8 {
                light * 12.92
            } else {
                1.055 * light.powf(1.0 / 2.4) - 0.055
            };
            (value * 255.0).round() as u8
        })
        .collect()
});

/// The mean of each two by two pixels, as light: a bright edge keeps its share. `size` is that of the result; `rgb8` is twice as wide and as
/// high, three bytes a pixel.
pub fn mean_of_four(rgb8: &[u8], size: [usize; 2]) -> Vec<u8> {
    let row = size[0] * 3;
    let mut out = vec![0; row * size[1]];
    if row == 0 {
        return out;
    }
    let (light, bytes) = (&*LIGHT, &*BYTES);
    out.par_chunks_exact_mut(row)
        .zip(rgb8.par_chunks_exact(4 * row))
        .for_each(|(out, two_rows)| {
            let (upper, lower) = two_rows.split_at(2 * row);
            let quads = upper.chunks_exact(6).zip(lower.chunks_exact(6));
            for (pixel, (u, l)) in out.chunks_exact_mut(3).zip(quads) {
                for (c, byte) in pixel.iter_mut().enumerate() {
                    let sum: f32 = [u[c], u[c + 3], l[c], l[c + 3]]
                        .iter()
                        .map(|b| light[*b as usize])
                        .sum();
                    *byte = bytes[(sum * (0.25 * STEPS as f32) + 0.5) as usize];
                }
            }
        });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_areas_stay_as_they_are() {
        for byte in 0..=255 {
            assert_eq!(mean_of_four(&[byte; 4 * 3], [1, 1]), [byte; 3]);
        }
    }

    #[test]
    fn half_black_and_half_white_is_half_the_light() {
        // Two pixels of the result: the left one has a white column beside a black one, the right one is red above and blue below.
        let upper = [255, 255, 255, 0, 0, 0, 255, 0, 0, 255, 0, 0];
        let lower = [255, 255, 255, 0, 0, 0, 0, 0, 255, 0, 0, 255];
        // Half the light of white is sRGB 188, not 128.
        assert_eq!(
            mean_of_four(&[upper, lower].concat(), [2, 1]),
            [188, 188, 188, 188, 0, 188]
        );
    }
}
