// A workgroup renders the view at one pose, compares it with the camera image while doing so, and
// writes one number (module comparison).

@group(0) @binding(8) var<storage, read_write> images: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> photo: array<vec4<f32>>;  // RGB; 1 where it counts, else 0.
// For EVIDENCE 1 and its row of the table; a row of zeros and the table stand behind the pixels.
@group(0) @binding(10) var<storage, read_write> costs: array<f32>;

const LANES: u32 = 64u;
const BLOCK: u32 = 8u;  // neighbouring threads take neighbouring pixels: 8 by 8

// Sums over pixels. What they are depends on the cost; see the functions below.
struct Sums {
  a: vec4<f32>,
  b: vec4<f32>,
}

var<workgroup> partial: array<Sums, LANES>;

fn summed(lane: u32, own: Sums) -> Sums {
  partial[lane] = own;
  workgroupBarrier();
  for (var half = LANES / 2u; half > 0u; half /= 2u) {
    if (lane < half) {
      partial[lane].a += partial[lane + half].a;
      partial[lane].b += partial[lane + half].b;
    }
    workgroupBarrier();
  }
  let total = partial[0];
  workgroupBarrier();
  return total;
}

fn blocks() -> vec2<u32> {
  return (settings.size + BLOCK - 1u) / BLOCK;
}

fn pixel_of(block: u32, lane: u32) -> vec2<u32> {
  let across = blocks().x;
  return BLOCK * vec2(block % across, block / across) + vec2(lane % BLOCK, lane / BLOCK);
}

fn row_by_row(pixel: vec2<u32>) -> u32 {
  return pixel.y * settings.size.x + pixel.x;
}

fn image_at(slot: u32, pixel: vec2<u32>) -> vec4<f32> {
  return images[slot * settings.size.x * settings.size.y + row_by_row(pixel)];
}

// What a pixel says for the map.
fn evidence(rendered: vec3<f32>, taken: vec4<f32>) -> f32 {
  let difference = dot(abs(rendered - taken.xyz), vec3(1.0));
  let column = u32(min(difference / EVIDENCE_BIN, f32(EVIDENCE_BINS - 1u)));
  let entry = u32(taken.w) * EVIDENCE_BINS + column;
  return photo[settings.size.x * settings.size.y + entry / 4u][entry % 4u];
}

// Adds one pixel. EVIDENCE: minus what it says. ZNCC: the sums of its formula, relative to the camera image's mean. All others,
// with e = rendered - taken: sums of e^2, rendered^2, rendered e; of what the first pass of ROBUST
// costs; of uncovered pixels.
fn counted(sums: Sums, rendered: vec4<f32>, taken: vec4<f32>) -> Sums {
  var result = sums;
  if (taken.w == 0.0) {
    return result;
  }
  if (rendered.w == 0.0) {
    result.b.y += 1.0;
    return result;
  }
  if (KIND == EVIDENCE) {
    result.a.x -= evidence(rendered.xyz, taken);
    return result;
  }
  if (KIND == ZNCC) {
    let x = rendered.xyz - settings.middle;
    let y = taken.xyz - settings.middle;
    result.a += vec4(dot(x, vec3(1.0)), dot(y, vec3(1.0)), dot(x, x), dot(y, y));
    result.b += vec4(dot(x, y), 0.0, 1.0, 0.0);
    return result;
  }
  let difference = rendered.xyz - taken.xyz;
  var fitted = vec3(1.0);
  if (KIND == ROBUST) {
    // What stands in front of the scene does not change the gain.
    fitted = select(vec3(0.0), vec3(1.0), abs(difference) < vec3(ROBUST_LIMIT));
    result.b.x += dot(min(abs(difference), vec3(ROBUST_LIMIT)), vec3(1.0));
  }
  result.a.x += dot(difference, difference);
  result.a.y += dot(fitted * rendered.xyz, rendered.xyz);
  result.a.z += dot(fitted * rendered.xyz, difference);
  return result;
}

// rendered . taken / rendered . rendered, less 1 so that nothing of small deviations is lost.
fn gain_less_one(sums: Sums) -> f32 {
  if (!FIT_GAIN || sums.a.y <= 0.0) {
    return 0.0;
  }
  return clamp(-sums.a.z / sums.a.y, 1.0 / LARGEST_GAIN - 1.0, LARGEST_GAIN - 1.0);
}

fn correlation_cost(sums: Sums) -> f32 {
  let covered = sums.b.z;
  if (covered == 0.0) {
    return UNCOVERED_ZNCC;
  }
  let share = covered / max(settings.compared, 1.0);
  let n = 3.0 * covered;
  let variance_x = sums.a.z - sums.a.x * sums.a.x / n;
  let variance_y = sums.a.w - sums.a.y * sums.a.y / n;
  var correlation = 0.0;
  // Below one grey level of contrast there is nothing to correlate.
  if (variance_x > n && variance_y > n) {
    let covariance = sums.b.x - sums.a.x * sums.a.y / n;
    correlation = covariance / (sqrt(variance_x) * sqrt(variance_y));
  }
  return share * (1.0 - correlation) / 2.0 + (1.0 - share) * UNCOVERED_ZNCC;
}

// Cost of one pixel, or of its steps to the right and down, in the second pass.
fn second_cost(slot: u32, pixel: vec2<u32>, gain: f32) -> f32 {
  let taken = photo[row_by_row(pixel)];
  if (taken.w == 0.0) {
    return 0.0;
  }
  let rendered = image_at(slot, pixel);
  if (KIND == ROBUST) {
    let difference = abs(gain * rendered.xyz - taken.xyz);
    let cost = dot(min(difference, vec3(ROBUST_LIMIT)), vec3(1.0));
    return select(3.0 * ROBUST_LIMIT * UNCOVERED_ROBUST, cost, rendered.w > 0.0);
  }
  var total = 0.0;
  for (var step = 0u; step < 2u; step++) {
    let other = pixel + vec2(1u - step, step);
    if (any(other >= settings.size)) {
      continue;
    }
    let other_taken = photo[row_by_row(other)];
    if (other_taken.w == 0.0) {
      continue;
    }
    let other_rendered = image_at(slot, other);
    if (rendered.w * other_rendered.w == 0.0) {
      total += 3.0 * GRADIENT_LIMIT * UNCOVERED_GRADIENT;
      continue;
    }
    let difference = gain * (other_rendered.xyz - rendered.xyz) - (other_taken.xyz - taken.xyz);
    total += dot(min(abs(difference), vec3(GRADIENT_LIMIT)), vec3(1.0));
  }
  return total;
}

// From the sums of the first pass, where that is all.
fn first_cost(sums: Sums) -> f32 {
  if (KIND == EVIDENCE) {
    return sums.a.x;
  }
  if (KIND == ZNCC) {
    return correlation_cost(sums);
  }
  let count = max(settings.compared, 1.0);
  if (KIND == ROBUST) {
    return sums.b.x / (3.0 * ROBUST_LIMIT * count) + sums.b.y / count * UNCOVERED_ROBUST;
  }
  let g = gain_less_one(sums);
  let total = max(sums.a.x + g * (2.0 * sums.a.z + g * sums.a.y), 0.0);
  return total / (3.0 * 255.0 * 255.0 * count) + sums.b.y / count * UNCOVERED_SQUARED;
}

@compute @workgroup_size(LANES)
fn compare(
  @builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32
) {
  let slot = group.x;
  let pose = poses[settings.first + slot];
  build_regions(slot, pose, lane, LANES);
  let block_count = blocks().x * blocks().y;
  var sums = Sums(vec4(0.0), vec4(0.0));
  for (var block = 0u; block < block_count; block++) {
    let pixel = pixel_of(block, lane);
    if (any(pixel >= settings.size)) {
      continue;
    }
    let taken = photo[row_by_row(pixel)];
    if (taken.w == 0.0) {
      continue;
    }
    let rendered = shade(slot, pose, pixel);
    sums = counted(sums, rendered, taken);
    if (TWO_PASSES) {
      images[slot * settings.size.x * settings.size.y + row_by_row(pixel)] = rendered;
    }
  }
  let first = summed(lane, sums);
  if (!TWO_PASSES) {
    if (lane == 0u) {
      costs[settings.first + slot] = first_cost(first);
    }
    return;
  }
  storageBarrier();
  let gain = 1.0 + gain_less_one(first);
  var cost = 0.0;
  for (var block = 0u; block < block_count; block++) {
    let pixel = pixel_of(block, lane);
    if (all(pixel < settings.size)) {
      cost += second_cost(slot, pixel, gain);
    }
  }
  let total = summed(lane, Sums(vec4(cost, 0.0, 0.0, 0.0), vec4(0.0))).a.x;
  if (lane == 0u) {
    var scale = 3.0 * ROBUST_LIMIT * max(settings.compared, 1.0);
    if (KIND == GRADIENT) {
      scale = 3.0 * GRADIENT_LIMIT * max(settings.compared_pairs, 1.0);
    }
    costs[settings.first + slot] = total / scale;
  }
}
