//! Packs the pixels of a layer: differences from one pixel to the next, split into planes of bytes, deflated.
//!
//! The crate's documentation has the layout. Unpacking never makes more bytes than the rectangle needs, whatever the stream says.

use flate2::{Compress, Compression, Decompress, FlushCompress, FlushDecompress, Status};

/// zlib's effort. Of the pixels of a generated view of 320 × 240, 1 makes 24.4 kB, 4 makes 17.7 kB in three times the time, 6 makes 15.9 kB in five
/// times, 9 makes 15.1 kB in thirty times (`view_cost`, an example of the simulator).
const EFFORT: u32 = 4;

/// Why packed bytes do not unpack.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// The stream is no zlib stream, was cut off, or fails its checksum.
    #[error("not a whole zlib stream: {0}")]
    Stream(String),
    /// The stream holds another number of bytes.
    #[error("expected {expected} unpacked bytes, got {got}")]
    Length {
        /// Bytes that the rectangle needs.
        expected: usize,
        /// Bytes that came, as far as they were read: at most one more than expected.
        got: usize,
    },
}

/// Packs layers one after the other; keeps its working memory.
#[derive(Debug)]
pub struct Packer {
    deflate: Compress,
    planes: Vec<u8>,
}

impl Default for Packer {
    fn default() -> Self {
        Self::with_effort(EFFORT)
    }
}

impl Packer {
    /// A packer with another of zlib's efforts, 1 to 9.
    pub fn with_effort(effort: u32) -> Self {
        Self { deflate: Compress::new(Compression::new(effort.clamp(1, 9)), true), planes: Vec::new() }
    }

    /// Packs 16-bit pixels.
    pub fn pack_u16(&mut self, values: &[u16]) -> Vec<u8> {
        let mut planes = std::mem::take(&mut self.planes);
        planes.clear();
        planes.resize(2 * values.len(), 0);
        let (low, high) = planes.split_at_mut(values.len());
        let mut before = 0u16;
        for ((value, low), high) in values.iter().zip(low).zip(high) {
            let difference = value.wrapping_sub(before) as i16;
            // Small numbers of either sign become small numbers: their high byte is 0.
            let folded = ((difference << 1) ^ (difference >> 15)) as u16;
            [*low, *high] = folded.to_le_bytes();
            before = *value;
        }
        self.planes = planes;
        self.deflated()
    }

    /// Packs colors.
    pub fn pack_color(&mut self, pixels: &[[u8; 3]]) -> Vec<u8> {
        let mut planes = std::mem::take(&mut self.planes);
        planes.clear();
        for channel in 0..3 {
            let mut before = 0u8;
            planes.extend(pixels.iter().map(|pixel| pixel[channel].wrapping_sub(std::mem::replace(&mut before, pixel[channel]))));
        }
        self.planes = planes;
        self.deflated()
    }

    fn deflated(&mut self) -> Vec<u8> {
        self.deflate.reset();
        let mut packed = Vec::with_capacity(64 + self.planes.len() / 4);
        loop {
            let done = self.deflate.total_in() as usize;
            // Compression into memory fails only when misused; what came so far then does not unpack and is refused by any reader.
            match self.deflate.compress_vec(&self.planes[done..], &mut packed, FlushCompress::Finish) {
                Ok(Status::Ok | Status::BufError) => packed.reserve(64 + packed.capacity()),
                Ok(Status::StreamEnd) | Err(_) => return packed,
            }
        }
    }
}

/// Unpacks `count` 16-bit pixels.
///
/// # Errors
/// [`CodecError`] when the bytes are not the packed form of as many pixels.
pub fn unpack_u16(packed: &[u8], count: usize) -> Result<Vec<u16>, CodecError> {
    let planes = inflated(packed, 2 * count)?;
    let (low, high) = planes.split_at(count);
    let mut value = 0u16;
    let unfolded = low.iter().zip(high).map(|(low, high)| {
        let folded = u16::from_le_bytes([*low, *high]);
        value = value.wrapping_add((folded >> 1) ^ (folded & 1).wrapping_neg());
        value
    });
    Ok(unfolded.collect())
}

/// Unpacks `count` colors.
///
/// # Errors
/// [`CodecError`] when the bytes are not the packed form of as many pixels.
pub fn unpack_color(packed: &[u8], count: usize) -> Result<Vec<[u8; 3]>, CodecError> {
    let planes = inflated(packed, 3 * count)?;
    let mut pixels = vec![[0u8; 3]; count];
    for channel in 0..3 {
        let mut value = 0u8;
        for (pixel, difference) in pixels.iter_mut().zip(&planes[channel * count..]) {
            value = value.wrapping_add(*difference);
            pixel[channel] = value;
        }
    }
    Ok(pixels)
}

/// Exactly `expected` bytes of a zlib stream.
fn inflated(packed: &[u8], expected: usize) -> Result<Vec<u8>, CodecError> {
    // One byte more than expected, so that a longer stream is told from one that fits.
    let mut planes = vec![0u8; expected + 1];
    let mut inflate = Decompress::new(true);
    let status = inflate.decompress(packed, &mut planes, FlushDecompress::Finish).map_err(|e| CodecError::Stream(e.to_string()))?;
    let got = inflate.total_out() as usize;
    if got > expected || (status == Status::StreamEnd && got < expected) {
        return Err(CodecError::Length { expected, got });
    }
    if status != Status::StreamEnd {
        return Err(CodecError::Stream(format!("it ends after {got} of {expected} unpacked bytes")));
    }
    planes.truncate(expected);
    Ok(planes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pixels_survive_the_round_trip(values: Vec<u16>, colors: Vec<[u8; 3]>) {
            let mut packer = Packer::default();
            prop_assert_eq!(unpack_u16(&packer.pack_u16(&values), values.len()).unwrap(), values);
            prop_assert_eq!(unpack_color(&packer.pack_color(&colors), colors.len()).unwrap(), colors);
        }

        #[test]
        fn arbitrary_bytes_are_an_error_and_no_more_than_that(packed: Vec<u8>, count in 0usize..10_000) {
            // Two bytes that happen to be a stream of nothing are no error for no pixels.
            let unpacked = unpack_u16(&packed, count);
            prop_assert!(unpacked.is_err() || unpacked.unwrap().len() == count);
        }

        #[test]
        fn a_stream_that_was_cut_or_changed_gives_no_other_pixels(values in prop::collection::vec(any::<u16>(), 1..300), at: prop::sample::Index, flip in 1u8..=255) {
            let packed = Packer::default().pack_u16(&values);
            let at = at.index(packed.len());
            prop_assert!(unpack_u16(&packed[..at], values.len()).is_err());
            let mut changed = packed.clone();
            changed[at] ^= flip;
            // Some bits are only padding, or say how hard the packer tried: then the pixels are the same.
            let unpacked = unpack_u16(&changed, values.len());
            prop_assert!(unpacked.is_err() || unpacked == Ok(values));
        }
    }

    #[test]
    fn a_stream_of_another_length_is_an_error_that_says_both() {
        let packed = Packer::default().pack_u16(&[1, 2, 3]);
        assert_eq!(unpack_u16(&packed, 2), Err(CodecError::Length { expected: 4, got: 5 }));
        assert_eq!(unpack_u16(&packed, 4), Err(CodecError::Length { expected: 8, got: 6 }));
    }

    #[test]
    fn a_million_pixels_of_a_plane_are_a_few_kilobytes() {
        let plane: Vec<u16> = (0..1_000_000).map(|i| (9_000.0 + 1.37 * f64::from(i % 1000) - 2.11 * f64::from(i / 1000)) as u16).collect();
        let packed = Packer::default().pack_u16(&plane);
        assert!(packed.len() < 40_000, "{}", packed.len());
    }
}
