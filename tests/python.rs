//! The Python tools in an environment of their own.

use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use crate::harness::Program;

/// Where the tools lie.
pub(crate) const TOOLS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tools/python");

/// One of the tools, started with these arguments.
pub(crate) fn tool<A: AsRef<str>>(script: &str, arguments: &[A]) -> Program {
    Program::start(python(&[script], arguments))
}

/// The command `python BEFORE… ARGUMENTS…`, run in the tools' folder.
pub(crate) fn python<A: AsRef<str>>(before: &[&str], arguments: &[A]) -> Command {
    let mut command = Command::new(python_environment());
    command
        .args(before)
        .args(arguments.iter().map(AsRef::as_ref))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .env("PYTHONUNBUFFERED", "1")
        .current_dir(TOOLS);
    command
}

/// A script with the libraries of other programs that read recordings: large, so apart.
pub(crate) fn reader(script: &str, arguments: &[&str]) -> Program {
    static INTERPRETER: OnceLock<PathBuf> = OnceLock::new();
    let interpreter = INTERPRETER.get_or_init(|| environment("requirements-readers.txt"));
    script_of(interpreter, script, arguments)
}

/// A node of ROS 2; what it needs is apart too.
pub(crate) fn ros2_node(arguments: &[&str]) -> Program {
    static INTERPRETER: OnceLock<PathBuf> = OnceLock::new();
    let interpreter = INTERPRETER.get_or_init(|| environment("requirements-ros2.txt"));
    script_of(interpreter, "ros2_node.py", arguments)
}

fn script_of(interpreter: &Path, script: &str, arguments: &[&str]) -> Program {
    let mut command = Command::new(interpreter);
    command
        .arg(script)
        .args(arguments)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .current_dir(TOOLS);
    Program::start(command)
}

/// The interpreter with what the tools themselves need.
pub(crate) fn python_environment() -> &'static Path {
    static INTERPRETER: OnceLock<PathBuf> = OnceLock::new();
    INTERPRETER.get_or_init(|| environment("requirements.txt"))
}

/// The interpreter of a virtual environment with these requirements installed. Made once and kept
/// under the target directory; another when the requirements or the interpreter change.
fn environment(requirements_file: &str) -> PathBuf {
    let requirements = fs::read_to_string(format!("{TOOLS}/{requirements_file}"))
        .unwrap_or_else(|error| panic!("tools/python/{requirements_file}: {error}"));
    let version = run(Command::new("python3").arg("--version"));
    let mut hasher = DefaultHasher::new();
    (requirements, version).hash(&mut hasher);
    let folder = format!("python-{:016x}", hasher.finish());
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(folder);
    environment_in(&folder, requirements_file)
}

/// Locked, so that test programs that run side by side make it once.
fn environment_in(folder: &Path, requirements_file: &str) -> PathBuf {
    let lock = File::create(folder.with_extension("lock")).expect("the target directory is ours");
    lock.lock().expect("files there can be locked");
    let interpreter = folder.join("bin/python");
    let complete = folder.join("complete");
    if !complete.exists() {
        run(Command::new("python3")
            .args(["-m", "venv", "--clear"])
            .arg(folder));
        run(Command::new(&interpreter)
            .args([
                "-m",
                "pip",
                "install",
                "--quiet",
                "--disable-pip-version-check",
            ])
            .args(["--requirement", requirements_file])
            .current_dir(TOOLS));
        File::create(complete).expect("the environment's folder was just made");
    }
    interpreter
}

/// Standard output of a command that has to succeed.
fn run(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| {
        panic!("{command:?} does not start ({error}): these tests need python3 with venv and pip")
    });
    assert!(
        output.status.success(),
        "{command:?} failed: these tests need python3 with venv and pip, and a package index\n{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8_lossy(&output.stdout).into_owned()
}
