//! A replay is held from the page, and goes on.

use std::time::Duration;

use serde_json::Value;

use crate::harness::free_port;
use crate::web::serving;
use crate::web_client::{Message, WebSocket, ask};

const LONG: Duration = Duration::from_secs(120);

/// The next status that the page is sent.
fn next_status(socket: &mut WebSocket) -> Value {
    loop {
        match socket.next(LONG) {
            Some(Message::Text(text)) => {
                let message: Value = serde_json::from_str(&text).expect("texts are JSON");
                if message["kind"] == "status" {
                    return message["status"].clone();
                }
            }
            Some(_) => {}
            None => panic!("no status"),
        }
    }
}

#[test]
fn a_replay_is_held_and_goes_on() {
    let port = free_port();
    let mut service = serving(port, "127.0.0.1", &["--rate", "4"]);
    let mut socket = WebSocket::open(port, "/live", &[]).unwrap();
    let asked = |path: &str| ask(port, "POST", path, &[]).status;
    let status = next_status(&mut socket);
    assert_eq!(status["replay_is_held"], false);
    assert!(status["link"]["configured"].is_null(), "no sonar is asked");
    assert_eq!(asked("/replay/pause"), 200);
    let held = std::iter::repeat_with(|| next_status(&mut socket));
    let mut held = held.skip_while(|status| status["replay_is_held"] != true);
    // What was read before it was held comes out by the second status after.
    let [before, after] = [held.nth(1), held.nth(1)].map(Option::unwrap);
    assert_eq!(before["pings_received"], after["pings_received"]);
    assert!(after["pings_received"].as_u64() < Some(crate::dive::PING_COUNT));
    assert_eq!(
        after["notices"], before["notices"],
        "to be held is nothing wrong"
    );
    assert_eq!(asked("/replay/resume"), 200);
    service.wait_for("the summary", LONG, |service| {
        service.stdout().contains("pings_mapped").then_some(())
    });
    service.interrupt();
    service.wait_exit_code(0, LONG);
    assert_eq!(service.only_json()["pings_mapped"], crate::dive::PING_COUNT);
}
