// The tiles of virtual images, a thread for each point of the outlook, for each corner, then for each
// tile; z counts the poses.

@compute @workgroup_size(64)
fn narrow(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x < OUTLOOK && is_narrowed()) {
    weigh_point(id.z, poses[settings.first + id.z], id.x);
  }
}

@compute @workgroup_size(64)
fn weigh(@builtin(global_invocation_id) id: vec3<u32>) {
  if (OUTLOOK + id.x < point_count()) {
    weigh_point(id.z, poses[settings.first + id.z], OUTLOOK + id.x);
  }
}

@compute @workgroup_size(64)
fn join(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x < tile_count()) {
    join_corners(id.z, id.x);
  }
}
