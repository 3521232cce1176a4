//! What simple methods make of the same pings, to hold the mapper against.
//!
//! Deliberately absent: the paper's method and its first Gaussians, which have a crate of their own.

mod carving;
mod voxels;

pub(crate) use carving::Carving;
