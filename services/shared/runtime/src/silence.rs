//! Connections over HTTP over which nothing passes are let go.
//!
//! A machine that is switched off or carried away leaves its connections open at this end for ever, and so does whoever connects and asks
//! nothing. Each takes one of the open files that the operating system allows a process: a console, a server for agents or a router that runs for months
//! would have none left, not even for a stop. Viewers' WebSockets and agents that wait are written to every few seconds, and are never silent so long.

use std::io::{Error, ErrorKind, IoSlice, Result};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep};

use crate::Shutdown;

/// How long nothing may pass. Browsers keep a connection that they may need again for about as long.
const LONGEST: Duration = Duration::from_secs(300);
/// How long requests under way may take once their server is to end: a stop is put for five seconds.
const LAST_ANSWERS: Duration = Duration::from_secs(6);

/// Serves until that ends, or until requests that were under way at the `shutdown` have had their time. A server that ends by itself waits for every
/// connection, also for one whose client has stopped to read its answer: until that counts as silent.
///
/// # Errors
/// Those of `serving`.
pub async fn until_answered(serving: impl Future<Output = Result<()>>, shutdown: &Shutdown) -> Result<()> {
    let late = async {
        shutdown.requested().await;
        sleep(LAST_ANSWERS).await;
    };
    tokio::select! {
        biased;
        served = serving => served,
        () = late => Ok(()),
    }
}

/// A listener whose connections do not stay silent.
pub struct Listener<L>(pub L);

impl<L: axum::serve::Listener> axum::serve::Listener for Listener<L> {
    type Io = Audible<L::Io>;
    type Addr = L::Addr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        let (connection, peer) = self.0.accept().await;
        (Audible::new(connection), peer)
    }

    fn local_addr(&self) -> Result<Self::Addr> {
        self.0.local_addr()
    }
}

/// A connection that ends with an error when nothing has passed over it for too long.
pub struct Audible<Io> {
    connection: Io,
    ends: Pin<Box<Sleep>>,
}

impl<Io> Audible<Io> {
    fn new(connection: Io) -> Self {
        Self { connection, ends: Box::pin(sleep(LONGEST)) }
    }

    /// Puts the end off where something has passed.
    fn passed<T>(&mut self, passing: Poll<Result<T>>) -> Poll<Result<T>> {
        if matches!(passing, Poll::Ready(Ok(_))) {
            self.ends.as_mut().reset(Instant::now() + LONGEST);
        }
        passing
    }
}

impl<Io: AsyncRead + Unpin> AsyncRead for Audible<Io> {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<Result<()>> {
        let this = self.get_mut();
        let reading = Pin::new(&mut this.connection).poll_read(context, buffer);
        match this.passed(reading) {
            // Whoever serves a connection listens to it all the time, also while it writes: here is the place to look at the clock.
            Poll::Pending => this.ends.as_mut().poll(context).map(|()| Err(Error::new(ErrorKind::TimedOut, "nothing passes"))),
            ready => ready,
        }
    }
}

impl<Io: AsyncWrite + Unpin> AsyncWrite for Audible<Io> {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<Result<usize>> {
        let this = self.get_mut();
        let writing = Pin::new(&mut this.connection).poll_write(context, bytes);
        this.passed(writing)
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.get_mut().connection).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.get_mut().connection).poll_shutdown(context)
    }

    fn poll_write_vectored(self: Pin<&mut Self>, context: &mut Context<'_>, parts: &[IoSlice<'_>]) -> Poll<Result<usize>> {
        let this = self.get_mut();
        let writing = Pin::new(&mut this.connection).poll_write_vectored(context, parts);
        this.passed(writing)
    }

    fn is_write_vectored(&self) -> bool {
        self.connection.is_write_vectored()
    }
}

#[cfg(test)]
mod tests {
    use axum::Router;
    use axum::routing::get;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};
    use tokio::net::{TcpListener, TcpStream};
    use tokio::time::timeout;

    use super::*;

    #[tokio::test]
    async fn a_server_that_is_to_end_waits_for_no_client_that_does_not_read_its_answer() {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        // More than the system takes on its way.
        let pages = Router::new().route("/", get(|| async { vec![0_u8; 64 << 20] }));
        let shutdown = Shutdown::new();
        let asked = shutdown.clone();
        let serving = axum::serve(Listener(listener), pages).with_graceful_shutdown(async move { asked.requested().await });
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
            served = until_answered(serving.into_future(), &shutdown) => served.expect("it ends"),
            () = reads_little => {}
            () = sleep(LONGEST / 2) => panic!("it waits for the client"),
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_connection_ends_when_nothing_passes_either_way_and_not_before() {
        let (mut peer, connection) = duplex(64);
        let (mut connection, mut byte) = (Audible::new(connection), [0]);
        for _ in 0..3 {
            sleep(LONGEST * 3 / 4).await;
            peer.write_all(b"a").await.expect("said");
            connection.read_exact(&mut byte).await.expect("heard");
        }
        sleep(LONGEST * 3 / 4).await;
        connection.write_all(b"b").await.expect("answered");
        sleep(LONGEST * 3 / 4).await;
        assert!(timeout(LONGEST / 8, connection.read(&mut byte)).await.is_err(), "what was written has passed, too");
        let end = timeout(LONGEST, connection.read(&mut byte)).await.expect("an end");
        assert_eq!(end.expect_err("silent").kind(), ErrorKind::TimedOut);
    }
}
