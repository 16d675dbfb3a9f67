//! use shared/grid
//! use shared/largest
// Stage `reduce`; see the CPU twin for what it computes. Bytes a cell: 16.
// Maxima are taken over bit patterns: numbers that are not negative have the order of their bits, and integers have an atomic maximum. What isn't
// finite is counted by its bits, because a comparison may take NaN for anything.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
@group(0) @binding(6) var<storage, read> viscosity: array<f32>;
@group(0) @binding(7) var<storage, read_write> block: array<atomic<u32>>;

// Maxima of the threads' own results, before one thread of them hands them on.
var<workgroup> shared_block: array<atomic<u32>, REDUCED_NUMBERS>;

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    if thread < REDUCED_NUMBERS {
        atomicStore(&shared_block[thread], 0u);
    }
    workgroupBarrier();
    var rate = 0u;
    var wind = 0u;
    var updraught = 0u;
    var thickest = 0u;
    var not_finite = 0u;
    if id.x < sim.cells.w {
        let i = id.z * sim.cells.w + id.x;
        let a = u[i];
        let b = v[i];
        let c = w[i];
        var k = 0.0;
        if (sim.holds & HOLDS_VISCOSITY) != 0u {
            k = viscosity[i];
        }
        if is_finite(a) && is_finite(b) && is_finite(c) && is_finite(k) {
            let r = sim.per_cell_size_m;
            rate = bitcast<u32>(abs(a) * r.x + abs(b) * r.y + abs(c) * r.z);
            wind = bitcast<u32>(max(abs(a), abs(b)));
            updraught = bitcast<u32>(max(c, 0.0));
            thickest = bitcast<u32>(abs(k));
        } else {
            not_finite = 1u;
        }
    }
    hand_on_largest(thread, REDUCED_RATE, rate);
    hand_on_largest(thread, REDUCED_WIND, wind);
    hand_on_largest(thread, REDUCED_UPDRAUGHT, updraught);
    hand_on_largest(thread, REDUCED_VISCOSITY, thickest);
    hand_on_count(thread, REDUCED_NOT_FINITE, not_finite);
    workgroupBarrier();
    if thread < REDUCED_NOT_FINITE {
        atomicMax(&block[thread], atomicLoad(&shared_block[thread]));
    } else if thread == REDUCED_NOT_FINITE {
        atomicAdd(&block[thread], atomicLoad(&shared_block[thread]));
    }
}
