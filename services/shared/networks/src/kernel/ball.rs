//! The points within a ball, by looking at all of them in blocks.

use repose_simd::{Lanes, Work};

/// Points examined at a time.
const BLOCK: usize = 32;

/// Coordinates in columns, padded to whole blocks with points that are near nothing.
#[derive(Debug, Clone)]
pub(crate) struct PointColumns {
    columns: [Vec<f32>; 3],
}

impl PointColumns {
    pub(crate) fn new(points: &[[f32; 3]]) -> Self {
        let padded = points.len().next_multiple_of(BLOCK);
        Self {
            columns: std::array::from_fn(|k| {
                let mut column: Vec<f32> = points.iter().map(|p| p[k]).collect();
                column.resize(padded, f32::INFINITY);
                column
            }),
        }
    }
}

/// [`super::Kernel::within`].
pub(super) struct Within<'a> {
    pub points: &'a PointColumns,
    pub center: [f32; 3],
    pub radius: f32,
    pub most: usize,
    pub found: &'a mut Vec<u32>,
}

impl Work for Within<'_> {
    type Output = ();

    // Plain loops over blocks, which the compiler turns into the caller's vectors.
    #[inline(always)]
    unsafe fn run<S: Lanes>(self) {
        let Self { points, center, radius, most, found } = self;
        let limit = radius * radius;
        let enough = found.len() + most;
        let [x, y, z] = &points.columns;
        for (b, ((x, y), z)) in x.chunks_exact(BLOCK).zip(y.chunks_exact(BLOCK)).zip(z.chunks_exact(BLOCK)).enumerate() {
            let mut near = [false; BLOCK];
            for l in 0..BLOCK {
                let (dx, dy, dz) = (x[l] - center[0], y[l] - center[1], z[l] - center[2]);
                near[l] = dx * dx + dy * dy + dz * dz <= limit;
            }
            let mut bits = near.iter().enumerate().fold(0u32, |bits, (l, near)| bits | u32::from(*near) << l);
            while bits != 0 {
                found.push((b * BLOCK) as u32 + bits.trailing_zeros());
                if found.len() == enough {
                    return;
                }
                bits &= bits - 1;
            }
        }
    }
}
