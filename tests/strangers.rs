//! A service as it comes is reached from its own machine alone.

use std::process::Command;
use std::time::Duration;

use crate::harness::Program;
use crate::namespaces::{End, Namespaces};

const LONG: Duration = Duration::from_secs(60);
/// Where the bus is unless configured.
const BUS: u16 = 7447;
const PAGE: u16 = 8080;
/// Of a program that any interface reaches, for comparison.
const OPEN: u16 = 9090;

/// Whether somebody accepts a connection there.
fn answers(mut command: Command) -> bool {
    let done = command.output().expect("ip and python3 are there");
    match String::from_utf8_lossy(&done.stdout).trim() {
        "answers" => true,
        "refused" => false,
        _ => panic!("{}", String::from_utf8_lossy(&done.stderr)),
    }
}

fn call(namespaces: &Namespaces, from: End, host: &str, port: u16) -> bool {
    let ask = format!(
        "import socket\ntry: socket.create_connection(('{host}', {port}), 5); print('answers')\n\
         except ConnectionRefusedError: print('refused')"
    );
    answers(namespaces.command(from, &["python3", "-c", &ask]))
}

/// Whether anything is bound to an address other than loopback's in one of these tables of Linux.
fn bound_beyond_loopback(tables: &str) -> Vec<&str> {
    let sockets = tables.lines().filter(|line| line.contains(": "));
    let open = sockets.filter(|line| {
        let mut words = line.split_whitespace().skip(1);
        let (local, _, state) = (words.next(), words.next(), words.next());
        // 0A listens; a socket of UDP that any peer reaches has state 07.
        let is_open = matches!(state, Some("0A" | "07"));
        let is_loopback = local.is_some_and(|local| {
            // 127.0.0.1 and ::1, in the order of this machine's bytes.
            local.starts_with("0100007F:") || local.starts_with("00000000000000000000000001000000:")
        });
        is_open && !is_loopback && local != Some("local_address")
    });
    open.collect()
}

#[test]
fn a_stranger_on_another_interface_reaches_neither_bus_nor_page() {
    let Some(namespaces) = Namespaces::with_link_of("100mbit") else {
        return;
    };
    let page = PAGE.to_string();
    let mut service = namespaces.echosplat(
        End::Vehicle,
        &["run", "--sonar", "sim://fence", "--web", &page],
    );
    let open = OPEN.to_string();
    let all = ["python3", "-m", "http.server", &open, "--bind", "0.0.0.0"];
    let mut neighbour = Program::start(namespaces.command(End::Vehicle, &all));
    service.wait_for("bus and page", LONG, |_| {
        let is_up = |port| call(&namespaces, End::Vehicle, "127.0.0.1", port);
        (is_up(BUS) && is_up(PAGE)).then_some(())
    });
    neighbour.wait_for("the neighbour", LONG, |_| {
        call(&namespaces, End::Shore, Namespaces::VEHICLE, OPEN).then_some(())
    });
    for from in [End::Vehicle, End::Shore] {
        for port in [BUS, PAGE] {
            let reached = call(&namespaces, from, Namespaces::VEHICLE, port);
            assert!(
                !reached,
                "{from:?} reaches port {port} of {}",
                Namespaces::VEHICLE
            );
        }
    }
    drop(neighbour);
    let tables = ["tcp", "tcp6", "udp", "udp6"].map(|kind| format!("/proc/net/{kind}"));
    let tables: Vec<&str> = tables.iter().map(String::as_str).collect();
    let cat = namespaces
        .command(End::Vehicle, &[&["cat"], &tables[..]].concat())
        .output();
    let told = String::from_utf8(cat.expect("cat").stdout).expect("tables of text");
    assert!(
        told.contains("0100007F:1D17"),
        "the bus is in none of\n{told}"
    );
    assert_eq!(bound_beyond_loopback(&told), Vec::<&str>::new());
    service.interrupt();
    service.wait_exit(LONG);
}
