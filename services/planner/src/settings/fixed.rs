//! The numbers that no request changes: tolerances, proposals, refitting, ranking.
//!
//! Unless a field says otherwise, they were chosen by hand on validation scenes of the simulator and looked at on real frames.

use repose_belief::settings::ViewSettings;

/// The settings that requests cannot change.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Fixed {
    /// Ranking by networks.
    pub ranking: RankingSettings,
    /// How the object must stand where it was seen.
    pub standing: StandingSettings,
    /// The in-view constraint.
    pub view: ViewSettings,
    /// What is right under a candidate.
    pub support: SupportSettings,
    /// What is in a candidate's way.
    pub clearance: ClearanceSettings,
    /// Space that was not seen.
    pub unseen: UnseenShareSettings,
    /// The reach of a robot that a request names.
    pub reach: ReachSettings,
    /// Goals by rule.
    pub rules: RuleSettings,
    /// Proposals from the goal's geometry.
    pub proposals: ProposerSettings,
    /// Refitting.
    pub surrogate: SurrogateSettings,
    /// Ranking by geometry.
    pub soundness: SoundnessSettings,
}

/// Where networks only rank: the shortlist that they are asked about at the end of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct RankingSettings {
    /// Its length, at most; levels of support take turns.
    pub candidates: usize,
    /// The networks are asked about at least so many of it at once, where so many may be answers: they share the cores.
    pub asked_at_once: usize,
    /// Its candidates are at least this far apart, metres.
    pub apart_m: f64,
    /// Where all of it are doubted, as many again are asked about that are this far from those and apart, metres.
    pub elsewhere_m: f64,
    /// Each is tried again when it ends up this far off, metres …
    pub off_m: f32,
    /// … and this far turned, radians.
    pub off_rad: f32,
    /// Where it gives fewer answers than asked, the networks are asked about farther candidates, so many times at most.
    pub more_rounds: usize,
    /// What it costs to be certain to fail, in units of λ_f.
    pub unsure: f64,
    /// Least probability of success where a request does not say: what will more likely fail is no answer.
    pub min_success: f64,
}

impl Default for RankingSettings {
    fn default() -> Self {
        Self {
            candidates: 32,
            asked_at_once: 4,
            apart_m: 0.012,
            elsewhere_m: 0.05,
            off_m: 0.005,
            off_rad: 3.0_f32.to_radians(),
            more_rounds: 4,
            unsure: 2.0,
            min_success: 0.5,
        }
    }
}

/// Space that was not seen may hold anything.
#[derive(Debug, Clone, PartialEq)]
pub struct UnseenShareSettings {
    /// Largest share of the query's volume in it.
    pub max_share: f64,
    /// Distance between the places tried in the query's volume, metres.
    pub step_m: f32,
}

impl Default for UnseenShareSettings {
    fn default() -> Self {
        Self { max_share: 0.6, step_m: 0.015 }
    }
}

/// What is right under a candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct SupportSettings {
    /// A top within this of the bottom carries it, metres. Covers the noise of depth and a tilt of 2° across an object.
    pub tolerance_m: f32,
    /// A place is empty when the camera saw at least this far past it, metres.
    pub through_m: f32,
    /// Share of the highest tops under the base that are taken for stray points.
    pub stray_share: f32,
    /// Tops within this of the highest belong to the same support, metres.
    pub same_support_m: f32,
    /// What reaches higher than this into the query, as it would stand among them, carries it instead, metres.
    pub reached_into_m: f32,
    /// A support surface's own height is used where the tops agree with it to this, metres.
    pub plane_m: f32,
    /// The height of release above the support, metres. A bottom is known to a few millimetres: a fall of that much is harmless, being
    /// pressed into the support is not.
    pub release_m: f32,
    /// Least distance of the axis from the edge of what carries it, metres.
    pub min_margin_m: f64,
    /// Least share of the base that was seen to be carried.
    pub min_seen_share: f64,
    /// Least share of the base that is carried where furniture carries it, what is hidden within a surface included.
    pub min_carried_share: f64,
    /// Levels farther than this from where things stand, and from their tops, count only when they are asked for, metres.
    pub far_level_m: f32,
}

impl Default for SupportSettings {
    fn default() -> Self {
        Self {
            tolerance_m: 0.008,
            through_m: 0.025,
            stray_share: 0.03,
            same_support_m: 0.012,
            reached_into_m: 0.004,
            plane_m: 0.008,
            release_m: 0.004,
            min_margin_m: 0.008,
            min_seen_share: 0.25,
            min_carried_share: 0.9,
            far_level_m: 0.35,
        }
    }
}

/// What is in a candidate's way.
#[derive(Debug, Clone, PartialEq)]
pub struct ClearanceSettings {
    /// How far around the query clearance is measured during the search, metres.
    pub ring_m: f32,
    /// How far at most where a clearance is asked for.
    pub max_ring_m: f32,
    /// Things that reach no deeper than this into the query's outline do not collide, metres (outlines are grown by the trim).
    pub graze_m: f32,
    /// Things that reach this deep into the query's outline are no stray points, metres, if they fill more than a few cells of one slab: deeper than what
    /// may be pressed into, and an error of what was seen.
    pub deep_m: f32,
    /// The same for an anchor that must be touched.
    pub touch_m: f32,
    /// Up to this many cells in the way are stray points.
    pub stray_cells: usize,
    /// Or this share of the query's cells, whichever is more.
    pub stray_share: f32,
    /// The clearance passes over so many of the nearest points.
    pub stray_points: usize,
}

impl Default for ClearanceSettings {
    fn default() -> Self {
        Self {
            ring_m: 0.04,
            max_ring_m: 0.12,
            graze_m: 0.002,
            deep_m: 0.006,
            touch_m: 0.009,
            stray_cells: 2,
            stray_share: 0.01,
            stray_points: 2,
        }
    }
}

/// The reach of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ReachSettings {
    /// Farther than this from the shoulder is out of reach without a further look, metres: an arm straightened to the grasp centre.
    pub max_m: f64,
    /// Where, away from the base, an arm has most room, metres.
    pub middle_m: f64,
    /// Height of the standoff above the place, metres: motion's.
    pub standoff_m: f64,
    /// Attitudes of the hand from straight down to leaning outwards …
    pub leans: usize,
    /// … this far apart, radians.
    pub lean_step_rad: f64,
    /// Directions in which the hand closes, over half a turn.
    pub turns: usize,
    /// Angles of the last joint that are tried.
    pub sweep: usize,
}

impl Default for ReachSettings {
    fn default() -> Self {
        Self { max_m: 1.1, middle_m: 0.5, standoff_m: 0.1, leans: 4, lean_step_rad: 25.0_f64.to_radians(), turns: 4, sweep: 12 }
    }
}

/// Goals by rule.
#[derive(Debug, Clone, PartialEq)]
pub struct RuleSettings {
    /// Least margin by which a direction must hold (or not hold), metres: the pose will not be exact to the millimetre.
    pub min_margin_m: f64,
    /// A direction is as good as certain from this margin on, metres.
    pub comfort_m: f64,
    /// Heights of a bottom and a top this close are in contact, metres.
    pub contact_m: f64,
}

impl Default for RuleSettings {
    fn default() -> Self {
        Self { min_margin_m: 0.003, comfort_m: 0.06, contact_m: 0.009 }
    }
}

/// Proposals from the goal's geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposerSettings {
    /// Farthest gap between query and anchor along the asked direction, metres.
    pub reach_m: f64,
    /// Share of the proposals that come from anywhere on the observed surfaces (or in the asked regions) instead.
    pub anywhere_share: f64,
    /// Share of the proposals that are lowered from above everything; the others from just above a support surface.
    pub from_above_share: f64,
    /// A candidate is lowered from this far above where it was drawn, metres.
    pub lowered_m: f32,
    /// Until so many candidates are feasible, proposals go on beside the modes: the first one found may be doubted later, with all around it.
    pub fresh_until: usize,
}

impl Default for ProposerSettings {
    fn default() -> Self {
        Self { reach_m: 0.3, anywhere_share: 0.15, from_above_share: 0.5, lowered_m: 0.04, fresh_until: 8 }
    }
}

/// Refitting the surrogate.
#[derive(Debug, Clone, PartialEq)]
pub struct SurrogateSettings {
    /// How far the sample covariance is drawn towards its diagonal.
    pub shrinkage: f64,
    /// Standard deviations added on top: x, y, z in metres, yaw in radians.
    pub floor: [f64; 4],
    /// With fewer feasible candidates than this, elites are chosen by least violation.
    pub min_feasible: usize,
    /// Most modes that are searched apart.
    pub max_modes: usize,
    /// Heights of one mode are at most this far apart, metres.
    pub level_gap_m: f32,
    /// Elites farther than this from their mode's best belong to another place, metres.
    pub reach_m: f64,
}

impl Default for SurrogateSettings {
    fn default() -> Self {
        Self {
            shrinkage: 0.3,
            floor: [0.005, 0.005, 0.002, 3.0_f64.to_radians()],
            min_feasible: 4,
            max_modes: 5,
            level_gap_m: 0.025,
            reach_m: 0.15,
        }
    }
}

/// How an object must stand where it was seen, by the forecasts, for an answer.
#[derive(Debug, Clone, PartialEq)]
pub struct StandingSettings {
    /// Least probability that it stands by itself: more likely than not. Answers of objects that do so hardly are left to the forecast of success,
    /// which reads this probability too; a limit of 0.7 beside it cost a right answer and spared a wrong one in 420 validation scenes.
    pub min_stands: f64,
    /// Least probability that each of its neighbours stays when it is taken away.
    pub min_neighbour_stays: f64,
}

impl Default for StandingSettings {
    fn default() -> Self {
        Self { min_stands: 0.5, min_neighbour_stays: 0.3 }
    }
}

/// Ranking by geometry: shortfalls from what would be comfortable, each 0 to 1, weighted.
#[derive(Debug, Clone, PartialEq)]
pub struct SoundnessSettings {
    /// Distance of the axis from the edge of its support that is comfortable, metres, or …
    pub support_m: f64,
    /// … this share of what the base allows at most, whichever is less.
    pub support_share: f64,
    /// Clearance that is comfortable, metres.
    pub clearance_m: f64,
    /// Width of the band around the base that should be carried too, metres.
    pub rim_m: f32,
    /// What each shortfall costs.
    pub weights: SoundnessWeights,
    /// Cost per metre of distance from the main anchor.
    pub distance_per_m: f64,
}

/// What a full shortfall of each kind costs, in units of λ_f. Chosen by hand on validation scenes of the simulator.
#[derive(Debug, Clone, PartialEq)]
pub struct SoundnessWeights {
    /// The axis is near the edge of its support.
    pub edge: f64,
    /// The base was not seen to be carried.
    pub base_not_seen: f64,
    /// Something is near.
    pub clearance: f64,
    /// Its points would be hidden from the camera.
    pub hidden: f64,
    /// The band around its base is not carried.
    pub rim: f64,
    /// An object carries it that no goal term asks for.
    pub stranger: f64,
    /// Its volume is in space that was not seen.
    pub unseen_space: f64,
    /// Small errors of its pose break a constraint.
    pub fragile: f64,
    /// Something is where its unseen back may reach.
    pub doubtful: f64,
    /// Something is where an end of it is if it is farther out than believed.
    pub farther: f64,
}

impl Default for SoundnessWeights {
    fn default() -> Self {
        Self {
            edge: 0.5,
            base_not_seen: 0.35,
            clearance: 0.35,
            hidden: 0.1,
            rim: 0.3,
            stranger: 0.25,
            unseen_space: 0.3,
            fragile: 0.5,
            doubtful: 0.3,
            farther: 0.6,
        }
    }
}

impl Default for SoundnessSettings {
    fn default() -> Self {
        Self {
            support_m: 0.03,
            support_share: 0.8,
            clearance_m: 0.03,
            rim_m: 0.02,
            weights: SoundnessWeights::default(),
            distance_per_m: 0.3,
        }
    }
}
