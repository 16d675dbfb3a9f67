//! Ranges of what a viewer may ask for.

use welkin_proto::ApiError;

use crate::limits::Limits;

/// `out_of_range` at `pointer` unless `low <= value <= high`; NaN is refused too.
pub fn in_range(value: f64, low: f64, high: f64, pointer: &str) -> Result<(), ApiError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ApiError::new(
        "out_of_range",
        format!("{value} is out of range; allowed is {low} to {high}"),
    )
    .at(pointer))
}

/// Refuses a frame that is empty or larger than the limits; pointers `/width`, `/height`.
pub fn size(width: u32, height: u32, limits: &Limits) -> Result<(), ApiError> {
    in_range(width.into(), 1.0, limits.width_max.into(), "/width")?;
    in_range(height.into(), 1.0, limits.height_max.into(), "/height")
}
