//! `sample`: the air at places or along a path, as a table or as JSON, once or again and again.

use clap::Args;
use welkin_client::ClientError;
use welkin_client::sample::{Samples, sample as ask};
use welkin_proto::ApiError;
use welkin_proto::sample::{SampleAnswer, SampleRequest};

use super::{Failure, print_line};

/// See the module.
#[derive(Args)]
pub struct Sample {
    /// The server, such as http://127.0.0.1:8080.
    url: String,
    /// The world's id; otherwise the server's first.
    #[arg(long, value_name = "ID")]
    world: Option<String>,
    /// A place: metres east, north and up from the box's south-west corner on the ground. May be given again.
    #[arg(long = "at", value_name = "X,Y,Z", value_parser = place, allow_hyphen_values = true, required_unless_present = "at_degrees")]
    at: Vec<[f64; 3]>,
    /// A place: latitude and longitude in degrees, altitude above mean sea level in metres. May be given again.
    #[arg(long = "at-degrees", value_name = "LAT,LON,ALT", value_parser = place, allow_hyphen_values = true, conflicts_with = "at")]
    at_degrees: Vec<[f64; 3]>,
    /// The places are the corners of a path, which is sampled every so many metres.
    #[arg(long, value_name = "METRES")]
    step: Option<f64>,
    /// Channels, with commas between; all that the scene has.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    channels: Option<Vec<String>>,
    /// The weather of this tick, if the server still keeps it.
    #[arg(long, value_name = "N", conflicts_with = "second")]
    tick: Option<u64>,
    /// The weather of this simulated second, if the server still keeps it.
    #[arg(long, value_name = "SECONDS")]
    second: Option<f64>,
    /// Ask so many times a second until interrupted, and print a line an answer and place.
    #[arg(long, value_name = "HZ", conflicts_with_all = ["step", "tick", "second", "at_degrees"])]
    rate: Option<f64>,
    /// Print the answer as JSON.
    #[arg(long, conflicts_with = "rate")]
    json: bool,
}

fn place(text: &str) -> Result<[f64; 3], String> {
    let numbers = text
        .split(',')
        .map(|n| n.trim().parse::<f64>().ok().filter(|n| n.is_finite()));
    let numbers: Option<Vec<f64>> = numbers.collect();
    let place = numbers.and_then(|n| <[f64; 3]>::try_from(n).ok());
    place.ok_or_else(|| "a place is three numbers with commas between".to_owned())
}

/// Runs the command. Errors: those of the library, and of standard output.
pub async fn sample(arguments: &Sample) -> Result<(), Failure> {
    if let Some(rate_hz) = arguments.rate {
        return follow(arguments, rate_hz).await;
    }
    let local = !arguments.at.is_empty();
    let request = SampleRequest {
        positions_m: local.then(|| arguments.at.clone()),
        positions_lat_lon_alt: (!local).then(|| arguments.at_degrees.clone()),
        step_m: arguments.step,
        channels: arguments.channels.clone(),
        tick: arguments.tick,
        simulated_s: arguments.second,
    };
    let answer = ask(&arguments.url, arguments.world.as_deref(), &request).await?;
    if arguments.json {
        let text = serde_json::to_string(&answer).map_err(|e| ClientError::BadMessage(e.to_string()))?;
        return print_line(&text).map(drop);
    }
    let places = answer.positions_m.as_deref();
    let places = places.unwrap_or(if local { &arguments.at } else { &arguments.at_degrees });
    for line in table(&answer, places) {
        if !print_line(&line)? {
            break;
        }
    }
    Ok(())
}

/// A line on the moment, then a line a channel with a value a place.
fn table(answer: &SampleAnswer, places: &[[f64; 3]]) -> Vec<String> {
    let moment = &answer.moment;
    let head = format!(
        "world {}, tick {}, {} ({} s simulated)",
        answer.world, moment.tick, moment.utc, moment.simulated_s
    );
    let column = |text: String| format!("{text:>26}");
    let at = places.iter().map(|[a, b, c]| column(format!("{a:.6},{b:.6},{c:.1}")));
    let mut lines = vec![head, format!("{:36}{}", "", at.collect::<String>())];
    for (name, values) in &answer.values {
        let unit = answer.units.get(name).map_or("", String::as_str);
        let shown = values
            .iter()
            .map(|v| column(v.map_or("outside".to_owned(), |v| v.to_string())));
        lines.push(format!(
            "{:36}{}",
            format!("{name} ({unit})"),
            shown.collect::<String>()
        ));
    }
    let missing = answer.unavailable.values().map(|why| format!("not there: {why}"));
    lines.into_iter().chain(missing).collect()
}

async fn follow(arguments: &Sample, rate_hz: f64) -> Result<(), Failure> {
    let names: Vec<&str> = arguments.channels.iter().flatten().map(String::as_str).collect();
    let mut samples = Samples::connect(&arguments.url, arguments.world.as_deref()).await?;
    samples.place(0, arguments.at.clone()).await?;
    samples.subscribe(&names, rate_hz).await?;
    loop {
        let answer = tokio::select! {
            answer = samples.next() => answer,
            _ = tokio::signal::ctrl_c() => return Ok(()),
        };
        let answer = match answer {
            // The world may be between two devices; the server goes on answering.
            Err(ClientError::Refused(ApiError { code, message, .. })) if code == "weather_unavailable" => {
                eprintln!("welkin-client: {message}");
                continue;
            }
            answer => answer?,
        };
        for (i, [x, y, z]) in arguments.at.iter().enumerate() {
            let value = |(q, column): (&welkin_proto::sample::Quantity, &Vec<f32>)| {
                format!(" {} {}", q.name(), column.get(i).copied().unwrap_or(f32::NAN))
            };
            let values: String = answer.quantities.iter().zip(&answer.columns).map(value).collect();
            if !print_line(&format!("{:.1} s | {x},{y},{z} |{values}", answer.simulated_s))? {
                return Ok(());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::place;

    #[test]
    fn places_are_read_or_refused() {
        assert_eq!(place("1, -2.5,3e2"), Ok([1.0, -2.5, 300.0]));
        for text in ["", "1,2", "1,2,3,4", "1,2,x", "NaN,1,2", "inf,1,2"] {
            assert!(place(text).is_err(), "{text} was taken");
        }
    }
}
