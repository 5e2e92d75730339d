//! Table 1, regenerated: the planner's variants on scenes never trained on, judged by releasing the object in the true world.
//!
//! The paper's columns are of each variant's lowest-cost feasible candidate, and where none is feasible, of the one of lowest cost among
//! those in view that violate the constraints least. The joint rate is of what was *returned*:
//! of the scenes with an answer, those where the object stayed, the goal held by ground truth after settling, nothing else moved 2 cm,
//! and the object neither tipped by 15° nor was put 5 mm into anything. "None" is right where there is no answer. Rates come with
//! intervals, comparisons are paired by scene.

use std::collections::BTreeMap;

use repose_dataset::Split;
use repose_inference::Engine;
use repose_networks::serving::spread;
use repose_proto::CallError;
use repose_proto::place::{Rejection, Variant};
use repose_simulator::scene::SceneKind;
use serde::Serialize;

use crate::scenes::held_scenes::forecasts_of;
use crate::scenes::outcome::PlacementFault;
use crate::scenes::planner_scene::{PlannerSceneSettings, SceneRecord, SceneSet, SelfAssessment, TriedScene, VariantTrial, try_scene};
use crate::statistics::calibration::Calibration;
use crate::statistics::paired::Paired;
use crate::statistics::quantile::Sorted;
use crate::statistics::rate::Rate;

/// ε_ρ and ε_f of the paper's columns.
const THRESHOLD: f64 = 0.5;

/// The scenes of a table.
#[derive(Debug, Clone)]
pub struct PlannerTableSettings {
    /// Whose seeds.
    pub split: Split,
    /// The sets, in the table's order.
    pub sets: Vec<SceneSet>,
    /// The first slot of each set.
    pub first: u64,
    /// How many scenes of each set.
    pub scenes: usize,
    /// What is tried on each.
    pub scene: PlannerSceneSettings,
    /// Threads; the table does not depend on it.
    pub threads: usize,
}

/// Tries every scene that `done` does not hold yet; `seen` is given each as it ends, in the order of sets and slots.
///
/// The engine is asked from several threads at once, so it should have one of its own.
///
/// # Errors
/// The planner's or the engine's, on a problem that they should have been able to take; what `seen` returns.
pub fn evaluate_planner<E: From<CallError>>(
    settings: &PlannerTableSettings,
    engine: &Engine,
    done: &[SceneRecord],
    mut seen: impl FnMut(TriedScene) -> Result<(), E>,
) -> Result<(), E> {
    let forecasts = forecasts_of(engine).map_err(E::from)?;
    let is_done = |set: &SceneSet, slot: u64| done.iter().any(|r| r.set == set.name && r.slot == slot);
    let slots = settings.first..settings.first + settings.scenes as u64;
    let open: Vec<(&SceneSet, u64)> = settings
        .sets
        .iter()
        .flat_map(|set| slots.clone().map(move |slot| (set, slot)))
        .filter(|(set, slot)| !is_done(set, *slot))
        .collect();
    for batch in open.chunks(settings.threads.max(1)) {
        let tried = spread(
            batch.len(),
            settings.threads,
            || (),
            |(), k| try_scene(batch[k].0, settings.split, batch[k].1, engine, &forecasts, &settings.scene),
        );
        for scene in tried {
            if let Some(scene) = scene.map_err(E::from)? {
                seen(scene)?;
            }
        }
    }
    Ok(())
}

/// The paper's four columns.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Columns {
    /// p > ε_ρ.
    pub predicates: Rate,
    /// f > ε_f.
    pub realistic: Rate,
    /// Both.
    pub successful: Rate,
    /// The object's centre moved less than 5 cm.
    pub stable: Rate,
}

impl Columns {
    fn count(&mut self, trial: &VariantTrial) {
        let is = |f: &dyn Fn(f64, f64) -> bool| trial.in_view.is_some_and(|c| f(c.relations, c.realism));
        self.predicates.count(is(&|p, _| p > THRESHOLD));
        self.realistic.count(is(&|_, f| f > THRESHOLD));
        self.successful.count(is(&|p, f| p > THRESHOLD && f > THRESHOLD));
        self.stable.count(trial.stable());
    }
}

/// A point of the risk–coverage curve: wrong answers against the share of answers given.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RiskCoveragePoint {
    /// Share of the answers that are to be given: the surest of them, percent.
    pub answered: f64,
    /// How many are: more than that share where others are as sure as the least sure of them.
    pub answers: usize,
    /// The least sureness among them: the `--min-success` that gives them.
    pub least: f64,
    /// How many of those are wrong.
    pub wrong_answers: usize,
    /// Share of those that are wrong, percent.
    pub wrong: f64,
}

/// The shares of the answers that the curve has points for, percent.
const CURVE_AT: [usize; 8] = [100, 98, 95, 90, 85, 80, 70, 50];

/// The curve of answers given by how sure they are of themselves and whether they are right.
fn curve_of(answers: &[(f64, bool)]) -> Vec<RiskCoveragePoint> {
    let mut surest = answers.to_vec();
    surest.sort_by(|a, b| b.0.total_cmp(&a.0));
    let point = |share: usize| {
        let (least, _) = *surest[..surest.len() * share / 100].last()?;
        // Nobody who asks for that sureness gets only some of those that have it.
        let given = &surest[..surest.partition_point(|(sureness, _)| *sureness >= least)];
        let wrong = given.iter().filter(|(_, right)| !right).count();
        let wrong_share = 100.0 * wrong as f64 / given.len() as f64;
        Some(RiskCoveragePoint { answered: share as f64, answers: given.len(), least, wrong_answers: wrong, wrong: wrong_share })
    };
    CURVE_AT.into_iter().filter_map(point).collect()
}

/// A variant's figures.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannerRow {
    /// Which.
    pub variant: Variant,
    /// The paper's columns, of all scenes.
    pub of_all: Columns,
    /// The paper's columns, of the scenes with an answer.
    pub of_answerable: Columns,
    /// A placement was returned, of the scenes with an answer.
    pub returned: Rate,
    /// The joint rate, of the scenes with an answer.
    pub joint: Rate,
    /// The joint rate, of the scenes with an answer that needs no luck: the object stands by itself, and with its whole base.
    pub joint_of_self_standing: Rate,
    /// Of the placements returned, in scenes with an answer or without: those that succeed.
    pub right_when_returned: Rate,
    /// Placements returned that fail, by what is wrong with them.
    pub faults: BTreeMap<PlacementFault, usize>,
    /// Whether what first answers say of themselves comes true ([`SelfAssessment::sureness`] against success); none where they say nothing.
    pub success_calibration: Calibration,
    /// How many of the answers would be wrong if only the surest were given.
    pub curve: Vec<RiskCoveragePoint>,
    /// Of the scenes answered with "none", those without an answer.
    pub none_precision: Rate,
    /// Of the scenes without an answer, those answered with "none".
    pub none_recall: Rate,
    /// Of the scenes answered with "none" in which the search with the truth finds an answer: what the planner refuses that by ([`missed_by`]).
    pub missed_by: BTreeMap<Rejection, usize>,
    /// The joint rate against `geometric`'s on the same scenes.
    pub against_geometric: Option<Paired>,
    /// The joint rate against the script's ([`crate::scenes::script`]) on the same scenes.
    pub against_script: Option<Paired>,
    /// Of the scenes with true answers on two supports or more: the answers stand on two or more.
    pub two_supports: Rate,
    /// The same, and on two of them at least one answer succeeds.
    pub two_good_supports: Rate,
    /// Times of a search, milliseconds: median and the 95th percentile.
    pub times_ms: [f64; 2],
}

/// Figures of a group of scenes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneGroup {
    /// What the scenes have in common.
    pub name: String,
    /// How many.
    pub scenes: usize,
    /// How many are known to have an answer.
    pub answerable: usize,
    /// How many of those only a variant or the script found one for: what the search with the truth missed.
    pub found_by_variants_only: usize,
    /// The script's joint rate, of the scenes with an answer.
    pub script_joint: Rate,
    /// One a variant.
    pub rows: Vec<PlannerRow>,
}

/// A set's figures, whole and by kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetTable {
    /// All scenes of the set.
    pub all: SceneGroup,
    /// By kind of scene, where there are several.
    pub kinds: Vec<SceneGroup>,
}

/// The tables of every set that has records, in order of first appearance.
pub fn planner_tables(records: &[SceneRecord], variants: &[Variant]) -> Vec<SetTable> {
    let mut names: Vec<&str> = Vec::new();
    for record in records {
        if !names.contains(&record.set.as_str()) {
            names.push(&record.set);
        }
    }
    let table = |name: &str| {
        let own: Vec<&SceneRecord> = records.iter().filter(|r| r.set == name).collect();
        let of_kind = |kind: SceneKind| own.iter().copied().filter(|r| r.kind == kind).collect::<Vec<_>>();
        let kinds: Vec<SceneGroup> =
            SceneKind::ALL.iter().map(|k| part(k.name(), &of_kind(*k), variants)).filter(|part| part.scenes > 0).collect();
        SetTable { all: part(name, &own, variants), kinds: if kinds.len() > 1 { kinds } else { Vec::new() } }
    };
    names.into_iter().map(table).collect()
}

fn part(name: &str, records: &[&SceneRecord], variants: &[Variant]) -> SceneGroup {
    SceneGroup {
        name: name.to_owned(),
        scenes: records.len(),
        answerable: records.iter().filter(|r| r.answerable()).count(),
        found_by_variants_only: records.iter().filter(|r| r.answerable() && r.true_supports == 0).count(),
        script_joint: records.iter().filter(|r| r.answerable()).map(|r| r.script.joint()).collect(),
        rows: variants.iter().map(|v| row(*v, records)).collect(),
    }
}

fn row(variant: Variant, records: &[&SceneRecord]) -> PlannerRow {
    let rate = Rate::default();
    let (mut of_all, mut of_answerable) = (Columns::default(), Columns::default());
    let (mut returned, mut joint, mut right_when_returned, mut none_precision, mut none_recall) = (rate, rate, rate, rate, rate);
    let mut joint_of_self_standing = rate;
    let (mut two_supports, mut two_good_supports) = (rate, rate);
    let (mut times, mut pairs, mut script_pairs) = (Vec::new(), Vec::new(), Vec::new());
    let (mut faults, mut missed, mut forecasts) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
    for record in records {
        let Some(trial) = record.trial(variant) else { continue };
        let is_none = trial.release.is_none();
        // A request that was refused was not searched for: its time would make searches look shorter.
        times.extend(trial.refused.is_none().then_some(trial.plan_ms));
        of_all.count(trial);
        if record.answerable() {
            of_answerable.count(trial);
            returned.count(!is_none);
            joint.count(trial.joint());
            script_pairs.push((trial.joint(), record.script.joint()));
            pairs.extend(record.trial(Variant::Geometric).map(|geometric| (trial.joint(), geometric.joint())));
        } else {
            none_recall.count(is_none);
        }
        if record.whole_based && record.stands_alone {
            joint_of_self_standing.count(trial.joint());
        }
        if is_none {
            none_precision.count(!record.answerable());
            if let Some(reason) = missed_by(record, trial) {
                *missed.entry(reason).or_default() += 1;
            }
        } else {
            right_when_returned.count(trial.joint());
        }
        if let Some(fault) = trial.release.and_then(|release| release.fault()) {
            *faults.entry(fault).or_default() += 1;
        }
        forecasts.extend(trial.said.as_ref().and_then(SelfAssessment::sureness).map(|sureness| (sureness, trial.joint())));
        if record.true_supports > 1 {
            two_supports.count(trial.supports > 1);
            two_good_supports.count(trial.good_supports > 1);
        }
    }
    let times = Sorted::new(times);
    let time = |share: f64| times.at(share).unwrap_or(0.0);
    PlannerRow {
        variant,
        of_all,
        of_answerable,
        returned,
        joint,
        joint_of_self_standing,
        right_when_returned,
        faults,
        success_calibration: Calibration::of(&forecasts, 1),
        curve: curve_of(&forecasts),
        none_precision,
        none_recall,
        missed_by: missed,
        against_geometric: if variant == Variant::Geometric { None } else { Paired::of(&pairs) },
        against_script: Paired::of(&script_pairs),
        two_supports,
        two_good_supports,
        times_ms: [time(0.5), time(0.95)],
    }
}

/// Why a trial ended with "none" though the search with the truth found answers: what speaks against the object itself, or else the constraint that the one
/// of those answers fails that comes furthest; [`Rejection::Unsure`] where one passes them all, so that the search or a forecast lost it. None where
/// there is no such answer, or the request was refused.
fn missed_by(record: &SceneRecord, trial: &VariantTrial) -> Option<Rejection> {
    let of_object = [Rejection::Tips, Rejection::Unsettles].into_iter().find(|reason| trial.rejections.contains_key(reason));
    let furthest = record.true_refusals.iter().map(|refusal| refusal.unwrap_or(Rejection::Unsure)).max()?;
    trial.refused.is_none().then(|| of_object.unwrap_or(furthest))
}

#[cfg(test)]
mod tests {
    use repose_proto::place::Outcome;
    use repose_proto::{GoalTerm, Relation};

    use super::*;
    use crate::scenes::outcome::{Judged, Release};
    use crate::scenes::planner_scene::{InView, ScriptTrial};

    fn trial(variant: Variant, joint: Option<bool>, [relations, realism, moved_m]: [f64; 3]) -> VariantTrial {
        VariantTrial {
            variant,
            outcome: if joint.is_some() { Outcome::Found } else { Outcome::None },
            refused: None,
            release: joint.map(|good| Release {
                judged: Judged { moved_m, stable: good, goal: good, clean: good },
                others_moved_m: 0.0,
                tilt_rad: 0.0,
                penetration_m: 0.0,
                dropped_m: 0.0,
            }),
            said: joint.map(|_| SelfAssessment {
                success: Some(realism),
                realism: Some(realism),
                relations,
                rule_margin_m: 0.01,
                support_m: None,
                clearance_m: None,
                measures: Vec::new(),
            }),
            in_view: Some(InView { relations, realism, moved_m }),
            supports: 2,
            good_supports: usize::from(joint == Some(true)),
            rejections: BTreeMap::new(),
            plan_ms: 10.0,
        }
    }

    fn record(slot: u64, kind: SceneKind, true_supports: usize, trials: Vec<VariantTrial>) -> SceneRecord {
        let goal = GoalTerm { relation: Relation::LeftOf, anchor: 2, holds: true };
        SceneRecord {
            set: "set".to_owned(),
            slot,
            seed: slot,
            kind,
            query: 1,
            goal,
            true_supports,
            whole_based: true_supports > 1,
            // One leans.
            stands_alone: slot != 5,
            true_refusals: vec![Some(Rejection::Unsupported); true_supports],
            script: ScriptTrial { release: None },
            trials,
        }
    }

    #[test]
    fn rates_are_of_the_scenes_that_they_name() {
        let both = |best: Option<bool>, geometric: Option<bool>| {
            vec![trial(Variant::Best, best, [0.9, 0.4, 0.01]), trial(Variant::Geometric, geometric, [0.9, 0.8, 0.2])]
        };
        let records = [
            record(0, SceneKind::Kitchen, 2, both(Some(true), Some(false))),
            record(1, SceneKind::Kitchen, 1, both(Some(true), Some(true))),
            record(2, SceneKind::Shelf, 1, both(None, Some(true))),
            record(3, SceneKind::Shelf, 0, both(None, Some(false))),
            // The search with the truth missed this one's answer.
            record(4, SceneKind::Shelf, 0, both(Some(true), None)),
        ];
        let leaning = record(5, SceneKind::Shelf, 2, both(None, None));
        let standing = planner_tables(&[records[0].clone(), leaning], &[Variant::Best]);
        assert_eq!(standing[0].all.rows[0].joint_of_self_standing, Rate { of: 1, n: 1 }, "of what leans no answer is asked");
        let tables = planner_tables(&records, &[Variant::Best, Variant::Geometric]);
        let [table] = &tables[..] else { panic!("one set") };
        assert_eq!((table.all.scenes, table.all.answerable, table.all.found_by_variants_only), (5, 4, 1));
        let [best, geometric] = &table.all.rows[..] else { panic!("two rows") };
        let rate = |of: usize, n: usize| Rate { of, n };
        assert_eq!((best.joint, best.returned, best.right_when_returned), (rate(3, 4), rate(3, 4), rate(3, 3)));
        assert_eq!((best.none_precision, best.none_recall), (rate(1, 2), rate(1, 1)));
        assert_eq!((geometric.joint, geometric.none_precision, geometric.none_recall), (rate(2, 4), rate(0, 1), rate(0, 1)));
        assert_eq!((best.of_all.predicates, best.of_all.realistic, best.of_all.successful), (rate(5, 5), rate(0, 5), rate(0, 5)));
        assert_eq!((best.of_answerable.stable, geometric.of_answerable.stable), (rate(4, 4), rate(0, 4)));
        let paired = best.against_geometric.expect("pairs");
        assert_eq!((paired.scenes, paired.difference, paired.only_first, paired.only_second), (4, 25.0, 2, 1));
        assert_eq!(table.all.script_joint, rate(0, 4));
        assert_eq!(best.against_script.map(|p| (p.scenes, p.difference)), Some((4, 75.0)));
        assert_eq!((best.two_supports, best.two_good_supports), (rate(1, 1), rate(0, 1)));
        assert_eq!(table.kinds.iter().map(|k| (k.name.as_str(), k.scenes)).collect::<Vec<_>>(), [("shelf", 3), ("kitchen", 2)]);
        assert_eq!(geometric.against_geometric, None);
    }

    #[test]
    fn a_refused_request_is_an_answer_of_none_but_takes_no_part_in_the_times() {
        let searched = trial(Variant::Best, Some(true), [0.9, 0.4, 0.01]);
        let refused = VariantTrial { refused: Some("it carries another".to_owned()), plan_ms: 0.0, ..trial(Variant::Best, None, [0.0; 3]) };
        let records: Vec<SceneRecord> =
            (0..).zip([refused.clone(), refused, searched]).map(|(slot, trial)| record(slot, SceneKind::Desk, 1, vec![trial])).collect();
        let tables = planner_tables(&records, &[Variant::Best]);
        let [best] = &tables[0].all.rows[..] else { panic!("one row") };
        assert_eq!((best.returned, best.times_ms), (Rate { of: 1, n: 3 }, [10.0, 10.0]));
    }

    #[test]
    fn what_is_missed_counts_by_the_true_answer_that_comes_furthest_and_by_what_speaks_against_the_object_first() {
        let none = |rejection: Option<Rejection>| VariantTrial {
            rejections: rejection.into_iter().map(|reason| (reason, 200)).collect(),
            ..trial(Variant::Best, None, [0.0; 3])
        };
        let scene = |refusals: &[Option<Rejection>], trial: VariantTrial| SceneRecord {
            true_refusals: refusals.to_vec(),
            ..record(0, SceneKind::Shelf, refusals.len(), vec![trial])
        };
        let (unseen, unsupported) = (Some(Rejection::OutOfView), Some(Rejection::Unsupported));
        let refused = VariantTrial { refused: Some("it carries another".to_owned()), ..none(None) };
        let records = [
            scene(&[unsupported, unseen], none(None)),
            scene(&[unseen, None], none(Some(Rejection::Collision))),
            scene(&[unsupported], none(Some(Rejection::Tips))),
            scene(&[], none(None)),
            scene(&[unseen], trial(Variant::Best, Some(true), [0.0; 3])),
            scene(&[unseen], refused),
        ];
        let row = row(Variant::Best, &records.each_ref());
        assert_eq!(row.missed_by, BTreeMap::from([(Rejection::Tips, 1), (Rejection::Unsupported, 1), (Rejection::Unsure, 1)]));
    }

    #[test]
    fn the_curve_leaves_out_the_least_sure_first() {
        let answers: Vec<(f64, bool)> = (0..20).map(|i| (f64::from(i) / 20.0, i >= 3)).collect();
        let curve = curve_of(&answers);
        let at = |share: f64| curve.iter().find(|point| point.answered == share).expect("a point");
        assert_eq!((at(100.0).wrong, at(90.0).wrong, at(85.0).wrong), (15.0, 100.0 / 18.0, 0.0));
        assert_eq!((at(90.0).answers, at(90.0).wrong_answers, at(85.0).least), (18, 1, 0.15));
        assert!(curve_of(&[]).is_empty());
    }

    #[test]
    fn a_point_of_the_curve_counts_all_answers_that_its_least_sureness_admits() {
        // The trees say the same of many: here of the last eight.
        let answers: Vec<(f64, bool)> = (0..20).map(|i| (if i < 12 { 0.9 } else { 0.6 }, i % 2 == 0)).collect();
        for point in curve_of(&answers) {
            let admitted: Vec<bool> = answers.iter().filter(|(said, _)| *said >= point.least).map(|(_, right)| *right).collect();
            let wrong = admitted.iter().filter(|right| !**right).count();
            assert_eq!((point.answers, point.wrong_answers), (admitted.len(), wrong), "{point:?}");
            assert_eq!(point.answers, if point.answered > 60.0 { 20 } else { 12 }, "{point:?}");
        }
    }

    #[test]
    fn a_record_is_read_back_as_it_was_written() {
        let record = record(7, SceneKind::Drawer, 1, vec![trial(Variant::Full, Some(true), [0.1, 0.2, 0.3])]);
        let text = serde_json::to_string(&record).expect("JSON");
        assert_eq!(serde_json::from_str::<SceneRecord>(&text).expect("a record"), record);
    }
}
