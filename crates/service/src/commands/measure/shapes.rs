//! What was measured, as shapes on Earth or as rows.

use std::io::Write;
use std::path::Path;

use echosplat_georeference::Georeference;
use echosplat_recording::export::placed::{Feature, Shape, write_geojson, write_kml};
use serde_json::{Value, json};

use crate::exit::Usage;
use crate::files;

/// A shape with all that was told of it but rows.
pub(crate) fn feature(name: &str, shape: Shape, facts: &Value, place: &Georeference) -> Feature {
    let mut properties = vec![("height_datum", json!(place.datum.name()))];
    // Long lists stay in their own file.
    let is_short = !["profile", "section"].contains(&name);
    if is_short {
        properties.push(("measured", facts.clone()));
    }
    Feature {
        name: name.to_owned(),
        shape,
        facts: properties,
    }
}

/// Writes `out` by its ending; `features` makes shapes of where the map lies.
///
/// # Errors
/// If the ending is of neither, the map says no place on Earth, or the file cannot be written.
pub(crate) fn write(
    out: &Path,
    map: &Path,
    place: Option<&Georeference>,
    rows: &str,
    features: impl FnOnce(&Georeference) -> Vec<Feature>,
) -> anyhow::Result<()> {
    let extension = out.extension().and_then(|extension| extension.to_str());
    let refused = |why: String| Usage::error(format!("--out {}: {why}", out.display()));
    match extension {
        Some("csv") if !rows.is_empty() => files::write("--out", out, rows.as_bytes()),
        Some("geojson" | "kml") => {
            let place = place.ok_or_else(|| {
                refused(format!(
                    "the map {} does not say where on Earth it lies; `echosplat georeference` puts that into it",
                    map.display()
                ))
            })?;
            let features = features(place);
            files::write_with("--out", out, |file| {
                match extension {
                    Some("kml") => write_kml(&features, &mut *file)?,
                    _ => write_geojson(&features, &mut *file)?,
                }
                file.flush()
            })
        }
        _ => Err(refused(
            "it must end in .geojson or .kml, of a profile or section also in .csv".to_owned(),
        )),
    }
}
