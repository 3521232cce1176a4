//! The thread that serves a device: requests in, profiles out when they are due.

use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, bounded};

use super::clock::DeviceClock;
use super::port::{Asked, Port};
use super::{EmulatedDevice, ListenUrl, ServeError, ServeOptions, ServeStatus};
use super::{serial, tcp, udp};
use crate::stop::{Stop, Stopper, stop_pair};

/// Requests are looked for this often, however fast profiles go out.
const REQUESTS_EVERY: Duration = Duration::from_millis(1);
/// Longest wait while there is nothing to do.
const IDLE_WAIT: Duration = Duration::from_millis(2);
/// Wait for a client that takes no more, at rate 0.
const FULL_WAIT: Duration = Duration::from_micros(200);
/// Last frames, answers to a request to stop among them, are given so long to go out.
const FLUSH_ON_STOP: Duration = Duration::from_millis(100);
const STOP_WAIT: Duration = Duration::from_secs(5);

/// A device being served. Dropping it stops the thread without waiting.
#[derive(Debug)]
pub struct Server {
    url: String,
    stopper: Stopper,
    status: Arc<Mutex<ServeStatus>>,
    ended: Receiver<()>,
}

/// Listens, then serves `device` on a thread of its own (`emulator`) until stopped.
///
/// # Errors
/// If the address is taken or cannot be listened on (named in the message), or the rate is
/// negative.
pub fn serve(
    listen: &ListenUrl,
    device: Box<dyn EmulatedDevice>,
    options: ServeOptions,
) -> Result<Server, ServeError> {
    if !(options.rate >= 0.0 && options.rate.is_finite()) {
        return Err(ServeError::Rate(options.rate));
    }
    let port = open(listen).map_err(|source| {
        let url = listen.to_string();
        match serial::is_taken(&source) {
            true => ServeError::InUse { url },
            false => ServeError::Listen { url, source },
        }
    })?;
    let url = port.url();
    let (stopper, stop) = stop_pair();
    let status = Arc::new(Mutex::new(ServeStatus::default()));
    let worker = Worker {
        port,
        device,
        clock: DeviceClock::new(options.rate),
        as_fast_as_taken: options.rate <= 0.0,
        stop,
        shared: Arc::clone(&status),
        status: ServeStatus::default(),
    };
    let (alive, ended) = bounded(0);
    thread::Builder::new()
        .name("emulator".to_owned())
        .spawn(move || {
            worker.run();
            drop::<Sender<()>>(alive);
        })
        .map_err(ServeError::Thread)?;
    Ok(Server {
        url,
        stopper,
        status,
        ended,
    })
}

fn open(listen: &ListenUrl) -> io::Result<Box<dyn Port>> {
    Ok(match listen {
        ListenUrl::Tcp(address) => Box::new(tcp::Tcp::bind(address)?),
        ListenUrl::Udp(address) => Box::new(udp::Udp::bind(address)?),
        ListenUrl::Pty { link } => serial::open_pty(link.as_deref())?,
        ListenUrl::Serial { path, baudrate } if serial::is_line(path) => {
            serial::open_line(path, *baudrate)?
        }
        ListenUrl::Serial { path, .. } => serial::open_pty(Some(path))?,
    })
}

impl Server {
    /// What a client connects to, with the port or path that was taken.
    #[must_use]
    pub fn url(&self) -> &str {
        &self.url
    }

    /// The latest state.
    #[must_use]
    pub fn status(&self) -> ServeStatus {
        *self.status.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the thread and all links, in bounded time; returns the last state.
    #[must_use]
    pub fn stop(mut self) -> ServeStatus {
        self.stopper.stop();
        // Nothing is ever sent: this waits for the thread to drop its end.
        let _ = self.ended.recv_timeout(STOP_WAIT);
        self.status()
    }
}

struct Worker {
    port: Box<dyn Port>,
    device: Box<dyn EmulatedDevice>,
    clock: DeviceClock,
    as_fast_as_taken: bool,
    stop: Stop,
    shared: Arc<Mutex<ServeStatus>>,
    status: ServeStatus,
}

impl Worker {
    fn run(mut self) {
        let mut served = Instant::now();
        let mut frame = Vec::new();
        let mut is_idle = true;
        while !self.stop.is_set() {
            let mut was_busy = false;
            if is_idle || served.elapsed() >= REQUESTS_EVERY {
                served = Instant::now();
                was_busy = self.serve_requests(served);
            }
            let wait = self.wait();
            if wait.is_zero() {
                self.transmit(&mut frame);
            }
            self.port.flush();
            is_idle = !was_busy && !wait.is_zero();
            if is_idle {
                self.stop.wait(wait.min(IDLE_WAIT));
            }
        }
        self.flush_last();
        self.publish();
    }

    fn serve_requests(&mut self, wall: Instant) -> bool {
        let mut asked = Asked {
            now: self.clock.now(wall),
            device: &mut *self.device,
        };
        let was_busy = self.port.serve(&mut asked, &mut self.status);
        self.device.go_along(self.status.clients_seen);
        match self.device.next_ping_due() {
            Some(_) => self.clock.start(wall),
            None => self.clock.stop(wall),
        }
        self.publish();
        was_busy
    }

    /// How long until the next frame; zero if it is time for it.
    fn wait(&mut self) -> Duration {
        match self.device.next_due() {
            None => IDLE_WAIT,
            Some(_) if self.as_fast_as_taken => match self.port.is_ready() {
                true => Duration::ZERO,
                false => FULL_WAIT,
            },
            Some(due) => self.clock.wait(due, Instant::now()),
        }
    }

    fn transmit(&mut self, frames: &mut Vec<u8>) {
        let Some(due) = self.device.next_due() else {
            return;
        };
        if self.device.next_ping_due().is_some_and(|ping| ping <= due) {
            self.status.pings += 1;
        }
        frames.clear();
        self.device.transmit(frames);
        self.clock.has_sent(due);
        if !frames.is_empty() {
            self.port.broadcast(frames, &mut self.status);
        }
    }

    fn flush_last(&mut self) {
        let began = Instant::now();
        self.port.flush();
        while self.port.has_waiting() && began.elapsed() < FLUSH_ON_STOP {
            thread::sleep(FULL_WAIT);
            self.port.flush();
        }
    }

    fn publish(&mut self) {
        self.status.is_pinging = self.device.next_due().is_some();
        self.status.is_finished = self.device.is_finished();
        *self.shared.lock().unwrap_or_else(PoisonError::into_inner) = self.status;
    }
}
