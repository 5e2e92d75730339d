//! Drafts of tasks: which objects stand where before and after, by which moves one becomes the other, and about what the goals are.
//!
//! All places before and after, but for those that a kind is about, keep a margin to each other: what makes an order, a place aside or the
//! clearing of a top necessary is the kind alone.

use std::sync::Arc;

use nalgebra::{Isometry3, Vector2};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_simulator::objects::{Family, ObjectShape, ObjectSource};
use serde::{Deserialize, Serialize};

use crate::scenes::arrangement::layout::{Layout, on_top};

/// What makes a task hard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskKind {
    /// Nothing: goals are about what stands, in any order.
    Free,
    /// Each goal is about an object that must move itself.
    Ordered,
    /// Objects stand where others must go, in a circle: one must be set down aside.
    Swap,
    /// Objects that must move carry others.
    Unstack,
}

impl TaskKind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Free, Self::Ordered, Self::Swap, Self::Unstack];

    /// The name in snake case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Free => "free",
            Self::Ordered => "ordered",
            Self::Swap => "swap",
            Self::Unstack => "unstack",
        }
    }
}

/// What an object's goal is about.
#[derive(Debug, Clone, PartialEq)]
pub enum About {
    /// Its relation to one of these.
    OneOf(Vec<usize>),
    /// It is on top of this one.
    OnTopOf(usize),
    /// It is near this one, and on a side of it.
    Beside(usize),
}

/// A task before physics and a camera have looked at it. Objects are counted from 0.
#[derive(Debug, Clone)]
pub struct Draft {
    /// The objects.
    pub shapes: Vec<Arc<ObjectShape>>,
    /// Where each stands at first.
    pub start: Vec<Isometry3<f64>>,
    /// The moves to the arranged table: object, and where it then stands.
    pub moves: Vec<(usize, Isometry3<f64>)>,
    /// The objects with goals, and what those are about.
    pub goals: Vec<(usize, About)>,
}

/// Half the edges of the table, metres.
pub const TABLE_HALF_M: [f64; 2] = [0.5, 0.36];
/// Room between things, metres.
const MARGIN_M: f32 = 0.025;
/// Draws of an object until one has the form that is wanted.
const DRAWS: usize = 60;

/// A draft with that many goals; none where the draws find no room.
pub fn drafted(kind: TaskKind, goals: usize, rng: &mut Pcg64) -> Option<Draft> {
    let mut making = Making {
        draft: Draft { shapes: Vec::new(), start: Vec::new(), moves: Vec::new(), goals: Vec::new() },
        end: Vec::new(),
        layout: Layout::new(Vector2::from(TABLE_HALF_M), MARGIN_M),
        fixed: Vec::new(),
    };
    match kind {
        TaskKind::Free => making.free(goals, rng),
        TaskKind::Ordered => making.ordered(goals, rng),
        TaskKind::Swap => making.swap(goals, rng),
        TaskKind::Unstack => making.unstack(goals, rng),
    }?;
    Some(making.draft)
}

/// A draft that is being made.
struct Making {
    draft: Draft,
    /// Where each object stands in the end, as far as that is known.
    end: Vec<Isometry3<f64>>,
    layout: Layout,
    /// Objects that stay.
    fixed: Vec<usize>,
}

impl Making {
    fn free(&mut self, goals: usize, rng: &mut Pcg64) -> Option<()> {
        self.bystanders(3, rng)?;
        (0..goals).try_for_each(|_| self.mover(rng))
    }

    fn ordered(&mut self, goals: usize, rng: &mut Pcg64) -> Option<()> {
        const STACKED: f64 = 0.4;
        self.bystanders(2, rng)?;
        let (mut previous, mut carries_stacked) = (0, false);
        for _ in 0..goals {
            let under = (self.draft.shapes[previous].clone(), self.end[previous]);
            let stacks = !carries_stacked && rng.random_bool(STACKED);
            let stacked = if stacks {
                (0..DRAWS).find_map(|_| {
                    let shape = drawn(rng)?;
                    on_top(&shape, (&under.0, &under.1), false).map(|end| (shape, end, About::OnTopOf(previous)))
                })
            } else {
                None
            };
            carries_stacked = stacked.is_some();
            let (shape, end, about) = stacked.or_else(|| {
                let shape = drawn(rng)?;
                // What stands on another is no good neighbour: beside it is beside what carries it.
                let on_table = self.on_table_under(previous);
                let neighbour = (self.draft.shapes[on_table].clone(), self.end[on_table]);
                let end = self.layout.beside(&shape, (&neighbour.0, &neighbour.1), rng)?;
                Some((shape, end, About::Beside(on_table)))
            })?;
            let start = {
                self.layout.keep(&shape, &end);
                self.layout.anywhere(&shape, rng)?
            };
            previous = self.add(shape, start, end);
            self.draft.moves.push((previous, end));
            self.draft.goals.push((previous, about));
        }
        Some(())
    }

    fn swap(&mut self, goals: usize, rng: &mut Pcg64) -> Option<()> {
        let circle = if goals > 3 { rng.random_range(2..=3) } else { 2 };
        let carriers: Vec<usize> = (0..circle).map(|_| self.carrier(rng)).collect::<Option<_>>()?;
        self.bystanders(1, rng)?;
        let mut members = Vec::new();
        for k in 0..circle {
            let [from, to] = [carriers[k], carriers[(k + 1) % circle]].map(|c| (self.draft.shapes[c].clone(), self.end[c]));
            let (shape, start, end) = (0..4 * DRAWS).find_map(|_| {
                let shape = drawn(rng)?;
                let start = on_top(&shape, (&from.0, &from.1), true)?;
                let end = on_top(&shape, (&to.0, &to.1), true)?;
                Some((shape, start, end))
            })?;
            let member = self.add(shape, start, end);
            members.push(member);
            self.draft.goals.push((member, About::OnTopOf(carriers[(k + 1) % circle])));
        }
        let first = members[0];
        let aside = self.layout.anywhere(&self.draft.shapes[first], rng)?;
        self.layout.keep(&self.draft.shapes[first].clone(), &aside);
        self.draft.moves.push((first, aside));
        // Whoever goes where there is room now leaves room for the one before.
        let back = members.iter().skip(1).rev().chain([&first]);
        self.draft.moves.extend(back.map(|member| (*member, self.end[*member])));
        (circle..goals).try_for_each(|_| self.mover(rng))
    }

    fn unstack(&mut self, goals: usize, rng: &mut Pcg64) -> Option<()> {
        self.bystanders(2, rng)?;
        let stacks = (goals / 2).max(1);
        let mut last = Vec::new();
        for k in 0..stacks {
            let carrier = self.carrier(rng)?;
            self.fixed.retain(|fixed| *fixed != carrier);
            let shape = self.draft.shapes[carrier].clone();
            let end = self.place_by_fixed(&shape, rng)?;
            self.layout.keep(&shape, &end);
            let from = (shape, self.draft.start[carrier]);
            self.end[carrier] = end;
            last.push((carrier, end));
            self.draft.goals.push((carrier, About::OneOf(self.fixed.clone())));
            let (upper, on) = (0..4 * DRAWS).find_map(|_| {
                let shape = drawn(rng)?;
                on_top(&shape, (&from.0, &from.1), false).map(|on| (shape, on))
            })?;
            let away = if k == 0 { self.layout.anywhere(&upper, rng)? } else { self.place_by_fixed(&upper, rng)? };
            let upper = self.add(upper, on, away);
            self.draft.moves.push((upper, away));
            // The first one is only in the way.
            if k > 0 {
                self.draft.goals.push((upper, About::OneOf(self.fixed.clone())));
            }
        }
        self.draft.moves.extend(last);
        (2 * stacks - 1..goals).try_for_each(|_| self.mover(rng))
    }

    /// Objects that stand and stay.
    fn bystanders(&mut self, count: usize, rng: &mut Pcg64) -> Option<()> {
        (0..count).try_for_each(|_| {
            let shape = drawn(rng)?;
            let at = self.layout.anywhere(&shape, rng)?;
            let id = self.add(shape, at, at);
            self.fixed.push(id);
            Some(())
        })
    }

    /// A low box with a top for one.
    fn carrier(&mut self, rng: &mut Pcg64) -> Option<usize> {
        const HEIGHT_M: f64 = 0.09;
        const TOP_M: [f32; 2] = [0.03, 0.06];
        let boxes = ObjectSource::procedural([(Family::Box, 1.0)]);
        let shape = (0..4 * DRAWS).find_map(|_| {
            let shape = boxes.sample(rng.random_range(0.6..1.2), rng);
            let top = shape.top?;
            let is_fit = top.half_extents_m.iter().all(|h| (TOP_M[0]..TOP_M[1]).contains(h)) && 2.0 * shape.half_extents_m.z <= HEIGHT_M;
            is_fit.then_some(shape)
        })?;
        let at = self.layout.anywhere(&shape, rng)?;
        let id = self.add(shape, at, at);
        self.fixed.push(id);
        Some(id)
    }

    /// An object with a goal about what stays.
    fn mover(&mut self, rng: &mut Pcg64) -> Option<()> {
        let shape = drawn(rng)?;
        let end = self.place_by_fixed(&shape, rng)?;
        self.layout.keep(&shape, &end);
        let start = self.layout.anywhere(&shape, rng)?;
        let id = self.add(shape, start, end);
        self.draft.moves.push((id, end));
        self.draft.goals.push((id, About::OneOf(self.fixed.clone())));
        Some(())
    }

    /// A free place, more often than not beside something that stays.
    fn place_by_fixed(&self, shape: &ObjectShape, rng: &mut Pcg64) -> Option<Isometry3<f64>> {
        const BESIDE: f64 = 0.6;
        let neighbour = self.fixed.get(rng.random_range(0..self.fixed.len().max(1)))?;
        let beside =
            rng.random_bool(BESIDE).then(|| self.layout.beside(shape, (&self.draft.shapes[*neighbour], &self.end[*neighbour]), rng));
        beside.flatten().or_else(|| self.layout.anywhere(shape, rng))
    }

    fn add(&mut self, shape: Arc<ObjectShape>, start: Isometry3<f64>, end: Isometry3<f64>) -> usize {
        self.layout.keep(&shape, &start);
        if end != start {
            self.layout.keep(&shape, &end);
        }
        self.draft.shapes.push(shape);
        self.draft.start.push(start);
        self.end.push(end);
        self.end.len() - 1
    }

    /// What stands on the table in the end, at the foot of the stack that an object is in.
    fn on_table_under(&self, object: usize) -> usize {
        let about = self.draft.goals.iter().find(|(id, _)| *id == object).map(|(_, about)| about);
        if let Some(About::OnTopOf(under)) = about { self.on_table_under(*under) } else { object }
    }
}

/// A thing of a size that one can set down by another.
fn drawn(rng: &mut Pcg64) -> Option<Arc<ObjectShape>> {
    use Family::{Bottle, Box, Can, Carton, Cup, Cylinder, Jar, Mug};
    let weights = [(Box, 4.0), (Cylinder, 2.0), (Can, 2.0), (Carton, 2.0), (Cup, 1.0), (Jar, 1.0), (Mug, 1.0), (Bottle, 1.0)];
    let source = ObjectSource::procedural(weights);
    (0..DRAWS).find_map(|_| {
        let shape = source.sample(rng.random_range(0.5..0.9), rng);
        let half = shape.half_extents_m;
        let wide = half.xy().min() >= 0.015 && half.xy().max() <= 0.06;
        // What is much higher than it is wide topples at a touch.
        (wide && (0.012..=0.1).contains(&half.z) && half.z <= 3.0 * half.xy().min()).then_some(shape)
    })
}
