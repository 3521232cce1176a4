//! Transports around a device session: TCP, UDP, serial lines and logs.
//!
//! [`spawn`] runs one [`Session`](echosplat_session::Session) on one named thread, keeps its link
//! alive for ever and hands pings to a bounded channel; [`serve`] is the other end, an emulated
//! device for any Ping client. Raw bytes are shown to a [`RawTap`] before they are decoded.
//!
//! This crate deliberately knows nothing of poses, maps, recordings or the bus, decodes nothing
//! itself, and has no simulated sonar in its own thread: `sim://` is the caller's to resolve.

mod config;
mod driver;
mod event;
mod link;
mod log_reader;
mod outlet;
mod pace;
mod serve;
mod stop;
mod transport;
mod url;

pub use config::{DriverConfig, DriverError};
pub use driver::{DriverHandle, RawTap, spawn};
pub use event::{DriverEvent, DriverStatus, LinkState};
pub use serve::{
    EmulatedDevice, ListenUrl, OnPing, ServeError, ServeOptions, ServeStatus, Server, serve,
};
pub use url::{SonarUrl, UrlError};
