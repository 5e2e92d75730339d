//! Objects that cover what carries them: of the carrier its front shows and nothing, or next to nothing, of its top.
//!
//! Such a carrier's own points tell nothing of how deep it is, and no level shows where the two meet. But the two fronts do: they are one above
//! the other, with no top between them. So the object stands where its lowest points and the carrier's highest ones meet, and the carrier goes on
//! under it, as far as the camera did not look past.

use std::collections::BTreeMap;

use nalgebra::{Point2, Point3, Vector2};
use repose_geometry::cloud;

use crate::columns::{ColumnMap, cells_of};
use crate::settings::CoverSettings;
use crate::shape::Shape;
use crate::standing::ObservedGeometry;
use crate::view::ObservedView;

/// What carries an object that covers it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Covered {
    /// The carrier.
    pub id: u16,
    /// The height at which the two meet, world z, metres.
    pub contact_m: f32,
}

impl ObservedGeometry<'_> {
    /// What an object stands on and covers; none where nothing is known to be covered by it.
    pub fn covered_by(&self, id: u16) -> Option<Covered> {
        let (cover, low_m) = (&self.settings.cover, self.extents.get(&id)?.lowest_m);
        let low = Band::lowest(self.clouds.get(&id)?, low_m, cover);
        let eye = self.view.eye().xy();
        let meeting = self.clouds.iter().filter_map(|(other, points)| {
            let high_m = self.extents.get(other)?.highest_m;
            let meets = *other != id && (-cover.over_m..=cover.gap_m).contains(&(low_m - high_m));
            meets.then_some((*other, points, high_m))
        });
        let carriers = meeting.filter_map(|(other, points, high_m)| {
            let high = Band::highest(points, high_m, cover);
            let is_covered =
                points.iter().any(|p| p.z <= high_m - cover.min_height_m) && high.is_narrow(&eye, cover) && low.is_along(&high, cover);
            is_covered.then_some(Covered { id: other, contact_m: (low_m + high_m) / 2.0 })
        });
        carriers.max_by(|a, b| a.contact_m.total_cmp(&b.contact_m))
    }
}

/// The lowest or the highest part of what was seen of an object.
struct Band {
    points: Vec<Point2<f32>>,
}

impl Band {
    /// Of an object whose lowest points but some stray ones are at a height, metres.
    fn lowest(points: &[Point3<f32>], lowest_m: f32, settings: &CoverSettings) -> Self {
        let in_band = points.iter().filter(|p| p.z <= lowest_m + settings.band_m);
        Self { points: in_band.map(|p| p.xy()).collect() }
    }

    /// The same of the highest.
    fn highest(points: &[Point3<f32>], highest_m: f32, settings: &CoverSettings) -> Self {
        let in_band = points.iter().filter(|p| p.z >= highest_m - settings.band_m);
        Self { points: in_band.map(|p| p.xy()).collect() }
    }

    /// Whether no top goes on behind its front: it is narrow in the direction of sight.
    fn is_narrow(&self, eye: &Point2<f32>, settings: &CoverSettings) -> bool {
        let Some([x, y]) = cloud::mean_of(self.points.iter().map(|p| [p.x, p.y])) else { return false };
        let Some(away) = (Vector2::new(x, y) - eye.coords).try_normalize(1e-3) else { return false };
        let across = Vector2::new(-away.y, away.x);
        // A face that is turned aside is deep in the direction of sight, but no deeper here than there.
        let columns = cut(&self.points, &across, settings.column_m);
        let narrow = columns.iter().filter(|column| span_m(column, &away, settings.strays) <= settings.narrow_m).count();
        !columns.is_empty() && narrow as f32 >= settings.share * columns.len() as f32
    }

    /// Whether most of it is right over or under another.
    fn is_along(&self, other: &Self, settings: &CoverSettings) -> bool {
        let step = self.points.len().div_ceil(settings.sample).max(1);
        let tried: Vec<&Point2<f32>> = self.points.iter().step_by(step).collect();
        let near = |p: &&&Point2<f32>| other.points.iter().any(|q| (q - **p).norm_squared() <= settings.aside_m * settings.aside_m);
        tried.iter().filter(near).count() as f32 >= settings.share * tried.len() as f32
    }
}

/// Points in strips of that width along a direction; strips of a few points are left out.
fn cut(points: &[Point2<f32>], along: &Vector2<f32>, width_m: f32) -> Vec<Vec<Point2<f32>>> {
    const FEWEST: usize = 3;
    let mut strips: BTreeMap<i32, Vec<Point2<f32>>> = BTreeMap::new();
    for p in points {
        strips.entry((p.coords.dot(along) / width_m).floor() as i32).or_default().push(*p);
    }
    strips.into_values().filter(|strip| strip.len() >= FEWEST).collect()
}

/// How far points spread along a direction, but for a share of stray ones at either end.
fn span_m(points: &[Point2<f32>], along: &Vector2<f32>, strays: f32) -> f32 {
    let mut values: Vec<f32> = points.iter().map(|p| p.coords.dot(along)).collect();
    values.sort_by(f32::total_cmp);
    let left_out = (strays * values.len() as f32) as usize;
    values[values.len() - 1 - left_out] - values[left_out]
}

/// Carriers go on under what covers them: each shape reaches to the hidden places under the base of what stands on it.
pub fn go_on_under(shapes: &mut BTreeMap<u16, Shape>, covered: &BTreeMap<u16, Covered>, view: &ObservedView, columns: &ColumnMap) {
    let mut pairs: Vec<(&u16, &Covered)> = covered.iter().collect();
    // From the top down: what is reached under is known before what carries it.
    pairs.sort_by(|a, b| b.1.contact_m.total_cmp(&a.1.contact_m));
    for (above, Covered { id, contact_m }) in pairs {
        let Some(places) = shapes.get(above).map(|above| hidden_under(above, *contact_m, view, columns)) else { continue };
        let whole = shapes.get(id).and_then(|below| below.reaching(&places));
        shapes.extend(whole.map(|whole| (*id, whole.up_to(*contact_m))));
    }
}

/// The places under a shape, seen from above, where the camera did not look past its base: what carries it at that height may reach there.
pub fn hidden_under(above: &Shape, height_m: f32, view: &ObservedView, columns: &ColumnMap) -> Vec<Point2<f32>> {
    // A little lower than what the object stands on: above that there is only the object.
    const BELOW_M: f32 = 0.01;
    cells_of(&above.base, 0.0, columns).filter(|p| !view.is_free(&Point3::new(p.x, p.y, height_m - BELOW_M))).collect()
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::SceneBuilder;

    use crate::tests::believed;

    #[test]
    fn what_covers_its_carrier_but_for_millimetres_is_carried_by_it_and_the_carrier_goes_on_under_it() {
        let scene =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.05]).object_at(2, [0.0, 0.0], 0.05, [0.096, 0.096, 0.1]).scene();
        let belief = believed(&scene);
        let shape = |id: u16| belief.objects[&id].shape.as_ref().unwrap();
        assert!((shape(2).bottom_m - 0.05).abs() < 0.003, "{}", shape(2).bottom_m);
        assert_eq!(belief.carried(1), &[2]);
        assert!(shape(1).base.margin(&[0.0, 0.03].into()) > 0.0 && shape(1).axis.coords.norm() < 0.01, "{:?}", shape(1));
    }

    #[test]
    fn a_tower_of_three_of_which_only_fronts_show_is_known_from_the_top_down() {
        let scene = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.1, 0.1, 0.05])
            .object_at(2, [0.0, 0.0], 0.05, [0.094, 0.094, 0.05])
            .object_at(3, [0.0, 0.0], 0.1, [0.088, 0.088, 0.05])
            .scene();
        let belief = believed(&scene);
        assert_eq!((belief.carried(1), belief.carried(2)), (&[2][..], &[3][..]));
    }

    #[test]
    fn what_lies_or_stands_before_an_object_does_not_carry_it() {
        // A pen at its foot, and a box before it whose top is seen.
        let pen = SceneBuilder::table().object(1, [0.0, -0.046], [0.14, 0.01, 0.01]).object(2, [0.0, 0.0], [0.08, 0.08, 0.12]).scene();
        let low = SceneBuilder::table().object(1, [0.0, -0.075], [0.14, 0.03, 0.04]).object(2, [0.0, 0.0], [0.08, 0.08, 0.12]).scene();
        for scene in [pen, low] {
            let belief = believed(&scene);
            assert_eq!(belief.carried(1), &[] as &[u16]);
            assert!(belief.objects[&2].shape.as_ref().unwrap().bottom_m.abs() < 0.004, "{:?}", belief.objects[&2].shape);
        }
    }
}
