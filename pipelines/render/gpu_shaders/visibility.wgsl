// Which views see any of a grid of surface points of the virtual frustum: only these are in
// the mesh.

@group(0) @binding(4) var<storage, read_write> visible: array<u32>;

@compute @workgroup_size(64)
fn find_visible(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x >= settings.view_count) {
    return;
  }
  let pose = poses[settings.first + id.z];
  let view = views[id.x];
  var seen = 0u;
  for (var sample = 0u; sample < FRUSTUM_SAMPLES * FRUSTUM_SAMPLES; sample++) {
    let step = vec2(sample % FRUSTUM_SAMPLES, sample / FRUSTUM_SAMPLES);
    let pixel = step * (settings.size - 1u) / (FRUSTUM_SAMPLES - 1u);
    let d = surface_at(id.z, pose, pixel);
    if (d > 0.0) {
      let ray = ray_of(pose, f32(pixel.x), f32(pixel.y));
      let place = locate(view, offset_from_view(view, pose, ray, d));
      seen |= u32(is_inside(view, place));
    }
  }
  visible[id.z * settings.view_count + id.x] = seen;
}
