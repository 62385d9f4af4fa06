// One virtual pixel: the weighted sum of what the views of its region (tile or triangle) show.

@group(0) @binding(6) var<storage, read> areas: array<vec4<u32>>;  // of a level: x, y, width, height
@group(0) @binding(7) var texels: texture_2d_array<u32>;

// The level on which a pixel that spans ``scale`` pixels of the finest one spans about one: how
// many of sqrt(2), 2 sqrt(2), 4 sqrt(2), ... it reaches, which the square's exponent says.
fn level_of(scale: f32) -> u32 {
  let exponent = i32(bitcast<u32>(scale * scale) >> 23u) - 127;
  return u32(clamp((exponent + 1) >> 1u, 0, i32(settings.levels) - 1));
}

fn texel(place: vec2<u32>, layer: u32) -> vec3<f32> {
  return vec3<f32>(textureLoad(texels, place, layer, 0).xyz);
}

// Bilinear, RGB. Done by hand: texture units weigh in steps of 1/256.
fn sample(index: u32, view: View, place: vec3<f32>) -> vec3<f32> {
  let level = level_of(view.photo.z / (settings.focal * place.z));
  let area = areas[index * settings.levels + level];
  let size = vec2<f32>(area.zw);
  let scaled = (place.xy + 0.5) * (size / view.photo.xy) - 0.5;
  let inside = clamp(scaled, vec2(0.0), size - 1.0);
  let near = vec2<u32>(inside);
  let share = inside - vec2<f32>(near);
  let first = area.xy + near;
  let last = area.xy + min(near + 1u, area.zw - 1u);
  let layer = u32(view.photo.w);
  let upper = mix(texel(first, layer), texel(vec2(last.x, first.y), layer), share.x);
  let lower = mix(texel(vec2(first.x, last.y), layer), texel(last, layer), share.x);
  return mix(upper, lower, share.y);
}

// Projection of a view's centre, whether before or behind the virtual camera.
fn projected_centre(view: View, pose: Pose) -> vec2<f32> {
  let offset = centre_of_view(view) - centre_of_pose(pose);
  let seen = pose.x.xyz * offset.x + pose.y.xyz * offset.y + pose.z.xyz * offset.z;
  var depth = seen.z;
  let smallest = max(SMALLEST_RELATIVE_DEPTH * length(seen), 1.0e-30);
  if (abs(depth) < smallest) {
    depth = smallest;
  }
  return settings.pinhole.xy * seen.xy / depth + settings.pinhole.zw;
}

// What the fallback view shows: of those that show the pixel the one with the nearest projected
// centre; an occluded one only where all are.
fn fallback(
  slot: u32, pose: Pose, pixel: vec2<f32>, ray: vec3<f32>, d: f32
) -> vec4<f32> {
  var best = NO_VIEW;
  var shortest = LARGEST;
  var best_is_hidden = true;
  for (var index = 0u; index < settings.view_count; index++) {
    if (!takes_part(slot, index)) {
      continue;
    }
    let view = views[index];
    let place = locate(view, offset_from_view(view, pose, ray, d));
    if (!is_inside(view, place)) {
      continue;
    }
    let away = projected_centre(view, pose) - pixel;
    let distance = dot(away, away);
    var is_hidden = false;
    if (HAS_DEPTH) {
      is_hidden = is_occluded(view, place, d);
    }
    let is_first = best == NO_VIEW || (best_is_hidden && !is_hidden);
    if (is_first || (is_hidden == best_is_hidden && distance < shortest)) {
      best = index;
      shortest = distance;
      best_is_hidden = is_hidden;
    }
  }
  if (best == NO_VIEW) {
    return vec4(0.0);
  }
  let view = views[best];
  let place = locate(view, offset_from_view(view, pose, ray, d));
  return vec4(sample(best, view, place), 1.0);
}

// RGB in 0 to 255 and 1, or all zero where no view shows the pixel.
fn shade(slot: u32, pose: Pose, pixel: vec2<u32>) -> vec4<f32> {
  let d = surface_at(slot, pose, pixel);
  if (d <= 0.0) {
    return vec4(0.0);
  }
  let place_on_screen = vec2<f32>(pixel);
  let ray = ray_of(pose, place_on_screen.x, place_on_screen.y);
  let region = region_of(slot, pixel);
  if (region.is_empty) {
    return vec4(0.0);
  }
  var total = vec4(0.0);
  for (var member = 0u; member < MEMBERS; member++) {
    let index = member_of(region, member);
    if (index == NO_VIEW) {
      break;
    }
    let weight = weight_of(region, member);
    if (weight <= 0.0) {
      continue;
    }
    let view = views[index];
    let place = locate(view, offset_from_view(view, pose, ray, d));
    if (!is_inside(view, place)) {
      continue;
    }
    if (HAS_DEPTH) {
      if (is_occluded(view, place, d)) {
        continue;
      }
    }
    total += weight * vec4(sample(index, view, place), 1.0);
  }
  if (total.w > SMALLEST_WEIGHT) {
    return vec4(total.xyz / total.w, 1.0);
  }
  return fallback(slot, pose, place_on_screen, ray, d);
}
