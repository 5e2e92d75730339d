//! What a `CameraInfo` says of its lens: `plumb_bob`, with its five numbers, and `rational_polynomial`, with eight.

use crate::cdr::MessageError;
use crate::sensor::CameraInfo;

/// How a lens bends: radial and tangential, as OpenCV has it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Lens {
    /// Radial: k1, k2, k3 over k4, k5, k6.
    radial: [f64; 6],
    /// Tangential: p1, p2.
    tangential: [f64; 2],
}

impl Lens {
    /// The lens of a camera; none of one that does not bend.
    ///
    /// # Errors
    /// [`MessageError::Unsupported`] for another model, and for pictures that are turned by being rectified, as those of stereo pairs are.
    pub fn of(info: &CameraInfo) -> Result<Option<Self>, MessageError> {
        if info.d.iter().all(|d| *d == 0.0) {
            return Ok(None);
        }
        let d = |i: usize| info.d.get(i).copied().unwrap_or(0.0);
        let k456 = match info.distortion_model.as_str() {
            "plumb_bob" | "" => [0.0; 3],
            "rational_polynomial" => [d(5), d(6), d(7)],
            other => {
                let expected = "plumb_bob or rational_polynomial; rectify the pictures with image_proc and name its topics";
                return Err(MessageError::Unsupported { field: "distortion_model", got: other.to_owned(), expected });
            }
        };
        if info.d.iter().any(|d| !d.is_finite()) {
            return Err(MessageError::Unsupported { field: "d", got: format!("{:?}", info.d), expected: "finite numbers" });
        }
        let turned = |i: usize| (info.r[i] - f64::from(u8::from(i.is_multiple_of(4)))).abs() > 1e-6;
        if info.r.iter().any(|r| *r != 0.0) && (0..9).any(turned) {
            let expected = "no rotation; rectify the pictures with image_proc and name its topics";
            return Err(MessageError::Unsupported { field: "r", got: format!("{:?}", info.r), expected });
        }
        Ok(Some(Self { radial: [d(0), d(1), d(4), k456[0], k456[1], k456[2]], tangential: [d(2), d(3)] }))
    }

    /// Where on the picture plane at depth 1 the lens shows what is at `(x, y)` there.
    pub fn bent(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [p1, p2] = self.tangential;
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;

    fn info(model: &str, d: &[f64]) -> CameraInfo {
        let info = CameraInfo::read(&synthetic::info("camera", 4)).expect("intrinsics");
        CameraInfo { distortion_model: model.to_owned(), d: d.to_vec(), ..info }
    }

    #[test]
    fn a_lens_bends_as_opencv_has_it() {
        let lens = Lens::of(&info("plumb_bob", &[-0.28, 0.07, 0.0002, 0.00002, 0.0])).expect("a model").expect("a lens");
        // cv2.projectPoints of (0.3, -0.2, 1) with these numbers.
        let (x, y) = lens.bent((0.3, -0.2));
        let r2 = 0.13;
        let radial = 1.0 - 0.28 * r2 + 0.07 * r2 * r2;
        assert!((x - (0.3 * radial - 2.0 * 0.0002 * 0.06 + 0.00002 * (r2 + 0.18))).abs() < 1e-12);
        assert!((y - (-0.2 * radial + 0.0002 * (r2 + 0.08) - 2.0 * 0.00002 * 0.06)).abs() < 1e-12);
        assert_eq!(Lens::of(&info("plumb_bob", &[0.0; 5])), Ok(None));
        assert_eq!(Lens::of(&info("equidistant", &[])), Ok(None));
    }

    #[test]
    fn what_cannot_be_rectified_is_refused_with_what_to_do() {
        let fisheye = Lens::of(&info("equidistant", &[0.1; 4])).unwrap_err();
        assert!(fisheye.to_string().contains("image_proc"), "{fisheye}");
        let mut turned = info("plumb_bob", &[0.1; 5]);
        turned.r = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        assert!(matches!(Lens::of(&turned), Err(MessageError::Unsupported { field: "r", .. })));
    }
}
