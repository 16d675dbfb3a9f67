//! use view/march
// Stage `layers`: what a client needs to put objects into a picture. The twin is cpu/view/layers.rs.
//
// Six numbers a pixel go where the picture would, and the objects' distances lie behind them in the same buffer, since the march binds all eight
// storage buffers that WebGPU grants.

@group(0) @binding(13) var<uniform> layering: Layering;

@compute @workgroup_size(8, 8)
fn layers(@builtin(global_invocation_id) id: vec3<u32>) {
    let y = id.y + frame.first_row;
    if (id.x >= frame.width || y >= frame.height) {
        return;
    }
    let pixel = y * frame.width + id.x;
    let ray = ray_of(vec2<f32>(f32(id.x), f32(y)) + 0.5);
    var limit_m = NEVER;
    if (layering.objects != 0u) {
        let object_m = bitcast<f32>(picture[layering.objects_at + pixel]);
        limit_m = select(NEVER, object_m, object_m < ray.end);
    }
    let behind = behind_of(ray);
    var met = Met(vec3<f32>(0.0), 1.0, 0.0);
    if (frame.cloud != 0u) {
        met = march_before(ray, limit_m);
    }
    let kept = 1.0 - faded(met.distance_m);
    var seen = composed(ray, behind, met);
    var through = 0.0;
    if (limit_m < NEVER) {
        let to_cloud = air_to(met.distance_m, ray, behind);
        let to_object = air_to(limit_m, ray, behind);
        let covered = (1.0 - met.through) * to_cloud.added + met.light * to_cloud.passed + to_object.added * met.through;
        seen = shaded(ray, met, limit_m, mix(to_object.added, covered, kept));
        let passed = mix(to_object.passed, to_object.passed * met.through, kept);
        through = (passed.r + passed.g + passed.b) / 3.0;
    }
    seen *= exposed();
    let at = pixel * LAYER_NUMBERS;
    picture[at] = bitcast<u32>(seen.r);
    picture[at + 1u] = bitcast<u32>(seen.g);
    picture[at + 2u] = bitcast<u32>(seen.b);
    picture[at + 3u] = bitcast<u32>(through);
    picture[at + 4u] = bitcast<u32>(met.distance_m);
    picture[at + 5u] = bitcast<u32>((1.0 - met.through) * kept);
}
