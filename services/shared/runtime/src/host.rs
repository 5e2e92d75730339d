//! The `Host` of requests over HTTP: which names a server goes by.
//!
//! A browser sends whatever a page asks it to, also to this machine's loopback. A page of somewhere else, whose own name was given our
//! address, still comes under its name: so addresses are ours, `localhost` is, and no other name but those that somebody configured.

use std::net::IpAddr;

/// The name or address in a `Host`, without its port and without the brackets of an IPv6 address.
pub fn host_name(host: &str) -> &str {
    match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((address, port)) if port.is_empty() || port.starts_with(':') => address,
        // An address with anything else behind it is none.
        Some(_) => host,
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    }
}

/// Whether a `Host` is one that a server on this machine goes by: an address, `localhost`, or one of `names`, which have no ports.
pub fn is_own_host(host: &str, names: &[String]) -> bool {
    let name = host_name(host);
    let is_named = name.eq_ignore_ascii_case("localhost") || names.iter().any(|known| known.eq_ignore_ascii_case(name));
    is_named || name.parse::<IpAddr>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_told_from_its_port() {
        let cases = [
            ("localhost:7448", "localhost"),
            ("cell.example", "cell.example"),
            ("127.0.0.1:80", "127.0.0.1"),
            ("[::1]:7448", "::1"),
            ("[fe80::1]", "fe80::1"),
        ];
        for (host, name) in cases {
            assert_eq!(host_name(host), name);
        }
    }

    #[test]
    fn addresses_and_names_that_were_told_are_ours_and_no_others_are() {
        let names = ["robot-1.example".to_owned()];
        for host in ["localhost:7449", "LOCALHOST", "192.168.1.20:7449", "[::1]:7449", "[fe80::1]", "Robot-1.example:7449"] {
            assert!(is_own_host(host, &names), "{host}");
        }
        for host in ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "[::1].evil.example", "[::1", "", ":7449"] {
            assert!(!is_own_host(host, &names), "{host}");
        }
    }
}
