// The surface's inverse depth at a virtual pixel; 0: none.

@group(0) @binding(5) var<storage, read> surfaces: array<f32>;  // from surface.wgsl

fn surface_at(slot: u32, pose: Pose, pixel: vec2<u32>) -> f32 {
  if (HAS_DEPTH) {
    return surfaces[(slot * settings.size.y + pixel.y) * settings.size.x + pixel.x];
  }
  let height = dot(settings.plane.xyz, centre_of_pose(pose)) + settings.plane.w;
  if (height <= 0.0) {
    return 0.0;
  }
  let ray = ray_of(pose, f32(pixel.x), f32(pixel.y));
  return max(-dot(settings.plane.xyz, ray) / height, 0.0);
}
