//! Kernels held to the plain twin.

use fearless_simd::{Level, dispatch};
use glam::{EulerRot, Mat3, Quat, Vec3};

use crate::heard::{Bins, Detail, PoseScore, View};
use crate::pulse::Weighted;
use crate::twin::Twin;
use crate::{
    Beam, Element, Listener, PingGeometry, PingPose, Scene, SymmetricMat3, lanes, simd_level,
};

const ROUND_M: f32 = 0.03;
const NOISE: f32 = 1e-4;

fn geometry() -> PingGeometry {
    let turn = Quat::from_euler(EulerRot::ZYX, 0.4, -0.2, 0.3);
    PingGeometry {
        pose: PingPose {
            position_m: Vec3::new(1.0, -2.0, 0.5),
            axes: Mat3::from_quat(turn),
            drift_per_m: Vec3::new(1e-4, 2e-4, -1e-4),
            reference_range_m: 5.0,
        },
        range_start_m: 0.3,
        bin_length_m: 0.02,
        bin_count: 500,
        range_variance_m2: 1e-4,
        azimuth_variance_rad2: 1e-5,
        beam: Beam::default(),
    }
}

/// Gaussians in and beside the fan and behind the sensor, of all shapes or round.
fn elements(geometry: &PingGeometry, is_round: bool) -> Vec<Element> {
    let element = |i| {
        let t = i as f32;
        let in_beam = Vec3::new(
            5.0 + 6.0 * (t * 0.7).sin(),
            0.3 * (t * 1.3).sin(),
            4.0 * (t * 0.9).cos(),
        );
        let rotation = Quat::from_euler(EulerRot::ZYX, t * 0.37, t * 0.11, t * 0.23);
        let axes = Mat3::from_quat(rotation) * Mat3::from_diagonal(Vec3::new(0.05, 0.03, 0.01));
        Element {
            mean_m: geometry.pose.position_m + geometry.pose.axes * in_beam,
            covariance_m2: match is_round {
                true => SymmetricMat3::isotropic(ROUND_M),
                false => SymmetricMat3::of(axes * axes.transpose()),
            },
            ahead: Vec3::new(1.0, 2.0, 3.0) + t,
            behind: Vec3::new(5.0, 7.0, 9.0) + t,
        }
    };
    (0..2003).map(element).collect()
}

struct Trial {
    twin: Twin,
    listener: Listener,
    predicted: Vec<f32>,
}

impl Trial {
    fn of(geometry: &PingGeometry, elements: &[Element], level: Level) -> Self {
        let scene = Scene::of(elements);
        let mut listener = Listener::with_level(level);
        let predicted = listener.hear(&scene, geometry, NOISE, Detail::Full);
        Self {
            predicted: predicted.to_vec(),
            twin: Twin::of(geometry, elements),
            listener,
        }
    }

    fn usual(is_round: bool) -> Self {
        let geometry = geometry();
        Self::of(
            &geometry,
            &elements(&geometry, is_round),
            simd_level::level(),
        )
    }
}

/// Largest error over the largest that is true.
fn worst<A: Into<f64> + Copy>(found: &[A], truth: &[f64]) -> f64 {
    assert_eq!(found.len(), truth.len());
    let largest = truth.iter().fold(0.0_f64, |most, t| most.max(t.abs()));
    let errors = found.iter().zip(truth).map(|(&f, t)| (f.into() - t).abs());
    errors.fold(0.0, f64::max) / largest
}

#[test]
fn eight_at_a_time_are_heard_as_one_at_a_time() {
    for is_round in [true, false] {
        let trial = Trial::usual(is_round);
        let hearing = &trial.listener.hearing;
        let rows = &hearing.rows;
        let heard: Vec<usize> = hearing.heard(0..rows.len()).collect();
        let expected: Vec<_> = trial.twin.echoes.iter().flatten().collect();
        let mut count = 0;
        for echo in expected.iter().filter(|echo| echo.energy > 1e-7) {
            let range_m = echo.range_m;
            let near = |a: f32, b: f64, most: f64| (f64::from(a) - b).abs() <= most;
            let is_it = |&&row: &&usize| {
                near(rows.range_m[row], range_m, 2e-5)
                    && near(rows.azimuth_rad[row], echo.azimuth_rad, 1e-5)
                    && near(rows.energy[row], echo.energy, 2e-3 * echo.energy)
            };
            // One beyond either end, or at the very edge of the beam, may fall to either side.
            let reach_m = 3.0 * echo.sigma_m + 0.03;
            let is_inside = range_m > 0.3 + reach_m && range_m < 10.3 - reach_m;
            let off = echo.azimuth_rad.powi(2) / echo.azimuth_variance_rad2;
            if !is_inside || off > 7.83 {
                continue;
            }
            let row = *heard.iter().find(is_it).expect("heard");
            assert!(near(rows.range_sigma_m[row], echo.sigma_m, 4e-5));
            assert!(near(rows.lever_m[row], echo.lever_m, 1e-4));
            let axes = [
                (rows.range_axis_of(row), echo.range_axis),
                (rows.azimuth_axis_of(row), echo.azimuth_axis),
            ];
            let off = axes.map(|(a, b)| (a.as_dvec3() - b).length());
            assert!(off[0] < 1e-5 && off[1] < 1e-5);
            let power = echo.energy * echo.strength;
            assert!(near(rows.echo[row], power, 2e-3 * power));
            count += 1;
        }
        assert!(count > 100 && count <= heard.len(), "{count}");
    }
}

#[test]
fn one_by_itself_is_projected_as_the_twin_has_it() {
    let geometry = geometry();
    let (elements, mut count) = (elements(&geometry, false), 0);
    let twin = Twin::of(&geometry, &elements);
    for (element, echo) in elements.iter().zip(&twin.echoes) {
        let splat = geometry.project(element.mean_m, &element.covariance_m2);
        // One at the very edge of a cut may fall to either side.
        let (Some(splat), Some(echo)) = (splat, echo) else {
            let energy = echo.map_or(0.0, |echo| echo.energy as f32);
            assert!(splat.map_or(energy, |splat| splat.energy) < 1e-4);
            continue;
        };
        count += 1;
        let near = |a: f32, b: f64, most: f64| (f64::from(a) - b).abs() <= most;
        assert!(near(splat.range_m, echo.range_m, 2e-5));
        assert!(near(splat.range_sigma_m, echo.sigma_m, 4e-5));
        assert!(near(splat.azimuth_rad, echo.azimuth_rad, 1e-5));
        assert!(near(splat.energy, echo.energy, 2e-3 * echo.energy));
        assert!((splat.range_axis.as_dvec3() - echo.range_axis).length() < 1e-5);
    }
    assert!(count > 100, "{count}");
}

#[test]
fn echoes_spread_as_the_sum_of_each_by_itself() {
    // Widths of shapes are rounded to a twentieth.
    for (is_round, allowed) in [(true, 0.003), (false, 0.03)] {
        let trial = Trial::usual(is_round);
        let truth = trial.twin.predicted(NOISE.into());
        let off = worst(&trial.predicted, &truth);
        assert!(off < allowed, "{off}");
        let sum = trial.predicted.iter().map(|&p| f64::from(p)).sum::<f64>();
        let ratio = sum / truth.iter().sum::<f64>();
        assert!((ratio - 1.0).abs() < 2e-3, "{ratio}");
    }
}

#[test]
fn bins_tell_strengths_and_places_what_they_tell_the_twin() {
    // A shape's width is off by a twentieth at most, a score by twice that and by what ε is off.
    for (is_round, allowed) in [(true, 0.02), (false, 0.15)] {
        let mut trial = Trial::usual(is_round);
        let truth = trial.twin.predicted(NOISE.into());
        let measured: Vec<f64> = truth
            .iter()
            .enumerate()
            .map(|(bin, power)| power * (1.2 + (bin as f64 * 0.37).sin()))
            .collect();
        let single: Vec<f32> = measured.iter().map(|&power| power as f32).collect();
        let found = trial.listener.step_sums(&single);
        let expected = trial.twin.step_sums(&measured, &truth);
        for k in 0..2 {
            let found: Vec<f32> = found.iter().map(|sums| sums[k]).collect();
            let expected: Vec<f64> = expected.iter().map(|sums| sums[k]).collect();
            let off = worst(&found, &expected);
            assert!(off < allowed, "sum {k}: {off}");
        }
        let found = trial.listener.scores(&single);
        let expected = trial.twin.scores(&measured, &truth);
        let parts = |v: glam::DVec3| v.to_array();
        let gradient: Vec<f64> = found
            .iter()
            .flat_map(|s| parts(s.gradient.as_dvec3()))
            .collect();
        let truth: Vec<f64> = expected.iter().flat_map(|s| parts(s.0)).collect();
        let off = worst(&gradient, &truth);
        assert!(off < allowed, "gradient: {off}");
        let of = |s: &crate::heard::Score| s.information.to_mat3().as_dmat3().to_cols_array();
        let information: Vec<f64> = found.iter().flat_map(of).collect();
        let truth: Vec<f64> = expected.iter().flat_map(|s| s.1.to_cols_array()).collect();
        let off = worst(&information, &truth);
        assert!(off < allowed, "information: {off}");
    }
}

#[test]
fn the_twins_score_is_the_slope_of_the_likelihood() {
    let geometry = geometry();
    let ahead = geometry.pose.axes * Vec3::new(5.0, 0.02, 0.4);
    let mean_m = geometry.pose.position_m + ahead;
    let at = |mean_m: Vec3| {
        [Element::even(
            mean_m,
            SymmetricMat3::isotropic(ROUND_M),
            1.0,
        )]
    };
    let noise = 1e-7;
    let of = |mean_m| Twin::of(&geometry, &at(mean_m));
    let measured = of(mean_m + 0.004 * ahead.normalize()).predicted(noise);
    let log_likelihood = |mean_m| {
        let predicted = of(mean_m).predicted(noise);
        let bins = predicted.iter().zip(&measured);
        bins.map(|(p, m)| -(p.ln() + m / p)).sum::<f64>()
    };
    let twin = of(mean_m);
    let (gradient, information) = twin.scores(&measured, &twin.predicted(noise))[0];
    let step_m = 1.0 / 4096.0;
    for axis in [geometry.pose.axes.x_axis, geometry.pose.axes.y_axis] {
        let [after, before] = [step_m, -step_m].map(|by| log_likelihood(mean_m + by * axis));
        let slope = (after - before) / (2.0 * f64::from(step_m));
        let told = gradient.dot(axis.as_dvec3());
        // Of what spreads with range, and of a bin's middle for all of it, it knows nothing.
        assert!((told / slope - 1.0).abs() < 0.1, "{told} {slope}");
    }
    let forth = ahead.normalize().as_dvec3();
    assert!(forth.dot(information * forth) > 0.0 && gradient.dot(forth) > 0.0);
}

/// What a ping that measured this says of its pose, and its log likelihood above that without echoes.
fn pose_score(scene: &Scene, geometry: &PingGeometry, measured: &[f32]) -> (PoseScore, f64) {
    let level = simd_level::level();
    let mut listener = Listener::with_level(level);
    let predicted = listener.hear(scene, geometry, NOISE, Detail::Full).to_vec();
    let (view, alone) = (View::of(geometry, true), vec![NOISE; predicted.len()]);
    let mut weight = vec![1.0; geometry.bin_count as usize];
    weight.resize(predicted.len(), 0.0);
    let bins = Bins {
        predicted: &predicted,
        measured,
        weight: &weight,
    };
    let score = dispatch!(level, simd => listener.hearing.tell_pose(simd, &view, bins, &alone));
    (score, bins.gain_nats(&alone))
}

#[test]
fn a_poses_score_is_the_slope_of_the_likelihood() {
    let geometry = geometry();
    let scene = Scene::of(
        &elements(&geometry, true)
            .into_iter()
            .step_by(25)
            .collect::<Vec<_>>(),
    );
    let moved = |state: usize, by: f32| {
        let mut moved = geometry;
        match state {
            0..3 => moved.pose.position_m[state] += by,
            3 => moved.pose.axes = Mat3::from_rotation_z(by) * moved.pose.axes,
            _ => moved.range_start_m += by,
        }
        moved
    };
    let mut listener = Listener::with_level(simd_level::level());
    // Of a sensor that is elsewhere by a centimetre or two.
    let mut elsewhere = moved(0, 0.012);
    elsewhere.pose.position_m += Vec3::new(0.0, -0.02, 0.01);
    let measured = listener
        .hear(&scene, &elsewhere, NOISE, Detail::Full)
        .to_vec();
    let (score, _) = pose_score(&scene, &geometry, &measured);
    for (state, by) in [(0, 1e-3), (1, 1e-3), (2, 1e-3), (3, 2e-4), (4, 1e-3)] {
        let gain = |by: f32| pose_score(&scene, &moved(state, by), &measured).1;
        let slope = (gain(by) - gain(-by)) / f64::from(2.0 * by);
        let (told, size) = (
            score.gradient[state],
            score.information[state][state].sqrt(),
        );
        assert!(
            (told - slope).abs() < 0.15 * slope.abs() + 0.5 * size,
            "{state}: {told} for {slope}"
        );
        assert!(score.information[state][state] > 0.0);
    }
}

#[test]
fn what_bins_say_comes_back_the_way_that_echoes_went() {
    // Of any numbers per bin: Σ_b x_b Î_b = Σ_i e_i (Σ_b K_i(b) x_b).
    for is_round in [true, false] {
        let mut trial = Trial::usual(is_round);
        let x: Vec<f32> = (0..500)
            .map(|bin| 1.5 + (bin as f32 * 0.37).sin())
            .collect();
        let mut gathered = Vec::new();
        let hearing = &mut trial.listener.hearing;
        dispatch!(simd_level::level(), simd => {
            hearing.pulses.gather(simd, Weighted::Energy, &x, &mut gathered);
        });
        let there = trial.predicted.iter().zip(&x);
        let there: f64 = there
            .map(|(&a, &b)| f64::from(a - NOISE) * f64::from(b))
            .sum();
        let back = (0..hearing.rows.len()).map(|row| {
            let found = hearing.rows.found(row, &gathered);
            f64::from(hearing.rows.echo[row]) * f64::from(found)
        });
        let back: f64 = back.sum();
        assert!((there / back - 1.0).abs() < 1e-5, "{there} {back}");
    }
}

#[test]
fn a_rows_own_bins_are_those_it_was_spread_over() {
    let geometry = geometry();
    // In the middle, and over either end of the ping.
    for range_m in [5.0, 0.305, 10.29] {
        let mut alone = elements(&geometry, true)[0];
        alone.mean_m = geometry.pose.position_m + geometry.pose.axes * Vec3::X * range_m;
        let trial = Trial::of(&geometry, &[alone], simd_level::level());
        let hearing = &trial.listener.hearing;
        assert!(hearing.rows.len() == 1 && hearing.rows.energy[0] > 0.0);
        let (bins, shares) = hearing.pulses.echo_of(&hearing.rows, 0);
        let echo = hearing.rows.echo[0];
        for (bin, &power) in trial.predicted.iter().enumerate() {
            let own = bins.contains(&bin).then(|| shares[bin - bins.start]);
            let off = (own.unwrap_or(0.0) * echo + NOISE - power).abs();
            assert!(off < 0.02 * echo, "{bin}: {own:?} {power}");
        }
    }
}

#[test]
fn levels_of_one_kind_hear_the_same_bits() {
    let geometry = geometry();
    let elements = elements(&geometry, false);
    let of = |level: Level| {
        let trial = Trial::of(&geometry, &elements, level);
        trial
            .predicted
            .iter()
            .map(|p| p.to_bits())
            .collect::<Vec<_>>()
    };
    assert!(lanes::avx2().is_none_or(|avx2| of(avx2) == of(Level::new())));
}

#[test]
fn what_is_no_gaussian_is_left_out_and_blocks_change_nothing() {
    let geometry = geometry();
    let sound = elements(&geometry, true);
    let mut spoilt = sound.clone();
    for (index, poison) in [f32::NAN, f32::INFINITY, f32::MAX].into_iter().enumerate() {
        let mut bad = sound[index];
        bad.mean_m.y = poison;
        spoilt.push(bad);
        let mut bad = sound[index];
        bad.covariance_m2.diagonal.z = poison;
        spoilt.push(bad);
        let mut bad = sound[index];
        bad.behind.x = poison;
        spoilt.push(bad);
    }
    let (alone, among) = (Scene::of(&sound), Scene::of(&spoilt));
    assert_eq!((alone.len(), among.len()), (2003, 2003));
    let mut listener = Listener::default();
    let mut heard = |scene: &Scene| {
        listener
            .hear(scene, &geometry, NOISE, Detail::Strength)
            .to_vec()
    };
    assert_eq!(heard(&alone), heard(&among));
    // One by one, each in a block of its own.
    let mut sum = vec![0.0_f64; 500];
    for element in &sound {
        let one = heard(&Scene::of(std::slice::from_ref(element)));
        for (sum, power) in sum.iter_mut().zip(one) {
            *sum += f64::from(power - NOISE);
        }
    }
    let all: Vec<f32> = heard(&alone).iter().map(|power| power - NOISE).collect();
    assert!(worst(&all, &sum) < 1e-4);
}
