//! Copying, scaling and text on pictures.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use repose_geometry::Image;

use crate::Rgb;
use crate::colors::{INK, PAPER};

const SIZE: RasterHeight = RasterHeight::Size16;
/// Columns that a character takes.
pub const GLYPH_WIDTH: usize = get_raster_width(FontWeight::Regular, SIZE);
/// Rows that a character takes.
pub const GLYPH_HEIGHT: usize = SIZE.val();
/// Rows from one line of text to the next.
pub const LINE_HEIGHT: usize = GLYPH_HEIGHT + 1;

/// Calls `put(x, y, coverage)` for every pixel that text covers, from 0 to 255; the text's upper left corner is (0, 0). Characters
/// beyond ASCII are question marks.
pub fn rasterised(text: &str, is_bold: bool, mut put: impl FnMut(usize, usize, u8)) {
    let weight = if is_bold { FontWeight::Bold } else { FontWeight::Regular };
    for (k, character) in text.chars().enumerate() {
        let Some(glyph) = get_raster(character, weight, SIZE).or_else(|| get_raster('?', weight, SIZE)) else { continue };
        for (y, row) in glyph.raster().iter().enumerate() {
            for (x, coverage) in row.iter().enumerate().filter(|(_, coverage)| **coverage > 0) {
                put(k * GLYPH_WIDTH + x, y, *coverage);
            }
        }
    }
}

/// Copies a picture onto another; what lies outside is left out.
pub fn blit(onto: &mut Image<Rgb>, picture: &Image<Rgb>, left: usize, top: usize) {
    let columns = picture.width().min(onto.width().saturating_sub(left));
    let width = onto.width();
    for y in 0..picture.height().min(onto.height().saturating_sub(top)) {
        let from = &picture.pixels()[y * picture.width()..][..columns];
        onto.pixels_mut()[(top + y) * width + left..][..columns].copy_from_slice(from);
    }
}

/// The picture at another width and the same proportions, by the nearest pixel: labels and holes stay what they are.
pub fn scaled_to_width(picture: &Image<Rgb>, width: usize) -> Image<Rgb> {
    if picture.width() == width || picture.width() == 0 {
        return picture.clone();
    }
    let height = picture.height() * width / picture.width();
    let mut scaled = Image::filled(width, height, PAPER);
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        scaled[(x, y)] = picture[(x * picture.width() / width, y * picture.height() / height)];
    }
    scaled
}

/// The pixels of a picture, row by row, with paper to the right up to `width`.
pub fn filled_around(picture: &Image<Rgb>, width: usize) -> impl Iterator<Item = Rgb> + '_ {
    let rows = picture.pixels().chunks(picture.width().max(1));
    rows.flat_map(move |row| row.iter().copied().chain(std::iter::repeat_n(PAPER, width.saturating_sub(row.len()))))
}

/// A bold title, and lines below it. What does not fit is cut off.
pub fn write_lines(onto: &mut Image<Rgb>, left: usize, top: usize, title: &str, lines: &[String]) {
    write(onto, left, top, title, true);
    for (k, line) in lines.iter().enumerate() {
        write(onto, left, top + (k + 1) * LINE_HEIGHT, line, false);
    }
}

fn write(onto: &mut Image<Rgb>, left: usize, top: usize, text: &str, is_bold: bool) {
    rasterised(text, is_bold, |x, y, coverage| {
        let at = (left + x, top + y);
        if onto.get(at.0, at.1).is_some() {
            let mix = |under: u8, ink: u8| {
                let coverage = u16::from(coverage);
                ((u16::from(under) * (255 - coverage) + u16::from(ink) * coverage) / 255) as u8
            };
            let under = onto[at];
            onto[at] = std::array::from_fn(|k| mix(under[k], INK[k]));
        }
    });
}

/// A number in white on black, centred on a pixel, which may lie at or past the border.
pub fn write_number(onto: &mut Image<Rgb>, number: u16, at: (i64, i64)) {
    number_pixels(number, at, |x, y, grey| {
        if let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y))
            && onto.get(x, y).is_some()
        {
            onto[(x, y)] = [grey; 3];
        }
    });
}

/// Calls `put(column, row, grey)` for every pixel of a number in white on black, centred on a pixel.
pub fn number_pixels(number: u16, at: (i64, i64), mut put: impl FnMut(i64, i64, u8)) {
    let text = number.to_string();
    let (width, height) = ((text.len() * GLYPH_WIDTH) as i64 + 2, GLYPH_HEIGHT as i64 - 2);
    let (left, top) = (at.0 - width / 2, at.1 - height / 2);
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        put(left + x, top + y, 0);
    }
    rasterised(&text, true, |x, y, coverage| put(left + 1 + x as i64, top - 1 + y as i64, coverage));
}

/// A line in pieces of at most `columns` characters, broken between words; pieces after the first are indented.
pub fn wrapped(line: &str, columns: usize) -> Vec<String> {
    const INDENT: &str = "    ";
    let mut pieces = vec![String::new()];
    for word in line.split(' ') {
        let last = pieces.last().map_or(0, |p| p.chars().count());
        if last > INDENT.len() && last + 1 + word.chars().count() > columns {
            pieces.push(format!("{INDENT}{word}"));
        } else if let Some(piece) = pieces.last_mut() {
            if last > 0 {
                piece.push(' ');
            }
            piece.push_str(word);
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_darkens_the_paper_where_it_stands_and_nowhere_else() {
        let mut paper = Image::filled(60, 20, PAPER);
        write(&mut paper, 10, 2, "Ag", true);
        let inked = |x0: usize, x1: usize| (x0..x1).any(|x| (0..20).any(|y| paper[(x, y)] != PAPER));
        assert!(inked(10, 10 + 2 * GLYPH_WIDTH));
        assert!(!inked(0, 10) && !inked(10 + 2 * GLYPH_WIDTH, 60));
        let untouched = paper.clone();
        write(&mut paper, 59, 19, "past the border", false);
        write(&mut paper, 500, 500, "outside", false);
        assert_eq!(paper.pixels().len(), untouched.pixels().len());
    }

    #[test]
    fn a_number_at_the_border_is_cut_off() {
        let mut paper = Image::filled(30, 20, PAPER);
        write_number(&mut paper, 12, (0, 0));
        assert_eq!(paper[(0, 0)][0], paper[(0, 0)][1]);
        assert!(paper.pixels().contains(&[0; 3]), "the box behind it");
        assert_eq!(paper[(29, 19)], PAPER);
    }

    #[test]
    fn lines_break_between_words() {
        assert_eq!(wrapped("short", 20), ["short"]);
        assert_eq!(wrapped("one two three four", 9), ["one two", "    three", "    four"]);
        assert_eq!(wrapped("averyveryverylongword", 5), ["averyveryverylongword"]);
    }

    #[test]
    fn scaling_keeps_the_proportions_and_invents_no_color() {
        let mut picture = Image::filled(4, 2, [9; 3]);
        picture[(3, 1)] = [200; 3];
        let larger = scaled_to_width(&picture, 8);
        assert_eq!((larger.width(), larger.height()), (8, 4));
        assert_eq!((larger[(7, 3)], larger[(5, 3)]), ([200; 3], [9; 3]));
    }
}
