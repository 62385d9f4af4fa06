// The unstructured-lumigraph rule (module blending): the best views at some points, those at which
// candidates are selected and the corners of the tiles; and of each tile the views of its four
// corners with their weights there.

// Of each pose, in units of four words: two for a point (views and their number; weights), then for
// each tile three of views and one of corner weights for each of these.
@group(0) @binding(4) var<storage, read_write> regions: array<vec4<u32>>;

const VIEWS_PER_CORNER: u32 = 3u;
const VIEWS_PER_TILE: u32 = 12u;
const TILE_UNITS: u32 = 15u;

const CANDIDATES: u32 = CANDIDATE_POINTS * CANDIDATE_POINTS;

fn point_count() -> u32 {
  return CANDIDATES + (settings.tiles.x + 1u) * (settings.tiles.y + 1u);
}

fn tile_count() -> u32 {
  return settings.tiles.x * settings.tiles.y;
}

fn first_word_of(slot: u32) -> u32 {
  return slot * (2u * point_count() + TILE_UNITS * tile_count());
}

fn tile_words(slot: u32, tile: u32) -> u32 {
  return first_word_of(slot) + 2u * point_count() + TILE_UNITS * tile;
}

// Pixel on which a corner of the tiles lies.
fn border(corner: vec2<u32>) -> vec2<u32> {
  return min(corner * settings.size / settings.tiles, settings.size - 1u);
}

// Whether a view may be the fallback where the chosen ones do not show a pixel.
fn takes_part(slot: u32, index: u32) -> bool {
  return true;
}

// The tile in which a pixel lies.
fn tile_of(pixel: vec2<u32>) -> vec2<u32> {
  return min(((pixel + 1u) * settings.tiles - 1u) / settings.size, settings.tiles - 1u);
}

// The chord 2 sin(angle / 2) between the rays, and what a coarser resolution costs. The angle comes
// from the vector product: a difference of cosines would leave nothing of small angles.
fn ray_penalty(view: View, pose: Pose, ray: vec3<f32>, d: f32, offset: vec3<f32>) -> f32 {
  let virtual_length = length(ray);
  let recorded_length = length(offset);
  let product = virtual_length * recorded_length;
  let baseline = centre_of_pose(pose) - centre_of_view(view);
  let sine = d * length(cross(ray, baseline)) / product;
  let cosine = dot(ray, offset) / product;
  var chord = sqrt(max(2.0 - 2.0 * cosine, 0.0));
  if (cosine > 0.0) {
    chord = sine * sqrt(2.0 / (1.0 + cosine));
  }
  return chord + RESOLUTION_PENALTY * max(recorded_length / virtual_length - 1.0, 0.0);
}

fn border_penalty(view: View, place: vec3<f32>) -> f32 {
  let size = view.photo.xy;
  let margins = min(place.xy + 0.5, size - 0.5 - place.xy);
  let margin = min(margins.x, margins.y);
  let strip = BORDER_SHARE * min(size.x, size.y);
  if (margin >= strip) {
    return 0.0;
  }
  return BORDER_PENALTY * (strip / max(margin, SMALLEST_MARGIN * strip) - 1.0);
}

fn pixel_of_point(point: u32) -> vec2<u32> {
  if (point < CANDIDATES) {
    let step = vec2(point % CANDIDATE_POINTS, point / CANDIDATE_POINTS);
    return step * (settings.size - 1u) / (CANDIDATE_POINTS - 1u);
  }
  let columns = settings.tiles.x + 1u;
  return border(vec2((point - CANDIDATES) % columns, (point - CANDIDATES) / columns));
}

// The best views of a point so far, in order; of equal ones the first of all views comes first.
struct Best {
  views: vec4<u32>,
  penalties: vec4<f32>,
}

fn comes_first(own: f32, index: u32, other: f32, other_index: u32) -> bool {
  return own < other || (own == other && index < other_index);
}

// With one more view, if it is among the best.
fn with_view(before: Best, index: u32, own: f32) -> Best {
  var best = before;
  if (!comes_first(own, index, best.penalties.w, best.views.w)) {
    return best;
  }
  best.penalties.w = own;
  best.views.w = index;
  if (comes_first(best.penalties.w, best.views.w, best.penalties.z, best.views.z)) {
    best.penalties = best.penalties.xywz;
    best.views = best.views.xywz;
  }
  if (comes_first(best.penalties.z, best.views.z, best.penalties.y, best.views.y)) {
    best.penalties = best.penalties.xzyw;
    best.views = best.views.xzyw;
  }
  if (comes_first(best.penalties.y, best.views.y, best.penalties.x, best.views.x)) {
    best.penalties = best.penalties.yxzw;
    best.views = best.views.yxzw;
  }
  return best;
}

// The same with a view's penalty worked out, if the view shows the point.
fn ranked(best: Best, index: u32, pose: Pose, ray: vec3<f32>, d: f32) -> Best {
  let view = views[index];
  let offset = offset_from_view(view, pose, ray, d);
  let place = locate(view, offset);
  if (!is_inside(view, place)) {
    return best;
  }
  if (HAS_DEPTH) {
    if (is_occluded(view, place, d)) {
      return best;
    }
  }
  return with_view(best, index, ray_penalty(view, pose, ray, d, offset) + border_penalty(view, place));
}

fn selects_candidates() -> bool {
  return settings.view_count > MOST_RANKED;
}

// Of all views, or of the candidates alone.
fn best_views(slot: u32, pose: Pose, ray: vec3<f32>, d: f32, of_all: bool) -> Best {
  var best = Best(vec4(NO_VIEW), vec4(LARGEST));
  if (of_all) {
    for (var index = 0u; index < settings.view_count; index++) {
      best = ranked(best, index, pose, ray, d);
    }
    return best;
  }
  for (var point = 0u; point < CANDIDATES; point++) {
    // The same view may be found at many points.
    let found = regions[first_word_of(slot) + 2u * point];
    if (found.w > 0u && all(best.views != vec4(found.x))) {
      best = ranked(best, found.x, pose, ray, d);
    }
  }
  return best;
}

// Writes the best views of one point, and weights with sum 1 that fall to zero where the next best
// view takes over.
fn weight_point(slot: u32, pose: Pose, point: u32) {
  let pixel = pixel_of_point(point);
  let d = surface_at(slot, pose, pixel);
  var best = Best(vec4(NO_VIEW), vec4(LARGEST));
  if (d > 0.0) {
    let ray = ray_of(pose, f32(pixel.x), f32(pixel.y));
    best = best_views(slot, pose, ray, d, point < CANDIDATES || !selects_candidates());
  }
  let penalty = best.penalties;
  var share = vec3(1.0);
  if (best.views.w != NO_VIEW) {
    share = max(1.0 - penalty.xyz / max(penalty.w, 2.0 * SMALLEST_PENALTY), vec3(0.0));
  }
  share /= max(penalty.xyz, vec3(SMALLEST_PENALTY));
  let shown = best.views.xyz != vec3(NO_VIEW);
  share = select(vec3(0.0), share, shown);
  let found = select(vec3(0u), vec3(1u), shown);
  let count = found.x + found.y + found.z;
  let total = share.x + share.y + share.z;
  if (total > 0.0) {
    share /= total;
  } else {
    share = vec3(1.0 / f32(max(count, 1u)));
  }
  let at = first_word_of(slot) + 2u * point;
  regions[at] = vec4(best.views.xyz, count);
  regions[at + 1u] = bitcast<vec4<u32>>(vec4(share, 0.0));
}

// Writes the views of a tile's corners and each one's weights at all four.
fn join_corners(slot: u32, tile: u32) {
  let columns = settings.tiles.x + 1u;
  let upper = CANDIDATES + (tile / settings.tiles.x) * columns + tile % settings.tiles.x;
  var members: array<u32, 12>;
  var weights: array<vec4<f32>, 12>;
  for (var member = 0u; member < VIEWS_PER_TILE; member++) {
    members[member] = NO_VIEW;
    weights[member] = vec4(0.0);
  }
  var count = 0u;
  for (var corner = 0u; corner < 4u; corner++) {
    let at = first_word_of(slot) + 2u * (upper + (corner >> 1u) * columns + (corner & 1u));
    let best = regions[at];
    let share = bitcast<vec4<f32>>(regions[at + 1u]);
    for (var rank = 0u; rank < best.w; rank++) {
      var member = 0u;
      while (member < count && members[member] != best[rank]) {
        member++;
      }
      if (member == count) {
        members[member] = best[rank];
        count++;
      }
      weights[member][corner] = share[rank];
    }
  }
  let at = tile_words(slot, tile);
  for (var word = 0u; word < 3u; word++) {
    let first = 4u * word;
    regions[at + word] = vec4(
      members[first], members[first + 1u], members[first + 2u], members[first + 3u]
    );
  }
  for (var member = 0u; member < count; member++) {
    regions[at + 3u + member] = bitcast<vec4<u32>>(weights[member]);
  }
}

// All steps, by one workgroup.
fn build_regions(slot: u32, pose: Pose, lane: u32, lanes: u32) {
  if (selects_candidates()) {
    for (var point = lane; point < CANDIDATES; point += lanes) {
      weight_point(slot, pose, point);
    }
    storageBarrier();
  }
  for (var point = CANDIDATES + lane; point < point_count(); point += lanes) {
    weight_point(slot, pose, point);
  }
  storageBarrier();
  for (var tile = lane; tile < tile_count(); tile += lanes) {
    join_corners(slot, tile);
  }
  storageBarrier();
}

const MEMBERS: u32 = VIEWS_PER_TILE;

struct Region {
  is_empty: bool,
  words: u32,
  shares: vec4<f32>,  // of the tile's corners at the pixel
}

fn region_of(slot: u32, pixel: vec2<u32>) -> Region {
  let tile = tile_of(pixel);
  let first = border(tile);
  let step = vec2<f32>(max(border(tile + 1u) - first, vec2(1u)));
  let s = vec2<f32>(pixel - first) / step;
  let shares = vec4((1.0 - s.x) * (1.0 - s.y), s.x * (1.0 - s.y), (1.0 - s.x) * s.y, s.x * s.y);
  return Region(false, tile_words(slot, tile.y * settings.tiles.x + tile.x), shares);
}

fn member_of(region: Region, member: u32) -> u32 {
  return regions[region.words + (member >> 2u)][member & 3u];
}

fn weight_of(region: Region, member: u32) -> f32 {
  return dot(region.shares, bitcast<vec4<f32>>(regions[region.words + 3u + member]));
}
