//! Named trainable tensors and running statistics, made from a seed or from stored weights.
//!
//! candle's CPU generator cannot be seeded, so initial weights come from a `Pcg64` that is passed in. Names are paths
//! (`discriminator/sa1/linear1/weight`); order is alphabetical wherever all parameters are walked.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Result, Tensor, Var};
use rand::RngExt;
use rand_pcg::Pcg64;

/// The first part of the paths of the encoder of objects, whose codes the relation predictor reads.
pub const OBJECT: &str = "object/";
/// The first part of the relation predictor's paths.
pub const RELATIONS: &str = "relations/";
/// The path of the weight that reads [`crate::pair_measures`]; only the `measured` variant of the relation predictor has it.
pub const MEASURES_WEIGHT: &str = "relations/measures/weight";
/// The first part of the discriminator's paths.
pub const DISCRIMINATOR: &str = "discriminator/";
/// The first part of the outcome network's paths.
pub const OUTCOME: &str = "outcome/";

/// Values by name, as stored: shape and row-major numbers.
pub type WeightMap = BTreeMap<String, (Vec<usize>, Vec<f32>)>;

/// What a new tensor is filled with.
#[derive(Debug, Clone, Copy)]
pub enum Init {
    /// Uniform in ± bound.
    Uniform(f32),
    /// All the same.
    Constant(f32),
}

impl Init {
    fn values(self, count: usize, rng: &mut Pcg64) -> Vec<f32> {
        match self {
            Self::Uniform(bound) => (0..count).map(|_| rng.random_range(-bound..=bound)).collect(),
            Self::Constant(value) => vec![value; count],
        }
    }
}

/// Where the values come from.
#[derive(Debug)]
enum Source<'a> {
    Seed(&'a mut Pcg64),
    Stored(&'a WeightMap),
    Started(&'a WeightMap, &'a mut Pcg64),
}

/// All tensors of the networks that are trained together.
#[derive(Debug, Clone, Default)]
pub struct Parameters {
    /// Fitted by gradient.
    pub trainable: BTreeMap<String, Var>,
    /// Running statistics of batch norms: followed, not fitted.
    pub statistics: BTreeMap<String, Var>,
}

impl Parameters {
    /// All values, trainable and statistics, copied out.
    ///
    /// # Errors
    /// None on a CPU; elsewhere when the device fails.
    pub fn to_map(&self) -> Result<WeightMap> {
        let all = self.trainable.iter().chain(&self.statistics);
        all.map(|(name, var)| Ok((name.clone(), (var.dims().to_vec(), var.flatten_all()?.to_vec1::<f32>()?)))).collect()
    }

    /// How many numbers are trained.
    pub fn count(&self) -> usize {
        self.trainable.values().map(|v| v.elem_count()).sum()
    }
}

/// Hands out tensors under a path while a network is put together.
#[derive(Debug)]
pub struct Builder<'a> {
    source: Source<'a>,
    device: Device,
    path: Vec<String>,
    parameters: Parameters,
}

impl<'a> Builder<'a> {
    fn new(source: Source<'a>, device: &Device) -> Self {
        Self { source, device: device.clone(), path: Vec::new(), parameters: Parameters::default() }
    }

    /// New values from a generator.
    pub fn seeded(rng: &'a mut Pcg64, device: &Device) -> Self {
        Self::new(Source::Seed(rng), device)
    }

    /// Stored values; a missing or misshapen one is an error that names it.
    pub fn stored(weights: &'a WeightMap, device: &Device) -> Self {
        Self::new(Source::Stored(weights), device)
    }

    /// Stored values where there are some of the right shape, new ones from the generator elsewhere.
    pub fn started(weights: &'a WeightMap, rng: &'a mut Pcg64, device: &Device) -> Self {
        Self::new(Source::Started(weights, rng), device)
    }

    /// Where the tensors are.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The tensors made so far.
    pub fn finish(self) -> Parameters {
        self.parameters
    }

    /// Runs `make` with `name` added to the path.
    ///
    /// # Errors
    /// What `make` returns.
    pub fn within<T>(&mut self, name: &str, make: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        self.path.push(name.to_string());
        let made = make(self);
        self.path.pop();
        made
    }

    /// A trainable tensor.
    ///
    /// # Errors
    /// When stored weights lack it or have it in another shape.
    pub fn trainable(&mut self, name: &str, shape: &[usize], init: Init) -> Result<Tensor> {
        let (path, var) = self.var(name, shape, init)?;
        let tensor = var.as_tensor().clone();
        self.parameters.trainable.insert(path, var);
        Ok(tensor)
    }

    /// A running statistic.
    ///
    /// # Errors
    /// When stored weights lack it or have it in another shape.
    pub fn statistic(&mut self, name: &str, shape: &[usize], value: f32) -> Result<(String, Tensor)> {
        let (path, var) = self.var(name, shape, Init::Constant(value))?;
        let tensor = var.as_detached_tensor();
        self.parameters.statistics.insert(path.clone(), var);
        Ok((path, tensor))
    }

    fn var(&mut self, name: &str, shape: &[usize], init: Init) -> Result<(String, Var)> {
        let path = self.path.iter().map(String::as_str).chain([name]).collect::<Vec<_>>().join("/");
        let count: usize = shape.iter().product();
        let values = match &mut self.source {
            Source::Seed(rng) => init.values(count, rng),
            Source::Started(weights, rng) => match weights.get(&path) {
                Some((stored, values)) if stored == shape => values.clone(),
                _ => init.values(count, rng),
            },
            Source::Stored(weights) => match weights.get(&path) {
                Some((stored, values)) if stored == shape => values.clone(),
                Some((stored, _)) => candle_core::bail!("weights: {path}: expected shape {shape:?}, got {stored:?}"),
                None => candle_core::bail!("weights: {path} is missing"),
            },
        };
        let tensor = Tensor::from_vec(values, shape, &self.device)?.to_dtype(DType::F32)?;
        Ok((path, Var::from_tensor(&tensor)?))
    }
}
