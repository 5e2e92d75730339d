//! The same request and seed give the same bytes: with one inference process and with three, of one thread or two, alone and among sixteen,
//! and when a worker is killed and its batch goes to another.

mod common;

use std::time::Duration;

use common::{Deployment, PATIENCE, enclosed, newest_scene, whole_scene};
use repose_proto::place::{Budget, Variant};
use repose_proto::{GoalTerm, Payload, PlaceRequest, PlaceResult, Relation, Scene, Service};
use repose_runtime::{CallOptions, Caller, Session};

async fn place(session: &Session, request: &PlaceRequest, scene: &Scene) -> Payload {
    let planner = session.caller(Service::Planner).await.expect("a caller");
    let answer = planner.call("place", enclosed(request, scene), CallOptions::within(PATIENCE)).await;
    answer.expect("an answer").payload
}

#[tokio::test(flavor = "multi_thread")]
async fn the_same_request_gives_the_same_bytes_whatever_else_runs() {
    let services = [(Service::Simulator, 1), (Service::Perception, 1), (Service::Inference, 1), (Service::Planner, 1)];
    let mut deployment = Deployment::start(&services).await;
    let session = deployment.session().await;
    let scene = newest_scene(&session).await;
    let whole = std::sync::Arc::new(whole_scene(&session, &scene).await);
    let request = |seed: u64, variant: Variant| PlaceRequest {
        seed,
        variant,
        budget: Budget { iterations: Some(2), batch: Some(8), ..Budget::default() },
        ..PlaceRequest::new(
            scene.scene_id.clone(),
            scene.objects[0].id,
            vec![GoalTerm { relation: Relation::LeftOf, anchor: scene.objects[1].id, holds: true }],
        )
    };
    let variants = [Variant::Full, Variant::Best, Variant::Geometric];
    let mut alone = Vec::new();
    for variant in variants {
        alone.push(place(&session, &request(7, variant), &whole).await);
    }
    let other = place(&session, &request(8, Variant::Full), &whole).await;
    let parsed: PlaceResult = alone[0].decode_json().expect("a result");
    assert!(parsed.evaluated > 0 && !parsed.weights_hash.is_empty());
    assert_ne!(alone[0].bytes, other.bytes, "another seed draws other candidates");

    deployment.add(Service::Inference);
    deployment.add(Service::Inference);
    let inference = session.caller(Service::Inference).await.expect("a caller");
    inference.wait_for_workers(3, PATIENCE).await.expect("three inference workers");
    for (variant, alone) in variants.into_iter().zip(&alone) {
        let again = place(&session, &request(7, variant), &whole).await;
        assert_eq!(again.bytes, alone.bytes, "{variant} with three inference workers");
    }

    let among: Vec<_> = (0..16u64)
        .map(|i| {
            let (session, request, whole) = (session.clone(), request(7 + i % 4, variants[i as usize / 4 % 2]), whole.clone());
            tokio::spawn(async move { (request.seed, request.variant, place(&session, &request, &whole).await) })
        })
        .collect();
    for one in among {
        let (seed, variant, payload) = one.await.expect("no panic");
        if seed == 7 {
            let index = variants.iter().position(|v| *v == variant).expect("a variant asked for");
            assert_eq!(payload.bytes, alone[index].bytes, "{variant} among sixteen");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_batch_whose_worker_is_killed_is_scored_by_another_to_the_same_bytes() {
    let services = [(Service::Simulator, 1), (Service::Perception, 1), (Service::Inference, 1), (Service::Planner, 1)];
    let mut deployment = Deployment::start(&services).await;
    let session = deployment.session().await;
    let scene = newest_scene(&session).await;
    let whole = std::sync::Arc::new(whole_scene(&session, &scene).await);
    // Nothing is ever realistic enough, so that every iteration draws its fill and the search is long enough to be hit.
    let request = |iterations: u32| PlaceRequest {
        seed: 3,
        variant: Variant::Full,
        budget: Budget { iterations: Some(iterations), batch: Some(40), draws_per_batch: Some(3), ..Budget::default() },
        thresholds: repose_proto::place::Thresholds { realism: Some(1.0), relations: Some(0.0) },
        ..PlaceRequest::new(
            scene.scene_id.clone(),
            scene.objects[0].id,
            vec![GoalTerm { relation: Relation::LeftOf, anchor: scene.objects[1].id, holds: true }],
        )
    };
    let planner = session.caller(Service::Planner).await.expect("a caller");
    let inference = session.caller(Service::Inference).await.expect("a caller");
    // A search may be over before the second worker has started, where that waits for a core: then one of three times the length is hit.
    for iterations in [8, 24, 72] {
        let request = request(iterations);
        let alone = place(&session, &request, &whole).await;

        let (sender, mut progress) = tokio::sync::mpsc::channel(128);
        let options = CallOptions { progress: Some(sender), ..CallOptions::within(PATIENCE) };
        let (payload, asked) = (enclosed(&request, &whole), planner.clone());
        let hit = tokio::spawn(async move { asked.call("place", payload, options).await });
        progress.recv().await.expect("the first iteration is done");
        // One worker has the batches; another, with two threads, is there when that one dies.
        deployment.add_with_threads(Service::Inference, 2);
        inference.wait_for_workers(2, PATIENCE).await.expect("the second worker is alive");
        let is_hit = !hit.is_finished();
        deployment.kill_one(Service::Inference);
        let answer = hit.await.expect("no panic").expect("an answer");
        assert_eq!(answer.payload.bytes, alone.bytes);
        one_is_left(&inference).await;
        if is_hit {
            let again = place(&session, &request, &whole).await;
            assert_eq!(again.bytes, alone.bytes, "on two threads alone");
            return;
        }
    }
    panic!("every search ended before its worker could be killed: they must be longer");
}

/// Waits until a worker that was killed is gone.
async fn one_is_left(inference: &Caller) {
    let gone = async {
        while inference.workers().len() > 1 {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    tokio::time::timeout(PATIENCE, gone).await.expect("it is missed");
}
