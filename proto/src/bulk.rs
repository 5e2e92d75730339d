//! The bulk form: safetensors, readable from any language, written in one canonical order.
//!
//! Read with the `safetensors` crate. Written here, because that crate's metadata is a hash map whose order changes from run to run,
//! and a scene's id is the hash of its bytes: names sorted, data in the order of names, header padded to 8 bytes with spaces.

use std::collections::BTreeMap;

use safetensors::{Dtype, SafeTensors};

use crate::CallError;

/// One tensor: little-endian numbers and their shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Element type.
    pub dtype: Dtype,
    /// Sizes, slowest axis first.
    pub shape: Vec<usize>,
    /// Row-major little-endian elements.
    pub bytes: Vec<u8>,
}

impl Tensor {
    /// A tensor of numbers; `T` must be the `dtype`'s Rust type, as in [`Tensor::f32`].
    fn of<T: bytemuck::NoUninit>(dtype: Dtype, shape: &[usize], values: &[T]) -> Self {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len());
        Self { dtype, shape: shape.to_vec(), bytes: bytemuck::cast_slice(values).to_vec() }
    }

    /// A tensor of `f32`.
    pub fn f32(shape: &[usize], values: &[f32]) -> Self {
        Self::of(Dtype::F32, shape, values)
    }

    /// A tensor of `u16`.
    pub fn u16(shape: &[usize], values: &[u16]) -> Self {
        Self::of(Dtype::U16, shape, values)
    }

    /// A tensor of `u8`.
    pub fn u8(shape: &[usize], values: &[u8]) -> Self {
        Self::of(Dtype::U8, shape, values)
    }
}

/// Tensors by name, and metadata by name.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bulk {
    /// Text beside the tensors; larger things are JSON.
    pub metadata: BTreeMap<String, String>,
    /// The tensors.
    pub tensors: BTreeMap<String, Tensor>,
}

impl Bulk {
    /// The canonical bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut header = serde_json::Map::new();
        if !self.metadata.is_empty() {
            header.insert("__metadata__".to_owned(), serde_json::json!(self.metadata));
        }
        let mut offset = 0usize;
        for (name, tensor) in &self.tensors {
            let end = offset + tensor.bytes.len();
            header.insert(name.clone(), serde_json::json!({"dtype": tensor.dtype, "shape": tensor.shape, "data_offsets": [offset, end]}));
            offset = end;
        }
        let mut text = serde_json::Value::Object(header).to_string().into_bytes();
        text.resize(text.len().next_multiple_of(8), b' ');
        let mut bytes = Vec::with_capacity(8 + text.len() + offset);
        bytes.extend_from_slice(&(text.len() as u64).to_le_bytes());
        bytes.extend_from_slice(&text);
        for tensor in self.tensors.values() {
            bytes.extend_from_slice(&tensor.bytes);
        }
        bytes
    }

    /// Reads bytes in bulk form, ours or any other writer's.
    ///
    /// # Errors
    /// `invalid_argument` on `payload`.
    pub fn decode(bytes: &[u8]) -> Result<Self, CallError> {
        let bad = |e: safetensors::SafeTensorError| CallError::invalid("payload", format!("not in bulk form (safetensors): {e}"));
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(bad)?;
        let parsed = SafeTensors::deserialize(bytes).map_err(bad)?;
        let metadata = header.metadata().iter().flatten().map(|(k, v)| (k.clone(), v.clone())).collect();
        let tensors = parsed
            .iter()
            .map(|(name, view)| {
                let tensor = Tensor { dtype: view.dtype(), shape: view.shape().to_vec(), bytes: view.data().to_vec() };
                (name.to_owned(), tensor)
            })
            .collect();
        Ok(Self { metadata, tensors })
    }

    /// A metadata entry that must be there.
    ///
    /// # Errors
    /// `invalid_argument` that names it.
    pub fn text(&self, name: &str) -> Result<&str, CallError> {
        self.metadata.get(name).map(String::as_str).ok_or_else(|| CallError::invalid(name, "this metadata entry is missing"))
    }

    /// The elements of a tensor of `dtype` whose shape `fits`; `expected` says which shape that is.
    ///
    /// # Errors
    /// `invalid_argument` that names the tensor.
    pub fn values<T: bytemuck::Pod>(
        &self,
        name: &str,
        dtype: Dtype,
        expected: &str,
        fits: impl Fn(&[usize]) -> bool,
    ) -> Result<(Vec<usize>, Vec<T>), CallError> {
        let tensor = self.tensors.get(name).ok_or_else(|| CallError::invalid(name, "this tensor is missing"))?;
        if tensor.dtype != dtype || !fits(&tensor.shape) {
            let message = format!("expected {dtype:?} {expected}, got {:?} {:?}", tensor.dtype, tensor.shape);
            return Err(CallError::invalid(name, message));
        }
        Ok((tensor.shape.clone(), bytemuck::pod_collect_to_vec::<u8, T>(&tensor.bytes)))
    }

    /// An `f32` tensor of shape `[n, columns]` as rows, all finite.
    ///
    /// # Errors
    /// `invalid_argument` that names the tensor, or the row at fault.
    pub fn finite_rows<const COLUMNS: usize>(&self, name: &str) -> Result<Vec<[f32; COLUMNS]>, CallError> {
        self.finite(name, &format!("[n, {COLUMNS}]"), |shape| matches!(shape, [_, c] if *c == COLUMNS))
    }

    /// As [`Bulk::finite_rows`] for any shape that `fits`, whose last axes together are a row's `COLUMNS`.
    ///
    /// # Errors
    /// As [`Bulk::finite_rows`].
    pub fn finite<const COLUMNS: usize>(
        &self,
        name: &str,
        expected: &str,
        fits: impl Fn(&[usize]) -> bool,
    ) -> Result<Vec<[f32; COLUMNS]>, CallError> {
        let (_, flat) = self.values::<f32>(name, Dtype::F32, expected, fits)?;
        if let Some(i) = flat.iter().position(|v| !v.is_finite()) {
            return Err(CallError::invalid(format!("{name}[{}]", i / COLUMNS), "not a finite number"));
        }
        Ok(flat.as_chunks::<COLUMNS>().0.to_vec())
    }
}
