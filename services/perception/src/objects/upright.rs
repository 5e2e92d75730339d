//! Pictures turned so that the world's up is nearest to their own.
//!
//! A camera at a wrist or a ceiling may be mounted on its side or upside down. What is looked for down the picture (the outside of a bowl below its
//! inside), and a network that learned from upright pictures, would see another world in it. So objects are looked for in its coarse picture turned by
//! quarters, and their ids are turned back.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_6};

use repose_geometry::{Image, Pinhole, Point3, UnitQuaternion, Vector3};

use super::coarse::CoarsePicture;

/// A camera that looks down or up within this of vertical has nothing below its picture: how it is rolled says nothing.
const STEEP_RAD: f64 = FRAC_PI_6;

/// A turn of a picture by so many quarters, clockwise as one looks at it: 0 to 3.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Turn {
    quarters: usize,
}

impl Turn {
    /// What turns the picture of a camera upright, where `up` is the unit vector against gravity in its frame: none for less than 45° of roll.
    pub fn upright(up: &Vector3<f64>) -> Self {
        if up.z.abs() > STEEP_RAD.cos() {
            return Self { quarters: 0 };
        }
        // Up is against y in an upright picture; clockwise of that it has to be turned back.
        let up_clockwise_rad = up.x.atan2(-up.y);
        Self { quarters: (-up_clockwise_rad / FRAC_PI_2).round().rem_euclid(4.0) as usize }
    }

    /// Whether it leaves a picture as it is.
    pub fn is_none(self) -> bool {
        self.quarters == 0
    }

    /// The turn back.
    pub fn back(self) -> Self {
        Self { quarters: (4 - self.quarters) % 4 }
    }

    /// A picture, turned.
    pub fn picture<T: Copy + Default>(self, picture: &Image<T>) -> Image<T> {
        let (width, height) = (picture.width(), picture.height());
        let (columns, rows) = if self.is_to_a_side() { (height, width) } else { (width, height) };
        let mut turned = Image::filled(columns, rows, T::default());
        for (v, row) in turned.pixels_mut().chunks_exact_mut(columns.max(1)).enumerate() {
            for (u, pixel) in row.iter_mut().enumerate() {
                *pixel = picture[match self.quarters {
                    0 => (u, v),
                    1 => (v, height - 1 - u),
                    2 => (width - 1 - u, height - 1 - v),
                    _ => (width - 1 - v, u),
                }];
            }
        }
        turned
    }

    /// A coarse picture, turned with its camera: the world's points stay.
    pub fn coarse(self, picture: &CoarsePicture) -> CoarsePicture {
        let turned_from_camera = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), FRAC_PI_2 * self.quarters as f64);
        CoarsePicture {
            of_full: self.camera(&picture.of_full),
            world_from_camera: picture.world_from_camera * turned_from_camera.inverse(),
            stride: picture.stride,
            camera: self.camera(&picture.camera),
            in_camera: self.picture(&picture.in_camera).map(|p| self.point(p)),
            in_world: self.picture(&picture.in_world),
            depth_m: self.picture(&picture.depth_m),
            faces_up: self.picture(&picture.faces_up),
        }
    }

    /// The camera that sees the turned picture.
    fn camera(self, camera: &Pinhole) -> Pinhole {
        let Pinhole { width, height, fx, fy, cx, cy } = *camera;
        let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
        match self.quarters {
            0 => *camera,
            1 => Pinhole { width: height, height: width, fx: fy, fy: fx, cx: bottom - cy, cy: cx },
            2 => Pinhole { cx: right - cx, cy: bottom - cy, ..*camera },
            _ => Pinhole { width: height, height: width, fx: fy, fy: fx, cx: cy, cy: right - cx },
        }
    }

    /// A point in the camera's frame in that of the turned camera.
    fn point(self, p: &Point3<f32>) -> Point3<f32> {
        match self.quarters {
            0 => *p,
            1 => Point3::new(-p.y, p.x, p.z),
            2 => Point3::new(-p.x, -p.y, p.z),
            _ => Point3::new(p.y, -p.x, p.z),
        }
    }

    /// Whether it makes rows of columns.
    fn is_to_a_side(self) -> bool {
        self.quarters % 2 == 1
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use repose_geometry::Isometry3;
    use repose_geometry::transform::look_at;

    use super::*;
    use crate::readings::point_map::is_reading;
    use crate::settings::Settings;
    use crate::synthetic::{Solid, render};

    /// The turn for a camera that looks down at the world's origin, rolled clockwise about its line of sight.
    fn turn(off_vertical_deg: f64, roll_deg: f64) -> Turn {
        let (away, high) = off_vertical_deg.to_radians().sin_cos();
        let upright = look_at(&Point3::new(0.0, -away, high), &Point3::origin(), &Vector3::z());
        let held = upright * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_deg.to_radians());
        Turn::upright(&(held.rotation.inverse() * Vector3::z()))
    }

    #[test]
    fn a_rolled_picture_is_turned_by_the_quarters_that_bring_up_nearest_to_its_own() {
        let quarters = |roll_deg: f64| turn(55.0, roll_deg).quarters;
        assert_eq!([0.0, 44.9, -44.9, 360.0].map(quarters), [0; 4]);
        // A camera that is rolled clockwise sees the world turned the other way.
        assert_eq!([45.1, 90.0, 134.9].map(quarters), [1; 3]);
        assert_eq!([135.1, 180.0, -180.0, -135.1].map(quarters), [2; 4]);
        assert_eq!([-45.1, -90.0, -134.9, 270.0].map(quarters), [3; 4]);
    }

    #[test]
    fn a_camera_that_looks_steeply_down_or_up_keeps_its_picture() {
        for off_vertical_deg in [0.1, 29.0, 151.0, 179.9] {
            assert!([90.0, 180.0, 270.0].into_iter().all(|roll_deg| turn(off_vertical_deg, roll_deg).is_none()), "{off_vertical_deg}");
        }
        assert!(!turn(31.0, 180.0).is_none() && !turn(149.0, 180.0).is_none());
    }

    proptest! {
        #[test]
        fn a_turn_and_the_turn_back_leave_a_picture_as_it_is(width in 1usize..9, height in 1usize..9, quarters in 0usize..4) {
            let picture = Image::from_pixels(width, height, (0..width * height).collect()).unwrap();
            let turn = Turn { quarters };
            let turned = turn.picture(&picture);
            prop_assert_eq!(turn.back().picture(&turned), picture);
            // The first pixel goes round the corners, clockwise.
            let corner = [(0, 0), (turned.width() - 1, 0), (turned.width() - 1, turned.height() - 1), (0, turned.height() - 1)][quarters];
            prop_assert_eq!(turned[corner], 0);
        }
    }

    #[test]
    fn a_turned_picture_is_the_one_that_its_camera_sees_in_the_same_world() {
        let camera = Pinhole { width: 40, height: 30, fx: 33.0, fy: 35.0, cx: 18.0, cy: 16.5 };
        let world_from_camera = look_at(&Point3::new(0.1, -0.7, 0.5), &Point3::origin(), &Vector3::z());
        let solids = [Solid::table(0.0), Solid::cuboid([0.05, 0.0, 0.04], [0.06, 0.05, 0.04])];
        let of = |camera: &Pinhole, pose: &Isometry3<f64>| {
            CoarsePicture::new(render(&solids, camera, pose), pose, camera, 1, &Settings::default())
        };
        for quarters in 0..4 {
            let turned = Turn { quarters }.coarse(&of(&camera, &world_from_camera));
            let seen = of(&turned.camera, &turned.world_from_camera);
            let pairs = [(&turned.in_camera, &seen.in_camera), (&turned.in_world, &seen.in_world)];
            for (turned, seen) in pairs.into_iter().flat_map(|(turned, seen)| turned.pixels().iter().zip(seen.pixels())) {
                assert_eq!(is_reading(turned), is_reading(seen));
                assert!(!is_reading(seen) || (turned - seen).norm() < 1e-5, "{quarters}: {turned} {seen}");
            }
        }
    }
}
