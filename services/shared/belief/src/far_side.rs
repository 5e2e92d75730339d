//! What is not seen of things, as points: an object's far side, how it goes on down to what it stands on, and how deep furniture is solid.
//!
//! Most things that people set down look alike from opposite sides, so the far half is taken to be what was seen, turned by half a turn about
//! the object's axis: right for boxes, cans and bowls, and within the same bounds for anything else. What hides the lower part of a thing does
//! not end it there: its outline goes straight down to its foot. Neither is believed where the camera saw past the place.

use nalgebra::{Point2, Point3};
use repose_geometry::{Aabb, Footprint, cloud};

use crate::Belief;
use crate::columns::{ColumnMap, ColumnRun};
use crate::outlines::area_centroid;
use crate::plane::SupportPlane;
use crate::view::ObservedView;

/// Step downwards, metres.
const STEP_M: f32 = 0.01;
/// How far inside a surface's outline places under it are tried, metres: its edge hides what is right below.
const INSIDE_M: f32 = 0.01;
/// Places along each side of a surface that are tried.
const SIDE: usize = 6;
/// A surface that is lower than another by less is the same one, metres.
const SAME_M: f32 = 0.015;
/// Furniture is asked for its inside down to this far under a surface, metres: beside what stands higher nothing is set down.
const MAX_SOLID_M: f32 = 0.4;
/// No furniture is looked under any farther down, metres.
const DEEPEST_M: f32 = 10.0;
/// Cells are looked at for the inside of furniture up to as many as so many levels have that each cover the map: as many as perception finds.
const MAX_SOLID_LEVELS: usize = 8;

impl Belief {
    /// An object as a whole: what was seen of it and what is believed to be there too, about `spacing_m` apart, world frame. Its rim is moved out
    /// by `border_m`, as much as is missing at each border of what was seen. Nothing for an unknown object.
    pub fn whole(&self, id: u16, spacing_m: f32, border_m: f32) -> Vec<Point3<f32>> {
        let Some(object) = self.objects.get(&id) else { return Vec::new() };
        let seen = cloud::voxel_downsampled(&object.points, spacing_m);
        let Some(shape) = &object.shape else { return seen };
        let far = far_side(&seen, &shape.turn_axis);
        let mut whole: Vec<Point3<f32>> = seen.into_iter().chain(far.into_iter().filter(|p| !self.view.is_free(p))).collect();
        if let Some(outline) = Footprint::of(&whole) {
            let rim = whole.iter().filter(|p| outline.margin(&p.xy()) < spacing_m);
            let outwards = |p: &Point3<f32>| {
                let away = (p.xy() - shape.axis).try_normalize(1e-6).unwrap_or_default() * border_m;
                Point3::new(p.x + away.x, p.y + away.y, p.z)
            };
            let rim: Vec<Point3<f32>> = rim.map(outwards).collect();
            for place in rim {
                whole.push(place);
                let steps = ((place.z - shape.bottom_m) / spacing_m) as usize;
                let below = (1..=steps).map(|k| Point3::new(place.x, place.y, place.z - k as f32 * spacing_m));
                whole.extend(below.take_while(|p| !self.view.is_free(p)));
            }
        }
        cloud::voxel_downsampled(&whole, spacing_m)
    }

    /// How deep a surface of the furniture is solid, as far as the camera did not look under it, metres; `None` for the lowest there.
    ///
    /// A box on a table shows its top and its near sides only; a shelf's board shows what is under it.
    pub fn solid_m(&self, surface: &SupportPlane) -> Option<f32> {
        solid_m(surface, &self.planes, &self.view, DEEPEST_M)
    }
}

/// See [`Belief::solid_m`]; where the camera looked under it is told down to `asked_m`.
fn solid_m(surface: &SupportPlane, planes: &[SupportPlane], view: &ObservedView, asked_m: f32) -> Option<f32> {
    let corners: Vec<Point3<f32>> = surface.outline.corners().iter().map(|c| Point3::new(c.x, c.y, 0.0)).collect();
    let bounds = Aabb::of(&corners)?;
    let is_lower = |p: &&SupportPlane| p.height_m <= surface.height_m - SAME_M && p.outline.margin(&bounds.center().xy()) > 0.0;
    let lower_m = planes.iter().filter(is_lower).map(|p| p.height_m).reduce(f32::max)?;
    let at = |k: usize, low: f32, high: f32| low + (high - low) * (k as f32 + 0.5) / SIDE as f32;
    let inside: Vec<Point2<f32>> = (0..SIDE * SIDE)
        .map(|k| Point2::new(at(k % SIDE, bounds.min.x, bounds.max.x), at(k / SIDE, bounds.min.y, bounds.max.y)))
        .filter(|place| surface.outline.margin(place) > INSIDE_M)
        .collect();
    let places = if inside.is_empty() { towards_corners(&surface.outline) } else { inside };
    let seen_free = |height_m: f32| places.iter().filter(|p| view.is_free(&Point3::new(p.x, p.y, height_m))).count();
    // The last of them says that it is solid as far as asked.
    let asked = (asked_m / STEP_M) as usize + 2;
    let steps = (((surface.height_m - lower_m) / STEP_M) as usize).min(asked);
    let looked = (2..steps).find(|k| seen_free(surface.height_m - *k as f32 * STEP_M) * 10 > places.len());
    Some(looked.map_or(surface.height_m - lower_m, |k| (k - 1) as f32 * STEP_M))
}

/// Places from the middle of an outline towards its corners: those of a surface that is too narrow for any others.
fn towards_corners(outline: &Footprint) -> Vec<Point2<f32>> {
    let middle = area_centroid(outline);
    outline.corners().iter().flat_map(|corner| [0.2, 0.5, 0.8].map(|share| middle + (corner - middle) * share)).collect()
}

/// The inside of furniture under the levels that were seen of it, for a map: as far as that reaches, whatever the levels' outlines.
pub fn solid_runs(planes: &[SupportPlane], view: &ObservedView, columns: &ColumnMap) -> Vec<(Point2<f32>, ColumnRun)> {
    // Nothing is set down beside it where no level is that low.
    let is_beside = |plane: &SupportPlane, other: &SupportPlane| (SAME_M..MAX_SOLID_M).contains(&(plane.height_m - other.height_m));
    let furniture = planes.iter().filter(|plane| plane.object == 0 && planes.iter().any(|other| is_beside(plane, other)));
    let solid = furniture.filter_map(|plane| Some((plane, solid_m(plane, planes, view, MAX_SOLID_M)?.min(MAX_SOLID_M))));
    let around = solid.flat_map(|(plane, deep_m)| {
        let (min, max) = plane.outline.bounds();
        columns.own_centers_within(&min, &max).map(move |center| (plane, deep_m, center))
    });
    let inside = around.take(MAX_SOLID_LEVELS * columns.cell_count()).filter(|(plane, _, center)| plane.outline.margin(center) >= 0.0);
    let run =
        |plane: &SupportPlane, deep_m: f32| ColumnRun { low_m: plane.height_m - deep_m, high_m: plane.height_m, object: 0, seen: false };
    inside.map(|(plane, deep_m, center)| (center, run(plane, deep_m))).collect()
}

/// The points' likenesses under half a turn about an upright axis.
pub fn far_side(points: &[Point3<f32>], axis: &Point2<f32>) -> Vec<Point3<f32>> {
    points.iter().map(|p| Point3::new(2.0 * axis.x - p.x, 2.0 * axis.y - p.y, p.z)).collect()
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::SceneBuilder;
    use repose_proto::{Scene, Surface};

    use super::*;
    use crate::tests::believed;

    const SPACING_M: f32 = 0.008;

    fn has(cloud: &[Point3<f32>], at: [f32; 3]) -> bool {
        cloud.iter().any(|p| (p - Point3::from(at)).norm() < 0.012)
    }

    #[test]
    fn the_far_side_of_a_box_is_where_it_was_not_seen() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.1], [0.12, 0.05, 0.10]).scene();
        let whole = believed(&scene).whole(1, SPACING_M, 0.0);
        for face in [[0.06, 0.1, 0.05], [-0.06, 0.1, 0.05], [0.0, 0.125, 0.05], [0.0, 0.075, 0.05]] {
            assert!(has(&whole, face), "{face:?}");
        }
        assert!(believed(&scene).whole(7, SPACING_M, 0.0).is_empty());
    }

    #[test]
    fn a_foot_behind_something_reaches_the_table_and_one_on_a_box_does_not() {
        // A tall box of which a wide one in front (furniture, label 0) hides the lower half; and one on top of the wide one.
        let scene = SceneBuilder::table()
            .object(0, [0.0, -0.1], [0.3, 0.1, 0.1])
            .object(1, [-0.05, 0.03], [0.14, 0.05, 0.2])
            .object_at(2, [0.1, -0.1], 0.1, [0.06, 0.06, 0.1])
            .scene();
        let belief = believed(&scene);
        let is_far_foot = |p: &Point3<f32>| p.z < 0.035 && (p.x + 0.05).abs() < 0.02 && p.y > 0.045;
        assert!(belief.whole(1, SPACING_M, 0.0).iter().any(is_far_foot), "its hidden foot is there");
        assert!(belief.whole(2, SPACING_M, 0.0).iter().all(|p| p.z > 0.09));
    }

    #[test]
    fn nothing_is_believed_where_the_camera_saw_past() {
        // A plate on a thin post, both seen: under the plate is nothing.
        let scene =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.03, 0.03, 0.15]).object_at(1, [0.0, 0.0], 0.15, [0.16, 0.16, 0.01]).scene();
        let whole = believed(&scene).whole(1, SPACING_M, 0.0);
        assert!(!has(&whole, [0.075, -0.07, 0.06]) && !has(&whole, [-0.075, -0.07, 0.06]), "under the near corners");
        assert!(has(&whole, [0.0, 0.0, 0.16]));
    }

    #[test]
    fn a_box_is_solid_to_the_table_and_a_board_is_not() {
        let solid_m = |scene: &Scene| {
            let belief = believed(scene);
            let of = |height_m: f32| belief.planes.iter().find(|p| (p.height_m - height_m).abs() < 0.01).map(|p| belief.solid_m(p));
            (of(0.0).expect("the table"), of(0.2).expect("the top"))
        };
        let (table, solid) = solid_m(&SceneBuilder::table().object(0, [0.0, 0.0], [0.3, 0.2, 0.2]).scene());
        assert!(table.is_none() && (solid.expect("there is a table under it") - 0.2).abs() < 0.01, "{solid:?}");
        // A narrow one, too, of which no place is a centimetre from its edges.
        for deep in [0.2, 0.015] {
            let (_, solid) = solid_m(&SceneBuilder::table().object_at(0, [0.0, 0.0], 0.18, [0.3, deep, 0.02]).scene());
            assert!(solid.expect("there is a table under it") < 0.12, "{deep}: {solid:?}");
        }
        let (_, wall) = solid_m(&SceneBuilder::table().object(0, [0.0, 0.0], [0.3, 0.015, 0.2]).scene());
        assert!((wall.expect("there is a table under it") - 0.2).abs() < 0.01, "{wall:?}");
    }

    #[test]
    fn however_many_levels_there_are_no_more_is_filled_than_a_few_that_cover_the_map_have() {
        let mut scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).scene();
        let outline_m = vec![[-0.5, -0.4], [0.5, -0.4], [0.5, 0.4], [-0.5, 0.4]];
        let level = |k: i32| Surface { height_m: -0.002 * f64::from(k), outline_m: outline_m.clone(), area_m2: 0.8, object: None };
        scene.meta.surfaces = (0..100).map(level).collect();
        let belief = believed(&scene);
        let runs = solid_runs(&belief.planes, &belief.view, &belief.columns);
        let cells = belief.columns.cell_count();
        assert!((cells..=MAX_SOLID_LEVELS * cells).contains(&runs.len()), "{} of {cells}", runs.len());
    }

    #[test]
    fn furniture_far_beyond_the_map_is_filled_on_the_map_alone() {
        // Two levels of hundreds of metres: 10^10 cells of 5 mm.
        let mut scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).scene();
        let wide = |height_m: f64, x_m: f64| Surface {
            height_m,
            outline_m: vec![[-x_m, -400.0], [x_m, -400.0], [x_m, 400.0], [-x_m, 400.0]],
            area_m2: 1600.0 * x_m,
            object: None,
        };
        scene.meta.surfaces = vec![wide(0.0, 600.0), wide(-0.2, 600.0)];
        let belief = believed(&scene);
        let runs = solid_runs(&belief.planes, &belief.view, &belief.columns);
        let [columns, rows] =
            [0, 1].map(|k| scene.points.iter().map(|p| p[k]).fold([f32::MAX, f32::MIN], |[a, b], v| [a.min(v), b.max(v)]));
        let cells = (columns[1] - columns[0]) * (rows[1] - rows[0]) / belief.columns.cell_m().powi(2);
        assert!((0.9 * cells..1.1 * cells).contains(&(runs.len() as f32)), "{} of {cells}", runs.len());
        // On the map it makes no difference how far a level goes on.
        scene.meta.surfaces = vec![wide(0.0, 2.0), wide(-0.2, 2.0)];
        let near = believed(&scene);
        assert_eq!(solid_runs(&near.planes, &near.view, &near.columns), runs);
    }
}
