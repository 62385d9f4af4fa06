// The paper's Delaunay mesh, which the CPU has built: regions, the region of each pixel, and which
// views take part. A weight is linear in the pixel's offset from the middle of the image.

// Of each pose, in units of four words: four for a region (its views; the coefficients of each one's
// weight), then the region of each pixel, then a bit for each view.
@group(0) @binding(4) var<storage, read_write> regions: array<vec4<u32>>;

const MEMBERS: u32 = 3u;
const REGION_UNITS: u32 = 4u;

struct Region {
  is_empty: bool,
  words: u32,
  place: vec3<f32>,  // x and y from the middle, 1
}

fn pixel_units() -> u32 {
  return (settings.size.x * settings.size.y + 3u) / 4u;
}

fn first_word_of(slot: u32) -> u32 {
  return slot * (REGION_UNITS * settings.regions + pixel_units() + (settings.view_count + 127u) / 128u);
}

fn build_regions(slot: u32, pose: Pose, lane: u32, lanes: u32) {}

fn takes_part(slot: u32, index: u32) -> bool {
  let first = first_word_of(slot) + REGION_UNITS * settings.regions + pixel_units();
  let bits = regions[first + index / 128u][(index / 32u) % 4u];
  return ((bits >> (index % 32u)) & 1u) == 1u;
}

fn region_of(slot: u32, pixel: vec2<u32>) -> Region {
  let first = first_word_of(slot);
  let index = pixel.y * settings.size.x + pixel.x;
  let number = regions[first + REGION_UNITS * settings.regions + index / 4u][index % 4u];
  let middle = 0.5 * (vec2<f32>(settings.size) - 1.0);
  let place = vec3(vec2<f32>(pixel) - middle, 1.0);
  return Region(number == NO_VIEW, first + REGION_UNITS * number, place);
}

fn member_of(region: Region, member: u32) -> u32 {
  return regions[region.words][member];
}

fn weight_of(region: Region, member: u32) -> f32 {
  return dot(region.place, bitcast<vec4<f32>>(regions[region.words + 1u + member]).xyz);
}
