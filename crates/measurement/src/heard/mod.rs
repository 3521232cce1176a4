//! What one ping hears of many Gaussians that are kept as packed numbers, each with a strength towards each of the six faces of
//! a cube.
//!
//! [`Hearing::find`] culls those in the beam and projects them: where in the ping each is heard and how strongly, as [`Rows`].
//! [`Pulses`] spread that over the bins and bring back what bins say of each: `tell_strengths` for the multiplicative step,
//! `tell_moments` for [`Score`], `tell_pose` for [`PoseScore`].

mod footprint;
mod hearing;
mod pose_score;
mod pulses;
mod rows;
mod told;
mod view;

pub use hearing::{Hearing, Run};
pub use pose_score::{POSE_STATES, PoseScore};
pub use pulses::Pulses;
pub use rows::{Detail, Rows};
pub use told::{Bins, Moments, Score};
pub use view::{Members, NUMBERS, Numbers, SHAPE_NUMBERS, View};
