//! Whose page it is.

/// What the page says of the service.
#[derive(Debug, Clone, Default)]
pub struct About {
    /// The vehicle's name.
    pub node: String,
    /// Of the program.
    pub version: String,
    /// Full width of the fan across.
    pub azimuth_width_deg: f64,
    /// Full width of the fan along.
    pub elevation_width_deg: f64,
}
