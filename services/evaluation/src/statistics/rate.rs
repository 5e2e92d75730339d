//! A rate with its 95 % interval.

use serde::Serialize;

/// Successes of trials.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Rate {
    /// How many succeeded.
    pub of: usize,
    /// How many were tried.
    pub n: usize,
}

impl Rate {
    /// Counts one trial.
    pub fn count(&mut self, success: bool) {
        self.n += 1;
        self.of += usize::from(success);
    }

    /// The rate in percent; none without trials.
    pub fn percent(&self) -> Option<f64> {
        (self.n > 0).then(|| 100.0 * self.of as f64 / self.n as f64)
    }

    /// The rate with its interval and without the counts: `95 % [89, 98]`, or `-` without trials.
    pub fn short(&self) -> String {
        let [low, high] = self.interval_percent();
        self.percent().map_or_else(|| "-".to_owned(), |percent| format!("{percent:.0} % [{low:.0}, {high:.0}]"))
    }

    /// Wilson's 95 % score interval, percent.
    pub fn interval_percent(&self) -> [f64; 2] {
        if self.n == 0 {
            return [0.0, 100.0];
        }
        const Z: f64 = 1.959_964;
        let (n, p) = (self.n as f64, self.of as f64 / self.n as f64);
        let scale = 1.0 / (1.0 + Z * Z / n);
        let middle = scale * (p + Z * Z / (2.0 * n));
        let half = scale * Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
        [100.0 * (middle - half).max(0.0), 100.0 * (middle + half).min(1.0)]
    }
}

impl FromIterator<bool> for Rate {
    fn from_iter<T: IntoIterator<Item = bool>>(trials: T) -> Self {
        let mut rate = Self::default();
        trials.into_iter().for_each(|success| rate.count(success));
        rate
    }
}

impl std::fmt::Display for Rate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Some(percent) = self.percent() else { return f.write_str("0/0") };
        let [low, high] = self.interval_percent();
        write!(f, "{}/{} = {percent:.0} % [{low:.0}, {high:.0}]", self.of, self.n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilsons_interval_is_the_textbooks() {
        let rate = Rate { of: 8, n: 10 };
        let [low, high] = rate.interval_percent();
        assert!((low - 49.02).abs() < 0.05 && (high - 94.33).abs() < 0.05, "{low} {high}");
        assert_eq!(Rate { of: 0, n: 0 }.interval_percent(), [0.0, 100.0]);
    }

    #[test]
    fn without_trials_there_is_no_rate() {
        assert_eq!((Rate::default().percent(), Rate { of: 0, n: 4 }.percent()), (None, Some(0.0)));
        assert_eq!(serde_json::json!(Rate::default().percent()), serde_json::Value::Null);
        assert_eq!((Rate::default().to_string(), Rate { of: 1, n: 2 }.to_string()), ("0/0".to_owned(), "1/2 = 50 % [9, 91]".to_owned()));
    }
}
