//! How memory grows: a line through what was held, after the warm-up.

/// What is allowed.
pub(super) const MOST_MIB_PER_HOUR: f64 = 1.0;
pub(super) const MIB: f64 = (1 << 20) as f64;

/// Memory held at a time of the dive.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) dive_s: f64,
    pub(super) bytes: u64,
}

/// The most of all.
pub(super) fn most_mib(samples: &[Sample]) -> f64 {
    let bytes = samples.iter().map(|sample| sample.bytes);
    bytes.max().unwrap_or(0) as f64 / MIB
}

/// Slope of the least squares' line after the warm-up; `None` with fewer than two moments there.
pub(super) fn mib_per_hour(samples: &[Sample], warm_up_s: f64) -> Option<f64> {
    let warm = samples.iter().filter(|sample| sample.dive_s >= warm_up_s);
    let points: Vec<[f64; 2]> = warm
        .map(|sample| [sample.dive_s / 3600.0, sample.bytes as f64 / MIB])
        .collect();
    let count = points.len() as f64;
    let mean = |axis: usize| points.iter().map(|point| point[axis]).sum::<f64>() / count;
    let [hours, mib] = [mean(0), mean(1)];
    let products = |axes: [usize; 2]| -> f64 {
        let away = |point: &[f64; 2]| [point[0] - hours, point[1] - mib];
        let points = points.iter().map(away);
        points.map(|away| away[axes[0]] * away[axes[1]]).sum()
    };
    let spread = products([0, 0]);
    (spread > 0.0).then(|| products([0, 1]) / spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_that_after_the_warm_up() {
        let sample = |minute: u64| Sample {
            dive_s: 60.0 * minute as f64,
            // 100 MiB within ten minutes, then two an hour.
            bytes: ((10 * minute.min(10)) << 20) + (minute << 20) / 30,
        };
        let samples: Vec<Sample> = (0..=70).map(sample).collect();
        let growth = mib_per_hour(&samples, 600.0).unwrap();
        assert!((growth - 2.0).abs() < 1e-3, "{growth}");
        assert!((most_mib(&samples) - 102.3).abs() < 0.1);
        assert_eq!(mib_per_hour(&samples, 1e9), None);
    }
}
