//! The service's end: takes what there is to show, and never waits for a browser.

use std::sync::Arc;

use echosplat_model::{Ping, PosedPing, Snapshot};
use serde_json::{Value, json};

use crate::hub::{ErrorPoint, Hub, Live, lock};
use crate::track::{Track, TrackPoint};

/// Takes maps, pings, poses and status; cheap to clone. Each call costs a lock that nobody holds for
/// longer than a copy takes.
#[derive(Debug, Clone)]
pub struct Feed(pub(crate) Arc<Hub>);

impl Feed {
    /// The map as it is now; a newer one takes its place.
    pub fn map(&self, map: &Arc<Snapshot>) {
        let mut orders = lock(&self.0.orders);
        orders.newest = Some(Arc::clone(map));
        orders.is_final = false;
        orders.offered += 1;
        drop(orders);
        self.0.ordered.notify_all();
    }

    /// The map given last will not change any more.
    pub fn map_is_final(&self) {
        let mut orders = lock(&self.0.orders);
        orders.is_final = true;
        orders.offered += 1;
        drop(orders);
        self.0.ordered.notify_all();
    }

    /// The map begins anew; what came before is of another world.
    pub fn begin_epoch(&self) {
        lock(&self.0.scene).track = Track::default();
        self.0
            .tell(Live::Text(json!({"kind": "epoch"}).to_string().into()));
    }

    /// A ping as it came, with or without a pose.
    pub fn ping(&self, ping: &Arc<Ping>) {
        if self.0.has_watchers() {
            lock(&self.0.scene).ring.push(ping);
        }
    }

    /// A ping with its pose.
    pub fn posed(&self, posed: &PosedPing) {
        let time = posed.ping.transmit_time();
        let mut scene = lock(&self.0.scene);
        let first = *scene.first_time.get_or_insert(time);
        scene.track.push(TrackPoint {
            dive_s: time.seconds_since(first),
            place_m: posed.world_from_sensor.translation_m,
        });
        scene.newest_pose = Some(posed.clone());
        scene.has_new_pose = true;
    }

    /// The service's status, once a second.
    pub fn status(&self, status: Value) {
        if self.0.has_watchers() {
            let text = json!({"kind": "status", "status": status}).to_string();
            self.0.tell(Live::Text(text.into()));
        }
        self.0.set_status(status);
    }

    /// How far the map of a moment is from the truth, metres: Chamfer and Hausdorff distance.
    pub fn error(&self, dive_s: f64, cd_m: f64, hd_m: f64) {
        let finite = |value: f64| value.is_finite().then_some(value);
        let point = ErrorPoint {
            dive_s,
            cd_m: finite(cd_m),
            hd_m: finite(hd_m),
        };
        lock(&self.0.scene).push_error(point);
        let text = json!({"kind": "error", "error": point}).to_string();
        self.0.tell(Live::Text(text.into()));
    }
}
