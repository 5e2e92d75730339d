//! Draws where a small box must stand for each relation to a larger one to hold, by the rules themselves: the picture of the README.
//!
//! `cargo run --release -p repose-evaluation --example relations_picture -- deploy/relations.png`

use std::path::PathBuf;

use nalgebra::{Point3, Vector3};
use repose_evaluation::report::written::write_picture;
use repose_geometry::Image;
use repose_local::picture::{captioned, rgb_image, side_by_side};
use repose_pictures::Rgb;
use repose_pictures::colors::object_color;
use repose_pictures::drawing::{GLYPH_HEIGHT, GLYPH_WIDTH, write_lines};
use repose_relations::ViewerExtents;
use repose_relations::directional::directional_margins;
use repose_relations::margins::NEAR_M;

/// Half the extents of the two boxes along the viewer's axes (right, away, up), metres.
const ANCHOR_HALF_M: [f64; 3] = [0.06, 0.045, 0.05];
const QUERY_HALF_M: [f64; 3] = [0.02; 3];
/// Half of what a panel shows, metres, and its pixels per metre.
const SHOWN_M: f64 = 0.22;
const PER_M: f64 = 900.0;
const PAPER: Rgb = [255; 3];
const INK: Rgb = [40; 3];

/// A plane through the anchor's centre: its name, the viewer's axes along its columns and (downwards) its rows, and the relations that it
/// shows: their place in the margins, their name, and where it is written (share of the panel).
struct Panel {
    title: &'static str,
    axes: [usize; 2],
    rows_point_down: f64,
    relations: [(usize, &'static str, [f64; 2]); 4],
}

const PANELS: [Panel; 2] = [
    Panel {
        title: "seen from above; the viewer is at the bottom",
        axes: [0, 1],
        rows_point_down: -1.0,
        relations: [(0, "left_of", [0.14, 0.5]), (1, "right_of", [0.86, 0.62]), (2, "in_front_of", [0.5, 0.9]), (3, "behind", [0.5, 0.1])],
    },
    Panel {
        title: "as the viewer sees it",
        axes: [0, 2],
        rows_point_down: -1.0,
        relations: [(0, "left_of", [0.14, 0.5]), (1, "right_of", [0.86, 0.62]), (4, "above", [0.5, 0.1]), (5, "below", [0.5, 0.9])],
    },
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args_os().nth(1).map_or_else(|| PathBuf::from("deploy/relations.png"), PathBuf::from);
    let panels = PANELS.iter().map(|panel| captioned(&rgb_image(&drawn(panel)), panel.title)).collect::<Vec<_>>();
    write_picture(&path, &side_by_side(&panels).into())?;
    Ok(())
}

fn extents(center: Point3<f64>, half_m: [f64; 3]) -> ViewerExtents {
    let half = Vector3::from(half_m);
    ViewerExtents { low: center - half, high: center + half, center }
}

fn drawn(panel: &Panel) -> Image<Rgb> {
    let anchor = extents(Point3::origin(), ANCHOR_HALF_M);
    let side = (2.0 * SHOWN_M * PER_M) as usize;
    let mut picture = Image::filled(side, side, PAPER);
    // The query with its centre at a pixel.
    let query_at = |x: usize, y: usize| {
        let mut center = Point3::origin();
        center[panel.axes[0]] = x as f64 / PER_M - SHOWN_M;
        center[panel.axes[1]] = panel.rows_point_down * (y as f64 / PER_M - SHOWN_M);
        extents(center, QUERY_HALF_M)
    };
    for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x, y))) {
        let query = query_at(x, y);
        let margins = directional_margins(&query, &anchor);
        let holding = panel.relations.iter().enumerate().filter(|(_, (index, _, _))| margins[*index] > 0.0);
        let colors: Vec<Rgb> = holding.map(|(k, _)| object_color(k as u16 + 1)).collect();
        let is_near = query.distance_m(&anchor) <= NEAR_M;
        let shade = if is_near { 2 } else { 3 };
        if let Some(mixed) = mixed(&colors) {
            picture[(x, y)] = mixed.map(|c| ((u16::from(c) + (shade - 1) * 255) / shade) as u8);
        } else if is_near {
            picture[(x, y)] = [215; 3];
        }
        let on_edge = |extents: &ViewerExtents, at: Point3<f64>| {
            let out = panel.axes.map(|a| (at[a] - extents.low[a]).min(extents.high[a] - at[a]));
            out[0].min(out[1]).abs() < 0.75 / PER_M && out.iter().all(|o| *o > -0.75 / PER_M)
        };
        // The anchor, and the query as large as it is, standing right of the anchor.
        let mut sample = Point3::origin();
        sample[0] = 0.135;
        if on_edge(&anchor, query.center) || on_edge(&extents(sample, QUERY_HALF_M), query.center) {
            picture[(x, y)] = INK;
        }
    }
    for (_, name, at) in panel.relations {
        write_centred(&mut picture, name, at.map(|share| (share * side as f64) as usize));
    }
    write_centred(&mut picture, "anchor", [side / 2, side / 2]);
    picture
}

/// The mean of colors; none of none.
fn mixed(colors: &[Rgb]) -> Option<Rgb> {
    let mean = |k: usize| (colors.iter().map(|c| usize::from(c[k])).sum::<usize>() / colors.len().max(1)) as u8;
    (!colors.is_empty()).then(|| std::array::from_fn(mean))
}

fn write_centred(picture: &mut Image<Rgb>, text: &str, [x, y]: [usize; 2]) {
    let left = x.saturating_sub(text.len() * GLYPH_WIDTH / 2).min(picture.width().saturating_sub(text.len() * GLYPH_WIDTH));
    write_lines(picture, left, y.saturating_sub(GLYPH_HEIGHT / 2), text, &[]);
}
