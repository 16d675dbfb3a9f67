// Lookups in the numbers of octaves. The twins are cpu/light/march_phase.rs and cpu/light/octave_shares.rs. The module that uses it binds the uniform `phase`.

/// Light of an octave, 0 to `OCTAVES_MAX`, with its weight, at the angle whose cosine is `mu`, 1/sr.
fn phase_of_octave(octave: u32, mu: f32) -> f32 {
    let place = sqrt(clamp(0.5 * (1.0 - mu), 0.0, 1.0)) * f32(PHASE_OCTAVE_NODES - 1u);
    let n = min(u32(place), PHASE_OCTAVE_NODES - 2u);
    let i = octave * PHASE_OCTAVE_NODES + n;
    let first = 2u * PHASE_FIRST_HALF;
    let j = i + 1u;
    return mix(phase.quads[first + i / 4u][i % 4u], phase.quads[first + j / 4u][j % 4u], place - f32(n));
}

/// Share of diffuse light that passes the cloud from top to bottom where the shares `sky` and `ground` of it come from above and from below: resistances in series.
fn passage_of(sky: f32, ground: f32) -> f32 {
    return sky * ground / max(sky + ground - sky * ground, 1e-6);
}

/// Factor on light behind the first scattering at a place `depth` behind the cloud's surface towards a sun of cosine `sun`, where the share `sky` of diffuse light comes from above and the share `passed` passes the cloud; see
/// there.
fn level_share(sun: f32, depth: f32, sky: f32, passed: f32) -> f32 {
    let last = f32(OCTAVE_SHARE_NODES - 1u);
    let above = (1.0 / max(sky, 1e-3) - 1.0) / LEVEL_RESISTANCE;
    let ratio = clamp((above + LEVEL_DEPTH * sun) / (depth + LEVEL_DEPTH), sun, 1.0);
    let cosine = mix(sun, ratio, TURNED_SHARE * clamp((LEVEL_FROM - depth) / LEVEL_OVER, 0.0, 1.0));
    let between = clamp(last * cosine, 0.0, last - 1e-3);
    let passage = clamp(last * passed, 0.0, last - 1e-3);
    let i = u32(between) * OCTAVE_SHARE_NODES + u32(passage);
    let j = i + OCTAVE_SHARE_NODES;
    let rest = fract(passage);
    return mix(mix(share_at(i), share_at(i + 1u), rest), mix(share_at(j), share_at(j + 1u), rest), fract(between));
}

fn share_at(n: u32) -> f32 {
    return phase.quads[PHASE_SHARES_FIRST + n / 4u][n % 4u];
}
