//! `echosplat completions SHELL`.

use clap::CommandFactory;
use clap_complete::Shell;

use crate::arguments::Arguments;
use crate::exit::Finish;
use crate::logging;

/// Prints the shell's script.
pub(crate) fn run(shell: Shell) -> Finish {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Arguments::command(), "echosplat", &mut script);
    logging::print(String::from_utf8_lossy(&script).trim_end());
    Finish::Done
}
