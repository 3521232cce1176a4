//! The page's files, in the binary.

use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use echosplat_page::FILES;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

fn kind(name: &str) -> &'static str {
    match name.rsplit_once('.') {
        Some((_, "html")) => HTML,
        Some((_, "css")) => CSS,
        Some((_, "svg")) => SVG,
        _ => JS,
    }
}

/// The file of this name.
pub(crate) fn file(name: &str) -> Option<Response> {
    if name == "widget.html" {
        let headers = [(CONTENT_TYPE, HTML), (CACHE_CONTROL, "no-cache")];
        return Some((headers, echosplat_page::widget()).into_response());
    }
    let found = FILES.iter().find(|known| known.name == name)?;
    // Small, and another version of the program may answer next.
    let headers = [(CONTENT_TYPE, kind(name)), (CACHE_CONTROL, "no-cache")];
    Some((headers, found.text).into_response())
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_page::PageFile;

    #[test]
    fn the_page_needs_no_other_host_and_no_root() {
        for PageFile { name, text } in FILES {
            let foreign = text.matches("://").count()
                - text.matches("http://www.w3.org/").count()
                - text.matches("\"://\"").count();
            assert_eq!(foreign, 0, "{name} names another host");
            for absolute in ["from \"/", "src=\"/", "href=\"/", "url(/", "fetch(\"/"] {
                assert!(!text.contains(absolute), "{name}: {absolute}");
            }
        }
    }

    #[test]
    fn files_say_what_they_are() {
        for (name, wanted) in [
            ("index.html", HTML),
            ("widget.html", HTML),
            ("style.css", CSS),
            ("icon.svg", SVG),
            ("app.js", JS),
        ] {
            let response = file(name).unwrap();
            assert_eq!(response.headers()[CONTENT_TYPE], wanted, "{name}");
        }
        assert!(file("viewer.js").is_none() && file("none").is_none());
    }

    #[test]
    fn every_import_is_embedded() {
        for PageFile { name, text } in FILES {
            for rest in text.split("from \"./").skip(1) {
                let wanted = rest.split('"').next().unwrap_or_default();
                assert!(file(wanted).is_some(), "{name} imports {wanted}");
            }
        }
    }
}
