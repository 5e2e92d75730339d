//! Whole plans on synthetic tables.

use std::cell::Cell;

use nalgebra::{Isometry3, Point3, Vector3};
use repose_panda::{CommandRuleSettings, CommandRules, JOINT_COUNT, Joints, LIMITS, READY, base_from_tcp, hermite};

use repose_motion::believed::Heeded;
use repose_motion::collision::{ArmCollisionSettings, CollisionChecker};
use repose_motion::execution::keep_out::Zones;
use repose_motion::grasp::GraspCandidate;
use repose_motion::obstacles::{ObstacleSettings, Obstacles};
use repose_motion::pick_place::plan::{Phase, PickPlaceError, PickPlacePlan, PlacementFailure};
use repose_motion::pick_place::{PickPlaceRequest, PickPlaceSettings, pick_place, pick_place_until};
use repose_motion::wire::motion_plan;
use repose_motion::{MotionConfig, synthetic};
use repose_proto::RigidTransform;
use repose_proto::motion::{KeepOutZone, MotionPlan, MotionPlanRequest};
use repose_proto::{CallError, Scene};

fn plan(query: u16, placements: &[Isometry3<f64>], grasps: Option<&[GraspCandidate]>) -> Result<PickPlacePlan, PickPlaceError> {
    let scene = synthetic::scene();
    let request = PickPlaceRequest { scene: &scene, query, placements, start: &READY, grasps, seed: 3 };
    pick_place(&request, &PickPlaceSettings::default())
}

/// Box 1 carried from its place to another, straight.
fn moved(x: f64, y: f64) -> Isometry3<f64> {
    Isometry3::translation(x - 0.45, y + 0.2, 0.0)
}

fn set_points(plan: &PickPlacePlan, period_s: f64) -> Vec<(Phase, Vec<Joints>)> {
    let phases = plan.phases.iter().filter_map(|p| Some((p.phase, p.trajectory.as_ref()?)));
    phases.map(|(phase, t)| (phase, t.sampled(period_s).map(|(_, p)| p.position_rad).collect())).collect()
}

/// What the robot is told at each whole millisecond.
fn milliseconds(plan: &PickPlacePlan) -> Vec<(Phase, Vec<Joints>)> {
    let phases = plan.phases.iter().filter_map(|p| Some((p.phase, p.trajectory.as_ref()?)));
    phases
        .map(|(phase, t)| (phase, (0..(t.duration_s() * 1e3) as usize + 3).map(|k| t.at(k as f64 * 1e-3).position_rad).collect()))
        .collect()
}

#[test]
fn a_box_is_picked_and_placed_with_all_phases_joined() {
    let plan = plan(1, &[moved(0.45, 0.25)], None).unwrap();
    assert_eq!(plan.placement, 0);
    let names: Vec<&str> = plan.phases.iter().map(|p| p.phase.as_str()).collect();
    assert_eq!(names, ["standoff", "approach", "grasp", "lift", "transfer", "lower", "release", "retreat", "home"]);
    let mut last = READY;
    for (phase, points) in set_points(&plan, 0.01) {
        assert!((0..JOINT_COUNT).all(|i| (points[0][i] - last[i]).abs() < 1e-6), "{phase:?} starts where the last phase ended");
        last = points[points.len() - 1];
    }
    assert!((0..JOINT_COUNT).all(|i| (last[i] - READY[i]).abs() < 1e-6), "the arm ends where it started");
}

#[test]
fn the_object_is_released_two_centimetres_above_the_planned_pose_after_a_standoff_of_ten() {
    let placed_from_observed = moved(0.45, 0.25) * Isometry3::identity();
    let plan = plan(1, &[placed_from_observed], None).unwrap();
    let planned = placed_from_observed * plan.grasp.world_from_tcp;
    let lower = plan.phases.iter().find(|p| p.phase == Phase::Lower).unwrap().trajectory.as_ref().unwrap();
    for (time_s, height_m) in [(0.0, 0.10), (lower.duration_s(), 0.02)] {
        let apart = base_from_tcp(&lower.at(time_s).position_rad).translation.vector - planned.translation.vector;
        assert!((apart - Vector3::z() * height_m).norm() < 1e-3, "{apart}");
    }
}

#[test]
fn every_millisecond_keeps_frankas_rules_and_touches_nothing() {
    let plan = plan(1, &[moved(0.45, 0.25)], None).unwrap();
    let scene = synthetic::scene();
    let others = Obstacles::new(&scene.points_without(1), &scene.surfaces_without(1, |_| None), &ObstacleSettings::default());
    let placed: Vec<_> = scene.points_of(1).iter().map(|p| (moved(0.45, 0.25) * p.cast::<f64>()).cast()).collect();
    let placed = Obstacles::new(&placed, &[], &ObstacleSettings::default());
    let arm = ArmCollisionSettings { padding_m: 0.0, finger_opening_m: plan.grasp.opening_m, ..ArmCollisionSettings::default() };
    for (phase, points) in milliseconds(&plan) {
        let obstacles = if phase == Phase::Home { vec![&others, &placed] } else { vec![&others] };
        let checker = CollisionChecker::new(arm, &obstacles, None);
        assert_eq!(CommandRules::check(&points[0], &points, CommandRuleSettings::default()), Ok(()), "{phase:?}");
        assert!(points.iter().all(|q| LIMITS.contains(q, 0.0)));
        assert_eq!(points.iter().step_by(5).find_map(|q| checker.contact(q)), None, "{phase:?}");
    }
}

#[test]
fn what_is_carried_is_hurried_nowhere() {
    let scene = synthetic::scene();
    let request = PickPlaceRequest { scene: &scene, query: 1, placements: &[moved(0.45, 0.25)], start: &READY, grasps: None, seed: 3 };
    let of = |holding_scale| pick_place(&request, &PickPlaceSettings { holding_scale, ..PickPlaceSettings::default() }).unwrap();
    let (usual, careful) = (of(PickPlaceSettings::default().holding_scale), of(0.1));
    for (usual, careful) in usual.phases.iter().zip(&careful.phases) {
        let (Some(before), Some(now)) = (&usual.trajectory, &careful.trajectory) else { continue };
        let longer = now.duration_s() / before.duration_s();
        // A fifth of the speed, and of the acceleration.
        let (least, most) = if usual.phase.is_carrying() { (2.0, 5.1) } else { (0.999, 1.001) };
        assert!((least..most).contains(&longer), "{} takes {longer} times as long", usual.phase);
    }
}

#[test]
fn what_the_robot_makes_of_the_set_points_keeps_frankas_rules() {
    let plan = plan(1, &[moved(0.45, 0.25)], None).unwrap();
    let request = MotionPlanRequest::new("0".repeat(64), "panda".to_owned(), 1, vec![RigidTransform::IDENTITY], READY);
    let sent = motion_plan(&plan, &request, 0, &MotionConfig::default().terms().unwrap());
    for phase in sent.phases.iter().filter(|p| !p.set_points.is_empty()) {
        let points = &phase.set_points;
        let end_ms = points[points.len() - 1].t_ms;
        let at = |ms: usize| {
            let t_ms = (ms as f64).min(end_ms);
            let next = points.partition_point(|p| p.t_ms <= t_ms).clamp(1, points.len() - 1);
            let (a, b) = (&points[next - 1], &points[next]);
            let s = (t_ms - a.t_ms) / (b.t_ms - a.t_ms);
            hermite((&a.q_rad, &a.dq_rad_s), (&b.q_rad, &b.dq_rad_s), (b.t_ms - a.t_ms) * 1e-3, s).0
        };
        // To the end and a little beyond, where the last position is held.
        let followed: Vec<Joints> = (0..end_ms as usize + 5).map(at).collect();
        assert_eq!(CommandRules::check(&followed[0], &followed, CommandRuleSettings::default()), Ok(()), "{}", phase.name);
    }
}

#[test]
fn a_placement_out_of_reach_falls_back_to_the_next_and_says_why() {
    let plan = plan(1, &[moved(1.6, 0.0), moved(0.55, 0.1), moved(0.45, 0.25)], None).unwrap();
    assert_eq!(plan.placement, 2);
    let failures: Vec<(usize, PlacementFailure)> = plan.not_chosen.iter().map(|n| (n.placement, n.failure)).collect();
    assert_eq!(
        failures,
        [(0, PlacementFailure::PlaceUnreachable), (1, PlacementFailure::PlaceBlocked)],
        "the second is inside another box"
    );
}

#[test]
fn no_placement_in_reach_is_an_error_with_the_reasons() {
    let Err(PickPlaceError::NoPlacement(reasons)) = plan(1, &[moved(1.6, 0.0)], None) else { panic!("expected no placement") };
    assert_eq!(reasons[0].failure, PlacementFailure::PlaceUnreachable);
}

#[test]
fn a_box_is_set_on_another_side_where_the_hand_gets_there_or_the_end_that_fails_is_named() {
    // Tipped over to each side about its middle, and set down at the height that it then has.
    let middle = Vector3::new(0.45, -0.2, 0.05);
    let tipped = |k: usize| {
        let towards = std::f64::consts::FRAC_PI_2 * k as f64;
        let axis = nalgebra::Unit::new_normalize(Vector3::new(towards.cos(), towards.sin(), 0.0));
        let turn = nalgebra::UnitQuaternion::from_axis_angle(&axis, std::f64::consts::FRAC_PI_2);
        let there = nalgebra::Translation3::new(0.45, 0.25, 0.04);
        there * turn * nalgebra::Translation3::from(-middle)
    };
    let placements: Vec<Isometry3<f64>> = (0..4).map(tipped).collect();
    let plan = plan(1, &placements, None).unwrap();
    let planned = placements[plan.placement] * plan.grasp.world_from_tcp;
    let lower = plan.phases.iter().find(|p| p.phase == Phase::Lower).unwrap().trajectory.as_ref().unwrap();
    let released = base_from_tcp(&lower.at(lower.duration_s()).position_rad);
    assert!(released.rotation.angle_to(&planned.rotation) < 1e-3, "the hand is turned with the object");
    // Head down, the hand would have to come up through the table.
    let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let head_down = nalgebra::Translation3::new(0.45, 0.25, 0.05) * turn * nalgebra::Translation3::from(-middle);
    let Err(PickPlaceError::NoPlacement(reasons)) = self::plan(1, &[head_down], None) else { panic!("expected no placement") };
    assert!(matches!(reasons[0].failure, PlacementFailure::PlaceBlocked | PlacementFailure::PlaceUnreachable), "{:?}", reasons[0]);
}

#[test]
fn a_bowl_is_taken_at_its_rim() {
    let plan = plan(3, &[Isometry3::translation(-0.1, 0.5, 0.0)], None).unwrap();
    assert!(plan.grasp.width_m.unwrap() < 0.02);
}

#[test]
fn an_unknown_object_and_a_start_inside_the_table_are_refused() {
    assert_eq!(plan(9, &[moved(0.45, 0.25)], None), Err(PickPlaceError::NoObject(9)));
    let scene = synthetic::scene();
    let mut start = READY;
    start[1] = 0.9;
    let placements = [moved(0.45, 0.25)];
    let request = PickPlaceRequest { scene: &scene, query: 1, placements: &placements, start: &start, grasps: None, seed: 3 };
    assert!(matches!(pick_place(&request, &PickPlaceSettings::default()), Err(PickPlaceError::StartBlocked(_))));
}

#[test]
fn a_plan_says_what_it_ignores_of_hidden_things() {
    let found = plan(1, &[moved(0.45, 0.25)], None).unwrap();
    let sent = |heeded: Heeded| {
        let request = MotionPlanRequest::new("0".repeat(64), "panda".to_owned(), 1, vec![RigidTransform::IDENTITY], READY);
        motion_plan(&PickPlacePlan { heeded, ..found.clone() }, &request, 0, &MotionConfig::default().terms().unwrap())
    };
    // A plan that ignores nothing is read by those who know no such field.
    assert_eq!(sent(found.heeded), sent(Heeded::Everything));
    assert!(sent(Heeded::Everything).heeded.is_none() && sent(Heeded::Everything).ignored_in_words().is_none());
    assert_eq!(sent(Heeded::Obstacles).heeded, Some(Heeded::Obstacles));
    assert!(sent(Heeded::Held).ignored_in_words().is_some_and(|words| words.contains("unseen parts of things are ignored")));
}

/// A zone as it is configured.
fn zone(min_m: [f64; 3], max_m: [f64; 3]) -> MotionConfig {
    MotionConfig { keep_out: vec![KeepOutZone { name: "zone".to_owned(), min_m, max_m }], ..MotionConfig::default() }
}

/// A plan as it is sent.
fn sent(plan: &PickPlacePlan) -> MotionPlan {
    let request = MotionPlanRequest::new("0".repeat(64), "panda".to_owned(), 1, vec![RigidTransform::IDENTITY], READY);
    motion_plan(plan, &request, 0, &MotionConfig::default().terms().unwrap())
}

/// Whether a plan that was sent keeps out of the zones of a cell.
fn keeps_out(plan: &MotionPlan, config: &MotionConfig, scene: Option<&Scene>) -> Result<(), CallError> {
    let settings = config.planning().unwrap();
    Zones { world_from_base: &settings.world_from_base, solids: &settings.keep_out, of_robot: None }.check(plan, scene, &|| Ok(()))
}

fn plan_in(config: &MotionConfig, placements: &[Isometry3<f64>]) -> Result<PickPlacePlan, PickPlaceError> {
    let scene = synthetic::scene();
    let request = PickPlaceRequest { scene: &scene, query: 1, placements, start: &READY, grasps: None, seed: 3 };
    pick_place(&request, &config.planning().unwrap())
}

#[test]
fn the_arm_and_what_it_holds_go_around_a_keep_out_zone() {
    // A wall across the straight way, as high as the lift.
    let walled = zone([0.3, -0.02, 0.0], [0.6, 0.06, 0.35]);
    let around = sent(&plan_in(&walled, &[moved(0.45, 0.25)]).unwrap());
    assert_eq!(keeps_out(&around, &walled, Some(&synthetic::wire_scene(0))), Ok(()));
    let straight = sent(&plan(1, &[moved(0.45, 0.25)], None).unwrap());
    let refused = keeps_out(&straight, &walled, None).unwrap_err();
    assert!(refused.message.contains("keep_out[0]") && refused.field.unwrap().starts_with("phases["), "{}", refused.message);
}

#[test]
fn what_a_robot_makes_of_few_set_points_keeps_out_of_a_zone_too() {
    let walled = zone([0.3, -0.02, 0.0], [0.6, 0.06, 0.35]);
    let mut sparse = sent(&plan(1, &[moved(0.45, 0.25)], None).unwrap());
    for phase in &mut sparse.phases {
        let ends = [0, phase.set_points.len().saturating_sub(1)];
        phase.set_points = ends.iter().filter_map(|end| phase.set_points.get(*end).copied()).collect();
    }
    let refused = keeps_out(&sparse, &walled, None).unwrap_err();
    assert!(refused.message.contains("keep_out[0]") && refused.field.unwrap().ends_with("set_points[1]"), "{}", refused.message);
    // So far apart that nobody can tell.
    sparse.phases[0].set_points[1].q_rad[0] = 11.0;
    let far = keeps_out(&sparse, &walled, None).unwrap_err();
    assert_eq!(far.field.as_deref(), Some("phases[0].set_points[1]"), "{}", far.message);
}

#[test]
fn what_is_held_keeps_out_of_a_zone_under_the_hand() {
    let straight = sent(&plan(1, &[moved(0.45, 0.25)], None).unwrap());
    let scene = synthetic::wire_scene(0);
    // What is held passes some ten centimetres above the table, the hand further up: of zones that reach higher and higher it is the first to enter one.
    let low = |cm: u16| zone([0.3, -0.02, 0.0], [0.6, 0.06, f64::from(cm) * 0.01]);
    let (first, refused) = (5..40).find_map(|cm| Some((cm, keeps_out(&straight, &low(cm), Some(&scene)).err()?))).unwrap();
    assert!((10..20).contains(&first) && refused.message.contains("held object"), "{first} cm: {}", refused.message);
    assert_eq!(keeps_out(&straight, &low(first), None), Ok(()));
}

#[test]
fn fingers_are_checked_against_a_zone_where_they_were_sent_and_not_wide_open() {
    let found = plan(1, &[moved(0.45, 0.25)], None).unwrap().grasp;
    let narrow = GraspCandidate { opening_m: 0.056, aside_m: 0.0, ..found };
    let narrow = plan(1, &[moved(0.45, 0.25)], Some(&[narrow])).unwrap();
    let approach = narrow.phases.iter().find(|p| p.phase == Phase::Approach).unwrap().trajectory.as_ref().unwrap();
    // A small thing at the height of the fingertips where they grasp, so far beside their middle.
    let beside = |y_m: f64| {
        let at = (base_from_tcp(approach.end()) * Point3::new(0.0, y_m, 0.0)).coords;
        zone((at - Vector3::repeat(0.002)).into(), (at + Vector3::repeat(0.002)).into())
    };
    let (mut sent, near, clear) = (sent(&narrow), beside(0.040), beside(0.056));
    assert_eq!(keeps_out(&sent, &clear, None), Ok(()), "the tips reach 48 mm from their middle");
    let refused = keeps_out(&sent, &near, None).unwrap_err();
    assert!(refused.message.contains("Finger would enter keep_out[0] in phase approach"), "{}", refused.message);
    // Where nothing says how far they are apart they may be wide open.
    sent.phases[0].gripper = None;
    assert!(keeps_out(&sent, &clear, None).is_err());
}

#[test]
fn what_stands_in_a_keep_out_zone_is_not_served_and_the_zone_is_named() {
    let taken = zone([0.3, 0.15, 0.0], [0.6, 0.35, 0.6]);
    let Err(PickPlaceError::NoPlacement(reasons)) = plan_in(&taken, &[moved(0.45, 0.25)]) else { panic!("expected no placement") };
    assert_eq!(reasons[0].failure, PlacementFailure::PlaceBlocked);
    assert!(reasons[0].tally.to_string().contains("keep_out[0]"), "{}", reasons[0].tally);
    let home = base_from_tcp(&READY).translation.vector;
    let around_the_hand = zone((home - Vector3::repeat(0.05)).into(), (home + Vector3::repeat(0.05)).into());
    let blocked = plan_in(&around_the_hand, &[moved(0.45, 0.25)]).unwrap_err();
    assert!(blocked.to_string().contains("keep_out[0]"), "{blocked}");
}

#[test]
fn the_open_hand_comes_down_aside_and_closes_at_the_grasp() {
    let found = plan(1, &[moved(0.45, 0.25)], None).unwrap().grasp;
    let aside = GraspCandidate { aside_m: 0.01, ..found };
    let plan = plan(1, &[moved(0.45, 0.25)], Some(&[aside])).unwrap();
    let approach = plan.phases.iter().find(|p| p.phase == Phase::Approach).unwrap().trajectory.as_ref().unwrap();
    let tcp_at =
        |time_s: f64| aside.world_from_tcp.inverse() * Point3::from(base_from_tcp(&approach.at(time_s).position_rad).translation.vector);
    assert!((tcp_at(0.0) - Point3::new(0.0, plan.grasp.aside_m, -0.1)).norm() < 1e-3, "{}", tcp_at(0.0));
    assert!(tcp_at(approach.duration_s()).coords.norm() < 1e-3);
    let times = (0..=100).map(|k| approach.duration_s() * f64::from(k) / 100.0);
    let early = times.map(tcp_at).find(|p| p.z < -0.003 && (p.y - plan.grasp.aside_m).abs() > 2e-3);
    assert_eq!(early, None, "it does not move to the side before it is down");
    assert_eq!(aside.flipped().aside_m, -aside.aside_m);
}

#[test]
fn grasps_from_elsewhere_are_used_in_their_order() {
    let found = plan(1, &[moved(0.45, 0.25)], None).unwrap().grasp;
    let far = GraspCandidate { world_from_tcp: Isometry3::translation(3.0, 0.0, 0.0), ..found };
    let plan = plan(1, &[moved(0.45, 0.25)], Some(&[far, GraspCandidate { width_m: None, ..found }])).unwrap();
    assert_eq!(plan.grasp.world_from_tcp, found.world_from_tcp);
}

#[test]
fn grasps_from_elsewhere_are_all_tried_and_none_is_put_before_an_earlier_one() {
    let found = plan(1, &[moved(0.45, 0.25)], None).unwrap().grasp;
    let far = GraspCandidate { world_from_tcp: Isometry3::translation(3.0, 0.0, 0.0), ..found };
    let mut many = vec![far; 40];
    many.push(found);
    let last = plan(1, &[moved(0.45, 0.25)], Some(&many)).unwrap();
    assert_eq!(last.grasp.world_from_tcp, found.world_from_tcp, "the last of them");
    // A hand turned by half a turn is carried further: whichever is named first is taken, if it can be.
    let turned = found.flipped();
    for order in [[found, turned], [turned, found]] {
        let first = plan(1, &[moved(0.45, 0.25)], Some(&order[..1])).unwrap();
        assert_eq!(plan(1, &[moved(0.45, 0.25)], Some(&order)).unwrap().grasp.world_from_tcp, first.grasp.world_from_tcp);
    }
}

#[test]
fn a_plan_is_given_up_when_it_is_told_and_is_the_same_when_it_is_not() {
    let (scene, placements) = (synthetic::scene(), [moved(1.6, 0.0), moved(0.55, 0.1), moved(0.45, 0.25)]);
    let request = PickPlaceRequest { scene: &scene, query: 1, placements: &placements, start: &READY, grasps: None, seed: 3 };
    let told = |after: usize| {
        let asked = Cell::new(0);
        let should_stop = || {
            asked.set(asked.get() + 1);
            asked.get() > after
        };
        (pick_place_until(&request, &PickPlaceSettings::default(), &should_stop), asked.get())
    };
    let (whole, asked) = told(usize::MAX);
    assert_eq!(whole, pick_place(&request, &PickPlaceSettings::default()));
    assert!(whole.is_ok() && asked > 20, "it was asked {asked} times");
    for after in [0, 1, asked / 2] {
        let (stopped, until) = told(after);
        assert_eq!(stopped, Err(PickPlaceError::Stopped));
        assert!(until < after + 10, "{until} times of {after}: it goes on");
    }
}

#[test]
fn the_same_seed_gives_the_same_plan() {
    assert_eq!(plan(1, &[moved(0.4, 0.3)], None), plan(1, &[moved(0.4, 0.3)], None));
}
