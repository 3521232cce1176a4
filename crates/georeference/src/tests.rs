//! Against PROJ 9.5.1 (pyproj 3.7.2), and there and back.

use echosplat_model::glam::{DVec2, DVec3};

use crate::{Crs, CrsError, Datum, Georeference, Place, Tie, TieError, parse_origin, solve};

struct Known {
    place: (f64, f64, f64),
    /// `+proj=cart`.
    from_middle_m: (f64, f64, f64),
    /// The place 120 m east, 340 m south and 7 m below, by `+proj=topocentric`.
    moved: (f64, f64, f64),
    code: u16,
    projected: (f64, f64),
    convergence_deg: f64,
    scale: f64,
}

/// Helsinki, Sydney, both sides of the antimeridian, and near the pole.
const KNOWN: [Known; 5] = [
    Known {
        place: (60.17, 24.94, 12.5),
        from_middle_m: (
            2_884_093.794_607_624_4,
            1_341_199.876_282_671_5,
            5_509_933.796_797_178,
        ),
        moved: (60.166_948_335_278, 24.942_161_435_087, 5.510_180_427_693),
        code: 32635,
        projected: (385_700.421_386, 6_672_126.743_134),
        convergence_deg: -1.787_252_019_174,
        scale: 0.999_760_097_885,
    },
    Known {
        place: (-33.86, 151.21, -8.25),
        from_middle_m: (
            -4_646_553.137_824_353,
            2_553_408.227_404_137_6,
            -3_533_557.281_964_661,
        ),
        moved: (
            -33.863_065_275_909,
            151.211_296_841_048,
            -15.239_777_438_343,
        ),
        code: 32756,
        projected: (334_416.393_990, 6_251_925.360_352),
        convergence_deg: 0.997_553_194_165,
        scale: 0.999_938_006_170,
    },
    Known {
        place: (-16.79, 179.9999, 3.0),
        from_middle_m: (
            -6_107_945.616_286_782,
            10.660_376_153_206_284,
            -1_830_597.057_863_149,
        ),
        moved: (
            -16.793_072_278_569,
            -179.998_974_316_820,
            -3.989_755_816_758,
        ),
        code: 32760,
        projected: (819_795.120_386, 8_141_256.027_860),
        convergence_deg: -0.867_305_258_036,
        scale: 1.000_864_806_595,
    },
    Known {
        place: (-16.79, -179.9999, 3.0),
        from_middle_m: (
            -6_107_945.616_286_782,
            -10.660_376_153_206_284,
            -1_830_597.057_863_149,
        ),
        moved: (
            -16.793_072_278_569,
            -179.998_774_316_820,
            -3.989_755_814_895,
        ),
        code: 32701,
        projected: (180_204.879_614, 8_141_256.027_860),
        convergence_deg: 0.867_305_258_045,
        scale: 1.000_864_806_597,
    },
    Known {
        place: (89.5, 33.0, 0.0),
        from_middle_m: (
            46_836.620_143_314_46,
            30_416.056_760_775_886,
            6_356_508.637_423_159,
        ),
        moved: (89.496_954_815_499, 33.122_369_620_914, -6.989_843_087_271),
        code: 5041,
        projected: (2_030_234.136_032, 1_953_443.513_214),
        convergence_deg: 33.0,
        scale: 0.994_018_924_546,
    },
];

fn place((latitude_deg, longitude_deg, height_m): (f64, f64, f64)) -> Place {
    Place::new(latitude_deg, longitude_deg, height_m).unwrap()
}

fn apart_m(a: &Place, b: &Place) -> f64 {
    a.from_middle_m().distance(b.from_middle_m())
}

#[test]
fn places_are_where_proj_has_them() {
    for known in KNOWN {
        let at = place(known.place);
        assert!(at.from_middle_m().distance(known.from_middle_m.into()) < 1e-6);
        assert!(apart_m(&Place::at(at.from_middle_m()), &at) < 1e-6);
        let reference = Georeference::at_origin(at, Datum::Ellipsoid, "test");
        let moved = reference.place_of(DVec3::new(120.0, -340.0, -7.0));
        assert!(apart_m(&moved, &place(known.moved)) < 1e-5, "{moved:?}");
        assert!((moved.height_m - known.moved.2).abs() < 1e-5, "{moved:?}");
    }
}

#[test]
fn the_zone_of_a_place_has_the_coordinates_that_proj_gives() {
    for known in KNOWN {
        let at = place(known.place);
        let crs = Crs::utm_of(&at).unwrap();
        assert_eq!(crs.code(), known.code);
        let projected = crs.project(&at).unwrap();
        let off_m = projected.distance(DVec2::from(known.projected));
        assert!(off_m < 2e-6, "{crs}: {off_m}");
        let back = crs.unproject(projected, at.height_m).unwrap();
        assert!(apart_m(&back, &at) < 1e-6, "{crs}");
        let grid = crs.grid(&at).unwrap();
        let off_deg = (grid.convergence_deg - known.convergence_deg).abs();
        assert!(off_deg < 1e-3, "{crs}: {grid:?}");
        assert!((grid.scale - known.scale).abs() < 1e-6, "{crs}: {grid:?}");
    }
}

#[test]
fn norway_has_zones_of_its_own() {
    let zone = |latitude, longitude| Crs::utm_of(&place((latitude, longitude, 0.0))).unwrap();
    assert_eq!(zone(60.4, 5.3).code(), 32632);
    assert_eq!(zone(78.2, 15.6).code(), 32633);
    assert_eq!(zone(0.0, 180.0).code(), 32601);
    assert_eq!(zone(-0.1, -180.0).code(), 32701);
}

#[test]
fn a_world_goes_to_earth_and_back() {
    for heading in [0.0, 37.5, 90.0, 213.0] {
        for known in KNOWN {
            let reference = Georeference {
                anchor_m: DVec3::new(500_000.0, -20.0, 3.0),
                x_heading_deg: heading,
                ..Georeference::at_origin(place(known.place), Datum::Surface, "test")
            };
            for offset_m in [DVec3::ZERO, DVec3::new(900.0, -1_400.0, -30.0)] {
                let world_m = reference.anchor_m + offset_m;
                let back_m = reference.world_of(&reference.place_of(world_m));
                assert!(back_m.distance(world_m) < 1e-6, "{heading}");
            }
            let read = Georeference::parse(&reference.line()).unwrap();
            assert_eq!(read, reference);
        }
    }
}

#[test]
fn the_heading_is_that_of_x() {
    let origin = place((60.0, 25.0, 0.0));
    let north_east = |heading: f64| {
        let reference = Georeference {
            x_heading_deg: heading,
            ..Georeference::at_origin(origin, Datum::Surface, "")
        };
        let enu_m = origin.enu_of(&reference.place_of(DVec3::X * 100.0));
        (enu_m.y.round() as i32, enu_m.x.round() as i32)
    };
    assert_eq!(north_east(0.0), (100, 0));
    assert_eq!(north_east(90.0), (0, 100));
    assert_eq!(north_east(180.0), (-100, 0));
}

/// Ties of a georeference, each moved by so much east.
fn ties(of: &Georeference, world_m: &[[f64; 3]], east_m: &[f64]) -> Vec<Tie> {
    let tie = |(world_m, east_m): (&[f64; 3], &f64)| {
        let world_m = DVec3::from_array(*world_m);
        let place = of.place_of(world_m).moved(DVec3::X * *east_m);
        Tie { world_m, place }
    };
    world_m.iter().zip(east_m).map(tie).collect()
}

const CORNERS_M: [[f64; 3]; 4] = [
    [0.0, 0.0, -2.0],
    [800.0, 10.0, -8.0],
    [790.0, 650.0, -5.0],
    [-20.0, 600.0, -3.0],
];

#[test]
fn ties_find_place_and_heading() {
    let truth = Georeference {
        x_heading_deg: 213.25,
        ..Georeference::at_origin(place((-16.79, 179.9995, 0.0)), Datum::Surface, "")
    };
    let found = solve(&ties(&truth, &CORNERS_M, &[0.0; 4]), 90.0).unwrap();
    assert!((found.georeference.x_heading_deg - 213.25).abs() < 2e-3);
    assert!(found.heading_sigma_deg.unwrap() < 1e-2);
    for corner in CORNERS_M {
        let corner = corner.into();
        let (told, true_place) = (found.georeference.place_of(corner), truth.place_of(corner));
        assert!(apart_m(&told, &true_place) < 0.06);
    }
    // One alone is where it is said to be.
    let one = solve(&ties(&truth, &CORNERS_M[1..2], &[0.0]), 213.25).unwrap();
    let corner = CORNERS_M[1].into();
    assert!(apart_m(&one.georeference.place_of(corner), &truth.place_of(corner)) < 1e-6);
    assert_eq!(one.heading_sigma_deg, None);
}

#[test]
fn residuals_tell_of_a_tie_that_does_not_fit() {
    let truth = Georeference::at_origin(place((60.0, 25.0, 0.0)), Datum::Surface, "");
    let found = solve(&ties(&truth, &CORNERS_M, &[0.0, 0.0, 0.0, 4.0]), 90.0).unwrap();
    let lengths = found.residuals.iter().map(|r| r.enu_m.length());
    let lengths: Vec<f64> = lengths.collect();
    assert!(lengths[3] > 1.5 && lengths[3] >= lengths[0], "{lengths:?}");
}

#[test]
fn ties_that_tell_nothing_are_refused() {
    let truth = Georeference::at_origin(place((60.0, 25.0, 0.0)), Datum::Surface, "");
    assert_eq!(solve(&[], 90.0), Err(TieError::None));
    let line = [[0.0, 0.0, 0.0], [10.0, 5.0, -1.0], [20.0, 10.0, 0.0]];
    assert_eq!(
        solve(&ties(&truth, &line, &[0.0; 3]), 90.0),
        Err(TieError::Line)
    );
    let near = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]];
    let said = solve(&ties(&truth, &near, &[0.0; 3]), 90.0);
    assert!(matches!(said, Err(TieError::Near(_))));
    let mut swapped = ties(&truth, &CORNERS_M, &[0.0; 4]);
    for tie in &mut swapped {
        tie.world_m *= 3.28;
    }
    assert!(matches!(solve(&swapped, 90.0), Err(TieError::Scale { .. })));
}

#[test]
fn what_is_no_place_or_system_is_said() {
    let said = |text: &str| parse_origin(text).unwrap_err();
    assert!(said("95,20,0").contains("latitude of 95"));
    assert!(said("60,200,0").contains("longitude of 200"));
    assert!(said("60,20").contains("three numbers"));
    assert!(said("60,20,inf").contains("three numbers"));
    assert!(said("60,20,90000").contains("height of 90000"));
    let said = |text: &str| Crs::parse(text).unwrap_err().to_string();
    assert!(said("EPSG:99999").contains("EPSG:99999 is not known"));
    assert!(said("EPSG:63000").contains("EPSG:63000 is not known"));
    assert!(said("utm").contains("EPSG:CODE"));
    assert_eq!(Crs::parse("epsg:32635").unwrap().code(), 32635);
    assert!(
        Tie::parse("1,2=60,25,3")
            .unwrap_err()
            .contains("a tie reads")
    );
    assert!(
        Tie::parse("1,2,3=95,25,3")
            .unwrap_err()
            .contains("latitude of 95")
    );
    let tie = Tie::parse("1,-2,3 = 60, 25, 3.5").unwrap();
    assert!((tie.place.height_m + 3.5).abs() < 1e-12);
    for line in ["", "wgs84 95 20 0 surface x_heading 90 anchor 0 0 0 from x"] {
        assert!(Georeference::parse(line).is_err());
    }
}

#[test]
fn a_projection_refuses_what_it_cannot_show() {
    let pole = place((90.0, 0.0, 0.0));
    let crs = Crs::of_code(3857);
    match crs {
        Ok(crs) => assert!(matches!(crs.project(&pole), Err(CrsError::Outside { .. }))),
        Err(error) => assert_eq!(error, CrsError::Unknown { code: 3857 }),
    }
}

/// By the register's parameters, against PROJ 9.5.1: national grids of three kinds of projection, and one in feet.
#[cfg(feature = "epsg")]
#[test]
fn other_codes_are_where_proj_has_them() {
    for (code, latitude, longitude, x, y) in epsg::KNOWN {
        let crs = Crs::of_code(code).unwrap();
        let found = crs.project(&place((latitude, longitude, 0.0))).unwrap();
        assert!(found.distance(DVec2::new(x, y)) < 0.01, "{crs}: {found}");
    }
    let geocentric = Crs::of_code(4978).unwrap_err();
    assert!(matches!(geocentric, CrsError::Unusable { .. }));
}

#[cfg(feature = "epsg")]
mod epsg {
    pub(super) const KNOWN: [(u16, f64, f64, f64, f64); 5] = [
        (2154, 48.85, 2.35, 652_301.564_831, 6_861_302.725_900),
        (3006, 59.33, 18.06, 674_079.256_577, 6_580_798.387_244),
        (3577, -33.86, 151.21, 1_761_192.240_581, -3_827_788.631_997),
        (2263, 40.7, -74.0, 984_250.0, 194_305.338_941),
        (3067, 60.17, 24.94, 385_700.421_385, 6_672_126.743_011),
    ];
}
