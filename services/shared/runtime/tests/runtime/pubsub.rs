//! Publishing and subscribing over a router: the newest wins, losses are counted, keys and encodings arrive.

use crate::common::{Network, read, word};
use repose_runtime::{RuntimeConfig, Traffic};

#[tokio::test(flavor = "multi_thread")]
async fn a_subscription_to_the_newest_drops_and_counts_the_rest() {
    let network = Network::routed(RuntimeConfig::default()).await;
    let other = network.session().await;
    let key = other.cell().robot_state("arm");
    let mut newest = other.subscribe_latest(&key).await.unwrap();
    let mut all = other.subscribe_queue(&key, 64).await.unwrap();
    let states = network.caller.publisher(key.clone(), Traffic::Scene);
    // A put before the subscription is known everywhere goes nowhere: repeat until the first has arrived.
    let first = loop {
        states.put(word("first")).await.unwrap();
        if let Ok(Some(sample)) = tokio::time::timeout(std::time::Duration::from_millis(50), all.recv()).await {
            break sample;
        }
    };
    assert_eq!((first.key.as_str(), read(&first.payload).as_str()), (key.as_str(), "first"));
    for i in 0..10 {
        states.put(word(&i.to_string())).await.unwrap();
    }
    while read(&all.recv().await.unwrap().payload) != "9" {}
    assert_eq!(all.dropped(), 0);
    // Both subscriptions are fed by the same session, in the order of declaration or its reverse: wait for the newest to hold the last.
    loop {
        let sample = newest.recv().await.unwrap();
        if read(&sample.payload) == "9" {
            break;
        }
    }
    assert!(newest.dropped() >= 9, "dropped {}", newest.dropped());
}

#[tokio::test(flavor = "multi_thread")]
async fn an_oversize_put_is_refused_by_the_sender() {
    let network = Network::embedded(RuntimeConfig::default()).await;
    let payload = repose_proto::Payload { encoding: String::new(), bytes: vec![0; (32 << 20) + 1].into() };
    let error = network.caller.put("repose/v1/cell/camera/front/frame", payload, Traffic::Frame).await.unwrap_err();
    assert!(error.to_string().contains("33554433"), "{error}");
}
