//! Pose sources
