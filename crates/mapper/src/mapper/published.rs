//! The map as others see it.

use std::sync::Arc;

use echosplat_measurement::SymmetricMat3;
use echosplat_model::{Gaussian, GaussianId, Snapshot, Standing};
use rayon::prelude::*;

use crate::spawn::gaussians::{Gaussians, Verdict};
use crate::world::Placing;

/// Intensity per steradian that αρ = 1 stands for: above what a typical strongest echo needs, and a
/// power of two, so that the unit does not creep and every Gaussian with it. 1 before any echo.
pub(super) fn intensity_unit(unit_strength: f32) -> f32 {
    if !(unit_strength > 0.0) {
        return 1.0;
    }
    // Between the powers of two that are normal numbers.
    (4.0 * unit_strength)
        .log2()
        .ceil()
        .clamp(-126.0, 127.0)
        .exp2()
}

/// In the order of [`Gaussian::position_covariance_m2`].
fn upper_triangle(matrix: &SymmetricMat3) -> [f32; 6] {
    let (d, m) = (matrix.diagonal, matrix.mixed);
    [d.x, m.z, m.y, d.y, m.x, d.z]
}

/// What all published Gaussians are made with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Print {
    /// Intensity per steradian that αρ = 1 stands for.
    pub(super) unit: f32,
    /// Where the map's frame lies in the one it is published in.
    pub(super) placing: Placing,
}

/// Which Gaussian of the map stands there in what was last published.
#[derive(Debug, Clone, Copy)]
struct Row {
    id: GaussianId,
    slot: u32,
    /// See [`Gaussians::birth`]: the slot may hold another by now, with the same id even.
    birth: GaussianId,
}

/// What was last published of the map, from which all that is still there is copied: few of them are new.
#[derive(Debug, Default)]
pub(super) struct Published {
    last: Option<(Print, Arc<Snapshot>)>,
    /// Of the first Gaussians of that snapshot; behind them is ground.
    rows: Vec<Row>,
    /// None of them was born with this id or a later one.
    next_birth: GaussianId,
}

impl Published {
    /// Nothing is kept, and all is made anew next.
    pub(super) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Published Gaussians in order of id; what is not likely is ambiguous. What comes of them is to be kept by [`Self::keep`].
    ///
    /// Cost: a copy of each, and some 200 ns for one that is new.
    pub(super) fn of(&mut self, gaussians: &Gaussians, print: Print) -> Vec<Gaussian> {
        if self.last.as_ref().is_none_or(|(last, _)| *last != print) {
            self.forget();
        }
        let order = self.order(gaussians);
        let last = self.last.as_ref();
        let last = last.map_or(&[][..], |(_, snapshot)| &snapshot.gaussians);
        let gaussian = |&(row, from): &(Row, Option<u32>)| match from {
            Some(from) => last[from as usize],
            None => made(gaussians, row, print),
        };
        // As many as there are in order, so that each thread writes its share in place.
        let mut published: Vec<Gaussian> = order.par_iter().map(gaussian).collect();
        // What was published once was sound.
        let new = order.par_iter().zip(&published);
        let new = new.filter(|((_, from), _)| from.is_none());
        let is_sound = new.all(|(_, gaussian)| gaussian.is_sound());
        self.rows = order.into_iter().map(|(row, _)| row).collect();
        if !is_sound {
            let is_sound: Vec<bool> = published.iter().map(Gaussian::is_sound).collect();
            let mut of_rows = is_sound.iter();
            self.rows.retain(|_| of_rows.next() == Some(&true));
            published.retain(Gaussian::is_sound);
        }
        published
    }

    /// Those to be published in order of id, and where they stand in what was last published.
    fn order(&mut self, gaussians: &Gaussians) -> Vec<(Row, Option<u32>)> {
        let is_there = |row: &Row| {
            let slot = row.slot as usize;
            gaussians.alive[slot] && gaussians.birth[slot] == row.birth
        };
        let rows = self.rows.iter().zip(0..);
        let stay = rows.filter(|(row, _)| is_there(row));
        let mut order: Vec<_> = stay.map(|(&row, from)| (row, Some(from))).collect();
        let newest = order.last().map(|(row, _)| row.id);
        let (staying, first_birth) = (order.len(), self.next_birth);
        for slot in gaussians.slots() {
            let birth = gaussians.birth[slot];
            let is_shown = matches!(gaussians.verdict[slot], Verdict::Published(_));
            if birth >= first_birth && is_shown {
                let (id, slot) = (gaussians.id[slot], slot as u32);
                order.push((Row { id, slot, birth }, None));
                self.next_birth = self.next_birth.max(birth + 1);
            }
        }
        order[staying..].par_sort_unstable_by_key(|(row, _)| row.id);
        // What took another's place has its id.
        let first = order.get(staying).map(|(row, _)| row.id);
        if first.is_some() && first < newest {
            order.par_sort_unstable_by_key(|(row, _)| row.id);
        }
        order
    }

    /// What [`Self::of`] gave stands first in `snapshot`.
    pub(super) fn keep(&mut self, print: Print, snapshot: &Arc<Snapshot>) {
        self.last = Some((print, Arc::clone(snapshot)));
    }
}

/// As it is published. The gauge is that of (13): `α = √ρ`, so `αρ = ρ^{3/2}`.
fn made(gaussians: &Gaussians, row: Row, print: Print) -> Gaussian {
    let slot = row.slot as usize;
    let product = (gaussians.strongest(slot) / print.unit).clamp(1e-12, 1.0);
    let gaussian = Gaussian {
        id: row.id,
        mean_m: gaussians.mean_m[slot],
        rotation: gaussians.rotation[slot],
        scale_m: gaussians.scale_m[slot],
        opacity: product.cbrt(),
        reflectivity: product.cbrt() * product.cbrt(),
        sigma_m: gaussians.sigma_m[slot],
        position_covariance_m2: upper_triangle(&gaussians.position_covariance_m2[slot]),
        probability: gaussians.probability[slot],
        standing: match gaussians.verdict[slot] {
            Verdict::Published(standing) if gaussians.is_likely[slot] => standing,
            _ => Standing::Ambiguous,
        },
        why: gaussians.why[slot],
    };
    match gaussian.is_sound() {
        true => print.placing.leave(gaussian),
        false => gaussian,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spawn::gaussians::Stage;
    use echosplat_model::Timestamp;
    use echosplat_model::glam::{DVec3, Vec3};

    #[test]
    fn what_is_copied_from_the_last_map_is_what_would_be_made_anew() {
        let mut gaussians = Gaussians::default();
        let mut print = Print {
            unit: 1.0,
            placing: Placing::default(),
        };
        let mut published = Published::default();
        let mut source = Gaussians::default();
        for step in 0..40_u32 {
            for number in 0..7 {
                let at_m = Vec3::new(step as f32, number as f32, 0.0);
                let slot = gaussians.spawn(at_m, (0, 0), 0.1, 1.0) as usize;
                gaussians.sigma_m[slot] = 0.1;
                gaussians.position_covariance_m2[slot] = SymmetricMat3::isotropic(0.1);
                if number == 3 && step % 5 == 0 {
                    gaussians.mean_m[slot].z = f32::NAN;
                }
            }
            let slots: Vec<usize> = gaussians.slots().collect();
            for &slot in slots.iter().skip(step as usize % 3).step_by(4) {
                gaussians.remove(slot as u32);
            }
            if step % 3 == 0 {
                // As a work-out does: another one, in the same place or not, with the id of one that is gone.
                let gone = gaussians.slots().nth(step as usize / 2).unwrap();
                let id = gaussians.id[gone];
                gaussians.remove(gone as u32);
                let worked = source.spawn(Vec3::splat(step as f32), (0, 0), 0.2, 3.0) as usize;
                source.sigma_m[worked] = 0.2;
                source.position_covariance_m2[worked] = SymmetricMat3::isotropic(0.2);
                source.verdict[worked] = Verdict::Published(Standing::Confident);
                source.is_likely[worked] = true;
                let placed = gaussians.adopt(&source, worked, Stage::Worked);
                gaussians.id[placed as usize] = id;
            }
            if step == 20 {
                print.unit = 2.0;
            }
            let anew = Published::default().of(&gaussians, print);
            let found = published.of(&gaussians, print);
            assert_eq!(found, anew);
            assert!(found.is_sorted_by_key(|gaussian| gaussian.id));
            let snapshot = Snapshot {
                epoch: 1,
                sequence: 1,
                time: Timestamp::ZERO,
                through_ping: 0,
                origin_m: DVec3::ZERO,
                intensity_unit: print.unit,
                gaussians: found,
            };
            published.keep(print, &Arc::new(snapshot));
        }
        let last = published
            .last
            .as_ref()
            .map_or(0, |(_, map)| map.gaussians.len());
        assert!(last > 10 && published.rows.len() == last, "{last}");
    }

    #[test]
    fn what_is_not_likely_enough_is_shown_and_not_asserted_and_what_is_unsound_is_neither() {
        let mut gaussians = Gaussians::default();
        let unsound = gaussians.spawn(Vec3::NAN, (0, 0), 0.1, 1.0) as usize;
        gaussians.verdict[unsound] = Verdict::Published(Standing::Confident);
        for (verdict, is_likely) in [
            (Verdict::Published(Standing::Confident), true),
            (Verdict::Published(Standing::Confident), false),
            (Verdict::Published(Standing::Ambiguous), true),
            (Verdict::ExplainedAway, true),
        ] {
            let slot = gaussians.spawn(Vec3::ZERO, (0, 0), 0.1, 1.0) as usize;
            gaussians.sigma_m[slot] = 0.1;
            gaussians.position_covariance_m2[slot] = SymmetricMat3::isotropic(0.1);
            gaussians.verdict[slot] = verdict;
            gaussians.is_likely[slot] = is_likely;
        }
        let print = Print {
            unit: 1.0,
            placing: Placing::default(),
        };
        let published = Published::default().of(&gaussians, print);
        let standings: Vec<Standing> = published.iter().map(|g| g.standing).collect();
        let (confident, ambiguous) = (Standing::Confident, Standing::Ambiguous);
        assert_eq!(standings, [confident, ambiguous, ambiguous]);
    }
}
