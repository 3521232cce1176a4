//! Is there a sonar at this place? Asks for its identity and one profile, in bounded time, and
//! leaves it as it was: pinging that this started is stopped, pinging of others goes on.

mod conversation;
mod discovery;
mod serial;

use std::time::Duration;

use echosplat_firmware_protocol::{DeviceInformation, OsMonoProfile};
use serde::Serialize;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

pub use discovery::{Discovered, Discovery, discover};
pub use serial::serial_ports;

use crate::config::DriverConfig;
use crate::transport;
use crate::url::SonarUrl;

/// Echoes nearer than this are ring-down.
const RING_DOWN_M: f64 = 0.5;

/// A sonar that answered.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProbedUnit {
    /// How it can be reached, baud rate included.
    pub url: String,
    /// What it said it is; without, it sent profiles and did not answer.
    pub identity: Option<ProbedIdentity>,
    /// Whether it was pinging before it was asked to.
    pub was_pinging: bool,
    /// One profile, if one came.
    pub profile: Option<ProbedProfile>,
}

/// Who a sonar says it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ProbedIdentity {
    /// The product's name, such as `OmniScan 450`; `None` of a type that no list has.
    pub product: Option<&'static str>,
    /// Number of the product in the vendor's list; 101 and 104 are `OmniScan` 450.
    pub device_type: u8,
    /// Hardware revision.
    pub device_revision: u8,
    /// Firmware version: major, minor, patch.
    pub firmware: [u8; 3],
}

/// What one profile shows. Ranges are at the speed of sound that the device takes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ProbedProfile {
    /// Counted by the device since it was powered up.
    pub ping_number: u32,
    /// Near edge of the first bin.
    pub range_start_m: f64,
    /// Of all bins together.
    pub range_length_m: f64,
    /// Number of bins.
    pub bin_count: usize,
    /// Gain step of the receiver.
    pub gain_index: u16,
    /// Speed of sound the device takes.
    pub speed_of_sound_mps: f64,
    /// Median of all bins beyond the ring-down; `None` without such bins.
    pub noise_db: Option<f64>,
    /// Greatest power beyond the ring-down (0.5 m).
    pub strongest_db: Option<f64>,
    /// Where it is.
    pub strongest_range_m: Option<f64>,
}

/// Asks at one place, for so long at most (and the time to close). A serial line is asked at the
/// baud rate given, then at other common ones.
///
/// # Errors
/// One sentence that says what is in the way.
pub async fn probe(url: &SonarUrl, limit: Duration) -> Result<ProbedUnit, String> {
    let deadline = Instant::now() + limit;
    match url {
        SonarUrl::Tcp(_) | SonarUrl::Udp(_) => at(url, deadline).await,
        SonarUrl::Serial { path, baudrate } => serial::probe(path, *baudrate, deadline).await,
        SonarUrl::Sim(_) | SonarUrl::File(_) => Err(format!(
            "{url} is not a place where a sonar can be: give tcp://, udp:// or serial://"
        )),
    }
}

/// Asks at one place, at one baud rate.
async fn at(url: &SonarUrl, deadline: Instant) -> Result<ProbedUnit, String> {
    let left_s = deadline
        .saturating_duration_since(Instant::now())
        .as_secs_f64();
    let config = DriverConfig {
        io_timeout_s: (0.6 * left_s).max(0.05),
        ..DriverConfig::new(url.clone())
    };
    let opened = transport::open(&config, false, &CancellationToken::new()).await;
    let mut link = opened.map_err(|error| in_words(url, &error))?;
    let held = conversation::hold(&mut link, url, deadline).await;
    link.close().await;
    held
}

/// What the system says of a place that cannot be reached, and what to do about it.
fn in_words(url: &SonarUrl, error: &std::io::Error) -> String {
    use std::io::ErrorKind as Kind;
    if matches!(url, SonarUrl::Serial { .. }) {
        return error.to_string();
    }
    match error.kind() {
        Kind::ConnectionRefused => {
            "refused: there is a machine of that address, but nothing listens on that port".into()
        }
        Kind::TimedOut | Kind::WouldBlock => {
            "no answer: is the unit powered, and its cable plugged in?".into()
        }
        Kind::NetworkUnreachable | Kind::HostUnreachable => {
            "no route: give this machine an address in the sonar's network, such as 192.168.2.1/24"
                .into()
        }
        Kind::PermissionDenied => "no permission: a firewall forbids it".into(),
        Kind::ConnectionReset | Kind::UnexpectedEof | Kind::BrokenPipe => {
            "connected, and closed by the other end: are all its connections taken?".into()
        }
        _ => error.to_string(),
    }
}

impl From<ProbedIdentity> for DeviceInformation {
    fn from(identity: ProbedIdentity) -> Self {
        Self {
            device_type: identity.device_type,
            device_revision: identity.device_revision,
            firmware: identity.firmware,
        }
    }
}

impl From<DeviceInformation> for ProbedIdentity {
    fn from(information: DeviceInformation) -> Self {
        let DeviceInformation {
            device_type,
            device_revision,
            firmware,
        } = information;
        Self {
            product: information.product(),
            device_type,
            device_revision,
            firmware,
        }
    }
}

impl ProbedProfile {
    fn of(profile: &OsMonoProfile<'_>) -> Self {
        let range_start_m = f64::from(profile.start_mm) * 1e-3;
        let range_length_m = f64::from(profile.length_mm) * 1e-3;
        let bin_count = profile.pwr_results.len();
        let center_m =
            |bin: usize| range_start_m + range_length_m * (bin as f64 + 0.5) / bin_count as f64;
        let mut beyond: Vec<(f64, f64)> = (0..bin_count)
            .filter_map(|bin| Some((f64::from(profile.power_db(bin)?), center_m(bin))))
            .filter(|&(power_db, range_m)| power_db.is_finite() && range_m > RING_DOWN_M)
            .collect();
        beyond.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self {
            ping_number: profile.ping_number,
            range_start_m,
            range_length_m,
            bin_count,
            gain_index: profile.gain_index,
            speed_of_sound_mps: f64::from(profile.sos_dmps) * 0.1,
            noise_db: beyond.get(beyond.len() / 2).map(|bin| bin.0),
            strongest_db: beyond.last().map(|bin| bin.0),
            strongest_range_m: beyond.last().map(|bin| bin.1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_firmware_protocol::PowerResults;

    #[test]
    fn noise_is_the_median_and_the_strongest_echo_is_beyond_the_ring_down() {
        let mut raw = [0_u8; 400];
        // A bin is 0.05 m: ring-down in the first ones, an echo at 5 m.
        raw[..12].fill(0xff);
        raw[200..202].fill(0xf0);
        let profile = OsMonoProfile {
            ping_number: 9,
            start_mm: 0,
            length_mm: 10_000,
            timestamp_ms: 0,
            ping_hz: 451_127,
            gain_index: 4,
            sos_dmps: 15_000,
            channel_number: 0,
            pulse_duration_sec: 2e-5,
            analog_gain: 1.0,
            max_pwr_db: 60.0,
            min_pwr_db: -10.0,
            transducer_heading_deg: 0.0,
            vehicle_heading_deg: 0.0,
            pwr_results: PowerResults::from_bytes(&raw).unwrap(),
        };
        let shown = ProbedProfile::of(&profile);
        assert!((shown.noise_db.unwrap() + 10.0).abs() < 1e-6);
        assert!((shown.strongest_range_m.unwrap() - 5.025).abs() < 1e-9);
        assert!((50.0..60.0).contains(&shown.strongest_db.unwrap()));
    }

    #[tokio::test]
    async fn what_is_no_link_is_said_to_be_none() {
        let url = "file://dive.svlog".parse().unwrap();
        let words = probe(&url, Duration::from_millis(10)).await.unwrap_err();
        assert!(words.contains("tcp://"), "{words}");
    }
}
