//! `echosplat calibrate LOG`: whether time offset and mount fit the dive, and what fits better.
//!
//! The dive is mapped anew with one of them shifted; the map wins that makes those pings most likely that were kept from it.
//! What a dive does not tell, such as the roll where the sonar never rolls, is said to be open. What is left, compass and speed
//! of sound above all, is then asked of the map with what fits and of others beside it, as while a dive goes on.
//!
//! Cost: four to eight maps of at most 6,144 pings for each of them, and again if one was off.

mod parameter;
mod trials;

use clap::ValueEnum;
use serde::Serialize;
use serde_json::json;

use crate::arguments::{CalibrateArguments, Parameter};
use crate::config::Config;
use crate::exit::Finish;
use crate::logging;
use crate::pipeline::calibration::Settings;
use trials::{Dive, Verdict};

/// Most times that all are gone through.
const ROUNDS: usize = 2;

/// # Errors
/// If a file cannot be read, or too few pings have a pose.
pub(super) fn run(arguments: &CalibrateArguments) -> anyhow::Result<Finish> {
    let configured = match &arguments.config {
        Some(file) => Config::load(file)?,
        None => Config::default(),
    };
    let dive = Dive::read(&arguments.log, arguments.poses.as_deref(), &configured)?;
    let all = Parameter::value_variants().iter().copied();
    let is_chosen = |p: &Parameter| arguments.only.is_empty() || arguments.only.contains(p);
    let parameters: Vec<Parameter> = all.filter(is_chosen).collect();
    let mut best = dive.trial(&configured)?;
    let mut verdicts = vec![Verdict::Open; parameters.len()];
    for _ in 0..ROUNDS {
        let mut is_settled = true;
        for (parameter, verdict) in parameters.iter().zip(&mut verdicts) {
            let found = dive.search(*parameter, &best)?;
            let fits = parameter.of(&found.best.config);
            tracing::info!("{} {}", parameter.name(), parameter.show(fits));
            is_settled &= found.verdict != Verdict::Off;
            // Once off, it stays so when the rest has followed.
            *verdict = match *verdict {
                Verdict::Off => Verdict::Off,
                _ => found.verdict,
            };
            best = found.best;
        }
        if is_settled {
            break;
        }
    }
    let landmarks = dive.landmarks(&best.config)?;
    let advice = landmarks.map_or(Vec::new(), |found| {
        Settings::of(&best.config).advice(&found)
    });
    let answers: Vec<Answer> = parameters
        .iter()
        .zip(verdicts)
        .map(|(parameter, verdict)| Answer {
            parameter: *parameter,
            configured: parameter.of(&configured),
            fits: parameter.of(&best.config),
            verdict,
        })
        .collect();
    match arguments.json {
        true => {
            let all = json!({ "parameters": answers, "landmarks": landmarks, "advice": advice });
            logging::print(&all.to_string());
        }
        false => {
            let told = advice.iter().map(|advice| format!("\n{}", advice.sentence));
            let told: String = told.collect();
            logging::print(&(account(&answers, &best.config) + &told));
        }
    }
    Ok(Finish::Done)
}

#[derive(Debug, Serialize)]
struct Answer {
    parameter: Parameter,
    configured: f64,
    fits: f64,
    verdict: Verdict,
}

fn account(answers: &[Answer], best: &Config) -> String {
    let line = |answer: &Answer| {
        let Answer {
            parameter, verdict, ..
        } = answer;
        let (name, configured) = (parameter.name(), parameter.show(answer.configured));
        match verdict {
            Verdict::Fits => format!("{name}: {configured} fits\n"),
            Verdict::Off => {
                let fits = parameter.show(answer.fits);
                format!("{name}: {configured} is off, {fits} fits\n")
            }
            Verdict::Open => format!("{name}: {configured}; this dive does not tell\n"),
        }
    };
    let mut text: String = answers.iter().map(line).collect();
    if answers.iter().any(|answer| answer.verdict == Verdict::Off) {
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
