//! Planning and judging on a scene, in this process.

use std::sync::Arc;

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use repose_local::picture::{Coloring, draw_ids, scene_picture};
use repose_proto::message::from_json;
use repose_proto::motion::MotionPlanRequest;
use repose_proto::scoring::RealismBy;
use repose_proto::{CallError, PlaceRequest, PlaceResult};

use crate::error::{pretty, raised};
use crate::models::{Models, chosen};
use crate::scene::Scene;
use crate::waiting::compute;

/// Width, height and the bytes of an 8-bit RGB picture.
type Picture<'py> = (u32, u32, Bound<'py, PyBytes>);

/// A `PlaceRequest` to a `PlaceResult`, both JSON.
#[pyfunction]
#[pyo3(signature = (scene, request, models = None))]
pub fn plan(py: Python<'_>, scene: &Scene, request: &str, models: Option<&Models>) -> PyResult<String> {
    let result = compute(py, |stop| {
        let request: PlaceRequest = from_json(request.as_bytes())?;
        repose_local::plan(&scene.scene, &request, || chosen(models), stop)
    });
    pretty(&result?)
}

/// Every pair's relations, as `repose relations --json` prints them.
#[pyfunction]
#[pyo3(signature = (scene, models = None))]
pub fn relations(py: Python<'_>, scene: &Scene, models: Option<&Models>) -> PyResult<String> {
    let pairs = py.detach(|| repose_local::relations(&scene.scene, chosen(models)?.as_ref()));
    pretty(&serde_json::json!({"pairs": pairs.map_err(raised)?}))
}

/// Realism f32 [n] and relations f32 [n, anchors, 10] of transforms f64 [n, 16], all in native order.
#[pyfunction]
#[pyo3(signature = (scene, query, anchors, transforms, realism_by, models = None))]
pub fn score<'py>(
    py: Python<'py>,
    scene: &Scene,
    query: u16,
    anchors: Vec<u16>,
    transforms: &[u8],
    realism_by: &str,
    models: Option<&Models>,
) -> PyResult<(Bound<'py, PyBytes>, Bound<'py, PyBytes>)> {
    let scores = py.detach(|| {
        let numbers: Vec<f64> = transforms.as_chunks::<8>().0.iter().map(|b| f64::from_ne_bytes(*b)).collect();
        let by = match realism_by {
            "discriminator" => RealismBy::Discriminator,
            "outcome" => RealismBy::Outcome,
            other => return Err(CallError::invalid("realism_by", format!("expected discriminator or outcome, got {other:?}"))),
        };
        repose_local::score(&scene.scene, (query, &anchors), numbers.as_chunks::<16>().0, by, chosen(models)?.as_ref())
    });
    let scores = scores.map_err(raised)?;
    let bytes = |values: &[f32]| PyBytes::new(py, &values.iter().flat_map(|v| v.to_ne_bytes()).collect::<Vec<u8>>());
    Ok((bytes(&scores.realism), bytes(scores.relations.as_flattened())))
}

/// A `MotionPlanRequest` to a `MotionPlan`, both JSON.
#[pyfunction]
pub fn plan_motion(py: Python<'_>, scene: &Scene, request: &str) -> PyResult<String> {
    let plan = compute(py, |stop| {
        let request: MotionPlanRequest = from_json(request.as_bytes())?;
        repose_local::plan_motion(&scene.scene, &request, None, stop)
    });
    pretty(&plan?)
}

/// The scene as its camera saw it, with an object drawn where it is moved to.
#[pyfunction]
#[pyo3(signature = (scene, by_object, with_ids, moved = None))]
pub fn picture<'py>(
    py: Python<'py>,
    scene: &Scene,
    by_object: bool,
    with_ids: bool,
    moved: Option<(u16, [f64; 16])>,
) -> PyResult<Picture<'py>> {
    let drawn = py.detach(|| {
        let moved = moved.map(|(id, m)| repose_local::picture::placed(&m).map(|placed| (id, placed))).transpose()?;
        let coloring = if by_object { Coloring::Objects } else { Coloring::Seen };
        let mut drawn = scene_picture(&scene.scene, coloring, moved.as_ref().map(|(id, m)| (*id, m)));
        if with_ids {
            draw_ids(&mut drawn, &scene.scene);
        }
        Ok(drawn)
    });
    let drawn = drawn.map_err(raised)?;
    Ok((drawn.width(), drawn.height(), PyBytes::new(py, &drawn)))
}

/// The picture that `repose plan --out` writes.
#[pyfunction]
pub fn before_and_after<'py>(py: Python<'py>, scene: &Scene, result: &str) -> PyResult<Picture<'py>> {
    let drawn = py.detach(|| {
        let result: PlaceResult = from_json(result.as_bytes())?;
        repose_local::picture::before_and_after(&scene.scene, &result)
    });
    let drawn = drawn.map_err(raised)?;
    Ok((drawn.width(), drawn.height(), PyBytes::new(py, &drawn)))
}

/// A goal in words: `{"query", "goal", "taken"}`, or `{"refused", "candidates"}`.
#[pyfunction]
#[pyo3(signature = (scene, sentence, view_yaw_rad = None))]
pub fn understand(py: Python<'_>, scene: &Scene, sentence: &str, view_yaw_rad: Option<f64>) -> PyResult<String> {
    let scene: &Arc<repose_proto::Scene> = &scene.scene;
    let understood = py.detach(|| {
        let looks = repose_words::looks_of(scene, view_yaw_rad.unwrap_or(scene.meta.view_yaw_rad));
        repose_words::understand(sentence, &looks)
    });
    pretty(&match understood {
        Ok(said) => {
            let taken: Vec<_> = said.taken.iter().map(|t| serde_json::json!({"phrase": t.phrase, "object": t.object})).collect();
            serde_json::json!({"query": said.query, "goal": said.goal, "taken": taken})
        }
        Err(refused) => serde_json::json!({"refused": refused.to_string(), "candidates": refused.candidates}),
    })
}
