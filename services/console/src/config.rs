//! The console's configuration, section `[console]`.

use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::ConsoleError;

/// The port of the page where nothing says otherwise.
pub const PORT: u16 = 7448;
/// The most attempts at a goal, as of `place --attempts`.
const MOST_ATTEMPTS: usize = 10;

/// Configuration of a console process. Unknown fields are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConsoleConfig {
    /// Where the page is served, address and port. Default `127.0.0.1:7448`; beyond loopback it needs `certificate`, `private_key` and a token.
    pub listen: SocketAddr,
    /// Names, without a port, by which browsers may ask for the page. Addresses and `localhost` always may. Every other name is refused, so that
    /// a page of somebody else's cannot reach this one under a name of its own.
    #[serde(deserialize_with = "repose_runtime::list_or_commas")]
    pub hosts: Vec<String>,
    /// The certificate chain, PEM. With `private_key` the page is served over TLS. Where the files are renewed they are taken up within a minute.
    pub certificate: Option<PathBuf>,
    /// The certificate's private key, PEM.
    pub private_key: Option<PathBuf>,
    /// A file with the token of those who may look. Without any token, everybody on this machine may do everything.
    pub viewer_token: Option<PathBuf>,
    /// A file with the token of those who may also ask for placements and plans.
    pub planner_token: Option<PathBuf>,
    /// A file with the token of those who may also move the robot and clear its stop.
    pub operator_token: Option<PathBuf>,
    /// Pages open at once; the next is refused. A quarter of them is for operators alone. Higher: more memory, some 3 MB each.
    pub max_viewers: usize,
    /// The least time between two pictures of a camera, milliseconds. Lower: smoother, more computing and traffic.
    pub picture_period_ms: u64,
    /// The least time between two scenes of a camera, milliseconds. Lower: outlines and cloud follow the picture faster, at 5 MB of traffic a scene.
    pub scene_period_ms: u64,
    /// How often a robot's state is shown, milliseconds.
    pub robot_period_ms: u64,
    /// How often workers' loads are shown, milliseconds.
    pub system_period_ms: u64,
    /// Most points of a cloud that is shown, 1000 to 1000000; denser ones are thinned. Higher: finer, more traffic (11 bytes each).
    pub cloud_points: usize,
    /// Quality of pictures, 1 to 100. Higher: sharper, more traffic.
    pub jpeg_quality: u8,
    /// The deadline of a placement or a motion plan, milliseconds.
    pub request_deadline_ms: u64,
    /// How often an object of a sequence that slips, falls or is not grasped is looked for again and tried anew, the first time counted: 1 to 10.
    pub attempts: usize,
}

impl Default for ConsoleConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from((Ipv4Addr::LOCALHOST, PORT)),
            hosts: Vec::new(),
            certificate: None,
            private_key: None,
            viewer_token: None,
            planner_token: None,
            operator_token: None,
            max_viewers: 32,
            picture_period_ms: 100,
            scene_period_ms: 500,
            robot_period_ms: 50,
            system_period_ms: 500,
            cloud_points: 60_000,
            jpeg_quality: 85,
            request_deadline_ms: 60_000,
            attempts: 3,
        }
    }
}

impl ConsoleConfig {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// [`ConsoleError::Config`] that names the field.
    pub fn validate(&self) -> Result<(), ConsoleError> {
        let check = |good: bool, field: &'static str, message: &str| match good {
            true => Ok(()),
            false => Err(ConsoleError::Config { field, message: message.to_owned() }),
        };
        let both_or_none = self.certificate.is_some() == self.private_key.is_some();
        check(both_or_none, "private_key", "a certificate and its private key go together")?;
        if !self.listen.ip().is_loopback() {
            let reach = format!("{} can be reached from other machines", self.listen);
            check(self.certificate.is_some(), "certificate", &format!("{reach}: that needs TLS, a certificate and a private_key"))?;
            check(self.has_token(), "operator_token", &format!("{reach}: that needs a token, of operators, planners or viewers"))?;
        }
        check(self.max_viewers > 0, "max_viewers", "expected at least 1, got 0")?;
        for (field, period_ms) in [
            ("picture_period_ms", self.picture_period_ms),
            ("scene_period_ms", self.scene_period_ms),
            ("robot_period_ms", self.robot_period_ms),
            ("system_period_ms", self.system_period_ms),
        ] {
            check((10..=60_000).contains(&period_ms), field, &format!("expected 10 to 60000, got {period_ms}"))?;
        }
        let points = self.cloud_points;
        check((1000..=1_000_000).contains(&points), "cloud_points", &format!("expected 1000 to 1000000, got {points}"))?;
        let quality = self.jpeg_quality;
        check((1..=100).contains(&quality), "jpeg_quality", &format!("expected 1 to 100, got {quality}"))?;
        let deadline_ms = self.request_deadline_ms;
        let most = repose_proto::limits::MAX_REMAINING_MS;
        check((1..=most).contains(&deadline_ms), "request_deadline_ms", &format!("expected 1 to {most}, got {deadline_ms}"))?;
        let attempts = self.attempts;
        check((1..=MOST_ATTEMPTS).contains(&attempts), "attempts", &format!("expected 1 to {MOST_ATTEMPTS}, got {attempts}"))
    }

    /// The files of TLS, where it is configured.
    pub fn certificate_and_key(&self) -> Option<(&Path, &Path)> {
        self.certificate.as_deref().zip(self.private_key.as_deref())
    }

    /// What to type into a browser on this machine.
    pub fn url(&self) -> String {
        crate::url(self.listen, self.certificate.is_some())
    }

    fn has_token(&self) -> bool {
        [&self.viewer_token, &self.planner_token, &self.operator_token].into_iter().any(Option::is_some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused_field(config: &ConsoleConfig) -> &'static str {
        match config.validate() {
            Err(ConsoleError::Config { field, .. }) => field,
            other => panic!("expected a refusal, got {other:?}"),
        }
    }

    #[test]
    fn the_defaults_stand_on_loopback_and_other_addresses_need_tls_and_a_token() {
        let mut config = ConsoleConfig::default();
        assert!(config.validate().is_ok() && config.listen.ip().is_loopback());
        config.listen = "0.0.0.0:7448".parse().expect("an address");
        assert_eq!(refused_field(&config), "certificate");
        (config.certificate, config.private_key) = (Some("console.pem".into()), Some("console.key".into()));
        assert_eq!(refused_field(&config), "operator_token");
        config.viewer_token = Some("viewer.token".into());
        assert!(config.validate().is_ok());
    }

    #[test]
    fn values_out_of_range_are_refused_by_name() {
        let refused = |change: fn(&mut ConsoleConfig)| {
            let mut config = ConsoleConfig::default();
            change(&mut config);
            refused_field(&config)
        };
        assert_eq!(refused(|c| c.certificate = Some("console.pem".into())), "private_key");
        assert_eq!(refused(|c| c.robot_period_ms = 0), "robot_period_ms");
        assert_eq!(refused(|c| c.cloud_points = 10), "cloud_points");
        assert_eq!(refused(|c| c.jpeg_quality = 0), "jpeg_quality");
        assert_eq!(refused(|c| c.attempts = 0), "attempts");
        assert_eq!(refused(|c| c.attempts = 11), "attempts");
        assert!(serde_json::from_str::<ConsoleConfig>(r#"{"port": 1}"#).unwrap_err().to_string().contains("unknown field"));
    }
}
