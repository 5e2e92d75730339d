//! Answers to `prior` and `score`: the networks on a held scene. Synchronous; the service and the command line share it.
//!
//! Nine relations are the networks'; `aligned` is judged by rule on the observed clouds, as a probability of 0 or 1. A candidate is one
//! unit of work for one thread, so an answer does not depend on how candidates were batched or spread.

use std::sync::{Mutex, PoisonError};

use nalgebra::Point3;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_networks::points::Observer;
use repose_networks::serving::spread;
use repose_networks::{Candidate, InputError, Mixture, Models, SceneContext};
use repose_proto::CallError;
use repose_proto::scoring::{ForecastsReply, MixtureComponent, ModelInfo, ModelsReply, PriorReply, PriorRequest, ScoreReply, ScoreRequest};

use crate::held_scene::HeldScene;
use crate::mixture;
use crate::scoring::{ScoreJob, Scoring};
use crate::wire_error::wire_error;

/// Why networks are not served.
#[derive(Debug, thiserror::Error)]
pub enum ServingError {
    /// They refused the trial scene.
    #[error(transparent)]
    Input(#[from] InputError),
    /// An answer was NaN or infinite.
    #[error("{network}: the answer is not finite")]
    NotFinite {
        /// The first network of which this is true.
        network: &'static str,
    },
}

/// The networks and the threads that they may use.
#[derive(Debug)]
pub struct Engine {
    models: Models,
    threads: usize,
}

impl Engine {
    /// Scores with `models` on up to `threads` threads per request.
    pub fn new(models: Models, threads: usize) -> Self {
        Self { models, threads: threads.max(1) }
    }

    /// Runs every network once on a small made-up scene, so that the first caller does not wait for memory and threads, and weights that
    /// overflow are noticed before they are served.
    ///
    /// # Errors
    /// [`ServingError`].
    pub fn warm_up(&self) -> Result<(), ServingError> {
        let side = |i: u32| 0.05 * (i % 8) as f32 / 8.0;
        let block = |label: u16| (0..64u32).map(move |i| (Point3::new(0.2 * f32::from(label) + side(i), side(i / 8), 0.05), label));
        let table = (0..900u32).map(|i| (Point3::new((i % 30) as f32 * 0.03 - 0.3, (i / 30) as f32 * 0.03 - 0.3, 0.0), 0));
        let (points, labels): (Vec<_>, Vec<_>) = table.chain(block(1)).chain(block(2)).unzip();
        let observer = Observer { eye: Point3::new(0.2, -0.5, 0.5), pixel_rad: 0.002 };
        let context = SceneContext::new(&points, &labels, 0.0, &observer, &self.models.config().cloud)?;
        let candidates = vec![Candidate { position_in_world: [0.3, 0.1, 0.05], yaw_rad: 0.1 }; 4 * self.threads];
        let Mixture { weights, means_in_viewer_m, sigmas_m, yaw_mean_rad, kappa } =
            self.models.prior(&context, 1, 2, [1, 0, 0, 0, 0, 0, 0, 0, 0, 0])?;
        let prior = [&weights, means_in_viewer_m.as_flattened(), sigmas_m.as_flattened(), &yaw_mean_rad, &kappa].concat();
        let relations = self.models.relations(&context, 1, &[2], &candidates, self.threads)?;
        let mut answers = vec![
            ("prior", prior),
            ("relations", relations.into_iter().flatten().flatten().collect()),
            ("discriminator", self.models.realism(&context, 1, &candidates, self.threads)?),
        ];
        if self.models.config().outcome {
            answers.push(("outcome", self.models.outcome(&context, 1, &candidates, self.threads)?));
        }
        match answers.iter().find(|(_, numbers)| !numbers.iter().all(|x| x.is_finite())) {
            Some((network, _)) => Err(ServingError::NotFinite { network }),
            None => Ok(()),
        }
    }

    /// BLAKE3 of the weights.
    pub fn weights_hash(&self) -> &str {
        self.models.hash()
    }

    /// The kernel in use.
    pub fn kernel(&self) -> &str {
        self.models.kernel_id()
    }

    /// Mixture and draws of the prior.
    ///
    /// # Errors
    /// `not_found` on `query` or `anchor`.
    pub fn prior(&self, request: &PriorRequest, held: &HeldScene) -> Result<PriorReply, CallError> {
        let context = held.prepared(request.view_yaw_rad, &self.models.config().cloud)?;
        let predicted = self.models.prior(&context, request.query, request.anchor, request.goal).map_err(|e| wire_error(&e, "anchor"))?;
        let mixture: Vec<MixtureComponent> = (0..predicted.weights.len())
            .map(|k| MixtureComponent {
                weight: f64::from(predicted.weights[k]),
                mean_m: predicted.means_in_viewer_m[k].map(f64::from),
                sigma_m: predicted.sigmas_m[k].map(f64::from),
                yaw_mean_rad: f64::from(predicted.yaw_mean_rad[k]),
                yaw_concentration: f64::from(predicted.kappa[k]),
            })
            .collect();
        let anchor = context.centroid_in_world(request.anchor).map(|c| c.cast::<f64>());
        let anchor = anchor.ok_or_else(|| CallError::not_found("anchor", format!("the scene has no object {}", request.anchor)))?;
        let mut rng = Pcg64::seed_from_u64(request.seed);
        let count = request.count as usize;
        let (candidates, components) = mixture::draw(&mixture, &anchor, &context.viewer(), request.rotation, count, &mut rng);
        let (weights_hash, kernel) = self.identity();
        Ok(PriorReply { mixture, weights_hash, kernel, candidates, components })
    }

    /// Realism and relations of candidates, as asked.
    ///
    /// # Errors
    /// `not_found` on `query` or `anchors`.
    pub fn score(&self, request: &ScoreRequest, held: &HeldScene) -> Result<ScoreReply, CallError> {
        let answer = Mutex::new(None);
        let job = ScoreJob { request, held, check: &|| Ok(()) };
        self.score_together(&[job], |_, reply| *answer.lock().unwrap_or_else(PoisonError::into_inner) = Some(reply));
        let answer = answer.into_inner().unwrap_or_else(PoisonError::into_inner);
        answer.unwrap_or_else(|| Err(CallError::internal("a request without an answer")))
    }

    /// Several requests at once: their candidates share the threads, in the order of the requests. `finish` gets each reply once, as soon as
    /// its last candidate is scored; it is what [`Engine::score`] would give alone. The rest of a request that failed, or whose check did, is
    /// not computed.
    pub fn score_together(&self, jobs: &[ScoreJob<'_>], finish: impl Fn(usize, Result<ScoreReply, CallError>) + Sync) {
        let scorings: Vec<Scoring<'_>> = jobs.iter().map(|job| Scoring::new(&self.models, job)).collect();
        let of_request = |(i, scoring): (usize, &Scoring<'_>)| (0..scoring.pieces).map(move |piece| (i, piece));
        let pieces: Vec<(usize, usize)> = scorings.iter().enumerate().flat_map(of_request).collect();
        spread(
            pieces.len(),
            self.threads,
            || (),
            |(), k| {
                let (i, piece) = pieces[k];
                if let Some(reply) = scorings[i].score(piece) {
                    finish(i, reply);
                }
            },
        );
    }

    /// The weights served.
    pub fn models(&self) -> ModelsReply {
        let (weights_hash, kernel) = self.identity();
        let info = self.models.info();
        let (recipe, metrics) = (info.recipe.clone(), info.metrics.clone());
        let model = ModelInfo { name: "default".to_owned(), hash: weights_hash.clone(), recipe, metrics };
        ModelsReply { weights_hash, kernel, models: vec![model] }
    }

    /// What was learned beside the networks, by name.
    pub fn forecasts(&self) -> ForecastsReply {
        ForecastsReply { weights_hash: self.models.hash().to_owned(), forecasts: self.models.info().forecasts.clone() }
    }

    /// The forecasts that were fitted with another outcome network than the one served: what they say is less sure.
    pub fn misfit_forecasts(&self) -> Vec<String> {
        self.models.misfit_forecasts()
    }

    /// BLAKE3 of the outcome network's parameters.
    pub fn outcome_hash(&self) -> &str {
        self.models.outcome_hash()
    }

    fn identity(&self) -> (String, String) {
        (self.models.hash().to_owned(), self.models.kernel_id().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use repose_networks::{NetworksConfig, Weights, parameters::WeightMap};

    use super::*;

    #[test]
    fn weights_that_overflow_are_noticed_before_they_are_served() {
        let weights = Weights::from_bytes(&Weights::initial(&NetworksConfig::paper(), 1).unwrap()).unwrap();
        let served = |values: &WeightMap| Engine::new(Models::load(&Weights::to_bytes(values, &weights.info).unwrap()).unwrap(), 1);
        served(&weights.values).warm_up().unwrap();
        let cases =
            [("prior", "prior/norm/scale"), ("relations", "relations/hidden/weight"), ("discriminator", "discriminator/sa4/norm/scale")];
        for (network, parameter) in cases {
            let mut values = weights.values.clone();
            // Sums overflow to infinity, and the last layer subtracts infinities.
            values.get_mut(parameter).unwrap().1.iter_mut().for_each(|x| *x = 3e38 * x.signum());
            let error = served(&values).warm_up().expect_err(network);
            assert!(matches!(error, ServingError::NotFinite { network: named } if named == network), "{network}: {error}");
        }
    }
}
