//! A view as a shard's JSON has it: everything but pixels, relations and gaps.
//!
//! Transforms are 16 numbers, row-major, named `to_from` as on the wire, rounded to a billionth. A rectangle is where a layer sits in the
//! full picture; its pixels are in the tensor of the same name.

use nalgebra::{Isometry3, Vector3};
use repose_geometry::transform::{NotRigid, from_row_major, to_row_major};
use repose_geometry::{OrientedBox, Pinhole};
use serde::{Deserialize, Serialize};

use crate::{
    layer::Layer,
    record::{FixtureRecord, ObjectRecord, ViewRecord},
    split::Split,
};

/// The camera's intrinsics and pose.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CameraJson {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Column of the principal point, pixels.
    pub cx: f64,
    /// Row of the principal point, pixels.
    pub cy: f64,
    /// Pose; world is z up, the camera looks along its z, x right, y down.
    pub world_from_camera: [f64; 16],
}

/// Where a layer's rectangle sits in the full picture.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct RectJson {
    /// Column of the left edge.
    pub x0: u32,
    /// Row of the upper edge.
    pub y0: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// A box.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct BoxJson {
    /// Pose of its middle; its edges lie along the axes.
    pub world_from_box: [f64; 16],
    /// Half the edge lengths, metres.
    pub half_extents_m: [f64; 3],
}

/// A piece of furniture.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FixtureJson {
    /// What it is.
    pub name: String,
    /// The box that it is.
    #[serde(rename = "box")]
    pub bounds: BoxJson,
}

/// An object's second layer.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ElsewhereJson {
    /// Where the layer sits.
    pub rect: RectJson,
    /// The motion from there to where the object stands.
    pub placed_from_elsewhere: [f64; 16],
}

/// An object.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ObjectJson {
    /// Instance id in the scene.
    pub id: u16,
    /// What it is.
    pub name: String,
    /// Mass.
    pub mass_kg: f32,
    /// Pose.
    pub world_from_object: [f64; 16],
    /// Its object-oriented box.
    #[serde(rename = "box")]
    pub bounds: BoxJson,
    /// Pixels of it in the full picture.
    pub visible_px: u32,
    /// Pixels of it with nothing else there.
    pub alone_px: u32,
    /// Where the layer `alone` sits.
    pub alone: RectJson,
    /// The layer `elsewhere`, if there is one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub elsewhere: Option<ElsewhereJson>,
}

/// A view.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ViewJson {
    /// The scene's seed.
    pub scene_seed: u64,
    /// What kind of scene.
    pub scene_kind: String,
    /// The split that the seed belongs to.
    pub split: Option<Split>,
    /// Which of the scene's views.
    pub view: u32,
    /// Who holds the camera.
    pub viewpoint: String,
    /// The camera.
    pub camera: CameraJson,
    /// The viewer's yaw about world z, radians.
    pub view_yaw_rad: f64,
    /// Whether every layer has a color tensor beside it.
    pub color: bool,
    /// Where the background's layer sits.
    pub background: RectJson,
    /// The background's boxes.
    pub fixtures: Vec<FixtureJson>,
    /// The objects, in the order of the tensors' `object_{k}`.
    pub objects: Vec<ObjectJson>,
}

impl CameraJson {
    /// What is wrong with the intrinsics, as points cannot be told by them; `None` where nothing is.
    pub fn fault(&self) -> Option<String> {
        const FOCAL_PX: std::ops::RangeInclusive<f64> = 1.0..=1e6;
        const CENTER_MOST_PX: f64 = 1e6;
        let Self { fx, fy, cx, cy, .. } = self;
        if !(FOCAL_PX.contains(fx) && FOCAL_PX.contains(fy)) {
            return Some(format!("expected focal lengths of {} to {} pixels, got {fx} and {fy}", FOCAL_PX.start(), FOCAL_PX.end()));
        }
        let is_near = cx.abs() <= CENTER_MOST_PX && cy.abs() <= CENTER_MOST_PX;
        (!is_near).then(|| format!("expected a principal point within {CENTER_MOST_PX} pixels, got {cx}, {cy}"))
    }
}

impl ViewJson {
    /// What a view's JSON says.
    pub fn of(view: &ViewRecord) -> Self {
        let Pinhole { width, height, fx, fy, cx, cy } = view.camera;
        let fixture = |f: &FixtureRecord| FixtureJson { name: f.name.clone(), bounds: BoxJson::of(&f.bounds) };
        Self {
            scene_seed: view.scene_seed,
            scene_kind: view.scene_kind.clone(),
            split: Split::of_seed(view.scene_seed),
            view: view.view,
            viewpoint: view.viewpoint.clone(),
            camera: CameraJson { width, height, fx, fy, cx, cy, world_from_camera: rounded(&view.world_from_camera) },
            view_yaw_rad: view.view_yaw_rad,
            color: view.has_color(),
            background: RectJson::of(&view.background),
            fixtures: view.fixtures.iter().map(fixture).collect(),
            objects: view.objects.iter().map(ObjectJson::of).collect(),
        }
    }
}

impl ObjectJson {
    fn of(object: &ObjectRecord) -> Self {
        Self {
            id: object.id,
            name: object.name.clone(),
            mass_kg: object.mass_kg,
            world_from_object: rounded(&object.world_from_object),
            bounds: BoxJson::of(&object.bounds),
            visible_px: object.visible_px,
            alone_px: object.alone_px,
            alone: RectJson::of(&object.alone),
            elsewhere: object
                .elsewhere
                .as_ref()
                .map(|e| ElsewhereJson { rect: RectJson::of(&e.layer), placed_from_elsewhere: rounded(&e.placed_from_elsewhere) }),
        }
    }
}

impl RectJson {
    fn of(layer: &Layer) -> Self {
        Self { x0: layer.x0, y0: layer.y0, width: layer.width, height: layer.height }
    }

    /// Pixels of the rectangle; `None` when it does not lie inside the camera's picture.
    pub fn area_within(&self, camera: &CameraJson) -> Option<usize> {
        let fits = |start: u32, length: u32, size: usize| start.checked_add(length).is_some_and(|end| end as usize <= size);
        let inside = fits(self.x0, self.width, camera.width) && fits(self.y0, self.height, camera.height);
        inside.then(|| self.width as usize * self.height as usize)
    }
}

impl BoxJson {
    fn of(bounds: &OrientedBox) -> Self {
        let half = bounds.half_extents;
        Self { world_from_box: rounded(&bounds.world_from_box), half_extents_m: [half.x, half.y, half.z].map(to_billionths) }
    }

    /// The box.
    ///
    /// # Errors
    /// [`NotRigid`] when its pose is none.
    pub fn bounds(&self) -> Result<OrientedBox, NotRigid> {
        Ok(OrientedBox { world_from_box: from_row_major(&self.world_from_box)?, half_extents: Vector3::from(self.half_extents_m) })
    }
}

fn rounded(to_from: &Isometry3<f64>) -> [f64; 16] {
    to_row_major(to_from).map(to_billionths)
}

/// Digits beyond a nanometre say nothing and do not deflate.
fn to_billionths(value: f64) -> f64 {
    // Adding zero turns −0 into 0.
    (value * 1e9).round() / 1e9 + 0.0
}
