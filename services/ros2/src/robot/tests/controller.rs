//! What becomes of a goal that takes the place of another: by a controller that leaves the old one at once, as `ros2_control`'s
//! `JointTrajectoryController` does, and goes from where it is then to the new one's first point on a cubic.

use repose_panda::{CommandRuleSettings, CommandRules, Joints, READY, hermite};
use repose_proto::robot::SetPoint;
use repose_ros_messages::JointTrajectory;

use super::trial::{Trial, halted, swing};
use crate::robot::events::{Do, Told};

/// How long a goal takes to get to the controller, milliseconds.
const WAY_MS: usize = 10;

/// The controller: what it goes through from where it was as its goal came, and how far it is since then.
struct Controller {
    knots: Vec<SetPoint>,
    followed_ms: f64,
}

impl Controller {
    fn standing_at(q_rad: Joints) -> Self {
        Self { knots: vec![SetPoint { t_ms: 0.0, q_rad, dq_rad_s: [0.0; 7] }], followed_ms: 0.0 }
    }

    fn take(&mut self, trajectory: &JointTrajectory) {
        let joints = |numbers: &[f64]| -> Joints { numbers.try_into().expect("seven joints") };
        let here = SetPoint { t_ms: 0.0, ..self.place() };
        let points = trajectory.points.iter().map(|point| SetPoint {
            t_ms: point.time_from_start.as_ms(),
            q_rad: joints(&point.positions),
            dq_rad_s: joints(&point.velocities),
        });
        self.knots = std::iter::once(here).chain(points).collect();
        self.followed_ms = 0.0;
    }

    fn place(&self) -> SetPoint {
        let next = self.knots.partition_point(|knot| knot.t_ms <= self.followed_ms);
        let a = self.knots[next - 1];
        let Some(b) = self.knots.get(next) else { return SetPoint { dq_rad_s: [0.0; 7], ..a } };
        let (span_ms, t_ms) = (b.t_ms - a.t_ms, self.followed_ms);
        let (q_rad, dq_rad_s) = hermite((&a.q_rad, &a.dq_rad_s), (&b.q_rad, &b.dq_rad_s), span_ms * 1e-3, (t_ms - a.t_ms) / span_ms);
        SetPoint { t_ms, q_rad, dq_rad_s }
    }

    /// Where it has the joints at each of the next milliseconds.
    fn follow(&mut self, milliseconds: usize) -> Vec<Joints> {
        let next = |_| {
            self.followed_ms += 1.0;
            self.place().q_rad
        };
        (0..milliseconds).map(next).collect()
    }
}

/// Where the joints are at each millisecond of a fast swing that is brought to rest on its way, as the controller carries it out. It says that it
/// accepts, which is heard `accepts_in_ms` after the goal was sent, and has begun `began_ms` before that.
fn brought_to_rest(accepts_in_ms: u64, began_ms: usize, rest: &[SetPoint]) -> Vec<Joints> {
    let sent = |trial: &mut Trial| match &trial.done()[..] {
        [Do::Follow(_, trajectory)] => trajectory.clone(),
        other => panic!("expected a goal, got {other:?}"),
    };
    let mut trial = Trial::new(false);
    let mut controller = Controller::standing_at(READY);
    trial.start(swing(READY[0], 1.0));
    controller.take(&sent(&mut trial));
    trial.run(accepts_in_ms);
    trial.side.told(Told::Accepted(1), trial.now_ms);
    let mut places = vec![READY];
    places.extend(controller.follow(began_ms));
    for _ in 0..75 {
        trial.joints_rad = controller.place().q_rad;
        trial.run(4);
        places.extend(controller.follow(4));
    }
    trial.command(|command| (command.set_points, command.ends_stream) = (rest.to_vec(), true));
    let goal = sent(&mut trial);
    places.extend(controller.follow(WAY_MS));
    controller.take(&goal);
    places.extend(controller.follow(1500));
    places
}

#[test]
fn a_controller_that_is_ahead_of_its_word_comes_to_rest_within_the_limits_and_never_goes_back() {
    // After 300 ms of the swing. The last is ahead by as long as a goal takes to be accepted, and no more is reckoned with than 50 ms.
    for (accepts_in_ms, began_ms) in [(0, 5), (16, 5), (60, 50)] {
        for slows_ms in [700.0, 450.0] {
            let named = format!("accepted in {accepts_in_ms} ms, begun {began_ms} ms before, slowing down from {slows_ms} ms on");
            let rest = halted(slows_ms, READY[0], 1.0);
            let places = brought_to_rest(accepts_in_ms, began_ms, &rest);
            assert_eq!(CommandRules::check(&READY, &places, CommandRuleSettings::default()), Ok(()), "{named}");
            assert!(places.windows(2).all(|pair| pair[1][0] >= pair[0][0] - 1e-6), "{named}");
            let (last, end) = (places[places.len() - 1], rest[rest.len() - 1].q_rad);
            assert!((last[0] - end[0]).abs() < 1e-9, "{named}: {last:?}");
        }
    }
}
