//! Networks whose answers are known: a prior around a place, relations and realism by simple formulas; and what tests ask with them.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::Point3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use repose_belief::boosted_trees::{BoostedTrees, Branch, DecisionTree, TreeSplit};
use repose_geometry::{cloud, transform};
use repose_proto::place::{PlaceRequest, PlaceResult, Variant};
use repose_proto::scoring::{MixtureComponent, PriorReply, PriorRequest, ScoreReply, ScoreRequest};
use repose_proto::{CallError, ErrorCode, RELATION_COUNT, Relation, Scene};

use crate::judge::Judge;
use crate::learned::forecast::{Forecast, ForecastFitData, Forecasts};
use crate::learned::models::PlacementModels;
use crate::plan::plan;
use crate::scene::prepared::PreparedScene;
use crate::settings::PlanSettings;
use crate::tests::forecasts;
use crate::tests::synthetic::{Prepared, SceneBuilder, posed};

/// A fake whose prior has components at given offsets, whose realism falls with the distance from the nearest of some heights, and
/// whose only relation is `right_of`: likely where x exceeds the anchor's.
pub(crate) struct Fake {
    /// Where its prior draws, relative to the anchor, metres.
    pub(crate) means_m: Vec<[f64; 3]>,
    pub(crate) real_height_m: f32,
    pub(crate) scored: AtomicUsize,
    /// From this score request on, another worker with other weights answers.
    pub(crate) changes_after: usize,
    /// From this score request on, the deadline passes before an answer comes.
    pub(crate) late_after: usize,
    /// What it says of success.
    pub(crate) success: Option<Forecast>,
    /// What it says of how objects stand: the forecasts of the program's weights where it says nothing of its own.
    pub(crate) stands: Option<Forecast>,
    pub(crate) neighbour_stays: Option<Forecast>,
}

impl Fake {
    pub(crate) fn new(means_m: &[[f64; 3]]) -> Self {
        Self {
            means_m: means_m.to_vec(),
            real_height_m: 0.045,
            scored: AtomicUsize::new(0),
            changes_after: usize::MAX,
            late_after: usize::MAX,
            success: None,
            stands: None,
            neighbour_stays: None,
        }
    }
}

impl PlacementModels for Fake {
    fn prior(&self, request: &PriorRequest, scene: &Arc<Scene>) -> Result<PriorReply, CallError> {
        let anchor: Vec<Point3<f32>> = scene.points_of(request.anchor).map(Point3::from).collect();
        let anchor = cloud::centroid(&anchor).unwrap();
        let weight = 1.0 / self.means_m.len() as f64;
        let component =
            |mean_m: &[f64; 3]| MixtureComponent { weight, mean_m: *mean_m, sigma_m: [0.03; 3], yaw_mean_rad: 0.0, yaw_concentration: 0.0 };
        let mut rng = Pcg64::seed_from_u64(request.seed);
        let (mut candidates, mut components) = (Vec::new(), Vec::new());
        for i in 0..request.count as usize {
            let k = i % self.means_m.len();
            let at: [f32; 3] = std::array::from_fn(|axis| {
                let z: f64 = StandardNormal.sample(&mut rng);
                (anchor[axis] + self.means_m[k][axis] + 0.03 * z) as f32
            });
            candidates.push([at[0], at[1], at[2], 0.0]);
            components.push(k as u8);
        }
        Ok(PriorReply {
            mixture: self.means_m.iter().map(component).collect(),
            weights_hash: "first".to_owned(),
            kernel: "fake".to_owned(),
            candidates,
            components,
        })
    }

    fn score(&self, request: &ScoreRequest, scene: &Arc<Scene>) -> Result<ScoreReply, CallError> {
        let calls = self.scored.fetch_add(1, Ordering::Relaxed);
        if calls >= self.late_after {
            return Err(CallError::new(ErrorCode::DeadlineExceeded, "the deadline passed before an answer came"));
        }
        // Never quite sure, so that what was asked can be told from what was not.
        let realism = |row: &[f32; 4]| 0.99 * (-((row[2] - self.real_height_m) / 0.02).powi(2)).exp();
        let relations = |row: &[f32; 4], anchor: u16| {
            let anchor: Vec<Point3<f32>> = scene.points_of(anchor).map(Point3::from).collect();
            let x = cloud::centroid(&anchor).unwrap().x as f32;
            let mut p = [0.1; RELATION_COUNT];
            p[Relation::RightOf.index()] = 1.0 / (1.0 + (-(row[0] - x - 0.05) / 0.01).exp());
            p
        };
        let rows = || request.candidates.iter();
        Ok(ScoreReply {
            weights_hash: if calls >= self.changes_after { "second" } else { "first" }.to_owned(),
            kernel: "fake".to_owned(),
            realism: if request.realism { rows().map(realism).collect() } else { Vec::new() },
            relations: match request.relations {
                true => rows().flat_map(|row| request.anchors.iter().map(move |a| relations(row, *a))).collect(),
                false => Vec::new(),
            },
            anchors: request.anchors.len(),
        })
    }

    fn forecasts(&self) -> Result<Arc<Forecasts>, CallError> {
        let known = (**forecasts()).clone();
        Ok(Arc::new(Forecasts {
            success: self.success.clone(),
            stands: self.stands.clone().unwrap_or(known.stands),
            neighbour_stays: self.neighbour_stays.clone().unwrap_or(known.neighbour_stays),
            ..known
        }))
    }
}

/// Where the usual fake's prior draws, relative to the anchor, metres.
pub(crate) const BESIDE: [f64; 3] = [0.16, 0.0, 0.0];

pub(crate) fn scene() -> PreparedScene {
    SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.25, -0.2], [0.06, 0.05, 0.08]).prepared()
}

/// Has work done with the judge of a request on [`scene`], whose networks believe in places beside the anchor.
pub(crate) fn judging<T>(request: &PlaceRequest, settings: &PlanSettings, work: impl FnOnce(&mut Judge<'_>) -> T) -> T {
    judging_with(&Fake::new(&[BESIDE]), request, settings, work)
}

/// The same with networks of one's own.
pub(crate) fn judging_with<T>(fake: &Fake, request: &PlaceRequest, settings: &PlanSettings, work: impl FnOnce(&mut Judge<'_>) -> T) -> T {
    posed(&scene(), request, settings, |problem| work(&mut Judge::new(problem, fake)))
}

pub(crate) fn request(prepared: &PreparedScene, variant: Variant, goal: &[&str]) -> PlaceRequest {
    let goal = goal.iter().map(|t| t.parse().unwrap()).collect();
    PlaceRequest { variant, ..PlaceRequest::new(prepared.scene_id.clone(), 2, goal) }
}

pub(crate) fn run(prepared: &PreparedScene, request: &PlaceRequest, fake: &Fake) -> PlaceResult {
    plan(prepared, request, fake, &mut |_| ControlFlow::Continue(())).unwrap()
}

pub(crate) fn moved_by(result: &PlaceResult, answer: usize) -> nalgebra::Vector3<f64> {
    transform::from_row_major(&result.placements[answer].placed_from_observed.0).unwrap().translation.vector
}

/// A forecast that says the same of everything.
pub(crate) fn always(p: f32, names: &[&str]) -> Forecast {
    let leaf = DecisionTree { splits: Vec::new(), leaves: vec![(p / (1.0 - p)).ln()] };
    Forecast::new(names, BoostedTrees { bias: 0.0, trees: vec![leaf] }, ForecastFitData::default()).unwrap()
}

/// A forecast that says one thing where a measure is below a value, and another from there on.
pub(crate) fn stepped(names: &[&str], measure: &str, at: f32, said: [f32; 2]) -> Forecast {
    let number = names.iter().position(|name| *name == measure).unwrap() as u8;
    let splits = vec![TreeSplit(number, at, [Branch::Leaf(0), Branch::Leaf(1)])];
    let tree = DecisionTree { splits, leaves: said.map(|p| (p / (1.0 - p)).ln()).to_vec() };
    Forecast::new(names, BoostedTrees { bias: 0.0, trees: vec![tree] }, ForecastFitData::default()).unwrap()
}
