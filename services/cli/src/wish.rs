//! A placement wished for on the command line, and the request that it becomes.

use std::f64::consts::TAU;

use clap::Args;
use repose_proto::place::{Budget, ReachingRobot, Rotation, Variant};
use repose_proto::{CallError, GoalTerm, PlaceRequest, Scene};

use crate::failure::Failure;
use crate::say::{SentenceMeaning, wish_of};
use crate::values::{parse_rotation, parse_variant};

/// A placement wished for: what both `plan` and `place` take.
#[derive(Debug, Clone, Args)]
pub struct WishArgs {
    /// The object to move, by id.
    #[arg(long = "move", value_name = "ID", required_unless_present = "say")]
    pub query: Option<u16>,
    /// A relation that must hold: RELATION:ANCHOR, such as left_of:3, or not:RELATION:ANCHOR. Repeat for more terms.
    #[arg(long, required_unless_present = "say", value_name = "TERM")]
    pub goal: Vec<GoalTerm>,
    /// The object and the goal in words, objects by their appearance: "put the red mug to the left of the box, not near the bowl". An ambiguous
    /// sentence is refused, with the objects that it may mean.
    #[arg(long, value_name = "SENTENCE", conflicts_with_all = ["query", "goal"])]
    pub say: Option<String>,
    /// The planning method: best, full, full_lambda_1, no_discriminator, mean_only, mdn_prior or geometric.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub variant: Variant,
    /// Seed of the random number generator.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// How many distinct placements to find.
    #[arg(long, default_value_t = 1)]
    pub count: u32,
    /// Whether the object may be turned: fixed, yaw, or stable (turned, and where that does not do, set on another side).
    #[arg(long, default_value = "fixed", value_parser = parse_rotation)]
    pub rotation: Rotation,
    /// The viewer's direction of view, which `left_of` and the other directions refer to, radians about z. Default: the camera's.
    #[arg(long, allow_negative_numbers = true, value_name = "RADIANS", value_parser = parse_view_yaw)]
    pub view_yaw: Option<f64>,
    /// Iterations of the search. Default: the variant's.
    #[arg(long)]
    pub iterations: Option<u32>,
    /// Candidates accepted in each iteration. Default: the variant's.
    #[arg(long)]
    pub batch: Option<u32>,
    /// Minimum distance from everything except the support, metres.
    #[arg(long)]
    pub min_clearance: Option<f64>,
    /// Minimum success probability, 0 to 1; less certain placements are rejected. Default for the variant best: 0.5; 0 rejects none.
    #[arg(long, value_name = "P")]
    pub min_success: Option<f64>,
    /// Only placements within reach of this robot. `plan` takes its base pose from the frame's robot.json; `place` from the robot's state, or
    /// else from the planner's configuration.
    #[arg(long, value_name = "ROBOT")]
    pub reach_of: Option<String>,
}

impl WishArgs {
    /// What is wished for by numbers; none where it is said in words, which mean something on a scene only.
    pub fn numbered(&self) -> Option<NextWish> {
        Some(NextWish { query: self.query?, goal: self.goal.clone() })
    }

    /// What is wished for on a scene, and how the words were taken where it is said in words.
    pub fn on(&self, scene: &Scene) -> Result<(NextWish, Option<SentenceMeaning>), Failure> {
        if let Some(sentence) = &self.say {
            return wish_of(sentence, scene, self.view_yaw).map(|(query, goal, said)| (NextWish { query, goal }, Some(said)));
        }
        let wish = self.numbered().ok_or_else(|| Failure::bad_input("move", "expected --move or --say"))?;
        Ok((wish, None))
    }

    /// The request for a wish on a scene; `reaching` is the robot of `reach_of` with where its base stands, as far as that is known.
    pub fn request(&self, scene_id: String, wish: &NextWish, reaching: Option<ReachingRobot>) -> PlaceRequest {
        PlaceRequest {
            view_yaw_rad: self.view_yaw,
            count: self.count,
            rotation: self.rotation,
            seed: self.seed,
            variant: self.variant,
            min_clearance_m: self.min_clearance,
            min_success: self.min_success,
            robot: reaching,
            budget: Budget { iterations: self.iterations, batch: self.batch, ..Budget::default() },
            ..PlaceRequest::new(scene_id, wish.query, wish.goal.clone())
        }
    }
}

/// A direction of view. Nobody writes more than a whole turn in radians, and nearly everyone who thinks in degrees does.
pub fn parse_view_yaw(text: &str) -> Result<f64, String> {
    let yaw_rad: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if yaw_rad.abs() <= TAU { Ok(yaw_rad) } else { Err("expected radians, from -6.283 to 6.283".to_owned()) }
}

/// One wish of a sequence: `ID=TERM[,TERM…]`.
#[derive(Debug, Clone, PartialEq)]
pub struct NextWish {
    /// The object to move, by its id in the first view.
    pub query: u16,
    /// What must hold; anchors by their ids in the first view.
    pub goal: Vec<GoalTerm>,
}

impl std::str::FromStr for NextWish {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (query, terms) = text.split_once('=').ok_or_else(|| format!("expected ID=TERM[,TERM…], got {text:?}"))?;
        let query = query.parse().map_err(|e| format!("{query:?} is no object id: {e}"))?;
        let goal = terms.split(',').map(|t| t.parse().map_err(|e: CallError| e.message)).collect::<Result<_, String>>()?;
        Ok(Self { query, goal })
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::Relation;

    use super::*;

    #[test]
    fn a_direction_of_view_is_in_radians() {
        assert_eq!(parse_view_yaw("-1.5"), Ok(-1.5));
        assert!(["180", "-90", "nan", "inf"].iter().all(|text| parse_view_yaw(text).is_err_and(|e| e.contains("radians"))));
    }

    #[test]
    fn a_wish_is_read_with_its_terms_and_faults_are_named() {
        let wish: NextWish = "3=right_of:5,not:near:2".parse().expect("a wish");
        assert_eq!(wish.query, 3);
        assert_eq!(wish.goal[1], GoalTerm { relation: Relation::Near, anchor: 2, holds: false });
        for (text, named) in [("3", "ID=TERM"), ("x=near:2", "x"), ("3=beside:2", "beside")] {
            assert!(text.parse::<NextWish>().is_err_and(|e| e.contains(named)), "{text}");
        }
    }
}
