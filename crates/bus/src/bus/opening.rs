//! Opens a session whether or not anybody is there to connect to.
//!
//! A peer or a router opens at once, and tries its endpoints until somebody answers. A client of zenoh
//! 1.10 does not: its opening fails, or never returns, as long as no router answers; but one whose
//! router is gone tries all its endpoints until one answers. So where none does, a client is opened
//! at a router of our own, on a port of the loopback interface, which has nothing and is closed
//! again at once.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use zenoh::{Config, Session, Wait};

use super::company;
use crate::listening::free_port;
use crate::zenoh_config::{Plan, setting};

/// A router that is there answers within so long, milliseconds.
const FIRST_TRY_MS: &str = "1500";
/// The router of our own is gone within so long.
const GONE_WITHIN: Duration = Duration::from_secs(5);
const LOOK_AGAIN: Duration = Duration::from_millis(10);

/// Opens what is planned.
///
/// # Errors
/// What zenoh says; that nobody answers is none.
pub(super) fn open(plan: Plan) -> Result<Session, zenoh::Error> {
    if !plan.is_client() {
        return zenoh::open(plan.config).wait();
    }
    let mut first = plan.config.clone();
    first.insert_json5("connect/timeout_ms", FIRST_TRY_MS)?;
    match zenoh::open(first).wait() {
        Ok(session) => Ok(session),
        Err(reason) if plan.endpoints.connect.is_empty() && !plan.scouts() => Err(reason),
        Err(reason) => {
            tracing::debug!(%reason, "no router answers");
            as_if_lost(plan.config)
        }
    }
}

/// A client that has lost its router.
fn as_if_lost(mut config: Config) -> Result<Session, zenoh::Error> {
    let stand_in = StandIn::open(&config)?;
    let theirs = setting(&config, "connect/endpoints");
    let mut endpoints = vec![json!(stand_in.endpoint)];
    endpoints.extend(of_client(theirs));
    config.insert_json5("connect/endpoints", &Value::from(endpoints).to_string())?;
    config.insert_json5("connect/timeout_ms", "5000")?;
    let session = zenoh::open(config).wait()?;
    drop(stand_in);
    let begin = Instant::now();
    while company(&session) > 0 && begin.elapsed() < GONE_WITHIN {
        std::thread::sleep(LOOK_AGAIN);
    }
    Ok(session)
}

/// Those of a client, where endpoints are given for each mode.
fn of_client(endpoints: Value) -> Vec<Value> {
    match endpoints {
        Value::Array(list) => list,
        Value::Object(mut modes) => modes.remove("client").map_or(Vec::new(), of_client),
        _ => Vec::new(),
    }
}

/// A router that only this process knows of.
struct StandIn {
    endpoint: String,
    session: Session,
    _users: Option<Users>,
}

impl StandIn {
    fn open(of_client: &Config) -> Result<Self, zenoh::Error> {
        let endpoint = format!("tcp/127.0.0.1:{}", free_port()?);
        let listen = json!([endpoint]).to_string();
        let mut config = Config::default();
        let settings = [
            ("mode", "\"router\""),
            ("scouting/multicast/enabled", "false"),
            ("scouting/gossip/enabled", "false"),
            ("listen/endpoints", &listen),
        ];
        for (key, value) in settings {
            config.insert_json5(key, value)?;
        }
        let users = Users::with_that_of(of_client)?;
        if let Some(Users(path)) = &users {
            let path = json!(path.display().to_string()).to_string();
            config.insert_json5("transport/auth/usrpwd/dictionary_file", &path)?;
        }
        Ok(Self {
            endpoint,
            session: zenoh::open(config).wait()?,
            _users: users,
        })
    }
}

impl Drop for StandIn {
    fn drop(&mut self) {
        if let Err(reason) = self.session.close().wait() {
            tracing::debug!(%reason, "zenoh");
        }
    }
}

/// A client with a name and a password insists on being asked for them: a file that holds both, for this
/// user's eyes alone, gone when dropped.
struct Users(PathBuf);

impl Users {
    fn with_that_of(client: &Config) -> std::io::Result<Option<Self>> {
        let text = |key: &str| match setting(client, key) {
            Value::String(text) => Some(text),
            _ => None,
        };
        let user = text("transport/auth/usrpwd/user");
        let Some((user, password)) = user.zip(text("transport/auth/usrpwd/password")) else {
            return Ok(None);
        };
        let unique = format!("echosplat-{}-{}", std::process::id(), free_port()?);
        let users = Self(std::env::temp_dir().join(unique));
        let mut file = private(&users.0)?;
        writeln!(file, "{user}:{password}")?;
        Ok(Some(users))
    }
}

fn private(path: &Path) -> std::io::Result<fs::File> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

impl Drop for Users {
    fn drop(&mut self) {
        // What cannot be removed was made by somebody else, or is gone.
        let _ = fs::remove_file(&self.0);
    }
}
