//! What the observations of one Gaussian add up to.

use echosplat_measurement::SymmetricMat3;
use echosplat_model::glam::Vec3;

use super::common_error::{CommonError, Faded};
use crate::refine::expectation::Score;

/// View statistics: sums over all lit observations of one Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ViewStatistics {
    /// Independent lit observations.
    pub(crate) observations: f32,
    /// Of these, observations through a confident surface that should hide it.
    pub(crate) hidden_observations: f32,
    /// Of all, observations whose echo comes from its surroundings alone, or nearly.
    pub(crate) clear_observations: f32,
    /// Log likelihood ratio of all observations, dark ones too: that its surroundings send back what they do, against
    /// nothing.
    pub(crate) odds: f32,
    /// Explained-energy ratio, summed over the observations: what its surroundings explain of the echo over what the best
    /// place on the same arc does.
    pub(crate) explained_ratio: f32,
    /// Sum over the observations of the fraction of what its surroundings send back that comes from their middle.
    pub(crate) compactness: f32,
    /// Sums over the observations of its mirror image above or below the beam's axis, metres from the Gaussian's home, and
    /// of its square.
    pub(crate) mirror_m: Vec3,
    pub(crate) mirror_m2: f32,
}

impl ViewStatistics {
    pub(crate) fn add(&mut self, other: &Self) {
        self.observations += other.observations;
        self.hidden_observations += other.hidden_observations;
        self.clear_observations += other.clear_observations;
        self.odds += other.odds;
        self.explained_ratio += other.explained_ratio;
        self.compactness += other.compactness;
        self.mirror_m += other.mirror_m;
        self.mirror_m2 += other.mirror_m2;
    }

    /// As if each observation had been made so many times.
    fn times(self, count: f32) -> Self {
        Self {
            observations: self.observations * count,
            hidden_observations: self.hidden_observations * count,
            clear_observations: self.clear_observations * count,
            odds: self.odds * count,
            explained_ratio: self.explained_ratio * count,
            compactness: self.compactness * count,
            mirror_m: self.mirror_m * count,
            mirror_m2: self.mirror_m2 * count,
        }
    }
}

/// What the observations of some pings say of one Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Finding {
    pub(crate) statistics: ViewStatistics,
    /// Fisher information of its mean, 1/m².
    pub(crate) information: SymmetricMat3,
    /// What the gradient of its mean changes by were all echoes a metre nearer, 1/m².
    pub(crate) nearer: Vec3,
    /// The error that the poses of its observations give its place.
    pub(crate) of_poses: CommonError,
}

impl Finding {
    /// Adds one observation with this score, at a time in time constants of its pose's error, which makes `pose_m2` of the
    /// place.
    pub(crate) fn add_observation(
        &mut self,
        score: &Score,
        pose_m2: SymmetricMat3,
        at: f64,
        faded: &mut Faded,
    ) {
        let weight = score.information.diagonal.element_sum();
        add(&mut self.information, &score.information);
        self.nearer += score.nearer;
        self.of_poses
            .add_faded(&CommonError::of_observation(weight, pose_m2, at), faded);
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.statistics.add(&other.statistics);
        add(&mut self.information, &other.information);
        self.nearer += other.nearer;
        self.of_poses.add(&other.of_poses);
    }

    /// As if each observation had been made so many times.
    pub(crate) fn times(self, count: f32) -> Self {
        Self {
            statistics: self.statistics.times(count),
            information: times(self.information, count),
            nearer: self.nearer * count,
            of_poses: self.of_poses.times(count),
        }
    }

    /// With the information multiplied by this factor.
    pub(crate) fn with_information(self, factor: f32) -> Self {
        Self {
            information: times(self.information, factor),
            nearer: self.nearer * factor,
            of_poses: self.of_poses.times(factor),
            ..self
        }
    }
}

pub(super) fn add(sum: &mut SymmetricMat3, other: &SymmetricMat3) {
    sum.diagonal += other.diagonal;
    sum.mixed += other.mixed;
}

pub(super) fn times(matrix: SymmetricMat3, factor: f32) -> SymmetricMat3 {
    SymmetricMat3 {
        diagonal: matrix.diagonal * factor,
        mixed: matrix.mixed * factor,
    }
}
