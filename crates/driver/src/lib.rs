//! Transports around a device session: TCP, UDP, serial lines and logs.
//!
//! [`spawn`] runs one [`Session`](echosplat_session::Session) on one named thread, keeps its link
//! alive for ever and hands pings to a bounded channel; [`spawn_tape`] does the same from a
//! recording; [`serve`] is the other end, an emulated device for any Ping client. Raw bytes are
//! shown to a [`RawTap`] before they are decoded. [`probe`](probe()) says whether a sonar is at a place.
//!
//! This crate deliberately knows nothing of poses, maps, recordings or the bus, decodes nothing
//! itself, and has no simulated sonar in its own thread: `sim://` is the caller's to resolve.

mod clock;
mod config;
mod driver;
mod event;
mod intake;
mod link;
mod log_reader;
mod outlet;
mod pace;
mod path;
mod pause;
mod probe;
mod serve;
mod status;
mod stop;
mod tap;
mod tape_reader;
mod transport;
mod url;

pub use config::{DriverConfig, DriverError};
pub use driver::{DriverHandle, spawn, spawn_in_place_of, spawn_tape};
pub use event::{DriverEvent, DriverStatus, LinkState};
pub use path::PingPath;
pub use pause::Pause;
pub use probe::{
    Discovered, Discovery, ProbedIdentity, ProbedProfile, ProbedUnit, discover, probe, serial_ports,
};
pub use serve::{EmulatedDevice, ListenUrl, ServeError, ServeOptions, ServeStatus, Server, serve};
pub use tap::{RawTap, Tape, TapeItem, Tapped};
pub use url::{SonarUrl, UrlError};
