//! Where the sun stands.

use solar_positioning::time::JulianDate;
use solar_positioning::{Location, SolarPositions};
use welkin_proto::scene::{Domain, Sun};

/// Julian date of 1970-01-01T00:00Z.
pub(crate) const JULIAN_DATE_OF_UNIX_EPOCH: f64 = 2_440_587.5;
/// Terrestrial time less universal time in these decades, s; an hour's worth of error would move the sun by 0.04 degrees.
pub(crate) const DELTA_T_S: f64 = 69.0;

/// Elevation and azimuth (clockwise from north), degrees.
///
/// By the clock: NREL's solar position algorithm, without refraction. Where that has no answer (a date far outside its
/// range), the sun stands at the zenith of an equinox noon; scenes are validated so that this does not happen.
pub fn position_deg(sun: &Sun, domain: &Domain, unix_s: f64) -> [f64; 2] {
    if let Sun::Fixed {
        elevation_deg,
        azimuth_deg,
    } = sun
    {
        return [*elevation_deg, *azimuth_deg];
    }
    let location = Location {
        latitude: domain.latitude_deg,
        longitude: domain.longitude_deg,
    };
    JulianDate::new(unix_s / 86_400.0 + JULIAN_DATE_OF_UNIX_EPOCH, DELTA_T_S)
        .and_then(|date| SolarPositions::new().at_from_julian(date, location, domain.surface_altitude_m, None))
        .map_or([90.0 - domain.latitude_deg.abs(), 180.0], |p| {
            [p.elevation_angle(), p.azimuth()]
        })
}

/// Unit vector towards the sun: x east, y north, z up.
pub fn direction([elevation_deg, azimuth_deg]: [f64; 2]) -> [f32; 3] {
    let (elevation, azimuth) = (elevation_deg.to_radians(), azimuth_deg.to_radians());
    [
        elevation.cos() * azimuth.sin(),
        elevation.cos() * azimuth.cos(),
        elevation.sin(),
    ]
    .map(|c| c as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solstice_noon_at_greenwich() {
        let domain = Domain {
            cells: [1, 1, 2],
            cell_size_m: [1.0; 3],
            latitude_deg: 51.48,
            longitude_deg: 0.0,
            surface_altitude_m: 0.0,
            ground: Default::default(),
        };
        // 2026-06-21T12:02Z: the sun culminates at 90 - 51.48 + 23.44 degrees.
        let [elevation, azimuth] = position_deg(&Sun::Clock, &domain, 1_782_043_320.0);
        assert!((elevation - 61.96).abs() < 0.05, "{elevation}");
        assert!((azimuth - 180.0).abs() < 1.0, "{azimuth}");
        let up = direction([90.0, 0.0]);
        assert!(up[2] > 0.999_999);
    }
}
