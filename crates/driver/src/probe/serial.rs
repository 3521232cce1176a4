//! A sonar on a serial line, at whatever baud rate.

use std::path::{Path, PathBuf};
use std::time::Duration;

use tokio::time::Instant;

use super::{ProbedUnit, at};
use crate::url::SonarUrl;

/// Tried after the one that was asked for.
const COMMON_BAUDRATES: [u32; 5] = [115_200, 921_600, 230_400, 57_600, 9_600];

/// Serial lines of this machine, as far as the system lists them.
#[must_use]
pub fn serial_ports() -> Vec<PathBuf> {
    // The library takes this folder for granted.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").is_dir() {
        return Vec::new();
    }
    let ports = serialport::available_ports().unwrap_or_default();
    let mut paths: Vec<PathBuf> = ports
        .into_iter()
        .map(|port| port.port_name.into())
        .collect();
    paths.sort();
    paths
}

/// The first rate gets as long as a ping takes to come, the others share what is left.
pub(super) async fn probe(
    path: &Path,
    baudrate: u32,
    deadline: Instant,
) -> Result<ProbedUnit, String> {
    let others = COMMON_BAUDRATES
        .into_iter()
        .filter(|&rate| rate != baudrate);
    let rates: Vec<u32> = std::iter::once(baudrate).chain(others).collect();
    let mut tried = 0_u32;
    let mut first = None;
    for (index, &rate) in rates.iter().enumerate() {
        let left = deadline.saturating_duration_since(Instant::now());
        if index > 0 && left < Duration::from_millis(150) {
            break;
        }
        let share = match index {
            0 => left.mul_f64(0.6),
            _ => left / (rates.len() - index) as u32,
        };
        let url = SonarUrl::Serial {
            path: path.to_path_buf(),
            baudrate: rate,
        };
        match at(&url, Instant::now() + share).await {
            Ok(unit) => return Ok(unit),
            // What does not open at one rate opens at none.
            Err(words) if !words.contains("baud") && !words.contains("Ping device") => {
                return Err(words);
            }
            Err(words) => {
                tried += 1;
                first.get_or_insert(words);
            }
        }
    }
    let words = first.unwrap_or_else(|| "there was no time to ask".to_owned());
    Err(match tried {
        0 | 1 => words,
        _ => format!("{words}, nor at {} other rates", tried - 1),
    })
}
