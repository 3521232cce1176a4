//! Maps a log with the poses of a TUM file, as `echosplat replay` does, without a socket:
//! `cargo run --release --example map_a_log -- dive.svlog dive.tum map.ply`.

use std::error::Error;
use std::fs::{self, File};
use std::io::BufReader;

use echosplat_join::{PoseJoin, PoseJoinConfig};
use echosplat_mapper::{Mapper, MapperConfig};
use echosplat_model::Timestamp;
use echosplat_recording::ply::{self, MapNotes};
use echosplat_recording::tum;
use echosplat_session::{Session, SessionConfig, SessionEvent};

fn main() -> Result<(), Box<dyn Error>> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [log, poses, map] = &paths[..] else {
        return Err("give a log, its poses and where the map goes".into());
    };
    let poses = tum::read(BufReader::new(File::open(poses)?))?.poses;
    let mut join = PoseJoin::new(PoseJoinConfig {
        trajectory_capacity: poses.len(),
        ..PoseJoinConfig::default()
    })?;
    poses
        .into_iter()
        .try_for_each(|pose| join.push_pose(pose))?;
    join.finish();
    let mut mapper = Mapper::new(MapperConfig::default())?;
    let mut session = Session::listening(SessionConfig::default(), Timestamp::ZERO);
    for piece in fs::read(log)?.chunks(4096) {
        session.receive(piece, Timestamp::ZERO);
        while let Some(event) = session.poll_event() {
            if let SessionEvent::Ping { ping, .. } = event {
                join.push_ping(ping);
            }
            while let Some(verdict) = join.poll() {
                if let Ok(posed) = verdict.result {
                    mapper.insert(&posed);
                }
            }
        }
    }
    let snapshot = mapper.finish();
    ply::write_map(
        map.as_ref(),
        snapshot.origin_m,
        snapshot.intensity_unit,
        &snapshot.gaussians,
        &MapNotes::default(),
    )?;
    Ok(())
}
