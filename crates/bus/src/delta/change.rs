//! How two states of a Gaussian, or of a tile, differ.

use std::cmp::Ordering;

use echosplat_model::{Gaussian, GaussianId, Standing};

/// Everything of a Gaussian as bits; two are the same if and only if these are.
pub(crate) fn bits(gaussian: &Gaussian) -> [u32; 23] {
    let m = gaussian.mean_m;
    let q = gaussian.rotation;
    let s = gaussian.scale_m;
    let [xx, xy, xz, yy, yz, zz] = gaussian.position_covariance_m2.map(f32::to_bits);
    let [reason, clear, measured] = gaussian.why.bytes();
    [
        gaussian.id,
        m.x.to_bits(),
        m.y.to_bits(),
        m.z.to_bits(),
        q.x.to_bits(),
        q.y.to_bits(),
        q.z.to_bits(),
        q.w.to_bits(),
        s.x.to_bits(),
        s.y.to_bits(),
        s.z.to_bits(),
        gaussian.opacity.to_bits(),
        gaussian.reflectivity.to_bits(),
        gaussian.sigma_m.to_bits(),
        xx,
        xy,
        xz,
        yy,
        yz,
        zz,
        gaussian.probability.to_bits(),
        u32::from(gaussian.standing == Standing::Confident),
        u32::from_le_bytes([reason, clear, measured, 0]),
    ]
}

/// One entry of a tile that is to be sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Change<'g> {
    pub(super) id: GaussianId,
    /// The new state; `None` where it is gone.
    pub(super) now: Option<&'g Gaussian>,
    /// How much it matters, above 0, at most 1.
    pub(super) score: f64,
}

/// What leads from the tile `old` to the tile `new`, both in order of id, in order of id.
pub(super) fn changes<'g>(old: &[Gaussian], new: &'g [Gaussian]) -> Vec<Change<'g>> {
    let mut found = Vec::new();
    let (mut old, mut new) = (old, new);
    loop {
        let order = match (old.first(), new.first()) {
            (None, None) => return found,
            (Some(_), None) => Ordering::Less,
            (None, Some(_)) => Ordering::Greater,
            (Some(was), Some(is)) => was.id.cmp(&is.id),
        };
        if order == Ordering::Equal && bits(&old[0]) != bits(&new[0]) {
            found.push(change_of(&new[0], score(&old[0], &new[0])));
        }
        if order == Ordering::Less {
            found.push(Change {
                id: old[0].id,
                now: None,
                score: 1.0,
            });
        }
        if order == Ordering::Greater {
            found.push(change_of(&new[0], 1.0));
        }
        old = &old[usize::from(order != Ordering::Greater)..];
        new = &new[usize::from(order != Ordering::Less)..];
    }
}

fn change_of(now: &Gaussian, score: f64) -> Change<'_> {
    Change {
        id: now.id,
        now: Some(now),
        score,
    }
}

/// How different two states of one Gaussian look: its shift in units of its size, and what its
/// strength changed by. A change of standing counts as much as a new Gaussian.
fn score(was: &Gaussian, is: &Gaussian) -> f64 {
    if was.standing != is.standing {
        return 1.0;
    }
    let shift = was.mean_m.distance(is.mean_m) / is.scale_m.max_element();
    let growth = (was.scale_m - is.scale_m).length() / is.scale_m.max_element();
    let strength = (was.opacity - is.opacity).abs() + (was.reflectivity - is.reflectivity).abs();
    let score = 1e-3 + f64::from(shift + growth + strength);
    // NaN counts as a whole change.
    if score < 1.0 { score } else { 1.0 }
}

/// `old` with `changes` applied, both in order of id.
pub(super) fn applied(old: &[Gaussian], changes: &[Change<'_>]) -> Vec<Gaussian> {
    let mut merged = Vec::with_capacity(old.len() + changes.len());
    let mut rest = old;
    for change in changes {
        let kept = rest.partition_point(|gaussian| gaussian.id < change.id);
        merged.extend_from_slice(&rest[..kept]);
        rest = &rest[kept..];
        if rest
            .first()
            .is_some_and(|gaussian| gaussian.id == change.id)
        {
            rest = &rest[1..];
        }
        merged.extend(change.now.copied());
    }
    merged.extend_from_slice(rest);
    merged
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{gaussian, same};

    #[test]
    fn applying_the_changes_gives_the_new_tile() {
        let old: Vec<_> = [1, 2, 4, 7, 9].map(gaussian).to_vec();
        let mut new: Vec<_> = [0, 2, 4, 5, 9, 10].map(gaussian).to_vec();
        new[2].opacity = f32::from_bits(new[2].opacity.to_bits() + 1);
        let found = changes(&old, &new);
        let ids: Vec<_> = found.iter().map(|change| change.id).collect();
        assert_eq!(ids, [0, 1, 4, 5, 7, 10]);
        assert!(same(&applied(&old, &found), &new));
        assert!(changes(&new, &new).is_empty());
    }

    #[test]
    fn one_bit_is_a_change_but_a_small_one() {
        let a = gaussian(1);
        let mut b = a;
        b.mean_m.x = f32::from_bits(b.mean_m.x.to_bits() ^ 1);
        let found = changes(&[a], std::slice::from_ref(&b));
        assert_eq!(found.len(), 1);
        assert!(found[0].score < 0.01);
        let mut negative = a;
        negative.sigma_m = -0.0;
        let mut positive = a;
        positive.sigma_m = 0.0;
        assert_eq!(changes(&[negative], &[positive]).len(), 1);
    }

    #[test]
    fn scores_stay_within_bounds_whatever_the_numbers() {
        let a = gaussian(1);
        let mut far = a;
        far.mean_m.x = f32::MAX;
        let mut odd = a;
        odd.mean_m.x = f32::NAN;
        for b in [far, odd] {
            assert!((score(&a, &b) - 1.0).abs() < 1e-12);
        }
    }
}
