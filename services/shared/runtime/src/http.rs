//! Pages served until a process is to end.

use std::fmt::Debug;
use std::io::Result;
use std::time::Duration;

use axum::Router;
use axum::serve::Listener;
use tokio::time::sleep;

use crate::{Shutdown, silence};

/// How long requests under way may take once their server is to end: a stop is put for five seconds.
const LAST_ANSWERS: Duration = Duration::from_secs(6);

/// Serves until `shutdown`, and then until requests that are under way have had their time. A server that ends by itself waits for every connection, also
/// for one whose client has stopped to read its answer: until that counts as silent.
///
/// # Errors
/// When the listener fails.
pub async fn serve_http<L>(listener: L, pages: Router, shutdown: &Shutdown) -> Result<()>
where
    L: Listener,
    L::Addr: Debug,
{
    let asked = shutdown.clone();
    let serving = axum::serve(silence::Listener(listener), pages).with_graceful_shutdown(async move { asked.requested().await });
    let late = async {
        shutdown.requested().await;
        sleep(LAST_ANSWERS).await;
    };
    tokio::select! {
        biased;
        served = serving.into_future() => served,
        () = late => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use axum::routing::get;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::{TcpListener, TcpStream};

    use super::*;

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
            std::future::pending::<()>().await;
        };
        tokio::select! {
            served = serve_http(listener, pages, &shutdown) => served.expect("it ends"),
            () = reads_little => {}
            () = sleep(silence::LONGEST / 2) => panic!("it waits for the client"),
        }
    }
}
