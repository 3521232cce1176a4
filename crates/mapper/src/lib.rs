//! From posed pings to a map of Gaussians: evidence along arcs, Gaussians where evidence asks for
//! them, reflectivity by expectation-maximisation, and what of it the map dares to assert.
//!
//! A ping goes through five rooms in order: `detect`, `accumulate`, `spawn`, `refine`, `classify`; the method is
//! in `docs/develop/method.md`. [`Mapper`] is the face: `insert`, `snapshot`, `finish`. Everything else is inside.
//! This crate deliberately has no sockets, no files, no clock and no randomness: the same pings,
//! configuration and budgets give the same bits at any number of threads.
//!
//! A sonar that stays where it is hears an echo at 5 m, again and again. How high up it comes from
//! nobody can tell, so that nothing is asserted:
//!
//! ```
//! use std::sync::Arc;
//!
//! use echosplat_mapper::{Mapper, MapperConfig};
//! use echosplat_model::{Ping, PingSettings, Pose, PosedPing, Standing, Timestamp, Twist};
//!
//! let settings = PingSettings {
//!     range_start_m: 0.0,
//!     range_length_m: 10.0,
//!     bin_count: 500,
//!     speed_of_sound_mps: 1500.0,
//!     frequency_hz: 451_127.0,
//!     pulse_duration_s: 2e-5,
//!     gain_index: 0,
//! };
//! let mut mapper = Mapper::new(MapperConfig::default())?;
//! for number in 0..40_u32 {
//!     let mut intensity = vec![1e-4; 500]; // linear power per bin
//!     intensity[250] = 1.0;
//!     let time = Timestamp::from_millis(25 * i64::from(number));
//!     let ping = Ping::new(u64::from(number), time, settings, intensity)?;
//!     mapper.insert(&PosedPing {
//!         ping: Arc::new(ping),
//!         world_from_sensor: Pose::IDENTITY, // x forward, y left, z up
//!         twist: Twist::default(),
//!         reference_range_m: 5.0,
//!         uncertainty: None, // taken from the configuration
//!         jitter: None,
//!     });
//! }
//! let map = mapper.finish();
//! assert_eq!(mapper.status().pings, 40);
//! assert!(map.gaussians.iter().all(|g| g.standing == Standing::Ambiguous));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! `examples/map_a_log.rs` maps a log with the poses of a file.

mod accumulate;
mod calibrate;
mod classify;
mod config;
mod detect;
mod drift;
mod effort;
mod features;
mod mapper;
mod progress;
mod refine;
mod seabed;
mod spawn;
mod world;

pub use accumulate::history::geometry_of;
pub use calibrate::{Calibration, Estimate};
pub use config::{ConfigError, MapperConfig};
pub use drift::{CorrectedPose, PoseCorrections, PoseDrift, PoseSigma};
pub use effort::{Counted, Task, TaskCounts, TaskEnd};
pub use features::{Features, LeftOut};
pub use mapper::{
    Calibrator, Foretold, InsertReport, Mapper, MapperStatus, Questions, ReasonCounts,
};
pub use refine::step::damped_step;
