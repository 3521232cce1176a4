//! The 33 bytes that go with every message.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 8 | sequence number, i64, from 1 for each publisher |
//! | 8 | 8 | time of sending, i64, nanoseconds of Unix time |
//! | 16 | 1 | 16, the length of what follows (LEB128) |
//! | 17 | 16 | the publisher's [`Gid`] |
//!
//! Little-endian, as zenoh's serialiser has it.

use xxhash_rust::xxh3::xxh3_128;

/// Bytes of an attachment.
pub const ATTACHMENT_BYTES: usize = 33;

/// Names a publisher: XXH3 of its liveliness token, 128 bits, the low 64 first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Gid(pub [u8; 16]);

impl Gid {
    /// Of whoever has declared `token`.
    #[must_use]
    pub fn of_token(token: &str) -> Self {
        Self(xxh3_128(token.as_bytes()).to_le_bytes())
    }
}

/// What goes with one message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Attachment {
    /// From 1, one more for each message of the publisher.
    pub sequence: i64,
    /// When it was sent, nanoseconds of Unix time.
    pub source_time_ns: i64,
    /// Of the publisher.
    pub gid: Gid,
}

impl Attachment {
    /// The bytes.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; ATTACHMENT_BYTES] {
        let mut bytes = [0; ATTACHMENT_BYTES];
        bytes[..8].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.source_time_ns.to_le_bytes());
        bytes[16] = self.gid.0.len() as u8;
        bytes[17..].copy_from_slice(&self.gid.0);
        bytes
    }

    /// Reads one; `None` unless it has 33 bytes and says so of its gid.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let bytes: &[u8; ATTACHMENT_BYTES] = bytes.try_into().ok()?;
        let number = |at: usize| Some(i64::from_le_bytes(*bytes[at..].first_chunk()?));
        let gid = Gid(*bytes[17..].first_chunk()?);
        (usize::from(bytes[16]) == gid.0.len()).then_some(Self {
            sequence: number(0)?,
            source_time_ns: number(8)?,
            gid,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_are_those_worked_out_by_hand() {
        let gid = Gid(std::array::from_fn(|i| 0xA0 + i as u8));
        let attachment = Attachment {
            sequence: 258,
            source_time_ns: -2,
            gid,
        };
        let bytes = attachment.to_bytes();
        assert_eq!(bytes[..8], [2, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!(bytes[8..16], [0xFE, 255, 255, 255, 255, 255, 255, 255]);
        assert_eq!(bytes[16], 16);
        assert_eq!((bytes[17], bytes[32]), (0xA0, 0xAF));
        assert_eq!(Attachment::from_bytes(&bytes), Some(attachment));
    }

    #[test]
    fn other_lengths_are_refused() {
        let bytes = [16; ATTACHMENT_BYTES + 1];
        assert!(Attachment::from_bytes(&bytes[..33]).is_some());
        for length in [0, 32, 34] {
            assert_eq!(Attachment::from_bytes(&bytes[..length]), None, "{length}");
        }
        assert_eq!(Attachment::from_bytes(&[15; ATTACHMENT_BYTES]), None);
    }

    /// By the reference implementation of xxHash (0.8.4), the low half first, both little-endian.
    #[test]
    fn a_gid_is_the_hash_of_the_token() {
        let hex = |text: &str| {
            let bytes = Gid::of_token(text).0;
            bytes.map(|byte| format!("{byte:02x}")).concat()
        };
        let publisher = "@ros2_lv/0/a1/0/1/MP/%/%echosplat%vehicle/echosplat/%tf/\
            tf2_msgs::msg::dds_::TFMessage_/\
            RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087/::,100:,:,:,,";
        assert_eq!(hex(publisher), "0485a4969d52508280dda5822a6210c9");
        let node = format!(
            "@ros2_lv/0/{}/0/0/NN/%/%echosplat%vehicle/echosplat",
            "a".repeat(32)
        );
        assert_eq!(hex(&node), "5f56618cfd2de3bbec6991144cf4bb3b");
        // Beyond 240 bytes it is made in another way.
        let long = publisher.to_owned() + &"x".repeat(200);
        assert_eq!(hex(&long), "b9c51e843f49e6007093a4278e069568");
    }
}
