//! The page over TLS: a listener whose handshakes do not wait for one another.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};
use tokio_rustls::server::TlsStream;

use crate::ConsoleError;

/// How long a handshake may take.
const HANDSHAKE_WITHIN: Duration = Duration::from_secs(10);
/// Connections whose handshake is done and that wait to be served.
const WAITING: usize = 64;
/// How long to wait before accepting again when the system is out of something.
const PAUSE: Duration = Duration::from_millis(100);

/// Makes TLS connections of TCP connections.
#[derive(Clone)]
pub struct Acceptor(TlsAcceptor);

impl Acceptor {
    /// Reads a certificate chain and its key, PEM.
    ///
    /// # Errors
    /// [`ConsoleError::Config`] that names the field of the file at fault.
    pub fn read(certificate: &Path, private_key: &Path) -> Result<Self, ConsoleError> {
        let fail = |field: &'static str, file: &Path, e: &dyn std::fmt::Display| ConsoleError::Config {
            field,
            message: format!("{}: {e}", file.display()),
        };
        let chain: Vec<CertificateDer<'static>> =
            CertificateDer::pem_file_iter(certificate).and_then(Iterator::collect).map_err(|e| fail("certificate", certificate, &e))?;
        let key = PrivateKeyDer::from_pem_file(private_key).map_err(|e| fail("private_key", private_key, &e))?;
        let of_both = |e: rustls::Error| fail("certificate", certificate, &e);
        let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(of_both)?
            .with_no_client_auth()
            .with_single_cert(chain, key)
            .map_err(of_both)?;
        Ok(Self(TlsAcceptor::from(Arc::new(config))))
    }
}

/// A listener of TLS connections.
pub struct Listener {
    connections: mpsc::Receiver<(TlsStream<TcpStream>, SocketAddr)>,
    address: SocketAddr,
}

impl Listener {
    /// Accepts until it is dropped.
    ///
    /// # Errors
    /// When the listener's address cannot be told.
    pub fn new(listener: TcpListener, acceptor: Acceptor) -> std::io::Result<Self> {
        let address = listener.local_addr()?;
        let (sender, connections) = mpsc::channel(WAITING);
        tokio::spawn(async move {
            tokio::select! {
                () = accept(listener, acceptor, sender.clone()) => {}
                () = sender.closed() => {}
            }
        });
        Ok(Self { connections, address })
    }
}

async fn accept(listener: TcpListener, acceptor: Acceptor, to: mpsc::Sender<(TlsStream<TcpStream>, SocketAddr)>) {
    loop {
        let (stream, peer) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        let (acceptor, to) = (acceptor.0.clone(), to.clone());
        tokio::spawn(async move {
            match tokio::time::timeout(HANDSHAKE_WITHIN, acceptor.accept(stream)).await {
                // A listener that is gone serves nobody.
                Ok(Ok(stream)) => drop(to.send((stream, peer)).await),
                Ok(Err(error)) => tracing::debug!(%peer, %error, "no TLS connection"),
                Err(_) => tracing::debug!(%peer, "the TLS handshake took too long"),
            }
        });
    }
}

impl axum::serve::Listener for Listener {
    type Io = TlsStream<TcpStream>;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        match self.connections.recv().await {
            Some(connection) => connection,
            // The accepting task ends only with this listener.
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> std::io::Result<SocketAddr> {
        Ok(self.address)
    }
}
