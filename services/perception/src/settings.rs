//! What segmentation can be told. Every field has a default that suits a depth camera half a metre to two metres from a table.
//!
//! Where the defaults come from: depth noise per square metre follows the published figures of structured light in `repose-sensor`; lengths
//! of objects, creases, hollows and halves were chosen on the tuning half (names ending in an even digit) of the real frames `mosd`. The
//! other half is for reporting.

mod components;
mod ranges;

use serde::Deserialize;

pub use components::{ComponentSettings, ForegroundSettings, HalvesSettings, HoleSettings, HollowSettings, InsideSettings, TopSettings};

/// Settings of [`segment`](crate::segment::segment).
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// Readings beyond this are treated as missing, metres. Raising it lets walls and floors far behind the table into the scene.
    pub max_depth_m: f32,
    /// Most points in a scene; more are thinned evenly, but of each object `min_object_points` stay. Raising it makes scenes larger on the wire (17 bytes
    /// a point).
    pub max_points: usize,
    /// An object that keeps fewer points than this after cleaning is no object of the scene; its points stay, as nobody's.
    pub min_object_points: usize,
    /// Columns of the coarse picture that supports, surfaces and components are found on, where it is of 4:3; others have about as many
    /// pixels. Raising it costs time, quadratically.
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
    /// Radius of the dilation and of the erosion, pixels of the frame; where depth was registered into a larger picture and fills blocks of pixels with each
    /// reading, blocks. Raising it removes more stray pixels, and small parts of objects; thin ones keep their middle.
    pub radius_px: usize,
}

impl BorderSettings {
    /// The same in pixels of a picture that repeats each reading so wide.
    pub fn repeated(&self, repeat_px: usize) -> Self {
        Self { radius_px: self.radius_px.saturating_mul(repeat_px) }
    }
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
    /// Largest roll of the camera about its optical axis, radians; a right angle at most, which is any roll but for one held upside down.
    pub max_roll_rad: f64,
    /// How far past straight down the camera may look, radians; a right angle at most. Raising it lets walls pass for tables.
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
    /// Half the thickness of the slice that makes one surface, metres; at least one and a half bins.
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
    /// Steepest slope of a level, and of a surface that objects can stand on, which errors of the camera's pose give it.
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
