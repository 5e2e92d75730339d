//! What objects are told apart by without the network, and completed by.

use serde::Deserialize;

/// What rises above furniture.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ForegroundSettings {
    /// Readings that differ by at most so many standard deviations are averaged.
    pub like_deviations: f32,
    /// Least rise above furniture, metres, whatever the noise: real cameras' planes bend.
    pub least_m: f32,
    /// What rises by so many standard deviations more stands on it.
    pub seed_deviations: f32,
    /// Beside that, what rises by so many belongs to it.
    pub belongs_deviations: f32,
    /// How far outside the outline of furniture something may stand on it, metres: it hides its rim.
    pub slack_m: f32,
    /// How far outside what stands on it may reach, metres.
    pub beyond_m: f32,
}

impl Default for ForegroundSettings {
    fn default() -> Self {
        Self { like_deviations: 3.0, least_m: 0.002, seed_deviations: 4.0, belongs_deviations: 2.0, slack_m: 0.05, beyond_m: 0.25 }
    }
}

/// What is a flat top, and what stands on it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TopSettings {
    /// Fewest pixels of the coarse picture.
    pub min_pixels: usize,
    /// Least area of its outline, square metres.
    pub min_area_m2: f32,
    /// Steepest slope.
    pub max_slope: f32,
    /// Heights that differ by this are one, metres, whatever the noise.
    pub least_m: f32,
    /// Neighbours differ by at most so many standard deviations more.
    pub like_deviations: f32,
    /// What lies within so many of the top's plane is of it.
    pub on_deviations: f32,
    /// Least share of a region that lies in its plane.
    pub min_flat: f32,
    /// Most of its border that may be higher than it, a share.
    pub max_rim: f32,
    /// How far beyond the border that is looked at, metres: more than the half length over which a pixel is told to face up.
    pub look_m: f32,
    /// What stands on a top lies this far inside its outline, metres.
    pub inset_m: f32,
}

impl Default for TopSettings {
    fn default() -> Self {
        Self {
            min_pixels: 80,
            min_area_m2: 0.003,
            max_slope: 0.35,
            least_m: 0.002,
            like_deviations: 2.0,
            on_deviations: 3.0,
            min_flat: 0.8,
            max_rim: 0.6,
            look_m: 0.022,
            inset_m: 0.004,
        }
    }
}

/// How objects are told apart without labels.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ComponentSettings {
    /// Telling what rises above the furniture.
    pub foreground: ForegroundSettings,
    /// Cutting what stands on a flat top from it.
    pub tops: TopSettings,
    /// Neighbouring readings of one object are at most this far apart, metres; `noise_per_m2` adds to it.
    pub gap_m: f32,
    /// Depth noise added to the lengths above, metres per square metre of depth.
    pub noise_per_m2: f32,
    /// Half the length over which a crease between touching objects is looked for, metres.
    pub crease_arm_m: f32,
    /// Depth of the crease over that length from which it separates, metres; `noise_per_m2` adds to it.
    pub crease_depth_m: f32,
    /// What is cut at creases must have this many readings on the coarse picture to be a part of its own.
    pub min_part_pixels: usize,
    /// Components with fewer readings on the coarse picture are too small for an object.
    pub min_pixels: usize,
    /// Those with fewer than this are not even told of.
    pub min_told_pixels: usize,
    /// Components with a longer edge of their box are background, metres.
    pub max_extent_m: f32,
    /// Least share of an object's readings that lie over the outline of what it stands on.
    pub min_inside: f32,
    /// Widest gap in the readings of a mask that is filled, pixels of the frame.
    pub max_gap_px: usize,
    /// Most objects; the largest are kept.
    pub max_count: usize,
    /// Completing masks where the camera reads nothing, by color.
    pub holes: HoleSettings,
    /// Joining the inside of hollow objects with their outside.
    pub hollows: HollowSettings,
    /// Giving objects what their rims surround.
    pub insides: InsideSettings,
    /// Joining what shows of an object on both sides of another.
    pub halves: HalvesSettings,
}

impl Default for ComponentSettings {
    fn default() -> Self {
        Self {
            foreground: ForegroundSettings::default(),
            tops: TopSettings::default(),
            gap_m: 0.008,
            noise_per_m2: 0.003,
            crease_arm_m: 0.012,
            crease_depth_m: 0.002,
            min_part_pixels: 100,
            min_pixels: 60,
            min_told_pixels: 12,
            max_extent_m: 0.8,
            min_inside: 0.2,
            max_gap_px: 24,
            max_count: 64,
            holes: HoleSettings::default(),
            hollows: HollowSettings::default(),
            insides: InsideSettings::default(),
            halves: HalvesSettings::default(),
        }
    }
}

/// How far masks reach over pixels without a reading.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HoleSettings {
    /// How far a mask reaches, pixels of the frame; where color changes a step counts as many more as levels differ. Raising it completes larger
    /// holes, and takes more of what is not read beside an object for a part of it. At 0 nothing is completed.
    pub reach: u16,
    /// A mask that would gain a smaller share of its readings stays as it is read.
    pub least_gain: f32,
}

impl Default for HoleSettings {
    fn default() -> Self {
        Self { reach: 80, least_gain: 0.5 }
    }
}

/// What makes one component the inside of another.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HollowSettings {
    /// Least share of the inside's columns that end on the outside.
    pub min_covered: f64,
    /// Most pixels of the coarse picture between the two in a column: the floor that is seen inside.
    pub max_floor_px: usize,
    /// Most that the upper ends of the two differ in height, metres.
    pub rim_tolerance_m: f32,
    /// Least sag of the inside's rows, as a share of their length. A half circle sags by 0.5.
    pub min_sag: f32,
    /// Shorter rows, in pixels of the coarse picture, are not judged.
    pub min_row_px: usize,
}

impl Default for HollowSettings {
    fn default() -> Self {
        Self { min_covered: 0.6, max_floor_px: 25, rim_tolerance_m: 0.025, min_sag: 0.06, min_row_px: 6 }
    }
}

/// What makes readings near the table the inside of an object.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InsideSettings {
    /// Fewest readings on the coarse picture. Lowering it also tells of small holes, as of handles.
    pub min_pixels: usize,
    /// Neighbouring readings differ in height by at most this without a step, metres; `noise_per_m2` adds to it.
    pub step_m: f32,
    /// Depth noise added to heights, metres per square metre of depth.
    pub noise_per_m2: f32,
    /// How far from its border the rim may be, metres: what is high leaves a shadow beside it.
    pub look_m: f32,
    /// Least share of the border, the picture's edges left out, beside one object.
    pub min_rim: f32,
    /// Most of the border from which a way leads out, a share.
    pub max_open: f32,
    /// Least share of it that lies over the convex outline of that object.
    pub min_within: f32,
    /// The table is looked at up to this far around the object, metres.
    pub around_m: f32,
    /// It rises clearly where it does by this, metres; `noise_per_m2` adds to it.
    pub least_m: f32,
    /// Where this share of it looks more like the object than like the table it is the object's, where so much looks more like the table it is that.
    pub same_color: f32,
}

impl Default for InsideSettings {
    fn default() -> Self {
        Self {
            min_pixels: 150,
            step_m: 0.003,
            noise_per_m2: 0.003,
            look_m: 0.022,
            min_rim: 0.5,
            max_open: 0.1,
            min_within: 0.5,
            around_m: 0.1,
            least_m: 0.002,
            same_color: 0.75,
        }
    }
}

/// What makes two components the ends of one object behind a third.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HalvesSettings {
    /// Fewest rows and columns of the coarse picture that must see both ends.
    pub min_lines: usize,
    /// Least share of those on which the ends continue each other.
    pub min_agreement: f64,
    /// Most that the surfaces may lie off one line, metres; `noise_per_m2` adds to it.
    pub tolerance_m: f32,
    /// Depth noise added to the tolerance, metres per square metre of depth.
    pub noise_per_m2: f32,
    /// Most that the upper ends of the two differ in height, metres.
    pub rim_tolerance_m: f32,
    /// What covers must be nearer by this, metres.
    pub cover_step_m: f32,
    /// Length over which each end's direction is taken, pixels of the coarse picture.
    pub arm_px: usize,
    /// Shorter ends are not judged, pixels of the coarse picture.
    pub min_run_px: usize,
    /// Widest shadow without a label between an end and what covers it, pixels of the coarse picture.
    pub max_shadow_px: usize,
}

impl Default for HalvesSettings {
    fn default() -> Self {
        Self {
            min_lines: 5,
            min_agreement: 0.6,
            tolerance_m: 0.004,
            noise_per_m2: 0.004,
            rim_tolerance_m: 0.025,
            cover_step_m: 0.01,
            arm_px: 12,
            min_run_px: 4,
            max_shadow_px: 15,
        }
    }
}
