//! Dives that leave open where things are, or on which there is nothing.

use echosplat_simulator::Scene;

use super::Base;
use super::voyage::{self, Way};
use crate::stability::Row;
use crate::stability::row::{Comparison, Label};

const OPEN: Label = Label {
    case: "whole mapper: dives that leave elevation open",
    quantity: "confident Gaussians",
    why: "What is as well explained by its mirror image, or was seen from too few places, is \
          ambiguous and said to be.",
};

const NOTHING: Label = Label {
    case: "whole mapper: dives that leave elevation open",
    quantity: "Gaussians in the map",
    why: "An echo stands above the noise, or it is none.",
};

const WAYS: [(&str, Way); 4] = [
    ("level", Way::Level),
    ("one view", Way::OneView),
    ("identical views", Way::Still),
    ("pan", Way::Pan),
];

pub(super) fn rows(base: &Base) -> Vec<Row> {
    let count = if base.quick { 200 } else { 800 };
    let map = |scene: &Scene, way| base.map_of(&voyage::pings(scene, way, base.seed, count));
    let row = |(name, way): (&str, Way)| {
        let confident =
            map(&base.scene, way).map_or(f64::NAN, |made| made.confident_count() as f64);
        Comparison::of(0.0, confident, 1.0).row(OPEN, name, 0.0)
    };
    let mut rows: Vec<Row> = WAYS.into_iter().map(row).collect();
    let held = Scene::parse("name = \"empty\"", None).ok();
    let held = held.and_then(|empty| map(&empty, Way::Around));
    let held = held.map_or(f64::NAN, |made| made.snapshot.gaussians.len() as f64);
    rows.push(Comparison::of(0.0, held, 1.0).row(NOTHING, "no echo at all", 0.0));
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_still_dive_hears_the_structure() {
        let scene = voyage::scene().unwrap();
        let pings = voyage::pings(&scene, Way::Still, 1, 8);
        let loudest = pings
            .iter()
            .flat_map(|p| p.ping.intensity().iter().copied());
        assert!(loudest.fold(0.0, f32::max) > 10.0);
    }
}
