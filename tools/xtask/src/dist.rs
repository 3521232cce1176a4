//! What a package of the program holds, under `out/dist/`: program, manual pages, completions and licences.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::{Context, ensure};

/// Where a shell looks for completions, below `share/`.
const COMPLETIONS: [(&str, &str); 3] = [
    ("bash", "bash-completion/completions/echosplat"),
    ("zsh", "zsh/site-functions/_echosplat"),
    ("fish", "fish/vendor_completions.d/echosplat.fish"),
];
const LICENCES: [&str; 2] = ["LICENSE-APACHE", "LICENSE-MIT"];

/// Makes it, and says where it is or why not.
pub(crate) fn made() -> ExitCode {
    match make() {
        Ok(folder) => {
            println!("xtask: {}", folder.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("xtask could not pack: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn make() -> anyhow::Result<PathBuf> {
    let here = std::env::var_os("CARGO_MANIFEST_DIR");
    let here = here.unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    let root = Path::new(&here).join("../..").canonicalize()?;
    let folder = root.join("out/dist");
    if folder.exists() {
        std::fs::remove_dir_all(&folder)?;
    }
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut install = Command::new(cargo);
    install
        .args(["install", "--locked", "--no-track", "--path"])
        .arg(root.join("crates/program"))
        .arg("--root")
        .arg(&folder);
    output(install)?;
    let program = folder.join("bin/echosplat");
    let mut manual = Command::new(&program);
    manual
        .args(["man", "--out"])
        .arg(folder.join("share/man/man1"));
    output(manual)?;
    for (shell, place) in COMPLETIONS {
        let mut completions = Command::new(&program);
        completions.args(["completions", shell]);
        let path = folder.join("share").join(place);
        std::fs::create_dir_all(path.parent().unwrap_or(&folder))?;
        std::fs::write(path, output(completions)?)?;
    }
    let licences = folder.join("share/doc/echosplat");
    std::fs::create_dir_all(&licences)?;
    for name in LICENCES {
        std::fs::copy(root.join(name), licences.join(name)).context(name)?;
    }
    Ok(folder)
}

/// What it prints; its complaints go where ours do.
fn output(mut command: Command) -> anyhow::Result<Vec<u8>> {
    command.stderr(std::process::Stdio::inherit());
    let output = command.output().with_context(|| format!("{command:?}"))?;
    ensure!(
        output.status.success(),
        "{command:?} failed: {}",
        output.status
    );
    Ok(output.stdout)
}
