// @ts-check
// What the kernels of the view are told that is neither the cloud nor the server's: where the camera looks, where the sun stands, which
// levels hold cloud. The twins are shaders/src/view.rs and `ViewFrame::new` in shaders/src/gpu/view.rs.

/** @import { Camera, Cloud, Lights, Scenery } from "./types.js" */
/** @import { Kernels } from "./kernels.js" */

const RADIANS = Math.PI / 180;

/** @param {number} value @param {number} low @param {number} high */
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** @param {number[]} v */
function unit(v) {
  const length = Math.hypot(...v);
  return length > 0 ? v.map((c) => c / length) : [0, 0, 1];
}

/**
 * Towards the sun: x east, y north, z up.
 * @param {number} elevation_deg
 * @param {number} azimuth_deg
 */
export function sunDirection(elevation_deg, azimuth_deg) {
  const [e, a] = [elevation_deg * RADIANS, azimuth_deg * RADIANS];
  return [Math.cos(e) * Math.sin(a), Math.cos(e) * Math.cos(a), Math.sin(e)];
}

/**
 * The sun as tables are made for it: the nearest of directions a twentieth of a degree apart.
 * @param {number[]} sun
 * @param {Kernels} kernels
 */
export function tableSun(sun, kernels) {
  const steps = kernels.constant("SUN_DIRECTIONS");
  return unit(unit(sun).map((c) => Math.round(Math.fround(c) * steps) / steps));
}

/**
 * The sun as it is marched to: never too low.
 * @param {number[]} sun
 * @param {Kernels} kernels
 */
export function marchedSun(sun, kernels) {
  const z = clamp(sun[2], kernels.constant("SUN_MARCHED_SINE_LEAST"), 1);
  const side = Math.hypot(sun[0], sun[1]);
  const scale = Math.sqrt(1 - z * z);
  return side > 1e-6 ? [(sun[0] / side) * scale, (sun[1] / side) * scale, z] : [scale, 0, z];
}

/**
 * The moon as a lamp: the twin is `MoonLook` in shaders/src/cpu/light/moon.rs. Null where there is none.
 * @param {Lights} lights
 * @param {Kernels} kernels
 */
export function moonLook({ sun, moon }, kernels) {
  if (moon === null) {
    return null;
  }
  /** @param {string} name */
  const k = (name) => kernels.constant(name);
  const [direction, towards] = [unit(moon.direction), unit(sun)];
  const along = direction[0] * towards[0] + direction[1] * towards[1] + direction[2] * towards[2];
  const phase_deg = Math.acos(clamp(-along, -1, 1)) / RADIANS;
  const fainter = k("MOON_PHASE_SLOPE") * phase_deg + k("MOON_PHASE_QUARTIC") * phase_deg ** 4;
  const full = k("MOON_FULL_IRRADIANCE") * 10 ** (-0.4 * fainter) * (k("MOON_LAW_DISTANCE_M") / moon.distance_m) ** 2;
  const redder = k("MAGNITUDE_LOG2") * (k("MOON_COLOUR_INDEX") - k("SUN_COLOUR_INDEX"));
  const risen = direction[2] > k("MOON_LIGHTS_FROM");
  const dark = clamp((k("MOON_BEAM_FROM") - towards[2]) / (k("MOON_BEAM_FROM") - k("MOON_BEAM_WHOLE")), 0, 1);
  return {
    direction,
    angular_radius: k("MOON_RADIUS_M") / moon.distance_m,
    irradiance: [full * 2 ** (k("STAR_RED_SLOPE") * redder), full, full * 2 ** -redder],
    beam_share: risen ? dark * dark * (3 - 2 * dark) : 0,
    lights_sky: risen && towards[2] < 0,
  };
}

/**
 * Towards what throws shadows: the sun, by night the moon.
 * @param {Lights} lights
 * @param {Kernels} kernels
 */
export function beamDirection(lights, kernels) {
  const moon = moonLook(lights, kernels);
  return moon !== null && moon.beam_share > 0 ? moon.direction : unit(lights.sun);
}

/**
 * Rows that turn a direction of the world into the equator's frame of date: the twin is `equatorial_from_world` in server/src/moon.rs.
 * @param {number} sidereal_deg
 * @param {number} latitude_deg
 */
function equatorialFromWorld(sidereal_deg, latitude_deg) {
  const [s, c] = [Math.sin(sidereal_deg * RADIANS), Math.cos(sidereal_deg * RADIANS)];
  const [up, north] = [Math.sin(latitude_deg * RADIANS), Math.cos(latitude_deg * RADIANS)];
  return [
    [-s, -up * c, north * c],
    [c, -up * s, north * s],
    [0, north, up],
  ];
}

/** Degrees that the sky of stars turns in a second. */
const TURN_DEG_PER_S = 360.985647 / 86_400;

/**
 * Moon and stars some seconds before: turned back about the pole together, the moon's own way (half a degree an hour) left out. Without stars no latitude is known, and
 * the moon stays.
 * @param {Lights} lights
 * @param {number} seconds
 * @param {number | null} latitude_deg
 * @returns {Lights}
 */
export function earlier(lights, seconds, latitude_deg) {
  const { moon, sidereal_deg } = lights;
  if (latitude_deg === null || sidereal_deg === null) {
    return lights;
  }
  const before_deg = sidereal_deg - seconds * TURN_DEG_PER_S;
  if (moon === null) {
    return { ...lights, sidereal_deg: before_deg };
  }
  const q = equatorialFromWorld(sidereal_deg, latitude_deg).map((row) => row[0] * moon.direction[0] + row[1] * moon.direction[1] + row[2] * moon.direction[2]);
  const back = equatorialFromWorld(before_deg, latitude_deg);
  const direction = [0, 1, 2].map((axis) => back[0][axis] * q[0] + back[1][axis] * q[1] + back[2][axis] * q[2]);
  return { ...lights, sidereal_deg: before_deg, moon: { ...moon, direction } };
}

/**
 * Sine of the horizon's elevation, seen from a height.
 * @param {number} height_m
 * @param {Kernels} kernels
 */
export function horizonSine(height_m, kernels) {
  const q = (2 * Math.max(height_m, 0)) / kernels.constant("EARTH_RADIUS_M");
  return -Math.sqrt(q / (1 + q));
}

/**
 * Unit vectors to the right, up and ahead of a camera without roll.
 * @param {Camera} camera
 */
export function axes(camera) {
  const a = camera.azimuth_deg * RADIANS;
  const e = clamp(camera.elevation_deg, -90, 90) * RADIANS;
  return {
    right: [Math.cos(a), -Math.sin(a), 0],
    up: [-Math.sin(e) * Math.sin(a), -Math.sin(e) * Math.cos(a), Math.cos(e)],
    ahead: [Math.cos(e) * Math.sin(a), Math.cos(e) * Math.cos(a), Math.sin(e)],
  };
}

/**
 * Where the camera is drawn from: never under the ground.
 * @param {Camera} camera
 * @param {Kernels} kernels
 */
export function cameraPlace(camera, kernels) {
  const [x, y, z] = camera.position_m;
  const height_m = clamp(z, kernels.constant("CAMERA_LOWEST_M"), kernels.constant("CAMERA_HIGHEST_M"));
  return [clamp(x, -1e6, 1e6), clamp(y, -1e6, 1e6), height_m];
}

/**
 * What is added to positions for the detail, which moves with the cloudy air, m.
 * @param {Scenery} scenery
 * @param {Cloud | null} cloud
 */
export function detailOffset(scenery, cloud) {
  const given = scenery.uniforms.ViewFrame;
  const tiles_per_m = Number(given.detail_tiles_per_m);
  const tile_m = tiles_per_m > 0 ? 1 / tiles_per_m : 1;
  const start_m = /** @type {number[]} */ (given.detail_offset_m);
  const moved_m = cloud?.air_displacement_m ?? [0, 0];
  return [0, 1, 2].map((axis) => {
    const offset_m = start_m[axis] - (moved_m[axis] ?? 0);
    return offset_m - Math.floor(offset_m / tile_m) * tile_m;
  });
}

/**
 * The members of the uniform `ViewFrame`, but for the place of a map of the sun's rays.
 * @param {Scenery} scenery
 * @param {Camera} camera
 * @param {Lights} lights
 * @param {Cloud | null} cloud
 * @param {[number, number]} size pixels
 * @param {Kernels} kernels
 */
export function viewFrame(scenery, camera, lights, cloud, [width, height], kernels) {
  const given = scenery.uniforms.ViewFrame;
  const position_m = cameraPlace(camera, kernels);
  const { sun } = lights;
  const moon = moonLook(lights, kernels);
  const beam = beamDirection(lights, kernels);
  /** @param {number[]} direction */
  const eastNorth = (direction) => {
    const table = tableSun(direction, kernels);
    const side = Math.hypot(table[0], table[1]);
    return side > 1e-4 ? [table[0] / side, table[1] / side] : [1, 0];
  };
  const dark = unit(sun)[2] < kernels.constant("STARS_SUN_SINE");
  const stars = dark && scenery.stars && lights.sidereal_deg !== null;
  const equator = stars ? equatorialFromWorld(Number(lights.sidereal_deg), Number(scenery.stars?.latitude_deg)) : [[0], [0], [0]];
  const air = scenery.uniforms.Air;
  const altitude_m = Number(air.surface_altitude_m) + position_m[2];
  const molecules = Math.exp(-altitude_m / kernels.constant("RAYLEIGH_HEIGHT_M"));
  const aerosol = Math.exp(-position_m[2] / kernels.constant("AEROSOL_HEIGHT_M")) * Number(air.aerosol_per_m);
  const rayleigh = ["RED", "GREEN", "BLUE"].map((c) => kernels.constant(`RAYLEIGH_${c}_PER_M`) * molecules);
  const fov = clamp(camera.vertical_fov_deg, 0.1, 170) * RADIANS;
  return {
    ...given,
    ...axes(camera),
    position_m,
    sun_direction: unit(sun),
    beam_direction: beam,
    marched_beam: marchedSun(beam, kernels),
    sky_sun: [...eastNorth(sun), ...(moon?.lights_sky ? eastNorth(moon.direction) : [0, 0])],
    moon_direction: moon === null ? [0, 0, 0, 0] : [...moon.direction, moon.angular_radius],
    moon_light: moon?.irradiance ?? [0, 0, 0],
    equator_x: equator[0],
    equator_y: equator[1],
    equator_z: equator[2],
    moon_sky: moon?.lights_sky ?? false,
    stars: Boolean(stars),
    haze_per_m: [...rayleigh, aerosol],
    detail_offset_m: detailOffset(scenery, cloud),
    width,
    height,
    first_row: 0,
    row_words: Math.ceil(width / 4) * 3,
    radians_per_pixel: (2 * Math.tan(0.5 * fov)) / height,
    horizon_sine: horizonSine(position_m[2], kernels),
    exposure_gain: 2 ** clamp(camera.exposure_ev ?? 0, -20, 20),
    cloud: cloud !== null,
    shadow: cloud !== null && Number(given.shadow) !== 0,
  };
}

/**
 * The levels of a volume that hold cloud, with an empty one below (at the ground the cloud goes on below) and above, and the grid of points
 * that the shape is made on. Null where there is no cloud.
 * @param {Cloud} cloud
 * @param {Kernels} kernels
 */
export function cloudySlab(cloud, kernels) {
  const [nx, ny, nz] = cloud.cells;
  const plane = nx * ny;
  const most = kernels.constant("EXTINCTION_MAX_PER_M");
  const from = cloud.extinction_per_m;
  /** @param {number} k */
  const cloudy = (k) => {
    for (let n = k * plane; n < (k + 1) * plane; n++) {
      if (from[n] > 0) {
        return true;
      }
    }
    return false;
  };
  let first = 0;
  while (first < nz && !cloudy(first)) {
    first += 1;
  }
  let end = nz;
  while (end > first && !cloudy(end - 1)) {
    end -= 1;
  }
  if (first === end) {
    return null;
  }
  const levels = end - first + 2;
  const extinction_per_m = new Float32Array(levels * plane);
  let largest_per_m = 0;
  for (let level = 0; level < levels; level++) {
    const k = Math.max(0, first + level - 1);
    if ((k >= first || first === 0) && k < end) {
      for (let n = 0; n < plane; n++) {
        const value = from[k * plane + n];
        const kept = value > 0 && value < Infinity ? Math.min(value, most) : 0;
        extinction_per_m[level * plane + n] = kept;
        largest_per_m = Math.max(largest_per_m, kept);
      }
    }
  }
  const [sx, sy, sz] = cloud.cell_size_m;
  const finer = extinction_per_m.length <= kernels.constant("FINER_CELLS_MAX") ? 2 : 1;
  const bottom_m = (first - 1) * sz;
  const cells = nx * ny * levels;
  const grid = {
    points_x: nx * finer,
    points_y: ny * finer,
    points_z: levels * finer,
    finer,
    stride_x: nx * finer + 2,
    stride_y: ny * finer + 2,
    cells_x: nx,
    cells_y: ny,
    levels,
    occupancy_row: Math.min(Math.ceil(cells / 4), 1 << 20),
    bottom_m,
    top_m: bottom_m + levels * sz,
    point_spacing_x_m: sx / finer,
    point_spacing_y_m: sy / finer,
    point_spacing_z_m: sz / finer,
    amplitude_unit_per_m: largest_per_m / 65_535,
    per_period_x: 1 / (nx * sx),
    per_period_y: 1 / (ny * sy),
    cell_size_x_m: sx,
    cell_size_y_m: sy,
    cell_size_z_m: sz,
  };
  return largest_per_m > 0 ? { grid, extinction_per_m } : null;
}
