//! What a figure was measured with.

use serde::Serialize;

use echosplat_service::arguments::COMMIT;
use echosplat_service::processor;

/// The machine and this program.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Machine {
    /// The processor's own name.
    processor: String,
    /// Threads it runs at once.
    cores: usize,
    /// Vector instructions that the kernels take.
    simd: String,
    /// Of this program.
    version: &'static str,
    /// Of this program's source.
    commit: &'static str,
}

impl Machine {
    pub(super) fn this() -> Self {
        Self {
            processor: processor::model_name(),
            cores: processor::core_count(),
            simd: simd_level().to_owned(),
            version: env!("CARGO_PKG_VERSION"),
            commit: COMMIT,
        }
    }

    pub(super) fn facts(&self) -> Vec<(String, String)> {
        let fact = |name: &str, value: String| (name.to_owned(), value);
        vec![
            fact("processor", format!("{} × {}", self.cores, self.processor)),
            fact("vector instructions", self.simd.clone()),
            fact("version", self.version.to_owned()),
            fact("commit", self.commit.to_owned()),
        ]
    }
}

#[cfg(target_arch = "x86_64")]
fn simd_level() -> &'static str {
    match () {
        () if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") => "avx2",
        () if is_x86_feature_detected!("sse4.2") => "sse4.2",
        () => "sse2",
    }
}

#[cfg(target_arch = "aarch64")]
fn simd_level() -> &'static str {
    "neon"
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn simd_level() -> &'static str {
    "none"
}
