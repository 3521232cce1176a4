//! What looks found of one Gaussian.

use echosplat_acoustics::SymmetricMat3;
use echosplat_model::glam::Vec3;

use super::common_error::CommonError;
use crate::refine::expectation::Pull;

/// What was seen of one Gaussian over all looks that lit it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Account {
    /// Independent lit looks.
    pub(crate) looks: f32,
    /// Of these, looks past a confident surface that should hide it.
    pub(crate) hidden_looks: f32,
    /// Of all, looks whose echo comes from its surroundings alone, or nearly.
    pub(crate) clear_looks: f32,
    /// Log likelihood ratio of all looks, dark ones too: that its surroundings send back what they do, against nothing.
    pub(crate) odds: f32,
    /// Sum over looks of what its surroundings explain against the best place on the same arc.
    pub(crate) rivalry: f32,
    /// Sum over looks of the part of what its surroundings send back that comes from their middle.
    pub(crate) compactness: f32,
    /// Sums over looks of its mirror image above or below the beam's axis, metres from the
    /// Gaussian's home, and of its square.
    pub(crate) mirror_m: Vec3,
    pub(crate) mirror_m2: f32,
}

impl Account {
    pub(crate) fn add(&mut self, part: &Self) {
        self.looks += part.looks;
        self.hidden_looks += part.hidden_looks;
        self.clear_looks += part.clear_looks;
        self.odds += part.odds;
        self.rivalry += part.rivalry;
        self.compactness += part.compactness;
        self.mirror_m += part.mirror_m;
        self.mirror_m2 += part.mirror_m2;
    }

    /// As if each look had been made so many times.
    fn times(self, count: f32) -> Self {
        Self {
            looks: self.looks * count,
            hidden_looks: self.hidden_looks * count,
            clear_looks: self.clear_looks * count,
            odds: self.odds * count,
            rivalry: self.rivalry * count,
            compactness: self.compactness * count,
            mirror_m: self.mirror_m * count,
            mirror_m2: self.mirror_m2 * count,
        }
    }
}

/// What the looks of some pings say of one Gaussian.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Finding {
    pub(crate) account: Account,
    /// Fisher information of its mean, 1/m².
    pub(crate) information: SymmetricMat3,
    /// What the gradient of its mean changes by were all echoes a metre nearer, 1/m².
    pub(crate) nearer: Vec3,
    /// What its looks' poses make of its place.
    pub(crate) of_poses: CommonError,
}

impl Finding {
    /// Adds one look, by what it says of the mean, at a time in time constants of its pose's error, which makes `pose_m2` of
    /// the place.
    pub(crate) fn add_look(&mut self, pull: &Pull, pose_m2: SymmetricMat3, at: f64) {
        let weight = pull.information.diagonal.element_sum();
        add(&mut self.information, &pull.information);
        self.nearer += pull.nearer;
        self.of_poses
            .add(&CommonError::of_look(weight, pose_m2, at));
    }

    pub(crate) fn add(&mut self, part: &Self) {
        self.account.add(&part.account);
        add(&mut self.information, &part.information);
        self.nearer += part.nearer;
        self.of_poses.add(&part.of_poses);
    }

    /// As if each look had been made so many times.
    pub(crate) fn times(self, count: f32) -> Self {
        Self {
            account: self.account.times(count),
            information: times(self.information, count),
            nearer: self.nearer * count,
            of_poses: self.of_poses.times(count),
        }
    }

    /// With the information of looks as many times as sharp.
    pub(crate) fn with_information(self, factor: f32) -> Self {
        Self {
            information: times(self.information, factor),
            nearer: self.nearer * factor,
            of_poses: self.of_poses.times(factor),
            ..self
        }
    }
}

pub(super) fn add(sum: &mut SymmetricMat3, part: &SymmetricMat3) {
    sum.diagonal += part.diagonal;
    sum.mixed += part.mixed;
}

pub(super) fn times(matrix: SymmetricMat3, factor: f32) -> SymmetricMat3 {
    SymmetricMat3 {
        diagonal: matrix.diagonal * factor,
        mixed: matrix.mixed * factor,
    }
}
