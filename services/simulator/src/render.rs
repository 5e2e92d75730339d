//! A z-buffer rasteriser: depth, labels and shaded color of meshes through a pinhole.
//!
//! Meshes are closed and outward oriented, so back faces are skipped: the inside of a cup is a front face of its own. Inverse depth is
//! linear in the picture, which makes the interpolation exact. Pixel centres are at integer coordinates, as in [`Pinhole`].

use nalgebra::{Isometry3, Point3, Vector3};
use repose_geometry::{Image, Pinhole, TriMesh};

/// Nothing nearer than this is drawn; triangles are cut there.
const NEAR_PLANE_M: f32 = 0.03;

/// One mesh to draw.
#[derive(Debug, Clone, Copy)]
pub struct Drawable<'a> {
    /// Closed, outward oriented.
    pub mesh: &'a TriMesh,
    /// Where it is.
    pub world_from_mesh: Isometry3<f64>,
    /// Instance id written to the label picture.
    pub label: u16,
    /// Color in full light.
    pub color: [u8; 3],
}

/// A finished picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Depth along the optical axis, metres; 0 = nothing there.
    pub depth_m: Image<f32>,
    /// Instance ids; 0 = background.
    pub labels: Image<u16>,
    /// Shaded color.
    pub color: Image<[u8; 3]>,
}

/// The rectangle of pixels that something covers; empty when `x0 >= x1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelRect {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// One past the last column.
    pub x1: usize,
    /// One past the last row.
    pub y1: usize,
}

/// Draws everything, nearest first by depth.
pub fn picture(camera: &Pinhole, world_from_camera: &Isometry3<f64>, drawables: &[Drawable]) -> Picture {
    const SKY: [u8; 3] = [205, 212, 220];
    let mut canvas = DepthCanvas::new(camera.width, camera.height);
    let mut labels = Image::filled(camera.width, camera.height, 0u16);
    let mut color = Image::filled(camera.width, camera.height, SKY);
    let light = Light::of_camera(world_from_camera);
    for drawable in drawables {
        let camera_from_mesh = (world_from_camera.inverse() * drawable.world_from_mesh).cast::<f32>();
        let shading = light.on(drawable.mesh, &drawable.world_from_mesh, drawable.color);
        let (labels, color) = (labels.pixels_mut(), color.pixels_mut());
        canvas.draw(camera, &camera_from_mesh, drawable.mesh, |triangle, pixels| {
            let shaded = shading.of_triangle(triangle);
            for index in pixels {
                labels[*index as usize] = drawable.label;
                color[*index as usize] = shaded;
            }
        });
    }
    let depth_m = canvas.inverse_depth.into_iter().map(|w| if w > 0.0 { 1.0 / w } else { 0.0 }).collect();
    let depth_m =
        Image::from_pixels(camera.width, camera.height, depth_m).unwrap_or_else(|_| Image::filled(camera.width, camera.height, 0.0));
    Picture { depth_m, labels, color }
}

/// A distant light, and some from everywhere.
#[derive(Debug, Clone, Copy)]
pub struct Light {
    /// Unit vector towards it.
    towards_in_world: Vector3<f32>,
}

impl Light {
    /// The light above a camera's right shoulder: shading then tells faces apart in every view.
    pub fn of_camera(world_from_camera: &Isometry3<f64>) -> Self {
        let towards = world_from_camera * Vector3::new(0.45, -0.8, -0.6).normalize() + Vector3::z() * 0.6;
        Self { towards_in_world: towards.normalize().cast() }
    }

    /// How it falls on a mesh of one color.
    pub fn on<'a>(&self, mesh: &'a TriMesh, world_from_mesh: &Isometry3<f64>, color: [u8; 3]) -> Shading<'a> {
        Shading { mesh, color, towards_in_mesh: world_from_mesh.rotation.cast::<f32>().inverse_transform_vector(&self.towards_in_world) }
    }
}

/// A mesh under a light.
#[derive(Debug, Clone, Copy)]
pub struct Shading<'a> {
    mesh: &'a TriMesh,
    color: [u8; 3],
    towards_in_mesh: Vector3<f32>,
}

impl Shading<'_> {
    /// The color of a triangle.
    pub fn of_triangle(&self, triangle: usize) -> [u8; 3] {
        let [a, b, c] = self.mesh.corners(triangle);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::z);
        let brightness = 0.42 + 0.58 * normal.dot(&self.towards_in_mesh).max(0.0);
        self.color.map(|channel| (f32::from(channel) * brightness).min(255.0) as u8)
    }
}

/// A picture of inverse depth that is drawn into, and reused.
#[derive(Debug, Clone)]
pub struct DepthCanvas {
    width: usize,
    height: usize,
    /// 1/m, 0 = nothing; row-major.
    inverse_depth: Vec<f32>,
    covered: PixelRect,
    vertices: Vec<Point3<f32>>,
    written: Vec<u32>,
}

impl DepthCanvas {
    /// An empty canvas.
    pub fn new(width: usize, height: usize) -> Self {
        let covered = PixelRect { x0: width, y0: height, x1: 0, y1: 0 };
        Self { width, height, inverse_depth: vec![0.0; width * height], covered, vertices: Vec::new(), written: Vec::new() }
    }

    /// Forgets what was drawn.
    pub fn clear(&mut self) {
        let rect = self.covered;
        for y in rect.y0..rect.y1 {
            self.inverse_depth[y * self.width + rect.x0..y * self.width + rect.x1].fill(0.0);
        }
        self.covered = PixelRect { x0: self.width, y0: self.height, x1: 0, y1: 0 };
    }

    /// The rectangle that has been drawn into (it may be larger than what was drawn).
    pub fn covered(&self) -> PixelRect {
        self.covered
    }

    /// What was drawn: 1/m, 0 = nothing; row-major, as large as the canvas.
    pub fn inverse_depth(&self) -> &[f32] {
        &self.inverse_depth
    }

    /// Draws depth only.
    pub fn draw_depth(&mut self, camera: &Pinhole, camera_from_mesh: &Isometry3<f32>, mesh: &TriMesh) {
        self.draw(camera, camera_from_mesh, mesh, |_, _| ());
    }

    /// Draws a mesh and tells, triangle by triangle, which pixels it won.
    pub fn draw(&mut self, camera: &Pinhole, camera_from_mesh: &Isometry3<f32>, mesh: &TriMesh, mut won: impl FnMut(usize, &[u32])) {
        let mut vertices = std::mem::take(&mut self.vertices);
        vertices.clear();
        vertices.extend(mesh.vertices.iter().map(|v| camera_from_mesh * v));
        let lens = [camera.fx as f32, camera.fy as f32, camera.cx as f32, camera.cy as f32];
        for (index, triangle) in mesh.triangles.iter().enumerate() {
            let corners = triangle.map(|v| vertices[v as usize]);
            // Facing away, or edge-on: the camera is on the inner side of the triangle's plane.
            if (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).dot(&corners[0].coords) >= 0.0 {
                continue;
            }
            self.written.clear();
            let (clipped, count) = clipped_near(&corners);
            for k in 2..count {
                self.fill([clipped[0], clipped[k - 1], clipped[k]].map(|p| projected(&p, lens)));
            }
            if !self.written.is_empty() {
                won(index, &self.written);
            }
        }
        self.vertices = vertices;
    }

    /// Fills a triangle of (column, row, inverse depth).
    fn fill(&mut self, [a, b, c]: [[f32; 3]; 3]) {
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area.abs() < 1e-12 {
            return;
        }
        let low = |k: usize| a[k].min(b[k]).min(c[k]).ceil().max(0.0) as usize;
        let high = |k: usize, size: usize| a[k].max(b[k]).max(c[k]).floor().min(size as f32 - 1.0);
        let (x0, y0) = (low(0), low(1));
        let (x_high, y_high) = (high(0, self.width), high(1, self.height));
        if x_high < x0 as f32 || y_high < y0 as f32 {
            return;
        }
        let (x1, y1) = (x_high as usize + 1, y_high as usize + 1);
        // Inverse depth is a plane over the picture.
        let dx = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / area;
        let dy = ((c[2] - a[2]) * (b[0] - a[0]) - (b[2] - a[2]) * (c[0] - a[0])) / area;
        let orient = area.signum();
        for y in y0..y1 {
            let row = y as f32;
            let (mut from, mut to) = (x0 as f32, (x1 - 1) as f32);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                // Inside where slope * x + rest >= 0.
                let slope = -(q[1] - p[1]) * orient;
                let rest = ((q[0] - p[0]) * (row - p[1]) + (q[1] - p[1]) * p[0]) * orient;
                if slope > 0.0 {
                    from = from.max((-rest / slope).ceil());
                } else if slope < 0.0 {
                    to = to.min((-rest / slope).floor());
                } else if rest < 0.0 {
                    to = -1.0;
                }
            }
            if to < from {
                continue;
            }
            let start = y * self.width;
            let mut w = a[2] + dx * (from - a[0]) + dy * (row - a[1]);
            for x in from as usize..=to as usize {
                if w > self.inverse_depth[start + x] {
                    self.inverse_depth[start + x] = w;
                    self.written.push((start + x) as u32);
                }
                w += dx;
            }
        }
        self.covered.x0 = self.covered.x0.min(x0);
        self.covered.y0 = self.covered.y0.min(y0);
        self.covered.x1 = self.covered.x1.max(x1);
        self.covered.y1 = self.covered.y1.max(y1);
    }
}

fn projected(p: &Point3<f32>, [fx, fy, cx, cy]: [f32; 4]) -> [f32; 3] {
    [fx * p.x / p.z + cx, fy * p.y / p.z + cy, 1.0 / p.z]
}

/// The part of a triangle beyond the near plane: up to four corners in order, and how many.
fn clipped_near(corners: &[Point3<f32>; 3]) -> ([Point3<f32>; 4], usize) {
    let mut kept = [corners[0]; 4];
    let mut count = 0;
    for k in 0..3 {
        let (here, next) = (corners[k], corners[(k + 1) % 3]);
        if here.z >= NEAR_PLANE_M {
            kept[count] = here;
            count += 1;
        }
        if (here.z >= NEAR_PLANE_M) != (next.z >= NEAR_PLANE_M) {
            let t = (NEAR_PLANE_M - here.z) / (next.z - here.z);
            kept[count] = here + (next - here) * t;
            count += 1;
        }
    }
    (kept, count)
}

#[cfg(test)]
mod tests {
    use nalgebra::Translation3;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;
    use repose_geometry::transform::look_at;

    use super::*;
    use crate::objects::Family;
    use crate::objects::body::cuboid_mesh;

    const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 140.0, fy: 140.0, cx: 79.5, cy: 59.5 };

    #[test]
    fn a_wall_has_its_depth_everywhere_also_when_it_reaches_behind_the_camera() {
        let floor = cuboid_mesh(Vector3::new(20.0, 20.0, 0.5));
        let world_from_camera = look_at(&Point3::new(0.0, 0.0, 1.0), &Point3::new(0.6, 0.0, 0.0), &Vector3::z());
        let drawable = Drawable { mesh: &floor, world_from_mesh: Isometry3::translation(0.0, 0.0, -0.5), label: 3, color: [200; 3] };
        let picture = picture(&CAMERA, &world_from_camera, &[drawable]);
        for (u, v) in [(0, 0), (80, 60), (159, 119), (3, 90)] {
            let depth = f64::from(picture.depth_m[(u, v)]);
            let point = world_from_camera * CAMERA.unproject(u as f64, v as f64, depth);
            assert!(depth > 0.5 && point.z.abs() < 1e-3, "pixel {u}, {v} is {point}");
            assert_eq!(picture.labels[(u, v)], 3);
        }
    }

    #[test]
    fn the_nearer_of_two_boxes_hides_the_other_whatever_the_order() {
        let mesh = cuboid_mesh(Vector3::repeat(0.05));
        let at = |z: f64, label: u16| Drawable { mesh: &mesh, world_from_mesh: Isometry3::translation(0.0, 0.0, z), label, color: [90; 3] };
        for drawables in [[at(1.0, 1), at(0.6, 2)], [at(0.6, 2), at(1.0, 1)]] {
            let picture = picture(&CAMERA, &Isometry3::identity(), &drawables);
            assert_eq!(picture.labels[(80, 60)], 2);
            assert!((picture.depth_m[(80, 60)] - 0.55).abs() < 1e-4);
            assert_eq!((picture.labels[(0, 0)], picture.depth_m[(0, 0)]), (0, 0.0));
        }
    }

    #[test]
    fn one_looks_into_a_cup_and_sees_its_floor() {
        let mug = Family::Mug.sample(1.0, &mut Pcg64::seed_from_u64(3));
        let world_from_camera = look_at(&Point3::new(0.0, 0.001, 0.6), &Point3::origin(), &Vector3::y());
        let drawable = Drawable { mesh: &mug.mesh, world_from_mesh: Isometry3::from(Translation3::identity()), label: 1, color: [90; 3] };
        let picture = picture(&CAMERA, &world_from_camera, &[drawable]);
        // The axis of the cup is not the axis of its box: the handle sticks out.
        let lowest = (0..160)
            .flat_map(|u| (0..120).map(move |v| (u, v)))
            .filter(|&p| picture.labels[p] == 1)
            .map(|p| picture.depth_m[p])
            .fold(0.0, f32::max);
        let floor = 0.6 + mug.half_extents_m.z as f32;
        assert!(lowest < floor && lowest > floor - 0.01, "deepest {lowest}, table at {floor}");
    }
}
