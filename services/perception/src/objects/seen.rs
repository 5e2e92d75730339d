//! The objects of a coarse picture that came without labels: what geometry finds, put right by the network for masks where that is asked.

use repose_geometry::{Image, Vector3};

use super::coarse::CoarsePicture;
use super::color::Rgb;
use super::find::{self, Found};
use super::{agreed, insides, learned};
use crate::settings::{Settings, SurfaceSettings};
use crate::supports::levels::{self, Viewpoint};
use crate::supports::surfaces;

/// Level pieces that are looked at for furniture, at most: a crowded desk has many tops.
const MOST_PIECES: usize = 24;
/// Of so many readings that face up one tells of levels: cells of furniture hold many.
const THINNED: usize = 3;

/// What shows in the picture, with its colors where it has any.
pub fn objects(picture: &CoarsePicture, colors: Option<&Image<Rgb>>, settings: &Settings) -> Found {
    let mut found = agreed(picture, colors, settings);
    insides::find(&mut found, picture, colors, &settings.components.insides);
    found
}

/// What rises above the furniture, as geometry and the network agree on it.
fn agreed(picture: &CoarsePicture, colors: Option<&Image<Rgb>>, settings: &Settings) -> Found {
    let geometry = by_geometry(picture, settings);
    if !settings.learned.enabled {
        return geometry;
    }
    let up = picture.world_from_camera.rotation.inverse() * Vector3::z();
    // Without weights that can be read geometry has the word.
    let Some(logits) = learned::logits(&picture.depth_m, &picture.camera, &up) else { return geometry };
    let ids = learned::ids(&logits, &picture.depth_m, colors, &settings.learned);
    agreed::put_right(&geometry, &ids, &picture.in_camera, &picture.in_world, settings)
}

/// What rises above the furniture, cut into objects.
fn by_geometry(picture: &CoarsePicture, settings: &Settings) -> Found {
    let view = picture.view();
    let facing = picture.upward(|_| Some(0)).step_by(THINNED);
    let pieces = surfaces::find(facing, &SurfaceSettings { max_count: MOST_PIECES, ..settings.surfaces.clone() });
    let viewpoint = Viewpoint::new(&picture.camera, &picture.world_from_camera);
    let levels = levels::find(&pieces, view.in_camera, view.in_world, &viewpoint, &settings.levels);
    find::find(&view, &levels, &settings.components, &settings.levels, |parts| parts.together.clone())
}
