//! Why a session cannot be opened. Zenoh says "unable to connect" for everything; an operator needs to know which of it: the address, the
//! certificate, or the user.
//!
//! One handshake of our own with each endpoint tells. Where the handshake is good, what remains is that the router does not know the user.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use quinn::crypto::rustls::QuicClientConfig;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio::time::timeout;

/// How long an endpoint may take to answer.
const ANSWER: Duration = Duration::from_millis(1500);
/// How long a router may take to refuse a certificate after the handshake, as TLS 1.3 does.
const REFUSAL: Duration = Duration::from_millis(400);
/// The names under which Zenoh speaks over QUIC (ALPN).
const PROTOCOLS: [&[u8]; 4] = [b"zenoh-ms", b"zenoh", b"zenoh-ms-mr", b"zenoh-mr"];

/// What an endpoint turned out to be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Finding {
    /// It may come yet: a router that is not up.
    Absent(String),
    /// It will not get better by itself.
    Refused(String),
    /// The link is good; the router is asked who this is.
    Good,
}

/// What Zenoh's configuration says of certificates and users.
pub(crate) struct Credentials {
    authority: Option<String>,
    certificate: Option<String>,
    key: Option<String>,
    user: Option<String>,
}

impl Credentials {
    pub(crate) fn of(config: &zenoh::Config) -> Self {
        let text = |key: &str| config.get_json(key).ok().and_then(|json| serde_json::from_str::<Option<String>>(&json).ok()?);
        let is_mutual = config.get_json("transport/link/tls/enable_mtls").is_ok_and(|json| json == "true");
        Self {
            authority: text("transport/link/tls/root_ca_certificate"),
            certificate: text("transport/link/tls/connect_certificate").filter(|_| is_mutual),
            key: text("transport/link/tls/connect_private_key").filter(|_| is_mutual),
            user: text("transport/auth/usrpwd/user"),
        }
    }

    /// Whether a user is named, by a password or a certificate.
    pub(crate) fn name_user(&self) -> bool {
        self.user.is_some() || self.certificate.is_some()
    }

    /// What to say when the link is good and the router lets nobody in.
    pub(crate) fn not_let_in(&self) -> String {
        match (&self.user, &self.certificate) {
            (Some(user), _) => {
                format!("the router does not let the user {user:?} in: the password is wrong, or it does not know that user")
            }
            (None, Some(_)) => "the router does not let this certificate's user in: does it ask for a password, too?".to_owned(),
            (None, None) => {
                "the router asks who this is, and the configuration names no user (zenoh_file with a user and password)".to_owned()
            }
        }
    }

    fn client_config(&self) -> Result<rustls::ClientConfig, String> {
        let mut roots = rustls::RootCertStore { roots: webpki_roots::TLS_SERVER_ROOTS.to_vec() };
        if let Some(file) = &self.authority {
            for certificate in CertificateDer::pem_file_iter(file).map_err(|e| format!("root_ca_certificate {file}: {e}"))? {
                let certificate = certificate.map_err(|e| format!("root_ca_certificate {file}: {e}"))?;
                roots.add(certificate).map_err(|e| format!("root_ca_certificate {file}: {e}"))?;
            }
        }
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let builder = rustls::ClientConfig::builder_with_provider(provider).with_protocol_versions(&[&rustls::version::TLS13]);
        let builder = builder.map_err(|e| e.to_string())?.with_root_certificates(roots);
        let mut config = match (&self.certificate, &self.key) {
            (Some(certificate), Some(key)) => {
                let chain = CertificateDer::pem_file_iter(certificate).and_then(Iterator::collect::<Result<Vec<_>, _>>);
                let chain = chain.map_err(|e| format!("connect_certificate {certificate}: {e}"))?;
                let key = PrivateKeyDer::from_pem_file(key).map_err(|e| format!("connect_private_key {key}: {e}"))?;
                builder.with_client_auth_cert(chain, key).map_err(|e| format!("connect_certificate {certificate}: {e}"))?
            }
            _ => builder.with_no_client_auth(),
        };
        config.alpn_protocols = PROTOCOLS.iter().map(|name| name.to_vec()).collect();
        Ok(config)
    }
}

/// Looks at an endpoint.
pub(crate) async fn look_at(endpoint: &str, credentials: &Credentials) -> Finding {
    let (protocol, rest) = endpoint.split_once('/').unwrap_or(("", endpoint));
    let address = rest.split(['?', '#']).next().unwrap_or(rest);
    if !["tcp", "quic"].contains(&protocol) {
        return Finding::Absent(format!("nothing answers at {endpoint}"));
    }
    let resolved = match tokio::net::lookup_host(address).await {
        Ok(mut addresses) => addresses.next(),
        Err(error) => return Finding::Refused(format!("{endpoint}: the address cannot be used: {error}")),
    };
    let Some(resolved) = resolved else { return Finding::Refused(format!("{endpoint}: the name has no address")) };
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host).trim_matches(['[', ']']);
    match protocol {
        "tcp" => look_at_tcp(endpoint, resolved).await,
        _ => look_at_quic(endpoint, resolved, host, credentials).await,
    }
}

async fn look_at_tcp(endpoint: &str, address: SocketAddr) -> Finding {
    match timeout(ANSWER, tokio::net::TcpStream::connect(address)).await {
        Ok(Ok(_)) => Finding::Good,
        Ok(Err(error)) => Finding::Absent(format!(
            "nothing listens at {endpoint} ({error}): is a router running there (`repose up` or `repose serve router`)? One with certificates \
             is reached by quic/ and not by tcp/"
        )),
        Err(_) => Finding::Absent(format!("{endpoint} does not answer within {} ms: is it the right address?", ANSWER.as_millis())),
    }
}

async fn look_at_quic(endpoint: &str, address: SocketAddr, host: &str, credentials: &Credentials) -> Finding {
    let config = match credentials.client_config() {
        Ok(config) => config,
        Err(why) => return Finding::Refused(why),
    };
    let crypto = match QuicClientConfig::try_from(config) {
        Ok(crypto) => crypto,
        Err(error) => return Finding::Refused(error.to_string()),
    };
    let any: SocketAddr = if address.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { (std::net::Ipv6Addr::UNSPECIFIED, 0).into() };
    let connecting = quinn::Endpoint::client(any).map_err(|e| e.to_string()).and_then(|endpoint| {
        let config = quinn::ClientConfig::new(Arc::new(crypto));
        let connecting = endpoint.connect_with(config, address, host).map_err(|e| e.to_string())?;
        Ok((endpoint, connecting))
    });
    // The endpoint is kept until the end: it carries the connection.
    let (_endpoint, connecting) = match connecting {
        Ok(both) => both,
        Err(why) => return Finding::Refused(format!("{endpoint}: {why}")),
    };
    match timeout(ANSWER, connecting).await {
        Err(_) => {
            let without_tls = timeout(ANSWER, tokio::net::TcpStream::connect(address)).await.is_ok_and(|connected| connected.is_ok());
            Finding::Absent(match without_tls {
                true => format!("nothing answers at {endpoint}, but something listens there without certificates: tcp/{address}?"),
                false => format!("nothing answers at {endpoint}: is a router running there, and do firewalls let UDP through?"),
            })
        }
        Ok(Err(error)) => of_error(endpoint, host, &error),
        Ok(Ok(connection)) => match timeout(REFUSAL, connection.closed()).await {
            Ok(error) => of_error(endpoint, host, &error),
            Err(_) => Finding::Good,
        },
    }
}

/// A failed handshake in words. What we find of the router's certificate ends it here; what the router finds of ours, there.
fn of_error(endpoint: &str, host: &str, error: &quinn::ConnectionError) -> Finding {
    let (code, reason, is_ours) = match error {
        quinn::ConnectionError::TransportError(error) => (u64::from(error.code), error.reason.clone(), true),
        quinn::ConnectionError::ConnectionClosed(close) => {
            (u64::from(close.error_code), String::from_utf8_lossy(&close.reason).into_owned(), false)
        }
        other => return Finding::Absent(format!("{endpoint}: {other}")),
    };
    // TLS alerts travel as 0x100 and their number (RFC 9001, 4.8; RFC 8446, 6).
    let alert = code.checked_sub(0x100);
    let whose = if is_ours { "the router's certificate" } else { "this user's certificate" };
    let why = match alert {
        _ if is_ours && (reason.contains("NotValidForName") || reason.contains("not valid for name")) => {
            format!("the router's certificate is for another name than {host:?} ({reason})")
        }
        Some(45) => format!("{whose} has expired ({reason})"),
        // An authority of the same name but another key is told by the signature: bad signature, 51.
        Some(48 | 51) if is_ours => format!("the router's certificate is of another authority than root_ca_certificate ({reason})"),
        Some(48 | 51) => "this user's certificate is of another authority than the router's".to_owned(),
        Some(116) => "the router asks for a certificate of the user's (enable_mtls, connect_certificate)".to_owned(),
        Some(120) => "something else than a router answers".to_owned(),
        Some(_) => format!("{whose} is not good ({reason})"),
        None => return Finding::Absent(format!("{endpoint}: {error}")),
    };
    Finding::Refused(format!("{endpoint}: {why}"))
}
