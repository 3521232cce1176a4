//! Whether what a map says of its own certainty holds: errors against the covariances it gives, and how often there is
//! surface where it says how likely there is.

use echosplat_model::{Gaussian, Standing};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::Truth;
use crate::statistics::share;

/// Groups of Gaussians, by sigma or by probability.
const GROUPS: usize = 10;
/// A Gaussian's probability is that of surface this near.
const NEAR_M: f64 = 0.10;

/// A tenth of what is asserted, by sigma across the surface.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SigmaTenth {
    /// Root mean square of the distances to truth, metres.
    pub error_m: f64,
    /// Root mean square of the sigmas along truth's normal, metres.
    pub sigma_m: f64,
    /// How many there are.
    pub count: usize,
}

/// All Gaussians, ambiguous ones too, whose probability is within the same tenth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ProbabilityTenth {
    /// Mean of the probabilities.
    pub said: f64,
    /// Share of them that have truth within 0.10 m.
    pub found: f64,
    /// How many there are.
    pub count: usize,
}

/// How far the map's own word can be trusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Certainty {
    /// Share of what is asserted whose distance to truth is within two sigma along truth's normal.
    pub within_two_sigma_share: f64,
    /// From the surest to the least sure.
    pub sigma_tenths: Vec<SigmaTenth>,
    /// Those of 0 to 0.1, 0.1 to 0.2 and so on that there are any of.
    pub probability_tenths: Vec<ProbabilityTenth>,
}

impl Certainty {
    /// Of several maps together: their tenths by sigma, in order of sigma, are cut where a tenth of all is full. `None`
    /// of none.
    #[must_use]
    pub fn pooled(of_maps: &[&Self]) -> Option<Self> {
        let mut parts: Vec<SigmaTenth> = of_maps
            .iter()
            .flat_map(|of_map| of_map.sigma_tenths.iter().copied())
            .collect();
        parts.sort_unstable_by(|a, b| a.sigma_m.total_cmp(&b.sigma_m));
        let count_of = |of_map: &Self| {
            let tenths = of_map.sigma_tenths.iter();
            tenths.map(|tenth| tenth.count as f64).sum::<f64>()
        };
        let counts: Vec<f64> = of_maps.iter().map(|of_map| count_of(of_map)).collect();
        let total: f64 = counts.iter().sum();
        let within = of_maps.iter().zip(&counts);
        let within = within.map(|(of_map, count)| of_map.within_two_sigma_share * count);
        (total > 0.0).then(|| Self {
            within_two_sigma_share: within.sum::<f64>() / total,
            sigma_tenths: (0..GROUPS)
                .map(|tenth| pooled_tenth(&parts, total / GROUPS as f64, tenth))
                .collect(),
            probability_tenths: (0..GROUPS)
                .filter_map(|group| pooled_group(of_maps, group))
                .collect(),
        })
    }

    /// Error over sigma of the tenth where it is furthest from 1 either way, at least 1.
    #[must_use]
    pub fn worst_sigma_ratio(&self) -> f64 {
        let ratio = |tenth: &SigmaTenth| {
            let ratio = tenth.error_m / tenth.sigma_m;
            ratio.max(ratio.recip())
        };
        self.sigma_tenths.iter().map(ratio).fold(1.0, f64::max)
    }

    /// By how much the probabilities of a group of at least so many Gaussians miss what is found, at most.
    #[must_use]
    pub fn worst_probability_error(&self, least_count: usize) -> f64 {
        let groups = self.probability_tenths.iter();
        groups
            .filter(|group| group.count >= least_count)
            .map(|group| (group.said - group.found).abs())
            .fold(0.0, f64::max)
    }
}

/// Of groups in order of sigma, what lies between `tenth` and `tenth + 1` times `size`.
fn pooled_tenth(parts: &[SigmaTenth], size: f64, tenth: usize) -> SigmaTenth {
    let (low, high) = (size * tenth as f64, size * (tenth + 1) as f64);
    let (mut passed, mut inside, mut error_m2, mut sigma_m2) = (0.0_f64, 0.0, 0.0, 0.0);
    for part in parts {
        let (from, to) = (passed, passed + part.count as f64);
        let overlap = (to.min(high) - from.max(low)).max(0.0);
        inside += overlap;
        error_m2 += overlap * part.error_m.powi(2);
        sigma_m2 += overlap * part.sigma_m.powi(2);
        passed = to;
    }
    SigmaTenth {
        error_m: (error_m2 / inside).sqrt(),
        sigma_m: (sigma_m2 / inside).sqrt(),
        count: inside.round() as usize,
    }
}

/// All of the maps whose probability is in the same tenth.
fn pooled_group(of_maps: &[&Certainty], group: usize) -> Option<ProbabilityTenth> {
    let is_here = |tenth: &&ProbabilityTenth| group_of(tenth.said) == group;
    let here: Vec<&ProbabilityTenth> = of_maps
        .iter()
        .flat_map(|of_map| of_map.probability_tenths.iter().filter(is_here))
        .collect();
    let count: usize = here.iter().map(|tenth| tenth.count).sum();
    let mean = |value: fn(&ProbabilityTenth) -> f64| {
        let sum: f64 = here
            .iter()
            .map(|tenth| value(tenth) * tenth.count as f64)
            .sum();
        sum / count as f64
    };
    (count > 0).then(|| ProbabilityTenth {
        said: mean(|tenth| tenth.said),
        found: mean(|tenth| tenth.found),
        count,
    })
}

/// Which tenth a probability is in.
fn group_of(probability: f64) -> usize {
    ((probability * GROUPS as f64) as usize).min(GROUPS - 1)
}

/// Of Gaussians relative to `origin_m`. `None` unless truth has normals and the map gives covariances.
#[must_use]
pub fn certainty(origin_m: DVec3, gaussians: &[Gaussian], truth: &Truth) -> Option<Certainty> {
    let all: Vec<Told> = gaussians
        .par_iter()
        .filter_map(|gaussian| Told::of(origin_m, gaussian, truth))
        .collect();
    let asserted = all.iter().filter(|told| told.is_confident);
    let mut known: Vec<Told> = asserted
        .filter(|told| told.sigma_m.is_finite())
        .copied()
        .collect();
    if known.is_empty() {
        return None;
    }
    known.sort_unstable_by(|a, b| a.sigma_m.total_cmp(&b.sigma_m));
    let tenths = known.chunks(known.len().div_ceil(GROUPS));
    Some(Certainty {
        within_two_sigma_share: share(&known, |told| told.error_m <= 2.0 * told.sigma_m),
        sigma_tenths: tenths.map(sigma_tenth).collect(),
        probability_tenths: (0..GROUPS)
            .filter_map(|group| probability_tenth(&all, group))
            .collect(),
    })
}

/// One Gaussian and the truth nearest to it.
#[derive(Debug, Clone, Copy)]
struct Told {
    error_m: f64,
    sigma_m: f64,
    probability: f64,
    is_confident: bool,
}

impl Told {
    fn of(origin_m: DVec3, gaussian: &Gaussian, truth: &Truth) -> Option<Self> {
        let (error_m, normal, _) = truth.nearest(origin_m + gaussian.mean_m.as_dvec3());
        let normal = normal.try_normalize()?;
        let [xx, xy, xz, yy, yz, zz] = gaussian.position_covariance_m2.map(f64::from);
        let covariance_m2 = DMat3::from_cols_array_2d(&[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]);
        Some(Self {
            error_m,
            sigma_m: normal.dot(covariance_m2 * normal).sqrt(),
            probability: gaussian.probability.into(),
            is_confident: gaussian.standing == Standing::Confident,
        })
    }
}

fn sigma_tenth(tenth: &[Told]) -> SigmaTenth {
    let rms = |value: fn(&Told) -> f64| {
        let sum: f64 = tenth.iter().map(|told| value(told).powi(2)).sum();
        (sum / tenth.len() as f64).sqrt()
    };
    SigmaTenth {
        error_m: rms(|told| told.error_m),
        sigma_m: rms(|told| told.sigma_m),
        count: tenth.len(),
    }
}

fn probability_tenth(all: &[Told], group: usize) -> Option<ProbabilityTenth> {
    let here: Vec<Told> = all
        .iter()
        .filter(|told| group_of(told.probability) == group)
        .copied()
        .collect();
    let said: f64 = here.iter().map(|told| told.probability).sum();
    (!here.is_empty()).then(|| ProbabilityTenth {
        said: said / here.len() as f64,
        found: share(&here, |told| told.error_m <= NEAR_M),
        count: here.len(),
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use echosplat_model::glam::{Quat, Vec3};
    use echosplat_simulator::Scene;

    use super::*;

    /// A ball of radius 1 m.
    fn ball() -> Truth {
        let scene = "name = \"ball\"\n[[sphere]]\ncenter_m = [0, 0, 0]\nradius_m = 1\n";
        Truth::from_scene(&Arc::new(Scene::parse(scene, None).unwrap()), None)
    }

    /// On the x axis, so far outside the ball, with these sigmas across and along its surface.
    fn outside(id: u32, error_m: f32, sigma_m: [f32; 2], probability: f32) -> Gaussian {
        let [across_m2, along_m2] = sigma_m.map(|sigma_m| sigma_m * sigma_m);
        Gaussian {
            id,
            mean_m: Vec3::X * (1.0 + error_m),
            rotation: Quat::IDENTITY,
            scale_m: Vec3::splat(0.02),
            opacity: 0.5,
            reflectivity: 0.5,
            sigma_m: sigma_m[1],
            position_covariance_m2: [across_m2, 0.0, 0.0, along_m2, 0.0, along_m2],
            probability,
            standing: Standing::Confident,
            why: echosplat_model::Why::default(),
        }
    }

    #[test]
    fn errors_are_held_against_sigma_across_the_surface() {
        // Nine are off by one sigma, one by three.
        let map: Vec<Gaussian> = (0..10_u8)
            .map(|i| {
                let error_m = if i == 9 { 0.06 } else { 0.02 };
                outside(i.into(), error_m, [0.02 + 1e-5 * f32::from(i), 3.0], 0.95)
            })
            .collect();
        let found = certainty(DVec3::ZERO, &map, &ball()).unwrap();
        assert!((found.within_two_sigma_share - 0.9).abs() < 1e-9);
        let (first, last) = (found.sigma_tenths[0], found.sigma_tenths[9]);
        assert!((first.error_m - 0.02).abs() < 1e-6 && (first.sigma_m - 0.02).abs() < 1e-6);
        assert!((last.error_m - 0.06).abs() < 1e-6 && last.count == 1);
    }

    #[test]
    fn probabilities_are_held_against_what_is_found() {
        let mut map: Vec<Gaussian> = (0..4)
            .map(|i| outside(i, if i == 0 { 0.05 } else { 0.5 }, [0.02, 0.02], 0.25))
            .collect();
        map.push(outside(4, 0.0, [0.02, 0.02], 1.0));
        map[1].standing = Standing::Ambiguous;
        let found = certainty(DVec3::ZERO, &map, &ball())
            .unwrap()
            .probability_tenths;
        let expected = [(0.25, 0.25, 4), (1.0, 1.0, 1)];
        assert_eq!(found.len(), expected.len());
        for (tenth, (said, share, count)) in found.iter().zip(expected) {
            assert!((tenth.said - said).abs() < 1e-6 && (tenth.found - share).abs() < 1e-6);
            assert_eq!(tenth.count, count);
        }
    }

    #[test]
    fn maps_are_pooled_by_sigma_and_by_probability() {
        // Half as many of one map, surer and twice as far off as it says.
        let map = |count: u32, sigma_m: f32, times: f32, probability: f32| -> Vec<Gaussian> {
            let one = |id| outside(id, times * sigma_m, [sigma_m, 3.0], probability);
            (0..count).map(one).collect()
        };
        let of = |map: &[Gaussian]| certainty(DVec3::ZERO, map, &ball()).unwrap();
        let (sure, unsure) = (
            of(&map(50, 0.01, 2.5, 0.95)),
            of(&map(100, 0.03, 1.0, 0.75)),
        );
        let all = Certainty::pooled(&[&unsure, &sure]).unwrap();
        assert!((all.within_two_sigma_share - 2.0 / 3.0).abs() < 1e-9);
        let ratio =
            |tenth: usize| all.sigma_tenths[tenth].error_m / all.sigma_tenths[tenth].sigma_m;
        assert!((ratio(0) - 2.5).abs() < 1e-3 && (ratio(9) - 1.0).abs() < 1e-3);
        // A third of all is within the fourth tenth: a third of it is of the sure map.
        assert!((all.sigma_tenths[3].sigma_m.powi(2) - (1e-4 + 2.0 * 9e-4) / 3.0).abs() < 1e-6);
        assert!(all.sigma_tenths.iter().all(|tenth| tenth.count == 15));
        assert!((all.worst_sigma_ratio() - 2.5).abs() < 1e-3);
        let counts: Vec<usize> = all.probability_tenths.iter().map(|t| t.count).collect();
        assert_eq!(counts, [100, 50]);
        assert!((all.worst_probability_error(51) - 0.25).abs() < 1e-6);
        assert!(all.worst_probability_error(101) == 0.0);
        assert_eq!(Certainty::pooled(&[]), None);
    }

    #[test]
    fn a_map_without_covariances_says_nothing() {
        let map = [outside(0, 0.1, [f32::INFINITY, f32::INFINITY], 1.0)];
        assert_eq!(certainty(DVec3::ZERO, &map, &ball()), None);
    }
}
