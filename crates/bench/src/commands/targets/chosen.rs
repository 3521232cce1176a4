//! Which cases and seeds were asked for.

use crate::targets::{self, Case, Section};

use crate::arguments::TargetsBenchArguments;
use echosplat_service::exit::Usage;

/// # Errors
/// If a name is of no section and of no scene.
pub(super) fn cases(arguments: &TargetsBenchArguments) -> anyhow::Result<Vec<Case>> {
    let all = targets::cases();
    for name in &arguments.only {
        if !all.iter().any(|case| is_named(case, name)) {
            return Err(Usage::error(unknown(name, &all)));
        }
    }
    let is_chosen = |case: &Case| match arguments.only.is_empty() {
        true => case.is_quick || !arguments.options.quick,
        false => arguments.only.iter().any(|name| is_named(case, name)),
    };
    Ok(all.into_iter().filter(is_chosen).collect())
}

fn is_named(case: &Case, name: &str) -> bool {
    let section = case.section.as_str();
    match name.split_once('/') {
        Some((first, scene)) => first == section && scene == case.scene,
        None => name == section || name == case.scene,
    }
}

fn unknown(name: &str, all: &[Case]) -> String {
    let mut scenes: Vec<&str> = all.iter().map(|case| case.scene).collect();
    scenes.sort_unstable();
    scenes.dedup();
    format!(
        "--only {name}: there are the sections {}, the scenes {}, and SECTION/SCENE",
        Section::ALL.map(Section::as_str).join(", "),
        scenes.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arguments::{Bench, parsed};

    fn arguments(more: &[&str]) -> TargetsBenchArguments {
        match parsed("targets", more) {
            Bench::Targets(arguments) => arguments,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn sections_and_scenes_are_chosen_by_name() {
        let count = |more: &[&str]| cases(&arguments(more)).unwrap().len();
        let all = count(&[]);
        assert!(count(&["--quick"]) < all);
        assert_eq!(count(&["--only", "empty"]), 1);
        assert_eq!(count(&["--only", "shift", "--only", "empty"]), 2);
        assert_eq!(count(&["--only", "more/wall"]), 1);
        let error = cases(&arguments(&["--only", "fense"])).unwrap_err();
        assert!(error.to_string().contains("accuracy"), "{error}");
    }
}
