//! What every object of a scene stands on: how high its bottom is.
//!
//! An object hides most of what it stands on, and border cleaning trims its own lowest points. So the strip around it tells: the highest
//! level that something else shows there, unless what was seen speaks against the object's reaching down to it: another object's points
//! right under it, or a camera that looked through the place where its lower part would be.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point2, Point3, Vector2};
use repose_geometry::{Aabb, Footprint, cloud};

use crate::columns::{ColumnMap, cells_of};
use crate::meeting::Edges;
use crate::outlines::are_clearly_apart;
use crate::plane::SupportPlane;
use crate::settings::{BeliefSettings, StackSettings};
use crate::shape::{Shape, Slab};
use crate::view::ObservedView;

/// The observed geometry of a scene, before its objects are completed.
#[derive(Debug, Clone, Copy)]
pub struct ObservedGeometry<'a> {
    /// The points by object, world frame.
    pub clouds: &'a BTreeMap<u16, Vec<Point3<f32>>>,
    /// How far each of them reaches ([`CloudExtent::of_all`]).
    pub extents: &'a BTreeMap<u16, CloudExtent>,
    /// Runs above the floor plan.
    pub columns: &'a ColumnMap,
    /// The support surfaces.
    pub planes: &'a [SupportPlane],
    /// The camera's picture.
    pub view: &'a ObservedView,
    /// Where each object's picture ends.
    pub edges: &'a BTreeMap<u16, Edges>,
    /// Tolerances.
    pub settings: &'a BeliefSettings,
}

/// How far an object's points reach: every other object asks about it.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudExtent {
    /// Their outline seen from above; none of a line.
    pub outline: Option<Footprint>,
    /// The height of the lowest of them but some stray ones, world z, metres.
    pub lowest_m: f32,
    /// The same of the highest.
    pub highest_m: f32,
}

impl CloudExtent {
    /// Of all objects' points.
    pub fn of_all(clouds: &BTreeMap<u16, Vec<Point3<f32>>>, settings: &StackSettings) -> BTreeMap<u16, Self> {
        let of = |points: &[Point3<f32>]| {
            let lowest = |sign: f32| nth(points.iter().map(|p| sign * p.z).collect(), settings.stray_points);
            Some(Self { outline: Footprint::of(points), lowest_m: lowest(1.0)?, highest_m: -lowest(-1.0)? })
        };
        clouds.iter().filter_map(|(id, points)| Some((*id, of(points)?))).collect()
    }
}

impl ObservedGeometry<'_> {
    /// The height of an object's bottom, world z, metres; `None` for an object without extent.
    ///
    /// Whatever tells it, it is not above what was seen of the object: set down as if it were, the object would be pressed in.
    pub fn bottom_m(&self, id: u16) -> Option<f32> {
        Some(self.told_bottom_m(id)?.min(self.extents.get(&id)?.lowest_m))
    }

    /// The outline of an object's points seen from above.
    pub fn outline(&self, id: u16) -> Option<&Footprint> {
        self.extents.get(&id)?.outline.as_ref()
    }

    /// The height that the surroundings of an object tell.
    fn told_bottom_m(&self, id: u16) -> Option<f32> {
        let (points, settings) = (self.clouds.get(&id)?, self.settings);
        let robust = robust_box(points)?;
        if let Some(covered) = self.covered_by(id) {
            return Some(covered.contact_m);
        }
        let lowest_m = robust.min.z;
        let limit_m = lowest_m + settings.bottom_slack_m;
        let own_m = lowest_m - self.trimmed_m(&robust.center());
        let middle = robust.center().xy();
        let carriers = self.reaching_under(id, &middle);
        let shown_m = self.shown_level_m(id, &carriers, &middle, limit_m);
        let under_m = self.highest_under_m(id, lowest_m - settings.stack.below_m);
        if lowest_m - shown_m > settings.stack.overhang_m
            && let Some(top_m) = self.touched_top_m(id, points, lowest_m)
        {
            return Some(top_m.min(lowest_m));
        }
        let looked_under = self.looked_under(points, id, lowest_m, shown_m);
        let reaches_down = under_m <= shown_m + settings.same_level_m && !looked_under;
        if !shown_m.is_finite() || !reaches_down {
            let stack = &settings.stack;
            return Some(if own_m - under_m <= stack.sunk_m {
                // What shows right under it carries it: it stands in a bowl whose rim hides its foot, or on what it covers.
                under_m
            } else if looked_under {
                own_m
            } else {
                // Its foot is hidden, or beyond the picture's edge.
                let nearby_m = self.nearby_m(&carriers, &middle, own_m).filter(|_| !shown_m.is_finite() && !under_m.is_finite());
                nearby_m.unwrap_or(own_m - stack.hidden_m)
            });
        }
        // The surface's own height is less noisy than a few cells of it. A top of about that height that is elsewhere tells nothing.
        let under = self.planes.iter().filter(|p| carriers.contains(&p.object)).map(|p| p.height_m);
        let level = under.filter(|h| *h <= limit_m && (h - shown_m).abs() <= settings.same_level_m);
        let same = level.min_by(|a, b| (a - shown_m).abs().total_cmp(&(b - shown_m).abs()));
        // Where the level is above its own lowest points it reaches into a hollow: set down by the level, it would be pressed in.
        Some(same.unwrap_or(shown_m).min(lowest_m + settings.stack.below_m))
    }

    /// The highest surface of what may carry an object, near its place, that is not above a height.
    fn nearby_m(&self, carriers: &BTreeSet<u16>, place: &Point2<f32>, limit_m: f32) -> Option<f32> {
        let near = self.planes.iter().filter(|p| p.height_m <= limit_m && p.outline.margin(place) >= -self.settings.stack.nearby_m);
        near.filter(|p| carriers.contains(&p.object)).map(|p| p.height_m).reduce(f32::max)
    }

    /// The top of another object that carries an object though little of it shows: it is as high as the object's lowest points, and what
    /// both are completed to overlaps, so that the object cannot stand beside it. `None` for an object that reaches below all such tops.
    pub fn covered_top_m(&self, id: u16, shapes: &BTreeMap<u16, Shape>) -> Option<f32> {
        let stack = &self.settings.stack;
        let shape = shapes.get(&id)?;
        let lowest_m = robust_box(self.clouds.get(&id)?)?.min.z;
        let carriers = shapes.iter().filter(|(other, below)| {
            let height_fits = (lowest_m - stack.covered_m..=lowest_m + stack.below_m).contains(&below.top_m);
            let raised = below.top_m - shape.bottom_m > stack.raised_m;
            **other != id && height_fits && raised && self.overlap(shape, below) >= stack.carried_share
        });
        carriers.map(|(_, below)| below.top_m).reduce(f32::max)
    }

    /// Of the places, seen from above, of one shape's base and another's top: the share of the smaller that both are believed to take.
    fn overlap(&self, above: &Shape, below: &Shape) -> f32 {
        let Some(top) = below.slabs.last() else { return 0.0 };
        let cells = |outline| cells_of(outline, 0.0, self.columns);
        let both = cells(&above.base).filter(|c| top.outline.margin(c) >= 0.0).count();
        both as f32 / cells(&above.base).count().min(cells(&top.outline).count()).max(1) as f32
    }

    /// How much of the lowest part of something at a place border cleaning has taken: the band, seen at that distance and slope.
    fn trimmed_m(&self, place: &Point3<f32>) -> f32 {
        let sight = self.view.eye() - place;
        let distance_m = sight.norm();
        let steepness = (sight.xy().norm() / distance_m.max(1e-3)).max(0.4);
        (self.view.border_m(place, self.settings.border_px) / steepness).max(self.settings.trim_m)
    }

    /// The highest level up to a limit that its carriers show in and around an object's place seen from above; −∞ where none does.
    fn shown_level_m(&self, id: u16, carriers: &BTreeSet<u16>, middle: &Point2<f32>, limit_m: f32) -> f32 {
        let planes =
            self.planes.iter().filter(|p| carriers.contains(&p.object) && p.height_m <= limit_m && p.outline.margin(middle) >= 0.0);
        let outlined_m = planes.map(|p| p.height_m).fold(f32::NEG_INFINITY, f32::max);
        outlined_m.max(self.shared_top_m(id, carriers, limit_m))
    }

    /// What may carry an object: furniture, and of other objects those that reach under its middle. What stands beside it carries nothing.
    fn reaching_under(&self, id: u16, middle: &Point2<f32>) -> BTreeSet<u16> {
        let reaches_under = |other: u16| match other {
            0 => true,
            _ => self.outline(other).is_some_and(|outline| outline.margin(middle) >= -0.005),
        };
        self.clouds.keys().copied().chain([0]).filter(|other| *other != id && reaches_under(*other)).collect()
    }

    /// The highest level that enough cells of the carriers' tops share, in an object's outline and the strip around it.
    fn shared_top_m(&self, id: u16, carriers: &BTreeSet<u16>, limit_m: f32) -> f32 {
        let settings = self.settings;
        let Some(outline) = self.outline(id) else { return f32::NEG_INFINITY };
        let mut tops: Vec<f32> = Vec::new();
        let mut inside = 0;
        for center in cells_of(outline, settings.strip_m, self.columns) {
            inside += usize::from(outline.margin(&center) >= 0.0);
            let runs = self.columns.at(&center).iter().filter(|r| carriers.contains(&r.object) && r.high_m <= limit_m);
            tops.extend(runs.map(|r| r.high_m).reduce(f32::max));
        }
        tops.sort_by(|a, b| b.total_cmp(a));
        let needed = ((settings.carrier_share * inside as f32).ceil() as usize).max(4);
        let shared = tops.windows(needed).find(|w| w[0] - w[needed - 1] <= settings.same_level_m);
        shared.map_or(f32::NEG_INFINITY, |w| w[needed / 2])
    }

    /// The highest points of other objects right under an object, up to a limit: it cannot reach below them. −∞ without any.
    fn highest_under_m(&self, id: u16, limit_m: f32) -> f32 {
        let stack = &self.settings.stack;
        let Some(outline) = self.outline(id) else { return f32::NEG_INFINITY };
        let (min, max) = outline.bounds();
        // Most points are of objects that are elsewhere.
        let is_around = |p: &Point3<f32>| p.x >= min.x && p.x <= max.x && p.y >= min.y && p.y <= max.y;
        let is_under = |p: &Point3<f32>| p.z <= limit_m && is_around(p) && outline.margin(&p.xy()) >= stack.inside_m;
        let of_others = self.clouds.iter().filter(|(other, _)| **other != id).map(|(_, points)| {
            let mut heights: Vec<f32> = points.iter().filter(|p| is_under(p)).map(|p| p.z).collect();
            heights.sort_by(|a, b| b.total_cmp(a));
            heights.get(stack.stray_points).copied().unwrap_or(f32::NEG_INFINITY)
        });
        of_others.fold(f32::NEG_INFINITY, f32::max)
    }

    /// The height of another object's top that an object's lowest points are seen to touch, if most of them do.
    ///
    /// What merely hides an object's lower part is nearer to the camera than its lowest visible points are and higher, for the camera looks
    /// down past it; or, where the two touch, has a rim there and no top that goes on.
    fn touched_top_m(&self, id: u16, points: &[Point3<f32>], lowest_m: f32) -> Option<f32> {
        let stack = &self.settings.stack;
        let low: Vec<&Point3<f32>> = points.iter().filter(|p| p.z <= lowest_m + stack.band_m).collect();
        let columns: Vec<&&Point3<f32>> = low.iter().step_by(low.len().div_ceil(stack.columns).max(1)).collect();
        let mut touched: Vec<f32> = Vec::new();
        for p in &columns {
            let Some((object, under)) = self.view.level_under(p, id, stack.border_rows, self.settings.same_level_m) else { continue };
            let fits = (lowest_m - stack.contact_m..=lowest_m + stack.below_m).contains(&under.z);
            let is_there = fits && (under.xy() - p.xy()).norm() <= stack.touching_m;
            if object != 0 && is_there {
                touched.push(under.z);
            }
        }
        touched.sort_by(f32::total_cmp);
        (2 * touched.len() > columns.len()).then(|| touched[touched.len() / 2])
    }

    /// Whether the camera saw something else, or nothing, where the object would be if it reached from its lowest points down to a level.
    fn looked_under(&self, points: &[Point3<f32>], id: u16, lowest_m: f32, level_m: f32) -> bool {
        let stack = &self.settings.stack;
        let gap_m = lowest_m - level_m;
        if !(stack.overhang_m..f32::INFINITY).contains(&gap_m) {
            return false;
        }
        let camera = self.view.eye().xy();
        let low: Vec<&Point3<f32>> = points.iter().filter(|p| p.z <= lowest_m + stack.band_m).collect();
        let (mut tried, mut others, mut through) = (0usize, 0usize, 0usize);
        for p in low.iter().step_by(low.len().div_ceil(stack.columns).max(1)) {
            let away = (p.xy() - camera).try_normalize(1e-3).unwrap_or_else(Vector2::zeros);
            let inside = p.xy() + away * stack.below_m;
            let mut below_m = stack.step_m;
            while below_m < gap_m - stack.step_m {
                let Some(reading) = self.view.reading(&Point3::new(inside.x, inside.y, lowest_m - below_m)) else { break };
                below_m += stack.step_m;
                tried += 1;
                if reading.object == id {
                    continue;
                }
                if (-stack.before_m..=stack.same_place_m).contains(&reading.behind_m) {
                    others += usize::from(reading.object != 0);
                } else if reading.behind_m > stack.through_m {
                    through += 1;
                }
            }
        }
        // A rim hides the slope under it, so that a camera looks past a low bowl's foot: emptiness speaks only below that.
        let emptiness = if gap_m > stack.hollow_m { through } else { 0 };
        tried > 0 && (others + emptiness) as f32 >= stack.contradicted_share * tried as f32
    }
}

/// The box around points without the stray ones.
fn robust_box(points: &[Point3<f32>]) -> Option<Aabb> {
    cloud::percentile_box(points, 0.02, 0.98)
}

/// The n-th smallest of some values, the largest where there are fewer: the lowest height but for some stray points. Thin legs and the rim of
/// what lies on its side are far fewer than the points that [`robust_box`] leaves out.
pub(crate) fn nth(mut values: Vec<f32>, n: usize) -> Option<f32> {
    let at = n.min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(at, f32::total_cmp).1)
}

/// Whether one shape stands on another or in it: its bottom is within reach of the other's top, and enough of its base is over it.
pub(crate) fn is_on(above: &Shape, below: &Shape, columns: &ColumnMap, settings: &StackSettings) -> bool {
    let height_fits = above.bottom_m > below.bottom_m + settings.step_m && above.bottom_m <= below.top_m + settings.contact_m;
    let may_meet = |slab: &&Slab| height_fits && !are_clearly_apart(&above.base, &slab.outline, 0.0);
    let Some(top) = below.slabs.last().filter(may_meet) else { return false };
    let (mut cells, mut over) = (0usize, 0usize);
    for center in cells_of(&above.base, 0.0, columns) {
        cells += 1;
        over += usize::from(top.outline.margin(&center) >= 0.0);
    }
    cells > 0 && over as f32 >= settings.carried_share * cells as f32
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::SceneBuilder;

    use crate::Belief;
    use crate::tests::believed;

    fn bottom_m(belief: &Belief, id: u16) -> f32 {
        belief.objects[&id].shape.as_ref().unwrap().bottom_m
    }

    #[test]
    fn each_object_stands_on_what_is_under_it() {
        let scene = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.15, 0.12, 0.1])
            .object_at(2, [0.0, 0.0], 0.1, [0.06, 0.06, 0.08])
            .object(3, [0.25, 0.0], [0.05, 0.05, 0.05])
            .scene();
        assert!(
            bottom_m(&believed(&scene), 1).abs() < 1e-3
                && (bottom_m(&believed(&scene), 2) - 0.1).abs() < 2e-3
                && bottom_m(&believed(&scene), 3).abs() < 1e-3
        );
        assert_eq!((believed(&scene).carried(1), believed(&scene).carried(2), believed(&scene).carried(3)), (&[2][..], &[][..], &[][..]));
    }

    #[test]
    fn furniture_that_an_object_hides_almost_whole_still_carries_it() {
        // Perception has found no surface on the low box (label 0): the object covers its top but for a strip.
        let mut scene =
            SceneBuilder::table().object(0, [0.0, 0.0], [0.12, 0.12, 0.14]).object_at(2, [0.0, 0.02], 0.14, [0.11, 0.07, 0.06]).scene();
        scene.meta.surfaces.retain(|s| s.height_m < 0.01);
        let bottom_m = bottom_m(&believed(&scene), 2);
        assert!((bottom_m - 0.14).abs() < 0.004, "{bottom_m}");
    }

    #[test]
    fn a_neighbour_in_front_does_not_carry_what_it_hides() {
        let scene = SceneBuilder::table().object(1, [0.0, -0.06], [0.16, 0.06, 0.07]).object(2, [0.0, 0.02], [0.06, 0.06, 0.12]).scene();
        assert!(bottom_m(&believed(&scene), 2).abs() < 0.004, "{}", bottom_m(&believed(&scene), 2));
        assert_eq!(believed(&scene).carried(1), &[] as &[u16]);
    }

    #[test]
    fn a_foot_that_is_seen_to_touch_a_top_behind_its_front_stands_on_it() {
        // The far half of a tall box's top: most of what it stands on is in front of it, and it reaches beyond the back.
        let scene =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.06, 0.1, 0.14]).object_at(2, [0.0, 0.04], 0.14, [0.07, 0.08, 0.1]).scene();
        assert!((bottom_m(&believed(&scene), 2) - 0.14).abs() < 0.008, "{}", bottom_m(&believed(&scene), 2));
    }

    #[test]
    fn what_hides_the_back_of_its_carriers_top_stands_on_it() {
        // The front of the carrier's top shows; the object behind it on the same top overhangs on one side, with the table seen beside it.
        let scene = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.1, 0.1, 0.2])
            .object_at(2, [0.055, 0.03], 0.2, [0.12, 0.06, 0.05])
            .object(3, [-0.25, 0.0], [0.05, 0.05, 0.05])
            .scene();
        assert!((bottom_m(&believed(&scene), 2) - 0.2).abs() < 0.008, "{}", bottom_m(&believed(&scene), 2));
    }

    #[test]
    fn an_object_cut_off_by_the_picture_stands_on_the_surface_nearby() {
        // Far from the other one, and beside it: what stands beside an object does not carry it.
        for x in [0.3, 0.16] {
            let mut scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.08, 0.08, 0.16]).object(2, [x, 0.0], [0.05, 0.05, 0.05]).scene();
            // As if the picture ended half way down object 1, 6 cm before the nearest point of the table that it shows.
            let shown = |p: &[f32; 3], label: u16| if label == 1 { p[2] > 0.08 } else { p[0].hypot(p[1]) > 0.1 };
            let kept: Vec<bool> = scene.points.iter().zip(&scene.labels).map(|(p, label)| shown(p, *label)).collect();
            let mut of_points = kept.iter();
            scene.points.retain(|_| of_points.next() == Some(&true));
            let mut of_labels = kept.iter();
            scene.labels.retain(|_| of_labels.next() == Some(&true));
            for surface in scene.meta.surfaces.iter_mut().filter(|s| s.height_m < 0.01) {
                surface.outline_m = vec![[0.1, -0.4], [0.5, -0.4], [0.5, 0.4], [0.1, 0.4]];
            }
            let bottom_m = bottom_m(&believed(&scene), 1);
            assert!(bottom_m.abs() < 0.004, "beside one at {x}: {bottom_m}");
        }
    }

    #[test]
    fn nothing_is_believed_to_stand_above_what_was_seen_of_it() {
        // A box over a plate of 12 mm; then a few points show that two thin legs of it reach down beside the plate.
        let mut scene =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.2, 0.012]).object_at(2, [0.0, 0.0], 0.02, [0.2, 0.08, 0.12]).scene();
        let on_the_plate_m = bottom_m(&believed(&scene), 2);
        assert!((0.01..0.02).contains(&on_the_plate_m), "{on_the_plate_m}");
        for k in 0..10_u8 {
            let x = if k % 2 == 0 { -0.097 } else { 0.097 };
            scene.points.push([x, -0.037, 0.004]);
            scene.labels.push(2);
            if let Some(colors) = &mut scene.colors {
                colors.push([128; 3]);
            }
        }
        let bottom_m = bottom_m(&believed(&scene), 2);
        assert!(bottom_m <= 0.004, "{bottom_m}");
    }

    #[test]
    fn a_top_of_about_the_same_height_elsewhere_does_not_raise_a_foot() {
        // A box on a box of 28 mm; the top of another box, far from both, is 8 mm higher, and perception found a surface there and not under the box.
        let mut scene = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.12, 0.12, 0.028])
            .object_at(2, [0.0, 0.0], 0.028, [0.06, 0.06, 0.1])
            .object(3, [0.3, -0.1], [0.1, 0.08, 0.036])
            .scene();
        scene.meta.surfaces.retain(|s| s.object != Some(1) && s.object != Some(2));
        let bottom_m = bottom_m(&believed(&scene), 2);
        assert!((bottom_m - 0.028).abs() < 0.004, "{bottom_m}");
    }

    #[test]
    fn what_covers_its_carrier_whole_does_not_reach_down_to_the_table() {
        // As wide as the tall box that it stands on, and a plate that overhangs a post on all sides.
        let tower =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.08, 0.08, 0.16]).object_at(2, [0.0, 0.0], 0.16, [0.08, 0.08, 0.08]).scene();
        // No more is known than what cleaning may have taken, which these clouds have kept.
        assert!((bottom_m(&believed(&tower), 2) - 0.16).abs() < 0.015, "{}", bottom_m(&believed(&tower), 2));
        let table =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.03, 0.03, 0.2]).object_at(2, [0.0, 0.0], 0.2, [0.16, 0.16, 0.02]).scene();
        assert!((bottom_m(&believed(&table), 2) - 0.2).abs() < 0.02, "{}", bottom_m(&believed(&table), 2));
    }
}
