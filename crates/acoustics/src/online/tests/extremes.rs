//! Where plain single precision breaks: each case against the f64 twin or the value it must have.

use super::*;
use crate::{LOG_SCALE_LIMITS, OPACITY_MAX, Parameters};
use echosplat_model::glam::{DVec3, Quat, Vec3};

fn plain() -> Parameters {
    Parameters {
        mean_m: Vec3::new(6.0, 0.01, 0.3),
        rotation: Quat::IDENTITY,
        log_scale: Vec3::splat(0.05f32.ln()),
        opacity_logit: 0.0,
        reflectivity_log: 0.0,
    }
}

fn of(bodies: impl IntoIterator<Item = Parameters>) -> GaussianArrays {
    let mut gaussians = GaussianArrays::new();
    for body in bodies {
        gaussians.push(body);
    }
    gaussians
}

fn assert_close(
    what: &str,
    options: OnlineOptions,
    geometry: &PingGeometry,
    gaussians: &GaussianArrays,
) {
    let loss = weights(&mut Dice::new(11), geometry.bin_count);
    let (forward, backward) = errors(Level::new(), options, geometry, gaussians, &loss);
    println!("{what}: forward {forward:e}, backward {backward:e}");
    assert!(forward < 1e-4, "{what}: forward {forward:e}");
    assert!(backward < 1e-3, "{what}: backward {backward:e}");
}

fn assert_finite(gradients: &GradientArrays) {
    for field in gradients.fields() {
        assert!(field.iter().all(|g| g.is_finite()));
    }
}

#[test]
fn covariances_of_condition_1e2_to_1e12() {
    let geometry = sample::geometry();
    let mut dice = Dice::new(1);
    for exponent in [2, 4, 6, 8, 10, 12] {
        let ratio = 10f32.powi(exponent).sqrt();
        let (widest, thinnest) = (0.5f32.min(1e-3 * ratio), 0.5f32.min(1e-3 * ratio) / ratio);
        let needle = Vec3::new(widest, thinnest, thinnest).map(f32::ln);
        let disc = Vec3::new(widest, widest, thinnest).map(f32::ln);
        for (shape, log_scale) in [("needles", needle), ("discs", disc)] {
            let bodies = (0..40).map(|_| Parameters {
                log_scale,
                rotation: dice.rotation(),
                ..sample::in_view(&mut dice, 3.0, 10.0, [0.1, 0.2])
            });
            let gaussians = of(bodies.collect::<Vec<_>>());
            assert_close(
                &format!("{shape} of condition 1e{exponent}"),
                SHADOWING,
                &geometry,
                &gaussians,
            );
        }
    }
}

/// Positions are relative to the map's origin, an f64 point: what is far from the world's origin
/// reaches here as if it were near. Shifts that f64 and f32 both hold exactly give the same bits.
#[test]
fn far_origins_change_no_bit() {
    let (mut geometry, mut gaussians) = sample::bench_scene(2);
    geometry.pose.position_m = Vec3::new(0.5, -0.25, 0.125);
    // Multiples of 2⁻²⁰ m are exact in f64 out to 10⁹ m.
    for number in gaussians.mean_m.iter_mut().flatten() {
        *number = (*number * 1_048_576.0).round() / 1_048_576.0;
    }
    let near = render(SHADOWING, &geometry, &gaussians, &[1.0; 600]);
    for far in [1e5, 1e6, 1e7] {
        let origin = DVec3::new(far, -far, far);
        let reached = |m: Vec3| ((origin + m.as_dvec3()) - origin).as_vec3();
        let (mut moved_geometry, mut moved) = (geometry, gaussians.clone());
        moved_geometry.pose.position_m = reached(geometry.pose.position_m);
        for index in 0..moved.len() {
            let mut one = moved.get(index);
            one.mean_m = reached(one.mean_m);
            moved.set(index, one);
        }
        assert!(
            render(SHADOWING, &moved_geometry, &moved, &[1.0; 600]) == near,
            "{far}"
        );
    }
}

/// In the map's own frame a kilometre from its origin f32 still resolves 0.06 mm.
#[test]
fn a_kilometre_from_the_maps_origin() {
    let (mut geometry, near) = sample::bench_scene(3);
    geometry.pose.position_m = Vec3::new(800.0, -600.0, 40.0);
    let bodies = (0..200).map(|index| {
        let mut one = near.get(index);
        one.mean_m += geometry.pose.position_m;
        one
    });
    assert_close("a kilometre away", BARE, &geometry, &of(bodies));
}

#[test]
fn the_polar_axis_and_the_sensor_itself_give_nothing() {
    let geometry = sample::geometry();
    let tiny = [0.0, 1e-30, 1e-9, 1e-3];
    let mut bodies = Vec::new();
    for &a in &tiny {
        for mean_m in [
            Vec3::new(a, a, 3.0),
            Vec3::new(a, 0.0, -3.0),
            Vec3::splat(a),
            Vec3::X * a,
        ] {
            bodies.push(Parameters { mean_m, ..plain() });
        }
    }
    let gaussians = of(bodies);
    let (intensity, gradients) = render(SHADOWING, &geometry, &gaussians, &[1.0; 600]);
    assert_eq!(intensity, [0.0; 600]);
    assert_eq!(gradients, GradientArrays::zeros(gaussians.len()));
}

#[test]
fn transmittance_through_1e5_gaussians_of_opacity_1e_minus_8() {
    let geometry = sample::geometry();
    let count = 100_000;
    let veil = |place: usize| Parameters {
        mean_m: Vec3::X * (3.0 + 3.0 * place as f32 / count as f32),
        log_scale: Vec3::new(0.01, 1.0, 0.05).map(f32::ln),
        opacity_logit: 1e-8f32.ln(),
        ..plain()
    };
    let target = Parameters {
        mean_m: Vec3::X * 8.0,
        ..plain()
    };
    let gaussians = of((0..count).map(veil).chain([target]));
    let mut renderer = OnlineRenderer::new(SHADOWING);
    renderer.forward(&geometry, &gaussians, &all(&gaussians));
    let found = renderer.rows().last().map(|row| row.transmittance).unwrap();
    let numbers = twin::numbers_of::<f64>(&gaussians);
    let cutoffs = twin::Cutoffs::default();
    let rows = twin::forward(&geometry, &numbers, &all(&gaussians), true, &cutoffs).rows;
    let expected = rows.last().unwrap().transmittance;
    assert!(expected < 0.9999 && expected > 0.999, "{expected}");
    // 6·10⁻⁸ is one f32 step below 1: the loss of 8·10⁻⁴ is right to a few of those.
    assert!(
        (f64::from(found) - expected).abs() < 4e-7,
        "{found} for {expected}"
    );
}

#[test]
fn transmittance_through_many_of_opacity_one_half() {
    let geometry = sample::geometry();
    let veil = |place: usize| Parameters {
        mean_m: Vec3::X * (3.0 + 0.005 * place as f32),
        log_scale: Vec3::new(0.01, 1.0, 1.0).map(f32::ln),
        ..plain()
    };
    let gaussians = of((0..400).map(veil));
    let mut renderer = OnlineRenderer::new(SHADOWING);
    renderer.forward(&geometry, &gaussians, &all(&gaussians));
    for pair in renderer.rows().windows(2) {
        assert!(pair[1].transmittance <= pair[0].transmittance);
    }
    assert!(renderer.rows()[5].transmittance > 0.01);
    assert!(renderer.rows()[399].transmittance < 1e-6);
    let loss = vec![1.0; 600];
    let mut gradients = GradientArrays::zeros(400);
    renderer.backward(&gaussians, &loss, &mut gradients);
    assert_finite(&gradients);
    assert_eq!(renderer.not_finite_count(), 0);
}

#[test]
fn backward_through_opacities_near_one() {
    let geometry = sample::geometry();
    for logit in [4.0, 6.0, 6.9, 12.0] {
        let wall = |place: usize| Parameters {
            mean_m: Vec3::new(4.0 + 0.3 * place as f32, 0.01, 0.1 + 0.02 * place as f32),
            log_scale: Vec3::new(0.02, 0.3, 0.2).map(f32::ln),
            opacity_logit: logit,
            ..plain()
        };
        let gaussians = of((0..3).map(wall));
        assert_close(
            &format!("opacity logit {logit}"),
            SHADOWING,
            &geometry,
            &gaussians,
        );
        assert!(gaussians.get(0).opacity() <= OPACITY_MAX);
    }
}

#[test]
fn what_ran_away_is_clamped_counted_and_finds_back() {
    let geometry = sample::geometry();
    let mut gaussians = of([
        Parameters {
            opacity_logit: 30.0,
            ..plain()
        },
        Parameters {
            opacity_logit: -30.0,
            ..plain()
        },
        Parameters {
            log_scale: Vec3::new(100.0, -3.0, -3.0),
            ..plain()
        },
        Parameters {
            rotation: Quat::from_xyzw(0.0, 0.0, 0.0, 0.0),
            ..plain()
        },
    ]);
    let (intensity, gradients) = render(BARE, &geometry, &gaussians, &[1.0; 600]);
    assert!(intensity.iter().all(|i| i.is_finite()));
    assert_finite(&gradients);
    let clamped = gaussians.clamp();
    let counts = [
        clamped.opacity_logits,
        clamped.log_scales,
        clamped.rotations_reset,
    ];
    assert_eq!(counts, [2, 1, 1]);
    assert!(gaussians.log_scale[0][2] <= LOG_SCALE_LIMITS[1]);

    // Sign descent on the energy's distance from half of one Gaussian's: logits that ran away come
    // back from the clamp.
    for logit in [12.0f32, -12.0] {
        let mut one = of([Parameters {
            opacity_logit: logit,
            ..plain()
        }]);
        let wanted = render(BARE, &geometry, &of([plain()]), &[]).0;
        for _ in 0..200 {
            let (found, _) = render(BARE, &geometry, &one, &[]);
            let loss: Vec<f32> = found.iter().zip(&wanted).map(|(f, w)| f - w).collect();
            let (_, gradients) = render(BARE, &geometry, &one, &loss);
            let slope = gradients.opacity_logit[0];
            assert!(slope != 0.0);
            one.opacity_logit[0] -= 0.1 * slope.signum();
        }
        assert!(
            one.opacity_logit[0].abs() < 0.2,
            "{logit}: {}",
            one.opacity_logit[0]
        );
    }
}

#[test]
fn a_millimetre_and_a_hundred_metres_together() {
    let geometry = sample::geometry();
    let mut dice = Dice::new(5);
    let mut bodies: Vec<Parameters> = (0..50)
        .map(|_| sample::in_view(&mut dice, 3.0, 10.0, [0.001, 0.0011]))
        .collect();
    for _ in 0..5 {
        let mut giant = sample::in_view(&mut dice, 4.0, 9.0, [100.0, 101.0]);
        giant.opacity_logit = -3.0;
        bodies.push(giant);
    }
    for options in [BARE, SHADOWING] {
        assert_close("1 mm and 100 m", options, &geometry, &of(bodies.clone()));
    }
}

#[test]
fn ten_thousand_in_one_place() {
    let geometry = sample::geometry();
    let faint = Parameters {
        opacity_logit: -8.0,
        ..plain()
    };
    let gaussians = of((0..10_000).map(|_| faint));
    for options in [BARE, SHADOWING] {
        assert_close("10⁴ coincident", options, &geometry, &gaussians);
    }
}

/// Nothing that is not finite, or is the largest or smallest finite number, gets out again.
#[test]
fn poison_in_any_parameter() {
    let geometry = sample::geometry();
    let poisons = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN,
        1e-42,
        -1e-42,
    ];
    let healthy = of([plain()]);
    let (alone, _) = render(SHADOWING, &geometry, &healthy, &[]);
    for options in [BARE, SHADOWING] {
        for poison in poisons {
            for number in 0..12 {
                let mut sick = plain().to_array();
                sick[number] = poison;
                let gaussians = of([plain(), Parameters::from_array(sick)]);
                let (intensity, gradients) = render(options, &geometry, &gaussians, &[1.0; 600]);
                assert!(
                    intensity.iter().all(|i| i.is_finite()),
                    "{poison} in {number}"
                );
                assert_finite(&gradients);
                if !poison.is_finite() {
                    assert_eq!(intensity, alone, "{poison} in {number}");
                }
            }
        }
    }
}

#[test]
fn poison_in_geometry_and_loss() {
    let (geometry, gaussians) = sample::bench_scene(1);
    for poison in [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        1e-42,
        0.0,
    ] {
        let geometries: [fn(&mut PingGeometry, f32); 11] = [
            |l, x| l.pose.position_m.y = x,
            |l, x| l.pose.axes.x_axis.z = x,
            |l, x| l.pose.drift_per_m.x = x,
            |l, x| l.pose.reference_range_m = x,
            |l, x| l.range_start_m = x,
            |l, x| l.bin_length_m = x,
            |l, x| l.range_variance_m2 = x,
            |l, x| l.azimuth_variance_rad2 = x,
            |l, x| l.beam.azimuth_width_deg = x,
            |l, x| l.beam.elevation_width_deg = x,
            |l, x| l.pose.axes.y_axis = Vec3::splat(x),
        ];
        for (which, set) in geometries.into_iter().enumerate() {
            let mut sick = geometry;
            set(&mut sick, poison);
            let (intensity, gradients) = render(SHADOWING, &sick, &gaussians, &[1.0; 600]);
            assert!(
                intensity.iter().all(|i| i.is_finite()),
                "{poison} in {which}"
            );
            assert_finite(&gradients);
        }
        let mut loss = vec![1.0; 600];
        loss[300] = poison;
        let (_, gradients) = render(SHADOWING, &geometry, &gaussians, &loss);
        assert_finite(&gradients);
    }
}
