//! Numbers to codes and back.
//!
//! A code `c` stands for `offset + c * scale` (linear) or `offset + (c * scale)^2` (square: finer where values are small, as extinction and
//! water want it). Both are computed in double precision and then rounded to single. Scale and offset follow from the smallest and
//! largest value alone and lie on a coarse ladder, so that they stay as they are while a field changes a little; the same field gives the same codes whoever
//! encodes it, and whenever.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Bits a code.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "u8", into = "u8")]
#[schemars(with = "u8")]
pub enum Bits {
    /// 256 codes.
    #[default]
    Eight,
    /// 65536 codes.
    Sixteen,
}

impl Bits {
    /// The largest code.
    pub fn code_max(self) -> u16 {
        match self {
            Self::Eight => u8::MAX.into(),
            Self::Sixteen => u16::MAX,
        }
    }

    /// Bytes a code.
    pub fn bytes(self) -> usize {
        match self {
            Self::Eight => 1,
            Self::Sixteen => 2,
        }
    }
}

impl TryFrom<u8> for Bits {
    type Error = String;

    fn try_from(bits: u8) -> Result<Self, String> {
        match bits {
            8 => Ok(Self::Eight),
            16 => Ok(Self::Sixteen),
            other => Err(format!("{other} bits a code are not to be had; 8 and 16 are")),
        }
    }
}

impl From<Bits> for u8 {
    fn from(bits: Bits) -> u8 {
        match bits {
            Bits::Eight => 8,
            Bits::Sixteen => 16,
        }
    }
}

/// How codes follow values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Curve {
    /// Evenly.
    Linear,
    /// By the square root; for what is never negative and mostly zero. The offset is 0.
    Square,
}

/// See the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantiser {
    /// Bits a code.
    pub bits: Bits,
    /// How codes follow values.
    pub curve: Curve,
    /// What code 0 stands for.
    pub offset: f64,
    /// Step from code to code: of the value, or of its square root.
    pub scale: f64,
}

/// The smallest of 1, 1.25, 1.5, 1.75 times a power of two that is not below `value`; 0 for 0 and for what is too small to matter.
fn ladder_up(value: f64) -> f64 {
    if !(value.is_finite() && value > 1e-300) {
        return 0.0;
    }
    // The value with its fraction cut off.
    let power = f64::from_bits(value.to_bits() & !((1 << 52) - 1));
    [1.0, 1.25, 1.5, 1.75, 2.0]
        .into_iter()
        .map(|m| m * power)
        .find(|v| *v >= value)
        .unwrap_or(2.0 * power)
}

impl Quantiser {
    /// For values from `low` to `high`. What is not finite counts as 0.
    pub fn for_range(curve: Curve, bits: Bits, low: f32, high: f32) -> Self {
        let tame = |v: f32| if v.is_finite() { f64::from(v) } else { 0.0 };
        let (low, high) = (tame(low), tame(high).max(tame(low)));
        let codes = f64::from(bits.code_max());
        match curve {
            Curve::Square => Self {
                bits,
                curve,
                offset: 0.0,
                scale: ladder_up(high.max(0.0).sqrt() / codes),
            },
            Curve::Linear => {
                // The offset moves in strides of a sixteenth of the codes, which the scale leaves room for.
                let stride = (codes + 1.0) / 16.0;
                let scale = ladder_up((high - low) / (codes - stride));
                let offset = if scale > 0.0 {
                    (low / (stride * scale)).floor() * stride * scale
                } else {
                    low
                };
                Self {
                    bits,
                    curve,
                    offset,
                    scale,
                }
            }
        }
    }

    /// The code of a value; values out of range get the nearest code.
    pub fn code(&self, value: f32) -> u16 {
        let from_offset = f64::from(value) - self.offset;
        if self.scale == 0.0 {
            return 0;
        }
        let steps = match self.curve {
            Curve::Linear => from_offset / self.scale,
            Curve::Square => from_offset.max(0.0).sqrt() / self.scale,
        };
        // Conversion cuts off, bounds, and takes what is no number as 0.
        ((steps + 0.5).min(f64::from(self.bits.code_max()))) as u16
    }

    /// The codes of values.
    pub fn codes(&self, values: &[f32], codes: &mut Vec<u16>) {
        codes.clear();
        match self.curve {
            // Most of a sky is clear: its zeros cost no root.
            Curve::Square => codes.extend(values.iter().map(|v| if *v == 0.0 { 0 } else { self.code(*v) })),
            Curve::Linear => codes.extend(values.iter().map(|v| self.code(*v))),
        }
    }

    /// What a code stands for.
    pub fn value(&self, code: u16) -> f32 {
        let step = f64::from(code) * self.scale;
        (match self.curve {
            Curve::Linear => self.offset + step,
            Curve::Square => self.offset + step * step,
        }) as f32
    }

    /// Largest difference between a value in range and what its code stands for, apart from the rounding to single precision: half a step, or with the
    /// square curve `scale * sqrt(value) + 0.75 * scale^2`.
    pub fn error_max(&self, value: f32) -> f64 {
        match self.curve {
            Curve::Linear => 0.5 * self.scale,
            Curve::Square => {
                let root = f64::from(value.max(0.0)).sqrt();
                self.scale * (root + 0.75 * self.scale)
            }
        }
    }
}
