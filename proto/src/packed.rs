//! The packed form of bulk: what is sent over a slow network in place of it, without loss and a fifth as large for a scene.
//!
//! Neighbours in a tensor are alike: points go along the rows of a picture. So each row has the one before taken from it, number by number as unsigned
//! integers; what is left is made positive (zigzag) and its bytes are sorted by significance, as in HDF5's shuffle; and the whole, a safetensors file like
//! the plain form, goes through zlib. Any language has these three.

use std::io::{Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;

use crate::bulk::{Bulk, Tensor};
use crate::{CallError, limits};

/// The fastest: the next levels take three times as long for a tenth less.
const LEVEL: Compression = Compression::new(1);

/// The packed form.
///
/// # Errors
/// `internal` where memory cannot be had.
pub fn pack(bulk: &Bulk) -> Result<Vec<u8>, CallError> {
    let failed = |e: std::io::Error| CallError::internal(format!("packing: {e}"));
    let tensors = bulk.tensors.iter().map(|(name, tensor)| (name.clone(), with_bytes(tensor, sorted_differences))).collect();
    let mut packed = ZlibEncoder::new(Vec::new(), LEVEL);
    packed.write_all(&Bulk { metadata: bulk.metadata.clone(), tensors }.encode()).map_err(failed)?;
    packed.finish().map_err(failed)
}

/// What was packed.
///
/// # Errors
/// `invalid_argument` on `payload` for what was not packed so, and for what would become larger than a message may be.
pub fn unpack(bytes: &[u8]) -> Result<Bulk, CallError> {
    let invalid = |message: String| CallError::invalid("payload", message);
    let mut plain = Vec::new();
    let most = limits::MAX_MESSAGE_BYTES as u64;
    let read = ZlibDecoder::new(bytes).take(most + 1).read_to_end(&mut plain).map_err(|e| invalid(format!("not in packed form: {e}")))?;
    if read as u64 > most {
        return Err(invalid(format!("unpacked it has more than the {most} bytes that a message may have")));
    }
    let packed = Bulk::decode(&plain)?;
    let tensors = packed.tensors.iter().map(|(name, tensor)| (name.clone(), with_bytes(tensor, summed))).collect();
    Ok(Bulk { metadata: packed.metadata, tensors })
}

/// A tensor whose bytes were made of the rows' by `change`, which gets bytes, numbers in a row, and bytes in a number.
fn with_bytes(tensor: &Tensor, change: fn(&[u8], usize, usize) -> Vec<u8>) -> Tensor {
    let rows = tensor.shape.first().copied().unwrap_or(0);
    let numbers: usize = tensor.shape.iter().skip(1).product();
    let width = tensor.bytes.len().checked_div(rows * numbers).unwrap_or(0);
    // Wider numbers than there are here stay as they are.
    let bytes = if matches!(width, 1 | 2 | 4) { change(&tensor.bytes, numbers, width) } else { tensor.bytes.clone() };
    Tensor { dtype: tensor.dtype, shape: tensor.shape.clone(), bytes }
}

/// What numbers of a width can be: all ones in that width.
fn mask(width: usize) -> u32 {
    u32::MAX >> (32 - 8 * width)
}

fn number(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte))
}

/// Rows as differences to the one before, made positive; the first column's lowest bytes first, then their next ones, then the second column's.
fn sorted_differences(bytes: &[u8], numbers: usize, width: usize) -> Vec<u8> {
    let (rows, top) = (bytes.len() / (numbers * width), 8 * width - 1);
    let mut sorted = vec![0; bytes.len()];
    for column in 0..numbers {
        let mut before = 0;
        for (row, number) in bytes.chunks_exact(numbers * width).map(|row| number(&row[column * width..][..width])).enumerate() {
            let difference = number.wrapping_sub(before) & mask(width);
            let is_negative = difference >> top & 1;
            let positive = (difference << 1 ^ (0_u32.wrapping_sub(is_negative))) & mask(width);
            for (byte, value) in positive.to_le_bytes().into_iter().take(width).enumerate() {
                sorted[(column * width + byte) * rows + row] = value;
            }
            before = number;
        }
    }
    sorted
}

/// The rows again.
fn summed(sorted: &[u8], numbers: usize, width: usize) -> Vec<u8> {
    let rows = sorted.len() / (numbers * width);
    let mut bytes = vec![0; sorted.len()];
    for column in 0..numbers {
        let mut number: u32 = 0;
        for row in 0..rows {
            let positive = (0..width).rev().fold(0_u32, |n, byte| n << 8 | u32::from(sorted[(column * width + byte) * rows + row]));
            let difference = positive >> 1 ^ 0_u32.wrapping_sub(positive & 1);
            number = number.wrapping_add(difference) & mask(width);
            bytes[(row * numbers + column) * width..][..width].copy_from_slice(&number.to_le_bytes()[..width]);
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    fn bulk(points: &[f32], labels: &[u16], colors: &[u8]) -> Bulk {
        let tensors = BTreeMap::from([
            ("points".to_owned(), Tensor::f32(&[points.len() / 3, 3], &points[..points.len() / 3 * 3])),
            ("labels".to_owned(), Tensor::u16(&[labels.len()], labels)),
            ("colors".to_owned(), Tensor::u8(&[colors.len() / 3, 3], &colors[..colors.len() / 3 * 3])),
        ]);
        Bulk { metadata: BTreeMap::from([("camera".to_owned(), "front".to_owned())]), tensors }
    }

    proptest! {
        #[test]
        fn whatever_is_packed_comes_back_to_the_last_bit(
            bits in prop::collection::vec(any::<u32>(), 0..60), labels in prop::collection::vec(any::<u16>(), 0..60),
            colors in prop::collection::vec(any::<u8>(), 0..60),
        ) {
            let points: Vec<f32> = bits.into_iter().map(f32::from_bits).collect();
            let bulk = bulk(&points, &labels, &colors);
            let back = unpack(&pack(&bulk).unwrap()).unwrap();
            // By their bytes: a NaN is not itself.
            prop_assert_eq!(back.encode(), bulk.encode());
        }
    }

    #[test]
    fn a_picture_seen_is_packed_to_a_fraction() {
        let points: Vec<f32> = (0..60_000).flat_map(|i| [(i % 200) as f32 * 1e-3, (i / 200) as f32 * 1e-3, 0.0]).collect();
        let bulk = bulk(&points, &vec![3; 60_000], &vec![90; 180_000]);
        let (packed, plain) = (pack(&bulk).unwrap().len(), bulk.encode().len());
        assert!(packed * 4 < plain, "{packed} of {plain}");
    }

    #[test]
    fn what_is_not_packed_or_would_grow_too_large_is_refused() {
        let small = pack(&bulk(&[1.0; 30], &[1; 10], &[1; 30])).unwrap();
        for broken in [&small[..small.len() / 2], b"plain"] {
            assert_eq!(unpack(broken).unwrap_err().field.as_deref(), Some("payload"));
        }
        let mut bomb = ZlibEncoder::new(Vec::new(), LEVEL);
        bomb.write_all(&vec![0; limits::MAX_MESSAGE_BYTES + 1]).unwrap();
        let refused = unpack(&bomb.finish().unwrap()).unwrap_err();
        assert!(refused.message.contains("may have"), "{refused}");
    }
}
