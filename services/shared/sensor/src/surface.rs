//! What a pixel's neighbours say of the surface: whether depth jumps there, and how the surface is turned.
//!
//! The inverse depth of a plane is linear in the picture, however slanted it is. So a second difference tells jumps from slopes, and the
//! first difference gives the normal.

/// Jump of inverse depth, as a share, that counts as two surfaces.
const JUMP_SHARE: f32 = 0.02;

/// The inverse depths of a pixel and its neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PixelNeighbourhood {
    /// Least inverse depth of the pixel and its four neighbours, 1/m; 0 when one of them has nothing.
    pub least: f32,
    /// Greatest inverse depth among them, 1/m.
    pub greatest: f32,
    /// Whether they lie on different surfaces.
    pub is_edge: bool,
    /// Cosine of the angle between normal and line of sight, squared.
    pub cosine_squared: f32,
}

impl PixelNeighbourhood {
    /// The surroundings of a pixel of inverse depth `here` (> 0), from its neighbours along x and along y (0 = nothing), in a picture with focal
    /// lengths `fx` and `fy`, whose line of sight is (`ray[0]`, `ray[1]`, 1).
    #[inline]
    pub fn new(here: f32, along_x: [f32; 2], along_y: [f32; 2], [fx, fy]: [f32; 2], ray: [f32; 2]) -> Self {
        let least = along_x[0].min(along_x[1]).min(along_y[0]).min(along_y[1]).min(here);
        let greatest = along_x[0].max(along_x[1]).max(along_y[0]).max(along_y[1]).max(here);
        let bend_x = (along_x[0] + along_x[1] - 2.0 * here).abs();
        let bend_y = (along_y[0] + along_y[1] - 2.0 * here).abs();
        let is_edge = bend_x.max(bend_y) > JUMP_SHARE * here;
        // The plane n·P = 1 has inverse depth n·(ray): its gradient gives n, and n·ray is the inverse depth itself.
        let (nx, ny) = (flatter(here, along_x) * fx, flatter(here, along_y) * fy);
        let nz = here - nx * ray[0] - ny * ray[1];
        let lengths = (nx * nx + ny * ny + nz * nz) * (1.0 + ray[0] * ray[0] + ray[1] * ray[1]);
        Self { least, greatest, is_edge, cosine_squared: here * here / lengths }
    }
}

/// The difference to whichever neighbour differs less: the one on the same surface.
#[inline]
fn flatter(here: f32, [before, after]: [f32; 2]) -> f32 {
    let (back, ahead) = (here - before, after - here);
    if back.abs() < ahead.abs() { back } else { ahead }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_plane_has_no_edges_and_its_own_angle(turn in -1.4f32..1.4, tilt in -1.4f32..1.4, u in -100.0f32..100.0, v in -80.0f32..80.0) {
            let normal = Vector3::new(turn.sin(), tilt.sin(), -1.0).normalize();
            let f = 280.0f32;
            let ray = |u: f32, v: f32| Vector3::new(u / f, v / f, 1.0);
            let inverse = |u: f32, v: f32| normal.dot(&ray(u, v)) / -0.8;
            let neighbours = [inverse(u - 1.0, v), inverse(u + 1.0, v), inverse(u, v - 1.0), inverse(u, v + 1.0)];
            prop_assume!(neighbours.iter().all(|w| *w > 0.05));
            let [l, r, t, b] = neighbours;
            let surface = PixelNeighbourhood::new(inverse(u, v), [l, r], [t, b], [f, f], [u / f, v / f]);
            let cosine = normal.dot(&ray(u, v).normalize());
            prop_assert!(!surface.is_edge);
            prop_assert!((surface.cosine_squared - cosine * cosine).abs() < 0.02, "{} {}", surface.cosine_squared, cosine * cosine);
        }
    }

    #[test]
    fn a_jump_is_an_edge_and_does_not_look_like_a_slope() {
        let surface = PixelNeighbourhood::new(1.0, [1.0, 1.6], [1.0, 1.0], [280.0; 2], [0.0; 2]);
        assert!(surface.is_edge && surface.cosine_squared == 1.0);
        assert_eq!((surface.least, surface.greatest), (1.0, 1.6));
    }
}
