//! Names of topics, services and nodes, the keys that they become, and quality of service as tokens say it.

use super::type_hash::TypeName;

/// The quality of service of an endpoint, as far as `rmw_zenoh` acts on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Qos {
    /// Whether messages wait for room; otherwise they are dropped.
    pub reliable: bool,
    /// Whether a late subscriber gets the last messages.
    pub transient_local: bool,
    /// How many messages are kept.
    pub depth: u32,
}

impl Qos {
    /// Reliable, the last ten.
    pub const DEFAULT: Self = Self { reliable: true, transient_local: false, depth: 10 };
    /// What sensors publish: the newest, or none.
    pub const SENSOR: Self = Self { reliable: false, transient_local: false, depth: 5 };
    /// Kept for those who come late: static transforms, states of goals.
    pub const KEPT: Self = Self { reliable: true, transient_local: true, depth: 100 };

    /// `reliability:durability:history,depth:deadline:lifespan:liveliness`, where what is empty is the default.
    pub fn encode(self) -> String {
        let reliability = if self.reliable { "" } else { "2" };
        let durability = if self.transient_local { "1" } else { "" };
        format!("{reliability}:{durability}:,{}:,:,:,,", self.depth)
    }
}

/// A name that is none.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name:?} is no name of ROS: {reason}")]
pub struct NameError {
    /// The name.
    pub name: String,
    /// Why not.
    pub reason: &'static str,
}

/// Checks a fully qualified name, `/camera/depth/image_raw`.
///
/// # Errors
/// [`NameError`] that says why not.
pub fn check(name: &str) -> Result<(), NameError> {
    let wrong = |reason| Err(NameError { name: name.to_owned(), reason });
    let Some(rest) = name.strip_prefix('/') else { return wrong("it has to begin with /") };
    for part in rest.split('/') {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if part.is_empty() || !part.chars().all(good) {
            return wrong("its parts are letters, digits and _, and none is empty");
        }
        if part.starts_with(|c: char| c.is_ascii_digit()) {
            return wrong("no part begins with a digit");
        }
    }
    Ok(())
}

/// The key of a topic's messages or a service's requests: `0/camera/depth/sensor_msgs::msg::dds_::Image_/RIHS01_…`.
pub fn key(domain: u32, name: &str, of: &TypeName) -> String {
    key_of_hash(domain, name, of, &of.hash)
}

/// The same with another hash, or `*` for every one.
pub fn key_of_hash(domain: u32, name: &str, of: &TypeName, hash: &str) -> String {
    format!("{domain}/{}/{}/{hash}", name.trim_matches('/'), of.dds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::type_hash::type_named;

    #[test]
    fn keys_and_qos_are_as_rmw_zenoh_writes_them() {
        let image = type_named("sensor_msgs/msg/Image").expect("a shipped type");
        assert_eq!(
            key(7, "/camera/depth/image_raw", &image),
            "7/camera/depth/image_raw/sensor_msgs::msg::dds_::Image_/RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
        );
        assert_eq!(Qos::DEFAULT.encode(), "::,10:,:,:,,");
        assert_eq!(Qos::SENSOR.encode(), "2::,5:,:,:,,");
        assert_eq!(Qos::KEPT.encode(), ":1:,100:,:,:,,");
    }

    #[test]
    fn what_is_no_name_is_refused() {
        assert_eq!(check("/camera_1/depth"), Ok(()));
        for name in ["camera", "/", "/a//b", "/a/", "/a b", "/1a", "/a/**"] {
            assert!(check(name).is_err(), "{name}");
        }
    }
}
