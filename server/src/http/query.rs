//! Reading a query's parameters; pointers name the parameter.

use std::str::FromStr;

use welkin_proto::ApiError;

use crate::sample::When;

/// A finite number; `bad_parameter`.
pub fn number(name: &str, value: &str) -> Result<f64, ApiError> {
    match f64::from_str(value) {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(invalid(name, value, "a finite number")),
    }
}

/// Which moment `tick` or `simulated_s` asks for, and the other parameters.
///
/// Errors: `bad_parameter` for what is no number, or for both.
pub fn moment(pairs: Vec<(String, String)>) -> Result<(When, Vec<(String, String)>), ApiError> {
    let (own, rest): (Vec<_>, Vec<_>) = pairs
        .into_iter()
        .partition(|(name, _)| ["tick", "simulated_s"].contains(&name.as_str()));
    let (mut tick, mut simulated_s) = (None, None);
    for (name, value) in &own {
        match name.as_str() {
            "tick" => tick = Some(u64::from_str(value).map_err(|_| invalid(name, value, "a whole number"))?),
            _ => simulated_s = Some(number(name, value)?),
        }
    }
    Ok((when(tick, simulated_s)?, rest))
}

/// The moment that is named in one of two ways, or now.
///
/// Errors: `bad_parameter` for both; `out_of_range` for a second that is none.
pub fn when(tick: Option<u64>, simulated_s: Option<f64>) -> Result<When, ApiError> {
    match (tick, simulated_s) {
        (None, None) => Ok(When::Now),
        (Some(tick), None) => Ok(When::Tick(tick)),
        (None, Some(second)) if second.is_finite() => Ok(When::Simulated(second)),
        (None, Some(second)) => Err(ApiError::new("out_of_range", format!("{second} is no time")).at("/simulated_s")),
        (Some(_), Some(_)) => {
            let message = "give `tick` or `simulated_s`, not both";
            Err(ApiError::new("bad_parameter", message).at("/simulated_s"))
        }
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
