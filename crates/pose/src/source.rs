//! Poses of any source, one after another.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_channel::Receiver;
use echosplat_bus::{Bus, BusError, PoseSubscription};
use echosplat_liveness::Heartbeat;
use echosplat_model::StampedPose;
use echosplat_recording::tum::TumError;
use tokio::runtime::Handle;

use crate::bus_feed::{BusFeed, receive};
use crate::link::Address;
use crate::log::LogPosesError;
use crate::mavlink::over_bus::{OnBus, keys};
use crate::mavlink::run::OverLink;
use crate::now::now;
use crate::only::Only;
use crate::source_task::{SourceTask, Work};
use crate::status::{PoseSourceStatus, Rate};
use crate::tum_file::FilePoses;
use crate::url::PoseUrl;
use echosplat_join::{ArrivedPose, StampClock};

/// Poses as they become known.
#[derive(Debug)]
pub enum PoseSource {
    /// None at all.
    None,
    /// All at once, in order of time; they arrived when they were valid.
    File(FilePoses),
    /// All at once, with the times at which they arrived then.
    Recorded(std::vec::IntoIter<ArrivedPose>),
    /// One after another as they are asked for, in order of time: of a dive too long to be held.
    Made(MadePoses),
    /// Handed over in step with a tape; they arrived where the tape was made.
    Taped(TapedPoses),
    /// As they arrive.
    Live(Box<LivePoses>),
}

/// Poses in step with a tape, from the thread that reads it.
#[derive(Debug)]
pub struct TapedPoses {
    poses: Receiver<ArrivedPose>,
    /// Set once none will follow.
    is_ended: Arc<AtomicBool>,
    taken: u64,
    rate: Rate,
}

impl TapedPoses {
    fn next(&mut self) -> Option<ArrivedPose> {
        let pose = self.poses.try_recv().ok()?;
        self.taken += 1;
        // By this host's clock: the tape may come from one whose clock differs.
        self.rate.count(now());
        Some(pose)
    }
}

/// Poses that nobody holds; they arrived when they were valid.
pub struct MadePoses {
    next: Option<StampedPose>,
    rest: Box<dyn Iterator<Item = StampedPose> + Send>,
}

impl std::fmt::Debug for MadePoses {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut fields = f.debug_struct("MadePoses");
        fields.field("next", &self.next).finish_non_exhaustive()
    }
}

impl MadePoses {
    fn take(&mut self) -> Option<StampedPose> {
        let following = self.rest.next();
        std::mem::replace(&mut self.next, following)
    }
}

/// Poses as they arrive, and what is known of their source.
#[derive(Debug)]
pub struct LivePoses {
    url: String,
    feed: Feed,
    rate: Rate,
}

#[derive(Debug)]
enum Feed {
    Bus(Box<BusFeed>),
    Task(SourceTask),
}

/// Why there is no such source.
#[derive(Debug, thiserror::Error)]
pub enum PoseSourceError {
    /// The file cannot be opened.
    #[error("poses: cannot open {path}: {reason}", path = .path.display())]
    Open {
        /// Which.
        path: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
    /// The file holds something else.
    #[error("poses: {path}: {reason}", path = .path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// Where and what.
        reason: TumError,
    },
    /// The file is of another program.
    #[error("poses: {path} is {reason}", path = .path.display())]
    Foreign {
        /// Which.
        path: PathBuf,
        /// What it is, and what makes a file that is read of it.
        reason: String,
    },
    /// The file holds no pose.
    #[error("poses: {path} holds no pose; lines are `timestamp tx ty tz qx qy qz qw`", path = .0.display())]
    Empty(PathBuf),
    /// Every row of the file is one that no pose can be made of.
    #[error("poses: all {rows} rows hold NaN or infinity: {path} holds no pose", path = .path.display())]
    NoneFinite {
        /// Which.
        path: PathBuf,
        /// How many.
        rows: usize,
    },
    /// Poses of one time go with no ping.
    #[error(
        "poses: {path}: all {rows} rows have the timestamp {stamp_s}; the first column has to be the time of each \
         pose in seconds, on the clock of the pings", path = .path.display()
    )]
    OneTime {
        /// Which.
        path: PathBuf,
        /// How many.
        rows: usize,
        /// What all of them say, seconds.
        stamp_s: f64,
    },
    /// A source on the bus, without a bus.
    #[error("poses come over zenoh, but the bus is off")]
    NoBus,
    /// `log://` where no log is read.
    #[error(
        "log:// takes the poses of the log that is replayed; a live sonar needs another source, \
         for example zenoh:// or mavlink+udp://0.0.0.0:14550"
    )]
    NoLog,
    /// The poses of a log.
    #[error(transparent)]
    Log(#[from] LogPosesError),
    /// The bus refuses.
    #[error(transparent)]
    Bus(#[from] BusError),
}

impl PoseSource {
    /// Opens what `url` names; a file is read whole, a link is a task of `runtime`, which has several
    /// workers. `bus` is needed for sources on zenoh only.
    /// A vehicle or DVL that is not there yet is no error: it is waited for, which
    /// [`PoseSourceStatus::link`] tells.
    ///
    /// # Errors
    /// Says which file or what of the bus cannot be used.
    pub fn open(
        runtime: &Handle,
        url: &PoseUrl,
        bus: Option<&Bus>,
        stamps: StampClock,
    ) -> Result<Self, PoseSourceError> {
        let need_bus = || bus.ok_or(PoseSourceError::NoBus);
        let (of_poses, dvl) = match url {
            PoseUrl::MavlinkWithDvl { mavlink, dvl } => {
                (&**mavlink, Some(Address::Tcp(dvl.clone())))
            }
            url => (url, None),
        };
        let over_link = |address, only: Only| {
            let vehicle = OverLink {
                address,
                stamps,
                only,
                dvl: dvl.clone(),
            };
            Ok(task(runtime, url, Work::Mavlink(vehicle)))
        };
        match of_poses {
            PoseUrl::None | PoseUrl::MavlinkWithDvl { .. } => Ok(Self::None),
            PoseUrl::Tum(path) => FilePoses::open(path).map(Self::File),
            PoseUrl::Log(_) => Err(PoseSourceError::NoLog),
            PoseUrl::Zenoh => Ok(live(url, Feed::of_bus(need_bus()?.subscribe_poses()?))),
            PoseUrl::ZenohKey(key) => Ok(live(
                url,
                Feed::of_bus(need_bus()?.subscribe_poses_on(key)?),
            )),
            PoseUrl::Ros2(topic) => {
                let poses = need_bus()?.subscribe_poses_of_ros(topic)?;
                Ok(live(url, Feed::of_bus(poses)))
            }
            PoseUrl::MavlinkZenoh { prefix, only } => {
                let messages = need_bus()?.subscribe_messages(&keys(prefix))?;
                let server = OnBus {
                    messages: Arc::new(messages),
                    stamps,
                    only: *only,
                    dvl: dvl.clone(),
                };
                Ok(task(runtime, url, Work::MavlinkOnBus(server)))
            }
            PoseUrl::MavlinkUdp { address, out, only } => {
                let address = address.clone();
                let address = match out {
                    true => Address::UdpOut(address),
                    false => Address::UdpIn(address),
                };
                over_link(address, *only)
            }
            PoseUrl::MavlinkTcp { address, only } => {
                over_link(Address::Tcp(address.clone()), *only)
            }
            PoseUrl::MavlinkSerial {
                path,
                baudrate,
                only,
            } => {
                let address = Address::Serial {
                    path: path.clone(),
                    baudrate: *baudrate,
                };
                over_link(address, *only)
            }
            PoseUrl::Dvl(address) => {
                let address = Address::Tcp(address.clone());
                Ok(task(runtime, url, Work::Dvl(address, stamps)))
            }
        }
    }

    /// Poses of a recording; ends like a file.
    #[must_use]
    pub fn recorded(poses: Vec<ArrivedPose>) -> Self {
        Self::Recorded(poses.into_iter())
    }

    /// Poses that whoever reads a tape hands over, each before the tape's mark that stands for it.
    /// `is_ended` is set once none will follow.
    #[must_use]
    pub fn taped(poses: Receiver<ArrivedPose>, is_ended: Arc<AtomicBool>) -> Self {
        Self::Taped(TapedPoses {
            poses,
            is_ended,
            taken: 0,
            rate: Rate::default(),
        })
    }

    /// Poses that are made when they are asked for.
    #[must_use]
    pub fn made(mut poses: impl Iterator<Item = StampedPose> + Send + 'static) -> Self {
        Self::Made(MadePoses {
            next: poses.next(),
            rest: Box::new(poses),
        })
    }

    /// The next pose, if it is known already. Poses of a file arrived at their own stamps.
    #[must_use]
    pub fn try_next(&mut self) -> Option<ArrivedPose> {
        match self {
            Self::None => None,
            Self::File(poses) => poses.next().map(ArrivedPose::at_its_stamp),
            Self::Recorded(poses) => poses.next(),
            Self::Made(poses) => poses.take().map(ArrivedPose::at_its_stamp),
            Self::Taped(taped) => taped.next(),
            Self::Live(live) => live.next(None),
        }
    }

    /// The next pose, waiting for one that is yet to arrive no longer than `limit`.
    #[must_use]
    pub fn next_within(&mut self, limit: Duration) -> Option<ArrivedPose> {
        match self {
            Self::Live(live) => live.next(Some(limit)),
            _ => self.try_next(),
        }
    }

    /// Whether no pose will ever come again.
    #[must_use]
    pub fn is_ended(&self) -> bool {
        let may_follow = match self {
            Self::Live(_) => true,
            Self::Taped(taped) => !taped.is_ended.load(Ordering::Acquire),
            _ => false,
        };
        !may_follow && self.known_len() == 0
    }

    /// Whether poses come as time goes by.
    #[must_use]
    pub fn is_live(&self) -> bool {
        matches!(self, Self::Live(_))
    }

    /// How many poses are known to be left: of a file all of them, which is what a trajectory
    /// should have room for; of poses made one by one the next.
    #[must_use]
    pub fn known_len(&self) -> usize {
        match self {
            Self::None => 0,
            Self::File(poses) => poses.len(),
            Self::Recorded(poses) => poses.len(),
            Self::Made(poses) => usize::from(poses.next.is_some()),
            Self::Taped(taped) => taped.poses.len(),
            Self::Live(live) => live.waiting_len(),
        }
    }

    /// All that are known to be left of poses that were read whole, in their order; of others none.
    #[must_use]
    pub fn known(&self) -> Vec<StampedPose> {
        match self {
            Self::File(poses) => poses.known().to_vec(),
            Self::Recorded(poses) => poses
                .as_slice()
                .iter()
                .map(|arrived| arrived.pose)
                .collect(),
            _ => Vec::new(),
        }
    }

    /// Whether x of their world points elsewhere than east, as far as their source knows.
    #[must_use]
    pub fn lacks_north(&self) -> bool {
        matches!(self, Self::Live(_)) && self.status().lacks_north
    }

    /// How many poses were handed over in step with a tape whose marks are still to come.
    #[must_use]
    pub fn taped_len(&self) -> usize {
        match self {
            Self::Taped(taped) => taped.poses.len(),
            _ => 0,
        }
    }

    /// Of a live source: whether it is alive.
    #[must_use]
    pub fn heartbeat(&self) -> Option<&Heartbeat> {
        let Self::Live(live) = self else { return None };
        Some(match &live.feed {
            Feed::Bus(feed) => feed.subscription().heartbeat(),
            Feed::Task(task) => task.heartbeat(),
        })
    }

    /// What became of the poses so far. Of poses read whole only what kind of source it is.
    #[must_use]
    pub fn status(&self) -> PoseSourceStatus {
        let named = |name: &str| PoseSourceStatus {
            source: name.to_owned(),
            ..PoseSourceStatus::default()
        };
        match self {
            Self::None => named("none"),
            Self::File(poses) => poses.status(),
            Self::Recorded(_) => named("log://"),
            Self::Made(_) => named("simulated"),
            Self::Taped(taped) => {
                let (rate_hz, age_s) = taped.rate.read(now());
                PoseSourceStatus {
                    received: taped.taken,
                    accepted: taped.taken,
                    rate_hz,
                    age_s,
                    ..named("driver")
                }
            }
            Self::Live(live) => live.status(),
        }
    }
}

impl Feed {
    fn of_bus(poses: PoseSubscription) -> Self {
        Self::Bus(Box::new(BusFeed::new(poses)))
    }
}

impl LivePoses {
    fn next(&mut self, limit: Option<Duration>) -> Option<ArrivedPose> {
        let pose = match &mut self.feed {
            Feed::Bus(feed) => feed.next(limit),
            Feed::Task(task) => {
                task.replace_if_it_hangs();
                receive(task.poses(), limit)
            }
        }?;
        self.rate.count(pose.arrived);
        Some(pose)
    }

    fn waiting_len(&self) -> usize {
        match &self.feed {
            Feed::Bus(feed) => feed.waiting_len(),
            Feed::Task(task) => task.poses().len(),
        }
    }

    fn status(&self) -> PoseSourceStatus {
        let (rate_hz, age_s) = self.rate.read(now());
        let status = match &self.feed {
            Feed::Bus(feed) => feed.status(),
            Feed::Task(task) => task.status(),
        };
        PoseSourceStatus {
            source: self.url.clone(),
            rate_hz,
            age_s,
            ..status
        }
    }
}

fn live(url: &PoseUrl, feed: Feed) -> PoseSource {
    PoseSource::Live(Box::new(LivePoses {
        url: url.to_string(),
        feed,
        rate: Rate::default(),
    }))
}

fn task(runtime: &Handle, url: &PoseUrl, work: Work) -> PoseSource {
    live(url, Feed::Task(SourceTask::start(runtime, work)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::sync::LazyLock;
    use tokio::runtime::Runtime;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    fn open(url: &PoseUrl) -> Result<PoseSource, PoseSourceError> {
        static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());
        PoseSource::open(RUNTIME.handle(), url, None, StampClock::Host)
    }

    #[test]
    fn a_file_yields_all_its_poses_at_once_in_order() {
        let file = file("# t x y z qx qy qz qw\n2.5 1 2 3 0 0 0 1\n1.5 1 2 3 0 0 0 1\n");
        let url = PoseUrl::Tum(file.path().to_owned());
        let mut source = open(&url).unwrap();
        assert_eq!((source.known_len(), source.is_ended()), (2, false));
        let times: Vec<_> = std::iter::from_fn(|| source.try_next())
            .map(|pose| (pose.pose.time.nanos(), pose.arrived.nanos()))
            .collect();
        let (first, second) = (1_500_000_000, 2_500_000_000);
        assert_eq!(times, [(first, first), (second, second)]);
        assert!(source.is_ended() && !source.is_live());
    }

    #[test]
    fn poses_made_one_by_one_end_after_the_last() {
        let pose = |seconds: i32| StampedPose {
            time: echosplat_model::Timestamp::from_secs_f64(f64::from(seconds)),
            world_from_vehicle: echosplat_model::Pose::IDENTITY,
            uncertainty: None,
            epoch: 0,
        };
        let mut source = PoseSource::made((0..3).map(pose));
        assert_eq!((source.known_len(), source.is_ended()), (1, false));
        let times = std::iter::from_fn(|| source.try_next()).map(|pose| pose.arrived.nanos());
        let times: Vec<_> = times.collect();
        assert_eq!(times, [0, 1_000_000_000, 2_000_000_000]);
        assert!(source.is_ended() && !source.is_live());
    }

    #[test]
    fn unusable_sources_say_why() {
        let refusal = |url: &PoseUrl| open(url).unwrap_err().to_string();
        assert!(refusal(&PoseUrl::Zenoh).contains("bus"));
        assert!(refusal(&PoseUrl::Ros2("/odom".to_owned())).contains("bus"));
        assert!(refusal(&"mavlink+zenoh://".parse().unwrap()).contains("bus"));
        assert!(refusal(&PoseUrl::Log(None)).contains("mavlink+udp://"));
        assert!(refusal(&PoseUrl::Tum("/no/such.tum".into())).contains("/no/such.tum"));
        let empty = file("# nothing\n");
        assert!(refusal(&PoseUrl::Tum(empty.path().into())).contains("holds no pose"));
        let broken = file("1 2 3\n");
        assert!(refusal(&PoseUrl::Tum(broken.path().into())).contains("line 1"));
    }

    #[test]
    fn nowhere_has_ended_from_the_start() {
        let mut source = open(&PoseUrl::None).unwrap();
        assert!(source.is_ended() && source.try_next().is_none());
    }
}
