//! What an object looks like: all that words may refer to, measured once for a scene and a viewer.

use nalgebra::Point3;
use repose_geometry::ViewerFrame;
use repose_proto::Scene;
use repose_relations::ObservedObject;

use crate::color::ColorShares;
use crate::shape::ShapeMeasures;

/// What points hold that the camera saw no color of, as where depth is wider than color.
const NO_COLOR: [u8; 3] = [0; 3];

/// The appearance of one object, as words can describe it.
#[derive(Debug, Clone)]
pub struct ObjectAppearance {
    /// The object's id.
    pub id: u16,
    /// The middle of the box around its observed points, viewer's axes (x right, y away, z up), metres.
    pub center_in_viewer_m: [f64; 3],
    /// Its shape; none where its points span no area.
    pub shape: Option<ShapeMeasures>,
    /// Its colors; none where the camera saw no color.
    pub colors: Option<ColorShares>,
    /// Its cloud for relations, with the same viewer.
    pub observed: ObservedObject,
}

impl ObjectAppearance {
    /// What can be said of the object in a few words: `object 3 (red, round, tall, 8 x 8 x 20 cm)`.
    pub fn describe(&self) -> String {
        let mut words: Vec<String> = Vec::new();
        words.extend(self.colors.as_ref().and_then(ColorShares::name).map(|c| c.as_str().to_owned()));
        if let Some(shape) = &self.shape {
            let yes = |grade| grade == crate::Grade::Yes;
            let named =
                [(yes(shape.round()), "round"), (yes(shape.boxy()), "boxy"), (yes(shape.tall()), "tall"), (yes(shape.flat()), "flat")];
            words.extend(named.iter().filter(|(is, _)| *is).map(|(_, name)| (*name).to_owned()));
            let [length, width] = shape.plan_m.map(|m| m * 100.0);
            words.push(format!("{length:.0} x {width:.0} x {:.0} cm", shape.height_m * 100.0));
        }
        format!("object {} ({})", self.id, words.join(", "))
    }
}

/// The looks of a scene's objects for a viewer, in the scene's order. Objects without a finite point have none.
pub fn looks_of(scene: &Scene, view_yaw_rad: f64) -> Vec<ObjectAppearance> {
    let viewer = ViewerFrame::from_yaw(view_yaw_rad);
    scene.meta.objects.iter().filter_map(|object| look_of(scene, object.id, &viewer)).collect()
}

fn look_of(scene: &Scene, id: u16, viewer: &ViewerFrame) -> Option<ObjectAppearance> {
    let mut points = Vec::new();
    let mut colors = Vec::new();
    for (i, _) in scene.labels.iter().enumerate().filter(|(_, label)| **label == id) {
        points.push(Point3::from(scene.points[i]));
        colors.extend(scene.colors.as_ref().map(|c| c[i]).filter(|color| *color != NO_COLOR));
    }
    let observed = ObservedObject::new(&points, viewer)?;
    let extents = observed.extents();
    let shape = ShapeMeasures::of(&points);
    Some(ObjectAppearance { id, center_in_viewer_m: extents.center.into(), shape, colors: ColorShares::of(&colors), observed })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ColorTerm;
    use repose_proto::scene::{ObjectSummary, SceneMeta, WorldFrame};
    use repose_proto::{CameraModel, Unseen};

    /// The name of the color of an object of a hundred points, of which some have no color and the others are red.
    fn named(without_color: usize) -> Option<ColorTerm> {
        let camera = CameraModel { width: 4, height: 4, fx: 5.0, fy: 5.0, cx: 1.5, cy: 1.5, depth_unit_m: 0.001, world_from_camera: None };
        let object = ObjectSummary { id: 1, points: 100, centroid_m: [0.05; 3], extent_m: [0.1, 0.1, 0.0], completeness: 1.0, score: None };
        let meta = SceneMeta {
            objects: vec![object],
            surfaces: Vec::new(),
            camera,
            world_frame: WorldFrame::Extrinsics,
            view_yaw_rad: 0.0,
            unseen: Unseen::default(),
            left_out: Vec::new(),
            warnings: Vec::new(),
        };
        let points = (0..100u8).map(|i| [f32::from(i % 10) * 0.01, f32::from(i / 10) * 0.01, 0.05]).collect();
        let colors = (0..100).map(|i| if i < without_color { NO_COLOR } else { [220, 20, 30] }).collect();
        let scene =
            Scene { camera_name: "front".to_owned(), stamp_ns: 0, points, labels: vec![1; 100], colors: Some(colors), meta, as_sent: None };
        looks_of(&scene, 0.0)[0].colors.as_ref().and_then(ColorShares::name)
    }

    #[test]
    fn points_without_a_color_do_not_make_an_object_black() {
        assert_eq!(named(0), Some(ColorTerm::Red));
        assert_eq!(named(80), Some(ColorTerm::Red));
        assert_eq!(named(100), None);
    }
}
