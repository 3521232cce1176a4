//! The Python tools' own tests, so that one command runs all.

use std::time::Duration;

use crate::harness::Program;
use crate::python::python;

#[test]
fn the_python_tools_pass_their_tests() {
    let discover = ["-m", "unittest", "discover"];
    let mut tests = Program::start(python::<&str>(&discover, &[]));
    tests.wait_exit_code(0, Duration::from_secs(180));
    assert!(tests.stderr().contains("\nOK"), "{}", tests.account());
}
