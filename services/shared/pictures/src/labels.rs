//! Which object each pixel of a scene's picture shows.
//!
//! The label image comes from the scene, not from the frame: every point of the cloud is projected into the camera, so a click means the object
//! that will be planned with, whoever segmented it. Borders, which perception leaves out, are filled from their neighbours.

use nalgebra::Point3;
use repose_geometry::transform::from_row_major;
use repose_proto::{CallError, Scene};

use crate::projection::pinhole;

/// How far the label of an object is carried over pixels that show nobody, pixels.
const FILL_PX: usize = 3;

/// The object that each pixel shows, row by row, 0 = none.
///
/// # Errors
/// `invalid_argument` when the scene's camera has no pose.
pub fn label_image(scene: &Scene) -> Result<Vec<u16>, CallError> {
    let camera = &scene.meta.camera;
    let lost = || CallError::invalid("scene.camera.world_from_camera", "a scene's camera must have a pose");
    let pose = camera.world_from_camera.ok_or_else(lost)?;
    let camera_from_world = from_row_major(&pose.0).map_err(|_| lost())?.inverse();
    let (rotation, offset) = (camera_from_world.rotation.to_rotation_matrix(), camera_from_world.translation.vector);
    let pinhole = pinhole(camera);
    let mut labels = vec![0; camera.width * camera.height];
    // Of several points on one pixel the nearest is seen.
    let mut nearest = vec![f32::INFINITY; labels.len()];
    for (point, label) in scene.points.iter().zip(&scene.labels) {
        let point_in_camera = Point3::from(rotation * Point3::from(point.map(f64::from)).coords + offset);
        let Some((u, v)) = pinhole.pixel_of(&point_in_camera) else { continue };
        let at = v * camera.width + u;
        let depth = point_in_camera.z as f32;
        if depth < nearest[at] {
            (nearest[at], labels[at]) = (depth, *label);
        }
    }
    // Furniture was seen there: nobody's label is carried over it.
    let is_open: Vec<bool> = nearest.iter().map(|d| !d.is_finite()).collect();
    fill(&mut labels, &is_open, camera.width);
    Ok(labels)
}

/// Carries labels over open pixels beside them, [`FILL_PX`] far.
fn fill(labels: &mut [u16], is_open: &[bool], width: usize) {
    let height = labels.len() / width.max(1);
    let mut edge: Vec<usize> = (0..labels.len()).filter(|at| labels[*at] != 0).collect();
    for _ in 0..FILL_PX {
        let mut next = Vec::new();
        for at in edge {
            let (u, v) = (at % width, at / width);
            let beside =
                [(u > 0, at.wrapping_sub(1)), (u + 1 < width, at + 1), (v > 0, at.wrapping_sub(width)), (v + 1 < height, at + width)];
            for (is_inside, other) in beside {
                if is_inside && is_open[other] && labels[other] == 0 {
                    labels[other] = labels[at];
                    next.push(other);
                }
            }
        }
        edge = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_made_scenes::seen_from_above;

    #[test]
    fn a_pixel_shows_the_nearest_object_and_open_borders_are_filled() {
        // Straight down from 1 m on a 9 x 9 picture whose middle pixel is (4, 4): one pixel is 0.1 m at the floor.
        let mut scene = seen_from_above(&[([0.0, 0.0, 0.0], 1), ([0.0, 0.0, 0.2], 2), ([0.3, 0.0, 0.0], 0)]);
        scene.meta.camera.width = 9;
        scene.meta.camera.height = 9;
        let labels = label_image(&scene).expect("a camera with a pose");
        let at = |u: usize, v: usize| labels[v * 9 + u];
        assert_eq!(at(4, 4), 2, "the higher point hides the lower one");
        assert_eq!((at(4, 1), at(1, 4), at(6, 3)), (2, 2, 2), "the open surroundings are filled");
        assert_eq!(at(7, 4), 0, "furniture was seen there");
        assert_eq!(at(0, 0), 0, "too far to be a border");
    }
}
