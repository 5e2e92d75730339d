//! Weights on disk: one safetensors file with its origin, identified by its BLAKE3 hash.
//!
//! Tensors are stored as `f32` under their parameter paths. The metadata holds the recipe, the data's seed range and the metrics as JSON, and
//! the names of the measures that the relation predictor reads.

use std::collections::{BTreeMap, HashMap};

use candle_core::Device;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};

use crate::{
    config::NetworksConfig,
    networks::Networks,
    pair_measures::pair_measure_names,
    parameters::{MEASURES_WEIGHT, OUTCOME, WeightMap},
};

/// The metadata's only key (a hash map of several would be written in any order, and the file's hash would change with it).
const METADATA: &str = "repose-weights-1";

/// Where weights came from.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WeightsInfo {
    /// What was trained and how, as the training command puts it.
    pub recipe: serde_json::Value,
    /// What was measured on validation scenes.
    pub metrics: serde_json::Value,
    /// What was learned beside the networks, by name, in a form that only its readers know: it is served with the weights, and their hash
    /// covers it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub forecasts: BTreeMap<String, serde_json::Value>,
}

/// The metadata entry as it is stored.
#[derive(Debug, Serialize, Deserialize)]
struct Header {
    #[serde(flatten)]
    info: WeightsInfo,
    /// What each input of [`MEASURES_WEIGHT`] reads, where there is that tensor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    measures: Option<Vec<String>>,
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
        let Header { info, measures } = serde_json::from_str(info).map_err(|e| malformed(METADATA, e.to_string()))?;
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
        for (name, value) in values.iter_mut().filter(|(name, _)| reads_measures(name)) {
            *value = in_our_order(value, measures.as_deref()).map_err(|reason| malformed(name, reason))?;
        }
        Ok(Self { values, info, hash: blake3::hash(bytes).to_hex().to_string() })
    }

    /// The weights that come with the program.
    ///
    /// # Errors
    /// None unless the program was built with a broken file.
    pub fn embedded() -> Result<Self, WeightsError> {
        Self::from_bytes(crate::serving::EMBEDDED)
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
        // `values` are in this program's order, into which reading brings them.
        let measures = values.keys().any(|name| reads_measures(name)).then(|| pair_measure_names().to_vec());
        let text = serde_json::to_string(&Header { info: info.clone(), measures }).map_err(|e| malformed(METADATA, e.to_string()))?;
        let metadata = HashMap::from([(METADATA.to_string(), text)]);
        safetensors::serialize(tensors, Some(metadata)).map_err(|e| malformed("container", e.to_string()))
    }

    /// BLAKE3 of the outcome network's parameters, hexadecimal: what forecasts that read its word were fitted with.
    pub fn outcome_hash(&self) -> String {
        self.hash_of(|path| path.starts_with(OUTCOME))
    }

    /// BLAKE3 of all networks' parameters, hexadecimal. Unlike [`Weights::hash`] it is the same with other forecasts beside them.
    pub fn networks_hash(&self) -> String {
        self.hash_of(|_| true)
    }

    /// BLAKE3 of the parameters whose paths are wanted.
    fn hash_of(&self, is_wanted: impl Fn(&str) -> bool) -> String {
        let mut hasher = blake3::Hasher::new();
        for (path, (shape, numbers)) in self.values.iter().filter(|(path, _)| is_wanted(path)) {
            hasher.update(format!("{path} {shape:?}").as_bytes());
            hasher.update(bytemuck::cast_slice(numbers));
        }
        hasher.finalize().to_hex().to_string()
    }

    /// Untrained weights from a seed, with which a whole system runs (and answers nonsense).
    ///
    /// # Errors
    /// Never for valid shapes; building networks is fallible for stored weights.
    pub fn initial(config: &NetworksConfig, seed: u64) -> Result<Vec<u8>, WeightsError> {
        let (_, parameters) = Networks::seeded(config, &mut Pcg64::seed_from_u64(seed), &Device::Cpu)?;
        let info = WeightsInfo {
            recipe: serde_json::json!({ "untrained": true, "seed": seed }),
            metrics: serde_json::Value::Null,
            ..WeightsInfo::default()
        };
        Self::to_bytes(&parameters.to_map()?, &info)
    }
}

/// Whether a tensor's inputs are measures: the relation predictor's own, or a checkpoint's copy of it.
fn reads_measures(name: &str) -> bool {
    name.rsplit_once(':').map_or(name, |(_, path)| path) == MEASURES_WEIGHT
}

/// `[outputs, named]` with one column per name → `[outputs, measures]` with one per measure of this program; measures that are not read
/// weigh nothing. A checkpoint's moments are the same in one dimension.
fn in_our_order((shape, weight): &(Vec<usize>, Vec<f32>), names: Option<&[String]>) -> Result<(Vec<usize>, Vec<f32>), String> {
    let Some(names) = names else {
        return Err("the file does not name the measures that this tensor reads (metadata entry `measures`)".to_owned());
    };
    // Rows of nothing may be any number of them.
    if names.is_empty() {
        return Err("the file names no measures that this tensor reads".to_owned());
    }
    let inputs = names.len();
    let outputs = match shape[..] {
        [outputs, columns] if columns == inputs => outputs,
        [values] if values % inputs == 0 => values / inputs,
        [outputs, _] => return Err(format!("expected shape [{outputs}, {inputs}] for the measures that the file names, got {shape:?}")),
        _ => return Err(format!("expected two dimensions, got {shape:?}")),
    };
    let ours = pair_measure_names();
    let column = |name: &String| {
        let at = ours.iter().position(|n| n == name);
        at.ok_or_else(|| format!("reads the measure {name:?}, which this program does not have"))
    };
    let columns = names.iter().map(column).collect::<Result<Vec<usize>, String>>()?;
    if let Some(k) = (1..columns.len()).find(|k| columns[..*k].contains(&columns[*k])) {
        return Err(format!("names the measure {:?} twice", names[k]));
    }
    let mut ordered = vec![0.0; outputs * ours.len()];
    for (row, from) in ordered.chunks_exact_mut(ours.len()).zip(weight.chunks_exact(inputs)) {
        columns.iter().zip(from).for_each(|(column, value)| row[*column] = *value);
    }
    let shape = if shape.len() == 1 { vec![outputs * ours.len()] } else { vec![outputs, ours.len()] };
    Ok((shape, ordered))
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
    fn the_networks_hash_tells_every_value_and_no_forecast_and_the_outcome_networks_its_own_alone() {
        let weights = Weights::from_bytes(&Weights::initial(&NetworksConfig::default(), 1).unwrap()).unwrap();
        let hashes = |weights: &Weights| (weights.networks_hash(), weights.outcome_hash());
        let (networks, outcome) = hashes(&weights);
        let mut with_forecast = weights.clone();
        with_forecast.info.forecasts.insert("stands".to_owned(), serde_json::json!({"logit": 1}));
        assert_eq!(hashes(&with_forecast), (networks.clone(), outcome.clone()));
        for (path, is_outcome) in [("relations/out/bias", false), ("outcome/out/bias", true)] {
            let mut changed = weights.clone();
            changed.values.get_mut(path).unwrap().1[0] += 1.0;
            assert_ne!(changed.networks_hash(), networks, "{path}");
            assert_eq!(changed.outcome_hash() != outcome, is_outcome, "{path}");
        }
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

    /// A file whose metadata says what `change` makes of the names, with the columns in any order.
    fn with_names(weights: &Weights, (shape, values): (&[usize], &[f32]), names: Option<Vec<String>>) -> Vec<u8> {
        let view = TensorView::new(Dtype::F32, shape.to_vec(), bytemuck::cast_slice(values)).unwrap();
        let text = serde_json::to_string(&Header { info: weights.info.clone(), measures: names }).unwrap();
        safetensors::serialize([(MEASURES_WEIGHT, view)], Some(HashMap::from([(METADATA.to_owned(), text)]))).unwrap()
    }

    #[test]
    fn measures_are_read_by_name_in_any_order_and_others_are_refused_by_name() {
        let weights = Weights::from_bytes(&Weights::initial(&NetworksConfig::default(), 3).unwrap()).unwrap();
        let (shape, ours) = weights.values[MEASURES_WEIGHT].clone();
        let (outputs, inputs) = (shape[0], shape[1]);
        let names = pair_measure_names().to_vec();

        let backwards = (0..outputs).flat_map(|o| ours[o * inputs..(o + 1) * inputs].iter().rev().copied()).collect::<Vec<_>>();
        let turned = with_names(&weights, (&shape, &backwards), Some(names.iter().rev().cloned().collect()));
        assert_eq!(Weights::from_bytes(&turned).unwrap().values[MEASURES_WEIGHT].1, ours);

        let fewer: Vec<f32> = (0..outputs).flat_map(|o| ours[o * inputs..(o + 1) * inputs - 1].iter().copied()).collect();
        let fewer = with_names(&weights, (&[outputs, inputs - 1], &fewer), Some(names[..inputs - 1].to_vec()));
        let read = &Weights::from_bytes(&fewer).unwrap().values[MEASURES_WEIGHT];
        assert_eq!((&read.0, read.1[inputs - 1], read.1[inputs - 2]), (&shape, 0.0, ours[inputs - 2]));

        // A tensor without columns costs its file nothing, whatever number of rows it says.
        let rows_of_nothing = with_names(&weights, (&[1 << 60, 0], &[]), Some(Vec::new()));
        let error = Weights::from_bytes(&rows_of_nothing).unwrap_err().to_string();
        assert!(error.contains(MEASURES_WEIGHT) && error.contains("names no measures"), "{error}");

        let mut other = names.clone();
        other[7] = "height_above_sea_level".to_owned();
        for (names, expected) in
            [(Some(other), "height_above_sea_level"), (Some(names[1..].to_vec()), "[128, 145]"), (None, "does not name the measures")]
        {
            let error = Weights::from_bytes(&with_names(&weights, (&shape, &ours), names)).unwrap_err().to_string();
            assert!(error.contains(MEASURES_WEIGHT) && error.contains(expected), "{error}");
        }
    }
}
