//! What the demo says before it begins, and what it advises at its end.

use std::path::Path;

use echosplat_simulator::Dive;

/// Times real time where somebody looks on: a dive of four minutes in one.
pub(super) const WATCHED_RATE: f64 = 4.0;

/// What the whole dive at the fence was seen to take on two cores of a server.
const SEEN: &str =
    "The whole dive of 240 s at the fence takes about 70 s on two busy cores of a server.";

/// What will happen, and how long it may take.
pub(super) fn plan(dive: &Dive, scene: &str, is_watched: bool, out: &Path) -> String {
    let length_s = dive.duration_s();
    let pace = match is_watched {
        true => format!(
            "It runs at {WATCHED_RATE:.0} times real time, so that you can look on: {:.0} s or longer.",
            length_s / WATCHED_RATE
        ),
        false => format!("It runs as fast as this computer maps. {SEEN}"),
    };
    format!(
        "EchoSplat demo: the whole service with a simulated sonar, no hardware needed.\n  \
         1. The sonar sends {} pings, {length_s:.0} s of a dive at the {scene}.\n  \
         2. The service maps them. Every 10 s of the dive a line says how near the map is to the truth.\n  \
         3. Map and report are written to {}.\n{pace}",
        dive.pings(),
        out.display()
    )
}

/// The three commands that come next.
pub(super) fn next(program: &str) -> String {
    let lines = commands(program).map(|(command, what)| format!("\n  {command:<45} {what}"));
    format!("Next:{}", lines.concat())
}

fn commands(program: &str) -> [(String, &'static str); 3] {
    [
        (
            format!("{program} demo --web 8080"),
            "# the same dive, live in a browser",
        ),
        (
            format!("{program} probe"),
            "# finds your sonar, or says what is in the way",
        ),
        (
            format!("{program} config --basic > my.toml"),
            "# the settings for dives of your own",
        ),
    ]
}

/// The program as it was called, if that was by a path: it may not be installed.
pub(super) fn called() -> String {
    let first = std::env::args().next().unwrap_or_default();
    let is_path = first.contains('/') && !first.contains(char::is_whitespace);
    match is_path {
        true => first,
        false => "echosplat".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::{DiveArguments, parsed};
    use crate::dives;

    #[test]
    fn the_plan_names_the_dive_of_its_own_scene() {
        let arguments = DiveArguments {
            scene: "pier".to_owned(),
            ..DiveArguments::default()
        };
        let sonar = dives::sonar(&arguments, Some(12.0)).unwrap();
        let said = |is_watched| plan(sonar.dive(), "pier", is_watched, Path::new("there"));
        for words in [said(false), said(true)] {
            assert!(
                words.contains("480 pings, 12 s of a dive at the pier"),
                "{words}"
            );
            assert!(words.contains("written to there."), "{words}");
        }
        assert!(said(true).contains(": 3 s or longer"), "{}", said(true));
    }

    #[test]
    fn what_comes_next_is_taken_by_the_command_line() {
        for (command, _) in commands("echosplat") {
            let (words, _) = command.split_once(" > ").unwrap_or((&command, ""));
            let words = words.split_whitespace().skip(1).map(str::to_owned);
            assert!(parsed(words).is_ok(), "{command}");
        }
        assert_eq!(next("target/release/echosplat").lines().count(), 4);
    }
}
