//! Files: the vendor's `.svlog`, TUM trajectories, 3DGS PLY maps, and the raw MCAP recording.
//!
//! Everything reads from `std::io::Read` and writes to `std::io::Write`; paths appear only in thin
//! helpers. What a file says of its own size is never believed before the bytes are there, and
//! what is damaged or cut is read as far as it goes and said so.
//!
//! Deliberately absent: threads, a clock (the caller says when to sync and what time it is), the
//! meaning of sonar messages, and any map other than one of Gaussians.

pub mod export;
pub mod foreign;
pub mod mcap;
pub mod ply;
mod ramp;
pub mod replace;
pub mod svlog;
pub mod tum;
