//! use shared/grid
//! use shared/largest
// Stage `vitals`; see the CPU twin for what it computes. Bytes a cell: 24.
// What isn't finite is counted by its bits, because a comparison may take NaN for anything; maxima are taken over bits, as in `reduce`.

@group(0) @binding(3) var<storage, read> u: array<f32>;
@group(0) @binding(4) var<storage, read> v: array<f32>;
@group(0) @binding(5) var<storage, read> w: array<f32>;
@group(0) @binding(6) var<storage, read> heat: array<f32>;
@group(0) @binding(7) var<storage, read> water: array<f32>;
@group(0) @binding(8) var<storage, read> extinction: array<f32>;
@group(0) @binding(9) var<storage, read_write> block: array<atomic<u32>>;

var<workgroup> shared_block: array<atomic<u32>, VITAL_NUMBERS>;

fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(local_invocation_index) thread: u32) {
    if thread < VITAL_NUMBERS {
        atomicStore(&shared_block[thread], 0u);
    }
    workgroupBarrier();
    var falling = 0u;
    var divergence_bits = 0u;
    var fine = true;
    if id.x < sim.cells.w {
        let nx = sim.cells.x;
        let z = id.z;
        let x = id.x % nx;
        let y = id.x / nx;
        let here = row_of(y, z);
        let i = here + x;
        if (sim.holds & HOLDS_HEAT) != 0u {
            fine = fine && is_finite(heat[i]);
        }
        if (sim.holds & HOLDS_WATER) != 0u {
            let q = water[i];
            fine = fine && is_finite(q) && is_finite(extinction[i]);
            // The bits of a number turned so that the least number has the largest ones.
            let bits = bitcast<u32>(q);
            falling = select(~bits & 0x7fffffffu, bits, (bits & 0x80000000u) != 0u);
        }
        if (sim.holds & HOLDS_FLOW) != 0u {
            let a = u[i];
            let b = v[i];
            let c = w[i];
            fine = fine && is_finite(a) && is_finite(b) && is_finite(c);
            let r = sim.per_cell_size_m;
            var up = -profile(PROFILE_FACE_DENSITY, z) * c;
            if z + 1u < sim.cells.z {
                up += profile(PROFILE_FACE_DENSITY, z + 1u) * w[i + sim.cells.w];
            }
            let divergence = (u[here + ahead(x, 1u, nx)] - a) * r.x
                + (v[row_of(ahead(y, 1u, sim.cells.y), z) + x] - b) * r.y
                + up * r.z / profile(PROFILE_DENSITY, z);
            if is_finite(divergence) {
                divergence_bits = bitcast<u32>(abs(divergence));
            } else {
                fine = false;
            }
        }
    }
    hand_on_largest(thread, VITAL_WATER, falling);
    hand_on_largest(thread, VITAL_DIVERGENCE, divergence_bits);
    hand_on_count(thread, VITAL_NOT_FINITE, select(1u, 0u, fine));
    workgroupBarrier();
    if thread < VITAL_NOT_FINITE {
        atomicMax(&block[thread], atomicLoad(&shared_block[thread]));
    } else if thread == VITAL_NOT_FINITE {
        atomicAdd(&block[thread], atomicLoad(&shared_block[thread]));
    }
}
