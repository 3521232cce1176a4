//! What the driver hears goes into its recording and to mappers in one order, whichever thread heard
//! it.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use echosplat_bus::{TapeEntry, TapeKeeper, TapeKeeperCounters};
use echosplat_driver::{RawTap, Tapped};
use echosplat_join::ArrivedPose;
use echosplat_model::Timestamp;
use echosplat_recording::mcap::Record;

use super::begin::position_event;
use crate::recorder::Recorder;

/// A recording says so often where in the tape it is: whoever goes on from it counts from there.
pub(super) const POSITION_EVERY: Duration = Duration::from_secs(1);

/// The recording, if there is one, and the tape that mappers ask for. Neither is waited for.
#[derive(Clone)]
pub(super) struct DiveLog {
    driver: u64,
    keeper: Arc<TapeKeeper>,
    recorder: Option<Recorder>,
    /// Held while a record goes to both; when the position was last recorded.
    order: Arc<Mutex<Option<Instant>>>,
}

impl DiveLog {
    pub(super) fn new(driver: u64, keeper: Arc<TapeKeeper>, recorder: Option<Recorder>) -> Self {
        Self {
            driver,
            keeper,
            recorder,
            order: Arc::default(),
        }
    }

    /// For the sonar's task.
    pub(super) fn raw_tap(&self) -> RawTap {
        let log = self.clone();
        Box::new(move |host_time, tapped| log.tapped(host_time, tapped))
    }

    pub(super) fn pose(&self, pose: &ArrivedPose) {
        self.add(pose.arrived, TapeEntry::Pose(pose.pose));
    }

    pub(super) fn end(&self, host_time: Timestamp) {
        self.add(host_time, TapeEntry::End);
    }

    pub(super) fn counters(&self) -> TapeKeeperCounters {
        self.keeper.counters()
    }

    /// That a ping found no room here is no matter: the mapper makes its own of the bytes.
    fn tapped(&self, host_time: Timestamp, tapped: Tapped<'_>) {
        match tapped {
            Tapped::LinkUp => self.add(host_time, TapeEntry::LinkUp),
            Tapped::LinkDown => self.add(host_time, TapeEntry::LinkDown),
            Tapped::HalfFrameExpired => self.add(host_time, TapeEntry::HalfFrameExpired),
            Tapped::Bytes(bytes) => {
                for piece in self.keeper.pieces(bytes) {
                    self.add(host_time, TapeEntry::Bytes(piece));
                }
            }
            Tapped::PingsShed(..) => {}
        }
    }

    fn add(&self, host_time: Timestamp, entry: TapeEntry) {
        let mut told = self.order.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(recorder) = &self.recorder {
            if told.is_none_or(|told| told.elapsed() >= POSITION_EVERY) {
                *told = Some(Instant::now());
                let event = position_event(self.driver, self.keeper.counters().next);
                recorder.record(host_time, Record::Event(event));
            }
            record(recorder, host_time, &entry);
        }
        self.keeper.append(host_time, entry);
    }
}

/// One record of the tape is one of the recording; its end is none.
pub(super) fn record(recorder: &Recorder, host_time: Timestamp, entry: &TapeEntry) {
    match entry {
        TapeEntry::LinkUp => recorder.link(host_time, true),
        TapeEntry::LinkDown => recorder.link(host_time, false),
        TapeEntry::HalfFrameExpired => recorder.record(host_time, Record::HalfFrameExpired),
        TapeEntry::Bytes(bytes) => recorder.record(host_time, Record::Raw(Bytes::clone(bytes))),
        TapeEntry::Pose(pose) => recorder.record(host_time, Record::Pose(*pose)),
        TapeEntry::End => {}
    }
}
