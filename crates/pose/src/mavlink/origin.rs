//! Where on Earth the origin of a vehicle's local positions lies, as it says itself.

use echosplat_georeference::{Datum, Georeference, Place};
use echosplat_model::glam::DVec3;
use serde::Serialize;

/// Degrees in a unit of `MAVLink`'s latitudes and longitudes.
const DEGREE_PER_UNIT: f64 = 1e-7;

/// Metres; farther than a vehicle's rounding, an origin is another one.
const MOVED_M: f64 = 1.0;
/// Metres; so far an origin worked out from two positions may be from the one that is said.
const ROUGH_M: f64 = 20.0;

/// Where on Earth the origin of poses lies. Their world is ENU there.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ToldOrigin {
    /// Degrees north.
    pub latitude_deg: f64,
    /// Degrees east.
    pub longitude_deg: f64,
    /// Metres above mean sea level.
    pub height_m: f64,
    /// Which message said it.
    pub source: &'static str,
    /// How far the vehicle moved it since, at most; the first is kept. Metres.
    pub moved_m: f64,
    /// Where it was said to be last.
    #[serde(skip)]
    newest: Place,
    /// How often it was said, also in worlds before.
    #[serde(skip)]
    said: u64,
}

impl ToldOrigin {
    /// The same as a georeference; `None` if it is no place.
    #[must_use]
    pub fn georeference(&self) -> Option<Georeference> {
        let place = Place::new(self.latitude_deg, self.longitude_deg, self.height_m).ok()?;
        Some(Georeference::at_origin(place, Datum::MeanSea, self.source))
    }
}

/// Which epochs of poses have an origin: one that was said in another epoch may be another world's.
#[derive(Debug, Default)]
pub struct OriginEpochs {
    /// The newest epoch, and how often an origin had been said when it began.
    newest: Option<(u32, u64)>,
    /// The epoch that began first.
    first: Option<u32>,
}

impl OriginEpochs {
    /// What an origin that was told while poses were of this epoch says of its world: of the first epoch what was told first,
    /// of another what was said since it began, and `None` until then.
    pub fn of(&mut self, epoch: u32, told: Option<&ToldOrigin>) -> Option<Georeference> {
        let said = told.map_or(0, |told| told.said);
        let is_first = *self.first.get_or_insert(epoch) == epoch;
        let newest = self.newest.get_or_insert((epoch, said));
        if newest.0 != epoch {
            *newest = (epoch, said);
        }
        let told = told?;
        match is_first {
            true => told.georeference(),
            false if said == newest.1 => None,
            false => Some(Georeference::at_origin(
                told.newest,
                Datum::MeanSea,
                told.source,
            )),
        }
    }
}

/// A place as messages have it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Fix {
    /// North, 1e-7 degrees.
    pub(crate) latitude_e7: i32,
    /// East, 1e-7 degrees.
    pub(crate) longitude_e7: i32,
    /// Above mean sea level, millimetres.
    pub(crate) height_mm: i32,
}

impl Fix {
    /// `None` for zeros, which stand for nothing known, and for what is no place.
    fn place(self) -> Option<Place> {
        let is_known = self.latitude_e7 != 0 || self.longitude_e7 != 0;
        let place = Place::new(
            f64::from(self.latitude_e7) * DEGREE_PER_UNIT,
            f64::from(self.longitude_e7) * DEGREE_PER_UNIT,
            f64::from(self.height_mm) * 1e-3,
        );
        place.ok().filter(|_| is_known)
    }
}

/// What was heard of the origin.
#[derive(Debug, Default)]
pub(crate) struct Origin {
    told: Option<(Place, ToldOrigin)>,
    /// By its own message, and not worked out.
    is_exact: bool,
    said: u64,
}

impl Origin {
    pub(crate) fn told(&self) -> Option<ToldOrigin> {
        self.told.as_ref().map(|(_, told)| told.clone())
    }

    /// What counts from it begins anew: the vehicle has to say again where that is.
    pub(crate) fn forget(&mut self) {
        self.told = None;
        self.is_exact = false;
    }

    /// `GPS_GLOBAL_ORIGIN`.
    pub(crate) fn says(&mut self, fix: Fix) {
        let Some(place) = fix.place() else { return };
        self.hear(place);
        let apart_m = self.apart_m(&place);
        let is_better = !self.is_exact && apart_m.is_none_or(|apart_m| apart_m <= ROUGH_M);
        if is_better {
            self.is_exact = true;
            self.keep(place, "GPS_GLOBAL_ORIGIN");
        } else if let Some(apart_m) = apart_m {
            self.moved(apart_m);
        }
    }

    /// `GLOBAL_POSITION_INT` of a vehicle that is then at this local position, east, north and up. Only the first is
    /// taken: what follows differs by how the vehicle drifts.
    pub(crate) fn is_beside(&mut self, fix: Fix, local_enu_m: DVec3) {
        if self.is_exact {
            return;
        }
        if let Some(place) = fix.place() {
            let origin = place.origin_beside(local_enu_m);
            self.hear(origin);
            if self.told.is_none() {
                self.keep(origin, "GLOBAL_POSITION_INT beside LOCAL_POSITION_NED");
            }
        }
    }

    fn hear(&mut self, place: Place) {
        self.said += 1;
        if let Some((_, told)) = &mut self.told {
            (told.newest, told.said) = (place, self.said);
        }
    }

    fn keep(&mut self, place: Place, source: &'static str) {
        let told = ToldOrigin {
            latitude_deg: place.latitude_deg,
            longitude_deg: place.longitude_deg,
            height_m: place.height_m,
            source,
            moved_m: 0.0,
            newest: place,
            said: self.said,
        };
        self.told = Some((place, told));
    }

    fn apart_m(&self, place: &Place) -> Option<f64> {
        let (held, _) = self.told.as_ref()?;
        Some(held.enu_of(place).length())
    }

    fn moved(&mut self, apart_m: f64) {
        let Some((_, told)) = &mut self.told else {
            return;
        };
        if apart_m > MOVED_M && apart_m > told.moved_m + MOVED_M {
            tracing::warn!(
                "the vehicle moved the origin of its positions by {apart_m:.1} m in mid-dive: the map's place on \
                 Earth stays that of the first; map what follows as a dive of its own"
            );
            told.moved_m = apart_m;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(latitude_e7: i32, longitude_e7: i32, height_mm: i32) -> Fix {
        Fix {
            latitude_e7,
            longitude_e7,
            height_mm,
        }
    }

    #[test]
    fn the_first_origin_stays_and_a_move_is_told() {
        let mut origin = Origin::default();
        origin.says(fix(0, 0, 5));
        assert_eq!(origin.told(), None);
        origin.says(fix(601_700_000, 249_400_000, -1_500));
        origin.says(fix(601_700_001, 249_400_000, -1_500));
        let first = origin.told().unwrap();
        assert!((first.latitude_deg - 60.17).abs() < 1e-12 && first.moved_m < 1e-9);
        // About 111 m north.
        origin.says(fix(601_710_000, 249_400_000, -1_500));
        let told = origin.told().unwrap();
        assert!((told.latitude_deg - 60.17).abs() < 1e-12);
        assert!((told.moved_m - 111.4).abs() < 0.5, "{told:?}");
        let georeference = told.georeference().unwrap();
        assert_eq!(georeference.datum, Datum::MeanSea);
    }

    #[test]
    fn a_position_on_earth_beside_a_local_one_tells_the_origin_until_it_is_said() {
        let mut origin = Origin::default();
        let truth = Place::new(-16.79, 179.9999, 2.0).unwrap();
        let local_m = DVec3::new(120.0, -340.0, -7.0);
        let there = truth.moved(local_m);
        let unit = |degrees: f64| (degrees * 1e7).round() as i32;
        let seen = fix(
            unit(there.latitude_deg),
            unit(there.longitude_deg),
            (there.height_m * 1e3).round() as i32,
        );
        origin.is_beside(seen, local_m);
        let told = origin.told().unwrap().georeference().unwrap();
        assert!(told.place.enu_of(&truth).length() < 0.02);
        origin.says(fix(unit(-16.79), unit(179.9999), 2_000));
        let told = origin.told().unwrap();
        assert!(told.source == "GPS_GLOBAL_ORIGIN" && told.moved_m < 1e-9);
    }

    #[test]
    fn what_was_said_in_one_epoch_places_no_other() {
        let (mut origin, mut epochs) = (Origin::default(), OriginEpochs::default());
        assert_eq!(epochs.of(3, None), None);
        origin.says(fix(601_700_000, 249_400_000, 0));
        origin.says(fix(601_700_001, 249_400_000, 0));
        let told = origin.told();
        let first = epochs.of(3, told.as_ref()).unwrap();
        assert!((first.place.latitude_deg - 60.17).abs() < 1e-12);
        // A jump that the vehicle does not know of: only what it says from then on counts.
        assert_eq!(epochs.of(4, told.as_ref()), None);
        origin.says(fix(601_800_000, 249_400_000, 0));
        let second = epochs.of(4, origin.told().as_ref()).unwrap();
        assert!(
            (second.place.latitude_deg - 60.18).abs() < 1e-9,
            "{second:?}"
        );
        // One that it does know of.
        origin.forget();
        assert_eq!(epochs.of(5, origin.told().as_ref()), None);
        origin.says(fix(601_900_000, 249_400_000, 0));
        let third = epochs.of(5, origin.told().as_ref()).unwrap();
        assert!((third.place.latitude_deg - 60.19).abs() < 1e-9, "{third:?}");
    }
}
