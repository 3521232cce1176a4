//! The map, pings and poses over zenoh
