//! What runs in a browser: the files of the live page, which `web` serves as they are, and a viewer of
//! one finished map, which `report` puts into a file. Both draw with the same renderer.
//!
//! Deliberately absent: serving, and what there is to show.

mod bundle;

pub use bundle::bundle;

/// A file of the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageFile {
    /// Without a folder; its ending says what it is.
    pub name: &'static str,
    /// What it holds, UTF-8.
    pub text: &'static str,
}

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        [$(PageFile { name: $name, text: include_str!(concat!("../files/", $name)) }),*]
    };
}

/// Every file of the live page.
pub const FILES: [PageFile; 29] = files![
    "index.html",
    "style.css",
    "icon.svg",
    "app.js",
    "camera.js",
    "charts.js",
    "colors.js",
    "connection.js",
    "drawing.js",
    "frames.js",
    "history.js",
    "incoming.js",
    "legend.js",
    "lines.js",
    "map.js",
    "math.js",
    "measure.js",
    "notices.js",
    "panels.js",
    "pick.js",
    "picture.js",
    "plots.js",
    "renderer.js",
    "scene.js",
    "shaders.js",
    "state.js",
    "time.js",
    "views.js",
    "wire.js",
];

/// The live page without its frame, for a small place in another page: its map, and what is wrong.
#[must_use]
pub fn widget() -> String {
    let index = FILES.iter().find(|file| file.name == "index.html");
    let text = index.map_or("", |file| file.text);
    text.replacen(
        "<html lang=\"en\">",
        "<html lang=\"en\" class=\"widget\">",
        1,
    )
}

/// Draws the map that stands in the same document: the data in an element `map-data`, the picture in the
/// elements of class `viewer`. See `viewer.js` for both.
pub const VIEWER: PageFile = PageFile {
    name: "viewer.js",
    text: include_str!("../files/viewer.js"),
};

/// The viewer with all that it draws with, as one script for a document that stands alone.
#[must_use]
pub fn viewer_script() -> String {
    bundle(VIEWER, &FILES)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_viewer_is_one_script_that_can_stand_in_a_document() {
        let script = viewer_script();
        for modular in ["\nimport ", "\nexport ", "</script", "://"] {
            assert!(!script.contains(modular), "{modular}");
        }
        for file in ["renderer.js", "shaders.js", "camera.js", "viewer.js"] {
            assert_eq!(
                script.matches(&format!("\n// {file}\n")).count(),
                1,
                "{file}"
            );
        }
        assert!(
            !script.contains("\n// app.js\n"),
            "the viewer needs no service"
        );
        assert!(script.len() < 80_000, "{} bytes", script.len());
    }

    #[test]
    fn the_widget_is_the_page_with_a_class_of_its_own() {
        assert!(widget().contains("class=\"widget\""));
        let style = FILES.iter().find(|file| file.name == "style.css");
        assert!(style.unwrap().text.contains(".widget "));
    }

    #[test]
    fn names_and_texts_are_there() {
        for file in FILES.iter().chain([&VIEWER]) {
            assert!(
                !file.text.is_empty() && file.name.contains('.'),
                "{}",
                file.name
            );
        }
    }
}
