//! The simulated sonar, which outlives its links, and whose frames are spoilt on their way out.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use echosplat_driver::EmulatedDevice;
use echosplat_firmware_protocol::{Decoder, Event, Message, OsMonoProfile};
use echosplat_model::Timestamp;
use echosplat_simulator::{SimulatedDevice, SimulatedSonar};

use crate::draw::Draw;
use echosplat_service::clock;

/// One profile in so many comes through when it is slow.
const SLOW_EVERY: u64 = 20;
/// Frames are held back so long when they are delayed.
const DELAY: Duration = Duration::from_secs(3);
/// From ping to ping, as the configuration asks for.
pub(super) const PING_INTERVAL_MS: u32 = 25;
/// Silent and sounding of an intermittent link, seconds.
const SILENT_S: f64 = 1.6;
const SOUNDING_S: f64 = 1.0;

/// What is wrong with the frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SonarFault {
    /// Nothing comes.
    Off,
    /// The newest sound profile comes again and again.
    Stuck,
    /// Bytes that mean nothing.
    Garbage,
    /// Profiles with a speed of sound of 0.
    Wrong,
    /// One profile in twenty.
    Slow,
    /// All come three seconds late.
    Delayed,
    /// Off for 1.6 s, on for 1 s.
    Intermittent,
}

/// A profile as it left the device, sound, with somebody there to hear it.
#[derive(Debug, Clone, Copy)]
pub(super) struct SentPing {
    pub(super) at: Instant,
    /// This host's clock.
    pub(super) host_time: Timestamp,
    /// As in the profile.
    pub(super) number: u32,
}

/// The device, shared by those who serve it one after another.
pub(super) struct Sonar(Mutex<State>);

struct State {
    device: SimulatedDevice,
    /// When its time was 0; `None` before the first ping.
    epoch: Option<Instant>,
    fault: Option<(SonarFault, Instant)>,
    /// Whether a client has asked for anything on the link as it is now.
    is_heard: bool,
    sent: Vec<SentPing>,
    held: VecDeque<(Instant, Vec<u8>)>,
    sound_profile: Vec<u8>,
    counters: DeviceCounts,
    /// So many pings in place of each.
    crowd: u32,
    /// Of these, what is not due yet.
    pieces: VecDeque<Piece>,
    draw: Draw,
}

/// Profiles that leave the device at one time, and the number and time in each.
struct Piece {
    due: Timestamp,
    frames: Vec<u8>,
    stamps: Vec<(u32, u32)>,
}

/// What is taken off or added to the counters in a profile, modulo 2³².
#[derive(Debug, Clone, Copy, Default)]
struct DeviceCounts {
    number: u32,
    clock_ms: u32,
    profiles: u64,
    newest: (u32, u32),
}

impl Sonar {
    /// Its millisecond counter begins at `clock_ms`.
    pub(super) fn new(simulated: Arc<SimulatedSonar>, seed: u64, clock_ms: u32) -> Arc<Self> {
        Arc::new(Self(Mutex::new(State {
            device: SimulatedDevice::new(simulated),
            epoch: None,
            fault: None,
            is_heard: false,
            sent: Vec::new(),
            held: VecDeque::new(),
            sound_profile: Vec::new(),
            counters: DeviceCounts {
                clock_ms,
                ..DeviceCounts::default()
            },
            crowd: 1,
            pieces: VecDeque::new(),
            draw: Draw::new(seed, 1),
        })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins a fault, or ends it.
    pub(super) fn set_fault(&self, fault: Option<SonarFault>) {
        self.state().fault = fault.map(|fault| (fault, Instant::now()));
    }

    /// From now on it pings so many times as often.
    pub(super) fn set_crowd(&self, crowd: u32) {
        self.state().crowd = crowd.max(1);
    }

    /// Its counters begin anew, as after a power cut.
    pub(super) fn reboot(&self) {
        let mut state = self.state();
        let (number, clock_ms) = state.counters.newest;
        state.counters.number = state.counters.number.wrapping_sub(number);
        state.counters.clock_ms = state.counters.clock_ms.wrapping_sub(clock_ms);
    }

    /// Sound profiles that left it so far while there was a client.
    pub(super) fn sent(&self) -> Vec<SentPing> {
        self.state().sent.clone()
    }

    pub(super) fn sent_count(&self) -> u64 {
        self.state().sent.len() as u64
    }

    /// Seconds into the dive; `None` before the first ping.
    pub(super) fn dive_s(&self) -> Option<f64> {
        let epoch = self.state().epoch;
        epoch.map(|epoch| epoch.elapsed().as_secs_f64())
    }

    /// To be served: the dive goes on as if it had pinged all the while.
    pub(super) fn served(self: &Arc<Self>) -> Box<dyn EmulatedDevice> {
        let begin = self
            .dive_s()
            .map_or(Timestamp::ZERO, Timestamp::from_secs_f64);
        let mut state = self.state();
        state.is_heard = false;
        while state.device.next_due().is_some_and(|due| due < begin) {
            let unheard = state.device.advance(begin);
            state.newest_of(&unheard);
        }
        drop(state);
        Box::new(Served {
            sonar: Arc::clone(self),
            begin_nanos: begin.nanos(),
        })
    }
}

impl State {
    fn next_due(&self) -> Option<Timestamp> {
        let piece = self.pieces.front().map(|piece| piece.due);
        piece.into_iter().chain(self.device.next_due()).min()
    }

    /// What leaves the device in place of `frames`.
    fn spoilt(&mut self, mut frames: Vec<u8>, due: Timestamp, out: &mut Vec<u8>) {
        let now = Instant::now();
        self.recounted(&mut frames);
        let is_ping = self.newest_of(&frames);
        let fault = self.fault;
        if fault.is_none_or(|(kind, _)| kind != SonarFault::Delayed) {
            out.extend(self.held.drain(..).flat_map(|(_, bytes)| bytes));
        }
        let Some((kind, since)) = fault else {
            if is_ping && self.crowd > 1 {
                return self.crowded(&frames, due, out);
            }
            if is_ping {
                self.sound_profile.clone_from(&frames);
                self.note_sent(now);
            }
            out.extend(frames);
            return;
        };
        match kind {
            SonarFault::Off => {}
            SonarFault::Stuck if is_ping => out.extend(&self.sound_profile),
            SonarFault::Garbage => out.extend(self.draw.bytes(frames.len())),
            SonarFault::Wrong => {
                out.extend(edited(&frames, &mut |profile| profile.sos_dmps = 0));
            }
            SonarFault::Slow if is_ping => {
                if self.counters.profiles.is_multiple_of(SLOW_EVERY) {
                    self.note_sent(now);
                    out.extend(frames);
                }
            }
            SonarFault::Delayed => {
                self.held.push_back((now, frames));
                let due = self.held.partition_point(|(at, _)| *at + DELAY <= now);
                out.extend(self.held.drain(..due).flat_map(|(_, bytes)| bytes));
            }
            SonarFault::Intermittent => {
                let phase_s = now.duration_since(since).as_secs_f64() % (SILENT_S + SOUNDING_S);
                if phase_s >= SILENT_S {
                    if is_ping {
                        self.note_sent(now);
                    }
                    out.extend(frames);
                }
            }
            SonarFault::Stuck | SonarFault::Slow => out.extend(frames),
        }
    }

    fn recounted(&mut self, frames: &mut Vec<u8>) {
        let shift = self.counters;
        if shift.number != 0 || shift.clock_ms != 0 {
            *frames = edited(frames, &mut |profile| {
                profile.ping_number = profile.ping_number.wrapping_add(shift.number);
                profile.timestamp_ms = profile.timestamp_ms.wrapping_add(shift.clock_ms);
            });
        }
    }

    /// Notes the newest counters in `frames`; says whether there is a profile among them.
    fn newest_of(&mut self, frames: &[u8]) -> bool {
        let mut newest = None;
        edited(frames, &mut |profile| {
            newest = Some((profile.ping_number, profile.timestamp_ms));
        });
        let Some(newest) = newest else { return false };
        self.counters.newest = newest;
        self.counters.profiles += 1;
        true
    }

    /// Many pings in place of the one in `frames`, a piece a millisecond until the next is due.
    fn crowded(&mut self, frames: &[u8], due: Timestamp, out: &mut Vec<u8>) {
        let (crowd, (first, begin_ms)) = (self.crowd, self.counters.newest);
        for index in 0..crowd {
            let after_ms = index * PING_INTERVAL_MS / crowd;
            let stamp = (first.wrapping_add(index), begin_ms.wrapping_add(after_ms));
            let frames = edited(frames, &mut |profile| {
                (profile.ping_number, profile.timestamp_ms) = stamp;
            });
            let due = due.offset_by(f64::from(after_ms) * 1e-3);
            match self.pieces.back_mut().filter(|piece| piece.due == due) {
                Some(piece) => {
                    piece.frames.extend(frames);
                    piece.stamps.push(stamp);
                }
                None => self.pieces.push_back(Piece {
                    due,
                    frames,
                    stamps: vec![stamp],
                }),
            }
        }
        self.counters.number = self.counters.number.wrapping_add(crowd - 1);
        self.piece_due(due, out);
    }

    /// The piece that is due by then, if there is one.
    fn piece_due(&mut self, due: Timestamp, out: &mut Vec<u8>) -> bool {
        let is_due = |piece: &Piece| piece.due <= due;
        if !self.pieces.front().is_some_and(is_due) {
            return false;
        }
        let Some(piece) = self.pieces.pop_front() else {
            return false;
        };
        for stamp in piece.stamps {
            self.counters.newest = stamp;
            self.note_sent(Instant::now());
        }
        out.extend(piece.frames);
        true
    }

    fn note_sent(&mut self, at: Instant) {
        if !self.is_heard {
            return;
        }
        self.sent.push(SentPing {
            at,
            host_time: clock::now(),
            number: self.counters.newest.0,
        });
    }
}

/// The device on one link.
struct Served {
    sonar: Arc<Sonar>,
    /// The device's time when the link's is 0.
    begin_nanos: i64,
}

impl Served {
    fn links_time(&self, due: Option<Timestamp>) -> Option<Timestamp> {
        due.map(|due| due.offset_by_nanos(-self.begin_nanos))
    }
}

impl EmulatedDevice for Served {
    fn receive(&mut self, bytes: &[u8], now: Timestamp, out: &mut Vec<u8>) {
        let now = now.offset_by_nanos(self.begin_nanos);
        let mut state = self.sonar.state();
        state.is_heard = true;
        let mut answers = Vec::new();
        EmulatedDevice::receive(&mut state.device, bytes, now, &mut answers);
        if state.fault.is_none_or(|(kind, _)| kind != SonarFault::Off) {
            out.extend(answers);
        }
    }

    fn next_due(&self) -> Option<Timestamp> {
        self.links_time(self.sonar.state().next_due())
    }

    fn next_ping_due(&self) -> Option<Timestamp> {
        self.links_time(self.sonar.state().device.next_ping_due())
    }

    fn transmit(&mut self, out: &mut Vec<u8>) {
        let mut state = self.sonar.state();
        let Some(due) = state.next_due() else {
            return;
        };
        let now = Instant::now();
        if state.epoch.is_none() {
            let due_s = Duration::try_from_secs_f64(due.as_secs_f64()).unwrap_or_default();
            state.epoch = now.checked_sub(due_s);
        }
        if state.piece_due(due, out) {
            return;
        }
        let frames = state.device.advance(due);
        state.spoilt(frames, due, out);
    }

    fn is_finished(&self) -> bool {
        self.sonar.state().device.is_finished()
    }
}

/// `frames` with each profile changed; all other frames as they were.
pub(super) fn edited(frames: &[u8], change: &mut dyn FnMut(&mut OsMonoProfile<'_>)) -> Vec<u8> {
    let mut out = Vec::with_capacity(frames.len());
    Decoder::new().feed(frames, &mut |event| {
        let Event::Frame(frame) = event else { return };
        let Ok(Message::OsMonoProfile(mut profile)) = Message::parse(&frame) else {
            return out.extend(frame.bytes());
        };
        change(&mut profile);
        let message = Message::OsMonoProfile(profile);
        let mut bytes = vec![0; message.encoded_byte_count()];
        let (from, to) = (frame.src_device_id(), frame.dst_device_id());
        // As long as it was, so it fits.
        if message.encode(from, to, &mut bytes).is_ok() {
            out.extend(bytes);
        }
    });
    out
}
