//! What segmentation can be told. Every field has a default that suits a depth camera half a metre to two metres from a table.
//!
//! Where the defaults come from: depth noise per square metre follows the published figures of structured light in `repose-sensor`; lengths
//! of objects, creases, hollows and halves were chosen on the tuning half (names ending in an even digit) of the real frames `mosd`. The
//! other half is for reporting.

use serde::Deserialize;

/// Settings of [`segment`](crate::segment::segment).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Readings beyond this are treated as missing, metres. Raising it lets walls and floors far behind the table into the scene.
    pub max_depth_m: f32,
    /// Most points in a scene; more are thinned evenly. Raising it makes scenes larger on the wire (17 bytes a point).
    pub max_points: usize,
    /// An object that keeps fewer points than this after cleaning is no object of the scene; its points stay, as nobody's.
    pub min_object_points: usize,
    /// Columns of the coarse picture that supports, surfaces and components are found on; raising it costs time, quadratically.
    pub coarse_columns: usize,
    /// Removing readings that hang in the air.
    pub flying: FlyingSettings,
    /// Telling the robots from the rest of the picture.
    pub self_filter: SelfFilterSettings,
    /// Removing the uncertain band around every mask.
    pub borders: BorderSettings,
    /// Finding out which way is up.
    pub gravity: GravitySettings,
    /// Finding surfaces that objects can stand on.
    pub surfaces: SurfaceSettings,
    /// Telling furniture, however covered, from the tops of things.
    pub levels: LevelSettings,
    /// Finding objects when no labels are given.
    pub components: ComponentSettings,
    /// Finding them with the network for masks, too.
    pub learned: LearnedSettings,
    /// Telling where nothing was seen.
    pub unseen: UnseenSettings,
    /// Seed of every random draw, so that the same frame gives the same scene.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_depth_m: 4.0,
            max_points: 320_000,
            min_object_points: 50,
            coarse_columns: 320,
            flying: FlyingSettings::default(),
            self_filter: SelfFilterSettings::default(),
            borders: BorderSettings::default(),
            gravity: GravitySettings::default(),
            surfaces: SurfaceSettings::default(),
            levels: LevelSettings::default(),
            components: ComponentSettings::default(),
            learned: LearnedSettings::default(),
            unseen: UnseenSettings::default(),
            seed: 0,
        }
    }
}

/// What counts as a reading between two surfaces.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlyingSettings {
    /// Steepest surface, depth per distance across the view (a tangent); neighbouring pixels of one surface differ by no more. Raising it
    /// keeps more of surfaces seen at a glance, and more stray readings.
    pub max_slope: f32,
    /// Depth noise added to that difference, metres per square metre of depth.
    pub noise_per_m2: f32,
}

impl Default for FlyingSettings {
    fn default() -> Self {
        Self { max_slope: 6.0, noise_per_m2: 0.006 }
    }
}

/// What counts as part of a robot.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SelfFilterSettings {
    /// Readings up to this far outside the robot's balls are its own, metres. Raising it bears worse calibration, and hides more beside the arm.
    pub margin_m: f32,
    /// How far from its place a robot is looked for, metres.
    pub look_m: f32,
    /// A robot seen further than this from its place is warned of, metres.
    pub warn_m: f32,
    /// Fewest readings between the fingers that make a held object.
    pub held_readings: usize,
}

impl Default for SelfFilterSettings {
    fn default() -> Self {
        Self { margin_m: 0.02, look_m: 0.06, warn_m: 0.015, held_readings: 30 }
    }
}

/// How finely unseen space is told.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnseenSettings {
    /// Edge of the cubes, metres; larger where the furniture is too wide or too high for [`UnseenSpace`](repose_proto::UnseenSpace).
    /// Lowering it costs time and bytes, quadratically, and lowers how high the cubes reach.
    pub cell_m: f64,
}

impl Default for UnseenSettings {
    fn default() -> Self {
        Self { cell_m: 0.02 }
    }
}

/// What the network for masks is asked, and how far it is believed.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnedSettings {
    /// Whether it is asked at all.
    pub enabled: bool,
    /// Logit from which a pixel shows an object. Lowering it finds more objects, and takes more furniture for some.
    pub object_from: f32,
    /// Logit from which a pair of pixels shows one object. Raising it cuts more.
    pub same_from: f32,
    /// Colors that differ by fewer levels, of 255, speak for one object, others for two.
    pub color_levels: f32,
    /// What the same color adds to the logit of a pair. Raising it joins more, and with it neighbours of one color.
    pub alike: f32,
    /// What colors that differ by twice `color_levels` or more take from the logit. Raising it cuts more, and with it what is printed on an object.
    pub unlike: f32,
    /// Groups with fewer readings on the coarse picture are too small for an object.
    pub min_pixels: usize,
    /// What geometry finds stays as geometry says where the network's objects cover less than this share of it; at 0 only the network says what is an
    /// object. Raising it finds again what the network missed, and furniture that geometry takes for objects.
    pub uncovered: f32,
}

impl Default for LearnedSettings {
    fn default() -> Self {
        Self {
            enabled: true,
            object_from: 0.0,
            same_from: -1.0,
            color_levels: 40.0,
            alike: 2.0,
            unlike: 2.0,
            min_pixels: 25,
            uncovered: 0.0,
        }
    }
}

/// How wide the band around a mask is.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BorderSettings {
    /// Radius of the dilation and of the erosion, pixels of the frame. Raising it removes more stray pixels, and thin parts of objects.
    pub radius_px: usize,
}

impl Default for BorderSettings {
    fn default() -> Self {
        Self { radius_px: 2 }
    }
}

/// How the main support plane is found.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GravitySettings {
    /// Planes tried. Raising it finds a support that fills less of the view.
    pub iterations: usize,
    /// Readings that each plane is judged on, spread evenly over the picture.
    pub sample_points: usize,
    /// How far from the plane a reading may be at no distance, metres.
    pub tolerance_m: f32,
    /// What a reading's depth adds to that tolerance, metres per square metre of depth (noise of structured light grows with its square).
    pub tolerance_per_m2: f32,
    /// Least share of the readings that the plane must hold.
    pub min_share: f64,
    /// Fewest readings that it must hold, of those judged on: any three make a plane.
    pub min_readings: usize,
    /// Most readings below the plane, as a multiple of those on it: what the objects stand on has little beneath it.
    pub max_below_ratio: f64,
    /// Largest roll of the camera about its optical axis, radians.
    pub max_roll_rad: f64,
    /// How far past straight down the camera may look, radians. Raising it lets walls pass for tables.
    pub max_past_vertical_rad: f64,
}

impl Default for GravitySettings {
    fn default() -> Self {
        Self {
            iterations: 300,
            sample_points: 3000,
            tolerance_m: 0.004,
            tolerance_per_m2: 0.004,
            min_share: 0.1,
            min_readings: 50,
            max_below_ratio: 1.0,
            max_roll_rad: 0.8,
            max_past_vertical_rad: 0.1,
        }
    }
}

/// What counts as a support surface.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceSettings {
    /// Largest angle between a surface's normal and up, radians.
    pub max_tilt_rad: f32,
    /// Height of a bin of the height histogram, metres.
    pub bin_m: f32,
    /// Half the thickness of the slice that makes one surface, metres.
    pub tolerance_m: f32,
    /// Two surfaces of the same object (or of none) lie at least this far apart in height where they overlap, metres.
    pub separation_m: f32,
    /// Edge of the cells that connect a surface's readings, metres, for surfaces of the furniture.
    pub cell_m: f32,
    /// The same for the tops of objects, which are smaller and nearer.
    pub object_cell_m: f32,
    /// Least area of a surface of the furniture, square metres.
    pub min_area_m2: f32,
    /// Least area of an object's top, square metres.
    pub min_object_area_m2: f32,
    /// Most surfaces of the furniture, and most of each object.
    pub max_count: usize,
}

impl Default for SurfaceSettings {
    fn default() -> Self {
        Self {
            max_tilt_rad: 0.44,
            bin_m: 0.004,
            tolerance_m: 0.012,
            separation_m: 0.03,
            cell_m: 0.03,
            object_cell_m: 0.01,
            min_area_m2: 0.02,
            min_object_area_m2: 0.0015,
            max_count: 8,
        }
    }
}

/// How furniture is told from the tops of things.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LevelSettings {
    /// Depth noise that is assumed until a large level says better, metres per square metre of depth, one standard deviation.
    pub usual_noise_per_m2: f32,
    /// Readings within this of a plane lie on it whatever the noise, metres.
    pub least_clearance_m: f32,
    /// And within so many standard deviations of the noise.
    pub clearance_deviations: f32,
    /// Steepest slope of a level, which errors of the camera's pose give it.
    pub max_slope: f32,
    /// What lies this far below a plane was seen below it, metres.
    pub seen_below_m: f32,
    /// Most of what is seen between two pieces of one level that may lie below it, a share.
    pub max_below_share: f32,
    /// A level with an outline of this area is furniture, square metres.
    pub large_m2: f32,
    /// And one as long as this, metres.
    pub large_m: f32,
    /// A level higher than this above the furniture below it is furniture, metres.
    pub highest_top_m: f32,
    /// A level may stand over the rim of what it stands on by this, metres: it hides the rim.
    pub rim_m: f32,
    /// A level half as large that is hollow beneath is a board where it is this high above what is below it, metres.
    pub lowest_board_m: f32,
    /// A level is hollow beneath where readings lie this far under it, metres.
    pub hollow_m: f32,
    /// Fewest such readings, of the 6000 that are looked at.
    pub hollow_readings: usize,
    /// Furniture this far below other furniture is a floor, metres.
    pub floor_below_m: f32,
}

impl Default for LevelSettings {
    fn default() -> Self {
        Self {
            usual_noise_per_m2: 0.0018,
            least_clearance_m: 0.002,
            clearance_deviations: 3.0,
            max_slope: 0.05,
            seen_below_m: 0.03,
            max_below_share: 0.15,
            large_m2: 0.15,
            large_m: 0.6,
            highest_top_m: 0.36,
            rim_m: 0.1,
            lowest_board_m: 0.18,
            hollow_m: 0.06,
            hollow_readings: 40,
            floor_below_m: 0.36,
        }
    }
}

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
