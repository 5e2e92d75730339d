//! One view with one of its objects as the query: what most trainings draw their samples from.
//!
//! The query's cloud comes from another place and is moved in by the operator that makes candidates (paper, section 2 and appendix A.3), or is
//! seen alone in its place. Either way the scene is seen without it, as when a robot asks where to put something. What the query hid in its
//! other place stays unknown, as it does then. Both clouds go through the sensor model, the border cleaning and a small tilt of gravity.

use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_dataset::{Composite, Layer, RELATIONS, ReleaseRecord, ViewRecord};
use repose_geometry::{ViewerFrame, cloud, transform::yaw_of};
use repose_networks::points::{CloudConfig, ObjectCloud, Observer, SceneCloud};
use repose_sensor::SensorModel;

use crate::{
    normal::gaussian,
    views::{PIXELS_LEAST, QueryView},
};

/// How episodes are perturbed. The tilt is the ±2° that gravity may be off by (twice the deviation); the shares are ours, without a recorded
/// comparison.
#[derive(Debug, Clone, Copy)]
pub struct EpisodeSettings {
    /// Border bands are 1 up to this many pixels wide.
    pub band_px: usize,
    /// Standard deviation of gravity's tilt, radians; cut at twice that.
    pub tilt_rad: f32,
    /// Share of episodes whose query comes from elsewhere, where the data has it.
    pub elsewhere: f64,
    /// The share of the query that must be visible elsewhere; below it, the query is taken where it stands.
    pub visible_least: f64,
}

impl Default for EpisodeSettings {
    fn default() -> Self {
        Self { band_px: 2, tilt_rad: 0.0175, elsewhere: 0.75, visible_least: 0.5 }
    }
}

/// One anchor of an episode.
#[derive(Debug, Clone)]
pub struct EpisodeAnchor {
    /// Its cloud, the query absent.
    pub cloud: ObjectCloud,
    /// Ground truth of query × this anchor.
    pub relations: [bool; RELATIONS],
}

/// A simulated release of the query, and its outcome.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedRelease {
    /// Where its observed centroid was released.
    pub position: Point3<f32>,
    /// Turn about z from how it was observed, radians.
    pub yaw_rad: f32,
    /// It moved less than 5 cm (paper, section 3).
    pub stayed: bool,
    /// It stayed as it was put: see [`stays_as_put`].
    pub as_put: bool,
}

/// Whether an object stays as it was put: it moves less than 1 cm, tilts less than 5 degrees, overlapped nothing by more than 3 mm, and moves
/// nothing else by more than 1 cm.
pub fn stays_as_put(release: &ReleaseRecord) -> bool {
    release.moved_m < 0.01 && release.tilt_rad < 5f32.to_radians() && release.penetration_m < 0.003 && release.others_moved_m < 0.01
}

/// How far an object may move and still count as stable, metres (paper, section 3).
const STAYED_M: f32 = 0.05;

/// A query, its resting place and its surroundings, in the viewer's axes.
#[derive(Debug, Clone)]
pub struct Episode {
    /// The query as observed (not turned).
    pub query: ObjectCloud,
    /// Turn about z from how it was observed to how it rests, radians.
    pub yaw_rad: f32,
    /// Where its observed centroid rests.
    pub position: Point3<f32>,
    /// The scene without the query, in sampling order; labels are 1 + object index.
    pub scene: SceneCloud,
    /// The other objects that are visible enough.
    pub anchors: Vec<EpisodeAnchor>,
    /// Its simulated releases.
    pub trials: Vec<SimulatedRelease>,
}

impl Episode {
    /// Prepares an episode; `None` when cleaning leaves too little of the query or no anchor.
    pub fn new(drawn: &QueryView<'_>, cloud: &CloudConfig, settings: &EpisodeSettings, rng: &mut Pcg64) -> Option<Self> {
        let QueryView { view, query, releases } = drawn;
        let query = *query;
        let label = query as u16 + 1;
        let band_px = rng.random_range(1..=settings.band_px.max(1));
        let wants_elsewhere = rng.random_bool(settings.elsewhere);
        let mut scene = Composite::of(view, |k| k != query);
        let object = &view.objects[query];
        let elsewhere =
            object.elsewhere.as_ref().filter(|e| wants_elsewhere && is_visible(&scene, &e.layer, label, settings.visible_least));
        // Every episode has its own camera noise.
        let sensor = SensorModel::jittered(rng);
        let clean = |picture: &mut Composite, rng: &mut Pcg64| observed(picture, view, &sensor, band_px, rng);
        let cloud = &CloudConfig { border_px: band_px as f32, ..*cloud };
        let (points, labels, mut query_points) = if let Some(elsewhere) = elsewhere {
            scene.add(&elsewhere.layer, label);
            let (points, labels) = clean(&mut scene, rng);
            let query = points.iter().zip(&labels).filter(|(_, l)| **l == label).map(|(p, _)| *p).collect();
            (points, labels, query)
        } else {
            let mut alone = Composite::empty(view.camera.width, view.camera.height);
            alone.add(&object.alone, label);
            let (query, _) = clean(&mut alone, rng);
            let (points, labels) = clean(&mut scene, rng);
            (points, labels, query)
        };
        let yaw_rad = elsewhere.map_or(0.0, |e| yaw_of(&e.placed_from_elsewhere)) as f32;
        let centroid = cloud::centroid(&query_points).filter(|_| query_points.len() >= PIXELS_LEAST / 2)?;
        let position = elsewhere.map_or(centroid, |e| e.placed_from_elsewhere * centroid).cast::<f32>();
        // Gravity is known to a degree or so: everything tilts about the place where the query rests.
        let viewer_from_world = ViewerFrame::from_yaw(view.view_yaw_rad).viewer_from_world().cast::<f32>();
        let rotation = tilt(settings.tilt_rad, rng) * viewer_from_world;
        let about = |p: &Point3<f32>| viewer_from_world * position + rotation * (p - position);
        let points: Vec<Point3<f32>> = points.iter().map(about).collect();
        let observer = Observer::of_camera(&view.camera, &view.world_from_camera);
        // The query tilts about itself and the scene about where the query rests; for the lines of sight that is the same camera.
        let observer = Observer { eye: about(&observer.eye), ..observer };
        for p in &mut query_points {
            *p = viewer_from_world * centroid.cast::<f32>() + rotation * (*p - centroid.cast::<f32>());
        }
        let mut anchors = Vec::new();
        let mut centers = vec![viewer_from_world * position];
        for (k, _) in view.objects.iter().enumerate().filter(|(k, _)| *k != query) {
            let own: Vec<Point3<f32>> = points.iter().zip(&labels).filter(|(_, l)| usize::from(**l) == k + 1).map(|(p, _)| *p).collect();
            if let Some(object) = ObjectCloud::new(&own, &observer, cloud).filter(|_| own.len() >= PIXELS_LEAST / 2) {
                centers.push(object.centroid_in_viewer);
                anchors.push(EpisodeAnchor { cloud: object, relations: *view.relations_of(query, k) });
            }
        }
        let trial = |release: &ReleaseRecord| {
            let motion = release.placed_from_settled(&object.world_from_object);
            SimulatedRelease {
                position: about(&(motion.cast::<f32>() * position)),
                yaw_rad: yaw_rad + release.yaw_rad,
                stayed: release.moved_m < STAYED_M,
                as_put: stays_as_put(release),
            }
        };
        let trials: Vec<SimulatedRelease> = releases.iter().map(trial).collect();
        // The crops around trials must be kept too.
        centers.extend(trials.iter().map(|t| t.position));
        let scene = SceneCloud::new(&points, &labels, &centers, cloud).without(label);
        (!anchors.is_empty()).then_some(Self {
            query: ObjectCloud::new(&query_points, &observer, cloud)?,
            yaw_rad,
            position: viewer_from_world * position,
            scene,
            anchors,
            trials,
        })
    }

    /// The query as it rests: turned.
    pub fn placed(&self) -> ObjectCloud {
        self.query.turned(self.yaw_rad)
    }
}

/// The points of a picture, in the world, with their labels, as a sensor gives them and cleaning leaves them.
pub(crate) fn observed(
    picture: &mut Composite,
    view: &ViewRecord,
    sensor: &SensorModel,
    band_px: usize,
    rng: &mut Pcg64,
) -> (Vec<Point3<f32>>, Vec<u16>) {
    sensor.disturb(&mut picture.depth_m, &view.camera, rng.random());
    picture.drop_borders(band_px);
    picture.points_in_world(view)
}

/// Whether enough of a layer would be seen in a picture.
pub(crate) fn is_visible(picture: &Composite, layer: &Layer, label: u16, least: f64) -> bool {
    let mut with = picture.clone();
    with.add(layer, label);
    let visible = with.labels.iter().filter(|l| **l == label).count();
    visible >= PIXELS_LEAST && visible as f64 >= least * layer.count() as f64
}

pub(crate) fn tilt(deviation_rad: f32, rng: &mut Pcg64) -> Rotation3<f32> {
    let component = |rng: &mut Pcg64| (gaussian(rng) * deviation_rad).clamp(-2.0 * deviation_rad, 2.0 * deviation_rad);
    let axis = Vector3::new(component(rng), component(rng), 0.0);
    UnitQuaternion::from_scaled_axis(axis).to_rotation_matrix()
}
