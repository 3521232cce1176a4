//! Asking for the map, and what comes back.

use echosplat_model::{Gaussian, TileKey, Timestamp};
use glam::DVec3;

/// What of the map is asked for, from the parameters of a query.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SnapshotRequest {
    /// `bbox=x0,y0,z0,x1,y1,z1`: only tiles that touch this box; metres in the map's frame.
    pub bbox_m: Option<[f64; 6]>,
    /// `epoch=E`: the epoch that `since` belongs to; taken as the current one if left out.
    pub epoch: Option<u64>,
    /// `since=N`: only tiles that changed after sequence N, each of them whole.
    pub since: Option<u64>,
}

/// A parameter that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("snapshot parameter {name}={value} is not {wanted}")]
pub struct SnapshotRequestError {
    name: &'static str,
    value: String,
    wanted: &'static str,
}

impl SnapshotRequest {
    /// From `parameter`, which gives the text of a parameter by name.
    ///
    /// # Errors
    /// Names the parameter that cannot be read.
    pub fn parse<'a>(
        parameter: impl Fn(&str) -> Option<&'a str>,
    ) -> Result<Self, SnapshotRequestError> {
        let number = |name: &'static str| {
            let text = parameter(name).filter(|text| !text.is_empty());
            let parse = |text: &str| text.trim().parse::<u64>().ok();
            let error = |text: &str| refused(name, text, "a whole number");
            text.map(|text| parse(text).ok_or_else(|| error(text)))
                .transpose()
        };
        let bbox = parameter("bbox").filter(|text| !text.is_empty());
        Ok(Self {
            bbox_m: bbox.map(parse_bbox).transpose()?,
            epoch: number("epoch")?,
            since: number("since")?,
        })
    }

    /// The parameters of a query that [`SnapshotRequest::parse`] reads as this.
    #[must_use]
    pub fn to_parameters(&self) -> String {
        let mut parts = Vec::new();
        if let Some(bbox) = self.bbox_m {
            let numbers = bbox.map(|number| number.to_string());
            parts.push(format!("bbox={}", numbers.join(",")));
        }
        if let Some(epoch) = self.epoch {
            parts.push(format!("epoch={epoch}"));
        }
        if let Some(since) = self.since {
            parts.push(format!("since={since}"));
        }
        parts.join(";")
    }

    /// Whether the tile shares a point with the box.
    pub(super) fn touches(&self, tile: TileKey, tile_edge_m: f64) -> bool {
        let Some([x0, y0, z0, x1, y1, z1]) = self.bbox_m else {
            return true;
        };
        let within = |index: i32, low: f64, high: f64| {
            let start = f64::from(index) * tile_edge_m;
            start <= high && start + tile_edge_m >= low
        };
        within(tile.x, x0, x1) && within(tile.y, y0, y1) && within(tile.z, z0, z1)
    }
}

fn refused(name: &'static str, text: &str, wanted: &'static str) -> SnapshotRequestError {
    SnapshotRequestError {
        name,
        value: text.chars().take(80).collect(),
        wanted,
    }
}

fn parse_bbox(text: &str) -> Result<[f64; 6], SnapshotRequestError> {
    let error = || {
        let wanted = "six finite numbers x0,y0,z0,x1,y1,z1 with each low end first";
        refused("bbox", text, wanted)
    };
    let mut corners = [0.0; 6];
    let mut parts = text.split(',');
    for corner in &mut corners {
        let part = parts.next().ok_or_else(error)?;
        *corner = part.trim().parse().map_err(|_| error())?;
    }
    let ordered = (0..3).all(|axis| corners[axis] <= corners[axis + 3]);
    let finite = corners.iter().all(|corner: &f64| corner.is_finite());
    match parts.next().is_none() && ordered && finite {
        true => Ok(corners),
        false => Err(error()),
    }
}

/// One tile, whole.
#[derive(Debug, Clone, PartialEq)]
pub struct TileState {
    /// Which.
    pub tile: TileKey,
    /// Everything in it, in order of id; empty if nothing is left.
    pub gaussians: Vec<Gaussian>,
}

/// The map, or what changed of it, as of one sequence.
#[derive(Debug, Clone, PartialEq)]
pub struct SnapshotAnswer {
    /// Of the map.
    pub epoch: u64,
    /// All deltas up to this one are in it.
    pub sequence: u64,
    /// Transmit time of the newest ping whose evidence is in it.
    pub time: Timestamp,
    /// Sequence of that ping.
    pub through_ping: u64,
    /// Added to every mean gives the world's coordinates.
    pub origin_m: DVec3,
    /// Intensity per steradian, in the pings' own unit, that αρ = 1 sends back; positive.
    pub intensity_unit: f32,
    /// Nothing more will come.
    pub is_final: bool,
    /// Only tiles that changed after this sequence are in it; `None`: tiles not in it are empty.
    pub since: Option<u64>,
    /// In order of tile.
    pub tiles: Vec<TileState>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(parameters: &str) -> Result<SnapshotRequest, SnapshotRequestError> {
        let pairs: Vec<_> = parameters
            .split(';')
            .filter_map(|part| part.split_once('='))
            .collect();
        SnapshotRequest::parse(|name| {
            let pair = pairs.iter().find(|(key, _)| *key == name);
            pair.map(|(_, value)| *value)
        })
    }

    #[test]
    fn requests_are_read_as_written() {
        let request = SnapshotRequest {
            bbox_m: Some([-1.5, 0.0, 1e-3, 2.0, 0.0, 4.0]),
            epoch: Some(u64::MAX),
            since: Some(0),
        };
        assert_eq!(parse(&request.to_parameters()), Ok(request));
        assert_eq!(parse(""), Ok(SnapshotRequest::default()));
    }

    #[test]
    fn unreadable_parameters_are_named() {
        let bad = [
            "since=-1",
            "epoch=x",
            "bbox=1,2,3",
            "bbox=0,0,0,1,1,1,1",
            "bbox=0,0,0,1,1,NaN",
            "bbox=2,0,0,1,1,1",
        ];
        for text in bad {
            let refused = parse(text).unwrap_err();
            assert_eq!(Some(refused.name), text.split('=').next());
        }
    }

    #[test]
    fn a_box_takes_every_tile_it_touches() {
        let request = parse("bbox=0,0,0,4,1,1").unwrap();
        let touches = |x| request.touches(TileKey { x, y: 0, z: 0 }, 4.0);
        assert!(touches(0) && touches(1) && touches(-1));
        assert!(!touches(2) && !touches(-2));
    }
}
