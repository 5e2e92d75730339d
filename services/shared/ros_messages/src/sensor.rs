//! `sensor_msgs`: what a depth camera's driver and a robot's publish.

use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use crate::cdr::{MessageError, decode};
use crate::common::Header;

/// The kinds of numbers that a `sensor_msgs/msg/PointField` may have.
pub mod datatype {
    /// 16-bit counts.
    pub const UINT16: u8 = 4;
    /// 32-bit floats.
    pub const FLOAT32: u8 = 7;
}

use datatype::FLOAT32;

/// `sensor_msgs/msg/Image`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RosImage {
    /// When and from where.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// What a pixel is, such as `rgb8` or `16UC1`.
    pub encoding: String,
    /// Byte order of pixels wider than a byte.
    pub is_bigendian: u8,
    /// Bytes from one row to the next.
    pub step: u32,
    /// The pixels.
    pub data: ByteBuf,
}

/// `sensor_msgs/msg/RegionOfInterest`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// First column.
    pub x_offset: u32,
    /// First row.
    pub y_offset: u32,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Whether it should be rectified.
    pub do_rectify: bool,
}

/// `sensor_msgs/msg/CameraInfo`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// When and from where.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// The lens model.
    pub distortion_model: String,
    /// Its parameters.
    pub d: Vec<f64>,
    /// Intrinsics, row by row: fx 0 cx, 0 fy cy, 0 0 1.
    pub k: [f64; 9],
    /// Rectification.
    pub r: [f64; 9],
    /// Projection.
    pub p: [f64; 12],
    /// Columns binned together.
    pub binning_x: u32,
    /// Rows binned together.
    pub binning_y: u32,
    /// The part of the sensor in use.
    pub roi: RegionOfInterest,
}

/// `sensor_msgs/msg/CompressedImage`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompressedImage {
    /// When and from where.
    pub header: Header,
    /// What the pixels were, and what they are packed as.
    pub format: String,
    /// The packed picture.
    pub data: ByteBuf,
}

/// `sensor_msgs/msg/JointState`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// When.
    pub header: Header,
    /// The joints.
    pub name: Vec<String>,
    /// Radians, or metres.
    pub position: Vec<f64>,
    /// The same per second; may be empty.
    pub velocity: Vec<f64>,
    /// Newton metres, or newtons; may be empty.
    pub effort: Vec<f64>,
}

/// `sensor_msgs/msg/PointField`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointField {
    /// What it is.
    pub name: String,
    /// Bytes from the point's first.
    pub offset: u32,
    /// The kind of number.
    pub datatype: u8,
    /// How many of them.
    pub count: u32,
}

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointCloud2 {
    /// When and from where.
    pub header: Header,
    /// Rows; 1 for a cloud that is no picture.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// What a point holds.
    pub fields: Vec<PointField>,
    /// Byte order of the data.
    pub is_bigendian: bool,
    /// Bytes from one point to the next; padding is allowed.
    pub point_step: u32,
    /// Bytes from one row to the next; padding is allowed.
    pub row_step: u32,
    /// The points.
    pub data: ByteBuf,
    /// Whether every point is finite.
    pub is_dense: bool,
}

/// A point of a cloud: coordinates in the camera frame, metres, NaN where there is none, and its color where the cloud has any.
pub type ColoredPoint = ([f32; 3], Option<[u8; 3]>);

impl RosImage {
    /// Reads a message.
    ///
    /// # Errors
    /// [`MessageError`] when the bytes are no image, or hold fewer rows than they say.
    pub fn read(bytes: &[u8]) -> Result<Self, MessageError> {
        let image: Self = decode(bytes, "sensor_msgs/msg/Image")?;
        check_length("sensor_msgs/msg/Image", image.height, image.step, image.data.len())?;
        Ok(image)
    }

    /// The rows' pixels, `bytes_per_pixel` each, padding left out.
    ///
    /// # Errors
    /// [`MessageError::Short`] when a row is shorter than its pixels, or there are fewer rows than it says.
    pub fn rows(&self, bytes_per_pixel: usize) -> Result<impl Iterator<Item = &[u8]>, MessageError> {
        let (row, step) = (self.width as usize * bytes_per_pixel, self.step as usize);
        if row > step || row == 0 {
            return Err(MessageError::Short { message: "sensor_msgs/msg/Image", expected: row.max(1), got: step });
        }
        check_length("sensor_msgs/msg/Image", self.height, self.step, self.data.len())?;
        Ok(self.data.chunks_exact(step).take(self.height as usize).map(move |chunk| &chunk[..row]))
    }
}

impl CameraInfo {
    /// Reads a message.
    ///
    /// # Errors
    /// [`MessageError`] when the bytes are none.
    pub fn read(bytes: &[u8]) -> Result<Self, MessageError> {
        decode(bytes, "sensor_msgs/msg/CameraInfo")
    }
}

impl PointCloud2 {
    /// Reads a message.
    ///
    /// # Errors
    /// [`MessageError`] when the bytes are no cloud, or hold fewer rows than they say.
    pub fn read(bytes: &[u8]) -> Result<Self, MessageError> {
        let cloud: Self = decode(bytes, "sensor_msgs/msg/PointCloud2")?;
        cloud.check_sizes()?;
        Ok(cloud)
    }

    /// Checks that its rows hold their points, and its data the rows.
    fn check_sizes(&self) -> Result<(), MessageError> {
        check_length("sensor_msgs/msg/PointCloud2", self.height, self.row_step, self.data.len())?;
        let row = u64::from(self.width) * u64::from(self.point_step);
        if row > u64::from(self.row_step) || row == 0 {
            let expected = usize::try_from(row.max(1)).unwrap_or(usize::MAX);
            return Err(MessageError::Short { message: "sensor_msgs/msg/PointCloud2", expected, got: self.row_step as usize });
        }
        Ok(())
    }

    /// Every point, row by row.
    ///
    /// # Errors
    /// [`MessageError::Unsupported`] when x, y or z are missing or no 32-bit floats, or lie outside a point; [`MessageError::Short`] when there
    /// is less than the sizes say.
    pub fn points(&self) -> Result<impl Iterator<Item = ColoredPoint> + '_, MessageError> {
        self.check_sizes()?;
        let step = self.point_step as usize;
        let [x, y, z] = [self.offset("x")?, self.offset("y")?, self.offset("z")?];
        let rgb = self.fields.iter().find(|f| f.name == "rgb" || f.name == "rgba").map(|f| f.offset as usize).filter(|at| at + 4 <= step);
        let word = move |point: &[u8], at: usize| {
            let bytes = [point[at], point[at + 1], point[at + 2], point[at + 3]];
            if self.is_bigendian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
        };
        let rows = self.data.chunks_exact(self.row_step as usize).take(self.height as usize);
        let points = rows.flat_map(move |row| row.chunks_exact(step).take(self.width as usize));
        Ok(points.map(move |point| {
            let color = rgb.map(|at| {
                // Red, green and blue from the third byte down, whatever the number's type says.
                let [_, red, green, blue] = word(point, at).to_be_bytes();
                [red, green, blue]
            });
            ([x, y, z].map(|at| f32::from_bits(word(point, at))), color)
        }))
    }

    /// Where a coordinate lies in a point.
    fn offset(&self, name: &'static str) -> Result<usize, MessageError> {
        let unsupported = |got: String| MessageError::Unsupported { field: name, got, expected: "a FLOAT32 inside the point" };
        let field = self.fields.iter().find(|f| f.name == name).ok_or_else(|| unsupported("a cloud without it".to_owned()))?;
        let fits = u64::from(field.offset) + 4 <= u64::from(self.point_step);
        if field.datatype != FLOAT32 || !fits {
            return Err(unsupported(format!("type {} at byte {} of {}", field.datatype, field.offset, self.point_step)));
        }
        Ok(field.offset as usize)
    }
}

fn check_length(message: &'static str, rows: u32, step: u32, got: usize) -> Result<(), MessageError> {
    let expected = usize::try_from(u64::from(rows) * u64::from(step)).unwrap_or(usize::MAX);
    if got < expected { Err(MessageError::Short { message, expected, got }) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::CdrWriter;
    use proptest::prelude::*;

    /// An image of 2 x 2 16-bit pixels in rows of 6 bytes.
    fn image(data: &[u8]) -> Vec<u8> {
        let mut writer = CdrWriter::default();
        writer.u32(7).u32(5).text("cam").u32(2).u32(2).text("16UC1").put(&[0]).u32(6).bytes(data);
        writer.message()
    }

    /// A cloud of one row of two points of 20 bytes: x, y, z, 4 bytes of padding, rgb.
    fn cloud(datatype: u8, z_offset: u32, width: u32) -> Vec<u8> {
        let mut writer = CdrWriter::default();
        writer.u32(7).u32(5).text("cam").u32(1).u32(width).u32(4);
        for (name, offset) in [("x", 0), ("y", 4), ("z", z_offset), ("rgb", 16)] {
            writer.text(name).u32(offset).put(&[datatype]).u32(1);
        }
        let mut data = Vec::new();
        for point in [[1.0f32, 2.0, 3.0], [f32::NAN; 3]] {
            data.extend(point.iter().flat_map(|c| c.to_le_bytes()).chain([9; 4]).chain([30, 20, 10, 0]));
        }
        writer.put(&[0]).u32(20).u32(40).bytes(&data).put(&[0]);
        writer.message()
    }

    #[test]
    fn an_image_is_read_row_by_row_without_its_padding() {
        let image = RosImage::read(&image(&[1, 2, 3, 4, 9, 9, 5, 6, 7, 8, 9, 9])).unwrap();
        assert_eq!((image.header.stamp.as_ns(), image.header.frame_id.as_str()), (7_000_000_005, "cam"));
        let rows: Vec<&[u8]> = image.rows(2).unwrap().collect();
        assert_eq!(rows, [[1, 2, 3, 4], [5, 6, 7, 8]]);
        assert!(matches!(image.rows(4), Err(MessageError::Short { expected: 8, got: 6, .. })));
    }

    #[test]
    fn a_cloud_is_read_past_padding_and_holes() {
        let cloud = PointCloud2::read(&cloud(FLOAT32, 8, 2)).unwrap();
        let points: Vec<ColoredPoint> = cloud.points().unwrap().collect();
        assert_eq!(points[0], ([1.0, 2.0, 3.0], Some([10, 20, 30])));
        assert!(points[1].0.iter().all(|c| c.is_nan()) && points.len() == 2);
    }

    #[test]
    fn what_a_message_promises_and_does_not_hold_is_said() {
        assert!(matches!(RosImage::read(&image(&[1, 2, 3])), Err(MessageError::Short { expected: 12, got: 3, .. })));
        assert!(matches!(PointCloud2::read(&cloud(FLOAT32, 8, 3)), Err(MessageError::Short { expected: 60, got: 40, .. })));
        for (datatype, z_offset) in [(8, 8), (FLOAT32, 17), (FLOAT32, u32::MAX)] {
            let cloud = PointCloud2::read(&cloud(datatype, z_offset, 2)).unwrap();
            assert!(matches!(cloud.points().err(), Some(MessageError::Unsupported { .. })));
        }
        assert!(matches!(RosImage::read(&[0, 7, 0, 0, 1]), Err(MessageError::Encapsulation { .. })));
        assert!(matches!(CameraInfo::read(&image(&[0; 12])), Err(MessageError::Body { .. })));
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), cut in 0usize..120, at in 0usize..120, with: u8) {
            let _ = RosImage::read(&bytes);
            let mut spoiled = cloud(FLOAT32, 8, 2);
            spoiled.truncate(spoiled.len() - cut);
            if let Some(byte) = spoiled.get_mut(at) {
                *byte = with;
            }
            // Also where nobody has checked the sizes, as in what comes live.
            if let Ok(cloud) = decode::<PointCloud2>(&spoiled, "sensor_msgs/msg/PointCloud2")
                && let Ok(points) = cloud.points()
            {
                prop_assert!(points.count() <= 1 << 20);
            }
            let _ = CameraInfo::read(&spoiled);
        }
    }
}
