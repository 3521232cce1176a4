//! `echosplat bench soak`: one service for hours, live with all that goes wrong out there and from a
//! log as fast as it goes; whether memory and descriptors stay as they were.

mod live;
mod memory;
mod replayed;

use crate::arguments::SoakBenchArguments;
use echosplat_service::exit::Finish;

use super::outcome::Outcome;
use super::{Told, conclude, overload, set_up, tell};

const LIVE_MINUTES: f64 = 60.0;
const REPLAYED_MINUTES: f64 = 90.0;
const QUICK_LIVE_MINUTES: f64 = 1.0;
const QUICK_REPLAYED_MINUTES: f64 = 4.0;
/// What is known of a structure that is seen for the first time grows for half an hour: the fence's
/// replay gained 17 MiB an hour between 13 and 40 minutes, and 0.3 between 30 and 90.
const WARM_UP_S: f64 = 1800.0;
/// Growth is judged over at least as long again.
const JUDGED_MINUTES: f64 = 60.0;

/// # Errors
/// If something cannot be run or written.
pub(in crate::commands) fn run(arguments: &SoakBenchArguments) -> anyhow::Result<Finish> {
    let quick = arguments.options.quick;
    let minutes = |asked: Option<f64>, whole, quickly| match (asked, quick) {
        (Some(asked), _) => asked,
        (None, true) => quickly,
        (None, false) => whole,
    };
    let live = minutes(arguments.live_minutes, LIVE_MINUTES, QUICK_LIVE_MINUTES);
    let replayed = arguments.replayed_minutes;
    let replayed = minutes(replayed, REPLAYED_MINUTES, QUICK_REPLAYED_MINUTES);
    let setup = set_up(
        &arguments.options,
        arguments.program.as_ref(),
        "soak",
        60.0 * live + 600.0,
    )?;
    let mut outcomes = Vec::new();
    let mut note = |outcome: Outcome| {
        tell(&outcome);
        outcomes.push(outcome);
    };
    note(replayed::run(&setup, replayed));
    let factors = overload::FACTORS.into_iter();
    for factor in factors.filter(|_| !setup.stop.is_set()) {
        note(overload::run(&setup, factor));
    }
    if !setup.stop.is_set() {
        note(live::run(&setup, live));
    }
    let told = Told {
        name: "soak",
        title: "A service for hours",
        options: &arguments.options,
        is_whole: !setup.stop.is_set(),
    };
    // Empty unless some case did not hold.
    let _ = std::fs::remove_dir(&setup.out);
    conclude(&told, &outcomes)
}

/// Settings that leave room for what is remembered to fill within minutes, so that all growth after
/// them is growth without end.
const SETTINGS: &str = "[mapper]\nhistory_pings = 4096\n[pose]\ncapacity = 8192\n";

/// As `config/echosplat.service` has it: threads share pools of memory, so that what one of them gave
/// back is there for the next.
fn environment() -> Vec<(String, String)> {
    vec![("MALLOC_ARENA_MAX".to_owned(), "2".to_owned())]
}

/// Notes growth from the warm-up on, without what is known to grow by `known` bytes a second of dive;
/// judged where it was looked at for long enough.
fn note_growth(samples: &[memory::Sample], minutes: f64, known: f64, outcome: &mut Outcome) {
    outcome.figure("minutes", minutes);
    outcome.figure("most memory MiB", memory::most_mib(samples));
    let growth = memory::mib_per_hour(samples, WARM_UP_S);
    let Some(growth) = growth.filter(|_| minutes >= JUDGED_MINUTES) else {
        return;
    };
    let known_mib = 3600.0 * known / memory::MIB;
    outcome.figure("MiB an hour after warm-up", growth);
    outcome.figure("of it the file's poses", known_mib);
    let growth = growth - known_mib;
    outcome.expect(growth <= memory::MOST_MIB_PER_HOUR, || {
        format!("memory grows by {growth:.2} MiB an hour")
    });
}

/// How the program is told where `setup`'s files are.
fn path(folder: &std::path::Path, name: &str) -> String {
    folder.join(name).display().to_string()
}
