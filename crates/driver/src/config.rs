//! How the link to a sonar is kept.

use echosplat_session::{SessionConfig, SessionConfigError};

use crate::pause::Pause;
use crate::url::SonarUrl;

/// How the link to a sonar is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct DriverConfig {
    /// Where the sonar is.
    pub url: SonarUrl,
    /// What is asked of it.
    pub session: SessionConfig,
    /// Longest wait for a connection or for bytes to be taken. 0.05 to 60 s.
    pub io_timeout_s: f64,
    /// First wait before connecting again; it doubles. 0.01 to 60 s.
    pub reconnect_min_s: f64,
    /// Longest wait before connecting again. At least the first, at most 60 s.
    pub reconnect_max_s: f64,
    /// A link without a byte for so long is lost; also 20 intervals between pings. 0.2 to 600 s.
    pub silence_timeout_s: f64,
    /// Times real time for `file://`; 0 is as fast as the events are taken.
    pub rate: f64,
    /// A tape's bytes are those of a log, with its session packets, and not of a link.
    pub tape_is_log: bool,
    /// Holds a log or a tape between two pings; a link is not held.
    pub pause: Option<Pause>,
}

impl DriverConfig {
    /// The defaults for a sonar at `url`.
    #[must_use]
    pub fn new(url: SonarUrl) -> Self {
        Self {
            url,
            session: SessionConfig::default(),
            io_timeout_s: 1.0,
            reconnect_min_s: 0.05,
            reconnect_max_s: 0.5,
            silence_timeout_s: 5.0,
            rate: 0.0,
            tape_is_log: false,
            pause: None,
        }
    }

    /// # Errors
    /// Names the first setting out of range, what it holds and what is allowed.
    pub fn check(&self) -> Result<(), DriverError> {
        self.session.check()?;
        let within = |key, value: f64, low: f64, high: f64| match value >= low && value <= high {
            true => Ok(()),
            false => Err(DriverError::Setting {
                key,
                value,
                low,
                high,
            }),
        };
        within("io_timeout_s", self.io_timeout_s, 0.05, 60.0)?;
        within("reconnect_min_s", self.reconnect_min_s, 0.01, 60.0)?;
        let least = self.reconnect_min_s;
        within("reconnect_max_s", self.reconnect_max_s, least, 60.0)?;
        within("silence_timeout_s", self.silence_timeout_s, 0.2, 600.0)?;
        within("rate", self.rate, 0.0, 1e6)
    }
}

/// Why a driver could not be started.
#[derive(Debug, thiserror::Error)]
pub enum DriverError {
    /// What is to be asked of the device cannot be.
    #[error(transparent)]
    Session(#[from] SessionConfigError),
    /// A setting of the link out of range.
    #[error("sonar setting `{key}` is {value}; allowed is {low} to {high}")]
    Setting {
        /// Name of the field.
        key: &'static str,
        /// What it held.
        value: f64,
        /// Least allowed.
        low: f64,
        /// Most allowed.
        high: f64,
    },
    /// `sim://` has no transport.
    #[error("sim://{scene} is not a transport: serve a simulated device and connect to that")]
    Simulated {
        /// Of the URL.
        scene: String,
    },
    /// The log cannot be read.
    #[error("log {path} cannot be opened: {source}")]
    Log {
        /// Of the URL.
        path: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The path of a serial line leads to something else.
    #[error(
        "{path} is {what}, not a serial line: give the device, as in \
         serial:///dev/ttyUSB0?baudrate=115200"
    )]
    NoLine {
        /// Of the URL.
        path: String,
        /// What is there.
        what: &'static str,
    },
    /// The system gives no thread.
    #[error("the thread for the sonar could not be started: {0}")]
    Thread(std::io::Error),
}
