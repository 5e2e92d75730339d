//! The segmentation table: perception's own masks of labelled frames against the labels, which it does not get to see.
//!
//! Figures are means over frames, as published ones are; the share of objects found is of all objects. Two kinds of masks are scored:
//! whole ones, which `segment --labels-out` writes, and cleaned ones, whose pixels became the points of the scene's objects (the band
//! around each mask is left out on purpose). Frames are split by name ([`Half::of`]): changes to segmentation are judged on the one half
//! only, and the other is for reporting.

use std::collections::BTreeMap;

use repose_geometry::Image;
use repose_perception::{SegmentError, Segmented, Settings, segment_with_labels};
use repose_proto::{CallError, Frame};
use serde::Serialize;

use crate::statistics::mask_faults::MaskFaults;
use crate::statistics::mask_scores::{MaskScores, PrecisionRecall, score_masks};

/// Which half of the frames a frame belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Half {
    /// Looked at while segmentation is changed.
    Tuning,
    /// For reporting only.
    Reporting,
}

impl Half {
    /// The half of a frame by its folder's name: an even last digit is for tuning, everything else for reporting.
    ///
    /// Numbered frames of one recording share their objects, so that both halves see each kind of scene.
    pub fn of(frame: &str) -> Self {
        match frame.bytes().last() {
            Some(digit) if digit.is_ascii_digit() && digit % 2 == 0 => Self::Tuning,
            _ => Self::Reporting,
        }
    }
}

/// One frame's figures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegmentationTrial {
    /// The set that it belongs to.
    pub set: String,
    /// Its name in the set.
    pub frame: String,
    /// Its half.
    pub half: Half,
    /// Of whole masks.
    pub masks: MaskScores,
    /// Of masks without their border bands.
    pub cleaned: MaskScores,
    /// Objects of [`LARGE_READINGS`] or more of which perception says nothing at all.
    pub untold: usize,
}

/// An object with so many readings is never missing without a reason.
pub const LARGE_READINGS: usize = 1500;

/// Figures of several frames.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegmentationRow {
    /// How many frames.
    pub frames: usize,
    /// Labelled objects in them.
    pub objects: usize,
    /// Objects found in them.
    pub found: usize,
    /// On whole masks, mean over frames.
    pub overlap: PrecisionRecall,
    /// On contours, mean over frames.
    pub boundary: PrecisionRecall,
    /// Share of all labelled objects found with an overlap F above 0.75.
    pub share_75: f64,
    /// What went wrong with the rest.
    pub faults: MaskFaults,
    /// Large objects of which perception says nothing at all.
    pub untold: usize,
}

/// Perception's masks of one labelled frame, judged.
///
/// # Errors
/// `invalid_argument` on `labels` when the frame has none; what [`segment_with_labels`] says otherwise.
pub fn judge_frame(set: &str, name: &str, frame: &Frame, settings: &Settings) -> Result<SegmentationTrial, CallError> {
    let mut frame = frame.clone();
    let labels = frame.labels.take().ok_or_else(|| CallError::invalid("labels", format!("frame {name} has no labels to judge by")))?;
    let labelled = Image::from_pixels(frame.camera.width, frame.camera.height, labels)
        .map_err(|e| SegmentError::Frame(CallError::invalid("labels", e.to_string())))?;
    let segmented = segment_with_labels(&frame, settings)?;
    Ok(SegmentationTrial {
        set: set.to_owned(),
        frame: name.to_owned(),
        half: Half::of(name),
        masks: score_masks(&labelled, &segmented.labels),
        cleaned: score_masks(&labelled, &segmented.cleaned),
        untold: untold(&labelled, &segmented, &frame.depth).len(),
    })
}

/// The labelled objects of [`LARGE_READINGS`] or more of which less than half is an object or left out with a reason.
fn untold(labelled: &Image<u16>, segmented: &Segmented, depth: &[u16]) -> Vec<u16> {
    let mut counts: BTreeMap<u16, [usize; 2]> = BTreeMap::new();
    for (i, id) in labelled.pixels().iter().enumerate().filter(|(i, id)| **id != 0 && depth[*i] > 0) {
        let told = segmented.labels.pixels()[i] != 0 || segmented.left_out.pixels()[i] != 0;
        counts.entry(*id).or_insert([0; 2])[usize::from(told)] += 1;
    }
    let is_untold = |[silent, told]: [usize; 2]| silent + told >= LARGE_READINGS && told < silent;
    counts.into_iter().filter(|(_, counts)| is_untold(*counts)).map(|(id, _)| id).collect()
}

/// The row of some frames; `scores` picks which masks.
pub fn row_of<'a>(
    trials: impl IntoIterator<Item = &'a SegmentationTrial>,
    scores: impl Fn(&SegmentationTrial) -> &MaskScores,
) -> SegmentationRow {
    let trials: Vec<&SegmentationTrial> = trials.into_iter().collect();
    let untold = trials.iter().map(|trial| trial.untold).sum();
    let scores: Vec<&MaskScores> = trials.into_iter().map(scores).collect();
    let n = scores.len().max(1) as f64;
    let mean = |of: &dyn Fn(&MaskScores) -> PrecisionRecall| PrecisionRecall {
        precision: scores.iter().map(|s| of(s).precision).sum::<f64>() / n,
        recall: scores.iter().map(|s| of(s).recall).sum::<f64>() / n,
        f: scores.iter().map(|s| of(s).f).sum::<f64>() / n,
    };
    let objects: usize = scores.iter().map(|s| s.labelled).sum();
    let above_75: usize = scores.iter().map(|s| s.above_75).sum();
    SegmentationRow {
        frames: scores.len(),
        objects,
        found: scores.iter().map(|s| s.found).sum(),
        overlap: mean(&|s| s.overlap),
        boundary: mean(&|s| s.boundary),
        share_75: if objects == 0 { 1.0 } else { above_75 as f64 / objects as f64 },
        faults: scores.iter().map(|s| s.faults).fold(MaskFaults::default(), MaskFaults::plus),
        untold,
    }
}

#[cfg(test)]
mod tests {
    use repose_dataset::Split;
    use repose_sensor::SensorModel;
    use repose_simulator::furniture::SceneKind;
    use repose_simulator::generate::view_rng;
    use repose_simulator::render::DepthCanvas;
    use repose_simulator::scene::{SceneSettings, scene_of_seed};
    use repose_simulator::viewpoint::ViewpointSettings;
    use repose_simulator::views::view_of_scene;

    use super::*;
    use crate::scenes::problem::frame_of;

    #[test]
    fn frames_are_split_by_their_last_digit() {
        for (name, half) in [
            ("learn0", Half::Tuning),
            ("learn44", Half::Tuning),
            ("learn7", Half::Reporting),
            ("mustard", Half::Reporting),
            ("", Half::Reporting),
        ] {
            assert_eq!(Half::of(name), half, "{name}");
        }
    }

    #[test]
    fn a_row_is_the_mean_over_frames_and_the_share_over_objects() {
        let scores = |labelled, above_75, f| MaskScores {
            labelled,
            found: labelled,
            above_75,
            overlap: PrecisionRecall { precision: f, recall: f, f },
            boundary: PrecisionRecall::default(),
            faults: MaskFaults::default(),
        };
        let trial = |masks: MaskScores| SegmentationTrial {
            set: "s".to_owned(),
            frame: "f".to_owned(),
            half: Half::Tuning,
            masks,
            cleaned: masks,
            untold: 1,
        };
        let row = row_of(&[trial(scores(1, 1, 1.0)), trial(scores(9, 4, 0.5))], |t| &t.masks);
        assert_eq!((row.frames, row.objects, row.overlap.f, row.share_75, row.untold), (2, 10, 0.75, 0.5, 2));
    }

    #[test]
    fn a_frame_without_labels_cannot_be_judged() {
        let camera = repose_proto::CameraModel {
            width: 2,
            height: 1,
            fx: 1.0,
            fy: 1.0,
            cx: 0.0,
            cy: 0.0,
            depth_unit_m: 0.001,
            world_from_camera: None,
        };
        let frame = Frame::new("c".to_owned(), 0, camera, vec![1, 1]);
        assert_eq!(judge_frame("s", "f", &frame, &Settings::default()).unwrap_err().field.as_deref(), Some("labels"));
    }

    /// Labelled frames of validation desks.
    fn desks(scenes: u64) -> Vec<Frame> {
        let (settings, viewpoint) =
            (SceneSettings::only(SceneKind::Desk), ViewpointSettings { width: 640, height: 480, ..ViewpointSettings::default() });
        let mut canvas = DepthCanvas::new(640, 480);
        let first = Split::Validation.seeds().start;
        let frame = |seed: u64| {
            let (scene, _) = scene_of_seed(seed, &settings).ok()?;
            let seen = view_of_scene(&scene, 0, &viewpoint, false, &mut canvas, &mut view_rng(seed, 0))?;
            Some(frame_of(&scene, &seen.camera, &seen.world_from_camera, &SensorModel::structured_light(), seed))
        };
        (first..first + scenes).filter_map(frame).collect()
    }

    #[test]
    fn no_object_of_1500_readings_on_a_crowded_desk_is_missing_without_a_reason() {
        let (mut large, mut found) = (0, 0);
        for (k, mut frame) in desks(5).into_iter().enumerate() {
            let labels = frame.labels.take().expect("labels");
            let labels = Image::from_pixels(640, 480, labels).expect("as many as pixels");
            let segmented = segment_with_labels(&frame, &Settings::default()).expect("a scene");
            assert_eq!(untold(&labels, &segmented, &frame.depth), Vec::<u16>::new(), "desk {k}");
            // Nobody sees anything of these.
            let blind = Segmented { labels: Image::filled(640, 480, 0), left_out: Image::filled(640, 480, 0), ..segmented.clone() };
            large += untold(&labels, &blind, &frame.depth).len();
            let objects_only = Segmented { left_out: Image::filled(640, 480, 0), ..segmented };
            found += untold(&labels, &blind, &frame.depth).len() - untold(&labels, &objects_only, &frame.depth).len();
        }
        assert!(large >= 20 && found * 10 >= large * 9, "{found} of {large} are objects");
    }
}
