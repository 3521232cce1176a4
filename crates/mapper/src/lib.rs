//! From posed pings to a map of Gaussians
