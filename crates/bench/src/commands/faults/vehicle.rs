//! The vehicle: its poses on the bus, stamped on this host's clock in step with the sonar's dive, and
//! spoilt on their way.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use echosplat_bus::Bus;
use echosplat_model::glam::{DQuat, DVec3};
use echosplat_model::{Pose, StampedPose, Timestamp};
use echosplat_simulator::Dive;

use super::sonar::Sonar;
use crate::draw::Draw;
use echosplat_service::clock;

const HOUR_S: f64 = 3600.0;
/// From pose to pose of a slow source, seconds.
const SLOW_S: f64 = 1.0;
/// A slow clock loses this share of the time.
const SLOW_CLOCK: f64 = 0.1;
const LATE_S: f64 = 3.0;
/// Silent and sounding of an intermittent source, seconds.
const SILENT_S: f64 = 1.6;
const SOUNDING_S: f64 = 1.0;
/// Where a second publisher holds the vehicle to be.
const ASIDE_M: f64 = 2.0;
const TICK: Duration = Duration::from_millis(4);

/// What is wrong with the poses or with their stamps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PoseFault {
    /// None come.
    Off,
    /// The same pose under new stamps.
    Stuck,
    /// Not finite, no rotation, too far.
    Garbage,
    /// A second publisher holds the vehicle to be two metres aside.
    SecondSource,
    /// North-east-down and forward-right-down, not said so.
    Ned,
    /// One a second.
    Slow,
    /// Seconds later than they are stamped.
    Late(f64),
    /// Off for 1.6 s, on for 1 s.
    Intermittent,
    /// So many metres aside from then on.
    Jump(f64),
    /// Those of the last seconds come a second time, each after the newest.
    Replayed,
    /// Stamps of 0.
    ClockOff,
    /// One stamp for all.
    ClockStuck,
    /// Any stamp at all.
    ClockGarbage,
    /// An hour ahead.
    ClockAhead,
    /// Ten per cent slow.
    ClockSlow,
    /// Three seconds behind.
    ClockBehind,
    /// An hour ahead every other second.
    ClockIntermittent,
}

/// Publishes until dropped.
pub(super) struct Vehicle {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    /// Added to every stamp, nanoseconds.
    shift_ns: AtomicI64,
    fault: Mutex<Option<(PoseFault, Instant)>>,
    /// Stamps of all that were published.
    stamps: Mutex<Vec<Timestamp>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Vehicle {
    pub(super) fn start(bus: Arc<Bus>, sonar: Arc<Sonar>, dive: Arc<Dive>, seed: u64) -> Self {
        let shared = Arc::new(Shared::default());
        let publishing = Publishing {
            bus,
            sonar,
            dive,
            shared: Arc::clone(&shared),
            next: 0,
            host_epoch: None,
            waiting: VecDeque::new(),
            spoiler: Spoiler::new(seed),
        };
        Self {
            thread: Some(std::thread::spawn(move || publishing.run())),
            shared,
        }
    }

    /// Begins a fault, or ends it.
    pub(super) fn set_fault(&self, fault: Option<PoseFault>) {
        *lock(&self.shared.fault) = fault.map(|fault| (fault, Instant::now()));
    }

    /// Stamps are on a clock so far from this host's from now on.
    pub(super) fn shift_stamps(&self, seconds: f64) {
        let shift_ns = (seconds * 1e9) as i64;
        self.shared.shift_ns.store(shift_ns, Ordering::Relaxed);
    }

    /// Stamps of all poses published so far.
    pub(super) fn stamps(&self) -> Vec<Timestamp> {
        lock(&self.shared.stamps).clone()
    }
}

impl Drop for Vehicle {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic in it has been printed.
            let _ = thread.join();
        }
    }
}

struct Publishing {
    bus: Arc<Bus>,
    sonar: Arc<Sonar>,
    dive: Arc<Dive>,
    shared: Arc<Shared>,
    /// Next of the dive's poses.
    next: usize,
    /// This host's time when the dive's was 0.
    host_epoch: Option<Timestamp>,
    waiting: VecDeque<(Instant, StampedPose)>,
    spoiler: Spoiler,
}

impl Publishing {
    fn run(mut self) {
        while !self.shared.stop.load(Ordering::Relaxed) {
            if let Some(dive_s) = self.sonar.dive_s() {
                self.publish_until(dive_s);
            }
            std::thread::sleep(TICK);
        }
    }

    fn publish_until(&mut self, dive_s: f64) {
        let now = Instant::now();
        let host_epoch = *self
            .host_epoch
            .get_or_insert_with(|| clock::now().offset_by(-dive_s));
        let fault = *lock(&self.shared.fault);
        let dive = Arc::clone(&self.dive);
        let to_come = dive.reported_poses().get(self.next..).unwrap_or_default();
        for pose in to_come
            .iter()
            .take_while(|p| p.time.as_secs_f64() <= dive_s)
        {
            self.next += 1;
            let shift_ns = self.shared.shift_ns.load(Ordering::Relaxed);
            let time = pose.time.offset_by_nanos(host_epoch.nanos());
            let stamped = StampedPose {
                time: time.offset_by_nanos(shift_ns),
                ..*pose
            };
            self.spoiler.spoilt(stamped, fault, now, &mut self.waiting);
        }
        if fault.is_none() {
            // What was held back comes at once when the link is itself again.
            self.waiting.iter_mut().for_each(|(due, _)| *due = now);
        }
        let due = self.waiting.partition_point(|(due, _)| *due <= now);
        for (_, pose) in self.waiting.drain(..due) {
            lock(&self.shared.stamps).push(pose.time);
            if let Err(error) = self.bus.publish_pose(&pose) {
                tracing::debug!(%error, "pose not published");
            }
        }
    }
}

/// Makes wrong poses of right ones.
struct Spoiler {
    draw: Draw,
    /// Newest sound pose.
    sound: Option<StampedPose>,
    /// Newest that a slow source sent.
    slow: Option<Timestamp>,
    past: VecDeque<StampedPose>,
}

/// Poses that are remembered to come a second time.
const PAST_POSES: usize = 100;

impl Spoiler {
    fn new(seed: u64) -> Self {
        Self {
            draw: Draw::new(seed, 2),
            sound: None,
            slow: None,
            past: VecDeque::new(),
        }
    }

    /// Appends what is published in place of `pose`, and when.
    fn spoilt(
        &mut self,
        pose: StampedPose,
        fault: Option<(PoseFault, Instant)>,
        now: Instant,
        out: &mut VecDeque<(Instant, StampedPose)>,
    ) {
        self.past.push_back(pose);
        if self.past.len() > PAST_POSES {
            self.past.pop_front();
        }
        let Some((kind, since)) = fault else {
            self.sound = Some(pose);
            self.slow = None;
            out.push_back((now, pose));
            return;
        };
        let since_s = now.duration_since(since).as_secs_f64();
        let sound = self.sound.unwrap_or(pose);
        let stamped = |time| StampedPose { time, ..pose };
        let moved = |by: DVec3| moved(pose, by);
        match kind {
            PoseFault::Off => {}
            PoseFault::Stuck => out.push_back((
                now,
                StampedPose {
                    time: pose.time,
                    ..sound
                },
            )),
            PoseFault::Garbage => out.push_back((now, self.garbage(pose))),
            PoseFault::SecondSource => {
                out.push_back((now, pose));
                out.push_back((now, moved(DVec3::X * ASIDE_M)));
            }
            PoseFault::Ned => out.push_back((now, ned(pose))),
            PoseFault::Slow => {
                let is_due = |before: Timestamp| pose.time.seconds_since(before) >= SLOW_S;
                if self.slow.is_none_or(is_due) {
                    self.slow = Some(pose.time);
                    out.push_back((now, pose));
                }
            }
            PoseFault::Late(late_s) => {
                out.push_back((now + Duration::from_secs_f64(late_s), pose));
            }
            PoseFault::Intermittent => {
                if since_s % (SILENT_S + SOUNDING_S) >= SILENT_S {
                    out.push_back((now, pose));
                }
            }
            PoseFault::Jump(metres) => out.push_back((now, moved(DVec3::X * metres))),
            PoseFault::Replayed => {
                out.push_back((now, pose));
                out.extend(self.past.front().map(|&old| (now, old)));
            }
            PoseFault::ClockOff => out.push_back((now, stamped(Timestamp::ZERO))),
            PoseFault::ClockStuck => out.push_back((now, stamped(sound.time))),
            PoseFault::ClockGarbage => {
                let any = Timestamp::from_nanos((self.draw.bits() >> 1) as i64);
                out.push_back((now, stamped(any)));
            }
            PoseFault::ClockAhead => out.push_back((now, stamped(pose.time.offset_by(HOUR_S)))),
            PoseFault::ClockSlow => {
                let passed_s = pose.time.seconds_since(sound.time);
                out.push_back((now, stamped(pose.time.offset_by(-SLOW_CLOCK * passed_s))));
            }
            PoseFault::ClockBehind => out.push_back((now, stamped(pose.time.offset_by(-LATE_S)))),
            PoseFault::ClockIntermittent => {
                let is_odd = since_s % 2.0 < 1.0;
                let ahead_s = if is_odd { HOUR_S } else { 0.0 };
                out.push_back((now, stamped(pose.time.offset_by(ahead_s))));
            }
        }
    }

    /// One of three kinds: not finite, no rotation, beyond any place.
    fn garbage(&mut self, mut pose: StampedPose) -> StampedPose {
        let place = &mut pose.world_from_vehicle;
        match self.draw.bits() % 3 {
            0 => place.translation_m.x = f64::NAN,
            1 => place.rotation = DQuat::from_xyzw(3.0, 0.0, 0.0, 3.0),
            _ => place.translation_m.y = 1e300,
        }
        pose
    }
}

fn moved(mut pose: StampedPose, by: DVec3) -> StampedPose {
    pose.world_from_vehicle.translation_m += by;
    pose
}

/// The same place in north-east-down, the vehicle forward-right-down.
fn ned(mut pose: StampedPose) -> StampedPose {
    let Pose {
        rotation,
        translation_m: at,
    } = pose.world_from_vehicle;
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let ned_from_enu = DQuat::from_xyzw(half, half, 0.0, 0.0);
    let flu_from_frd = DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0);
    pose.world_from_vehicle = Pose {
        rotation: ned_from_enu * rotation * flu_from_frd,
        translation_m: DVec3::new(at.y, at.x, -at.z),
    };
    pose
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(seconds: f64) -> StampedPose {
        StampedPose {
            time: Timestamp::from_secs_f64(seconds),
            world_from_vehicle: Pose::from_yaw_pitch_roll(
                0.0,
                0.0,
                0.0,
                DVec3::new(1.0, 2.0, -3.0),
            ),
            uncertainty: None,
            epoch: 0,
        }
    }

    /// What becomes of the poses of ten seconds, fifty a second, the first of them sound.
    fn published(fault: PoseFault) -> Vec<StampedPose> {
        let begin = Instant::now();
        let mut spoiler = Spoiler::new(1);
        let mut out = VecDeque::new();
        for i in 0..500 {
            let seconds = f64::from(i) * 0.02;
            let fault = (i > 0).then_some((fault, begin));
            let now = begin + Duration::from_secs_f64(seconds);
            spoiler.spoilt(pose(seconds), fault, now, &mut out);
        }
        out.into_iter().map(|(_, pose)| pose).collect()
    }

    #[test]
    fn every_fault_is_what_its_name_says() {
        assert_eq!(published(PoseFault::Off).len(), 1);
        assert_eq!(published(PoseFault::SecondSource).len(), 999);
        let slow = published(PoseFault::Slow).len();
        assert!((10..=12).contains(&slow), "{slow}");
        let share = published(PoseFault::Intermittent).len() as f64 / 500.0;
        assert!((share - 1.0 / 2.6).abs() < 0.1, "{share}");
        let behind = published(PoseFault::ClockSlow).pop().unwrap();
        assert!((behind.time.as_secs_f64() - 0.9 * 9.98).abs() < 1e-6);
        let down = published(PoseFault::Ned).pop().unwrap().world_from_vehicle;
        assert!(down.translation_m.distance(DVec3::new(2.0, 1.0, 3.0)) < 1e-12);
        // East is where the nose was, which is y of north-east-down.
        let nose = down.rotation * DVec3::X;
        assert!(nose.distance(DVec3::Y) < 1e-12, "{nose}");
    }
}
