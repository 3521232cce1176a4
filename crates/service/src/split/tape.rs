//! The driver's tape as the mapper's sonar thread reads it.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use crossbeam_channel::{Sender, bounded};
use echosplat_bus::{
    Heard, TapeEntry, TapeFollower, TapeFollowerCounters, TapeRecord, TapeTrouble,
};
use echosplat_driver::{DriverConfig, SonarUrl, TapeItem};
use echosplat_join::ArrivedPose;
use echosplat_model::{RateLimit, Timestamp};
use echosplat_pose::PoseSource;
use echosplat_recording::mcap::Record;
use serde::{Serialize, Serializer};

use super::begin::{Begin, position_event};
use super::dive_log::{POSITION_EVERY, record};
use super::resumed::Resumed;
use super::waiting::{not_a_driver, wait_for_driver};
use crate::clock;
use crate::pipeline::Input;
use crate::recorder::Recorder;
use crate::signals::Stop;

/// How long nothing may come before the reader looks whether it is to stop.
pub(super) const LOOK: Duration = Duration::from_millis(50);

/// What the mapper knows of its driver.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(crate) struct TapeReport {
    /// Names the driver's run: its start in nanoseconds.
    pub(crate) driver: Option<u64>,
    /// Records read from recordings before the driver was asked.
    pub(crate) resumed: u64,
    /// Number of the record that is asked for next.
    pub(crate) next: u64,
    /// For how long the driver has owed an answer, seconds; `null` before the first.
    pub(crate) silent_s: Option<f64>,
    #[serde(flatten)]
    pub(crate) counters: TapeFollowerCounters,
    /// What was wrong with the first answer that could not be read.
    pub(crate) first_fault: Option<String>,
    /// What is wrong with what has answered of late.
    #[serde(serialize_with = "in_words")]
    pub(crate) trouble: Option<TapeTrouble>,
}

fn in_words<S: Serializer>(trouble: &Option<TapeTrouble>, to: S) -> Result<S::Ok, S::Error> {
    trouble.as_ref().map(ToString::to_string).serialize(to)
}

/// The newest report, written by the thread that reads the tape.
#[derive(Debug, Clone, Default)]
pub(crate) struct TapeState(Arc<Mutex<TapeReport>>);

impl TapeState {
    pub(crate) fn read(&self) -> TapeReport {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    fn write(&self, report: TapeReport) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = report;
    }
}

/// One thing to be played. A pose is handed over as its mark is.
enum Next {
    Item(Timestamp, TapeItem),
    Pose(Timestamp, ArrivedPose),
}

/// The dive as its driver hears it, after what recordings hold of it: an iterator that ends with the
/// dive.
pub(crate) struct VehicleTape {
    follower: TapeFollower,
    resumed: Option<Resumed>,
    begin: Begin,
    /// The first answer, heard before anything was started.
    first: Option<Heard>,
    recorder: Option<Recorder>,
    position_told: Option<Instant>,
    /// To the mapper's thread, each before its mark.
    poses: Sender<ArrivedPose>,
    poses_ended: Arc<AtomicBool>,
    pose_count: u64,
    ready: VecDeque<Next>,
    is_link_up: bool,
    is_over: bool,
    now: Timestamp,
    /// The driver and the number of the record that comes next.
    position: Option<(u64, u64)>,
    resumed_count: u64,
    /// What is said of drivers that were started again, and of records that are missing.
    restarts_told: RateLimit,
    missing_told: RateLimit,
    state: TapeState,
}

impl VehicleTape {
    /// Waits until the driver says how the sonar is asked, unless a recording has said so. Gives
    /// `None` if it was asked to stop before.
    ///
    /// # Errors
    /// If the bus is closed, or the driver says what no driver does.
    pub(crate) fn meet(
        mut follower: TapeFollower,
        resumed: Option<Resumed>,
        queue_pings: usize,
        stop: &Stop,
    ) -> anyhow::Result<Option<(Self, PoseSource)>> {
        let (begin, first) = match &resumed {
            Some(resumed) => (resumed.begin().clone(), None),
            None => match wait_for_driver(&mut follower, stop)? {
                Some((begin, first)) => (begin, Some(first)),
                None => return Ok(None),
            },
        };
        // Each pose is taken with its mark, and marks wait in a queue of that length.
        let (poses, taken) = bounded(queue_pings + 16);
        let poses_ended = Arc::new(AtomicBool::new(false));
        let source = PoseSource::taped(taken, Arc::clone(&poses_ended));
        let tape = Self {
            follower,
            resumed,
            begin,
            first,
            recorder: None,
            position_told: None,
            poses,
            poses_ended,
            pose_count: 0,
            ready: VecDeque::new(),
            is_link_up: false,
            is_over: false,
            now: Timestamp::ZERO,
            position: None,
            resumed_count: 0,
            restarts_told: RateLimit::new(),
            missing_told: RateLimit::new(),
            state: TapeState::default(),
        };
        Ok(Some((tape, source)))
    }

    pub(crate) fn begin(&self) -> &Begin {
        &self.begin
    }

    pub(crate) fn state(&self) -> TapeState {
        self.state.clone()
    }

    /// The same, recording what the driver says.
    pub(crate) fn recorded_by(mut self, recorder: Option<Recorder>) -> Self {
        self.recorder = recorder;
        self
    }

    /// The mapper's input in the place of a link.
    pub(crate) fn into_input(self) -> Input {
        let session = self.begin.session.clone();
        Input {
            config: DriverConfig {
                session,
                ..DriverConfig::new(SonarUrl::File("driver".into()))
            },
            tape: Some(Box::new(move || Ok(Box::new(self)))),
            byte_count: None,
            records_itself: true,
        }
    }

    /// # Errors
    /// In words that say why the tape cannot be followed further.
    fn read_on(&mut self) -> Result<(), String> {
        if let Some(mut resumed) = self.resumed.take() {
            match resumed.next_record()? {
                Some(record) => {
                    self.resumed_count += 1;
                    self.is_link_up = match record.entry {
                        TapeEntry::LinkUp => true,
                        TapeEntry::LinkDown => false,
                        _ => self.is_link_up,
                    };
                    self.queue(record);
                    self.resumed = Some(resumed);
                }
                None => self.go_over(&resumed)?,
            }
            if self.resumed_count.is_multiple_of(1024) {
                self.report();
            }
            return Ok(());
        }
        let heard = match self.first.take() {
            Some(first) => Some(first),
            None => self
                .follower
                .hear(LOOK)
                .map_err(|error| error.to_string())?,
        };
        let result = heard.map_or(Ok(()), |heard| self.take(heard));
        self.report();
        result
    }

    /// From the recordings to the driver.
    fn go_over(&mut self, resumed: &Resumed) -> Result<(), String> {
        let Some((driver, next)) = resumed.position() else {
            return Err("the recording does not say where in the dive it ends".to_owned());
        };
        tracing::info!(
            records = self.resumed_count,
            "the recording is read; going on with record {next} of the driver"
        );
        self.follower.go_on_from(driver, next);
        self.position = Some((driver, next));
        self.ready.push_back(Next::Item(self.now, TapeItem::GoesOn));
        Ok(())
    }

    fn take(&mut self, heard: Heard) -> Result<(), String> {
        let before = self.position.map(|(driver, _)| driver);
        if let Some(told) = &heard.begin {
            let Some(begin) = Begin::read(told) else {
                self.follower.refuse(not_a_driver(told));
                return Ok(());
            };
            if begin.session != self.begin.session {
                return Err(
                    "the driver was started again with other settings of the sonar: \
                            start the mapper again for a new map"
                        .to_owned(),
                );
            }
        }
        self.tell_of_breaks(&heard);
        let is_broken = heard.missing > 0 || before.is_some_and(|before| before != heard.driver);
        if is_broken {
            self.position_told = None;
            self.link(false);
        }
        for (number, record) in (heard.first..).zip(heard.records) {
            self.now = record.host_time;
            let is_link = matches!(record.entry, TapeEntry::LinkUp | TapeEntry::LinkDown);
            if !self.is_link_up && !is_link && record.entry != TapeEntry::End {
                self.link(true);
            }
            self.record(heard.driver, number, &record);
            self.position = Some((heard.driver, number + 1));
            match record.entry {
                TapeEntry::LinkUp => self.is_link_up = true,
                TapeEntry::LinkDown => self.is_link_up = false,
                _ => {}
            }
            self.queue(record);
        }
        match self.is_over {
            true => self
                .follower
                .acknowledge()
                .map_err(|error| error.to_string()),
            false => Ok(()),
        }
    }

    fn tell_of_breaks(&mut self, heard: &Heard) {
        let more = |left_out: u64| match left_out {
            0 => String::new(),
            count => format!(" ({count} times more before this)"),
        };
        let now = clock::now();
        let is_again = heard.begin.is_some() && self.position.is_some();
        if is_again && let Some(left_out) = self.restarts_told.admit(now) {
            tracing::warn!(
                "the driver was started again; the map goes on{}",
                more(left_out)
            );
        }
        if heard.missing > 0
            && let Some(left_out) = self.missing_told.admit(now)
        {
            tracing::warn!(
                "{} records of the dive are no longer kept by the driver: they are missing in the \
                 map{}",
                heard.missing,
                more(left_out)
            );
        }
    }

    /// The link's news that the tape itself does not say: what came before is lost.
    fn link(&mut self, is_up: bool) {
        if self.is_link_up == is_up {
            return;
        }
        self.is_link_up = is_up;
        let (item, entry) = match is_up {
            true => (TapeItem::LinkUp, TapeEntry::LinkUp),
            false => (TapeItem::LinkDown, TapeEntry::LinkDown),
        };
        self.ready.push_back(Next::Item(self.now, item));
        if let Some(recorder) = &self.recorder {
            record(recorder, self.now, &entry);
            self.position_told = None;
        }
    }

    fn record(&mut self, driver: u64, number: u64, tape_record: &TapeRecord) {
        let Some(recorder) = &self.recorder else {
            return;
        };
        let is_due = |told: Instant| told.elapsed() >= POSITION_EVERY;
        if self.position_told.is_none_or(is_due) {
            self.position_told = Some(Instant::now());
            let event = Record::Event(position_event(driver, number));
            recorder.record(tape_record.host_time, event);
        }
        record(recorder, tape_record.host_time, &tape_record.entry);
    }

    fn queue(&mut self, record: TapeRecord) {
        let time = record.host_time;
        let item = match record.entry {
            TapeEntry::LinkUp => TapeItem::LinkUp,
            TapeEntry::LinkDown => TapeItem::LinkDown,
            TapeEntry::HalfFrameExpired => TapeItem::HalfFrameExpired,
            TapeEntry::Bytes(bytes) => TapeItem::Bytes(bytes),
            TapeEntry::Pose(pose) => {
                let arrived = time;
                let pose = ArrivedPose { pose, arrived };
                return self.ready.push_back(Next::Pose(time, pose));
            }
            TapeEntry::End => return self.is_over = true,
        };
        self.ready.push_back(Next::Item(time, item));
    }

    fn report(&self) {
        let counters = self.follower.counters();
        let silent = self.follower.silent_for();
        let report = TapeReport {
            driver: self.position.map(|(driver, _)| driver),
            resumed: self.resumed_count,
            next: self.position.map_or(0, |(_, next)| next),
            silent_s: silent.map(|silent| silent.as_secs_f64()),
            counters,
            first_fault: self.follower.first_fault().map(str::to_owned),
            trouble: self.follower.trouble().cloned(),
        };
        self.state.write(report);
    }
}

impl Iterator for VehicleTape {
    type Item = Result<(Timestamp, TapeItem), String>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ready.is_empty()
            && !self.is_over
            && let Err(words) = self.read_on()
        {
            self.is_over = true;
            return Some(Err(words));
        }
        match self.ready.pop_front() {
            Some(Next::Item(time, item)) => Some(Ok((time, item))),
            Some(Next::Pose(time, pose)) => {
                // There is room for as many as marks wait; without, the mapper has ended.
                let _ = self.poses.try_send(pose);
                self.pose_count += 1;
                Some(Ok((time, TapeItem::Mark(self.pose_count))))
            }
            None if self.is_over => None,
            None => Some(Ok((self.now, TapeItem::Nothing))),
        }
    }
}

impl Drop for VehicleTape {
    fn drop(&mut self) {
        self.poses_ended.store(true, Ordering::Release);
    }
}
