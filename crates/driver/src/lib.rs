//! Transports around a device session
