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

/// How long nothing may pass, in either direction, in the middle of a body, an answer or a WebSocket; the next request has to come sooner.
pub(crate) const LONGEST: Duration = Duration::from_secs(300);

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
    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};
    use tokio::time::timeout;

    use super::*;

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
