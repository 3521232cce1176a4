//! Behind the web server of `BlueOS`, and in Cockpit: the manifests as they are read there, the widget, and the page under
//! `/extensionv2/`. Without nginx (Debian's `nginx-light`) or Chromium what needs them is passed over, and says so.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde_json::{Map, Value, json};

use crate::browser::{Browser, chromium, say};
use crate::dive::replay;
use crate::harness::{Program, free_port, wait_until_listening};
use crate::web_client::ask;

const LONG: Duration = Duration::from_secs(120);
const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../blueos");
const TOKEN: &str = "a word of the owner";

fn nginx() -> Option<PathBuf> {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let folders: Vec<PathBuf> = std::env::split_paths(&folders).collect();
    let system = ["/usr/sbin", "/usr/local/sbin"].map(PathBuf::from);
    let all = folders.into_iter().chain(system);
    all.map(|folder| folder.join("nginx"))
        .find(|path| path.is_file())
}

/// A service whose owner lets Cockpit begin and end recordings, known to a proxy at this port.
fn serve(folder: &Path, port: u16, proxy: u16) -> Program {
    let config = folder.join("own.toml");
    let text = format!(
        "[web]\naddress = \"127.0.0.1:{port}\"\ntoken = \"{TOKEN}\"\ncockpit_actions = true\n\
         allowed_hosts = [\"127.0.0.1:{proxy}\"]\n"
    );
    std::fs::write(&config, text).expect("there is room");
    let records = folder.join("records").display().to_string();
    let config = config.display().to_string();
    let more = [
        "--config", &config, "--record", &records, "--rate", "1", "--json",
    ];
    let mut service = Program::echosplat(&replay(&more));
    wait_until_listening(&mut service, port);
    service
}

fn json_at(port: u16, path: &str) -> Value {
    let answer = ask(port, "GET", path, &[]);
    assert_eq!(answer.status, 200, "{path}");
    serde_json::from_slice(&answer.body).expect("it is JSON")
}

/// Every member is one of these and of this kind; those without `?` are there.
fn has_shape(value: &Value, shape: &[(&str, &str)]) {
    let members: &Map<String, Value> = value.as_object().expect("an object");
    for (name, member) in members {
        let known = shape
            .iter()
            .find(|(known, _)| known.trim_end_matches('?') == name);
        let (_, kind) = known.unwrap_or_else(|| panic!("{name} is not known there"));
        let is_it = match *kind {
            "string" => member.is_string(),
            "boolean" => member.is_boolean(),
            "number" => member.is_number(),
            "array" => member.is_array(),
            "strings" => member
                .as_object()
                .is_some_and(|all| all.values().all(Value::is_string)),
            _ => member.is_object(),
        };
        assert!(is_it, "{name} must be a {kind}: {member}");
    }
    for (name, _) in shape.iter().filter(|(name, _)| !name.ends_with('?')) {
        assert!(members.contains_key(*name), "{name} is missing");
    }
}

#[test]
fn manifests_are_what_blueos_cockpit_and_the_store_read() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let mut service = serve(folder.path(), port, 1);

    // `ServiceMetadata` of BlueOS 1.5 (core/services/helper/main.py).
    let about = json_at(port, "/register_service");
    has_shape(
        &about,
        &[
            ("name", "string"),
            ("description", "string"),
            ("icon", "string"),
            ("company", "string"),
            ("version", "string"),
            ("webpage", "string"),
            ("api", "string"),
            ("route?", "string"),
            ("new_page?", "boolean"),
            ("extra_query?", "string"),
            ("avoid_iframes?", "boolean"),
            ("sanitized_name?", "string"),
            ("works_in_relative_paths?", "boolean"),
            ("extras?", "strings"),
        ],
    );
    assert_eq!(about["works_in_relative_paths"], true);
    let name = about["name"].as_str().unwrap().to_lowercase();
    let sanitized: String = name.chars().filter(char::is_ascii_alphanumeric).collect();

    // `ExtrasJsonSchema` of Cockpit 1.19 (src/libs/blueos/schemas.ts).
    let path = about["extras"]["cockpit"].as_str().unwrap();
    let extras = json_at(port, path);
    has_shape(
        &extras,
        &[
            ("targetCockpitApiVersion", "string"),
            ("targetSystem", "string"),
            ("widgets", "array"),
            ("actions", "array"),
            ("joystickSuggestions?", "array"),
        ],
    );
    for widget in extras["widgets"].as_array().unwrap() {
        has_shape(
            widget,
            &[
                ("name", "string"),
                ("iframeUrl", "string"),
                ("iconUrl", "string"),
                ("collapsibleContainerName?", "string"),
                ("version?", "string"),
                ("startCollapsed?", "boolean"),
                ("useExtensionPathAsBaseUrl", "boolean"),
                ("contentZoom?", "number"),
                ("scaleContentWithWidget?", "boolean"),
            ],
        );
        for address in ["iframeUrl", "iconUrl"] {
            let path = widget[address].as_str().unwrap();
            assert_eq!(ask(port, "GET", path, &[]).status, 200, "{path}");
        }
    }
    let actions = extras["actions"].as_array().unwrap();
    assert_eq!(actions.len(), 2);
    for action in actions {
        has_shape(
            action,
            &[
                ("id", "string"),
                ("name", "string"),
                ("type", "string"),
                ("config", "object"),
                ("version?", "string"),
            ],
        );
        assert_eq!(action["type"], "http-request");
        has_shape(
            &action["config"],
            &[
                ("name", "string"),
                ("url", "string"),
                ("method", "string"),
                ("headers", "strings"),
                ("urlParams", "strings"),
                ("body", "string"),
            ],
        );
        let url = action["config"]["url"].as_str().unwrap();
        let start = format!("http://{{{{ vehicle-address }}}}/extensionv2/{sanitized}/recording/");
        assert!(url.starts_with(&start), "{url}");
        assert!(
            !action.to_string().contains(TOKEN),
            "the token is nobody's to read"
        );
    }
    service.interrupt();
    service.wait_exit(LONG);

    // `fetch_extensions_metadata` of the store (blueos_repository/consolidate.py).
    let file = std::fs::read_to_string(format!("{FOLDER}/metadata.json")).unwrap();
    let metadata: Value = serde_json::from_str(&file).unwrap();
    let strings = ["name", "website", "docker", "description"].map(|name| (name, "string"));
    has_shape(&metadata, &strings);
    assert_eq!(metadata["name"], about["name"]);
}

/// The web server of `BlueOS` as far as it concerns an extension (core/tools/nginx/nginx.conf and `setup_nginx_route`), and
/// another origin, where Cockpit is.
fn proxy(folder: &Path, program: &Path, [service, blueos, cockpit]: [u16; 3]) -> Program {
    let pages = folder.join("pages");
    std::fs::create_dir_all(&pages).expect("there is room");
    let frame = "<!doctype html><title>a ground station</title><body style=\"margin:0\"><iframe src=\"/extensionv2/echosplat/widget.html\" \
                 width=\"300\" height=\"200\" frameborder=\"0\"></iframe>";
    std::fs::write(pages.join("index.html"), frame).expect("there is room");
    let at = folder.display();
    let config = format!(
        "worker_processes 1;\npid {at}/nginx.pid;\nerror_log {at}/error.log;\nevents {{ worker_connections 64; }}\n\
         http {{\n access_log off;\n client_body_temp_path {at}/body;\n proxy_temp_path {at}/proxy;\n fastcgi_temp_path {at}/f;\n \
         uwsgi_temp_path {at}/u;\n scgi_temp_path {at}/s;\n types {{ text/html html; }}\n\
         server {{\n listen 127.0.0.1:{blueos};\n root {at}/pages;\n\
         proxy_hide_header Access-Control-Allow-Origin;\n add_header Access-Control-Allow-Origin * always;\n\
         location /extensionv2/echosplat/ {{\n proxy_pass http://127.0.0.1:{service}/;\n proxy_http_version 1.1;\n\
         proxy_set_header Upgrade $http_upgrade;\n proxy_set_header Connection \"Upgrade\";\n proxy_set_header Host $host;\n\
         proxy_set_header X-Real-IP $remote_addr;\n proxy_set_header X-Forwarded-For $proxy_add_x_forwarded_for;\n\
         proxy_set_header X-Forwarded-Proto $scheme;\n }}\n }}\n\
         server {{ listen 127.0.0.1:{cockpit}; root {at}/pages; }}\n}}\n"
    );
    let file = folder.join("nginx.conf");
    std::fs::write(&file, config).expect("there is room");
    let mut command = Command::new(program);
    command.arg("-p").arg(folder).arg("-c").arg(&file);
    command.args(["-g", "daemon off;"]);
    let mut proxy = Program::start(command);
    wait_until_listening(&mut proxy, blueos);
    proxy
}

/// In the frame of the widget.
fn inside(expression: &str) -> String {
    format!(
        "((window, document, echosplat) => {expression})(frames[0], frames[0].document, frames[0].echosplat)"
    )
}

#[test]
fn page_and_widget_work_behind_the_web_server_of_blueos() {
    let (Some(program), Some(nginx)) = (chromium(), nginx()) else {
        return say(
            "passed over: page and widget behind a proxy, since no Chromium or nginx was found",
        );
    };
    let folder = tempfile::tempdir().unwrap();
    let ports = [free_port(), free_port(), free_port()];
    let [port, blueos, cockpit] = ports;
    let mut browser = Browser::start(&program);
    let mut service = serve(folder.path(), port, blueos);
    let mut proxy = proxy(folder.path(), &nginx, ports);
    let go = |browser: &mut Browser, port: u16, path: &str| {
        let url = format!("http://127.0.0.1:{port}{path}");
        browser.call("Page.navigate", &json!({ "url": url }));
    };

    browser.size(640, 480);
    go(&mut browser, blueos, "/");
    browser.wait(
        "a map in the widget",
        &inside("echosplat.stats().gaussians > 200"),
    );
    let size = browser.evaluate(&inside(
        "[window.innerWidth, document.documentElement.scrollWidth, document.documentElement.scrollHeight, \
         document.getElementById('view').clientWidth, document.getElementById('view').clientHeight]",
    ));
    assert_eq!(size, json!([300, 300, 200, 300, 200]), "all of it is map");
    let drawn = browser.evaluate(&inside("echosplat.lit()"));
    let share = drawn["lit"].as_f64().unwrap() / drawn["total"].as_f64().unwrap();
    assert!((0.01..0.9).contains(&share), "{drawn}");
    let frame = "['figures', 'panels', 'legend'].every((id) => document.getElementById(id).offsetHeight === 0)";
    assert_eq!(browser.evaluate(&inside(frame)), true);
    let buttons = "[...document.querySelectorAll('#views button')].every((one) => one.getBoundingClientRect().right <= 300)";
    assert_eq!(browser.evaluate(&inside(buttons)), true);

    // The whole page, as BlueOS names it: without a slash at the end.
    browser.size(1280, 800);
    go(&mut browser, blueos, "/extensionv2/echosplat");
    browser.wait("the page", "echosplat.stats().gaussians > 200");
    assert_eq!(
        browser.evaluate("location.pathname"),
        "/extensionv2/echosplat/"
    );
    let own = "fetch('measure?pile=1,2').then((answer) => answer.status)";
    assert_eq!(
        browser.evaluate(own),
        422,
        "what is asked for reaches the service"
    );

    // Cockpit is a page of another origin: with the token it ends and begins a recording, without it nothing.
    go(&mut browser, cockpit, "/");
    browser.wait("Cockpit", "document.title === 'a ground station'");
    let act = |act: &str, token: &str| {
        format!(
            "fetch('http://127.0.0.1:{blueos}/extensionv2/echosplat/{act}', {{ method: 'POST', body: '', \
             headers: {{ 'X-EchoSplat-Token': '{token}' }} }}).then((answer) => answer.status, () => 'refused by the browser')"
        )
    };
    assert_eq!(
        browser.evaluate(&act("recording/stop", "another word")),
        403
    );
    assert_eq!(browser.evaluate(&act("recording/stop", TOKEN)), 200);
    assert_eq!(browser.evaluate(&act("recording/start", TOKEN)), 200);
    assert_eq!(
        browser.evaluate(&act("replay/pause", TOKEN)),
        "refused by the browser"
    );
    service.interrupt();
    service.wait_exit(LONG);
    proxy.terminate();
    proxy.wait_exit(LONG);
}
