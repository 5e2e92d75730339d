//! From ranked placements to a timed pick and place.
//!
//! Placements are taken in rank order. For each, grasps are tried best first until one is reachable and free at both ends and free ways join
//! them (start to standoff, lift to above the placement); so an unreachable best placement falls back to the next, and the result says why.
//! What is known of a grasp at the object is kept for all placements. Standoff and release heights: paper, section 3.

use nalgebra::{Isometry3, Point3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_panda::{Frame, Joints, LIMITS};

use crate::collision::{CollisionChecker, HeldObject};
use crate::grasp::sight::Sight;
use crate::grasp::{Grasp, GraspScene, GraspSettings, GraspTally, grasps};
use crate::obstacles::{ObstacleSettings, Obstacles};
use crate::plan::{EndTally, GripperMove, NotChosen, Phase, PickPlaceError, PickPlacePlan, PlannedPhase};
use crate::reach::{EndFailure, PickEnd, PlaceEnd, Reach, ReachSettings};
use crate::rrt_connect::{RrtSettings, rrt_connect};
use crate::scene::PlanningScene;
use crate::simplify::{SimplifySettings, simplified};
use crate::timing::{TimingSettings, Trajectory};

/// How a pick and place is planned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PickPlaceSettings {
    /// Where the robot stands.
    pub world_from_base: Isometry3<f64>,
    /// The obstacles' resolution.
    pub obstacles: ObstacleSettings,
    /// How grasps are found.
    pub grasp: GraspSettings,
    /// How the ends are reached.
    pub reach: ReachSettings,
    /// The search for paths between them.
    pub rrt: RrtSettings,
    /// The shortening of those paths.
    pub simplify: SimplifySettings,
    /// How fast the arm moves in free space.
    pub timing: TimingSettings,
    /// Share of that speed and acceleration near things: approach, lift, lower, retreat. Default 0.5.
    pub contact_scale: f64,
    /// What is added to the robot's spheres, metres. Default 0.003.
    pub padding_m: f64,
    /// Spacing of the held object's points, metres. Default 0.012.
    pub held_spacing_m: f32,
    /// Ball that each of them stands for, metres. Default 0.004.
    pub held_radius_m: f64,
    /// Grip force, newtons. Default 30.
    pub grip_force_n: f64,
    /// Grasps tried per placement, both turns of the hand counted. Default 64.
    pub grasps_per_placement: usize,
    /// Path searches per placement that may fail. Default 4.
    pub path_failures: usize,
}

impl Default for PickPlaceSettings {
    fn default() -> Self {
        Self {
            world_from_base: Isometry3::identity(),
            obstacles: ObstacleSettings::default(),
            grasp: GraspSettings::default(),
            reach: ReachSettings::default(),
            rrt: RrtSettings::default(),
            simplify: SimplifySettings::default(),
            timing: TimingSettings::default(),
            contact_scale: 0.5,
            padding_m: 0.003,
            held_spacing_m: 0.012,
            held_radius_m: 0.004,
            grip_force_n: 30.0,
            grasps_per_placement: 64,
            path_failures: 4,
        }
    }
}

/// What to plan.
#[derive(Debug, Clone, Copy)]
pub struct PickPlaceRequest<'a> {
    /// The scene.
    pub scene: &'a PlanningScene,
    /// The object to move.
    pub query: u16,
    /// Where it may go, best first: `placed_from_observed` in the world frame.
    pub placements: &'a [Isometry3<f64>],
    /// Where the arm stands, radians.
    pub start: &'a Joints,
    /// Grasps from elsewhere, in the order in which they are tried; none to find them here.
    pub grasps: Option<&'a [Grasp]>,
    /// The source of every random number.
    pub seed: u64,
}

/// Plans a pick and place for the best placement that the arm can serve.
///
/// # Errors
/// [`PickPlaceError`] when the object is unknown, the arm cannot start, nothing can be grasped, or no placement can be served.
pub fn pick_place(request: &PickPlaceRequest<'_>, settings: &PickPlaceSettings) -> Result<PickPlacePlan, PickPlaceError> {
    let object = request.scene.points_of(request.query);
    if object.is_empty() {
        return Err(PickPlaceError::NoObject(request.query));
    }
    let surfaces: Vec<_> = request.scene.surfaces.iter().filter(|s| s.object != Some(request.query)).cloned().collect();
    let others = Obstacles::new(&request.scene.points_without(request.query), &surfaces, &settings.obstacles);
    let query = Obstacles::new(&object, &[], &settings.obstacles);
    let (others, everything) = ([&others], [&others, &query]);

    let mut rng = Pcg64::seed_from_u64(request.seed);
    let search = Search { request, settings, object: &object, others: &others, everything: &everything };
    if let Some(contact) = search.checker(&everything, 0.0, None).contact(request.start) {
        return Err(PickPlaceError::StartBlocked(contact));
    }
    let found = match request.grasps {
        Some([]) => return Err(PickPlaceError::NoGrasp(GraspTally::default())),
        Some(given) => given.to_vec(),
        None => {
            let camera_in_world = &request.scene.camera_in_world;
            let sight = Sight::new(camera_in_world, &request.scene.points);
            let support_m = support_under(request.scene, &object, request.query);
            let scene = GraspScene { points: &object, support_m, camera_in_world, sight: &sight, others: others[0] };
            let (found, tally) = grasps(&scene, &settings.grasp, &mut rng);
            if found.is_empty() {
                return Err(PickPlaceError::NoGrasp(tally));
            }
            found
        }
    };
    // A hand that is turned by half a turn grasps the same: the wrist may reach one and not the other.
    let mut tried: Vec<TriedGrasp<'_>> = found.iter().flat_map(|g| [*g, g.flipped()]).map(|grasp| search.tried(grasp)).collect();
    tried.truncate(settings.grasps_per_placement);

    let mut not_chosen = Vec::new();
    for (placement, placed_from_observed) in request.placements.iter().enumerate() {
        match search.placement(placed_from_observed, &mut tried, &mut rng) {
            Ok((grasp, phases)) => return Ok(PickPlacePlan { placement, not_chosen, grasp, phases }),
            Err(tally) => not_chosen.push(NotChosen { placement, failure: tally.failure(), tally }),
        }
    }
    Err(PickPlaceError::NoPlacement(not_chosen))
}

/// A grasp, what it holds, and what is known of it at the object.
struct TriedGrasp<'a> {
    grasp: Grasp,
    held: HeldObject,
    pick: Option<Result<PickEnd, EndFailure>>,
    to_standoff: Option<Option<Trajectory>>,
    search: &'a Search<'a>,
}

impl TriedGrasp<'_> {
    fn open(&self) -> CollisionChecker<'_> {
        self.search.checker(self.search.others, self.grasp.opening_m, None)
    }

    fn holding(&self) -> CollisionChecker<'_> {
        self.search.checker(self.search.others, self.grasp.width_m.unwrap_or(self.grasp.opening_m), Some(&self.held))
    }

    fn reach(&self) -> Reach<'_> {
        let base_from_world = self.search.settings.world_from_base.inverse();
        Reach { base_from_world, open: self.open(), holding: self.holding(), settings: &self.search.settings.reach }
    }

    /// The object's end of the move, worked out once.
    fn pick_end(&mut self, rng: &mut Pcg64) -> Result<PickEnd, EndFailure> {
        if self.pick.is_none() {
            let near = self.search.near(&self.grasp.world_from_tcp);
            self.pick = Some(self.reach().pick(&self.grasp, &near, rng));
        }
        self.pick.clone().unwrap_or(Err(EndFailure::Unreachable))
    }

    /// The way from the start to the standoff, worked out once.
    fn standoff(&mut self, pick: &PickEnd, rng: &mut Pcg64) -> Option<Trajectory> {
        if self.to_standoff.is_none() {
            // The object itself is in the way here.
            let checker = self.search.checker(self.search.everything, self.grasp.opening_m, None);
            self.to_standoff = Some(self.search.path(self.search.request.start, &pick.approach[0], &checker, rng));
        }
        self.to_standoff.clone().flatten()
    }
}

struct Search<'a> {
    request: &'a PickPlaceRequest<'a>,
    settings: &'a PickPlaceSettings,
    object: &'a [Point3<f32>],
    others: &'a [&'a Obstacles],
    everything: &'a [&'a Obstacles],
}

impl<'a> Search<'a> {
    fn checker(&self, obstacles: &'a [&'a Obstacles], finger_opening_m: f64, held: Option<&'a HeldObject>) -> CollisionChecker<'a> {
        let world_from_base = Frame::of(&self.settings.world_from_base);
        CollisionChecker { world_from_base, obstacles, padding_m: self.settings.padding_m, finger_opening_m, held }
    }

    fn tried(&'a self, grasp: Grasp) -> TriedGrasp<'a> {
        let held = HeldObject::new(self.object, &grasp.world_from_tcp, self.settings.held_spacing_m, self.settings.held_radius_m);
        TriedGrasp { grasp, held, pick: None, to_standoff: None, search: self }
    }

    /// A posture to start inverse kinematics from: the ready pose, turned towards the target.
    fn near(&self, world_from_tcp: &Isometry3<f64>) -> Joints {
        let in_base = self.settings.world_from_base.inverse() * world_from_tcp.translation.vector;
        let mut near = repose_panda::READY;
        near[0] = in_base.y.atan2(in_base.x);
        LIMITS.clamped(&near, self.settings.reach.inverse.limit_margin_rad)
    }

    /// The first grasp that serves a placement, with the whole plan; or how many failed where.
    fn placement(
        &self,
        placed_from_observed: &Isometry3<f64>,
        tried: &mut [TriedGrasp<'_>],
        rng: &mut Pcg64,
    ) -> Result<(Grasp, Vec<PlannedPhase>), EndTally> {
        let mut tally = EndTally::default();
        for grasp in tried {
            let pick = match grasp.pick_end(rng) {
                Ok(pick) => pick,
                Err(EndFailure::Unreachable) => {
                    tally.pick_unreachable += 1;
                    continue;
                }
                Err(EndFailure::Blocked(contact)) => {
                    tally.pick_blocked += 1;
                    tally.contact = Some(contact);
                    continue;
                }
            };
            let lifted = pick.lift[pick.lift.len() - 1];
            let place = match grasp.reach().place(&grasp.grasp, placed_from_observed, &lifted, rng) {
                Ok(place) => place,
                Err(EndFailure::Unreachable) => {
                    tally.place_unreachable += 1;
                    continue;
                }
                Err(EndFailure::Blocked(contact)) => {
                    tally.place_blocked += 1;
                    tally.contact = Some(contact);
                    continue;
                }
            };
            let to_standoff = grasp.standoff(&pick, rng);
            let transfer = to_standoff.is_some().then(|| self.path(&lifted, &place.lower[0], &grasp.holding(), rng)).flatten();
            if let (Some(to_standoff), Some(transfer)) = (to_standoff, transfer)
                && let Some(phases) = self.phases(grasp, &pick, &place, to_standoff, transfer)
            {
                return Ok((grasp.grasp, phases));
            }
            tally.no_path += 1;
            if tally.no_path >= self.settings.path_failures {
                break;
            }
        }
        Err(tally)
    }

    /// A timed free path between two configurations.
    fn path(&self, from: &Joints, to: &Joints, checker: &CollisionChecker<'_>, rng: &mut Pcg64) -> Option<Trajectory> {
        let is_free = |q: &Joints| checker.is_free(q);
        let corners = rrt_connect(from, &[*to], &is_free, &self.settings.rrt, rng).ok()?;
        let corners = simplified(corners, &self.settings.simplify, &is_free, rng);
        timed(&corners, &self.settings.timing, &is_free)
    }

    fn phases(
        &self,
        grasp: &TriedGrasp<'_>,
        pick: &PickEnd,
        place: &PlaceEnd,
        to_standoff: Trajectory,
        transfer: Trajectory,
    ) -> Option<Vec<PlannedPhase>> {
        let slow = TimingSettings {
            velocity_scale: self.settings.timing.velocity_scale * self.settings.contact_scale,
            acceleration_scale: self.settings.timing.acceleration_scale * self.settings.contact_scale,
            // The corners are a centimetre apart and nearly in line: rounding them by this little changes nothing that was checked.
            deviation_rad: 0.002,
            ..self.settings.timing
        };
        let open = GripperMove { width_m: grasp.grasp.opening_m, force_n: self.settings.grip_force_n };
        let close = GripperMove { width_m: 0.0, force_n: self.settings.grip_force_n };
        let phase = |phase, gripper, trajectory| PlannedPhase { phase, gripper, trajectory };
        Some(vec![
            phase(Phase::Standoff, Some(open), Some(to_standoff)),
            phase(Phase::Approach, None, Some(Trajectory::new(&pick.approach, &slow)?)),
            phase(Phase::Grasp, Some(close), None),
            phase(Phase::Lift, None, Some(Trajectory::new(&pick.lift, &slow)?)),
            phase(Phase::Transfer, None, Some(transfer)),
            phase(Phase::Lower, None, Some(Trajectory::new(&place.lower, &slow)?)),
            phase(Phase::Release, Some(open), None),
            phase(Phase::Retreat, None, Some(Trajectory::new(&place.retreat, &slow)?)),
        ])
    }
}

/// How often a path that was rounded into an obstacle is rounded less.
const ROUNDINGS: usize = 4;
/// Time between the checks of a timed path, seconds.
const CHECK_PERIOD_S: f64 = 0.01;

/// The fastest timing of a path that stays free when its corners are rounded.
fn timed(corners: &[Joints], settings: &TimingSettings, is_free: &impl Fn(&Joints) -> bool) -> Option<Trajectory> {
    let mut settings = *settings;
    for _ in 0..ROUNDINGS {
        let trajectory = Trajectory::new(corners, &settings)?;
        if trajectory.sampled(CHECK_PERIOD_S).all(|(_, point)| is_free(&point.position_rad)) {
            return Some(trajectory);
        }
        settings.deviation_rad *= 0.2;
    }
    None
}

/// The height of what the object stands on: the highest surface under it, or else its lowest point.
fn support_under(scene: &PlanningScene, object: &[Point3<f32>], query: u16) -> f64 {
    let lowest = object.iter().map(|p| f64::from(p.z)).fold(f64::INFINITY, f64::min);
    let middle = repose_geometry::cloud::centroid(object).unwrap_or_else(Point3::origin);
    // Borders of objects are cleaned away, so that its lowest seen point may be a little above what it stands on, and noise below it.
    scene.support_below(middle.x, middle.y, lowest + 0.02, query).unwrap_or(lowest)
}
