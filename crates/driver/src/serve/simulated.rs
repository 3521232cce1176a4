//! The simulator's device as one that can be served.

use echosplat_model::Timestamp;
use echosplat_simulator::SimulatedDevice;

use super::EmulatedDevice;

/// Earlier than anything is due: only answers come.
const BEFORE_ALL: Timestamp = Timestamp::from_nanos(i64::MIN);

impl EmulatedDevice for SimulatedDevice {
    fn receive(&mut self, bytes: &[u8], now: Timestamp, out: &mut Vec<u8>) {
        self.receive(bytes, now);
        out.extend(self.advance(BEFORE_ALL));
    }

    fn next_due(&self) -> Option<Timestamp> {
        self.next_due()
    }

    fn next_ping_due(&self) -> Option<Timestamp> {
        self.next_ping_due()
    }

    fn transmit(&mut self, out: &mut Vec<u8>) {
        if let Some(due) = self.next_due() {
            out.extend(self.advance(due));
        }
    }

    fn is_finished(&self) -> bool {
        self.is_finished()
    }
}
