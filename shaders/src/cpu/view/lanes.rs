//! Sixteen rays side by side: arithmetic on arrays of 16 floats, written so that the compiler turns it into SIMD of whatever
//! width the caller's `multiversion` target has.
//!
//! Only additions, multiplications, divisions and square roots are used, never a fused multiply-add, so every instruction
//! set gives the same bits. No closures: the compiler does not give them the caller's instruction set. `exp2` and `log2` are own polynomials for the same reason.

use std::ops::{Add, Div, Mul, Sub};

/// Rays in a packet.
pub const LANES: usize = 16;

/// One float of each ray in a packet.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub struct Lanes(pub [f32; LANES]);

/// One unsigned integer of each ray in a packet.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub struct Indices(pub [u32; LANES]);

macro_rules! operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Lanes {
            type Output = Lanes;
            #[inline(always)]
            fn $method(self, other: Lanes) -> Lanes {
                let mut r = self;
                for l in 0..LANES {
                    r.0[l] = self.0[l] $op other.0[l];
                }
                r
            }
        }
        impl $trait<f32> for Lanes {
            type Output = Lanes;
            #[inline(always)]
            fn $method(self, other: f32) -> Lanes {
                let mut r = self;
                for l in 0..LANES {
                    r.0[l] = self.0[l] $op other;
                }
                r
            }
        }
    };
}
operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);

/// Added to a float below 2^22 in size it leaves the rounded integer in the low mantissa bits.
const ROUNDING: f32 = 12_582_912.0;

impl Lanes {
    /// The same value in every lane.
    #[inline(always)]
    pub fn splat(value: f32) -> Lanes {
        Lanes([value; LANES])
    }
    /// A function of the lane's number.
    #[inline(always)]
    pub fn from_fn(mut f: impl FnMut(usize) -> f32) -> Lanes {
        let mut r = Lanes::splat(0.0);
        for l in 0..LANES {
            r.0[l] = f(l);
        }
        r
    }
    /// The smaller one.
    #[inline(always)]
    pub fn min(self, other: Lanes) -> Lanes {
        Lanes::select_less(self, other, self, other)
    }
    /// The larger one.
    #[inline(always)]
    pub fn max(self, other: Lanes) -> Lanes {
        Lanes::select_less(other, self, self, other)
    }
    /// Not less than `low` and not more than `high`; `low` for NaN.
    #[inline(always)]
    pub fn clamp(self, low: f32, high: f32) -> Lanes {
        let mut r = self;
        for l in 0..LANES {
            let v = if self.0[l] > low { self.0[l] } else { low };
            r.0[l] = if v < high { v } else { high };
        }
        r
    }
    /// Square root; 0 for what is not positive.
    #[inline(always)]
    pub fn sqrt(self) -> Lanes {
        let mut r = self;
        for l in 0..LANES {
            r.0[l] = if self.0[l] > 0.0 { self.0[l] } else { 0.0 }.sqrt();
        }
        r
    }
    /// `x` where `a < b`, else `y`.
    #[inline(always)]
    pub fn select_less(a: Lanes, b: Lanes, x: Lanes, y: Lanes) -> Lanes {
        let mut r = y;
        for l in 0..LANES {
            r.0[l] = if a.0[l] < b.0[l] { x.0[l] } else { y.0[l] };
        }
        r
    }
    /// Whether any lane is above `bound`.
    #[inline(always)]
    pub fn any_above(self, bound: f32) -> bool {
        let mut any = false;
        for l in 0..LANES {
            any |= self.0[l] > bound;
        }
        any
    }
    /// The smallest lane.
    #[inline(always)]
    pub fn smallest(self) -> f32 {
        let mut r = self.0[0];
        for l in 1..LANES {
            r = if self.0[l] < r { self.0[l] } else { r };
        }
        r
    }
    /// `self` moved towards `other` by the share `t`.
    #[inline(always)]
    pub fn lerp(self, other: Lanes, t: Lanes) -> Lanes {
        self + (other - self) * t
    }
    /// Hermite step of values already scaled so that the ramp runs from 0 to 1.
    #[inline(always)]
    pub fn smoothstep(self) -> Lanes {
        let t = self.clamp(0.0, 1.0);
        t * t * (Lanes::splat(3.0) - t * 2.0)
    }
    /// The integer below (modulo 2^22, in the low bits) and the fraction, 0 to 1 inclusive, for sizes below 2^21.
    #[inline(always)]
    pub fn split(self) -> (Indices, Lanes) {
        let mut index = Indices([0; LANES]);
        let mut fraction = self;
        for l in 0..LANES {
            let rounded = (self.0[l] - 0.5) + ROUNDING;
            index.0[l] = rounded.to_bits() & 0x3f_ffff;
            fraction.0[l] = self.0[l] - (rounded - ROUNDING);
        }
        (index, fraction)
    }
    /// The fraction above the integer below, 0 to 1 inclusive.
    #[inline(always)]
    pub fn fraction(self) -> Lanes {
        let mut r = self;
        for l in 0..LANES {
            r.0[l] = self.0[l] - (((self.0[l] - 0.5) + ROUNDING) - ROUNDING);
        }
        r
    }
    /// 2 to the power of each lane, relative error below 3e-6 between -126 and 126; bounded beyond.
    #[inline(always)]
    pub fn exp2(self) -> Lanes {
        let mut r = self;
        for l in 0..LANES {
            r.0[l] = exp2(self.0[l]);
        }
        r
    }
    /// e to the power of each lane.
    #[inline(always)]
    pub fn exp(self) -> Lanes {
        (self * std::f32::consts::LOG2_E).exp2()
    }
    /// Each lane, not negative, to the power of `exponent`.
    #[inline(always)]
    pub fn powf(self, exponent: f32) -> Lanes {
        (self.log2() * exponent).exp2()
    }
    /// Logarithm to base 2 of positive numbers.
    #[inline(always)]
    pub fn log2(self) -> Lanes {
        let mut r = self;
        for l in 0..LANES {
            r.0[l] = log2(self.0[l]);
        }
        r
    }
}

impl Indices {
    /// `table[index]` of each lane; an index beyond the end takes the last entry. The table is not empty and has at most 2^31 entries, so that
    /// indices of 32 bits serve, which one instruction gathers by.
    #[inline(always)]
    pub fn gather(self, table: &[u32]) -> Indices {
        let mut r = self;
        let last = (table.len() - 1).min(i32::MAX as usize) as u32;
        let table = &table[..=last as usize];
        for l in 0..LANES {
            let at = if self.0[l] < last { self.0[l] } else { last };
            r.0[l] = table[at as usize];
        }
        r
    }
    /// `table[index]` of each lane; as [`Indices::gather`].
    #[inline(always)]
    pub fn gather_f32(self, table: &[f32]) -> Lanes {
        let mut r = Lanes::splat(0.0);
        let last = (table.len() - 1).min(i32::MAX as usize) as u32;
        let table = &table[..=last as usize];
        for l in 0..LANES {
            let at = if self.0[l] < last { self.0[l] } else { last };
            r.0[l] = table[at as usize];
        }
        r
    }
    /// Byte `index` of each lane as a float, of a table that holds four a word, the first in the low bits.
    #[inline(always)]
    pub fn gather_bytes(self, words: &[u32]) -> Lanes {
        let mut word = self;
        for l in 0..LANES {
            word.0[l] = self.0[l] >> 2;
        }
        let word = word.gather(words);
        let mut r = Lanes::splat(0.0);
        for l in 0..LANES {
            r.0[l] = ((word.0[l] >> ((self.0[l] & 3) * 8)) & 0xff) as i32 as f32;
        }
        r
    }
    /// Each index plus `offset`.
    #[inline(always)]
    pub fn plus(self, offset: u32) -> Indices {
        let mut r = self;
        for l in 0..LANES {
            r.0[l] = self.0[l].wrapping_add(offset);
        }
        r
    }
    /// The bits from `shift` on, `mask` wide, as a float.
    #[inline(always)]
    pub fn bits(self, shift: u32, mask: u32) -> Lanes {
        let mut r = Lanes::splat(0.0);
        for l in 0..LANES {
            r.0[l] = ((self.0[l] >> shift) & mask) as i32 as f32;
        }
        r
    }
}

/// 2^v without the C library: the integer part goes into the exponent, the rest through a polynomial fitted for 0 to 1.
#[inline(always)]
pub fn exp2(v: f32) -> f32 {
    let v = if v > -126.0 { v } else { -126.0 };
    let v = if v < 126.0 { v } else { 126.0 };
    let rounded = v + ROUNDING;
    let f = v - (rounded - ROUNDING);
    let exponent = (rounded.to_bits() as i32).wrapping_sub(0x4b40_0000).wrapping_add(127) << 23;
    // Taylor series of 2^f for f from -0.5 to 0.5.
    let p = 1.0
        + f * (std::f32::consts::LN_2
            + f * (0.240_226_5 + f * (0.055_504_11 + f * (0.009_618_129 + f * (0.001_333_356 + f * 0.000_154_035)))));
    f32::from_bits(exponent as u32) * p
}

/// log2 of a positive float, absolute error below 2e-6; about -126 for 0.
#[inline(always)]
pub fn log2(v: f32) -> f32 {
    let v = if v > f32::MIN_POSITIVE { v } else { f32::MIN_POSITIVE };
    let bits = v.to_bits() as i32;
    // Mantissa between 1/sqrt(2) and sqrt(2).
    let exponent = (bits.wrapping_sub(0x3f35_04f3)) >> 23;
    let m = f32::from_bits(bits.wrapping_sub(exponent << 23) as u32);
    // log2(m) = 2/ln2 * artanh((m-1)/(m+1)).
    let s = (m - 1.0) / (m + 1.0);
    let q = s * s;
    exponent as f32 + s * (2.885_39 + q * (0.961_796_7 + q * (0.577_078 + q * (0.412_198_6 + q * 0.320_6))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_and_log2_are_close_to_the_library() {
        for i in -1200..1200 {
            let x = i as f32 * 0.1;
            assert!((exp2(x) / x.exp2() - 1.0).abs() < 3e-6, "exp2({x})");
        }
        for i in 1..4000 {
            let x = i as f32 * 0.01;
            assert!((log2(x) - x.log2()).abs() < 3e-6, "log2({x}) {} {}", log2(x), x.log2());
        }
        assert!(exp2(f32::NAN).is_finite() && log2(0.0) < -125.0);
    }

    #[test]
    fn split_gives_the_integer_below_and_wraps() {
        let (index, fraction) = Lanes::from_fn(|l| l as f32 * 0.75 - 3.0).split();
        for l in 0..LANES {
            let x = l as f32 * 0.75 - 3.0;
            let whole = (index.0[l] << 10) as i32 >> 10;
            assert!((whole as f32 + fraction.0[l] - x).abs() < 1e-6);
            assert!((0.0..=1.0).contains(&fraction.0[l]));
            assert_eq!(index.0[l] & 63, whole.rem_euclid(64) as u32);
        }
    }
}
