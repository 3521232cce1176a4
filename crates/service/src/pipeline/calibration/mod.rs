//! Whether clock, mount, compass and speed of sound fit the dive, looked at while it goes on, on a thread of its own that
//! nothing waits for. What is found is told; it changes nothing.
//!
//! Cost: at 4,800 pings, and whenever there are three times as many as the time before, a visit to at most 8,192 pings of the
//! map as it is, and three to six maps of 2,048 pings where that finds something off. At the end of a log the same once more,
//! and at least three maps of 1,024 pings for the speed of sound.

mod advice;

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use echosplat_mapper::{Calibration, ConfigError, Mapper, Questions};
use serde::Serialize;

use crate::config::{Calibrate, Config};
use crate::pipeline::Pace;
use crate::pipeline::effort::{Stopwatch, Took};
use crate::processor;
pub(crate) use advice::{Advice, Settings, set_mount};

/// Pings of the first estimate, two minutes at 40 a second: less tells next to nothing of small errors.
const FIRST_PINGS: u64 = 4800;
/// The next is due at so many times as many.
const GROWN: u64 = 3;
/// An estimate that is under way when a log ends is waited for so long.
const LAST: Duration = Duration::from_secs(60);
const THREAD_NAME: &str = "calibration";
const NOT_LOOKED_AT: &str = "clock and mount are not looked at";

/// What an estimate's thread ends with.
type Estimated = Result<Option<Calibration>, ConfigError>;

/// What was found, and what to set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Found {
    #[serde(flatten)]
    pub(crate) calibration: Calibration,
    /// Pings that it rests on.
    pub(crate) pings: u64,
    /// One for each thing that is off.
    pub(crate) advice: Vec<Advice>,
}

/// Asks a dive now and then.
#[derive(Debug)]
pub(crate) struct Watch {
    settings: Settings,
    gives_way: bool,
    /// Pings at which the next estimate is due; `None` for never.
    next_pings: Option<u64>,
    under_way: Option<(u64, JoinHandle<Estimated>)>,
    found: Option<Found>,
    stopwatch: Stopwatch,
}

impl Watch {
    /// Its thread has the least priority, except where the map sets the pace: the end of such a run would wait for it.
    pub(crate) fn new(config: &Config, pace: Pace) -> Self {
        Self {
            gives_way: pace != Pace::AsMapped,
            next_pings: match config.pipeline.calibrate {
                Calibrate::Off => None,
                Calibrate::Tell => Some(FIRST_PINGS),
            },
            ..Self::off(config)
        }
    }

    /// Never estimates anything.
    pub(crate) fn off(config: &Config) -> Self {
        Self {
            settings: Settings::of(config),
            gives_way: false,
            next_pings: None,
            under_way: None,
            found: None,
            stopwatch: Stopwatch::default(),
        }
    }

    /// Begins an estimate if one is due and there is time for it, and takes what the last one found. Never waits.
    pub(crate) fn advance(&mut self, mapper: &Mapper, has_time: bool) {
        self.take_found();
        if !has_time {
            return;
        }
        let pings = mapper.status().pings;
        if self.under_way.is_some() || self.next_pings.is_none_or(|next| pings < next) {
            return;
        }
        self.next_pings = Some(GROWN * pings);
        self.begin(mapper, Questions::InPassing);
    }

    /// At the end of a log: begins the last estimate, of the speed of sound too, once the one under way is done.
    pub(crate) fn end(&mut self, mapper: &Mapper) {
        self.wait();
        if self.next_pings.is_some() && mapper.status().pings >= FIRST_PINGS {
            self.begin(mapper, Questions::AtEnd);
        }
    }

    fn begin(&mut self, mapper: &Mapper, questions: Questions) {
        let pings = mapper.status().pings;
        let Some(mut calibrator) = mapper.calibrator() else {
            return;
        };
        calibrator.on_task(self.stopwatch.of_maps());
        let gives_way = self.gives_way;
        let run = move || {
            if gives_way {
                processor::give_way();
            }
            calibrator.run(questions)
        };
        let thread = std::thread::Builder::new().name(THREAD_NAME.to_owned());
        match thread.spawn(run) {
            Ok(thread) => self.under_way = Some((pings, thread)),
            Err(error) => tracing::warn!(%error, NOT_LOOKED_AT),
        }
    }

    fn take_found(&mut self) {
        let is_done = |(_, thread): &mut (u64, JoinHandle<_>)| thread.is_finished();
        let Some((pings, thread)) = self.under_way.take_if(is_done) else {
            return;
        };
        match thread.join() {
            Ok(Ok(Some(calibration))) => {
                self.found = Some(Found {
                    advice: self.settings.advice(&calibration),
                    calibration,
                    pings,
                });
            }
            Ok(Ok(None)) => {}
            Ok(Err(error)) => tracing::warn!(%error, NOT_LOOKED_AT),
            Err(_) => tracing::warn!("looking at clock and mount failed; the map is as it was"),
        }
    }

    /// What its maps took so far.
    pub(crate) fn took(&self) -> Took {
        self.stopwatch.took()
    }

    /// What the newest estimate found.
    pub(crate) fn found(&self) -> Option<Found> {
        self.found.clone()
    }

    /// Another map begins: what was found of the one before says nothing of it.
    pub(crate) fn begin_anew(&mut self) {
        self.under_way = None;
        self.found = None;
        self.next_pings = self.next_pings.map(|_| FIRST_PINGS);
    }

    /// Waits for an estimate that is under way.
    pub(crate) fn wait(&mut self) {
        let deadline = Instant::now() + LAST;
        while self.under_way.is_some() && Instant::now() < deadline {
            self.take_found();
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}
