//! A map that is followed over a link that carries less than deltas may take.

use std::fs;
use std::path::Path;
use std::time::Duration;

use crate::browser::say;
use crate::harness::Program;
use crate::namespaces::{End, Namespaces};

const LONG: Duration = Duration::from_secs(240);
/// Makes the dive so many seconds long, to measure.
const LENGTH: &str = "ECHOSPLAT_SLOW_LINK_S";

/// A map as a follower had it.
#[derive(Debug, Clone, Copy)]
struct Held {
    /// Time of day, seconds.
    at_s: f64,
    /// Of the newest ping in it, on the pings' clock.
    ping_s: f64,
}

/// What a follower says in its log, several times a second.
fn followed(watch: &Program) -> Vec<Held> {
    let log = watch.stderr();
    let lines = log.lines().filter_map(|line| {
        let (before, after) = line.split_once("the map followed ")?;
        let ping_ns: i64 = after.split_once("time_ns=")?.1.trim().parse().ok()?;
        let time = before.split_once('T')?.1.split_once('Z')?.0;
        let mut parts = time.split(':').map(|part| part.parse::<f64>().ok());
        let [hours, minutes, seconds] = [parts.next()??, parts.next()??, parts.next()??];
        Some(Held {
            at_s: 3600.0 * hours + 60.0 * minutes + seconds,
            ping_s: ping_ns as f64 * 1e-9,
        })
    });
    lines.collect()
}

/// How old the map was, in order of age, seconds: against the pings that were heard meanwhile, their
/// clock read off from whoever has them first.
fn ages_s(held: &[Held], first: &[Held], dive_s: f64) -> Vec<f64> {
    let lag = |held: &Held| held.at_s - held.ping_s;
    let least = first.iter().map(lag).fold(f64::INFINITY, f64::min);
    let begin = first.first().map_or(0.0, |held| held.at_s);
    let during = held.iter().filter(|held| held.at_s < begin + dive_s);
    let mut ages: Vec<f64> = during.map(|held| lag(held) - least).collect();
    ages.sort_by(f64::total_cmp);
    ages
}

/// The longest map that is followed is told; the final one is that of the service, byte for byte.
fn follow_over(rate: &str, dive_s: u32) {
    let Some(namespaces) = Namespaces::with_link_of(rate) else {
        return;
    };
    let folder = tempfile::tempdir().expect("there is room");
    let map = |who: &str| {
        folder
            .path()
            .join(format!("{who}.ply"))
            .display()
            .to_string()
    };
    let (ours, near, far) = (map("ours"), map("near"), map("far"));
    let seconds = dive_s.to_string();
    let dive = ["--sonar", "sim://fence", "--duration", &seconds];
    let run = ["run", "--node", "rov", "--map", &ours];
    let run = [&run[..], &dive, &Namespaces::host()].concat();
    let mut service = namespaces.echosplat(End::Vehicle, &run);
    service.wait_for_text("zenoh: ", LONG);
    let watch = |end, map: &str| {
        let own = [
            "watch",
            "--verbose",
            "--node",
            "rov",
            "--until-final",
            "--map",
            map,
        ];
        namespaces.echosplat(end, &[&own[..], &Namespaces::guest()].concat())
    };
    let mut at_vehicle = watch(End::Vehicle, &near);
    let mut ashore = watch(End::Shore, &far);
    for program in [&mut service, &mut at_vehicle, &mut ashore] {
        program.wait_exit_code(0, LONG + Duration::from_secs(dive_s.into()));
    }
    let first = followed(&at_vehicle);
    let ages = ages_s(&followed(&ashore), &first, dive_s.into());
    assert!(!ages.is_empty(), "{}", ashore.account());
    let size = fs::metadata(&ours).expect("it is written").len();
    say(&format!(
        "{rate}, {dive_s} s: the map ashore was {:.2} s old in the middle, {:.2} s at most; final map {size} B",
        ages[ages.len() / 2],
        ages[ages.len() - 1],
    ));
    for kind in ["ply", "ambiguous.ply"] {
        let bytes =
            |map: &str| fs::read(Path::new(map).with_extension(kind)).expect("it is written");
        assert!(bytes(&ours) == bytes(&far), "{kind}: {}", ashore.account());
        assert!(
            bytes(&ours) == bytes(&near),
            "{kind}: {}",
            at_vehicle.account()
        );
    }
}

/// Both links at once.
fn follow_over_slow_links(dive_s: u32) {
    std::thread::scope(|scope| {
        for rate in ["10mbit", "1mbit"] {
            scope.spawn(move || follow_over(rate, dive_s));
        }
    });
}

#[test]
fn a_map_followed_over_a_slow_link_is_whole_at_the_end() {
    let asked = std::env::var(LENGTH).ok();
    follow_over_slow_links(asked.and_then(|text| text.parse().ok()).unwrap_or(30));
}
