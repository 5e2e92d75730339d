//! How far a place on the arm can be from each joint's axis: what turns a change of angles into a bound on motion.
//!
//! When joint `i` turns by `Δᵢ`, a place moves by at most its lever times `|Δᵢ|`, whatever the other joints do meanwhile; so along an edge in
//! joint space it moves by at most `Σ leverᵢ·|Δᵢ|`. The levers are suprema over all configurations, by the triangle inequality along the chain.

use nalgebra::Vector3;

use crate::kinematics::{ELBOW_OFFSET_M, FOREARM_M, UPPER_ARM_M, WRIST_OFFSET_M};
use crate::{JOINT_COUNT, Joints};

/// The largest distance of a place on link `link` (1 to 7, the place in that link's frame; 0 is the foot) from each joint's axis, metres.
///
/// Zero for joints beyond the link. Hand, fingers and what they hold are places of link 7.
pub fn levers(link: usize, place_in_link: &Vector3<f64>) -> Joints {
    let upper = UPPER_ARM_M.hypot(ELBOW_OFFSET_M);
    let fore = FOREARM_M.hypot(ELBOW_OFFSET_M);
    // From the link's own axis, and from its origin.
    let (axis, origin) = (place_in_link.xy().norm(), place_in_link.norm());
    let mut levers = [0.0; JOINT_COUNT];
    // The axes of joints 1 to 3 meet in the shoulder, those of 5 and 6 in the wrist.
    match link {
        0 => {}
        1 => levers[0] = axis,
        2 => levers[..2].copy_from_slice(&[origin, axis]),
        3 => {
            let shoulder = (place_in_link + Vector3::z() * UPPER_ARM_M).norm();
            levers[..3].copy_from_slice(&[shoulder, shoulder, axis]);
        }
        4 => levers[..4].copy_from_slice(&[upper + origin, upper + origin, ELBOW_OFFSET_M + origin, axis]),
        _ => {
            let wrist = if link < 7 { origin } else { (WRIST_OFFSET_M + axis).hypot(place_in_link.z) };
            let elbow = fore + wrist;
            levers[..4].copy_from_slice(&[upper + elbow, upper + elbow, ELBOW_OFFSET_M + elbow, elbow]);
            let distal = [wrist, wrist, axis];
            levers[4..link].copy_from_slice(&distal[..link - 4]);
            levers[link - 1] = axis;
        }
    }
    levers
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LIMITS, LinkFrames};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn no_place_is_further_from_an_axis_than_its_lever(
            u in prop::array::uniform7(0.0..1.0f64), place in prop::array::uniform3(-0.2..0.2f64), link in 1usize..=7,
        ) {
            let frames = LinkFrames::at(&LIMITS.between(&u));
            let place = Vector3::from(place);
            let at = frames.links[link - 1].carry(&place).coords;
            let levers = levers(link, &place);
            for (i, frame) in frames.links.iter().enumerate() {
                let from_axis = (at - frame.origin).cross(&frame.rotation.column(2)).norm();
                prop_assert!(i >= link && levers[i] == 0.0 || i < link && from_axis <= levers[i] + 1e-12, "joint {i}: {from_axis} of {levers:?}");
            }
        }
    }
}
