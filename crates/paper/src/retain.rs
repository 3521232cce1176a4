//! Arrays of a Gaussian each, thinned together.

/// Keeps the values whose place in `keep` is true.
pub(crate) fn retain<T>(values: &mut Vec<T>, keep: &[bool]) {
    let mut keep = keep.iter();
    values.retain(|_| *keep.next().unwrap_or(&false));
}
