//! "Try it without a sonar" of the README: its commands, run as they stand there.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crate::harness::{Program, wait_until_listening};
use crate::web_client::ask;

const LONG: Duration = Duration::from_secs(180);
const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// The commands of a text in Markdown, a list for each block of `sh`; what goes on in the next line is one.
pub(crate) fn blocks(text: &str) -> Vec<Vec<String>> {
    let blocks = text.split("```sh\n").skip(1);
    let lines = |block: &str| {
        let block = block.split("\n```").next().unwrap_or_default();
        let block = block.replace("\\\n", " ");
        block.lines().map(str::to_owned).collect()
    };
    blocks.map(lines).collect()
}

/// A section of the README.
fn section(name: &str) -> String {
    let readme =
        fs::read_to_string(Path::new(ROOT).join("README.md")).expect("the README is there");
    let (_, rest) = readme
        .split_once(&format!("\n## {name}\n"))
        .expect("it has this section");
    rest.split("\n## ").next().unwrap_or_default().to_owned()
}

/// Starts a line as a shell does in the repository's folder, with `echosplat` installed. What it writes goes into
/// `folder`, which is its home as well, where `tools` leads to the repository's.
pub(crate) fn start(line: &str, folder: &Path) -> Program {
    let program = Path::new(env!("CARGO_BIN_EXE_echosplat"));
    let mut path = OsString::from(program.parent().unwrap_or(program));
    path.push(":");
    path.push(env::var_os("PATH").unwrap_or_default());
    let mut command = Command::new("sh");
    command
        .args(["-c", &format!("exec {line}")])
        .current_dir(folder)
        .env("HOME", folder)
        .env("PATH", path)
        .env("PYTHONDONTWRITEBYTECODE", "1");
    Program::start(command)
}

/// The number behind these words.
fn number_after(line: &str, words: &str) -> u16 {
    let (_, rest) = line.split_once(words).expect("the line has these words");
    let digits = rest.split(|c: char| !c.is_ascii_digit()).next();
    digits
        .and_then(|digits| digits.parse().ok())
        .expect("a port")
}

#[test]
fn the_four_commands_of_the_readme_map_a_dive_without_a_sonar() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::os::unix::fs::symlink(Path::new(ROOT).join("tools"), folder.join("tools")).unwrap();
    let blocks = blocks(&section("Try it without a sonar"));
    let [once, four] = &blocks[..] else {
        panic!("two blocks: {blocks:?}");
    };
    for line in once.iter().filter(|line| line.starts_with("echosplat ")) {
        start(line, folder).wait_exit_code(0, LONG);
    }
    let [sonar, poses, run, watch] = &four[..] else {
        panic!("four commands: {four:?}");
    };

    let mut sonar = start(sonar, folder);
    sonar.wait_for_text("listening on", LONG);
    let mut poses = start(poses, folder);
    poses.wait_for_text("start with the first ping", LONG);
    let web_port = number_after(run, "--web ");
    let mut service = start(run, folder);
    wait_until_listening(&mut service, web_port);
    let mut watch = start(watch, folder);

    watch.wait_for_text(" Gaussians, the newest came ", LONG);
    watch.wait_for("copy of the map", LONG, |_| {
        folder.join("out/copy.ply").is_file().then_some(())
    });
    let page = ask(web_port, "GET", "/", &[]).text();
    assert!(page.contains("<title>"), "{page}");
    for program in [&mut watch, &mut service, &mut sonar] {
        program.interrupt();
        let status = program.wait_exit(LONG);
        // Pings from before the first pose are left out, and told.
        assert!(
            matches!(status.code(), Some(0 | 3)),
            "{}",
            program.account()
        );
    }
    assert!(
        folder.join("out/map.ply").is_file(),
        "{}",
        service.account()
    );
    assert!(
        service.stdout().contains(" mapped, "),
        "{}",
        service.account()
    );
}
