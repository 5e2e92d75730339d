//! Contact sheets: pictures of scenes with what is said of them, for people to look at.
//!
//! A plate that stands on its rim or a mug inside a bowl's wall is a bug in the world that no metric shows. A [`tile`] is one row of
//! pictures with text beside them, made from anything; [`scene_tile`](mod@scene_tile) is the tile of a scene: color, depth as the sensor has it, labels
//! with ids, and the relations that hold. Tiles are [`stacked`] to sheets. Everything is in memory; who calls writes the files.

pub mod scene_tile;
pub mod words;

use repose_geometry::Image;
use repose_pictures::colors::PAPER;
use repose_pictures::drawing::{GLYPH_WIDTH, LINE_HEIGHT, blit, filled_around, scaled_to_width, wrapped, write_lines};

pub use repose_pictures::Rgb;
pub use scene_tile::scene_tile;

/// Measures of a tile, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SheetSettings {
    /// Width of a whole tile. Default 1600; wider leaves more room for text.
    pub width: usize,
    /// Width that every picture is scaled to. Default 400; larger shows more and leaves less room for text.
    pub picture_width: usize,
    /// Space around pictures and text. Default 6.
    pub gap: usize,
}

impl Default for SheetSettings {
    fn default() -> Self {
        Self { width: 1600, picture_width: 400, gap: 6 }
    }
}

/// One row: pictures from left to right, each scaled to the same width, then a title and lines of text, which wrap.
pub fn tile(pictures: &[Image<Rgb>], title: &str, lines: &[String], settings: &SheetSettings) -> Image<Rgb> {
    let gap = settings.gap;
    let pictures: Vec<_> = pictures.iter().map(|p| scaled_to_width(p, settings.picture_width)).collect();
    let text_left = gap + pictures.iter().map(|p| p.width() + gap).sum::<usize>();
    let columns = settings.width.saturating_sub(text_left + gap) / GLYPH_WIDTH;
    let lines: Vec<String> = lines.iter().flat_map(|line| wrapped(line, columns)).collect();
    let text_height = (lines.len() + 1) * LINE_HEIGHT;
    let height = pictures.iter().map(Image::height).max().unwrap_or(0).max(text_height) + 2 * gap;
    let mut row = Image::filled(settings.width, height, PAPER);
    let mut left = gap;
    for picture in &pictures {
        blit(&mut row, picture, left, gap);
        left += picture.width() + gap;
    }
    write_lines(&mut row, text_left, gap, title, &lines);
    row
}

/// Rows under each other on one sheet; narrower ones are filled up with paper.
pub fn stacked(rows: &[Image<Rgb>]) -> Image<Rgb> {
    let width = rows.iter().map(Image::width).max().unwrap_or(0);
    let pixels = rows.iter().flat_map(|row| filled_around(row, width)).collect::<Vec<_>>();
    let height = pixels.len() / width.max(1);
    Image::from_pixels(width, height, pixels).unwrap_or_else(|_| Image::filled(0, 0, PAPER))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_grows_with_its_text_and_keeps_its_width() {
        let picture = Image::filled(640, 480, [10, 20, 30]);
        let settings = SheetSettings::default();
        let short = tile(&[picture.clone(), picture.clone()], "title", &[], &settings);
        assert_eq!((short.width(), short.height()), (1600, 300 + 12));
        assert_eq!(short[(6, 6)], [10, 20, 30]);
        assert_eq!(short[(6 + 400, 6)], PAPER, "the gap between pictures");
        let long = tile(&[picture], "title", &vec!["a line".to_owned(); 40], &settings);
        assert_eq!((long.width(), long.height()), (1600, 41 * LINE_HEIGHT + 12));
    }

    #[test]
    fn a_sheet_is_as_wide_as_its_widest_row_and_as_high_as_all() {
        let sheet = stacked(&[Image::filled(4, 2, [1; 3]), Image::filled(6, 3, [2; 3])]);
        assert_eq!((sheet.width(), sheet.height()), (6, 5));
        assert_eq!((sheet[(3, 1)], sheet[(4, 1)], sheet[(5, 4)]), ([1; 3], PAPER, [2; 3]));
        assert_eq!(stacked(&[]).pixels().len(), 0);
    }
}
