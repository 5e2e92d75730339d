//! A link that goes silent and is not closed, as when a machine loses its power, while frames go by it: the client finds its router again, and then
//! stops looking.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use repose_proto::Payload;
use repose_runtime::{RuntimeConfig, Session, SessionMode, Traffic};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;

/// What lies between a client and its router.
struct Wire {
    address: SocketAddr,
    accepted: Arc<AtomicUsize>,
    silence: watch::Sender<()>,
}

impl Wire {
    async fn to(router: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (accepted, silence) = (Arc::new(AtomicUsize::new(0)), watch::Sender::new(()));
        let (counted, told) = (accepted.clone(), silence.clone());
        tokio::spawn(async move {
            loop {
                let (mut near, _) = listener.accept().await.unwrap();
                counted.fetch_add(1, Ordering::Relaxed);
                let mut silenced = told.subscribe();
                tokio::spawn(async move {
                    let mut far = TcpStream::connect(router).await.unwrap();
                    tokio::select! {
                        _ = tokio::io::copy_bidirectional(&mut near, &mut far) => {}
                        // Both ends stay open, and nothing passes any more.
                        _ = silenced.changed() => std::future::pending::<()>().await,
                    }
                });
            }
        });
        Self { address, accepted, silence }
    }

    fn accepted(&self) -> usize {
        self.accepted.load(Ordering::Relaxed)
    }
}

async fn session(mode: SessionMode, address: SocketAddr) -> Session {
    let mut config = RuntimeConfig::default();
    config.session.mode = mode;
    let endpoint = vec![format!("tcp/{address}")];
    match mode {
        SessionMode::Router => config.session.listen = endpoint,
        _ => config.session.connect = endpoint,
    }
    Session::open(config).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_comes_back_after_a_silent_link_and_looks_for_its_router_no_longer() {
    let address = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let _router = session(SessionMode::Router, address).await;
    let wire = Wire::to(address).await;
    let (camera, watching) = (session(SessionMode::Client, wire.address).await, session(SessionMode::Client, address).await);
    let key = camera.cell().camera_frame("front");
    let mut seen = watching.subscribe_latest(&key).await.unwrap();
    let frames = camera.publisher(key, Traffic::Frame);
    tokio::spawn(async move {
        loop {
            // What a link takes of frames that nobody reads is less than these.
            let frame = Payload { encoding: String::new(), bytes: vec![0; 4 << 20].into() };
            drop(frames.put(frame).await);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    });
    let mut next = async || tokio::time::timeout(Duration::from_secs(20), seen.recv()).await.expect("a frame").unwrap();
    next().await;
    wire.silence.send(()).unwrap();
    let silent = Instant::now();
    // Those that were under way arrive at once, the first by a new link later.
    while silent.elapsed() < Duration::from_secs(1) {
        tokio::time::timeout(Duration::from_millis(200), next()).await.ok();
    }
    next().await;
    // Zenoh pauses for half a second at most between attempts.
    let (mut accepted, mut since) = (wire.accepted(), Instant::now());
    while since.elapsed() < Duration::from_secs(2) {
        assert!(silent.elapsed() < Duration::from_secs(25), "{} links, and still more", wire.accepted());
        tokio::time::sleep(Duration::from_millis(50)).await;
        if wire.accepted() != accepted {
            (accepted, since) = (wire.accepted(), Instant::now());
        }
    }
    next().await;
}
