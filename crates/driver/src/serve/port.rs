//! Where requests come from, and what they ask.

use echosplat_model::Timestamp;

use super::{EmulatedDevice, ServeStatus};

/// The device and its time, as requests find it.
pub(super) struct Asked<'a> {
    pub(super) device: &'a mut dyn EmulatedDevice,
    pub(super) now: Timestamp,
}

/// Where clients come from. Nothing here waits.
pub(super) trait Port: Send {
    /// What a client connects to.
    fn url(&self) -> String;
    /// Answers the requests that have come; says whether any bytes had.
    fn serve(&mut self, device: &mut Asked<'_>, status: &mut ServeStatus) -> bool;
    /// Queues one frame for every client.
    fn broadcast(&mut self, frame: &[u8], status: &mut ServeStatus);
    /// Writes what the clients take.
    fn flush(&mut self);
    /// Whether there is a client and none is behind.
    fn is_ready(&self) -> bool;
    /// Whether bytes wait for a client to take them.
    fn has_waiting(&self) -> bool;
}
