//! Device time against wall time.

use std::time::{Duration, Instant};

use echosplat_model::Timestamp;

/// Further behind than this is not caught up: the machine stood still, and so did the device.
const MAX_BEHIND_S: f64 = 1.0;

/// The device's clock: at 0 until it starts, then so many times as fast as the wall's while the
/// device is pinging; it stands while it is not. At rate 0 it goes from one frame to the next.
#[derive(Debug)]
pub(super) struct DeviceClock {
    rate: f64,
    started: Option<Instant>,
    /// Where it stood when it was started.
    base: Timestamp,
    /// What it was held back by since.
    slip_s: f64,
    newest: Timestamp,
}

impl DeviceClock {
    pub(super) fn new(rate: f64) -> Self {
        Self {
            rate,
            started: None,
            base: Timestamp::ZERO,
            slip_s: 0.0,
            newest: Timestamp::ZERO,
        }
    }

    /// Starts the clock if it stands.
    pub(super) fn start(&mut self, wall: Instant) {
        self.started.get_or_insert(wall);
    }

    /// Has the clock stand if it runs.
    pub(super) fn stop(&mut self, wall: Instant) {
        self.base = self.now(wall);
        self.started = None;
        self.slip_s = 0.0;
    }

    /// Device time at `wall`.
    pub(super) fn now(&self, wall: Instant) -> Timestamp {
        match self.started {
            Some(started) if self.rate > 0.0 => {
                let passed_s = wall.saturating_duration_since(started).as_secs_f64();
                self.base.offset_by(passed_s * self.rate - self.slip_s)
            }
            None if self.rate > 0.0 => self.base,
            _ => self.newest,
        }
    }

    /// A frame due at `due` went out.
    pub(super) fn has_sent(&mut self, due: Timestamp) {
        self.newest = self.newest.max(due);
    }

    /// How long to wait at `wall` for what is due at `due`; zero if it is time.
    pub(super) fn wait(&mut self, due: Timestamp, wall: Instant) -> Duration {
        if self.rate <= 0.0 {
            return Duration::ZERO;
        }
        let wait_s = due.seconds_since(self.now(wall)) / self.rate;
        if wait_s < -MAX_BEHIND_S {
            self.slip_s -= wait_s * self.rate;
        }
        Duration::try_from_secs_f64(wait_s).unwrap_or(Duration::ZERO)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Timestamp {
        Timestamp::from_secs_f64(seconds)
    }

    #[test]
    fn twice_real_time_waits_half_as_long_and_runs_while_nothing_is_sent() {
        let wall = Instant::now();
        let mut clock = DeviceClock::new(2.0);
        assert_eq!(clock.now(wall), Timestamp::ZERO);
        clock.start(wall);
        let later = wall + Duration::from_secs(3);
        assert_eq!(clock.now(later), at(6.0));
        assert_eq!(clock.wait(at(7.0), later), Duration::from_millis(500));
        assert_eq!(clock.wait(at(5.5), later), Duration::ZERO);
    }

    #[test]
    fn it_stands_while_it_is_stopped_and_goes_on_from_there() {
        let wall = Instant::now();
        let after = |seconds| wall + Duration::from_secs(seconds);
        let mut clock = DeviceClock::new(1.0);
        clock.stop(wall);
        clock.start(wall);
        clock.stop(after(3));
        clock.stop(after(50));
        assert_eq!(clock.now(after(100)), at(3.0));
        clock.start(after(100));
        assert_eq!(clock.now(after(102)), at(5.0));
        assert_eq!(clock.wait(at(5.5), after(102)), Duration::from_millis(500));
    }

    #[test]
    fn a_standstill_of_the_machine_is_one_of_the_device() {
        let wall = Instant::now();
        let mut clock = DeviceClock::new(1.0);
        clock.start(wall);
        let later = wall + Duration::from_secs(60);
        assert_eq!(clock.wait(at(0.025), later), Duration::ZERO);
        assert_eq!(clock.wait(at(0.125), later), Duration::from_millis(100));
    }

    #[test]
    fn at_rate_zero_time_goes_from_frame_to_frame() {
        let wall = Instant::now();
        let mut clock = DeviceClock::new(0.0);
        clock.start(wall);
        assert_eq!(clock.wait(at(9.0), wall), Duration::ZERO);
        clock.has_sent(at(9.0));
        assert_eq!(clock.now(wall), at(9.0));
    }
}
