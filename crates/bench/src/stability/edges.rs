//! The kernels of one ping where geometry is singular, shapes are extreme, numbers are none, or instructions are others.

use echosplat_measurement::simd_level;
use glam::Vec3;

use super::Row;
use super::kernels::{HEARD, SHAPED, heard, worst};
use super::row::{Comparison, Label};
use super::scene::{NOISE, Trial, plain, shaped};
use crate::draw::Draw;

const PLACES: Label = Label {
    case: "singular places and edges",
    quantity: "energy, errors relative to the same on the axis",
    why: "Nearer than 5 cm, behind, beside the beam or outside the fan nothing is heard; guards are \
          written so that NaN fails them.",
};

const SHAPES: Label = Label {
    case: "needles and discs over nine decades",
    quantity: HEARD,
    why: "The cross-section is found by Cholesky, with azimuth in metres; no determinant is a \
          difference of large numbers.",
};

const FAR: Label = Label {
    case: "far coordinates",
    quantity: HEARD,
    why: "The sensor is taken from the mean before anything else: what both have in common cancels \
          exactly.",
};

const POISON: Label = Label {
    case: "poison in one Gaussian",
    quantity: "numbers out of 15 that spoil another's echo",
    why: "A Gaussian with a number that single precision cannot work with is left out whole.",
};

const LEVELS: Label = Label {
    case: "instructions of the processor",
    quantity: "numbers that differ in any bit from the best level's of its kind",
    why: "Lanes do not touch one another: a level changes how many run at once, not what each does.",
};

const KINDS: Label = Label {
    case: "instructions of the processor",
    quantity: HEARD,
    why: "Without fused multiply-add each product is rounded: the last digits differ.",
};

pub(super) fn places(_seed: u64, _quick: bool) -> Vec<Row> {
    let polar = |azimuth_deg: f32, elevation_deg: f32| {
        let (sin_a, cos_a) = azimuth_deg.to_radians().sin_cos();
        let (sin_e, cos_e) = elevation_deg.to_radians().sin_cos();
        5.0 * Vec3::new(cos_e * cos_a, cos_e * sin_a, sin_e)
    };
    let row = |(input, mean_m): (&str, Vec3)| {
        let energy = |mean_m: Vec3| {
            let trial = Trial::of(vec![plain(mean_m)]);
            let sum = |power: f64| power - f64::from(NOISE);
            let truth: f64 = trial
                .twin()
                .predicted(NOISE.into())
                .into_iter()
                .map(sum)
                .sum();
            let program = trial.program().into_iter();
            (truth, program.map(|p| sum(p.into())).sum::<f64>())
        };
        let on_axis = energy(Vec3::X * mean_m.length().clamp(0.06, 11.0)).0;
        let (truth, program) = energy(mean_m);
        Comparison::of(truth, program, on_axis).row(PLACES, input, 0.01)
    };
    [
        ("at the sensor", Vec3::ZERO),
        ("10⁻²⁵ m before it", Vec3::new(1e-25, 0.0, 0.0)),
        ("4.9 cm before it", Vec3::new(0.049, 0.0, 0.0)),
        ("5.1 cm before it", Vec3::new(0.051, 0.0, 0.0)),
        ("behind, 180°", Vec3::new(-4.0, 1e-4, 0.1)),
        ("behind, −180°", Vec3::new(-4.0, -1e-4, 0.1)),
        ("straight above", Vec3::new(0.0, 0.0, 3.0)),
        ("10⁻²⁰ m off the vertical", Vec3::new(1e-20, 0.0, -3.0)),
        ("the fan's edge, 25°", polar(0.0, 25.0)),
        ("beyond it, 33°", polar(0.0, -33.0)),
        ("the beam's edge, 1.2°", polar(1.2, 0.0)),
        ("beyond it, 3°", polar(-3.0, 0.0)),
        ("beyond the ping's end", Vec3::new(12.5, 0.0, 0.0)),
        ("across its end", Vec3::new(11.999, 0.0, 0.0)),
    ]
    .map(row)
    .into()
}

pub(super) fn shapes(seed: u64, quick: bool) -> Vec<Row> {
    let count = if quick { 20 } else { 300 };
    let kinds = [
        ("balls", Vec3::new(1.0, 1.0, 1.01)),
        ("needles 1:30", Vec3::new(1.0, 0.033, 0.033)),
        ("discs 1:30", Vec3::new(1.0, 1.0, 0.033)),
        ("blades 1:30:900", Vec3::new(1.0, 0.033, 0.0011)),
    ];
    let mut rows = Vec::new();
    for (name, scale) in kinds {
        let mut draw = Draw::new(seed, 520);
        let mut of_decade = |decade: i32| {
            let longest_m = 10_f32.powi(decade);
            let trial = |_| {
                let mean_m = Vec3::new(5.0, 0.01, 0.4) + 0.02 * draw.cube();
                Trial::of(vec![shaped(mean_m, draw.rotation(), longest_m * scale)])
            };
            worst((0..count).map(trial).map(|trial| heard(&loud(trial))))
        };
        let all = worst((-5..=4).map(&mut of_decade));
        let input = format!("{name}, 10 µm to 10 km, worst of {count} each");
        rows.push(all.row(SHAPES, input, SHAPED));
    }
    rows
}

/// As strong as stands above the noise, however small.
fn loud(mut trial: Trial) -> Trial {
    for element in &mut trial.elements {
        let area_m2 = element.covariance_m2.diagonal.element_sum();
        let strength = Vec3::splat((1e3 / area_m2).clamp(1.0, 1e20));
        (element.ahead, element.behind) = (strength, strength);
    }
    trial
}

pub(super) fn far(seed: u64, _quick: bool) -> Vec<Row> {
    let row = |distance_m: f32| {
        let mut draw = Draw::new(seed, 530);
        let each = (0..50).map(|_| {
            let away = distance_m * Vec3::new(1.0, -0.7, 0.01);
            let mut trial = Trial::of(vec![plain(away + Vec3::new(5.0, 0.0, 0.3))]);
            trial.geometry.pose.position_m = away + 0.01 * draw.cube();
            heard(&trial)
        });
        worst(each).row(FAR, format!("{distance_m} m from the origin"), 0.005)
    };
    [0.0, 1e3, 1e4, 1e5].map(row).into()
}

pub(super) fn poison(_seed: u64, _quick: bool) -> Vec<Row> {
    let neighbour = plain(Vec3::new(8.0, 0.02, -0.2));
    let alone = Trial::of(vec![neighbour]).program();
    let spoilt = |poison: f32| {
        let spoils = |number: usize| {
            let mut bad = plain(Vec3::new(5.0, 0.0, 0.2));
            let covariance = &mut bad.covariance_m2;
            let triples = [
                &mut bad.mean_m,
                &mut covariance.diagonal,
                &mut covariance.mixed,
                &mut bad.ahead,
                &mut bad.behind,
            ];
            if let Some(triple) = triples.into_iter().nth(number / 3) {
                triple[number % 3] = poison;
            }
            let with = Trial::of(vec![bad, neighbour]).program();
            // The neighbour's own bins, far from the other's.
            let own = 350..450;
            let is_same = with[own.clone()] == alone[own];
            !(is_same && with.iter().all(|power| power.is_finite()))
        };
        (0..15).filter(|&number| spoils(number)).count() as f64
    };
    [
        ("NaN", f32::NAN),
        ("∞", f32::INFINITY),
        ("−∞", f32::NEG_INFINITY),
        ("largest f32", f32::MAX),
        ("least f32", f32::MIN),
        ("subnormal", 1e-40),
    ]
    .map(|(name, number)| Comparison::of(0.0, spoilt(number), 1.0).row(POISON, name, 0.0))
    .into()
}

pub(super) fn levels(seed: u64, _quick: bool) -> Vec<Row> {
    let trial = Trial::random(&mut Draw::new(seed, 540), 2_000);
    let of = |level| {
        let (mut listener, mut numbers) = trial.listener(level);
        let measured: Vec<f32> = numbers.iter().map(|power| 1.3 * power).collect();
        let sums = listener.step_sums(&measured).into_iter().flatten();
        numbers.extend(sums);
        let scores = listener.scores(&measured).into_iter();
        numbers.extend(scores.flat_map(|score| score.gradient.to_array()));
        numbers
    };
    let all = simd_level::levels();
    let mut rows = Vec::new();
    for kind in [true, false] {
        let of_kind = |&&level: &&_| simd_level::has_fused_multiply_add(level) == kind;
        let mut of_kind = all.iter().filter(of_kind);
        let Some(&best) = of_kind.next() else {
            continue;
        };
        let best_name = simd_level::name_of(best);
        let first = of(best);
        for &level in of_kind {
            let other = of(level);
            let pairs = first.iter().zip(&other);
            let differing = pairs.filter(|(a, b)| a.to_bits() != b.to_bits()).count();
            let input = format!("{} against {best_name}", simd_level::name_of(level));
            rows.push(Comparison::of(0.0, differing as f64, 1.0).row(LEVELS, input, 0.0));
        }
        let truth = trial.twin().predicted(NOISE.into());
        let comparison = Comparison::of_many(&truth, &first[..truth.len()]);
        rows.push(comparison.row(KINDS, best_name, SHAPED));
    }
    rows.sort_by_key(|row| row.quantity);
    rows
}
