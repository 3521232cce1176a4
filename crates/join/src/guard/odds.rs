//! How sure it is that a run of poses is the track from now on, and not as many strays in a row.

/// Poses without the track, at least; found.
/// So many poses go on without the track at least, before they are believed.
pub(super) const LEAST_RUN: usize = 5;
/// Poses, at most; bounds memory.
/// And at most: all of them are held.
const LONGEST_RUN: f64 = 48.0;
/// Probability, assumed: once in hours at 50 poses/s.
/// That as many strays follow each other by chance may be so likely: once in hours of 50 poses a second.
const BY_CHANCE: f64 = 1e-6;
/// Poses of late; found.
const OF_LATE: f64 = 64.0;
/// Poses, assumed: one in four a stray.
/// Before any pose has come: one in four might be a stray.
const FIRST: Odds = Odds {
    refused: 1.0,
    all: 4.0,
};

/// How common poses are of late that do not continue the track.
#[derive(Debug, Clone, Copy)]
pub(super) struct Odds {
    refused: f64,
    all: f64,
}

impl Default for Odds {
    fn default() -> Self {
        FIRST
    }
}

impl Odds {
    pub(super) fn taken(&mut self, count: u64) {
        self.add(0.0, count as f64);
    }

    pub(super) fn refused(&mut self, count: u64) {
        self.add(count as f64, count as f64);
    }

    fn add(&mut self, refused: f64, all: f64) {
        let kept = (1.0 - all / OF_LATE).max(0.0);
        let kept = if self.all + all > OF_LATE { kept } else { 1.0 };
        self.refused = kept * self.refused + refused;
        self.all = kept * self.all + all;
    }

    /// Poses that have to go on from each other while the track is silent: with a share s of strays, n of them follow each other
    /// with the probability sⁿ.
    pub(super) fn least_run(&self) -> usize {
        let share = (self.refused / self.all).clamp(1e-3, 0.99);
        let run = (BY_CHANCE.ln() / share.ln()).ceil();
        LEAST_RUN.max(run.min(LONGEST_RUN) as usize)
    }
}

/// Which of two lines of stamps of one vehicle is followed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Preference {
    /// Poses of late on the line followed, and on another that is nearer to when they arrive.
    followed: f64,
    nearer: f64,
}

/// Share of poses on a line; found.
/// Of two lines that about as many poses are on, as these are of all.
const ABOUT_HALF: f64 = 0.4;

impl Preference {
    pub(super) fn taken(&mut self) {
        self.forget();
        self.followed += 1.0;
    }

    /// One of the other line; whether that is to be followed.
    pub(super) fn refused(&mut self) -> bool {
        self.forget();
        self.nearer += 1.0;
        let is_common = self.nearer >= ABOUT_HALF * (self.nearer + self.followed);
        is_common && self.nearer >= LEAST_RUN as f64 - 0.5
    }

    fn forget(&mut self) {
        if self.followed + self.nearer > OF_LATE {
            let kept = 1.0 - 1.0 / OF_LATE;
            (self.followed, self.nearer) = (kept * self.followed, kept * self.nearer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Poses that have to go on after many of which `refused` in `all` were strays.
    fn least_run(refused: u64, all: u64) -> usize {
        let mut odds = Odds::default();
        for _ in 0..400 {
            odds.refused(refused);
            odds.taken(all - refused);
        }
        odds.least_run()
    }

    #[test]
    fn the_commoner_strays_are_the_longer_a_run_is_asked_for() {
        assert_eq!(least_run(0, 1), LEAST_RUN);
        assert!((5..8).contains(&least_run(1, 50)));
        assert!((18..23).contains(&least_run(1, 2)), "{}", least_run(1, 2));
        assert_eq!(least_run(9, 10), 48);
        assert!((8..12).contains(&Odds::default().least_run()));
    }

    #[test]
    fn a_line_is_left_for_one_that_as_many_are_on_and_not_for_a_few() {
        let switches = |followed: u32| {
            let mut preference = Preference::default();
            (0..200).any(|_| {
                (0..followed).for_each(|_| preference.taken());
                preference.refused()
            })
        };
        assert!(switches(0) && switches(1));
        assert!(!switches(2) && !switches(50));
    }
}
