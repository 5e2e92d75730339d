//! Workers die and stop while four processes load the system: every request still ends in exactly one terminal outcome, in time.

mod common;

use std::io::{BufRead, BufReader};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use common::{Deployment, PATIENCE, Process, newest_scene, repose};
use repose_proto::Service;

const LOADS: usize = 4;
const REQUESTS_EACH: usize = 50;
const DEADLINE_MS: usize = 60_000;

#[tokio::test(flavor = "multi_thread")]
async fn requests_survive_a_killed_and_a_stopped_inference_worker() {
    let services = [(Service::Simulator, 1), (Service::Perception, 1), (Service::Inference, 3), (Service::Planner, 2)];
    // As by default: the stopped one is missed as it would be anywhere.
    let deployment = Deployment::start_impatient(&services).await;
    let session = deployment.session().await;
    newest_scene(&session).await;

    let ended = Arc::new(AtomicUsize::new(0));
    let loads: Vec<_> = (0..LOADS)
        .map(|i| {
            let mut load = repose();
            load.args(["load", "--json", "--clients", "2", "--variant", "full", "--iterations", "1", "--batch", "16"]);
            load.args(["--requests", &REQUESTS_EACH.to_string(), "--deadline-ms", &DEADLINE_MS.to_string()]);
            load.args(["--seed", &(i * REQUESTS_EACH).to_string(), "--connect", deployment.endpoint()]);
            load.env("REPOSE_LOG", "repose=debug").stdout(Stdio::piped()).stderr(Stdio::piped());
            let mut child = load.spawn().expect("a load");
            let (log, ended) = (BufReader::new(child.stderr.take().expect("its log")), ended.clone());
            std::thread::spawn(move || {
                for line in log.lines().map_while(Result::ok) {
                    if line.contains("request ended") {
                        ended.fetch_add(1, Ordering::SeqCst);
                    }
                }
            });
            Process(child)
        })
        .collect();

    let give_up = std::time::Instant::now() + 2 * PATIENCE;
    while ended.load(Ordering::SeqCst) < LOADS * REQUESTS_EACH / 2 {
        assert!(std::time::Instant::now() < give_up, "only {} requests have ended", ended.load(Ordering::SeqCst));
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    }
    let inference = deployment.of(Service::Inference);
    inference[0].signal(libc::SIGKILL);
    inference[1].signal(libc::SIGSTOP);

    let (mut answered, mut all) = (0, 0);
    for mut load in loads {
        let mut printed = String::new();
        std::io::Read::read_to_string(&mut load.0.stdout.take().expect("its output"), &mut printed).expect("text");
        assert!(load.0.wait().expect("it ends").success());
        let report: serde_json::Value = serde_json::from_str(&printed).expect("one JSON document");
        println!("{}", report["outcomes"]);
        let outcomes = report["outcomes"].as_object().expect("outcomes");
        let count = |name: &str| outcomes.get(name).and_then(serde_json::Value::as_u64).unwrap_or(0);
        assert_eq!((count("lost"), count("duplicate")), (0, 0));
        assert_eq!(report["late"], 0, "requests outlived their deadline");
        assert_eq!(outcomes.values().filter_map(serde_json::Value::as_u64).sum::<u64>(), REQUESTS_EACH as u64);
        answered += count("result") + count("none");
        all += REQUESTS_EACH as u64;
    }
    inference[1].signal(libc::SIGCONT);
    assert!(answered * 100 >= all * 95, "{answered} of {all} were answered");
}
