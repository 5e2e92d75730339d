//! The object to move, in the form that candidates are tried with: its completed shape as cells around its observed centroid.
//!
//! A cell is an offset from that centroid, about which candidates turn, so that trying a candidate takes one look-up per cell in the map.

use nalgebra::{Point2, Point3, Vector2};
use repose_geometry::Footprint;
use repose_proto::CallError;

use crate::scene::prepared::PreparedScene;
use crate::settings::Fixed;
use repose_belief::farther::reach_m;
use repose_belief::front::span;
use repose_belief::offsets::Offsets;
use repose_belief::outlines::to_outline_m;
use repose_belief::shape::{Shape, Slab};
use repose_belief::unseen_end::UnseenEnd;

/// Beyond the clearance ring a cell counts that the shape reaches with this chance, …
const LEAST_CHANCE: f32 = 0.1;
/// … and that is no farther from the outline than this, metres: what goes on farther is rare, and each cell is asked of each candidate.
const LONGEST_M: f32 = 0.08;

/// A cell in or around a prism.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutlineCell {
    /// From the observed centroid, world axes, metres.
    pub offset: Vector2<f32>,
    /// How far inside the prism's outline, metres; negative: how far outside of the line of an edge.
    pub inside_m: f32,
    /// How far from the outline, metres; 0 inside. Beyond a corner that is farther than outside of any edge's line.
    pub apart_m: f32,
    /// Whether it is outside the outline, but the shape may reach there ([`Shape::doubt`]).
    pub doubtful: bool,
    /// How likely the shape reaches there, outside the outline: by its ends that may be farther out ([`Shape::ends`]).
    pub chance: f32,
}

/// One prism of the query's shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Prism {
    /// Bottom above the query's bottom, metres.
    pub low_m: f32,
    /// Top above the query's bottom, metres.
    pub high_m: f32,
    /// The cells inside it, those within the clearance ring around it, and those that it may well reach.
    pub cells: Vec<OutlineCell>,
    /// The offsets of those.
    pub offsets: Offsets,
    /// How many of them are inside.
    pub inside: usize,
    /// How many of them are doubtful.
    pub doubtful: usize,
    /// A few places inside it, from the observed centroid: enough to sample the prism's volume.
    pub sparse: Vec<Vector2<f32>>,
}

/// The query of a request.
#[derive(Debug, Clone)]
pub struct QueryObject {
    /// Its id.
    pub id: u16,
    /// Its completed shape where it was observed, or turned over there.
    pub shape: Shape,
    /// Whether it was turned over.
    pub is_turned_over: bool,
    /// The cells of its base, from the observed centroid.
    pub base: Offsets,
    /// The band of cells around those.
    pub rim: Offsets,
    /// How far inside its own base the axis is, metres: the support margin on a flat floor.
    pub base_margin_m: f64,
    /// The same as the cells of its base tell it, which end up to a cell before its edge; none where these are hardly more than a line.
    pub told_margin_m: Option<f64>,
    /// Its shape, from the bottom up.
    pub prisms: Vec<Prism>,
    /// How far from the observed centroid its cells are, all of them, metres.
    pub reach_m: f32,
    /// How far outside of its prisms those of the clearance rings are, metres.
    pub ring_m: f32,
    /// Some of its observed points, spread over the cloud, to judge visibility by, world frame.
    pub view_points: Vec<Point3<f64>>,
}

impl QueryObject {
    /// The query of that id, with a clearance ring that measures at least `min_clearance_m`.
    ///
    /// # Errors
    /// As [`PreparedScene::movable`].
    pub fn new(prepared: &PreparedScene, id: u16, min_clearance_m: f64, fixed: &Fixed) -> Result<Self, CallError> {
        let (object, shape) = prepared.movable(id)?;
        let cell_m = prepared.belief.columns.cell_m();
        let origin = object.centroid.xy().cast::<f32>();
        let ring_m = (min_clearance_m as f32 + 2.0 * cell_m).clamp(fixed.clearance.ring_m, fixed.clearance.max_ring_m + 2.0 * cell_m);
        let prisms: Vec<Prism> = shape
            .slabs
            .iter()
            .map(|slab| {
                let mut cells = cells_around(&slab.reach, &ends_of(slab, shape), &origin, ring_m, cell_m);
                let doubtful = doubt(&mut cells, &slab.reach, &origin, &shape.doubt, ring_m);
                let inside = cells.iter().filter(|c| c.inside_m >= 0.0).count();
                let sparse = cells_around(&slab.reach, &[], &origin, 0.0, fixed.unseen.step_m).into_iter().map(|c| c.offset).collect();
                let offsets = cells.iter().map(|cell| cell.offset).collect();
                Prism { low_m: slab.low_m - shape.bottom_m, high_m: slab.high_m - shape.bottom_m, cells, offsets, inside, doubtful, sparse }
            })
            .collect();
        let (base, rim): (Vec<OutlineCell>, Vec<OutlineCell>) =
            cells_around(&shape.base, &[], &origin, fixed.soundness.rim_m, cell_m).into_iter().partition(|c| c.inside_m >= 0.0);
        let stride = object.points.len().div_ceil(fixed.view.sample_points).max(1);
        Ok(Self {
            id,
            told_margin_m: told_outline(&base, cell_m).map(|told| f64::from(told.margin(&Point2::from(shape.axis_offset())))),
            base: base.into_iter().map(|c| c.offset).collect(),
            rim: rim.into_iter().map(|c| c.offset).collect(),
            base_margin_m: f64::from(shape.base.margin(&shape.axis)).max(0.0),
            reach_m: prisms.iter().flat_map(|p| &p.cells).map(|cell| cell.offset.norm()).fold(0.0, f32::max),
            ring_m: prisms.iter().flat_map(|p| &p.cells).map(|cell| -cell.inside_m).filter(|out_m| *out_m <= ring_m).fold(0.0, f32::max),
            prisms,
            view_points: object.points.iter().step_by(stride).map(|p| p.cast()).collect(),
            shape: shape.clone(),
            is_turned_over: prepared.turned_over == Some(id),
        })
    }

    /// Its shape where it stands: a place that is free once it is picked up. None of an object that was turned over, which never stood as its shape says.
    pub fn stands(&self) -> Option<&Shape> {
        (!self.is_turned_over).then_some(&self.shape)
    }

    /// The height of the bottom of the query with its centroid at a height, metres.
    pub fn bottom_of(&self, centroid_m: f32) -> f32 {
        centroid_m - self.shape.centroid_height_m()
    }
}

/// An end as a prism has it.
struct PrismEnd {
    end: UnseenEnd,
    /// How much farther out the whole shape is believed to reach there than the prism, metres.
    behind_m: f32,
}

/// The ends of a shape as one of its prisms has them.
fn ends_of(slab: &Slab, shape: &Shape) -> Vec<PrismEnd> {
    let behind_m = |end: &UnseenEnd| (reach_m(shape, &end.outwards) - span(slab.reach.corners(), &end.outwards)[1]).max(0.0);
    shape.ends.iter().map(|end| PrismEnd { end: *end, behind_m: behind_m(end) }).collect()
}

/// Marks the cells outside an outline, up to `ring_m` from it, that the outline sweeps when it is shifted by `by`; returns how many.
pub fn doubt(cells: &mut [OutlineCell], outline: &Footprint, origin: &Point2<f32>, by: &Vector2<f32>, ring_m: f32) -> usize {
    if *by == Vector2::zeros() {
        return 0;
    }
    let Some(swept) = Footprint::of_places(outline.corners().iter().flat_map(|c| [*c, c + by])) else { return 0 };
    for cell in cells.iter_mut() {
        cell.doubtful = cell.inside_m < 0.0 && cell.inside_m >= -ring_m && swept.margin(&(origin + cell.offset)) >= 0.0;
    }
    cells.iter().filter(|c| c.doubtful).count()
}

/// How likely a shape reaches a place outside of one of its outlines: by the end that is likeliest to come so far out. What is not farther out than all of
/// the shape is believed to be says nothing.
fn chance_of(place: &Point2<f32>, outline: &Footprint, ends: &[PrismEnd]) -> f32 {
    let farther_m = |of: &PrismEnd| of.end.out_m(place, outline.corners()).map(|out_m| out_m - of.behind_m).filter(|m| *m > 0.0);
    ends.iter().filter_map(|of| Some(of.end.chance(farther_m(of)?))).fold(0.0, f32::max)
}

/// The outline of the cells of a base; none of a line, nor of what is no wider than half a cell.
fn told_outline(base: &[OutlineCell], cell_m: f32) -> Option<Footprint> {
    let is_wide = |outline: &Footprint| {
        let (min, max) = outline.bounds();
        outline.area() >= 0.5 * cell_m * (max - min).norm()
    };
    Footprint::of_places(base.iter().map(|c| Point2::from(c.offset))).filter(is_wide)
}

/// Cells every `cell_m` in an outline, up to `ring_m` around it, and where one of the ends that may be farther out may well reach.
fn cells_around(outline: &Footprint, ends: &[PrismEnd], origin: &Point2<f32>, ring_m: f32, cell_m: f32) -> Vec<OutlineCell> {
    let (min, max) = outline.bounds();
    let middle = nalgebra::center(&min, &max);
    let longest_m = ends.iter().map(|of| of.behind_m + of.end.longest_m(LEAST_CHANCE)).fold(0.0, f32::max).min(LONGEST_M);
    let asked_m = ring_m.max(longest_m);
    let half = ((max - min) / 2.0).map(|v| ((v + asked_m) / cell_m).ceil() as i32);
    let mut cells = Vec::new();
    for j in -half.y..=half.y {
        for i in -half.x..=half.x {
            let at = middle + Vector2::new(i as f32, j as f32) * cell_m;
            let inside_m = outline.margin(&at);
            let chance = if inside_m < 0.0 && inside_m >= -asked_m { chance_of(&at, outline, ends) } else { 0.0 };
            if inside_m >= -ring_m || chance >= LEAST_CHANCE {
                let apart_m = if inside_m < 0.0 { to_outline_m(&at, outline.corners()) } else { 0.0 };
                cells.push(OutlineCell { offset: at - origin, inside_m, apart_m, doubtful: false, chance });
            }
        }
    }
    cells
}
