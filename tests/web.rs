//! The page over real sockets: what it serves, what it refuses, and that a browser ends with the map of
//! the service.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use echosplat_bus::point_cloud;
use echosplat_model::{Gaussian, Standing};
use echosplat_recording::ply;
use serde_json::Value;

use crate::dive::replay;
use crate::harness::{Program, free_port, wait_until_listening};
use crate::web_client::{Message, WebSocket, ask, raw_and_end};

const LONG: Duration = Duration::from_secs(120);

/// A replay with a page; it goes on until it is interrupted.
pub(crate) fn serving(port: u16, host: &str, more: &[&str]) -> Program {
    let address = format!("{host}:{port}");
    let own = ["--web", &address, "--json"];
    let mut service = Program::echosplat(&replay(&[&own[..], more].concat()));
    wait_until_listening(&mut service, port);
    service
}

/// The map as a browser puts it together.
#[derive(Default)]
struct Follower {
    tiles: BTreeMap<String, BTreeMap<u32, Gaussian>>,
    sequence: Option<u64>,
    is_in_delta: bool,
    is_final: bool,
    deltas: u64,
    kinds: Vec<String>,
    pings: u64,
}

impl Follower {
    fn follow(&mut self, socket: &mut WebSocket) {
        let began = Instant::now();
        while !self.is_final && began.elapsed() < LONG {
            match socket.next(LONG) {
                Some(Message::Binary(bytes)) => self.binary(&bytes),
                Some(Message::Text(text)) => self.text(&text),
                other => panic!("{other:?} before the final map"),
            }
        }
        assert!(self.is_final, "no final map");
    }

    fn text(&mut self, text: &str) {
        let message: Value = serde_json::from_str(text).expect("texts are JSON");
        self.kinds.push(
            message["kind"]
                .as_str()
                .expect("texts have a kind")
                .to_owned(),
        );
    }

    fn binary(&mut self, bytes: &[u8]) {
        let length = u32::from_le_bytes(bytes[4..8].try_into().expect("four bytes")) as usize;
        let header: Value =
            serde_json::from_slice(&bytes[16..16 + length]).expect("headers are JSON");
        let payload = &bytes[16 + length..];
        match bytes[0] {
            1 => self.delta(&header, payload),
            2 => self.snapshot(&header, payload),
            3 => {
                self.pings += 1;
                let bins = payload.len();
                assert!(bins == 600 && header["range_length_m"].as_f64() > Some(0.0));
            }
            kind => panic!("a message of kind {kind}"),
        }
    }

    fn delta(&mut self, header: &Value, payload: &[u8]) {
        let sequence = number(header, "sequence");
        let before = self.sequence.expect("a snapshot comes first");
        let continues = self.is_in_delta && sequence == before;
        if sequence <= before && !continues {
            return;
        }
        assert!(
            continues || sequence == before + 1,
            "{before} to {sequence}"
        );
        self.is_in_delta = number(header, "chunk") + 1 < number(header, "chunks");
        self.deltas += 1;
        let removed = header["removed"].as_array().expect("ids");
        let tile = self.tile(header);
        for id in removed {
            tile.remove(&(id.as_u64().expect("an id") as u32));
        }
        self.put(header, payload);
    }

    fn snapshot(&mut self, header: &Value, payload: &[u8]) {
        if header["part"] == 0 {
            self.tiles.clear();
        }
        self.is_in_delta = false;
        self.put(header, payload);
        // Each part bears the mark; the last makes the map whole.
        let part = number(header, "part");
        self.is_final &= part + 1 == number(header, "parts");
    }

    fn tile(&mut self, header: &Value) -> &mut BTreeMap<u32, Gaussian> {
        let name = header["tile"].as_str().expect("a tile").to_owned();
        self.tiles.entry(name).or_default()
    }

    fn put(&mut self, header: &Value, payload: &[u8]) {
        let cloud = point_cloud::decode(payload).expect("a cloud");
        assert_eq!(cloud.unsound, []);
        let tile = self.tile(header);
        tile.extend(cloud.gaussians.into_iter().map(|g| (g.id, g)));
        self.sequence = header["sequence"].as_u64();
        self.is_final = header["final"] == true && !self.is_in_delta;
    }

    /// Place, sigma and strength, which a PLY keeps to the bit, of one half of the map.
    fn half(&self, standing: Standing) -> Vec<[u32; 5]> {
        let all = self.tiles.values().flat_map(BTreeMap::values);
        bits(all.filter(|g| g.standing == standing))
    }
}

fn number(header: &Value, name: &str) -> u64 {
    header[name].as_u64().expect("a whole number")
}

fn bits<'a>(gaussians: impl Iterator<Item = &'a Gaussian>) -> Vec<[u32; 5]> {
    let of = |g: &Gaussian| {
        let m = g.mean_m;
        [m.x, m.y, m.z, g.sigma_m, g.reflectivity].map(f32::to_bits)
    };
    let mut all: Vec<_> = gaussians.map(of).collect();
    all.sort_unstable();
    all
}

fn downloaded(port: u16, path: &str) -> Vec<[u32; 5]> {
    let answer = ask(port, "GET", path, &[]);
    assert_eq!(answer.status, 200, "{}", answer.text());
    let map = ply::read(&answer.body[..]).expect("a map");
    bits(map.gaussians.iter())
}

#[test]
fn browsers_early_late_and_beside_a_stalled_one_end_with_the_map_of_the_service() {
    let port = free_port();
    let mut service = serving(port, "127.0.0.1", &["--rate", "4"]);
    let page = ask(port, "GET", "/", &[]);
    assert_eq!(page.status, 200);
    assert!(page.text().contains("<canvas id=\"view\""));
    assert!(page.head.contains("default-src 'self'"), "{}", page.head);
    // One browser that never reads, from the beginning to the end.
    let _stalled = WebSocket::open(port, "/live", &[]).unwrap();
    let mut early = Follower::default();
    early.follow(&mut WebSocket::open(port, "/live", &[]).unwrap());
    let mut late = Follower::default();
    late.follow(&mut WebSocket::open(port, "/live", &[]).unwrap());

    assert_eq!(early.kinds.first().map(String::as_str), Some("hello"));
    assert!(early.kinds.iter().any(|kind| kind == "status"));
    assert!(early.kinds.iter().any(|kind| kind == "pose"));
    assert!(
        early.deltas > 10 && early.pings > 100,
        "{} {}",
        early.deltas,
        early.pings
    );
    let halves = [
        (Standing::Confident, "/map.ply"),
        (Standing::Ambiguous, "/map.ambiguous.ply"),
    ];
    for (standing, path) in halves {
        let expected = downloaded(port, path);
        assert!(!expected.is_empty());
        for (who, follower) in [("early", &early), ("late", &late)] {
            let found = follower.half(standing);
            let (ours, theirs) = (expected.len(), found.len());
            assert!(found == expected, "{who}, {standing:?}: {theirs} of {ours}");
        }
    }
    service.wait_for("the summary", LONG, |service| {
        service.stdout().contains("pings_mapped").then_some(())
    });
    service.interrupt();
    service.wait_exit_code(0, LONG);
    assert_eq!(service.only_json()["pings_mapped"], crate::dive::PING_COUNT);
}

#[test]
fn what_changes_anything_is_refused_to_strangers() {
    let folder = tempfile::tempdir().unwrap();
    let records = folder.path().display().to_string();
    let port = free_port();
    let record = ["--rate", "1", "--record", &records];
    let mut service = serving(port, "0.0.0.0", &record);
    service.wait_for_text("#token=", LONG);
    let log = service.stderr();
    let token = log.split("#token=").nth(1).unwrap();
    let token: String = token.chars().take_while(char::is_ascii_hexdigit).collect();
    let own = format!("http://127.0.0.1:{port}");
    let post = |path: &str, headers: &[(&str, &str)]| ask(port, "POST", path, headers).status;

    for path in [
        "/recording/stop",
        "/recording/start",
        "/replay/pause",
        "/replay/resume",
    ] {
        assert_eq!(post(path, &[]), 401, "without a token");
        assert_eq!(post(path, &[("X-EchoSplat-Token", "0123456789")]), 401);
        let strange = [
            ("X-EchoSplat-Token", token.as_str()),
            ("Origin", "http://evil.example"),
        ];
        assert_eq!(post(path, &strange), 403, "of another origin");
        let strange = [
            ("X-EchoSplat-Token", token.as_str()),
            ("Host", "evil.example"),
        ];
        assert_eq!(post(path, &strange), 403, "by a name that is not ours");
        let large = [
            ("X-EchoSplat-Token", token.as_str()),
            ("Content-Length", "9000000000"),
        ];
        assert_eq!(post(path, &large), 413, "with a body");
        assert_eq!(ask(port, "GET", path, &[]).status, 405);
    }
    let refused = |origin: &str| WebSocket::open(port, "/live", &[("Origin", origin)]).err();
    assert_eq!(refused("http://evil.example"), Some(403));
    assert_eq!(refused(&own), None);

    let allowed = [
        ("X-EchoSplat-Token", token.as_str()),
        ("Origin", own.as_str()),
    ];
    assert_eq!(post("/recording/start", &allowed), 409, "one goes on");
    assert_eq!(post("/recording/stop", &allowed), 200);
    assert_eq!(post("/recording/start", &allowed), 200);
    assert_eq!(post("/recording/stop", &allowed), 200);
    let listed: Value = serde_json::from_slice(&ask(port, "GET", "/logs", &[]).body).unwrap();
    assert_eq!(listed["is_recording"], false);
    let logs = listed["logs"].as_array().unwrap();
    assert_eq!(logs.len(), 2, "{listed}");
    for log in logs {
        let name = log["name"].as_str().unwrap();
        let body = ask(port, "GET", &format!("/logs/{name}"), &[]).body;
        assert_eq!(body, std::fs::read(folder.path().join(name)).unwrap());
        assert!(body.starts_with(b"\x89MCAP"));
    }
    for strange in [
        "/logs/..",
        "/logs/.hidden",
        "/logs/%2e%2e%2fmap.ply",
        "/logs/none.mcap",
    ] {
        assert_eq!(ask(port, "GET", strange, &[]).status, 404, "{strange}");
    }
    service.interrupt();
    service.wait_exit(LONG);
}

#[test]
fn a_port_alone_means_loopback() {
    let port = free_port();
    let text = port.to_string();
    let mut service = Program::echosplat(&replay(&["--web", &text, "--rate", "0"]));
    wait_until_listening(&mut service, port);
    service.wait_for_text(&format!("http://127.0.0.1:{port}/"), LONG);
    let addresses = local_addresses();
    for address in &addresses {
        let reached = std::net::TcpStream::connect((address.as_str(), port));
        assert!(reached.is_err(), "{address} is no loopback");
    }
    let answer = ask(port, "GET", "/healthz", &[("Host", "evil.example")]);
    assert_eq!(answer.status, 403);
    service.interrupt();
    service.wait_exit(LONG);
}

/// Of other interfaces than loopback, as Linux lists them.
fn local_addresses() -> Vec<String> {
    let table = std::fs::read_to_string("/proc/net/fib_trie").unwrap_or_default();
    let lines: Vec<&str> = table.lines().collect();
    let hosts = lines
        .windows(2)
        .filter(|pair| pair[1].contains("host LOCAL"));
    let addresses = hosts.filter_map(|pair| pair[0].split("|-- ").nth(1));
    let mut all: Vec<String> = addresses
        .filter(|address| !address.starts_with("127."))
        .map(str::to_owned)
        .collect();
    all.dedup();
    all
}

#[test]
fn programs_can_ask_how_it_is() {
    let port = free_port();
    let mut service = serving(port, "127.0.0.1", &["--rate", "4"]);
    let began = Instant::now();
    while ask(port, "GET", "/healthz", &[]).status != 200 {
        assert!(began.elapsed() < LONG, "{}", service.account());
        std::thread::sleep(Duration::from_millis(50));
    }
    let has_begun = |metrics: &str| {
        let wanted = ["effort_evidence_ns_per_voxel_look ", "mapper_reasons_"];
        wanted.into_iter().all(|name| metrics.contains(name))
    };
    let mut metrics = ask(port, "GET", "/metrics", &[]).text();
    while !has_begun(&metrics) {
        assert!(began.elapsed() < LONG, "{metrics}");
        std::thread::sleep(Duration::from_millis(50));
        metrics = ask(port, "GET", "/metrics", &[]).text();
    }
    for name in [
        "echosplat_effort_detect_visits ",
        "echosplat_effort_detect_thread_s ",
        "echosplat_effort_evidence_voxel_looks ",
        "echosplat_mapper_reasons_",
        "echosplat_pings_received ",
        "echosplat_ledger_mapped ",
        "echosplat_link_state{is=\"",
        "echosplat_web_requests ",
    ] {
        assert!(metrics.contains(name), "{name} in {metrics}");
    }
    let about = ask(port, "GET", "/register_service", &[]).body;
    let about: Value = serde_json::from_slice(&about).unwrap();
    assert_eq!(about["name"], "EchoSplat");
    service.interrupt();
    service.wait_exit(LONG);
    // What was counted is all that was done, and no time is longer than the run.
    let told = service.only_json();
    let effort = &told["effort"];
    let of_mapper = || {
        let all = effort.as_object().unwrap().iter();
        all.filter(|(name, _)| !["calibrate", "frame_check"].contains(&&***name))
    };
    let sum = |what: &str| -> u64 {
        let counts = of_mapper().filter_map(|(_, took)| took[what].as_u64());
        counts.sum()
    };
    assert_eq!(
        Some(sum("voxel_looks")),
        told["mapper"]["voxel_looks"].as_u64()
    );
    let sampled = effort["begin"]["pairs"].as_u64().unwrap_or(0);
    assert_eq!(
        Some(sum("pairs") - sampled),
        told["pairs"].as_u64(),
        "{effort}"
    );
    let times = of_mapper().filter_map(|(_, took)| took["thread_s"].as_f64());
    let thread_s: f64 = times.sum();
    let wall_s = told["wall_s"].as_f64().unwrap();
    assert!(
        0.0 < thread_s && thread_s < wall_s,
        "{thread_s} of {wall_s} s"
    );
}

/// As xorshift64 has it.
fn next_random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

#[test]
fn a_thousand_mutated_requests_do_not_upset_it() {
    let port = free_port();
    let mut service = serving(port, "127.0.0.1", &["--rate", "1"]);
    let upgrade = format!(
        "GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n\x01\x05hello"
    );
    let host = format!("Host: 127.0.0.1:{port}\r\n");
    let plain = |line: &str, more: &str| {
        format!("{line} HTTP/1.1\r\n{host}{more}Connection: close\r\n\r\n")
    };
    let requests = [
        upgrade,
        plain("GET /", ""),
        plain("GET /logs/echosplat-1.mcap", "Range: bytes=0-1\r\n"),
        plain("POST /recording/stop", "Content-Length: 3\r\n"),
        plain("POST /recording/stop", "Transfer-Encoding: chunked\r\n"),
        plain("GET /metrics", "Accept: text/plain\r\n"),
    ];
    let mut random = 0x5eed_u64;
    for round in 0..1000 {
        let mut bytes = requests[round % requests.len()].clone().into_bytes();
        for _ in 0..=next_random(&mut random) % 4 {
            let at = next_random(&mut random) as usize % bytes.len();
            match next_random(&mut random) % 4 {
                0 => bytes[at] = next_random(&mut random) as u8,
                1 => bytes.truncate(at.max(1)),
                2 => bytes.insert(at, next_random(&mut random) as u8),
                _ => {
                    let copied = bytes[at..].to_vec();
                    bytes.extend(copied);
                }
            }
        }
        // What it answers to nonsense is its own choice.
        let _ = raw_and_end(port, &bytes);
    }
    let mut socket = WebSocket::open(port, "/live", &[]).unwrap();
    let noise: Vec<u8> = (0..5000).map(|_| next_random(&mut random) as u8).collect();
    socket.send_raw(&noise);
    let mut socket = WebSocket::open(port, "/live", &[]).unwrap();
    socket.send_text(&"x".repeat(100_000));

    assert_eq!(ask(port, "GET", "/", &[]).status, 200);
    assert!(
        !service.stderr().contains("panicked"),
        "{}",
        service.account()
    );
    service.interrupt();
    service.wait_exit_code(0, LONG);
}
