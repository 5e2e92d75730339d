//! Whatever is commanded, and whatever happens to the robot: no set-point that reaches it breaks a limit, what is stopped stays where it is until
//! it is cleared, and nothing is acknowledged but by a reset.

use proptest::prelude::*;
use repose_panda::{Joints, Model};
use repose_proto::robot::{RobotCommand, SetPoint};

use super::bench::Bench;

/// What happens between two stretches of time.
#[derive(Debug, Clone)]
enum Act {
    /// A good commander's stream to a place.
    Stream {
        to: Joints,
        span_ms: f64,
        ends: bool,
        take: usize,
    },
    /// Set-points that belong to nothing.
    Noise {
        points: Vec<(Joints, Joints, f64)>,
        starts: bool,
        ends: bool,
    },
    /// The last command again, under the next number.
    Replay,
    Reset,
    Stop,
    Reflex(&'static str),
    UserStop(bool),
    Lose,
    Return,
    /// The joints are off where they should be.
    Push(f64),
    /// The robot refuses to recover, or no more.
    Stubborn(bool),
}

fn places() -> impl Strategy<Value = Joints> {
    prop::array::uniform7(0.0..1.0f64).prop_map(|u| Model::Panda.limits().narrower(&Model::Fr3.limits()).between(&u))
}

fn acts() -> impl Strategy<Value = (Act, u64)> {
    let stream = (places(), 300.0..4000.0f64, any::<bool>(), 2..400usize).prop_map(|(to, span_ms, ends, take)| Act::Stream {
        to,
        span_ms,
        ends,
        take,
    });
    let point = (places(), prop::array::uniform7(-3.0..3.0f64), 0.01..200.0f64);
    let noise = (prop::collection::vec(point, 0..6), any::<bool>(), any::<bool>()).prop_map(|(points, starts, ends)| Act::Noise {
        points,
        starts,
        ends,
    });
    let reflexes = prop_oneof![
        Just("joint_reflex"),
        Just("cartesian_reflex"),
        Just("communication_constraints_violation"),
        Just("power_limit_violation")
    ];
    let act = prop_oneof![
        8 => stream,
        1 => noise,
        1 => Just(Act::Replay),
        6 => Just(Act::Reset),
        1 => Just(Act::Stop),
        1 => reflexes.prop_map(Act::Reflex),
        1 => any::<bool>().prop_map(Act::UserStop),
        1 => Just(Act::Lose),
        3 => Just(Act::Return),
        1 => prop_oneof![3 => Just(0.0), 1 => Just(0.3), 1 => Just(f64::NAN)].prop_map(Act::Push),
        1 => prop::bool::weighted(0.3).prop_map(Act::Stubborn),
    ];
    (act, prop_oneof![3 => 0..400u64, 1 => 400..2500u64])
}

/// Does it; whether it was a reset.
fn act(bench: &mut Bench, act: &Act) -> bool {
    match act {
        Act::Stream { to, span_ms, ends, take } => {
            let set_points = bench.smooth(to, *span_ms).into_iter().take(*take).collect();
            let command = RobotCommand { set_points, starts_stream: true, ends_stream: *ends, ..bench.next() };
            // Refusals are part of the bargain.
            let _ = bench.send(command);
        }
        Act::Noise { points, starts, ends } => {
            let mut t_ms = 0.0;
            let set_points = points.iter().map(|(q_rad, dq_rad_s, span_ms)| {
                t_ms += span_ms;
                SetPoint { t_ms, q_rad: *q_rad, dq_rad_s: *dq_rad_s }
            });
            let set_points = set_points.collect();
            let command = RobotCommand { set_points, starts_stream: *starts, ends_stream: *ends, ..bench.next() };
            let _ = bench.send(command);
        }
        Act::Replay => {
            let Some(last) = bench.last.clone() else { return false };
            let command = RobotCommand { seq: bench.next().seq, clear_stop: false, ..last };
            let _ = bench.send(command);
        }
        Act::Reset => {
            bench.reset(200);
            return true;
        }
        Act::Stop => bench.estop(),
        Act::Reflex(name) => bench.reflex(name),
        Act::UserStop(pressed) => bench.user_stop(*pressed),
        Act::Lose if bench.is_connected => bench.disconnect(),
        Act::Return if !bench.is_connected => bench.reconnect(),
        Act::Push(off_rad) => bench.robot.off_rad = *off_rad,
        Act::Stubborn(is_stubborn) => bench.robot.is_stubborn = *is_stubborn,
        Act::Lose | Act::Return => {}
    }
    false
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_set_point_breaks_a_limit_and_no_stop_clears_itself(
        script in prop::collection::vec(acts(), 1..16),
        model in prop_oneof![Just(Model::Panda), Just(Model::Fr3)],
        sag_rad in prop_oneof![Just(0.0), -0.004..0.004f64],
    ) {
        let mut bench = Bench::new(model);
        bench.robot.sag_rad = sag_rad;
        for (next, milliseconds) in &script {
            let (stopped, recoveries) = (bench.side.stop().is_some(), bench.robot.recoveries);
            let is_reset = act(&mut bench, next);
            bench.run(*milliseconds);
            prop_assert!(is_reset || !stopped || bench.side.stop().is_some(), "{next:?} has cleared a stop");
            prop_assert!(is_reset || bench.robot.recoveries <= recoveries + 1, "{next:?} has begun a recovery");
        }
        // Without a commander it comes to rest, and stays there.
        bench.run(5000);
        prop_assert_eq!(&bench.robot.violations, &Vec::<String>::new());
        let end = bench.robot.trace.len() - 1;
        prop_assert_eq!(bench.robot.trace[end], bench.robot.trace[end - 1000]);
        prop_assert!(!bench.robot.in_motion);
    }

    #[test]
    fn whatever_stops_the_arm_at_any_moment_leaves_it_at_rest_and_latched(
        to in places(), at_ms in 1..1200u64, how in 0..6usize, model in prop_oneof![Just(Model::Panda), Just(Model::Fr3)],
    ) {
        let mut bench = Bench::new(model);
        bench.stream(&to, 4000.0).expect("taken");
        bench.run(at_ms);
        // One that broke a rule is stopped for that.
        prop_assume!(bench.side.stop().is_none());
        let kind = ["estop", "joint_reflex", "user_stop", "connection_lost", "following_error", "driver_ended"][how];
        match how {
            0 => bench.estop(),
            1 => bench.reflex("joint_reflex"),
            2 => bench.user_stop(true),
            3 => bench.disconnect(),
            4 => bench.robot.off_rad = 1.0,
            _ => bench.side.end(),
        }
        bench.run(1500);
        let stopped_by = bench.stopped_by();
        prop_assert_eq!(stopped_by.as_deref(), Some(kind));
        let stands = bench.robot.held_rad;
        let again = bench.last.clone().expect("a command was sent");
        bench.seq += 1;
        let seq = bench.seq;
        let taken = bench.send(RobotCommand { seq, ..again });
        prop_assert!(taken.is_err(), "what it was told before is not done afterwards");
        bench.run(200);
        prop_assert_eq!(bench.robot.held_rad, stands);
        prop_assert_eq!(&bench.robot.violations, &Vec::<String>::new());
    }

    #[test]
    fn a_robot_that_misses_set_points_is_brought_back_to_its_way_within_the_limits(
        to in places(), at_ms in 20..3980u64, missed_ms in prop::collection::vec((1..20u64, 1..400u64), 1..4),
        model in prop_oneof![Just(Model::Panda), Just(Model::Fr3)],
    ) {
        let mut bench = Bench::new(model);
        bench.stream(&to, 4000.0).expect("taken");
        bench.run(5000);
        // One that breaks a rule is stopped for that.
        prop_assume!(bench.side.stop().is_none());
        bench = Bench::new(model);
        bench.stream(&to, 4000.0).expect("taken");
        bench.run(at_ms);
        for (missed_ms, then_ms) in missed_ms {
            bench.miss(missed_ms);
            bench.run(then_ms);
        }
        bench.run(6000);
        prop_assert_eq!(&bench.robot.violations, &Vec::<String>::new());
        prop_assert_eq!(bench.stopped_by(), None);
        prop_assert!(!bench.robot.in_motion);
        let off_rad = (0..7).map(|i| (bench.robot.held_rad[i] - to[i]).abs()).fold(0.0, f64::max);
        prop_assert!(off_rad < 1e-9, "it ends {off_rad} rad beside where it was sent");
    }
}
