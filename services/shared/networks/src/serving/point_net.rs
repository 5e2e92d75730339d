//! A chain of set abstractions and the dense layers around it, on the kernels, with every norm folded into a scale and a shift.

use crate::{
    config::{NetworksConfig, SetAbstractionConfig},
    crops::Grouped,
    kernel::{Kernel, PackedLinear, PairMlp},
    layers::NORM_EPSILON,
    neighbours::Neighbours,
    object_encoder::CENTER_UNIT_M,
    parameters::WeightMap,
    weights::WeightsError,
};

type Result<T> = std::result::Result<T, WeightsError>;

/// Looks up stored values and says which are missing.
pub(crate) struct Stored<'a> {
    pub weights: &'a WeightMap,
}

impl<'a> Stored<'a> {
    fn get(&self, path: &str, shape: &[usize]) -> Result<&'a [f32]> {
        match self.weights.get(path) {
            Some((stored, values)) if stored == shape => Ok(values),
            Some((stored, _)) => Err(malformed(path, format!("expected shape {shape:?}, got {stored:?}"))),
            None => Err(malformed(path, "this tensor is missing".to_owned())),
        }
    }

    pub(crate) fn linear(&self, path: &str, inputs: usize, outputs: usize) -> Result<PackedLinear> {
        let weight = self.get(&format!("{path}/weight"), &[outputs, inputs])?;
        Ok(PackedLinear::new(inputs, outputs, weight, self.get(&format!("{path}/bias"), &[outputs])?))
    }

    /// A batch norm's running statistics as scale and shift. Those that are none give no numbers, which a ReLU after them would hide.
    pub(crate) fn batch_norm(&self, path: &str, width: usize) -> Result<Affine> {
        let part = |name: &str| self.get(&format!("{path}/{name}"), &[width]);
        let (scale, shift, mean, variance) = (part("scale")?, part("shift")?, part("mean")?, part("variance")?);
        if let Some(i) = variance.iter().position(|v| *v < 0.0) {
            return Err(malformed(&format!("{path}/variance"), format!("entry {i} is negative: {}", variance[i])));
        }
        let factor: Vec<f32> = scale.iter().zip(variance).map(|(s, v)| s / (v + NORM_EPSILON as f32).sqrt()).collect();
        let offset: Vec<f32> = (0..width).map(|k| shift[k] - mean[k] * factor[k]).collect();
        if let Some(i) = (0..width).find(|k| !(factor[*k].is_finite() && offset[*k].is_finite())) {
            return Err(malformed(path, format!("entry {i}: a factor of {} and an offset of {}, expected numbers", factor[i], offset[i])));
        }
        Ok(Affine { scale: factor, shift: offset })
    }

    pub(crate) fn layer_norm(&self, path: &str, width: usize) -> Result<Affine> {
        let part = |name: &str| Ok::<_, WeightsError>(self.get(&format!("{path}/{name}"), &[width])?.to_vec());
        Ok(Affine { scale: part("scale")?, shift: part("shift")? })
    }
}

fn malformed(field: &str, reason: String) -> WeightsError {
    WeightsError::Malformed { field: field.to_owned(), reason }
}

/// `y = scale · x + shift` per column.
#[derive(Debug, Clone)]
pub(crate) struct Affine {
    scale: Vec<f32>,
    shift: Vec<f32>,
}

impl Affine {
    /// `relu(scale · x + shift)` on rows.
    pub(crate) fn relu(&self, rows: &mut [f32]) {
        for row in rows.chunks_exact_mut(self.scale.len()) {
            for ((y, scale), shift) in row.iter_mut().zip(&self.scale).zip(&self.shift) {
                *y = (*y * scale + shift).max(0.0);
            }
        }
    }

    /// Layer norm of one row.
    pub(crate) fn layer_normed(&self, row: &mut [f32]) {
        let n = row.len() as f32;
        let mean = row.iter().sum::<f32>() / n;
        let variance = row.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>() / n;
        let deviation = (variance + NORM_EPSILON as f32).sqrt();
        for ((y, scale), shift) in row.iter_mut().zip(&self.scale).zip(&self.shift) {
            *y = (*y - mean) / deviation * scale + shift;
        }
    }
}

/// Buffers that a thread reuses between candidates.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    input: Vec<f32>,
    point_terms: Vec<f32>,
    centroid_terms: Vec<f32>,
    pair: Vec<f32>,
}

#[derive(Debug, Clone)]
struct Level {
    config: SetAbstractionConfig,
    /// First layer on points: `[hidden, 3 + features]`.
    first: PackedLinear,
    /// First layer on centroids: its coordinate columns, without bias.
    first_of_centroids: PackedLinear,
    middle: Option<PackedLinear>,
    last: PackedLinear,
    norm: Affine,
}

/// A chain of set abstractions with packed weights, for serving.
#[derive(Debug, Clone)]
pub(crate) struct PackedPointNet {
    levels: Vec<Level>,
}

impl PackedPointNet {
    pub(crate) fn new(stored: &Stored<'_>, path: &str, configs: &[SetAbstractionConfig]) -> Result<Self> {
        let levels = configs.iter().enumerate().map(|(k, config)| Level::new(stored, &format!("{path}/sa{}", k + 1), config));
        Ok(Self { levels: levels.collect::<Result<_>>()? })
    }

    /// One sample → the last level's features.
    pub(crate) fn forward(&self, kernel: Kernel, sample: &Grouped, scratch: &mut Scratch) -> Vec<f32> {
        let is_labelled = self.levels.first().is_some_and(|l| l.config.features == 1);
        let mut features = if is_labelled { sample.is_query.clone() } else { Vec::new() };
        let mut points = &sample.points;
        for (level, grouping) in (0..).zip(&sample.levels) {
            features = self.level(kernel, level, points, &features, &grouping.centroids, &grouping.neighbours, scratch);
            points = &grouping.centroids;
        }
        features
    }

    /// One level: coordinates and features of points → features of centroids `[centroids, outputs]`, in the world they share.
    #[allow(clippy::too_many_arguments, reason = "a level's input, named one by one")]
    pub(crate) fn level(
        &self,
        kernel: Kernel,
        level: usize,
        points: &[[f32; 3]],
        features: &[f32],
        centroids: &[[f32; 3]],
        neighbours: &Neighbours,
        scratch: &mut Scratch,
    ) -> Vec<f32> {
        let Scratch { input, point_terms, centroid_terms, pair } = scratch;
        let level = &self.levels[level];
        let scale = 1.0 / level.config.radius_m;
        let width = level.config.features;
        input.clear();
        for (i, p) in points.iter().enumerate() {
            input.extend(p.map(|x| x * scale));
            input.extend_from_slice(&features[i * width..(i + 1) * width]);
        }
        point_terms.resize(points.len() * level.first.padded(), 0.0);
        kernel.linear(&level.first, input, points.len(), false, point_terms);
        input.clear();
        input.extend(centroids.iter().flatten().map(|x| x * scale));
        centroid_terms.resize(centroids.len() * level.first_of_centroids.padded(), 0.0);
        kernel.linear(&level.first_of_centroids, input, centroids.len(), false, centroid_terms);
        let mut out = vec![0.0; centroids.len() * level.last.padded()];
        let op = PairMlp { point_terms, centroid_terms, middle: level.middle.as_ref(), last: &level.last, neighbours };
        kernel.pair_mlp(&op, &mut out, pair);
        if level.config.centroids == 0 {
            out.chunks_exact_mut(level.last.padded()).for_each(|row| level.norm.layer_normed(row));
            out.iter_mut().for_each(|x| *x = x.max(0.0));
        } else {
            level.norm.relu(&mut out);
        }
        out
    }
}

impl Level {
    fn new(stored: &Stored<'_>, path: &str, config: &SetAbstractionConfig) -> Result<Self> {
        let &[hidden, .., outputs] = &config.widths[..] else {
            return Err(malformed(path, format!("a set abstraction has two or three layers, got {:?}", config.widths)));
        };
        let inputs = config.inputs();
        let first = stored.linear(&format!("{path}/linear1"), inputs, hidden)?;
        let weight = stored.get(&format!("{path}/linear1/weight"), &[hidden, inputs])?;
        let of_coordinates: Vec<f32> = weight.chunks_exact(inputs).flat_map(|row| row[..3].to_vec()).collect();
        let (middle, last) = match config.widths[..] {
            [_, middle, _] => (
                Some(stored.linear(&format!("{path}/linear2"), hidden, middle)?),
                stored.linear(&format!("{path}/linear3"), middle, outputs)?,
            ),
            _ => (None, stored.linear(&format!("{path}/linear2"), hidden, outputs)?),
        };
        let norm = format!("{path}/norm");
        Ok(Self {
            config: config.clone(),
            first,
            first_of_centroids: PackedLinear::new(3, hidden, &of_coordinates, &vec![0.0; hidden]),
            middle,
            last,
            norm: if config.centroids == 0 { stored.layer_norm(&norm, outputs)? } else { stored.batch_norm(&norm, outputs)? },
        })
    }
}

/// One row through a layer.
pub(crate) fn row(kernel: Kernel, layer: &PackedLinear, input: &[f32], relu: bool) -> Vec<f32> {
    let mut out = vec![0.0; layer.padded()];
    kernel.linear(layer, input, 1, relu, &mut out);
    out.truncate(layer.outputs());
    out
}

/// (features, centre) → code, with packed weights: the end of both encoders.
#[derive(Debug, Clone)]
pub(crate) struct PackedCodeHead {
    center1: PackedLinear,
    center2: PackedLinear,
    hidden: PackedLinear,
    norm: Affine,
    code: PackedLinear,
}

impl PackedCodeHead {
    pub(crate) fn new(stored: &Stored<'_>, path: &str, config: &NetworksConfig, features: usize) -> Result<Self> {
        let (center, hidden) = (config.center_code, config.hidden[0]);
        Ok(Self {
            center1: stored.linear(&format!("{path}/center1"), 3, center)?,
            center2: stored.linear(&format!("{path}/center2"), center, center)?,
            hidden: stored.linear(&format!("{path}/hidden"), features + center, hidden)?,
            norm: stored.layer_norm(&format!("{path}/hidden_norm"), hidden)?,
            code: stored.linear(&format!("{path}/code"), hidden, config.code)?,
        })
    }

    /// Features and a centre (metres) → code.
    pub(crate) fn forward(&self, kernel: Kernel, features: &[f32], center_m: [f32; 3]) -> Vec<f32> {
        let center = row(kernel, &self.center1, &center_m.map(|x| x / CENTER_UNIT_M), true);
        let center = row(kernel, &self.center2, &center, false);
        let mut hidden = row(kernel, &self.hidden, &[features, &center].concat(), true);
        self.norm.layer_normed(&mut hidden);
        row(kernel, &self.code, &hidden, false)
    }
}
