//! The shapes of all networks in one place.

use crate::{
    parameters::{MEASURES_WEIGHT, OUTCOME, WeightMap},
    points::CloudConfig,
};

/// One set abstraction: `SA(n, k, r, mlp)`.
#[derive(Debug, Clone, PartialEq)]
pub struct SetAbstractionConfig {
    /// Centroids, the first of the sampling order. 0 means one group of all points: the global layer.
    pub centroids: usize,
    /// Neighbours of a centroid at most, the first of the sampling order.
    pub neighbours: usize,
    /// How far a neighbour may be, metres; relative coordinates are divided by it.
    pub radius_m: f32,
    /// Features of a point besides its coordinates.
    pub features: usize,
    /// Widths of the layers: two or three.
    pub widths: Vec<usize>,
}

impl SetAbstractionConfig {
    /// Inputs of the first layer: relative coordinates and features.
    pub fn inputs(&self) -> usize {
        3 + self.features
    }

    /// Outputs.
    pub fn outputs(&self) -> usize {
        self.widths.last().copied().unwrap_or(0)
    }
}

fn level(centroids: usize, neighbours: usize, radius_m: f32, features: usize, widths: &[usize]) -> SetAbstractionConfig {
    SetAbstractionConfig { centroids, neighbours, radius_m, features, widths: widths.to_vec() }
}

/// All shapes. The defaults are the paper's (appendix A.2) where it gives them.
#[derive(Debug, Clone, PartialEq)]
pub struct NetworksConfig {
    /// How clouds are thinned and ordered.
    pub cloud: CloudConfig,
    /// Set abstractions of the object encoder; the last is global.
    pub object_levels: Vec<SetAbstractionConfig>,
    /// Set abstractions of the scene encoder; the last is global.
    pub scene_levels: Vec<SetAbstractionConfig>,
    /// Set abstractions of the discriminator; the last is global.
    pub discriminator_levels: Vec<SetAbstractionConfig>,
    /// Points that the scene encoder sees.
    pub scene_encoder_points: usize,
    /// Radius of the scene encoder's and the discriminator's crops, metres.
    pub crop_m: f32,
    /// Points that the discriminator sees in all, of the query at most, and near the query at most.
    pub discriminator_points: DiscriminatorPoints,
    /// Width of the encoding of an object's centre.
    pub center_code: usize,
    /// Width of the layer before an object's code, and of the hidden layers of predictor and prior.
    pub hidden: [usize; 2],
    /// Width of an object's or a scene's code `h`.
    pub code: usize,
    /// Components of the prior's mixture.
    pub components: usize,
    /// Whether the relation predictor reads [`crate::pair_measures`] beside the codes (ours), and how wide the two layers of their encoding are;
    /// `None` is the paper's.
    pub measures_code: Option<usize>,
    /// How many points the outcome network uses.
    pub shared: SharedConfig,
    /// Whether there is an outcome network beside the discriminator (ours): the same layers, on scene features
    /// that candidates share ([`crate::shared_scene`]), trained on simulated releases.
    pub outcome: bool,
}

/// How many points the discriminator uses of each kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscriminatorPoints {
    /// All points.
    pub total: usize,
    /// At most this many of the query.
    pub query: usize,
    /// At most this many of the scene near the query.
    pub near: usize,
    /// How far from the query's box "near" reaches, metres: 0.15 m from the centre of an object of 10 cm. Sampling the whole crop evenly
    /// would leave 2.3 cm between points, too coarse to see contact.
    pub near_m: f32,
}

/// How many centroids and neighbours the outcome network has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharedConfig {
    /// Centroids of the scene at the first and the second level.
    pub scene_centroids: [usize; 2],
    /// Centroids of the query at the three levels, even numbers.
    pub query_centroids: [usize; 3],
    /// Neighbours of a query's centroid among the query's points, and among the scene's, at most.
    pub neighbours: [usize; 2],
}

impl Default for SharedConfig {
    fn default() -> Self {
        Self { scene_centroids: [2048, 512], query_centroids: [128, 64, 32], neighbours: [32, 32] }
    }
}

/// Relations that the predictor predicts, the first in wire order; the tenth (`aligned`) is judged by rule.
pub const PREDICTED_RELATIONS: usize = 9;
/// Relations that a goal can name.
pub const GOAL_RELATIONS: usize = 10;

impl NetworksConfig {
    /// The networks of the paper alone.
    pub fn paper() -> Self {
        Self { measures_code: None, outcome: false, ..Self::default() }
    }

    /// The width of the relation predictor's hidden layer: more where it reads more.
    pub fn relations_hidden(&self) -> usize {
        if self.measures_code.is_some() { self.hidden[0] } else { self.hidden[1] }
    }

    /// The default shapes, with the optional parts that the weights have.
    pub fn of_weights(weights: &WeightMap) -> Self {
        let measures = weights.get(MEASURES_WEIGHT).and_then(|(shape, _)| shape.first().copied());
        let outcome = weights.keys().any(|path| path.starts_with(OUTCOME));
        Self { measures_code: measures, outcome, ..Self::default() }
    }
}

impl Default for NetworksConfig {
    fn default() -> Self {
        let encoder = |reach: f32| {
            vec![
                level(128, 64, 0.04 * reach, 0, &[32, 32, 64]),
                level(32, 32, 0.08 * reach, 64, &[64, 64, 128]),
                level(0, 0, 0.16 * reach, 128, &[128, 128, 256]),
            ]
        };
        Self {
            cloud: CloudConfig::default(),
            object_levels: encoder(1.0),
            // The same layers over a crop of half a metre, where a radius of 0.04 m would hold no neighbours.
            scene_levels: encoder(3.0),
            discriminator_levels: vec![
                level(512, 64, 0.05, 1, &[32, 64]),
                level(256, 64, 0.10, 64, &[64, 128]),
                level(128, 64, 0.20, 128, &[128, 256]),
                level(0, 0, 0.40, 256, &[256, 512]),
            ],
            scene_encoder_points: 1024,
            crop_m: 0.5,
            discriminator_points: DiscriminatorPoints { total: 2048, query: 512, near: 768, near_m: 0.10 },
            center_code: 128,
            hidden: [256, 128],
            code: 128,
            components: 5,
            measures_code: Some(128),
            shared: SharedConfig::default(),
            outcome: true,
        }
    }
}
