//! What one version of the program reaches, as one JSON file, and the page that is made of it.
//!
//! [`Results`] is filled by `echosplat bench report`; [`Page`] is text and charts made of nothing else,
//! so that no figure of the page can differ from the file. Deliberately absent: running anything, files.

mod charts;
mod data;
mod page;
mod parts;
mod readme;
#[cfg(test)]
mod tests;

pub use charts::MOST_CHARTS;
pub use data::{Case, Curve, Judged, Live, Noise, Point, Results, Run, Sigma, Watched};
pub use page::{MOST_WORDS, Page, PageError};
pub use readme::{ACCURACY_MARK, with_accuracy};
