// The unstructured-lumigraph rule (module blending): the best views at the corners of the tiles,
// and of each tile the views of its four corners with their weights there.

// Of each pose: two words of four for a corner (views and their number; weights), then for each
// tile three words of views and one word of corner weights for each of these.
@group(0) @binding(4) var<storage, read_write> workspace: array<vec4<u32>>;

const VIEWS_PER_CORNER: u32 = 3u;
const VIEWS_PER_TILE: u32 = 12u;
const TILE_WORDS: u32 = 15u;

fn corner_count() -> u32 {
  return (settings.tiles.x + 1u) * (settings.tiles.y + 1u);
}

fn tile_count() -> u32 {
  return settings.tiles.x * settings.tiles.y;
}

fn workspace_of(slot: u32) -> u32 {
  return slot * (2u * corner_count() + TILE_WORDS * tile_count());
}

fn tile_words(slot: u32, tile: u32) -> u32 {
  return workspace_of(slot) + 2u * corner_count() + TILE_WORDS * tile;
}

// Pixel on which a corner of the tiles lies.
fn border(corner: vec2<u32>) -> vec2<u32> {
  return min(corner * settings.size / settings.tiles, settings.size - 1u);
}

// Whether a view may stand in where the chosen ones do not show a pixel.
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

// Writes the best views of one corner, and weights with sum 1 that fall to zero where the next best
// view takes over.
fn weigh_corner(slot: u32, pose: Pose, corner: u32) {
  let columns = settings.tiles.x + 1u;
  let pixel = border(vec2(corner % columns, corner / columns));
  let d = surface_at(slot, pose, pixel);
  let ray = ray_of(pose, f32(pixel.x), f32(pixel.y));
  var best = vec4(NO_VIEW);
  var penalty = vec4(LARGEST);
  var found = 0u;
  if (d > 0.0) {
    for (var index = 0u; index < settings.view_count; index++) {
      let view = views[index];
      let offset = offset_from_view(view, pose, ray, d);
      let place = locate(view, offset);
      if (!is_inside(view, place)) {
        continue;
      }
      if (HAS_DEPTH) {
        if (is_occluded(view, place, d)) {
          continue;
        }
      }
      found++;
      let own = ray_penalty(view, pose, ray, d, offset) + border_penalty(view, place);
      // Four in order; the first found stays before an equal one.
      if (own < penalty.w) {
        penalty.w = own;
        best.w = index;
        if (penalty.w < penalty.z) {
          penalty = penalty.xywz;
          best = best.xywz;
        }
        if (penalty.z < penalty.y) {
          penalty = penalty.xzyw;
          best = best.xzyw;
        }
        if (penalty.y < penalty.x) {
          penalty = penalty.yxzw;
          best = best.yxzw;
        }
      }
    }
  }
  var share = vec3(1.0);
  if (found > VIEWS_PER_CORNER) {
    share = max(1.0 - penalty.xyz / max(penalty.w, 2.0 * SMALLEST_PENALTY), vec3(0.0));
  }
  share /= max(penalty.xyz, vec3(SMALLEST_PENALTY));
  let count = min(found, VIEWS_PER_CORNER);
  share = select(vec3(0.0), share, vec3(0u, 1u, 2u) < vec3(count));
  let total = share.x + share.y + share.z;
  if (total > 0.0) {
    share /= total;
  } else {
    share = vec3(1.0 / f32(max(count, 1u)));
  }
  let at = workspace_of(slot) + 2u * corner;
  workspace[at] = vec4(best.xyz, count);
  workspace[at + 1u] = bitcast<vec4<u32>>(vec4(share, 0.0));
}

// Writes the views of a tile's corners and each one's weights at all four.
fn join_corners(slot: u32, tile: u32) {
  let columns = settings.tiles.x + 1u;
  let upper = (tile / settings.tiles.x) * columns + tile % settings.tiles.x;
  var members: array<u32, 12>;
  var weights: array<vec4<f32>, 12>;
  for (var member = 0u; member < VIEWS_PER_TILE; member++) {
    members[member] = NO_VIEW;
    weights[member] = vec4(0.0);
  }
  var count = 0u;
  for (var corner = 0u; corner < 4u; corner++) {
    let at = workspace_of(slot) + 2u * (upper + (corner >> 1u) * columns + (corner & 1u));
    let best = workspace[at];
    let share = bitcast<vec4<f32>>(workspace[at + 1u]);
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
    workspace[at + word] = vec4(
      members[first], members[first + 1u], members[first + 2u], members[first + 3u]
    );
  }
  for (var member = 0u; member < count; member++) {
    workspace[at + 3u + member] = bitcast<vec4<u32>>(weights[member]);
  }
}

// Both steps, by one workgroup.
fn build_cells(slot: u32, pose: Pose, lane: u32, lanes: u32) {
  for (var corner = lane; corner < corner_count(); corner += lanes) {
    weigh_corner(slot, pose, corner);
  }
  storageBarrier();
  for (var tile = lane; tile < tile_count(); tile += lanes) {
    join_corners(slot, tile);
  }
  storageBarrier();
}

const MEMBERS: u32 = VIEWS_PER_TILE;

struct Cell {
  is_empty: bool,
  words: u32,
  shares: vec4<f32>,  // of the tile's corners at the pixel
}

fn cell_of(slot: u32, pixel: vec2<u32>) -> Cell {
  let tile = tile_of(pixel);
  let first = border(tile);
  let step = vec2<f32>(max(border(tile + 1u) - first, vec2(1u)));
  let s = vec2<f32>(pixel - first) / step;
  let shares = vec4((1.0 - s.x) * (1.0 - s.y), s.x * (1.0 - s.y), (1.0 - s.x) * s.y, s.x * s.y);
  return Cell(false, tile_words(slot, tile.y * settings.tiles.x + tile.x), shares);
}

fn member_of(cell: Cell, member: u32) -> u32 {
  return workspace[cell.words + (member >> 2u)][member & 3u];
}

fn weight_of(cell: Cell, member: u32) -> f32 {
  return dot(cell.shares, bitcast<vec4<f32>>(workspace[cell.words + 3u + member]));
}
