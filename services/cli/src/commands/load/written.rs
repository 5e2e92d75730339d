//! A load run on disk: a line for each request (CSV), and a page with plots (HTML) that needs nothing else.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::report::{Ended, Report, STAGES};
use crate::failure::Failure;

/// Size of a plot, pixels.
const SIZE: (u32, u32) = (1000, 360);
/// Points of a plot: of more requests every so many-th is drawn.
const MOST_POINTS: usize = 4000;
/// Time slices of the rates.
const SLICES: usize = 60;
/// Colors of series, in their order: readable side by side without seeing red or green.
static COLORS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(140, 185, 220),
    RGBColor(120, 120, 120),
];

/// Writes what was asked for.
pub fn write(csv: Option<&Path>, html: Option<&Path>, title: &str, report: &Report, ended: &[Ended]) -> Result<(), Failure> {
    let write = |path: &Path, text: String| std::fs::write(path, text).map_err(|e| Failure::bad_input(&path.display().to_string(), e));
    if let Some(path) = csv {
        write(path, lines(ended))?;
    }
    if let Some(path) = html {
        write(path, page(title, report, ended)?)?;
    }
    Ok(())
}

/// A line for each request, in the order in which they were due.
fn lines(ended: &[Ended]) -> String {
    let mut text = String::from("due_s,priority,outcome,worker,took_ms,late");
    for stage in STAGES {
        text += &format!(",{stage}_ms");
    }
    text.push('\n');
    for end in in_order(ended) {
        let priority = serde_json::to_value(end.priority).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default();
        let (due_s, took_ms) = (end.due.as_secs_f64(), end.took.as_secs_f64() * 1e3);
        // Writing to a string does not fail; names here are our own, without commas.
        let _infallible =
            write!(text, "{due_s:.6},{priority},{},{},{took_ms:.3},{}", end.outcome, end.worker.as_deref().unwrap_or_default(), end.late);
        for stage in STAGES {
            text += &end.stages_ms.get(stage).map_or_else(|| ",".to_owned(), |ms| format!(",{ms:.3}"));
        }
        text.push('\n');
    }
    text
}

fn in_order(ended: &[Ended]) -> Vec<&Ended> {
    let mut in_order: Vec<&Ended> = ended.iter().collect();
    in_order.sort_by_key(|end| end.due);
    in_order
}

/// The report in words, with latency and rates over time.
fn page(title: &str, report: &Report, ended: &[Ended]) -> Result<String, Failure> {
    let ended = in_order(ended);
    let faults_s: Vec<f64> = report.faults.iter().map(|fault| fault.at_s).collect();
    let plots =
        [latencies(&ended, &faults_s), rates(&ended, &faults_s)].into_iter().collect::<Result<Vec<_>, _>>().map_err(Failure::other)?;
    let escape = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    let (title, words) = (escape(title), escape(&report.to_string()));
    let plots = plots.join("\n");
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>repose load</title>\
         <style>body{{font-family:sans-serif;margin:2em auto;max-width:1000px}}pre{{background:#f4f4f4;padding:1em;overflow-x:auto}}</style></head>\n\
         <body><h1>repose load</h1><p><code>{title}</code></p>\n<pre>{words}</pre>\n{plots}\n</body></html>\n"
    ))
}

type Drawn<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

fn drawn(draw: impl FnOnce(&DrawingArea<SVGBackend<'_>, Shift>) -> Drawn<()>) -> Drawn<String> {
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        draw(&root)?;
        root.present()?;
    }
    Ok(svg)
}

fn series<'a>(plot: &str, names: impl Iterator<Item = (&'a str, Vec<(f64, f64)>)>, as_lines: bool, faults_s: &[f64]) -> Drawn<String> {
    let all: BTreeMap<&str, Vec<(f64, f64)>> = names.collect();
    let largest = |of: fn(&(f64, f64)) -> f64| all.values().flatten().map(of).fold(0.0_f64, f64::max).max(1e-3) * 1.05;
    let (to_s, top) = (largest(|point| point.0), largest(|point| point.1));
    drawn(|root| {
        let mut chart =
            ChartBuilder::on(root).margin(10).x_label_area_size(36).y_label_area_size(64).build_cartesian_2d(0.0..to_s, 0.0..top)?;
        chart.configure_mesh().x_desc("seconds").y_desc(plot).draw()?;
        // A fault is a line from bottom to top, below everything else.
        for at_s in faults_s.iter().copied().filter(|at_s| *at_s <= to_s) {
            chart.draw_series(std::iter::once(PathElement::new(vec![(at_s, 0.0), (at_s, top)], BLACK.mix(0.25))))?;
        }
        for ((name, points), color) in all.iter().zip(COLORS.iter().cycle()) {
            let drawn = match as_lines {
                true => chart.draw_series(std::iter::once(PathElement::new(points.clone(), color.stroke_width(2))))?,
                false => chart.draw_series(points.iter().map(|point| Circle::new(*point, 2, color.mix(0.6).filled())))?,
            };
            drawn.label(*name).legend(move |(x, y)| Circle::new((x + 6, y), 4, color.filled()));
        }
        chart.configure_series_labels().background_style(WHITE.mix(0.8)).border_style(BLACK.mix(0.3)).draw()?;
        Ok(())
    })
}

/// When each request was due, and how long it took, by outcome.
fn latencies(ended: &[&Ended], faults_s: &[f64]) -> Drawn<String> {
    let mut by_outcome: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
    for end in ended.iter().step_by(ended.len().div_ceil(MOST_POINTS).max(1)) {
        let point = (end.due.as_secs_f64(), end.took.as_secs_f64() * 1e3);
        by_outcome.entry(&end.outcome).or_default().push(point);
    }
    series("latency, ms", by_outcome.into_iter(), false, faults_s)
}

/// Requests a second by time slice: due, and by how they ended.
fn rates(ended: &[&Ended], faults_s: &[f64]) -> Drawn<String> {
    let last_s = ended.iter().map(|end| (end.due + end.took).as_secs_f64()).fold(0.0, f64::max).max(1e-3);
    let slice_s = last_s / SLICES as f64;
    let mut by_name: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut count = |name, at_s: f64| {
        let slices = by_name.entry(name).or_insert_with(|| vec![0.0; SLICES]);
        slices[((at_s / slice_s) as usize).min(SLICES - 1)] += 1.0 / slice_s;
    };
    for end in ended {
        count("due", end.due.as_secs_f64());
        count(end.outcome.as_str(), (end.due + end.took).as_secs_f64());
    }
    let points = |slices: Vec<f64>| slices.into_iter().enumerate().map(|(k, rate)| ((k as f64 + 0.5) * slice_s, rate)).collect();
    series("requests a second", by_name.into_iter().map(|(name, slices)| (name, points(slices))), true, faults_s)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use repose_proto::Priority;

    use super::*;
    use crate::commands::load::own::Happened;
    use crate::commands::load::report::Asked;

    fn ended() -> Vec<Ended> {
        let one = |due_ms, outcome: &str, took_ms| Ended {
            kind: 0,
            outcome: outcome.to_owned(),
            priority: Priority::Batch,
            worker: (outcome == "result").then(|| "planner-1".to_owned()),
            due: Duration::from_millis(due_ms),
            took: Duration::from_millis(took_ms),
            late: false,
            stages_ms: BTreeMap::from([("queue".to_owned(), 2.5)]),
        };
        vec![one(20, "resource_exhausted", 1), one(10, "result", 30)]
    }

    #[test]
    fn each_request_is_a_line_in_the_order_of_when_it_was_due() {
        let text = lines(&ended());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "due_s,priority,outcome,worker,took_ms,late,client_ms,network_ms,queue_ms,compute_ms");
        assert_eq!(lines[1], "0.010000,batch,result,planner-1,30.000,false,,,2.500,");
        assert_eq!(lines[2], "0.020000,batch,resource_exhausted,,1.000,false,,,2.500,");
    }

    #[test]
    fn the_page_holds_the_report_and_both_plots_and_nothing_from_elsewhere() {
        let asked = Asked { ended: ended(), dropped: 0, duplicates: 0, elapsed: Duration::from_secs(1) };
        let mut report = Report::new(&asked, Some(10.0), &["a".to_owned(), "b".to_owned()]).expect("a report");
        assert_eq!(report.kinds["a"].requests, 2);
        report.faults.push(Happened { at_s: 0.015, what: "kill router".to_owned() });
        let page = page("repose load --slo p99<1s", &report, &asked.ended).expect("a page");
        assert!(page.contains("faults: kill router 1"));
        assert_eq!(page.matches("<svg").count(), 2);
        assert!(page.contains("p99&lt;1s") && page.contains("resource_exhausted") && page.contains("requests a second"));
        assert!(!page.contains("<script") && !page.contains("src="), "it needs nothing else");
    }
}
