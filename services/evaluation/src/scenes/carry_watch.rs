//! What goes wrong between approach and retreat, by ground truth: what hand and held object touch that they should not, and when what is
//! held first shifts in the hand. It explains a failure; it decides none.

use nalgebra::{Isometry3, Vector3};
use repose_geometry::transform::tilt;
use repose_panda::base_from_hand;
use repose_proto::motion::Phase;
use repose_simulator::cell_world::CellWorld;
use repose_simulator::physics::Touchable;
use repose_simulator::scene::SimulatedScene;
use serde::Serialize;

/// A change of pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Shift {
    /// Distance, metres.
    pub by_m: f64,
    /// Angle, radians.
    pub turn_rad: f64,
}

impl Shift {
    /// From one pose to another.
    pub fn between(a: &Isometry3<f64>, b: &Isometry3<f64>) -> Self {
        Self { by_m: (a.translation.vector - b.translation.vector).norm(), turn_rad: a.rotation.angle_to(&b.rotation) }
    }
}

/// Something that should not have happened.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Incident {
    /// The phase of the plan.
    pub phase: Phase,
    /// When, seconds of robot time.
    pub at_s: f64,
    /// What.
    pub what: String,
}

/// Watches one object while a plan is carried out.
#[derive(Debug)]
pub struct CarryWatch {
    query: usize,
    phase: Phase,
    /// How it stood before the plan began.
    stood: Option<Isometry3<f64>>,
    /// The object's pose in the hand and its height (metres) when the fingers had closed.
    grasped: Option<(Isometry3<f64>, f64)>,
    /// Its pose in the hand when the lift and when the lowering had ended.
    lifted: Option<Isometry3<f64>>,
    lowered: Option<Isometry3<f64>>,
    slipped: bool,
    /// What happened, each kind once per phase.
    pub incidents: Vec<Incident>,
}

/// How high the object must be for its touching something to count, metres: until then it stands where it stood.
const LIFTED_M: f64 = 0.03;
/// From here on it leans between the fingers, radians.
const LEANS_RAD: f64 = 0.05;
/// From here on it has slipped: metres and radians.
const SLIPPED: (f64, f64) = (0.008, 0.1);

impl CarryWatch {
    /// A watch over the scene's object number `query`.
    pub fn new(query: usize) -> Self {
        Self {
            query,
            phase: Phase::Standoff,
            stood: None,
            grasped: None,
            lifted: None,
            lowered: None,
            slipped: false,
            incidents: Vec::new(),
        }
    }

    /// The plan has come to a phase.
    pub fn begins(&mut self, phase: Phase, cell: &CellWorld) {
        self.phase = phase;
        let pose = cell.world_from_objects()[self.query];
        let stood = *self.stood.get_or_insert(pose);
        let in_hand = base_from_hand(cell.arm.q_rad()).inverse() * pose;
        match phase {
            Phase::Lift => self.grasped = Some((in_hand, pose.translation.z)),
            Phase::Transfer => self.lifted = Some(in_hand),
            Phase::Release => self.lowered = Some(in_hand),
            _ => {}
        }
        if matches!(phase, Phase::Lift | Phase::Release) {
            let leans_rad = tilt(&stood, &pose);
            if leans_rad > LEANS_RAD {
                self.note(cell, format!("the object leans by {leans_rad:.2} rad"));
            }
        }
    }

    /// How the object has shifted in the hand between the closing of the fingers and the end of the lift; none where it did not come so far.
    pub fn shift_of_lift(&self) -> Option<Shift> {
        self.grasped.zip(self.lifted).map(|((grasped, _), lifted)| Shift::between(&grasped, &lifted))
    }

    /// The same until the end of the lowering.
    pub fn shift_in_hand(&self) -> Option<Shift> {
        self.grasped.zip(self.lowered).map(|((grasped, _), lowered)| Shift::between(&grasped, &lowered))
    }

    /// Looks at the cell as it is now.
    pub fn look(&mut self, cell: &CellWorld, scene: &SimulatedScene) {
        let is_carried = self.phase.is_carrying();
        let pose = cell.world_from_objects()[self.query];
        let risen_m = self.grasped.map_or(0.0, |(_, height_m)| pose.translation.z - height_m);
        let is_up = is_carried && (self.phase != Phase::Lift || risen_m > LIFTED_M);
        let query = Touchable::Object(self.query);
        for [a, b] in cell.contacts() {
            let (who, other) = match (a, b) {
                (Touchable::Robot, other) | (other, Touchable::Robot) if other == query => match self.phase {
                    Phase::Standoff | Phase::Approach => ("the hand", other),
                    _ => continue,
                },
                (Touchable::Robot, other) | (other, Touchable::Robot) => ("the hand", other),
                (a, other) | (other, a) if a == query && is_up => ("the object", other),
                _ => continue,
            };
            self.note(cell, format!("{who} touches {}", self.name_of(other, scene)));
        }
        if let Some((in_hand, _)) = self.grasped.filter(|_| is_carried && !self.slipped) {
            let now = base_from_hand(cell.arm.q_rad()).inverse() * pose;
            let shift = Shift::between(&in_hand, &now);
            if shift.by_m > SLIPPED.0 || shift.turn_rad > SLIPPED.1 {
                self.slipped = true;
                let along: Vector3<f64> = now.translation.vector - in_hand.translation.vector;
                let [x, y, z] = [along.x, along.y, along.z].map(|m| m * 1e3);
                self.note(cell, format!("the object slips: {x:.0} {y:.0} {z:.0} mm in the hand, {:.2} rad", shift.turn_rad));
            }
        }
    }

    fn note(&mut self, cell: &CellWorld, what: String) {
        if !self.incidents.iter().any(|i| i.phase == self.phase && i.what == what) {
            self.incidents.push(Incident { phase: self.phase, at_s: cell.robot_ms() * 1e-3, what });
        }
    }

    fn name_of(&self, what: Touchable, scene: &SimulatedScene) -> String {
        match what {
            Touchable::Fixture(i) => scene.fixtures.get(i).map_or_else(String::new, |f| f.role.name().to_owned()),
            Touchable::Object(i) if i == self.query => "the object".to_owned(),
            Touchable::Object(i) => scene.objects.get(i).map_or_else(String::new, |o| format!("{} ({})", o.id, o.shape.name)),
            Touchable::Robot => "the robot".to_owned(),
        }
    }
}
