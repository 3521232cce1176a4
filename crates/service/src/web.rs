//! The page: where it is served, and what it can have done.

use std::fs::File;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, UNIX_EPOCH};

use echosplat_driver::Pause;
use echosplat_georeference::Georeference;
use echosplat_liveness::Heartbeat;
use echosplat_model::glam::DVec3;
use echosplat_model::{Snapshot, Standing};
use echosplat_recording::ply::{self, MapFile};
use echosplat_web::{About, Control, Feed, LogFile, MapPart, WebServer};
use serde_json::{Value, json};

use crate::arguments;
use crate::config::Config;
use crate::exit::Usage;
use crate::maps::MapNotes;
use crate::measuring::{Asked, asserted, measure};
use crate::recorder::Recorder;
use crate::runtime;
use crate::signals::Stop;

/// Logs that are listed.
const MOST_LOGS: usize = 200;
/// How often it is asked whether to end.
const TICK: Duration = Duration::from_millis(50);

/// The page of a run.
pub(crate) struct Page {
    server: WebServer,
    service: Arc<Service>,
}

impl Page {
    /// Serves it, if the configuration says where.
    ///
    /// # Errors
    /// If the address is taken or none of this machine.
    pub(crate) fn start(config: &Config) -> anyhow::Result<Option<Self>> {
        let address = config.web.parsed_address().map_err(Usage::error)?;
        let Some(address) = address else {
            return Ok(None);
        };
        let about = About {
            node: config.bus.node.clone(),
            version: arguments::VERSION.to_owned(),
            azimuth_width_deg: config.mapper.beam.azimuth_width_deg.into(),
            elevation_width_deg: config.mapper.beam.elevation_width_deg.into(),
        };
        let service = Arc::new(Service {
            recorder: Mutex::default(),
            pause: Mutex::default(),
            held_out_every: config.pipeline.hold_back_every,
            georeference: config.georeference.georeference(),
        });
        let control = Arc::clone(&service);
        let runtime = runtime::handle()?;
        let server = WebServer::start(
            &runtime,
            &address,
            &config.web,
            config.bus.clone(),
            about,
            control,
        )
        .map_err(Usage::error)?;
        tracing::info!("the page is at {}", server.url());
        if server.is_open() {
            tracing::warn!(
                "other machines reach the page: all of them can see it, and without encryption; \
                 recording needs the token in the address above"
            );
        }
        Ok(Some(Self { server, service }))
    }

    /// Where what there is to show is given.
    pub(crate) fn feed(&self) -> Feed {
        self.server.feed()
    }

    /// Of the threads that make what it shows.
    pub(crate) fn heartbeats(&self) -> Vec<Heartbeat> {
        self.server.heartbeats().to_vec()
    }

    /// What is begun and ended from the page.
    pub(crate) fn control(&self, recorder: Option<&Recorder>) {
        *lock(&self.service.recorder) = recorder.cloned();
    }

    /// What is held and let go on from the page.
    pub(crate) fn control_replay(&self, pause: &Pause) {
        *lock(&self.service.pause) = Some(pause.clone());
    }

    /// A dive that was replayed is looked at until Ctrl-C.
    pub(crate) fn stay(self, stop: &Stop) {
        if stop.is_set() {
            return;
        }
        let url = self.server.url();
        tracing::info!("the page stays at {url} until Ctrl-C");
        while !stop.is_set() {
            std::thread::sleep(TICK);
        }
    }
}

/// What the page can have done.
struct Service {
    recorder: Mutex<Option<Recorder>>,
    /// Of what is replayed.
    pause: Mutex<Option<Pause>>,
    held_out_every: u64,
    georeference: Option<Georeference>,
}

impl Service {
    /// Cloned, so that nobody waits for what is done with it.
    fn recorder(&self) -> Option<Recorder> {
        lock(&self.recorder).clone()
    }
}

impl Control for Service {
    fn write_map(&self, map: &Snapshot, part: MapPart, to: &mut dyn Write) -> io::Result<()> {
        let standing = match part {
            MapPart::Confident => Standing::Confident,
            MapPart::Ambiguous => Standing::Ambiguous,
        };
        let wanted = map.gaussians.iter().filter(|g| g.standing == standing);
        let file = MapFile {
            origin_m: map.origin_m,
            intensity_unit: map.intensity_unit,
            notes: MapNotes {
                held_out_every: self.held_out_every,
                georeference: self.georeference.clone(),
                ..MapNotes::default()
            },
            gaussians: wanted.copied().collect(),
            ..MapFile::default()
        };
        ply::write(&file, to)
    }

    fn measure(&self, map: &Snapshot, query: &str) -> Result<Value, String> {
        let asked = Asked::of_query(query)?;
        let samples = asserted(map.origin_m, &map.gaussians);
        let found = measure(&asked, &samples, self.georeference.as_ref());
        let found = found.map_err(|error| error.to_string())?;
        Ok(json!({
            "name": found.name,
            "lines": found.lines,
            "facts": found.facts,
            "shape_m": found.shape.iter().map(DVec3::to_array).collect::<Vec<_>>(),
        }))
    }

    fn is_recording(&self) -> bool {
        self.recorder()
            .is_some_and(|recorder| recorder.is_running())
    }

    fn start_recording(&self) -> Result<(), String> {
        let nothing = || "nothing runs that could be recorded".to_owned();
        let recorder = self.recorder().ok_or_else(nothing)?;
        recorder.begin().map_err(|error| error.to_string())
    }

    fn stop_recording(&self) -> Result<(), String> {
        match self.recorder().is_some_and(|recorder| recorder.end()) {
            true => Ok(()),
            false => Err("no recording goes on".to_owned()),
        }
    }

    fn hold_replay(&self, is_held: bool) -> Result<(), String> {
        match &*lock(&self.pause) {
            Some(pause) => {
                pause.set(is_held);
                Ok(())
            }
            None => Err("nothing is replayed here that could be held".to_owned()),
        }
    }

    fn logs(&self) -> Vec<LogFile> {
        let Some(recorder) = self.recorder() else {
            return Vec::new();
        };
        let entries = std::fs::read_dir(recorder.directory());
        let entries = entries.into_iter().flatten().flatten();
        let mut logs: Vec<LogFile> = entries.filter_map(|entry| log_of(&entry)).collect();
        logs.sort_by(|a, b| (b.modified_s, &b.name).cmp(&(a.modified_s, &a.name)));
        logs.truncate(MOST_LOGS);
        logs
    }

    fn open_log(&self, name: &str) -> Option<io::Result<File>> {
        let recorder = self.recorder()?;
        // Of those that are there, so that no name leads elsewhere.
        let log = self.logs().into_iter().find(|log| log.name == name)?;
        Some(File::open(
            recorder.directory().join(PathBuf::from(log.name)),
        ))
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn log_of(entry: &std::fs::DirEntry) -> Option<LogFile> {
    let name = entry.file_name().into_string().ok()?;
    let is_log = [".mcap", ".svlog"].iter().any(|end| name.ends_with(end));
    // Of the entry itself: a link is no file of ours.
    let metadata = entry.metadata().ok()?;
    let modified = metadata.modified().ok()?;
    let modified = modified.duration_since(UNIX_EPOCH).unwrap_or_default();
    (is_log && metadata.is_file()).then_some(LogFile {
        name,
        bytes: metadata.len(),
        modified_s: modified.as_secs(),
    })
}
