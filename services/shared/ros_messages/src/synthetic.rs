//! Messages to test with, written by hand: little-endian CDR that owes nothing to the encoder.

use crate::sensor::datatype::FLOAT32;

/// Little-endian CDR by hand: each number aligned to its size.
#[derive(Default)]
pub struct CdrWriter(Vec<u8>);

impl CdrWriter {
    /// A number, aligned to its size.
    pub fn put(&mut self, bytes: &[u8]) -> &mut Self {
        while !self.0.len().is_multiple_of(bytes.len()) {
            self.0.push(0);
        }
        self.0.extend_from_slice(bytes);
        self
    }

    /// A count.
    pub fn u32(&mut self, value: u32) -> &mut Self {
        self.put(&value.to_le_bytes())
    }

    /// Numbers of a fixed-size array.
    pub fn f64s(&mut self, values: &[f64]) -> &mut Self {
        for value in values {
            self.put(&value.to_le_bytes());
        }
        self
    }

    /// Words.
    pub fn text(&mut self, text: &str) -> &mut Self {
        self.u32(text.len() as u32 + 1).0.extend(text.bytes().chain([0]));
        self
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.u32(bytes.len() as u32).0.extend_from_slice(bytes);
        self
    }

    /// All of it, with the header.
    pub fn message(&self) -> Vec<u8> {
        [&[0, 1, 0, 0], self.0.as_slice()].concat()
    }
}

/// A square picture of `side` pixels a side, stamped 7 s; depth is 1000 counts, or 1 m.
pub fn image(frame_id: &str, encoding: &str, side: u32) -> Vec<u8> {
    let pixel: &[u8] = match encoding {
        "rgb8" => &[9; 3],
        "32FC1" => &1f32.to_le_bytes(),
        _ => &1000u16.to_le_bytes(),
    };
    let mut writer = CdrWriter::default();
    writer.u32(7).u32(0).text(frame_id).u32(side).u32(side).text(encoding).put(&[0]).u32(side * pixel.len() as u32);
    writer.bytes(&pixel.repeat((side * side) as usize));
    writer.message()
}

/// Intrinsics of such pictures, with a focal length of 5 pixels.
pub fn info(frame_id: &str, side: u32) -> Vec<u8> {
    let mut writer = CdrWriter::default();
    writer.u32(7).u32(0).text(frame_id).u32(side).u32(side).text("plumb_bob").u32(0);
    let center = f64::from(side - 1) / 2.0;
    writer.f64s(&[5.0, 0.0, center, 0.0, 5.0, center, 0.0, 0.0, 1.0]).f64s(&[0.0; 9]).f64s(&[0.0; 12]);
    writer.u32(0).u32(0).u32(0).u32(0).u32(0).u32(0).put(&[0]);
    writer.message()
}

/// An organized cloud of `side` by `side` points, by row and column.
pub fn cloud(frame_id: &str, side: u32, point: impl Fn(u32, u32) -> [f32; 3]) -> Vec<u8> {
    let mut writer = CdrWriter::default();
    writer.u32(7).u32(0).text(frame_id).u32(side).u32(side).u32(3);
    for (name, offset) in [("x", 0), ("y", 4), ("z", 8)] {
        writer.text(name).u32(offset).put(&[FLOAT32]).u32(1);
    }
    let data: Vec<u8> = (0..side * side).flat_map(|i| point(i / side, i % side)).flat_map(f32::to_le_bytes).collect();
    writer.put(&[0]).u32(12).u32(12 * side).bytes(&data).put(&[1]);
    writer.message()
}
