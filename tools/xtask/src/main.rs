//! Checks that the workspace holds to its architecture: `cargo xtask check`. `cargo xtask constants` writes the page of
//! constants, and `cargo xtask dist` packs what a package needs ([`dist`]).
//!
//! The check reads `cargo tree` and the tracked files and judges them by the rules in [`dependencies`], [`constants`],
//! [`results`] and [`sources`]. It deliberately builds nothing, changes nothing and needs no network: what the
//! compiler and clippy can say is theirs to say.

#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a command for the terminal"
)]

mod code;
mod constants;
mod crates;
mod dependencies;
mod dist;
mod graph;
mod results;
mod sources;
mod workspace;

use std::process::ExitCode;

use workspace::Workspace;

const USAGE: &str = "usage: cargo xtask check | constants | dist";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["check"] => report(check()),
        ["dist"] => dist::made(),
        ["constants"] => report(write_constants()),
        _ => {
            eprintln!("{USAGE}");
            ExitCode::from(2)
        }
    }
}

/// Every broken rule, one line each.
fn check() -> anyhow::Result<Vec<String>> {
    let workspace = Workspace::here()?;
    let graphs = workspace.dependency_graphs()?;
    let files = workspace.tracked_files()?;
    println!(
        "xtask: {} crates, {} files looked at",
        graphs.len(),
        files.len()
    );
    let mut broken = dependencies::violations(&graphs);
    broken.extend(dependencies::violations_on_a_vehicle(
        &workspace.vehicle_graph()?,
    ));
    broken.extend(sources::violations(&files));
    broken.extend(constants::violations(&files));
    broken.extend(results::violations(&files));
    Ok(broken)
}

/// Writes the page of constants; what they do not say is told by the check.
fn write_constants() -> anyhow::Result<Vec<String>> {
    let workspace = Workspace::here()?;
    let page = constants::page(&workspace.tracked_files()?)?;
    workspace.write(constants::PAGE, &page)?;
    Ok(Vec::new())
}

fn report(outcome: anyhow::Result<Vec<String>>) -> ExitCode {
    match outcome {
        Ok(broken) if broken.is_empty() => {
            println!("xtask: every rule holds");
            ExitCode::SUCCESS
        }
        Ok(broken) => {
            for line in &broken {
                eprintln!("error: {line}");
            }
            eprintln!("xtask: {} broken rules", broken.len());
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("xtask could not check: {error:#}");
            ExitCode::FAILURE
        }
    }
}
