//! The kernels of one ping against the plain twin: usual pings, loud and silent ones, crowds, and pings of few bins.

use echosplat_measurement::{Element, simd_level};
use glam::Vec3;

use super::Row;
use super::row::{Comparison, Label};
use super::scene::{NOISE, Trial, plain, shaped};
use crate::draw::Draw;

pub(super) const HEARD: &str = "power of the worst bin, errors relative to the largest";

/// Ratio, measured: of the largest, 0.3 % of round ones.
/// Echoes lie between steps of a fraction of a bin.
const ROUND: f64 = 0.004;
/// Ratio, derived: widths are off by half of a tenth.
/// Widths of shapes are rounded to powers of 1.1.
pub(super) const SHAPED: f64 = 0.06;

const USUAL: Label = Label {
    case: "kernels against the twin",
    quantity: HEARD,
    why: "Lanes of eight, steps of a bin and one convolution a width, against loops over Gaussians and \
          bins in f64.",
};

const SUMS: Label = Label {
    case: "kernels against the twin",
    quantity: "what bins say of each Gaussian, errors relative to the largest",
    why: "Numerator and denominator of the multiplicative step, gradient and information of the mean: \
          each is gathered by the way that echoes were spread.",
};

const DECADES: Label = Label {
    case: "strengths over twelve decades",
    quantity: "power at the worst Gaussian, errors relative to its own",
    why: "Bins are sums of what reaches them: no running sum carries a strong echo to a weak one.",
};

const CROWD: Label = Label {
    case: "a crowd in one bin",
    quantity: HEARD,
    why: "Energies of one place are added up in single precision, one after the other.",
};

const SMALL: Label = Label {
    case: "small pings",
    quantity: HEARD,
    why: "Kernels read whole groups of bins: there is room beyond the last, and it counts nothing.",
};

const STEPS: Label = Label {
    case: "silence and saturation",
    quantity: "factor of the worst strength's step, within 0.05 to 20",
    why: "Division by the prediction twice, never by its square.",
};

const OVERFLOW: Label = Label {
    case: "silence and saturation",
    quantity: "steps that are numbers, and wrong",
    why: "What overflows is no number, and the mapper leaves such a strength as it was; it refuses \
          such pings before.",
};

const CALM: Label = Label {
    case: "silence and saturation",
    quantity: "gradients and information that are no numbers",
    why: "A bin says no more than four times what was predicted.",
};

fn nothing() -> Comparison {
    Comparison::of(f64::NAN, f64::NAN, 1.0)
}

pub(super) fn worst(comparisons: impl IntoIterator<Item = Comparison>) -> Comparison {
    let all = comparisons.into_iter();
    all.reduce(Comparison::worse).unwrap_or_else(nothing)
}

pub(super) fn heard(trial: &Trial) -> Comparison {
    let truth = trial.twin().predicted(NOISE.into());
    Comparison::of_many(&truth, &trial.program())
}

pub(super) fn against_twin(seed: u64, quick: bool) -> Vec<Row> {
    let scenes = if quick { 4 } else { 40 };
    let mut draw = Draw::new(seed, 500);
    let trials: Vec<Trial> = (0..scenes).map(|_| Trial::random(&mut draw, 300)).collect();
    let input = format!("{scenes} pings of 300 Gaussians");
    let mut rows = vec![worst(trials.iter().map(heard)).row(USUAL, input.clone(), SHAPED)];
    let round = |trial: &Trial| {
        let elements = trial.elements.iter().map(|element| Element {
            covariance_m2: plain(Vec3::ZERO).covariance_m2,
            ..*element
        });
        Trial {
            elements: elements.collect(),
            ..trial.clone()
        }
    };
    let of_round = trials.iter().map(|trial| heard(&round(trial)));
    rows.push(worst(of_round).row(USUAL, input + ", round", ROUND));
    for (name, which) in ["numerator", "denominator", "gradient", "information"]
        .into_iter()
        .zip(0..)
    {
        let each = trials.iter().map(|trial| said(&round(trial))[which]);
        rows.push(worst(each).row(SUMS, format!("{name}, round"), 0.03));
    }
    rows
}

/// What bins say, in the order of the rows.
fn said(trial: &Trial) -> [Comparison; 4] {
    let twin = trial.twin();
    let predicted = twin.predicted(NOISE.into());
    let swell = |(bin, power): (usize, &f64)| power * (1.2 + (bin as f64 * 0.37).sin());
    let measured: Vec<f64> = predicted.iter().enumerate().map(swell).collect();
    let single: Vec<f32> = measured.iter().map(|&power| power as f32).collect();
    let (mut listener, _) = trial.listener(simd_level::level());
    let (sums, truth) = (
        listener.step_sums(&single),
        twin.step_sums(&measured, &predicted),
    );
    let step = [0, 1].map(|k| {
        let truth: Vec<f64> = truth.iter().map(|sums| sums[k]).collect();
        let found: Vec<f32> = sums.iter().map(|sums| sums[k]).collect();
        Comparison::of_many(&truth, &found)
    });
    let (scores, truth) = (listener.scores(&single), twin.scores(&measured, &predicted));
    let gradients = (
        truth.iter().flat_map(|s| s.0.to_array()),
        scores.iter().flat_map(|s| s.gradient.to_array()),
    );
    let information = (
        truth.iter().flat_map(|s| s.1.to_cols_array()),
        scores
            .iter()
            .flat_map(|s| s.information.to_mat3().to_cols_array()),
    );
    let of = |truth: Vec<f64>, found: Vec<f32>| Comparison::of_many(&truth, &found);
    [
        step[0],
        step[1],
        of(gradients.0.collect(), gradients.1.collect()),
        of(information.0.collect(), information.1.collect()),
    ]
}

pub(super) fn decades(_seed: u64, _quick: bool) -> Vec<Row> {
    let element = |(k, of): (i32, fn(Vec3) -> Element)| {
        let strength = Vec3::splat(10_f32.powi(k));
        Element {
            ahead: strength,
            behind: strength,
            ..of(Vec3::new(1.5 + 0.7 * k as f32, 0.005, 0.1))
        }
    };
    let disc: fn(Vec3) -> Element =
        |at_m| shaped(at_m, glam::Quat::IDENTITY, Vec3::new(0.01, 0.03, 0.05));
    let round: fn(Vec3) -> Element = plain;
    [("round", round, ROUND), ("discs", disc, SHAPED)]
        .map(|(name, of, limit)| {
            let mut trial = Trial::of((0..13).map(|k| element((k, of))).collect());
            trial.elements.reverse();
            let (twin, program) = (trial.twin(), trial.program());
            let truth = twin.predicted(NOISE.into());
            let own = |echo| {
                let bins: Vec<usize> = twin.shares(echo).map(|(bin, ..)| bin).collect();
                let truth: Vec<f64> = bins.iter().map(|&bin| truth[bin]).collect();
                let program: Vec<f32> = bins.iter().map(|&bin| program[bin]).collect();
                Comparison::of_many(&truth, &program)
            };
            let each = worst(twin.echoes.iter().flatten().map(own));
            each.row(DECADES, format!("13 {name}, 1 to 10^12"), limit)
        })
        .into()
}

pub(super) fn crowds(_seed: u64, quick: bool) -> Vec<Row> {
    let most = if quick { 100_000 } else { 1_000_000 };
    let row = |count: usize, limit: f64| {
        let one = Trial::of(vec![plain(Vec3::new(5.0, 0.01, 0.3))]);
        let all = Trial::of(vec![one.elements[0]; count]);
        let of_one = one.twin().predicted(0.0);
        let truth: Vec<f64> = of_one
            .iter()
            .map(|power| count as f64 * power + f64::from(NOISE))
            .collect();
        let comparison = Comparison::of_many(&truth, &all.program());
        comparison.row(CROWD, format!("{count} in one place"), limit)
    };
    vec![row(10_000, ROUND), row(most, 0.05)]
}

pub(super) fn small(_seed: u64, _quick: bool) -> Vec<Row> {
    let at = |range_m: f32| Trial::of(vec![plain(Vec3::new(range_m, 0.0, 0.2))]);
    let mut rows = Vec::new();
    for bin_count in [1, 2, 7, 33] {
        let mut trial = at(5.01);
        trial.geometry.range_start_m = 5.0;
        trial.geometry.bin_count = bin_count;
        rows.push(heard(&trial).row(SMALL, format!("{bin_count} bins"), ROUND));
    }
    rows.push(heard(&at(5.01)).row(SMALL, "one Gaussian", ROUND));
    rows.push(heard(&Trial::of(Vec::new())).row(SMALL, "no Gaussian", 1e-6));
    let mut none = at(5.01);
    none.geometry.bin_count = 0;
    let heard = none.program().len() as f64;
    rows.push(Comparison::of(0.0, heard, 1.0).row(SMALL, "no bin", 0.0));
    rows
}

pub(super) fn loudness(seed: u64, _quick: bool) -> Vec<Row> {
    let trial = Trial::random(&mut Draw::new(seed, 510), 100);
    let (twin, mut rows) = (trial.twin(), Vec::new());
    let predicted = twin.predicted(NOISE.into());
    let factor = |[n, d]: [f64; 2]| match d > 0.0 {
        true => (n / d).sqrt().clamp(0.05, 20.0),
        false => 1.0,
    };
    for (name, power, overflows) in [
        ("all zero", 0.0, false),
        ("all subnormal", 1e-40, false),
        ("all 10^20", 1e20, false),
        ("all 10^30", 1e30, true),
        ("all at the largest f32", f32::MAX, true),
    ] {
        let (single, measured) = (vec![power; 600], vec![f64::from(power); 600]);
        let truth = twin
            .step_sums(&measured, &predicted)
            .into_iter()
            .map(factor);
        let (mut listener, _) = trial.listener(simd_level::level());
        let found = listener.step_sums(&single).into_iter();
        let found = found.map(|sums| factor(sums.map(f64::from)));
        rows.push(match overflows {
            false => {
                let (truth, found): (Vec<f64>, Vec<f64>) = truth.zip(found).unzip();
                Comparison::of_many(&truth, &found).row(STEPS, name, 0.01)
            }
            true => {
                let wrong = truth.zip(found).filter(|(t, f)| (t - f).abs() > 0.01 * t);
                Comparison::of(0.0, wrong.count() as f64, 1.0).row(OVERFLOW, name, 0.0)
            }
        });
        let spoilt = listener.scores(&single);
        let spoilt = spoilt.iter().filter(|score| {
            let information = score.information.to_mat3();
            !(score.gradient.is_finite() && information.is_finite())
        });
        let spoilt = spoilt.count() as f64;
        rows.push(Comparison::of(0.0, spoilt, 1.0).row(CALM, name, 0.0));
    }
    rows.sort_by_key(|row| row.quantity);
    rows
}
