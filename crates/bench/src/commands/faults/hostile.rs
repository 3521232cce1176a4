//! Strangers: floods of datagrams at the program's port, and poses that come a second time.

use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;

use super::outcome::Outcome;
use super::sonar::SonarFault;
use super::trial::{Link, Plan, Setup, Trial};
use super::vehicle::PoseFault;
use crate::draw::Draw;

const FAMILY: &str = "hostile";
const LASTS: Duration = Duration::from_secs(8);
/// Share of the true pings that may be lost.
const MOST_LOST: f64 = 0.01;
/// With the sonar silent, all that came is in the map after so long.
const SETTLED: Duration = Duration::from_millis(3_200);
const STRANGERS: usize = 4;
/// Datagrams a stranger sends at once, every millisecond.
const AT_ONCE: usize = 5;
const DATAGRAM_BYTES: usize = 1_262;

/// Floods and replayed poses, while pings are counted.
pub(super) fn run(setup: &Setup) -> Outcome {
    let mut outcome = Outcome::new(FAMILY, "floods over UDP, and poses that come twice");
    if let Err(error) = flooded(setup, &mut outcome) {
        outcome.expect(false, || format!("{error:#}"));
    }
    outcome
}

fn flooded(setup: &Setup, outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut trial = Trial::start(setup, &Plan::new("hostile", Link::Udp))?;
    trial.settle(outcome);
    let before = counted(&mut trial);
    let port = client_port(&trial)?;
    trial.set_pose_fault(Some(PoseFault::Replayed));
    let flood = Flood::start(port, setup.seed)?;
    trial.pass(LASTS);
    let (datagrams, answers) = flood.stop();
    let after = counted(&mut trial);
    let sent = after.0 - before.0;
    let lost = sent.saturating_sub(after.1 - before.1);
    outcome.figure("true pings", sent as f64);
    outcome.figure("lost", lost as f64);
    outcome.figure("datagrams of strangers", datagrams as f64);
    outcome.figure("answers to them", answers as f64);
    let share = lost as f64 / sent.max(1) as f64;
    outcome.expect(share <= MOST_LOST, || {
        format!("{lost} of {sent} true pings are not in the map")
    });
    outcome.expect(answers == 0, || {
        format!("{answers} datagrams went to strangers")
    });
    trial.end(outcome, &[0, 3]);
    Ok(())
}

/// Pings sent and pings in the map, with nothing under way between the two.
pub(super) fn counted(trial: &mut Trial) -> (u64, u64) {
    trial.sonar.set_fault(Some(SonarFault::Off));
    trial.pass(SETTLED);
    let counts = (trial.sonar.sent_count(), trial.statuses.mapped());
    trial.sonar.set_fault(None);
    counts
}

/// The program's port, by the table of all sockets: it is connected to the sonar's.
pub(super) fn client_port(trial: &Trial) -> anyhow::Result<u16> {
    let url = trial.listen.to_string();
    let sonar: u16 = url.rsplit(':').next().unwrap_or_default().parse()?;
    let table = std::fs::read_to_string("/proc/net/udp").context("/proc/net/udp")?;
    port_connected_to(&table, sonar).context("no UDP socket is connected to the sonar")
}

/// Lines hold the local and the remote address, in hexadecimal, after a number.
fn port_connected_to(table: &str, remote: u16) -> Option<u16> {
    let port = |address: &str| u16::from_str_radix(address.split(':').nth(1)?, 16).ok();
    table.lines().find_map(|line| {
        let mut fields = line.split_whitespace().skip(1);
        let (from, to) = (port(fields.next()?), port(fields.next()?));
        from.filter(|_| to == Some(remote))
    })
}

/// Strangers that send until stopped.
pub(super) struct Flood {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<(u64, u64)>>,
}

impl Flood {
    pub(super) fn start(port: u16, seed: u64) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let mut threads = Vec::new();
        for index in 0..STRANGERS {
            let socket = UdpSocket::bind("127.0.0.1:0").context("a stranger's socket")?;
            socket.set_nonblocking(true)?;
            let stop = Arc::clone(&stop);
            let draw = Draw::new(seed, 20 + index as u64);
            threads.push(std::thread::spawn(move || {
                flood(&socket, port, draw, &stop)
            }));
        }
        Ok(Self { stop, threads })
    }

    /// Datagrams sent, and answers that came.
    pub(super) fn stop(self) -> (u64, u64) {
        self.stop.store(true, Ordering::Relaxed);
        let counts = self
            .threads
            .into_iter()
            .filter_map(|thread| thread.join().ok());
        counts.fold((0, 0), |sum, count| (sum.0 + count.0, sum.1 + count.1))
    }
}

fn flood(socket: &UdpSocket, port: u16, mut draw: Draw, stop: &AtomicBool) -> (u64, u64) {
    let (mut sent, mut answers) = (0, 0);
    let mut bytes = draw.bytes(DATAGRAM_BYTES);
    let mut buffer = [0; 64];
    // The beginning of a frame that a request would have too.
    bytes[..6].copy_from_slice(b"BR\x02\x00\x06\x00");
    let begin = Instant::now();
    while !stop.load(Ordering::Relaxed) && begin.elapsed() < Duration::from_secs(60) {
        for _ in 0..AT_ONCE {
            sent += u64::from(socket.send_to(&bytes, ("127.0.0.1", port)).is_ok());
        }
        // Longer ones are cut, which is an error only elsewhere than on Unix.
        answers += u64::from(socket.recv_from(&mut buffer).is_ok());
        std::thread::sleep(Duration::from_millis(1));
    }
    (sent, answers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_connected_socket_is_found_in_the_systems_table() {
        let table = "  sl  local_address rem_address   st\n\
                      8: 0100007F:1F90 00000000:0000 07\n\
                      9: 0100007F:9C40 0100007F:1F90 01\n";
        assert_eq!(port_connected_to(table, 8080), Some(40_000));
        assert_eq!(port_connected_to(table, 99), None);
    }
}
