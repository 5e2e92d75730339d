//! The objects of a coarse picture that came without labels: what geometry finds, put right by the network for masks where that is asked.

use repose_geometry::{Image, Vector3};

use super::coarse::CoarsePicture;
use super::color::Rgb;
use super::find::{self, Found};
use super::upright::Turn;
use super::{agreed, insides, learned};
use crate::settings::{Settings, SurfaceSettings};
use crate::supports::levels::{self, Viewpoint};
use crate::supports::surfaces;

/// Level pieces that are looked at for furniture, at most: a crowded desk has many tops.
const MOST_PIECES: usize = 24;
/// Of so many readings that face up one tells of levels: cells of furniture hold many.
const THINNED: usize = 3;

/// What shows in the picture, with its colors where it has any, however the camera is held.
pub fn objects(picture: &CoarsePicture, colors: Option<&Image<Rgb>>, settings: &Settings) -> Found {
    let turn = Turn::upright(&up_in_camera(picture));
    if turn.is_none() {
        return upright_objects(picture, colors, settings);
    }
    let colors = colors.map(|colors| turn.picture(colors));
    let found = upright_objects(&turn.coarse(picture), colors.as_ref(), settings);
    Found { ids: turn.back().picture(&found.ids), ..found }
}

/// What shows in a picture that is nearly upright.
fn upright_objects(picture: &CoarsePicture, colors: Option<&Image<Rgb>>, settings: &Settings) -> Found {
    let mut found = agreed(picture, colors, settings);
    insides::find(&mut found, picture, colors, &settings.components.insides);
    found
}

/// The unit vector against gravity in the camera's frame.
fn up_in_camera(picture: &CoarsePicture) -> Vector3<f64> {
    picture.world_from_camera.rotation.inverse() * Vector3::z()
}

/// What rises above the furniture, as geometry and the network agree on it.
fn agreed(picture: &CoarsePicture, colors: Option<&Image<Rgb>>, settings: &Settings) -> Found {
    let geometry = by_geometry(picture, settings);
    if !settings.learned.enabled {
        return geometry;
    }
    // Without weights that can be read geometry has the word.
    let Some(logits) = learned::logits(&picture.depth_m, &picture.camera, &up_in_camera(picture)) else { return geometry };
    let ids = learned::ids(&logits, &picture.depth_m, colors, &settings.learned);
    agreed::put_right(&geometry, &ids, &picture.in_camera, &picture.in_world, settings)
}

/// What rises above the furniture, cut into objects.
fn by_geometry(picture: &CoarsePicture, settings: &Settings) -> Found {
    let view = picture.view();
    let facing = picture.upward(|_| Some(0)).step_by(THINNED);
    let of_pieces = SurfaceSettings { max_count: MOST_PIECES, ..settings.surfaces.clone() };
    let pieces = surfaces::find(facing, &of_pieces, settings.levels.max_slope);
    let viewpoint = Viewpoint::new(&picture.camera, &picture.world_from_camera);
    let levels = levels::find(&pieces, view.in_camera, view.in_world, &viewpoint, &settings.levels);
    find::find(&view, &levels, &settings.components, &settings.levels, |parts| parts.together.clone())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use repose_geometry::transform::look_at;
    use repose_geometry::{Isometry3, Pinhole, Point3};

    use super::*;
    use crate::readings::depth::DepthMap;
    use crate::synthetic::{Solid, cast};

    /// The ids in a depth picture of tenths of a millimetre, of a camera that has its middle in the picture's.
    fn found(depth: &Image<u16>, world_from_camera: &Isometry3<f64>) -> Image<u16> {
        let (width, height) = (depth.width(), depth.height());
        let (cx, cy) = ((width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0);
        let camera = Pinhole { width, height, fx: 262.0, fy: 262.0, cx, cy };
        let in_camera = DepthMap::new(depth.pixels(), 1e-4, &camera, 4.0).points(1);
        let picture = CoarsePicture::new(in_camera, world_from_camera, &camera, 1, &Settings::default());
        objects(&picture, None, &Settings::default()).ids
    }

    /// A picture turned clockwise by a quarter.
    fn clockwise(picture: &Image<u16>) -> Image<u16> {
        let (width, height) = (picture.width(), picture.height());
        let from = |i: usize| picture[(i / height, height - 1 - i % height)];
        Image::from_pixels(height, width, (0..width * height).map(from).collect()).unwrap()
    }

    #[test]
    fn a_camera_mounted_on_its_side_or_upside_down_finds_the_same_objects() {
        // A pot, of which the near wall hides a part of the far one, and a box.
        let wall = |x: f64, y: f64, half_x: f64, half_y: f64| Solid::cuboid([x, y, 0.04], [half_x, half_y, 0.04]);
        let pot =
            [wall(0.0, -0.05, 0.05, 0.0025), wall(0.0, 0.05, 0.05, 0.0025), wall(-0.05, 0.0, 0.0025, 0.05), wall(0.05, 0.0, 0.0025, 0.05)];
        let others = [Solid::table(0.0), Solid::cuboid([0.2, 0.05, 0.03], [0.05, 0.04, 0.03])];
        let camera = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };
        let world_from_camera = look_at(&Point3::new(0.0, -0.7, 0.5), &Point3::origin(), &Vector3::z());
        let seen = cast(&[&others[..], &pot[..]].concat(), &camera, &world_from_camera);
        let mut depth = seen.map(|s| s.map_or(0, |(z, _)| (z * 1e4).round() as u16));
        let mut ids = found(&depth, &world_from_camera);
        assert!(ids.pixels().contains(&2), "two objects at least");
        for quarters in 1..4 {
            (depth, ids) = (clockwise(&depth), clockwise(&ids));
            let counterclockwise = Isometry3::rotation(-Vector3::z() * (f64::from(quarters) * FRAC_PI_2));
            assert_eq!(found(&depth, &(world_from_camera * counterclockwise)), ids, "{quarters} quarters");
        }
    }
}
