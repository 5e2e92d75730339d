//! A segmented scene: what perception makes of a frame, and what everything after it plans on.

use std::sync::Arc;

use safetensors::Dtype;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::check_range;
use crate::message::{below, from_entry};
use crate::{Bulk, CallError, CameraModel, Message, Tensor, limits};

/// How a request names its scene. The bulk form of a request encloses the scene itself beside this id.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneRef {
    /// BLAKE3 of the scene's content, 64 hexadecimal digits.
    pub scene_id: String,
}

impl SceneRef {
    /// Checks the form of the id.
    ///
    /// # Errors
    /// `invalid_argument` on `scene.scene_id`.
    pub fn validate(&self) -> Result<(), CallError> {
        let good = self.scene_id.len() == 64 && self.scene_id.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b));
        if good {
            Ok(())
        } else {
            Err(CallError::invalid("scene.scene_id", format!("expected 64 lower-case hexadecimal digits, got {:?}", self.scene_id)))
        }
    }
}

/// What is known of one object without its points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ObjectSummary {
    /// The object's id, its label in the cloud.
    pub id: u16,
    /// How many points it has.
    pub points: usize,
    /// Mean of its observed points, world frame, metres.
    pub centroid_m: [f64; 3],
    /// Edge lengths of the axis-aligned box of its observed points, world frame, metres.
    pub extent_m: [f64; 3],
    /// Estimated share of its visible surface that was in fact observed, 0 to 1.
    pub completeness: f64,
    /// How sure it is that its points are those of one whole object, 0 to 1; none where its mask came with the frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub score: Option<f64>,
}

/// Readings that make up no object and no surface: an obstacle of which nothing else is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LeftOut {
    /// Why it is no object.
    pub reason: LeftOutReason,
    /// How many points of the scene it has.
    pub points: usize,
    /// Mean of its points, world frame, metres.
    pub centroid_m: [f64; 3],
    /// Its label in the frame, where that came with one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<u16>,
}

/// Why something that was seen is no object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeftOutReason {
    /// Too thin or too small: too few readings are left without its uncertain border.
    TooSmall,
    /// Larger than an object may be: furniture, a wall, or several things in one.
    TooLarge,
    /// It goes on below the surface behind which it stands, or beside it.
    BesideSupports,
    /// There are more objects than a scene may have, and this is one of the smallest.
    TooMany,
    /// It rises above what things stand on, and the network for masks sees no object in it: furniture, or an object that was missed.
    Unconfirmed,
    /// The rim of an object goes around it: that object's floor, or what that object stands on.
    Enclosed,
    /// A reason of a later version.
    #[serde(other)]
    Other,
}

impl LeftOutReason {
    /// The same for a person.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::TooSmall => "too thin or too small for an object",
            Self::TooLarge => "larger than an object may be",
            Self::BesideSupports => "beside what objects stand on",
            Self::TooMany => "one object too many",
            Self::Unconfirmed => "rises like an object, but the network for masks sees none",
            Self::Enclosed => "within an object's rim: its floor, or what it stands on",
            Self::Other => "no object",
        }
    }
}

/// Something about a scene that its user should know and look into: a camera pose that cannot be right, a robot that is not where it says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SceneWarning {
    /// The field of the frame, or the setting, that is most likely at fault.
    pub field: String,
    /// What is wrong.
    pub message: String,
}

/// A horizontal surface on which things can stand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Surface {
    /// Height, world z, metres.
    pub height_m: f64,
    /// Convex outline of what was seen of it, world x and y, counter-clockwise, metres.
    pub outline_m: Vec<[f64; 2]>,
    /// Area of that outline, square metres.
    pub area_m2: f64,
    /// The object whose top it is; none for tables, shelves and other furniture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object: Option<u16>,
}

impl Surface {
    /// Checks coordinates and the number of corners.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        let most_m = f64::from(limits::MAX_COORDINATE_M);
        check_range(&format!("{field}.height_m"), self.height_m, -most_m..=most_m)?;
        if self.outline_m.len() > limits::MAX_CORNERS {
            let message = format!("expected at most {} corners, got {}", limits::MAX_CORNERS, self.outline_m.len());
            return Err(CallError::invalid(format!("{field}.outline_m"), message));
        }
        let corners = self.outline_m.iter().enumerate();
        corners
            .flat_map(|(i, corner)| corner.iter().map(move |v| (i, *v)))
            .try_for_each(|(i, v)| check_range(&format!("{field}.outline_m[{i}]"), v, -most_m..=most_m))
    }
}

/// What the camera could not tell.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Unseen {
    /// Pixels without a depth reading.
    pub pixels_without_reading: usize,
    /// Pixels ignored because they lie on an object's border.
    pub pixels_on_borders: usize,
    /// Pixels ignored because their reading hangs in the air between two surfaces.
    #[serde(default)]
    pub pixels_flying: usize,
    /// Share of all pixels that gave no point, 0 to 1.
    pub share: f64,
    /// Where nothing was seen above the furniture: behind objects, inside them, and where readings are missing. None without furniture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub space: Option<UnseenSpace>,
}

/// Space that the camera did not see into, as cubes over the floor plan: as far as anybody knows neither free nor solid.
///
/// Cube (column, row, level) spans `cell_m` from `origin_m + (column, row, level) * cell_m` in each world axis. Whatever lies outside
/// the grid was not looked into.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UnseenSpace {
    /// The lowest corner of the first cube, world frame, metres; its z is the height of the main support surface, or of what stands a little
    /// lower and carries things too.
    pub origin_m: [f64; 3],
    /// Edge of a cube, metres.
    pub cell_m: f64,
    /// Cubes along world x.
    pub columns: usize,
    /// Cubes along world y.
    pub rows: usize,
    /// Per cell of the floor plan, row by row: bit k is set where the cube at level k (0 is the lowest) was not seen.
    pub hidden: Vec<u32>,
}

impl UnseenSpace {
    /// Levels of cubes above each other.
    pub const LEVELS: usize = 32;
    /// Most cubes along x and along y.
    pub const MAX_SIDE: usize = 96;

    /// Checks sizes.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn validate(&self) -> Result<(), CallError> {
        crate::checks::check_finite("scene.unseen.space.origin_m", &self.origin_m)?;
        check_range("scene.unseen.space.cell_m", self.cell_m, f64::MIN_POSITIVE..=1e3)?;
        for (field, side) in [("columns", self.columns), ("rows", self.rows)] {
            check_range(&format!("scene.unseen.space.{field}"), side as f64, 1.0..=Self::MAX_SIDE as f64)?;
        }
        if self.hidden.len() != self.columns * self.rows {
            let message =
                format!("expected {} numbers ({} x {}), got {}", self.columns * self.rows, self.columns, self.rows, self.hidden.len());
            return Err(CallError::invalid("scene.unseen.space.hidden", message));
        }
        Ok(())
    }

    /// Whether a point of the world lies in a cube that was not seen; none outside the grid.
    pub fn hides(&self, point_m: [f64; 3]) -> Option<bool> {
        let [x, y, z] = point_m;
        let level = self.level_of(z)?;
        Some(self.hidden_over(x, y)? >> level & 1 == 1)
    }

    /// The levels over a place that were not seen: bit l for level l; none outside the grid.
    pub fn hidden_over(&self, x_m: f64, y_m: f64) -> Option<u32> {
        let (column, row) = (self.cell(0, x_m, self.columns)?, self.cell(1, y_m, self.rows)?);
        self.hidden.get(row * self.columns + column).copied()
    }

    /// The level of a height; none outside the grid.
    pub fn level_of(&self, z_m: f64) -> Option<usize> {
        self.cell(2, z_m, Self::LEVELS)
    }

    fn cell(&self, axis: usize, at_m: f64, most: usize) -> Option<usize> {
        let at = (at_m - self.origin_m[axis]) / self.cell_m;
        (at >= 0.0 && at < most as f64).then_some(at as usize)
    }
}

/// Where the world's axes come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WorldFrame {
    /// The camera's calibrated pose: coordinates are the cell's, and a robot can act on them.
    Extrinsics,
    /// The main support plane: good for planning placements, not for moving a robot.
    SupportPlane,
}

/// All of a scene but its points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SceneMeta {
    /// The objects, by id.
    pub objects: Vec<ObjectSummary>,
    /// The support surfaces, largest first.
    pub surfaces: Vec<Surface>,
    /// The camera. `world_from_camera` is always set: calibrated, or estimated from the support plane.
    pub camera: CameraModel,
    /// Whether that pose is calibrated.
    pub world_frame: WorldFrame,
    /// The camera's viewing direction as a yaw, the default viewer of relations, radians.
    pub view_yaw_rad: f64,
    /// What the camera could not tell.
    pub unseen: Unseen,
    /// What was seen and is no object: with the surfaces, all that is labelled 0.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// What should be looked into.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<SceneWarning>,
}

/// A segmented point cloud in the world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The camera that saw it.
    pub camera_name: String,
    /// When, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// Points, world frame, metres.
    pub points: Vec<[f32; 3]>,
    /// The object of each point, 0 = not an object.
    pub labels: Vec<u16>,
    /// Color of each point.
    pub colors: Option<Vec<[u8; 3]>>,
    /// Everything else.
    pub meta: SceneMeta,
    /// The JSON of `meta` as it was sent, where this release would write it otherwise: a newer perception may say more than is read here. While
    /// `meta` is unchanged, this is what is sent on and hashed into the id. None in a scene that was made here.
    pub as_sent: Option<Arc<str>>,
}

impl Scene {
    /// The bulk schema's name.
    pub const SCHEMA: &'static str = "Scene.v1";

    /// The scene's id: BLAKE3 of its canonical bulk form without stamp and camera name, which is the tensors `points`, `labels` and `colors` and the
    /// metadata entry `scene` as it was sent, so that a receiver that knows fewer of its fields finds the same id. Costs a copy of the scene: keep it.
    pub fn id(&self) -> String {
        self.id_in(self.description())
    }

    /// Whether `id` is this scene's, with its metadata as it was sent or as this release writes it: a client that reads a scene and writes it anew may
    /// order its fields and spell its numbers otherwise.
    pub fn goes_by(&self, id: &str) -> bool {
        self.id() == id || (self.as_sent.is_some() && self.id_in(written(&self.meta)) == id)
    }

    fn id_in(&self, description: String) -> String {
        blake3::hash(&self.content(description).encode()).to_hex().to_string()
    }

    /// The points of one object, in cloud order.
    pub fn points_of(&self, object: u16) -> impl Iterator<Item = [f32; 3]> + '_ {
        self.points.iter().zip(&self.labels).filter(move |(_, l)| **l == object).map(|(p, _)| *p)
    }

    /// What is known of one object.
    pub fn object(&self, id: u16) -> Option<&ObjectSummary> {
        self.meta.objects.iter().find(|o| o.id == id)
    }

    /// The JSON summary that perception publishes; `scene_id` is [`Scene::id`].
    pub fn summary(&self, scene_id: String) -> SceneSummary {
        SceneSummary {
            scene_id,
            camera: self.camera_name.clone(),
            stamp_ns: self.stamp_ns,
            objects: self.meta.objects.clone(),
            surfaces: self.meta.surfaces.clone(),
            left_out: self.meta.left_out.clone(),
            warnings: self.meta.warnings.clone(),
        }
    }

    /// The bulk form.
    pub fn to_bulk(&self) -> Bulk {
        let mut bulk = self.content(self.description());
        bulk.metadata.insert("camera".to_owned(), self.camera_name.clone());
        bulk.metadata.insert("stamp_ns".to_owned(), self.stamp_ns.to_string());
        bulk
    }

    fn content(&self, description: String) -> Bulk {
        let n = self.points.len();
        let mut bulk = Bulk::default();
        bulk.tensors.insert("points".to_owned(), Tensor::f32(&[n, 3], self.points.as_flattened()));
        bulk.tensors.insert("labels".to_owned(), Tensor::u16(&[n], &self.labels));
        if let Some(colors) = &self.colors {
            bulk.tensors.insert("colors".to_owned(), Tensor::u8(&[n, 3], colors.as_flattened()));
        }
        bulk.metadata.insert("scene".to_owned(), description);
        bulk
    }

    /// The JSON of `meta`: as it was sent, unless `meta` has been changed since.
    fn description(&self) -> String {
        let says_so = |text: &&str| crate::message::from_json::<SceneMeta>(text.as_bytes()).is_ok_and(|meta| meta == self.meta);
        self.as_sent.as_deref().filter(says_so).map_or_else(|| written(&self.meta), str::to_owned)
    }

    /// Reads and checks the bulk form. Metadata of objects that have no points is refused, and so are a cloud without points, points and
    /// surfaces that no camera sees, as coordinates in millimetres are, and more objects or surfaces than a scene may have.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn from_bulk(bulk: &Bulk) -> Result<Self, CallError> {
        let points = bulk.finite_rows::<3>("points")?;
        if points.is_empty() {
            return Err(CallError::invalid("points", "the cloud is empty"));
        }
        let far = |p: &[f32; 3]| p.iter().any(|v| v.abs() > limits::MAX_COORDINATE_M);
        if let Some(i) = points.iter().position(far) {
            let message = format!("expected coordinates within {} m of the origin, got {:?}", limits::MAX_COORDINATE_M, points[i]);
            return Err(CallError::invalid(format!("points[{i}]"), message));
        }
        let n = points.len();
        let (_, labels) = bulk.values::<u16>("labels", Dtype::U16, &format!("[{n}]"), |s| s == [n])?;
        let colors = match bulk.tensors.contains_key("colors") {
            true => {
                let (_, bytes) = bulk.values::<u8>("colors", Dtype::U8, &format!("[{n}, 3]"), |s| s == [n, 3])?;
                Some(bytes.as_chunks::<3>().0.to_vec())
            }
            false => None,
        };
        let description = bulk.text("scene")?;
        let meta: SceneMeta = from_entry(bulk, "scene")?;
        meta.camera.validate().map_err(|error| below("scene.camera", error))?;
        if meta.camera.world_from_camera.is_none() {
            return Err(CallError::invalid("scene.camera.world_from_camera", "a scene's camera must have a pose"));
        }
        if let Some(space) = &meta.unseen.space {
            space.validate()?;
        }
        if meta.surfaces.len() > limits::MAX_SURFACES {
            let message = format!("expected at most {} surfaces, got {}", limits::MAX_SURFACES, meta.surfaces.len());
            return Err(CallError::invalid("scene.surfaces", message));
        }
        meta.surfaces.iter().enumerate().try_for_each(|(i, surface)| surface.validate(&format!("scene.surfaces[{i}]")))?;
        let mut in_cloud = vec![false; 1 << u16::BITS];
        labels.iter().for_each(|label| in_cloud[usize::from(*label)] = true);
        // What has points is an object, whether it is described or not.
        let objects = in_cloud[1..].iter().filter(|is_there| **is_there).count();
        if objects > limits::MAX_OBJECTS {
            return Err(CallError::invalid("labels", format!("expected at most {} objects, got {objects}", limits::MAX_OBJECTS)));
        }
        let mut named = vec![false; 1 << u16::BITS];
        for (i, object) in meta.objects.iter().enumerate() {
            if object.id == 0 || std::mem::replace(&mut named[usize::from(object.id)], true) {
                let message = format!("object ids are unique and not 0, got {}", object.id);
                return Err(CallError::invalid(format!("scene.objects[{i}].id"), message));
            }
            if !in_cloud[usize::from(object.id)] {
                return Err(CallError::invalid("scene.objects", format!("object {} has no points in the cloud", object.id)));
            }
        }
        let camera_name = bulk.text("camera")?.to_owned();
        crate::keys::validate_chunk("camera", &camera_name)?;
        let as_sent = (description != written(&meta)).then(|| description.into());
        Ok(Self { camera_name, stamp_ns: crate::frame::parse_stamp(bulk)?, points, labels, colors, meta, as_sent })
    }
}

/// The metadata entry `scene` as this release writes it.
fn written(meta: &SceneMeta) -> String {
    serde_json::to_string(meta).unwrap_or_default()
}

/// A scene without its points: what `scene/{camera}` carries and `latest` returns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SceneSummary {
    /// The scene's id.
    pub scene_id: String,
    /// The camera that saw it.
    pub camera: String,
    /// When, nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// The objects.
    pub objects: Vec<ObjectSummary>,
    /// The support surfaces.
    pub surfaces: Vec<Surface>,
    /// What was seen and is no object.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// What should be looked into.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<SceneWarning>,
}

impl Message for SceneSummary {
    const SCHEMA: &'static str = "SceneSummary.v1";
}
