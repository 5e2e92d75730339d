//! What a worker serves, as a metric. Weights are labels of it, and can change while the worker runs: a series whose labels are no longer so does
//! not end by itself, and would go on telling that they are.

use repose_proto::Service;

/// The metric `repose_worker_info` of one worker.
pub(super) struct ServedInfo {
    service: &'static str,
    worker: String,
    /// Weights and kernel that were told last.
    told: Option<[String; 2]>,
}

impl ServedInfo {
    pub(super) fn new(service: Service, worker: &str) -> Self {
        Self { service: service.as_str(), worker: worker.to_owned(), told: None }
    }

    /// Tells what is served now: 1 for this, and 0 for what was before.
    pub(super) fn tell(&mut self, weights: &str, kernel: &str) {
        let now = [weights.to_owned(), kernel.to_owned()];
        if self.told.as_ref() == Some(&now) {
            return;
        }
        self.set(&now, 1.0);
        if let Some(before) = self.told.replace(now) {
            self.set(&before, 0.0);
        }
    }

    fn set(&self, [weights, kernel]: &[String; 2], value: f64) {
        let labels = [
            ("service", self.service.to_owned()),
            ("worker", self.worker.clone()),
            ("weights", weights.clone()),
            ("kernel", kernel.clone()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        metrics::gauge!("repose_worker_info", &labels).set(value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_that_are_served_no_longer_are_told_to_be_so() {
        let recorder = metrics_exporter_prometheus::PrometheusBuilder::new().build_recorder();
        let page = recorder.handle();
        let value = |weights: &str| {
            let (text, label) = (page.render(), format!("weights=\"{weights}\""));
            text.lines().find(|line| line.contains(&label)).and_then(|line| line.rsplit(' ').next()).map(str::to_owned)
        };
        metrics::with_local_recorder(&recorder, || {
            let mut served = ServedInfo::new(Service::Inference, "a");
            served.tell("old", "avx2");
            served.tell("old", "avx2");
            assert_eq!((value("old").as_deref(), value("new")), (Some("1"), None));
            served.tell("new", "avx2");
            assert_eq!((value("old").as_deref(), value("new").as_deref()), (Some("0"), Some("1")));
            served.tell("old", "avx2");
            assert_eq!((value("old").as_deref(), value("new").as_deref()), (Some("1"), Some("0")));
        });
    }
}
