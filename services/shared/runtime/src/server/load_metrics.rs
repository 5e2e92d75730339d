//! A worker's load as metrics.

use repose_proto::Service;
use repose_proto::load::WorkerLoad;

/// Tells a worker's load as metrics.
pub(super) struct LoadMetrics {
    service: &'static str,
    worker: String,
    /// The weights and the kernel that were told last.
    served: Option<[String; 2]>,
}

impl LoadMetrics {
    pub(super) fn of(service: Service, worker: &str) -> Self {
        Self { service: service.as_str(), worker: worker.to_owned(), served: None }
    }

    pub(super) fn tell(&mut self, load: &WorkerLoad) {
        let labels = [("service", self.service.to_owned()), ("worker", self.worker.clone())];
        metrics::gauge!("repose_queue_waiting", &labels).set(load.queue_depth as f64);
        metrics::gauge!("repose_calls_running", &labels).set(load.in_flight as f64);
        metrics::gauge!("repose_draining", &labels).set(f64::from(u8::from(load.draining)));
        let serves = [load.weights_hash.clone(), load.kernel.clone()];
        // A gauge is told for as long as the process runs, that of weights which were replaced too.
        if let Some(before) = self.served.replace(serves.clone()).filter(|before| *before != serves) {
            self.tell_info(before, 0.0);
        }
        self.tell_info(serves, 1.0);
    }

    fn tell_info(&self, [weights, kernel]: [String; 2], value: f64) {
        let (service, worker, version) = (self.service, self.worker.clone(), env!("CARGO_PKG_VERSION"));
        metrics::gauge!(
            "repose_worker_info", "service" => service, "worker" => worker, "weights" => weights, "kernel" => kernel, "version" => version
        )
        .set(value);
    }
}

#[cfg(test)]
mod tests {
    use metrics_exporter_prometheus::PrometheusBuilder;

    use super::*;

    #[test]
    fn weights_that_were_replaced_are_not_told_as_served() {
        let recorder = PrometheusBuilder::new().build_recorder();
        let mut told = LoadMetrics::of(Service::Inference, "i-1");
        metrics::with_local_recorder(&recorder, || {
            for weights in ["old", "old", "new"] {
                told.tell(&WorkerLoad { weights_hash: weights.to_owned(), ..WorkerLoad::default() });
            }
        });
        let page = recorder.handle().render();
        let value = |weights: &str| {
            let label = format!("weights=\"{weights}\"");
            page.lines()
                .find(|line| line.starts_with("repose_worker_info") && line.contains(&label))
                .and_then(|line| line.rsplit(' ').next())
        };
        assert_eq!((value("old"), value("new")), (Some("0"), Some("1")), "{page}");
    }
}
