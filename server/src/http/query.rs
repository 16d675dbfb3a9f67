//! Reading a query's parameters; pointers name the parameter.

use std::str::FromStr;

use welkin_proto::ApiError;

/// A finite number; `bad_parameter`.
pub fn number(name: &str, value: &str) -> Result<f64, ApiError> {
    match f64::from_str(value) {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(invalid(name, value, "a finite number")),
    }
}

/// The refusal of a value, `bad_parameter`: `wanted` says what it must be.
pub fn invalid(name: &str, value: &str, wanted: &str) -> ApiError {
    let value: String = value.chars().take(40).collect();
    ApiError::new("bad_parameter", format!("{name} is {value:?}; it must be {wanted}")).at(format!("/{name}"))
}

/// The refusal of a parameter that a route does not know, `unknown_parameter`.
pub fn unknown(name: &str) -> ApiError {
    let message = format!("there is no parameter {name:?}; see /v1/openapi.json");
    ApiError::new("unknown_parameter", message).at(format!("/{}", escape(name)))
}

/// A name as a part of a JSON pointer (RFC 6901).
fn escape(name: &str) -> String {
    name.chars()
        .take(40)
        .collect::<String>()
        .replace('~', "~0")
        .replace('/', "~1")
}
