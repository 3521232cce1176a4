//! Several units on one link or in one log, and devices that are none of ours.

use echosplat_driver::{DriverStatus, LinkState};
use echosplat_session::UnitHeard;

use super::super::loss;
use crate::pipeline::notices::Finding;

/// The keys that choose among units.
const KEYS: &str = "session.channel, session.source or session.heading_deg";

/// Profiles of a unit that nobody chose or left out by choice, or of none at all.
pub(in crate::pipeline) fn finding(sonar: &DriverStatus) -> Option<Finding> {
    let is_ended = sonar.link == LinkState::Ended;
    let (mapped, others): (Vec<&UnitHeard>, Vec<&UnitHeard>) =
        sonar.units.iter().partition(|unit| unit.is_mapped);
    let Some(first) = mapped.first() else {
        if others.is_empty() {
            return sonar
                .other_product
                .filter(|_| is_ended)
                .map(of_another_device);
        }
        return Some(loss(
            "no-such-unit",
            format!(
                "no profile of the unit that is asked for came: heard are {}; {KEYS} says which is mapped",
                listed(&others)
            ),
        ));
    };
    if let Some(other) = mapped.iter().find(|unit| looks_elsewhere(unit, first)) {
        return Some(loss(
            "units-mixed",
            format!(
                "the logs hold pings of different units, and all are mapped: {} and {}; {KEYS} chooses one",
                first.label, other.label
            ),
        ));
    }
    if others.is_empty() || sonar.unit_is_chosen {
        return None;
    }
    let is_twin = others
        .iter()
        .any(|other| !looks_elsewhere(other, first) && other.label.source == first.label.source);
    let remedy = match is_twin {
        true => "these say the same of themselves, so that none can be chosen: give each a channel of its own".to_owned(),
        false => format!("{KEYS} chooses one, this one too"),
    };
    Some(loss(
        "second-unit",
        format!(
            "profiles of several units come: those of {} are mapped, and those of {} left out; {remedy}",
            first.label,
            listed(&others)
        ),
    ))
}

fn of_another_device(product: &str) -> Finding {
    loss(
        "other-device",
        format!("the log holds messages of a {product}, and no profile of an OmniScan 450"),
    )
}

/// Whether two units differ by more than the number that a log gives them.
fn looks_elsewhere(unit: &UnitHeard, other: &UnitHeard) -> bool {
    let apart_deg = unit.label.heading_deg - other.label.heading_deg;
    let apart_deg = (apart_deg + 180.0).rem_euclid(360.0) - 180.0;
    unit.label.channel != other.label.channel || apart_deg.abs() > 10.0
}

fn listed(units: &[&UnitHeard]) -> String {
    let listed: Vec<String> = units
        .iter()
        .map(|unit| format!("{} ({} profiles)", unit.label, unit.profiles))
        .collect();
    listed.join(" and ")
}
