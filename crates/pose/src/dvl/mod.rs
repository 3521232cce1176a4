//! Dead reckoning of a Water Linked DVL A50 or A125 over TCP: one JSON object a line.
//!
//! Protocol `json_v2` to `json_v3.1`, "DVL protocol" of docs.waterlinked.com. `position_local`, about 5
//! a second: metres and degrees in the frame that the DVL had when its dead reckoning was last
//! reset, x forward, y right, z down. `velocity`, 2 to 26 a second: in the DVL's own frame. A pose
//! is given for each of both. Those at velocities wait for the position behind them, since only
//! positions come with an attitude; between positions more than half a second apart there are none.
//! The world is the frame of that reset turned to z up: x as it was, y left.
//!
//! Beside an autopilot, whose attitude is better than the DVL's, [`velocities`] gives velocities alone.

mod devices;
mod report;
mod track;

use std::convert::Infallible;
use std::io;

use crossbeam_channel::Sender;
use echosplat_model::{Timestamp, flu_from_frd};
use tokio::task::block_in_place;

use self::report::Report;
use self::track::Track;
use crate::link::{Address, BackOff, Link};
use crate::mavlink::beside::News;
use crate::mavlink::told::{Stamp, Teller, Told};
use crate::now::now;
use crate::outlet::Outlet;
use crate::reckon::Axes;
use crate::status::PoseSourceStatus;
use echosplat_join::StampClock;

/// Longest line read; a velocity with four transducers has some 1,000 bytes.
const MAX_LINE_BYTES: usize = 16 * 1024;
/// A connection without a report for so long is made anew.
const SILENT_AFTER_S: f64 = 10.0;

/// Connects, reads, connects again.
pub(crate) async fn run(address: &Address, stamps: StampClock, outlet: &mut Outlet) {
    let mut track = Track::new(stamps);
    let mut back_off = BackOff::default();
    let name = address.name();
    outlet.link(format!("waiting for the DVL on {name}"));
    loop {
        let Err(error) = read(address, &mut track, &mut back_off, outlet).await;
        outlet.link(format!("lost: {name}: {error}; trying again"));
        let waiting = outlet.meanwhile(|| status(&track, outlet, now()), back_off.wait());
        waiting.await;
    }
}

/// With a silence in place of a link that is up.
fn status(track: &Track, outlet: &Outlet, now: Timestamp) -> PoseSourceStatus {
    let silence = track.silent_s(now).map(|silent_s| {
        let link = outlet.link_so_far().filter(|link| *link != "up");
        let link = link.map_or(String::new(), |link| format!("; {link}"));
        format!(
            "nothing from the DVL for {silent_s:.0} s: is it powered, and its cable whole?{link}"
        )
    });
    PoseSourceStatus {
        link: silence,
        ..track.status(now)
    }
}

/// Until the connection is lost.
async fn read(
    address: &Address,
    track: &mut Track,
    back_off: &mut BackOff,
    outlet: &mut Outlet,
) -> io::Result<Infallible> {
    let opening = outlet.meanwhile(|| status(track, outlet, now()), address.open());
    let link = opening.await?;
    let take = |read: Read| match read {
        Read::Report(report, arrived) => {
            if let Ok(Some(_)) = report {
                outlet.link("up");
            }
            let poses = track.take(report, arrived);
            poses.into_iter().for_each(|pose| outlet.hand_on(pose));
        }
        Read::All(arrived) => outlet.tell(status(track, outlet, arrived)),
    };
    reports(link, back_off, take).await
}

/// Connects, reads velocities, connects again; positions are left alone.
pub(crate) async fn velocities(address: &Address, news: &Sender<News>) -> Infallible {
    let mut back_off = BackOff::default();
    let name = address.name();
    // With the queue full nobody takes anything: the newest is of no use later.
    let tell = |what: News| drop(news.try_send(what));
    tell(News::Link(format!("waiting for it on {name}")));
    loop {
        let taken = |read: Read| {
            if let Read::Report(Ok(Some(report)), arrived) = read {
                tell(News::Link("up".to_owned()));
                told_of(&report)
                    .into_iter()
                    .for_each(|told| tell(News::Velocity(told, arrived)));
            }
        };
        let lost = match address.open().await {
            Ok(link) => reports(link, &mut back_off, taken).await,
            Err(error) => Err(error),
        };
        let Err(error) = lost;
        tell(News::Link(format!("lost: {name}: {error}; trying again")));
        back_off.wait().await;
    }
}

/// A velocity that can be one; none without the bottom.
fn told_of(report: &Report) -> Option<Told> {
    let Report::Velocity {
        valid_us,
        sent_us,
        velocity_mps,
        is_valid: true,
    } = *report
    else {
        return None;
    };
    Some(Told {
        teller: Teller::Dvl,
        sender: crate::mavlink::message::Sender::default(),
        stamp: Stamp::Own(sent_us.saturating_mul(1_000)),
        before_s: sent_us.saturating_sub(valid_us) as f64 * 1e-6,
        axes: Axes::Vehicle,
        mps: flu_from_frd(velocity_mps),
    })
}

/// What one read gives.
enum Read {
    /// A line, and when it came.
    Report(Result<Option<Report>, String>, Timestamp),
    /// There is no more by now.
    All(Timestamp),
}

/// Reads reports until the connection is lost.
async fn reports(
    mut link: Link,
    back_off: &mut BackOff,
    mut take: impl FnMut(Read),
) -> io::Result<Infallible> {
    let mut lines = Lines::default();
    let mut buffer = [0; 4096];
    let mut heard_at = now();
    loop {
        let count = link.read(&mut buffer).await?;
        let arrived = now();
        block_in_place(|| {
            lines.feed(&buffer[..count], |line| {
                let report = Report::parse(line);
                if let Ok(Some(_)) = report {
                    heard_at = arrived;
                    back_off.reset();
                }
                take(Read::Report(report, arrived));
            });
            take(Read::All(arrived));
        });
        if arrived.seconds_since(heard_at).abs() > SILENT_AFTER_S {
            let what = "it sends no reports";
            return Err(io::Error::new(io::ErrorKind::TimedOut, what));
        }
    }
}

/// Bytes in, lines out; a line that is too long is given cut, which is no report.
#[derive(Default)]
struct Lines {
    held: Vec<u8>,
}

impl Lines {
    fn feed(&mut self, bytes: &[u8], mut take: impl FnMut(&[u8])) {
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            let room = MAX_LINE_BYTES - self.held.len();
            self.held.extend_from_slice(&piece[..piece.len().min(room)]);
            if piece.ends_with(b"\n") {
                let line = self.held.trim_ascii();
                if !line.is_empty() {
                    take(line);
                }
                self.held.clear();
            }
        }
    }
}

#[cfg(test)]
mod tests;
