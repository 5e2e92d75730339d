//! A short film as numbered pictures and as one animated PNG, small enough for a page.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use image::{RgbImage, imageops};
use png::{BitDepth, BlendOp, ColorType, DisposeOp, Encoder, EncodingError};
use repose_local::picture::captioned;

use crate::failure::Failure;

/// Width of the film, pixels.
const WIDTH: u32 = 480;
/// The most pictures that follow each other: of a longer run every second one is shown, or every fourth, each for as much longer.
const MOST: usize = 240;
/// Channels differ by less than this from picture to picture by the camera's noise alone.
const NOISE: u8 = 20;
/// Channels are rounded to multiples of this: half the bytes, and nobody sees it.
const STEP: u8 = 8;

/// A picture of a film.
#[derive(Debug)]
struct Shot {
    picture: RgbImage,
    /// How long it is shown, milliseconds.
    ms: u16,
    /// Whether it is one of many that follow each other, and may make room for others.
    is_moving: bool,
}

/// A film that is being shot.
#[derive(Debug)]
pub struct Film {
    /// Pictures of one size.
    shots: Vec<Shot>,
    /// Of so many pictures that follow each other one is kept.
    every: u16,
    /// Those of them that came.
    moving: u64,
    /// Those of them that may be kept.
    most: usize,
}

impl Default for Film {
    fn default() -> Self {
        Self { shots: Vec::new(), every: 1, moving: 0, most: MOST }
    }
}

impl Film {
    /// Adds a picture by itself, shown for `ms`.
    pub fn add(&mut self, picture: &RgbImage, caption: &str, ms: u16) {
        self.keep(picture, caption, ms, false);
    }

    /// Adds one of many pictures that follow each other, `ms` apart. However many come, the film is of all that time: it gets coarser, and not cut
    /// short.
    pub fn add_moving(&mut self, picture: &RgbImage, caption: &str, ms: u16) {
        if self.shots.iter().filter(|shot| shot.is_moving).count() >= self.most {
            self.every = self.every.saturating_mul(2);
            let mut number = 0;
            self.shots.retain_mut(|shot| {
                number += usize::from(shot.is_moving);
                shot.ms = if shot.is_moving { shot.ms.saturating_mul(2) } else { shot.ms };
                !shot.is_moving || number % 2 == 1
            });
        }
        if self.moving.is_multiple_of(u64::from(self.every)) {
            self.keep(picture, caption, ms.saturating_mul(self.every), true);
        }
        self.moving += 1;
    }

    fn keep(&mut self, picture: &RgbImage, caption: &str, ms: u16, is_moving: bool) {
        let height = (picture.height() * WIDTH).div_ceil(picture.width());
        let small = imageops::resize(picture, WIDTH, height, imageops::FilterType::Triangle);
        let mut picture = captioned(&small, caption);
        picture.iter_mut().for_each(|channel| *channel = rounded(*channel));
        if let Some(Shot { picture: first, .. }) = self.shots.first().filter(|first| first.picture.dimensions() != picture.dimensions()) {
            picture = imageops::resize(&picture, first.width(), first.height(), imageops::FilterType::Triangle);
        }
        self.shots.push(Shot { picture, ms, is_moving });
    }

    /// Writes `frame-001.png`, … and `film.png` into a folder; returns the film's path and size, bytes.
    ///
    /// # Errors
    /// When a file cannot be written, or there is no picture.
    pub fn write(&self, folder: &Path) -> Result<(PathBuf, u64), Failure> {
        let bad = |e: &dyn std::fmt::Display| Failure::bad_input(&folder.display().to_string(), e);
        std::fs::create_dir_all(folder).map_err(|e| bad(&e))?;
        for (k, shot) in self.shots.iter().enumerate() {
            shot.picture.save(folder.join(format!("frame-{:03}.png", k + 1))).map_err(|e| bad(&e))?;
        }
        let path = folder.join("film.png");
        let file = BufWriter::new(File::create(&path).map_err(|e| bad(&e))?);
        self.animate(file).map_err(|e| bad(&e))?;
        let bytes = std::fs::metadata(&path).map_err(|e| bad(&e))?.len();
        Ok((path, bytes))
    }

    /// One animated PNG: of each picture only what has changed, the rest transparent over what was shown before.
    fn animate(&self, out: impl std::io::Write) -> Result<(), EncodingError> {
        let Some(Shot { picture: first, .. }) = self.shots.first() else {
            return Err(EncodingError::IoError(std::io::Error::other("a film without a picture")));
        };
        let mut encoder = Encoder::new(out, first.width(), first.height());
        encoder.set_color(ColorType::Rgba);
        encoder.set_depth(BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        encoder.set_animated(self.shots.len() as u32, 0)?;
        encoder.set_blend_op(BlendOp::Over)?;
        encoder.set_dispose_op(DisposeOp::None)?;
        let mut writer = encoder.write_header()?;
        // What a viewer shows so far: noise that is left out does not add up.
        let mut shown: Option<RgbImage> = None;
        for Shot { picture, ms, .. } in &self.shots {
            let changed = changes(shown.as_ref(), picture);
            writer.set_frame_delay(*ms, 1000)?;
            writer.write_image_data(&changed)?;
            let mut now = shown.take().unwrap_or_else(|| picture.clone());
            for (pixel, changed) in now.pixels_mut().zip(changed.as_chunks::<4>().0) {
                if changed[3] > 0 {
                    pixel.0 = [changed[0], changed[1], changed[2]];
                }
            }
            shown = Some(now);
        }
        writer.finish()
    }
}

fn rounded(channel: u8) -> u8 {
    channel.saturating_add(STEP / 2) / STEP * STEP
}

/// RGBA of the pixels that clearly differ from what is shown; the others are transparent black.
fn changes(shown: Option<&RgbImage>, picture: &RgbImage) -> Vec<u8> {
    let mut rgba = Vec::with_capacity(picture.len() / 3 * 4);
    for (k, pixel) in picture.pixels().enumerate() {
        let before = shown.map(|shown| shown.get_pixel(k as u32 % picture.width(), k as u32 / picture.width()));
        let is_same = before.is_some_and(|before| before.0.iter().zip(pixel.0).all(|(a, b)| a.abs_diff(b) <= NOISE));
        rgba.extend_from_slice(&if is_same { [0; 4] } else { [pixel.0[0], pixel.0[1], pixel.0[2], 255] });
    }
    rgba
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    #[test]
    fn a_film_is_animated_and_its_still_parts_cost_little() {
        let folder = tempfile::tempdir().expect("a folder");
        let noisy = |k: u32| RgbImage::from_fn(640, 480, |u, v| Rgb([((u * 7 + v * 13) % 200) as u8 + (u * v + k) as u8 % 4, 90, 120]));
        let mut film = Film::default();
        (0..20).for_each(|k| film.add(&noisy(k), "still", 100));
        let (still, still_bytes) = film.write(folder.path()).expect("written");
        let reader = png::Decoder::new(std::io::BufReader::new(File::open(&still).expect("the film"))).read_info().expect("a PNG");
        let animation = reader.info().animation_control().expect("it is animated");
        assert_eq!((animation.num_frames, animation.num_plays), (20, 0));
        assert!(folder.path().join("frame-020.png").exists() && !folder.path().join("frame-021.png").exists());
        let mut one = Film::default();
        one.add(&noisy(0), "still", 100);
        let (_, one_bytes) = one.write(folder.path()).expect("written");
        assert!((still_bytes - one_bytes) / 19 < one_bytes / 4, "{still_bytes} bytes of 20 pictures, {one_bytes} of one");
        assert!(Film::default().write(folder.path()).is_err(), "nothing to show");
    }

    #[test]
    fn a_long_run_is_shown_to_its_end_with_fewer_pictures_of_it() {
        let picture = RgbImage::new(64, 48);
        let mut film = Film { most: 4, ..Film::default() };
        film.add(&picture, "before", 1500);
        for k in 0..19 {
            film.add_moving(&picture, &k.to_string(), 100);
        }
        film.add(&picture, "done", 1500);
        let shown: Vec<u16> = film.shots.iter().map(|shot| shot.ms).collect();
        // Of 19 pictures those of numbers 0, 8 and 16, each for what eight of them take.
        assert_eq!(shown, [1500, 800, 800, 800, 1500]);
    }
}
