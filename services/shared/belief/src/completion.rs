//! The shape that a network completes ([`repose_networks::completion`]): what was seen in a grid over an object, and what is made of the answer.
//!
//! The grid lies over what the rules believe of the object ([`crate::shape`]) and some way beyond, its rows away from the camera, and has slabs from the
//! bottom to the top. Of each cell the network is told how many of the object's points are in it, how far behind it the camera read something and whose that
//! was, and whether the rules fill it.

use std::sync::OnceLock;

use nalgebra::{Point2, Point3, Vector2};
use repose_geometry::Footprint;
use repose_networks::completion::{CHANNELS, CompletionNetwork, OF_OBJECT, OF_SLAB, SIDE, SLABS};

use crate::front::{Front, span};
use crate::settings::{CompletionSettings, ShapeSettings};
use crate::shape::{Shape, Slab, merged};
use crate::standing::ObservedGeometry;
use crate::view::ObservedView;

/// How much wider than the believed shape the grid is.
const WIDER: f32 = 1.3;
/// Least half of its width, metres.
const LEAST_HALF_M: f32 = 0.013;
/// Cells are no larger than this in training scenes, but for one object in a thousand, metres.
const MOST_CELL_M: f32 = 0.027;
/// What is farther behind a cell, or before it, is as far, metres.
const BEHIND_M: f32 = 0.06;
/// Told as how far behind a cell something was read where that is beyond the picture's edge, and not merely without a reading: nothing's surface is nearer.
const BEYOND_EDGE: f32 = -1.0;
/// Sizes that are told as logarithms are told as shares of these: of a cell and of a slab, metres, and points.
const USUAL: [f32; 3] = [0.008, 0.012, 1000.0];

/// What the network is told of an object.
#[derive(Debug, Clone, PartialEq)]
pub struct Told {
    /// How many points were seen of it.
    pub points: usize,
    /// Those that count, with the object's bottom and top.
    pub front: Front,
    /// The grid over it.
    pub grid: Grid,
    /// What was seen of each cell, row by row.
    pub cells: Vec<[f32; CHANNELS]>,
}

impl ObservedGeometry<'_> {
    /// What the network is told of an object that the rules have completed; none where too little was seen of it.
    pub(crate) fn told(&self, id: u16, by_rule: &Shape) -> Option<Told> {
        let points = self.clouds.get(&id)?;
        let front = Front::of(points, by_rule.bottom_m, &self.view.eye().xy(), &self.settings.shape)?;
        let grid = Grid::over(&front, by_rule);
        let cells = grid.cells(&Seen { id, points: points.len(), front: &front, shape: by_rule, view: self.view });
        Some(Told { points: points.len(), front, grid, cells })
    }
}

/// Completes an object; none where nothing is likely enough, and where it is larger than what was learned from.
pub fn completed(told: &Told, by_rule: &Shape, settings: &CompletionSettings, shapes: &ShapeSettings) -> Option<Shape> {
    Answer { grid: &told.grid, filled: filled(told)? }.shape(&told.front, by_rule, settings, shapes)
}

/// How likely an object fills the cells of its grid, row by row, and slab; none where it is larger than what was learned from.
pub fn filled(told: &Told) -> Option<Vec<[f32; SLABS]>> {
    (told.grid.cell_m <= MOST_CELL_M).then(|| network().filled(&told.cells))
}

/// The network that comes with the program.
pub(crate) fn network() -> &'static CompletionNetwork {
    static NETWORK: OnceLock<CompletionNetwork> = OnceLock::new();
    NETWORK.get_or_init(|| CompletionNetwork::embedded().expect("the weights that come with the program: tested"))
}

/// What is known of an object that is to be completed.
#[derive(Clone, Copy)]
struct Seen<'a> {
    id: u16,
    /// How many points were seen of it; those that count are in its front.
    points: usize,
    front: &'a Front,
    /// What the rules believe.
    shape: &'a Shape,
    view: &'a ObservedView,
}

/// A grid over an object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Its middle, seen from above.
    pub middle: Point2<f32>,
    /// Where its rows follow each other: away from the camera.
    pub away: Vector2<f32>,
    /// Where the cells of a row follow each other: to the left of that.
    pub across: Vector2<f32>,
    /// Edge of a cell, metres.
    pub cell_m: f32,
    /// Height of its bottom, world z, metres.
    pub bottom_m: f32,
    /// Height of a slab, metres.
    pub slab_m: f32,
}

impl Grid {
    /// Over a believed shape.
    pub fn over(front: &Front, shape: &Shape) -> Self {
        let (away, across) = (front.away, front.across);
        let corners: Vec<Point2<f32>> = shape.slabs.iter().flat_map(|s| s.outline.corners()).flat_map(|c| [*c, c + shape.doubt]).collect();
        let [[near_m, far_m], [right_m, left_m]] = [away, across].map(|along| span(&corners, &along));
        let half_m = ((far_m - near_m).max(left_m - right_m) / 2.0 * WIDER).max(LEAST_HALF_M);
        Self {
            middle: Point2::from(away * ((near_m + far_m) / 2.0) + across * ((right_m + left_m) / 2.0)),
            away,
            across,
            cell_m: 2.0 * half_m / SIDE as f32,
            bottom_m: shape.bottom_m,
            slab_m: (shape.top_m - shape.bottom_m) / SLABS as f32,
        }
    }

    /// The place of a row and a cell in it, counted from the middle of the first, seen from above.
    fn at(&self, row: f32, cell: f32) -> Point2<f32> {
        let from_middle_m = |count: f32| (count + 0.5 - SIDE as f32 / 2.0) * self.cell_m;
        self.middle + self.away * from_middle_m(row) + self.across * from_middle_m(cell)
    }

    /// The middle of a cell of a slab, world frame.
    pub fn place(&self, slab: usize, row: usize, cell: usize) -> Point3<f32> {
        let at = self.at(row as f32, cell as f32);
        Point3::new(at.x, at.y, self.bottom_m + (slab as f32 + 0.5) * self.slab_m)
    }

    /// The slab, the row and the cell of a point; none beside the grid. What is below the bottom or above the top is in the nearest slab.
    fn cell_of(&self, point: &Point3<f32>) -> Option<[usize; 3]> {
        let from_middle = point.xy() - self.middle;
        let count = |along: &Vector2<f32>| from_middle.dot(along) / self.cell_m + SIDE as f32 / 2.0;
        let within = |count: f32| (0.0..SIDE as f32).contains(&count).then_some(count as usize);
        let slab = ((point.z - self.bottom_m) / self.slab_m).clamp(0.0, SLABS as f32 - 0.5) as usize;
        Some([slab, within(count(&self.away))?, within(count(&self.across))?])
    }

    /// What the network is told of each cell, row by row.
    fn cells(&self, seen: &Seen<'_>) -> Vec<[f32; CHANNELS]> {
        let Seen { id, points, front, shape, view } = *seen;
        let mut counts = [[0u32; SLABS]; SIDE * SIDE];
        for [slab, row, cell] in front.points.iter().filter_map(|p| self.cell_of(p)) {
            counts[row * SIDE + cell][slab] += 1;
        }
        let sight = view.eye() - self.place(0, SIDE / 2, SIDE / 2);
        let [of_cell, of_slab, of_points] = USUAL;
        let of_whole: [f32; OF_OBJECT] = [
            (self.cell_m / of_cell).ln(),
            (self.slab_m.max(1e-4) / of_slab).ln(),
            shape.foot_probability,
            (view.eye().z - self.bottom_m) / sight.norm().max(1e-6),
            (points.max(1) as f32 / of_points).ln(),
        ];
        let told = |(index, counts): (usize, &[u32; SLABS])| {
            let mut told = [0.0; CHANNELS];
            let (of_slabs, rest) = told.split_at_mut(OF_SLAB * SLABS);
            rest.copy_from_slice(&of_whole);
            for (slab, told) in of_slabs.chunks_exact_mut(OF_SLAB).enumerate() {
                let place = self.place(slab, index / SIDE, index % SIDE);
                told[0] = ((counts[slab] as f32).ln_1p() / 4.0).min(1.0);
                if let Some(reading) = view.reading(&place) {
                    told[1] = (reading.behind_m / BEHIND_M).clamp(-1.0, 1.0);
                    told[if reading.object == id {
                        2
                    } else if reading.object != 0 {
                        3
                    } else {
                        4
                    }] = 1.0;
                } else if !view.shows(&place) {
                    told[1] = BEYOND_EDGE;
                }
                let fills = |s: &Slab| (s.low_m..=s.high_m).contains(&place.z) && s.outline.margin(&place.xy()) >= 0.0;
                told[5] = f32::from(u8::from(shape.slabs.iter().any(fills)));
            }
            told
        };
        counts.iter().enumerate().map(told).collect()
    }
}

/// How likely the cells of a grid are filled.
struct Answer<'a> {
    grid: &'a Grid,
    /// By cell, row by row, and slab.
    filled: Vec<[f32; SLABS]>,
}

impl Answer<'_> {
    fn shape(&self, front: &Front, by_rule: &Shape, settings: &CompletionSettings, shapes: &ShapeSettings) -> Option<Shape> {
        let Grid { bottom_m, slab_m, .. } = *self.grid;
        let mut slabs: Vec<Slab> = Vec::with_capacity(SLABS);
        // From the top down: of what nothing is likely looks like what is above it.
        for slab in (0..SLABS).rev() {
            let (low_m, high_m) = (bottom_m + slab as f32 * slab_m, bottom_m + (slab + 1) as f32 * slab_m);
            let of_points = front.points.iter().filter(|p| p.z > low_m && p.z <= high_m).map(|p| p.xy());
            let of_points: Vec<Point2<f32>> = of_points.collect();
            let of_level = |level: f32| Footprint::of_places(self.crossings(slab, level).into_iter().chain(of_points.iter().copied()));
            let of_levels = of_level(settings.filled_from).zip(of_level(settings.reaches_from));
            let of_levels =
                of_levels.and_then(|(outline, reach)| Some(Slab { low_m, high_m, reach: reach.around_both(&outline)?, outline }));
            if let Some(slab) = of_levels.or_else(|| slabs.last().map(|above| Slab { low_m, high_m, ..above.clone() })) {
                slabs.push(slab);
            }
        }
        slabs.first_mut()?.high_m = by_rule.top_m;
        slabs.reverse();
        let axis = self.center_of_mass()?;
        let base = self.base(&axis, &by_rule.base, settings)?;
        let reach_m = |places: &[Point2<f32>]| span(places, &front.away)[1];
        let believed_m = slabs.iter().map(|s| reach_m(s.reach.corners())).fold(f32::NEG_INFINITY, f32::max);
        let possible_m = (0..SLABS).map(|slab| reach_m(&self.crossings(slab, settings.doubted_from))).fold(f32::NEG_INFINITY, f32::max);
        let doubt = front.away * (possible_m - believed_m).max(0.0);
        let slabs = merged(slabs, shapes.same_area_ratio);
        Some(Shape { axis, slabs, base, doubt, ..by_rule.clone() })
    }

    /// What it stands on: as much of the lowest slab as is likely, and more of it where its centre of mass would not be over that, for it stands.
    fn base(&self, axis: &Point2<f32>, by_rule: &Footprint, settings: &CompletionSettings) -> Option<Footprint> {
        let bears = |base: &Footprint| base.margin(axis) > settings.base_margin_m;
        let of_level = |level: f32| Footprint::of_places(self.crossings(0, level));
        let likely = of_level(settings.base_from);
        let possible = || [0.7, 0.4, 0.2].into_iter().filter_map(|share| of_level(share * settings.base_from)).find(bears);
        let with_rule = || likely.as_ref().map_or_else(|| Some(by_rule.clone()), |likely| likely.around_both(by_rule));
        likely.clone().filter(bears).or_else(possible).or_else(with_rule)
    }

    /// Where it is as likely as that that a slab ends, seen from above: between the middles of neighbouring cells, along rows and across them.
    fn crossings(&self, slab: usize, level: f32) -> Vec<Point2<f32>> {
        let at = |row: usize, cell: usize| self.filled[row * SIDE + cell][slab];
        let mut crossings = Vec::new();
        for line in 0..SIDE {
            for (along, value) in [(true, &(|k| at(k, line)) as &dyn Fn(usize) -> f32), (false, &|k| at(line, k))] {
                let mut before = 0.0;
                for k in 0..=SIDE {
                    let here = if k < SIDE { value(k) } else { 0.0 };
                    if (before > level) != (here > level) {
                        let to = k as f32 - 1.0 + (level - before) / (here - before);
                        crossings.push(if along { self.grid.at(to, line as f32) } else { self.grid.at(line as f32, to) });
                    }
                    before = here;
                }
            }
        }
        crossings
    }

    /// Where the centre of mass is believed to be, seen from above: of all cells, as far as they are likely filled.
    fn center_of_mass(&self) -> Option<Point2<f32>> {
        let mut sum = 0.0;
        let mut moment = Vector2::zeros();
        for (index, slabs) in self.filled.iter().enumerate() {
            let weight: f32 = slabs.iter().sum();
            sum += weight;
            moment += self.grid.at((index / SIDE) as f32, (index % SIDE) as f32).coords * weight;
        }
        (sum > 0.0).then(|| Point2::from(moment / sum))
    }
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::{SceneBuilder, world_from_camera};

    use super::*;
    use crate::settings::BeliefSettings;
    use crate::{Belief, SeenScene};

    fn grid() -> Grid {
        let (away, across) = (Vector2::y(), -Vector2::x());
        Grid { middle: Point2::new(0.3, -0.1), away, across, cell_m: 0.01, bottom_m: 0.2, slab_m: 0.01 }
    }

    /// Of which as much as told is likely in the cells whose middles lie within so far of the grid's, along its rows and across.
    fn answer(grid: &Grid, rows_m: f32, cells_m: f32, likely: f32) -> Answer<'_> {
        let is_within = |index: usize| {
            let off = grid.place(0, index / SIDE, index % SIDE).xy() - grid.middle;
            off.dot(&grid.away).abs() < rows_m && off.dot(&grid.across).abs() < cells_m
        };
        Answer { grid, filled: (0..SIDE * SIDE).map(|index| [if is_within(index) { likely } else { 0.0 }; SLABS]).collect() }
    }

    #[test]
    fn points_are_in_the_cells_whose_middles_they_are() {
        let grid = grid();
        for (slab, row, cell) in [(0, 0, 0), (3, 7, 20), (SLABS - 1, SIDE - 1, SIDE - 1)] {
            assert_eq!(grid.cell_of(&grid.place(slab, row, cell)), Some([slab, row, cell]));
        }
        assert_eq!(grid.cell_of(&Point3::new(0.3, -0.1 + 0.121, 0.2)), None);
        assert_eq!(grid.cell_of(&Point3::new(0.301, -0.099, 9.0)).map(|[slab, ..]| slab), Some(SLABS - 1));
    }

    #[test]
    fn what_is_beyond_the_edge_of_the_picture_is_told_apart_from_what_has_no_reading() {
        // Half of it is beyond the picture's edge, and the table ends before it does.
        let scene = SceneBuilder::table().object(1, [0.56, 0.0], [0.12, 0.1, 0.1]).scene();
        let pose = world_from_camera();
        let seen = SeenScene::of(&scene, &pose);
        let view = Belief::of(&seen, &BeliefSettings::default()).expect("a small scene").view;
        let Told { grid, cells, .. } = &Belief::completion_grids(&seen, &BeliefSettings::default()).expect("a small scene")[&1];
        let [mut beyond, mut unread] = [0; 2];
        for (index, cell) in cells.iter().enumerate() {
            for (slab, told) in cell[..OF_SLAB * SLABS].chunks_exact(OF_SLAB).enumerate() {
                let place = grid.place(slab, index / SIDE, index % SIDE);
                if view.reading(&place).is_none() {
                    let is_beyond = !view.shows(&place);
                    assert_eq!(told[1..5], [if is_beyond { -1.0 } else { 0.0 }, 0.0, 0.0, 0.0], "{place}");
                    *(if is_beyond { &mut beyond } else { &mut unread }) += 1;
                }
            }
        }
        assert!(beyond > 100 && unread > 100, "{beyond}, {unread}");
    }

    #[test]
    fn a_slab_ends_between_the_cells_where_the_level_is_crossed() {
        let grid = grid();
        let of = |level: f32| Footprint::of_places(answer(&grid, 0.05, 0.03, 0.8).crossings(2, level)).expect("it has an extent");
        // Middles of cells are every centimetre from 5 mm on: the last of ten rows is at 4.5 cm, and what is likely falls to nothing at 5.5 cm.
        let (low, high) = of(0.4).bounds();
        assert!((high - Point2::new(0.3 + 0.03, -0.1 + 0.05)).amax() < 1e-5, "half of what is likely, half way: {high}");
        assert!((low - Point2::new(0.3 - 0.03, -0.1 - 0.05)).amax() < 1e-5, "{low}");
        assert!(of(0.1).area() > of(0.4).area() && of(0.7).area() < of(0.4).area());
        assert!(answer(&grid, 0.05, 0.03, 0.3).crossings(2, 0.4).is_empty(), "nothing is as likely");
    }

    #[test]
    fn the_base_of_what_stands_is_under_its_centre_of_mass() {
        let (grid, settings) = (grid(), CompletionSettings::default());
        let by_rule = Footprint::of_places([[0.2, -0.2], [0.4, -0.2], [0.4, 0.0], [0.2, 0.0]].map(Point2::from)).unwrap();
        let base = |likely: f32, off: f32| {
            answer(&grid, 0.02, 0.02, likely).base(&(grid.middle + Vector2::x() * off), &by_rule, &settings).unwrap()
        };
        assert!(base(0.9, 0.0).area() < 0.003, "as large as is likely");
        assert!(base(0.3, 0.0).area() < 0.003, "or as is possible, where nothing is likely");
        assert!(base(0.9, 0.05).margin(&(grid.middle + Vector2::x() * 0.05)) > settings.base_margin_m, "or as large as the rules say");
    }

    #[test]
    fn what_was_seen_of_a_box_from_one_side_is_completed_to_the_box() {
        for (at, size) in [([0.0, 0.0], [0.08, 0.06, 0.12]), ([0.15, 0.1], [0.06, 0.1, 0.08]), ([-0.2, 0.05], [0.12, 0.07, 0.06])] {
            let scene = SceneBuilder::table().object(1, at, size).scene();
            let belief = Belief::of(&SeenScene::of(&scene, &world_from_camera()), &BeliefSettings::of_shapes(true)).expect("a small scene");
            let shape = belief.objects[&1].shape.as_ref().expect("it has an extent");
            let (low, high) = Footprint::of(&shape.corners().collect::<Vec<_>>()).unwrap().bounds();
            for k in 0..2 {
                let ends = [at[k] - size[k] / 2.0, at[k] + size[k] / 2.0];
                assert!(
                    (f64::from(low[k]) - ends[0]).abs() < 0.015 && (f64::from(high[k]) - ends[1]).abs() < 0.015,
                    "{at:?}: {low} to {high}"
                );
                assert!((f64::from(shape.axis[k]) - at[k]).abs() < 0.008, "{at:?}: {}", shape.axis);
            }
            let keeps_clear = |slab: &Slab| slab.outline.corners().iter().all(|corner| slab.reach.margin(corner) > -1e-5);
            assert!(shape.slabs.iter().all(keeps_clear), "{shape:?}");
            assert!((f64::from(shape.top_m) - size[2]).abs() < 0.005 && shape.base.margin(&shape.axis) > 0.015, "{shape:?}");
        }
    }
}
