//! Which robots the cell's pictures showed, for whoever has one of them looked at again.
//!
//! A page holds a picture for as long as a person looks at it, and robots' states are kept for the seconds that a frame may wait for its turn: the picture
//! itself does not say where the arm stood in it.

use std::collections::VecDeque;

use repose_proto::{RobotInView, SceneWarning};

/// Pictures that are remembered: minutes of a camera's, a few hundred bytes each.
const PICTURES: usize = 4096;

/// The robots of a picture, and what is to be said of them.
pub type InPicture = (Vec<RobotInView>, Vec<SceneWarning>);

/// The robots of the pictures that came last.
#[derive(Debug, Default)]
pub struct ShownRobots {
    /// The oldest first.
    pictures: VecDeque<Shown>,
}

#[derive(Debug)]
struct Shown {
    camera: String,
    stamp_ns: u64,
    robots: InPicture,
}

impl ShownRobots {
    /// A camera's picture of an instant shows these robots.
    pub fn put(&mut self, camera: &str, stamp_ns: u64, robots: InPicture) {
        while self.pictures.len() >= PICTURES {
            self.pictures.pop_front();
        }
        self.pictures.push_back(Shown { camera: camera.to_owned(), stamp_ns, robots });
    }

    /// The robots of a camera's picture of an instant; none where it is not remembered.
    pub fn of(&self, camera: &str, stamp_ns: u64) -> Option<&InPicture> {
        self.pictures.iter().rev().find(|shown| shown.stamp_ns == stamp_ns && shown.camera == camera).map(|shown| &shown.robots)
    }

    /// Whether a camera's pictures are of this cell.
    pub fn knows(&self, camera: &str) -> bool {
        self.pictures.iter().any(|shown| shown.camera == camera)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_told_apart_by_camera_and_instant_and_the_oldest_are_forgotten() {
        let mut shown = ShownRobots::default();
        let said = |message: &str| (Vec::new(), vec![SceneWarning { field: "robots".to_owned(), message: message.to_owned() }]);
        shown.put("left", 7, said("left"));
        shown.put("right", 7, said("right"));
        assert_eq!((shown.of("left", 7), shown.of("right", 7), shown.of("left", 8)), (Some(&said("left")), Some(&said("right")), None));
        for stamp_ns in 100..100 + PICTURES as u64 {
            shown.put("right", stamp_ns, InPicture::default());
        }
        assert_eq!((shown.of("left", 7), shown.knows("left"), shown.knows("right")), (None, false, true));
        assert_eq!(shown.pictures.len(), PICTURES);
    }
}
