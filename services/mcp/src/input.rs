//! What an agent writes on standard input, and when that ends.
//!
//! The protocol's kit lets a call go on for seconds after the input has ended, so that its answer is still written to whoever reads on. An arm is not
//! to move for that long for an agent that is gone.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use repose_runtime::CancellationToken;
use tokio::io::{AsyncRead, ReadBuf};

/// A stream that says when it has ended.
pub struct AgentInput<R> {
    stream: R,
    ended: CancellationToken,
}

impl<R> AgentInput<R> {
    /// What is read from `stream`.
    pub fn new(stream: R) -> Self {
        Self { stream, ended: CancellationToken::new() }
    }

    /// Is cancelled when nothing comes any more: the agent has closed its end, or is gone, or the stream has failed.
    pub fn ended(&self) -> CancellationToken {
        self.ended.clone()
    }
}

impl<R: AsyncRead + Unpin> AsyncRead for AgentInput<R> {
    fn poll_read(self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let input = self.get_mut();
        let room = buffer.remaining();
        let read = Pin::new(&mut input.stream).poll_read(context, buffer);
        let has_ended = match &read {
            Poll::Ready(Ok(())) => room > 0 && buffer.remaining() == room,
            Poll::Ready(Err(_)) => true,
            Poll::Pending => false,
        };
        if has_ended {
            input.ended.cancel();
        }
        read
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt as _;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    use super::*;

    /// Cannot be read.
    struct Broken;

    impl AsyncRead for Broken {
        fn poll_read(self: Pin<&mut Self>, _: &mut Context<'_>, _: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
            Poll::Ready(Err(io::ErrorKind::BrokenPipe.into()))
        }
    }

    #[tokio::test]
    async fn the_end_of_an_input_is_told_and_no_pause_is() {
        let (mut agent, stream) = tokio::io::duplex(64);
        let mut input = AgentInput::new(stream);
        let (ended, mut read) = (input.ended(), [0; 64]);
        agent.write_all(b"asked").await.expect("written");
        assert_eq!(input.read(&mut read).await.expect("read"), 5);
        assert!(input.read(&mut read).now_or_never().is_none() && !ended.is_cancelled());
        drop(agent);
        assert_eq!(input.read(&mut read).await.expect("read"), 0);
        assert!(ended.is_cancelled());

        let mut broken = AgentInput::new(Broken);
        let ended = broken.ended();
        broken.read(&mut read).await.expect_err("it is broken");
        assert!(ended.is_cancelled());
    }
}
