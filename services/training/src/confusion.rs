//! Counts of what was said of a relation against what is true.

/// Counts of predicted against true.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Confusion {
    both: u32,
    predicted: u32,
    truly: u32,
    all: u32,
}

impl Confusion {
    pub(crate) fn add(&mut self, predicted: bool, truly: bool) {
        self.both += u32::from(predicted && truly);
        self.predicted += u32::from(predicted);
        self.truly += u32::from(truly);
        self.all += 1;
    }

    /// Harmonic mean of precision and recall; none without positives.
    pub(crate) fn f1(&self) -> Option<f64> {
        (self.predicted + self.truly > 0).then(|| 2.0 * f64::from(self.both) / f64::from(self.predicted + self.truly))
    }

    pub(crate) fn true_percent(&self) -> f64 {
        100.0 * f64::from(self.truly) / f64::from(self.all.max(1))
    }
}
