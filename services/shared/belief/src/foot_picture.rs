//! Feet of which the trees are in doubt ([`crate::foot`]): a network looks at the picture around them ([`repose_networks::feet`]).
//!
//! The measures that the trees read ask the picture a few questions; what a foot that goes on behind a rim looks like, or a bowl that stands in
//! another, is in none of them. The network is shown the picture itself, cut out around the object and upright.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use nalgebra::{Point2, Vector2};
use rayon::prelude::*;
use repose_networks::feet::{AskedLevel, FeetNetwork, FootPicture, SIDE, Shown, ShownPixel};

use crate::boosted_trees::probability_of;
use crate::foot::{Chosen, Foot};
use crate::foot_levels::Level;
use crate::view::ObservedView;

/// Objects one of whose levels the trees find this likely or more are not looked at: of these 99 in 100 are right.
const SURE: f64 = 0.975;
/// How far the picture goes, as a share of how far the object's longer side goes in it, to each side of its middle.
const AROUND: f64 = 0.8;
/// How far it goes at least, metres at the object's middle.
const LEAST_AROUND_M: f64 = 0.03;
/// How much lower than the object's middle its own is, as a share of that.
const LOWER: f64 = 0.2;

/// An object of whose foot the trees are in doubt.
#[derive(Debug, Clone, PartialEq)]
pub struct DoubtfulFoot {
    /// The picture around it.
    pub picture: FootPicture,
    /// What the trees say of it.
    pub levels: Said,
}

/// An object's levels, the rule's first, and the logarithm of the odds that the trees give each.
pub type Said = Vec<(Level, f64)>;

impl DoubtfulFoot {
    /// How likely each level is the right one, by the network.
    fn looked_at(&self) -> Vec<f64> {
        let asked = |(level, log_odds): &(Level, f64)| {
            let asked = AskedLevel { height_m: level.height_m, measures: &level.measures, log_odds: *log_odds as f32 };
            probability_of(f64::from(network().log_odds(&self.picture, &asked)))
        };
        self.levels.iter().map(asked).collect()
    }
}

/// The level that is chosen for each object, and how likely it is the right one.
pub fn choices(view: &ObservedView, levels: BTreeMap<u16, Vec<Level>>) -> BTreeMap<u16, Chosen> {
    let (left, doubtful) = by_doubt(view, levels);
    let by_trees =
        left.iter().filter_map(|(id, levels)| Some((*id, chosen(levels, levels.iter().map(|(_, log_odds)| probability_of(*log_odds)))?)));
    let looked_at = doubtful.par_iter().filter_map(|(id, foot)| Some((*id, chosen(&foot.levels, foot.looked_at().into_iter())?)));
    by_trees.chain(looked_at.collect::<Vec<_>>()).collect()
}

fn chosen(levels: &[(Level, f64)], probabilities: impl Iterator<Item = f64>) -> Option<Chosen> {
    Foot::chosen(levels.iter().map(|(level, _)| level.height_m).zip(probabilities))
}

/// The objects that the network is asked about.
pub fn doubtful(view: &ObservedView, levels: BTreeMap<u16, Vec<Level>>) -> BTreeMap<u16, DoubtfulFoot> {
    by_doubt(view, levels).1.into_iter().collect()
}

/// Of each object by its id.
type OfObjects<T> = Vec<(u16, T)>;

/// The objects that are left to the trees, and those that the network is asked about.
fn by_doubt(view: &ObservedView, levels: BTreeMap<u16, Vec<Level>>) -> (OfObjects<Said>, OfObjects<DoubtfulFoot>) {
    let said = |level: Level| {
        let log_odds = Foot::own().log_odds(&level);
        (level, log_odds)
    };
    let is_sure = |levels: &[(Level, f64)]| levels.iter().any(|(_, log_odds)| probability_of(*log_odds) >= SURE);
    let of_objects = levels.into_iter().map(|(id, levels)| (id, levels.into_iter().map(said).collect::<Said>()));
    let (mut left, doubted): (Vec<_>, Vec<_>) = of_objects.partition(|(_, levels)| is_sure(levels));
    let shown = if doubted.is_empty() { BTreeMap::new() } else { shown(view) };
    let mut doubtful = Vec::new();
    for (id, levels) in doubted {
        let picture = levels.first().and_then(|(rule, _)| shown.get(&id)?.picture(id, view, rule.height_m));
        match picture {
            Some(picture) => doubtful.push((id, DoubtfulFoot { picture, levels })),
            None => left.push((id, levels)),
        }
    }
    (left, doubtful)
}

fn network() -> &'static FeetNetwork {
    static NETWORK: OnceLock<FeetNetwork> = OnceLock::new();
    NETWORK.get_or_init(|| FeetNetwork::embedded().expect("the weights that come with the program: tested"))
}

/// Where an object is in the picture.
struct InPicture {
    /// Least and greatest column and row.
    columns: [usize; 2],
    rows: [usize; 2],
    /// Of its pixels, metres along the optical axis.
    depths_m: Vec<f32>,
}

/// Where each object is in the picture.
fn shown(view: &ObservedView) -> BTreeMap<u16, InPicture> {
    let width = view.camera().width;
    let mut shown: BTreeMap<u16, InPicture> = BTreeMap::new();
    for (i, pixel) in view.pixels().pixels().iter().enumerate().filter(|(_, pixel)| pixel.depth_m > 0.0 && pixel.object != 0) {
        let (u, v) = (i % width, i / width);
        let of = shown.entry(pixel.object).or_insert_with(|| InPicture { columns: [u, u], rows: [v, v], depths_m: Vec::new() });
        for (span, at) in [(&mut of.columns, u), (&mut of.rows, v)] {
            *span = [span[0].min(at), span[1].max(at)];
        }
        of.depths_m.push(pixel.depth_m);
    }
    shown
}

impl InPicture {
    /// The picture around it; none where nothing falls in the picture, at the vanishing point of a rolled camera, and where the focal length is so short that
    /// no line of sight can be told from it.
    fn picture(&self, id: u16, view: &ObservedView, rule_m: f32) -> Option<FootPicture> {
        let camera = view.camera();
        let middle_m = {
            let mut depths_m = self.depths_m.clone();
            let middle = depths_m.len() / 2;
            *depths_m.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        let [[left, right], [top, bottom]] = [self.columns, self.rows].map(|span| span.map(|at| at as f64));
        let middle = Point2::new((left + right) / 2.0, (top + bottom) / 2.0);
        let down = view.step_down(&camera.unproject(middle.x, middle.y, f64::from(middle_m)))?;
        let aside = Vector2::new(down.y, -down.x);
        let half = (AROUND * ((right - left).max(bottom - top) + 1.0)).max(LEAST_AROUND_M * camera.fx / f64::from(middle_m));
        let step = 2.0 * half / SIDE as f64;
        let at =
            |row: f64, column: f64| middle + aside * ((column + 0.5) * step - half) + down * ((row + 0.5) * step - half + LOWER * half);
        let pixel = |index: usize| shown_at(at((index / SIDE) as f64, (index % SIDE) as f64), id, view);
        let rise = |row: usize| {
            let on = at(row as f64, (SIDE / 2) as f64);
            view.rise(on.x, on.y) as f32
        };
        let (rises, pixel_m): ([f32; SIDE], f32) = (std::array::from_fn(rise), (step * f64::from(middle_m) / camera.fx) as f32);
        rises.iter().chain([&pixel_m]).all(|length| length.is_finite()).then(|| FootPicture {
            pixels: (0..SIDE * SIDE).map(pixel).collect(),
            rises,
            depth_m: middle_m,
            pixel_m,
            eye_m: view.eye().z,
            rule_m,
        })
    }
}

/// What is at a place in the picture.
fn shown_at(place: Point2<f64>, id: u16, view: &ObservedView) -> ShownPixel {
    let (u, v) = (place.x.round(), place.y.round());
    let pixel = (u >= 0.0 && v >= 0.0).then(|| view.pixels().get(u as usize, v as usize)).flatten();
    let Some(pixel) = pixel else { return ShownPixel { shown: Shown::Beyond, ..ShownPixel::default() } };
    if pixel.depth_m == 0.0 {
        return ShownPixel::default();
    }
    let shown = if pixel.object == id {
        Shown::Own
    } else if pixel.object == 0 {
        Shown::Furniture
    } else {
        Shown::Other
    };
    ShownPixel { shown, height_m: pixel.height_m, depth_m: pixel.depth_m }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Isometry3, Vector3};
    use repose_made_scenes::{SceneBuilder, world_from_camera};
    use repose_proto::CameraModel;

    use super::*;
    use crate::BeliefSettings;
    use crate::foot_levels::MEASURES;

    /// A block with id 1 on a table.
    fn view(roll_rad: f64) -> ObservedView {
        let scene = SceneBuilder::table().object(1, [0.02, 0.05], [0.08, 0.08, 0.1]).scene();
        let pose = world_from_camera() * Isometry3::rotation(Vector3::z() * roll_rad);
        ObservedView::new(&scene.points, &scene.labels, &scene.meta.camera, &pose, BeliefSettings::default().view_columns)
    }

    #[test]
    fn what_the_trees_doubt_is_what_the_network_says_and_what_the_picture_does_not_show_is_what_the_trees_say() {
        let (view, heights_m) = (view(0.0), [0.0, 0.04]);
        // Measures of no level in particular: of such the trees are not sure.
        let level = |height_m| Level { height_m, measures: vec![0.1; MEASURES.len()] };
        let levels = BTreeMap::from([(1, heights_m.map(level).to_vec()), (2, heights_m.map(level).to_vec())]);
        let doubtful = doubtful(&view, levels.clone());
        assert_eq!(doubtful.keys().collect::<Vec<_>>(), [&1], "of 2 the picture has nothing");
        let by_trees = levels[&2].iter().map(|level| probability_of(Foot::own().log_odds(level))).collect::<Vec<_>>();
        let by_network = doubtful[&1].looked_at();
        assert!(by_trees.iter().all(|probability| *probability < SURE));
        assert!(by_network.iter().zip(&by_trees).any(|(network, trees)| (network - trees).abs() > 1e-3), "{by_network:?}, {by_trees:?}");
        let chosen = |said: &[f64]| Foot::chosen(heights_m.into_iter().zip(said.iter().copied())).unwrap();
        assert_eq!(choices(&view, levels), BTreeMap::from([(1, chosen(&by_network)), (2, chosen(&by_trees))]));
    }

    #[test]
    fn a_line_of_sight_that_no_number_tells_gives_no_picture() {
        let (scene, pose) = (SceneBuilder::table().object(1, [0.02, 0.05], [0.08, 0.08, 0.1]).scene(), world_from_camera());
        let camera = CameraModel { fx: f64::MIN_POSITIVE, fy: f64::MIN_POSITIVE, ..scene.meta.camera };
        let short = ObservedView::new(&scene.points, &scene.labels, &camera, &pose, BeliefSettings::default().view_columns);
        assert_eq!(shown(&view(0.0))[&1].picture(1, &short, 0.0), None);
    }

    #[test]
    fn the_network_reads_as_many_measures_as_the_trees() {
        assert_eq!(repose_networks::feet::MEASURES, MEASURES.len());
    }

    fn picture(roll_rad: f64) -> FootPicture {
        let view = view(roll_rad);
        shown(&view)[&1].picture(1, &view, 0.0).unwrap()
    }

    #[test]
    fn the_picture_has_the_object_in_it_and_what_it_stands_on_under_that() {
        let picture = picture(0.0);
        let rows_of = |shown: Shown| {
            let at = picture.pixels.iter().enumerate().filter(|(_, pixel)| pixel.shown == shown).map(|(i, _)| i / SIDE).collect::<Vec<_>>();
            (at.len(), at.iter().sum::<usize>() as f32 / at.len().max(1) as f32)
        };
        let ((own, own_row), (furniture, _)) = (rows_of(Shown::Own), rows_of(Shown::Furniture));
        assert!(own > 200 && furniture > 200, "{own}, {furniture}");
        assert!(own_row < SIDE as f32 / 2.0, "the object is over the picture's middle: {own_row}");
        let own = picture.pixels.iter().filter(|pixel| pixel.shown == Shown::Own);
        assert!(own.clone().all(|pixel| (-0.005..0.105).contains(&pixel.height_m)));
        assert!(picture.rises.windows(2).all(|rows| rows[1] < rows[0]), "lower rows look further down");
        assert!(picture.pixel_m > 0.001 && picture.pixel_m < 0.01, "{}", picture.pixel_m);
    }

    #[test]
    fn a_camera_on_its_side_gives_an_upright_picture() {
        let (upright, rolled) = (picture(0.0), picture(std::f64::consts::FRAC_PI_2));
        let same = upright.pixels.iter().zip(&rolled.pixels).filter(|(a, b)| a.shown == b.shown).count();
        assert!(same * 10 > SIDE * SIDE * 8, "{same} of {}", SIDE * SIDE);
        assert!(upright.rises.iter().zip(&rolled.rises).all(|(a, b)| (a - b).abs() < 0.05));
    }
}
