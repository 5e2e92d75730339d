//! The tile of one scene: what the camera sees of it, and what holds in it.

use repose_geometry::{Image, ViewerFrame};
use repose_pictures::colors::{depth_colors, label_colors};
use repose_pictures::drawing;

use super::words::relations_in_words;
use super::{Rgb, SheetSettings, tile};
use crate::render::Picture;
use crate::scene::SimulatedScene;

/// Color, depth and labels of `seen`, and beside them, object by object, how much of it is seen and which relations hold.
///
/// `seen` is what the camera shows of the scene; its depth may be the sensor's. `title` stands above the text.
pub fn scene_tile(scene: &SimulatedScene, seen: &Picture, viewer: &ViewerFrame, title: &str, settings: &SheetSettings) -> Image<Rgb> {
    let ids: Vec<u16> = scene.objects.iter().map(|o| o.id).collect();
    let views: Vec<Option<(usize, (i64, i64))>> = ids.iter().map(|id| seen_of(&seen.labels, *id)).collect();
    let scaled = drawing::scaled_to_width(&label_colors(&seen.labels, &seen.color), settings.picture_width);
    let mut labels = scaled;
    // Numbers are written at the size that is shown, or scaling would tear them.
    let scale = labels.width() as f64 / seen.labels.width().max(1) as f64;
    for (id, view) in ids.iter().zip(&views) {
        if let Some((_, (x, y))) = view {
            drawing::write_number(&mut labels, *id, ((*x as f64 * scale) as i64, (*y as f64 * scale) as i64));
        }
    }
    let words = relations_in_words(&scene.relations(viewer), &scene.gaps_m, ids.len());
    let line = |k: usize| {
        let object = &scene.objects[k];
        let visible = views[k].map_or("unseen".to_owned(), |(pixels, _)| format!("{pixels} px"));
        format!("{} {} ({visible}) {}", object.id, object.shape.name, words[k])
    };
    let lines: Vec<String> = (0..ids.len()).map(line).collect();
    tile(&[seen.color.clone(), depth_colors(&seen.depth_m), labels], title, &lines, settings)
}

/// How many pixels show an object, and one of them near the middle of all; `None` when none does.
fn seen_of(labels: &Image<u16>, id: u16) -> Option<(usize, (i64, i64))> {
    let width = labels.width().max(1);
    let at: Vec<(i64, i64)> = labels
        .pixels()
        .iter()
        .enumerate()
        .filter(|(_, label)| **label == id)
        .map(|(i, _)| ((i % width) as i64, (i / width) as i64))
        .collect();
    let n = at.len() as i64;
    let (x, y) = at.iter().fold((0, 0), |(x, y), p| (x + p.0, y + p.1));
    // The mean of a ring lies outside it: take the pixel of the object that is nearest to the mean.
    let middle = at.iter().min_by_key(|p| (p.0 * n - x).pow(2) + (p.1 * n - y).pow(2))?;
    Some((at.len(), *middle))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::picture;
    use crate::scene::{SceneSettings, scene_of_seed};
    use nalgebra::{Point3, Vector3};
    use repose_geometry::Pinhole;
    use repose_geometry::transform::look_at;

    #[test]
    fn a_number_stands_on_its_object_also_when_that_is_a_ring() {
        let mut labels = Image::filled(9, 9, 3u16);
        for (x, y) in (1..8).flat_map(|y| (1..8).map(move |x| (x, y))) {
            labels[(x, y)] = 0;
        }
        let (pixels, (x, y)) = seen_of(&labels, 3).unwrap();
        assert_eq!(pixels, 81 - 49);
        assert_eq!(labels[(x as usize, y as usize)], 3);
        assert_eq!(seen_of(&labels, 4), None);
    }

    #[test]
    fn a_scene_s_tile_has_its_three_pictures_and_its_text() {
        let (scene, _) = scene_of_seed(7, &SceneSettings::default()).unwrap();
        let camera = Pinhole { width: 320, height: 240, fx: 280.0, fy: 280.0, cx: 159.5, cy: 119.5 };
        let middle = scene.middle();
        let world_from_camera = look_at(&(middle + Vector3::new(0.5, -0.5, 0.6)), &Point3::from(middle.coords), &Vector3::z());
        let seen = picture(&camera, &world_from_camera, &scene.drawables());
        let viewer = ViewerFrame::from_camera(&world_from_camera);
        let settings = SheetSettings { picture_width: 320, ..SheetSettings::default() };
        let tile = scene_tile(&scene, &seen, &viewer, "seed 7", &settings);
        assert_eq!(tile.width(), settings.width);
        assert_eq!(tile[(6 + 160, 6 + 120)], seen.color[(160, 120)], "the first picture is the color");
        let text = (3 * 326 + 6..1600).flat_map(|x| (0..tile.height()).map(move |y| (x, y)));
        assert!(text.filter(|at| tile[*at] != repose_pictures::colors::PAPER).count() > 500, "text to the right");
    }
}
