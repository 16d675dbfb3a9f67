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
    let west2 = q[1] - q[0];
    let west1 = q[2] - q[1];
    let middle = q[3] - q[2];
    let east1 = q[4] - q[3];
    let east2 = q[5] - q[4];
    let value = select(q[3], q[2], positive);
    let d0 = select(-east2, west2, positive);
    let d1 = select(-east1, west1, positive);
    let d2 = select(-middle, middle, positive);
    let d3 = select(-west1, east1, positive);
    let bend0 = d1 - d0;
    let bend1 = d2 - d1;
    let bend2 = d3 - d2;
    let slope0 = d1 + d1 + bend0;
    let slope1 = d1 + d2;
    let slope2 = bend2 - (d2 + d2);
    let rough0 = (13.0 / 3.0) * (bend0 * bend0) + slope0 * slope0;
    let rough1 = (13.0 / 3.0) * (bend1 * bend1) + slope1 * slope1;
    let rough2 = (13.0 / 3.0) * (bend2 * bend2) + slope2 * slope2;
    let tau = abs(rough0 - rough2);
    let ratio0 = min(tau / (rough0 + ROUGHNESS_FLOOR), ROUGHNESS_RATIO_MAX);
    let ratio1 = min(tau / (rough1 + ROUGHNESS_FLOOR), ROUGHNESS_RATIO_MAX);
    let ratio2 = min(tau / (rough2 + ROUGHNESS_FLOOR), ROUGHNESS_RATIO_MAX);
    let w0 = 1.0 + ratio0 * ratio0;
    let w1 = 6.0 + 6.0 * (ratio1 * ratio1);
    let w2 = 3.0 + 3.0 * (ratio2 * ratio2);
    let face0 = 3.0 * d1 + 2.0 * bend0;
    let face1 = slope1 + d2;
    let face2 = 3.0 * d2 - bend2;
    return speed * (value + (w0 * face0 + w1 * face1 + w2 * face2) / (6.0 * (w0 + w1 + w2)));
}

// How far a face is from ground and lid decides the order there: 5 with three values on both sides, 3 with two, else the lowest.
fn order_at(z: u32, top: u32) -> u32 {
    let room = min(z, top + 1u - z);
    return select(select(1u, 3u, room == 2u), 5u, room >= 3u);
}
