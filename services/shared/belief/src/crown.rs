//! Tops that carry nothing: of balls, of tubes that lie, of boxes that stand on an edge. Something set down on one rolls or tips off.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix2, Point3};

use crate::settings::CrownSettings;

/// Whether an object's top is crowned: a paraboloid through its uppermost points bulges upwards.
///
/// The rim of a cup is level and its inside hollow: neither is crowned.
pub fn is_crowned(points: &[Point3<f32>], settings: &CrownSettings) -> bool {
    let points = uppermost(points, settings.cell_m);
    let mut heights: Vec<f32> = points.iter().map(|p| p.z).collect();
    heights.sort_by(f32::total_cmp);
    // The highest few may be stray.
    let Some(top_m) = heights.get((heights.len() * 49) / 50).copied() else { return false };
    let upper: Vec<&Point3<f32>> = points.iter().filter(|p| (top_m - settings.band_m..=top_m + settings.stray_m).contains(&p.z)).collect();
    let step = upper.len().div_ceil(settings.sample).max(1);
    let upper: Vec<&Point3<f32>> = upper.into_iter().step_by(step).collect();
    if upper.len() < settings.min_points {
        return false;
    }
    let count = upper.len() as f64;
    let mean = upper.iter().map(|p| p.coords.cast::<f64>()).sum::<nalgebra::Vector3<f64>>() / count;
    let rows = upper.iter().map(|p| p.coords.cast::<f64>() - mean);
    // In units of a centimetre the columns are of one size.
    let terms = |d: &nalgebra::Vector3<f64>| {
        let (x, y) = (d.x * 100.0, d.y * 100.0);
        [1.0, x, y, x * x, x * y, y * y]
    };
    let (a, b): (Vec<[f64; 6]>, Vec<f64>) = rows.map(|d| (terms(&d), d.z * 100.0)).unzip();
    let a = DMatrix::from_row_iterator(a.len(), 6, a.into_iter().flatten());
    let Ok(fit) = a.svd(true, true).solve(&DVector::from_vec(b), 1e-9) else { return false };
    // Second derivatives, per centimetre: the most negative principal curvature and its direction.
    let curvature = Matrix2::new(2.0 * fit[3], fit[4], fit[4], 2.0 * fit[5]).symmetric_eigen();
    let most = curvature.eigenvalues.imin();
    let (bulge_per_m, across) = (-curvature.eigenvalues[most] * 100.0, curvature.eigenvectors.column(most).into_owned());
    // Over a narrow top a curve is only noise.
    let spread_m2 = upper.iter().map(|p| (p.coords.cast::<f64>() - mean).xy().dot(&across).powi(2)).sum::<f64>() / count;
    bulge_per_m >= settings.bulge_per_m && bulge_per_m * spread_m2 >= settings.rise_m
}

/// The highest point of each cell seen from above: the upright faces below a top's edge are none of it.
fn uppermost(points: &[Point3<f32>], cell_m: f32) -> Vec<Point3<f32>> {
    let mut highest: BTreeMap<[i32; 2], Point3<f32>> = BTreeMap::new();
    for p in points {
        let cell = [p.x, p.y].map(|along| (along / cell_m).floor() as i32);
        let top = highest.entry(cell).or_insert(*p);
        if p.z > top.z {
            *top = *p;
        }
    }
    highest.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points every 2 mm over a square of 8 cm, where there is a top; noise of 1 mm.
    fn seen(top_m: impl Fn(f32, f32) -> Option<f32>) -> Vec<Point3<f32>> {
        let noise = |i: i32, j: i32| 0.001 * ((i * 7 + j * 13) % 5 - 2) as f32 / 2.0;
        let at = |i: i32, j: i32| {
            let (x, y) = (i as f32 * 0.002, j as f32 * 0.002);
            top_m(x, y).map(|z| Point3::new(x, y, z + noise(i, j)))
        };
        (-20..=20).flat_map(|i| (-20..=20).map(move |j| (i, j))).filter_map(|(i, j)| at(i, j)).collect()
    }

    #[test]
    fn balls_lying_tubes_and_edges_are_crowned_and_level_or_hollow_tops_are_not() {
        let settings = CrownSettings::default();
        let ball = |radius: f32| seen(move |x, y| Some((radius * radius - x * x - y * y).max(0.0).sqrt()).filter(|z| *z > 0.0));
        let tube = |radius: f32| seen(move |_, y| Some((radius * radius - y * y).max(0.0).sqrt()).filter(|z| *z > 0.0));
        for points in [ball(0.03), ball(0.06), tube(0.02), tube(0.04), seen(|x, _| Some(0.1 - x.abs()))] {
            assert!(is_crowned(&points, &settings));
        }
        let bowl = seen(|x, y| Some(10.0 * (x * x + y * y)));
        let rim = seen(|x, y| Some(0.1).filter(|_| (0.03..0.035).contains(&x.hypot(y))));
        let lid = seen(|x, y| Some(0.2).filter(|_| x.hypot(y) < 0.012));
        for points in [seen(|_, _| Some(0.05)), bowl, rim, lid, seen(|x, _| Some(0.1 + 0.1 * x))] {
            assert!(!is_crowned(&points, &settings));
        }
        assert!(!is_crowned(&[], &settings));
    }

    #[test]
    fn a_small_box_whose_front_shows_is_not_crowned() {
        let settings = CrownSettings::default();
        for size_m in [0.04, 0.05, 0.08] {
            let steps = (size_m / 0.002) as i32;
            let at = |i: i32| i as f32 * 0.002;
            let top = (0..=steps).flat_map(|i| (0..=steps).map(move |j| Point3::new(at(i), at(j), 0.1)));
            let front = (0..=steps).flat_map(|i| (0..50).map(move |k| Point3::new(at(i), 0.0, 0.1 - at(k))));
            assert!(!is_crowned(&top.chain(front).collect::<Vec<_>>(), &settings), "{size_m}");
        }
    }
}
