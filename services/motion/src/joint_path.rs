//! Paths through joint space as lists of corners, and whether a straight edge between two of them is free.

use repose_panda::{JOINT_COUNT, Joints};

/// The longest lever that each joint moves, metres: no point of arm or hand is further from that joint's axis.
///
/// Link lengths of the Panda with its hand, fingers straight out.
const LEVERS_M: Joints = [1.1, 1.1, 0.75, 0.75, 0.31, 0.25, 0.12];

/// Euclidean distance in joint space, radians.
pub fn distance(a: &Joints, b: &Joints) -> f64 {
    (0..JOINT_COUNT).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// The configuration at `fraction` of the way from `a` to `b`.
pub fn between(a: &Joints, b: &Joints, fraction: f64) -> Joints {
    std::array::from_fn(|i| a[i] + fraction * (b[i] - a[i]))
}

/// Length of a path, radians.
pub fn length(path: &[Joints]) -> f64 {
    path.windows(2).map(|w| distance(&w[0], &w[1])).sum()
}

/// How far any point of the robot can move at most along the edge, metres.
pub fn sweep_bound_m(a: &Joints, b: &Joints) -> f64 {
    (0..JOINT_COUNT).map(|i| LEVERS_M[i] * (a[i] - b[i]).abs()).sum()
}

/// Whether the edge from `a` (not asked again) to `b` is free, asked at places between which no point of the robot moves `resolution_m`.
///
/// The end is asked first, then ever finer subdivisions: a blocked edge is most often found out in few questions.
pub fn edge_is_free(a: &Joints, b: &Joints, resolution_m: f64, is_free: &impl Fn(&Joints) -> bool) -> bool {
    if !is_free(b) {
        return false;
    }
    let steps = (sweep_bound_m(a, b) / resolution_m).ceil().max(1.0) as usize;
    let mut stride = steps.next_power_of_two();
    while stride > 1 {
        let half = stride / 2;
        if !(half..steps).step_by(stride).all(|k| is_free(&between(a, b, k as f64 / steps as f64))) {
            return false;
        }
        stride = half;
    }
    true
}

/// Whether a whole path is free, its first corner included.
pub fn path_is_free(path: &[Joints], resolution_m: f64, is_free: &impl Fn(&Joints) -> bool) -> bool {
    path.first().is_some_and(is_free) && path.windows(2).all(|w| edge_is_free(&w[0], &w[1], resolution_m, is_free))
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_panda::READY;
    use std::cell::RefCell;

    #[test]
    fn an_edge_is_asked_at_every_step_once() {
        let mut end = READY;
        end[0] += 0.5;
        let asked = RefCell::new(Vec::new());
        assert!(edge_is_free(&READY, &end, 0.05, &|q| {
            asked.borrow_mut().push(q[0]);
            true
        }));
        let mut asked = asked.into_inner();
        asked.sort_by(f64::total_cmp);
        assert_eq!(asked.len(), 11, "0.5 rad on a lever of 1.1 m");
        assert!(asked.windows(2).all(|w| (w[1] - w[0] - 0.5 / 11.0).abs() < 1e-12));
    }
}
