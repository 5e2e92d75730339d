//! What goes along with every message, request and response: 33 bytes.

use bytes::Bytes;

/// Sequence number (8 bytes), instant (8), length (1), id (16); little-endian.
pub const BYTES: usize = 33;

/// Who sent something, as its how manieth, and when.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Attachment {
    /// Counts what an endpoint sends; a response has its request's.
    pub sequence: i64,
    /// Nanoseconds since the Unix epoch.
    pub stamp_ns: i64,
    /// The endpoint; a response has its request's.
    pub gid: [u8; 16],
}

impl Attachment {
    /// As it is sent.
    pub fn encode(&self) -> Bytes {
        let mut bytes = Vec::with_capacity(BYTES);
        bytes.extend(self.sequence.to_le_bytes());
        bytes.extend(self.stamp_ns.to_le_bytes());
        bytes.push(self.gid.len() as u8);
        bytes.extend(self.gid);
        bytes.into()
    }

    /// Reads what came; none of anything else.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (sequence, rest) = bytes.split_first_chunk::<8>()?;
        let (stamp_ns, rest) = rest.split_first_chunk::<8>()?;
        let (length, gid) = rest.split_first()?;
        let gid: [u8; 16] = gid.try_into().ok()?;
        (usize::from(*length) == gid.len()).then(|| Self {
            sequence: i64::from_le_bytes(*sequence),
            stamp_ns: i64::from_le_bytes(*stamp_ns),
            gid,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attachment_is_33_bytes_as_rmw_zenoh_writes_them() {
        let attachment = Attachment { sequence: 1, stamp_ns: 0x0102_0304_0506_0708, gid: std::array::from_fn(|i| i as u8) };
        let bytes = attachment.encode();
        let golden = [1, 0, 0, 0, 0, 0, 0, 0, 8, 7, 6, 5, 4, 3, 2, 1, 16, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
        assert_eq!(bytes.as_ref(), golden);
        assert_eq!(Attachment::decode(&bytes), Some(attachment));
        assert_eq!(Attachment::decode(&bytes[..32]), None);
        assert_eq!(Attachment::decode(b""), None);
    }
}
