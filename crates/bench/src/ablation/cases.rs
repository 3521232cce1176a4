//! Which features, which of their states together, and on which dives.

use echosplat_simulator::{DiveKind, NoiseLevel};
use serde::Serialize;

use crate::error_time::Omission;
use crate::runs::{Spec, dive_name};

/// Poses are freed from jitter before the mapper has them.
const POSES: &str = "poses";
/// Names of the optional features: keys of `mapper.parts`, but for [`POSES`], each "on", "off" or
/// "auto".
pub(crate) const FEATURES: [&str; 11] = [
    "occlusion",
    "elevation",
    "anisotropy",
    "speckle",
    "specular",
    "glints",
    POSES,
    "splitting",
    "converged",
    "redundant",
    "empty",
];

const QUICK_DIVE_S: f64 = 30.0;

/// Whether a feature takes part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum State {
    /// Always.
    On,
    /// Never.
    Off,
    /// As the mapper finds it worth its work.
    Auto,
}

impl State {
    /// In the order of tables.
    pub(crate) const ALL: [Self; 3] = [Self::On, Self::Off, Self::Auto];

    /// As in the configuration.
    #[must_use]
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Off => "off",
            Self::Auto => "auto",
        }
    }
}

/// An optional feature and how the configuration says what becomes of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Feature {
    /// As in reports.
    pub(crate) name: String,
    /// Key of the configuration.
    pub(crate) key: String,
    /// TOML values, in the order of [`State::ALL`].
    pub(crate) values: [String; 3],
}

impl Feature {
    /// One of the mapper's own, or the poses'.
    #[must_use]
    pub(crate) fn named(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            key: match name {
                POSES => "pose.smoothing".to_owned(),
                name => format!("mapper.parts.{name}"),
            },
            values: State::ALL.map(|state| format!("\"{}\"", state.as_str())),
        }
    }

    /// The TOML value for a state.
    #[must_use]
    pub(crate) fn value(&self, state: State) -> &str {
        let [on, off, auto] = &self.values;
        match state {
            State::On => on,
            State::Off => off,
            State::Auto => auto,
        }
    }
}

/// A state for every feature.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Variant {
    /// As in reports.
    pub(crate) name: String,
    /// One for each feature, in their order.
    pub(crate) states: Vec<State>,
}

impl Variant {
    /// Whether the mapper chooses everything by itself.
    #[must_use]
    pub(crate) fn is_auto(&self) -> bool {
        self.states.iter().all(|state| *state == State::Auto)
    }

    /// Whether every feature is in the same state.
    #[must_use]
    pub(crate) fn is_whole(&self) -> bool {
        self.states.windows(2).all(|pair| pair[0] == pair[1])
    }

    fn all(state: State, count: usize) -> Self {
        Self {
            name: format!("everything {}", state.as_str()),
            states: vec![state; count],
        }
    }
}

/// Everything in each state, and each feature alone fixed on and off with the others left to the
/// mapper. Without features, what the mapper does by itself.
#[must_use]
pub(crate) fn variants(features: &[Feature], quick: bool) -> Vec<Variant> {
    let auto = Variant::all(State::Auto, features.len());
    if features.is_empty() {
        return vec![auto];
    }
    let fixed = [State::On, State::Off].map(|state| Variant::all(state, features.len()));
    let mut variants = vec![auto];
    variants.extend(fixed);
    if quick {
        return variants;
    }
    for (index, feature) in features.iter().enumerate() {
        for state in [State::On, State::Off] {
            let mut states = vec![State::Auto; features.len()];
            states[index] = state;
            let name = format!("{} {}", feature.name, state.as_str());
            variants.push(Variant { name, states });
        }
    }
    variants
}

/// A dive that every variant maps.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Case {
    /// A built-in scene.
    pub(crate) scene: &'static str,
    /// How the sonar moves.
    pub(crate) dive: DiveKind,
    /// What is wrong with pings and poses.
    pub(crate) noise: NoiseLevel,
    duration_s: Option<f64>,
    alone: Alone,
    first_seed_only: bool,
}

/// When each feature is fixed by itself on a dive: that is 22 runs, with the first seed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Alone {
    /// Before other seeds.
    Early,
    /// After everything else.
    Late,
    Never,
}

impl Case {
    /// Unique.
    #[must_use]
    pub(crate) fn name(&self) -> String {
        dive_name(self.scene, self.dive, self.noise, self.duration_s)
    }

    /// The run of one variant: every feature is set, also to what is its default.
    #[must_use]
    pub(crate) fn spec(&self, features: &[Feature], variant: &Variant, seed: u64) -> Spec {
        let spec = Spec {
            duration_s: self.duration_s,
            held_out: true,
            ..Spec::new(self.scene, self.dive, self.noise, seed)
        };
        let set = features.iter().zip(&variant.states);
        set.fold(spec, |spec, (feature, state)| {
            spec.with(&feature.key, feature.value(*state))
        })
    }
}

/// Runs in the order in which they are worth their time: everything in each state with the first seed,
/// each feature alone where a run is short, the other seeds, each feature alone elsewhere.
#[must_use]
pub(crate) fn specs(
    cases: &[Case],
    features: &[Feature],
    variants: &[Variant],
    seeds: &[u64],
) -> Vec<Spec> {
    let Some((&first, others)) = seeds.split_first() else {
        return Vec::new();
    };
    let (whole, alone): (Vec<_>, Vec<_>) = variants.iter().partition(|v| v.is_whole());
    let mut specs = Vec::new();
    let mut add = |seed: u64, variants: &[&Variant], takes: &dyn Fn(&Case) -> bool| {
        for variant in variants {
            let own = cases.iter().filter(|case| takes(case));
            specs.extend(own.map(|case| case.spec(features, variant, seed)));
        }
    };
    add(first, &whole, &|_| true);
    add(first, &alone, &|case| case.alone == Alone::Early);
    for &seed in others {
        add(seed, &whole, &|case| !case.first_seed_only);
    }
    add(first, &alone, &|case| case.alone == Alone::Late);
    specs
}

/// What [`specs`] leaves out of all variants on all dives with all seeds.
#[must_use]
pub(crate) fn omissions(cases: &[Case]) -> Vec<Omission> {
    let named = |takes: fn(&Case) -> bool| {
        let own = cases.iter().filter(|case| takes(case));
        let names: Vec<&str> = own.map(|case| case.scene).collect();
        names.join(", ")
    };
    let omitted = [
        (
            "each feature alone on",
            named(|case| case.alone == Alone::Never),
        ),
        (
            "other seeds than the first on",
            named(|case| case.first_seed_only),
        ),
        (
            "each feature alone with other seeds on",
            named(|case| case.alone != Alone::Never),
        ),
    ];
    let omitted = omitted.into_iter().filter(|(_, names)| !names.is_empty());
    let omission =
        |(what, names)| Omission::new(format!("{what} {names}"), "thinned, to fit the time");
    omitted.map(omission).collect()
}

/// All dives, in the order of the report.
#[must_use]
pub(crate) fn cases(quick: bool) -> Vec<Case> {
    use DiveKind::{Survey, Viewpoints};
    use NoiseLevel::{Nominal, None as Clean};
    let case = |(scene, dive, noise, alone)| Case {
        scene,
        dive,
        noise,
        duration_s: quick.then_some(QUICK_DIVE_S),
        alone,
        first_seed_only: scene == "truss",
    };
    let all = [
        ("fence", Survey, Nominal, Alone::Early),
        ("empty", Survey, Nominal, Alone::Early),
        ("pier", Survey, Nominal, Alone::Late),
        ("wall", Survey, Nominal, Alone::Never),
        ("pipeline", Survey, Nominal, Alone::Never),
        ("truss", Viewpoints, Clean, Alone::Never),
    ];
    let count = if quick { 3 } else { all.len() };
    all.into_iter().take(count).map(case).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Features that the configuration has had all along.
    pub(crate) fn stand_ins() -> Vec<Feature> {
        let feature = |name: &str, values: [&str; 3]| Feature {
            name: name.to_owned(),
            key: format!("mapper.{name}"),
            values: values.map(str::to_owned),
        };
        vec![
            feature("workout_passes", ["32", "4", "16"]),
            feature("slice_pings", ["4", "16", "8"]),
        ]
    }

    #[test]
    fn every_variant_is_a_run_of_its_own_and_sets_every_feature() {
        let features = stand_ins();
        let variants = variants(&features, false);
        assert_eq!(variants.len(), 3 + 2 * features.len());
        assert_eq!(variants.iter().filter(|v| v.is_auto()).count(), 1);
        let case = &cases(false)[0];
        let specs = variants
            .iter()
            .map(|variant| case.spec(&features, variant, 1));
        let mut names: Vec<String> = specs.map(|spec| spec.name()).collect();
        assert!(names.iter().all(|name| name.contains("slice_pings = ")));
        names.sort();
        names.dedup();
        assert_eq!(names.len(), variants.len());
    }

    #[test]
    fn features_of_the_mapper_are_words_in_its_configuration() {
        let feature = Feature::named(FEATURES[0]);
        assert_eq!(feature.key, "mapper.parts.occlusion");
        assert_eq!(feature.value(State::Auto), "\"auto\"");
        assert_eq!(variants(&[], false).len(), 1);
    }
}
