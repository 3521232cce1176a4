//! Features of the mapper that a scene may not need, and what of the running dive decides.
//!
//! Cost: a few sums per ping. A decision may change as the dive goes on, and every feature that is left out says why.

use echosplat_model::Switch;
use serde::{Deserialize, Serialize};

/// The optional features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Features {
    /// What surfaces hide behind them is doubted.
    pub occlusion: Switch,
    /// The fan's sensitivity over elevation is part of the measurement; without it, it is even up
    /// to its edge.
    pub elevation: Switch,
    /// Gaussians are laid along the surface; without it they stay round.
    pub anisotropy: Switch,
    /// Echoes scatter as gamma speckle; without it, as counts do: faint ones matter less.
    pub speckle: Switch,
    /// Directional reflectivity: a strength towards each of the six faces of a cube; without it, one for all directions.
    pub specular: Switch,
    /// Specular returns are expected: candidates are weighed as if each azimuth sector of 45° had seen something of its
    /// own. Without it, sectors of 90°, and their darkness counts for more.
    pub glints: Switch,
    /// What is confident is split in eight.
    pub splitting: Switch,
    /// What has been seen often enough is observed further; with auto only where it helps.
    pub converged: Switch,
    /// Pings that say nearly nothing that the one before did not are taken in too; off leaves out
    /// all that are not independent.
    pub redundant: Switch,
    /// Pings without an echo count for strengths too; off leaves out every dark bin.
    pub empty: Switch,
    /// Ground is a layer of its own that explains its echoes; with auto the map asserts it once its onset was seen
    /// to follow the vehicle's height and tilt. Without it, ground is a structure like any other.
    pub seabed: Switch,
    /// Poses that drift against the map are corrected; with auto once corrected ones foretell pings far better. Off leaves them
    /// as they come and asks nothing.
    pub drift: Switch,
}

impl Features {
    /// Names of all.
    pub const NAMES: [&'static str; 12] = [
        "occlusion",
        "elevation",
        "anisotropy",
        "speckle",
        "specular",
        "glints",
        "splitting",
        "converged",
        "redundant",
        "empty",
        "seabed",
        "drift",
    ];

    /// Of maps that are compared with one another: places that few observations lit are left out of all unless switched on,
    /// since a crowd of candidates would leave them out of one map and not of the next.
    #[must_use]
    pub fn for_comparison(self) -> Self {
        let glints = match self.glints {
            Switch::Auto => Switch::Off,
            set => set,
        };
        Self { glints, ..self }
    }
}

/// A feature that is not at work though it may be, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// One of [`Features::NAMES`].
    #[serde(rename = "part")]
    pub feature: &'static str,
    /// With the figure that decided.
    pub why: String,
}

impl LeftOut {
    /// Specular returns are not expected where so many places would be candidates.
    pub(crate) fn specular_returns_of_crowd(places: usize) -> Self {
        Self {
            feature: "glints",
            why: format!(
                "{places} places would be candidates: darkness from every azimuth sector counts"
            ),
        }
    }
}

/// What is at work now.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct AtWork {
    pub(crate) occlusion: bool,
    pub(crate) elevation: bool,
    pub(crate) anisotropy: bool,
    pub(crate) speckle: bool,
    pub(crate) specular: bool,
    pub(crate) specular_returns: bool,
    pub(crate) splitting: bool,
    /// Whether poses jitter so much that echoes are smeared; no feature, but features depend on it.
    pub(crate) smeared: bool,
    /// Whether another sonar's pulses were heard, which leave false places at random; no feature either.
    pub(crate) interfered: bool,
    pub(crate) converged: Extent,
    pub(crate) redundant: Extent,
    pub(crate) empty: Extent,
}

/// How far a feature goes that is more than on or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Extent {
    All,
    Useful,
    None,
}

impl From<Switch> for Extent {
    fn from(switch: Switch) -> Self {
        match switch {
            Switch::On => Self::All,
            Switch::Auto => Self::Useful,
            Switch::Off => Self::None,
        }
    }
}

/// Echoes a ping; found.
/// Runs of echoes per ping that shows any, up to which nothing lies behind anything.
const ALONE: f32 = 1.05;
/// Pings before anything is decided; found.
const LEAST_PINGS: f32 = 64.0;
/// Fraction of observations; found.
/// Share of observations from one azimuth sector beyond which a structure was seen from nowhere else.
const ONE_SECTOR: f32 = 0.98;
/// Voxels left open; found.
/// What a pose leaves open, in voxels, beyond which finer Gaussians show nothing finer.
const BLURRED_VOXELS: f32 = 0.8;
/// Voxels of jitter; found.
/// Poses that jitter by so many voxels smear echoes: darkness from every azimuth sector is needed to tell.
const SMEARED_VOXELS: f32 = 1.0;
/// Bins a ping, found.
/// Bins a ping that another sonar's pulses fill, from which on there is one: where there is none, noise and echoes pass for
/// at most 0.003.
const INTERFERED_BINS: f64 = 0.01;
/// Fraction of pings left out; found.
/// Share of pings left out that is worth saying.
const WORTH_SAYING: f32 = 0.05;

/// Cheap statistics of the running dive.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cues {
    pings: f32,
    /// Pings with an echo, and runs of echoes in them.
    echoing: f32,
    runs: f32,
    /// Observations towards each azimuth sector of 90°.
    towards: [f32; 4],
    /// What poses leave open at the range of echoes, metres, mean of late.
    blur_m: f32,
    /// What poses jitter by in the middle of the range, metres, mean of late.
    jitter_m: f32,
}

/// What a ping tells [`Cues`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cue {
    /// Runs of echoes.
    pub(crate) runs: usize,
    /// How independent an observation it is, 0 to 1.
    pub(crate) weight: f32,
    /// Azimuth sector of 90° it looks towards.
    pub(crate) sector: usize,
    pub(crate) blur_m: f32,
    pub(crate) jitter_m: f32,
}

impl Cues {
    pub(crate) fn add(&mut self, cue: Cue) {
        /// Weight of a new blur; found.
        const RATE: f32 = 0.01;
        self.pings += 1.0;
        if cue.runs > 0 {
            self.echoing += 1.0;
            self.runs += cue.runs as f32;
            self.towards[cue.sector] += cue.weight;
        }
        let of_late = |before: &mut f32, now: f32| {
            let from = if *before > 0.0 { *before } else { now };
            *before = from + RATE * (now - from);
        };
        of_late(&mut self.blur_m, cue.blur_m);
        of_late(&mut self.jitter_m, cue.jitter_m);
    }

    fn runs_per_ping(&self) -> f32 {
        self.runs / self.echoing.max(1.0)
    }

    fn most_in_one_sector(&self) -> f32 {
        let all: f32 = self.towards.iter().sum();
        self.towards.iter().copied().fold(0.0, f32::max) / all.max(f32::MIN_POSITIVE)
    }
}

/// What the map itself adds to the decision.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct MapCues {
    pub(crate) voxel_m: f32,
    /// Pings left out as redundant.
    pub(crate) redundant: u64,
    /// Bins that another sonar's pulses filled, per ping.
    pub(crate) interfered_bins: f64,
    /// Whether pings show what may be ground or reverberation.
    pub(crate) is_ground_open: bool,
}

/// Settings and statistics to what is at work, and what is left out.
pub(crate) fn decide(features: &Features, cues: &Cues, map: MapCues) -> (AtWork, Vec<LeftOut>) {
    let mut left_out = Vec::new();
    let mut use_feature = |feature: &'static str, switch: Switch, reason: Option<String>| {
        let why = match (switch, reason) {
            (Switch::On, _) | (Switch::Auto, None) => return true,
            (Switch::Off, _) => "switched off".to_owned(),
            (Switch::Auto, Some(why)) => why,
        };
        left_out.push(LeftOut { feature, why });
        false
    };
    let known = cues.pings >= LEAST_PINGS && cues.echoing > 0.0;
    let if_so = |so: bool, why: String| (known && so).then_some(why);
    let runs = cues.runs_per_ping();
    let in_one_sector = cues.most_in_one_sector();
    let voxels = |metres: f32| metres / map.voxel_m.max(f32::MIN_POSITIVE);
    let (blur, jitter) = (voxels(cues.blur_m), voxels(cues.jitter_m));
    let smeared = known && jitter >= SMEARED_VOXELS;
    let at_work = AtWork {
        smeared,
        interfered: map.interfered_bins >= INTERFERED_BINS,
        occlusion: use_feature(
            "occlusion",
            features.occlusion,
            if_so(
                runs <= ALONE,
                format!("{runs:.2} runs of echoes a ping: nothing lies behind anything"),
            ),
        ),
        elevation: use_feature("elevation", features.elevation, None),
        anisotropy: use_feature("anisotropy", features.anisotropy, None),
        speckle: use_feature("speckle", features.speckle, None),
        specular: use_feature(
            "specular",
            features.specular,
            if_so(
                in_one_sector >= ONE_SECTOR,
                format!(
                    "{:.0} % of observations from one azimuth sector",
                    100.0 * in_one_sector
                ),
            ),
        ),
        specular_returns: use_feature(
            "glints",
            features.glints,
            if_so(
                smeared,
                format!(
                    "poses jitter by {jitter:.1} voxels: darkness from every azimuth sector counts"
                ),
            ),
        ),
        splitting: use_feature(
            "splitting",
            features.splitting,
            if_so(
                blur >= BLURRED_VOXELS,
                format!("poses leave {blur:.1} voxels open: finer shows nothing finer"),
            ),
        ),
        converged: features.converged.into(),
        redundant: features.redundant.into(),
        empty: features.empty.into(),
    };
    // The layer itself knows whether it is proven.
    let why = "its onset was not yet seen to follow the vehicle's height and tilt from places 1 m apart: it may be \
               reverberation";
    use_feature(
        "seabed",
        features.seabed,
        map.is_ground_open.then(|| why.to_owned()),
    );
    let mut tell_share = |feature, switch, share: f32, what| {
        if switch == Switch::Auto && known && share > WORTH_SAYING {
            let why = format!("{:.0} % of pings {what}", 100.0 * share);
            left_out.push(LeftOut { feature, why });
        }
    };
    let said_before = map.redundant as f32 / cues.pings.max(1.0);
    tell_share(
        "redundant",
        features.redundant,
        said_before,
        "say what the one before did",
    );
    let silent = 1.0 - cues.echoing / cues.pings.max(1.0);
    tell_share("empty", features.empty, silent, "have no echo");
    (at_work, left_out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A dive of pings with so many runs of echoes, looking towards so many azimuth sectors.
    fn dive(runs: usize, sectors: usize) -> Cues {
        let mut cues = Cues::default();
        for ping in 0..200 {
            cues.add(Cue {
                runs,
                weight: 0.5,
                sector: ping % sectors,
                blur_m: 0.03,
                jitter_m: 0.01,
            });
        }
        cues
    }

    const KNOWN: MapCues = MapCues {
        voxel_m: 0.05,
        redundant: 0,
        is_ground_open: false,
        interfered_bins: 0.003,
    };

    fn names(left_out: &[LeftOut]) -> Vec<&'static str> {
        left_out.iter().map(|out| out.feature).collect()
    }

    #[test]
    fn another_sonar_is_known_by_its_pulses() {
        let is_interfered =
            |map: MapCues| decide(&Features::default(), &dive(4, 4), map).0.interfered;
        assert!(!is_interfered(KNOWN));
        assert!(is_interfered(MapCues {
            interfered_bins: 0.05,
            ..KNOWN
        }));
    }

    #[test]
    fn ground_that_may_be_reverberation_is_told_and_so_is_one_switched_off() {
        let open = MapCues {
            is_ground_open: true,
            ..KNOWN
        };
        let why = |features: &Features, map: MapCues| {
            let (_, left_out) = decide(features, &dive(4, 4), map);
            let seabed = left_out.into_iter().find(|out| out.feature == "seabed");
            seabed.map(|out| out.why)
        };
        let off = Features {
            seabed: Switch::Off,
            ..Features::default()
        };
        assert_eq!(why(&Features::default(), KNOWN), None);
        assert!(
            why(&Features::default(), open)
                .unwrap()
                .contains("reverberation")
        );
        assert_eq!(why(&off, KNOWN).unwrap(), "switched off");
    }

    #[test]
    fn auto_leaves_out_what_a_dive_does_not_need_and_says_why() {
        let (_, of_rich) = decide(&Features::default(), &dive(3, 4), KNOWN);
        assert_eq!(of_rich, []);
        let (at_work, of_plain) = decide(&Features::default(), &dive(1, 1), KNOWN);
        assert_eq!(names(&of_plain), ["occlusion", "specular"]);
        assert!(!at_work.occlusion && at_work.splitting);
        assert!(of_plain[0].why.contains("1.00 runs"), "{}", of_plain[0].why);
    }

    #[test]
    fn jittering_poses_are_no_ground_to_expect_specular_returns() {
        let mut cues = dive(3, 4);
        assert!(
            decide(&Features::default(), &cues, KNOWN)
                .0
                .specular_returns
        );
        cues.jitter_m = 0.1;
        let (at_work, left_out) = decide(&Features::default(), &cues, KNOWN);
        assert!(!at_work.specular_returns);
        assert!(left_out[0].why.contains("2.0 voxels"), "{left_out:?}");
    }

    #[test]
    fn whether_maps_that_are_compared_expect_specular_returns_does_not_hang_on_how_crowded_each_is()
    {
        let of = |glints: Switch| {
            let features = Features {
                glints,
                ..Features::default()
            };
            features.for_comparison().glints
        };
        assert_eq!(of(Switch::Auto), Switch::Off);
        assert_eq!(of(Switch::On), Switch::On);
    }

    #[test]
    fn nothing_is_left_out_before_enough_is_known() {
        let mut cues = Cues::default();
        cues.add(Cue {
            runs: 1,
            weight: 1.0,
            sector: 0,
            blur_m: 1.0,
            jitter_m: 0.0,
        });
        assert_eq!(decide(&Features::default(), &cues, KNOWN).1, []);
    }

    #[test]
    fn what_is_switched_stays_as_it_is() {
        let features = Features {
            occlusion: Switch::On,
            splitting: Switch::Off,
            ..Features::default()
        };
        let (at_work, left_out) = decide(&features, &dive(1, 4), KNOWN);
        assert!(at_work.occlusion && !at_work.splitting);
        assert_eq!(names(&left_out), ["splitting"]);
        assert_eq!(left_out[0].why, "switched off");
    }
}
