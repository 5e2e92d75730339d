//! Faults that a real camera, its calibration or its labels have, put on a problem's frame: the scene, the query, the goal and the truth stay.
//!
//! Each follows from the scene's seed alone, so that a fault can be compared scene by scene with its absence and with other variants.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, UnitVector3, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, UnitSphere};
use rand_pcg::Pcg64;
use repose_geometry::Image;
use repose_geometry::transform::to_row_major;
use repose_perception::{SegmentError, Settings, segment, segment_with_labels};
use repose_proto::{CameraModel, Frame, RigidTransform, Scene};
use serde::{Deserialize, Serialize};

use crate::scenes::problem::Problem;
use crate::statistics::mask_scores::matched;

/// A fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Perturbation {
    /// Masks are found by perception, not given. A found mask has the id of the object that it matches; an object that no mask matches is
    /// not in the scene.
    FoundMasks,
    /// The camera's pose is off by 1° about a random axis and 10 mm in a random direction.
    Pose1Deg10Mm,
    /// The camera's pose is off by 2° and 20 mm.
    Pose2Deg20Mm,
    /// Every mask is shifted by 3 pixels in a direction of its own.
    Labels3Px,
    /// Depth is 1 % too far.
    DepthScale1Percent,
    /// A third of the objects shine: patches of their readings are missing, 40 % of them or more.
    Holes,
    /// A frame of half the columns and rows: 320 × 240.
    QuarterFrame,
}

impl Perturbation {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::FoundMasks,
        Self::Pose1Deg10Mm,
        Self::Pose2Deg20Mm,
        Self::Labels3Px,
        Self::DepthScale1Percent,
        Self::Holes,
        Self::QuarterFrame,
    ];

    /// The name on the command line and in records.
    pub const fn name(self) -> &'static str {
        match self {
            Self::FoundMasks => "found_masks",
            Self::Pose1Deg10Mm => "pose_1_10",
            Self::Pose2Deg20Mm => "pose_2_20",
            Self::Labels3Px => "labels_3_px",
            Self::DepthScale1Percent => "depth_scale_1",
            Self::Holes => "holes",
            Self::QuarterFrame => "320x240",
        }
    }

    /// What perception makes of the problem's frame with this fault; ids stay those of the true objects.
    ///
    /// # Errors
    /// When perception refuses the frame.
    pub fn observed(self, problem: &Problem, perception: &Settings) -> Result<Scene, SegmentError> {
        let rng = &mut Pcg64::new(u128::from(problem.seed), 0xfa_0175);
        let mut frame = problem.frame.clone();
        match self {
            Self::FoundMasks => return with_found_masks(frame, perception),
            Self::Pose1Deg10Mm => misplace(&mut frame.camera, &problem.world_from_camera, [1.0, 0.01], rng),
            Self::Pose2Deg20Mm => misplace(&mut frame.camera, &problem.world_from_camera, [2.0, 0.02], rng),
            Self::Labels3Px => shift_labels(&mut frame, 3.0, rng),
            Self::DepthScale1Percent => {
                frame.depth.iter_mut().for_each(|count| *count = (f64::from(*count) * 1.01).round().min(f64::from(u16::MAX)) as u16);
            }
            Self::Holes => pierce(&mut frame, rng),
            Self::QuarterFrame => frame = every_second_pixel(&frame),
        }
        segment(&frame, perception)
    }
}

/// What perception makes of a frame with masks that it finds itself, named by the labelled ones that they match.
///
/// # Errors
/// When perception refuses the frame.
pub fn with_found_masks(frame: Frame, perception: &Settings) -> Result<Scene, SegmentError> {
    segment(&Frame { labels: Some(found_labels(&frame, perception)?), ..frame }, perception)
}

/// The masks that perception finds, named by the labelled ones that they match with an overlap F of a half or more; others have new ids.
fn found_labels(frame: &Frame, perception: &Settings) -> Result<Vec<u16>, SegmentError> {
    const SAME_FROM: f64 = 0.5;
    let unlabelled = Frame { labels: None, ..frame.clone() };
    let found = segment_with_labels(&unlabelled, perception)?.labels;
    let given = frame.labels.clone().unwrap_or_default();
    let most = given.iter().copied().max().unwrap_or(0);
    let Ok(given) = Image::from_pixels(frame.camera.width, frame.camera.height, given) else { return Ok(found.into_pixels()) };
    let pairs = matched(&given, &found).into_iter().filter(|(_, _, f)| *f >= SAME_FROM);
    let mut names: BTreeMap<u16, u16> = pairs.map(|(given, found, _)| (found, given)).collect();
    names.insert(0, 0);
    let mut next = most;
    let name = |id: &u16| {
        *names.entry(*id).or_insert_with(|| {
            next += 1;
            next
        })
    };
    Ok(found.pixels().iter().map(name).collect())
}

/// Turns and moves the camera's pose as it is believed, by degrees and metres.
fn misplace(camera: &mut CameraModel, world_from_camera: &Isometry3<f64>, [turn_deg, move_m]: [f64; 2], rng: &mut Pcg64) {
    let [axis, direction] = [(); 2].map(|()| UnitVector3::new_unchecked(Vector3::from(UnitSphere.sample(rng))));
    let turn = UnitQuaternion::from_axis_angle(&axis, turn_deg.to_radians());
    let believed = Translation3::from(direction.into_inner() * move_m) * world_from_camera * turn;
    camera.world_from_camera = Some(RigidTransform(to_row_major(&believed)));
}

/// Shifts every mask by so many pixels, each in a direction of its own; later ids lie over earlier ones.
fn shift_labels(frame: &mut Frame, by_px: f64, rng: &mut Pcg64) {
    let Some(labels) = &frame.labels else { return };
    let (width, height) = (frame.camera.width as i64, frame.camera.height as i64);
    let mut shifted = vec![0; labels.len()];
    for id in ids_of(labels) {
        let direction = rng.random_range(0.0..std::f64::consts::TAU);
        let (du, dv) = ((by_px * direction.cos()).round() as i64, (by_px * direction.sin()).round() as i64);
        for (i, _) in labels.iter().enumerate().filter(|(_, label)| **label == id) {
            let (u, v) = (i as i64 % width + du, i as i64 / width + dv);
            if (0..width).contains(&u) && (0..height).contains(&v) {
                shifted[(v * width + u) as usize] = id;
            }
        }
    }
    frame.labels = Some(shifted);
}

/// Takes round patches of readings off a third of the objects, until two fifths of each are gone.
pub(crate) fn pierce(frame: &mut Frame, rng: &mut Pcg64) {
    const SHINES: f64 = 1.0 / 3.0;
    const GONE: f64 = 0.4;
    let Some(labels) = &frame.labels else { return };
    let width = frame.camera.width as i64;
    for id in ids_of(labels) {
        let shines = rng.random_bool(SHINES);
        let pixels: Vec<usize> = labels.iter().enumerate().filter(|(_, label)| **label == id).map(|(i, _)| i).collect();
        // A patch is a tenth of the object's size in the picture.
        let radius = ((pixels.len() as f64).sqrt() * 0.15).max(1.0) as i64;
        let mut gone = 0;
        while shines && (gone as f64) < GONE * pixels.len() as f64 {
            let at = pixels[rng.random_range(0..pixels.len())] as i64;
            for &i in &pixels {
                let (du, dv) = (i as i64 % width - at % width, i as i64 / width - at / width);
                if du * du + dv * dv <= radius * radius && frame.depth[i] > 0 {
                    frame.depth[i] = 0;
                    gone += 1;
                }
            }
            // What had no reading to begin with is gone, too.
            gone = gone.max(pixels.iter().filter(|i| frame.depth[**i] == 0).count());
        }
    }
}

/// Takes the readings away that are farther than a camera of shorter reach sees: from a twentieth to a half farther than the middle one of what is labelled.
pub(crate) fn shorten(frame: &mut Frame, rng: &mut Pcg64) {
    let Some(labels) = &frame.labels else { return };
    let mut of_objects: Vec<u16> =
        labels.iter().zip(&frame.depth).filter(|(label, count)| **label != 0 && **count > 0).map(|(_, count)| *count).collect();
    of_objects.sort_unstable();
    let Some(middle) = of_objects.get(of_objects.len() / 2) else { return };
    let most = f64::from(*middle) * rng.random_range(1.05..1.5);
    frame.depth.iter_mut().filter(|count| f64::from(**count) > most).for_each(|count| *count = 0);
}

fn every_second_pixel(frame: &Frame) -> Frame {
    let camera = &frame.camera;
    let (width, height) = (camera.width / 2, camera.height / 2);
    let kept: Vec<usize> = (0..height).flat_map(|v| (0..width).map(move |u| 2 * v * camera.width + 2 * u)).collect();
    let half =
        CameraModel { width, height, fx: camera.fx / 2.0, fy: camera.fy / 2.0, cx: camera.cx / 2.0, cy: camera.cy / 2.0, ..camera.clone() };
    Frame {
        camera: half,
        depth: kept.iter().map(|i| frame.depth[*i]).collect(),
        color: frame.color.as_ref().map(|color| kept.iter().map(|i| color[*i]).collect()),
        labels: frame.labels.as_ref().map(|labels| kept.iter().map(|i| labels[*i]).collect()),
        ..frame.clone()
    }
}

/// The ids of a picture of labels, ascending, background left out.
fn ids_of(labels: &[u16]) -> Vec<u16> {
    let mut ids: Vec<u16> = labels.iter().copied().filter(|id| *id != 0).collect();
    ids.sort_unstable();
    ids.dedup();
    ids
}

#[cfg(test)]
mod tests {
    use repose_dataset::Split;
    use repose_geometry::transform::from_row_major;

    use super::*;
    use crate::scenes::problem::ProblemSettings;

    fn problem() -> (Problem, Settings) {
        let settings = ProblemSettings::default();
        let problem = (0..).find_map(|i| Problem::of_split(Split::Validation, i, &settings)).expect("a problem");
        (problem, settings.perception)
    }

    #[test]
    fn every_fault_changes_what_is_seen_alike_each_time_and_keeps_the_ids() {
        let (problem, perception) = problem();
        let ids = |scene: &Scene| scene.meta.objects.iter().map(|o| o.id).collect::<Vec<_>>();
        for fault in Perturbation::ALL {
            let observed = fault.observed(&problem, &perception).unwrap_or_else(|e| panic!("{}: {e}", fault.name()));
            assert_ne!(observed.id(), problem.observed.id(), "{}", fault.name());
            assert_eq!(observed.id(), fault.observed(&problem, &perception).expect("again").id(), "{}", fault.name());
            let known = ids(&problem.observed);
            let kept = ids(&observed).iter().filter(|id| known.contains(id)).count();
            // Each fault may cost one object: of found masks two that touch may be one.
            assert!(kept + 1 >= known.len(), "{}: {:?} of {known:?}", fault.name(), ids(&observed));
        }
    }

    #[test]
    fn a_pose_is_off_by_what_its_name_says() {
        let (problem, _) = problem();
        let mut camera = problem.frame.camera.clone();
        misplace(&mut camera, &problem.world_from_camera, [2.0, 0.02], &mut Pcg64::new(1, 2));
        let believed = from_row_major(&camera.world_from_camera.expect("a pose").0).expect("rigid");
        assert!((believed.rotation.angle_to(&problem.world_from_camera.rotation).to_degrees() - 2.0).abs() < 1e-6);
        assert!(((believed.translation.vector - problem.world_from_camera.translation.vector).norm() - 0.02).abs() < 1e-9);
    }

    #[test]
    fn a_camera_of_short_reach_reads_what_is_near_as_ever_and_nothing_farther() {
        let (problem, _) = problem();
        let mut frame = problem.frame.clone();
        shorten(&mut frame, &mut Pcg64::new(3, 3));
        let pairs = || problem.frame.depth.iter().zip(&frame.depth).filter(|(before, _)| **before > 0);
        let nearest_gone = pairs().filter(|(_, now)| **now == 0).map(|(before, _)| *before).min().expect("it reads less");
        assert!(pairs().filter(|(before, _)| **before < nearest_gone).all(|(before, now)| before == now));
        assert!(pairs().all(|(before, now)| *before < nearest_gone || *now == 0));
        assert!(pairs().filter(|(_, now)| **now > 0).count() > 1000, "half of the objects and more are within it");
    }

    #[test]
    fn holes_take_two_fifths_of_some_objects_and_nothing_else() {
        let (problem, _) = problem();
        let mut frame = problem.frame.clone();
        // Objects shine by chance: some seed has one that does and one that does not.
        pierce(&mut frame, &mut Pcg64::new(3, 3));
        let labels = frame.labels.as_ref().expect("given");
        let share = |id: u16, depth: &[u16]| {
            let of = labels.iter().zip(depth).filter(|(label, _)| **label == id).map(|(_, d)| *d == 0);
            let (gone, all) = of.fold((0, 0), |(gone, all), is_gone| (gone + usize::from(is_gone), all + 1));
            f64::from(gone as u32) / f64::from(all as u32)
        };
        for id in ids_of(labels) {
            let (before, after) = (share(id, &problem.frame.depth), share(id, &frame.depth));
            assert!(after == before || after >= 0.4, "object {id}: {before} to {after}");
        }
        let background = |depth: &[u16]| labels.iter().zip(depth).filter(|(label, _)| **label == 0).map(|(_, d)| *d).collect::<Vec<_>>();
        assert_eq!(background(&frame.depth), background(&problem.frame.depth));
    }
}
