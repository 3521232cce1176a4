//! Three numbers at a time, for the twins.

use crate::Real;

pub(super) fn dot<R: Real>(a: [R; 3], b: [R; 3]) -> R {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn sum<R: Real>(a: [R; 3]) -> R {
    a[0] + a[1] + a[2]
}

pub(super) fn length<R: Real>(a: [R; 3]) -> R {
    dot(a, a).sqrt()
}

pub(super) fn unit<R: Real>(a: [R; 3]) -> [R; 3] {
    let length = length(a);
    a.map(|part| part / length)
}

pub(super) fn cross<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Component by component.
pub(super) fn scaled<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

/// `v` turned by the inverse of the unit quaternion x y z w: `v − 2w(q×v) + 2q×(q×v)`.
pub(super) fn rotated_back<R: Real>([x, y, z, w]: [R; 4], v: [R; 3]) -> [R; 3] {
    let axis = [x, y, z];
    let once = cross(axis, v);
    let twice = cross(axis, once);
    let two = R::of(2.0);
    [0, 1, 2].map(|k| v[k] + two * (twice[k] - w * once[k]))
}
