// Virtual images, a thread for each pixel; z counts the poses.

@group(0) @binding(8) var<storage, read_write> images: array<vec4<f32>>;

@compute @workgroup_size(8, 8)
fn draw(@builtin(global_invocation_id) id: vec3<u32>) {
  if (all(id.xy < settings.size)) {
    let first = id.z * settings.size.x * settings.size.y;
    let pose = poses[settings.first + id.z];
    images[first + id.y * settings.size.x + id.x] = shade(id.z, pose, id.xy);
  }
}
