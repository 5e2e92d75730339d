//! How likely an object stays where it is let go: the outcome network's word, weighed with what geometry measures of the place.
//!
//! The network sees points; that an object hangs a hand above a table, or is half in something, it tells only roughly. Geometry measures
//! such things, but knows nothing of shapes beyond its guess. A logistic regression on both and their products, fitted on releases in training
//! scenes (draws of the prior and the planner's places: `repose train --network stability`), says more than either, and what it says comes true
//! as often as it says.

use std::sync::OnceLock;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::constraints::view_miss;
use crate::footing::Ground;
use crate::obstruction::obstruction;
use crate::prepared::Prepared;
use crate::query::Query;
use crate::settings::Fixed;
use crate::unseen::unseen_share;

/// How many things are measured.
pub const COUNT: usize = 30;
/// What is measured, in order.
pub const MEASURES: [&str; COUNT] = [
    "network",             // the outcome network's logit
    "network_sure",        // its probability, squared
    "drop_from_near",      // fall onto what reaches less than 1 cm into it
    "drop",                // … 3 cm
    "drop_far",            // whether that is farther than a stable object may move
    "sunk",                // how deep it is in that
    "drop_from_above",     // fall onto what reaches less than 8 cm into it
    "drop_from_above_far", // whether that is too far
    "sunk_from_above",     // how deep it is in that
    "margin",              // let down: its axis inside the edge of what carries it
    "beyond_edge",         // … or beyond it
    "seen",                // share of its base seen to be carried
    "carried",             // … or believed to be
    "on_object",           // whether an object carries it
    "colliding",           // share of its cells that something fills, as it is
    "collides",            // whether any
    "colliding_settled",   // the same, let down
    "collides_settled",
    "colliding_lifted", // the same, a hair above that
    "clearance",        // distance from everything else
    "rim",              // share of the band around its base that is carried
    "unseen",           // share of its volume in space that was not seen
    "doubtful",         // what fills where its unseen back may reach
    "unhidden",         // share of its points that would be seen
    "height",           // its height
    "base",             // how far inside its base its axis is
    "slenderness",      // the one over the other
    "back_unknown",     // how far its back is a guess
    "points",           // how many points of it were seen
    "in_picture",       // share of its points in the picture
];
/// Terms of the regression: every measure, and every product of two, squares too.
const TERMS: usize = COUNT + COUNT * (COUNT + 1) / 2;

/// The regression that comes with the program.
const EMBEDDED: &str = include_str!("../weights/stability.json");
/// A fall that is far, metres.
const FAR_M: f32 = 0.1;
/// Ridge on standardised terms. There are hundreds of them, each of which says little.
const RIDGE: f64 = 100.0;
/// Newton's steps; it settles in about eight.
const STEPS: usize = 30;

/// The measures of a candidate, in the order of [`MEASURES`], each about 0 to 1. `outcome` is what the outcome network says of it.
pub fn measures(prepared: &Prepared, query: &Query, candidate: &Candidate, outcome: f32, fixed: &Fixed) -> [f64; COUNT] {
    let ground = Ground { prepared, query, settings: &fixed.support };
    let bottom_m = query.bottom_of(candidate.centroid_m[2]);
    // How far it falls onto what is under it; below zero, how deep it is in that. What is higher above its bottom than `up_m` is beside it.
    let drop_m =
        |up_m: f32| ground.rest_m(candidate, bottom_m + up_m).map_or(FAR_M, |rest_m| bottom_m - (rest_m - fixed.support.release_m));
    let [near_m, drop_m, above_m] = [0.01, 0.03, 0.08].map(drop_m);
    let at = |lower_by_m: f32| {
        let mut at = *candidate;
        at.centroid_m[2] -= lower_by_m;
        at
    };
    let in_way = |c: &Candidate| obstruction(prepared, query, c, &[], &fixed.clearance, &fixed.support);
    let settled = at(drop_m);
    let footing = ground.footing(&settled);
    let (here, there, lifted) = (in_way(candidate), in_way(&settled), in_way(&at(drop_m - fixed.support.release_m)));
    let (seen, _) = view_miss(&prepared.view, query, candidate, &fixed.view);
    let part = |x_m: f32, most_m: f32| f64::from((x_m / most_m).clamp(0.0, 1.0));
    // From 3 to 6 cm: what falls 5 cm has moved.
    let far = |x_m: f32| part(x_m - 0.03, 0.03);
    let height_m = query.shape.top_m - query.shape.bottom_m;
    let flag = |yes: bool| f64::from(u8::from(yes));
    let share = |x: f64| (x / 0.3).min(1.0);
    let network = f64::from(outcome).clamp(0.005, 0.995);
    let margin = footing.margin_m.clamp(-0.04, 0.04) / 0.04;
    [
        (network / (1.0 - network)).ln() / 3.0,
        network * network,
        part(near_m, FAR_M),
        part(drop_m, FAR_M),
        far(drop_m),
        part(-drop_m, 0.04),
        part(above_m, FAR_M),
        far(above_m),
        part(-above_m, 0.08),
        margin,
        flag(margin < 0.0),
        footing.seen_share,
        footing.carried_share,
        flag(footing.carrier.is_some_and(|carrier| carrier != 0)),
        share(here.colliding_share),
        flag(here.colliding_share > 0.0),
        share(there.colliding_share),
        flag(there.colliding_share > 0.0),
        share(lifted.colliding_share),
        (here.clearance_m / 0.04).min(1.0),
        ground.rim_share(&settled),
        unseen_share(prepared.scene.meta.unseen.space.as_ref(), query, candidate, &fixed.unseen),
        (10.0 * there.doubtful_share).min(1.0),
        seen.unhidden,
        part(height_m, 0.2),
        (query.base_margin_m / 0.04).min(1.0),
        (f64::from(height_m) / query.base_margin_m.max(0.002) / 10.0).min(1.0),
        part(query.shape.doubt.norm(), 0.04),
        (prepared.objects.get(&query.id).map_or(1.0, |o| o.points.len() as f64).max(1.0).ln() / 10.0).min(1.0),
        seen.in_picture,
    ]
}

/// The terms of measures, in order: each measure, then its products with itself and those after it.
fn terms(measures: &[f64; COUNT]) -> impl Iterator<Item = f64> + '_ {
    measures.iter().copied().chain((0..COUNT).flat_map(move |i| (i..COUNT).map(move |j| measures[i] * measures[j])))
}

/// A release to learn from.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// What was measured before.
    pub measures: [f64; COUNT],
    /// Whether the object's centre moved less than 5 cm.
    pub stable: bool,
}

/// A logistic regression on [`MEASURES`] and their products.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stability {
    /// Names of the measures, to tell a file of another version.
    measures: Vec<String>,
    /// The logit that each term adds: each measure, then its products with itself and those after it.
    weights: Vec<f64>,
    /// The logit without any.
    bias: f64,
    /// What it was fitted on: releases, and the weights whose outcome network spoke.
    fitted_on: FittedOn,
}

/// What a regression was fitted on.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FittedOn {
    /// Scenes of the training split.
    pub scenes: u64,
    /// Releases.
    pub releases: usize,
    /// BLAKE3 of the weights whose outcome network spoke.
    pub weights_hash: String,
}

/// Why there is no regression.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoFit(String);

impl std::fmt::Display for NoFit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NoFit {}

impl Stability {
    /// The regression that comes with the program.
    pub fn embedded() -> &'static Self {
        static EMBEDDED_FIT: OnceLock<Stability> = OnceLock::new();
        EMBEDDED_FIT.get_or_init(|| Self::from_json(EMBEDDED).unwrap_or_else(|e| unreachable!("a test reads it: {e}")))
    }

    /// Reads what [`serde_json`] wrote of one.
    ///
    /// # Errors
    /// When the text is none, or is of other measures.
    pub fn from_json(text: &str) -> Result<Self, NoFit> {
        let read: Self = serde_json::from_str(text).map_err(|e| NoFit(e.to_string()))?;
        let finite = read.weights.iter().chain([&read.bias]).all(|x| x.is_finite());
        if read.measures != MEASURES || read.weights.len() != TERMS || !finite {
            return Err(NoFit(format!("expected {TERMS} finite weights of {MEASURES:?} and their products")));
        }
        Ok(read)
    }

    /// The probability that what was measured stays: that it moves less than 5 cm.
    pub fn of(&self, measures: &[f64; COUNT]) -> f64 {
        let logit = self.bias + self.weights.iter().zip(terms(measures)).map(|(w, x)| w * x).sum::<f64>();
        1.0 / (1.0 + (-logit).exp())
    }

    /// Fits releases: the largest likelihood, with a ridge on standardised terms. The same samples in the same order give the same bits.
    ///
    /// # Errors
    /// When there are fewer releases than terms, or all came to the same.
    pub fn fit(samples: &[Sample], fitted_on: FittedOn) -> Result<Self, NoFit> {
        let n = samples.len();
        let stable = samples.iter().filter(|s| s.stable).count();
        if n < TERMS || stable == 0 || stable == n {
            return Err(NoFit(format!("expected at least {TERMS} releases, some stable and some not; got {n}, {stable} stable")));
        }
        let mut rows = DMatrix::from_row_iterator(n, TERMS, samples.iter().flat_map(|s| terms(&s.measures)));
        let mut moments = Vec::with_capacity(TERMS);
        for mut term in rows.column_iter_mut() {
            let mean = term.mean();
            // A term that is always the same says nothing.
            let scale = term.variance().sqrt().max(1e-6);
            term.apply(|x| *x = (*x - mean) / scale);
            moments.push((mean, scale));
        }
        // A product with this is several times faster than one with `rows` turned as it goes.
        let columns = rows.transpose();
        let (mut w, mut bias) = (DVector::<f64>::zeros(TERMS), (stable as f64 / (n - stable) as f64).ln());
        for _ in 0..STEPS {
            let p = (&rows * &w).map(|x| 1.0 / (1.0 + (-x - bias).exp()));
            let error = DVector::from_fn(n, |i, _| p[i] - f64::from(u8::from(samples[i].stable)));
            let slope = p.map(|p| p * (1.0 - p));
            // Newton's step, the bias eliminated first: it has no ridge.
            let weighted = DMatrix::from_fn(n, TERMS, |i, j| rows[(i, j)] * slope[i]);
            let (total, mean) = (slope.sum().max(1e-12), weighted.row_sum_tr());
            let curvature = &columns * &weighted - &mean * mean.transpose() / total + DMatrix::identity(TERMS, TERMS) * RIDGE;
            let gradient = &columns * &error + &w * RIDGE - &mean * (error.sum() / total);
            let step =
                curvature.cholesky().ok_or_else(|| NoFit("the releases do not tell the measures apart".to_owned()))?.solve(&gradient);
            bias -= (error.sum() - mean.dot(&step)) / total;
            w -= &step;
            if step.amax() < 1e-7 {
                break;
            }
        }
        let weights: Vec<f64> = w.iter().zip(&moments).map(|(w, (_, scale))| w / scale).collect();
        let bias = bias - weights.iter().zip(&moments).map(|(w, (mean, _))| w * mean).sum::<f64>();
        Ok(Self { measures: MEASURES.map(str::to_owned).to_vec(), weights, bias, fitted_on })
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::synthetic::{Builder, standing_at};

    #[test]
    fn a_fit_finds_the_probabilities_that_made_the_releases() {
        let mut rng = Pcg64::seed_from_u64(4);
        let logit = |m: &[f64]| 2.0 * m[0] - 3.0 * m[7] * m[9] + 0.5;
        let samples: Vec<Sample> = (0..5000)
            .map(|_| {
                let measures = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
                Sample { measures, stable: rng.random_bool(1.0 / (1.0 + (-logit(&measures)).exp())) }
            })
            .collect();
        let fit = Stability::fit(&samples, FittedOn::default()).unwrap();
        let error = |s: &Sample| (fit.of(&s.measures) - 1.0 / (1.0 + (-logit(&s.measures)).exp())).abs();
        let mean = samples.iter().map(error).sum::<f64>() / samples.len() as f64;
        assert!(mean < 0.1, "{mean}");
        let said = samples.iter().map(|s| fit.of(&s.measures)).sum::<f64>();
        let came = samples.iter().filter(|s| s.stable).count() as f64;
        assert!((said - came).abs() < 1.0, "without a ridge on the bias it says as many as came true: {said}, {came}");
        let again = Stability::from_json(&serde_json::to_string(&fit).unwrap()).unwrap();
        assert_eq!(again, fit);
        assert!(Stability::fit(&samples[..100], FittedOn::default()).unwrap_err().to_string().contains("got 100"));
    }

    #[test]
    fn a_file_of_other_measures_is_refused() {
        let text = serde_json::to_string(Stability::embedded()).unwrap();
        assert!(Stability::from_json(&text.replace("rim", "brim")).is_err());
        assert!(Stability::from_json("{}").is_err());
    }

    #[test]
    fn what_is_measured_is_what_it_is_called() {
        let prepared = Builder::table().object(1, [0.0, 0.1], [0.15, 0.15, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = Query::new(&prepared, 2, 0.0, &fixed).unwrap();
        let of = |name: &str, x: f32, y: f32, bottom_m: f32| {
            let measured = measures(&prepared, &query, &standing_at(&query, x, y, bottom_m), 0.5, &fixed);
            measured[MEASURES.iter().position(|m| *m == name).unwrap()]
        };
        assert_eq!(of("network", 0.25, 0.0, 0.004), 0.0);
        assert!((of("drop", 0.25, 0.0, 0.05) - 0.5).abs() < 0.05 && of("sunk", 0.25, 0.0, 0.05) == 0.0);
        assert!(of("drop_far", 0.25, 0.0, 0.05) > 0.5 && of("drop_far", 0.25, 0.0, 0.02) == 0.0);
        assert!(of("sunk", 0.25, 0.0, -0.02) > 0.4 && of("drop", 0.25, 0.0, -0.02) == 0.0);
        assert_eq!((of("collides", 0.0, 0.1, 0.05), of("collides", 0.25, 0.0, 0.004)), (1.0, 0.0));
        assert_eq!((of("beyond_edge", 0.55, 0.0, 0.004), of("beyond_edge", 0.25, 0.0, 0.004)), (1.0, 0.0));
        assert_eq!((of("on_object", 0.0, 0.1, 0.104), of("on_object", 0.25, 0.0, 0.004)), (1.0, 0.0));
        assert!((of("height", 0.25, 0.0, 0.004) - 0.4).abs() < 0.03);
        assert!(of("seen", 0.25, 0.0, 0.004) > 0.9 && of("in_picture", 0.25, 0.0, 0.004) > 0.9);
    }

    #[test]
    fn what_stands_is_likelier_to_stay_than_what_hangs_sinks_or_overhangs() {
        let prepared = Builder::table().object(1, [0.0, 0.1], [0.15, 0.15, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = Query::new(&prepared, 2, 0.0, &fixed).unwrap();
        let stays = |x: f32, y: f32, bottom_m: f32| {
            Stability::embedded().of(&measures(&prepared, &query, &standing_at(&query, x, y, bottom_m), 0.7, &fixed))
        };
        let stands = stays(0.25, 0.0, 0.004);
        assert!(stands > 0.8, "{stands}");
        for (other, what) in
            [(stays(0.25, 0.0, 0.12), "hangs"), (stays(0.0, 0.1, 0.05), "is in the box"), (stays(0.5, 0.0, 0.004), "overhangs")]
        {
            assert!(other < stands - 0.1, "{what}: {other}, standing {stands}");
        }
    }
}
