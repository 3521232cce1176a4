//! Where on Earth a map lies, and in which projection it is told.
//!
//! A [`Georeference`] ties the world of the poses, metres with z up, to WGS 84: one point of the world with its
//! latitude, longitude and height, and the heading of the world's x axis. [`Crs`] makes coordinates of a projection of
//! places; [`solve`] finds a georeference from points that are known in both. [`nmea`] and [`OriginFinder`] find one from fixes of a
//! satellite receiver beside poses.
//!
//! Deliberately absent: geoids (heights stay over the [`Datum`] they were given over), files, sockets.

mod beside;
mod crs;
mod declination;
mod fix;
mod georeference;
mod known_codes;
pub mod nmea;
mod place;
mod text;
mod ties;

pub use beside::{BesideCounters, BesideRule, FoundOrigin, OriginFinder};
pub use crs::{Crs, CrsError, Grid, LengthUnit};
pub use declination::{Declination, DeclinationError, declination};
pub use fix::{Fix, Heard, USUAL_SIGMA_M, sigma_of};
pub use georeference::{Georeference, GeoreferenceError};
pub use place::{Place, PlaceError};
pub use text::{Datum, parse_origin};
pub use ties::{Residual, Solved, Tie, TieError, solve};

#[cfg(test)]
mod tests;
