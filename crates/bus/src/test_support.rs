//! Gaussians and maps for the tests of this crate.

use std::sync::Arc;

use echosplat_model::{Gaussian, Snapshot, Standing, Timestamp, Why};
use glam::{DVec3, Quat, Vec3};

pub(crate) use crate::delta::bits;
use crate::{Bus, BusConfig};

/// One that differs from every other by its id in every field.
pub(crate) fn gaussian(id: u32) -> Gaussian {
    let t = (id % 10_007) as f32;
    Gaussian {
        id,
        mean_m: Vec3::new(t * 0.013 - 20.0, (t * 0.7).sin() * 9.0, -t * 0.001),
        rotation: Quat::from_rotation_z(t * 0.1),
        scale_m: Vec3::new(0.01, 0.02, 0.03) + t * 1e-5,
        opacity: 0.5 + 0.4 * (t * 0.3).cos(),
        reflectivity: 0.25 + 1e-5 * t,
        sigma_m: 0.05 + 1e-4 * t,
        position_covariance_m2: [1e-3, 1e-5 * t, -2e-5, 2e-3, 3e-5, 3e-3],
        probability: 0.5 + 0.4 * (t * 0.1).sin(),
        standing: match id % 3 {
            0 => Standing::Confident,
            1 => Standing::Ambiguous,
            _ => Standing::Confident,
        },
        why: Why::of_bytes([(id % 18 + 1) as u8, (id % 251) as u8, (id % 255) as u8]),
    }
}

pub(crate) fn snapshot(epoch: u64, sequence: u64, gaussians: Vec<Gaussian>) -> Arc<Snapshot> {
    Arc::new(Snapshot {
        epoch,
        sequence,
        time: Timestamp::from_millis(sequence as i64 * 100),
        through_ping: sequence * 10,
        origin_m: DVec3::new(500_000.125, 0.1, -3.0),
        intensity_unit: 0.3,
        gaussians,
    })
}

/// Bit for bit the same Gaussians in the same order.
pub(crate) fn same(a: &[Gaussian], b: &[Gaussian]) -> bool {
    a.iter().map(bits).eq(b.iter().map(bits))
}

/// One port of this machine to listen on and to connect to, as by default.
pub(crate) fn endpoints() -> String {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    format!("['tcp/127.0.0.1:{port}']")
}

/// A session there.
pub(crate) fn bus_with(endpoints: &str, change: impl FnOnce(&mut BusConfig)) -> Bus {
    let setting = |key: &str| (key.to_owned(), endpoints.to_owned());
    let mut config = BusConfig {
        node: "test".to_owned(),
        zenoh: vec![setting("connect/endpoints"), setting("listen/endpoints")],
        ..BusConfig::default()
    };
    change(&mut config);
    Bus::open(config).unwrap()
}

/// Two sessions that see each other.
pub(crate) fn bus_pair() -> (Bus, Bus) {
    let endpoints = endpoints();
    let open = || bus_with(&endpoints, |_| {});
    (open(), open())
}
