//! From ranked placements to a timed pick and place.
//!
//! Placements are taken in rank order. For each, grasps are tried best first until one is reachable and free at both ends and free ways join
//! them (start to standoff, lift to above the placement); so an unreachable best placement falls back to the next, and the result says why.
//! What is known of a grasp at the object is kept for all placements. Standoff and release heights: paper, section 3. Afterwards the arm goes
//! back to where it started, where there is a free way: from there the camera saw what it is to see again.

pub mod plan;
pub mod reach;
pub mod request;
pub mod settings;

use nalgebra::{Isometry3, Point3};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_geometry::cloud::centroid;
use repose_panda::{Joints, LinkFrame};

pub use self::request::PickPlaceRequest;
pub use self::settings::PickPlaceSettings;

use crate::believed::{HEEDED_IN_TURN, Heeded, Worlds};
use crate::collision::{ArmCollisionSettings, CollisionChecker, HeldCloud, PALM_OUT_M};
use crate::grasp::{GraspCandidate, GraspScene, GraspTally, grasps};
use crate::obstacles::Obstacles;
use crate::path::joint_path::distance;
use crate::path::rrt_connect::rrt_connect;
use crate::path::simplify::simplified;
use crate::path::timed::timed;
use crate::path::timing::{TimingSettings, Trajectory};
use crate::pick_place::plan::{EndTally, GripperMove, Phase, PickPlaceError, PickPlacePlan, PlannedPhase, SkippedPlacement};
use crate::pick_place::reach::{EndFailure, EndSearch, PickEnd, PlaceEnd, openings_between};

/// Height of the shoulder over the base, metres.
const SHOULDER_M: f64 = 0.333;

/// Plans a pick and place for the best placement that the arm can serve.
///
/// Hidden parts of things are believed to be there ([`Heeded`]); where that leaves no way, less of them is heeded, until only
/// what was seen counts.
///
/// # Errors
/// [`PickPlaceError`] when the object is unknown, the arm cannot start, nothing can be grasped, or no placement can be served.
pub fn pick_place(request: &PickPlaceRequest<'_>, settings: &PickPlaceSettings) -> Result<PickPlacePlan, PickPlaceError> {
    pick_place_until(request, settings, &|| false)
}

/// The same, given up once `should_stop` holds, which it then does for good. It is asked at every grasp and now and then in a search, and changes
/// nothing but when the planning ends.
///
/// # Errors
/// As [`pick_place`], and [`PickPlaceError::Stopped`].
pub fn pick_place_until(
    request: &PickPlaceRequest<'_>,
    settings: &PickPlaceSettings,
    should_stop: &dyn Fn() -> bool,
) -> Result<PickPlacePlan, PickPlaceError> {
    if !request.scene.labels.contains(&request.query) {
        return Err(PickPlaceError::NoObject(request.query));
    }
    if request.grasps.is_some_and(<[GraspCandidate]>::is_empty) {
        return Err(PickPlaceError::NoGrasp(GraspTally::default()));
    }
    let shoulder = (settings.world_from_base * Point3::new(0.0, 0.0, SHOULDER_M)).cast::<f32>();
    let worlds = Worlds::new(request, settings, shoulder);
    let mut found = planned(&worlds, Heeded::Everything, should_stop);
    for heeded in HEEDED_IN_TURN.into_iter().skip(1) {
        if found.is_ok() || should_stop() {
            break;
        }
        found = planned(&worlds, heeded, should_stop);
    }
    if found.is_err() && should_stop() { Err(PickPlaceError::Stopped) } else { found }
}

/// The plan in one of the worlds.
fn planned(worlds: &Worlds<'_>, heeded: Heeded, should_stop: &dyn Fn() -> bool) -> Result<PickPlacePlan, PickPlaceError> {
    let &Worlds { request, settings, .. } = worlds;
    let world = worlds.world(heeded);
    let (others, everything) = ([world.others], [world.others, &world.query]);
    let mut rng = Pcg64::seed_from_u64(request.seed);
    let search = Search { request, settings, object: &world.held, others: &others, everything: &everything, should_stop };
    if let Some(contact) = search.checker(search.everything, 0.0, None).contact(request.start) {
        return Err(PickPlaceError::StartBlocked(contact));
    }
    let found = match request.grasps {
        Some(given) => given.to_vec(),
        None => {
            let (points, view) = (request.scene.points_of(request.query), &request.scene.belief.view);
            let (support_m, axis, believes) = (world.support_m, world.axis, heeded != Heeded::Held);
            let scene = GraspScene { points, support_m, axis, view, others: world.others, believes };
            let (found, tally) = grasps(&scene, &settings.grasp, &mut rng);
            if found.is_empty() {
                return Err(PickPlaceError::NoGrasp(tally));
            }
            found
        }
    };
    // Grasps from elsewhere were chosen by who asks: all of them are tried.
    let count = if request.grasps.is_some() { 2 * found.len() } else { settings.grasps_per_placement };
    // A hand that is turned by half a turn grasps the same: the wrist may reach one and not the other.
    let both = found.iter().flat_map(|g| [*g, g.flipped()]);
    let mut tried: Vec<TriedGrasp<'_>> = both.take(count).map(|grasp| search.tried(grasp)).collect();

    let mut not_chosen = Vec::new();
    for (placement, placed_from_observed) in request.placements.iter().enumerate() {
        if should_stop() {
            return Err(PickPlaceError::Stopped);
        }
        match search.placement(placed_from_observed, &mut tried, &mut rng) {
            Ok((grasp, phases)) => return Ok(PickPlacePlan { placement, not_chosen, heeded, grasp, phases }),
            Err(tally) => not_chosen.push(SkippedPlacement { placement, failure: tally.failure(), tally }),
        }
    }
    Err(PickPlaceError::NoPlacement(not_chosen))
}

/// A grasp and what is known of it at the object.
struct TriedGrasp<'a> {
    grasp: GraspCandidate,
    search: &'a Search<'a>,
    /// The arm with this grasp, made when first needed.
    reach: Option<EndSearch<'a>>,
    pick: Option<Result<PickEnd, EndFailure>>,
    to_standoff: Option<Option<Trajectory>>,
}

impl<'a> TriedGrasp<'a> {
    fn reach(&mut self) -> &EndSearch<'a> {
        let (search, grasp) = (self.search, &self.grasp);
        self.reach.get_or_insert_with(|| {
            let held = HeldCloud::new(search.object, &grasp.world_from_tcp, search.settings.held_radius_m);
            let closed_m = grasp.width_m.unwrap_or(grasp.opening_m);
            EndSearch {
                base_from_world: search.settings.world_from_base.inverse(),
                open: search.checker(search.others, grasp.opening_m, None),
                holding: search.checker(search.others, closed_m, Some(&held)),
                closed: search.checker(search.others, closed_m, None),
                moving: openings_between(closed_m, grasp.opening_m).map(|m| search.checker(search.others, m, None)).collect(),
                settings: &search.settings.reach,
            }
        })
    }

    /// The object's end of the move, worked out once.
    fn pick_end(&mut self) -> Result<PickEnd, EndFailure> {
        if self.pick.is_none() {
            let (near, grasp) = (self.search.near(&self.grasp.world_from_tcp), self.grasp);
            self.pick = Some(self.reach().pick(&grasp, &near));
        }
        self.pick.clone().unwrap_or(Err(EndFailure::Unreachable))
    }

    /// The way from the start to the standoff, worked out once.
    fn standoff(&mut self, pick: &PickEnd, rng: &mut Pcg64) -> Option<Trajectory> {
        if self.to_standoff.is_none() {
            let search = self.search;
            // The object itself is in the way here.
            let checkers = search.checkers(search.everything, self.grasp.opening_m, None);
            self.to_standoff = Some(search.way(search.request.start, &pick.approach[0], self.reach(), &checkers, rng));
        }
        self.to_standoff.clone().flatten()
    }
}

/// Both ends of a move with one grasp.
struct Ends {
    pick: PickEnd,
    place: PlaceEnd,
}

impl Ends {
    /// Where the lift ends.
    fn lifted(&self) -> &Joints {
        &self.pick.lift[self.pick.lift.len() - 1]
    }
}

struct Search<'a> {
    request: &'a PickPlaceRequest<'a>,
    settings: &'a PickPlaceSettings,
    /// The object's points, thinned.
    object: &'a [Point3<f32>],
    others: &'a [&'a Obstacles],
    everything: &'a [&'a Obstacles],
    should_stop: &'a dyn Fn() -> bool,
}

impl<'a> Search<'a> {
    fn arm(&self, finger_opening_m: f64) -> ArmCollisionSettings {
        let world_from_base = LinkFrame::of(&self.settings.world_from_base);
        let (padding_m, palm_out_m) = (self.settings.padding_m, PALM_OUT_M);
        ArmCollisionSettings { world_from_base, padding_m, palm_out_m, finger_opening_m, limits: self.settings.reach.inverse.limits }
    }

    fn checker(&self, obstacles: &'a [&'a Obstacles], finger_opening_m: f64, held: Option<&HeldCloud>) -> CollisionChecker<'a> {
        CollisionChecker::new(self.arm(finger_opening_m), obstacles, held)
    }

    fn tried(&'a self, grasp: GraspCandidate) -> TriedGrasp<'a> {
        TriedGrasp { grasp, search: self, reach: None, pick: None, to_standoff: None }
    }

    /// What is held beside its middle turns about the closing direction by its weight, or swings as the arm moves, unless the pads press more.
    fn grip_force_n(&self, grasp: &GraspCandidate) -> f64 {
        let PickPlaceSettings { grip_force_n, grip_force_max_n, .. } = *self.settings;
        let lever_m = centroid(self.object).map_or(0.0, |middle| (grasp.world_from_tcp.translation.vector - middle.coords).xy().norm());
        grip_force_n + (grip_force_max_n - grip_force_n) * (lever_m / FULL_LEVER_M).min(1.0)
    }

    /// The posture that is preferred: the ready pose, turned towards the target.
    fn near(&self, world_from_tcp: &Isometry3<f64>) -> Joints {
        let near = ready_towards(&world_from_tcp.translation.vector.into(), &self.settings.world_from_base);
        let inverse = &self.settings.reach.inverse;
        inverse.limits.clamped(&near, inverse.limit_margin_rad)
    }

    /// The grasp that serves a placement, with the whole plan; or how many failed where.
    ///
    /// Of the grasps that work at both ends, the ones up to the first that needs no long way between them are weighed: a long carry (the wrist
    /// turned about, the arm folded over) takes longer and loses more objects than a slightly worse grasp, but fewer than a bad one. Grasps from
    /// elsewhere are not weighed: they are taken in their order.
    fn placement(
        &self,
        placed_from_observed: &Isometry3<f64>,
        tried: &mut [TriedGrasp<'_>],
        rng: &mut Pcg64,
    ) -> Result<(GraspCandidate, Vec<PlannedPhase>), EndTally> {
        let mut tally = EndTally::default();
        let mut usable: Vec<(f64, usize, Ends)> = Vec::new();
        let mut next = 0;
        let compared = if self.request.grasps.is_some() { 1 } else { self.settings.compared };
        while next < tried.len() && tally.no_path < self.settings.path_failures && !(self.should_stop)() {
            while next < tried.len() && usable.len() < compared && !(self.should_stop)() {
                let index = next;
                next += 1;
                let Some(ends) = self.ends(placed_from_observed, &mut tried[index], &mut tally) else { continue };
                let beyond_rad = (distance(ends.lifted(), &ends.place.lower[0]) - self.settings.carry_rad).max(0.0);
                usable.push((self.settings.carry_cost_per_rad * beyond_rad - tried[index].grasp.score, index, ends));
                if beyond_rad == 0.0 {
                    break;
                }
            }
            usable.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (_, index, ends) in usable.drain(..).take(self.settings.path_failures - tally.no_path) {
                if let Some(mut phases) = self.joined(&mut tried[index], &ends, rng) {
                    let grasp = tried[index].grasp;
                    phases.extend(self.home(&mut tried[index], &ends.place, placed_from_observed, rng));
                    return Ok((grasp, phases));
                }
                tally.no_path += 1;
            }
        }
        Err(tally)
    }

    /// Both ends of the move with a grasp, or a count of what stood in the way.
    fn ends(&self, placed_from_observed: &Isometry3<f64>, grasp: &mut TriedGrasp<'_>, tally: &mut EndTally) -> Option<Ends> {
        let pick = match grasp.pick_end() {
            Ok(pick) => pick,
            Err(EndFailure::Unreachable) => {
                tally.pick_unreachable += 1;
                return None;
            }
            Err(EndFailure::Blocked(contact)) => {
                tally.pick_blocked += 1;
                tally.contact = Some(contact);
                return None;
            }
        };
        let lifted = pick.lift[pick.lift.len() - 1];
        let chosen = grasp.grasp;
        match grasp.reach().place(&chosen, placed_from_observed, &lifted) {
            Ok(place) => Some(Ends { pick, place }),
            Err(EndFailure::Unreachable) => {
                tally.place_unreachable += 1;
                None
            }
            Err(EndFailure::Blocked(contact)) => {
                tally.place_blocked += 1;
                tally.contact = Some(contact);
                None
            }
        }
    }

    /// The whole plan with a grasp, if free ways join its ends.
    fn joined(&self, grasp: &mut TriedGrasp<'_>, ends: &Ends, rng: &mut Pcg64) -> Option<Vec<PlannedPhase>> {
        let to_standoff = grasp.standoff(&ends.pick, rng)?;
        let transfer = self.transfer(grasp, ends, rng)?;
        self.phases(grasp, ends, to_standoff, transfer)
    }

    /// The way from the lift to above the placement.
    fn transfer(&self, grasp: &mut TriedGrasp<'_>, ends: &Ends, rng: &mut Pcg64) -> Option<Trajectory> {
        let closed_m = grasp.grasp.width_m.unwrap_or(grasp.grasp.opening_m);
        let checkers = self.checkers(self.others, closed_m, Some(&grasp.grasp.world_from_tcp));
        self.way(ends.lifted(), &ends.place.lower[0], grasp.reach(), &checkers, rng)
    }

    /// Back to the start, past the object where it was put; none where there is no way, and the arm stays above it.
    fn home(
        &self,
        grasp: &mut TriedGrasp<'_>,
        place: &PlaceEnd,
        placed_from_observed: &Isometry3<f64>,
        rng: &mut Pcg64,
    ) -> Option<PlannedPhase> {
        let placed: Vec<Point3<f32>> = self.object.iter().map(|p| (placed_from_observed * p.cast::<f64>()).cast()).collect();
        let placed = Obstacles::new(&placed, &[], &self.settings.obstacles);
        let obstacles: Vec<&Obstacles> = self.others.iter().copied().chain([&placed]).collect();
        let checkers = self.checkers(&obstacles, grasp.grasp.opening_m, None);
        let trajectory = self.way(place.retreat.last()?, self.request.start, grasp.reach(), &checkers, rng)?;
        Some(PlannedPhase { phase: Phase::Home, gripper: None, trajectory: Some(trajectory) })
    }

    /// Checkers with less and less room around the arm and what it holds, the last with none; the object is held at a pose of the grasp centre.
    fn checkers<'b>(
        &self,
        obstacles: &'b [&'b Obstacles],
        finger_opening_m: f64,
        world_from_tcp: Option<&Isometry3<f64>>,
    ) -> [CollisionChecker<'b>; ROOM_SHARES.len()] {
        ROOM_SHARES.map(|share| {
            let radius_m = self.settings.held_radius_m + share * self.settings.held_room_m;
            let held = world_from_tcp.map(|tcp| HeldCloud::new(self.object, tcp, radius_m));
            let arm = self.arm(finger_opening_m);
            let padding_m = arm.padding_m + share * self.settings.arm_room_m;
            CollisionChecker::new(ArmCollisionSettings { padding_m, ..arm }, obstacles, held.as_ref())
        })
    }

    /// A timed way between two configurations. There is room around the arm and what it holds where there can be some: what is held may shift
    /// in the hand and is larger than what was seen of it, and so are the things beside the way. Where an end has none, beside something tall, the
    /// way goes straight up from it first.
    fn way(
        &self,
        from: &Joints,
        to: &Joints,
        reach: &EndSearch<'_>,
        checkers: &[CollisionChecker<'_>; ROOM_SHARES.len()],
        rng: &mut Pcg64,
    ) -> Option<Trajectory> {
        let [roomy @ .., plain] = checkers;
        let timing = if plain.holds() { self.settings.timing.slowed(self.settings.holding_scale) } else { self.settings.timing };
        for roomy in roomy {
            let (Some(up), Some(down)) = (reach.clear_of(from, plain, roomy), reach.clear_of(to, plain, roomy)) else { continue };
            let Some(between) = self.corners(&up[up.len() - 1], &down[down.len() - 1], roomy, rng) else { continue };
            let mut corners = up;
            corners.extend(between.into_iter().skip(1));
            corners.extend(down.into_iter().rev().skip(1));
            if let Some(trajectory) = timed(&corners, &timing, plain) {
                return Some(trajectory);
            }
        }
        timed(&self.corners(from, to, plain, rng)?, &timing, plain)
    }

    /// The corners of a free path between two configurations, shortened.
    fn corners(&self, from: &Joints, to: &Joints, checker: &CollisionChecker<'_>, rng: &mut Pcg64) -> Option<Vec<Joints>> {
        let corners = rrt_connect(from, &[*to], checker, &self.settings.rrt, rng, self.should_stop).ok()?;
        Some(simplified(&corners, &self.settings.simplify, checker))
    }

    fn phases(
        &self,
        grasp: &mut TriedGrasp<'_>,
        Ends { pick, place }: &Ends,
        to_standoff: Trajectory,
        transfer: Trajectory,
    ) -> Option<Vec<PlannedPhase>> {
        // The corners are a centimetre apart and nearly in line: little rounding is enough.
        let slowed = |share| TimingSettings { deviation_rad: 0.002, ..self.settings.timing.slowed(share) };
        let slow = slowed(self.settings.contact_scale);
        // Near things with something in the hand, the slower of both.
        let carrying = slowed(self.settings.contact_scale.min(self.settings.holding_scale));
        let open = GripperMove { width_m: grasp.grasp.opening_m, force_n: self.settings.grip_force_n };
        let close = GripperMove { width_m: 0.0, force_n: self.grip_force_n(&grasp.grasp) };
        let phase = |phase, gripper, trajectory| PlannedPhase { phase, gripper, trajectory };
        let reach = grasp.reach();
        Some(vec![
            phase(Phase::Standoff, Some(open), Some(to_standoff)),
            phase(Phase::Approach, None, Some(timed(&pick.approach, &slow, &reach.open)?)),
            phase(Phase::Grasp, Some(close), None),
            // What is held may touch what it stood on at first; its corners further up are checked.
            phase(Phase::Lift, None, Some(timed(&pick.lift, &carrying, &reach.closed)?)),
            phase(Phase::Transfer, None, Some(transfer)),
            phase(Phase::Lower, None, Some(timed(&place.lower, &carrying, &reach.holding)?)),
            phase(Phase::Release, Some(open), None),
            phase(Phase::Retreat, None, Some(timed(&place.retreat, &slow, &reach.open)?)),
        ])
    }
}

/// How far beside its middle something is held with the most force, metres.
const FULL_LEVER_M: f64 = 0.05;
/// Shares of the room around the arm and what it holds that are tried in turn.
const ROOM_SHARES: [f64; 3] = [1.0, 0.5, 0.0];

/// The ready pose turned towards a place in the world.
fn ready_towards(place: &Point3<f64>, world_from_base: &Isometry3<f64>) -> Joints {
    let in_base = world_from_base.inverse_transform_point(place);
    let mut ready = repose_panda::READY;
    ready[0] = in_base.y.atan2(in_base.x);
    ready
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ready_pose_turns_towards_a_place_from_wherever_the_base_stands() {
        let place = Point3::new(0.1, 0.0, 0.3);
        let turned_rad = |x_m, y_m, yaw_rad: f64| {
            ready_towards(&place, &Isometry3::new(nalgebra::Vector3::new(x_m, y_m, 0.2), nalgebra::Vector3::z() * yaw_rad))[0]
        };
        assert_eq!(turned_rad(0.0, 0.0, 0.0), 0.0);
        assert!((turned_rad(-0.5, 0.3, 0.0) - (-0.3_f64).atan2(0.6)).abs() < 1e-12);
        // From behind it, looking the other way.
        assert!((turned_rad(0.6, 0.0, std::f64::consts::PI)).abs() < 1e-12);
    }
}
