//! One running service with all around it: a sonar behind a real link, a vehicle on a real bus.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use echosplat_bus::{Bus, BusConfig, MapSubscriber, free_port};
use echosplat_driver::{ListenUrl, ServeOptions, Server, serve};
use echosplat_simulator::SimulatedSonar;

use super::disk::Disk;
use super::outcome::Outcome;
use super::program::{LOOK_AGAIN, Program};
use super::sonar::{Sonar, SonarFault};
use super::status::Statuses;
use super::vehicle::{PoseFault, Vehicle};
use echosplat_service::clock;
use echosplat_service::signals::Stop;

/// A service maps within so long after its start.
const START_LIMIT: Duration = Duration::from_secs(30);
/// So many pings in the map before anything is spoilt.
const FIRST_PINGS: u64 = 5;
/// No condition takes longer to be looked for; a run is sound if nothing stands by then.
const SETTLED: Duration = Duration::from_millis(4_500);
/// A service ends within 5 s of being asked to; so much more for a busy machine.
const END_LIMIT: Duration = Duration::from_secs(15);

/// What all runs share.
pub(super) struct Setup {
    pub(super) program: PathBuf,
    pub(super) simulated: Arc<SimulatedSonar>,
    /// Runs that did not hold leave their files here.
    pub(super) out: PathBuf,
    pub(super) seed: u64,
    pub(super) stop: Stop,
}

/// How the sonar is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Link {
    Tcp,
    Udp,
    Pty,
}

/// What is spoilt.
#[derive(Debug, Clone, Copy)]
pub(super) enum Spoil {
    Sonar(SonarFault),
    Poses(PoseFault),
}

/// What differs between runs.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    /// Of its folder.
    pub(super) name: String,
    pub(super) link: Link,
    /// Where the device's millisecond counter begins.
    pub(super) clock_ms: u32,
    pub(super) environment: Vec<(String, String)>,
    /// Recordings go onto a disk of so many bytes.
    pub(super) disk_bytes: Option<u64>,
    /// More of the configuration.
    pub(super) settings: String,
}

impl Plan {
    pub(super) fn new(name: impl Into<String>, link: Link) -> Self {
        Self {
            name: name.into(),
            link,
            clock_ms: 0,
            environment: Vec::new(),
            disk_bytes: None,
            settings: String::new(),
        }
    }
}

/// A running service and all around it.
pub(super) struct Trial {
    // In the order in which they end.
    pub(super) program: Program,
    pub(super) vehicle: Vehicle,
    server: Option<Server>,
    pub(super) sonar: Arc<Sonar>,
    pub(super) statuses: Statuses,
    pub(super) bus: Arc<Bus>,
    /// Where the service's bus listens.
    pub(super) bus_port: u16,
    /// Where the sonar listens.
    pub(super) listen: ListenUrl,
    pub(super) folder: PathBuf,
    /// Where recordings are, if its size is limited.
    pub(super) disk: Option<Disk>,
    stop: Stop,
}

impl Trial {
    /// # Errors
    /// If something cannot be started.
    pub(super) fn start(setup: &Setup, plan: &Plan) -> anyhow::Result<Self> {
        let folder = setup.out.join(&plan.name);
        // What a former run left.
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let folder = folder.canonicalize()?;
        let recordings = folder.join("recordings");
        let disk = plan.disk_bytes.map(|bytes| Disk::mount(recordings, bytes));
        let disk = disk.transpose()?;
        let sonar = Sonar::new(Arc::clone(&setup.simulated), setup.seed, plan.clock_ms);
        let (server, listen) = listening(plan.link, &folder, &sonar)?;
        let bus_port = free_port()?;
        let arguments = arguments(setup, &folder, (server.url(), bus_port), &plan.settings)?;
        let program = Program::start(&setup.program, &arguments, &plan.environment)?;
        let bus = Arc::new(open_bus(bus_port)?);
        let statuses = Statuses::new(bus.subscribe_status()?);
        let dive = Arc::clone(setup.simulated.dive());
        let vehicle = Vehicle::start(Arc::clone(&bus), Arc::clone(&sonar), dive, setup.seed);
        Ok(Self {
            program,
            vehicle,
            server: Some(server),
            sonar,
            statuses,
            bus,
            bus_port,
            listen,
            folder,
            disk,
            stop: setup.stop.clone(),
        })
    }

    /// Waits until `is_so`, and says after how long; `None` if it was not within `limit` or the
    /// program has ended.
    pub(super) fn wait(
        &mut self,
        limit: Duration,
        mut is_so: impl FnMut(&mut Self) -> bool,
    ) -> Option<Duration> {
        let begin = Instant::now();
        loop {
            self.statuses.poll();
            if is_so(self) {
                return Some(begin.elapsed());
            }
            let is_over = begin.elapsed() >= limit || self.stop.is_set();
            if is_over || !self.program.is_running() {
                return None;
            }
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    /// Goes on for so long.
    pub(super) fn pass(&mut self, duration: Duration) {
        self.wait(duration, |_| false);
    }

    /// Waits for the first pings in the map.
    pub(super) fn wait_mapping(&mut self) -> bool {
        let maps = |trial: &mut Self| trial.statuses.mapped() >= FIRST_PINGS;
        self.wait(START_LIMIT, maps).is_some()
    }

    /// Waits until pings are mapped and nothing is wrong. What is wrong all the same is noted.
    pub(super) fn settle(&mut self, outcome: &mut Outcome) {
        let begins = self.wait_mapping();
        outcome.expect(begins, || "the service does not begin to map".to_owned());
        self.pass(SETTLED);
        let is_quiet = |trial: &mut Self| trial.program.log().standing().is_empty();
        let quiet = self.wait(SETTLED, is_quiet).is_some();
        outcome.expect(quiet, || {
            let standing = self.program.log().standing().clone();
            format!("told before anything was wrong: {standing:?}")
        });
        self.statuses.is_sound_now();
    }

    /// Seconds from now until pings that are sent from now on are mapped; `None` if that does not
    /// happen within `limit`.
    ///
    /// The published map says it at once where it is followed and changes. Statuses come once a
    /// second: of these the moment is worked out from how many pings came since.
    pub(super) fn maps_again(
        &mut self,
        limit: Duration,
        map: Option<&MapSubscriber>,
    ) -> Option<f64> {
        let (begin, host_time) = (Instant::now(), clock::now());
        let before = self.statuses.mapped() + self.sent_since_status();
        let mut position = None;
        let mut in_map_s = f64::INFINITY;
        let by_status = |trial: &Self| trial.statuses.mapped() > before + WAITING_PINGS;
        self.wait(limit, |trial| {
            if let Some(map) = map.filter(|map| map.position() != position) {
                position = map.position();
                if map.newest().is_some_and(|map| map.time > host_time) {
                    in_map_s = in_map_s.min(begin.elapsed().as_secs_f64());
                }
            }
            // Beyond this the map may just not have changed for a while.
            in_map_s <= SOON_S || by_status(trial)
        });
        let newest = self.statuses.newest().filter(|_| by_status(self));
        let by_status_s = newest.map_or(f64::INFINITY, |newest| {
            let after_s = newest.at.saturating_duration_since(begin).as_secs_f64();
            let mapped_since_s = (newest.mapped() - before) as f64 * PING_INTERVAL_S;
            (after_s - mapped_since_s).max(0.0)
        });
        let after_s = in_map_s.min(by_status_s);
        after_s.is_finite().then_some(after_s)
    }

    /// Profiles that left the device since the newest status came.
    fn sent_since_status(&self) -> u64 {
        let Some(heard) = self.statuses.newest() else {
            return 0;
        };
        let sent = self.sonar.sent();
        let since = sent.iter().rev().take_while(|ping| ping.at > heard.at);
        since.count() as u64
    }

    /// Begins a fault, or ends whatever is wrong.
    pub(super) fn set_fault(&self, fault: Option<Spoil>) {
        match fault {
            Some(Spoil::Sonar(fault)) => self.sonar.set_fault(Some(fault)),
            Some(Spoil::Poses(fault)) => self.set_pose_fault(Some(fault)),
            None => {
                self.sonar.set_fault(None);
                self.set_pose_fault(None);
            }
        }
    }

    /// Begins a fault of the poses, or ends it.
    pub(super) fn set_pose_fault(&self, fault: Option<PoseFault>) {
        self.vehicle.set_fault(fault);
    }

    /// Takes the link away.
    pub(super) fn unplug(&mut self) {
        if let Some(server) = self.server.take() {
            // Its last state is of no use: the device goes on.
            let _ = server.stop();
        }
    }

    /// Times that the link did not take what left the sonar.
    pub(super) fn refused_count(&self) -> u64 {
        let server = self.server.as_ref();
        server.map_or(0, |server| server.status().frames_dropped)
    }

    /// Brings the link back where it was.
    ///
    /// # Errors
    /// If the address cannot be listened on again.
    pub(super) fn plug_in(&mut self) -> anyhow::Result<()> {
        let server = serve(&self.listen, self.sonar.served(), real_time())?;
        self.server = Some(server);
        Ok(())
    }

    /// Open files and sockets of the program.
    pub(super) fn descriptor_count(&self) -> usize {
        self.program.descriptor_count()
    }

    pub(super) fn map(&self) -> PathBuf {
        self.folder.join("map.ply")
    }

    /// Asks the program to end and notes what it leaves: one of these exit codes, a finite map and
    /// finite figures. The folder goes if all held.
    pub(super) fn end(mut self, outcome: &mut Outcome, codes: &[i32]) {
        let status = self.program.terminate(END_LIMIT);
        let found = status.and_then(|status| status.code());
        outcome.expect(
            found.is_some_and(|code| codes.contains(&code)),
            || match status {
                Some(status) => format!("it ended with {status} and not with {codes:?}"),
                None => format!("it did not end within {END_LIMIT:?} of being asked to"),
            },
        );
        let not_finite = self.statuses.not_finite();
        outcome.expect(not_finite.is_empty(), || {
            format!("figures of the status that were not finite: {not_finite:?}")
        });
        let fault = map_fault(&self.map());
        outcome.expect(fault.is_none(), || fault.unwrap_or_default());
        self.leave(outcome);
    }

    /// Ends all; the folder goes if all held, else the log is left there too.
    pub(super) fn leave(mut self, outcome: &Outcome) {
        self.program.kill();
        // Before its folder goes.
        drop(self.disk.take());
        if outcome.held {
            // What stays is looked at by nobody.
            let _ = fs::remove_dir_all(&self.folder);
        } else {
            let log = self.program.log().text();
            let _ = fs::write(self.folder.join("log.jsonl"), log);
        }
    }
}

/// What the published map shows no later than this is taken as it is, seconds.
const SOON_S: f64 = 0.7;
/// Pings that may have waited for their poses when something was spoilt.
const WAITING_PINGS: u64 = 20;
/// From ping to ping, as the configuration asks for.
pub(super) const PING_INTERVAL_S: f64 = 0.025;

fn real_time() -> ServeOptions {
    ServeOptions { rate: 1.0 }
}

fn listening(link: Link, folder: &Path, sonar: &Arc<Sonar>) -> anyhow::Result<(Server, ListenUrl)> {
    let wanted = match link {
        Link::Tcp => "tcp://127.0.0.1:0".to_owned(),
        Link::Udp => "udp://127.0.0.1:0".to_owned(),
        Link::Pty => format!("serial://{}", folder.join("sonar").display()),
    };
    let server = serve(&wanted.parse()?, sonar.served(), real_time())?;
    // With the port that was taken, so that it can be listened on again.
    let listen = match link {
        Link::Pty => wanted.parse()?,
        Link::Tcp | Link::Udp => server.url().parse()?,
    };
    Ok((server, listen))
}

fn arguments(
    setup: &Setup,
    folder: &Path,
    (sonar_url, bus_port): (&str, u16),
    more: &str,
) -> anyhow::Result<Vec<String>> {
    let settings = setup.simulated.dive().settings();
    let config = folder.join("config.toml");
    let text = format!(
        "[session]\nrange_start_m = {:?}\nrange_length_m = {:?}\nbin_count = {}\n\
         ping_interval_ms = {}\n{more}",
        settings.range_start_m,
        settings.range_length_m,
        settings.bin_count,
        (PING_INTERVAL_S * 1e3).round(),
    );
    fs::write(&config, text).with_context(|| format!("cannot write {}", config.display()))?;
    let path = |name: &str| folder.join(name).display().to_string();
    let endpoint = |way: &str| format!("{way}/endpoints=[\"tcp/127.0.0.1:{bus_port}\"]");
    let (listen, connect) = (endpoint("listen"), endpoint("connect"));
    let (config, map, recordings) = (path("config.toml"), path("map.ply"), path("recordings"));
    let words = [
        "run",
        "--config",
        &config,
        "--sonar",
        sonar_url,
        "--map",
        &map,
        "--record",
        &recordings,
        "--threads",
        "1",
        "--zenoh",
        &listen,
        "--zenoh",
        &connect,
    ];
    Ok(words.map(str::to_owned).to_vec())
}

/// A session that connects to the service as soon as that listens.
pub(super) fn open_bus(port: u16) -> anyhow::Result<Bus> {
    let owned = |(key, value): (&str, String)| (key.to_owned(), value);
    let zenoh = [
        ("listen/endpoints", "[]".to_owned()),
        ("connect/endpoints", format!("[\"tcp/127.0.0.1:{port}\"]")),
        ("connect/timeout_ms", "-1".to_owned()),
    ];
    let bus = Bus::open(BusConfig {
        zenoh: zenoh.map(owned).into(),
        open_timeout_s: 60.0,
        ..BusConfig::default()
    });
    bus.context("the service's bus cannot be reached")
}

/// What is wrong with the map that was left.
pub(super) fn map_fault(map: &Path) -> Option<String> {
    let gaussians = match echosplat_recording::ply::read_map(map) {
        Ok(map) => map.gaussians,
        Err(error) => return Some(format!("the map {}: {error}", map.display())),
    };
    let unsound = gaussians.iter().filter(|g| !g.is_sound()).count();
    (unsound > 0).then(|| format!("{unsound} Gaussians of the map are not finite"))
}
