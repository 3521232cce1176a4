//! `echosplat bench long`: hours of diving past several structures through the service's own way from
//! pings to the map, and what these cost and keep.

use std::sync::Arc;

use crate::long::{self, Asked, Errors, Found, Reading, Voyage, VoyagePlan};
use anyhow::{Context, ensure};
use crossbeam_channel::{Receiver, Sender, unbounded};
use echosplat_metrics::{MapPoints, Truth, evaluate_raw};
use echosplat_model::{Ping, Snapshot};
use echosplat_pose::PoseSource;
use echosplat_report::Report;
use rayon::prelude::*;
use serde_json::{Map, json};

use super::Findings;
use crate::arguments::LongBenchArguments;
use echosplat_service::config::Config;
use echosplat_service::exit::Usage;
use echosplat_service::pipeline::{Mapping, Observed, Observer, Poses, Schedule};
use echosplat_service::signals::Stop;
use echosplat_service::{logging, processor};

/// Pings made together.
const PIECE: usize = 256;
const TENTHS: u32 = 10;
const HOURS: f64 = 2.0;
const QUICK_HOURS: f64 = 1.0 / 6.0;

/// # Errors
/// If there is no such dive, it cannot be mapped, or it is stopped.
pub(super) fn run(arguments: &LongBenchArguments) -> anyhow::Result<Findings> {
    let options = &arguments.options;
    let default_hours = if options.quick { QUICK_HOURS } else { HOURS };
    let plan = VoyagePlan {
        duration_s: 3600.0 * arguments.hours.unwrap_or(default_hours),
        pings_per_s: arguments.pings_per_s,
        is_quick: options.quick,
        seed: options.seed,
    };
    let voyage = Arc::new(Voyage::new(&plan).map_err(Usage::error)?);
    let truth = voyage.first_truth()?;
    let found = dive(&voyage, &truth)?;
    results(&voyage, &found)
}

/// When live maps are looked at, seconds since the first ping.
struct Times {
    /// When the first place is left for the first time.
    left_s: f64,
    tenths_s: Vec<f64>,
}

impl Times {
    fn of(voyage: &Voyage) -> Self {
        // The end is the last ping's transmit.
        let last_s = voyage.duration_s() - 2.5 * voyage.interval_s();
        let tenth = |index: u32| voyage.duration_s() * f64::from(index) / f64::from(TENTHS);
        Self {
            left_s: voyage.stays_s()[0].1,
            tenths_s: (1..=TENTHS).map(|index| tenth(index).min(last_s)).collect(),
        }
    }

    /// When the first structure's map is judged: left, half, end.
    fn judged_s(&self) -> [f64; 3] {
        let tenth = |number: usize| self.tenths_s[number - 1];
        let middle = TENTHS as usize / 2;
        [self.left_s, tenth(middle), tenth(TENTHS as usize)]
    }

    fn schedule(&self) -> Schedule {
        let mut times_s = self.tenths_s.clone();
        times_s.push(self.left_s);
        times_s.sort_by(f64::total_cmp);
        Schedule::At(times_s)
    }
}

/// What the mapper's thread hands over: the first structure's map only where it is asked for.
type Seen = (Reading, Option<MapPoints>);

fn dive(voyage: &Arc<Voyage>, truth: &Truth) -> anyhow::Result<Found> {
    let mut config = Config::default();
    // As in the other benches; the second core makes the pings.
    config.mapper.threads = 1;
    // Maps for nobody to see are not made.
    config.pipeline.snapshot_interval_s = 2.0 * voyage.duration_s();
    let times = Times::of(voyage);
    let before_bytes = processor::memory_bytes();
    let poses = PoseSource::made(voyage.poses());
    let poses = Poses::waited_for(&config, poses)?;
    let (sender, seen) = unbounded();
    let observer = observer(voyage, &times, sender);
    let mapping = Mapping::start(&config, poses, Some(observer))?;
    let mut judged = Judged {
        voyage,
        truth,
        seen,
        readings: Vec::new(),
        cds_m: Vec::new(),
    };
    feed(voyage, &mapping, &mut judged)?;
    let (map, _) = mapping.finish()?;
    judged.take_what_came();
    let at = |time_s: f64| judged.cds_m.iter().find(|(dive_s, _)| *dive_s >= time_s);
    let cd_m = |time_s: f64| at(time_s).map_or(f64::INFINITY, |(_, cd_m)| *cd_m);
    let [first_visit_m, half_m, end_m] = times.judged_s().map(cd_m);
    let errors = Errors {
        first_visit_m,
        half_m,
        end_m,
        finished_m: judged.cd_m(&at_first(voyage, &map)),
    };
    let at = |time_s: &f64| judged.readings.iter().find(|r| r.dive_s >= *time_s);
    let readings: Vec<Reading> = times.tenths_s.iter().filter_map(at).copied().collect();
    Ok(Found::new(
        &readings,
        &voyage.stays_s(),
        before_bytes,
        errors,
    ))
}

/// Makes the pings piece by piece while those before are mapped.
fn feed(voyage: &Voyage, mapping: &Mapping, judged: &mut Judged<'_>) -> anyhow::Result<()> {
    let stop = Stop::on_signals()?;
    let count = voyage.pings();
    let bar = logging::progress_bar(count as u64, "{bar:40} {pos} of {len} pings · {elapsed}");
    for start in (0..count).step_by(PIECE) {
        ensure!(!stop.is_set(), "stopped at ping {start} of {count}");
        let end = (start + PIECE).min(count);
        for ping in pings(voyage, start..end)? {
            mapping.take(ping)?;
        }
        judged.take_what_came();
        bar.set_position(end as u64);
    }
    bar.finish_and_clear();
    Ok(())
}

fn pings(voyage: &Voyage, range: std::ops::Range<usize>) -> anyhow::Result<Vec<Arc<Ping>>> {
    let ping = |index| voyage.ping(index).context("a simulated ping");
    range.into_par_iter().map(ping).collect()
}

/// Reads off what there is at each moment. Memory is looked at before anything is copied for judging.
fn observer(voyage: &Arc<Voyage>, times: &Times, to: Sender<Seen>) -> Observer {
    let voyage = Arc::clone(voyage);
    let mut to_judge = times.judged_s().to_vec();
    to_judge.sort_by(f64::total_cmp);
    let mut before_bytes = 0;
    let take = move |observed: Observed| {
        let (moment, map) = (observed.moment, &observed.snapshot);
        let map_bytes = size_of_val(map.gaussians.as_slice()) as u64;
        let reading = Reading {
            dive_s: moment.dive_s,
            pings: moment.pings,
            compute_s: moment.compute_s,
            resident_bytes: processor::memory_bytes(),
            map_bytes,
            // The map before is let go once this one is handed on.
            published_bytes: map_bytes + before_bytes,
            gaussians: map.gaussians.len(),
        };
        before_bytes = map_bytes;
        let is_asked = to_judge.iter().any(|time_s| moment.dive_s >= *time_s);
        to_judge.retain(|time_s| moment.dive_s < *time_s);
        let points = is_asked.then(|| at_first(&voyage, map));
        // Where nobody takes it any more the bench has failed already.
        let _ = to.send((reading, points));
    };
    Observer {
        schedule: times.schedule(),
        take: Box::new(take),
    }
}

fn at_first(voyage: &Voyage, map: &Snapshot) -> MapPoints {
    voyage.at_first(MapPoints::from(map))
}

/// Judges on this thread what the mapper's hands over, so that the mapper does not pay for it and
/// nothing is kept.
struct Judged<'a> {
    voyage: &'a Voyage,
    truth: &'a Truth,
    seen: Receiver<Seen>,
    readings: Vec<Reading>,
    /// Chamfer distances of the first structure, with their times.
    cds_m: Vec<(f64, f64)>,
}

impl Judged<'_> {
    fn take_what_came(&mut self) {
        while let Ok((reading, points)) = self.seen.try_recv() {
            if let Some(points) = points {
                self.cds_m.push((reading.dive_s, self.cd_m(&points)));
            }
            tracing::info!(
                "{:.0} of {:.0} s, {} pings, {:.0} CPU s, {} Gaussians, {:.0} MB",
                reading.dive_s,
                self.voyage.duration_s(),
                reading.pings,
                reading.compute_s,
                reading.gaussians,
                reading.resident_bytes as f64 * 1e-6,
            );
            self.readings.push(reading);
        }
    }

    fn cd_m(&self, points: &MapPoints) -> f64 {
        evaluate_raw(points, self.truth).cd_m
    }
}

fn results(voyage: &Voyage, found: &Found) -> anyhow::Result<Findings> {
    let asked = found.asked();
    let met = asked.iter().filter(|asked| asked.is_met == Some(true));
    let (met, scenes) = (met.count(), voyage.scenes().join(", "));
    let about = format!(
        "Surveys of {scenes} in a row, {:.1} pings a second, {:.2} h in nominal noise, straight \
         transits between them at about 1 m/s; one thread of the mapper.",
        1.0 / voyage.interval_s(),
        voyage.duration_s() / 3600.0,
    );
    let mut fields = Map::new();
    fields.insert("duration_s".to_owned(), json!(voyage.duration_s()));
    fields.insert("pings".to_owned(), json!(voyage.pings()));
    fields.insert("interval_s".to_owned(), json!(voyage.interval_s()));
    fields.insert("places".to_owned(), json!(voyage.scenes()));
    fields.insert("found".to_owned(), serde_json::to_value(found)?);
    fields.insert("asked".to_owned(), json!(asked));
    let highlights = asked.iter().map(|asked| {
        let said = format!("{} {}", asked.reached, asked.verdict());
        (asked.quantity.to_owned(), said)
    });
    Ok(Findings {
        name: "long",
        fields,
        text: format!(
            "{about}\n{}{met} of {} targets met",
            long::text(found),
            asked.len()
        ),
        report: Report {
            title: "A long dive".to_owned(),
            highlights: highlights.collect(),
            sections: vec![long::section(found, about)],
            ..Report::default()
        },
        failures: asked.iter().filter_map(Asked::failure).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_are_looked_at_ten_times_and_when_the_first_place_is_left() {
        let plan = VoyagePlan {
            duration_s: 600.0,
            pings_per_s: 58.0,
            is_quick: true,
            seed: 1,
        };
        let voyage = Voyage::new(&plan).unwrap();
        let times = Times::of(&voyage);
        let Schedule::At(all_s) = times.schedule() else {
            panic!("it names its times");
        };
        assert_eq!(all_s.len(), 11);
        assert!(all_s.is_sorted() && all_s.contains(&voyage.stays_s()[0].1));
        let last_ping_s = (voyage.pings() - 1) as f64 * voyage.interval_s();
        assert!(all_s[10] < last_ping_s && all_s[10] > last_ping_s - 1.0);
        let [left_s, half_s, end_s] = times.judged_s();
        assert!(left_s < half_s && (half_s - 300.0).abs() < 1e-9 && end_s < 600.0);
    }
}
