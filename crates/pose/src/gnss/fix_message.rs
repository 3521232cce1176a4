//! Fixes as messages of ROS have them, judged.

use echosplat_georeference::{Datum, Fix, Place, sigma_of};
use echosplat_ros::{COVARIANCE_UNKNOWN, NavSatFix};

/// The fix in a message; `None` if its receiver says that it has none.
///
/// # Errors
/// In words, which number cannot be.
pub(super) fn fix_of(message: &NavSatFix) -> Result<Option<Fix>, String> {
    if message.status < 0 {
        return Ok(None);
    }
    let (latitude_deg, longitude_deg) = (message.latitude_deg, message.longitude_deg);
    if latitude_deg == 0.0 && longitude_deg == 0.0 {
        return Err(
            "NavSatFix: latitude and longitude are 0, as in a message that nobody filled in"
                .to_owned(),
        );
    }
    // NaN stands for no altitude.
    let altitude_m = message.altitude_m;
    let has_height = !altitude_m.is_nan();
    let height_m = if has_height { altitude_m } else { 0.0 };
    let place = Place::new(latitude_deg, longitude_deg, height_m)
        .map_err(|error| format!("NavSatFix: {error}"))?;
    let covariance = &message.covariance_m2;
    let is_known = message.covariance_type != COVARIANCE_UNKNOWN;
    let sigma_m = is_known.then(|| (0.5 * (covariance[0] + covariance[4])).sqrt());
    Ok(Some(Fix {
        time: message.stamp,
        place,
        datum: has_height.then_some(Datum::Ellipsoid),
        separation_m: None,
        sigma_m: sigma_of(sigma_m),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_georeference::USUAL_SIGMA_M;
    use echosplat_model::Timestamp;

    #[test]
    fn a_message_is_a_fix_no_fix_or_refused() {
        let mut covariance_m2 = [0.0; 9];
        (covariance_m2[0], covariance_m2[4]) = (0.3, 0.5);
        let message = NavSatFix {
            stamp: Timestamp::from_nanos(5),
            status: 2,
            latitude_deg: 60.17,
            longitude_deg: 24.94,
            altitude_m: 18.5,
            covariance_m2,
            covariance_type: 2,
        };
        let fix = fix_of(&message).unwrap().unwrap();
        assert!((fix.sigma_m - 0.4_f64.sqrt()).abs() < 1e-12);
        assert_eq!(
            (fix.datum, fix.place.height_m.to_bits()),
            (Some(Datum::Ellipsoid), 18.5_f64.to_bits())
        );
        let usual = |covariance_type, covariance_m2| {
            let fix = fix_of(&NavSatFix {
                covariance_type,
                covariance_m2,
                ..message
            });
            fix.unwrap().unwrap().sigma_m.to_bits() == USUAL_SIGMA_M.to_bits()
        };
        assert!(usual(COVARIANCE_UNKNOWN, covariance_m2));
        assert!(usual(3, [f64::NAN; 9]) && usual(1, [-4.0; 9]) && usual(1, [0.0; 9]));
        let level = fix_of(&NavSatFix {
            altitude_m: f64::NAN,
            ..message
        })
        .unwrap()
        .unwrap();
        assert_eq!((level.datum, level.place.height_m.to_bits()), (None, 0));
        assert_eq!(
            fix_of(&NavSatFix {
                status: -1,
                latitude_deg: 95.0,
                ..message
            }),
            Ok(None)
        );
        let said = |message: NavSatFix| fix_of(&message).unwrap_err();
        assert!(
            said(NavSatFix {
                latitude_deg: 95.0,
                ..message
            })
            .contains("latitude of 95 degrees")
        );
        assert!(
            said(NavSatFix {
                longitude_deg: f64::NAN,
                ..message
            })
            .contains("longitude of NaN")
        );
        assert!(
            said(NavSatFix {
                altitude_m: f64::INFINITY,
                ..message
            })
            .contains("height of inf")
        );
        assert!(
            said(NavSatFix {
                latitude_deg: 0.0,
                longitude_deg: 0.0,
                ..message
            })
            .contains("nobody filled in")
        );
    }
}
