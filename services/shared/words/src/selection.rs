//! Which objects fit: nouns, colors and shapes by grade, then comparisons among those that are left.

use crate::description::{Description, Head, Measure, Pick, ShapeWord, Telling};
use crate::grade::Grade;
use crate::look::ObjectAppearance;

/// How much farther left, nearer or farther away the meant object must be than the next, metres.
const CLEARLY_M: f64 = 0.02;
/// By which factor it must be larger (volume), and higher or longer.
const CLEARLY_LARGER: f64 = 1.35;
const CLEARLY_HIGHER: f64 = 1.15;
/// … or by this much, metres, which eyes tell however long both are.
const CLEARLY_HIGHER_M: f64 = 0.015;

/// The objects that fit the noun, colors and shape: those that surely do, or else those that may.
pub fn fitting<'a>(description: &Description, head: Option<Head>, looks: &[&'a ObjectAppearance]) -> Vec<&'a ObjectAppearance> {
    let graded: Vec<(Grade, &ObjectAppearance)> = looks.iter().map(|look| (grade(description, head, look), *look)).collect();
    let Some(number) = description.number else { return best(graded) };
    // The number says which, and an object may not look like what it is called. But where another surely looks so, one of the two is a slip.
    let is_slip = graded.iter().any(|(grade, look)| look.id == number && *grade == Grade::No)
        && graded.iter().any(|(grade, look)| look.id != number && *grade == Grade::Yes);
    graded.into_iter().filter(|(_, look)| look.id == number && !is_slip).map(|(_, look)| look).collect()
}

/// Whether an object may be called by a noun.
pub fn may_be_called(head: Option<Head>, look: &ObjectAppearance) -> bool {
    grade(&Description::default(), head, look) > Grade::No
}

/// Those of the best grade that occurs, if that is not [`Grade::No`].
pub fn best(graded: Vec<(Grade, &ObjectAppearance)>) -> Vec<&ObjectAppearance> {
    let best = graded.iter().map(|(grade, _)| *grade).max().unwrap_or(Grade::No);
    graded.into_iter().filter(|(grade, _)| best > Grade::No && *grade == best).map(|(_, look)| look).collect()
}

fn grade(description: &Description, head: Option<Head>, look: &ObjectAppearance) -> Grade {
    let noun = match (head, &look.shape) {
        (Some(Head::Kind(kind)), Some(shape)) => kind.fits(shape),
        (Some(Head::Kind(_)), None) => Grade::Maybe,
        _ => Grade::Yes,
    };
    let colors = description.colors.iter().map(|color| look.colors.as_ref().map_or(Grade::No, |c| c.is(*color)));
    let shapes = description.shapes.iter().map(|word| match (word, &look.shape) {
        (ShapeWord::Round, Some(shape)) => shape.round(),
        (ShapeWord::Boxy, Some(shape)) => shape.boxy(),
        // Compared afterwards.
        (ShapeWord::Tall | ShapeWord::Flat, _) => Grade::Yes,
        (_, None) => Grade::Maybe,
    });
    colors.chain(shapes).fold(noun, Grade::and)
}

/// The tall ones by shape, or else the one that is clearly higher than the others; flat likewise.
pub fn by_build<'a>(word: ShapeWord, among: &[&'a ObjectAppearance]) -> Vec<&'a ObjectAppearance> {
    let (by_shape, least): (fn(&crate::ShapeMeasures) -> Grade, bool) = match word {
        ShapeWord::Tall => (crate::ShapeMeasures::tall, false),
        ShapeWord::Flat => (crate::ShapeMeasures::flat, true),
        ShapeWord::Round | ShapeWord::Boxy => return among.to_vec(),
    };
    let sure: Vec<&ObjectAppearance> = among.iter().copied().filter(|l| l.shape.as_ref().map(by_shape) == Some(Grade::Yes)).collect();
    if sure.is_empty() { picked(Pick { measure: Measure::Height, least, rank: Some(1), telling: Telling::Always }, among) } else { sure }
}

/// The object that comparisons pick, one after another. The first may leave one object, which compared with nothing but itself is the foremost in
/// all else: it must be on the side of the others that each names. Where it is not, "the front left mug" may be the frontmost or the leftmost one.
pub fn picked_by_all<'a>(picks: &[Pick], among: &[&'a ObjectAppearance]) -> Vec<&'a ObjectAppearance> {
    let mut found = among.to_vec();
    for pick in picks {
        let next = match found[..] {
            [alone] if among.len() > 1 => {
                let others = picked(*pick, among);
                let is_picked = others.iter().any(|look| look.id == alone.id) || is_on_side(*pick, alone, among);
                if !is_picked && !others.is_empty() {
                    return std::iter::once(alone).chain(others).collect();
                }
                if others.is_empty() { others } else { vec![alone] }
            }
            _ => picked(*pick, &found),
        };
        found = next;
    }
    found
}

/// Whether an object is on the side of the middle of some that a comparison names.
fn is_on_side(pick: Pick, look: &ObjectAppearance, among: &[&ObjectAppearance]) -> bool {
    let values = among.iter().map(|other| measured(pick.measure, other));
    let [low, high] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
    let beyond = measured(pick.measure, look) - (low + high) / 2.0;
    pick.rank == Some(1) && if pick.least { beyond <= 0.0 } else { beyond >= 0.0 }
}

/// The object that a comparison picks; those that are too much alike to be told apart where it is not clear; none past the last.
fn picked<'a>(pick: Pick, among: &[&'a ObjectAppearance]) -> Vec<&'a ObjectAppearance> {
    let found = by_measure(pick, among);
    if pick.measure != Measure::Top {
        return found;
    }
    // "The lower box" is the one that is less high, or the one below. Where those differ, either may be meant.
    let mut by_height = by_measure(Pick { measure: Measure::Height, ..pick }, among);
    let is_in = |look: &ObjectAppearance, looks: &[&ObjectAppearance]| looks.iter().any(|other| other.id == look.id);
    if !by_height.iter().all(|look| is_in(look, &found)) {
        let others: Vec<&ObjectAppearance> = found.into_iter().filter(|look| !is_in(look, &by_height)).collect();
        by_height.extend(others);
    }
    by_height
}

fn by_measure<'a>(pick: Pick, among: &[&'a ObjectAppearance]) -> Vec<&'a ObjectAppearance> {
    let rank = match pick.rank {
        Some(rank) => rank,
        // The one in the middle has as many on either side.
        None if among.len() % 2 == 1 => among.len() / 2 + 1,
        None => return among.to_vec(),
    };
    let values = among.iter().map(|look| (measured(pick.measure, look), *look)).collect();
    ranked(values, pick.least, rank, |a, b| clearly(pick.measure, a, b))
}

/// The object that is nearest to another, or farthest from it.
pub fn by_distance<'a>(nearest: bool, to: &ObjectAppearance, among: &[&'a ObjectAppearance]) -> Vec<&'a ObjectAppearance> {
    let distance = |look: &ObjectAppearance| {
        let [a, b] = [look, to].map(|l| nalgebra::Vector3::from(l.center_in_viewer_m));
        (a - b).xy().norm()
    };
    let values = among.iter().filter(|look| look.id != to.id).map(|look| (distance(look), *look)).collect();
    ranked(values, nearest, 1, |a, b| (a - b).abs() >= CLEARLY_M)
}

fn ranked(mut values: Vec<(f64, &ObjectAppearance)>, least: bool, rank: usize, apart: impl Fn(f64, f64) -> bool) -> Vec<&ObjectAppearance> {
    values.sort_by(|a, b| a.0.total_cmp(&b.0));
    if !least {
        values.reverse();
    }
    let Some((chosen, _)) = values.get(rank - 1).copied() else { return Vec::new() };
    let alike = |i: usize, value: f64| i + 1 == rank || !apart(value, chosen);
    values.iter().enumerate().filter(|(i, (value, _))| alike(*i, *value)).map(|(_, (_, look))| *look).collect()
}

fn measured(measure: Measure, look: &ObjectAppearance) -> f64 {
    let of_shape = |value: fn(&crate::ShapeMeasures) -> f64| look.shape.as_ref().map_or(0.0, value);
    match measure {
        Measure::Size => of_shape(crate::ShapeMeasures::volume_m3),
        Measure::Height => of_shape(|s| s.height_m),
        Measure::Top => look.center_in_viewer_m[2] + of_shape(|s| s.height_m) / 2.0,
        Measure::Length => of_shape(|s| s.plan_m[0]),
        Measure::Right => look.center_in_viewer_m[0],
        Measure::Away => look.center_in_viewer_m[1],
    }
}

fn clearly(measure: Measure, a: f64, b: f64) -> bool {
    let by_factor = |factor: f64| a.max(b) >= factor * a.min(b);
    match measure {
        Measure::Size => by_factor(CLEARLY_LARGER),
        Measure::Height | Measure::Length => by_factor(CLEARLY_HIGHER) || (a - b).abs() >= CLEARLY_HIGHER_M,
        Measure::Top => (a - b).abs() >= CLEARLY_HIGHER_M,
        Measure::Right | Measure::Away => (a - b).abs() >= CLEARLY_M,
    }
}
