//! The commands of the program `echosplat`, and what they are made of: configuration, wiring, shutdown.
//!
//! It knows all other parts of the product. It deliberately holds no mathematics, no protocol and no
//! file format of its own, and no bench: the program adds those. What is public here is what the
//! program and the benches use.

#[cfg(test)]
mod advised;
mod alignment;
pub mod arguments;
pub mod clock;
pub mod commands;
pub mod config;
mod decided;
pub mod dives;
pub mod exit;
mod files;
mod inputs;
mod kind;
mod log_clock;
pub mod logging;
mod logs;
pub mod maps;
mod measuring;
pub mod pipeline;
mod placing;
pub mod processor;
mod recorder;
mod replayed;
mod rig;
mod runtime;
mod scene_files;
pub mod signals;
pub mod simd;
mod split;
mod supervisor;
mod thinned;
pub mod truth;
mod web;
