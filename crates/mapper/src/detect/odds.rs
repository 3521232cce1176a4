//! What was found of a hypothesis, weighed against chance.

/// Nats, derived: 500 tries, a millionth.
/// Log ratio of the likelihoods of a hypothesis and of chance, from which on it is told: of 500 that are tried, one is told
/// by chance in a million dives.
pub(super) const LEAST_NATS: f64 = 20.0;

/// Log likelihood of `found` of `asked` independent questions, over that of a share of `chance` or less, less that over a
/// share of `least` or more, nats; NaN where nothing was asked.
pub(super) fn nats_over_chance(asked: f64, found: f64, chance: f64, least: f64) -> f64 {
    let share = found / asked;
    let unlikely = |by: f64| {
        let part = |of: f64, by: f64| if of > 0.0 { of * (of / by).ln() } else { 0.0 };
        part(share, by) + part(1.0 - share, 1.0 - by)
    };
    let by_chance = if share > chance {
        unlikely(chance)
    } else {
        0.0
    };
    let by_least = if share < least { unlikely(least) } else { 0.0 };
    asked * (by_chance - by_least)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_chance_speaks_for_it_and_less_than_expected_against() {
        // All of a hundred where half were expected: a hundred coins that fall alike.
        let coins = nats_over_chance(100.0, 100.0, 0.5, 0.7);
        assert!((coins - 100.0 * std::f64::consts::LN_2).abs() < 1e-9);
        assert!(nats_over_chance(1e4, 5e3, 0.5, 0.7) < -LEAST_NATS);
        // As far from either.
        let between = nats_over_chance(1e6, 4e5, 0.3, 0.5).abs();
        assert!(between < 0.1 * nats_over_chance(1e6, 5e5, 0.3, 0.5));
        assert!(!(nats_over_chance(0.0, 0.0, 0.5, 0.7) >= LEAST_NATS));
    }
}
