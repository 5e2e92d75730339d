//! The goals that a controller may still be carrying out, and the cancels that they are sent.
//!
//! One cancel is not enough: it may get lost, or overtake the goal, or be refused. A goal is here from when it is sent until it is known to have
//! ended, and while the arm is stopped it is canceled again and again. One more stands for those of others ([`OTHERS`]): what processes before this
//! one left, and what other clients of the controller have sent by the time of an emergency stop.

/// Between two cancels of a goal, milliseconds: one may get lost, or overtake the goal.
pub const CANCEL_EVERY_MS: u64 = 250;
/// The number that stands for the goals of others: it cancels every goal of the controller.
pub const OTHERS: u64 = 0;
/// Goals at most: a commander that changes its stream more often than the controller ends goals is stopped.
const MOST: usize = 64;

/// A goal, with when it was first and last canceled, and when its controller last said that it is ending it, milliseconds.
#[derive(Debug, Clone, Copy)]
struct Open {
    number: u64,
    canceled_ms: Option<(u64, u64)>,
    ending_ms: Option<u64>,
    /// Whether a cancel is due whenever the last one was.
    at_once: bool,
}

/// The goals that are not known to have ended.
#[derive(Debug, Clone, Default)]
pub struct Unended {
    goals: Vec<Open>,
}

impl Unended {
    /// Whether every goal has ended.
    pub fn is_empty(&self) -> bool {
        self.goals.is_empty()
    }

    /// Whether there is room for another goal.
    pub fn has_room(&self) -> bool {
        self.goals.len() < MOST
    }

    /// A goal is sent.
    pub fn sent(&mut self, number: u64) {
        self.goals.push(Open { number, canceled_ms: None, ending_ms: None, at_once: false });
    }

    /// Others may have sent goals, too.
    pub fn others_may_have_sent(&mut self) {
        if self.goals.iter().all(|goal| goal.number != OTHERS) {
            self.sent(OTHERS);
        }
    }

    /// Its controller has accepted it: a cancel that came before that was of no effect.
    pub fn accepted(&mut self, number: u64) {
        self.goals.iter_mut().filter(|goal| goal.number == number).for_each(|goal| goal.at_once = true);
    }

    /// Its controller says to a cancel that it is ending it.
    pub fn ending(&mut self, number: u64, now_ms: u64) {
        self.goals.iter_mut().filter(|goal| goal.number == number).for_each(|goal| goal.ending_ms = Some(now_ms));
    }

    /// It has ended, or was never taken.
    pub fn ended(&mut self, number: u64) {
        self.goals.retain(|goal| goal.number != number);
    }

    /// The arm has arrived on a goal: those of this process before it gave way to it.
    pub fn arrived(&mut self, number: u64) {
        self.goals.retain(|goal| goal.number > number || goal.number == OTHERS);
    }

    /// The controller says to a cancel that it carries out no such goal. Within `patience_ms` of the first cancel the goal itself may still be on
    /// its way to the controller, or the controller may still be ending it; within that time of its word that it is, too.
    pub fn not_there(&mut self, number: u64, now_ms: u64, patience_ms: u64) {
        let is_over = |goal: &Open| {
            goal.canceled_ms.is_some_and(|(first_ms, _)| now_ms >= first_ms + patience_ms)
                && goal.ending_ms.is_none_or(|ending_ms| now_ms >= ending_ms + patience_ms)
        };
        self.goals.retain(|goal| goal.number != number || !is_over(goal));
    }

    /// The goals of an arm that is stopped which are to be canceled now.
    pub fn to_cancel(&mut self, now_ms: u64) -> Vec<u64> {
        let is_due = |goal: &Open| goal.at_once || goal.canceled_ms.is_none_or(|(_, last_ms)| now_ms >= last_ms + CANCEL_EVERY_MS);
        let due = self.goals.iter_mut().filter(|goal| is_due(goal));
        due.map(|goal| {
            let first_ms = goal.canceled_ms.map_or(now_ms, |(first_ms, _)| first_ms);
            (goal.canceled_ms, goal.at_once) = (Some((first_ms, now_ms)), false);
            goal.number
        })
        .collect()
    }

    /// What is to be said of goals that go on though they were canceled for more than `patience_ms`.
    pub fn overdue(&self, now_ms: u64, patience_ms: u64) -> Option<String> {
        let is_overdue = |goal: &&Open| {
            // Only an answer that comes after that time tells that nothing of others is left.
            let patience_ms = if goal.number == OTHERS { patience_ms + 2 * CANCEL_EVERY_MS } else { patience_ms };
            goal.canceled_ms.is_some_and(|(first_ms, _)| now_ms > first_ms + patience_ms)
        };
        if self.goals.iter().filter(is_overdue).any(|goal| goal.number == OTHERS) {
            let left = "no goal of another client or of before this start";
            return Some(format!("the controller has not said that it carries out {left}: the arm may still move"));
        }
        let count = self.goals.iter().filter(is_overdue).count();
        (count > 0).then(|| format!("the controller has not ended {count} of the canceled goals: the arm may still move"))
    }
}
