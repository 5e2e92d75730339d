//! Liveliness tokens, by which nodes of ROS 2 see each other: what of them is a node, publishes, subscribes, serves or calls, and as which type.
//!
//! `@ros2_lv/<domain>/<session>/<node>/<entity>/<kind>/<enclave>/<namespace>/<name>[/<topic>/<type>/<hash>/<qos>]`, slashes within as `%`.

use super::names::Qos;
use super::type_hash::TypeName;

/// What a token stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum EntityKind {
    /// A node.
    Node,
    /// A publisher.
    Publisher,
    /// A subscription.
    Subscription,
    /// A service's server.
    Service,
    /// A service's client.
    Client,
}

impl EntityKind {
    const ALL: [(Self, &str); 5] =
        [(Self::Node, "NN"), (Self::Publisher, "MP"), (Self::Subscription, "MS"), (Self::Service, "SS"), (Self::Client, "SC")];

    fn as_str(self) -> &'static str {
        Self::ALL.iter().find(|(kind, _)| *kind == self).map_or("", |(_, name)| name)
    }

    fn parse(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(_, of)| *of == name).map(|(kind, _)| *kind)
    }
}

/// A node of ours.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NodeName {
    /// The domain.
    pub domain: u32,
    /// The session's id.
    pub session: String,
    /// `/`, or `/cell_3`.
    pub namespace: String,
    /// `repose`.
    pub name: String,
}

impl NodeName {
    /// The node's own token.
    pub fn token(&self) -> String {
        self.start(0, EntityKind::Node)
    }

    /// The token of an endpoint, the `id`th of the node's.
    pub fn endpoint(&self, id: u64, kind: EntityKind, topic: &str, of: &TypeName, qos: Qos) -> String {
        let start = self.start(id, kind);
        format!("{start}/{}/{}/{}/{}", mangled(topic), of.dds, of.hash, qos.encode())
    }

    fn start(&self, id: u64, kind: EntityKind) -> String {
        let (domain, session, kind) = (self.domain, &self.session, kind.as_str());
        format!("@ros2_lv/{domain}/{session}/0/{id}/{kind}/%/{}/{}", mangled(&self.namespace), self.name)
    }
}

/// An endpoint of anybody's.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Endpoint {
    /// What it does.
    pub kind: EntityKind,
    /// The topic or service.
    pub topic: String,
    /// Its type, as `pkg::msg::dds_::Type_`.
    pub dds: String,
    /// The type's hash.
    pub hash: String,
    /// Its node, with the namespace.
    pub node: String,
    /// Its session.
    pub session: String,
}

/// The tokens of a domain.
pub fn all(domain: u32) -> String {
    format!("@ros2_lv/{domain}/**")
}

/// The endpoint of a token; none of nodes and of what cannot be read.
pub fn parse(token: &str) -> Option<Endpoint> {
    let parts: Vec<&str> = token.split('/').collect();
    let ["@ros2_lv", _, session, _, _, kind, _, namespace, node, topic, dds, hash, _] = parts[..] else { return None };
    let namespace = unmangled(namespace);
    Some(Endpoint {
        kind: EntityKind::parse(kind)?,
        topic: unmangled(topic),
        dds: dds.to_owned(),
        hash: hash.to_owned(),
        node: format!("{}/{node}", namespace.trim_end_matches('/')),
        session: session.to_owned(),
    })
}

fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

fn unmangled(name: &str) -> String {
    name.replace('%', "/")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::type_hash::type_named;

    #[test]
    fn tokens_are_as_rmw_zenoh_writes_them_and_are_read_again() {
        let node = NodeName { domain: 3, session: "ab12".to_owned(), namespace: "/".to_owned(), name: "repose".to_owned() };
        assert_eq!(node.token(), "@ros2_lv/3/ab12/0/0/NN/%/%/repose");
        let tf = type_named("tf2_msgs/msg/TFMessage").expect("a shipped type");
        let token = node.endpoint(5, EntityKind::Subscription, "/tf_static", &tf, Qos::KEPT);
        assert_eq!(
            token,
            "@ros2_lv/3/ab12/0/5/MS/%/%/repose/%tf_static/tf2_msgs::msg::dds_::TFMessage_/\
             RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087/:1:,100:,:,:,,"
        );
        let endpoint = parse(&token).expect("an endpoint");
        assert_eq!((endpoint.topic.as_str(), endpoint.node.as_str()), ("/tf_static", "/repose"));
        assert_eq!((endpoint.kind, endpoint.hash.as_str()), (EntityKind::Subscription, tf.hash.as_str()));
        assert_eq!(parse(&node.token()), None);
    }
}
