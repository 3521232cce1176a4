//! The page in a headless Chromium, driven over its `DevTools` protocol. Without Chromium (`chromium`,
//! `chromium-browser`, `google-chrome` or what `ECHOSPLAT_CHROMIUM` names) it is passed over, and says so.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::dive::replay;
use crate::harness::{Program, free_port, wait_until_listening};
use crate::web_client::{Message, WebSocket};

const LONG: Duration = Duration::from_secs(120);

/// Written past the capture of test output.
pub(crate) fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

pub(crate) fn chromium() -> Option<PathBuf> {
    let named = std::env::var_os("ECHOSPLAT_CHROMIUM").map(PathBuf::from);
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<PathBuf> = std::env::split_paths(&folders).collect();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let found = names
        .iter()
        .flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    named.into_iter().chain(found).find(|path| path.is_file())
}

/// A browser with one page.
pub(crate) struct Browser {
    socket: WebSocket,
    number: u64,
    _program: Program,
    _profile: tempfile::TempDir,
}

impl Browser {
    pub(crate) fn start(program: &Path) -> Self {
        let profile = tempfile::tempdir().expect("there is room");
        let mut command = Command::new(program);
        command.args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--remote-debugging-port=0",
        ]);
        command.arg(format!("--user-data-dir={}", profile.path().display()));
        command.arg("about:blank");
        let mut program = Program::start(command);
        let file = profile.path().join("DevToolsActivePort");
        let port: u16 = program.wait_for("DevTools", LONG, |_| {
            let text = std::fs::read_to_string(&file).ok()?;
            text.split_once('\n')?.0.parse().ok()
        });
        let target = program.wait_for("a page", LONG, |_| {
            let list = crate::web_client::ask(port, "GET", "/json", &[]);
            let list: Value = serde_json::from_slice(&list.body).ok()?;
            let page = list.as_array()?.iter().find(|t| t["type"] == "page")?;
            let url = page["webSocketDebuggerUrl"].as_str()?;
            Some(url[url.find("/devtools")?..].to_owned())
        });
        let socket = WebSocket::open(port, &target, &[]).expect("DevTools answers");
        Self {
            socket,
            number: 0,
            _program: program,
            _profile: profile,
        }
    }

    pub(crate) fn call(&mut self, method: &str, parameters: &Value) -> Value {
        self.number += 1;
        let call = json!({ "id": self.number, "method": method, "params": parameters });
        self.socket.send_text(&call.to_string());
        loop {
            match self.socket.next(LONG) {
                Some(Message::Text(text)) => {
                    let answer: Value = serde_json::from_str(&text).expect("DevTools speaks JSON");
                    if answer["id"] == self.number {
                        return answer["result"].clone();
                    }
                }
                other => panic!("{method}: {other:?}"),
            }
        }
    }

    pub(crate) fn size(&mut self, width: u32, height: u32) {
        let size = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600});
        self.call("Emulation.setDeviceMetricsOverride", &size);
    }

    pub(crate) fn evaluate(&mut self, expression: &str) -> Value {
        let asked = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let answer = self.call("Runtime.evaluate", &asked);
        let thrown = &answer["exceptionDetails"];
        assert!(thrown.is_null(), "{expression}: {thrown}");
        answer["result"]["value"].clone()
    }

    /// Until the expression is true.
    pub(crate) fn wait(&mut self, what: &str, expression: &str) {
        let began = Instant::now();
        // Before the page is loaded nothing of it is there.
        let guarded =
            format!("(() => {{ try {{ return {expression}; }} catch {{ return false; }} }})()");
        while self.evaluate(&guarded) != true {
            let seen = self.evaluate("window.echosplat ? echosplat.stats() : document.title + document.body?.innerText.slice(0, 300)");
            assert!(began.elapsed() < LONG, "{what}: {seen}");
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

pub(crate) fn serve(port: u16, rate: &str) -> Program {
    let address = format!("127.0.0.1:{port}");
    let mut service = Program::echosplat(&replay(&["--web", &address, "--rate", rate, "--json"]));
    wait_until_listening(&mut service, port);
    service
}

/// A sphere of 1 m, 10 m before the eye, and nothing else.
const ONE_SPHERE: &str = r#"(async () => {
  const e = echosplat;
  const points = new Float32Array(16);
  points.set([0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 0, 0, 0, 0.5, 0.1, 0]);
  new Uint32Array(points.buffer)[15] = 1;
  const { Tile } = await import("./map.js");
  const tile = new Tile("0_0_0");
  tile.put(1, points, 0, 0);
  e.past.keep = () => {};
  e.state.at = 1e9;
  e.past.moments = [{ diveS: 0, tiles: [tile], originM: [0, 0, 0] }];
  e.past.poses = [];
  e.state.pose = null;
  e.state.hasFitted = true;
  e.state.extent = 1;
  e.renderer.scale = 1;
  for (const name of ["track", "fan", "grid"]) e.state.shows[name] = false;
  Object.assign(e.camera, { targetM: [0, 0, 0], yaw: 0.4, pitch: 0.3, distanceM: 10, goal: null });
  const { lit } = e.lit();
  const view = e.camera.view(e.renderer.canvas.clientWidth, e.renderer.canvas.clientHeight);
  const radius = Math.tan(Math.asin(1 / 10)) / view.tanY * e.renderer.canvas.height / 2;
  return lit / (Math.PI * radius * radius);
})()"#;

/// Two Gaussians behind one another, and what clicks on them and beside them tell: [on them, beside them].
const CLICKS: &str = r#"(async () => {
  const e = echosplat;
  const { Tile } = await import("./map.js");
  const tile = new Tile("0_0_0");
  const point = (x, confident) => {
    const floats = new Float32Array([x, 0, 0, 0, 0, 1, 0.1, 0.1, 0.1, 1, 0, 0, 0, 0.5, 0.25, 0]);
    new Uint32Array(floats.buffer)[15] = confident;
    return floats;
  };
  tile.put(1, point(9, 1), 0, 0);
  tile.put(2, point(-1, 1), 0, 0, [2, 12, 40]);
  tile.put(3, point(1, 0), 0, 0, [6, 3, 7]);
  tile.remove(1);
  e.past.moments = [{ diveS: 0, tiles: [tile], originM: [100, 0, -2] }];
  Object.assign(e.camera, { targetM: [0, 0, 0], yaw: 0, pitch: 0, distanceM: 10, goal: null });
  const canvas = document.getElementById("view");
  const click = (x, y, toX = x) => {
    const box = canvas.getBoundingClientRect();
    for (const [kind, at] of [["pointerdown", x], ["pointerup", toX]]) {
      canvas.dispatchEvent(new PointerEvent(kind, { clientX: box.left + at, clientY: box.top + y, button: 0, isPrimary: true, pointerId: 1, bubbles: true }));
    }
    const told = document.getElementById("picked");
    return told.hidden ? "nothing" : told.innerText;
  };
  canvas.setPointerCapture = () => {};
  const [x, y] = [canvas.clientWidth / 2, canvas.clientHeight / 2];
  const beside = click(x + 200, y);
  const dragged = click(x, y, x + 40);
  const front = click(x, y);
  e.state.shows.ambiguous = false;
  return { beside, dragged, front, behind: click(x, y) };
})()"#;

/// So many Gaussians of 2 cm over a quay of 60 by 12 m; then pictures while the camera turns.
const MANY: &str = r#"(async () => {
  const e = echosplat;
  const { Tile } = await import("./map.js");
  const tiles = new Map();
  const points = new Float32Array(16);
  const words = new Uint32Array(points.buffer);
  for (let i = 0; i < 200000; i += 1) {
    const [u, v] = [(i % 1000) * 0.06, Math.floor(i / 1000) * 0.06];
    points.set([u, 0.4 * Math.sin(u), v, 0, 0, 0.9, 0.03, 0.02, 0.03, 1, 0, 0, 0, 0.5, 0.05, 0]);
    words[15] = 1;
    const name = [points[0], points[1], points[2]].map((x) => Math.floor(x / 4)).join("_");
    if (!tiles.has(name)) tiles.set(name, new Tile(name));
    tiles.get(name).put(i, points, 0, 0);
  }
  e.past.keep = () => {};
  e.state.at = 1e9;
  e.past.moments = [{ diveS: 0, tiles: [...tiles.values()], originM: [0, 0, 0] }];
  Object.assign(e.state, { hasFitted: true, extent: 1.6, measures: true, summaryAt: 0, summary: null });
  Object.assign(e.camera, { targetM: [30, 0, 6], yaw: -1.6, pitch: 0.2, distanceM: 50, goal: null });
  const turn = async (seconds) => {
    const began = performance.now();
    let frames = 0;
    while (performance.now() - began < seconds * 1000) {
      e.camera.orbit(2, 0);
      await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
      frames += 1;
    }
    return frames / (performance.now() - began) * 1000;
  };
  await turn(4);
  const rate = await turn(4);
  const moving = { drawn: e.renderer.drawn, scale: e.renderer.scale, rate };
  e.renderer.scale = 1;
  e.lit();
  const began = performance.now();
  e.lit();
  const stillMs = performance.now() - began;
  return { moving, drawn: e.renderer.drawn, stillMs, card: e.renderer.name() };
})()"#;

#[test]
fn the_page_draws_and_follows_in_a_browser() {
    let Some(program) = chromium() else {
        return say("passed over: the page in a browser, since no Chromium was found");
    };
    let port = free_port();
    let mut browser = Browser::start(&program);
    let mut service = serve(port, "1");
    browser.size(1280, 800);
    let url = json!({ "url": format!("http://127.0.0.1:{port}/") });
    browser.call("Page.navigate", &url);

    browser.wait("a map", "echosplat.stats().gaussians > 200");
    browser.wait(
        "more of it",
        "echosplat.stats().updates > 30 && echosplat.pings.list.length > 100",
    );
    let told = browser.evaluate("document.getElementById('status').textContent");
    let told = told.as_str().unwrap();
    assert!(
        told.contains("Log read") && !told.contains("Settings confirmed"),
        "a log is asked for nothing: {told}"
    );
    let drawn = browser.evaluate("echosplat.lit()");
    let share = drawn["lit"].as_f64().unwrap() / drawn["total"].as_f64().unwrap();
    assert!((0.005..0.9).contains(&share), "{drawn}");
    browser.wait("the final map", "echosplat.stats().isFinal");
    let stats = browser.evaluate("echosplat.stats()");
    say(&format!("the page in a browser: {stats}"));

    // That nothing is wrong is said only where nothing was.
    let told = |notices: &str| {
        let status = format!("{{ notices: [{notices}], link: {{}} }}");
        format!("import('./notices.js').then(({{ told }}) => told({status}).above)")
    };
    let was = r#"{ sentence: "too fast", is_loss: false, since_s: 1, until_s: 9, count: 2 }"#;
    let stands = r#"{ sentence: "too fast", is_loss: false, since_s: 1, until_s: null, count: 1 }"#;
    assert_eq!(browser.evaluate(&told("")), "✓ nothing is wrong");
    assert_eq!(browser.evaluate(&told(stands)), "");
    let again = browser.evaluate(&told(was));
    assert_eq!(again, "✓ all is well again; earlier in this run:");

    // It says that the service is gone, and comes back with it.
    service.interrupt();
    service.wait_exit(LONG);
    browser.wait("the notice", "!document.getElementById('lost').hidden");
    let mut service = serve(port, "1");
    browser.wait("the way back", "document.getElementById('lost').hidden");
    browser.wait(
        "the new map",
        &format!("echosplat.stats().epoch !== {}", stats["epoch"]),
    );

    browser.size(390, 844);
    browser.wait("a narrow page", "innerWidth === 390");
    let fits = "document.documentElement.scrollWidth <= 390 \
                && document.getElementById('view').clientHeight > 400";
    assert_eq!(browser.evaluate(fits), true);
    browser.evaluate("document.getElementById('panels-toggle').click()");
    browser.wait(
        "panels",
        "document.getElementById('panels').getBoundingClientRect().top < 600",
    );

    browser.size(1000, 700);
    let area = browser.evaluate(ONE_SPHERE).as_f64().unwrap();
    assert!(
        (area - 1.0).abs() < 0.03,
        "a sphere covers {area} of its disc"
    );
    let clicks = browser.evaluate(CLICKS);
    assert_eq!(
        (&clicks["beside"], &clicks["dragged"]),
        (&json!("nothing"), &json!("nothing"))
    );
    let front = clicks["front"].as_str().unwrap();
    assert!(
        front.starts_with("Ambiguous at 101.00, 0.00, −2.00 m, sigma 0.25 m"),
        "{front}"
    );
    assert!(
        front.contains("only 3 observations are clear") && front.contains("only 7 nats"),
        "{front}"
    );
    let behind = clicks["behind"].as_str().unwrap();
    assert!(
        behind.starts_with("Confident at 99.00") && behind.contains("12, 40 % of all"),
        "{behind}"
    );
    browser.evaluate("echosplat.state.shows.ambiguous = true");
    let many = browser.evaluate(MANY);
    say(&format!("200,000 Gaussians: {many}"));
    assert_eq!(many["drawn"], 200_000);
    service.interrupt();
    service.wait_exit(LONG);
}
