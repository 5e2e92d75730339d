//! Who else is there: the endpoints of a domain, as their tokens say.

use std::collections::BTreeSet;

use repose_runtime::AliveWatch;

use super::endpoints::Node;
use crate::error::BridgeError;
use crate::wire::token::{self, Endpoint, EntityKind};
use crate::wire::type_hash::TypeName;

/// The endpoints of a domain, kept up to date.
pub struct Graph {
    watch: AliveWatch,
}

impl Graph {
    /// Follows a node's domain.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn follow(node: &Node) -> Result<Self, BridgeError> {
        Ok(Self { watch: node.session().watch_alive(&token::all(node.domain())).await? })
    }

    /// Waits until somebody has come or gone; false when the session has closed. Cancel safe.
    pub async fn changed(&mut self) -> bool {
        self.watch.changed().await
    }

    /// Everybody's endpoints.
    pub fn endpoints(&mut self) -> BTreeSet<Endpoint> {
        self.watch.current().iter().filter_map(|token| token::parse(token)).collect()
    }
}

/// What is wrong with the others' ends of a topic or service: they are there, and of another type, so that nothing can be exchanged.
pub fn mismatch(endpoints: &BTreeSet<Endpoint>, kind: EntityKind, name: &str, expected: &TypeName) -> Option<String> {
    let others: Vec<&Endpoint> = endpoints.iter().filter(|e| e.kind == kind && e.topic == name).collect();
    if others.iter().any(|e| e.dds == expected.dds && e.hash == expected.hash) {
        return None;
    }
    let other = others.first()?;
    let said = other.dds.trim_end_matches('_').replace("::dds_::", "::").replace("::", "/");
    Some(if other.dds == expected.dds {
        format!("{name}: {} has another version of {}, with hash {} and not {}", other.node, expected.name, other.hash, expected.hash)
    } else {
        format!("{name}: {} has {said}, expected {}", other.node, expected.name)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::type_hash::type_named;

    fn endpoint(dds: &str, hash: &str) -> Endpoint {
        let [topic, node, session] = ["/camera/depth", "/driver", "1"].map(str::to_owned);
        Endpoint { kind: EntityKind::Publisher, topic, dds: dds.to_owned(), hash: hash.to_owned(), node, session }
    }

    #[test]
    fn an_end_of_another_type_or_version_is_told_unless_a_right_one_is_there_too() {
        let image = type_named("sensor_msgs/msg/Image").expect("a shipped type");
        let with = |ends: &[Endpoint]| mismatch(&ends.iter().cloned().collect(), EntityKind::Publisher, "/camera/depth", &image);
        let (cloud, old) = (endpoint("sensor_msgs::msg::dds_::PointCloud2_", "RIHS01_1"), endpoint(&image.dds, "RIHS01_2"));
        assert_eq!(with(&[]), None);
        let told = with(std::slice::from_ref(&cloud)).expect("a mismatch");
        assert_eq!(told, "/camera/depth: /driver has sensor_msgs/msg/PointCloud2, expected sensor_msgs/msg/Image");
        assert!(with(&[old]).expect("a mismatch").contains("another version"));
        assert_eq!(with(&[cloud, endpoint(&image.dds, &image.hash)]), None);
    }
}
