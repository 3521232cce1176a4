//! Who in this process is handed what is published of the map: the recorder.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Takes the cloud (CDR of `sensor_msgs/msg/PointCloud2`) and the attachment (JSON) of one message.
pub type DeltaTap = Box<dyn Fn(Arc<[u8]>, Arc<[u8]>) + Send + Sync>;

/// Takes a static transform, CDR of `tf2_msgs/msg/TFMessage`.
pub type StaticTransformTap = Box<dyn Fn(Arc<[u8]>) + Send + Sync>;

/// What a publisher calls; each is called on its thread and must not wait.
#[derive(Clone, Default)]
pub(crate) struct Taps {
    pub(crate) delta: Option<Arc<DeltaTap>>,
    pub(crate) static_transform: Option<Arc<StaticTransformTap>>,
}

impl fmt::Debug for Taps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Taps")
            .field("delta", &self.delta.is_some())
            .field("static_transform", &self.static_transform.is_some())
            .finish()
    }
}

/// Those that the next publisher takes over.
#[derive(Debug, Default)]
pub(crate) struct TapBoard(Mutex<Taps>);

impl TapBoard {
    pub(crate) fn edit(&self) -> MutexGuard<'_, Taps> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn current(&self) -> Taps {
        self.edit().clone()
    }
}
