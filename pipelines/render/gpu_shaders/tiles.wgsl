// The tiles of virtual images: a thread for each point at which candidate views are selected, for
// each corner, then for each tile; z counts the poses.

@compute @workgroup_size(64)
fn select_candidates(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x < CANDIDATES && selects_candidates()) {
    weight_point(id.z, poses[settings.first + id.z], id.x);
  }
}

@compute @workgroup_size(64)
fn weight_corners(@builtin(global_invocation_id) id: vec3<u32>) {
  if (CANDIDATES + id.x < point_count()) {
    weight_point(id.z, poses[settings.first + id.z], CANDIDATES + id.x);
  }
}

@compute @workgroup_size(64)
fn join_tiles(@builtin(global_invocation_id) id: vec3<u32>) {
  if (id.x < tile_count()) {
    join_corners(id.z, id.x);
  }
}
