//! Where a world's box stands on Earth: from latitude, longitude and altitude to the box's own metres and back.
//!
//! The scene's `domain.latitude_deg` and `longitude_deg` are the place of the **middle** of the box. Around it the Earth is taken as flat:
//! x = L_x / 2 + N cos(phi_0) (lambda - lambda_0), y = L_y / 2 + M (phi - phi_0), with the radii of curvature of the WGS 84 ellipsoid
//! along the parallel (N) and the meridian (M) at phi_0. Both ways are exact inverses, lines of latitude are lines of y. Distances
//! are true at the middle; 100 km north or south of it at 45 degrees an eastward distance is off by 1.6 %. Altitude is above mean sea level, z above
//! the ground, which is flat: z = altitude - surface altitude.

use crate::error::ApiError;
use crate::scene::Domain;

/// Equatorial radius of the WGS 84 ellipsoid, m.
const EQUATOR_RADIUS_M: f64 = 6_378_137.0;
/// Square of its eccentricity.
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_141_32e-3;
/// Beyond this distance from the middle, east, north or up, a flat Earth says nothing, m.
pub const REACH_M: f64 = 1.0e6;
/// Nearer to a pole than this, degrees, meridians meet within the box.
const POLE_DEG: f64 = 0.5;

/// See the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geography {
    /// Latitude and longitude of the middle, degrees.
    pub middle_deg: [f64; 2],
    /// Size of the box east, north and up, m.
    pub size_m: [f64; 3],
    /// Height of the ground above mean sea level, m.
    pub surface_altitude_m: f64,
    /// Metres in a degree of longitude and of latitude.
    metres_per_deg: [f64; 2],
}

impl Geography {
    /// Of a box whose ground lies at `surface_altitude_m` above mean sea level.
    pub fn new(domain: &Domain, surface_altitude_m: f64) -> Self {
        let latitude = domain.latitude_deg.to_radians();
        let flatter = 1.0 - ECCENTRICITY_SQUARED * latitude.sin().powi(2);
        let along_parallel_m = EQUATOR_RADIUS_M / flatter.sqrt();
        let along_meridian_m = along_parallel_m * (1.0 - ECCENTRICITY_SQUARED) / flatter;
        Self {
            middle_deg: [domain.latitude_deg, domain.longitude_deg],
            size_m: [0, 1, 2].map(|a| f64::from(domain.cells[a]) * domain.cell_size_m[a]),
            surface_altitude_m,
            metres_per_deg: [along_parallel_m * latitude.cos(), along_meridian_m].map(|m| m * 1f64.to_radians()),
        }
    }

    /// Metres east, north and up from the south-west corner on the ground, of latitude (degrees), longitude (degrees, any turn) and altitude above
    /// mean sea level (m).
    ///
    /// Errors: `out_of_range` for a latitude beyond a pole or what is not finite, `outside_domain` beyond [`REACH_M`], `no_geography` for a box at
    /// a pole. Pointers `/0`, `/1`, `/2`.
    pub fn local_m(&self, [latitude_deg, longitude_deg, altitude_m]: [f64; 3]) -> Result<[f64; 3], ApiError> {
        if 90.0 - self.middle_deg[0].abs() < POLE_DEG {
            let message = "the world stands at a pole, where longitude means nothing; use x_m, y_m, z_m";
            return Err(ApiError::new("no_geography", message));
        }
        let given = [latitude_deg, longitude_deg, altitude_m];
        for (place, (value, most)) in given.iter().zip([90.0, 1e6, f64::MAX]).enumerate() {
            if !(-most..=most).contains(value) {
                let message = format!("{value} is out of range; allowed is {} to {most}", -most);
                return Err(ApiError::new("out_of_range", message).at(format!("/{place}")));
            }
        }
        let east_deg = (longitude_deg - self.middle_deg[1] + 180.0).rem_euclid(360.0) - 180.0;
        let north_deg = latitude_deg - self.middle_deg[0];
        let local = [
            0.5 * self.size_m[0] + self.metres_per_deg[0] * east_deg,
            0.5 * self.size_m[1] + self.metres_per_deg[1] * north_deg,
            altitude_m - self.surface_altitude_m,
        ];
        for (place, axis) in [(0, 1), (1, 0), (2, 2)] {
            if local[axis].abs() > REACH_M {
                let message = format!(
                    "it is {:.0} km from the world's box, which is too far",
                    local[axis].abs() / 1e3
                );
                return Err(ApiError::new("outside_domain", message).at(format!("/{place}")));
            }
        }
        Ok(local)
    }

    /// Latitude, longitude (degrees, -180 to 180) and altitude above mean sea level (m) of local metres.
    pub fn latitude_longitude_altitude(&self, [x_m, y_m, z_m]: [f64; 3]) -> [f64; 3] {
        let longitude_deg = self.middle_deg[1] + (x_m - 0.5 * self.size_m[0]) / self.metres_per_deg[0];
        [
            self.middle_deg[0] + (y_m - 0.5 * self.size_m[1]) / self.metres_per_deg[1],
            if (-180.0..=180.0).contains(&longitude_deg) {
                longitude_deg
            } else {
                (longitude_deg + 180.0).rem_euclid(360.0) - 180.0
            },
            z_m + self.surface_altitude_m,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Ground;

    fn at(latitude_deg: f64, longitude_deg: f64) -> Geography {
        let domain = Domain {
            cells: [100, 50, 40],
            cell_size_m: [100.0, 100.0, 50.0],
            latitude_deg,
            longitude_deg,
            surface_altitude_m: 0.0,
            ground: Ground::Land,
        };
        Geography::new(&domain, 350.0)
    }

    #[test]
    fn the_middle_is_where_the_scene_says_and_a_degree_is_as_long_as_on_the_ellipsoid() {
        let geography = at(45.0, 10.0);
        assert_eq!(geography.local_m([45.0, 10.0, 350.0]), Ok([5000.0, 2500.0, 0.0]));
        // A degree at 45 N on WGS 84: 78,847 m of longitude; 111,132 m of latitude (the tables' rounding).
        let [x, y, z] = geography.local_m([46.0, 11.0, 1350.0]).expect("near");
        assert!((x - 5000.0 - 78_847.0).abs() < 1.0, "{x}");
        assert!((y - 2500.0 - 111_132.0).abs() < 1.0, "{y}");
        assert_eq!(z, 1000.0);
    }

    #[test]
    fn there_and_back_is_the_same_place_also_across_the_date_line() {
        for (latitude, longitude) in [(45.0, 10.0), (-60.0, 179.99), (0.0, -180.0), (89.0, 0.0)] {
            let geography = at(latitude, longitude);
            for place in [
                [0.0, 0.0, 0.0],
                [9_999.0, 4_321.0, 1_999.0],
                [-20_000.0, 30_000.0, 12.0],
            ] {
                let there = geography.latitude_longitude_altitude(place);
                assert!(there[1].abs() <= 180.0);
                let back = geography.local_m(there).expect("near");
                // 1e-14 of 180 degrees is 2e-7 m; sums of a few of those.
                (0..3).for_each(|a| assert!((back[a] - place[a]).abs() < 1e-5, "{place:?} {back:?}"));
            }
        }
    }

    #[test]
    fn far_places_poles_and_what_is_no_number_are_refused() {
        let geography = at(45.0, 10.0);
        for (place, code, pointer) in [
            ([90.5, 10.0, 0.0], "out_of_range", Some("/0")),
            ([f64::NAN, 10.0, 0.0], "out_of_range", Some("/0")),
            ([45.0, f64::INFINITY, 0.0], "out_of_range", Some("/1")),
            ([45.0, 10.0, f64::NEG_INFINITY], "out_of_range", Some("/2")),
            ([45.0, -170.0, 0.0], "outside_domain", Some("/1")),
            ([-45.0, 10.0, 0.0], "outside_domain", Some("/0")),
            ([45.0, 10.0, 1e9], "outside_domain", Some("/2")),
        ] {
            let error = geography.local_m(place).expect_err("refused");
            assert_eq!(
                (error.code.as_str(), error.pointer.as_deref()),
                (code, pointer),
                "{place:?}"
            );
        }
        assert_eq!(
            at(90.0, 0.0).local_m([90.0, 0.0, 0.0]).expect_err("a pole").code,
            "no_geography"
        );
    }
}
