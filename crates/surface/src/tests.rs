use std::collections::HashMap;

use echosplat_model::glam::{Quat, Vec3};
use echosplat_model::{MAX_PLACE_M, Unsound};

use super::*;

const SPACING_M: f32 = 0.025;

fn gaussian(mean_m: Vec3) -> Gaussian {
    Gaussian {
        id: 7,
        mean_m,
        rotation: Quat::IDENTITY,
        scale_m: Vec3::splat(0.03),
        opacity: 0.1,
        reflectivity: 0.01,
        sigma_m: 0.1,
        position_covariance_m2: Gaussian::known_alike_m2(0.1),
        probability: 1.0,
        standing: Standing::Confident,
        why: echosplat_model::Why::default(),
    }
}

/// Between −1 and 1, the same for the same number.
fn jitter(number: u32) -> f32 {
    let mixed = number.wrapping_mul(0x9E37_79B9).rotate_left(15) ^ number;
    mixed.wrapping_mul(0x85EB_CA6B) as f32 / u32::MAX as f32 * 2.0 - 1.0
}

/// A sheet of `size_m` by `size_m` across y, around `middle_m`, with places scattered by a centimetre.
fn sheet(middle_m: Vec3, size_m: f32) -> Vec<Gaussian> {
    let side = (size_m / SPACING_M) as u32;
    let at = |index: u32| (index as f32 + 0.5) * SPACING_M - 0.5 * size_m;
    let places = (0..side * side).map(|number| {
        let noise = 0.01 * [0, 1, 2].map(|axis| jitter(3 * number + axis)).into_vec();
        middle_m + Vec3::new(at(number % side), 0.0, at(number / side)) + noise
    });
    places.map(gaussian).collect()
}

trait IntoVec {
    fn into_vec(self) -> Vec3;
}

impl IntoVec for [f32; 3] {
    fn into_vec(self) -> Vec3 {
        Vec3::from_array(self)
    }
}

fn surface(gaussians: &[Gaussian]) -> Surface {
    surface_of(gaussians, CELL_M).unwrap()
}

/// Area times unit normal.
fn facing_m2(surface: &Surface, triangle: [u32; 3]) -> Vec3 {
    let [a, b, c] = triangle.map(|number| surface.vertices[number as usize].position_m);
    0.5 * (b - a).cross(c - a)
}

fn area_m2(surface: &Surface) -> f32 {
    let triangles = surface.triangles.iter();
    triangles.map(|t| facing_m2(surface, *t).length()).sum()
}

/// Area of the triangles that face `towards`, less that of those that face away.
fn front_area_m2(surface: &Surface, towards: Vec3) -> f32 {
    let facing = surface.triangles.iter().map(|t| facing_m2(surface, *t));
    facing
        .map(|m2| m2.length() * m2.dot(towards).signum())
        .sum()
}

/// How many sheets hang together by edges.
fn sheet_count(surface: &Surface) -> usize {
    let mut root: Vec<usize> = (0..surface.vertices.len()).collect();
    fn find(root: &mut [usize], mut at: usize) -> usize {
        while root[at] != at {
            root[at] = root[root[at]];
            at = root[at];
        }
        at
    }
    for triangle in &surface.triangles {
        let first = find(&mut root, triangle[0] as usize);
        for other in &triangle[1..] {
            let other = find(&mut root, *other as usize);
            root[other] = first;
        }
    }
    (0..root.len()).filter(|&at| root[at] == at).count()
}

#[test]
fn nothing_and_a_few_make_no_surface() {
    assert_eq!(surface(&[]), Surface::default());
    assert_eq!(surface(&[gaussian(Vec3::X)]), Surface::default());
    let same = vec![gaussian(Vec3::X); 1000];
    assert_eq!(surface(&same), Surface::default());
    let mut ambiguous = sheet(Vec3::ZERO, 1.0);
    for gaussian in &mut ambiguous {
        gaussian.standing = Standing::Ambiguous;
    }
    assert_eq!(surface(&ambiguous), Surface::default());
    let mut unlikely = sheet(Vec3::ZERO, 1.0);
    for gaussian in &mut unlikely {
        gaussian.probability = 0.4;
    }
    assert_eq!(surface(&unlikely), Surface::default());
}

#[test]
fn a_few_far_from_all_others_span_nothing() {
    let mut gaussians = sheet(Vec3::ZERO, 1.0);
    let whole_m2 = area_m2(&surface(&gaussians));
    let lone = [[0.0, 0.12, 0.76], [0.05, 0.18, 0.8], [0.0, 0.24, 0.84]];
    gaussians.extend(lone.map(|place| gaussian(place.into_vec())));
    let with_lone_m2 = area_m2(&surface(&gaussians));
    assert!(
        (with_lone_m2 - whole_m2).abs() < 0.002,
        "{with_lone_m2} {whole_m2}"
    );
    // Wide ones are neighbours at that distance.
    for gaussian in gaussians.iter_mut().rev().take(3) {
        gaussian.scale_m = Vec3::splat(0.3);
    }
    let spanned_m2 = area_m2(&surface(&gaussians));
    assert!(spanned_m2 > whole_m2 + 0.05, "{spanned_m2} {whole_m2}");
}

#[test]
fn a_plane_gives_one_plane_that_ends_where_it_ends() {
    let surface = surface(&sheet(Vec3::new(3.0, -2.0, 1.0), 2.0));
    assert_eq!(sheet_count(&surface), 1);
    assert!(
        (area_m2(&surface) / 4.0 - 1.0).abs() < 0.05,
        "{}",
        area_m2(&surface)
    );
    for vertex in &surface.vertices {
        let offset_m = vertex.position_m - Vec3::new(3.0, -2.0, 1.0);
        assert!(offset_m.y.abs() < 0.01, "{offset_m}");
        assert!(offset_m.abs().max_element() < 1.0 + CELL_M, "{offset_m}");
        assert!((vertex.sigma_m - 0.1).abs() < 1e-4);
        assert!(vertex.normal.y.abs() > 0.8, "{}", vertex.normal);
    }
    let front_m2 = front_area_m2(&surface, Vec3::Y).abs();
    assert!(front_m2 > 0.999 * area_m2(&surface), "{front_m2}");
}

#[test]
fn a_level_floor_has_its_front_up() {
    let mut floor = sheet(Vec3::ZERO, 1.0);
    for gaussian in &mut floor {
        gaussian.mean_m = Vec3::new(gaussian.mean_m.x, gaussian.mean_m.z, gaussian.mean_m.y);
    }
    let surface = surface(&floor);
    assert!(!surface.triangles.is_empty());
    assert!(front_area_m2(&surface, Vec3::Z) > 0.99 * area_m2(&surface));
    assert!(surface.vertices.iter().all(|vertex| vertex.normal.z > 0.8));
}

#[test]
fn two_sheets_0_3_m_apart_stay_two() {
    let gap_m = 0.3;
    let both = [sheet(Vec3::ZERO, 1.0), sheet(Vec3::Y * gap_m, 1.0)].concat();
    let surface = surface(&both);
    assert_eq!(sheet_count(&surface), 2);
    for vertex in &surface.vertices {
        let y = vertex.position_m.y;
        assert!(y.abs() < 0.01 || (y - gap_m).abs() < 0.01, "{y}");
    }
    assert!((area_m2(&surface) / 2.0 - 1.0).abs() < 0.08);
}

#[test]
fn where_nothing_was_lit_it_is_open() {
    let mut holed = sheet(Vec3::ZERO, 2.0);
    holed.retain(|gaussian| gaussian.mean_m.length() > 0.3);
    let surface = surface(&holed);
    let nearest_m = surface.vertices.iter().map(|v| v.position_m.length());
    let nearest_m = nearest_m.fold(f32::INFINITY, f32::min);
    assert!(nearest_m > 0.3 - CELL_M, "{nearest_m}");
    let expected_m2 = 4.0 - std::f32::consts::PI * 0.3 * 0.3;
    assert!((area_m2(&surface) / expected_m2 - 1.0).abs() < 0.05);
}

#[test]
fn a_sparse_floor_is_closed_too() {
    let mut floor = sheet(Vec3::ZERO, 1.0);
    for gaussian in &mut floor {
        gaussian.mean_m *= 10.0;
        gaussian.mean_m.y *= 0.1;
        gaussian.scale_m = Vec3::new(0.1, 0.02, 0.1);
    }
    let surface = surface(&floor);
    assert_eq!(sheet_count(&surface), 1);
    assert!(
        (area_m2(&surface) / 100.0 - 1.0).abs() < 0.1,
        "{}",
        area_m2(&surface)
    );
}

#[test]
fn a_pile_is_closed_around_and_faces_outward() {
    let radius_m = 0.3;
    let turn = std::f32::consts::TAU / 76.0;
    let places = (0..76 * 60).map(|number| {
        let (sin, cos) = ((number % 76) as f32 * turn).sin_cos();
        let noise = 0.01 * [0, 1, 2].map(|axis| jitter(3 * number + axis)).into_vec();
        let height_m = (number / 76) as f32 * SPACING_M;
        Vec3::new(radius_m * cos, radius_m * sin, height_m) + noise
    });
    let surface = surface(&places.map(gaussian).collect::<Vec<_>>());
    assert_eq!(sheet_count(&surface), 1);
    for triangle in &surface.triangles {
        let corner_m = surface.vertices[triangle[0] as usize].position_m;
        let outward = facing_m2(&surface, *triangle).dot(corner_m.with_z(0.0));
        assert!(outward > 0.0);
        let off_m = corner_m.truncate().length() - radius_m;
        assert!(off_m.abs() < 0.015, "{off_m}");
    }
    let mut uses: HashMap<(u32, u32), u32> = HashMap::new();
    for [a, b, c] in &surface.triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *uses.entry((*from.min(to), *from.max(to))).or_default() += 1;
        }
    }
    for ((a, _), _) in uses.into_iter().filter(|(_, count)| *count == 1) {
        let height_m = surface.vertices[a as usize].position_m.z;
        assert!(!(0.1..1.4).contains(&height_m), "open at {height_m} m");
    }
}

#[test]
fn order_changes_nothing_and_distance_little() {
    let near = sheet(Vec3::ZERO, 1.0);
    let mut backwards = near.clone();
    backwards.reverse();
    assert_eq!(surface(&near), surface(&backwards));
    let far = surface(&sheet(Vec3::splat(9_000.0), 1.0));
    assert_eq!(sheet_count(&far), 1);
    let flat = |vertex: &Vertex| (vertex.position_m.y - 9_000.0).abs() < 0.012;
    assert!(far.vertices.iter().all(flat));
    // As far as a Gaussian may be, where single precision rounds to a centimetre.
    let furthest = surface(&sheet(Vec3::splat(MAX_PLACE_M - 10.0), 1.0));
    assert!(!furthest.triangles.is_empty());
}

#[test]
fn what_is_unknown_stays_unknown() {
    let mut some = sheet(Vec3::ZERO, 1.0);
    for gaussian in some.iter_mut().filter(|gaussian| gaussian.mean_m.x > 0.0) {
        gaussian.sigma_m = f32::INFINITY;
    }
    for vertex in surface(&some).vertices {
        match vertex.position_m.x {
            0.1.. => assert!(vertex.sigma_m.is_infinite()),
            ..-0.15 => assert!((vertex.sigma_m - 0.1).abs() < 1e-3, "{vertex:?}"),
            _ => {}
        }
    }
}

#[test]
fn absurd_maps_are_refused_by_name() {
    let refused = |change: fn(&mut Gaussian)| {
        let mut map = sheet(Vec3::ZERO, 0.5);
        change(&mut map[3]);
        surface_of(&map, CELL_M).unwrap_err()
    };
    let unsound = |why| SurfaceError::Unsound { id: 7, why };
    let (place, sigma) = (unsound(Unsound::Place), unsound(Unsound::Sigma));
    assert_eq!(refused(|g| g.mean_m.x = f32::NAN), place);
    assert_eq!(refused(|g| g.mean_m.x = f32::INFINITY), place);
    assert_eq!(refused(|g| g.mean_m.z = -1e30), place);
    assert_eq!(refused(|g| g.sigma_m = f32::NAN), sigma);
    assert_eq!(refused(|g| g.sigma_m = -1.0), sigma);
    assert_eq!(refused(|g| g.scale_m.y = 0.0), unsound(Unsound::Scale));
    assert!(place.to_string().contains("100000 m"), "{place}");
    for cell_m in [f32::NAN, 0.0, -1.0, 1e-9, f32::INFINITY] {
        let error = surface_of(&[], cell_m).unwrap_err();
        assert!(error.to_string().contains("0.005 to 5 m"), "{error}");
    }
}

/// Handfuls all over the sea take blocks each, which are counted before any is made.
#[test]
fn memory_is_bounded() {
    let handful = |number: u32| {
        let at = |shift: u32| ((number >> shift) % 64) as f32 * 300.0 - 9_600.0;
        let middle_m = Vec3::new(at(0), at(6), at(12));
        let arm = |axis: usize| Vec3::AXES[axis] * 0.16;
        [0, 1, 2].into_iter().flat_map(move |axis| {
            [-1.0, -0.5, 0.5, 1.0].map(|along| gaussian(middle_m + along * arm(axis)))
        })
    };
    let map: Vec<Gaussian> = (0..64 * 64 * 4).flat_map(handful).collect();
    let error = surface_of(&map, CELL_M).unwrap_err();
    assert_eq!(error, SurfaceError::Large { cell_m: CELL_M });
    assert!(surface_of(&map[..1200], CELL_M).is_ok());
}
