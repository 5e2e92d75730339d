//! A frame on disk: a folder with `depth.png` (16-bit), `camera.json` and, optionally, `color.png`, `labels.png` and `robot.json`.
//!
//! What is wrong is said with the file and, inside `camera.json` and `robot.json`, the field; all pictures must have the size that
//! `camera.json` states. `robot.json` is a [`RobotInView`], or a list of them.

use std::io::{BufReader, ErrorKind};
use std::path::{Path, PathBuf};

use image::{DynamicImage, ExtendedColorType, ImageError, ImageReader};
use repose_proto::{CallError, CameraModel, Frame, RobotInView, limits};

/// Why a folder is not a frame.
#[derive(Debug, thiserror::Error)]
pub enum FrameFolderError {
    /// A file that must be there is not, or cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// `camera.json` does not hold a camera, or `robot.json` no robot.
    #[error("{}: {error}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// The field at fault and why.
        error: CallError,
    },
    /// A picture is not a PNG that can be decoded or written.
    #[error("{}: {source}", path.display())]
    Png {
        /// The file.
        path: PathBuf,
        /// What the decoder says.
        source: ImageError,
    },
    /// A picture has another kind of pixel than its meaning needs.
    #[error("{}: expected {expected}, got {got}", path.display())]
    PixelKind {
        /// The file.
        path: PathBuf,
        /// The kinds that would do.
        expected: &'static str,
        /// The kind that came.
        got: String,
    },
    /// A picture's size is not the one that `camera.json` states.
    #[error("{}: {} x {} pixels, but camera.json says {} x {}", path.display(), got.0, got.1, expected.0, expected.1)]
    Size {
        /// The file.
        path: PathBuf,
        /// Columns and rows in `camera.json`.
        expected: (usize, usize),
        /// Columns and rows of the picture.
        got: (usize, usize),
    },
}

impl FrameFolderError {
    /// The file at fault.
    pub fn path(&self) -> &Path {
        match self {
            Self::File { path, .. }
            | Self::Json { path, .. }
            | Self::Png { path, .. }
            | Self::PixelKind { path, .. }
            | Self::Size { path, .. } => path,
        }
    }
}

/// Reads a frame folder. The camera is named after the folder, and the frame has no stamp.
///
/// # Errors
/// [`FrameFolderError`] names the file, and the field in `camera.json`.
pub fn read(folder: &Path) -> Result<Frame, FrameFolderError> {
    let camera = read_camera(&folder.join("camera.json"))?;
    let frame = read_pictures(camera, &folder.join("depth.png"), &folder.join("color.png"), &folder.join("labels.png"))?;
    Ok(Frame { camera_name: camera_name(folder), robots: read_robots(&folder.join("robot.json"))?, ..frame })
}

/// Reads a frame's pictures, of which color and labels may be absent. The camera's name is `folder`, and the frame has no stamp.
///
/// # Errors
/// [`FrameFolderError`] names the file.
pub fn read_pictures(camera: CameraModel, depth: &Path, color: &Path, labels: &Path) -> Result<Frame, FrameFolderError> {
    let size = (camera.width, camera.height);
    let depth = match decode(depth, size)? {
        DynamicImage::ImageLuma16(picture) => picture.into_raw(),
        other => return Err(pixel_kind(depth.to_owned(), "16-bit gray (depth counts)", &other)),
    };
    let color = optional(color.to_owned(), size)?
        .map(|(path, picture)| match picture {
            DynamicImage::ImageRgb8(picture) => Ok(picture.into_raw().as_chunks::<3>().0.to_vec()),
            other => Err(pixel_kind(path, "8-bit RGB", &other)),
        })
        .transpose()?;
    let labels = optional(labels.to_owned(), size)?
        .map(|(path, picture)| match picture {
            DynamicImage::ImageLuma16(picture) => Ok(picture.into_raw()),
            DynamicImage::ImageLuma8(picture) => Ok(picture.into_raw().into_iter().map(u16::from).collect()),
            other => Err(pixel_kind(path, "8- or 16-bit gray (instance ids)", &other)),
        })
        .transpose()?;
    Ok(Frame { color, labels, ..Frame::new("folder".to_owned(), 0, camera, depth) })
}

/// Writes a frame as a folder, which is made if it is not there.
///
/// # Errors
/// [`FrameFolderError`]; the frame must be valid ([`Frame::validate`]), which is reported against `camera.json`.
pub fn write(folder: &Path, frame: &Frame) -> Result<(), FrameFolderError> {
    let path = folder.join("camera.json");
    frame.validate().map_err(|error| FrameFolderError::Json { path: path.clone(), error })?;
    std::fs::create_dir_all(folder).map_err(|source| FrameFolderError::File { path: folder.to_owned(), source })?;
    let json = serde_json::to_string_pretty(&frame.camera)
        .map_err(|e| FrameFolderError::Json { path: path.clone(), error: CallError::internal(e.to_string()) })?;
    std::fs::write(&path, json).map_err(|source| FrameFolderError::File { path, source })?;
    let save = |name: &str, bytes: &[u8], color: ExtendedColorType| {
        let path = folder.join(name);
        image::save_buffer(&path, bytes, frame.camera.width as u32, frame.camera.height as u32, color)
            .map_err(|source| FrameFolderError::Png { path, source })
    };
    // The encoder takes 16-bit samples in the machine's byte order.
    let native = |values: &[u16]| values.iter().flat_map(|v| v.to_ne_bytes()).collect::<Vec<u8>>();
    save("depth.png", &native(&frame.depth), ExtendedColorType::L16)?;
    if let Some(color) = &frame.color {
        save("color.png", color.as_flattened(), ExtendedColorType::Rgb8)?;
    }
    if !frame.robots.is_empty() {
        let path = folder.join("robot.json");
        let json = serde_json::to_string_pretty(&frame.robots)
            .map_err(|e| FrameFolderError::Json { path: path.clone(), error: CallError::internal(e.to_string()) })?;
        std::fs::write(&path, json).map_err(|source| FrameFolderError::File { path, source })?;
    }
    if let Some(labels) = &frame.labels {
        save("labels.png", &native(labels), ExtendedColorType::L16)?;
    }
    Ok(())
}

/// Reads a `camera.json`.
///
/// # Errors
/// [`FrameFolderError::Json`] that names the field, [`FrameFolderError::File`] when there is none.
pub fn read_camera(path: &Path) -> Result<CameraModel, FrameFolderError> {
    let bytes = std::fs::read(path).map_err(|source| FrameFolderError::File { path: path.to_owned(), source })?;
    let wrong = |error| json(path, error);
    let camera: CameraModel = repose_proto::message::from_file_json(&bytes).map_err(wrong)?;
    camera.validate().map_err(wrong)?;
    Ok(camera)
}

/// What is wrong with a file of JSON. Where it is none, no field of it is at fault.
fn json(path: &Path, error: CallError) -> FrameFolderError {
    let field = error.field.filter(|field| field != "payload");
    FrameFolderError::Json { path: path.to_owned(), error: CallError { field, ..error } }
}

/// Reads a `robot.json`; no robots where there is none.
fn read_robots(path: &Path) -> Result<Vec<RobotInView>, FrameFolderError> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(source) if source.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(FrameFolderError::File { path: path.to_owned(), source }),
    };
    let wrong = |error| json(path, error);
    let is_list = bytes.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[');
    let read = |bytes| {
        if is_list { repose_proto::message::from_json(bytes) } else { repose_proto::message::from_json(bytes).map(|robot| vec![robot]) }
    };
    let robots: Vec<RobotInView> = read(&bytes).map_err(wrong)?;
    for (i, robot) in robots.iter().enumerate() {
        robot.validate(&format!("[{i}]")).map_err(wrong)?;
    }
    Ok(robots)
}

/// A picture that may be absent.
fn optional(path: PathBuf, size: (usize, usize)) -> Result<Option<(PathBuf, DynamicImage)>, FrameFolderError> {
    match decode(&path, size) {
        Ok(picture) => Ok(Some((path, picture))),
        Err(FrameFolderError::File { source, .. }) if source.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

fn decode(path: &Path, expected: (usize, usize)) -> Result<DynamicImage, FrameFolderError> {
    let file = std::fs::File::open(path).map_err(|source| FrameFolderError::File { path: path.to_owned(), source })?;
    let mut reader = ImageReader::with_format(BufReader::new(file), image::ImageFormat::Png);
    let mut bounds = image::Limits::default();
    bounds.max_image_width = Some(limits::MAX_IMAGE_SIDE as u32);
    bounds.max_image_height = Some(limits::MAX_IMAGE_SIDE as u32);
    reader.limits(bounds);
    let picture = reader.decode().map_err(|source| FrameFolderError::Png { path: path.to_owned(), source })?;
    let got = (picture.width() as usize, picture.height() as usize);
    if got != expected {
        return Err(FrameFolderError::Size { path: path.to_owned(), expected, got });
    }
    Ok(picture)
}

fn pixel_kind(path: PathBuf, expected: &'static str, got: &DynamicImage) -> FrameFolderError {
    let got = match got {
        DynamicImage::ImageLuma8(_) => "8-bit gray".to_owned(),
        DynamicImage::ImageLuma16(_) => "16-bit gray".to_owned(),
        DynamicImage::ImageRgb8(_) => "8-bit RGB (or a palette)".to_owned(),
        DynamicImage::ImageRgba8(_) => "8-bit RGB with transparency".to_owned(),
        other => format!("{:?}", other.color()),
    };
    FrameFolderError::PixelKind { path, expected, got }
}

/// The folder's name as a chunk of a key: lower case, anything else than letters, digits, `_` and `-` replaced.
fn camera_name(folder: &Path) -> String {
    let name = folder.file_name().map(|n| n.to_string_lossy().to_lowercase()).unwrap_or_default();
    let chunk: String = name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' }).take(64).collect();
    let chunk = chunk.trim_start_matches(['-', '_']);
    if chunk.is_empty() { "folder".to_owned() } else { chunk.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_proto::RigidTransform;
    use tempfile::TempDir;

    fn frame() -> Frame {
        let camera = CameraModel {
            width: 4,
            height: 3,
            fx: 5.0,
            fy: 5.0,
            cx: 1.5,
            cy: 1.0,
            depth_unit_m: 0.001,
            world_from_camera: Some(RigidTransform::IDENTITY),
        };
        let depth = (0..12).map(|i| i * 5000).collect();
        let color = Some((0..12).map(|i| [i, 2 * i, 255 - i]).collect());
        Frame { color, labels: Some((0..12).map(|i| i * 300).collect()), ..Frame::new("folder".to_owned(), 0, camera, depth) }
    }

    fn written() -> TempDir {
        let folder = tempfile::Builder::new().prefix("folder").tempdir().unwrap();
        write(folder.path(), &frame()).unwrap();
        folder
    }

    /// The error's text after `spoil` changed the folder.
    fn error_after(spoil: impl FnOnce(&Path)) -> String {
        let folder = written();
        spoil(folder.path());
        read(folder.path()).unwrap_err().to_string()
    }

    fn with_camera(from: &str, to: &str) -> String {
        error_after(|folder| {
            let path = folder.join("camera.json");
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(text.contains(from), "{text}");
            std::fs::write(path, text.replacen(from, to, 1)).unwrap();
        })
    }

    #[test]
    fn what_was_written_is_read() {
        let folder = written();
        let back = read(folder.path()).unwrap();
        assert_eq!(back, Frame { camera_name: back.camera_name.clone(), ..frame() });
        assert!(back.camera_name.starts_with("folder"));
    }

    #[test]
    fn color_and_labels_may_be_absent_but_depth_may_not() {
        let folder = written();
        std::fs::remove_file(folder.path().join("color.png")).unwrap();
        std::fs::remove_file(folder.path().join("labels.png")).unwrap();
        let back = read(folder.path()).unwrap();
        assert!(back.color.is_none() && back.labels.is_none());
        assert!(error_after(|f| std::fs::remove_file(f.join("depth.png")).unwrap()).contains("depth.png"));
        assert!(error_after(|f| std::fs::remove_file(f.join("camera.json")).unwrap()).contains("camera.json"));
    }

    #[test]
    fn robots_are_a_list_or_a_single_one_and_a_wrong_one_is_named() {
        let pose = serde_json::to_string(&RigidTransform::IDENTITY).unwrap();
        let robot = |width: &str| {
            format!(r#"{{"name": "left", "joints_rad": [0, 0, 0, -2, 0, 2, 0], "gripper_width_m": {width}, "world_from_base": {pose}}}"#)
        };
        let read_with = |text: String| {
            let folder = written();
            std::fs::write(folder.path().join("robot.json"), text).unwrap();
            read(folder.path())
        };
        let single = read_with(robot("0.04")).unwrap().robots;
        assert_eq!((single.len(), single[0].model.as_str(), single[0].holding), (1, "panda", None));
        assert_eq!(read_with(format!(" [{}]", robot("0.04"))).unwrap().robots, single);
        let text = read_with(robot("4")).unwrap_err().to_string();
        assert!(text.contains("robot.json") && text.contains("gripper_width_m"), "{text}");
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &Frame { robots: single.clone(), ..frame() }).unwrap();
        assert_eq!(read(folder.path()).unwrap().robots, single);
    }

    #[test]
    fn a_picture_of_another_size_is_named() {
        for name in ["depth.png", "labels.png"] {
            let text = error_after(|f| image::GrayImage::new(3, 4).save(f.join(name)).unwrap());
            assert!(text.contains(name) && text.contains("3 x 4") && text.contains("4 x 3"), "{text}");
        }
        assert!(error_after(|f| image::RgbImage::new(8, 6).save(f.join("color.png")).unwrap()).contains("color.png"));
    }

    #[test]
    fn pixels_of_the_wrong_kind_are_refused() {
        let text = error_after(|f| image::GrayImage::new(4, 3).save(f.join("depth.png")).unwrap());
        assert!(text.contains("expected 16-bit gray") && text.contains("got 8-bit gray"), "{text}");
        assert!(error_after(|f| image::GrayImage::new(4, 3).save(f.join("color.png")).unwrap()).contains("8-bit RGB"));
        assert!(error_after(|f| image::RgbImage::new(4, 3).save(f.join("labels.png")).unwrap()).contains("instance ids"));
        assert!(error_after(|f| std::fs::write(f.join("depth.png"), b"no picture").unwrap()).contains("depth.png"));
    }

    #[test]
    fn a_wrong_field_of_the_camera_is_named() {
        for (from, to, field) in [
            ("\"fx\": 5.0", "\"fx\": 0.0", "fx"),
            ("\"fy\": 5.0", "\"fy\": -1", "fy"),
            ("\"cx\": 1.5", "\"cx\": null", "cx"),
            ("\"depth_unit_m\": 0.001", "\"depth_unit_m\": 0", "depth_unit_m"),
            ("\"width\": 4", "\"width\": 0", "width"),
            ("\"width\": 4", "\"width\": 400000", "width"),
            ("\"width\": 4", "\"wide\": 4", "width"),
            ("\"width\": 4", "\"lens\": 1, \"width\": 4", "lens"),
        ] {
            let text = with_camera(from, to);
            assert!(text.contains("camera.json") && text.contains(field), "{text}");
        }
        assert!(with_camera("[\n    1.0,", "[2.0,").contains("world_from_camera"));
    }

    #[test]
    fn folders_with_odd_names_still_name_a_camera() {
        for (folder, name) in [("/a/learn7", "learn7"), ("/a/My Frame.1", "my-frame-1"), ("/", "folder"), ("/a/__x", "x")] {
            assert_eq!(camera_name(Path::new(folder)), name);
        }
    }
}
