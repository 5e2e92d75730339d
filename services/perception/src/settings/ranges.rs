//! What the numbers of the settings may be. Beyond that, segmentation would find nothing and blame the picture for it, or never end.

use std::f64::consts::FRAC_PI_2;
use std::ops::RangeInclusive;

use repose_proto::CallError;
use repose_proto::checks::check_range;
use repose_proto::limits::{MAX_COORDINATE_M, MAX_IMAGE_SIDE};

use super::{
    ComponentSettings, FlyingSettings, GravitySettings, HalvesSettings, InsideSettings, LearnedSettings, LevelSettings, SelfFilterSettings,
    Settings, SurfaceSettings, TopSettings,
};

/// A setting below the settings that are checked: its name, its value, and what that may be.
type Checked = (&'static str, f64, RangeInclusive<f64>);

/// Lengths, areas, slopes, noise and multiples of these.
const MOST: f64 = MAX_COORDINATE_M as f64;
const NOT_NEGATIVE: RangeInclusive<f64> = 0.0..=MOST;
const ABOVE_ZERO: RangeInclusive<f64> = f64::MIN_POSITIVE..=MOST;
const SHARE: RangeInclusive<f64> = 0.0..=1.0;
/// Differences of logits.
const LOGIT: RangeInclusive<f64> = -MOST..=MOST;
/// Edges of cells and bins, metres: of smaller ones there would be too many.
const CELL_M: RangeInclusive<f64> = 1e-4..=1.0;
/// Pixels of a picture's side.
const SIDE_PX: f64 = MAX_IMAGE_SIDE as f64;
/// Of a peak of three bins' width a slice that is this much thinner, by rounding, misses nothing.
const ROUNDED: f64 = 0.999;
/// Counts of which at least one is needed.
const COUNT: RangeInclusive<f64> = 1.0..=SIDE_PX * SIDE_PX;

impl Settings {
    /// Checks that every number is one that can be meant.
    ///
    /// # Errors
    /// `invalid_argument` that names the setting below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        let parts: [(&str, Vec<Checked>); 14] = [
            ("", self.own()),
            ("flying.", flying(&self.flying)),
            ("self_filter.", self_filter(&self.self_filter)),
            ("borders.", vec![("radius_px", self.borders.radius_px as f64, 0.0..=SIDE_PX)]),
            ("gravity.", gravity(&self.gravity)),
            ("surfaces.", surfaces(&self.surfaces)),
            ("levels.", levels(&self.levels)),
            ("learned.", learned(&self.learned)),
            ("unseen.", vec![("cell_m", self.unseen.cell_m, CELL_M)]),
            ("components.", components(&self.components)),
            ("components.foreground.", foreground(&self.components)),
            ("components.tops.", tops(&self.components.tops)),
            ("components.insides.", insides(&self.components.insides)),
            ("components.halves.", halves(&self.components.halves)),
        ];
        let (holes, hollows) = (&self.components.holes, &self.components.hollows);
        let others = [
            ("components.holes.least_gain", f64::from(holes.least_gain), NOT_NEGATIVE),
            ("components.hollows.min_covered", hollows.min_covered, SHARE),
            ("components.hollows.rim_tolerance_m", f64::from(hollows.rim_tolerance_m), NOT_NEGATIVE),
            ("components.hollows.min_sag", f64::from(hollows.min_sag), NOT_NEGATIVE),
        ];
        for (part, checked) in parts {
            checked.into_iter().try_for_each(|(name, value, range)| check_range(&format!("{field}.{part}{name}"), value, range))?;
        }
        others.into_iter().try_for_each(|(name, value, range)| check_range(&format!("{field}.{name}"), value, range))
    }

    fn own(&self) -> Vec<Checked> {
        vec![
            ("max_depth_m", self.max_depth_m.into(), ABOVE_ZERO),
            ("max_points", self.max_points as f64, COUNT),
            ("min_object_points", self.min_object_points as f64, COUNT),
            ("coarse_columns", self.coarse_columns as f64, 1.0..=SIDE_PX),
        ]
    }
}

fn flying(s: &FlyingSettings) -> Vec<Checked> {
    vec![("max_slope", s.max_slope.into(), ABOVE_ZERO), ("noise_per_m2", s.noise_per_m2.into(), NOT_NEGATIVE)]
}

fn self_filter(s: &SelfFilterSettings) -> Vec<Checked> {
    vec![
        ("margin_m", s.margin_m.into(), NOT_NEGATIVE),
        ("look_m", s.look_m.into(), NOT_NEGATIVE),
        ("warn_m", s.warn_m.into(), NOT_NEGATIVE),
    ]
}

/// Angles beyond a right one are compared by their sines, which fall again: they would allow less, not more.
fn gravity(s: &GravitySettings) -> Vec<Checked> {
    vec![
        ("iterations", s.iterations as f64, 1.0..=1e6),
        ("sample_points", s.sample_points as f64, 3.0..=1e6),
        ("tolerance_m", s.tolerance_m.into(), NOT_NEGATIVE),
        ("tolerance_per_m2", s.tolerance_per_m2.into(), NOT_NEGATIVE),
        ("min_share", s.min_share, SHARE),
        ("max_below_ratio", s.max_below_ratio, NOT_NEGATIVE),
        ("max_roll_rad", s.max_roll_rad, 0.0..=FRAC_PI_2),
        ("max_past_vertical_rad", s.max_past_vertical_rad, 0.0..=FRAC_PI_2),
    ]
}

/// A peak of the histogram of heights is three bins wide: a thinner slice around its middle may hold none of it.
fn surfaces(s: &SurfaceSettings) -> Vec<Checked> {
    vec![
        ("max_tilt_rad", s.max_tilt_rad.into(), 0.0..=FRAC_PI_2),
        ("bin_m", s.bin_m.into(), CELL_M),
        ("tolerance_m", s.tolerance_m.into(), f64::from(1.5 * s.bin_m) * ROUNDED..=MOST),
        ("separation_m", s.separation_m.into(), NOT_NEGATIVE),
        ("cell_m", s.cell_m.into(), CELL_M),
        ("object_cell_m", s.object_cell_m.into(), CELL_M),
        ("min_area_m2", s.min_area_m2.into(), NOT_NEGATIVE),
        ("min_object_area_m2", s.min_object_area_m2.into(), NOT_NEGATIVE),
        ("max_count", s.max_count as f64, COUNT),
    ]
}

fn levels(s: &LevelSettings) -> Vec<Checked> {
    vec![
        ("usual_noise_per_m2", s.usual_noise_per_m2.into(), NOT_NEGATIVE),
        ("least_clearance_m", s.least_clearance_m.into(), NOT_NEGATIVE),
        ("clearance_deviations", s.clearance_deviations.into(), NOT_NEGATIVE),
        ("max_slope", s.max_slope.into(), NOT_NEGATIVE),
        ("seen_below_m", s.seen_below_m.into(), NOT_NEGATIVE),
        ("max_below_share", s.max_below_share.into(), SHARE),
        ("large_m2", s.large_m2.into(), NOT_NEGATIVE),
        ("large_m", s.large_m.into(), NOT_NEGATIVE),
        ("highest_top_m", s.highest_top_m.into(), NOT_NEGATIVE),
        ("rim_m", s.rim_m.into(), NOT_NEGATIVE),
        ("lowest_board_m", s.lowest_board_m.into(), NOT_NEGATIVE),
        ("hollow_m", s.hollow_m.into(), NOT_NEGATIVE),
        ("floor_below_m", s.floor_below_m.into(), NOT_NEGATIVE),
    ]
}

fn learned(s: &LearnedSettings) -> Vec<Checked> {
    vec![
        ("object_from", s.object_from.into(), LOGIT),
        ("same_from", s.same_from.into(), LOGIT),
        ("color_levels", s.color_levels.into(), ABOVE_ZERO),
        ("alike", s.alike.into(), LOGIT),
        ("unlike", s.unlike.into(), LOGIT),
        ("uncovered", s.uncovered.into(), SHARE),
    ]
}

fn components(s: &ComponentSettings) -> Vec<Checked> {
    vec![
        ("gap_m", s.gap_m.into(), NOT_NEGATIVE),
        ("noise_per_m2", s.noise_per_m2.into(), NOT_NEGATIVE),
        ("crease_arm_m", s.crease_arm_m.into(), NOT_NEGATIVE),
        ("crease_depth_m", s.crease_depth_m.into(), NOT_NEGATIVE),
        ("max_extent_m", s.max_extent_m.into(), ABOVE_ZERO),
        ("min_inside", s.min_inside.into(), SHARE),
        ("max_count", s.max_count as f64, COUNT),
    ]
}

fn foreground(s: &ComponentSettings) -> Vec<Checked> {
    let s = &s.foreground;
    vec![
        ("like_deviations", s.like_deviations.into(), NOT_NEGATIVE),
        ("least_m", s.least_m.into(), NOT_NEGATIVE),
        ("seed_deviations", s.seed_deviations.into(), NOT_NEGATIVE),
        ("belongs_deviations", s.belongs_deviations.into(), NOT_NEGATIVE),
        ("slack_m", s.slack_m.into(), NOT_NEGATIVE),
        ("beyond_m", s.beyond_m.into(), NOT_NEGATIVE),
    ]
}

fn tops(s: &TopSettings) -> Vec<Checked> {
    vec![
        ("min_area_m2", s.min_area_m2.into(), NOT_NEGATIVE),
        ("max_slope", s.max_slope.into(), NOT_NEGATIVE),
        ("least_m", s.least_m.into(), NOT_NEGATIVE),
        ("like_deviations", s.like_deviations.into(), NOT_NEGATIVE),
        ("on_deviations", s.on_deviations.into(), NOT_NEGATIVE),
        ("min_flat", s.min_flat.into(), SHARE),
        ("max_rim", s.max_rim.into(), SHARE),
        ("look_m", s.look_m.into(), NOT_NEGATIVE),
        ("inset_m", s.inset_m.into(), NOT_NEGATIVE),
    ]
}

fn insides(s: &InsideSettings) -> Vec<Checked> {
    vec![
        ("step_m", s.step_m.into(), NOT_NEGATIVE),
        ("noise_per_m2", s.noise_per_m2.into(), NOT_NEGATIVE),
        ("look_m", s.look_m.into(), NOT_NEGATIVE),
        ("min_rim", s.min_rim.into(), SHARE),
        ("max_open", s.max_open.into(), SHARE),
        ("min_within", s.min_within.into(), SHARE),
        ("around_m", s.around_m.into(), NOT_NEGATIVE),
        ("least_m", s.least_m.into(), NOT_NEGATIVE),
        ("same_color", s.same_color.into(), SHARE),
    ]
}

fn halves(s: &HalvesSettings) -> Vec<Checked> {
    vec![
        ("min_agreement", s.min_agreement, SHARE),
        ("tolerance_m", s.tolerance_m.into(), NOT_NEGATIVE),
        ("noise_per_m2", s.noise_per_m2.into(), NOT_NEGATIVE),
        ("rim_tolerance_m", s.rim_tolerance_m.into(), NOT_NEGATIVE),
        ("cover_step_m", s.cover_step_m.into(), NOT_NEGATIVE),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_meant_is_refused_by_name() {
        /// What is named, and how it is made wrong.
        type Fault = (&'static str, fn(&mut Settings));
        let faulty: [Fault; 10] = [
            ("surfaces.bin_m", |s| s.surfaces.bin_m = 0.0),
            ("surfaces.tolerance_m", |s| (s.surfaces.bin_m, s.surfaces.tolerance_m) = (0.01, 0.002)),
            ("max_depth_m", |s| s.max_depth_m = -4.0),
            ("max_depth_m", |s| s.max_depth_m = f32::NAN),
            ("max_points", |s| s.max_points = 0),
            ("coarse_columns", |s| s.coarse_columns = 0),
            ("gravity.min_share", |s| s.gravity.min_share = 1.1),
            ("gravity.max_roll_rad", |s| s.gravity.max_roll_rad = 3.1),
            ("gravity.max_past_vertical_rad", |s| s.gravity.max_past_vertical_rad = 2.0),
            ("components.insides.step_m", |s| s.components.insides.step_m = f32::INFINITY),
        ];
        let mut thin = Settings::default();
        assert_eq!(thin.validate("segmentation"), Ok(()));
        thin.surfaces.bin_m = 0.008;
        assert_eq!(thin.validate("segmentation"), Ok(()), "just thick enough");
        for (named, fault) in faulty {
            let mut settings = Settings::default();
            fault(&mut settings);
            let field = settings.validate("segmentation").unwrap_err().field;
            assert_eq!(field, Some(format!("segmentation.{named}")));
        }
    }
}
