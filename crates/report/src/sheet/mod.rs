//! Drawings of a map to a round scale, for paper: plan and elevations with grid, scale bar and north arrow.
//!
//! One unit of their SVG is a millimetre of an A4 page printed at 100 %.

mod furniture;
mod raster;

use echosplat_model::{Gaussian, Standing};
use glam::{DVec2, DVec3};

use crate::{Plot, Table, Trajectory, escape, plots_html};
use raster::{Ink, Raster};

/// Width of a page between its margins, mm.
pub(crate) const PAGE_MM: f64 = 180.0;
/// Room for numbers left of and below a drawing, mm.
const LEFT_MM: f64 = 13.0;
const BELOW_MM: f64 = 9.0;
const TOP_MM: f64 = 5.0;
const RIGHT_MM: f64 = 1.0;
/// Room for the scale bar and the colours, mm.
const FOOT_MM: f64 = 13.0;
/// Around what is drawn, share of its larger side and metres at least.
const MARGIN: (f64, f64) = (0.04, 0.2);
/// Lowest drawing, mm.
const LEAST_HEIGHT_MM: f64 = 24.0;
/// Of scales, times a power of ten.
const STEPS: [f64; 8] = [1.0, 1.25, 1.5, 2.0, 2.5, 4.0, 5.0, 7.5];
/// Share of what is asserted that may lie outside at each end of an axis: one phantom far away does not shrink all.
const OUTSIDE: f64 = 0.0005;

/// How a map's frame lies, and what its heights are counted from.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bearings {
    /// Heading of the x axis, degrees clockwise from true north, y being 90° to its left; `None` where nobody knows it.
    pub x_heading_deg: Option<f64>,
    /// Added to z to have the height that is told, metres.
    pub height_offset_m: f64,
    /// Whether depth, downward, is told in its place.
    pub is_depth: bool,
    /// What is told along the axis up, with its unit.
    pub name: String,
}

impl Bearings {
    fn told(&self, z_m: f64) -> f64 {
        let height_m = z_m + self.height_offset_m;
        if self.is_depth { -height_m } else { height_m }
    }
}

/// What is to be found again in every drawing: one place or the ends of a line, metres of the world.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbered {
    /// Beside it.
    pub number: usize,
    /// World coordinates, metres.
    pub places_m: Vec<DVec3>,
}

/// A page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sheet {
    /// Its heading.
    pub title: String,
    /// Below the heading, HTML of this crate's own making.
    html: String,
}

impl Sheet {
    /// With nothing on it.
    #[must_use]
    pub fn new(title: &str) -> Self {
        Self {
            title: title.to_owned(),
            html: String::new(),
        }
    }

    pub(crate) fn html(mut self, html: &str) -> Self {
        self.html += html;
        self
    }

    /// With a figure of [`Drawn::figure`] below what is there.
    #[must_use]
    pub fn figure(self, figure: Option<String>) -> Self {
        self.html(&figure.unwrap_or_default())
    }

    /// With a paragraph below what is there.
    #[must_use]
    pub fn words(self, text: &str) -> Self {
        self.html(&format!("<p>{}</p>\n", escape(text)))
    }

    /// With a table below what is there.
    #[must_use]
    pub fn table(self, table: &Table) -> Self {
        self.html(&table.to_html())
    }

    /// With charts below what is there.
    #[must_use]
    pub fn plots(self, plots: &[Plot]) -> Self {
        self.html(&plots_html(plots))
    }

    /// With how high the sonar was when below what is there.
    #[must_use]
    pub fn heights(self, way: &Trajectory) -> Self {
        self.html(&way.height_html())
    }

    pub(crate) fn to_html(&self) -> String {
        format!(
            "<section class=\"sheet\"><h2>{}</h2>\n{}</section>\n",
            escape(&self.title),
            self.html
        )
    }
}

/// From where a map is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// From above, x to the right.
    Above,
    /// Along y, x to the right: from the south where x is east.
    AlongY,
    /// Against x, y to the right: from the east where x is east.
    AgainstX,
}

impl Side {
    /// Right, up, and toward the eye.
    pub(crate) fn axes(self) -> [DVec3; 3] {
        match self {
            Self::Above => [DVec3::X, DVec3::Y, DVec3::Z],
            Self::AlongY => [DVec3::X, DVec3::Z, DVec3::NEG_Y],
            Self::AgainstX => [DVec3::Y, DVec3::Z, DVec3::X],
        }
    }

    fn flat(self, place: DVec3) -> DVec2 {
        let [right, up, _] = self.axes();
        DVec2::new(place.dot(right), place.dot(up))
    }
}

/// What of a map is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    /// What is asserted, by height.
    Asserted,
    /// What is ambiguous, on what is asserted in grey.
    Ambiguous,
    /// Where the sonar was, on what is asserted in grey.
    Track,
    /// What changed, on the rest in grey.
    Changes,
}

/// A map with all that its drawings share.
#[derive(Debug, Clone, Copy)]
pub struct Drawn<'a> {
    /// Of the map, metres of the world.
    pub origin_m: DVec3,
    /// Places relative to the origin.
    pub gaussians: &'a [Gaussian],
    /// What became of each, by its number in [`CHANGES`](crate::CHANGES); empty where nothing is compared.
    pub changes: &'a [u8],
    /// Where the sonar was, world coordinates, metres.
    pub track_m: &'a [DVec3],
    /// Numbers beside places.
    pub numbered: &'a [Numbered],
    /// How the frame lies.
    pub bearings: &'a Bearings,
}

/// A rectangle of the world, seen from a side, at a scale.
struct Frame {
    side: Side,
    low: DVec2,
    high: DVec2,
    /// One to so many.
    scale: f64,
}

impl Frame {
    fn mm_per_m(&self) -> f64 {
        1000.0 / self.scale
    }

    fn size_mm(&self) -> DVec2 {
        (self.high - self.low) * self.mm_per_m()
    }

    /// Where in the drawing a place of the rectangle is, mm.
    fn at_mm(&self, flat: DVec2) -> DVec2 {
        let from = (flat - self.low) * self.mm_per_m();
        DVec2::new(LEFT_MM + from.x, TOP_MM + self.size_mm().y - from.y)
    }

    fn holds(&self, flat: DVec2) -> bool {
        flat.cmpge(self.low).all() && flat.cmple(self.high).all()
    }
}

impl Drawn<'_> {
    /// A figure with its caption, at most `most_mm` high; `None` if there is nothing to draw.
    #[must_use]
    pub fn figure(&self, side: Side, shown: Shown, most_mm: f64) -> Option<String> {
        let (low, high) = self.bounds(shown)?;
        let margin = (MARGIN.0 * (high - low).max_element()).max(MARGIN.1);
        let heights_m = (low.z, high.z);
        let (low, high) = (low - margin, high + margin);
        let frame = framed(side, low, high, self.scale(low, high, side, most_mm));
        Some(furniture::figure(self, &frame, shown, heights_m))
    }

    /// Plan and elevations, on pages of their own, and what is ambiguous and the track apart.
    #[must_use]
    pub fn sheets(&self) -> Vec<Sheet> {
        let sheet = |title: &str, figures: &[Option<String>]| {
            let html: String = figures.iter().flatten().map(String::as_str).collect();
            (!html.is_empty()).then(|| Sheet::new(title).html(&html))
        };
        let (asserted, ambiguous) = (Shown::Asserted, Shown::Ambiguous);
        let plan = [self.figure(Side::Above, asserted, 205.0)];
        let elevations =
            [Side::AlongY, Side::AgainstX].map(|side| self.figure(side, asserted, 92.0));
        let apart = [(Side::Above, 148.0), (Side::AlongY, 76.0)];
        let apart = match self.ambiguous_count() {
            0 => Vec::new(),
            _ => apart
                .map(|(side, most)| self.figure(side, ambiguous, most))
                .into(),
        };
        let all = [
            sheet("Plan", &plan),
            sheet("Elevations", &elevations),
            sheet("What is ambiguous", &apart),
        ];
        all.into_iter().flatten().collect()
    }

    fn ambiguous_count(&self) -> usize {
        let sound = self.gaussians.iter().filter(|g| g.is_sound());
        sound.filter(|g| g.standing == Standing::Ambiguous).count()
    }

    fn place(&self, gaussian: &Gaussian) -> DVec3 {
        self.origin_m + gaussian.mean_m.as_dvec3()
    }

    /// What is drawn lies in here, but for phantoms far away.
    fn bounds(&self, shown: Shown) -> Option<(DVec3, DVec3)> {
        let sound = || self.gaussians.iter().filter(|g| g.is_sound());
        let is_asserted = |g: &&Gaussian| g.standing == Standing::Confident;
        let mut places: Vec<DVec3> = sound().filter(is_asserted).map(|g| self.place(g)).collect();
        if places.is_empty() {
            places = sound().map(|g| self.place(g)).collect();
        }
        let bounds = within(&places, OUTSIDE);
        let track = match shown {
            Shown::Track => within(self.track_m, 0.0),
            _ => None,
        };
        let all = bounds.into_iter().chain(track);
        all.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// The larger drawing that fits; elevations share one, so that they can be compared.
    fn scale(&self, low: DVec3, high: DVec3, side: Side, most_mm: f64) -> f64 {
        let fits = |side: Side| {
            let size_m = side.flat(high - low).abs();
            let room_mm = DVec2::new(
                PAGE_MM - LEFT_MM - RIGHT_MM,
                most_mm - TOP_MM - BELOW_MM - FOOT_MM,
            );
            round_scale(1000.0 * (size_m / room_mm).max_element())
        };
        match side {
            Side::Above => fits(side),
            Side::AlongY | Side::AgainstX => fits(Side::AlongY).max(fits(Side::AgainstX)),
        }
    }

    fn raster(&self, frame: &Frame, shown: Shown, z_m: (f64, f64)) -> Raster {
        let mut raster = Raster::new(frame.low, frame.high, frame.mm_per_m());
        let gaussians = || self.gaussians.iter().filter(|g| g.is_sound());
        let layer = |wanted: Standing, ink: Ink, raster: &mut Raster| {
            let these = gaussians().filter(|g| g.standing == wanted);
            raster.draw(these.map(|g| (self.place(g), g, ink)), frame.side);
        };
        match shown {
            Shown::Asserted => layer(Standing::Confident, Ink::Height(z_m), &mut raster),
            Shown::Ambiguous => {
                layer(Standing::Confident, Ink::PALE, &mut raster);
                layer(Standing::Ambiguous, Ink::AMBIGUOUS, &mut raster);
            }
            Shown::Track => layer(Standing::Confident, Ink::PALE, &mut raster),
            Shown::Changes => {
                let of = |index: usize| usize::from(self.changes.get(index).copied().unwrap_or(0));
                let colored = self.gaussians.iter().enumerate();
                let colored =
                    colored.filter(|(_, g)| g.is_sound() && g.standing == Standing::Confident);
                let these = colored.map(|(index, g)| {
                    let change = &crate::CHANGES[of(index).min(crate::CHANGES.len() - 1)];
                    (self.place(g), g, Ink::Plain(change.rgb))
                });
                raster.draw(these, frame.side);
            }
        }
        raster
    }
}

/// The rectangle widened to the page.
fn framed(side: Side, low: DVec3, high: DVec3, scale: f64) -> Frame {
    let (mut low, mut high) = (side.flat(low), side.flat(high));
    (low, high) = (low.min(high), low.max(high));
    let wanted_m = DVec2::new(PAGE_MM - LEFT_MM - RIGHT_MM, LEAST_HEIGHT_MM) * scale / 1000.0;
    let spare = (0.5 * (wanted_m - (high - low))).max(DVec2::ZERO);
    Frame {
        side,
        low: low - spare,
        high: high + spare,
        scale,
    }
}

/// At least this, as scales are on drawings: [`STEPS`] times a power of ten.
fn round_scale(least: f64) -> f64 {
    let least = least.max(1.0);
    let decade = 10_f64.powf(least.log10().floor());
    let fits = |step: &f64| step * decade >= least * (1.0 - 1e-9);
    let step = STEPS.into_iter().find(fits);
    step.unwrap_or(10.0) * decade
}

/// Without so large a share at each end of each axis.
fn within(places: &[DVec3], outside: f64) -> Option<(DVec3, DVec3)> {
    let finite: Vec<DVec3> = places.iter().copied().filter(|p| p.is_finite()).collect();
    if finite.is_empty() {
        return None;
    }
    let cut = (outside * finite.len() as f64) as usize;
    let mut low = DVec3::ZERO;
    let mut high = DVec3::ZERO;
    for axis in 0..3 {
        let mut values: Vec<f64> = finite.iter().map(|place| place[axis]).collect();
        values.sort_by(f64::total_cmp);
        low[axis] = values[cut];
        high[axis] = values[values.len() - 1 - cut];
    }
    Some((low, high))
}

#[cfg(test)]
mod tests;
