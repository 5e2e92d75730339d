//! The paper's Table 3 in simulation: eight objects, some trials each, on a table and on a table with a large box.
//!
//! The objects were named before the first run: those of the twelve in `data/ycb` that the Panda's hand, which opens 8 cm, can take across
//! their body. Of the other four the wood block (85 mm) and the coffee can (102 mm) are too wide, bowl and mug can be had at their walls
//! only; these four stand about as anchors. Rates are conditional on the step before, as in the paper, and end to end beside them.

use std::collections::BTreeMap;

use repose_planner::PlacementModels;
use repose_simulator::objects::MeshLibrary;
use serde::Serialize;

use crate::scenes::cell_run::Strip;
use crate::scenes::problem::Problem;
use crate::scenes::robot_scene::{Excluded, RobotSceneSettings, TableCondition, robot_problem};
use crate::scenes::robot_settings::{RobotTrialError, RobotTrialSettings};
use crate::scenes::robot_trial::{Cause, RobotTrial, robot_trial};
use crate::statistics::rate::Rate;

/// The eight objects, by the names of their folders.
pub const OBJECTS: [&str; 8] = [
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "009_gelatin_box",
    "010_potted_meat_can",
    "061_foam_brick",
    "077_rubiks_cube",
];

/// What is run.
#[derive(Debug, Clone)]
pub struct RobotTableSettings {
    /// How scenes are made.
    pub scene: RobotSceneSettings,
    /// How trials are run.
    pub trial: RobotTrialSettings,
    /// Trials for each object and condition.
    pub trials: usize,
    /// The seed that all scenes follow from.
    pub seed: u64,
    /// Which objects.
    pub objects: Vec<String>,
    /// Which conditions.
    pub conditions: Vec<TableCondition>,
}

impl Default for RobotTableSettings {
    fn default() -> Self {
        Self {
            scene: RobotSceneSettings::default(),
            trial: RobotTrialSettings::default(),
            trials: 3,
            seed: 0,
            objects: OBJECTS.map(str::to_owned).to_vec(),
            conditions: TableCondition::ALL.to_vec(),
        }
    }
}

/// Why the table could not be made.
#[derive(Debug, thiserror::Error)]
pub enum RobotTableError {
    /// The folder lacks an object.
    #[error("no object is called {0}")]
    NoObject(String),
    /// A trial could not be run.
    #[error(transparent)]
    Trial(#[from] RobotTrialError),
}

/// A trial that there is none of: no draw of its seed gave a scene.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Undrawn {
    /// The object.
    pub object: String,
    /// The condition.
    pub condition: TableCondition,
    /// The seed.
    pub seed: u64,
}

/// Rates of an object or of all objects, in one condition.
#[derive(Debug, Clone, Serialize)]
pub struct RobotRow {
    /// The object; none for all of them.
    pub object: Option<String>,
    /// The condition.
    pub condition: TableCondition,
    /// Placement and motion were found, at one attempt or more.
    pub plan: Rate,
    /// Of those, the object was lifted at the last attempt that was carried out.
    pub grasp: Rate,
    /// Of those, it came to stand where it was to, with the goal true.
    pub place: Rate,
    /// Of all trials, the last.
    pub end_to_end: Rate,
    /// Of all trials, the last at the first attempt.
    pub first_attempt: Rate,
    /// How often trials failed for what.
    pub causes: BTreeMap<Cause, usize>,
    /// What was drawn beside these trials and not asked for.
    pub excluded: Excluded,
}

impl RobotRow {
    fn of<'a>(object: Option<&str>, condition: TableCondition, trials: impl Iterator<Item = &'a RobotTrial>) -> Self {
        let rate = Rate::default();
        let (plan, grasp, place, end_to_end, first_attempt) = (rate, rate, rate, rate, rate);
        let (object_name, causes, excluded) = (object.map(str::to_owned), BTreeMap::new(), Excluded::default());
        let mut row = Self { object: object_name, condition, plan, grasp, place, end_to_end, first_attempt, causes, excluded };
        for trial in trials.filter(|t| t.condition == condition && object.is_none_or(|o| t.object == o)) {
            row.plan.count(trial.planned);
            if trial.planned {
                row.grasp.count(trial.grasped);
            }
            if trial.grasped {
                row.place.count(trial.placed);
            }
            row.end_to_end.count(trial.placed);
            row.first_attempt.count(trial.placed && trial.failed_attempts.is_empty());
            row.excluded = row.excluded.and(trial.excluded);
            if let Some(cause) = trial.cause {
                *row.causes.entry(cause).or_default() += 1;
            }
        }
        row
    }
}

/// All of the table.
#[derive(Debug, Clone, Serialize)]
pub struct RobotTable {
    /// Objects and conditions.
    pub rows: Vec<RobotRow>,
    /// All objects, by condition.
    pub overall: Vec<RobotRow>,
    /// Everything, trial by trial.
    pub trials: Vec<RobotTrial>,
    /// Trials that are in no rate, for want of a scene.
    pub undrawn: Vec<Undrawn>,
}

/// Runs all trials; `seen` is told of each as it ends, with its pictures. A seed that gives no scene leaves one trial out, and not all others.
///
/// # Errors
/// [`RobotTableError`] when the folder lacks an object, or a trial cannot be run.
pub fn evaluate_robot(
    library: &MeshLibrary,
    settings: &RobotTableSettings,
    models: &dyn PlacementModels,
    mut seen: impl FnMut(&Problem, &RobotTrial, &Strip),
) -> Result<RobotTable, RobotTableError> {
    let (mut trials, mut undrawn) = (Vec::new(), Vec::new());
    let shapes = library.shapes();
    let of_name = |name: &String| shapes.iter().find(|s| *s.name == **name).ok_or_else(|| RobotTableError::NoObject(name.clone()));
    // One that is missing is told before the trials of the others, which take hours, are run for nothing.
    let objects = settings.objects.iter().map(|name| Ok((name, of_name(name)?))).collect::<Result<Vec<_>, RobotTableError>>()?;
    for &condition in &settings.conditions {
        for &(name, object) in &objects {
            let others: Vec<_> = shapes.iter().filter(|s| s.name != object.name).cloned().collect();
            for k in 0..settings.trials {
                let seed = seed_of(settings.seed, name, condition, k);
                let drawn = robot_problem(object, &others, condition, seed, &settings.trial.region, &settings.scene);
                let Some((problem, excluded)) = drawn else {
                    undrawn.push(Undrawn { object: name.clone(), condition, seed });
                    continue;
                };
                let (mut trial, strip) = robot_trial(&problem, condition, models, &settings.trial)?;
                trial.excluded = excluded;
                seen(&problem, &trial, &strip);
                trials.push(trial);
            }
        }
    }
    let row = |object: Option<&str>, condition| RobotRow::of(object, condition, trials.iter());
    let each = settings.objects.iter().flat_map(|o| settings.conditions.iter().map(|c| row(Some(o), *c)));
    let rows = each.collect();
    let overall = settings.conditions.iter().map(|c| row(None, *c)).collect();
    Ok(RobotTable { rows, overall, trials, undrawn })
}

/// A trial's seed: the same whichever other objects and conditions are run.
fn seed_of(seed: u64, object: &str, condition: TableCondition, trial: usize) -> u64 {
    // FNV-1a: stable over versions and machines.
    let bytes = object.bytes().chain([condition as u8]).chain((trial as u64).to_le_bytes()).chain(seed.to_le_bytes());
    // Seeds travel as JSON numbers, which hold 53 bits.
    bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)) >> 12
}

#[cfg(test)]
mod tests {
    use repose_planner::NoModels;
    use repose_proto::{GoalTerm, Relation};
    use repose_simulator::objects::MeshSettings;

    use super::*;
    use crate::scenes::robot_trial::FailedAttempt;

    fn trial(object: &str, [planned, grasped, placed]: [bool; 3], cause: Option<Cause>) -> RobotTrial {
        let goal = GoalTerm { relation: Relation::LeftOf, anchor: 2, holds: true };
        RobotTrial { planned, grasped, placed, cause, ..RobotTrial::new(object.to_owned(), TableCondition::Table, 0, goal) }
    }

    #[test]
    fn each_rate_is_of_the_trials_that_came_so_far() {
        let mut trials = [
            trial("a", [true; 3], None),
            trial("a", [true, true, false], Some(Cause::Moved)),
            trial("a", [true, false, false], Some(Cause::GraspLost)),
            trial("b", [false; 3], Some(Cause::NoMotion)),
            RobotTrial {
                failed_attempts: vec![FailedAttempt { cause: Some(Cause::GraspLost), detail: String::new() }],
                ..trial("a", [true; 3], None)
            },
        ];
        trials[0].excluded = Excluded { out_of_reach: 1, no_place: 2 };
        trials[3].excluded = Excluded { out_of_reach: 0, no_place: 3 };
        let all = RobotRow::of(None, TableCondition::Table, trials.iter());
        let counts = [all.plan, all.grasp, all.place, all.end_to_end, all.first_attempt].map(|r| (r.of, r.n));
        assert_eq!(counts, [(4, 5), (3, 4), (2, 3), (2, 5), (1, 5)]);
        assert_eq!(all.causes, BTreeMap::from([(Cause::NoMotion, 1), (Cause::GraspLost, 1), (Cause::Moved, 1)]));
        assert_eq!(all.excluded, Excluded { out_of_reach: 1, no_place: 5 });
        assert_eq!(RobotRow::of(Some("b"), TableCondition::Table, trials.iter()).plan, Rate { of: 0, n: 1 });
        assert_eq!(RobotRow::of(None, TableCondition::LargeBox, trials.iter()).plan.n, 0);
    }

    /// A folder of one object, `brick`.
    fn bricks() -> MeshLibrary {
        let folder = tempfile::tempdir().expect("a folder");
        let corners: String = (0..8).map(|k| format!("v {} {} {}\n", k & 1, k >> 1 & 1, k >> 2)).collect();
        let sides = ["1 3 4", "1 4 2", "5 6 8", "5 8 7", "1 2 6", "1 6 5", "3 7 8", "3 8 4", "1 5 7", "1 7 3", "2 4 8", "2 8 6"];
        let sides: String = sides.iter().map(|side| format!("f {side}\n")).collect();
        std::fs::write(folder.path().join("brick.obj"), corners + &sides).expect("written");
        MeshLibrary::load(folder.path(), &MeshSettings { scale: 0.05, ..MeshSettings::default() }).expect("a brick")
    }

    #[test]
    fn an_object_that_is_missing_is_told_before_any_trial() {
        let objects = ["brick", "003_cracker_box"].map(str::to_owned).to_vec();
        let settings = RobotTableSettings { objects, ..RobotTableSettings::default() };
        let failed = evaluate_robot(&bricks(), &settings, &NoModels, |_, _, _| panic!("nothing is tried")).expect_err("one is missing");
        assert!(matches!(&failed, RobotTableError::NoObject(name) if name == "003_cracker_box"), "{failed}");
    }

    #[test]
    fn a_seed_without_a_scene_leaves_out_its_trial_alone() {
        let mut settings = RobotTableSettings { objects: vec!["brick".to_owned()], trials: 2, ..RobotTableSettings::default() };
        settings.scene.attempts = 0;
        let table = evaluate_robot(&bricks(), &settings, &NoModels, |_, _, _| panic!("there is no scene")).expect("a table");
        let told: Vec<(&str, TableCondition)> = table.undrawn.iter().map(|trial| (trial.object.as_str(), trial.condition)).collect();
        let [first, second] = TableCondition::ALL.map(|condition| ("brick", condition));
        assert_eq!(told, [first, first, second, second]);
        assert!(table.trials.is_empty() && table.overall.iter().all(|row| row.plan.n == 0));
    }

    #[test]
    fn no_two_trials_share_a_seed() {
        let mut seeds: Vec<u64> = Vec::new();
        for object in OBJECTS {
            for condition in TableCondition::ALL {
                seeds.extend((0..3).map(|k| seed_of(0, object, condition, k)));
            }
        }
        let count = seeds.len();
        seeds.sort_unstable();
        seeds.dedup();
        assert_eq!((seeds.len(), count), (48, 48));
    }
}
