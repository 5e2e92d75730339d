//! Who may do what, and whose pages may ask: tokens and roles, `Host` and `Origin`.
//!
//! A browser sends whatever a page asks it to, also to this machine's loopback. So a request must name a host that is an address, `localhost`
//! or configured (else a page elsewhere could give its own name this address), and must come from a page of that same host.

use repose_proto::{CallError, ErrorCode};
use repose_runtime::{AccessToken, host_name, is_own_host};
use serde::Serialize;

use crate::{ConsoleConfig, ConsoleError};

/// The cookie that carries the token.
pub const COOKIE: &str = "repose_console";

/// What somebody may do. Each may what the ones before may; everybody may stop a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Looks.
    Viewer,
    /// Also asks for placements and motion plans.
    Planner,
    /// Also moves the robot and clears its stop.
    Operator,
}

impl Role {
    /// Refuses what this role may not do.
    ///
    /// # Errors
    /// `failed_precondition` that says which role it takes.
    pub fn check(self, needed: Self) -> Result<(), CallError> {
        if self >= needed {
            return Ok(());
        }
        let name = |role: Self| match role {
            Self::Viewer => "viewer",
            Self::Planner => "planner",
            Self::Operator => "operator",
        };
        Err(CallError::new(ErrorCode::FailedPrecondition, format!("this takes the role {}; yours is {}", name(needed), name(self))))
    }
}

/// The tokens, and what each is good for.
pub struct Access {
    tokens: Vec<(AccessToken, Role)>,
    hosts: Vec<String>,
}

impl Access {
    /// Reads the token files.
    ///
    /// # Errors
    /// [`ConsoleError::Config`] that names the field of a file that cannot be read or holds no good token.
    pub fn read(config: &ConsoleConfig) -> Result<Self, ConsoleError> {
        let files = [
            ("operator_token", &config.operator_token, Role::Operator),
            ("planner_token", &config.planner_token, Role::Planner),
            ("viewer_token", &config.viewer_token, Role::Viewer),
        ];
        let given = files.into_iter().filter_map(|(field, file, role)| Some((field, file.as_deref()?, role)));
        let unread = |field, e: CallError| ConsoleError::Config { field, message: e.message };
        let read = |(field, file, role)| AccessToken::read(field, file).map(|token| (token, role)).map_err(|e| unread(field, e));
        let tokens = given.map(read).collect::<Result<_, ConsoleError>>()?;
        Ok(Self { tokens, hosts: config.hosts.clone() })
    }

    /// The role of whoever shows this token. Without configured tokens everybody is an operator: only this machine is listened to then.
    pub fn role_of(&self, token: Option<&str>) -> Option<Role> {
        if self.tokens.is_empty() {
            return Some(Role::Operator);
        }
        let shown = token?;
        self.tokens.iter().find(|(token, _)| token.is(shown)).map(|(_, role)| *role)
    }

    /// Whether a request may be looked at, by its `Host`, its `Origin` and what the browser says of where it comes from.
    ///
    /// # Errors
    /// What is wrong, for a person.
    pub fn admits(&self, host: Option<&str>, origin: Option<&str>, fetch_site: Option<&str>) -> Result<(), String> {
        let host = host.ok_or("the request names no host")?;
        if !is_own_host(host, &self.hosts) {
            let name = host_name(host);
            return Err(format!("{name:?} is no name of this console: expected an address, localhost or one of [console] hosts"));
        }
        if let Some(origin) = origin {
            let authority = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
            if authority != Some(host) {
                return Err(format!("a page of {origin} may not ask this console"));
            }
        }
        match fetch_site {
            Some("cross-site" | "same-site") => Err("a page of another site may not ask this console".to_owned()),
            _ => Ok(()),
        }
    }
}

/// The token in a `Cookie` header.
pub fn token_in(cookies: &str) -> Option<&str> {
    cookies.split(';').find_map(|cookie| cookie.trim().strip_prefix(COOKIE)?.strip_prefix('='))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(hosts: &[&str]) -> Access {
        Access { tokens: Vec::new(), hosts: hosts.iter().map(|h| (*h).to_owned()).collect() }
    }

    #[test]
    fn a_page_of_another_site_is_refused_and_one_of_ours_is_not() {
        let access = open(&["cell.example"]);
        let cases = [
            ("127.0.0.1:7448", Some("http://127.0.0.1:7448"), None, true),
            ("localhost:7448", Some("http://localhost:7448"), Some("same-origin"), true),
            ("[::1]:7448", Some("http://[::1]:7448"), None, true),
            ("cell.example", Some("https://cell.example"), None, true),
            ("127.0.0.1:7448", None, Some("none"), true),
            ("127.0.0.1:7448", Some("http://evil.example"), None, false),
            ("127.0.0.1:7448", Some("http://127.0.0.1:9999"), None, false),
            ("127.0.0.1:7448", Some("null"), None, false),
            ("127.0.0.1:7448", None, Some("cross-site"), false),
            // Another's name that was given our address.
            ("evil.example:7448", Some("http://evil.example:7448"), None, false),
            ("localhost.evil.example:7448", None, None, false),
        ];
        for (host, origin, site, may) in cases {
            assert_eq!(access.admits(Some(host), origin, site).is_ok(), may, "{host} {origin:?} {site:?}");
        }
        assert!(access.admits(None, None, None).is_err());
    }

    #[test]
    fn tokens_give_roles_and_without_tokens_everybody_here_operates() {
        assert_eq!(open(&[]).role_of(None), Some(Role::Operator));
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str, token: &str| {
            std::fs::write(folder.path().join(name), token).expect("written");
            Some(folder.path().join(name))
        };
        let viewer_token = write("viewer", "a-long-viewer-token\n");
        let operator_token = write("operator", "a-long-operator-token\n");
        let mut config = ConsoleConfig { viewer_token, operator_token, ..ConsoleConfig::default() };
        let access = Access::read(&config).expect("good tokens");
        assert_eq!(access.role_of(Some("a-long-viewer-token")), Some(Role::Viewer));
        assert_eq!(access.role_of(Some("a-long-operator-token")), Some(Role::Operator));
        assert_eq!((access.role_of(Some("a-guess")), access.role_of(None)), (None, None));
        config.planner_token = write("planner", "short");
        assert!(Access::read(&config).err().is_some_and(|e| e.to_string().contains("planner_token")));
    }

    #[test]
    fn a_role_is_refused_what_it_may_not_do_in_words() {
        assert!(Role::Operator.check(Role::Planner).is_ok());
        let refusal = Role::Viewer.check(Role::Operator).unwrap_err();
        assert!(refusal.message.contains("operator") && refusal.message.contains("viewer"), "{refusal}");
    }

    #[test]
    fn the_token_is_found_among_cookies() {
        assert_eq!(token_in("a=b; repose_console=xyz; c=d"), Some("xyz"));
        assert_eq!(token_in("not_repose_console=xyz"), None);
    }
}
