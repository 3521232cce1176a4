//! The live page: map, pings, poses and status of a running service in a browser, and the few things
//! that can be done from there.
//!
//! | address | what |
//! |---|---|
//! | `GET /` and its files | the page: plain ES modules and WebGL2, embedded in the binary |
//! | `GET /live` | WebSocket: see [`wire`] |
//! | `GET /map.ply`, `/map.ambiguous.ply` | the map as it stands |
//! | `GET /measure?pile=X,Y,Z` | a size in the map as it stands, or of `plane`, `distance`, `profile`, `section` |
//! | `GET /logs`, `/logs/NAME` | recordings as a JSON list, and one of them |
//! | `POST /recording/start`, `/recording/stop` | begins and ends a recording |
//! | `POST /replay/pause`, `/replay/resume` | holds what is replayed; with those for recordings all that changes anything |
//! | `GET /metrics` | every number of the status, for Prometheus |
//! | `GET /healthz` | 200 while the service reports, else 503 |
//! | `GET /register_service` | what `BlueOS` asks an extension |
//! | `GET /cockpit_extras.json`, `/widget.html` | what Cockpit asks of it, and the page without its frame |
//!
//! The service hands maps, pings and status to a [`Feed`]; nothing there waits for a browser or
//! encodes anything. Without a browser a ping costs one atomic load. Deltas are made by
//! [`echosplat_bus::MapEncoder`], once for all browsers; one that does not keep up misses messages
//! and is then sent what changed since.
//!
//! Deliberately absent: TLS, users, compression, any file of another host, settings that could be
//! changed from the page, and any control of the sonar.

mod about;
mod access;
mod address;
mod assets;
mod cockpit;
mod config;
mod control;
mod download;
mod feed;
mod hub;
mod metrics;
mod pings;
mod routes;
mod server;
mod socket;
mod track;
pub mod wire;
mod workers;

pub use about::About;
pub use address::{AddressError, WebAddress};
pub use config::WebConfig;
pub use control::{Control, LogFile, MapPart};
pub use feed::Feed;
pub use server::{WebError, WebServer};
pub use track::{Track, TrackPoint};
