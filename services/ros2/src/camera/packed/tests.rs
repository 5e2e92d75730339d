//! Packed pictures against plain ones, and what is broken.

use std::io::Cursor;

use image::{ImageBuffer, Luma, Rgb};
use serde_bytes::ByteBuf;

use super::*;

const COUNTS: [u16; 4] = [0, 1000, 2000, 65_535];

fn png(picture: &DynamicImage) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).expect("a PNG");
    bytes.into_inner()
}

fn png_of(counts: &[u16]) -> Vec<u8> {
    let picture = ImageBuffer::<Luma<u16>, _>::from_raw(2, 2, counts.to_vec()).expect("a picture");
    png(&DynamicImage::ImageLuma16(picture))
}

fn rvl_of(counts: &[u16], width: u32, height: u32) -> Vec<u8> {
    [&width.to_le_bytes()[..], &height.to_le_bytes(), &rvl::pack(counts)].concat()
}

/// What image_transport puts before depth.
fn headed(a: f32, b: f32, packed: &[u8]) -> Vec<u8> {
    [&0i32.to_le_bytes()[..], &a.to_le_bytes(), &b.to_le_bytes(), packed].concat()
}

fn message(format: &str, data: Vec<u8>) -> CompressedImage {
    CompressedImage { format: format.to_owned(), data: ByteBuf::from(data), ..CompressedImage::default() }
}

/// A JPEG with a red left half and a blue right one, by libjpeg (Pillow, quality 90, 16 x 16).
const JPEG: &[u8] = include_bytes!("red_and_blue.jpg");

#[test]
fn depth_is_read_of_png_and_rvl_as_integers() {
    let (png, rvl) = (png_of(&COUNTS), rvl_of(&COUNTS, 2, 2));
    for (format, data) in [
        ("16UC1; compressedDepth png", headed(0.0, 0.0, &png)),
        ("16UC1; compressedDepth", headed(0.0, 0.0, &png)),
        ("16UC1", headed(0.0, 0.0, &png)),
        ("mono16; compressedDepth png", headed(0.0, 0.0, &png)),
        ("16UC1; png compressed ", png.clone()),
        ("16UC1; compressedDepth rvl", headed(0.0, 0.0, &rvl)),
    ] {
        let read = depth(&message(format, data)).expect(format);
        assert_eq!((read.width, read.height, read.unit_m, read.counts.as_slice()), (2, 2, 1e-3, COUNTS.as_slice()), "{format}");
    }
}

#[test]
fn floats_are_inverse_depths_by_the_numbers_in_the_header() {
    // As the publisher has it: depth_quantization 100, depth_max 10.
    let a = 100.0f32 * 101.0;
    let b = 1.0 - a / 10.0;
    let metres = [0.5f32, 1.0, 4.0];
    let inverse: Vec<u16> = [0].into_iter().chain(metres.iter().map(|m| (a / m + b) as u16)).collect();
    for (format, packed) in [("32FC1; compressedDepth png", png_of(&inverse)), ("32FC1; compressedDepth rvl", rvl_of(&inverse, 2, 2))] {
        let read = depth(&message(format, headed(a, b, &packed))).expect(format);
        assert_eq!((read.counts[0], read.unit_m), (0, 1e-4));
        for (count, m) in read.counts[1..].iter().zip(metres) {
            // One step of the quantization, which grows with the square of the depth.
            let step = f64::from(m * m / a);
            assert!((f64::from(*count) * 1e-4 - f64::from(m)).abs() <= step + 1e-4, "{count} is not {m} m");
        }
    }
    // What would be behind the camera, or is too far, is no reading.
    let far = depth(&message("32FC1; compressedDepth", headed(1000.0, 100.0, &png_of(&[99, 100, 101, 2100])))).expect("depth");
    assert_eq!(far.counts, [0, 0, 0, 5000]);
}

#[test]
fn depth_of_other_kinds_and_broken_depth_is_refused_by_name() {
    let rvl = rvl_of(&COUNTS, 2, 2);
    let cases = [
        ("16UC1; compressedDepth zstd", headed(0.0, 0.0, &rvl), "zstd"),
        ("8UC1; compressedDepth png", headed(0.0, 0.0, &png_of(&COUNTS)), "8UC1"),
        ("16UC1; jpeg compressed ", JPEG.to_vec(), "jpeg"),
        ("32FC1; png compressed ", png_of(&COUNTS), "32FC1"),
        ("32FC1; compressedDepth png", headed(f32::NAN, 0.0, &png_of(&COUNTS)), "depthQuantA"),
        ("16UC1; compressedDepth png", vec![0; 5], "12 bytes"),
        ("16UC1; compressedDepth png", headed(0.0, 0.0, &png_of(&COUNTS)[..40]), "PNG"),
        ("16UC1; compressedDepth png", headed(0.0, 0.0, JPEG), "PNG"),
        ("16UC1; compressedDepth rvl", headed(0.0, 0.0, &rvl[..8]), "0 of 4 pixels"),
        ("16UC1; compressedDepth rvl", headed(0.0, 0.0, &rvl[..6]), "8 bytes"),
        ("16UC1; compressedDepth rvl", headed(0.0, 0.0, &rvl_of(&COUNTS, u32::MAX, 2)), "4294967295 x 2"),
        ("16UC1; compressedDepth rvl", headed(0.0, 0.0, &rvl_of(&COUNTS, 0, 2)), "0 x 2"),
    ];
    for (format, data, words) in cases {
        let error = depth(&message(format, data)).expect_err(words).to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn color_is_read_of_jpeg_and_png_whatever_the_driver_calls_them() {
    let near = |pixel: [u8; 3], of: [u8; 3]| pixel.iter().zip(of).all(|(a, b)| a.abs_diff(b) <= 12);
    for format in ["rgb8; jpeg compressed bgr8", "bgra8; jpeg compressed bgr8", "jpeg", "mjpeg", "mono8; jpeg compressed "] {
        let read = color(&message(format, JPEG.to_vec())).expect(format);
        assert_eq!((read.width, read.height, read.pixels.len()), (16, 16, 256));
        assert!(near(read.pixels[0], [254, 0, 0]) && near(read.pixels[255], [0, 0, 254]), "{format}: {:?}", read.pixels[0]);
    }
    // Packed without being turned: red is where blue belongs.
    let turned = color(&message("rgb8; jpeg compressed ", JPEG.to_vec())).expect("a picture");
    assert!(near(turned.pixels[0], [0, 0, 254]));
    let picture = ImageBuffer::<Rgb<u8>, _>::from_raw(1, 2, vec![1u8, 2, 3, 4, 5, 6]).expect("a picture");
    let read = color(&message("bgr8; png compressed bgr8", png(&DynamicImage::ImageRgb8(picture)))).expect("color");
    assert_eq!((read.width, read.pixels), (1, vec![[1, 2, 3], [4, 5, 6]]));
    let gray = ImageBuffer::<Luma<u8>, _>::from_raw(1, 1, vec![9u8]).expect("a picture");
    assert_eq!(color(&message("mono8; png compressed ", png(&DynamicImage::ImageLuma8(gray)))).expect("color").pixels, [[9; 3]]);
}

#[test]
fn a_jpeg_that_is_cut_anywhere_is_refused_and_padding_is_not() {
    for cut in 1..JPEG.len() - 1 {
        let refused = color(&message("jpeg", JPEG[..cut].to_vec()));
        assert!(refused.is_err(), "{cut} of {} bytes are a picture", JPEG.len());
    }
    assert_eq!(color(&message("jpeg", [JPEG, &[0; 500]].concat())), color(&message("jpeg", JPEG.to_vec())));
    let error = color(&message("bgr8; h264", vec![0, 0, 0, 1])).unwrap_err().to_string();
    assert!(error.contains("h264") && error.contains("jpeg or png"), "{error}");
}

/// Seeded, so that it says the same each time.
#[test]
fn no_spoiled_byte_makes_a_decoder_panic() {
    let sources = [
        ("jpeg", JPEG.to_vec()),
        ("16UC1; compressedDepth rvl", headed(0.0, 0.0, &rvl_of(&COUNTS, 2, 2))),
        ("32FC1; compressedDepth png", headed(1000.0, 0.0, &png_of(&COUNTS))),
    ];
    let mut state = 11u32;
    let mut drawn = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let mut refused = 0;
    for (format, whole) in &sources {
        for _ in 0..4000 {
            let mut data = whole.clone();
            for _ in 0..=drawn(3) {
                let at = drawn(data.len());
                data[at] = drawn(256) as u8;
            }
            let spoiled = message(format, data);
            let is_refused = if *format == "jpeg" { color(&spoiled).is_err() } else { depth(&spoiled).is_err() };
            refused += usize::from(is_refused);
        }
    }
    assert!(refused > 3000, "{refused} of 12000");
}
