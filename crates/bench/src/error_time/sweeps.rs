//! Knobs that trade time for error, one at a time, on some scenes.

use echosplat_simulator::{DiveKind, NoiseLevel};
use serde::Serialize;

use crate::front::{front, knee};
use crate::runs::{Outcomes, Spec};
use echosplat_metrics::nullable;

/// Times the edge that the mapper takes by itself.
const RESOLUTION_FACTORS: [f64; 2] = [0.7, 1.4];

/// A key of the configuration and values other than its default.
struct Knob {
    key: &'static str,
    values: &'static [&'static str],
}

const KNOBS: [Knob; 5] = [
    Knob {
        key: "mapper.workout_passes",
        values: &["4", "8", "32", "64"],
    },
    Knob {
        key: "mapper.workout_pairs",
        values: &["500_000_000", "1_500_000_000", "24_000_000_000"],
    },
    Knob {
        key: "mapper.work_pairs_per_ping",
        // As the targets write theirs, so that their runs serve here too.
        values: &["75000", "150000", "600000", "1200000"],
    },
    Knob {
        key: "mapper.spawn_evidence",
        values: &["2.5", "3.5", "6.0", "8.0"],
    },
    Knob {
        key: "mapper.slice_pings",
        values: &["1", "2", "8"],
    },
];
const RESOLUTION: &str = "mapper.resolution_m";
const THREADS: &str = "mapper.threads";

/// All knobs on one scene, surveyed at nominal noise.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Sweep {
    /// A built-in scene.
    pub(crate) scene: &'static str,
    settings: Vec<Setting>,
}

/// One run of a sweep.
#[derive(Debug, Clone, PartialEq)]
struct Setting {
    knob: &'static str,
    value: String,
    spec: Spec,
}

/// What one setting came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Point {
    /// Key of the configuration; empty for the defaults.
    pub(crate) knob: String,
    /// Its value.
    pub(crate) value: String,
    /// Processor seconds of the mapper.
    pub(crate) compute_s: f64,
    /// Gaussian–bin pairs and voxel observations.
    pub(crate) work: u64,
    /// Chamfer distance of the finished map, metres.
    #[serde(with = "nullable")]
    pub(crate) cd_m: f64,
    /// Share of what is asserted that is false, 0 to 1.
    pub(crate) confident_false_share: f64,
    /// Whether no other setting has less of both, compute time and error.
    pub(crate) is_on_front: bool,
    /// Whether the front bends here.
    pub(crate) is_knee: bool,
}

impl Point {
    /// Whether it is that of the defaults.
    #[must_use]
    pub(crate) fn is_default(&self) -> bool {
        self.knob.is_empty()
    }
}

/// The sweeps, given the edge of a voxel in metres that the mapper takes by itself on each scene.
#[must_use]
pub(crate) fn sweeps(automatic_voxel_m: &[(&'static str, f64)], seed: u64) -> Vec<Sweep> {
    let sweep = |&(scene, voxel_m): &(&'static str, f64)| Sweep {
        scene,
        settings: settings(scene, voxel_m, seed),
    };
    automatic_voxel_m.iter().map(sweep).collect()
}

fn settings(scene: &str, voxel_m: f64, seed: u64) -> Vec<Setting> {
    let default = Spec::new(scene, DiveKind::Survey, NoiseLevel::Nominal, seed);
    let mut settings = vec![Setting {
        knob: "",
        value: String::new(),
        spec: default.clone(),
    }];
    let mut add = |knob, value: &str, spec| {
        settings.push(Setting {
            knob,
            value: value.to_owned(),
            spec,
        });
    };
    for knob in &KNOBS {
        for value in knob.values {
            add(knob.key, value, default.clone().with(knob.key, value));
        }
    }
    for factor in RESOLUTION_FACTORS {
        let value = format!("{:.5}", factor * voxel_m);
        let spec = default.clone().with(RESOLUTION, &value);
        add(RESOLUTION, &format!("{value} (× {factor})"), spec);
    }
    let on_two = Spec {
        threads: 2,
        ..default.clone()
    };
    add(THREADS, "2", on_two);
    settings
}

impl Sweep {
    /// Its runs; the first has the defaults.
    #[must_use]
    pub(crate) fn specs(&self) -> Vec<Spec> {
        self.settings
            .iter()
            .map(|setting| setting.spec.clone())
            .collect()
    }

    /// What those that were run came to, and which are on the front.
    #[must_use]
    pub(crate) fn points(&self, results: &Outcomes) -> Vec<Point> {
        let point = |setting: &Setting| {
            let outcome = results.of(&setting.spec)?.as_ref().ok()?;
            Some(Point {
                knob: setting.knob.to_owned(),
                value: setting.value.clone(),
                compute_s: outcome.total.compute_s,
                work: outcome.total.counted(),
                cd_m: outcome.metrics.cd_m,
                confident_false_share: outcome.metrics.confident_false_share,
                is_on_front: false,
                is_knee: false,
            })
        };
        let mut points: Vec<Point> = self.settings.iter().filter_map(point).collect();
        let places: Vec<(f64, f64)> = points.iter().map(|p| (p.compute_s, p.cd_m)).collect();
        for index in front(&places) {
            points[index].is_on_front = true;
        }
        if let Some(index) = knee(&places) {
            points[index].is_knee = true;
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runs::sample_outcome;

    #[test]
    fn every_setting_is_a_run_of_its_own_and_the_defaults_come_first() {
        let sweeps = sweeps(&[("fence", 0.05), ("pier", 0.1)], 7);
        let mut names: Vec<String> = sweeps
            .iter()
            .flat_map(|sweep| sweep.specs().into_iter().map(|spec| spec.name()))
            .collect();
        assert_eq!(names[0], "fence survey nominal, seed 7");
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count);
        assert!(
            names
                .iter()
                .any(|name| name.contains("resolution_m = 0.03500"))
        );
    }

    #[test]
    fn the_front_and_its_knee_are_marked() {
        let sweep = &sweeps(&[("fence", 0.05)], 1)[0];
        let specs = sweep.specs();
        let mut results = Outcomes::default();
        for (spec, (cd_m, pairs)) in
            specs
                .iter()
                .zip([(0.02, 200), (0.5, 100), (0.019, 2000), (0.6, 300)])
        {
            results
                .0
                .insert(spec.name(), Ok(sample_outcome(cd_m, pairs)));
        }
        results.0.insert(specs[5].name(), Err("no".into()));
        let points = sweep.points(&results);
        let on_front: Vec<bool> = points.iter().map(|point| point.is_on_front).collect();
        assert_eq!(on_front, [true, true, true, false]);
        assert!(points[0].is_default() && points[0].is_knee);
        assert_eq!(points.iter().filter(|point| point.is_knee).count(), 1);
    }
}
