//! What a frame is made of, from the messages of a ROS 2 camera driver: depth counts, colors, intrinsics.

use repose_proto::CameraModel;

use super::ros_messages::{CameraInfo, MessageError, PointCloud2, RosImage};

/// Metres per count of depth that came as floats: fine enough for any depth camera, and 6.5 m fit.
pub const DEPTH_UNIT_M: f64 = 1e-4;
/// Metres per count of integer depth, as the ROS convention (REP 118) has it.
const INTEGER_UNIT_M: f64 = 1e-3;

/// Depth counts and metres per count of an image of integers or floats.
///
/// # Errors
/// [`MessageError`] for other encodings and short rows.
pub fn depth_of_image(image: &RosImage) -> Result<(Vec<u16>, f64), MessageError> {
    let big = image.is_bigendian != 0;
    match image.encoding.as_str() {
        "16UC1" | "mono16" => {
            let count = |pixel: &[u8; 2]| if big { u16::from_be_bytes(*pixel) } else { u16::from_le_bytes(*pixel) };
            let counts = image.rows(2)?.flat_map(|row| row.as_chunks::<2>().0).map(count).collect();
            Ok((counts, INTEGER_UNIT_M))
        }
        "32FC1" => {
            let metres = |pixel: &[u8; 4]| if big { f32::from_be_bytes(*pixel) } else { f32::from_le_bytes(*pixel) };
            let counts = image.rows(4)?.flat_map(|row| row.as_chunks::<4>().0).map(|pixel| count_of(metres(pixel))).collect();
            Ok((counts, DEPTH_UNIT_M))
        }
        other => Err(MessageError::Unsupported { field: "encoding", got: other.to_owned(), expected: "16UC1, mono16 or 32FC1" }),
    }
}

/// The colors of an image.
///
/// # Errors
/// [`MessageError`] for other encodings and short rows.
pub fn color_of(image: &RosImage) -> Result<Vec<[u8; 3]>, MessageError> {
    let (bytes, blue_first) = match image.encoding.as_str() {
        "rgb8" => (3, false),
        "bgr8" => (3, true),
        "rgba8" => (4, false),
        "bgra8" => (4, true),
        other => {
            return Err(MessageError::Unsupported { field: "encoding", got: other.to_owned(), expected: "rgb8, bgr8, rgba8 or bgra8" });
        }
    };
    let pixel = |p: &[u8]| if blue_first { [p[2], p[1], p[0]] } else { [p[0], p[1], p[2]] };
    Ok(image.rows(bytes)?.flat_map(|row| row.chunks_exact(bytes)).map(pixel).collect())
}

/// An organised cloud as pictures.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CloudPicture {
    /// Depth, counts of [`DEPTH_UNIT_M`].
    pub counts: Vec<u16>,
    /// Color, where every point has one.
    pub colors: Option<Vec<[u8; 3]>>,
}

/// The pictures of an organised cloud, which has a point per pixel.
///
/// # Errors
/// [`MessageError`] for a cloud that is no picture.
pub fn depth_of_cloud(cloud: &PointCloud2) -> Result<CloudPicture, MessageError> {
    if cloud.height < 2 {
        let got = format!("{} x {}", cloud.width, cloud.height);
        return Err(MessageError::Unsupported { field: "height", got, expected: "organised clouds, one point per pixel" });
    }
    let (mut counts, mut colors) = (Vec::new(), Vec::new());
    for ([_, _, z], color) in cloud.points()? {
        counts.push(count_of(z));
        colors.extend(color);
    }
    let colors = (colors.len() == counts.len()).then_some(colors);
    Ok(CloudPicture { counts, colors })
}

/// The camera of pictures of a size; `None` when the intrinsics are of another size or are none.
pub fn model_of(info: &CameraInfo, (width, height): (usize, usize), depth_unit_m: f64) -> Option<CameraModel> {
    if (info.width as usize, info.height as usize) != (width, height) {
        return None;
    }
    let [fx, _, cx, _, fy, cy, ..] = info.k;
    let model = CameraModel { width, height, fx, fy, cx, cy, depth_unit_m, world_from_camera: None };
    model.validate().is_ok().then_some(model)
}

/// Counts of a depth in metres; 0 for NaN, what is not in front, and what is too far.
fn count_of(depth_m: f32) -> u16 {
    let count = (f64::from(depth_m) / DEPTH_UNIT_M).round();
    if count >= 1.0 && count <= f64::from(u16::MAX) { count as u16 } else { 0 }
}
