//! Plain text for a terminal.

use std::fmt::Write;

use echosplat_metrics::curve::{Curve, Sample};
use echosplat_metrics::{
    AlignedFigures, Certainty, MeshFigures, MeshMetrics, Metrics, ProbabilityTenth, SigmaTenth,
};

/// Said above every table of errors.
pub const CAPTION: &str =
    "CD and HD in metres, raw: nothing aligned, nothing cropped; ∞ is an empty map";

/// The line above the samples of a curve.
#[must_use]
pub fn header() -> String {
    format!(
        "{:>8}  {:>9}  {:>9}  {:>9}  {:>8}  {:>8}  {:>7}",
        "dive s", "compute s", "confident", "ambiguous", "CD m", "HD m", "false"
    )
}

/// One moment of a run as a line of the table.
#[must_use]
pub fn row(sample: &Sample) -> String {
    let metrics = &sample.metrics;
    format!(
        "{:>8.1}  {:>9.2}  {:>9}  {:>9}  {:>8}  {:>8}  {:>7}",
        sample.dive_s,
        sample.compute_s,
        metrics.confident_count,
        metrics.ambiguous_count,
        metres(metrics.cd_m),
        metres(metrics.hd_m),
        percent(metrics.confident_false_share),
    )
}

/// A whole run: dive time, compute time, Gaussians, errors.
#[must_use]
pub fn curve(curve: &Curve) -> String {
    let mut text = format!("{CAPTION}\n{}\n", header());
    for sample in &curve.samples {
        text += &row(sample);
        text.push('\n');
    }
    if let Some(failure) = &curve.failure {
        let _ = writeln!(text, "failed: {failure}");
    }
    text
}

/// Everything said of one map.
#[must_use]
pub fn metrics(metrics: &Metrics) -> String {
    let mut text = format!("{CAPTION}\n");
    for (name, value) in facts(metrics) {
        let _ = writeln!(text, "{name:<34}  {value}");
    }
    text
}

/// The same as pairs of name and value, for any table.
#[must_use]
pub fn facts(metrics: &Metrics) -> Vec<(String, String)> {
    let m = metrics;
    let mut facts = vec![
        ("chamfer distance (half-sum)", metres_unit(m.cd_m)),
        ("chamfer distance (sum)", metres_unit(m.cd_sum_m)),
        ("accuracy, map → truth", metres_unit(m.accuracy_m)),
        (
            "completeness, seen truth → map",
            metres_unit(m.completeness_m),
        ),
        ("Hausdorff distance", metres_unit(m.hd_m)),
        (
            "95th, 99th percentile",
            format!("{}, {}", metres_unit(m.p95_m), metres_unit(m.p99_m)),
        ),
        (
            "precision, recall, F at 5 cm",
            shares([m.precision_5cm, m.recall_5cm, m.f_5cm]),
        ),
        (
            "precision, recall, F at 10 cm",
            shares([m.precision_10cm, m.recall_10cm, m.f_10cm]),
        ),
        (
            "confident, beyond 0.25 m of truth",
            format!(
                "{} ({})",
                percent(m.confident_false_share),
                m.confident_false_count
            ),
        ),
        (
            "seen truth near an ambiguous one",
            percent(m.ambiguous_cover_share),
        ),
        (
            "Gaussians, confident + ambiguous",
            format!("{} + {}", m.confident_count, m.ambiguous_count),
        ),
    ];
    if m.left_out_count > 0 {
        facts.push((
            "Gaussians left out, not finite",
            m.left_out_count.to_string(),
        ));
    }
    for (name, part) in [
        ("seabed: CD, HD", m.seabed),
        ("with the seabed: CD, HD", m.whole),
    ] {
        let both = part.map(|p| format!("{}, {}", metres_unit(p.cd_m), metres_unit(p.hd_m)));
        facts.extend(both.map(|value| (name, value)));
    }
    if let Some(n) = m.normals {
        let within = percent(n.within_20deg_share);
        let value = format!("{:.0}°, {within} of {}", n.median_deg, n.flat_count);
        facts.push(("normals: median, within 20°", value));
    }
    if let Some(p) = m.paper {
        let value = format!("{}, {}", metres_unit(p.cd_m), metres_unit(p.hd_m));
        facts.push(("paper's protocol (ICP, crop): CD, HD", value));
    }
    let owned = facts
        .into_iter()
        .map(|(name, value)| (name.to_owned(), value));
    owned.collect()
}

/// What is said of a map that was moved onto the truth.
#[must_use]
pub fn aligned_map(aligned: &AlignedFigures) -> String {
    let a = aligned;
    let [x, y, z] = a.shift_m;
    format!(
        "{:<34}  CD {}, HD {}, {} beyond 0.25 m; by {x:+.3}, {y:+.3}, {z:+.3} m and {:+.2}°\n",
        "moved onto the truth",
        metres_unit(a.cd_m),
        metres_unit(a.hd_m),
        percent(a.confident_false_share),
        a.turn_deg
    )
}

/// Everything said of a mesh.
#[must_use]
pub fn mesh(mesh: &MeshMetrics) -> String {
    let part = |name: &str, m: &MeshFigures| {
        let (accuracy, p95) = (metres_unit(m.accuracy_m), metres_unit(m.p95_m));
        let completeness = metres_unit(m.completeness_m);
        format!(
            "{name:<34}  {accuracy} ({:.2} of the Gaussians'), 95 % within {p95}; seen truth → mesh \
             {completeness}; {:.1} m²\n",
            m.accuracy_ratio, m.area_m2
        )
    };
    let mut text = part("mesh → truth, by area", &mesh.headline);
    if let Some(seabed) = &mesh.seabed {
        text += &part("the mesh's seabed → truth", seabed);
    }
    for (name, share) in [
        ("mesh area beyond 0.25 m of truth", mesh.false_area_share),
        ("… of truth that was seen", mesh.unseen_area_share),
        ("… of the map's Gaussians", mesh.bare_area_share),
    ] {
        let _ = writeln!(text, "{name:<34}  {:.3} %", 100.0 * share);
    }
    text
}

/// How far a map's own sigma and probability hold.
#[must_use]
pub fn certainty(certainty: &Certainty) -> String {
    let mut text = format!(
        "{:<34}  {:.1} %\n",
        "within two sigma of the truth",
        100.0 * certainty.within_two_sigma_share
    );
    let mut line = |name: &str, cells: Vec<String>| {
        let _ = writeln!(text, "{name:<34}  {}", cells.join("  "));
    };
    let sigma = |value: fn(&SigmaTenth) -> f64| {
        let tenths = certainty.sigma_tenths.iter();
        tenths
            .map(|tenth| format!("{:>6.3}", value(tenth)))
            .collect()
    };
    line(
        "sigma by tenths, surest first, m",
        sigma(|tenth| tenth.sigma_m),
    );
    line("error of the same, rms, m", sigma(|tenth| tenth.error_m));
    let probability = |value: fn(&ProbabilityTenth) -> String| {
        let tenths = certainty.probability_tenths.iter();
        tenths.map(|tenth| format!("{:>6}", value(tenth))).collect()
    };
    line(
        "probability of surface in 0.10 m",
        probability(|tenth| format!("{:.2}", tenth.said)),
    );
    line(
        "… found of the same, all Gaussians",
        probability(|tenth| format!("{:.2}", tenth.found)),
    );
    line("… how many", probability(|tenth| tenth.count.to_string()));
    text
}

/// Lines of cells as wide as their column, a line of names above; the first `left` columns begin
/// at the left. Rows are as long as the header.
#[must_use]
pub fn aligned<T: AsRef<str>>(header: &[T], rows: &[Vec<String>], left: usize) -> String {
    let header: Vec<&str> = header.iter().map(AsRef::as_ref).collect();
    let rows = rows
        .iter()
        .map(|row| row.iter().map(String::as_str).collect());
    let lines: Vec<Vec<&str>> = std::iter::once(header).chain(rows).collect();
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max();
    let widths: Vec<usize> = (0..lines[0].len())
        .map(|column| width(column).unwrap_or(0))
        .collect();
    let mut text = String::new();
    for line in &lines {
        let cells = line.iter().zip(&widths).enumerate();
        let cells = cells.map(|(column, (cell, &width))| match column < left {
            true => format!("{cell:<width$}"),
            false => format!("{cell:>width$}"),
        });
        let _ = writeln!(text, "  {}", cells.collect::<Vec<_>>().join("  "));
    }
    text
}

/// Three decimals below 10 m, `∞` for an empty map.
#[must_use]
pub fn metres(value: f64) -> String {
    match value {
        v if !v.is_finite() => "∞".to_owned(),
        v if v < 10.0 => format!("{v:.3}"),
        v => format!("{v:.1}"),
    }
}

/// As [`metres`], with its unit.
#[must_use]
pub fn metres_unit(value: f64) -> String {
    match value.is_finite() {
        true => metres(value) + " m",
        false => "∞".to_owned(),
    }
}

/// Three digits, without an exponent: 0.00021, 2.5, 1234, 53.2 k, 2.37 G.
#[must_use]
pub fn quantity(value: f64) -> String {
    const PREFIXES: [(f64, &str); 4] = [(1e12, " T"), (1e9, " G"), (1e6, " M"), (1e4, " k")];
    let size = value.abs();
    if !value.is_finite() {
        return if value > 0.0 { "∞" } else { "–" }.to_owned();
    }
    if let Some((least, prefix)) = PREFIXES
        .into_iter()
        .find(|(least, _)| size >= 0.9995 * least)
    {
        let unit = if prefix == " k" { 1e3 } else { least };
        return significant(value / unit, 3) + prefix;
    }
    match size >= 1000.0 {
        true => format!("{value:.0}"),
        false => significant(value, 3),
    }
}

/// So many digits that count, in plain decimals, without zeros at the end. What is nearer to 0 than 10⁻¹² is 0.
#[must_use]
pub fn significant(value: f64, digits: i32) -> String {
    if value.abs() < 1e-12 {
        return "0".to_owned();
    }
    let places = (digits - 1 - value.abs().log10().floor() as i32).max(0);
    let text = format!("{value:.0$}", places as usize);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// A share, 0 to 1, in per cent.
#[must_use]
pub fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn shares(values: [f64; 3]) -> String {
    values.map(percent).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_metrics::sample::run;

    #[test]
    fn columns_line_up_and_infinity_is_said() {
        let mut run = run("online", 1, 3.0, 3);
        run.failure = Some("stopped".into());
        let text = curve(&run);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[2].contains("∞"));
        assert_eq!(
            lines[4],
            "    20.0       0.60          1          0     0.150     0.150    0.0 %"
        );
        let widths: Vec<usize> = lines[1..5].iter().map(|l| l.chars().count()).collect();
        assert!(widths.iter().all(|width| *width == widths[0]), "{widths:?}");
        assert_eq!(lines[5], "failed: stopped");
    }

    #[test]
    fn quantities_have_no_exponents() {
        let said = [
            0.0, 1e-3, 2e-4, 0.5, 1000.0, 9_876.0, 1e5, 53_210.0, 2.373e9, 5e12, -0.25,
        ];
        let expected = [
            "0", "0.001", "0.0002", "0.5", "1000", "9876", "100 k", "53.2 k", "2.37 G", "5 T",
            "-0.25",
        ];
        assert_eq!(said.map(quantity), expected);
        assert_eq!(quantity(f64::INFINITY), "∞");
        assert_eq!(significant(0.000_012_34, 3), "0.0000123");
    }

    #[test]
    fn every_fact_has_its_line() {
        let run = run("online", 1, 3.0, 3);
        let text = metrics(&run.last().unwrap().metrics);
        assert!(text.contains("chamfer distance (half-sum)"));
        assert!(text.contains("0.150 m"));
    }

    #[test]
    fn columns_are_as_wide_as_their_widest_cell() {
        let rows = vec![vec!["fence".to_owned(), "1".to_owned()]];
        assert_eq!(
            aligned(&["a", "runs"], &rows, 1),
            "  a      runs\n  fence     1\n"
        );
    }
}
