//! What the program can do, measured: the proof, apart from the product.
//!
//! [`commands`] has a file for each `echosplat bench …`: timing, files, processes and words are there.
//! What is asked and how it is judged is beside it: [`runs`] names single runs and what came out of
//! them; [`targets`] says what maps of which dives must reach; [`error_time`], [`ablation`] and
//! [`noise_sweep`] compare runs; [`report`] chooses from them what one version is told by; [`long`] makes a dive of hours past many structures, and says what it
//! must not cost; [`stability`] is what the program's numerics make of stiff and extreme cases.
//!
//! Deliberately absent: anything that the service needs.

mod ablation;
mod arguments;
mod baselines;
mod commands;
mod draw;
mod error_time;
mod fingerprint;
mod front;
mod long;
mod noise_sweep;
mod report;
mod runs;
mod stability;
mod targets;

pub use arguments::BenchArguments;
pub use commands::run;
