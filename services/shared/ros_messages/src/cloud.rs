//! Organized clouds as pictures: a point per pixel, whose distance ahead is the depth, and which may have a color.
//!
//! The points say themselves what the camera is, where nobody else does: in the camera's optical frame a pixel's column is a linear function of x / z,
//! its row one of y / z.

use repose_proto::CameraModel;

use crate::cdr::MessageError;
use crate::frames::{CloudPicture, DEPTH_UNIT_M, SampledPoint, depth_of_cloud};
use crate::pictures::{Color, Depth};
use crate::sensor::PointCloud2;

/// Points that a camera is told from at least.
const LEAST_POINTS: usize = 100;
/// How far a point may be from its pixel, and how many per cent of them farther: points are computed from pixels, but for rounding.
const OFF_PX: f64 = 1.0;
const OFF_PERCENT: usize = 5;

/// A picture of depth with what came in the same message.
#[derive(Debug, Clone, PartialEq)]
pub struct Sight {
    /// The depth.
    pub depth: Depth,
    /// A cloud's colors.
    pub color: Option<Color>,
    /// Points of a cloud, to be compared with the camera.
    pub sample: Vec<SampledPoint>,
}

impl From<Depth> for Sight {
    fn from(depth: Depth) -> Self {
        Self { depth, color: None, sample: Vec::new() }
    }
}

/// The picture of a cloud.
///
/// # Errors
/// [`MessageError`] for a cloud that is no picture, or shorter than it says.
pub fn sight(cloud: &PointCloud2) -> Result<Sight, MessageError> {
    let CloudPicture { counts, unit_m, colors, sample } = depth_of_cloud(cloud)?;
    let (width, height) = (cloud.width as usize, cloud.height as usize);
    let color = colors.map(|pixels| Color { width, height, pixels });
    Ok(Sight { depth: Depth { width, height, unit_m, counts }, color, sample })
}

/// The camera that points show to their pixels in, by least squares.
///
/// # Errors
/// [`MessageError::Unsupported`] for too few points; [`MessageError::NotOptical`] for those of another frame, or of a lens that bends.
pub fn camera_of(sample: &[SampledPoint], (width, height): (usize, usize)) -> Result<CameraModel, MessageError> {
    let few = || {
        let expected = "more points with readings; or name the camera's `info`";
        MessageError::Unsupported { field: "data", got: format!("{} points to tell the camera from", sample.len()), expected }
    };
    if sample.len() < LEAST_POINTS {
        return Err(few());
    }
    let of = |at: &SampledPoint, axis: usize| f64::from(at.point_m[axis]) / f64::from(at.point_m[2]);
    let (column, row) = (|at: &SampledPoint| (at.pixel % width) as f64, |at: &SampledPoint| (at.pixel / width) as f64);
    let ahead: Vec<&SampledPoint> = sample.iter().filter(|at| at.point_m[2] > 0.0).collect();
    let Some((fx, cx)) = line(ahead.iter().map(|at| (of(at, 0), column(at)))) else { return Err(few()) };
    let Some((fy, cy)) = line(ahead.iter().map(|at| (of(at, 1), row(at)))) else { return Err(few()) };
    let is_on = |at: &&&SampledPoint| (fx * of(at, 0) + cx - column(at)).abs() <= OFF_PX && (fy * of(at, 1) + cy - row(at)).abs() <= OFF_PX;
    let off_percent = 100 - ahead.iter().filter(is_on).count() * 100 / sample.len();
    let camera = CameraModel { width, height, fx, fy, cx, cy, depth_unit_m: DEPTH_UNIT_M, world_from_camera: None };
    if off_percent > OFF_PERCENT || camera.validate().is_err() {
        return Err(MessageError::NotOptical { off_percent });
    }
    Ok(camera)
}

/// Slope and offset of the line nearest to points; none where they do not differ.
fn line(points: impl Iterator<Item = (f64, f64)> + Clone) -> Option<(f64, f64)> {
    let count = points.clone().count().max(1) as f64;
    let (x, y) = points.clone().fold((0.0, 0.0), |(x, y), point| (x + point.0 / count, y + point.1 / count));
    let (xx, xy) = points.fold((0.0, 0.0), |(xx, xy), point| (xx + (point.0 - x).powi(2), xy + (point.0 - x) * (point.1 - y)));
    (xx / count > 1e-9).then(|| (xy / xx, y - xy / xx * x))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    const SIDE: u32 = 40;

    /// A point on the ray of a pixel of a camera with a focal length of 50 pixels, some 1 m away.
    fn seen(row: u32, column: u32) -> [f32; 3] {
        let z = 1.0 + 0.01 * row as f32;
        [(column as f32 - 18.5) / 50.0 * z, (row as f32 - 21.0) / 52.0 * z, z]
    }

    fn of(point: impl Fn(u32, u32) -> [f32; 3]) -> Result<CameraModel, MessageError> {
        let cloud = PointCloud2::read(&synthetic::cloud("optical", SIDE, point)).expect("a cloud");
        let sight = sight(&cloud).expect("a picture");
        camera_of(&sight.sample, (sight.depth.width, sight.depth.height))
    }

    #[test]
    fn a_cloud_is_depth_and_says_what_its_camera_is() {
        let camera = of(seen).expect("a camera");
        for (got, expected) in [(camera.fx, 50.0), (camera.fy, 52.0), (camera.cx, 18.5), (camera.cy, 21.0)] {
            assert!((got - expected).abs() < 1e-3, "{got} is not {expected}");
        }
        let holes = of(|row, column| if (row + column).is_multiple_of(3) { [f32::NAN; 3] } else { seen(row, column) });
        assert!(holes.is_ok_and(|held| (held.fx - camera.fx).abs() < 1e-3));
        let cloud = PointCloud2::read(&synthetic::cloud("optical", SIDE, seen)).expect("a cloud");
        let sight = sight(&cloud).expect("a picture");
        assert_eq!((sight.depth.counts[0], sight.depth.counts[(SIDE * SIDE - 1) as usize], sight.color), (10_000, 13_900, None));
        let hall =
            PointCloud2::read(&synthetic::cloud("optical", SIDE, |row, column| seen(row, column).map(|m| 8.0 * m))).expect("a cloud");
        let Depth { counts, unit_m, .. } = super::sight(&hall).expect("a picture").depth;
        assert_eq!((counts[0], unit_m), (20_000, 4e-4), "past the things one sees to the end of the hall");
    }

    #[test]
    fn what_is_no_pinhole_picture_is_refused() {
        // A robot's axes: x forward, y left, z up.
        let turned = of(|row, column| {
            let [x, y, z] = seen(row, column);
            [z, -x, -y]
        });
        assert!(matches!(turned, Err(MessageError::NotOptical { .. })), "{turned:?}");
        let bent = of(|row, column| {
            let [x, y, z] = seen(row, column);
            let radial = 1.0 - 0.8 * (x * x + y * y);
            [x * radial, y * radial, z]
        });
        assert!(matches!(bent, Err(MessageError::NotOptical { .. })), "{bent:?}");
        assert!(of(|_, _| [f32::NAN; 3]).is_err_and(|e| e.to_string().contains("info")));
        assert!(of(|_, _| [0.1, 0.1, 1.0]).is_err());
        let mut list = PointCloud2::read(&synthetic::cloud("optical", SIDE, seen)).expect("a cloud");
        (list.width, list.height, list.row_step) = (SIDE * SIDE, 1, SIDE * SIDE * list.point_step);
        assert!(sight(&list).is_err_and(|e| e.to_string().contains("ordered_pc")));
        list.data.truncate(100);
        (list.width, list.height, list.row_step) = (SIDE, SIDE, 0);
        assert!(sight(&list).is_err());
    }
}
