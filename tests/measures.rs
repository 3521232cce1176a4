//! Sizes asked for at the page, over HTTP and by clicks: they are those of the command `measure`.

use std::time::Duration;

use serde_json::{Value, json};

use crate::browser::{Browser, chromium, say};
use crate::harness::{Program, free_port};
use crate::web::serving;
use crate::web_client::ask;

const LONG: Duration = Duration::from_secs(120);

fn asked(port: u16, query: &str) -> (u16, Value) {
    let answer = ask(port, "GET", &format!("/measure?{query}"), &[]);
    let body = serde_json::from_slice(&answer.body).expect("answers are JSON");
    (answer.status, body)
}

/// What `measure` says of the same map.
fn told(map: &str, arguments: &[&str]) -> Value {
    let all = [&["measure", map][..], arguments, &["--json"]].concat();
    let mut program = Program::echosplat(&all);
    program.wait_exit_code(0, LONG);
    program.only_json()
}

/// Places of the map, well inside it.
fn places(map: &str) -> [String; 2] {
    let map = echosplat_recording::ply::read_map(map.as_ref()).expect("it was written");
    let all = map.gaussians.len();
    [all / 4, 3 * all / 4].map(|index| {
        let at = map.origin_m + map.gaussians[index].mean_m.as_dvec3();
        format!("{:.4},{:.4},{:.4}", at.x, at.y, at.z)
    })
}

#[test]
fn the_page_measures_as_the_command_does_and_refuses_what_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply").display().to_string();
    let port = free_port();
    let mut service = serving(port, "127.0.0.1", &["--map", &map]);
    service.wait_for_text("the page stays", LONG);
    let [a, b] = places(&map);
    for (query, arguments) in [
        (format!("distance={a},{b}"), vec!["--distance", &a, &b]),
        (format!("profile={a},{b}"), vec!["--profile", &a, &b]),
        (
            format!("section={a},{b}&within=0.5"),
            vec!["--section", &a, &b, "--within", "0.5"],
        ),
    ] {
        let (status, answer) = asked(port, &query);
        assert_eq!(status, 200, "{answer}");
        assert_eq!(answer["facts"], told(&map, &arguments), "{query}");
        assert!(
            answer["lines"]
                .as_array()
                .is_some_and(|lines| !lines.is_empty())
        );
    }
    // A plane and a pile are there or not; both say the same of it.
    for kind in ["plane", "pile"] {
        let (status, answer) = asked(port, &format!("{kind}={a}"));
        let option = format!("--{kind}");
        let mut program = Program::echosplat(&["measure", &map, &option, &a, "--json"]);
        let code = program.wait_exit(LONG).code();
        match status {
            200 => assert_eq!(answer["facts"], program.only_json()),
            _ => {
                let why = answer["error"].as_str().unwrap();
                assert_eq!((status, code), (422, Some(2)), "{}", program.account());
                assert!(
                    program.stderr().contains(why),
                    "{why} {}",
                    program.account()
                );
            }
        }
    }
    for (query, status, says) in [
        ("pile=1,2".to_owned(), 422, "X,Y,Z"),
        ("pile=1,2,inf".to_owned(), 422, "X,Y,Z"),
        (format!("pile={a}&within=99"), 422, "at most 5 m"),
        ("profile=0,0,0,999,0,0".to_owned(), 422, "200 m at most"),
        (
            "distance=900,900,0,1,1,1".to_owned(),
            422,
            "the map has nothing within",
        ),
        ("x".repeat(600), 414, "too long"),
    ] {
        let (found, answer) = asked(port, &query);
        assert_eq!(found, status, "{query}: {answer}");
        assert!(answer["error"].as_str().unwrap().contains(says), "{answer}");
    }
    let foreign = [("Origin", "http://evil.example")];
    let refused = ask(port, "GET", &format!("/measure?pile={a}"), &foreign);
    assert_eq!(refused.status, 403);
    let no_write = ask(
        port,
        "POST",
        &format!("/measure?pile={a}"),
        &[("Content-Length", "0")],
    );
    assert_eq!(no_write.status, 405);
    service.interrupt();
    service.wait_exit(LONG);
}

/// Two places of the picture, apart, at which a click meets the map: [[x, y], [x, y]], pixels.
const PLACES: &str = r#"(() => {
  const canvas = document.getElementById("view");
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const found = [];
  for (let i = 1; i < 40; i += 1) {
    for (let j = 1; j < 40; j += 1) {
      const [x, y] = [(width * i) / 40, (height * j) / 40];
      if (echosplat.picked(x, y)?.isConfident) found.push([x, y]);
    }
  }
  return [found[0], found.at(-1)];
})()"#;

fn click(browser: &mut Browser, at: &Value) {
    let [x, y] = [0, 1].map(|axis| at[axis].as_f64().expect("a number"));
    browser.evaluate(&format!(
        r#"(() => {{
  const canvas = document.getElementById("view");
  canvas.setPointerCapture = () => {{}};
  const box = canvas.getBoundingClientRect();
  for (const kind of ["pointerdown", "pointerup"]) canvas.dispatchEvent(new PointerEvent(kind, {{
    clientX: box.left + {x}, clientY: box.top + {y}, button: 0, isPrimary: true, pointerId: 1, bubbles: true }}));
}})()"#
    ));
}

#[test]
fn two_clicks_measure_and_are_drawn() {
    let Some(program) = chromium() else {
        return say("passed over: measures on the page, since no Chromium was found");
    };
    let folder = tempfile::tempdir().unwrap();
    let map = folder.path().join("map.ply").display().to_string();
    let port = free_port();
    let mut browser = Browser::start(&program);
    let mut service = serving(port, "127.0.0.1", &["--map", &map]);
    browser.size(1280, 800);
    browser.call(
        "Page.navigate",
        &json!({ "url": format!("http://127.0.0.1:{port}/") }),
    );
    browser.wait(
        "the final map",
        "echosplat.stats().isFinal && echosplat.lit().lit > 100",
    );
    service.wait_for_text("the page stays", LONG);
    browser.wait("a still camera", "echosplat.camera.goal === null");
    let places = browser.evaluate(PLACES);
    assert!(places[1].is_array(), "{places}");

    browser.evaluate("document.dispatchEvent(new KeyboardEvent('keydown', { key: 'm', bubbles: true })), document.body.dispatchEvent(new KeyboardEvent('keydown', { key: 'm', bubbles: true }))");
    browser.wait("the mode", "document.body.classList.contains('measures')");
    // Beside the map nothing is taken, and it is said.
    click(&mut browser, &json!([2, 2]));
    browser.wait(
        "the words",
        "document.getElementById('measure-says').textContent.includes('click on a Gaussian')",
    );
    click(&mut browser, &places[0]);
    click(&mut browser, &places[1]);
    browser.wait("a measure", "echosplat.measured().length === 1");
    let found = browser.evaluate("echosplat.measured()[0]");
    let place = |name: &str| {
        let at = &found["facts"][name];
        let numbers = [0, 1, 2].map(|axis| at[axis].as_f64().unwrap().to_string());
        numbers.join(",")
    };
    let wanted = told(&map, &["--distance", &place("from_m"), &place("to_m")]);
    assert_eq!(found["facts"], wanted);
    let shown = browser.evaluate("document.getElementById('measures').innerText");
    assert!(shown.as_str().unwrap().contains("higher by"), "{shown}");
    assert_eq!(
        browser.evaluate("echosplat.scene.measured.count"),
        7,
        "two crosses and a line"
    );

    // A profile has its chart, and what is forgotten is not drawn.
    browser.evaluate("(() => { const kind = document.getElementById('measure-kind'); kind.value = 'profile'; kind.dispatchEvent(new Event('change')); })()");
    click(&mut browser, &places[0]);
    click(&mut browser, &places[1]);
    browser.wait(
        "a profile",
        "document.querySelectorAll('#measures svg circle').length > 3",
    );
    browser.evaluate(
        "for (const away of [...document.querySelectorAll('#measures button')]) away.click()",
    );
    browser.wait("nothing", "echosplat.measured().length === 0 && (echosplat.draw(performance.now()), echosplat.scene.measured.count === 0)");
    service.interrupt();
    service.wait_exit(LONG);
}
