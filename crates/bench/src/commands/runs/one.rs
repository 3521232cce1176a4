//! One run, in a process of its own: what a spec describes, made and judged.

use std::path::Path;
use std::time::Instant;

use crate::runs::{Method, Outcome, Spec};
use echosplat_simulator::{Disturbances, SimulatedSonar};

use super::{batch, online};
use crate::arguments::RunBenchArguments;
use echosplat_service::arguments::DiveArguments;
use echosplat_service::exit::{Finish, Usage};
use echosplat_service::{dives, logging};

/// Makes the run that a spec in JSON describes, and prints its outcome as a line of JSON.
///
/// # Errors
/// If there is no such dive, or it cannot be mapped.
pub(in crate::commands) fn run_one(arguments: &RunBenchArguments) -> anyhow::Result<Finish> {
    let spec: Spec = serde_json::from_str(&arguments.spec)
        .map_err(|error| Usage::error(format!("bench run: {error}")))?;
    let outcome = outcome(&spec, arguments.keep_map.as_deref())?;
    logging::print(&serde_json::to_string(&outcome)?);
    Ok(Finish::Done)
}

fn outcome(spec: &Spec, keep_map: Option<&Path>) -> anyhow::Result<Outcome> {
    let begin = Instant::now();
    let sonar = sonar(spec)?;
    let outcome = match spec.method {
        Method::Online => online::outcome(spec, &sonar, keep_map)?,
        Method::Support | Method::Carving | Method::Paper => batch::outcome(spec, &sonar)?,
    };
    Ok(Outcome {
        wall_s: begin.elapsed().as_secs_f64(),
        ..outcome
    })
}

/// The sonar on the dive that a spec names.
///
/// # Errors
/// If there is no such dive, or nothing is heard on it whose strength could be chosen.
pub(in crate::commands) fn sonar(spec: &Spec) -> anyhow::Result<SimulatedSonar> {
    let dive = DiveArguments {
        scene: spec.scene.clone(),
        dive: spec.dive,
        noise: spec.noise,
        seed: spec.seed,
        pings_per_s: None,
    };
    let poses = spec.pose_noise.unwrap_or(spec.noise);
    let mut disturbances = Disturbances::default();
    for pair in &spec.disturbances {
        disturbances.set(pair)?;
    }
    let sonar = dives::sonar_with(&dive, spec.duration_s, poses, disturbances)?;
    match spec.echoes_over_noise_db {
        None => Ok(sonar),
        Some(over_noise_db) => sonar.with_echoes_over_noise(over_noise_db).ok_or_else(|| {
            Usage::error(format!(
                "{}: half of the pings hear no echo, so none can stand {over_noise_db} dB over the noise",
                spec.scene
            ))
        }),
    }
}
