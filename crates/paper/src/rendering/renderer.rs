//! The renderer: projects, orders, deals out to bands, and joins what the bands found.

use fearless_simd::{Level, dispatch};
use rayon::prelude::*;

use super::band::{Band, Found};
use super::gradient::add_gradients;
use super::order::Order;
use super::projection::{Frame, Splat, project_all};
use super::stroke::{MOMENTS, Moments};
use super::{PaperView, Transmittance};
use crate::parameters::{GaussianArrays, GradientArrays};

/// Images are cut into this many bands of beams: always, so that the sums are the same.
const BANDS: usize = 4;

/// Renders images of Gaussians as the paper does, and their gradients. Keeps its buffers: after
/// the largest image it allocates no more.
#[derive(Debug)]
pub struct PaperRenderer {
    level: Level,
    parallel: bool,
    view: Option<PaperView>,
    kind: Transmittance,
    splats: Vec<Splat>,
    unordered: Vec<Splat>,
    order: Order,
    bands: [Band; BANDS],
    all: Vec<Found>,
    means: Vec<f32>,
    moments: Vec<Moments>,
    image: Vec<f32>,
    /// Whether `backward` has undone the shading.
    undone: bool,
    pair_count: u64,
    dropped_gradient_count: u64,
}

impl Default for PaperRenderer {
    fn default() -> Self {
        Self::new()
    }
}

impl PaperRenderer {
    /// With the best arithmetic of this machine, on the caller's thread.
    #[must_use]
    pub fn new() -> Self {
        Self::with_level(Level::new())
    }

    /// As [`Self::new`], the bands spread over rayon's current pool: the same bits.
    #[must_use]
    pub fn parallel() -> Self {
        Self {
            parallel: true,
            ..Self::new()
        }
    }

    /// With a level of arithmetic chosen by the caller: results differ by rounding between levels.
    #[must_use]
    pub fn with_level(level: Level) -> Self {
        Self {
            level,
            parallel: false,
            view: None,
            kind: Transmittance::None,
            splats: Vec::new(),
            unordered: Vec::new(),
            order: Order::default(),
            bands: Default::default(),
            all: Vec::new(),
            means: Vec::new(),
            moments: Vec::new(),
            image: Vec::new(),
            undone: false,
            pair_count: 0,
            dropped_gradient_count: 0,
        }
    }

    /// The image of the Gaussians in `subset` (indices into the arrays, any order; those of one
    /// range are taken in the subset's), shape `[beams][range_bins]`, row by row. Empty if the view
    /// is not sound; Gaussians that do not exist or are not finite are left out.
    pub fn forward(
        &mut self,
        view: &PaperView,
        gaussians: &GaussianArrays,
        subset: &[u32],
        transmittance: Transmittance,
    ) -> &[f32] {
        self.image.clear();
        self.image.resize(view.pixel_count(), 0.0);
        self.view = view.is_sound().then_some(*view);
        self.kind = transmittance;
        self.pair_count = 0;
        if self.view.is_some() {
            self.place_splats(view, gaussians, subset);
            for (band, beams) in self.bands.iter_mut().zip(band_beams(view.beams)) {
                band.start(view, beams);
            }
            self.deal_out();
            self.shade();
            self.join_means();
            self.share();
            for band in &self.bands {
                band.copy_to(&mut self.image);
                self.pair_count += band.pair_count();
            }
        }
        &self.image
    }

    /// Adds dL/d(parameters) of what the last [`Self::forward`] rendered, given dL/d(image) in the
    /// image's shape; missing slopes are 0, and so are those that are not finite. `gaussians` must
    /// be the same as then; gradients that are not finite are counted, not added.
    pub fn backward(
        &mut self,
        gaussians: &GaussianArrays,
        d_image: &[f32],
        gradients: &mut GradientArrays,
    ) {
        let Some(view) = self.view else { return };
        if self.undone {
            self.shade();
        }
        for band in &mut self.bands {
            band.start_back(d_image);
        }
        self.find_moments();
        self.join_moments();
        let frame = Frame::of(&view);
        let (splats, moments) = (&self.unordered, &self.moments);
        self.dropped_gradient_count += dispatch!(self.level, simd => add_gradients(
            simd, &frame, gaussians, splats, moments, gradients
        ));
    }

    /// Pairs of Gaussian and pixel that the last image was made of.
    #[must_use]
    pub fn pair_count(&self) -> u64 {
        self.pair_count
    }

    /// Gradients left out so far since they were not finite.
    #[must_use]
    pub fn dropped_gradient_count(&self) -> u64 {
        self.dropped_gradient_count
    }

    /// Fills `splats`, nearest first where that matters.
    fn place_splats(&mut self, view: &PaperView, gaussians: &GaussianArrays, subset: &[u32]) {
        let frame = Frame::of(view);
        let found = &mut self.unordered;
        found.clear();
        dispatch!(self.level, simd => project_all(simd, &frame, gaussians, subset, found));
        if self.kind == Transmittance::None {
            self.splats.clone_from(&self.unordered);
            return;
        }
        let order = self
            .order
            .sort(self.unordered.iter().map(|splat| splat.range_m));
        self.splats.clear();
        self.splats.extend(order.map(|place| self.unordered[place]));
    }

    /// All that bands can do by themselves.
    fn shade(&mut self) {
        let (level, kind, splats) = (self.level, self.kind, &self.splats);
        each(self.parallel, &mut self.bands, |band| {
            dispatch!(level, simd => band.forward(simd, kind, splats));
        });
        self.undone = false;
    }

    /// Every splat to the bands it touches.
    fn deal_out(&mut self) {
        let ends = std::array::from_fn::<_, BANDS, _>(|band| self.bands[band].end_beam());
        // Counted, not searched: which band it is cannot be guessed.
        let band_of = |beam: u32| {
            ends.iter()
                .map(|&end| usize::from(end <= beam))
                .sum::<usize>()
        };
        for (place, splat) in self.splats.iter().enumerate() {
            let (first, last) = (band_of(splat.beams[0]), band_of(splat.beams[1] - 1));
            for band in self.bands.iter_mut().take(last + 1).skip(first) {
                band.places.push(place as u32);
            }
        }
    }

    /// (29) over all bands.
    fn join_means(&mut self) {
        self.all.clear();
        self.means.clear();
        if self.kind != Transmittance::Averaged {
            return;
        }
        self.all.resize(self.splats.len(), Found::default());
        for band in &self.bands {
            for (&place, found) in band.places.iter().zip(&band.found) {
                let all = &mut self.all[place as usize];
                all.pixels += found.pixels;
                all.seen += found.seen;
            }
        }
        let mean = |all: &Found| all.seen / all.pixels.max(1) as f32;
        self.means.extend(self.all.iter().map(mean));
    }

    /// (30) for splats in more than one band.
    fn share(&mut self) {
        if self.kind != Transmittance::Averaged {
            return;
        }
        let (level, splats, means) = (self.level, &self.splats, &self.means);
        each(self.parallel, &mut self.bands, |band| {
            dispatch!(level, simd => band.forward_shared(simd, splats, means));
        });
    }

    fn find_moments(&mut self) {
        let (level, kind, splats) = (self.level, self.kind, &self.splats);
        if kind == Transmittance::Averaged {
            each(self.parallel, &mut self.bands, |band| {
                dispatch!(level, simd => band.energies(simd, splats));
            });
            for all in &mut self.all {
                all.energy = 0.0;
            }
            for band in &self.bands {
                for (&place, found) in band.places.iter().zip(&band.found) {
                    self.all[place as usize].energy += found.energy;
                }
            }
        }
        let all = &self.all;
        each(self.parallel, &mut self.bands, |band| {
            dispatch!(level, simd => band.backward(simd, kind, splats, all));
        });
        self.undone = kind != Transmittance::None;
    }

    /// Sums the moments of each splat over the bands, in the bands' order; they then stand in the
    /// subset's order, in which parameters lie together.
    fn join_moments(&mut self) {
        self.moments.clear();
        self.moments.resize(self.splats.len(), [0.0; MOMENTS]);
        for band in &self.bands {
            for (&place, moments) in band.places.iter().zip(&band.moments) {
                let origin = self.splats[place as usize].origin;
                let sums = &mut self.moments[origin as usize];
                for (sum, moment) in sums.iter_mut().zip(moments) {
                    *sum += moment;
                }
            }
        }
    }
}

/// First beam and one beyond the last, of each band.
fn band_beams(beams: u32) -> [[u32; 2]; BANDS] {
    let bound = |band: usize| (u64::from(beams) * band as u64 / BANDS as u64) as u32;
    std::array::from_fn(|band| [bound(band), bound(band + 1)])
}

fn each(parallel: bool, bands: &mut [Band], work: impl Fn(&mut Band) + Sync + Send) {
    if parallel {
        bands.par_iter_mut().for_each(work);
    } else {
        bands.iter_mut().for_each(work);
    }
}
