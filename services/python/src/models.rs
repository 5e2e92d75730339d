//! The learned models, loaded once.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::prelude::*;
use repose_local::ModelFiles;
use repose_proto::CallError;

use crate::error::raised;

/// Models that nobody named: those of the environment, or of the program.
static DEFAULT: Mutex<Option<Arc<repose_local::LocalModels>>> = Mutex::new(None);

/// Networks and forecasts.
#[pyclass(frozen, module = "repose._native")]
pub struct Models {
    models: Arc<repose_local::LocalModels>,
}

#[pymethods]
impl Models {
    #[new]
    #[pyo3(signature = (weights = None))]
    fn new(py: Python<'_>, weights: Option<PathBuf>) -> PyResult<Self> {
        let files = ModelFiles { weights };
        let models = py.detach(|| repose_local::LocalModels::load(&files)).map_err(raised)?;
        Ok(Self { models: Arc::new(models) })
    }
}

/// The given models, or the default ones.
pub fn chosen(given: Option<&Models>) -> Result<Arc<repose_local::LocalModels>, CallError> {
    if let Some(given) = given {
        return Ok(given.models.clone());
    }
    let mut default = DEFAULT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(loaded) = default.as_ref() {
        return Ok(loaded.clone());
    }
    let loaded = Arc::new(repose_local::LocalModels::load(&ModelFiles::default())?);
    *default = Some(loaded.clone());
    Ok(loaded)
}
