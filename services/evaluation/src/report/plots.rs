//! Pictures of the tables, as SVG: grouped bars with intervals, realism against distance moved, reliability diagrams.

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::statistics::calibration::{BINS, Calibration};

/// A picture that could not be drawn.
#[derive(Debug, thiserror::Error)]
#[error("drawing {what}: {message}")]
pub struct DrawError {
    /// What was drawn.
    what: &'static str,
    /// What the plotting library says.
    message: String,
}

/// Colors of series, in their order: readable side by side without seeing red or green.
static COLORS: [RGBColor; 4] = [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(140, 185, 220), RGBColor(240, 190, 130)];
const FONT: (&str, i32) = ("sans-serif", 14);

/// One series of [`grouped_bars`]: a name, and a height (0 to 1) with an interval per group.
pub struct BarSeries<'a> {
    /// For the legend.
    pub name: &'a str,
    /// One a group; `None` leaves a gap.
    pub values: Vec<Option<f64>>,
    /// One a group.
    pub intervals: Vec<Option<[f64; 2]>>,
}

/// One series of [`scatter`]: a name and points (distance moved in metres, realism).
pub struct Points<'a> {
    /// For the legend.
    pub name: &'a str,
    /// The points.
    pub points: Vec<(f64, f64)>,
}

/// Bars from 0 to 1, up to four series side by side in each group.
///
/// # Errors
/// [`DrawError`] when the plotting library fails.
pub fn grouped_bars(title: &str, groups: &[&str], series: &[BarSeries<'_>]) -> Result<String, DrawError> {
    drawn("bars", (1000, 420), |root| {
        let count = groups.len();
        let mut chart = ChartBuilder::on(root)
            .caption(title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(34)
            .y_label_area_size(46)
            .build_cartesian_2d((0..count.max(1)).into_segmented(), 0.0..1.0)?;
        let name = |at: &SegmentValue<usize>| match at {
            SegmentValue::CenterOf(k) => groups.get(*k).map_or_else(String::new, |g| (*g).to_owned()),
            _ => String::new(),
        };
        chart.configure_mesh().disable_x_mesh().x_labels(count).x_label_formatter(&name).label_style(FONT).draw()?;
        // Segments have no fractions: bars are placed in pixels within the segment.
        let width = chart.plotting_area().dim_in_pixel().0 as f64 / count.max(1) as f64;
        let bar = (0.8 * width / series.len().max(1) as f64) as i32;
        for (s, (bars, color)) in series.iter().zip(COLORS.iter().cycle()).enumerate() {
            let left = -(series.len() as i32 * bar) / 2 + s as i32 * bar;
            let area = chart.plotting_area();
            let at = |k: usize, value: f64| area.map_coordinate(&(SegmentValue::CenterOf(k), value));
            for (k, value) in bars.values.iter().enumerate().filter_map(|(k, v)| Some((k, (*v)?))) {
                let (x, top) = at(k, value);
                let (_, bottom) = at(k, 0.0);
                root.draw(&Rectangle::new([(x + left, top), (x + left + bar - 1, bottom)], color.filled()))?;
                if let Some([low, high]) = bars.intervals.get(k).copied().flatten() {
                    let middle = x + left + bar / 2;
                    root.draw(&PathElement::new([(middle, at(k, low).1), (middle, at(k, high).1)], BLACK.stroke_width(1)))?;
                }
            }
            chart
                .draw_series(std::iter::empty::<Circle<(SegmentValue<usize>, f64), i32>>())?
                .label(bars.name)
                .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 12, y + 5)], color.filled()));
        }
        legend(&mut chart)
    })
}

/// Realism (0 to 1) against how far the object moved, up to `farthest_m`.
///
/// # Errors
/// As [`grouped_bars`].
pub fn scatter(title: &str, farthest_m: f64, series: &[Points<'_>]) -> Result<String, DrawError> {
    drawn("points", (760, 480), |root| {
        let mut chart = ChartBuilder::on(root)
            .caption(title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(50)
            .build_cartesian_2d(0.0..farthest_m, 0.0..1.0)?;
        chart.configure_mesh().x_desc("distance moved after release, metres").y_desc("realism").label_style(FONT).draw()?;
        for (points, color) in series.iter().zip(COLORS.iter().cycle()) {
            chart
                .draw_series(points.points.iter().map(|p| Circle::new(*p, 3, color.mix(0.55).filled())))?
                .label(points.name)
                .legend(move |(x, y)| Circle::new((x + 6, y), 4, color.filled()));
        }
        legend(&mut chart)
    })
}

/// What came true against what was said, bin by bin, with the count of each; the diagonal is perfect.
///
/// # Errors
/// As [`grouped_bars`].
pub fn reliability(title: &str, calibration: &Calibration) -> Result<String, DrawError> {
    drawn("reliability", (520, 500), |root| {
        let mut chart = ChartBuilder::on(root)
            .caption(title, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(50)
            .build_cartesian_2d(0.0..1.0, 0.0..1.08)?;
        chart.configure_mesh().x_desc("realism").y_desc("share stable").label_style(FONT).draw()?;
        let filled = || calibration.bins.iter().enumerate().filter(|(_, bin)| bin.count > 0);
        let edge = |k: usize| k as f64 / BINS as f64;
        chart.draw_series(
            filled().map(|(k, bin)| Rectangle::new([(edge(k) + 0.005, 0.0), (edge(k + 1) - 0.005, bin.observed)], COLORS[2].filled())),
        )?;
        chart.draw_series(std::iter::once(PathElement::new([(0.0, 0.0), (1.0, 1.0)], BLACK.stroke_width(1))))?;
        chart.draw_series(filled().map(|(_, bin)| Circle::new((bin.predicted, bin.observed), 4, COLORS[0].filled())))?;
        chart.draw_series(filled().map(|(k, bin)| Text::new(bin.count.to_string(), (edge(k) + 0.02, bin.observed + 0.05), FONT)))?;
        Ok(())
    })
}

/// What a drawing closure returns.
pub(crate) type DrawResult = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// A white picture with what `draw` puts on it: the one place that starts and ends an SVG.
pub(crate) fn drawn(
    what: &'static str,
    size: (u32, u32),
    draw: impl FnOnce(&DrawingArea<SVGBackend<'_>, Shift>) -> DrawResult,
) -> Result<String, DrawError> {
    let failed = |e: &dyn std::fmt::Display| DrawError { what, message: e.to_string() };
    let mut text = String::new();
    {
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        root.fill(&WHITE).map_err(|e| failed(&e))?;
        draw(&root).map_err(|e| failed(&e))?;
        root.present().map_err(|e| failed(&e))?;
    }
    Ok(text)
}

fn legend<'a, 'b, X: Ranged, Y: Ranged>(chart: &mut ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>) -> DrawResult
where
    'b: 'a,
{
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .label_font(FONT)
        .draw()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_have_their_groups_series_and_intervals() {
        let series = [
            BarSeries { name: "ours", values: vec![Some(0.5), None], intervals: vec![Some([0.4, 0.6]), None] },
            BarSeries { name: "theirs", values: vec![Some(0.7), Some(0.2)], intervals: vec![None, None] },
        ];
        let svg = grouped_bars("F1", &["left of", "near"], &series).expect("a picture");
        for text in ["F1", "left of", "near", "ours", "theirs"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("fill=\"#0072B2\"").count(), 1 + 1, "a bar and its legend");
        assert_eq!(svg.matches("fill=\"#D55E00\"").count(), 2 + 1);
    }

    #[test]
    fn scatter_and_reliability_show_their_points() {
        let series = [Points { name: "random", points: vec![(0.1, 0.9), (0.3, 0.2)] }];
        let svg = scatter("Realism", 0.5, &series).expect("a picture");
        assert_eq!(svg.matches("<circle").count(), 2 + 1, "points and legend");
        let calibration = Calibration::of(&[(0.95, true), (0.25, false)], 1);
        let svg = reliability("Reliability", &calibration).expect("a picture");
        assert_eq!(svg.matches("<circle").count(), 2);
        assert!(svg.contains("</svg>"));
    }
}
