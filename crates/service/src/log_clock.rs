//! Logs whose session packet is older than their first ping.
//!
//! A profile's time is its session's `timestamp` plus the device time since that session's first profile. The vendor's
//! Python client stamps the packet when the log is opened and then waits for a key, so that its pings come out early by
//! seconds. By how many is asked of pings and poses before anything is mapped.
//!
//! Cost, for such logs alone: the log is read once more, and each section of five minutes costs about what a map of 4,000
//! pings does; at most four are looked at.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use echosplat_firmware_protocol::{Decoder, Event, id};
use echosplat_prediction::alignment::{Peak, Quantity};
use echosplat_recording::svlog::{SessionHeader, SvlogReader};

use crate::alignment;
use crate::config::Config;
use crate::pipeline::Finding;

/// A session packet comes first; this much is looked through for it.
const SEARCHED_BYTES: usize = 1 << 20;
/// Logs of one dive that differ by more cannot have one offset, seconds.
const SAME_S: f64 = 0.05;
const CODE: &str = "log-clock";

/// Looks for the offset of logs that need one, and sets it. What there is to say about it.
///
/// # Errors
/// If a log or its poses cannot be read.
pub(crate) fn adjust(
    logs: &[PathBuf],
    poses: &Path,
    config: &mut Config,
) -> anyhow::Result<Option<Finding>> {
    let Some(log) = logs.iter().find(|log| is_from_opening(log)) else {
        return Ok(None);
    };
    tracing::info!(
        "{} counts time from when it was opened, not from its first ping: looking for how much later its pings came",
        log.display()
    );
    let mut found: Vec<Option<Peak>> = Vec::new();
    for log in logs {
        found.push(offset(log, poses, config)?);
    }
    let told: Option<Vec<Peak>> = found.into_iter().collect();
    let Some(first) = told.and_then(same) else {
        return Ok(Some(unknown(logs, poses)));
    };
    if !first.is_off() {
        return Ok(None);
    }
    // To the millisecond, so that what is said can be given on the command line and makes the same map.
    let offset_s = (1e3 * (config.pose.time_offset_s + first.shift)).round() * 1e-3;
    config.pose.time_offset_s = offset_s;
    Ok(Some(Finding {
        code: CODE.into(),
        sentence: format!(
            "{} counts time from when it was opened, as the vendor's Python client writes it; by what its pings \
             hear they came {:.3} ± {:.3} s {} and are mapped so, as with --time-offset-s {offset_s:.3}",
            log.display(),
            offset_s.abs(),
            first.sigma,
            if offset_s > 0.0 { "later" } else { "earlier" },
        ),
        is_loss: false,
    }))
}

/// How much later than stamped its pings came, if they tell.
fn offset(log: &Path, poses: &Path, config: &Config) -> anyhow::Result<Option<Peak>> {
    let Some(alignment) = alignment::of_log(log, Some(poses), config)? else {
        return Ok(None);
    };
    let from = alignment::setting(config);
    let peak = alignment.search(Quantity::TimeOffset, &from);
    tracing::debug!(?peak, log = %log.display(), "time offset");
    Ok(peak.filter(Peak::is_telling))
}

/// The first, if all say the same.
fn same(peaks: Vec<Peak>) -> Option<Peak> {
    let mut peaks = peaks.into_iter();
    let first = peaks.next()?;
    let is_same = |peak: Peak| (peak.shift - first.shift).abs() < SAME_S;
    peaks.all(is_same).then_some(first)
}

fn unknown(logs: &[PathBuf], poses: &Path) -> Finding {
    let log = logs[0].display();
    let each = match logs.len() {
        1 => "",
        _ => " for each log by itself",
    };
    Finding {
        code: CODE.into(),
        sentence: format!(
            "{log} counts time from when it was opened, as the vendor's Python client writes it, and how much later \
             its pings came they do not tell: the map may be wrong; run `echosplat calibrate {log} --poses {} --only \
             time`{each}, or give --time-offset-s with the seconds between the two, 0 if there were none",
            poses.display()
        ),
        is_loss: true,
    }
}

/// Whether the first session packet says so; a file that cannot be read says nothing.
fn is_from_opening(log: &Path) -> bool {
    let header = || {
        let mut reader = SvlogReader::new(BufReader::new(File::open(log).ok()?)).ok()?;
        let (mut decoder, mut searched, mut header) = (Box::new(Decoder::new()), 0, None);
        while header.is_none()
            && searched < SEARCHED_BYTES
            && let Some(piece) = reader.next_piece().ok()?
        {
            searched += piece.len();
            decoder.feed(piece, &mut |event| {
                if let Event::Frame(frame) = event
                    && frame.message_id() == id::JSON
                    && header.is_none()
                {
                    header = SessionHeader::parse(frame.payload()).ok();
                }
            });
        }
        header
    };
    header().is_some_and(|header| header.is_from_opening)
}
