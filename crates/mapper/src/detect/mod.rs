//! Detect: a ping to its noise and to what each bin says.

pub(crate) mod bin_state;
pub(crate) mod bursts;
pub(crate) mod compact;
#[cfg(test)]
mod heard;
pub(crate) mod mirror;
pub(crate) mod noise_over_range;
mod odds;
pub(crate) mod own_vehicle;
pub(crate) mod profile;
pub(crate) mod receiver;
pub(crate) mod recurrences;
pub(crate) mod repeats;
pub(crate) mod ringing;
pub(crate) mod walkers;
pub(crate) mod working_range;

#[cfg(test)]
pub(crate) use heard::posed;
