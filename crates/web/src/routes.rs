//! Which request is answered by what.

use std::sync::Arc;

use axum::Router;
use axum::extract::{Path, RawQuery, Request, State, WebSocketUpgrade};
use axum::http::header::{
    ACCESS_CONTROL_ALLOW_HEADERS, ACCESS_CONTROL_ALLOW_METHODS, ACCESS_CONTROL_ALLOW_ORIGIN,
    CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_SECURITY_POLICY, CONTENT_TYPE, REFERRER_POLICY,
    VARY, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use serde_json::{Value, json};
use tokio::sync::Semaphore;

use crate::access::{Access, Refusal};
use crate::control::{Control, MapPart};
use crate::hub::{Busy, count, lock};
use crate::socket::{self, MAX_RECEIVED_BYTES, Source};
use crate::{assets, cockpit, download, metrics};

/// Browsers that may follow the map at once.
const MAX_WATCHERS: usize = 16;
/// Downloads at once; each copies the map or reads a disk.
const MAX_DOWNLOADS: usize = 2;
/// A service that did not report for so long is not well.
const STATUS_LIMIT_S: f64 = 5.0;
/// Measures at once; each copies the map's places and takes a processor.
const MAX_MEASURES: usize = 1;
/// Longest question of a measure that is read.
const MAX_QUERY_BYTES: usize = 512;
/// Longest name of a log that is looked for.
const MAX_NAME_BYTES: usize = 255;

/// What every answer needs.
#[derive(Clone)]
pub(crate) struct App(Arc<Inner>);

struct Inner {
    access: Access,
    source: Arc<Source>,
    control: Arc<dyn Control>,
    switching: Arc<Busy>,
    downloads: Arc<Semaphore>,
    measures: Arc<Semaphore>,
}

impl App {
    pub(crate) fn new(access: Access, source: Arc<Source>, control: Arc<dyn Control>) -> Self {
        Self(Arc::new(Inner {
            access,
            source,
            control,
            switching: Arc::default(),
            downloads: Arc::new(Semaphore::new(MAX_DOWNLOADS)),
            measures: Arc::new(Semaphore::new(MAX_MEASURES)),
        }))
    }
}

pub(crate) fn router(app: App) -> Router {
    Router::new()
        .route("/", get(|| file(Path("index.html".to_owned()))))
        .route("/{name}", get(file))
        .route("/live", get(live))
        .route("/map.ply", get(map))
        .route("/map.ambiguous.ply", get(ambiguous_map))
        .route("/measure", get(measure))
        .route("/logs", get(logs))
        .route("/logs/{name}", get(log))
        .route("/recording/start", post(start_recording))
        .route("/recording/stop", post(stop_recording))
        .route("/replay/pause", post(pause_replay))
        .route("/replay/resume", post(resume_replay))
        .route("/metrics", get(prometheus))
        .route("/healthz", get(health))
        .route("/register_service", get(register_service))
        .route(cockpit::PATH, get(cockpit_extras))
        .fallback(|| async { refusal(StatusCode::NOT_FOUND, "there is nothing here") })
        .layer(from_fn_with_state(app.clone(), guard))
        .with_state(app)
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        refusal(self.status, self.sentence)
    }
}

fn refusal(status: StatusCode, sentence: &str) -> Response {
    let mut response = answer(&json!({ "error": sentence }));
    *response.status_mut() = status;
    response
}

fn answer(value: &Value) -> Response {
    ([(CONTENT_TYPE, "application/json")], value.to_string()).into_response()
}

/// Every request passes here, whatever it asks for.
async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let counters = &app.0.source.hub.counters;
    count(&counters.requests, 1);
    let checked = check(&app.0.access, &request);
    let other_page = app.0.access.page_with_token(&request);
    let mut response = match checked {
        Ok(()) if request.method() == Method::OPTIONS => preflight(),
        Ok(()) => next.run(request).await,
        Err(refusal) => {
            count(&counters.refused, 1);
            refusal.into_response()
        }
    };
    let headers = response.headers_mut();
    let always = [
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (REFERRER_POLICY, "no-referrer"),
        (
            CONTENT_SECURITY_POLICY,
            "default-src 'self'; img-src 'self' data: blob:; base-uri 'none'; form-action 'none'",
        ),
    ];
    for (name, value) in always {
        headers.insert(name, HeaderValue::from_static(value));
    }
    // Whose page it is, so that its browser lets it read the answer.
    if let Some(origin) = other_page {
        headers.insert(ACCESS_CONTROL_ALLOW_ORIGIN, origin);
        headers.insert(VARY, HeaderValue::from_static("origin"));
    }
    if !headers.contains_key(CACHE_CONTROL) {
        headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    }
    response
}

fn check(access: &Access, request: &Request) -> Result<(), Refusal> {
    let headers = request.headers();
    access.host(headers)?;
    let reads = matches!(request.method().as_str(), "GET" | "HEAD");
    // What takes work is asked for by this page alone.
    let takes_work = ["/live", "/measure"].contains(&request.uri().path());
    if reads && !takes_work {
        return Ok(());
    }
    if access.lets_ask(request) {
        return Ok(());
    }
    if access.page_with_token(request).is_none() {
        access.origin(headers)?;
    }
    if reads {
        return Ok(());
    }
    access.token(headers)?;
    // No request of ours has a body, so none is read.
    let is_empty = headers.get("content-length").is_none_or(|len| len == "0");
    match is_empty && !headers.contains_key("transfer-encoding") {
        true => Ok(()),
        false => Err(Refusal {
            status: StatusCode::PAYLOAD_TOO_LARGE,
            sentence: "requests here have no body",
        }),
    }
}

/// What a browser asks before a page of another origin may send the token.
fn preflight() -> Response {
    let headers = [
        (ACCESS_CONTROL_ALLOW_METHODS, "POST"),
        (
            ACCESS_CONTROL_ALLOW_HEADERS,
            "x-echosplat-token, content-type",
        ),
    ];
    (StatusCode::NO_CONTENT, headers).into_response()
}

async fn file(Path(name): Path<String>) -> Response {
    assets::file(&name).unwrap_or_else(|| refusal(StatusCode::NOT_FOUND, "there is nothing here"))
}

async fn live(State(app): State<App>, upgrade: WebSocketUpgrade) -> Response {
    let source = Arc::clone(&app.0.source);
    if source.hub.watcher_count() >= MAX_WATCHERS {
        return refusal(
            StatusCode::SERVICE_UNAVAILABLE,
            "16 pages are open already: close one",
        );
    }
    upgrade
        .max_message_size(MAX_RECEIVED_BYTES)
        .max_frame_size(MAX_RECEIVED_BYTES)
        .on_upgrade(|socket| socket::serve(socket, source))
}

async fn map(State(app): State<App>) -> Response {
    send_map(&app, MapPart::Confident, "map.ply")
}

async fn ambiguous_map(State(app): State<App>) -> Response {
    send_map(&app, MapPart::Ambiguous, "map.ambiguous.ply")
}

fn send_map(app: &App, part: MapPart, name: &str) -> Response {
    let Some(map) = lock(&app.0.source.hub.orders).newest.clone() else {
        return refusal(StatusCode::NOT_FOUND, "there is no map yet");
    };
    let Ok(permit) = Arc::clone(&app.0.downloads).try_acquire_owned() else {
        return too_many();
    };
    let control = Arc::clone(&app.0.control);
    let body = download::body(permit, move |to| control.write_map(&map, part, to));
    (attachment(name), body).into_response()
}

/// A size in the map as it stands.
async fn measure(State(app): State<App>, RawQuery(query): RawQuery) -> Response {
    let query = query.unwrap_or_default();
    if query.len() > MAX_QUERY_BYTES {
        return refusal(StatusCode::URI_TOO_LONG, "the question is too long");
    }
    let Some(map) = lock(&app.0.source.hub.orders).newest.clone() else {
        return refusal(StatusCode::NOT_FOUND, "there is no map yet");
    };
    let Ok(permit) = Arc::clone(&app.0.measures).try_acquire_owned() else {
        return refusal(
            StatusCode::SERVICE_UNAVAILABLE,
            "something else is measured: ask again",
        );
    };
    let control = Arc::clone(&app.0.control);
    let measured = tokio::task::spawn_blocking(move || {
        let _permit = permit;
        control.measure(&map, &query)
    });
    match measured.await {
        Ok(Ok(found)) => answer(&found),
        Ok(Err(sentence)) => refusal(StatusCode::UNPROCESSABLE_ENTITY, &sentence),
        Err(_) => failed(),
    }
}

fn too_many() -> Response {
    refusal(
        StatusCode::SERVICE_UNAVAILABLE,
        "other downloads go on: try again when they are over",
    )
}

fn attachment(name: &str) -> HeaderMap {
    let mut headers = HeaderMap::new();
    let kind = HeaderValue::from_static("application/octet-stream");
    headers.insert(CONTENT_TYPE, kind);
    let disposition = format!("attachment; filename=\"{name}\"");
    if let Ok(disposition) = HeaderValue::from_str(&disposition) {
        headers.insert(CONTENT_DISPOSITION, disposition);
    }
    headers
}

async fn logs(State(app): State<App>) -> Response {
    let control = Arc::clone(&app.0.control);
    let listed = tokio::task::spawn_blocking(move || {
        let is_recording = control.is_recording();
        json!({ "is_recording": is_recording, "logs": control.logs() })
    });
    match listed.await {
        Ok(listed) => answer(&listed),
        Err(_) => failed(),
    }
}

fn failed() -> Response {
    refusal(
        StatusCode::INTERNAL_SERVER_ERROR,
        "this failed; the service's log says why",
    )
}

async fn log(State(app): State<App>, Path(name): Path<String>) -> Response {
    let is_name = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let fits = name.len() <= MAX_NAME_BYTES && !name.starts_with('.') && name.chars().all(is_name);
    if !fits {
        return refusal(StatusCode::NOT_FOUND, "there is no such log");
    }
    let Ok(permit) = Arc::clone(&app.0.downloads).try_acquire_owned() else {
        return too_many();
    };
    let (control, asked) = (Arc::clone(&app.0.control), name.clone());
    let opened = tokio::task::spawn_blocking(move || control.open_log(&asked));
    match opened.await {
        Ok(Some(Ok(file))) => {
            let body = download::body(permit, move |to| download::copy(file, to));
            (attachment(&name), body).into_response()
        }
        Ok(None) => refusal(StatusCode::NOT_FOUND, "there is no such log"),
        Ok(Some(Err(_))) | Err(_) => failed(),
    }
}

async fn start_recording(State(app): State<App>) -> Response {
    switch(app, |control| recording(control, Control::start_recording)).await
}

async fn stop_recording(State(app): State<App>) -> Response {
    switch(app, |control| recording(control, Control::stop_recording)).await
}

fn recording(
    control: &dyn Control,
    act: fn(&dyn Control) -> Result<(), String>,
) -> Result<Value, String> {
    act(control)?;
    Ok(json!({ "is_recording": control.is_recording() }))
}

async fn pause_replay(State(app): State<App>) -> Response {
    switch(app, |control| held(control, true)).await
}

async fn resume_replay(State(app): State<App>) -> Response {
    switch(app, |control| held(control, false)).await
}

fn held(control: &dyn Control, is_held: bool) -> Result<Value, String> {
    control.hold_replay(is_held)?;
    Ok(json!({ "is_held": is_held }))
}

async fn switch(app: App, act: fn(&dyn Control) -> Result<Value, String>) -> Response {
    let Some(busy) = app.0.switching.begin() else {
        return refusal(StatusCode::CONFLICT, "another such request goes on");
    };
    let control = Arc::clone(&app.0.control);
    let done = tokio::task::spawn_blocking(move || {
        let _busy = busy;
        act(&*control)
    });
    match done.await {
        Ok(Ok(said)) => answer(&said),
        Ok(Err(sentence)) => refusal(StatusCode::CONFLICT, &sentence),
        Err(_) => failed(),
    }
}

async fn prometheus(State(app): State<App>) -> Response {
    let hub = &app.0.source.hub;
    let (status, age_s) = hub.status().unzip();
    let mut own = hub.counters.all().to_vec();
    own.push(("watchers", hub.watcher_count() as u64));
    own.push(("pings_not_shown", lock(&hub.scene).ring.not_shown()));
    let text = metrics::text(status.as_deref(), age_s, &own);
    let kind = "text/plain; version=0.0.4; charset=utf-8";
    ([(CONTENT_TYPE, kind)], text).into_response()
}

async fn health(State(app): State<App>) -> Response {
    let reported = app.0.source.hub.status();
    let is_over = |status: &Value| status["final"].as_bool() == Some(true);
    match reported {
        Some((status, age_s)) if age_s < STATUS_LIMIT_S || is_over(&status) => {
            answer(&json!({ "ok": true, "phase": status["phase"] }))
        }
        Some(_) => refusal(
            StatusCode::SERVICE_UNAVAILABLE,
            "the service has not reported for 5 s",
        ),
        None => refusal(
            StatusCode::SERVICE_UNAVAILABLE,
            "the service has not reported yet",
        ),
    }
}

/// As `BlueOS` asks every port of an extension.
async fn register_service(State(app): State<App>) -> Response {
    let about = &app.0.source.about;
    answer(&json!({
        "name": "EchoSplat",
        "description": "A live 3-D map from a forward-scan sonar",
        "icon": "mdi-radar",
        "company": "EchoSplat",
        "version": about.version,
        "webpage": "",
        "api": "",
        "new_page": false,
        "works_in_relative_paths": true,
        "extras": { "cockpit": cockpit::PATH },
    }))
}

/// As Cockpit asks what [`register_service`] names.
async fn cockpit_extras(State(app): State<App>) -> Response {
    let version = &app.0.source.about.version;
    answer(&cockpit::extras(version, app.0.access.cockpit_actions))
}
