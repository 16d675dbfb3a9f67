//! use shared/grid
// Face fluxes of the flux form; see `advect` of the CPU device. The six values around a face come from the west (the south, below).

fn upwind5(q: array<f32, 6>, speed: f32) -> f32 {
    let even = (37.0 * (q[3] + q[2]) - 8.0 * (q[4] + q[1]) + (q[5] + q[0])) * (1.0 / 60.0);
    let odd = (10.0 * (q[3] - q[2]) - 5.0 * (q[4] - q[1]) + (q[5] - q[0])) * (1.0 / 60.0);
    return speed * even - abs(speed) * odd;
}

fn upwind3(q: array<f32, 6>, speed: f32) -> f32 {
    let even = (7.0 * (q[3] + q[2]) - (q[4] + q[1])) * (1.0 / 12.0);
    let odd = (3.0 * (q[3] - q[2]) - (q[4] - q[1])) * (1.0 / 12.0);
    return speed * even - abs(speed) * odd;
}

fn weno5(q: array<f32, 6>, speed: f32) -> f32 {
    let positive = speed >= 0.0;
    let a = select(q[5], q[0], positive);
    let b = select(q[4], q[1], positive);
    let c = select(q[3], q[2], positive);
    let d = select(q[2], q[3], positive);
    let e = select(q[1], q[4], positive);
    let bend0 = a - 2.0 * b + c;
    let bend1 = b - 2.0 * c + d;
    let bend2 = c - 2.0 * d + e;
    let slope0 = a - 4.0 * b + 3.0 * c;
    let slope1 = b - d;
    let slope2 = 3.0 * c - 4.0 * d + e;
    let rough0 = (13.0 / 12.0) * bend0 * bend0 + 0.25 * slope0 * slope0;
    let rough1 = (13.0 / 12.0) * bend1 * bend1 + 0.25 * slope1 * slope1;
    let rough2 = (13.0 / 12.0) * bend2 * bend2 + 0.25 * slope2 * slope2;
    let tau = abs(rough0 - rough2);
    let ratio0 = min(tau / (rough0 + ROUGHNESS_FLOOR), ROUGHNESS_RATIO_MAX);
    let ratio1 = min(tau / (rough1 + ROUGHNESS_FLOOR), ROUGHNESS_RATIO_MAX);
    let ratio2 = min(tau / (rough2 + ROUGHNESS_FLOOR), ROUGHNESS_RATIO_MAX);
    let w0 = 0.1 * (1.0 + ratio0 * ratio0);
    let w1 = 0.6 * (1.0 + ratio1 * ratio1);
    let w2 = 0.3 * (1.0 + ratio2 * ratio2);
    let face0 = 2.0 * a - 7.0 * b + 11.0 * c;
    let face1 = -b + 5.0 * c + 2.0 * d;
    let face2 = 2.0 * c + 5.0 * d - e;
    return speed * (w0 * face0 + w1 * face1 + w2 * face2) / (6.0 * (w0 + w1 + w2));
}

// How far a face is from ground and lid decides the order there: 5 with three values on both sides, 3 with two, else the lowest.
fn order_at(z: u32, top: u32) -> u32 {
    let room = min(z, top + 1u - z);
    return select(select(1u, 3u, room == 2u), 5u, room >= 3u);
}
