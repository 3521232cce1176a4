//! What systemd is told, where it started the service (`Type=notify`, see `sd_notify(3)`): that the
//! service is ready, how it is, that it lives, and that it ends. Without systemd nothing is told.
//!
//! The crates for this wait where systemd is slow to read, which the thread that watches over the
//! run must not: here a message that finds no room is left out, and the next one says as much.

use std::ffi::OsStr;
use std::io;
use std::os::unix::net::UnixDatagram;
use std::time::{Duration, Instant};

/// The watchdog is fed so many times within its interval.
const FEEDS: u32 = 3;

/// The service's side of systemd's notifications.
#[derive(Debug)]
pub(crate) struct Systemd {
    socket: Option<UnixDatagram>,
    /// Of the watchdog, if the unit has one.
    feed_every: Option<Duration>,
    fed: Option<Instant>,
    is_stopping: bool,
}

impl Systemd {
    /// As `NOTIFY_SOCKET`, `WATCHDOG_USEC` and `WATCHDOG_PID` say.
    pub(crate) fn of_environment() -> Self {
        let socket = std::env::var_os("NOTIFY_SOCKET").and_then(|name| {
            let connected = connect(&name);
            let refused = |error| tracing::warn!("systemd is not told anything: {error}");
            connected.map_err(refused).ok()
        });
        let number = |name: &str| std::env::var(name).ok()?.parse::<u64>().ok();
        let is_ours = number("WATCHDOG_PID").is_none_or(|pid| pid == u64::from(std::process::id()));
        let interval = number("WATCHDOG_USEC").filter(|_| is_ours);
        Self {
            socket,
            feed_every: interval.map(|micros| Duration::from_micros(micros) / FEEDS),
            fed: None,
            is_stopping: false,
        }
    }

    /// Every part of the run has been started.
    pub(crate) fn ready(&self) {
        self.tell("READY=1\n");
    }

    /// To be called often by the thread that watches over the run, with whether all parts that map
    /// and recording need are alive: the watchdog is fed only then.
    pub(crate) fn tick(&mut self, is_alive: bool, now: Instant) {
        let Some(feed_every) = self.feed_every else {
            return;
        };
        let is_due = |fed: Instant| now.saturating_duration_since(fed) >= feed_every;
        if is_alive && self.fed.is_none_or(is_due) {
            self.fed = Some(now);
            self.tell("WATCHDOG=1\n");
        }
    }

    /// One line for `systemctl status`.
    pub(crate) fn status(&self, line: &str) {
        // An end of a line would begin another message.
        self.tell(&format!("STATUS={}\n", line.replace('\n', " ")));
    }

    /// The run is about to end; told once.
    pub(crate) fn stopping(&mut self) {
        if !std::mem::replace(&mut self.is_stopping, true) {
            self.tell("STOPPING=1\n");
        }
    }

    fn tell(&self, message: &str) {
        if let Some(socket) = &self.socket
            && let Err(error) = socket.send(message.as_bytes())
        {
            tracing::debug!(%error, "systemd is not told: {}", message.trim_end());
        }
    }
}

/// `name` is a path, or an abstract name behind an `@`.
fn connect(name: &OsStr) -> io::Result<UnixDatagram> {
    let socket = UnixDatagram::unbound()?;
    socket.set_nonblocking(true)?;
    match name.as_encoded_bytes().strip_prefix(b"@") {
        None => socket.connect(name)?,
        #[cfg(target_os = "linux")]
        Some(name) => {
            use std::os::linux::net::SocketAddrExt;
            let address = std::os::unix::net::SocketAddr::from_abstract_name(name)?;
            socket.connect_addr(&address)?;
        }
        #[cfg(not(target_os = "linux"))]
        Some(_) => return Err(io::ErrorKind::Unsupported.into()),
    }
    Ok(socket)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(listener: &UnixDatagram) -> String {
        let mut message = [0; 256];
        let count = listener.recv(&mut message).unwrap_or(0);
        String::from_utf8_lossy(&message[..count]).into_owned()
    }

    #[test]
    fn the_watchdog_is_fed_a_few_times_an_interval_and_only_while_all_live() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let listener = UnixDatagram::bind(&path).unwrap();
        listener.set_nonblocking(true).unwrap();
        let mut systemd = Systemd {
            socket: Some(connect(path.as_os_str()).unwrap()),
            feed_every: Some(Duration::from_secs(1)),
            fed: None,
            is_stopping: false,
        };
        let begin = Instant::now();
        let mut fed_at = |seconds: f64, is_alive| {
            systemd.tick(is_alive, begin + Duration::from_secs_f64(seconds));
            told(&listener)
        };
        assert_eq!(fed_at(0.0, false), "");
        assert_eq!(fed_at(0.1, true), "WATCHDOG=1\n");
        assert_eq!(fed_at(0.9, true), "");
        assert_eq!(fed_at(1.2, true), "WATCHDOG=1\n");
        systemd.status("two\nlines");
        assert_eq!(told(&listener), "STATUS=two lines\n");
    }

    #[test]
    fn nobody_waits_for_a_systemd_that_does_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let _listener = UnixDatagram::bind(&path).unwrap();
        let systemd = Systemd {
            socket: Some(connect(path.as_os_str()).unwrap()),
            feed_every: None,
            fed: None,
            is_stopping: false,
        };
        (0..10_000).for_each(|_| systemd.ready());
    }
}
