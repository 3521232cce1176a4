//! Scenes, ray casting, dives, the simulated device
