//! Whole-service tests: the program as users run it, against devices and clients written by
//! others or a second time. Needs `python3` for the latter.

mod harness;
mod namespaces;
mod python;
mod web_client;

#[cfg(feature = "bench")]
mod bench;
mod browser;
mod browser_pictures;
mod calibrate;
mod damaged;
mod demo;
mod device;
mod disturbances;
mod dive;
mod doors;
mod earth;
mod emulated;
mod extension;
mod fake_sonar;
#[cfg(feature = "bench")]
mod faults;
mod files;
mod gnss;
mod handout;
mod hold;
mod info;
mod link;
mod log_clock;
mod map;
mod mavlink;
mod measures;
mod mesh;
mod notices;
mod outputs;
mod pages;
mod pipes;
mod pose_errors;
mod poses;
mod probe;
mod proxied;
mod python_tools;
mod readme;
mod recording;
mod render;
mod replay;
mod roles;
mod ros2;
mod routers;
mod sample_dive;
mod serial_line;
mod slow_link;
mod strangers;
mod supervision;
mod tapes;
mod trajectories;
mod units;
mod watch;
mod web;
mod written;
mod wrong_input;
