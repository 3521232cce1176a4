//! What is let go: by opacity and by distance (V-D1), by density (47), (48), and the guard (49).

use glam::Vec3;
use rayon::prelude::*;

use crate::Choices;
use crate::grid::Grid;

/// What pruning looks at, one entry per Gaussian.
pub(crate) struct Prunable<'a> {
    pub(crate) mean_m: &'a [Vec3],
    pub(crate) opacity: &'a [f32],
    /// `s_i` of (49).
    pub(crate) impact: &'a [f32],
}

/// How many went, and why.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Pruned {
    /// Opacity below the threshold.
    pub by_opacity: usize,
    /// Too close to a more opaque one.
    pub by_distance: usize,
    /// Too few neighbours (48).
    pub by_density: usize,
    /// Not finite.
    pub not_finite: usize,
    /// Would have gone, but matter to the reconstruction (49).
    pub guarded: usize,
}

/// Which Gaussians stay, and why the others do not.
pub(crate) fn prune(
    all: &Prunable<'_>,
    beam_width_m: f32,
    choices: &Choices,
) -> (Vec<bool>, Pruned) {
    let guard = Guard::new(all.impact, choices.guard_share);
    let mut pruned = Pruned::default();
    let mut keep = vec![true; all.mean_m.len()];
    let let_go = |keep: &mut bool, index: usize, counter: &mut usize, guarded: &mut usize| {
        if guard.protects(all.impact[index]) {
            *guarded += 1;
        } else {
            *keep = false;
            *counter += 1;
        }
    };
    for (index, keep) in keep.iter_mut().enumerate() {
        if !(all.mean_m[index].is_finite() && all.opacity[index].is_finite()) {
            *keep = false;
            pruned.not_finite += 1;
        } else if !(all.opacity[index] >= choices.prune_opacity) {
            let_go(keep, index, &mut pruned.by_opacity, &mut pruned.guarded);
        }
    }
    for index in too_close(all, &keep, choices.prune_distance_beams * beam_width_m) {
        let_go(
            &mut keep[index],
            index,
            &mut pruned.by_distance,
            &mut pruned.guarded,
        );
    }
    let radius_m = choices.density_radius_beams * beam_width_m;
    for index in isolated(all.mean_m, &keep, radius_m, choices.density_least) {
        let_go(
            &mut keep[index],
            index,
            &mut pruned.by_density,
            &mut pruned.guarded,
        );
    }
    (keep, pruned)
}

/// (49): those of the highest impact are kept whatever else is said of them.
struct Guard {
    least: f32,
}

impl Guard {
    fn new(impact: &[f32], share: f32) -> Self {
        let mut sorted: Vec<f32> = impact.iter().copied().filter(|s| s.is_finite()).collect();
        sorted.sort_unstable_by(|a, b| b.total_cmp(a));
        let protected = (sorted.len() as f32 * share) as usize;
        let least = if protected == 0 {
            f32::INFINITY
        } else {
            sorted[protected - 1]
        };
        Self { least }
    }

    fn protects(&self, impact: f32) -> bool {
        impact > 0.0 && impact >= self.least
    }
}

/// Those closer than `radius_m` to a more opaque one that stays, ascending.
fn too_close(all: &Prunable<'_>, keep: &[bool], radius_m: f32) -> Vec<usize> {
    if !(radius_m > 0.0) {
        return Vec::new();
    }
    let grid = Grid::new(all.mean_m, radius_m);
    let mut order: Vec<usize> = (0..keep.len()).filter(|index| keep[*index]).collect();
    order.sort_by(|&a, &b| all.opacity[b].total_cmp(&all.opacity[a]).then(a.cmp(&b)));
    let mut stays = vec![false; keep.len()];
    let mut gone = Vec::new();
    for index in order {
        let mut is_close = false;
        grid.for_each_within(all.mean_m, all.mean_m[index], radius_m, |near| {
            is_close |= stays[near as usize];
        });
        stays[index] = !is_close;
        if is_close {
            gone.push(index);
        }
    }
    gone.sort_unstable();
    gone
}

/// (47), (48): those with fewer than `least` others that stay within `radius_m`, ascending.
fn isolated(mean_m: &[Vec3], keep: &[bool], radius_m: f32, least: u32) -> Vec<usize> {
    let staying: Vec<usize> = (0..keep.len()).filter(|index| keep[*index]).collect();
    let points: Vec<Vec3> = staying.iter().map(|&index| mean_m[index]).collect();
    let grid = Grid::new(&points, radius_m);
    let is_isolated = |point: &Vec3| {
        let mut neighbors = 0;
        grid.for_each_within(&points, *point, radius_m, |_| neighbors += 1);
        // Itself is one of them in (47).
        neighbors < least
    };
    let isolated: Vec<bool> = points.par_iter().map(is_isolated).collect();
    staying
        .into_iter()
        .zip(isolated)
        .filter_map(|(index, is)| is.then_some(index))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choices() -> Choices {
        Choices {
            prune_opacity: 0.1,
            prune_distance_beams: 0.5,
            density_radius_beams: 2.5,
            density_least: 3,
            guard_share: 0.0,
            ..Choices::default()
        }
    }

    /// A row of five a beam width apart, a twin of the first, one far off, one not finite.
    fn row() -> Vec<Vec3> {
        let mut means: Vec<Vec3> = (0..5u8).map(|i| Vec3::X * f32::from(i)).collect();
        means.extend([Vec3::X * 0.3, Vec3::Y * 50.0, Vec3::NAN]);
        means
    }

    #[test]
    fn the_faint_the_doubled_the_lone_and_the_broken_go() {
        let opacity = [0.9, 0.9, 0.9, 0.05, 0.9, 0.8, 0.9, 0.9];
        let all = Prunable {
            mean_m: &row(),
            opacity: &opacity,
            impact: &[0.0; 8],
        };
        let (keep, pruned) = prune(&all, 1.0, &choices());
        // The fifth has but one neighbour left within 2.5 once the fourth is gone.
        assert_eq!(keep, [true, true, true, false, false, false, false, false]);
        let expected = Pruned {
            by_opacity: 1,
            by_distance: 1,
            by_density: 2,
            not_finite: 1,
            guarded: 0,
        };
        assert_eq!(pruned, expected);
    }

    #[test]
    fn the_guard_keeps_what_the_reconstruction_leans_on() {
        let opacity = [0.9, 0.9, 0.9, 0.05, 0.9, 0.8, 0.9, 0.9];
        let impact = [0.0, 0.0, 0.0, 9.0, 0.0, 0.0, 8.0, 1.0];
        let all = Prunable {
            mean_m: &row(),
            opacity: &opacity,
            impact: &impact,
        };
        let guarded = Choices {
            guard_share: 0.25,
            ..choices()
        };
        let (keep, pruned) = prune(&all, 1.0, &guarded);
        assert_eq!(keep, [true, true, true, true, true, false, true, false]);
        assert_eq!((pruned.guarded, pruned.by_density), (2, 0));
    }
}
