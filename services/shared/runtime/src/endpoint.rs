//! Endpoints as people write them: checked here, since what Zenoh says of a malformed one is about its own parts.

/// Protocols whose address is a host and a port. `tls/` is refused elsewhere, with what to take in its place.
const WITH_PORT: [&str; 3] = ["tcp", "quic", "tls"];
/// The protocol whose address is a path.
const WITH_PATH: &str = "unixsock-stream";

/// What is wrong with an endpoint, if anything.
pub fn endpoint_fault(endpoint: &str) -> Option<String> {
    // Metadata and settings may follow the address.
    let bare = endpoint.split(['?', '#']).next().unwrap_or_default();
    let is_good = bare.split_once('/').is_some_and(|(protocol, address)| match protocol {
        WITH_PATH => !address.is_empty(),
        _ => WITH_PORT.contains(&protocol) && is_host_and_port(address),
    });
    (!is_good).then(|| format!("expected tcp/HOST:PORT, or quic/HOST:PORT where there are certificates, got {endpoint:?}"))
}

/// Whether a text is a host and a port, `127.0.0.1:9464`.
pub(crate) fn is_host_and_port(text: &str) -> bool {
    let Some((host, port)) = text.rsplit_once(':') else { return false };
    let is_in_brackets = host.starts_with('[') && host.ends_with(']');
    let is_host = !host.is_empty() && !host.contains(['/', ' ']) && (is_in_brackets || !host.contains(':'));
    is_host && port.parse::<u16>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_is_a_protocol_and_an_address() {
        let good = [
            "tcp/127.0.0.1:0",
            "tcp/[::1]:7447",
            "quic/a.example:7447?rel=1;multistream=0",
            "tcp/0.0.0.0:1#iface=eth0",
            "unixsock-stream//tmp/x",
        ];
        assert_eq!(good.map(endpoint_fault), [const { None }; 5]);
        for bad in [
            "127.0.0.1:17447",
            "foo",
            "",
            "tcp/",
            "tcp/host",
            "tcp/:7447",
            "tcp/host:70000",
            "http/host:80",
            "quic/tcp/host:7447",
            "tcp/::1:7447",
        ] {
            assert!(endpoint_fault(bad).is_some_and(|fault| fault.contains(&format!("{bad:?}"))), "{bad}");
        }
    }
}
