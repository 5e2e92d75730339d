//! What is believed of a scene beyond what one camera saw of it: whole shapes, what stands on what, the space above the floor plan, and which
//! places were seen to be free. Whoever plans with a scene, for placements or for motions, reads it here, so that they agree where things end.
//!
//! ```
//! use repose_belief::{Belief, BeliefSettings, SeenScene};
//! use repose_geometry::transform::look_at;
//! use repose_geometry::{Point3, Vector3};
//! use repose_proto::CameraModel;
//!
//! // The front and the top of a box of 8 cm, 10 cm high, on a table; object 0 is furniture.
//! let mut points: Vec<([f32; 3], u16)> = Vec::new();
//! for (x, y) in (-40..=40).flat_map(|x| (-40..=40).map(move |y| (x as f32 * 0.01, y as f32 * 0.01))) {
//!     points.push(([x, y, 0.0], 0));
//! }
//! for (a, b) in (0..=16).flat_map(|a| (0..=20).map(move |b| (a as f32 * 0.005 - 0.04, b as f32 * 0.005))) {
//!     points.push(([a, -0.04, b], 1));
//!     points.push(([a, b.min(0.08) - 0.04, 0.1], 1));
//! }
//! let (points, labels): (Vec<[f32; 3]>, Vec<u16>) = points.into_iter().unzip();
//! let camera = CameraModel {
//!     width: 320, height: 240, fx: 240.0, fy: 240.0, cx: 159.5, cy: 119.5, depth_unit_m: 0.001, world_from_camera: None,
//! };
//! let world_from_camera = look_at(&Point3::new(0.0, -0.8, 0.7), &Point3::origin(), &Vector3::z());
//! let seen = SeenScene { points: &points, labels: &labels, surfaces: &[], camera: &camera, world_from_camera: &world_from_camera };
//! let belief = Belief::of(&seen, &BeliefSettings::default())?;
//!
//! let shape = belief.objects[&1].shape.as_ref().expect("it has an extent");
//! assert!(shape.bottom_m.abs() < 0.005, "it stands on the table");
//! assert!(shape.base.margin(&[0.0, 0.03].into()) > 0.0, "its base goes on where its front hides it");
//! # Ok::<(), repose_belief::TooWide>(())
//! ```
//!
//! Pure: from points to beliefs, with fixed rules ([`settings`]); no I/O, no random numbers.

pub mod back;
pub mod bearing;
pub mod boosted_trees;
pub mod carrying;
pub mod columns;
pub mod completion;
pub mod covering;
pub mod crown;
pub mod cut;
pub mod far_side;
pub mod farther;
pub mod filling;
pub mod foot;
pub mod foot_levels;
pub mod foot_picture;
pub mod front;
pub mod learned;
pub mod meeting;
pub mod offsets;
pub mod outlines;
pub mod plane;
mod projection;
pub mod settings;
pub mod shape;
pub mod sides;
pub mod solid;
pub mod standing;
pub mod thin;
pub mod unseen_end;
pub mod view;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use nalgebra::{Isometry3, Point2, Point3};
use rayon::prelude::*;
use repose_geometry::{Aabb, cloud};
use repose_proto::{CameraModel, Scene, Surface};

use back::Back;
use bearing::{Candidate, candidates};
use carrying::carried_by;
use columns::{ColumnMap, ColumnRun, bounds_around, cells_of, cells_of_map};
use completion::Told;
use covering::{Covered, go_on_under};
use crown::is_crowned;
use cut::Cut;
use far_side::solid_runs;
use farther::find_ends;
use filling::Filling;
use foot::Chosen;
use foot_levels::Level;
use foot_picture::DoubtfulFoot;
use front::Front;
use meeting::Edges;
use plane::SupportPlane;
use standing::{CloudExtent, ObservedGeometry};

use settings::CompletionSettings;

pub use settings::BeliefSettings;
pub use shape::Shape;
pub use view::ObservedView;

/// A labelled scene as one camera saw it.
#[derive(Debug, Clone, Copy)]
pub struct SeenScene<'a> {
    /// The points, world frame, metres.
    pub points: &'a [[f32; 3]],
    /// The object of each point, 0 for furniture. As long as `points`.
    pub labels: &'a [u16],
    /// The support surfaces, world frame.
    pub surfaces: &'a [Surface],
    /// The camera.
    pub camera: &'a CameraModel,
    /// Its pose.
    pub world_from_camera: &'a Isometry3<f64>,
}

impl<'a> SeenScene<'a> {
    /// A scene of the wire, with the pose of its camera.
    pub fn of(scene: &'a Scene, world_from_camera: &'a Isometry3<f64>) -> Self {
        let Scene { points, labels, meta, .. } = scene;
        Self { points, labels, surfaces: &meta.surfaces, camera: &meta.camera, world_from_camera }
    }
}

/// An object.
#[derive(Debug, Clone)]
pub struct BelievedObject {
    /// Its points, world frame.
    pub points: Vec<Point3<f32>>,
    /// Their mean.
    pub centroid: Point3<f64>,
    /// Its whole shape; none when its points have no extent seen from above.
    pub shape: Option<Shape>,
}

/// What is believed of a scene.
#[derive(Debug, Clone)]
pub struct Belief {
    /// Its objects by id.
    pub objects: BTreeMap<u16, BelievedObject>,
    /// Its support surfaces, as perception ranked them.
    pub planes: Vec<SupportPlane>,
    /// What stands above each cell of the floor plan.
    pub columns: ColumnMap,
    /// What the camera saw.
    pub view: ObservedView,
    carried: BTreeMap<u16, Vec<u16>>,
    /// What is measured of carriers and loads.
    bearings: BTreeMap<[u16; 2], Vec<f32>>,
    /// Objects whose tops carry nothing.
    crowned: BTreeSet<u16>,
    /// Objects that may stand elsewhere than the camera saw them.
    elsewhere: BTreeSet<u16>,
}

/// A scene whose objects are farther apart than a map reaches.
#[derive(Debug, Clone, PartialEq)]
pub struct TooWide {
    /// How far they spread, seen from above, metres.
    pub span_m: [f32; 2],
    /// How far they may, about, metres.
    pub most_m: f32,
}

impl fmt::Display for TooWide {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y] = self.span_m;
        write!(f, "the objects spread over {x:.0} m by {y:.0} m, expected about {:.0} m at most", self.most_m)
    }
}

impl std::error::Error for TooWide {}

impl Belief {
    /// What is believed of a scene.
    ///
    /// # Errors
    /// [`TooWide`].
    pub fn of(seen: &SeenScene<'_>, settings: &BeliefSettings) -> Result<Self, TooWide> {
        Self::made(seen, None, settings)
    }

    /// The same of a scene whose objects' shapes are known from elsewhere: what is believed of an object does not change when it is moved.
    ///
    /// # Errors
    /// [`TooWide`].
    pub fn with_shapes(seen: &SeenScene<'_>, shapes: BTreeMap<u16, Shape>, settings: &BeliefSettings) -> Result<Self, TooWide> {
        let elsewhere = shapes.keys().copied().collect();
        Self::made(seen, Some((shapes, elsewhere)), settings)
    }

    /// The same of the scene that is left of this one once an object was taken away or set down elsewhere, with the shapes that are known then. Beside
    /// what stands where the camera saw it, places that were seen to be free stay so.
    ///
    /// # Errors
    /// [`TooWide`].
    pub fn after(
        &self,
        moved: u16,
        left: &SeenScene<'_>,
        shapes: BTreeMap<u16, Shape>,
        settings: &BeliefSettings,
    ) -> Result<Self, TooWide> {
        let elsewhere = self.elsewhere.iter().copied().chain([moved]).collect();
        Self::made(left, Some((shapes, elsewhere)), settings)
    }

    /// The levels that the feet of a scene's objects are chosen among, by object: what [`foot`] is fitted on.
    ///
    /// # Errors
    /// [`TooWide`].
    pub fn foot_levels(seen: &SeenScene<'_>, settings: &BeliefSettings) -> Result<BTreeMap<u16, Vec<Level>>, TooWide> {
        let observed = Observed::of(seen, settings)?;
        let geometry = observed.geometry(settings);
        Ok(foot_levels(&geometry, &standing_at(&BTreeMap::new(), &geometry)))
    }

    /// The objects whose foot the trees doubt, with the picture around each and what they say of its levels: what the network that looks at feet is trained on.
    ///
    /// # Errors
    /// [`TooWide`].
    pub fn doubtful_feet(seen: &SeenScene<'_>, settings: &BeliefSettings) -> Result<BTreeMap<u16, DoubtfulFoot>, TooWide> {
        let observed = Observed::of(seen, settings)?;
        let geometry = observed.geometry(settings);
        Ok(foot_picture::doubtful(geometry.view, foot_levels(&geometry, &standing_at(&BTreeMap::new(), &geometry))))
    }

    /// What the network that completes shapes is told of a scene's objects: what it is trained on.
    ///
    /// # Errors
    /// [`TooWide`].
    pub fn completion_grids(seen: &SeenScene<'_>, settings: &BeliefSettings) -> Result<BTreeMap<u16, Told>, TooWide> {
        let observed = Observed::of(seen, settings)?;
        let geometry = observed.geometry(settings);
        let told = completed(&geometry).into_iter().filter_map(|(id, shape)| Some((id, geometry.told(id, &shape)?)));
        Ok(told.collect())
    }

    /// With shapes that are known, if any, and the objects that may stand elsewhere than the camera saw them.
    fn made(
        seen: &SeenScene<'_>,
        known: Option<(BTreeMap<u16, Shape>, BTreeSet<u16>)>,
        settings: &BeliefSettings,
    ) -> Result<Self, TooWide> {
        let observed = Observed::of(seen, settings)?;
        let geometry = observed.geometry(settings);
        let are_known = known.is_some();
        let (by_rule, elsewhere, completion) = match known {
            Some((shapes, elsewhere)) => (shapes, elsewhere, None),
            None => (completed(&geometry), BTreeSet::new(), settings.completion.as_ref()),
        };
        // What tells which objects bear which was learned with shapes that the rules complete.
        let pairs = candidates(&geometry, &by_rule);
        let carried = carried_by(&geometry, &by_rule, &pairs);
        let mut shapes = match completion {
            Some(completion) => by_network(&by_rule, &geometry, completion),
            None => by_rule,
        };
        if !are_known {
            find_ends(&mut shapes, &geometry);
        }
        // Beside what stands elsewhere the camera has not looked.
        let looks = |id: u16| (!elsewhere.contains(&id)).then_some(&observed.view);
        let of_objects = shapes.iter().flat_map(|(id, shape)| unseen_runs(*id, shape, &observed.columns, looks(*id)));
        let of_furniture = solid_runs(&observed.planes, &observed.view, &observed.columns);
        let hidden: Vec<(Point2<f32>, ColumnRun)> = of_objects.chain(of_furniture).collect();
        let Observed { clouds, columns, planes, view, .. } = observed;
        let crowned = clouds.iter().filter(|(_, points)| is_crowned(points, &settings.crown)).map(|(id, _)| *id).collect();
        let believed = clouds.into_iter().filter_map(|(id, points)| {
            let centroid = cloud::centroid(&points)?;
            // What goes on under something that was moved is among the points of a shape that was known before.
            let shape = shapes.remove(&id).map(|shape| Shape { centroid, ..shape });
            Some((id, BelievedObject { points, centroid, shape }))
        });
        let bearings = pairs.into_iter().map(|Candidate { carrier, load, measures }| ([carrier, load], measures)).collect();
        Ok(Self { objects: believed.collect(), planes, columns: columns.with(hidden), view, carried, bearings, crowned, elsewhere })
    }

    /// What is believed of a scene nothing of which counts: it has no objects, and the camera saw nothing.
    #[must_use]
    pub fn of_nothing(seen: &SeenScene<'_>, settings: &BeliefSettings) -> Self {
        let nowhere = Aabb { min: Point3::origin(), max: Point3::origin() };
        Self {
            objects: BTreeMap::new(),
            planes: Vec::new(),
            columns: ColumnMap::of_points(&[], &[], &nowhere, settings.cell_m, settings.gap_m),
            view: ObservedView::new(&[], &[], seen.camera, seen.world_from_camera, settings.view_columns),
            carried: BTreeMap::new(),
            bearings: BTreeMap::new(),
            crowned: BTreeSet::new(),
            elsewhere: BTreeSet::new(),
        }
    }

    /// Believes from now on that nothing lies on an object.
    pub fn bare(&mut self, id: u16) {
        self.carried.remove(&id);
    }

    /// The objects' shapes, of those that have one.
    pub fn shapes(&self) -> BTreeMap<u16, Shape> {
        self.objects.iter().filter_map(|(id, object)| Some((*id, object.shape.clone()?))).collect()
    }

    /// The objects that stand on an object or in it.
    pub fn carried(&self, id: u16) -> &[u16] {
        self.carried.get(&id).map_or(&[], Vec::as_slice)
    }

    /// What the picture and the shapes tell of whether one object bears another, in the order of [`bearing::MEASURES`], by carrier and load; those that are
    /// clearly apart are left out.
    pub fn bearings(&self) -> &BTreeMap<[u16; 2], Vec<f32>> {
        &self.bearings
    }

    /// Whether something can stand on an object's top: not on a ball or on a tube that lies. Furniture (0) carries.
    pub fn carries(&self, id: u16) -> bool {
        !self.crowned.contains(&id)
    }
}

/// A scene as it was seen, before anything is believed of it.
struct Observed {
    clouds: BTreeMap<u16, Vec<Point3<f32>>>,
    extents: BTreeMap<u16, CloudExtent>,
    columns: ColumnMap,
    planes: Vec<SupportPlane>,
    view: ObservedView,
    edges: BTreeMap<u16, Edges>,
}

impl Observed {
    fn of(seen: &SeenScene<'_>, settings: &BeliefSettings) -> Result<Self, TooWide> {
        let mut clouds: BTreeMap<u16, Vec<Point3<f32>>> = BTreeMap::new();
        for (p, label) in seen.points.iter().zip(seen.labels).filter(|(_, label)| **label != 0) {
            clouds.entry(*label).or_default().push(Point3::from(*p));
        }
        let bounds = bounds_of(&clouds, seen.points, settings)?;
        let extents = CloudExtent::of_all(&clouds, &settings.stack);
        let columns = ColumnMap::of_points(seen.points, seen.labels, &bounds, settings.cell_m, settings.gap_m);
        let planes: Vec<SupportPlane> = seen.surfaces.iter().filter_map(SupportPlane::of).collect();
        let view = ObservedView::new(seen.points, seen.labels, seen.camera, seen.world_from_camera, settings.view_columns);
        let edges = view.edges(settings.meeting.rows);
        Ok(Self { clouds, extents, columns, planes, view, edges })
    }

    fn geometry<'a>(&'a self, settings: &'a BeliefSettings) -> ObservedGeometry<'a> {
        let Self { clouds, extents, columns, planes, view, edges } = self;
        ObservedGeometry { clouds, extents, columns, planes, view, edges, settings }
    }
}

/// The whole shapes of the objects that were seen.
fn completed(seen: &ObservedGeometry<'_>) -> BTreeMap<u16, Shape> {
    let by_rule = standing_at(&BTreeMap::new(), seen);
    let feet: BTreeMap<u16, Chosen> = foot_picture::choices(seen.view, foot_levels(seen, &by_rule));
    let is_other = |(id, foot): &(&u16, &Chosen)| by_rule.get(id).is_some_and(|shape| shape.bottom_m != foot.height_m);
    let others: BTreeMap<u16, f32> = feet.iter().filter(is_other).map(|(id, foot)| (*id, foot.height_m)).collect();
    let mut shapes = if others.is_empty() { by_rule } else { standing_at(&others, seen) };
    for (id, foot) in feet {
        shapes.entry(id).and_modify(|shape| {
            shape.foot_probability = foot.probability as f32;
            shape.foot_doubt_m = foot.lower_m;
            shape.landing_probability = foot.landing_probability as f32;
        });
    }
    shapes
}

/// The shapes that the network completes; where it says nothing, those of the rules.
fn by_network(by_rule: &BTreeMap<u16, Shape>, seen: &ObservedGeometry<'_>, settings: &CompletionSettings) -> BTreeMap<u16, Shape> {
    let of = |(id, shape): (&u16, &Shape)| {
        let completed = seen.told(*id, shape).and_then(|told| completion::completed(&told, shape, settings, &seen.settings.shape));
        (*id, completed.unwrap_or_else(|| shape.clone()))
    };
    by_rule.par_iter().map(of).collect()
}

/// The levels that each object's foot may be at, with the shapes that the rule completes.
fn foot_levels(seen: &ObservedGeometry<'_>, by_rule: &BTreeMap<u16, Shape>) -> BTreeMap<u16, Vec<Level>> {
    let mut levels = foot_levels::levels(seen, by_rule, &candidates(seen, by_rule));
    let lowest = standing_at(&filling::lowest(&levels, seen), seen);
    filling::add(&mut levels, [&Filling::of(seen, &lowest), &Filling::of(seen, by_rule)]);
    levels
}

/// The whole shapes of objects that stand at given heights (metres), and as high as the rule says without one.
fn standing_at(feet_m: &BTreeMap<u16, f32>, seen: &ObservedGeometry<'_>) -> BTreeMap<u16, Shape> {
    let eye = seen.view.eye().xy();
    let complete = |id: u16, bottom_m: f32| {
        let front = Front::of(&seen.clouds[&id], bottom_m, &eye, &seen.settings.shape)?;
        let hidden = Back::own().hidden(&front, seen.view, seen.settings);
        let hidden = Cut::own().added_to(hidden, &front, seen.view, seen.settings);
        Some((id, Shape::complete(&front, &hidden, &seen.settings.shape)?))
    };
    let foot_m = |id: &u16| feet_m.get(id).copied().or_else(|| seen.bottom_m(*id));
    let mut shapes: BTreeMap<u16, Shape> = seen.clouds.keys().filter_map(|id| complete(*id, foot_m(id)?)).collect();
    // Some supports are known only from a carrier's completed shape.
    let by_rule = |id: &&u16| !feet_m.contains_key(*id);
    let covering: Vec<(u16, Shape)> =
        shapes.keys().filter(by_rule).filter_map(|id| complete(*id, seen.covered_top_m(*id, &shapes)?)).collect();
    shapes.extend(covering);
    // What stands on what it covers does so by the trees' word, too, unless they say another height.
    let meets =
        |id: u16, covered: &Covered| feet_m.get(&id).is_none_or(|foot_m| (foot_m - covered.contact_m).abs() <= foot_levels::RIGHT_M);
    let covered = shapes.keys().filter_map(|id| Some((*id, seen.covered_by(*id).filter(|covered| meets(*id, covered))?))).collect();
    go_on_under(&mut shapes, &covered, seen.view, seen.columns);
    shapes
}

/// The box that the map of a scene covers.
fn bounds_of(clouds: &BTreeMap<u16, Vec<Point3<f32>>>, points: &[[f32; 3]], settings: &BeliefSettings) -> Result<Aabb, TooWide> {
    let of_objects: Vec<Point3<f32>> = clouds.values().flatten().copied().collect();
    // Without objects the map is around the origin: planning then names the object that is missing.
    let bounds = bounds_around(&of_objects, points, settings.reach_m)
        .or_else(|| bounds_around(&[Point3::origin()], points, settings.reach_m))
        .unwrap_or(Aabb { min: Point3::origin(), max: Point3::origin() });
    let [columns, rows] = cells_of_map(&bounds, settings.cell_m);
    if columns.saturating_mul(rows) <= settings.max_cells {
        return Ok(bounds);
    }
    let span_m = bounds.max - bounds.min;
    Err(TooWide { span_m: [span_m.x, span_m.y], most_m: (settings.max_cells as f32).sqrt() * settings.cell_m })
}

/// The parts of a shape that must be there though no point shows them: under its tops, and behind its front.
///
/// What is hidden looks like what was seen of the object, turned by half a turn: the far side of a bowl's inside tells how deep the near side is. Where the
/// camera saw past a place nothing is hidden: a pan has one handle.
fn unseen_runs(id: u16, shape: &Shape, seen: &ColumnMap, looks: Option<&ObservedView>) -> Vec<(Point2<f32>, ColumnRun)> {
    let mut runs = Vec::new();
    let own_top_m = |place: &Point2<f32>| seen.at(place).iter().filter(|r| r.object == id).map(|r| r.high_m).reduce(f32::max);
    for slab in &shape.slabs {
        for center in cells_of(&slab.reach, 0.0, seen) {
            // A hollow that was looked into is as deep as it was seen to be.
            let own_m = own_top_m(&center).or_else(|| own_top_m(&(shape.turn_axis + (shape.turn_axis - center))));
            let high_m = own_m.unwrap_or(slab.high_m).min(slab.high_m);
            let middle = Point3::new(center.x, center.y, (slab.low_m + high_m) / 2.0);
            if high_m > slab.low_m && !looks.is_some_and(|view| view.is_free(&middle)) {
                runs.push((center, ColumnRun { low_m: slab.low_m, high_m, object: id, seen: false }));
            }
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::{SceneBuilder, world_from_camera};

    use super::*;

    #[test]
    fn the_inside_of_a_box_is_filled_down_to_the_table_and_the_space_under_a_board_is_not() {
        let filled_from_m = |base_m: f64, height_m: f64| {
            let scene = SceneBuilder::table().object_at(0, [0.0, 0.0], base_m, [0.3, 0.2, height_m]).scene();
            let belief = believed(&scene);
            // Behind the middle: the camera sees the top there and nothing below it.
            let inside = belief.columns.at(&Point2::new(0.05, 0.06)).iter().filter(|run| run.object == 0 && run.high_m > 0.15);
            inside.map(|run| run.low_m).reduce(f32::min).expect("there is a top")
        };
        assert!(filled_from_m(0.0, 0.2) < 0.03, "{}", filled_from_m(0.0, 0.2));
        assert!(filled_from_m(0.18, 0.02) > 0.05, "{}", filled_from_m(0.18, 0.02));
    }

    #[test]
    fn what_was_seen_to_be_free_beside_one_handle_is_no_other_handle() {
        // A pot and its handle to the right.
        let scene =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.16, 0.16, 0.08]).object_at(1, [0.15, 0.0], 0.05, [0.14, 0.03, 0.02]).scene();
        let belief = believed(&scene);
        let filled = |x: f32, y: f32| belief.columns.at(&Point2::new(x, y)).iter().any(|run| run.object == 1);
        assert!(filled(0.0, 0.0) && filled(0.0, 0.07) && filled(0.19, 0.0), "the pot with its back, and its handle");
        // Turned by half a turn the pot is around its handle.
        let shape = belief.objects[&1].shape.as_ref().expect("it has an extent");
        assert!(shape.slabs.iter().any(|slab| slab.outline.margin(&Point2::new(0.17, -0.055)) > 0.0));
        assert!(!filled(0.17, -0.055), "the table was seen there");
        assert!(filled(0.17, 0.055), "behind the handle nobody knows");
    }

    #[test]
    fn what_a_camera_without_a_focal_length_saw_is_believed_all_the_same_and_has_an_end() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).scene();
        // All that it may show is beside its picture.
        let camera = CameraModel { fx: 1e-300, fy: 1e-300, cx: -9.0, ..scene.meta.camera.clone() };
        let held = world_from_camera();
        let seen = SeenScene { camera: &camera, ..SeenScene::of(&scene, &held) };
        let belief = Belief::of(&seen, &BeliefSettings::default()).expect("a small scene");
        let shape = belief.objects[&1].shape.as_ref().expect("it has an extent");
        assert!(shape.slabs.iter().all(|slab| slab.low_m.is_finite() && slab.outline.area() < 10.0), "{shape:?}");
        assert!(shape.ends.iter().all(|end| end.chances.iter().all(|chance| (0.0..=1.0).contains(chance))), "{shape:?}");
    }

    /// What is believed of a made scene.
    pub(crate) fn believed(scene: &Scene) -> Belief {
        Belief::of(&SeenScene::of(scene, &world_from_camera()), &BeliefSettings::default()).expect("a small scene")
    }
}
