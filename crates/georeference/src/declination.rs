//! How far magnetic north is from true north, by the World Magnetic Model of NOAA and the British Geological Survey.
//!
//! Equations by their numbers in the WMM2025 technical report (doi 10.25923/prbc-s316). `wmm.cof` holds the coefficients of the
//! models of 2020 and 2025, which are in the public domain: a line with the year, then `n m g h` in nT and their rates in nT a
//! year. Summed here, since crates for it bring units and calendars that take longer to build than all else of this one.

use crate::Place;

/// Degree and order of the model.
const DEGREE: usize = 12;
/// Kilometres; the model's radius of the Earth.
const RADIUS_KM: f64 = 6371.2;
const COEFFICIENTS: &str = include_str!("wmm.cof");
/// Days after 1970-01-01 of the first day of 2020, 2025 and 2030.
const BEGIN_DAYS: [(u32, i64); 3] = [(2020, 18_262), (2025, 20_089), (2030, 21_915)];
/// Days in a year, near enough for rates of minutes of arc a year.
const YEAR_DAYS: f64 = 365.25;
/// Degrees, and degrees times nT; of the error model of declination, table 5 of the report: the greater of both years.
const SIGMA: (f64, f64) = (0.26, 5_625.0);
/// nT; with a level field below this the report calls compasses unsure.
const LEAST_LEVEL_NT: f64 = 6_000.0;

/// Where a compass points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Declination {
    /// Heading of magnetic north, degrees clockwise from true north: what is added to a compass's heading.
    pub declination_deg: f64,
    /// One sigma of it, degrees.
    pub sigma_deg: f64,
    /// Whether the field is so steep as to make compasses unsure, near a magnetic pole.
    pub is_unsure: bool,
}

/// Why there is none: the model's years do not hold the day.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the World Magnetic Model that is built in holds from 2020-01-01 to 2029-12-31, and says nothing of that day"
)]
pub struct DeclinationError;

/// At a place, so many days after 1970-01-01. Its height hardly matters, whatever it is counted from.
///
/// # Errors
/// If the model's years do not hold the day: they are never stretched.
pub fn declination(place: &Place, unix_day: i64) -> Result<Declination, DeclinationError> {
    let mut models = BEGIN_DAYS.windows(2);
    let model = models.find(|model| (model[0].1..model[1].1).contains(&unix_day));
    let (year, first_day) = model.ok_or(DeclinationError)?[0];
    let years = (unix_day - first_day) as f64 / YEAR_DAYS;
    let [north_nt, east_nt] = level_field_nt(place, year, years);
    let level_nt = north_nt.hypot(east_nt);
    Ok(Declination {
        declination_deg: east_nt.atan2(north_nt).to_degrees(),
        sigma_deg: SIGMA.0.hypot(SIGMA.1 / level_nt).min(180.0),
        is_unsure: level_nt < LEAST_LEVEL_NT,
    })
}

/// North and east, nT.
fn level_field_nt(place: &Place, year: u32, years: f64) -> [f64; 2] {
    let middle_m = place.from_middle_m();
    let distance_m = middle_m.length();
    // At the poles east has no meaning; a hair beside it has.
    let (sin, cos) = (
        middle_m.z / distance_m,
        (middle_m.truncate().length() / distance_m).max(1e-9),
    );
    let longitude = place.longitude_deg.to_radians();
    let legendre = legendre(sin, cos);
    let ratio = RADIUS_KM * 1e3 / distance_m;
    let (mut north, mut east, mut down) = (0.0, 0.0, 0.0);
    for (n, m, g, h) in coefficients(year, years) {
        let (value, slope) = legendre[n][m];
        let power = ratio.powi(n as i32 + 2);
        let order = m as f64;
        let (sin_m, cos_m) = (order * longitude).sin_cos();
        // Equations 10 to 12.
        north -= power * (g * cos_m + h * sin_m) * slope;
        east += power * order * (g * sin_m - h * cos_m) * value / cos;
        down -= power * (n as f64 + 1.0) * (g * cos_m + h * sin_m) * value;
    }
    // Equation 17: from the sphere's north to that of the ellipsoid.
    let (turn_sin, turn_cos) = (sin.atan2(cos) - place.latitude_deg.to_radians()).sin_cos();
    [north * turn_cos - down * turn_sin, east]
}

/// Degree, order and Gauss coefficients in nT, so many years after the model's first day.
fn coefficients(year: u32, years: f64) -> impl Iterator<Item = (usize, usize, f64, f64)> {
    let year = year.to_string();
    let lines = COEFFICIENTS
        .lines()
        .skip_while(move |line| *line != year)
        .skip(1);
    lines.map_while(move |line| {
        let mut words = line.split(' ');
        let degree = words
            .next()?
            .parse()
            .ok()
            .filter(|degree| *degree <= DEGREE)?;
        let order = words
            .next()?
            .parse()
            .ok()
            .filter(|order| *order <= degree)?;
        let mut number = || words.next()?.parse::<f64>().ok();
        let [g, h, g_rate, h_rate] = [number()?, number()?, number()?, number()?];
        Some((degree, order, g + years * g_rate, h + years * h_rate))
    })
}

type Legendre = [[(f64, f64); DEGREE + 1]; DEGREE + 1];

/// Schmidt's quasi-normal associated Legendre functions of the sine of latitude, and their slopes over latitude.
fn legendre(sin: f64, cos: f64) -> Legendre {
    let mut all: Legendre = [[(0.0, 0.0); DEGREE + 1]; DEGREE + 1];
    all[0][0] = (1.0, 0.0);
    for n in 1..=DEGREE {
        let degree = n as f64;
        let one = all[n - 1];
        let two = if n > 1 { all[n - 2] } else { all[DEGREE] };
        let edge_scale = if n == 1 {
            1.0
        } else {
            (1.0 - 0.5 / degree).sqrt()
        };
        all[n] = std::array::from_fn(|m| {
            if m == n {
                let (value, slope) = one[n - 1];
                return (
                    edge_scale * cos * value,
                    edge_scale * (cos * slope - sin * value),
                );
            }
            if m > n {
                return (0.0, 0.0);
            }
            let ((one, one_slope), (two, two_slope)) = (one[m], two[m]);
            let order = m as f64;
            let scale = (degree * degree - order * order).sqrt();
            let before = ((degree - 1.0).powi(2) - order * order).max(0.0).sqrt();
            let twice = 2.0 * degree - 1.0;
            (
                (twice * sin * one - before * two) / scale,
                (twice * (cos * one + sin * one_slope) - before * two_slope) / scale,
            )
        });
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(
        latitude_deg: f64,
        longitude_deg: f64,
        height_m: f64,
        unix_day: i64,
    ) -> Result<Declination, DeclinationError> {
        let place = Place {
            latitude_deg,
            longitude_deg,
            height_m,
        };
        declination(&place, unix_day)
    }

    /// Table 6 of the technical reports of WMM2020 and WMM2025: declination at 0 and 100 km on the models' first day and in their
    /// third year.
    #[test]
    fn it_is_what_the_models_reports_have() {
        for (day, height_m, latitude, longitude, expected) in [
            (18_262, 0.0, 80.0, 0.0, -1.28),
            (18_262, 0.0, -80.0, -120.0, 69.36),
            (18_262, 100_000.0, 80.0, 0.0, -1.70),
            (19_175, 0.0, 80.0, 0.0, 0.01),
            (19_175, 0.0, -80.0, -120.0, 69.13),
            (20_089, 0.0, 80.0, 0.0, 1.28),
            (20_089, 0.0, -80.0, -120.0, 68.78),
            (20_089, 100_000.0, -80.0, -120.0, 68.21),
            (21_002, 0.0, 80.0, 0.0, 2.59),
            (21_002, 100_000.0, 80.0, 0.0, 2.16),
            (21_002, 0.0, -80.0, -120.0, 68.49),
        ] {
            let found = at(latitude, longitude, height_m, day).unwrap();
            let off_deg = (found.declination_deg - expected).abs();
            assert!(
                off_deg < 0.02,
                "{day} {latitude} {longitude}: {found:?}, {expected}"
            );
        }
    }

    #[test]
    fn near_a_magnetic_pole_a_compass_is_unsure() {
        assert!(!at(60.17, 24.94, -5_000.0, 20_787).unwrap().is_unsure);
        let pole = at(85.0, 140.0, 0.0, 20_787).unwrap();
        assert!(pole.is_unsure && pole.sigma_deg > 2.0, "{pole:?}");
        for latitude_deg in [-90.0, 90.0] {
            assert!(
                at(latitude_deg, 0.0, 0.0, 20_787)
                    .unwrap()
                    .declination_deg
                    .is_finite()
            );
        }
    }

    #[test]
    fn years_beyond_the_models_are_refused() {
        for day in [i64::MIN, 0, 18_261, 21_915, i64::MAX] {
            assert_eq!(at(60.17, 24.94, 0.0, day), Err(DeclinationError));
        }
        assert!(at(60.17, 24.94, 0.0, 18_262).is_ok() && at(60.17, 24.94, 0.0, 21_914).is_ok());
        for year in [2020, 2025] {
            assert_eq!(coefficients(year, 0.0).count(), 90, "{year}");
        }
    }
}
