// What all programs share: where the virtual cameras and the photos are, and how they see points.
// Lengths are metres from the photos' middle, so that single precision is enough.

struct Settings {
  size: vec2<u32>,  // of the virtual image, pixels
  tiles: vec2<u32>,  // across and down
  pinhole: vec4<f32>,  // fx, fy, cx, cy of the virtual camera
  plane: vec4<f32>,  // unit normal and offset
  first: u32,  // pose of the first workgroup
  view_count: u32,
  levels: u32,  // of the pyramids
  grid_rounds: u32,  // holes of the depth grid are filled in so many rounds
  grid_size: vec2<u32>,
  spacing: f32,  // of the depth grid's vertices, pixels
  focal: f32,  // mean of fx and fy
  compared: f32,  // pixels of the camera image that count
  compared_pairs: f32,  // neighbours of which both count
  middle: f32,  // mean of the camera image, grey levels
  typical_inverse_depth: f32,
  regions: u32,  // of each Delaunay mesh
}

struct Pose {  // world_from_camera: rows of the rotation, the centre in the last column
  x: vec4<f32>,
  y: vec4<f32>,
  z: vec4<f32>,
}

struct View {
  x: vec4<f32>,  // rows of the projection's left 3x3 block, the centre in the last column
  y: vec4<f32>,
  z: vec4<f32>,
  photo: vec4<f32>,  // width, height, focal length, layer
  depth: vec4<u32>,  // column, row, width + height * 65536, layer of the depth map; width 0: none
}

@group(0) @binding(0) var<uniform> settings: Settings;
@group(0) @binding(1) var<storage, read> poses: array<Pose>;
@group(0) @binding(2) var<storage, read> views: array<View>;
@group(0) @binding(3) var depths: texture_2d_array<f32>;

const LARGEST: f32 = 3.0e38;
const NO_VIEW: u32 = 0xffffffffu;

fn centre_of_pose(pose: Pose) -> vec3<f32> {
  return vec3(pose.x.w, pose.y.w, pose.z.w);
}

fn centre_of_view(view: View) -> vec3<f32> {
  return vec3(view.x.w, view.y.w, view.z.w);
}

// World direction of a virtual pixel, of length 1 along the optical axis.
fn ray_of(pose: Pose, x: f32, y: f32) -> vec3<f32> {
  let pinhole = settings.pinhole;
  let ray = vec3((x - pinhole.z) / pinhole.x, (y - pinhole.w) / pinhole.y, 1.0);
  return vec3(dot(pose.x.xyz, ray), dot(pose.y.xyz, ray), dot(pose.z.xyz, ray));
}

// From a view's centre to the point at inverse depth d on a virtual ray, times d: finite for points
// at infinity.
fn offset_from_view(view: View, pose: Pose, ray: vec3<f32>, d: f32) -> vec3<f32> {
  return ray + d * (centre_of_pose(pose) - centre_of_view(view));
}

// Column and row in a view, and the depth there divided by the virtual depth; 0: behind the view.
fn locate(view: View, offset: vec3<f32>) -> vec3<f32> {
  let depth = dot(view.z.xyz, offset);
  if (depth <= 0.0) {
    return vec3(0.0);
  }
  return vec3(dot(view.x.xyz, offset) / depth, dot(view.y.xyz, offset) / depth, depth);
}

fn is_inside(view: View, place: vec3<f32>) -> bool {
  return place.z > 0.0 && all(place.xy >= vec2(-0.5)) && all(place.xy <= view.photo.xy - 0.5);
}

fn depth_map_size(view: View) -> vec2<u32> {
  return vec2(view.depth.z & 0xffffu, view.depth.z >> 16u);
}

fn depth_at(view: View, place: vec2<u32>) -> f32 {
  return textureLoad(depths, view.depth.xy + place, view.depth.w, 0).x;
}

// Whether a view sees something nearer than the point at ``place``, of virtual inverse depth d.
fn is_occluded(view: View, place: vec3<f32>, d: f32) -> bool {
  let size = depth_map_size(view);
  if (size.x == 0u) {
    return false;
  }
  let scaled = (place.xy + 0.5) * (vec2<f32>(size) / view.photo.xy);
  let seen = depth_at(view, min(vec2<u32>(max(scaled, vec2(0.0))), size - 1u));
  return seen > OCCLUSION_FACTOR * (d / place.z);
}
