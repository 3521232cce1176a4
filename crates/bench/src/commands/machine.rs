//! What a figure was measured with.

use serde::Serialize;

use echosplat_service::arguments::COMMIT;
use echosplat_service::{processor, simd};

/// The machine and this program.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Machine {
    /// The processor's own name.
    pub(super) processor: String,
    /// Threads it runs at once.
    pub(super) cores: usize,
    /// Vector instructions that the kernels take.
    simd: String,
    /// Of this program.
    pub(super) version: &'static str,
    /// Of this program's source.
    pub(super) commit: &'static str,
}

impl Machine {
    pub(super) fn this() -> Self {
        Self {
            processor: processor::model_name(),
            cores: processor::core_count(),
            simd: simd::name().to_owned(),
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
