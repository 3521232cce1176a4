//! What a method takes by itself, without what judges it.

use std::time::Instant;

use echosplat_service::processor;

/// Counts while it goes.
pub(in crate::commands) struct Clock {
    /// By the clock on the wall.
    pub(in crate::commands) wall_s: f64,
    /// Processor seconds of the whole process.
    pub(in crate::commands) compute_s: f64,
    began: (Instant, f64),
}

impl Clock {
    pub(in crate::commands) fn start() -> Self {
        Self {
            wall_s: 0.0,
            compute_s: 0.0,
            began: (Instant::now(), processor::process_seconds()),
        }
    }

    pub(in crate::commands) fn go_on(&mut self) {
        self.began = (Instant::now(), processor::process_seconds());
    }

    pub(in crate::commands) fn pause(&mut self) {
        self.wall_s += self.began.0.elapsed().as_secs_f64();
        self.compute_s += processor::process_seconds() - self.began.1;
    }
}
