//! `echosplat probe`: which sonars can be reached from here, and what is in the way of others.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::bail;
use crossbeam_channel::{Receiver, unbounded};
use echosplat_driver::{Discovery, ProbedUnit, SonarUrl, discover, probe, serial_ports};
use echosplat_firmware_protocol::DeviceInformation;
use serde_json::{Value, json};
use tokio::runtime::Handle;

use crate::arguments::ProbeArguments;
use crate::config::Config;
use crate::exit::{Finish, Usage};
use crate::{inputs, logging, runtime};

/// What answers a call to everybody has this share of the time; the rest is for asking it.
const DISCOVERY_SHARE: f64 = 0.3;
/// To close what was opened.
const GRACE: Duration = Duration::from_millis(700);
/// Serial lines tried at most; machines list dozens that are not there.
const MOST_LINES: usize = 16;

/// What came of one place.
struct Answer {
    place: String,
    outcome: Result<ProbedUnit, String>,
}

/// # Errors
/// If no sonar was found, with what is in the way at each place.
pub(crate) fn run(arguments: &ProbeArguments) -> anyhow::Result<Finish> {
    let limit = Duration::from_secs_f64(arguments.timeout.clamp(0.5, 600.0));
    let began = Instant::now();
    let discovery = discovery(arguments, limit)?;
    let (mut places, calls) = match arguments.sonar.is_empty() {
        true => (usual_places()?, true),
        false => (given_places(arguments)?, arguments.discovery.is_some()),
    };
    places.dedup();
    let runtime = runtime::handle()?;
    let mut answers = ask_all(&runtime, &places, limit);
    let heard = calls.then(|| discovery.recv().ok()).flatten();
    let heard = heard.unwrap_or_default();
    let left = limit.saturating_sub(began.elapsed().min(limit.mul_f64(DISCOVERY_SHARE)));
    let new: Vec<SonarUrl> = discovered_places(&heard)
        .filter(|url| !places.contains(url))
        .collect();
    answers.extend(ask_all(&runtime, &new, left));
    tell(&answers, &heard, arguments.json)
}

/// Calls everybody, on a thread of its own.
fn discovery(arguments: &ProbeArguments, limit: Duration) -> anyhow::Result<Receiver<Discovery>> {
    let to = arguments.discovery.as_deref();
    let to: SocketAddr = to.unwrap_or("255.255.255.255:30303").parse().map_err(|_| {
        Usage::error(format!(
            "--discovery {}: it must read ADDRESS:PORT, as in 192.168.2.255:30303",
            to.unwrap_or_default()
        ))
    })?;
    let (sender, receiver) = unbounded();
    if arguments.sonar.is_empty() || arguments.discovery.is_some() {
        thread::Builder::new()
            .name("discovery".to_owned())
            .spawn(move || sender.send(discover(to, limit.mul_f64(DISCOVERY_SHARE))))?;
    }
    Ok(receiver)
}

fn given_places(arguments: &ProbeArguments) -> anyhow::Result<Vec<SonarUrl>> {
    let urls = arguments.sonar.iter();
    urls.map(|text| inputs::sonar_url(text)).collect()
}

/// Where a unit is out of the box, by both transports, and every serial line.
fn usual_places() -> anyhow::Result<Vec<SonarUrl>> {
    let usual = inputs::sonar_url(&Config::default().sonar.url)?;
    let mut places = vec![usual.clone()];
    if let SonarUrl::Tcp(address) = usual {
        places.push(SonarUrl::Udp(address));
    }
    let lines = serial_ports().into_iter().take(MOST_LINES);
    places.extend(lines.map(line));
    Ok(places)
}

fn line(path: PathBuf) -> SonarUrl {
    SonarUrl::Serial {
        path,
        baudrate: 115_200,
    }
}

fn discovered_places(heard: &Discovery) -> impl Iterator<Item = SonarUrl> + '_ {
    heard.answers.iter().flat_map(|found| {
        let address = SocketAddr::new(found.address, 51_200).to_string();
        [SonarUrl::Tcp(address.clone()), SonarUrl::Udp(address)]
    })
}

/// Asks everywhere at once; what has not answered in time is not waited for.
fn ask_all(runtime: &Handle, places: &[SonarUrl], limit: Duration) -> Vec<Answer> {
    let deadline = Instant::now() + limit + GRACE;
    let (sender, receiver) = unbounded();
    for (index, url) in places.iter().cloned().enumerate() {
        let sender = sender.clone();
        runtime.spawn(async move {
            // Whoever asked may have stopped waiting.
            let _ = sender.send((index, probe(&url, limit).await));
        });
    }
    drop(sender);
    let mut outcomes: Vec<_> = places.iter().map(|_| None).collect();
    while let Ok((index, outcome)) = receiver.recv_deadline(deadline) {
        outcomes[index] = Some(outcome);
    }
    let answer = |(place, outcome): (&SonarUrl, Option<_>)| Answer {
        place: place.to_string(),
        outcome: outcome.unwrap_or_else(|| Err("no answer in time".to_owned())),
    };
    places.iter().zip(outcomes).map(answer).collect()
}

fn tell(answers: &[Answer], heard: &Discovery, as_json: bool) -> anyhow::Result<Finish> {
    let found = answers.iter().any(|answer| answer.outcome.is_ok());
    if as_json {
        logging::print(&account(answers, heard).to_string());
    } else {
        logging::print(&report(answers, heard));
    }
    if !found {
        let places = answers.len();
        bail!("no sonar found at {places} places tried; --sonar URL tries another");
    }
    Ok(Finish::Done)
}

fn account(answers: &[Answer], heard: &Discovery) -> Value {
    let found: Vec<_> = answers
        .iter()
        .filter_map(|a| a.outcome.as_ref().ok())
        .collect();
    let in_the_way = answers.iter().filter_map(|answer| {
        let words = answer.outcome.as_ref().err()?;
        Some(json!({ "place": answer.place, "in_the_way": words }))
    });
    let discovered = heard
        .answers
        .iter()
        .map(|answer| json!({ "address": answer.address.to_string(), "text": answer.text }));
    json!({
        "found": found,
        "not_found": in_the_way.collect::<Vec<_>>(),
        "discovered": discovered.collect::<Vec<_>>(),
        "discovery_trouble": heard.trouble,
    })
}

fn report(answers: &[Answer], heard: &Discovery) -> String {
    let mut lines: Vec<String> = answers.iter().map(Answer::line).collect();
    for answer in &heard.answers {
        lines.push(format!(
            "{} answers the call: {}",
            answer.address, answer.text
        ));
    }
    if let Some(trouble) = &heard.trouble {
        lines.push(format!("discovery: {trouble}"));
    }
    lines.join("\n")
}

impl Answer {
    fn line(&self) -> String {
        match &self.outcome {
            Ok(unit) => found_words(unit),
            Err(words) => format!("{}: {words}", self.place),
        }
    }
}

fn found_words(unit: &ProbedUnit) -> String {
    let identity = match unit.identity {
        Some(identity) => DeviceInformation::from(identity).to_string(),
        None => "a sonar that does not say what it is".to_owned(),
    };
    let pinging = match unit.was_pinging {
        true => ", pinging already",
        false => "",
    };
    let profile = profile_words(unit);
    format!("{}: {identity}{pinging}\n  {profile}", unit.url)
}

fn profile_words(unit: &ProbedUnit) -> String {
    let Some(profile) = &unit.profile else {
        return "it did not ping when asked to".to_owned();
    };
    let end_m = profile.range_start_m + profile.range_length_m;
    let mut words = format!(
        "one ping: {} to {end_m} m in {} bins, gain {}, sound {} m/s",
        profile.range_start_m, profile.bin_count, profile.gain_index, profile.speed_of_sound_mps
    );
    if let (Some(noise_db), Some(strongest_db), Some(range_m)) = (
        profile.noise_db,
        profile.strongest_db,
        profile.strongest_range_m,
    ) {
        words += &format!(
            ", noise {noise_db:.1} dB, strongest echo {strongest_db:.1} dB at {range_m:.2} m"
        );
    }
    words
}
