// Stage `detail_noise`: bakes the tile that carves cloud edges. The twin is cpu/view/detail_noise.rs.
//
// `values` makes both kinds of billows at every point and sums them a workgroup; `spread` finds their means and deviations;
// `pack` stretches them to bytes. Sums are of the difference from one half, which is near the mean.

@group(0) @binding(0) var<storage, read_write> values_at: array<vec2<f32>>;
@group(0) @binding(1) var<storage, read_write> sums: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> words: array<u32>;

const POINTS = TILE_POINTS * TILE_POINTS * TILE_POINTS;
const GROUPS = POINTS / 256u;

fn hash(cell: vec3<u32>, salt: u32) -> u32 {
    var h = (cell.x * NOISE_HASH_X) ^ (cell.y * NOISE_HASH_Y) ^ (cell.z * NOISE_HASH_Z);
    h += salt * NOISE_HASH_SALT;
    h = (h ^ (h >> 16u)) * NOISE_HASH_FIRST;
    h = (h ^ (h >> 15u)) * NOISE_HASH_SECOND;
    return h ^ (h >> 16u);
}

/// Three numbers of 10 bits.
fn tens(h: u32) -> vec3<f32> {
    return vec3<f32>((vec3<u32>(h) >> vec3<u32>(0u, 10u, 20u)) & vec3<u32>(1023u));
}

/// One less the distance to the nearest of one random point a cell.
fn billow(p: vec3<f32>, cells: u32, salt: u32) -> f32 {
    let q = p * f32(cells);
    let base = vec3<u32>(q);
    var least = 9.0;
    for (var n = 0u; n < 27u; n++) {
        let d = vec3<u32>(n % 3u, n / 3u % 3u, n / 9u);
        let jitter = tens(hash((base + cells + d - 1u) % cells, salt)) / 1023.0;
        let away = vec3<f32>(base) + vec3<f32>(d) - 1.0 + jitter - q;
        least = min(least, dot(away, away));
    }
    return 1.0 - min(sqrt(least), 1.0);
}

/// Gradient noise, about 0 to 1.
fn gradient(p: vec3<f32>, cells: u32, salt: u32) -> f32 {
    let q = p * f32(cells);
    let base = vec3<u32>(q);
    let f = q - vec3<f32>(base);
    let s = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    var sum = 0.0;
    for (var n = 0u; n < 8u; n++) {
        let d = vec3<u32>(n & 1u, (n >> 1u) & 1u, n >> 2u);
        let slope = tens(hash((base + d) % cells, salt)) / 511.5 - 1.0;
        let weight = select(1.0 - s, s, d == vec3<u32>(1u));
        sum += dot(slope, f - vec3<f32>(d)) * weight.x * weight.y * weight.z;
    }
    return 0.5 + NOISE_GRADIENT_GAIN * sum;
}

var<workgroup> partial: array<vec4<f32>, 256>;

fn add_up(thread: u32) {
    for (var span = 128u; span > 0u; span /= 2u) {
        workgroupBarrier();
        if (thread < span) {
            partial[thread] += partial[thread + span];
        }
    }
}

@compute @workgroup_size(256)
fn values(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let n = id.x;
    let p = vec3<f32>(vec3<u32>(n % TILE_POINTS, n / TILE_POINTS % TILE_POINTS, n / (TILE_POINTS * TILE_POINTS)))
        / f32(TILE_POINTS);
    let large = NOISE_LARGE_BILLOWS * billow(p, TILE_BILLOWS, 1u) + NOISE_LARGE_FINER * billow(p, 2u * TILE_BILLOWS, 2u)
        + NOISE_LARGE_GRADIENT * gradient(p, TILE_BILLOWS + 1u, 3u);
    let small = NOISE_SMALL_BILLOWS * billow(p, 2u * TILE_BILLOWS, 4u)
        + NOISE_SMALL_FINER * billow(p, 4u * TILE_BILLOWS, 5u);
    let value = vec2<f32>(large, small);
    values_at[n] = value;
    let off = value - 0.5;
    partial[thread] = vec4<f32>(off, off * off);
    add_up(thread);
    if (thread == 0u) {
        sums[group.x] = partial[0];
    }
}

/// Leaves mean and stretch of both in the first of the sums.
@compute @workgroup_size(256)
fn spread(@builtin(local_invocation_index) thread: u32) {
    var sum = vec4<f32>(0.0);
    for (var n = thread; n < GROUPS; n += 256u) {
        sum += sums[n];
    }
    partial[thread] = sum;
    add_up(thread);
    if (thread == 0u) {
        let mean = partial[0] / f32(POINTS);
        let deviation = sqrt(max(mean.zw - mean.xy * mean.xy, vec2<f32>(0.0)));
        sums[0] = vec4<f32>(mean.xy + 0.5, NOISE_DEVIATION / max(deviation, vec2<f32>(1e-6)));
    }
}

fn bytes(n: u32) -> vec2<u32> {
    let scale = sums[0];
    let stretched = clamp((values_at[n] - scale.xy) * scale.zw + 0.5, vec2<f32>(0.0), vec2<f32>(1.0));
    return vec2<u32>(stretched * 255.0 + 0.5);
}

@compute @workgroup_size(256)
fn pack(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    let own = bytes(n);
    let east = bytes(n - n % TILE_POINTS + (n + 1u) % TILE_POINTS);
    words[n] = own.x | (own.y << 8u) | (east.x << 16u) | (east.y << 24u);
}
