//! Echoes that are heard again further out, and so say nothing of the place they seem to come from.

use echosplat_measurement::PingGeometry;

use crate::detect::mirror::{Mirror, Source};
use crate::detect::profile::{Backdrop, Profile};
use crate::detect::recurrences::Recurrences;

/// At a ratio of their range, at a distance behind it, and by way of the water's surface.
#[derive(Debug, Default)]
pub(crate) struct Repeats {
    recurrences: Recurrences,
    mirror: Mirror,
}

impl Repeats {
    /// Whether echoes are known to come back.
    pub(crate) fn are_known(&self) -> bool {
        self.recurrences.are_told() || self.mirror.height_m().is_some()
    }

    /// Height of the water's surface above the first ping, metres, if images in it are heard.
    pub(crate) fn surface_m(&self) -> Option<f32> {
        self.mirror.height_m()
    }

    /// Whether it is time for [`Repeats::set_sources`].
    pub(crate) fn wants_sources(&self) -> bool {
        self.mirror.wants_sources()
    }

    /// The confident Gaussians in reach of the pings to come.
    pub(crate) fn set_sources(&mut self, sources: Vec<Source>) {
        self.mirror.set_sources(sources);
    }

    /// Learns from a ping that counts `weight`; all its echoes have to be in the profile.
    pub(crate) fn listen(
        &mut self,
        geometry: &PingGeometry,
        intensity: &[f32],
        profile: &Profile,
        strongest: f32,
        weight: f32,
    ) {
        self.recurrences
            .listen(geometry, intensity, profile, strongest, weight);
        self.mirror
            .listen(geometry, intensity, profile, strongest, weight);
    }

    /// Forgets what pings said of a surface, before all are asked anew.
    pub(crate) fn ask_for_surface_anew(&mut self) {
        self.mirror.begin_anew();
    }

    /// Asks a ping of before, which counts `weight`, for images of the sources of now.
    pub(crate) fn ask_for_surface(
        &mut self,
        geometry: &PingGeometry,
        intensity: &[f32],
        profile: &Profile,
        weight: f32,
    ) {
        let strongest = profile.strongest_here();
        self.mirror
            .listen(geometry, intensity, profile, strongest, weight);
    }

    /// Tells echoes that may be others heard again, and judges the ping without them. Returns their bins.
    pub(crate) fn doubt(
        &self,
        geometry: &PingGeometry,
        intensity: &[f32],
        ground: &Backdrop,
        profile: &mut Profile,
    ) -> u64 {
        if !self.are_known() {
            return 0;
        }
        let runs = self.runs(geometry, intensity, profile);
        if runs.is_empty() {
            return 0;
        }
        let bins = runs
            .iter()
            .map(|&(start, end)| u64::from(end - start))
            .sum();
        profile.doubted = runs.into();
        profile.judge(intensity, ground);
        bins
    }

    /// Bins of a ping's echoes, half-open runs, that may be others heard again.
    fn runs(
        &self,
        geometry: &PingGeometry,
        intensity: &[f32],
        profile: &Profile,
    ) -> Vec<(u32, u32)> {
        let mut runs: Vec<(u32, u32)> = Vec::new();
        let blank = profile.first_bin();
        let images = self.mirror.explained(geometry, intensity);
        for bin in profile.echoes.iter().flat_map(|&(start, end)| start..end) {
            if !images[bin as usize] && !self.recurrences.explain(geometry, intensity, blank, bin) {
                continue;
            }
            match runs.last_mut() {
                Some((_, end)) if *end == bin => *end += 1,
                _ => runs.push((bin, bin + 1)),
            }
        }
        runs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::bin_state::BinState::{Blank, Dark, Lit};
    use crate::detect::heard::heard;

    #[test]
    fn an_echo_that_comes_back_says_nothing_and_what_hides_no_copy_does() {
        let mut repeats = Repeats::default();
        for step in 0..640 {
            let range_m = 3.0 + 2.0 * f64::from(step * 37 % 512) / 512.0;
            let heading_deg = 90.0 * f64::from(step % 7) / 6.0;
            let echoes = [(range_m, 1e4), (range_m + 1.3, 1e3)];
            let (geometry, power, profile, strongest) = heard(heading_deg, &echoes);
            repeats.listen(&geometry, &power, &profile, strongest, 1.0);
        }
        assert!(repeats.are_known());
        let echoes = [(4.0, 1e4), (5.3, 1e3), (8.0, 1e3)];
        let (geometry, power, mut profile, _) = heard(0.0, &echoes);
        let bins = repeats.doubt(&geometry, &power, &Backdrop::default(), &mut profile);
        assert_eq!(bins, 3);
        assert_eq!(*profile.echoes, [(199, 202), (399, 402)]);
        let states = [199, 262, 264, 265, 400].map(|bin| profile.state.at(bin));
        assert_eq!(states, [Lit, Dark, Blank, Blank, Lit]);
    }
}
