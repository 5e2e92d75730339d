//! Histograms of lengths as one SVG, for reports.

use plotters::coord::Shift;
use plotters::prelude::*;
use repose_simulator::statistics::Histogram;

use crate::report::plots::{DrawError, DrawResult, drawn};

/// One of several histograms above each other.
pub struct Panel<'a> {
    /// What was counted.
    pub title: &'a str,
    /// The counts.
    pub histogram: &'a Histogram,
    /// Lengths at which relations change, millimetres: drawn as lines.
    pub limits_mm: &'a [f64],
}

/// Draws the panels. Bins are drawn equally wide, since they are finest where the limits are, and labelled with their lower border. The
/// title says how many lengths lie beyond all bins: a bar of them would flatten the others.
///
/// # Errors
/// When the plotting library fails.
pub fn histograms(panels: &[Panel]) -> Result<String, DrawError> {
    const WIDTH: u32 = 1100;
    const PANEL_HEIGHT: u32 = 300;
    drawn("histograms", (WIDTH, PANEL_HEIGHT * panels.len() as u32), |root| {
        let areas = root.split_evenly((panels.len(), 1));
        panels.iter().zip(&areas).try_for_each(|(panel, area)| draw(panel, area))
    })
}

fn draw(panel: &Panel, area: &DrawingArea<SVGBackend<'_>, Shift>) -> DrawResult {
    let Histogram { edges_mm, counts, beyond } = panel.histogram;
    let bins = counts.len();
    let highest = counts.iter().max().copied().unwrap_or(0).max(1);
    let title = format!("{} ({} pairs, {beyond} of them at 100 mm or more)", panel.title, panel.histogram.total());
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(8)
        .x_label_area_size(38)
        .y_label_area_size(58)
        .build_cartesian_2d(0.0..bins as f64, 0..highest + highest / 20 + 1)?;
    let border = |at: &f64| edges_mm.get(at.round() as usize).map_or_else(String::new, |mm| format!("{mm}"));
    chart.configure_mesh().disable_x_mesh().x_labels(bins + 1).x_label_formatter(&border).x_desc("millimetres").y_desc("pairs").draw()?;
    let bars = counts.iter().enumerate();
    chart.draw_series(
        bars.map(|(k, count)| Rectangle::new([(k as f64 + 0.05, 0), (k as f64 + 0.95, *count)], RGBColor(70, 120, 180).filled())),
    )?;
    let lines = panel.limits_mm.iter().filter_map(|limit| edges_mm.iter().position(|edge| edge == limit));
    chart.draw_series(lines.map(|k| PathElement::new([(k as f64, 0), (k as f64, highest)], RED.stroke_width(2))))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_a_bar_for_every_bin_and_names_its_panels() {
        let mut gaps = Histogram::default();
        for length_m in [0.0, 0.0004, 0.02, 0.5] {
            gaps.add(length_m);
        }
        let panels =
            [("gaps", &[1.0, 2.5][..]), ("offsets", &[][..])].map(|(title, limits_mm)| Panel { title, histogram: &gaps, limits_mm });
        let svg = histograms(&panels).expect("a picture");
        assert!(svg.starts_with("<svg") && svg.contains("gaps (4 pairs, 1 of them") && svg.contains("offsets (4 pairs"));
        assert_eq!(svg.matches("fill=\"#4678B4\"").count(), 2 * gaps.counts.len());
    }
}
