//! What a server refuses: every limit in one place, each with a flag of its own.

use welkin_proto::validate;

use crate::weather;

/// Limits of one server. The defaults suit a small machine.
#[derive(Clone, Debug, clap::Args)]
pub struct Limits {
    /// Most worlds that run at once.
    #[arg(long = "max-worlds", value_name = "N", default_value_t = 4)]
    pub worlds_max: usize,
    /// Most open streams (WebSocket), over all worlds.
    #[arg(long = "max-streams", value_name = "N", default_value_t = 256)]
    pub streams_max: usize,
    /// Most frames that wait for the renderer at once, over all viewers.
    #[arg(long = "max-queued-frames", value_name = "N", default_value_t = 256)]
    pub queued_frames_max: usize,
    /// Share of the renderer's time that one viewer gets while others wait, 0.01 to 1; alone, a viewer gets all of it. Snapshots
    /// over plain HTTP count as one viewer together.
    #[arg(long = "viewer-share", value_name = "SHARE", default_value_t = 0.5, value_parser = share)]
    pub viewer_share: f64,
    /// Most `POST /v1/render` jobs that run at once.
    #[arg(long = "max-renders", value_name = "N", default_value_t = 1)]
    pub renders_max: usize,
    /// Wall seconds that a `POST /v1/render` job may take.
    #[arg(long = "render-time-limit", value_name = "SECONDS", default_value_t = 60.0)]
    pub render_time_max_s: f64,
    /// Most simulated seconds that a `POST /v1/render` job may ask for.
    #[arg(long = "max-render-simulated", value_name = "SECONDS", default_value_t = 86_400.0)]
    pub render_simulated_max_s: f64,
    /// Widest frame, pixels.
    #[arg(long = "max-width", value_name = "PIXELS", default_value_t = 3840)]
    pub width_max: u32,
    /// Highest frame, pixels.
    #[arg(long = "max-height", value_name = "PIXELS", default_value_t = 2160)]
    pub height_max: u32,
    /// Most pixels of a picture whose objects' distances are posted; each costs 28 bytes while it is drawn.
    #[arg(long = "max-object-pixels", value_name = "N", default_value_t = 1920 * 1080)]
    pub object_pixels_max: usize,
    /// Most frames a wall second on one stream.
    #[arg(long = "max-fps", value_name = "N", default_value_t = 60.0)]
    pub frames_per_s_max: f64,
    /// Most places in one request for samples, and of one client that has samples streamed.
    #[arg(long = "max-sample-points", value_name = "N", default_value_t = 10_000)]
    pub sample_points_max: usize,
    /// Most answers a wall second on one stream of samples.
    #[arg(long = "max-sample-rate", value_name = "HZ", default_value_t = 30.0)]
    pub sample_rate_max_hz: f64,
    /// Most values (parameters times cells or places times moments) in one answer of the weather service, OGC API EDR.
    #[arg(long = "max-edr-values", value_name = "N", default_value_t = 1_000_000)]
    pub edr_values_max: usize,
    /// Most requests that are sampled at once; others wait.
    #[arg(long = "max-samplings", value_name = "N", default_value_t = 2)]
    pub samplings_max: usize,
    /// Bytes of past weather that a world keeps while somebody asks for samples; the newest is always there.
    #[arg(long = "max-past-weather", value_name = "BYTES", default_value_t = weather::PAST_BYTES_MAX)]
    pub past_weather_bytes_max: usize,
    /// Wall seconds of past sky that a world keeps for those who look back; 0 keeps none.
    #[arg(long = "past-sky", value_name = "SECONDS", default_value_t = 180.0, value_parser = seconds)]
    pub past_sky_s: f64,
    /// Wall seconds from one kept moment of it to the next, at least.
    #[arg(long = "past-sky-every", value_name = "SECONDS", default_value_t = 1.0, value_parser = seconds)]
    pub past_sky_every_s: f64,
    /// Most bytes of past sky that one world keeps; the newest moment is always there.
    #[arg(long = "max-past-sky", value_name = "BYTES", default_value_t = 32 << 20)]
    pub past_sky_bytes_max: usize,
    /// Most values in a kept moment: larger worlds are kept at half, a quarter, ... of their resolution.
    #[arg(long = "max-past-sky-values", value_name = "N", default_value_t = 1 << 19)]
    pub past_sky_values_max: u64,
    /// Keeps the past of a world that nobody has looked at for as long as is kept, too.
    #[arg(long = "past-sky-unwatched")]
    pub past_sky_unwatched: bool,
    /// Largest request body, bytes; also the largest message to a stream of samples, which carries everybody's position.
    #[arg(long = "max-body", value_name = "BYTES", default_value_t = 1 << 20)]
    pub body_bytes_max: usize,
    /// Largest message from a stream's client, bytes.
    #[arg(long = "max-message", value_name = "BYTES", default_value_t = 64 << 10)]
    pub message_bytes_max: usize,
    /// Most different volume views that are followed at once, over all worlds.
    #[arg(long = "max-volume-views", value_name = "N", default_value_t = 64)]
    pub volume_views_max: usize,
    /// Most values in a volume, over all its channels; one costs some 10 bytes while the view is followed.
    #[arg(long = "max-volume-values", value_name = "N", default_value_t = 1 << 25)]
    pub volume_values_max: u64,
    /// Most volumes a wall second for one subscriber.
    #[arg(long = "max-volume-rate", value_name = "N", default_value_t = 60.0)]
    pub volume_rate_max_hz: f64,
    /// Most bytes of volumes a wall second for one subscriber.
    #[arg(long = "max-volume-bytes", value_name = "N", default_value_t = 2e7)]
    pub volume_bytes_per_s_max: f64,
    /// Wall seconds that a client may take to accept what it is sent, over HTTP or a stream, before it is dropped.
    #[arg(long = "stall-timeout", value_name = "SECONDS", default_value_t = 10.0)]
    pub stall_timeout_s: f64,
    /// Wall seconds after which a world that a visitor made and nobody has looked at since is stopped; 0 keeps it until it is
    /// deleted. An open stream looks on; listing worlds does not.
    #[arg(long = "idle-world-timeout", value_name = "SECONDS", default_value_t = 1800.0)]
    pub idle_world_s: f64,
    /// Lets pages of this origin, such as https://example.org, read what the server gives to read: documents, samples, volumes, pictures, the weather
    /// service. `*` lets any. May be given again. Without it only the server's own page may; none but that may ever command.
    #[arg(long = "cors-origin", value_name = "ORIGIN", value_parser = origin)]
    pub cors_origins: Vec<String>,
    /// Most cells in a world; a cell costs about 200 bytes.
    #[arg(long = "max-cells", value_name = "N", default_value_t = 256 * 256 * 256)]
    pub cells_max: u64,
}

/// Reads a share. Errors: in words.
fn share(text: &str) -> Result<f64, String> {
    let share: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if (0.01..=1.0).contains(&share) {
        return Ok(share);
    }
    Err("a share is 0.01 to 1".to_owned())
}

/// Reads an origin as browsers send it, or `*`. Errors: in words.
fn origin(text: &str) -> Result<String, String> {
    let wrong = || {
        "an origin is a scheme and a host, such as https://example.org or http://127.0.0.1:3000, without a path; or *"
            .to_owned()
    };
    if text == "*" {
        return Ok(text.to_owned());
    }
    let uri: axum::http::Uri = text.parse().map_err(|_| wrong())?;
    let bare = matches!(uri.scheme_str(), Some("http" | "https")) && uri.path() == "/" && !text.ends_with('/');
    match uri.authority() {
        Some(authority) if bare && !authority.as_str().contains('@') && uri.query().is_none() => {
            Ok(text.to_ascii_lowercase())
        }
        _ => Err(wrong()),
    }
}

/// Reads a time. Errors: in words.
fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if seconds.is_finite() && seconds >= 0.0 {
        return Ok(seconds);
    }
    Err("a time is a number of seconds, 0 or more".to_owned())
}

impl Limits {
    /// What a scene may ask for.
    pub fn scene(&self) -> validate::Limits {
        validate::Limits {
            max_cells: self.cells_max,
            max_scene_bytes: self.body_bytes_max,
            ..Default::default()
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        #[derive(clap::Parser)]
        struct Defaults {
            #[command(flatten)]
            limits: Limits,
        }
        // The flags' defaults are the defaults: written once, above.
        <Defaults as clap::Parser>::parse_from(["defaults"]).limits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_read_or_refused() {
        for good in ["*", "https://example.org", "http://127.0.0.1:3000", "http://[::1]:80"] {
            assert_eq!(origin(good).as_deref(), Ok(good));
        }
        assert_eq!(origin("HTTPS://Example.org").as_deref(), Ok("https://example.org"));
        for wrong in [
            "example.org",
            "https://",
            "https://example.org/",
            "https://example.org/page",
            "ftp://x",
            "https://a@b",
            "",
            "null",
        ] {
            assert!(origin(wrong).is_err(), "{wrong} was taken");
        }
    }
}
