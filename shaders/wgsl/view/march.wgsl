//! use shared/atmosphere
//! use shared/air_transmittance
//! use shared/shape
//! use shared/detail
//! use shared/extinction
//! use shared/diffuse_light
//! use shared/light_words
//! use shared/octaves
//! use shared/sun_map
//! use shared/sky_look
//! use shared/stars
//! use shared/moon
//! use view/haze
//! use view/ground
//! use view/light_shafts
//! use view/tone_map
// Stage `march`: a ray of view an invocation, through sky, cloud and to the ground. The twin is cpu/view/march.rs (the light of samples: cpu/view/cloud_light.rs), which
// marches sixteen rays abreast; what a ray does there depends on that ray alone, so both take the same samples.
//
// A workgroup draws 8 x 8 pixels and packs their bytes: rows of the picture are filled up to whole words.

@group(0) @binding(0) var<uniform> frame: ViewFrame;
@group(0) @binding(1) var<uniform> light: SkyLightValues;
@group(0) @binding(2) var<uniform> shape: ShapeGrid;
@group(0) @binding(3) var<storage, read> transmittance_table: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> sky_table: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> shape_words: array<u32>;
@group(0) @binding(6) var<storage, read> occupancy_words: array<u32>;
@group(0) @binding(7) var<storage, read> light_words: array<u32>;
@group(0) @binding(8) var<storage, read> shadow: array<f32>;
@group(0) @binding(9) var<storage, read> detail_words: array<u32>;
@group(0) @binding(10) var<storage, read_write> picture: array<u32>;
@group(0) @binding(11) var<uniform> star_words: array<vec4<u32>, STAR_WORDS / 4u>;
@group(0) @binding(12) var<uniform> phase: MarchPhase;

const LOG2_E = 1.44269504088896;
const NEVER = 3.4e38;

/// What a ray met in the cloud.
struct Met {
    light: vec3<f32>,
    through: f32,
    distance_m: f32,
}

/// Length of a step in cloud at a distance, m.
fn step_m(t: f32) -> f32 {
    return clamp(t * MARCH_STEP_GROWTH, MARCH_STEP_LEAST_M, MARCH_STEP_MOST_M);
}

/// What is under the root, then the smaller and the larger root of `curve t^2 + rise t + gap = 0`.
fn roots(rise: f32, curve: f32, gap: f32) -> vec3<f32> {
    let under = rise * rise - curve * (4.0 * gap);
    let root = sqrt(max(under, 0.0));
    let q = select(-root - rise, root - rise, rise < 0.0) * 0.5;
    let a = q / max(curve, 1e-12);
    let b = gap / select(q, 1e-6, q * q < 1e-12);
    return vec3<f32>(under, min(a, b), max(a, b));
}

/// First and last distance at which a ray is between a height and the cloud's top; in between it may leave them for a while.
fn slab(from_m: f32, rise: f32, curve: f32, bottom_m: f32) -> vec2<f32> {
    let top = roots(rise, curve, from_m - shape.top_m);
    let bottom = roots(rise, curve, from_m - bottom_m);
    if (from_m > shape.top_m) {
        return vec2<f32>(select(NEVER, top.y, top.x > 0.0 && top.y > 0.0), select(0.0, top.z, top.x > 0.0));
    }
    if (from_m < bottom_m) {
        return vec2<f32>(select(0.0, max(bottom.z, 0.0), bottom.x > 0.0), top.z);
    }
    return vec2<f32>(0.0, top.z);
}

/// Light scattered once at the angle whose cosine is `mu`, three colours, 1/sr.
fn phase_once(mu: f32) -> vec3<f32> {
    let last = f32(PHASE_FIRST_HALF - 1u);
    let back = mu < 0.0;
    let place = last * select(sqrt(sqrt(max(1.0 - mu, 0.0))), sqrt(max(1.0 + mu, 0.0)), back);
    let n = min(u32(place), PHASE_FIRST_HALF - 2u);
    let i = n + select(0u, PHASE_FIRST_HALF, back);
    return mix(phase.quads[i].rgb, phase.quads[i + 1u].rgb, place - f32(n));
}

/// What light that is even on one side of the cloud brings a place, over its radiance, where the share `passage` of diffuse light passes the cloud and the share `other` comes from the other
/// side: two streams without absorption.
fn diffuse_share(passage: f32, other: f32) -> f32 {
    return passage * (1.0 / max(other, 1e-3) - 0.5);
}

/// The share of a step's length, even in extinction, of optical depth `depth` and passed by `kept` of the light, before which the share `part` lies of the light that reaches the camera from it.
fn place_of_light(part: f32, depth: f32, kept: f32) -> f32 {
    if (depth < THIN_STEP) {
        return part - 0.5 * depth * part * (1.0 - part);
    }
    return -log2(1.0 - part * (1.0 - kept)) / (LOG2_E * depth);
}

/// What the detail makes of the cloud at a place, `t` from the camera, less the mean that the stored depth is made of, 1/m.
fn beyond_mean(p: vec3<f32>, t: f32) -> f32 {
    let s = shape_sample(p);
    return carved_extinction(s, p, t, false) - s.y * smooth_ramp((s.x - CARVE_EDGE) / CARVE_MEAN_RAMP);
}

/// Optical depth from `p` towards the sun by a march of steps that grow with distance; midpoint rule.
fn secondary_march(p: vec3<f32>, t: f32) -> f32 {
    let sun = frame.marched_beam.xyz;
    let reach = clamp((shape.top_m - p.z) / sun.z, 0.0, SUN_MARCH_REACH_M);
    let unit = reach / f32(frame.secondary_steps * frame.secondary_steps);
    var depth = 0.0;
    for (var i = 0u; i < frame.secondary_steps; i++) {
        let n = f32(i);
        depth += extinction(p + sun * (unit * (n * n + n + 0.5)), t, false) * unit * (2.0 * n + 1.0);
    }
    return depth;
}

/// Factor on octaves over a place, of stage `octave_balance`; between columns' middles linear.
fn balance_at(p: vec3<f32>) -> f32 {
    let cells = vec2<f32>(f32(shape.cells_x), f32(shape.cells_y));
    let g = fract(p.xy * vec2<f32>(shape.per_period_x, shape.per_period_y)) * cells + 0.5;
    let whole = floor(g);
    let f = g - whole;
    let c = vec2<u32>(whole);
    let i = shape.stride_x * shape.stride_y + 1u + c.y * (shape.cells_x + 2u) + c.x;
    let j = i + shape.cells_x + 2u;
    return mix(mix(shadow[i], shadow[i + 1u], f.x), mix(shadow[j], shadow[j + 1u], f.x), f.y);
}

/// What a ray meets from `from_m` to `limit_m`; a step that reaches beyond is cut there.
fn march_between(ray: Ray, from_m: f32, limit_m: f32) -> Met {
    var met = Met(vec3<f32>(0.0), 1.0, 0.0);
    let d = ray.d;
    let curve = ray.curve;
    let o = frame.position_m.xyz;
    let reach = slab(o.z, d.z, curve, shape.bottom_m);
    let end = min(min(reach.y, ray.end), DRAW_DISTANCE_M);
    let first = max(reach.x, from_m);
    if (first >= end) {
        return met;
    }
    // Light that was scattered once has colours, what was scattered further the colours' mean.
    let once = phase_once(ray.turn);
    var phases: array<f32, OCTAVES_MAX + 1u>;
    for (var octave = 0u; octave <= frame.octaves; octave++) {
        phases[octave] = phase_of_octave(octave, ray.turn);
    }
    let slowest = -LOG2_E * frame.depth_scale / f32(1u << frame.octaves);
    let sun = frame.marched_beam.xyz;

    var through = 1.0;
    var once_base = 0.0;
    var once_rise = 0.0;
    var sun_base = 0.0;
    var sun_rise = 0.0;
    var from_sky = 0.0;
    var from_ground = 0.0;
    var distance = 0.0;
    var weights = 0.0;
    // Logarithmic segments: where cloud was met first, and by which share of the way from there they grow.
    var met_at = NEVER;
    var growth = 0.0;
    var place = first + ray.pattern * step_m(first);
    for (var n = 0u; n < MARCH_STEPS_MAX; n++) {
        // A sample stands for a step around it: one whose step begins before the limit counts, from the limit's side.
        let begun = place - ray.pattern * step_m(place);
        if (place >= end || begun >= limit_m || through <= MARCH_THROUGH_END) {
            break;
        }
        let t = min(place, limit_m);
        let p = vec3<f32>(d.xy * t + o.xy, t * (d.z + curve * t) + o.z);
        let empty = empty_distance_m(p);
        var step = step_m(t);
        if (empty > 0.0) {
            place += max(step, empty);
            continue;
        }
        let thick = extinction(p, t, t < NEAR_DETAIL_M);
        if (frame.segments > 0u) {
            if (t < met_at) {
                growth = pow((end - t) / SEGMENT_UNIT_M + 1.0, 1.0 / f32(frame.segments)) - 1.0;
                met_at = t;
            }
            step = max((t - met_at + SEGMENT_UNIT_M) * growth, 1.0);
        } else if (frame.step_depth > 0.0 && thick > 0.0) {
            step = min(max(frame.step_depth / max(thick, 1e-9), DEPTH_STEP_LEAST_M), step * DEPTH_STEP_LONGER);
        }
        if (thick > 0.0) {
            let length = min(step, limit_m - begun);
            let kept = exp2(thick * length * -LOG2_E);
            // Where the step's light comes from: more of it from the front.
            let lit = max(t + length * (place_of_light(ray.pattern, thick * length, kept) - ray.pattern), first);
            let p = vec3<f32>(d.xy * lit + o.xy, lit * (d.z + curve * lit) + o.z);
            var depth = 0.0;
            // What the detail adds to the mean cloud, or takes from it, matters while the ray is near and not yet dimmed; both fade.
            let fade = clamp((FINE_REACH_M - lit) / FINE_FADE_M, 0.0, 1.0)
                * clamp((through - FINE_DIMMED) / FINE_DIMMED, 0.0, 1.0)
                * select(0.0, 1.0, frame.secondary_steps == 0u && frame.map_side == 0u && frame.detail_blend > 0.0);
            if (fade > 0.0) {
                depth = fade * (beyond_mean(p + sun * FINE_FIRST_M, lit) * FINE_FIRST_LENGTH_M
                    + beyond_mean(p + sun * FINE_SECOND_M, lit) * FINE_SECOND_LENGTH_M);
            }
            let around_p = light_around(p);
            if (frame.map_side != 0u) {
                depth = map_depth(p);
            } else if (frame.secondary_steps == 0u) {
                depth = max(depth + beam_depth(around_p), 0.0);
            } else {
                depth = secondary_march(p, lit);
            }
            let sky_seen = sky_share(around_p);
            let ground_seen = ground_share(around_p);
            let passage = passage_of(sky_seen, ground_seen);
            // The last octave's transmittance; squaring gives the one before.
            var passed = exp2(depth * slowest);
            var scattered = 0.0;
            for (var octave = frame.octaves; octave > 0u; octave--) {
                scattered += phases[octave] * passed;
                passed *= passed;
            }
            if (frame.similarity > 0.0) {
                scattered = max(scattered + phases[0] * passed, 0.0) + diffuse_towards(p, d) * (0.25 / PI);
            }
            if (frame.octaves > 0u) {
                scattered *= level_share(sun.z, depth, sky_seen, passage);
                if (frame.similarity == 0.0) {
                    scattered *= balance_at(p);
                }
            }
            let share = through * (1.0 - kept);
            let height = clamp((p.z - shape.bottom_m) / (shape.top_m - shape.bottom_m), 0.0, 1.0);
            once_base += share * passed;
            once_rise += share * passed * height;
            sun_base += share * scattered;
            sun_rise += share * scattered * height;
            from_sky += share * diffuse_share(passage, ground_seen);
            from_ground += share * diffuse_share(passage, sky_seen);
            distance += share * t;
            weights += share;
            through *= kept;
        }
        place += step;
    }
    met.light = (once_base * once + sun_base) * light.sun_at_base.rgb
        + (once_rise * once + sun_rise) * (light.sun_at_top.rgb - light.sun_at_base.rgb)
        + from_sky * light.sky_radiance.rgb
        + from_ground * light.ground_radiance.rgb
            * (1.0 - COVERED_GROUND + COVERED_GROUND * sunlit_share());
    met.through = clamp((through - MARCH_THROUGH_END) / (1.0 - MARCH_THROUGH_END), 0.0, 1.0);
    met.distance_m = distance / max(weights, 1e-6);
    return met;
}

/// What a ray meets before `limit_m`.
fn march_before(ray: Ray, limit_m: f32) -> Met {
    return march_between(ray, 0.0, limit_m);
}

/// What a ray meets.
fn march(ray: Ray) -> Met {
    return march_before(ray, NEVER);
}

/// A ray of view.
struct Ray {
    d: vec3<f32>,
    /// Height along the ray: camera + d.z t + curve t^2.
    curve: f32,
    /// Whether the ground is met.
    down: bool,
    /// Distance at which the ground is met, or at which the ray ends in the sky, m.
    end: f32,
    /// Cosine of what the beam is turned by towards the camera.
    turn: f32,
    /// Interleaved gradient noise, for the march's start and against bands.
    pattern: f32,
}

/// The ray through the place `pixel`, pixels from the picture's upper left corner.
fn ray_of(pixel: vec2<f32>) -> Ray {
    let size = vec2<f32>(f32(frame.width), f32(frame.height));
    let scale = frame.radians_per_pixel;
    let s = (pixel - 0.5 * size) * vec2<f32>(scale, -scale);
    return ray_along(normalize(s.x * frame.right.xyz + s.y * frame.up.xyz + frame.ahead.xyz), pixel);
}

/// The ray along a unit vector; its steps begin where the pattern of a picture's place has them begin.
fn ray_along(d: vec3<f32>, pixel: vec2<f32>) -> Ray {
    let height = frame.position_m.z;
    let curve = (1.0 - d.z * d.z) * (0.5 / EARTH_RADIUS_M);
    let under_root = d.z * d.z - curve * (4.0 * height);
    let down = d.z < 0.0 && under_root >= 0.0;
    var end = SKY_DISTANCE_M;
    if (down) {
        end = min(2.0 * height / max(sqrt(max(under_root, 0.0)) - d.z, 1e-9), SKY_DISTANCE_M);
    }
    let pattern = fract(fract(pixel.x * PATTERN_X + pixel.y * PATTERN_Y) * PATTERN_SCALE);
    return Ray(d, curve, down, end, dot(d, frame.beam_direction.xyz), pattern);
}

/// What lies behind the cloud: radiance, the clear sky's alone, transmittance of the air to the ray's end.
struct Behind {
    light: vec3<f32>,
    sky: vec3<f32>,
    whole: vec3<f32>,
}

fn behind_of(ray: Ray) -> Behind {
    let d = ray.d;
    let o = frame.position_m.xyz;
    let scale = frame.radians_per_pixel;
    // The table's lower half holds no ground: a ray that just misses the ground must not look there.
    let looked = select(max(d.z, frame.horizon_sine + 2e-4), d.z, ray.down);
    let sky = sky_look(vec3<f32>(d.xy, looked));
    let whole = haze_transmittance(ray.end, d.z);
    var seen = sky;
    if (ray.down) {
        var land = ground_radiance(d.xy * ray.end + o.xy, ray.end);
        if (frame.sea != 0u) {
            land = mix(land, sky_look(mirrored(d)), mirror_share(d.z));
        }
        seen += land * whole;
    } else {
        // The chord to the sun's centre is its angle for small angles.
        let angle = sqrt(max((1.0 - dot(d, frame.sun_direction.xyz)) * 2.0, 0.0));
        let blur = scale * SUN_EDGE_PIXELS;
        let disc = clamp((SUN_ANGULAR_RADIUS + blur * 0.5 - angle) / blur, 0.0, 1.0);
        if (disc > 0.0) {
            let radiance = disc / (PI * SUN_ANGULAR_RADIUS * SUN_ANGULAR_RADIUS);
            seen += radiance * transmittance_of_sun(o.z, frame.sun_direction.z);
        }
        var open = 1.0;
        if (frame.moon_direction.w > 0.0) {
            let moon = moon_radiance(d, frame.moon_direction, frame.moon_light.rgb, frame.sun_direction.xyz, blur);
            if (moon.w > 0.0) {
                seen += moon.rgb * transmittance_of_sun(o.z, frame.moon_direction.z);
                open -= moon.w;
            }
        }
        if (frame.stars != 0u && open > 0.0) {
            let own = star_radiance(vec3<f32>(dot(frame.equator_x.xyz, d), dot(frame.equator_y.xyz, d), dot(frame.equator_z.xyz, d)), scale);
            if (own.g > 0.0) {
                seen += own * transmittance_to_space(o.z, d.z) * open;
            }
        }
    }
    return Behind(seen, sky, whole);
}

/// How far cloud at a distance has faded: 0 to 1.
fn faded(distance_m: f32) -> f32 {
    return smooth_ramp((distance_m - DRAW_FADES_FROM_M) / (DRAW_DISTANCE_M - DRAW_FADES_FROM_M));
}

/// Radiance of a ray: the cloud and the air before it over what lies behind.
fn composed(ray: Ray, behind: Behind, met: Met) -> vec3<f32> {
    var seen = behind.light;
    if (met.through < 1.0) {
        let air = air_to(met.distance_m, ray, behind);
        let covered = (1.0 - met.through) * air.added + met.light * air.passed + behind.light * met.through;
        seen = mix(behind.light, covered, 1.0 - faded(met.distance_m));
    }
    return shaded(ray, met, ray.end, seen);
}

/// Light to `end_m` less what the clouds' shadows in the air take.
fn shaded(ray: Ray, met: Met, end_m: f32, seen: vec3<f32>) -> vec3<f32> {
    if (frame.shaft_samples == 0u || frame.cloud == 0u) {
        return seen;
    }
    let taken = shafts_taken(ray.d, ray.curve, end_m, ray.turn, ray.pattern, met.distance_m, met.through);
    return max(seen - taken, vec3<f32>(0.0));
}

/// Transmittance of the air to a distance, and the light that it adds.
struct AirBetween {
    passed: vec3<f32>,
    added: vec3<f32>,
}

fn air_to(distance_m: f32, ray: Ray, behind: Behind) -> AirBetween {
    if (frame.haze_on_cloud == 0u) {
        return AirBetween(vec3<f32>(1.0), vec3<f32>(0.0));
    }
    let passed = haze_transmittance(distance_m, ray.d.z);
    return AirBetween(passed, behind.sky * min((1.0 - passed) / max(1.0 - behind.whole, vec3<f32>(1e-6)), vec3<f32>(1.0)));
}

/// Factor on radiance before the tone map.
fn exposed() -> f32 {
    let received = luminance_of(light.sun_at_ground.rgb) * max(frame.beam_direction.z, 0.0)
        + luminance_of(light.sky_irradiance.rgb);
    return exposure(received, frame.exposure_gain, frame.night != 0u);
}

/// Bytes as floats of a pixel whose ray meets this.
fn shown(ray: Ray, met: Met) -> vec3<f32> {
    return tone_map(composed(ray, behind_of(ray), met), exposed(), ray.pattern);
}

/// Bytes as floats of the pixel whose centre is at `pixel`.
fn draw(pixel: vec2<f32>) -> vec3<f32> {
    let ray = ray_of(pixel);
    if (frame.cloud != 0u) {
        return shown(ray, march(ray));
    }
    return tone_map(behind_of(ray).light, exposed(), ray.pattern);
}

var<workgroup> tile: array<u32, 64>;

/// Writes the bytes of a workgroup's 8 x 8 pixels, each given in `tile`.
fn pack(group: vec3<u32>, thread: u32) {
    workgroupBarrier();
    // Eight pixels make six words.
    if (thread < 48u) {
        let row = thread / 6u;
        let word = thread % 6u;
        let column = group.x * 6u + word;
        let line = group.y * 8u + row + frame.first_row;
        if (line < frame.height && column < frame.row_words) {
            // Word w holds bytes 4 w to 4 w + 3: the end of pixel 4 w / 3 and the start of the next.
            let first = row * 8u + word * 4u / 3u;
            let skipped = word % 3u * 8u;
            picture[line * frame.row_words + column] = (tile[first] >> skipped) | (tile[first + 1u] << (24u - skipped));
        }
    }
}

/// Bytes in a word.
fn in_word(rgb: vec3<f32>) -> u32 {
    let c = vec3<u32>(rgb);
    return c.r | (c.g << 8u) | (c.b << 16u);
}

@compute @workgroup_size(8, 8)
fn pixels(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let y = id.y + frame.first_row;
    tile[thread] = 0u;
    if (id.x < frame.width && y < frame.height) {
        tile[thread] = in_word(draw(vec2<f32>(f32(id.x), f32(y)) + 0.5));
    }
    pack(group, thread);
}
