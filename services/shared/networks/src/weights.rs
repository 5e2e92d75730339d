//! Weights on disk: one safetensors file with where it came from, known by its BLAKE3 hash.
//!
//! Tensors are stored as `f32` under their parameter paths. The metadata holds the recipe, the data's seed range and the metrics as JSON.

use std::collections::HashMap;

use rand::SeedableRng;
use rand_pcg::Pcg64;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};

use crate::{config::NetworksConfig, networks::Networks, parameters::WeightMap};

/// The format's name in the metadata.
const FORMAT: &str = "repose-weights-1";

/// Where weights came from.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WeightsInfo {
    /// What was trained and how, as the training command puts it.
    pub recipe: serde_json::Value,
    /// What was measured on validation scenes.
    pub metrics: serde_json::Value,
}

/// Why weights could not be used.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The container is not safetensors, or not of this format.
    #[error("weights: {field}: {reason}")]
    Malformed {
        /// The tensor or metadata entry.
        field: String,
        /// What was expected and what came.
        reason: String,
    },
    /// A tensor is missing or has another shape than the networks need.
    #[error("{0}")]
    Mismatch(#[from] candle_core::Error),
}

/// Weights as read: values by name and their origin.
#[derive(Debug, Clone)]
pub struct Weights {
    /// Values by parameter path.
    pub values: WeightMap,
    /// Origin.
    pub info: WeightsInfo,
    /// BLAKE3 of the file's bytes, hexadecimal.
    pub hash: String,
}

impl Weights {
    /// Reads a file's bytes.
    ///
    /// # Errors
    /// [`WeightsError::Malformed`] when the bytes are not weights, or a value is not finite.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, WeightsError> {
        let malformed = |field: &str, reason: String| WeightsError::Malformed { field: field.to_string(), reason };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| malformed("header", e.to_string()))?;
        let entries = header.metadata().clone().unwrap_or_default();
        let format = entries.get("format").map_or("nothing", String::as_str);
        if format != FORMAT {
            return Err(malformed("format", format!("expected {FORMAT}, got {format}")));
        }
        let json = |key: &str| match entries.get(key) {
            Some(text) => serde_json::from_str(text).map_err(|e| malformed(key, e.to_string())),
            None => Ok(serde_json::Value::Null),
        };
        let info = WeightsInfo { recipe: json("recipe")?, metrics: json("metrics")? };
        let tensors = SafeTensors::deserialize(bytes).map_err(|e| malformed("tensors", e.to_string()))?;
        let mut values = WeightMap::new();
        for (name, view) in tensors.tensors() {
            if view.dtype() != Dtype::F32 {
                return Err(malformed(&name, format!("expected F32, got {:?}", view.dtype())));
            }
            let mut numbers = vec![0f32; view.data().len() / 4];
            bytemuck::cast_slice_mut(&mut numbers).copy_from_slice(view.data());
            if let Some(i) = numbers.iter().position(|v| !v.is_finite()) {
                return Err(malformed(&name, format!("entry {i} is not finite")));
            }
            values.insert(name, (view.shape().to_vec(), numbers));
        }
        Ok(Self { values, info, hash: blake3::hash(bytes).to_hex().to_string() })
    }

    /// The file's bytes for these values and this origin.
    ///
    /// # Errors
    /// [`WeightsError::Malformed`] when a shape does not fit its values.
    pub fn to_bytes(values: &WeightMap, info: &WeightsInfo) -> Result<Vec<u8>, WeightsError> {
        let malformed = |field: &str, reason: String| WeightsError::Malformed { field: field.to_string(), reason };
        let mut tensors = Vec::with_capacity(values.len());
        for (name, (shape, numbers)) in values {
            let view = TensorView::new(Dtype::F32, shape.clone(), bytemuck::cast_slice(numbers));
            tensors.push((name.clone(), view.map_err(|e| malformed(name, e.to_string()))?));
        }
        // One string, so that the bytes do not depend on a hash map's order; `read_metadata` finds the parts.
        let metadata = HashMap::from([
            ("format".to_string(), FORMAT.to_string()),
            ("recipe".to_string(), info.recipe.to_string()),
            ("metrics".to_string(), info.metrics.to_string()),
        ]);
        safetensors::serialize(tensors, Some(metadata)).map_err(|e| malformed("container", e.to_string()))
    }

    /// Untrained weights from a seed, with which a whole system runs (and answers nonsense).
    ///
    /// # Errors
    /// None in practice; the networks' construction is fallible.
    pub fn initial(config: &NetworksConfig, seed: u64) -> Result<Vec<u8>, WeightsError> {
        let (_, parameters) = Networks::seeded(config, &mut Pcg64::seed_from_u64(seed))?;
        let info = WeightsInfo { recipe: serde_json::json!({ "untrained": true, "seed": seed }), metrics: serde_json::Value::Null };
        Self::to_bytes(&parameters.to_map()?, &info)
    }
}
