//! The page's files, in the binary.

use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

/// Name, type and text of every file.
const FILES: [(&str, &str, &str); 17] = [
    ("index.html", HTML, include_str!("../page/index.html")),
    ("style.css", CSS, include_str!("../page/style.css")),
    ("icon.svg", SVG, include_str!("../page/icon.svg")),
    ("app.js", JS, include_str!("../page/app.js")),
    ("camera.js", JS, include_str!("../page/camera.js")),
    ("charts.js", JS, include_str!("../page/charts.js")),
    ("colors.js", JS, include_str!("../page/colors.js")),
    ("connection.js", JS, include_str!("../page/connection.js")),
    ("history.js", JS, include_str!("../page/history.js")),
    ("lines.js", JS, include_str!("../page/lines.js")),
    ("map.js", JS, include_str!("../page/map.js")),
    ("math.js", JS, include_str!("../page/math.js")),
    ("panels.js", JS, include_str!("../page/panels.js")),
    ("renderer.js", JS, include_str!("../page/renderer.js")),
    ("scene.js", JS, include_str!("../page/scene.js")),
    ("shaders.js", JS, include_str!("../page/shaders.js")),
    ("wire.js", JS, include_str!("../page/wire.js")),
];

/// The file of this name.
pub(crate) fn file(name: &str) -> Option<Response> {
    let (_, kind, text) = FILES.iter().find(|(known, ..)| *known == name)?;
    // Small, and another version of the program may answer next.
    let headers = [(CONTENT_TYPE, *kind), (CACHE_CONTROL, "no-cache")];
    Some((headers, *text).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_needs_no_other_host_and_no_root() {
        for (name, kind, text) in FILES {
            let foreign = text.matches("://").count()
                - text.matches("http://www.w3.org/").count()
                - text.matches("\"://\"").count();
            assert_eq!(foreign, 0, "{name} names another host");
            for absolute in ["from \"/", "src=\"/", "href=\"/", "url(/", "fetch(\"/"] {
                assert!(!text.contains(absolute), "{name}: {absolute}");
            }
            assert!(!kind.is_empty() && !text.is_empty());
        }
    }

    #[test]
    fn every_import_is_embedded() {
        for (name, kind, text) in FILES {
            let imports = text.split("from \"./").skip(1).filter(|_| kind == JS);
            for rest in imports {
                let wanted = rest.split('"').next().unwrap_or_default();
                assert!(file(wanted).is_some(), "{name} imports {wanted}");
            }
        }
    }
}
