//! `echosplat simulate`: a dive as files: log, poses, truth and how it was made.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use echosplat_model::Timestamp;
use echosplat_recording::svlog::{SessionHeader, SvlogError, SvlogWriter};
use echosplat_recording::tum;
use echosplat_simulator::{Disturbances, SimulatedSonar};

use crate::arguments::SimulateArguments;
use crate::exit::{Finish, Usage};
use crate::scene_files::SceneFiles;
use crate::{dives, files, logging, truth};

/// Source id of the simulated unit's packets.
const DEVICE_ID: u8 = 1;

/// A file of the dive.
type Out<'a> = BufWriter<&'a mut File>;

/// Pings made at once, on all processors; bounds memory.
const BATCH: usize = 256;

/// # Errors
/// If there is no such dive or disturbance, or the files cannot be written.
pub(crate) fn run(arguments: &SimulateArguments) -> anyhow::Result<Finish> {
    let disturbances = disturbances(&arguments.disturb)?;
    let dive = &arguments.dive;
    let (scene, scene_text) = dives::scene_with_text(&dive.scene)?;
    let sonar = dives::sonar_disturbed(scene, dive, arguments.duration, disturbances)?;
    let out = &arguments.out;
    std::fs::create_dir_all(out)
        .map_err(|error| Usage::error(format!("--out {}: {error}", out.display())))?;
    let write = |name: &str, write: &dyn Fn(&mut Out<'_>) -> io::Result<()>| {
        files::write_with("--out", &out.join(name), |file| write(file))
    };
    write("dive.svlog", &|file| {
        write_log(&sonar, file).map_err(|error| match error {
            SvlogError::Io(error) => error,
            other => io::Error::other(other),
        })
    })?;
    write("dive.tum", &|file| {
        tum::write(sonar.dive().reported_poses(), file)
    })?;
    let description = description(arguments, &sonar);
    write("dive.toml", &|file| file.write_all(description.as_bytes()))?;
    let beside = Path::new(&arguments.dive.scene).parent();
    let scene_files = SceneFiles::of(&scene_text, beside.unwrap_or(Path::new("")))?;
    truth::write(out, &scene_files, sonar.scene(), sonar.dive())?;
    logging::print(&format!(
        "{}: {} pings over {:.0} s, their poses, and the truth",
        out.display(),
        sonar.dive().pings(),
        sonar.dive().duration_s()
    ));
    Ok(Finish::Done)
}

fn disturbances(pairs: &[String]) -> anyhow::Result<Disturbances> {
    let mut disturbances = Disturbances::default();
    for pair in pairs {
        disturbances
            .set(pair)
            .map_err(|error| Usage::error(format!("--disturb {pair}: {error}")))?;
    }
    Ok(disturbances)
}

/// How the dive was made, as TOML.
fn description(arguments: &SimulateArguments, sonar: &SimulatedSonar) -> String {
    let dive = &arguments.dive;
    format!(
        "# How echosplat {} made this dive.\nscene = {}\ndive = \"{}\"\nnoise = \"{}\"\nseed = {}\n\
         duration_s = {:?}\npings_per_s = {:?}\n\n[disturbances]\n{}",
        env!("CARGO_PKG_VERSION"),
        toml::Value::from(dive.scene.as_str()),
        dive.dive,
        dive.noise,
        dive.seed,
        sonar.dive().duration_s(),
        1.0 / sonar.dive().ping_interval_s(),
        sonar.dive().disturbances().to_toml()
    )
}

/// The log's time is that of the dive: the session begins at 0.
fn write_log(sonar: &SimulatedSonar, out: &mut Out<'_>) -> Result<(), SvlogError> {
    let header = SessionHeader::new(Timestamp::ZERO, DEVICE_ID, "simulated");
    let mut log = SvlogWriter::new(out, &header)?;
    let count = sonar.dive().pings();
    let bar = logging::progress_bar(count as u64, "{bar:40} {pos} of {len} pings, {eta} to go");
    for start in (0..count).step_by(BATCH) {
        let end = (start + BATCH).min(count);
        for frame in dives::frames(sonar, start..end, DEVICE_ID) {
            log.write_frame(&frame)?;
        }
        bar.set_position(end as u64);
    }
    bar.finish_and_clear();
    log.finish()?;
    Ok(())
}
