//! What the camera sees but the projector, or the second imager, does not: there is nothing to match, so there is no reading.
//!
//! A pixel at column u and depth z is seen by the other at column u − f·B/z. Along a row, what is further right must be seen further right
//! there too; a pixel that breaks this order is behind something as seen from there. The strip beside a thing of depth z_near before z_far is
//! f·B·(1/z_near − 1/z_far) wide. Block matchers hold to this order as well, so that a strip seen past a thin thing is lost, as it is here.

/// Marks the pixels of a row that the other point of view does not see.
///
/// `inverse_depth` is 1/m, 0 = nothing; `shift_px_m` is focal length (pixels of this picture) times the other's place to the right (metres;
/// negative: to the left). With `blind_band`, pixels beyond the edge of the other's picture are marked too. `hidden` has the row's length.
pub fn mark_row(inverse_depth: &[f32], shift_px_m: f32, blind_band: bool, hidden: &mut [bool]) {
    let last = inverse_depth.len().saturating_sub(1);
    let mut seen_to = f32::INFINITY;
    // Turned about, a row seen from the left is one seen from the right.
    let is_right = shift_px_m >= 0.0;
    for step in 0..inverse_depth.len() {
        let column = last - step;
        let at = if is_right { column } else { step };
        let inverse = inverse_depth[at];
        let there = column as f32 - shift_px_m.abs() * inverse;
        hidden[at] = inverse > 0.0 && (there >= seen_to || (blind_band && there < 0.0));
        if inverse > 0.0 {
            seen_to = seen_to.min(there);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn hidden(row: &[f32], shift: f32, band: bool) -> Vec<usize> {
        let mut marks = vec![false; row.len()];
        mark_row(row, shift, band, &mut marks);
        marks.iter().enumerate().filter(|(_, h)| **h).map(|(u, _)| u).collect()
    }

    /// A thing at `near` over columns 100 to 160 before a wall at `far`.
    fn row(near: f32, far: f32) -> Vec<f32> {
        (0..320).map(|u| if (100..160).contains(&u) { 1.0 / near } else { 1.0 / far }).collect()
    }

    proptest! {
        #[test]
        fn the_shadow_lies_beside_the_nearer_thing_and_is_as_wide_as_the_disparities_differ(
            near in 0.5f32..1.5, gap in 0.05f32..1.0, shift in 15.0f32..40.0
        ) {
            let far = near + gap;
            let width = shift * (1.0 / near - 1.0 / far);
            let left = hidden(&row(near, far), shift, false);
            prop_assert!((left.len() as f32 - width).abs() <= 1.0, "{} columns instead of {width}", left.len());
            prop_assert!(left.iter().rev().enumerate().all(|(k, u)| *u == 99 - k), "left of the thing, without gaps: {left:?}");
            let right = hidden(&row(near, far), -shift, false);
            prop_assert!(right.len() == left.len() && right.iter().enumerate().all(|(k, u)| *u == 160 + k), "{right:?}");
        }
    }

    #[test]
    fn a_plain_wall_has_no_shadow_but_a_band_at_the_edge_where_two_imagers_do_not_overlap() {
        let wall = vec![1.0 / 0.8; 320];
        assert!(hidden(&wall, 16.0, false).is_empty());
        assert_eq!(hidden(&wall, 16.0, true), (0..20).collect::<Vec<_>>());
        assert_eq!(hidden(&wall, -16.0, true), (300..320).collect::<Vec<_>>());
    }

    #[test]
    fn a_slope_that_faces_away_from_the_other_is_not_seen_by_it() {
        // Inverse depth that rises by more than a column of disparity per column.
        let slope: Vec<f32> = (0..50).map(|u| 0.5 + 0.06 * u as f32).collect();
        assert_eq!(hidden(&slope, 20.0, false).len(), 49);
        assert!(hidden(&slope, -20.0, false).is_empty());
    }
}
