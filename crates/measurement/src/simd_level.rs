//! Which vector instructions the kernels take: one level for the whole process.
//!
//! A level with fused multiply-add (AVX2, AVX-512, Neon) rounds `a·b + c` once, one without (SSE2,
//! SSE4.2, plain code) twice. What is worked out is the same to the last bit on all levels of one
//! kind, and differs in its last digits between the two.

use std::sync::OnceLock;

use fearless_simd::Level;
#[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
use fearless_simd::Simd;

static LEVEL: OnceLock<Level> = OnceLock::new();

/// A level that is not to be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LevelError {
    /// It is no level, or the processor lacks its instructions.
    #[error("there is no `{name}` on this processor; it has {}", available.join(", "))]
    Missing {
        /// As asked for.
        name: String,
        /// Best first.
        available: Vec<&'static str>,
    },
    /// Something has been worked out already.
    #[error("the level is {0} already and can be chosen only before the first use")]
    InUse(&'static str),
}

/// The level that all kernels take: the best that the processor has, or what [`hold_to`] said.
#[must_use]
pub fn level() -> Level {
    *LEVEL.get_or_init(Level::new)
}

/// Has all kernels take a level by its name, as in [`available`]. To be called before the first use.
///
/// # Errors
/// If the processor does not have it, or another is in use.
pub fn hold_to(name: &str) -> Result<(), LevelError> {
    let found = levels().into_iter().find(|&level| name_of(level) == name);
    let wanted = found.ok_or_else(|| LevelError::Missing {
        name: name.to_owned(),
        available: available(),
    })?;
    let taken = *LEVEL.get_or_init(|| wanted);
    match name_of(taken) == name {
        true => Ok(()),
        false => Err(LevelError::InUse(name_of(taken))),
    }
}

/// Names of the levels that this processor has, best first.
#[must_use]
pub fn available() -> Vec<&'static str> {
    levels().into_iter().map(name_of).collect()
}

/// `avx512`, `avx2`, `sse4.2`, `sse2`, `neon`, or `none` for plain code.
#[must_use]
pub fn name_of(level: Level) -> &'static str {
    match level {
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        Level::Avx512(_) => "avx512",
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        Level::Avx2(_) => "avx2",
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        Level::Sse4_2(_) => "sse4.2",
        #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
        Level::Sse2(_) => "sse2",
        #[cfg(target_arch = "aarch64")]
        Level::Neon(_) => "neon",
        _ => "none",
    }
}

/// Whether it multiplies and adds with one rounding.
#[must_use]
pub fn has_fused_multiply_add(level: Level) -> bool {
    matches!(name_of(level), "avx512" | "avx2" | "neon")
}

/// Those that this processor has, best first.
#[must_use]
pub fn levels() -> Vec<Level> {
    let best = Level::new();
    #[cfg(any(target_arch = "x86", target_arch = "x86_64"))]
    let lower = [
        best.as_avx2().map(Simd::level),
        best.as_sse4_2().map(Simd::level),
        best.as_sse2().map(Simd::level),
    ];
    #[cfg(not(any(target_arch = "x86", target_arch = "x86_64")))]
    let lower = [None::<Level>];
    let mut levels = vec![best];
    for level in lower.into_iter().flatten() {
        if levels.iter().all(|&had| name_of(had) != name_of(level)) {
            levels.push(level);
        }
    }
    levels
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_level_holds_for_the_process_and_a_wrong_name_says_which_there_are() {
        let names = available();
        assert_eq!(names[0], name_of(Level::new()));
        let error = hold_to("mmx").unwrap_err().to_string();
        assert!(
            error.contains("`mmx`") && error.contains(names[0]),
            "{error}"
        );
        let used = name_of(level());
        assert_eq!(hold_to(used), Ok(()));
        for other in names.into_iter().filter(|&name| name != used) {
            assert_eq!(hold_to(other), Err(LevelError::InUse(used)));
        }
    }
}
