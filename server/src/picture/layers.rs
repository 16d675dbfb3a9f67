//! Layers of a picture as bytes: where the cloud is, and what lies before a client's objects.

use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use welkin_proto::ApiError;
use welkin_shaders::cpu::view::layers::{Layer, rgba8};

/// The distance in a 16-bit depth image where there is no cloud.
const NOWHERE: u16 = u16::MAX;
/// Cloud less opaque than this is none: a step of the 16-bit image.
const OPACITY_LEAST: f32 = 1.0 / 65_535.0;

/// Where the cloud is: PNG of two channels of 16 bits (mean distance in metres, 65535 where there is none; opacity, 65535 is opaque), or as `raw` two little-endian
/// 32-bit floats a pixel (the distance in metres, infinite where there is none; opacity from 0 to 1). Errors: `internal`.
pub fn depth(layers: &[Layer], [width, height]: [u32; 2], raw: bool) -> Result<Vec<u8>, ApiError> {
    let place = |layer: &Layer| {
        let [.., distance_m, opacity] = *layer;
        (opacity >= OPACITY_LEAST).then_some((distance_m, opacity))
    };
    if raw {
        let both = layers.iter().map(|layer| place(layer).unwrap_or((f32::INFINITY, 0.0)));
        return Ok(both
            .flat_map(|(distance_m, opacity)| [distance_m.to_le_bytes(), opacity.to_le_bytes()].concat())
            .collect());
    }
    // PNG has the high byte first; the encoder takes the machine's order.
    let bytes: Vec<u8> = layers
        .iter()
        .flat_map(|layer| {
            let (metres, opacity) = match place(layer) {
                Some((distance_m, opacity)) => (
                    distance_m.round().min(f32::from(NOWHERE - 1)) as u16,
                    (opacity * 65_535.0).round() as u16,
                ),
                None => (NOWHERE, 0),
            };
            [metres.to_ne_bytes(), opacity.to_ne_bytes()].concat()
        })
        .collect();
    png(&bytes, [width, height], image::ExtendedColorType::La16)
}

/// What lies before objects: PNG of RGBA, or as `raw` four little-endian 32-bit floats a pixel (exposed linear light, 1 is white before the tone map; one less the
/// share of the objects' light that passes). Light is premultiplied. Errors: `internal`.
pub fn before(layers: &[Layer], [width, height]: [u32; 2], raw: bool) -> Result<Vec<u8>, ApiError> {
    if raw {
        let numbers = layers
            .iter()
            .flat_map(|&[red, green, blue, through, ..]| [red, green, blue, 1.0 - through]);
        return Ok(numbers.flat_map(f32::to_le_bytes).collect());
    }
    png(
        &rgba8(layers, width as usize),
        [width, height],
        image::ExtendedColorType::Rgba8,
    )
}

fn png(bytes: &[u8], [width, height]: [u32; 2], colour: image::ExtendedColorType) -> Result<Vec<u8>, ApiError> {
    let mut coded = Vec::new();
    PngEncoder::new_with_quality(&mut coded, CompressionType::Fast, FilterType::Adaptive)
        .write_image(bytes, width, height, colour)
        .map_err(|e| ApiError::new("internal", format!("the picture could not be coded: {e}")))?;
    Ok(coded)
}
