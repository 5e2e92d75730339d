//! Whatever is sent to the arm, at whatever moment, no limit of position, velocity, acceleration or jerk is exceeded, and it ends at rest.
//!
//! The properties are judged from the positions alone, by differences over a millisecond, not by what the arm says of itself.

use proptest::prelude::*;
use repose_panda::{CommandRuleSettings, JOINT_COUNT, JointLimits, Joints, LIMITS, Model, READY};
use repose_proto::robot::{EmergencyStop, Owner, RobotCommand, RobotMode, SetPoint};
use repose_robot_side::{Arm, ArmSettings, straight_way};

/// What is done to the arm between two stretches of time.
#[derive(Debug, Clone)]
enum Act {
    /// A stream from where the arm stands to a place in so many milliseconds, as a good commander sends it, from a set-point on.
    Stream { to: Joints, span_ms: f64, starts: bool, ends: bool, skip: usize, take: usize },
    /// Set-points that belong to nothing: any places and speeds, any distance in time.
    Noise { points: Vec<([f64; 7], [f64; 7], f64)>, starts: bool, ends: bool },
    /// A number of the last command's replaced by something that is no number or is far off.
    Broken { value: f64, index: usize, speed: bool },
    /// The last command again, as it was or under the next number.
    Replay { renumbered: bool },
    /// An emergency stop.
    Stop,
    /// A command that clears a stop.
    Clear,
    /// Another commander takes over.
    TakeOver,
}

fn places() -> impl Strategy<Value = Joints> {
    (prop::array::uniform7(0.0..1.0f64), models()).prop_map(|(u, model)| model.limits().between(&u))
}

fn models() -> impl Strategy<Value = Model> {
    prop_oneof![Just(Model::Panda), Just(Model::Fr3)]
}

fn acts() -> impl Strategy<Value = (Act, usize)> {
    let stream = (
        places(),
        200.0..4000.0f64,
        prop::bool::weighted(0.8),
        any::<bool>(),
        prop_oneof![3 => Just(0usize), 1 => 0..60usize],
        1..400usize,
    )
        .prop_map(|(to, span_ms, starts, ends, skip, take)| Act::Stream { to, span_ms, starts, ends, skip, take });
    let point = (places(), prop::array::uniform7(-3.0..3.0f64), 0.01..200.0f64);
    let noise = (prop::collection::vec(point, 0..8), any::<bool>(), any::<bool>()).prop_map(|(points, starts, ends)| Act::Noise {
        points,
        starts,
        ends,
    });
    let values = prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(1e308), Just(-5.0), -0.1..0.1f64];
    let broken = (values, 0..2000usize, any::<bool>()).prop_map(|(value, index, speed)| Act::Broken { value, index, speed });
    let act = prop_oneof![
        6 => stream,
        1 => noise,
        2 => broken,
        2 => any::<bool>().prop_map(|renumbered| Act::Replay { renumbered }),
        1 => Just(Act::Stop),
        3 => Just(Act::Clear),
        1 => Just(Act::TakeOver),
    ];
    (act, prop_oneof![3 => 0..300usize, 1 => 300..2500usize])
}

/// Sends what a list of acts says and watches every millisecond.
struct Bench {
    arm: Arm,
    now_s: f64,
    owner: Owner,
    seq: u64,
    last: Option<RobotCommand>,
    trace: Vec<Joints>,
}

impl Bench {
    fn new(model: Model) -> Self {
        let rules = CommandRuleSettings { limits: model.limits(), ..CommandRuleSettings::default() };
        let arm = Arm::new(ArmSettings { model, rules, ..ArmSettings::default() });
        // Three times where it stands, so that the first differences are of rest.
        Self { trace: vec![*arm.q_rad(); 3], arm, now_s: 0.0, owner: Owner { id: "a".to_owned(), epoch: 1 }, seq: 0, last: None }
    }

    fn command(&mut self, set_points: Vec<SetPoint>, starts_stream: bool, ends_stream: bool, clear_stop: bool) {
        self.seq += 1;
        let command = RobotCommand {
            v: 1,
            seq: self.seq,
            owner: self.owner.clone(),
            ttl_ms: 400,
            starts_stream,
            ends_stream,
            set_points,
            gripper: None,
            clear_stop,
            clears: None,
            task: None,
        };
        self.send(command);
    }

    fn send(&mut self, command: RobotCommand) {
        // Refusals are part of the bargain.
        let _ = self.arm.command(&command, self.now_s);
        self.last = Some(command);
    }

    fn act(&mut self, act: &Act) {
        match act {
            Act::Stream { to, span_ms, starts, ends, skip, take } => {
                let points = self.smooth(to, *span_ms);
                let chosen = points.into_iter().skip(*skip).take(*take).collect();
                self.command(chosen, *starts, *ends, false);
            }
            Act::Noise { points, starts, ends } => {
                let mut t_ms = 0.0;
                let points = points.iter().map(|(q_rad, dq_rad_s, span_ms)| {
                    t_ms += span_ms;
                    SetPoint { t_ms: t_ms - span_ms, q_rad: *q_rad, dq_rad_s: *dq_rad_s }
                });
                let points = points.collect();
                self.command(points, *starts, *ends, false);
            }
            Act::Broken { value, index, speed } => {
                let Some(mut command) = self.last.clone() else { return };
                let count = command.set_points.len().max(1);
                if let Some(point) = command.set_points.get_mut(index % count) {
                    let numbers = if *speed { &mut point.dq_rad_s } else { &mut point.q_rad };
                    numbers[index % JOINT_COUNT] = *value;
                }
                self.seq += 1;
                self.send(RobotCommand { seq: self.seq, ..command });
            }
            Act::Replay { renumbered } => {
                let Some(command) = self.last.clone() else { return };
                self.seq += u64::from(*renumbered);
                let seq = if *renumbered { self.seq } else { command.seq };
                self.send(RobotCommand { seq, ..command });
            }
            Act::Stop => self.arm.emergency_stop(&EmergencyStop {
                v: 1,
                id: format!("stop-{}", self.seq),
                source: "test".to_owned(),
                reason: "now".to_owned(),
                stamp_ns: 0,
            }),
            Act::Clear => self.command(Vec::new(), false, false, true),
            Act::TakeOver => self.owner.epoch += 1,
        }
    }

    /// A smooth motion from where the arm is to a place, a set-point every 10 ms.
    fn smooth(&self, to: &Joints, span_ms: f64) -> Vec<SetPoint> {
        straight_way(self.arm.q_rad(), to, span_ms)
    }

    fn run(&mut self, milliseconds: usize) {
        for _ in 0..milliseconds {
            self.now_s += 1e-3;
            self.arm.tick(self.now_s);
            self.trace.push(*self.arm.q_rad());
        }
    }
}

/// The first limit that a trace of positions, one each millisecond, exceeds.
#[allow(clippy::needless_range_loop, reason = "differences reach back over the trace")]
fn exceeded(trace: &[Joints], limits: &JointLimits) -> Option<String> {
    // Third differences of angles over a billionth of a cubic second blow rounding up to a few thousandths.
    let over = |value: f64, limit: f64| value.abs() > limit * (1.0 + 3e-6) + 0.01;
    let velocity = |k: usize, i: usize| (trace[k][i] - trace[k - 1][i]) * 1e3;
    let acceleration = |k: usize, i: usize| (velocity(k, i) - velocity(k - 1, i)) * 1e3;
    for k in 3..trace.len() {
        for i in 0..JOINT_COUNT {
            let q = trace[k][i];
            if !(limits.position_lower_rad[i] - 1e-7..=limits.position_upper_rad[i] + 1e-7).contains(&q) {
                return Some(format!("{k} ms, joint {i}: {q} rad"));
            }
            let jerk = (acceleration(k, i) - acceleration(k - 1, i)) * 1e3;
            if velocity(k, i).abs() > limits.speed_at(i, q, velocity(k, i)) * (1.0 + 3e-6) + 1e-9 {
                return Some(format!("{k} ms, joint {i}: {} rad/s", velocity(k, i)));
            }
            if over(acceleration(k, i), limits.acceleration_rad_s2[i]) {
                return Some(format!("{k} ms, joint {i}: {} rad/s²", acceleration(k, i)));
            }
            if over(jerk, limits.jerk_rad_s3[i]) {
                return Some(format!("{k} ms, joint {i}: {jerk} rad/s³"));
            }
        }
    }
    None
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_sequence_of_commands_makes_the_arm_exceed_a_limit(script in prop::collection::vec(acts(), 1..14), model in models()) {
        let mut bench = Bench::new(model);
        for (act, milliseconds) in &script {
            bench.act(act);
            bench.run(*milliseconds);
        }
        // Without a commander it comes to rest within three seconds, whatever it was doing.
        bench.run(8000);
        prop_assert_eq!(exceeded(&bench.trace, &model.limits()), None);
        let end = bench.trace.len() - 1;
        prop_assert_eq!(bench.trace[end], bench.trace[end - 1000]);
        prop_assert!(bench.arm.mode() != RobotMode::Moving);
    }

    #[test]
    fn a_stop_at_any_moment_of_a_fast_motion_keeps_the_limits_and_latches(to in places(), at_ms in 0..1500usize, silent in any::<bool>()) {
        let mut bench = Bench::new(Model::Panda);
        // As fast as the limits of velocity and acceleration of the slowest joint allow.
        let span_ms = (0..JOINT_COUNT).map(|i| {
            let way = (to[i] - READY[i]).abs();
            (1.875 * way / LIMITS.velocity_rad_s[i]).max((5.8 * way / LIMITS.acceleration_rad_s2[i]).sqrt()) * 1010.0
        }).fold(50.0, f64::max);
        let points = bench.smooth(&to, span_ms);
        bench.command(points, true, !silent, false);
        bench.run(at_ms);
        if !silent {
            bench.act(&Act::Stop);
        }
        bench.run(3000);
        prop_assert_eq!(exceeded(&bench.trace, &LIMITS), None);
        if silent || at_ms as f64 <= span_ms {
            let kind = bench.arm.stop().map(|s| s.kind.clone());
            prop_assert_eq!(kind.as_deref(), Some(if silent { "commander_silent" } else { "estop" }));
        }
        let end = bench.trace.len() - 1;
        prop_assert_eq!(bench.trace[end], bench.trace[end - 1000]);
        // Nothing moves it until it is cleared, and nothing that it was told before is done afterwards.
        let stands = *bench.arm.q_rad();
        let before = bench.last.clone();
        bench.send(before.expect("a command was sent"));
        bench.run(100);
        prop_assert_eq!(*bench.arm.q_rad(), stands);
    }
}
