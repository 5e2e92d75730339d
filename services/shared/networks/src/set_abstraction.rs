//! Set abstraction (PointNet++) for training: group, shared MLP, max.
//!
//! The first linear layer distributes over (neighbour − centroid, features), so it is computed once per point. Coordinates are divided by
//! the level's radius, which keeps their scale that of the features.
//!
//! Where the batch norm is: the paper's MLPs have one per layer, over every pair. Here one follows the max, over the centroids of the
//! batch: the tensor is 64 times smaller, normalising before the last ReLU commutes with a max (up to the sign of a learned scale), and the
//! one or two hidden layers keep their scale by He initialisation. A global level has one row per sample, too few for batch statistics, and
//! is layer-normed instead.

use std::sync::{Arc, Mutex};

use candle_core::{Device, Result, Tensor};

use crate::{
    config::SetAbstractionConfig,
    crops::Grouping,
    fused::FusedPairMlp,
    kernel::Kernel,
    layers::{BatchNorm, LayerNorm, Linear, Mode},
    parameters::Builder,
};

/// One level.
#[derive(Debug, Clone)]
pub struct SetAbstraction {
    config: SetAbstractionConfig,
    linears: Vec<Linear>,
    norm: Norm,
}

#[derive(Debug, Clone)]
enum Norm {
    Batch(BatchNorm),
    Layer(LayerNorm),
}

impl SetAbstraction {
    /// A level with its parameters under `name`.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, name: &str, config: &SetAbstractionConfig) -> Result<Self> {
        builder.within(name, |b| {
            let mut linears = Vec::new();
            let mut inputs = config.inputs();
            for (k, width) in config.widths.iter().enumerate() {
                linears.push(Linear::new(b, &format!("linear{}", k + 1), inputs, *width)?);
                inputs = *width;
            }
            let norm = if config.centroids == 0 {
                Norm::Layer(LayerNorm::new(b, "norm", inputs)?)
            } else {
                Norm::Batch(BatchNorm::new(b, "norm", inputs)?)
            };
            Ok(Self { config: config.clone(), linears, norm })
        })
    }

    /// Coordinates `[points, 3]` (metres) and features `[points, features]` → features of the centroids `[centroids, outputs]`.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward(&self, points: &Tensor, features: Option<&Tensor>, grouping: &Grouping, mode: &Mode) -> Result<Tensor> {
        let (point_terms, centroid_terms) = self.first_layer(points, features, grouping)?;
        let rest: Vec<Tensor> = self.linears[1..].iter().map(Linear::flat).collect::<Result<_>>()?;
        let op = FusedPairMlp {
            kernel: Kernel::detect(),
            neighbours: Arc::new(grouping.neighbours.clone()),
            widths: self.config.widths.clone(),
            winners: Mutex::default(),
        };
        let pooled = point_terms.contiguous()?.apply_op3(&centroid_terms.contiguous()?, &Tensor::cat(&rest, 0)?, op)?;
        self.normed(&pooled, mode)
    }

    /// The same by candle's own operations on all pairs at once, which run on any device.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward_gathered(&self, points: &Tensor, features: Option<&Tensor>, grouping: &Grouping, mode: &Mode) -> Result<Tensor> {
        let (point_terms, centroid_terms) = self.first_layer(points, features, grouping)?;
        let (centroids, most) = (grouping.neighbours.centroids(), grouping.neighbours.most());
        let gathered = Tensor::from_vec(grouping.neighbours.padded()?, centroids * most, points.device())?;
        let pairs = point_terms.index_select(&gathered, 0)?.reshape((centroids, most, ()))?;
        let mut x = pairs.broadcast_sub(&centroid_terms.unsqueeze(1)?)?.flatten(0, 1)?;
        for linear in &self.linears[1..] {
            x = linear.forward(&x.relu()?)?;
        }
        let x = x.reshape((centroids, most, ()))?;
        // By the winner's place, because candle's gradient of a maximum goes to all that tie, padding included.
        let winners = x.detach().argmax_keepdim(1)?;
        self.normed(&x.gather(&winners, 1)?.squeeze(1)?, mode)
    }

    /// The first linear layer's part of each point, `[points, hidden]`, and of each centroid, `[centroids, hidden]`: a pair's is the difference.
    fn first_layer(&self, points: &Tensor, features: Option<&Tensor>, grouping: &Grouping) -> Result<(Tensor, Tensor)> {
        let scale = 1.0 / f64::from(self.config.radius_m);
        let points = (points * scale)?;
        let centroids = (coordinates(&grouping.centroids, points.device())? * scale)?;
        let input = match features {
            Some(features) => Tensor::cat(&[&points, features], 1)?,
            None => points,
        };
        Ok((self.linears[0].forward(&input)?, centroids.matmul(&self.of_coordinates()?)?))
    }

    /// The first linear layer's weights on coordinates, `[3, hidden]`. Copied out of the whole: CUDA's products take a transposed operand only
    /// where its rows lie without gaps.
    fn of_coordinates(&self) -> Result<Tensor> {
        self.linears[0].weight().narrow(1, 0, 3)?.contiguous()?.t()
    }

    /// The same, operation by operation and neighbour list by neighbour list: the reference that tests compare the fused paths with.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward_plain(&self, points: &Tensor, features: Option<&Tensor>, grouping: &Grouping, mode: &Mode) -> Result<Tensor> {
        let mut rows = Vec::new();
        for (i, centroid) in grouping.centroids.iter().enumerate() {
            let list = Tensor::new(grouping.neighbours.of(i), points.device())?;
            let centroid = Tensor::new(&[*centroid], points.device())?;
            let relative = (points.index_select(&list, 0)?.broadcast_sub(&centroid)? * (1.0 / f64::from(self.config.radius_m)))?;
            let mut x = match features {
                Some(features) => Tensor::cat(&[relative, features.index_select(&list, 0)?], 1)?,
                None => relative,
            };
            for (k, linear) in self.linears.iter().enumerate() {
                x = if k == 0 { linear.forward(&x)? } else { linear.forward(&x.relu()?)? };
            }
            rows.push(x.max_keepdim(0)?);
        }
        self.normed(&Tensor::cat(&rows, 0)?, mode)
    }

    fn normed(&self, pooled: &Tensor, mode: &Mode) -> Result<Tensor> {
        match &self.norm {
            Norm::Batch(norm) => norm.forward(pooled, mode)?.relu(),
            Norm::Layer(norm) => norm.forward(pooled)?.relu(),
        }
    }
}

/// Which implementation of the set abstractions a forward pass runs on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Path {
    /// Fused kernels, which a CPU has.
    Fused,
    /// candle's operations on all pairs at once, which any device has.
    Gathered,
    /// candle, operation by operation: the reference.
    Plain,
}

impl Path {
    /// The fastest that a device has.
    pub fn of(device: &Device) -> Self {
        if device.is_cpu() { Self::Fused } else { Self::Gathered }
    }
}

/// A chain of levels; the last is global.
#[derive(Debug, Clone)]
pub struct PointNet {
    levels: Vec<SetAbstraction>,
}

impl PointNet {
    /// Levels `sa1`, `sa2`, … under the builder's path.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, configs: &[SetAbstractionConfig]) -> Result<Self> {
        let levels = configs.iter().enumerate().map(|(k, c)| SetAbstraction::new(builder, &format!("sa{}", k + 1), c));
        Ok(Self { levels: levels.collect::<Result<_>>()? })
    }

    /// A batch of samples → `[samples, outputs of the last level]`.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward(&self, input: &crate::crops::Grouped, mode: &Mode, path: Path) -> Result<Tensor> {
        let Some(device) = self.levels.first().map(|level| level.linears[0].weight().device()) else {
            candle_core::bail!("a point network needs at least one level")
        };
        let mut points = coordinates(&input.points, device)?;
        let mut features = match self.levels.first() {
            Some(first) if first.config.features == 1 => Some(Tensor::from_slice(&input.is_query, (input.is_query.len(), 1), device)?),
            _ => None,
        };
        for (level, grouping) in self.levels.iter().zip(&input.levels) {
            let out = match path {
                Path::Fused => level.forward(&points, features.as_ref(), grouping, mode)?,
                Path::Gathered => level.forward_gathered(&points, features.as_ref(), grouping, mode)?,
                Path::Plain => level.forward_plain(&points, features.as_ref(), grouping, mode)?,
            };
            points = coordinates(&grouping.centroids, device)?;
            features = Some(out);
        }
        match features {
            Some(features) => Ok(features),
            None => candle_core::bail!("a point network needs at least one level"),
        }
    }
}

/// `[n, 3]`.
fn coordinates(points: &[[f32; 3]], device: &Device) -> Result<Tensor> {
    Tensor::from_slice(points.as_flattened(), (points.len(), 3), device)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::config::NetworksConfig;

    /// What candle's CUDA backend asks of a product's right operand (`gemm_config` in its `cuda_backend/mod.rs`); its CPU takes any.
    fn is_taken_by_cuda(right: &Tensor) -> bool {
        let (k, n) = right.dims2().unwrap();
        let [down, across] = right.stride() else { panic!("a matrix") };
        ((*across == 1 || n == 1) && (*down == n || k == 1)) || ((*across == k || n == 1) && (*down == 1 || k == 1))
    }

    #[test]
    fn every_level_multiplies_by_what_cuda_takes_with_features_and_without() {
        let config = NetworksConfig::default();
        let rng = &mut Pcg64::seed_from_u64(1);
        for configs in [&config.object_levels, &config.scene_levels, &config.discriminator_levels] {
            for level in PointNet::new(&mut Builder::seeded(rng, &Device::Cpu), configs).unwrap().levels {
                let of_coordinates = level.of_coordinates().unwrap();
                assert!(is_taken_by_cuda(&of_coordinates), "{:?} {:?}", of_coordinates.dims(), of_coordinates.stride());
                // The product's gradient multiplies by its transpose.
                assert!(is_taken_by_cuda(&of_coordinates.t().unwrap()));
                assert!(level.linears.iter().all(|linear| is_taken_by_cuda(&linear.weight().t().unwrap())));
            }
        }
    }
}
