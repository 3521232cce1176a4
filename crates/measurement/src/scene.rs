//! Gaussians made ready once, and what any number of pings hears of them.

use std::ops::Range;

use fearless_simd::{Level, dispatch};
use glam::{IVec3, Vec3};

use crate::constants::STRONGEST;
use crate::heard::{Bins, Detail, Hearing, Members, NUMBERS, Numbers, SHAPE_NUMBERS, Score, View};
use crate::lanes::LANES;
use crate::pulse::GROUP;
use crate::{PingGeometry, SymmetricMat3, simd_level};

/// Metres, derived: single precision resolves one there.
/// What is further away, or wider, is left out.
const FURTHEST_M: f32 = 1e7;
/// Metres, found: blocks of tens to thousands.
/// Edge of the cells whose Gaussians make a block.
const CELL_M: f32 = 1.0;
/// Sizes; bounds work.
/// Round Gaussians of more sizes than this are taken as shaped.
const MOST_SIZES: usize = 4;

/// One Gaussian of a scene, in world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Element {
    /// Its middle.
    pub mean_m: Vec3,
    /// Its extent, square metres.
    pub covariance_m2: SymmetricMat3,
    /// Power per steradian towards +x, +y and +z.
    pub ahead: Vec3,
    /// The same towards −x, −y and −z.
    pub behind: Vec3,
}

impl Element {
    /// One that sends back the same to all sides.
    #[must_use]
    pub fn even(mean_m: Vec3, covariance_m2: SymmetricMat3, strength: f32) -> Self {
        Self {
            mean_m,
            covariance_m2,
            ahead: Vec3::splat(strength),
            behind: Vec3::splat(strength),
        }
    }

    /// Whether single precision can hold what a ping hears of it.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let SymmetricMat3 { diagonal, mixed } = self.covariance_m2;
        let (least, most) = (Vec3::ZERO, FURTHEST_M * FURTHEST_M);
        let within = |v: Vec3, most: f32| v.abs().cmple(Vec3::splat(most)).all();
        let strengths = [self.ahead, self.behind];
        within(self.mean_m, FURTHEST_M)
            && within(diagonal, most)
            && within(mixed, most)
            && diagonal.cmpge(least).all()
            && strengths
                .iter()
                .all(|&s| s.cmpge(least).all() && within(s, STRONGEST))
    }

    /// One sigma, if it is round.
    fn round_m(&self) -> Option<f32> {
        let SymmetricMat3 { diagonal, mixed } = self.covariance_m2;
        let is_round = mixed == Vec3::ZERO && diagonal == Vec3::splat(diagonal.x);
        is_round.then(|| diagonal.x.sqrt())
    }

    fn sigma_m(&self) -> f32 {
        self.covariance_m2.diagonal.element_sum().sqrt()
    }
}

/// Gaussians side by side as kernels read them, cut into blocks.
#[derive(Debug, Default)]
pub struct Scene {
    all: [Vec<f32>; NUMBERS],
    shapes: [Vec<f32>; SHAPE_NUMBERS],
    sizes_m: Vec<f32>,
    /// Each with its size.
    blocks: Vec<(Members, usize)>,
    /// Which of the given each is.
    given: Vec<u32>,
    given_count: usize,
}

impl Scene {
    /// Of all that are sound ([`Element::is_sound`]).
    #[must_use]
    pub fn of(elements: &[Element]) -> Self {
        let mut scene = Self {
            given_count: elements.len(),
            ..Self::default()
        };
        let mut order: Vec<(bool, usize, [i32; 3], u32)> = Vec::new();
        for (index, element) in elements.iter().enumerate() {
            if element.is_sound() {
                let size = scene.size_of(element);
                let cell = (element.mean_m / CELL_M).floor().as_ivec3();
                let key = (size < MOST_SIZES, size, IVec3::to_array(&cell));
                order.push((key.0, key.1, key.2, index as u32));
            }
        }
        order.sort_unstable();
        for block in order.chunk_by(|a, b| (a.1, a.2) == (b.1, b.2)) {
            let size = block[0].1.min(scene.sizes_m.len());
            scene.add(block.iter().map(|&(.., index)| index), size, elements);
        }
        // Eight at a time may read beyond the last.
        for numbers in scene.all.iter_mut().chain(&mut scene.shapes) {
            numbers.resize(numbers.len() + LANES, 0.0);
        }
        scene
    }

    /// [`MOST_SIZES`] of one with a shape.
    fn size_of(&mut self, element: &Element) -> usize {
        let Some(sigma_m) = element.round_m() else {
            return MOST_SIZES;
        };
        let bits = sigma_m.to_bits();
        let known = self.sizes_m.iter().position(|m| m.to_bits() == bits);
        known.unwrap_or_else(|| match self.sizes_m.len() < MOST_SIZES {
            true => {
                self.sizes_m.push(sigma_m);
                self.sizes_m.len() - 1
            }
            false => MOST_SIZES,
        })
    }

    fn add(&mut self, block: impl Iterator<Item = u32>, size: usize, elements: &[Element]) {
        let start = self.given.len();
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let mut sigma_m = 0.0_f32;
        for index in block {
            let element = &elements[index as usize];
            self.given.push(index);
            (low, high) = (low.min(element.mean_m), high.max(element.mean_m));
            sigma_m = sigma_m.max(element.sigma_m());
            let triples = [element.mean_m, element.ahead, element.behind];
            let numbers = triples.iter().flat_map(Vec3::to_array);
            for (field, number) in self.all.iter_mut().zip(numbers) {
                field.push(number);
            }
            if size >= self.sizes_m.len() {
                let SymmetricMat3 { diagonal, mixed } = element.covariance_m2;
                let numbers = [diagonal, mixed].into_iter().flat_map(|v| v.to_array());
                for (field, number) in self.shapes.iter_mut().zip(numbers) {
                    field.push(number);
                }
            }
        }
        let members = Members {
            places: start..self.given.len(),
            center_m: 0.5 * (low + high),
            radius_m: 0.5 * (high - low).length(),
            sigma_m,
        };
        self.blocks.push((members, size));
    }

    /// How many are in it.
    #[must_use]
    pub fn len(&self) -> usize {
        self.given.len()
    }

    /// Whether it is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.given.is_empty()
    }

    fn numbers(&self) -> Numbers<'_> {
        Numbers {
            all: &self.all,
            shapes: &self.shapes,
            sizes_m: &self.sizes_m,
        }
    }
}

/// Hears one ping of a scene after the other. Its buffers grow to the largest and stay.
#[derive(Debug)]
pub struct Listener {
    level: Level,
    pub(crate) hearing: Hearing,
    bin_count: usize,
    /// Of the last ping, with the room that kernels want.
    pub(crate) predicted: Vec<f32>,
    measured: Vec<f32>,
    weight: Vec<f32>,
    /// Which of the given each place is, and how many were given.
    given: Vec<u32>,
    given_count: usize,
}

impl Default for Listener {
    fn default() -> Self {
        Self::with_level(simd_level::level())
    }
}

impl Listener {
    /// For one level of processor features: results differ between levels of two kinds in their last digits.
    #[must_use]
    pub fn with_level(level: Level) -> Self {
        Self {
            level,
            hearing: Hearing::default(),
            bin_count: 0,
            predicted: Vec::new(),
            measured: Vec::new(),
            weight: Vec::new(),
            given: Vec::new(),
            given_count: 0,
        }
    }

    /// Power per bin above `noise`, shape `[bin_count]`, which a ping hears of a scene.
    pub fn hear(
        &mut self,
        scene: &Scene,
        geometry: &PingGeometry,
        noise: f32,
        detail: Detail,
    ) -> &[f32] {
        self.bin_count = geometry.bin_count as usize;
        self.given.clear();
        self.given.extend_from_slice(&scene.given);
        self.given_count = scene.given_count;
        let padded = (self.bin_count + LANES).next_multiple_of(GROUP);
        self.predicted.clear();
        self.predicted.resize(padded, noise);
        let view = View::of(geometry, true);
        let blocks = scene.blocks.iter().enumerate();
        let near = blocks.filter(|(_, (members, _))| view.may_hear(members));
        let near = near.map(|(block, (members, size))| (block as u32, members, *size));
        dispatch!(self.level, simd => {
            self.hearing.find(simd, &view, scene.numbers(), near, detail);
            self.hearing.spread(simd, &mut self.predicted);
        });
        &self.predicted[..self.bin_count]
    }

    /// Takes in what was measured in place of what was predicted; where it is missing, and beyond it, bins count nothing.
    fn measure(&mut self, measured: &[f32]) {
        let count = measured.len().min(self.bin_count);
        for (numbers, fill) in [(&mut self.measured, 0.0), (&mut self.weight, 1.0)] {
            numbers.clear();
            numbers.resize(count, fill);
            numbers.resize(self.predicted.len(), 0.0);
        }
        self.measured[..count].copy_from_slice(&measured[..count]);
    }

    /// Numerator and denominator of the multiplicative step of each given Gaussian, `Σ A I/Î²` and `Σ A/Î`, A being what one of
    /// strength 1 sends back; 0 of those that the ping does not hear. Noise must have been above 0.
    pub fn step_sums(&mut self, measured: &[f32]) -> Vec<[f32; 2]> {
        self.measure(measured);
        dispatch!(self.level, simd => {
            let bins = Bins { predicted: &self.predicted, measured: &self.measured, weight: &self.weight };
            self.hearing.tell_strengths(simd, bins, true);
        });
        let [shares, numerators] = self.hearing.strengths();
        let rows = &self.hearing.rows;
        let mut sums = vec![[0.0; 2]; self.given_count];
        for row in self.rows() {
            let of = [numerators, shares].map(|of| rows.energy[row] * rows.found(row, of));
            sums[self.given[rows.place[row] as usize] as usize] = of;
        }
        sums
    }

    /// Score and Fisher information of each given Gaussian's mean, after [`Self::hear`] in full detail.
    pub fn scores(&mut self, measured: &[f32]) -> Vec<Score> {
        self.measure(measured);
        dispatch!(self.level, simd => {
            let bins = Bins { predicted: &self.predicted, measured: &self.measured, weight: &self.weight };
            self.hearing.tell_moments(simd, bins);
        });
        let rows = &self.hearing.rows;
        let mut scores = vec![Score::default(); self.given_count];
        for row in self.rows() {
            let score = &mut scores[self.given[rows.place[row] as usize] as usize];
            score.add(rows, row, &self.hearing.moments(row), 1.0);
        }
        scores
    }

    fn rows(&self) -> impl Iterator<Item = usize> + '_ {
        let all: Range<usize> = 0..self.hearing.rows.len();
        self.hearing.heard(all)
    }

    /// Gaussian–bin pairs of the last ping.
    #[must_use]
    pub fn pair_count(&self) -> u64 {
        self.hearing.pulses.pair_count()
    }
}
