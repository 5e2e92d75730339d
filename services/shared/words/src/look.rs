//! What an object looks like: all that words may refer to, measured once for a scene and a viewer.

use nalgebra::Point3;
use repose_geometry::ViewerFrame;
use repose_proto::Scene;
use repose_relations::ObservedObject;

use crate::color::ColorShares;
use crate::shape::ShapeMeasures;

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
        colors.extend(scene.colors.as_ref().map(|c| c[i]));
    }
    let observed = ObservedObject::new(&points, viewer)?;
    let extents = observed.extents();
    let shape = ShapeMeasures::of(&points);
    Some(ObjectAppearance { id, center_in_viewer_m: extents.center.into(), shape, colors: ColorShares::of(&colors), observed })
}
