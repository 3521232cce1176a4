//! The paper's two cases, simulated as it says and reconstructed by its method:
//! `cargo run --release -p echosplat-paper --example cases -- fence|truss [views=N] [name=value …]`,
//! where `name` is a field of `Choices`. Prints counts, time and error over the epochs.

// A program for people to read.
#![allow(clippy::print_stdout)]

use std::error::Error;
use std::sync::Arc;
use std::time::Instant;

use echosplat_metrics::{MapPoints, Truth, evaluate};
use echosplat_model::PosedPing;
use echosplat_paper::{
    ASSERTED_IN_FENCE_FIGURE, ASSERTED_IN_TRUSS_FIGURE, Choices, Images, PaperMethod,
};
use echosplat_simulator::{Dive, DiveKind, NoiseLevel, Scene, SimulatedSonar, seen_surface};
use rayon::prelude::*;

const SEED: u64 = 1;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or_else(|| "fence".to_owned());
    let (choices, views) = parse(arguments)?;
    let scene = Arc::new(Scene::named(&name)?);
    let dive = Arc::new(Dive::plan(
        DiveKind::Viewpoints,
        &scene,
        NoiseLevel::None,
        SEED,
    )?);
    let mut images = Images::from_pings(&pings(&scene, &dive), &choices)?;
    images.truncate(views);
    let truth = Truth::from_scene(&scene, Some(seen_surface(&scene, &dive)));
    println!("{name}: {} views", images.images.len());
    run(PaperMethod::new_timed(images, choices), &truth);
    Ok(())
}

/// Fields of `Choices` as `name=value` in JSON, and `views=N`.
fn parse(arguments: impl Iterator<Item = String>) -> Result<(Choices, usize), Box<dyn Error>> {
    let mut fields = serde_json::to_value(Choices::default())?;
    let mut views = usize::MAX;
    for argument in arguments {
        let (name, value) = argument.split_once('=').ok_or("expected name=value")?;
        if name == "views" {
            views = value.parse()?;
            continue;
        }
        let field = fields
            .get_mut(name)
            .ok_or_else(|| format!("no choice is called `{name}`"))?;
        *field = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    }
    Ok((serde_json::from_value(fields)?, views))
}

fn pings(scene: &Arc<Scene>, dive: &Arc<Dive>) -> Vec<PosedPing> {
    let sonar = SimulatedSonar::new(scene.clone(), dive.clone(), NoiseLevel::None, SEED);
    let trajectory = dive.trajectory(0.5);
    let indices = (0..dive.pings()).into_par_iter();
    indices
        .filter_map(|index| sonar.posed_ping(index, &trajectory))
        .collect()
}

/// So that a start can be timed where it is made.
trait Timed {
    fn new_timed(images: Images, choices: Choices) -> Self;
}

impl Timed for PaperMethod {
    fn new_timed(images: Images, choices: Choices) -> Self {
        let begun = Instant::now();
        let method = Self::new(images, choices);
        println!(
            "{:?}, beam width {:.3} m, {:.1} s",
            method.candidate_counts(),
            method.beam_width_m(),
            begun.elapsed().as_secs_f64()
        );
        method
    }
}

fn run(mut method: PaperMethod, truth: &Truth) {
    let mut compute_s = 0.0;
    judge(&method, truth);
    while !method.is_done() {
        let begun = Instant::now();
        let report = method.run_epoch();
        let epoch_s = begun.elapsed().as_secs_f64();
        compute_s += epoch_s;
        if [1, 2, 5].contains(&report.epoch) || report.epoch.is_multiple_of(10) || method.is_done()
        {
            println!(
                "epoch {:3}: {epoch_s:.2} s, {compute_s:.1} s in all, loss {:.0} of {:.0}, elevation {:.3}, {:.1} M pairs, {} Gaussians, {} asserted, {:?}, peak {} MB",
                report.epoch,
                report.loss,
                report.loss_of_nothing,
                report.elevation_loss,
                report.pairs as f64 * 1e-6,
                report.gaussians,
                report.asserted,
                report.pruned,
                peak_memory_mb(),
            );
        }
        if report.epoch.is_multiple_of(20) || method.is_done() {
            judge(&method, truth);
        }
    }
    println!("{} M pairs in all", method.pair_count() / 1_000_000);
}

/// Raw, and by the paper's protocol, at both opacities that its figures show.
fn judge(method: &PaperMethod, truth: &Truth) {
    for opacity in [ASSERTED_IN_TRUSS_FIGURE, 0.5, ASSERTED_IN_FENCE_FIGURE] {
        let map = method.gaussians_above(opacity);
        let metrics = evaluate(&MapPoints::new(method.images().origin_m, &map), truth);
        let (cd_m, hd_m) = metrics
            .paper
            .map_or((f64::INFINITY, f64::INFINITY), |p| (p.cd_m, p.hd_m));
        println!(
            "    opacity above {opacity}: {} points, accuracy {:.3} (to {:.2}), completeness {:.3} (to {:.2}), CD {:.3} HD {:.3}; aligned and cropped CD {cd_m:.3} HD {hd_m:.3}",
            map.len(),
            metrics.accuracy_m,
            metrics.map_to_truth.max_m,
            metrics.completeness_m,
            metrics.truth_to_map.max_m,
            metrics.cd_m,
            metrics.hd_m,
        );
    }
}

/// Of this process, where the system says so.
fn peak_memory_mb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    kilobytes.unwrap_or(0) / 1024
}
