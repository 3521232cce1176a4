//! Ellipsoids as pixels: the nearest to the eye wins, edges of depth are darker.

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use echosplat_model::Gaussian;
use glam::{DMat2, DMat3, DVec2, DVec3};

use super::Side;

/// Of a printed drawing.
const PIXELS_PER_MM: f64 = 6.0;
/// Sigmas of its shape to which a Gaussian is drawn, as on the live page.
const EXTENT: f64 = 1.6;
/// Pixels; nothing is drawn smaller.
const LEAST_RADIUS: f64 = 0.7;
/// Metres of a step in depth that darkens an edge by a factor of e.
const EDGE_M: f64 = 0.25;
/// Nothing is darker than this share of its colour.
const DARKEST: f64 = 0.45;

/// Deep to shallow, as the page has it.
const RAMP: [[f64; 3]; 8] = [
    [74.0, 63.0, 181.0],
    [47.0, 111.0, 208.0],
    [27.0, 154.0, 180.0],
    [43.0, 176.0, 127.0],
    [140.0, 192.0, 75.0],
    [227.0, 178.0, 60.0],
    [232.0, 115.0, 60.0],
    [214.0, 69.0, 95.0],
];

/// What a Gaussian is coloured by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Ink {
    /// By the height of what is seen, between two, metres.
    Height((f64, f64)),
    /// One colour, over all that was drawn before.
    Plain([u8; 3]),
}

impl Ink {
    pub(super) const PALE: Self = Self::Plain([206, 212, 217]);
    pub(super) const AMBIGUOUS: Self = Self::Plain([132, 92, 196]);

    fn rgb(self, z_m: f64) -> [f64; 3] {
        match self {
            Self::Height((low, high)) => ramp((z_m - low) / (high - low).max(1e-9)),
            Self::Plain(rgb) => rgb.map(f64::from),
        }
    }
}

/// 0 is the deepest.
pub(super) fn ramp(share: f64) -> [f64; 3] {
    let last = RAMP.len() - 1;
    let at = share.clamp(0.0, 1.0) * last as f64;
    let at = if at.is_nan() { 0.0 } else { at };
    let below = (at as usize).min(last - 1);
    let part = at - below as f64;
    [0, 1, 2].map(|c| RAMP[below][c] * (1.0 - part) + RAMP[below + 1][c] * part)
}

/// Pixels in rows from above.
pub(super) struct Raster {
    low: DVec2,
    high: DVec2,
    per_m: f64,
    width: usize,
    height: usize,
    rgb: Vec<[f64; 3]>,
    /// Toward the eye, metres; minus infinity where nothing is.
    depth: Vec<f64>,
    /// Of the layers before: they lie below all of this one.
    is_below: Vec<bool>,
}

impl Raster {
    pub(super) fn new(low: DVec2, high: DVec2, mm_per_m: f64) -> Self {
        let per_m = mm_per_m * PIXELS_PER_MM;
        let size = ((high - low) * per_m).ceil().max(DVec2::ONE);
        let (width, height) = (size.x as usize, size.y as usize);
        Self {
            low,
            high,
            per_m,
            width,
            height,
            rgb: vec![[255.0; 3]; width * height],
            depth: vec![f64::NEG_INFINITY; width * height],
            is_below: vec![true; width * height],
        }
    }

    /// A layer over all before. Cost: the pixels that its Gaussians cover.
    pub(super) fn draw<'g>(
        &mut self,
        layer: impl Iterator<Item = (DVec3, &'g Gaussian, Ink)>,
        side: Side,
    ) {
        self.is_below.fill(true);
        for (place, gaussian, ink) in layer {
            self.draw_one(place, gaussian, ink, side);
        }
    }

    fn draw_one(&mut self, place: DVec3, gaussian: &Gaussian, ink: Ink, side: Side) {
        let [right, up, toward] = side.axes();
        let shape = shape_of(gaussian);
        let row = |a: DVec3, b: DVec3| a.dot(shape * b);
        let least_m2 = (LEAST_RADIUS / self.per_m / EXTENT).powi(2);
        let flat = DMat2::from_cols(
            DVec2::new(row(right, right) + least_m2, row(right, up)),
            DVec2::new(row(right, up), row(up, up) + least_m2),
        );
        let inverse = flat.inverse();
        let slope = inverse * DVec2::new(row(toward, right), row(toward, up));
        let across = DVec2::new(row(toward, right), row(toward, up));
        let thick_m = (row(toward, toward) - across.dot(slope)).max(0.0).sqrt();
        let middle = DVec2::new(place.dot(right), place.dot(up));
        let reach = EXTENT * DVec2::new(flat.x_axis.x, flat.y_axis.y).sqrt();
        if !(middle.is_finite() && reach.is_finite()) {
            return;
        }
        let (from, to) = (
            (middle - reach - self.low) * self.per_m,
            (middle + reach - self.low) * self.per_m,
        );
        let span = |from: f64, to: f64, most: usize| {
            (from.floor().max(0.0) as usize)..(to.ceil().clamp(0.0, most as f64) as usize)
        };
        let toward_m = place.dot(toward);
        for v in span(from.y, to.y, self.height) {
            for u in span(from.x, to.x, self.width) {
                let at = self.low + (DVec2::new(u as f64, v as f64) + 0.5) / self.per_m;
                let off = at - middle;
                let share = off.dot(inverse * off) / (EXTENT * EXTENT);
                if share > 1.0 {
                    continue;
                }
                let bulge_m = EXTENT * thick_m * (1.0 - share).sqrt();
                let depth = toward_m + slope.dot(off) + bulge_m;
                let z_m = match side {
                    Side::Above => depth,
                    Side::AlongY | Side::AgainstX => at.y,
                };
                let pixel = (self.height - 1 - v) * self.width + u;
                if self.is_below[pixel] || depth > self.depth[pixel] {
                    self.is_below[pixel] = false;
                    self.depth[pixel] = depth;
                    self.rgb[pixel] = ink.rgb(z_m);
                }
            }
        }
    }

    /// Share of pixels with anything in them.
    #[cfg(test)]
    pub(super) fn lit(&self) -> f64 {
        let lit = self.depth.iter().filter(|depth| depth.is_finite()).count();
        lit as f64 / self.depth.len() as f64
    }

    /// Metres, left and right, bottom and top of what is drawn.
    #[cfg(test)]
    pub(super) fn lit_box(&self) -> (DVec2, DVec2) {
        let mut low = DVec2::INFINITY;
        let mut high = DVec2::NEG_INFINITY;
        for (pixel, depth) in self.depth.iter().enumerate() {
            if depth.is_finite() {
                let (u, v) = (pixel % self.width, self.height - 1 - pixel / self.width);
                let corner = DVec2::new(u as f64, v as f64);
                low = low.min(self.low + corner / self.per_m);
                high = high.max(self.low + (corner + 1.0) / self.per_m);
            }
        }
        (low, high)
    }

    /// What lies behind something near beside it is darker there.
    fn shade(&self, pixel: usize) -> f64 {
        let (u, v) = (pixel % self.width, pixel / self.width);
        let beside = [
            (u > 0).then(|| pixel - 1),
            (u + 1 < self.width).then(|| pixel + 1),
            (v > 0).then(|| pixel - self.width),
            (v + 1 < self.height).then(|| pixel + self.width),
        ];
        let step = |other: usize| match self.depth[other].is_finite() {
            true => (self.depth[other] - self.depth[pixel]).clamp(0.0, EDGE_M),
            false => 0.0,
        };
        let steps: f64 = beside.into_iter().flatten().map(step).sum();
        (-steps / EDGE_M).exp().max(DARKEST)
    }

    /// As an element of an SVG that fills this rectangle, mm; empty if the picture cannot be written.
    pub(super) fn to_svg(&self, x_mm: f64, y_mm: f64, size_mm: DVec2) -> String {
        let Ok(png) = self.to_png() else {
            return String::new();
        };
        // The last row and column of pixels may reach out of the rectangle.
        let drawn = DVec2::new(self.width as f64, self.height as f64) / self.per_m;
        let whole_mm = size_mm * drawn / (self.high - self.low);
        format!(
            "<image x=\"{x_mm:.3}\" y=\"{:.3}\" width=\"{:.3}\" height=\"{:.3}\" preserveAspectRatio=\"none\" \
             href=\"data:image/png;base64,{}\"/>",
            y_mm + size_mm.y - whole_mm.y,
            whole_mm.x,
            whole_mm.y,
            BASE64.encode(png)
        )
    }

    fn to_png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let (width, height) = (self.width as u32, self.height as u32);
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        let colors = self.rgb.iter().enumerate().flat_map(|(pixel, rgb)| {
            let light = match self.depth[pixel].is_finite() {
                true => self.shade(pixel),
                false => 1.0,
            };
            // Steps of four: what nobody sees is not stored.
            rgb.map(|c| ((c * light / 4.0).round() * 4.0).clamp(0.0, 255.0) as u8)
        });
        let colors: Vec<u8> = colors.collect();
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&colors)?;
        writer.finish()?;
        Ok(bytes)
    }
}

/// Covariance of its shape, square metres, in the map's axes.
fn shape_of(gaussian: &Gaussian) -> DMat3 {
    let turn = DMat3::from_quat(gaussian.rotation.as_dquat().normalize());
    let scales = gaussian.scale_m.as_dvec3();
    turn * DMat3::from_diagonal(scales * scales) * turn.transpose()
}
