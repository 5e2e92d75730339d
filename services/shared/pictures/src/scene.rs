//! A scene as its own camera sees it: as it is, with its objects outlined and numbered, or with an object where it is to go.

use nalgebra::{Isometry3, Point3};
use repose_geometry::Image;
use repose_geometry::transform::from_row_major;
use repose_proto::{CallError, Scene};

use crate::Rgb;
use crate::colors::{PAPER, object_color};
use crate::drawing::write_number;
use crate::labels::label_image;
use crate::projection::{nearest_pixel, pinhole, pixel_of};

const PLACED: Rgb = [40, 200, 60];
/// Half the side of the square that a point is drawn as, pixels.
const SPLAT: i64 = 1;

/// How a scene's points are colored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coloring {
    /// As the camera saw them; by object where it saw no color.
    Seen,
    /// By object, background grey.
    Objects,
}

/// The scene seen from its own camera; `moved` names an object and where its points go. The hole that it leaves stays white.
pub fn scene_picture(scene: &Scene, coloring: Coloring, moved: Option<(u16, &Isometry3<f64>)>) -> Image<Rgb> {
    let camera = pinhole(&scene.meta.camera);
    let world_from_camera = scene.meta.camera.world_from_camera.and_then(|t| from_row_major(&t.0).ok()).unwrap_or_else(Isometry3::identity);
    let camera_from_world = world_from_camera.inverse();
    let mut picture = Image::filled(camera.width, camera.height, PAPER);
    let mut nearest = vec![f64::INFINITY; camera.width * camera.height];
    for (i, (point, &label)) in scene.points.iter().zip(&scene.labels).enumerate() {
        let mut in_world = Point3::from(*point).cast::<f64>();
        let seen = match (&scene.colors, coloring) {
            (Some(colors), Coloring::Seen) => colors[i],
            _ if label == 0 => [190; 3],
            _ => object_color(label),
        };
        let mut color = seen;
        if let Some((_, placed_from_observed)) = moved.filter(|(id, _)| *id == label) {
            in_world = placed_from_observed * in_world;
            color = std::array::from_fn(|k| ((u16::from(seen[k]) + 2 * u16::from(PLACED[k])) / 3) as u8);
        }
        let in_camera = camera_from_world * in_world;
        let Some(place) = camera.project(&in_camera) else { continue };
        let (u, v) = nearest_pixel(&place);
        for (x, y) in (v - SPLAT..=v + SPLAT).flat_map(|y| (u - SPLAT..=u + SPLAT).map(move |x| (x, y))) {
            if x < 0 || y < 0 || x >= camera.width as i64 || y >= camera.height as i64 {
                continue;
            }
            let slot = y as usize * camera.width + x as usize;
            // A splat's border must not cover a neighbour at the same depth.
            let depth = in_camera.z + if (x, y) == (u, v) { 0.0 } else { 0.002 };
            if depth < nearest[slot] {
                nearest[slot] = depth;
                picture.pixels_mut()[slot] = color;
            }
        }
    }
    picture
}

/// Writes every object's id where its centroid is; that of a moved one where it goes.
pub fn write_ids(picture: &mut Image<Rgb>, scene: &Scene, moved: Option<(u16, &Isometry3<f64>)>) {
    for object in &scene.meta.objects {
        let goes = moved.filter(|(id, _)| *id == object.id).map(|(_, placed_from_observed)| placed_from_observed);
        if let Some(at) = pixel_of(scene, &goes.map_or_else(|| object.centroid_m.into(), |goes| goes * Point3::from(object.centroid_m))) {
            write_number(picture, object.id, at);
        }
    }
}

/// The scene with every object outlined in its color and numbered.
///
/// # Errors
/// `invalid_argument` when the scene's camera has no pose.
pub fn with_numbered_outlines(scene: &Scene) -> Result<Image<Rgb>, CallError> {
    let mut picture = scene_picture(scene, Coloring::Seen, None);
    outline(&mut picture, &label_image(scene)?);
    write_ids(&mut picture, scene, None);
    Ok(picture)
}

/// The scene with an object drawn in green where it is to go, a hole where it stood, and every object's number.
pub fn with_placement(scene: &Scene, query: u16, placed_from_observed: &Isometry3<f64>) -> Image<Rgb> {
    let moved = Some((query, placed_from_observed));
    let mut picture = scene_picture(scene, Coloring::Seen, moved);
    write_ids(&mut picture, scene, moved);
    picture
}

/// Draws the borders of what a label image shows, two pixels wide: the outermost of each object and what lies beside it.
fn outline(picture: &mut Image<Rgb>, labels: &[u16]) {
    let (width, height) = (picture.width(), picture.height());
    for v in 0..height {
        for u in 0..width {
            let label = labels[v * width + u];
            let beside = [(u.wrapping_sub(1), v), (u + 1, v), (u, v.wrapping_sub(1)), (u, v + 1)];
            let inside = beside.into_iter().filter(|(u, v)| *u < width && *v < height);
            // Where two objects meet each keeps its own border.
            let other = inside.map(|(u, v)| labels[v * width + u]).find(|other| *other != label);
            if let Some(shown) = other.map(|other| if label == 0 { other } else { label }) {
                picture[(u, v)] = object_color(shown);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_made_scenes::seen_from_above;

    /// A plate of the second object on the floor, seen from above: pixels 2 to 4 in both axes.
    fn plate() -> Scene {
        let floor = (0..81).map(|i| ([(i % 9 - 4) as f32 * 0.1, (i / 9 - 4) as f32 * 0.1, 0.0], 0));
        let object = (0..9).map(|i| ([(i % 3 - 2) as f32 * 0.1, (i / 3) as f32 * 0.1, 0.001], 2));
        seen_from_above(&floor.chain(object).collect::<Vec<_>>())
    }

    #[test]
    fn an_object_is_outlined_where_the_picture_shows_it() {
        let mut picture = Image::filled(9, 9, [0; 3]);
        outline(&mut picture, &label_image(&plate()).expect("a camera with a pose"));
        let color = object_color(2);
        assert_eq!(picture[(3, 3)], [0; 3], "the inside stays as it is");
        assert!([(2, 3), (4, 3), (3, 2), (3, 4), (1, 3), (5, 3)].iter().all(|at| picture[*at] == color));
        assert!([(0, 0), (8, 8), (3, 6)].iter().all(|at| picture[*at] == [0; 3]));
    }

    #[test]
    fn what_goes_far_out_of_the_picture_is_not_drawn() {
        let scene = plate();
        let gone = scene_picture(&scene, Coloring::Objects, Some((2, &Isometry3::translation(1e300, -1e300, 0.0))));
        assert!(gone.pixels().iter().all(|color| [PAPER, [190; 3]].contains(color)));
    }

    #[test]
    fn a_moved_object_is_drawn_where_it_goes_and_its_number_with_it() {
        let scene = plate();
        let still = scene_picture(&scene, Coloring::Seen, None);
        let goes = Isometry3::translation(0.3, 0.0, 0.0);
        let moved = scene_picture(&scene, Coloring::Seen, Some((2, &goes)));
        let is_green = |c: Rgb| c[1] > c[0] + 50 && c[1] > c[2] + 50;
        assert!(is_green(moved[(6, 3)]) && !is_green(still[(6, 3)]));
        let numbered = with_placement(&scene, 2, &goes);
        assert!(numbered.pixels() != moved.pixels() && with_numbered_outlines(&scene).is_ok());
    }
}
