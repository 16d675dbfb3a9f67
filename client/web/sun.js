// @ts-check
// Where the sun stands at a time and a place: the low-precision formulas of the Astronomical Almanac, within 0.02 degrees from 1950 to 2050, without refraction.

const RADIANS = Math.PI / 180;
/** Days from 1970-01-01T00:00Z to 2000-01-01T12:00Z. */
const J2000_DAYS = 10_957.5;

/**
 * Degrees above the horizon, and clockwise from north.
 * @param {number} unix_s
 * @param {number} latitude_deg
 * @param {number} longitude_deg
 */
export function sunPosition(unix_s, latitude_deg, longitude_deg) {
  const days = unix_s / 86_400 - J2000_DAYS;
  const anomaly = (357.529 + 0.98560028 * days) * RADIANS;
  const longitude = (280.459 + 0.98564736 * days + 1.915 * Math.sin(anomaly) + 0.02 * Math.sin(2 * anomaly)) * RADIANS;
  const obliquity = (23.439 - 0.00000036 * days) * RADIANS;
  const ascension = Math.atan2(Math.cos(obliquity) * Math.sin(longitude), Math.cos(longitude));
  const declination = Math.asin(Math.sin(obliquity) * Math.sin(longitude));
  const hour = (280.46061837 + 360.98564736629 * days + longitude_deg) * RADIANS - ascension;
  const latitude = latitude_deg * RADIANS;
  const sine = Math.sin(latitude) * Math.sin(declination) + Math.cos(latitude) * Math.cos(declination) * Math.cos(hour);
  const north = Math.tan(declination) * Math.cos(latitude) - Math.sin(latitude) * Math.cos(hour);
  const azimuth_deg = Math.atan2(-Math.sin(hour), north) / RADIANS;
  return { elevation_deg: Math.asin(sine) / RADIANS, azimuth_deg: (azimuth_deg + 360) % 360 };
}

/**
 * The time of a day, seconds since 1970, that is so many hours after that day's midnight in UTC.
 * @param {string} utc a time of that day, RFC 3339
 * @param {number} hours
 */
export function timeOfDay(utc, hours) {
  const midnight = Date.parse(`${utc.slice(0, 10)}T00:00:00Z`) / 1000;
  return midnight + 3600 * hours;
}
