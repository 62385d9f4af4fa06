// The paper's net of triangles, which the CPU has cut: cells, each pixel's cell, and which views
// take part. A weight is linear in the pixel's offset from the middle of the image.

// Of each pose: four words of four for a cell (its views; the coefficients of each one's weight),
// then the pixels' cells, then a bit for each view.
@group(0) @binding(4) var<storage, read_write> workspace: array<vec4<u32>>;

const MEMBERS: u32 = 3u;
const CELL_WORDS: u32 = 4u;

struct Cell {
  is_empty: bool,
  words: u32,
  place: vec3<f32>,  // x and y from the middle, 1
}

fn label_words() -> u32 {
  return (settings.size.x * settings.size.y + 3u) / 4u;
}

fn workspace_of(slot: u32) -> u32 {
  return slot * (CELL_WORDS * settings.cells + label_words() + (settings.view_count + 127u) / 128u);
}

fn build_cells(slot: u32, pose: Pose, lane: u32, lanes: u32) {}

fn takes_part(slot: u32, index: u32) -> bool {
  let first = workspace_of(slot) + CELL_WORDS * settings.cells + label_words();
  let bits = workspace[first + index / 128u][(index / 32u) % 4u];
  return ((bits >> (index % 32u)) & 1u) == 1u;
}

fn cell_of(slot: u32, pixel: vec2<u32>) -> Cell {
  let first = workspace_of(slot);
  let index = pixel.y * settings.size.x + pixel.x;
  let label = workspace[first + CELL_WORDS * settings.cells + index / 4u][index % 4u];
  let middle = 0.5 * (vec2<f32>(settings.size) - 1.0);
  let place = vec3(vec2<f32>(pixel) - middle, 1.0);
  return Cell(label == NO_VIEW, first + CELL_WORDS * label, place);
}

fn member_of(cell: Cell, member: u32) -> u32 {
  return workspace[cell.words][member];
}

fn weight_of(cell: Cell, member: u32) -> f32 {
  return dot(cell.place, bitcast<vec4<f32>>(workspace[cell.words + 1u + member]).xyz);
}
