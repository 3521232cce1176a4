//! A georeference from points that are known in the world and on the Earth.

use echosplat_model::glam::{DVec2, DVec3};

use crate::text::three_numbers;
use crate::{Datum, Georeference, Place};

/// From so many on, ties find the heading too.
const FOR_HEADING: usize = 3;

/// Share of the ties' length, without a unit, that they must be wide.
const LEAST_WIDTH: f64 = 0.02;
/// Metres; nearer to each other ties tell a place, no heading.
const LEAST_SPREAD_M: f64 = 0.5;

/// Rounds of laying the plane that touches the Earth at the ties' middle; the second moves it by less than 1e-9 m.
const ROUNDS: usize = 3;

/// A point that is known twice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tie {
    /// In the world of the map, metres.
    pub world_m: DVec3,
    /// On the Earth; its height is over the surface of the water.
    pub place: Place,
}

impl Tie {
    /// Reads `X,Y,Z=LAT,LON,DEPTH`: metres of the world, degrees, and metres downward.
    ///
    /// # Errors
    /// Says what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}`: a tie reads X,Y,Z=LAT,LON,DEPTH, metres of the map, degrees and metres down, as in \
                 1.5,-2,-3.2=60.17,24.94,3.2"
            )
        };
        let (world, place) = text.split_once('=').ok_or_else(wrong)?;
        let world_m = DVec3::from_array(three_numbers(world).ok_or_else(wrong)?);
        let [latitude_deg, longitude_deg, depth_m] = three_numbers(place).ok_or_else(wrong)?;
        let place = Place::new(latitude_deg, longitude_deg, -depth_m)
            .map_err(|error| format!("`{text}`: {error}"))?;
        Ok(Self { world_m, place })
    }
}

/// How far a tie is from where the georeference has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// Where the Earth says it is minus where the map does: east, north, up, metres.
    pub enu_m: DVec3,
}

/// What ties tell.
#[derive(Debug, Clone, PartialEq)]
pub struct Solved {
    /// Best in the least squares of all coordinates.
    pub georeference: Georeference,
    /// Of each tie, in their order.
    pub residuals: Vec<Residual>,
    /// One sigma of the heading as the residuals tell it, degrees; `None` where the ties do not find it.
    pub heading_sigma_deg: Option<f64>,
}

/// Why ties tell nothing.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TieError {
    /// None at all.
    #[error("no ties: give at least one, --tie X,Y,Z=LAT,LON,DEPTH")]
    None,
    /// They cannot find a heading.
    #[error(
        "the ties lie within {0:.2} m of each other: too near to find a heading; give some that are farther apart, or one"
    )]
    Near(f64),
    /// A mistake along the line would not be seen.
    #[error(
        "the ties lie on a line, on which a mirrored or swapped point is not seen; give one that lies beside it"
    )]
    Line,
    /// The map and the Earth disagree.
    #[error(
        "the ties are {map_m:.2} m long in the map and {earth_m:.2} m on the Earth: coordinates are swapped, or in \
         other units"
    )]
    Scale {
        /// Metres.
        map_m: f64,
        /// Metres.
        earth_m: f64,
    },
}

/// The most that lengths may differ, without a unit: beyond, a mistake was made in writing the ties.
const MOST_STRETCH: f64 = 1.2;

/// Place from one tie or two, with this heading of the world's x axis; heading too from three.
///
/// # Errors
/// If they cannot tell it.
pub fn solve(ties: &[Tie], x_heading_deg: f64) -> Result<Solved, TieError> {
    let first = ties.first().ok_or(TieError::None)?;
    let middle_m = mean(ties.iter().map(|tie| tie.world_m));
    let finds_heading = ties.len() >= FOR_HEADING;
    if finds_heading {
        check_spread(ties, middle_m, first)?;
    }
    let mut georeference = Georeference {
        anchor_m: middle_m,
        place: first.place,
        datum: Datum::Surface,
        x_heading_deg,
        source: match ties.len() {
            1 => "1 tie".to_owned(),
            many => format!("{many} ties"),
        },
    };
    for _ in 0..ROUNDS {
        let enu_m: Vec<DVec3> = ties
            .iter()
            .map(|tie| georeference.place.enu_of(&tie.place))
            .collect();
        let shift_m = mean(enu_m.iter().copied());
        if finds_heading {
            georeference.x_heading_deg = heading_deg(ties, middle_m, &enu_m, shift_m);
        }
        georeference.place = georeference.place.moved(shift_m);
    }
    let turn = georeference.enu_from_world();
    let residual = |tie: &Tie| Residual {
        enu_m: georeference.place.enu_of(&tie.place) - turn * (tie.world_m - middle_m),
    };
    let residuals: Vec<Residual> = ties.iter().map(residual).collect();
    let heading_sigma_deg = finds_heading.then(|| heading_sigma_deg(ties, middle_m, &residuals));
    Ok(Solved {
        georeference,
        residuals,
        heading_sigma_deg,
    })
}

fn mean(points: impl ExactSizeIterator<Item = DVec3>) -> DVec3 {
    let count = points.len() as f64;
    points.sum::<DVec3>() / count
}

/// Clockwise from north, of the turn that brings the map's points nearest to the Earth's.
fn heading_deg(ties: &[Tie], middle_m: DVec3, enu_m: &[DVec3], shift_m: DVec3) -> f64 {
    let (mut along, mut across) = (0.0, 0.0);
    for (tie, enu_m) in ties.iter().zip(enu_m) {
        let map = (tie.world_m - middle_m).truncate();
        let earth = (*enu_m - shift_m).truncate();
        along += map.dot(earth);
        across += map.perp_dot(earth);
    }
    // Anticlockwise from east to the world's x.
    let turn_deg = across.atan2(along).to_degrees();
    (90.0 - turn_deg).rem_euclid(360.0)
}

fn check_spread(ties: &[Tie], middle_m: DVec3, first: &Tie) -> Result<(), TieError> {
    let flat: Vec<DVec2> = ties
        .iter()
        .map(|tie| (tie.world_m - middle_m).truncate())
        .collect();
    let longest = flat
        .iter()
        .copied()
        .max_by(|a, b| a.length().total_cmp(&b.length()));
    let longest = longest.unwrap_or(DVec2::ZERO);
    if longest.length() < LEAST_SPREAD_M {
        return Err(TieError::Near(2.0 * longest.length()));
    }
    // Wide is measured across the direction in which they lie, which the largest moment tells.
    let (xx, xy, yy) = flat.iter().fold((0.0, 0.0, 0.0), |(xx, xy, yy), p| {
        (xx + p.x * p.x, xy + p.x * p.y, yy + p.y * p.y)
    });
    let half = f64::hypot(0.5 * (xx - yy), xy);
    let (most, least) = (0.5 * (xx + yy) + half, 0.5 * (xx + yy) - half);
    if !(least.max(0.0).sqrt() >= LEAST_WIDTH * most.sqrt()) {
        return Err(TieError::Line);
    }
    let enu_m: Vec<DVec3> = ties
        .iter()
        .map(|tie| first.place.enu_of(&tie.place))
        .collect();
    let shift_m = mean(enu_m.iter().copied());
    let square = |offsets: &mut dyn Iterator<Item = DVec2>| -> f64 {
        offsets.map(DVec2::length_squared).sum::<f64>().sqrt()
    };
    let map_m = square(&mut flat.iter().copied());
    let earth_m = square(&mut enu_m.iter().map(|enu| (*enu - shift_m).truncate()));
    let stretch = map_m / earth_m;
    match (1.0 / MOST_STRETCH..=MOST_STRETCH).contains(&stretch) {
        true => Ok(()),
        false => Err(TieError::Scale { map_m, earth_m }),
    }
}

/// Of what the residuals leave over after two coordinates and the heading were fitted.
fn heading_sigma_deg(ties: &[Tie], middle_m: DVec3, residuals: &[Residual]) -> f64 {
    let square = |v: DVec3| v.truncate().length_squared();
    let left: f64 = residuals
        .iter()
        .map(|residual| square(residual.enu_m))
        .sum();
    let lever: f64 = ties.iter().map(|tie| square(tie.world_m - middle_m)).sum();
    let freedom = (2 * ties.len()).saturating_sub(3).max(1) as f64;
    (left / freedom / lever).sqrt().to_degrees()
}
