//! Whether the long-running parts of a program are alive. Each part holds a [`Heartbeat`]: it beats
//! as it works, says when it waits for something outside, and outlives its own panics. Whoever
//! watches over the parts reads the same heartbeat.
//!
//! It deliberately holds no threads and no policy: what becomes of a part that hangs or fails is
//! its watcher's to decide.

mod drill;
mod heartbeat;

pub use drill::{Drill, DrillError, VARIABLE as DRILL_VARIABLE};
pub use heartbeat::{Condition, Heartbeat, Panicked};
