//! What a scene's user should look into: depth, a camera's pose or masks that cannot be right, judged by what the scene shows with them.

use repose_proto::SceneWarning;
use repose_proto::scene::WorldFrame;

use crate::objects::coarse::CoarsePicture;
use crate::readings::depth::DepthMap;
use crate::settings::Settings;
use crate::supports::surfaces::{self, SupportSurface};

/// What is to be said of a picture with most readings alone.
pub fn sparse_depth() -> SceneWarning {
    let message = "most readings have none beside them: was depth registered into a larger picture? It shows more in its own size";
    SceneWarning { field: "depth".to_owned(), message: message.to_owned() }
}

/// What cannot be right about the camera or masks that were given, judged by the surfaces that the scene has with them.
pub fn doubts(
    surfaces: &[SupportSurface],
    depth: &DepthMap,
    coarse: &CoarsePicture,
    world_frame: WorldFrame,
    has_given_masks: bool,
    settings: &Settings,
) -> Vec<SceneWarning> {
    /// No depth camera measures below this, metres.
    const NEAREST_M: f32 = 0.05;
    /// A place of a few decimetres that is taken for metres lies beyond this, metres, …
    const FARTHEST_M: f64 = 100.0;
    /// … and higher or lower than this, metres: a camera stands beside an origin by some centimetres at least. On a map, however large, it does not.
    const HIGHEST_M: f64 = 20.0;
    let readings = || coarse.depth_m.pixels().iter().filter(|z| !z.is_nan());
    let near = readings().filter(|z| **z < NEAREST_M).count();
    if 2 * near > readings().count() {
        let message = format!("most readings are nearer than {:.0} mm: is it metres per count?", NEAREST_M * 1e3);
        return vec![SceneWarning { field: "depth_unit_m".to_owned(), message }];
    }
    let camera_m = coarse.world_from_camera.translation.vector;
    let from_origin_m = camera_m.norm();
    if world_frame == WorldFrame::Extrinsics && from_origin_m > FARTHEST_M && camera_m.z.abs() > HIGHEST_M {
        let message = format!("the camera stands {from_origin_m:.0} m from the world's origin: is its place in millimetres?");
        return vec![SceneWarning { field: "world_from_camera".to_owned(), message }];
    }
    if surfaces.iter().any(|s| s.object.is_none()) {
        return if world_frame == WorldFrame::Extrinsics { sloping_furniture(surfaces).into_iter().collect() } else { Vec::new() };
    }
    // Furniture that was labelled as an object is nowhere to be stood on, however right the pose is.
    let large = surfaces.iter().filter(|s| has_given_masks && s.seen_m2 >= settings.levels.large_m2);
    if let Some((surface, id)) = large.filter_map(|s| Some((s, s.object?))).max_by(|(a, _), (b, _)| a.seen_m2.total_cmp(&b.seen_m2)) {
        let message = format!(
            "label {id} is of a level surface of {:.2} m², and no other is seen: what things stand on must be labelled 0",
            surface.seen_m2
        );
        return vec![SceneWarning { field: "labels".to_owned(), message }];
    }
    let mut message = "no level surface is seen on which anything could stand".to_owned();
    if world_frame == WorldFrame::Extrinsics {
        message += "; is the camera's pose right?";
        let inverse =
            CoarsePicture::new(depth.points(coarse.stride), &coarse.world_from_camera.inverse(), &coarse.of_full, coarse.stride, settings);
        let of_inverse = surfaces::find(inverse.upward(|_| Some(0)), &settings.surfaces, settings.levels.max_slope);
        if of_inverse.iter().any(|s| s.seen_m2 >= settings.levels.large_m2) {
            message += " With its inverse there is one: it seems to be camera_from_world.";
        }
    }
    vec![SceneWarning { field: "world_from_camera".to_owned(), message }]
}

/// What is to be said of furniture that is not level by the camera's pose.
fn sloping_furniture(surfaces: &[SupportSurface]) -> Option<SceneWarning> {
    /// Floors and tables slope by less, radians.
    const MOST_RAD: f32 = 0.0175;
    let tilts = surfaces.iter().filter(|s| s.object.is_none()).filter_map(|s| Some((s, s.sloping?.slope().atan())));
    let (surface, tilt_rad) =
        tilts.filter(|(_, tilt_rad)| *tilt_rad > MOST_RAD).max_by(|(a, _), (b, _)| a.seen_m2.total_cmp(&b.seen_m2))?;
    let (area_m2, tilt_deg) = (surface.outline.area(), tilt_rad.to_degrees());
    let message = format!("what things stand on, {area_m2:.2} m² of it, slopes by {tilt_deg:.1}°: is the camera's pose right?");
    Some(SceneWarning { field: "world_from_camera".to_owned(), message })
}
