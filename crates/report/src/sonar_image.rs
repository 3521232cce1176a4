//! Pings side by side, range upward, brightness in decibels: as PNG, and as SVG with axes.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;

use crate::escape;

/// Most columns and rows drawn of a panel; more are thinned evenly.
const MAX_COLUMNS: usize = 1024;
const MAX_ROWS: usize = 1200;
/// Few columns are drawn wider, up to about so many pixels.
const PANEL_PIXELS: usize = 256;
/// Between panels of a PNG.
const GAP_PIXELS: usize = 8;
/// From brightest to black.
const SPAN_DB: f64 = 50.0;

/// Sizes in an SVG's own units.
const PANEL_WIDTH: f64 = 420.0;
const PANEL_HEIGHT: f64 = 480.0;
const LEFT: f64 = 56.0;
const TOP: f64 = 58.0;
const BELOW: f64 = 46.0;
const BETWEEN: f64 = 28.0;
const BAR_WIDTH: f64 = 14.0;
const RIGHT: f64 = 70.0;
const LINE_HEIGHT: f64 = 18.0;

/// Black through violet and orange to a pale yellow, even in lightness.
const RAMP: [[f64; 3]; 8] = [
    [0.0, 0.0, 4.0],
    [40.0, 11.0, 84.0],
    [101.0, 21.0, 110.0],
    [159.0, 42.0, 99.0],
    [212.0, 72.0, 66.0],
    [245.0, 125.0, 21.0],
    [250.0, 193.0, 39.0],
    [252.0, 255.0, 164.0],
];

const STYLE: &str = "text{font:13px system-ui,-apple-system,\"Segoe UI\",Roboto,sans-serif;\
    fill:#5b6670}.title{font-size:15px;font-weight:600;fill:#1d2329}\
    .frame{fill:none;stroke:#5b6670;stroke-width:1}image{image-rendering:pixelated}";

/// One ping.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Column {
    /// Near edge of the first bin, metres.
    pub range_start_m: f64,
    /// To the far edge of the last.
    pub range_length_m: f64,
    /// Linear, shape `[bins]`.
    pub intensity: Vec<f32>,
}

/// Pings of one origin.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Panel {
    /// What they are.
    pub title: String,
    /// From left to right.
    pub columns: Vec<Column>,
}

/// Panels on one scale of range and of decibels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SonarImage {
    /// What is shown.
    pub title: String,
    /// Side by side.
    pub panels: Vec<Panel>,
    /// What grows from left to right, with its unit.
    pub across: String,
    /// Its value at the left and right edges.
    pub across_limits: [f64; 2],
    /// Said below, a line each.
    pub notes: Vec<String>,
}

/// What all panels share.
struct Scale {
    near_m: f64,
    far_m: f64,
    rows: usize,
    /// Of the brightest colour.
    top_db: f64,
}

impl Scale {
    fn of(panels: &[Panel]) -> Self {
        let columns = || panels.iter().flat_map(|panel| &panel.columns);
        let starts = columns().map(|column| column.range_start_m);
        let near_m = starts.reduce(f64::min).unwrap_or(0.0);
        let ends = columns().map(|column| column.range_start_m + column.range_length_m);
        let far_m = ends.reduce(f64::max).unwrap_or(0.0);
        let bins = columns().map(|column| column.intensity.len()).max();
        let loudest = columns().flat_map(|column| &column.intensity);
        let loudest = loudest
            .copied()
            .filter(|i| i.is_finite())
            .fold(0.0, f32::max);
        Self {
            near_m,
            far_m: if far_m > near_m { far_m } else { near_m + 1.0 },
            rows: bins.unwrap_or(0).clamp(1, MAX_ROWS),
            top_db: decibels(loudest.max(f32::MIN_POSITIVE)),
        }
    }

    /// Colour of a row of a column, counted from the near end; grey where the ping has no bin.
    fn color(&self, column: &Column, row: usize) -> [u8; 3] {
        let share = (row as f64 + 0.5) / self.rows as f64;
        let range_m = self.near_m + (self.far_m - self.near_m) * share;
        let bin = (range_m - column.range_start_m) / column.range_length_m;
        let bin = bin * column.intensity.len() as f64;
        let found = (bin >= 0.0).then(|| column.intensity.get(bin as usize));
        match found.flatten() {
            Some(&intensity) => ramp(1.0 + (decibels(intensity) - self.top_db) / SPAN_DB),
            None => [128; 3],
        }
    }
}

fn decibels(intensity: f32) -> f64 {
    10.0 * f64::from(intensity).log10()
}

/// `share` 0 is dark and 1 bright; what is neither above 0 nor below 1 is cut, NaN to dark.
fn ramp(share: f64) -> [u8; 3] {
    let last = RAMP.len() - 1;
    let at = share.clamp(0.0, 1.0) * last as f64;
    let at = if at.is_nan() { 0.0 } else { at };
    let below = (at as usize).min(last - 1);
    let part = at - below as f64;
    let mix =
        |channel: usize| RAMP[below][channel] * (1.0 - part) + RAMP[below + 1][channel] * part;
    [0, 1, 2].map(|channel| mix(channel).round() as u8)
}

/// Pixels in rows from above, three bytes each.
struct Raster {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Raster {
    fn of(panel: &Panel, scale: &Scale, column_pixels: usize) -> Self {
        let shown = evenly(panel.columns.len(), MAX_COLUMNS);
        let shown: Vec<&Column> = shown.map(|index| &panel.columns[index]).collect();
        let width = shown.len() * column_pixels;
        let mut rgb = Vec::with_capacity(3 * width * scale.rows);
        for row in (0..scale.rows).rev() {
            for column in &shown {
                rgb.extend(scale.color(column, row).repeat(column_pixels));
            }
        }
        Self {
            width,
            height: scale.rows,
            rgb,
        }
    }

    fn beside(panels: &[Self], height: usize) -> Self {
        let gaps = GAP_PIXELS * panels.len().saturating_sub(1);
        let mut rgb = Vec::new();
        for row in 0..height {
            for (index, panel) in panels.iter().enumerate() {
                if index > 0 {
                    rgb.extend([255; 3 * GAP_PIXELS]);
                }
                let bytes = 3 * panel.width;
                rgb.extend_from_slice(&panel.rgb[row * bytes..(row + 1) * bytes]);
            }
        }
        Self {
            width: panels.iter().map(|panel| panel.width).sum::<usize>() + gaps,
            height,
            rgb,
        }
    }

    fn to_png(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let (width, height) = (self.width as u32, self.height as u32);
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let written = encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&self.rgb));
        // Into memory, and with as many bytes as announced, this fails only for an empty image.
        match written {
            Ok(()) => bytes,
            Err(_) => Vec::new(),
        }
    }
}

/// Indices of at most `most` of `count`, evenly chosen.
fn evenly(count: usize, most: usize) -> impl Iterator<Item = usize> {
    let shown = count.min(most);
    (0..shown).map(move |index| index * count / shown)
}

impl SonarImage {
    fn column_pixels(&self) -> usize {
        let most = self.panels.iter().map(|panel| panel.columns.len()).max();
        (PANEL_PIXELS / most.unwrap_or(1).max(1)).max(1)
    }

    /// The panels alone, side by side; empty if there is no ping to show.
    #[must_use]
    pub fn to_png(&self) -> Vec<u8> {
        let scale = Scale::of(&self.panels);
        let column_pixels = self.column_pixels();
        let panels = self.panels.iter().filter(|panel| !panel.columns.is_empty());
        let panels: Vec<Raster> = panels
            .map(|panel| Raster::of(panel, &scale, column_pixels))
            .collect();
        Raster::beside(&panels, scale.rows).to_png()
    }

    /// With axes, the scale of decibels, titles and notes; the pings are embedded as PNG.
    #[must_use]
    pub fn to_svg(&self) -> String {
        let scale = Scale::of(&self.panels);
        let count = self.panels.len() as f64;
        let panels_width = count * (PANEL_WIDTH + BETWEEN) - BETWEEN;
        let width = LEFT + panels_width.max(0.0) + RIGHT;
        let notes_height = LINE_HEIGHT * self.notes.len() as f64;
        let height = TOP + PANEL_HEIGHT + BELOW + notes_height;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" \
             role=\"img\"><style>{STYLE}</style><rect width=\"100%\" height=\"100%\" \
             fill=\"#ffffff\"/><text class=\"title\" x=\"{LEFT}\" y=\"24\">{}</text>\n",
            escape(&self.title)
        );
        for (panel, index) in self.panels.iter().zip(0..) {
            let left = LEFT + f64::from(index) * (PANEL_WIDTH + BETWEEN);
            svg += &self.panel_svg(panel, &scale, left);
        }
        svg += &range_axis(&scale);
        svg += &decibel_bar(&scale, width - RIGHT + 12.0);
        for (note, line) in self.notes.iter().zip(1..) {
            let y = TOP + PANEL_HEIGHT + BELOW - 14.0 + LINE_HEIGHT * f64::from(line);
            let _ = writeln!(svg, "<text x=\"{LEFT}\" y=\"{y}\">{}</text>", escape(note));
        }
        svg + "</svg>\n"
    }

    fn panel_svg(&self, panel: &Panel, scale: &Scale, left: f64) -> String {
        let mut svg = format!(
            "<text x=\"{left}\" y=\"{}\">{}</text>",
            TOP - 10.0,
            escape(&panel.title)
        );
        let raster = Raster::of(panel, scale, 1);
        let png = raster.to_png();
        if !png.is_empty() {
            let _ = write!(
                svg,
                "<image x=\"{left}\" y=\"{TOP}\" width=\"{PANEL_WIDTH}\" height=\"{PANEL_HEIGHT}\" \
                 preserveAspectRatio=\"none\" href=\"data:image/png;base64,{}\"/>",
                BASE64.encode(png)
            );
        }
        let bottom = TOP + PANEL_HEIGHT;
        let _ = write!(
            svg,
            "<rect class=\"frame\" x=\"{left}\" y=\"{TOP}\" width=\"{PANEL_WIDTH}\" \
             height=\"{PANEL_HEIGHT}\"/>"
        );
        let [from, to] = self.across_limits;
        let label = |x: f64, anchor: &str, text: &str| {
            let y = bottom + 18.0;
            format!("<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\">{text}</text>")
        };
        svg += &label(left, "start", &number(from));
        svg += &label(left + 0.5 * PANEL_WIDTH, "middle", &escape(&self.across));
        svg += &label(left + PANEL_WIDTH, "end", &number(to));
        svg + "\n"
    }
}

fn range_axis(scale: &Scale) -> String {
    let mut svg = String::new();
    for step in 0..=5 {
        let share = f64::from(step) / 5.0;
        let range_m = scale.near_m + (scale.far_m - scale.near_m) * share;
        let y = TOP + PANEL_HEIGHT * (1.0 - share);
        let _ = write!(
            svg,
            "<path class=\"frame\" d=\"M{} {y}h6\"/><text x=\"{}\" y=\"{}\" \
             text-anchor=\"end\">{}{}</text>",
            LEFT - 6.0,
            LEFT - 9.0,
            y + 4.0,
            number(range_m),
            if step == 5 { " m" } else { "" }
        );
    }
    svg + "\n"
}

fn decibel_bar(scale: &Scale, left: f64) -> String {
    const STEPS: u32 = 50;
    let height = PANEL_HEIGHT / f64::from(STEPS);
    let mut svg = String::new();
    for step in 0..STEPS {
        let [r, g, b] = ramp((f64::from(step) + 0.5) / f64::from(STEPS));
        let y = TOP + PANEL_HEIGHT - height * f64::from(step + 1);
        let _ = write!(
            svg,
            "<rect x=\"{left}\" y=\"{y:.2}\" width=\"{BAR_WIDTH}\" height=\"{:.2}\" \
             fill=\"#{r:02x}{g:02x}{b:02x}\"/>",
            height + 0.3
        );
    }
    for step in 0..=5 {
        let below_db = SPAN_DB * (1.0 - f64::from(step) / 5.0);
        let y = TOP + PANEL_HEIGHT * (1.0 - f64::from(step) / 5.0) + 4.0;
        let unit = if step == 5 { " dB" } else { "" };
        let _ = write!(
            svg,
            "<text x=\"{}\" y=\"{y}\">{:.0}{unit}</text>",
            left + BAR_WIDTH + 4.0,
            scale.top_db - below_db
        );
    }
    svg + "\n"
}

fn number(value: f64) -> String {
    format!("{}", (value * 10.0).round() / 10.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(start_m: f64, intensity: &[f32]) -> Column {
        Column {
            range_start_m: start_m,
            range_length_m: intensity.len() as f64,
            intensity: intensity.to_vec(),
        }
    }

    fn image(columns: Vec<Column>) -> SonarImage {
        SonarImage {
            title: "a <map>".into(),
            panels: vec![
                Panel {
                    title: "measured".into(),
                    columns: columns.clone(),
                },
                Panel {
                    title: "predicted".into(),
                    columns,
                },
            ],
            across: "ping".into(),
            across_limits: [0.0, 2.0],
            notes: vec!["a & b".into()],
        }
    }

    fn decoded(png: &[u8]) -> (usize, usize, Vec<u8>) {
        let decoder = png::Decoder::new(std::io::Cursor::new(png));
        let mut reader = decoder.read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgb).unwrap();
        (info.width as usize, info.height as usize, rgb)
    }

    #[test]
    fn loud_is_bright_and_near_is_below() {
        let image = image(vec![column(0.0, &[1.0, 1e-5, 0.0, f32::NAN])]);
        let (width, height, rgb) = decoded(&image.to_png());
        assert_eq!((width, height), (2 * PANEL_PIXELS + GAP_PIXELS, 4));
        let pixel = |row: usize| &rgb[3 * width * row..3 * width * row + 3];
        assert_eq!(pixel(3), RAMP[7].map(|c| c as u8));
        for dark in 0..3 {
            assert_eq!(pixel(dark), RAMP[0].map(|c| c as u8));
        }
    }

    #[test]
    fn pings_of_other_settings_share_the_scale_of_range() {
        let image = image(vec![column(0.0, &[1.0, 1.0]), column(2.0, &[1.0, 1.0])]);
        let scale = Scale::of(&image.panels);
        assert!((scale.far_m - 4.0).abs() < 1e-9);
        let columns = &image.panels[0].columns;
        assert_eq!(scale.color(&columns[0], 1), [128; 3]);
        assert_eq!(scale.color(&columns[1], 0), [128; 3]);
    }

    #[test]
    fn the_drawing_is_well_formed_and_the_same_each_time() {
        let image = image(vec![column(0.5, &[1.0, 0.1]); 3000]);
        let svg = image.to_svg();
        assert_eq!(svg, image.to_svg());
        assert_eq!(svg.matches("<image").count(), 2);
        assert!(svg.contains("a &lt;map&gt;") && svg.contains("a &amp; b"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        assert!(svg.len() < 100_000, "{}", svg.len());
        let empty = SonarImage::default();
        assert!(empty.to_png().is_empty() && !empty.to_svg().contains("NaN"));
    }
}
