//! A mapper and what answers as its driver and is none: each is named as what it is, and none fills a
//! log.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use serde_json::{Value, json};
use zenoh::Wait;
use zenoh::query::Query;

use crate::harness::{Program, free_port, wait_until_listening};

const LONG: Duration = Duration::from_secs(60);
const KEY: &str = "echosplat/rov/driver/tape";

fn mapper(port: u16) -> Program {
    let listen = format!("listen/endpoints=[\"tcp/127.0.0.1:{port}\"]");
    let mut mapper = Program::echosplat(&[
        "run",
        "--role",
        "mapper",
        "--node",
        "rov",
        "--zenoh",
        &listen,
        "--zenoh",
        "connect/endpoints=[]",
    ]);
    wait_until_listening(&mut mapper, port);
    mapper
}

/// Answers each question, which it is told the number of.
fn answering(port: u16, answer: impl Fn(&Query, u64) + Send + Sync + 'static) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let endpoint = format!("[\"tcp/127.0.0.1:{port}\"]");
    for (key, value) in [
        ("connect/endpoints", endpoint.as_str()),
        ("listen/endpoints", "[]"),
        ("scouting/multicast/enabled", "false"),
    ] {
        config
            .insert_json5(key, value)
            .expect("zenoh has the setting");
    }
    let session = zenoh::open(config).wait().expect("zenoh opens");
    let asked = AtomicU64::new(0);
    let callback = move |query: Query| answer(&query, asked.fetch_add(1, Ordering::Relaxed));
    let queryable = session.declare_queryable(KEY).callback(callback);
    queryable.background().wait().expect("it can be asked");
    session
}

fn reply(query: &Query, attachment: &str, payload: Vec<u8>) {
    let reply = query.reply(KEY, payload);
    // Who asked may have gone.
    let _ = match attachment.is_empty() {
        true => reply.wait(),
        false => reply.attachment(attachment.to_owned()).wait(),
    };
}

fn head(driver: u64, begin: &Value) -> String {
    json!({"driver": driver, "first": 0, "count": 1, "next": 1, "begin": begin}).to_string()
}

/// The link is there.
const LINK_UP: [u8; 9] = [1, 0, 0, 0, 0, 0, 0, 0, 0];

fn named(answer: impl Fn(&Query, u64) + Send + Sync + 'static, words: &str) {
    let port = free_port();
    let mut mapper = mapper(port);
    let _stranger = answering(port, answer);
    mapper.wait_for_text(words, LONG);
    mapper.terminate();
    mapper.wait_exit(LONG);
    let lines = mapper.stderr().lines().count();
    assert!(lines < 60, "{lines} lines\n{}", mapper.account());
}

#[test]
fn what_answers_and_is_no_driver_is_named_while_it_is_waited_for() {
    named(
        |query, _| reply(query, "", LINK_UP.to_vec()),
        "has no attachment",
    );
    named(
        |query, _| reply(query, "tape", LINK_UP.to_vec()),
        "no JSON object",
    );
    let cut = |query: &Query, _| reply(query, &head(1, &json!({})), LINK_UP[..3].to_vec());
    named(cut, "ends within record 0");
    let foreign = |query: &Query, _| reply(query, &head(1, &json!({"a": 1})), LINK_UP.to_vec());
    named(foreign, "which no driver of this version does");
    let words = |query: &Query, _| {
        let _ = query.reply_err("come back tomorrow").wait();
    };
    named(words, "refuses to: come back tomorrow");
}

#[test]
fn a_tape_that_flips_its_run_is_two_drivers_and_fills_no_log() {
    let port = free_port();
    // What a driver tells first, from one.
    let mut driver = Program::echosplat(&[
        "run",
        "--role",
        "driver",
        "--node",
        "rov",
        "--sonar",
        "sim://fence",
        "--zenoh",
        &format!("listen/endpoints=[\"tcp/127.0.0.1:{port}\"]"),
        "--zenoh",
        "connect/endpoints=[]",
    ]);
    wait_until_listening(&mut driver, port);
    let begin = begin_of(port);
    driver.terminate();
    driver.wait_exit(LONG);

    let port = free_port();
    let mut mapper = mapper(port);
    let flip = move |query: &Query, asked| {
        reply(query, &head(1 + asked % 2, &begin), LINK_UP.to_vec());
    };
    let _stranger = answering(port, flip);
    mapper.wait_for_text("two drivers answer under this node", LONG);
    // As long as it took to fill a log.
    std::thread::sleep(Duration::from_secs(4));
    let lines = mapper.stderr().lines().count();
    assert!(lines < 60, "{lines} lines\n{}", mapper.account());
    mapper.terminate();
    mapper.wait_exit(LONG);
}

/// What the driver that listens there tells in `begin`.
fn begin_of(port: u16) -> Value {
    let mut config = zenoh::Config::default();
    let endpoint = format!("[\"tcp/127.0.0.1:{port}\"]");
    for (key, value) in [
        ("connect/endpoints", endpoint.as_str()),
        ("listen/endpoints", "[]"),
        ("scouting/multicast/enabled", "false"),
    ] {
        config
            .insert_json5(key, value)
            .expect("zenoh has the setting");
    }
    let session = zenoh::open(config).wait().expect("zenoh opens");
    let began = std::time::Instant::now();
    loop {
        assert!(began.elapsed() < LONG, "no driver answers");
        let replies = session.get(KEY).wait().expect("it can be asked");
        let Ok(Some(answer)) = replies.recv_timeout(Duration::from_secs(2)) else {
            continue;
        };
        let Ok(sample) = answer.into_result() else {
            continue;
        };
        let attachment = sample.attachment().expect("a head").to_bytes().into_owned();
        let head: Value = serde_json::from_slice(&attachment).expect("JSON");
        return head["begin"].clone();
    }
}
