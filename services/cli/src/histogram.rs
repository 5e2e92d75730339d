//! Histograms of lengths as one SVG, for reports.

use plotters::prelude::*;
use repose_simulator::statistics::Histogram;

/// One of several histograms above each other.
pub struct Panel<'a> {
    /// What was counted.
    pub title: &'a str,
    /// The counts.
    pub histogram: &'a Histogram,
    /// Lengths at which relations change, millimetres: drawn as lines.
    pub limits_mm: &'a [f64],
}

/// Draws the panels. Bins are drawn equally wide, since they are finest where the limits are, and labelled with their lower border.
///
/// # Errors
/// A message when the picture cannot be drawn.
pub fn svg(panels: &[Panel]) -> Result<String, String> {
    const WIDTH: u32 = 1100;
    const PANEL_HEIGHT: u32 = 300;
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, (WIDTH, PANEL_HEIGHT * panels.len() as u32)).into_drawing_area();
        root.fill(&WHITE).map_err(|e| e.to_string())?;
        for (panel, area) in panels.iter().zip(root.split_evenly((panels.len(), 1))) {
            draw(panel, &area).map_err(|e| e.to_string())?;
        }
        root.present().map_err(|e| e.to_string())?;
    }
    Ok(text)
}

fn draw<DB: DrawingBackend>(
    panel: &Panel,
    area: &DrawingArea<DB, plotters::coord::Shift>,
) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    let Histogram { edges_mm, counts, beyond } = panel.histogram;
    let bins = counts.len() + 1;
    let highest = counts.iter().chain([beyond]).max().copied().unwrap_or(0).max(1);
    let title = format!("{} ({} pairs)", panel.title, panel.histogram.total());
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 16))
        .margin(8)
        .x_label_area_size(38)
        .y_label_area_size(58)
        .build_cartesian_2d(0.0..bins as f64, 0..highest + highest / 20 + 1)?;
    let border = |at: &f64| edges_mm.get(at.round() as usize).map_or_else(String::new, |mm| format!("{mm}"));
    chart
        .configure_mesh()
        .disable_x_mesh()
        .x_labels(bins + 1)
        .x_label_formatter(&border)
        .x_desc("millimetres, lower border of the bin; the last bin is 100 mm and more")
        .y_desc("pairs")
        .draw()?;
    let bars = counts.iter().chain([beyond]).enumerate();
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
        let svg = svg(&panels).expect("a picture");
        assert!(svg.starts_with("<svg") && svg.contains("gaps (4 pairs)") && svg.contains("offsets (4 pairs)"));
        assert_eq!(svg.matches("fill=\"#4678B4\"").count(), 2 * (gaps.counts.len() + 1));
    }
}
