//! Gaussian–bin pairs per second of the kernels and of their plain twin, on this machine.
//!
//! `cargo run --release -p echosplat-acoustics --example rates`
#![allow(clippy::print_stdout, clippy::disallowed_methods)]

use std::time::Instant;

use echosplat_acoustics::reference::online as twin;
use echosplat_acoustics::{
    GaussianArrays, GradientArrays, OnlineOptions, OnlineRenderer, PingGeometry, sample,
};

/// Seconds of the fastest of several runs, so that other programs disturb least.
fn fastest(runs: usize, mut run: impl FnMut()) -> f64 {
    let one = |_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64()
    };
    (0..runs).map(one).fold(f64::INFINITY, f64::min)
}

struct Rates {
    forward: f64,
    both: f64,
}

fn kernels(
    geometry: &PingGeometry,
    gaussians: &GaussianArrays,
    visible: &[u32],
    occlusion: bool,
) -> Rates {
    let mut renderer = OnlineRenderer::new(OnlineOptions { occlusion });
    let mut gradients = GradientArrays::zeros(gaussians.len());
    let loss = vec![0.5; geometry.bin_count as usize];
    renderer.forward(geometry, gaussians, visible);
    let pairs = renderer.pair_count() as f64;
    let forward = fastest(400, || {
        renderer.forward(geometry, gaussians, visible);
    });
    let both = fastest(400, || {
        renderer.forward(geometry, gaussians, visible);
        renderer.backward(gaussians, &loss, &mut gradients);
    });
    Rates {
        forward: pairs / forward,
        both: pairs / both,
    }
}

fn plain(
    geometry: &PingGeometry,
    gaussians: &GaussianArrays,
    visible: &[u32],
    occlusion: bool,
) -> Rates {
    let numbers = twin::numbers_of::<f32>(gaussians);
    let loss = vec![0.5f32; geometry.bin_count as usize];
    let cutoffs = twin::Cutoffs::default();
    let forward = || twin::forward(geometry, &numbers, visible, occlusion, &cutoffs);
    let pairs = forward().pair_count() as f64;
    let once = fastest(10, || {
        std::hint::black_box(forward());
    });
    let both = fastest(10, || {
        std::hint::black_box(twin::backward(geometry, &numbers, &forward(), &loss));
    });
    Rates {
        forward: pairs / once,
        both: pairs / both,
    }
}

fn main() {
    let (geometry, gaussians) = sample::bench_scene(1);
    let all: Vec<u32> = (0..gaussians.len() as u32).collect();
    let mut scattered = GaussianArrays::new();
    for &i in &all {
        scattered.push(gaussians.get(i as usize));
        scattered.push(gaussians.get(i as usize));
    }
    let every_other: Vec<u32> = all.iter().map(|i| 2 * i).collect();
    for occlusion in [false, true] {
        let twin = plain(&geometry, &gaussians, &all, occlusion);
        for (name, gaussians, visible) in [
            ("in a row", &gaussians, &all),
            ("scattered", &scattered, &every_other),
        ] {
            let fast = kernels(&geometry, gaussians, visible, occlusion);
            println!(
                "occlusion {occlusion}, {name}: forward {:.2} M/s ({:.1} × {:.2}), \
                 both {:.2} M/s ({:.1} × {:.2})",
                fast.forward * 1e-6,
                fast.forward / twin.forward,
                twin.forward * 1e-6,
                fast.both * 1e-6,
                fast.both / twin.both,
                twin.both * 1e-6,
            );
        }
    }
}
