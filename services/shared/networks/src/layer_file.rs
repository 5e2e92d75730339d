//! Files of the networks that read pictures: layers in half precision, norms folded in, as the scripts that train them export.

use std::collections::HashMap;

use candle_core::{DType, Device, Tensor};
use safetensors::SafeTensors;

use crate::kernel::PackedLinear;
use crate::weights::WeightsError;

/// The metadata's entry that names the format.
const FORMAT: &str = "format";

/// The layers of a file.
pub(crate) struct LayerFile {
    tensors: HashMap<String, Tensor>,
}

impl LayerFile {
    /// From a file's bytes.
    ///
    /// # Errors
    /// [`WeightsError::Malformed`] when the file is of another format.
    pub fn read(bytes: &[u8], expected: &str) -> Result<Self, WeightsError> {
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| malformed("header", e.to_string()))?;
        let format = header.metadata().as_ref().and_then(|entries| entries.get(FORMAT));
        if format.is_none_or(|format| format != expected) {
            return Err(malformed(FORMAT, format!("expected {expected:?}, got {format:?}")));
        }
        Ok(Self { tensors: candle_core::safetensors::load_buffer(bytes, &Device::Cpu)? })
    }

    /// A layer with a weight of this shape, outputs first, and its bias.
    ///
    /// # Errors
    /// [`WeightsError::Malformed`] when a tensor is missing or of another shape, or a value is not finite.
    pub fn layer(&self, path: &str, shape: &[usize]) -> Result<PackedLinear, WeightsError> {
        let (outputs, inputs) = (shape[0], shape[1..].iter().product());
        let (weight, bias) = (self.values(path, "weight", shape)?, self.values(path, "bias", &[outputs])?);
        Ok(PackedLinear::new(inputs, outputs, &weight, &bias))
    }

    /// A part of a layer, flat.
    ///
    /// # Errors
    /// As [`Self::layer`].
    pub fn values(&self, path: &str, part: &str, shape: &[usize]) -> Result<Vec<f32>, WeightsError> {
        let name = format!("{path}/{part}");
        let tensor = self.tensors.get(&name).ok_or_else(|| malformed(&name, "this tensor is missing".to_owned()))?;
        if tensor.dims() != shape {
            return Err(malformed(&name, format!("expected shape {shape:?}, got {:?}", tensor.dims())));
        }
        let values = tensor.to_dtype(DType::F32)?.flatten_all()?.to_vec1::<f32>()?;
        match values.iter().position(|v| !v.is_finite()) {
            Some(i) => Err(malformed(&name, format!("entry {i} is not finite"))),
            None => Ok(values),
        }
    }
}

fn malformed(field: &str, reason: String) -> WeightsError {
    WeightsError::Malformed { field: field.to_owned(), reason }
}
