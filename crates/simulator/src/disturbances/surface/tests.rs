use echosplat_model::Pose;

use super::*;
use crate::beam::{Fan, SideLobes};
use crate::random::{Purpose, Random};
use crate::scene::Scene;
use crate::sonar::{MovingSensor, Radiometry};

const RADIUS_M: f64 = 0.05;

/// Direct, once and twice by the surface: mean range and total power of a ball's echo.
struct Ways {
    range_m: [f64; 3],
    power: [f64; 3],
}

fn ways(surface: WaterSurface, ball: DVec3, roll_deg: f64, more: &str) -> Ways {
    let [x, y, z] = ball.to_array();
    let text = format!(
        "name = \"t\"\n[[sphere]]\ncenter_m = [{x}, {y}, {z}]\nradius_m = {RADIUS_M}\n{more}"
    );
    let scene = Scene::parse(&text, None).unwrap();
    let pose = Pose::from_yaw_pitch_roll(0.0, 0.0, roll_deg.to_radians(), DVec3::ZERO);
    let (sensor, fan) = (
        MovingSensor::new(12.0, |_| pose),
        Fan::new(SideLobes::Without),
    );
    let listener = Listener {
        scene: &scene,
        sensor: &sensor,
        fan: &fan,
        radiometry: Radiometry::Even,
    };
    let (mut power, mut moment) = ([0.0; 3], [0.0; 3]);
    let mut count = |way: usize, middle_m: f64, of_way: f64| {
        power[way] += of_way;
        moment[way] += of_way * middle_m;
    };
    for index in 0..40 {
        let mut random = Random::new(1, Purpose::Rays, index);
        listener.for_each_echo(20.0, &mut random, |echo| {
            if echo.hit.position.distance(ball) > 1.01 * RADIUS_M {
                return;
            }
            count(0, echo.hit.distance_m, echo.power(Radiometry::Even));
            if let Some([once, twice]) = surface.images(&listener, echo) {
                count(1, once.middle_m, once.power);
                count(2, twice.middle_m, twice.power);
            }
        });
    }
    Ways {
        range_m: [0, 1, 2].map(|way| moment[way] / power[way]),
        power,
    }
}

fn surface(height_m: f64, beyond_beam_db: f64) -> WaterSurface {
    WaterSurface {
        height_m,
        beyond_beam_db,
        ..WaterSurface::default()
    }
}

#[test]
fn images_arrive_at_the_ranges_of_their_ways() {
    // 5 m ahead and 1 m down, the surface 2 m up: the image lies at z = 5, √50 m away.
    let ways = ways(surface(2.0, 13.0), DVec3::new(5.0, 0.0, -1.0), 0.0, "");
    let (direct_m, image_m) = (26f64.sqrt(), 50f64.sqrt());
    for (way, expected_m) in [direct_m, 0.5 * (direct_m + image_m), image_m]
        .iter()
        .enumerate()
    {
        let short_m = expected_m - ways.range_m[way];
        // A ball's echo comes from before its middle, by its radius at most.
        assert!(
            (0.4 * RADIUS_M..RADIUS_M).contains(&short_m),
            "{way}: {short_m}"
        );
    }
}

#[test]
fn an_image_in_the_beam_has_the_power_of_its_ways_and_losses() {
    // So far away that all ways leave the ball by nearly the same side.
    let flat = WaterSurface {
        loss_db: 3.0,
        ..surface(0.6, 100.0)
    };
    let ways = ways(flat, DVec3::new(9.0, 0.0, -0.3), 0.0, "");
    let image = DVec3::new(9.0, 0.0, 1.5);
    let area = ways.power[0] * ways.range_m[0].powi(2);
    let loss = 10f64.powf(-0.3);
    // Both ways round add in amplitude: four times the power of one.
    let once = 4.0 * loss * area / (9.005 * image.length());
    let twice = loss * loss * area / image.length_squared();
    assert!(
        (ways.power[1] / once - 1.0).abs() < 0.1,
        "{}",
        ways.power[1] / once
    );
    assert!(
        (ways.power[2] / twice - 1.0).abs() < 0.1,
        "{}",
        ways.power[2] / twice
    );
}

#[test]
fn beyond_the_beam_an_image_has_what_is_left_there() {
    let ball = DVec3::new(5.0, 0.0, 0.0);
    // Rolled by 10° the image, 39° up, lies beside a beam of 0.8°.
    let heard = |beyond_db: f64| ways(surface(2.0, beyond_db), ball, 10.0, "").power;
    let (loud, soft) = (heard(13.0), heard(33.0));
    assert!((loud[0] / soft[0] - 1.0).abs() < 1e-12);
    assert!((10.0 * (loud[1] / soft[1]).log10() - 20.0).abs() < 1e-6);
    assert!((10.0 * (loud[2] / soft[2]).log10() - 40.0).abs() < 1e-6);
    // Sensitive by 13 dB less one way, twice the amplitude, 3 dB lost, and further away.
    let weaker_db = 10.0 * (loud[1] / loud[0]).log10();
    assert!((-13.0..-9.0).contains(&weaker_db), "{weaker_db}");
}

#[test]
fn what_the_surface_does_not_show_has_no_image() {
    let ball = DVec3::new(5.0, 0.0, 0.0);
    let images =
        |height_m: f64, more: &str| ways(surface(height_m, 13.0), ball, 0.0, more).power[1];
    assert!(images(2.0, "") > 0.0);
    // A lid over the ball, a lid over the sensor, and a surface below both.
    let lid = |x: f64| format!("[[box]]\ncenter_m = [{x}, 0, 1]\nsize_m = [1.6, 3, 0.1]");
    assert!(images(2.0, &lid(4.4)) <= 0.0);
    assert!(images(2.0, &lid(0.9)) <= 0.0);
    assert!(images(-1.0, "") <= 0.0);
    assert!(images(f64::INFINITY, "").to_bits() == 0);
}
