//! Weights on disk: one safetensors file with where it came from, known by its BLAKE3 hash.
//!
//! Tensors are stored as `f32` under their parameter paths. The metadata holds the recipe, the data's seed range and the metrics as JSON.

use std::collections::HashMap;

use candle_core::Device;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};

use crate::{config::NetworksConfig, networks::Networks, parameters::WeightMap};

/// The metadata's only key (a hash map of several would be written in any order, and the file's hash would change with it).
const METADATA: &str = "repose-weights-1";

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
    /// The container is not safetensors, or not of this format, or a tensor is not what the networks serve with.
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
        let info = header.metadata().as_ref().and_then(|entries| entries.get(METADATA));
        let info = info.ok_or_else(|| malformed("metadata", format!("expected the key {METADATA}, which is missing")))?;
        let info = serde_json::from_str(info).map_err(|e| malformed(METADATA, e.to_string()))?;
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
        let text = serde_json::to_string(info).map_err(|e| malformed(METADATA, e.to_string()))?;
        let metadata = HashMap::from([(METADATA.to_string(), text)]);
        safetensors::serialize(tensors, Some(metadata)).map_err(|e| malformed("container", e.to_string()))
    }

    /// Untrained weights from a seed, with which a whole system runs (and answers nonsense).
    ///
    /// # Errors
    /// None in practice; the networks' construction is fallible.
    pub fn initial(config: &NetworksConfig, seed: u64) -> Result<Vec<u8>, WeightsError> {
        let (_, parameters) = Networks::seeded(config, &mut Pcg64::seed_from_u64(seed), &Device::Cpu)?;
        let info = WeightsInfo { recipe: serde_json::json!({ "untrained": true, "seed": seed }), metrics: serde_json::Value::Null };
        Self::to_bytes(&parameters.to_map()?, &info)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_bytes_and_they_read_back() {
        let config = NetworksConfig::default();
        let bytes = Weights::initial(&config, 1).unwrap();
        assert_eq!(bytes, Weights::initial(&config, 1).unwrap());
        let weights = Weights::from_bytes(&bytes).unwrap();
        assert_eq!(Weights::to_bytes(&weights.values, &weights.info).unwrap(), bytes);
        assert_ne!(weights.hash, Weights::from_bytes(&Weights::initial(&config, 2).unwrap()).unwrap().hash);
    }

    #[test]
    fn what_is_not_weights_is_refused_with_the_field_named() {
        let config = NetworksConfig::default();
        let bytes = Weights::initial(&config, 1).unwrap();
        assert!(Weights::from_bytes(&bytes[..bytes.len() - 1]).is_err());
        assert!(Weights::from_bytes(b"not a container").is_err());
        let mut weights = Weights::from_bytes(&bytes).unwrap();
        weights.values.get_mut("relations/out/bias").unwrap().1[3] = f32::NAN;
        let error = Weights::from_bytes(&Weights::to_bytes(&weights.values, &weights.info).unwrap()).unwrap_err();
        assert!(error.to_string().contains("relations/out/bias"), "{error}");
        weights.values.remove("relations/out/bias");
        let error = Networks::stored(&config, &weights.values, &Device::Cpu).unwrap_err();
        assert!(error.to_string().contains("relations/out/bias is missing"), "{error}");
    }
}
