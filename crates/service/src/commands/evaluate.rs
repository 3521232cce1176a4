//! `echosplat evaluate MAP.ply --truth …`.

use echosplat_evaluation::{MapPoints, evaluate, table};

use crate::arguments::EvaluateArguments;
use crate::exit::Finish;
use crate::{logging, maps, truth};

/// # Errors
/// If map or truth cannot be read.
pub(crate) fn run(arguments: &EvaluateArguments) -> anyhow::Result<Finish> {
    let map = maps::read(&arguments.map)?;
    let truth = truth::load(&arguments.truth)?;
    let metrics = evaluate(&MapPoints::new(map.origin_m, &map.gaussians), &truth);
    match arguments.json {
        true => logging::print(&serde_json::to_string(&metrics)?),
        false => logging::print(table::metrics(&metrics).trim_end()),
    }
    Ok(Finish::Done)
}
