//! 169 `sync_channel_number`, 170 `set_sync_channel_number`.

/// Payload of both.
pub(crate) const PAYLOAD_BYTES: usize = 2;

mod field {
    pub(super) const CHANNEL_NUMBER: usize = 0;
    pub(super) const CHANNEL_COUNT: usize = 1;
}

/// Which of how many synchronised units one is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SyncChannel {
    /// From 0; 255 if it was never assigned.
    pub channel_number: u8,
    /// `number_of_channels` of the tables.
    pub channel_count: u8,
}

impl SyncChannel {
    pub(super) fn parse(payload: &[u8]) -> Self {
        Self {
            channel_number: payload[field::CHANNEL_NUMBER],
            channel_count: payload[field::CHANNEL_COUNT],
        }
    }

    pub(super) fn emit(&self, payload: &mut [u8]) {
        payload[field::CHANNEL_NUMBER] = self.channel_number;
        payload[field::CHANNEL_COUNT] = self.channel_count;
    }
}
