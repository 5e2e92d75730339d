//! The page over TLS: a listener whose handshakes do not wait for one another, and whose certificate may be renewed while it listens.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

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

/// How often it is looked whether certificate or key were renewed. They are valid for some weeks, and a console runs for longer.
const LOOK: Duration = Duration::from_secs(60);

/// Makes TLS connections of TCP connections.
pub struct Acceptor {
    tls: TlsAcceptor,
    certificate: PathBuf,
    private_key: PathBuf,
    /// When the two files were written that it was read from.
    written: [Option<SystemTime>; 2],
    /// What was wrong with those that were to take their place.
    fault: Option<String>,
}

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
        // Looked at before they are read: what replaces them meanwhile is then seen as new.
        let written = [written(certificate), written(private_key)];
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
        let tls = TlsAcceptor::from(Arc::new(config));
        Ok(Self { tls, certificate: certificate.to_owned(), private_key: private_key.to_owned(), written, fault: None })
    }

    /// Takes up certificate and key where they were renewed. Those of before stay until both are good: one of the files is written first.
    fn look_again(&mut self) {
        if [written(&self.certificate), written(&self.private_key)] == self.written {
            return;
        }
        match Self::read(&self.certificate, &self.private_key) {
            Ok(renewed) => {
                tracing::info!(certificate = %self.certificate.display(), "the certificate was renewed");
                *self = renewed;
            }
            Err(error) => {
                let fault = error.to_string();
                if self.fault.as_ref() != Some(&fault) {
                    tracing::warn!("the certificate of before stays in use: {fault}");
                    self.fault = Some(fault);
                }
            }
        }
    }
}

/// When a file was written; none of one that is not there.
fn written(file: &Path) -> Option<SystemTime> {
    std::fs::metadata(file).and_then(|metadata| metadata.modified()).ok()
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

async fn accept(listener: TcpListener, mut acceptor: Acceptor, to: mpsc::Sender<(TlsStream<TcpStream>, SocketAddr)>) {
    let mut looks = tokio::time::interval(LOOK);
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            _ = looks.tick() => {
                acceptor.look_again();
                continue;
            }
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(PAUSE).await;
                continue;
            }
        };
        let (tls, to) = (acceptor.tls.clone(), to.clone());
        tokio::spawn(async move {
            match tokio::time::timeout(HANDSHAKE_WITHIN, tls.accept(stream)).await {
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

#[cfg(test)]
mod tests {
    use std::fs::{File, copy, write};

    use super::*;

    #[test]
    fn a_certificate_that_is_renewed_is_taken_up_and_half_of_one_is_not() {
        let (folder, made) = (tempfile::tempdir().expect("a folder"), Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/tls")));
        let [certificate, private_key] = ["localhost.pem", "localhost.key"].map(|name| {
            copy(made.join(name), folder.path().join(name)).expect("a copy");
            folder.path().join(name)
        });
        let mut acceptor = Acceptor::read(&certificate, &private_key).expect("a certificate and its key");
        let first = acceptor.written;
        let written_later = |seconds: u64| {
            let file = File::options().write(true).open(&certificate).expect("the file");
            file.set_modified(first[0].expect("a time") + Duration::from_secs(seconds)).expect("a time of writing");
        };
        acceptor.look_again();
        assert_eq!((acceptor.written, &acceptor.fault), (first, &None));
        write(&certificate, "-----BEGIN CERTIFICATE-----").expect("written");
        written_later(10);
        acceptor.look_again();
        assert!(acceptor.written == first && acceptor.fault.is_some(), "what was good stays in use");
        copy(made.join("localhost.pem"), &certificate).expect("a copy");
        written_later(20);
        acceptor.look_again();
        assert!(acceptor.written != first && acceptor.fault.is_none());
    }
}
