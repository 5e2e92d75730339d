//! Pages served until a process is to end.
//!
//! By hyper's server and not by axum's, which sets no limit to how long the head of a request may take: whoever sent a byte of one every minute
//! would keep one of the files that the operating system allows this process, and so would a thousand others.

use std::convert::Infallible;
use std::time::Duration;

use axum::Router;
use axum::serve::Listener;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::mpsc;
use tokio::time::timeout;

use crate::{Shutdown, silence};

/// How long requests under way may take once their server is to end: a stop is put for five seconds.
const LAST_ANSWERS: Duration = Duration::from_secs(6);
/// How long the head of a request may take, from the connection's beginning or from the end of the answer before. A head has a few kilobytes, seconds
/// of the slowest link; but the wait of a kept connection for its next request counts too, and Prometheus asks once a minute. Bodies, answers and
/// WebSockets may go on for as long as something passes.
const HEAD_WITHIN: Duration = Duration::from_secs(90);

/// Serves until `shutdown`, and then until requests that are under way have had their time. Without that bound it would wait for every connection, also
/// for one whose client has stopped to read its answer: until that counts as silent.
pub async fn serve_http<L: Listener>(listener: L, pages: Router, shutdown: &Shutdown) {
    let mut listener = silence::Listener(listener);
    // Makes the routes here, and not again for every request.
    let pages: Router = pages.with_state(());
    // Nothing is sent: it is over when nobody is left who could.
    let (under_way, mut over) = mpsc::channel::<Infallible>(1);
    loop {
        let connection = tokio::select! {
            biased;
            () = shutdown.requested() => break,
            (connection, _) = listener.accept() => connection,
        };
        tokio::spawn(answer(connection, pages.clone(), shutdown.clone(), under_way.clone()));
    }
    drop((listener, under_way));
    let _late = timeout(LAST_ANSWERS, over.recv()).await;
}

/// Answers the requests of one connection.
async fn answer<Io>(connection: Io, pages: Router, shutdown: Shutdown, _under_way: mpsc::Sender<Infallible>)
where
    Io: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let mut protocol = http1::Builder::new();
    protocol.timer(TokioTimer::new()).header_read_timeout(HEAD_WITHIN);
    let answering = protocol.serve_connection(TokioIo::new(connection), TowerToHyperService::new(pages)).with_upgrades();
    tokio::pin!(answering);
    let ended = tokio::select! {
        ended = answering.as_mut() => ended,
        () = shutdown.requested() => {
            answering.as_mut().graceful_shutdown();
            answering.as_mut().await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "a connection over HTTP ended early");
    }
}

#[cfg(test)]
mod tests {
    use std::future::pending;

    use axum::extract::ws::WebSocketUpgrade;
    use axum::routing::{get, post};
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};
    use tokio::net::{TcpListener, TcpStream};
    use tokio::time::{Instant, sleep};

    use super::*;

    /// One connection, within the process: time may pass as soon as nobody has anything to do.
    struct Within(Option<DuplexStream>);

    impl Listener for Within {
        type Io = DuplexStream;
        type Addr = ();

        async fn accept(&mut self) -> (DuplexStream, ()) {
            match self.0.take() {
                Some(connection) => (connection, ()),
                None => pending().await,
            }
        }

        fn local_addr(&self) -> std::io::Result<()> {
            Ok(())
        }
    }

    /// What a client finds that is served `pages` over one connection.
    async fn as_a_client<T, F: Future<Output = T>>(pages: Router, client: impl FnOnce(DuplexStream) -> F) -> T {
        let (ours, theirs) = duplex(1 << 16);
        let shutdown = Shutdown::new();
        tokio::select! {
            () = serve_http(Within(Some(theirs)), pages, &shutdown) => panic!("nobody asked it to end"),
            found = client(ours) => found,
        }
    }

    /// The next answer's status line; it must have come whole.
    async fn status(client: &mut DuplexStream) -> String {
        let mut answer = vec![0; 4096];
        let length = client.read(&mut answer).await.expect("an answer");
        let text = String::from_utf8_lossy(&answer[..length]).into_owned();
        text.lines().next().unwrap_or_default().to_owned()
    }

    /// How long a client is listened to that sends a byte of a head, which never ends, every twenty seconds.
    async fn dripped(client: &mut DuplexStream) -> Duration {
        let begun = Instant::now();
        for _ in 0..30 {
            if client.write_all(b"a").await.is_err() {
                break;
            }
            sleep(Duration::from_secs(20)).await;
        }
        begun.elapsed()
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_sends_the_head_of_its_request_a_byte_at_a_time_is_let_go() {
        let pages = Router::new().route("/", get(|| async { "here\n" }));
        let first = as_a_client(pages.clone(), |mut client| async move { dripped(&mut client).await });
        let second = as_a_client(pages, |mut client| async move {
            client.write_all(b"GET / HTTP/1.1\r\nhost: localhost\r\n\r\n").await.expect("asked");
            assert_eq!(status(&mut client).await, "HTTP/1.1 200 OK");
            dripped(&mut client).await
        });
        let most = HEAD_WITHIN + Duration::from_secs(20);
        for held in [first.await, second.await] {
            assert!(held >= HEAD_WITHIN && held <= most, "{held:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn slow_bodies_slow_answers_and_web_sockets_take_longer_than_a_head_may() {
        let answers_late = get(|| async {
            sleep(HEAD_WITHIN * 2).await;
            "late\n"
        });
        let echo = |upgrade: WebSocketUpgrade| async move {
            upgrade.on_upgrade(|mut socket| async move {
                let said = socket.recv().await.expect("a message").expect("a whole one");
                socket.send(said).await.expect("sent back");
                pending::<()>().await;
            })
        };
        let pages =
            Router::new().route("/late", answers_late).route("/body", post(|body: String| async move { body })).route("/socket", get(echo));
        as_a_client(pages, |mut client| async move {
            client.write_all(b"GET /late HTTP/1.1\r\nhost: localhost\r\n\r\n").await.expect("asked");
            assert_eq!(status(&mut client).await, "HTTP/1.1 200 OK");
            client.write_all(b"POST /body HTTP/1.1\r\nhost: localhost\r\ncontent-length: 4\r\n\r\n").await.expect("asked");
            for byte in b"slow" {
                sleep(HEAD_WITHIN).await;
                client.write_all(&[*byte]).await.expect("a byte of the body");
            }
            assert_eq!(status(&mut client).await, "HTTP/1.1 200 OK");
            let upgrade = b"GET /socket HTTP/1.1\r\nhost: localhost\r\nconnection: upgrade\r\nupgrade: websocket\r\n\
                sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
            client.write_all(upgrade).await.expect("asked");
            assert_eq!(status(&mut client).await, "HTTP/1.1 101 Switching Protocols");
            sleep(HEAD_WITHIN * 2).await;
            // A text of one letter; what clients send is masked, here with zeros.
            client.write_all(&[0x81, 0x81, 0, 0, 0, 0, b'a']).await.expect("said");
            let mut echoed = [0; 3];
            client.read_exact(&mut echoed).await.expect("an echo");
            assert_eq!(echoed, [0x81, 1, b'a']);
        })
        .await;
    }

    #[tokio::test]
    async fn a_server_that_is_to_end_waits_for_no_client_that_does_not_read_its_answer() {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        // More than the system takes on its way.
        let pages = Router::new().route("/", get(|| async { vec![0_u8; 64 << 20] }));
        let shutdown = Shutdown::new();
        let mut client = TcpStream::connect(address).await.expect("a connection");
        client.write_all(b"GET / HTTP/1.1\r\nhost: localhost\r\n\r\n").await.expect("asked");
        let reads_little = async {
            client.read_exact(&mut [0]).await.expect("the answer begins");
            shutdown.trigger();
            // From here on time passes whenever nothing else does.
            tokio::time::pause();
            pending::<()>().await;
        };
        tokio::select! {
            () = serve_http(listener, pages, &shutdown) => {}
            () = reads_little => {}
            () = sleep(silence::LONGEST / 2) => panic!("it waits for the client"),
        }
    }
}
