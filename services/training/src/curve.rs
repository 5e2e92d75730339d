//! Learning curves: what a run measured at its checkpoints, kept beside the weights as JSON and drawn as SVG.

use std::path::PathBuf;

use plotters::prelude::*;
use repose_proto::Relation;
use serde::{Deserialize, Serialize};

use crate::{checkpoint, error::TrainError, settings::TrainSettings};

/// What was measured after some steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Steps done.
    pub step: u64,
    /// Training loss, a running mean over about fifty steps.
    pub loss: f64,
    /// Figures on validation scenes, as the task gives them; `loss` among them.
    pub validation: serde_json::Value,
}

/// A run's curve, from its first step on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// In the order of their steps.
    pub points: Vec<CurvePoint>,
}

/// One line of a picture: a name and (step, value).
type Line = (String, Vec<(f64, f64)>);

impl Curve {
    /// The curve of a run that is resumed at `step`, without what came after it; empty for a new run.
    ///
    /// # Errors
    /// When the file is there and cannot be read.
    pub fn resumed(settings: &TrainSettings, step: u64) -> Result<Self, TrainError> {
        let path = path_of(settings, "json");
        let text = match std::fs::read(&path) {
            Ok(_) if step == 0 => return Ok(Self::default()),
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Self::default()),
            Err(source) => return Err(TrainError::Io { path, source }),
        };
        let mut curve: Self = serde_json::from_slice(&text).map_err(|e| TrainError::Io { path, source: std::io::Error::other(e) })?;
        curve.points.retain(|point| point.step <= step);
        Ok(curve)
    }

    /// Adds a point and writes both files.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn add(&mut self, settings: &TrainSettings, point: CurvePoint) -> Result<(), TrainError> {
        self.points.push(point);
        let json = serde_json::to_vec_pretty(self).map_err(|e| candle_core::Error::Msg(e.to_string()))?;
        checkpoint::write(&path_of(settings, "json"), &json)?;
        checkpoint::write(&path_of(settings, "svg"), self.svg(settings.part.name())?.as_bytes())
    }

    /// The picture: losses above, the other figures (those from 0 to 1) below.
    ///
    /// # Errors
    /// When the plotting library fails.
    pub fn svg(&self, title: &str) -> Result<String, TrainError> {
        let of = |value: &dyn Fn(&CurvePoint) -> Option<f64>| -> Vec<(f64, f64)> {
            self.points.iter().filter_map(|p| Some((p.step as f64, value(p)?))).collect()
        };
        let losses = vec![
            ("training loss".to_owned(), of(&|p| Some(p.loss))),
            ("validation loss".to_owned(), of(&|p| p.validation["loss"].as_f64())),
        ];
        let mut shares: Vec<Line> = ["auc", "accepted_good", "accepted_bad"]
            .iter()
            .map(|name| (name.replace('_', " "), of(&|p| p.validation[*name].as_f64())))
            .filter(|(_, line)| !line.is_empty())
            .collect();
        for relation in Relation::ALL {
            let line = of(&|p| p.validation["f1"].get(relation.index())?.as_f64());
            if !line.is_empty() {
                shares.push((format!("F1 {}", relation.as_str()), line));
            }
        }
        let mut svg = String::new();
        draw(&mut svg, title, &losses, &shares).map_err(|e| candle_core::Error::Msg(format!("drawing the learning curve: {e}")))?;
        Ok(svg)
    }
}

fn draw(svg: &mut String, title: &str, losses: &[Line], shares: &[Line]) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, (760, 620)).into_drawing_area();
    root.fill(&WHITE)?;
    let (above, below) = root.split_vertically(300);
    let values = || losses.iter().flat_map(|(_, line)| line).map(|(_, y)| *y).filter(|y| y.is_finite());
    let (low, high) = (values().fold(0.0, f64::min), values().fold(0.1, f64::max));
    panel(&above, &format!("{title}: loss"), losses, low..1.05 * high)?;
    panel(&below, &format!("{title}: validation"), shares, 0.0..1.0)?;
    root.present()?;
    Ok(())
}

fn panel(
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    caption: &str,
    lines: &[Line],
    heights: std::ops::Range<f64>,
) -> Result<(), Box<dyn std::error::Error>> {
    let last = lines.iter().flat_map(|(_, line)| line).map(|(x, _)| *x).fold(1.0, f64::max);
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 16))
        .margin(8)
        .margin_right(150)
        .x_label_area_size(28)
        .y_label_area_size(48)
        .build_cartesian_2d(0.0..last, heights)?;
    chart.configure_mesh().x_desc("steps").label_style(("sans-serif", 12)).draw()?;
    for (k, (name, line)) in lines.iter().enumerate() {
        let color = Palette99::pick(k).to_rgba();
        chart
            .draw_series(std::iter::once(PathElement::new(line.clone(), color.stroke_width(2))))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], color.stroke_width(2)));
    }
    chart.configure_series_labels().position(SeriesLabelPosition::Coordinate(560, 10)).label_font(("sans-serif", 12)).draw()?;
    Ok(())
}

/// `weights.safetensors` → `weights.joint.curve.json`.
fn path_of(settings: &TrainSettings, extension: &str) -> PathBuf {
    checkpoint::beside(settings, &format!("curve.{extension}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(step: u64) -> CurvePoint {
        let validation = serde_json::json!({"loss": 0.5, "auc": 0.8, "f1": [0.9, null, 0.7]});
        CurvePoint { step, loss: 0.6, validation }
    }

    #[test]
    fn a_resumed_run_goes_on_from_its_own_points() {
        let folder = tempfile::tempdir().unwrap();
        let settings = TrainSettings { out: folder.path().join("w.safetensors"), ..TrainSettings::default() };
        let mut curve = Curve::resumed(&settings, 0).unwrap();
        for step in [100, 200, 300] {
            curve.add(&settings, point(step)).unwrap();
        }
        assert_eq!(Curve::resumed(&settings, 200).unwrap().points, [point(100), point(200)]);
        assert_eq!(Curve::resumed(&settings, 0).unwrap(), Curve::default());
        let svg = std::fs::read_to_string(folder.path().join("w.joint.curve.svg")).unwrap();
        assert!(svg.contains("training loss") && svg.contains("F1 left_of") && svg.contains("auc"), "{svg}");
        assert!(!svg.contains("F1 behind"));
    }
}
