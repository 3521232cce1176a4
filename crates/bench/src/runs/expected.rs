//! How long a run will take, roughly, so that a grid can be planned and what is left be told.

use super::{Method, Spec};

/// Seconds of one run on one core of a common server: a dive of 240 s at nominal noise, simulated, mapped and
/// judged.
const SCENES_S: [(&str, f64); 9] = [
    ("empty", 15.0),
    ("fence", 45.0),
    ("fence-specular", 45.0),
    ("lander", 60.0),
    ("pipeline", 75.0),
    ("dolphin", 110.0),
    ("pier", 125.0),
    ("wall", 150.0),
    ("truss", 650.0),
];
/// Of any other scene.
const OTHER_S: f64 = 120.0;
const SURVEY_S: f64 = 240.0;
/// Of methods that take all pings at once, anew for each moment.
const BATCH_S: f64 = 45.0;

impl Spec {
    /// Good to a factor of two or so; a queue corrects it by what its runs took so far.
    #[must_use]
    pub(crate) fn expected_s(&self) -> f64 {
        let known = SCENES_S.iter().find(|(name, _)| *name == self.scene);
        let scene_s = known.map_or(OTHER_S, |(_, seconds)| *seconds);
        let length = self.duration_s.map_or(1.0, |seconds| seconds / SURVEY_S);
        match self.method {
            Method::Online => scene_s * length * self.share,
            Method::Support | Method::Carving | Method::Paper => BATCH_S * length,
        }
    }
}
