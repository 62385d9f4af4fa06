// The surface that the photos' depth maps describe, seen from each pose (module surface): a
// workgroup splats the depth maps of the nearest views onto a depth grid and interpolates in it.

struct Source {
  x: vec4<f32>,  // rows of the matrix from pixels to world directions, the axis in the last column
  y: vec4<f32>,
  z: vec4<f32>,
  step: vec4<u32>,  // from one projected depth pixel to the next, in parts of one
}

@group(0) @binding(4) var<storage, read> sources: array<Source>;
@group(0) @binding(5) var<storage, read_write> surfaces: array<f32>;
// Inverse depths, not negative, so that their bits are in order; two grids for each pose.
@group(0) @binding(6) var<storage, read_write> grids: array<atomic<u32>>;

const LANES: u32 = 64u;

var<workgroup> smallest: array<vec2<f32>, LANES>;  // cost and view
var<workgroup> is_filled: atomic<u32>;

fn source_cost(index: u32, pose: Pose) -> f32 {
  let source = sources[index];
  let distance = length(centre_of_view(views[index]) - centre_of_pose(pose));
  let axis = vec3(source.x.w, source.y.w, source.z.w);
  // Two unit vectors: their distance is sqrt(2 - 2 cosine).
  let rotation = length(axis - vec3(pose.x.z, pose.y.z, pose.z.z));
  return distance * settings.typical_inverse_depth + ROTATION_COST * rotation;
}

fn is_before(a: vec2<f32>, b: vec2<f32>) -> bool {
  return a.x < b.x || (a.x == b.x && a.y < b.y);
}

// The next view in the order of costs after ``previous``; its number is view_count when there is
// none.
fn next_source(lane: u32, pose: Pose, previous: vec2<f32>) -> vec2<f32> {
  var best = vec2(LARGEST, f32(settings.view_count));
  for (var index = lane; index < settings.view_count; index += LANES) {
    let own = vec2(source_cost(index, pose), f32(index));
    if (depth_map_size(views[index]).x > 0u && is_before(previous, own) && is_before(own, best)) {
      best = own;
    }
  }
  smallest[lane] = best;
  workgroupBarrier();
  for (var half = LANES / 2u; half > 0u; half /= 2u) {
    if (lane < half) {
      if (is_before(smallest[lane + half], smallest[lane])) {
        smallest[lane] = smallest[lane + half];
      }
    }
    workgroupBarrier();
  }
  let first = smallest[0];
  workgroupBarrier();
  return first;
}

fn grid_vertices() -> u32 {
  return settings.grid_size.x * settings.grid_size.y;
}

fn grid_value(first: u32, vertex: vec2<u32>) -> f32 {
  return bitcast<f32>(atomicLoad(&grids[first + vertex.y * settings.grid_size.x + vertex.x]));
}

// Into the virtual camera, homogeneous pixels.
fn project(pose: Pose, direction: vec3<f32>) -> vec3<f32> {
  let seen =
    pose.x.xyz * direction.x + pose.y.xyz * direction.y + pose.z.xyz * direction.z;
  return vec3(settings.pinhole.xy * seen.xy + settings.pinhole.zw * seen.z, seen.z);
}

// Splats one depth map: each vertex keeps the nearest of its points.
fn splat(lane: u32, first: u32, pose: Pose, index: u32) {
  let view = views[index];
  let source = sources[index];
  let sample_step = source.step.x;
  let size = depth_map_size(view);
  let scale = view.photo.xy / vec2<f32>(size);
  let count = (size * PIXEL_PARTS + sample_step - 1u) / sample_step;
  let shift = project(pose, centre_of_view(view) - centre_of_pose(pose));
  // The columns of the matrix from the view's pixels to virtual ones.
  let x = project(pose, vec3(source.x.x, source.y.x, source.z.x));
  let y = project(pose, vec3(source.x.y, source.y.y, source.z.y));
  let one = project(pose, vec3(source.x.z, source.y.z, source.z.z));
  for (var sample = lane; sample < count.x * count.y; sample += LANES) {
    let depth_pixel = sample_step * vec2(sample % count.x, sample / count.x) / PIXEL_PARTS;
    let value = depth_at(view, depth_pixel);
    if (value <= 0.0) {
      continue;
    }
    let pixel = (vec2<f32>(depth_pixel) + 0.5) * scale - 0.5;
    let target_pixel = x * pixel.x + y * pixel.y + one + value * shift;
    if (target_pixel.z <= 1.0e-9) {
      continue;
    }
    let place = target_pixel.xy / target_pixel.z / settings.spacing + 0.5;
    if (all(place >= vec2(0.0)) && all(place < vec2<f32>(settings.grid_size))) {
      let vertex = vec2<u32>(place);
      let at = first + vertex.y * settings.grid_size.x + vertex.x;
      atomicMax(&grids[at], bitcast<u32>(value / target_pixel.z));
    }
  }
}

// Empty where a vertex shows the background through a gap between foreground points.
fn without_pinhole(first: u32, vertex: vec2<u32>) -> f32 {
  let own = grid_value(first, vertex);
  let low = max(vertex, vec2(1u)) - 1u;
  let high = min(vertex + 2u, settings.grid_size);
  var nearer = 0u;
  for (var row = low.y; row < high.y; row++) {
    for (var column = low.x; column < high.x; column++) {
      if (grid_value(first, vec2(column, row)) > PINHOLE_FACTOR * own) {
        nearer++;
      }
    }
  }
  return select(own, 0.0, nearer >= PINHOLE_NEIGHBOURS);
}

// The farthest known neighbour of an empty vertex.
fn filled(first: u32, vertex: vec2<u32>) -> f32 {
  let own = grid_value(first, vertex);
  if (own > 0.0) {
    return own;
  }
  let low = max(vertex, vec2(1u)) - 1u;
  let high = min(vertex + 2u, settings.grid_size);
  var farthest = LARGEST;
  for (var row = low.y; row < high.y; row++) {
    for (var column = low.x; column < high.x; column++) {
      let other = grid_value(first, vec2(column, row));
      if (other > 0.0) {
        farthest = min(farthest, other);
      }
    }
  }
  return select(0.0, farthest, farthest < LARGEST);
}

// Bilinear between vertices of one surface; across a depth edge, or a hole, the nearest vertex.
fn interpolated(first: u32, place: vec2<f32>) -> f32 {
  let last = settings.grid_size - 1u;
  let near = min(vec2<u32>(place), last);
  let far = min(near + 1u, last);
  let share = place - vec2<f32>(near);
  let a = grid_value(first, near);
  let b = grid_value(first, vec2(far.x, near.y));
  let c = grid_value(first, vec2(near.x, far.y));
  let d = grid_value(first, far);
  let lowest = min(min(a, b), min(c, d));
  let highest = max(max(a, b), max(c, d));
  if (lowest > 0.0 && highest <= EDGE_FACTOR * lowest) {
    return mix(mix(a, b, share.x), mix(c, d, share.x), share.y);
  }
  return grid_value(first, select(far, near, share < vec2(0.5)));
}

@compute @workgroup_size(LANES)
fn build_surface(
  @builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32
) {
  let slot = group.x;
  let pose = poses[settings.first + slot];
  let count = grid_vertices();
  var current = 2u * slot * count;
  var other = current + count;
  for (var vertex = lane; vertex < count; vertex += LANES) {
    atomicStore(&grids[current + vertex], 0u);
  }
  storageBarrier();
  // No loop with barriers in it ends early: not every compiler sees that all threads agree.
  var source = vec2(-1.0, -1.0);
  for (var number = 0u; number < SOURCE_VIEWS; number++) {
    source = next_source(lane, pose, source);
    if (u32(source.y) < settings.view_count) {
      splat(lane, current, pose, u32(source.y));
    }
  }
  storageBarrier();
  var is_open = true;
  for (var round = 0u; round <= settings.grid_rounds; round++) {
    if (lane == 0u) {
      atomicStore(&is_filled, 0u);
    }
    workgroupBarrier();
    if (is_open) {
      for (var vertex = lane; vertex < count; vertex += LANES) {
        let place = vec2(vertex % settings.grid_size.x, vertex / settings.grid_size.x);
        var value = 0.0;
        if (round == 0u) {
          value = without_pinhole(current, place);
          atomicStore(&is_filled, 1u);
        } else {
          value = filled(current, place);
          if (value > grid_value(current, place)) {
            atomicStore(&is_filled, 1u);
          }
        }
        atomicStore(&grids[other + vertex], bitcast<u32>(value));
      }
      let swapped = current;
      current = other;
      other = swapped;
    }
    storageBarrier();
    workgroupBarrier();
    is_open = atomicLoad(&is_filled) > 0u;
    workgroupBarrier();
  }
  let pixels = settings.size.x * settings.size.y;
  for (var pixel = lane; pixel < pixels; pixel += LANES) {
    let place = vec2<f32>(vec2(pixel % settings.size.x, pixel / settings.size.x));
    surfaces[slot * pixels + pixel] = interpolated(current, place / settings.spacing);
  }
}
