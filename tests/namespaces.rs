//! Two machines with a link of their own between them, as network namespaces. Needs root, `ip` and
//! `tc`; tests pass over what they cannot have.

use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::browser::say;
use crate::harness::Program;

/// One of the two machines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    Vehicle,
    Shore,
}

/// Gone when dropped.
pub(crate) struct Namespaces([String; 2]);

impl Namespaces {
    /// The vehicle's address on the link.
    pub(crate) const VEHICLE: &str = "10.99.0.1";
    const SHORE: &str = "10.99.0.2";

    /// With a link that carries so much each way, in the words of `tc`. Says so and gives `None` where
    /// this user or machine cannot have them.
    pub(crate) fn with_link_of(rate: &str) -> Option<Self> {
        static MADE: AtomicU32 = AtomicU32::new(0);
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let names = ["v", "s"].map(|end| format!("es{end}{}-{number}", std::process::id()));
        let made = Self(names);
        if made.link(rate) {
            return Some(made);
        }
        say("passed over: network namespaces need root, ip and tc");
        None
    }

    fn link(&self, rate: &str) -> bool {
        let [vehicle, shore] = &self.0;
        let link =
            format!("link add tether netns {vehicle} type veth peer name tether netns {shore}");
        let add = |name| format!("netns add {name}");
        let is_made = [add(vehicle), add(shore), link]
            .iter()
            .all(|command| ip(command));
        let up = |(name, address)| {
            let slow =
                format!("tc qdisc add dev tether root tbf rate {rate} burst 16kb latency 50ms");
            ip(&format!("-n {name} addr add {address}/24 dev tether"))
                && ip(&format!("-n {name} link set tether up"))
                && ip(&format!("-n {name} link set lo up"))
                && ip(&format!("netns exec {name} {slow}"))
        };
        is_made
            && [(vehicle, Self::VEHICLE), (shore, Self::SHORE)]
                .into_iter()
                .all(up)
    }

    /// Options that let others come to the vehicle.
    pub(crate) const fn host() -> [&'static str; 4] {
        [
            "--zenoh",
            "listen/endpoints=[\"tcp/10.99.0.1:7447\"]",
            "--zenoh",
            "connect/endpoints=[]",
        ]
    }

    /// Options to come there.
    pub(crate) const fn guest() -> [&'static str; 4] {
        [
            "--zenoh",
            "listen/endpoints=[]",
            "--zenoh",
            "connect/endpoints=[\"tcp/10.99.0.1:7447\"]",
        ]
    }

    /// Our own program there.
    pub(crate) fn echosplat(&self, end: End, arguments: &[&str]) -> Program {
        let program = [env!("CARGO_BIN_EXE_echosplat")];
        Program::start(self.command(end, &[&program[..], arguments].concat()))
    }

    /// Any program there.
    pub(crate) fn command(&self, end: End, program: &[&str]) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.0[end as usize]]);
        command.args(program);
        command
    }
}

impl Drop for Namespaces {
    fn drop(&mut self) {
        for name in &self.0 {
            let _ = Command::new("ip").args(["netns", "del", name]).output();
        }
    }
}

fn ip(arguments: &str) -> bool {
    let done = Command::new("ip").args(arguments.split(' ')).output();
    done.is_ok_and(|done| done.status.success())
}
