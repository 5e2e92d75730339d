//! What a `CameraInfo` says of its lens: `plumb_bob`, with five numbers as a rule, and `rational_polynomial`, with eight and more.
//!
//! What the numbers mean their order says and not the model's name, as in OpenCV and in what of ROS rectifies with it: drivers write eight of them
//! as `plumb_bob`, too, and twelve or fourteen as `rational_polynomial`.

use crate::cdr::MessageError;
use crate::sensor::CameraInfo;

/// Where the numbers of a thin prism end: those of a tilted sensor follow.
const PRISM_END: usize = 12;

/// How a lens bends: radial, tangential and as a thin prism, as OpenCV has it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Lens {
    /// Radial: k1, k2, k3 over k4, k5, k6.
    radial: [f64; 6],
    /// Tangential: p1, p2.
    tangential: [f64; 2],
    /// Of a thin prism: s1, s2 across, s3, s4 down.
    prism: [f64; 4],
}

impl Lens {
    /// The lens of a camera; none of one that does not bend.
    ///
    /// # Errors
    /// [`MessageError::Unsupported`] for another model, for a sensor that is tilted behind its lens, and for pictures that are turned by being
    /// rectified, as those of stereo pairs are.
    pub fn of(info: &CameraInfo) -> Result<Option<Self>, MessageError> {
        if info.d.iter().all(|d| *d == 0.0) {
            return Ok(None);
        }
        let d = |i: usize| info.d.get(i).copied().unwrap_or(0.0);
        if !matches!(info.distortion_model.as_str(), "plumb_bob" | "rational_polynomial" | "") {
            let expected = "plumb_bob or rational_polynomial; rectify the pictures with image_proc and name its topics";
            return Err(MessageError::Unsupported { field: "distortion_model", got: info.distortion_model.clone(), expected });
        }
        let of_d = |expected| Err(MessageError::Unsupported { field: "d", got: format!("{:?}", info.d), expected });
        if info.d.iter().any(|d| !d.is_finite()) {
            return of_d("finite numbers");
        }
        if info.d.iter().skip(PRISM_END).any(|d| *d != 0.0) {
            return of_d("no tilted sensor; rectify the pictures with image_proc and name its topics");
        }
        let turned = |i: usize| (info.r[i] - f64::from(u8::from(i.is_multiple_of(4)))).abs() > 1e-6;
        if info.r.iter().any(|r| *r != 0.0) && (0..9).any(turned) {
            let expected = "no rotation; rectify the pictures with image_proc and name its topics";
            return Err(MessageError::Unsupported { field: "r", got: format!("{:?}", info.r), expected });
        }
        Ok(Some(Self { radial: [d(0), d(1), d(4), d(5), d(6), d(7)], tangential: [d(2), d(3)], prism: [d(8), d(9), d(10), d(11)] }))
    }

    /// Where on the picture plane at depth 1 the lens shows what is at `(x, y)` there.
    pub fn bent(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [p1, p2] = self.tangential;
        let [s1, s2, s3, s4] = self.prism;
        let r2 = x * x + y * y;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let across = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
        let down = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
        (across + r2 * (s1 + r2 * s2), down + r2 * (s3 + r2 * s4))
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
    fn numbers_mean_what_their_order_says_whatever_the_model_is_called() {
        let d = [0.3, -0.2, 0.001, -0.002, 0.05, 0.4, -0.1, 0.02, 0.003, -0.004, 0.005, 0.006, 0.0, 0.0];
        let lens = |model: &str, d: &[f64]| Lens::of(&info(model, d)).expect("a model").expect("a lens");
        assert_eq!(lens("plumb_bob", &d[..8]), lens("rational_polynomial", &d[..8]));
        // The eight alone, by cv2.projectPoints's formula; then the prism's share of it.
        let (x, y, r2) = (0.3, -0.2, 0.13f64);
        let radial = (1.0 + 0.3 * r2 - 0.2 * r2.powi(2) + 0.05 * r2.powi(3)) / (1.0 + 0.4 * r2 - 0.1 * r2.powi(2) + 0.02 * r2.powi(3));
        let across = x * radial + 2.0 * 0.001 * x * y - 0.002 * (r2 + 2.0 * x * x);
        let down = y * radial + 0.001 * (r2 + 2.0 * y * y) - 2.0 * 0.002 * x * y;
        let off = |lens: &Lens, at: (f64, f64)| (lens.bent((x, y)).0 - at.0).abs().max((lens.bent((x, y)).1 - at.1).abs());
        assert!(off(&lens("plumb_bob", &d[..8]), (across, down)) < 1e-12);
        let bent = (across + 0.003 * r2 - 0.004 * r2 * r2, down + 0.005 * r2 + 0.006 * r2 * r2);
        for count in [12, 14] {
            assert!(off(&lens("rational_polynomial", &d[..count]), bent) < 1e-12);
        }
        let mut tilted = d;
        tilted[12] = 0.01;
        let refused = Lens::of(&info("rational_polynomial", &tilted)).unwrap_err();
        assert!(refused.to_string().contains("tilted"), "{refused}");
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
