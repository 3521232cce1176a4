//! Where on Earth the maps of a run lie, as the vehicle and a satellite receiver tell it while it goes on.

use std::collections::BTreeSet;

use echosplat_georeference::{FoundOrigin, Georeference};
use echosplat_pose::OriginEpochs;
use echosplat_recording::mcap::Record;
use serde_json::{Value, json};

use super::poses::PoseReport;
use crate::clock;
use crate::maps::RunNotes;
use crate::recorder::Recorder;

/// The event of a recording that says where on Earth its map lies.
const GEOREFERENCE: &str = "georeference";

/// What was learned, told and recorded, each once.
pub(crate) struct Places {
    notes: RunNotes,
    recorder: Option<Recorder>,
    epochs: OriginEpochs,
    /// Epochs whose receiver contradicts what is known.
    contradicted: BTreeSet<u32>,
}

impl Places {
    /// With what was learned before the run, by the epoch of poses.
    pub(crate) fn new(
        notes: RunNotes,
        recorder: Option<Recorder>,
        known: Vec<(u32, Georeference)>,
    ) -> Self {
        let mut places = Self {
            notes,
            recorder,
            epochs: OriginEpochs::default(),
            contradicted: BTreeSet::new(),
        };
        for (epoch, place) in known {
            places.learn(epoch, &place);
        }
        places
    }

    /// Looks what poses and receiver tell by now.
    pub(crate) fn look(&mut self, poses: &PoseReport) {
        if let Some((epoch, told)) = &poses.told_origin
            && let Some(place) = self.epochs.of(*epoch, Some(told))
        {
            self.learn(*epoch, &place);
        }
        for found in &poses.found_origins {
            self.found(found);
        }
    }

    /// A map of this epoch begins, made of poses of that.
    pub(crate) fn map_begins(&self, map: u64, poses: u32) {
        self.notes.map_begins(map, poses);
    }

    fn learn(&mut self, epoch: u32, place: &Georeference) -> Option<Georeference> {
        let known = self.notes.learn(epoch, place);
        if known.is_none() {
            let line = place.line();
            tracing::info!("the map's place on Earth: {line}");
            if let Some(recorder) = &self.recorder {
                let event = georeference_event(epoch, &line);
                recorder.record(clock::now(), Record::Event(event));
            }
        }
        known
    }

    fn found(&mut self, found: &FoundOrigin) {
        match self.learn(found.epoch, &found.georeference) {
            None => tell_separation(found),
            Some(known) if found.contradicts(&known) && self.contradicted.insert(found.epoch) => {
                tracing::warn!("{}", contradiction(found, &known));
            }
            Some(_) => {}
        }
    }
}

/// Of a receiver that tells the geoid's height.
pub(crate) fn tell_separation(found: &FoundOrigin) {
    if let Some(separation_m) = found.separation_m {
        tracing::info!(
            "the receiver has mean sea level {separation_m:.1} m above the ellipsoid there: `export --separation \
             {separation_m:.1}` tells heights over that"
        );
    }
}

/// That fixes and what is known do not go together, in words.
pub(crate) fn contradiction(found: &FoundOrigin, known: &Georeference) -> String {
    format!(
        "{} fixes of the GNSS receiver have the world's origin {:.1} m from where `{}` has it, which stays",
        found.fixes,
        found.apart_m(known),
        known.source
    )
}

/// As [`georeference_of`] finds it.
fn georeference_event(epoch: u32, line: &str) -> Value {
    json!({ "event": GEOREFERENCE, "epoch": epoch, "georeference": line })
}

/// Where on Earth a recorded dive learned that the world of an epoch of its poses lies.
pub(crate) fn georeference_of(event: &Value) -> Option<(u32, Georeference)> {
    let is_it = event["event"] == GEOREFERENCE;
    let line = event["georeference"].as_str().filter(|_| is_it)?;
    // Recordings without the epoch learned of the first alone.
    let epoch = event["epoch"].as_u64().unwrap_or(0);
    Some((u32::try_from(epoch).ok()?, Georeference::parse(line).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_georeference::{Datum, Place};

    #[test]
    fn an_event_gives_back_epoch_and_place() {
        let place = Place::new(60.17, 24.94, 0.1 + 0.2).unwrap();
        let place = Georeference::at_origin(place, Datum::MeanSea, "GPS_GLOBAL_ORIGIN");
        let event = georeference_event(3, &place.line());
        assert_eq!(georeference_of(&event), Some((3, place.clone())));
        let old = json!({ "event": "georeference", "georeference": place.line() });
        assert_eq!(georeference_of(&old), Some((0, place)));
        for wrong in [
            json!({ "event": "begin" }),
            json!({ "event": "georeference", "epoch": -1 }),
        ] {
            assert_eq!(georeference_of(&wrong), None);
        }
    }
}
