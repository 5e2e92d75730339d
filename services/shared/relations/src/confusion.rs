//! Counts of yes-or-no judgements against the truth, and their figures: F1, sensitivity, specificity.

use serde::Serialize;

/// True and false positives and negatives.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Confusion {
    /// Judged true, and true.
    pub true_positives: usize,
    /// Judged true, but false.
    pub false_positives: usize,
    /// Judged false, but true.
    pub false_negatives: usize,
    /// Judged false, and false.
    pub true_negatives: usize,
}

impl Confusion {
    /// Counts one judgement.
    pub fn count(&mut self, judged: bool, truth: bool) {
        *match (judged, truth) {
            (true, true) => &mut self.true_positives,
            (true, false) => &mut self.false_positives,
            (false, true) => &mut self.false_negatives,
            (false, false) => &mut self.true_negatives,
        } += 1;
    }

    /// Adds the counts of another.
    pub fn merge(&mut self, other: &Self) {
        self.true_positives += other.true_positives;
        self.false_positives += other.false_positives;
        self.false_negatives += other.false_negatives;
        self.true_negatives += other.true_negatives;
    }

    /// All judgements.
    pub fn total(&self) -> usize {
        self.true_positives + self.false_positives + self.false_negatives + self.true_negatives
    }

    /// The share that is true, percent; 0 without judgements.
    pub fn true_percent(&self) -> f64 {
        100.0 * share(self.true_positives + self.false_negatives, self.total()).unwrap_or(0.0)
    }

    /// The share of what is true that was judged true, 0 to 1; `None` where nothing is true.
    pub fn sensitivity(&self) -> Option<f64> {
        share(self.true_positives, self.true_positives + self.false_negatives)
    }

    /// The share of what is false that was judged false, 0 to 1; `None` where everything is true.
    pub fn specificity(&self) -> Option<f64> {
        share(self.true_negatives, self.true_negatives + self.false_positives)
    }

    /// Harmonic mean of precision and sensitivity, 0 to 1; `None` where nothing is true and nothing was judged true.
    pub fn f1(&self) -> Option<f64> {
        share(2 * self.true_positives, 2 * self.true_positives + self.false_positives + self.false_negatives)
    }

    /// The F1 that the same sensitivity and specificity would give at another `prevalence`, the share that is true (0 to 1): F1 cannot be
    /// compared between sets that differ in it.
    pub fn f1_at(&self, prevalence: f64) -> Option<f64> {
        let found = prevalence * self.sensitivity()?;
        let mistaken = (1.0 - prevalence) * (1.0 - self.specificity()?);
        let sum = found + mistaken + prevalence;
        (sum > 0.0).then(|| 2.0 * found / sum)
    }
}

fn share(part: usize, all: usize) -> Option<f64> {
    (all > 0).then(|| part as f64 / all as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    const WORKED: Confusion = Confusion { true_positives: 30, false_positives: 20, false_negatives: 10, true_negatives: 140 };

    #[test]
    fn the_figures_are_those_worked_by_hand() {
        // Precision 30/50, sensitivity 30/40: F1 = 2 · 0.6 · 0.75 / 1.35.
        assert_eq!(WORKED.sensitivity(), Some(0.75));
        assert_eq!(WORKED.specificity(), Some(0.875));
        assert!((WORKED.f1().expect("defined") - 0.9 / 1.35).abs() < 1e-12);
        assert_eq!((WORKED.total(), WORKED.true_percent()), (200, 20.0));
    }

    #[test]
    fn f1_at_its_own_prevalence_is_f1_and_falls_where_the_relation_is_rarer() {
        let f1 = WORKED.f1().expect("defined");
        assert!((WORKED.f1_at(0.2).expect("defined") - f1).abs() < 1e-12);
        // At 5 %: found 0.0375, mistaken 0.95 · 0.125 = 0.11875; 2 · 0.0375 / (0.0375 + 0.11875 + 0.05).
        assert!((WORKED.f1_at(0.05).expect("defined") - 0.075 / 0.20625).abs() < 1e-12);
    }

    #[test]
    fn figures_without_a_denominator_are_none() {
        let mut none = Confusion::default();
        assert_eq!((none.f1(), none.sensitivity(), none.specificity(), none.true_percent()), (None, None, None, 0.0));
        none.count(false, false);
        assert_eq!((none.f1(), none.sensitivity(), none.specificity()), (None, None, Some(1.0)));
        none.count(false, true);
        assert_eq!((none.f1(), none.f1_at(0.1)), (Some(0.0), Some(0.0)));
        let mut sum = WORKED;
        sum.merge(&none);
        assert_eq!((sum.total(), sum.false_negatives), (202, 11));
    }
}
