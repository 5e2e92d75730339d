//! What a frame is made of, from the messages of a ROS 2 camera driver: depth counts, colors, intrinsics.

use repose_proto::CameraModel;

use crate::cdr::MessageError;
use crate::sensor::{CameraInfo, PointCloud2, RosImage};

/// Metres per count of depth that came as floats: fine enough for any depth camera, and 6.5 m fit.
pub const DEPTH_UNIT_M: f64 = 1e-4;
/// The same of pictures in which something is farther away, as the other end of a hall is: 26 m fit, and no depth camera measures more.
const FAR_UNIT_M: f64 = 4e-4;
/// Metres per count of integer depth, as the ROS convention (REP 118) has it.
const INTEGER_UNIT_M: f64 = 1e-3;

/// What a cloud has to be; the parameter is that of RealSense's driver, whose clouds are lists of points otherwise.
const ORGANIZED: &str = "organized clouds, one point per pixel (RealSense: ordered_pc:=true)";
/// About how many points of a cloud are compared with their rays.
const SAMPLED_POINTS: usize = 4096;
/// How far from its pixel a point may show: lenses whose pictures are not rectified bend rays by a few pixels.
const RAY_TOLERANCE_PX: f64 = 5.0;

/// Depth counts and metres per count of an image of integers or floats.
///
/// # Errors
/// [`MessageError`] for other encodings and short rows.
pub fn depth_of_image(image: &RosImage) -> Result<(Vec<u16>, f64), MessageError> {
    let big = image.is_bigendian != 0;
    match image.encoding.as_str() {
        "16UC1" | "mono16" => {
            let count = |pixel: &[u8; 2]| if big { u16::from_be_bytes(*pixel) } else { u16::from_le_bytes(*pixel) };
            Ok((pixels(image, count)?, INTEGER_UNIT_M))
        }
        "32FC1" => {
            let metres = |pixel: &[u8; 4]| if big { f32::from_be_bytes(*pixel) } else { f32::from_le_bytes(*pixel) };
            Ok(counts_of(pixels(image, metres)?.iter().map(|depth_m| f64::from(*depth_m))))
        }
        other => Err(MessageError::Unsupported { field: "encoding", got: other.to_owned(), expected: "16UC1, mono16 or 32FC1" }),
    }
}

/// The colors of an image. OpenCV's names without an order of colors, as `8UC3`, have blue first, as its pictures have.
///
/// # Errors
/// [`MessageError`] for other encodings and short rows.
pub fn color_of(image: &RosImage) -> Result<Vec<[u8; 3]>, MessageError> {
    match image.encoding.as_str() {
        "rgb8" => pixels(image, |rgb: &[u8; 3]| *rgb),
        "bgr8" | "8UC3" => pixels(image, |[b, g, r]| [*r, *g, *b]),
        "rgba8" => pixels(image, |[r, g, b, _]| [*r, *g, *b]),
        "bgra8" | "8UC4" => pixels(image, |[b, g, r, _]| [*r, *g, *b]),
        "mono8" | "8UC1" => pixels(image, |[gray]| [*gray; 3]),
        other => {
            let expected = "rgb8, bgr8, rgba8, bgra8, mono8, 8UC1, 8UC3 or 8UC4";
            Err(MessageError::Unsupported { field: "encoding", got: other.to_owned(), expected })
        }
    }
}

/// Each pixel of `N` bytes as something else, row by row.
fn pixels<const N: usize, T>(image: &RosImage, read: impl Fn(&[u8; N]) -> T) -> Result<Vec<T>, MessageError> {
    let rows = image.rows(N)?;
    // By what came and not by what the sizes promise.
    let mut read_pixels = Vec::with_capacity(image.data.len() / N);
    rows.for_each(|row| read_pixels.extend(row.as_chunks().0.iter().map(&read)));
    Ok(read_pixels)
}

/// An organized cloud as pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct CloudPicture {
    /// Depth counts.
    pub counts: Vec<u16>,
    /// Metres per count.
    pub unit_m: f64,
    /// Color, where every point has one.
    pub colors: Option<Vec<[u8; 3]>>,
    /// Some of the points, spread over the picture.
    pub sample: Vec<SampledPoint>,
}

/// A point of a cloud, to be compared with its pixel's ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampledPoint {
    /// Its place in the picture, row by row.
    pub pixel: usize,
    /// Where it is, metres.
    pub point_m: [f32; 3],
}

/// The pictures of an organized cloud, which has a point per pixel.
///
/// # Errors
/// [`MessageError`] for a cloud that is no picture.
pub fn depth_of_cloud(cloud: &PointCloud2) -> Result<CloudPicture, MessageError> {
    if cloud.height < 2 {
        let got = format!("{} x {}", cloud.width, cloud.height);
        return Err(MessageError::Unsupported { field: "height", got, expected: ORGANIZED });
    }
    let (mut depths_m, mut colors, mut sample) = (Vec::new(), Vec::new(), Vec::new());
    let every = (cloud.width as usize * cloud.height as usize).div_ceil(SAMPLED_POINTS);
    for (pixel, (point_m, color)) in cloud.points()?.enumerate() {
        depths_m.push(point_m[2]);
        colors.extend(color);
        if pixel % every == 0 && point_m.iter().all(|c| c.is_finite()) && point_m != [0.0; 3] {
            sample.push(SampledPoint { pixel, point_m });
        }
    }
    let colors = (colors.len() == depths_m.len()).then_some(colors);
    let (counts, unit_m) = counts_of(depths_m.iter().map(|depth_m| f64::from(*depth_m)));
    Ok(CloudPicture { counts, unit_m, colors, sample })
}

/// Checks that most points of a cloud lie on the rays of their pixels: only then is their z the depth.
///
/// # Errors
/// [`MessageError::NotOptical`] when they do not, as in a cloud that was carried into a robot's frame.
pub fn check_rays(sample: &[SampledPoint], camera: &CameraModel) -> Result<(), MessageError> {
    let is_off = |at: &&SampledPoint| {
        let [x, y, z] = at.point_m.map(f64::from);
        let (u, v) = (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy);
        let (column, row) = ((at.pixel % camera.width) as f64, (at.pixel / camera.width) as f64);
        !(z > 0.0 && (u - column).abs() <= RAY_TOLERANCE_PX && (v - row).abs() <= RAY_TOLERANCE_PX)
    };
    let off = sample.iter().filter(is_off).count();
    if off * 2 > sample.len() { Err(MessageError::NotOptical { off_percent: off * 100 / sample.len() }) } else { Ok(()) }
}

/// Columns and rows of the pictures that intrinsics are told with: a part of the whole where they are cropped, fewer where they are binned.
pub fn picture_size(info: &CameraInfo) -> (u32, u32) {
    // A part without an extent stands for the whole.
    let has_part = info.roi.width > 0 && info.roi.height > 0;
    let (width, height) = if has_part { (info.roi.width, info.roi.height) } else { (info.width, info.height) };
    (width / info.binning_x.max(1), height / info.binning_y.max(1))
}

/// The camera of pictures of a size; `None` when the intrinsics are of another size or are none.
///
/// K and P are of the whole picture. What is cropped begins at its part's corner, and a pixel of what is binned or thinned out is several of the
/// whole, as ROS's own `image_geometry` reckons.
pub fn model_of(info: &CameraInfo, (width, height): (usize, usize), depth_unit_m: f64) -> Option<CameraModel> {
    let is_size = |(columns, rows): (u32, u32)| (columns as usize, rows as usize) == (width, height);
    // Drivers that tell the pictures' own size have turned K and P into theirs, whatever part of the sensor they tell.
    let [left, top, columns, rows] = match is_size((info.width, info.height)) {
        true => [0.0, 0.0, 1.0, 1.0],
        false if is_size(picture_size(info)) => {
            [info.roi.x_offset, info.roi.y_offset, info.binning_x.max(1), info.binning_y.max(1)].map(f64::from)
        }
        false => return None,
    };
    // A rectified picture has the intrinsics of the projection; without rectification that is empty.
    let [of_p_fx, _, of_p_cx, _, _, of_p_fy, of_p_cy, ..] = info.p;
    let [of_k_fx, _, of_k_cx, _, of_k_fy, of_k_cy, ..] = info.k;
    let [fx, fy, cx, cy] = if of_p_fx > 0.0 { [of_p_fx, of_p_fy, of_p_cx, of_p_cy] } else { [of_k_fx, of_k_fy, of_k_cx, of_k_cy] };
    let [fx, fy, cx, cy] = [fx / columns, fy / rows, (cx - left) / columns, (cy - top) / rows];
    let model = CameraModel { width, height, fx, fy, cx, cy, depth_unit_m, world_from_camera: None };
    model.validate().is_ok().then_some(model)
}

/// Counts of depths in metres, and metres per count: as fine as what is farthest away allows. 0 for NaN, what is not in front, and what no camera
/// measures. What is far behind a scene matters to it: one sees past the things to there.
pub fn counts_of(depths_m: impl Iterator<Item = f64> + Clone) -> (Vec<u16>, f64) {
    let is_far = |depth_m: f64| count_of(depth_m, DEPTH_UNIT_M) == 0 && count_of(depth_m, FAR_UNIT_M) > 0;
    let unit_m = if depths_m.clone().any(is_far) { FAR_UNIT_M } else { DEPTH_UNIT_M };
    (depths_m.map(|depth_m| count_of(depth_m, unit_m)).collect(), unit_m)
}

/// Counts of a depth in metres; 0 where it does not fit.
fn count_of(depth_m: f64, unit_m: f64) -> u16 {
    let count = (depth_m / unit_m).round();
    if count >= 1.0 && count <= f64::from(u16::MAX) { count as u16 } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::Header;
    use crate::sensor::RegionOfInterest;
    use crate::synthetic;

    #[test]
    fn rectified_pictures_have_the_intrinsics_of_the_projection() {
        let mut info = CameraInfo::read(&synthetic::info("camera", 4)).unwrap();
        let intrinsics = |info: &CameraInfo| model_of(info, (4, 4), 0.001).map(|m| [m.fx, m.fy, m.cx, m.cy]);
        assert_eq!(intrinsics(&info), Some([5.0, 5.0, 1.5, 1.5]));
        info.p = [4.0, 0.0, 1.25, -0.2, 0.0, 4.5, 1.75, 0.0, 0.0, 0.0, 1.0, 0.0];
        assert_eq!(intrinsics(&info), Some([4.0, 4.5, 1.25, 1.75]));
        assert_eq!(model_of(&info, (4, 5), 0.001), None);
    }

    #[test]
    fn pictures_that_are_cropped_or_binned_have_their_share_of_the_whole_ones_intrinsics() {
        let whole = CameraInfo {
            width: 640,
            height: 480,
            k: [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0],
            ..CameraInfo::read(&synthetic::info("camera", 4)).unwrap()
        };
        let roi = RegionOfInterest { x_offset: 100, y_offset: 60, width: 400, height: 300, do_rectify: false };
        let intrinsics = |info: &CameraInfo, size| model_of(info, size, 0.001).map(|m| [m.fx, m.fy, m.cx, m.cy]);
        let cropped = CameraInfo { roi, ..whole.clone() };
        assert_eq!(intrinsics(&cropped, (400, 300)), Some([500.0, 510.0, 220.0, 180.0]));
        let binned = CameraInfo { binning_x: 2, binning_y: 4, ..whole.clone() };
        assert_eq!(intrinsics(&binned, (320, 120)), Some([250.0, 127.5, 160.0, 60.0]));
        let both = CameraInfo {
            roi,
            binning_x: 2,
            binning_y: 2,
            p: [400.0, 0.0, 310.0, 0.0, 0.0, 410.0, 250.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            ..whole
        };
        assert_eq!(intrinsics(&both, (200, 150)), Some([200.0, 205.0, 105.0, 95.0]));
        // What has the size that is told has the intrinsics that are told.
        assert_eq!(intrinsics(&both, (640, 480)), Some([400.0, 410.0, 310.0, 250.0]));
        assert_eq!(intrinsics(&both, (320, 240)), None);
    }

    #[test]
    fn every_encoding_gives_the_same_colors_and_depth_has_its_byte_order() {
        let image = |encoding: &str, pixel: &[u8], is_bigendian: u8| {
            // Two rows of one pixel, each followed by a byte of padding.
            let row = [pixel, &[99]].concat();
            let (step, data) = (row.len() as u32, row.repeat(2));
            RosImage {
                height: 2,
                width: 1,
                encoding: encoding.to_owned(),
                is_bigendian,
                step,
                data: data.into(),
                header: Header::default(),
            }
        };
        let colors: [(&str, &[u8], [u8; 3]); 8] = [
            ("rgb8", &[1, 2, 3], [1, 2, 3]),
            ("bgr8", &[3, 2, 1], [1, 2, 3]),
            ("8UC3", &[3, 2, 1], [1, 2, 3]),
            ("rgba8", &[1, 2, 3, 4], [1, 2, 3]),
            ("bgra8", &[3, 2, 1, 4], [1, 2, 3]),
            ("8UC4", &[3, 2, 1, 4], [1, 2, 3]),
            ("mono8", &[7], [7; 3]),
            ("8UC1", &[7], [7; 3]),
        ];
        for (encoding, pixel, expected) in colors {
            assert_eq!(color_of(&image(encoding, pixel, 0)), Ok(vec![expected; 2]), "{encoding}");
        }
        assert!(color_of(&image("yuv422", &[1, 2], 0)).is_err_and(|e| e.to_string().contains("yuv422")));
        for encoding in ["16UC1", "mono16"] {
            assert_eq!(depth_of_image(&image(encoding, &[1, 2], 0)), Ok((vec![0x0201; 2], 1e-3)));
            assert_eq!(depth_of_image(&image(encoding, &[1, 2], 1)), Ok((vec![0x0102; 2], 1e-3)));
        }
        for (metres, count) in [(1.5f32, 15_000), (f32::NAN, 0), (-1.0, 0), (f32::INFINITY, 0)] {
            assert_eq!(depth_of_image(&image("32FC1", &metres.to_be_bytes(), 1)), Ok((vec![count; 2], 1e-4)));
        }
        for (metres, count, unit_m) in [(6.5f32, 65_000, 1e-4), (8.0, 20_000, 4e-4), (30.0, 0, 1e-4)] {
            assert_eq!(depth_of_image(&image("32FC1", &metres.to_le_bytes(), 0)), Ok((vec![count; 2], unit_m)), "{metres} m");
        }
        let long = RosImage { width: u32::MAX, step: u32::MAX, height: u32::MAX, ..image("rgb8", &[1, 2, 3], 0) };
        assert!(matches!(color_of(&long), Err(MessageError::Short { .. })));
    }

    #[test]
    fn a_cloud_in_another_frame_than_the_cameras_is_refused() {
        let info = CameraInfo::read(&synthetic::info("camera", 40)).unwrap();
        let camera = model_of(&info, (40, 40), DEPTH_UNIT_M).unwrap();
        let optical = |row: u32, column: u32| {
            let slope = |at: u32| (f64::from(at) - 19.5) / 5.0;
            [slope(column) as f32, slope(row) as f32, 1.0f32]
        };
        let checked = |point: &dyn Fn(u32, u32) -> [f32; 3]| {
            let cloud = PointCloud2::read(&synthetic::cloud("any", 40, point)).unwrap();
            check_rays(&depth_of_cloud(&cloud).unwrap().sample, &camera)
        };
        assert_eq!(checked(&optical), Ok(()));
        assert_eq!(checked(&|_, _| [f32::NAN; 3]), Ok(()));
        // A robot's axes: x forward, y left, z up.
        let robots = |row: u32, column: u32| {
            let [x, y, z] = optical(row, column);
            [z, -x, -y]
        };
        assert!(matches!(checked(&robots), Err(MessageError::NotOptical { off_percent: 90.. })));
    }
}
