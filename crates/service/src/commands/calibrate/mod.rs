//! `echosplat calibrate LOG`: whether time offset and mount fit the dive, and what fits better.
//!
//! First pings and poses are brought near each other, from up to a minute and tens of degrees off (`far`). From there the dive
//! is mapped anew with one of them shifted; the map wins that makes those pings most likely that were kept from it, and each
//! is looked at again until none of the others has moved since. What was found is verified on pings that no search saw.
//! What a dive does not tell, such as the roll where the sonar never rolls, is said to be open. What is left, compass and speed
//! of sound above all, is then asked of the map with what fits and of others beside it, as while a dive goes on.
//!
//! Cost: about a map of 6,144 pings for each five minutes and each of them to bring it near, four to eight of at most 6,144
//! pings for each of them, and as many again for each that was off.

mod far;
mod parameter;
mod search;
mod trials;
mod verified;

use std::time::{Duration, Instant};

use clap::ValueEnum;
use serde::Serialize;
use serde_json::json;

use crate::arguments::{CalibrateArguments, Parameter};
use crate::config::Config;
use crate::exit::Finish;
use crate::logging;
use crate::logs;
use crate::pipeline::calibration::Settings;
use search::{Found, Verdict};
use trials::{Dive, Trial};

/// Most searches for each of them.
const MOST_SEARCHES: usize = 6;

/// # Errors
/// If a file cannot be read, or too few pings have a pose.
pub(super) fn run(arguments: &CalibrateArguments) -> anyhow::Result<Finish> {
    let configured = match &arguments.config {
        Some(file) => Config::load(file)?,
        None => Config::default(),
    };
    let is_lossy = logs::tell_losses(&arguments.log, arguments.poses.as_deref())?;
    let dive = Dive::read(&arguments.log, arguments.poses.as_deref(), &configured)?;
    let all = Parameter::value_variants().iter().copied();
    let is_chosen = |p: &Parameter| arguments.only.is_empty() || arguments.only.contains(p);
    let parameters: Vec<Parameter> = all.filter(is_chosen).collect();
    let settled = settle(&dive, &configured, &parameters)?;
    let best = &settled.best.config;
    let mut answers = Vec::new();
    for (parameter, state) in parameters.iter().zip(&settled.states) {
        let verdict =
            verified::verdict(&dive, &configured, &settled.best, *parameter, state.verdict)?;
        answers.push(Answer {
            parameter: *parameter,
            configured: parameter.of(&configured),
            fits: parameter.of(best),
            sigma: state.sigma,
            verdict,
            has_settled: state.looked_at >= settled.moves,
        });
    }
    let landmarks = dive.landmarks(best)?;
    let advice = landmarks.map_or(Vec::new(), |found| Settings::of(best).advice(&found));
    match arguments.json {
        true => {
            let all = json!({ "parameters": answers, "landmarks": landmarks, "advice": advice });
            logging::print(&all.to_string());
        }
        false => {
            let told = advice.iter().map(|advice| format!("\n{}", advice.sentence));
            let told: String = told.collect();
            logging::print(&(account(&answers, best) + &told));
        }
    }
    Ok(match !is_lossy && answers.iter().all(Answer::is_sure) {
        true => Finish::Done,
        false => Finish::Lossy,
    })
}

/// Where a parameter stands.
#[derive(Debug, Clone, Copy)]
struct State {
    verdict: Verdict,
    sigma: Option<f64>,
    /// How many moves there had been, of itself and of others, when it was last looked at.
    looked_at: usize,
}

struct Settled {
    best: Trial,
    states: Vec<State>,
    moves: usize,
}

/// Looks at one after the other, and again at all that another has moved away from, until none is left.
fn settle(dive: &Dive, configured: &Config, parameters: &[Parameter]) -> anyhow::Result<Settled> {
    let (mut best, mut moves) = (far::begin(dive, configured, parameters)?, 1);
    let mut states = vec![
        State {
            verdict: Verdict::Open,
            sigma: None,
            looked_at: 0,
        };
        parameters.len()
    ];
    let begin = Instant::now();
    for searches in 0..MOST_SEARCHES * parameters.len() {
        let due = |state: &State| state.looked_at < moves;
        let Some(index) = (0..states.len())
            .filter(|index| due(&states[*index]))
            .min_by_key(|index| states[*index].looked_at)
        else {
            break;
        };
        let parameter = parameters[index];
        let Found {
            best: found,
            verdict,
            sigma,
        } = search::search(dive, parameter, &best)?;
        best = found;
        // It is where it fits now: only what moves after it makes it due again.
        moves += usize::from(verdict == Verdict::Off);
        states[index] = State {
            verdict,
            sigma,
            looked_at: moves,
        };
        let fits = parameter.show_with(parameter.of(&best.config), sigma);
        let left = states
            .iter()
            .filter(|state| state.looked_at < moves)
            .count();
        let each = begin.elapsed() / (searches as u32 + 1);
        tracing::info!("{} {fits}{}", parameter.name(), remaining(left, each));
    }
    Ok(Settled {
        best,
        states,
        moves,
    })
}

/// What is left to do, if nothing else turns out to be off.
fn remaining(left: usize, each: Duration) -> String {
    match left {
        0 => String::new(),
        _ => {
            let left_s = (each * left as u32).as_secs().max(1);
            format!("; {left} left to look at, about {left_s} s unless one is off")
        }
    }
}

#[derive(Debug, Serialize)]
struct Answer {
    parameter: Parameter,
    configured: f64,
    fits: f64,
    sigma: Option<f64>,
    verdict: Verdict,
    has_settled: bool,
}

impl Answer {
    /// Whether it can be relied on. A best value that is no top, since it is the last that was tried, is none that fits.
    fn is_sure(&self) -> bool {
        let is_found = self.verdict != Verdict::Off || self.sigma.is_some();
        self.has_settled && self.verdict != Verdict::Unverified && is_found
    }
}

fn account(answers: &[Answer], best: &Config) -> String {
    let line = |answer: &Answer| {
        let Answer {
            parameter, verdict, ..
        } = answer;
        let (name, configured) = (parameter.name(), parameter.show(answer.configured));
        let fits = parameter.show_with(answer.fits, answer.sigma);
        let told = match verdict {
            Verdict::Fits => format!("{name}: {fits} fits"),
            Verdict::Off if answer.sigma.is_some() => {
                format!("{name}: {configured} is off, {fits} fits")
            }
            Verdict::Off => format!(
                "{name}: {configured} is off; what fits is not found, {fits} is the last that was tried and better"
            ),
            Verdict::Open => format!("{name}: {configured}; this dive does not tell"),
            Verdict::Unverified => format!(
                "{name}: {configured} seems off and {fits} to fit, but pings that were kept from the search do not \
                 bear that out"
            ),
        };
        match answer.has_settled {
            true => told + "\n",
            false => told + "; it had not settled when the search was given up\n",
        }
    };
    let mut text: String = answers.iter().map(line).collect();
    let is_off = |answer: &Answer| answer.verdict == Verdict::Off;
    if answers.iter().any(is_off) && answers.iter().filter(|a| is_off(a)).all(Answer::is_sure) {
        let [yaw, pitch, roll] = best.pose.vehicle_from_sensor.yaw_pitch_roll_deg;
        text += &format!(
            "In the configuration:\n\
             [pose]\ntime_offset_s = {:.3}\n\
             [pose.vehicle_from_sensor]\nyaw_pitch_roll_deg = [{yaw:.2}, {pitch:.2}, {roll:.2}]\n",
            best.pose.time_offset_s
        );
    }
    text.trim_end().to_owned()
}
