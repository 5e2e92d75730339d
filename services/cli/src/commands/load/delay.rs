//! A slower way to a router: what goes either way through it arrives so much later, in order, at whatever rate it came.

use std::io;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;

use crate::failure::Failure;

/// Pieces that may be on their way at once; then the sender waits, as it would for a full link.
const ON_THE_WAY: usize = 4096;
/// The largest piece, bytes.
const PIECE: usize = 64 << 10;

/// Listens on this machine until dropped.
pub struct DelayedLink {
    endpoint: String,
    serving: JoinHandle<()>,
}

impl Drop for DelayedLink {
    fn drop(&mut self) {
        self.serving.abort();
    }
}

impl DelayedLink {
    /// A link to `endpoint`, `tcp/…`.
    pub async fn to(endpoint: &str, delay: Duration) -> Result<Self, Failure> {
        let address = endpoint.strip_prefix("tcp/").map(str::to_owned);
        let address = address.ok_or_else(|| Failure::bad_input("fault", "delay: only tcp/ links can be delayed; leave --secured out"))?;
        let listener = TcpListener::bind("127.0.0.1:0").await.map_err(Failure::other)?;
        let endpoint = format!("tcp/{}", listener.local_addr().map_err(Failure::other)?);
        let serving = tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let address = address.clone();
                tokio::spawn(async move {
                    // A router that is away ends the link, as it would without us.
                    if let Ok(far) = TcpStream::connect(&address).await {
                        let _ended = carry(near, far, delay).await;
                    }
                });
            }
        });
        Ok(Self { endpoint, serving })
    }

    /// Where to connect to in place of the router.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }
}

async fn carry(near: TcpStream, far: TcpStream, delay: Duration) -> io::Result<()> {
    near.set_nodelay(true)?;
    far.set_nodelay(true)?;
    let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
    tokio::select! {
        ended = pump(near_in, far_out, delay) => ended,
        ended = pump(far_in, near_out, delay) => ended,
    }
}

async fn pump(mut from: impl AsyncReadExt + Unpin, mut to: impl AsyncWriteExt + Unpin, delay: Duration) -> io::Result<()> {
    let (sender, mut pieces) = mpsc::channel::<(Instant, Vec<u8>)>(ON_THE_WAY);
    let read = async move {
        let mut buffer = vec![0; PIECE];
        loop {
            let count = from.read(&mut buffer).await?;
            if count == 0 || sender.send((Instant::now() + delay, buffer[..count].to_vec())).await.is_err() {
                return Ok(());
            }
        }
    };
    let write = async move {
        while let Some((due, piece)) = pieces.recv().await {
            tokio::time::sleep_until(due).await;
            to.write_all(&piece).await?;
        }
        io::Result::Ok(())
    };
    tokio::try_join!(read, write).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn what_goes_through_arrives_later_and_whole() {
        let router = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let endpoint = format!("tcp/{}", router.local_addr().expect("an address"));
        tokio::spawn(async move {
            let (mut link, _) = router.accept().await.expect("a link");
            let (mut from, mut to) = link.split();
            let _ended = tokio::io::copy(&mut from, &mut to).await;
        });
        let delay = Duration::from_millis(60);
        let link = DelayedLink::to(&endpoint, delay).await.unwrap_or_else(|e| panic!("{e:?}"));
        let mut near = TcpStream::connect(link.endpoint().trim_start_matches("tcp/")).await.expect("a link");
        let (sent, began) = ((0..200_000u32).flat_map(u32::to_le_bytes).collect::<Vec<u8>>(), Instant::now());
        let mut back = vec![0; sent.len()];
        let (mut from, mut to) = near.split();
        tokio::try_join!(to.write_all(&sent), from.read_exact(&mut back)).expect("there and back");
        assert_eq!(back, sent);
        assert!(began.elapsed() >= 2 * delay, "{:?}", began.elapsed());
        assert!(DelayedLink::to("quic/127.0.0.1:1", delay).await.is_err());
    }
}
