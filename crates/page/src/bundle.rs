//! ES modules as one script. A document opened from a disk may not load modules beside it, and what is
//! mailed has none beside it.

use std::fmt::Write;

use crate::PageFile;

/// `entry` and every file that it imports, each once and behind those it needs; a module becomes a
/// function that returns what it exports. Understood is what the page's own files hold: imports of a line at their
/// beginning, `import { a, b } from "./x.js"` and `import * as a from "./x.js"`, and exports of a
/// constant, a function or a class.
#[must_use]
pub fn bundle(entry: PageFile, files: &[PageFile]) -> String {
    let mut order = Vec::new();
    visit(entry, files, &mut order);
    let mut script = "\"use strict\";\nconst modules = {};\n".to_owned();
    for file in order {
        let _ = write!(script, "\n// {}\n{}", file.name, module(&file));
    }
    script
}

fn visit(file: PageFile, files: &[PageFile], order: &mut Vec<PageFile>) {
    let imports = file.text.lines().filter_map(Import::of);
    for import in imports {
        let known = files.iter().find(|known| known.name == import.from);
        if let Some(known) = known.filter(|known| !order.contains(known)) {
            visit(*known, files, order);
        }
    }
    order.push(file);
}

struct Import<'a> {
    /// `{ a, b }`, or a name for all.
    names: &'a str,
    from: &'a str,
}

impl<'a> Import<'a> {
    fn of(line: &'a str) -> Option<Self> {
        let (names, from) = line.strip_prefix("import ")?.split_once(" from \"./")?;
        Some(Self {
            names: names.strip_prefix("* as ").unwrap_or(names),
            from: from.strip_suffix("\";")?,
        })
    }
}

/// The name that a line exports, and the line without saying so.
fn export(line: &str) -> Option<(&str, &str)> {
    let plain = line.strip_prefix("export ")?;
    let rest = ["const ", "function ", "class "]
        .iter()
        .find_map(|kind| plain.strip_prefix(kind))?;
    let end = rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_')?;
    Some((&rest[..end], plain))
}

fn module(file: &PageFile) -> String {
    let mut names = Vec::new();
    let mut body = String::new();
    for line in file.text.lines() {
        if let Some(import) = Import::of(line) {
            let _ = writeln!(
                body,
                "const {} = modules[\"{}\"];",
                import.names, import.from
            );
        } else if let Some((name, plain)) = export(line) {
            names.push(name);
            let _ = writeln!(body, "{plain}");
        } else {
            let _ = writeln!(body, "{line}");
        }
    }
    let names = names.join(", ");
    format!(
        "modules[\"{}\"] = (() => {{\n{body}return {{ {names} }};\n}})();\n",
        file.name
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modules_become_functions_in_the_order_they_are_needed() {
        let files = [
            PageFile {
                name: "b.js",
                text: "import { one } from \"./c.js\";\nexport const two = one + one;\n",
            },
            PageFile {
                name: "c.js",
                text: "export function f() {}\nexport class K {\n}\nexport const one = 1;\n",
            },
            PageFile {
                name: "unused.js",
                text: "throw 1;\n",
            },
        ];
        let entry = PageFile {
            name: "a.js",
            text: "import * as b from \"./b.js\";\nimport { one } from \"./c.js\";\nsay(b.two, one);\n",
        };
        let script = bundle(entry, &files);
        let at = |text: &str| {
            script
                .find(text)
                .unwrap_or_else(|| panic!("{text}: {script}"))
        };
        assert!(at("// c.js") < at("// b.js") && at("// b.js") < at("// a.js"));
        assert_eq!(script.matches("// c.js").count(), 1);
        at("return { f, K, one };");
        at("const b = modules[\"b.js\"];");
        at("const { one } = modules[\"c.js\"];");
        assert!(!script.contains("unused") && !script.contains("export "));
    }
}
