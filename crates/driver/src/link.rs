//! A live link: connected again and again, a session on it, an orderly stop.

use std::io;
use std::time::Duration;

use bytes::Bytes;
use echosplat_model::{RateLimit, Timestamp};
use echosplat_session::Session;
use tokio::select;
use tokio::task::block_in_place;
use tokio::time::{Instant, sleep, timeout};

use crate::clock::host_time;
use crate::config::DriverConfig;
use crate::event::{DriverEvent, LinkState};
use crate::outlet::{Flow, Outlet};
use crate::tap::{RawTap, Tapped};
use crate::transport::{self, Transport};
use crate::url::SonarUrl;

/// After the request to stop, so long at most is waited for the device to fall silent: what is
/// unread when a TCP link closes may take the request with it.
const STOP_DRAIN: Duration = Duration::from_millis(500);
/// A device that says nothing for so long has fallen silent.
const QUIET: Duration = Duration::from_millis(60);
/// Timers are looked at after so long at the latest: the host's clock, which they are on, may be set.
const LONGEST_WAIT: Duration = Duration::from_secs(1);
/// Bytes of a profile's frame around its bins.
const PROFILE_OVERHEAD_BYTES: f64 = 62.0;
/// Start bit, eight data bits, stop bit.
const LINE_BITS_PER_BYTE: f64 = 10.0;

pub(crate) struct Link {
    config: DriverConfig,
    raw: Option<RawTap>,
    outlet: Outlet,
    session: Session,
    state: LinkState,
    /// Whether the last open link brought nothing.
    was_silent: bool,
    /// A link that flaps must not fill the log.
    ups_said: RateLimit,
    downs_said: RateLimit,
    restarts_said: RateLimit,
}

/// Why a link is no longer talked on.
enum End {
    Stopped,
    Lost(String),
}

impl Link {
    pub(crate) fn new(config: DriverConfig, raw: Option<RawTap>, outlet: Outlet) -> Self {
        let session = Session::new(config.session.clone(), host_time());
        Self {
            config,
            raw,
            outlet,
            session,
            state: LinkState::Connecting,
            was_silent: false,
            ups_said: RateLimit::new(),
            downs_said: RateLimit::new(),
            restarts_said: RateLimit::new(),
        }
    }

    /// Until stopped, or nobody listens.
    pub(crate) async fn run(mut self) {
        if let Some(warning) = line_warning(&self.config) {
            self.tell(DriverEvent::Warning(warning));
        }
        let stop = self.outlet.stop.clone();
        let heartbeat = self.outlet.heartbeat.clone();
        let mut wait_s = self.config.reconnect_min_s;
        while !stop.is_set() {
            let frames_before = self.session.counters().frames_good;
            // What a panic leaves half done the session gives up with the link.
            let ended = heartbeat.survive_task(self.connect_and_talk()).await;
            let reason = match ended {
                Ok(End::Stopped) => break,
                Ok(End::Lost(reason)) => reason,
                Err(panicked) if panicked.is_hopeless => {
                    // No use either, perhaps; then it is told as one more panic.
                    let _ = heartbeat.survive_task(self.stop_unlinked_device()).await;
                    return heartbeat.fail();
                }
                Err(panicked) => format!("its task failed, {panicked}"),
            };
            if stop.is_abandoned() {
                return;
            }
            // Being let in is no success: one that accepts and closes is asked ever more slowly.
            if self.session.counters().frames_good > frames_before {
                wait_s = self.config.reconnect_min_s;
            }
            let flow = block_in_place(|| self.lost(reason));
            heartbeat.rest();
            let pause = timeout(Duration::from_secs_f64(wait_s), stop.asked());
            if flow == Flow::Ends || pause.await.is_ok() {
                self.stop_unlinked_device().await;
                break;
            }
            wait_s = (2.0 * wait_s).min(self.config.reconnect_max_s);
        }
        self.session.finish(host_time());
        block_in_place(|| self.deliver());
        self.state = LinkState::Stopped;
        self.publish();
    }

    async fn connect_and_talk(&mut self) -> End {
        let stop = self.outlet.stop.clone();
        self.outlet.heartbeat.rest();
        let opened = select! {
            () = stop.asked() => None,
            opened = transport::open(&self.config, self.was_silent, stop.abandoned()) => Some(opened),
        };
        let mut link = match opened {
            Some(Ok(link)) => link,
            Some(Err(error)) => return End::Lost(error.to_string()),
            None => {
                self.stop_unlinked_device().await;
                return End::Stopped;
            }
        };
        let end = self.talk(&mut link).await;
        if matches!(end, End::Stopped) && !stop.is_abandoned() {
            self.stop_device(&mut link).await;
        }
        link.close().await;
        end
    }

    async fn talk(&mut self, link: &mut Transport) -> End {
        let stop = self.outlet.stop.clone();
        self.session.link_restored(host_time());
        if link.opens_connected() && block_in_place(|| self.came_up()) == Flow::Ends {
            return End::Stopped;
        }
        let silence = self.silence_timeout();
        let mut heard = Instant::now();
        self.was_silent = true;
        loop {
            if let Err(error) = self.send_requests(link).await {
                return End::Lost(format!("writing failed: {error}"));
            }
            self.outlet.heartbeat.rest();
            let wait = self
                .next_timer()
                .min(silence.saturating_sub(heard.elapsed()));
            // First what has come: a half frame must not expire while its rest waits to be read.
            let read = select! {
                biased;
                () = stop.asked() => return End::Stopped,
                read = link.read() => Some(read),
                () = sleep(wait) => None,
            };
            let bytes = match read.transpose() {
                Ok(bytes) => bytes,
                Err(error) => return End::Lost(error.to_string()),
            };
            if bytes.is_some() {
                heard = Instant::now();
                self.was_silent = false;
                self.outlet.read_at = Some(heard.into_std());
            } else if heard.elapsed() >= silence {
                return End::Lost(silence_words(&self.config.url, silence));
            }
            // Who takes what comes out may hold this up; nobody else's task waits for that.
            if block_in_place(|| self.take(bytes)) == Flow::Ends {
                return End::Stopped;
            }
        }
    }

    /// Takes what came, if anything did, and what is due by now.
    fn take(&mut self, bytes: Option<Bytes>) -> Flow {
        let byte_count = bytes.as_ref().map_or(0, Bytes::len);
        let _span = tracing::trace_span!("received", byte_count).entered();
        self.outlet.heartbeat.beat();
        if self.outlet.stop.is_abandoned() {
            return Flow::Ends;
        }
        if let Some(bytes) = bytes {
            if self.came_up() == Flow::Ends {
                return Flow::Ends;
            }
            let now = host_time();
            self.tap(now, Tapped::Bytes(&bytes));
            self.session.receive(&bytes, now);
        }
        let now = host_time();
        if self.session.handle_timeout(now) {
            self.tap(now, Tapped::HalfFrameExpired);
        }
        let flow = self.deliver();
        self.publish();
        flow
    }

    /// How long until the session has something to do.
    fn next_timer(&self) -> Duration {
        let due = self.session.poll_timeout();
        let wait_s = due.map(|due| due.seconds_since(host_time()).max(0.0));
        let wait = wait_s.and_then(|wait_s| Duration::try_from_secs_f64(wait_s).ok());
        wait.map_or(LONGEST_WAIT, |wait| wait.min(LONGEST_WAIT))
    }

    fn tap(&mut self, now: Timestamp, tapped: Tapped<'_>) {
        if let Some(raw) = &mut self.raw {
            raw(now, tapped);
        }
    }

    async fn send_requests(&mut self, link: &mut Transport) -> io::Result<()> {
        while let Some(frame) = self.session.poll_transmit() {
            link.write(frame).await?;
        }
        Ok(())
    }

    fn deliver(&mut self) -> Flow {
        let mut flow = Flow::GoesOn;
        self.outlet.status.count(&self.session);
        while let Some(event) = self.session.poll_event() {
            flow = self.tell(event.into());
            if flow == Flow::Ends {
                break;
            }
        }
        for (first, last) in self.outlet.take_shed() {
            self.tap(host_time(), Tapped::PingsShed(first, last));
        }
        flow
    }

    fn tell(&mut self, event: DriverEvent) -> Flow {
        match &event {
            DriverEvent::Ping { ping, .. } => tracing::trace!(ping = ping.sequence(), "decoded"),
            DriverEvent::Warning(text) => tracing::warn!(url = %self.config.url, "sonar: {text}"),
            DriverEvent::Nack { id, text } => {
                tracing::warn!(url = %self.config.url, id, "sonar refused a request: {text}");
            }
            DriverEvent::Rebooted => {
                if let Some(more) = self.restarts_said.admit(host_time()) {
                    tracing::warn!(url = %self.config.url, unsaid = (more > 0).then_some(more), "sonar was restarted");
                }
            }
            _ => {}
        }
        self.outlet.send(event)
    }

    fn came_up(&mut self) -> Flow {
        if self.state == LinkState::Up {
            return Flow::GoesOn;
        }
        if let Some(more) = self.ups_said.admit(host_time()) {
            tracing::info!(url = %self.config.url, unsaid = (more > 0).then_some(more), "sonar link is up");
        }
        self.tap(host_time(), Tapped::LinkUp);
        self.state = LinkState::Up;
        self.outlet.status.update(|status| status.connects += 1);
        self.publish();
        self.outlet.send(DriverEvent::LinkUp)
    }

    fn lost(&mut self, reason: String) -> Flow {
        let was_up = self.state == LinkState::Up;
        let now = host_time();
        if was_up {
            self.tap(now, Tapped::LinkDown);
        }
        self.session.link_lost(now);
        let flow = self.deliver();
        let is_news = self.state != LinkState::Down;
        self.state = LinkState::Down;
        self.outlet.status.update(|status| {
            status.disconnects += u64::from(was_up);
            status.reason = Some(reason.clone());
        });
        self.publish();
        if flow == Flow::Ends || !is_news {
            return flow;
        }
        if let Some(more) = self.downs_said.admit(now) {
            let url = &self.config.url;
            tracing::warn!(%url, unsaid = (more > 0).then_some(more), "sonar link is down, trying again: {reason}");
        }
        self.outlet.send(DriverEvent::LinkDown { reason })
    }

    fn publish(&self) {
        self.outlet.status.publish(self.state, Some(&self.session));
    }

    /// Stopped while the link is down: the unit may still be pinging, so one more try.
    async fn stop_unlinked_device(&mut self) {
        let was_connected = self.outlet.status.read().connects > 0;
        let stop = self.outlet.stop.clone();
        if !was_connected || stop.is_abandoned() {
            return;
        }
        if let Ok(mut link) = transport::open(&self.config, false, stop.abandoned()).await {
            self.stop_device(&mut link).await;
            link.close().await;
        }
    }

    /// Sends `enable = 0`, again if the device goes on, and reads until it is silent.
    async fn stop_device(&mut self, link: &mut Transport) {
        self.session.stop(host_time());
        let mut frames = Vec::new();
        while let Some(frame) = self.session.poll_transmit() {
            frames.push(frame);
        }
        let mut sent = Ok(());
        for _ in 0..2 {
            for frame in &frames {
                sent = sent.and(link.write(frame.clone()).await);
            }
            // Not in time: it goes on, and is told again.
            let silent = timeout(STOP_DRAIN / 2, self.drain(link)).await;
            if sent.is_err() || silent.is_ok() {
                break;
            }
        }
        if let Err(error) = &sent {
            tracing::warn!(url = %self.config.url, "sonar could not be told to stop: {error}");
        }
        self.outlet
            .status
            .update(|status| status.stop_sent = sent.is_ok());
    }

    /// Reads until nothing comes any more, or the link is gone.
    async fn drain(&mut self, link: &mut Transport) {
        while let Ok(Ok(bytes)) = timeout(QUIET, link.read()).await {
            let byte_count = bytes.len() as u64;
            let status = &self.outlet.status;
            status.update(|status| status.bytes_after_stop += byte_count);
        }
    }

    fn silence_timeout(&self) -> Duration {
        let intervals_s = 20.0 * self.config.session.expected_interval_s();
        Duration::try_from_secs_f64(self.config.silence_timeout_s.max(intervals_s))
            .unwrap_or(Duration::from_secs(600))
    }
}

/// What a silent link may lack.
fn silence_words(url: &SonarUrl, silence: Duration) -> String {
    let advice = match url {
        SonarUrl::Serial { baudrate, .. } => {
            format!(": is the unit powered, wired, and at {baudrate} baud?")
        }
        SonarUrl::Udp(_) => ": is the unit powered, and is this its address?".to_owned(),
        _ => String::new(),
    };
    format!("nothing came for {:.1} s{advice}", silence.as_secs_f64())
}

/// Says so if a serial line cannot carry what is asked for.
fn line_warning(config: &DriverConfig) -> Option<String> {
    let SonarUrl::Serial { baudrate, .. } = &config.url else {
        return None;
    };
    let profile_bytes = PROFILE_OVERHEAD_BYTES + 2.0 * f64::from(config.session.bin_count);
    let carried = f64::from(*baudrate) / (LINE_BITS_PER_BYTE * profile_bytes);
    let asked = 1.0 / config.session.expected_interval_s();
    (asked > carried).then(|| {
        format!(
            "{asked:.1} profiles/s of {} bins are asked for, but {baudrate} baud carry {carried:.1}: \
             set ping_interval_ms to {:.0} or more, or bin_count lower",
            config.session.bin_count,
            (1000.0 / carried).ceil(),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_at_115200_baud_carries_nine_profiles_a_second() {
        let url = "serial:///dev/ttyUSB0".parse().unwrap();
        let mut config = DriverConfig::new(url);
        let warning = line_warning(&config).unwrap();
        assert!(warning.contains("carry 9.1") && warning.contains("110 or more"));
        config.session.ping_interval_ms = 110;
        assert_eq!(line_warning(&config), None);
    }
}
