//! Poses out of `/tf`: where the vehicle lies in the world, through the frames between.
//!
//! The outermost frame is the world. From there the way leads inward for as long as there is one way,
//! or to `base_link`, as the vehicle is called in ROS (REP 105); frames that do not move among each
//! other may lie between. What hangs on the vehicle, such as a joint or a sensor, is no part of it.

use echosplat_join::ArrivedPose;
use echosplat_model::{Pose, StampedPose, Timestamp};

use super::message::Transform;

/// The vehicle's frame.
const VEHICLE: &str = "base_link";
/// Pairs of frames that are followed.
const MAX_PAIRS: usize = 256;
/// Poses of all pairs together; two days at 50 Hz.
const MAX_POSES: usize = 8_640_000;
/// Frames named in an error.
const NAMED: usize = 8;

/// Where frames lie in others, as time goes by.
#[derive(Debug, Default)]
pub(super) struct Frames {
    pairs: Vec<Pair>,
    pose_count: usize,
}

#[derive(Debug)]
struct Pair {
    parent: String,
    child: String,
    is_static: bool,
    poses: Vec<ArrivedPose>,
}

impl Frames {
    pub(super) fn take(&mut self, transform: Transform, is_static: bool, arrived: Timestamp) {
        let is_it =
            |pair: &Pair| (&pair.parent, &pair.child) == (&transform.parent, &transform.child);
        let index = match self.pairs.iter().position(is_it) {
            Some(index) => index,
            None if self.pairs.len() < MAX_PAIRS => {
                self.pairs.push(Pair {
                    parent: transform.parent,
                    child: transform.child,
                    is_static: true,
                    poses: Vec::new(),
                });
                self.pairs.len() - 1
            }
            None => return,
        };
        let pair = &mut self.pairs[index];
        pair.is_static &= is_static;
        if self.pose_count < MAX_POSES {
            self.pose_count += 1;
            let pose = transform.pose.pose;
            pair.poses.push(ArrivedPose { pose, arrived });
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pairs.iter().all(|pair| pair.is_static)
    }

    /// The vehicle's poses in the world, and the frames from the one to the other.
    ///
    /// # Errors
    /// In words, if the frames leave open which one is the vehicle.
    pub(super) fn poses(mut self) -> Result<(Vec<ArrivedPose>, String), String> {
        for pair in &mut self.pairs {
            pair.poses.sort_by_key(|arrived| arrived.pose.time);
        }
        let way = self.way()?;
        let names = way.iter().map(|pair| pair.child.as_str());
        let names = way
            .first()
            .map(|pair| pair.parent.as_str())
            .into_iter()
            .chain(names);
        let words = names.collect::<Vec<_>>().join(" → ");
        let Some(moving) = way.iter().rposition(|pair| !pair.is_static) else {
            return Err("its frames do not move among each other".to_owned());
        };
        // What does not move behind the last that does is the vehicle's own.
        let (outer, inner) = (&way[..moving], &way[moving..]);
        let poses = inner[0].poses.iter().map(|last| {
            let time = last.pose.time;
            let outer = outer.iter().map(|pair| pair.at(time));
            let outer = outer.fold(Pose::IDENTITY, |world, pose| world * pose);
            let rest = inner[1..].iter().map(|pair| pair.at(time));
            let world_from_vehicle = rest
                .fold(outer * last.pose.world_from_vehicle, |world, pose| {
                    world * pose
                });
            let pose = StampedPose {
                world_from_vehicle,
                ..last.pose
            };
            ArrivedPose { pose, ..*last }
        });
        Ok((poses.collect(), words))
    }

    /// From the world to the vehicle.
    fn way(&self) -> Result<Vec<&Pair>, String> {
        let is_child = |name: &str| self.pairs.iter().any(|pair| pair.child == name);
        let moves = |pair: &&Pair| !pair.is_static;
        if let Some(last) = self
            .pairs
            .iter()
            .find(|pair| last_name(&pair.child) == VEHICLE)
        {
            return Ok(self.way_to(last));
        }
        let mut roots: Vec<&str> = self.pairs.iter().map(|pair| pair.parent.as_str()).collect();
        roots.sort_unstable();
        roots.dedup();
        roots.retain(|root| !is_child(root) && self.inside(root).iter().any(moves));
        let [root] = roots[..] else {
            return Err(self.ambiguous());
        };
        let mut way: Vec<&Pair> = Vec::new();
        let mut frame = root;
        while way.len() < self.pairs.len() {
            let children = self.pairs.iter().filter(|pair| pair.parent == frame);
            let has_moving =
                |pair: &&Pair| !pair.is_static || self.inside(&pair.child).iter().any(moves);
            let moving: Vec<&Pair> = children.filter(has_moving).collect();
            match moving[..] {
                [only] => {
                    way.push(only);
                    frame = &only.child;
                }
                [] => break,
                // What hangs on the vehicle branches there.
                _ if way.iter().any(moves) => break,
                _ => return Err(self.ambiguous()),
            }
        }
        Ok(way)
    }

    fn way_to<'a>(&'a self, last: &'a Pair) -> Vec<&'a Pair> {
        let mut way = vec![last];
        while way.len() < self.pairs.len() {
            let outermost = way[way.len() - 1];
            match self
                .pairs
                .iter()
                .find(|pair| pair.child == outermost.parent)
            {
                Some(outer) => way.push(outer),
                None => break,
            }
        }
        way.reverse();
        way
    }

    /// All pairs that lie in this frame.
    fn inside(&self, frame: &str) -> Vec<&Pair> {
        let mut found: Vec<&Pair> = Vec::new();
        let mut frames = vec![frame];
        while let Some(frame) = frames.pop() {
            for pair in self.pairs.iter().filter(|pair| pair.parent == frame) {
                let is_known = |known: &&Pair| std::ptr::eq(*known, pair);
                if !found.iter().any(is_known) {
                    found.push(pair);
                    frames.push(&pair.child);
                }
            }
        }
        found
    }

    fn ambiguous(&self) -> String {
        let moving = self.pairs.iter().filter(|pair| !pair.is_static);
        let mut names: Vec<String> = moving
            .map(|pair| format!("{} → {}", pair.parent, pair.child))
            .collect();
        names.sort();
        names.truncate(NAMED);
        format!(
            "its frames leave open which one is the vehicle ({}); read is one way from the world inward, \
             or the one to `{VEHICLE}`",
            names.join(", ")
        )
    }
}

impl Pair {
    /// Between the two around `time`; the first or the last beyond them.
    fn at(&self, time: Timestamp) -> Pose {
        let pose = |index: usize| self.poses[index].pose;
        let behind = self
            .poses
            .partition_point(|arrived| arrived.pose.time <= time);
        if behind == 0 || self.poses.len() == behind {
            let nearest = behind.saturating_sub(1).min(self.poses.len() - 1);
            return pose(nearest).world_from_vehicle;
        }
        let (before, after) = (pose(behind - 1), pose(behind));
        let fraction = time.seconds_since(before.time) / after.time.seconds_since(before.time);
        before
            .world_from_vehicle
            .interpolate(&after.world_from_vehicle, fraction)
    }
}

/// `base_link` of `rov1/base_link`.
fn last_name(frame: &str) -> &str {
    frame.rsplit('/').next().unwrap_or(frame)
}

#[cfg(test)]
mod tests {
    use super::*;
    use echosplat_bus::pose_message;
    use echosplat_model::glam::DVec3;

    fn frames(pairs: &[(&str, &str, bool)]) -> Frames {
        let mut frames = Frames::default();
        for second in 0..3 {
            for (index, (parent, child, is_static)) in pairs.iter().enumerate() {
                let time = Timestamp::from_secs_f64(f64::from(second) + 0.25 * index as f64);
                let place = [if *is_static { 10.0 } else { time.as_secs_f64() }, 0.0, 0.0];
                let turn = [0.0, 0.0, 0.0, 1.0];
                let pose = pose_message::checked(time, [parent, child], (place, turn), None);
                let transform = Transform {
                    parent: (*parent).to_owned(),
                    child: (*child).to_owned(),
                    pose: pose.unwrap(),
                };
                frames.take(transform, *is_static, time);
            }
        }
        frames
    }

    #[test]
    fn the_way_leads_from_the_world_to_the_vehicle() {
        let ways = [
            (&[("map", "rov", false)][..], "map → rov"),
            (
                &[
                    ("map", "odom", false),
                    ("odom", "base_link", false),
                    ("base_link", "arm", false),
                ],
                "map → odom → base_link",
            ),
            (
                &[
                    ("odom", "rov", false),
                    ("map", "odom", true),
                    ("rov", "sonar", true),
                ],
                "map → odom → rov",
            ),
            (
                &[
                    ("world", "rov", false),
                    ("rov", "arm", false),
                    ("rov", "light", false),
                ],
                "world → rov",
            ),
            (
                &[("a", "b", false), ("map", "x/base_link", false)],
                "map → x/base_link",
            ),
        ];
        for (pairs, expected) in ways {
            let (poses, words) = frames(pairs).poses().unwrap();
            assert_eq!((words.as_str(), poses.len()), (expected, 3));
        }
    }

    #[test]
    fn a_frame_between_is_taken_at_the_time_of_the_innermost() {
        let (poses, _) = frames(&[("map", "odom", false), ("odom", "base_link", false)])
            .poses()
            .unwrap();
        // At 0.25 s the outer frame is at 0.25 m, between 0 m at 0 s and 1 m at 1 s.
        let place = poses[0].pose.world_from_vehicle.translation_m;
        assert!(
            (place - DVec3::new(0.5, 0.0, 0.0)).length() < 1e-9,
            "{place}"
        );
    }

    #[test]
    fn two_ways_are_told() {
        let said = frames(&[("map", "a", false), ("map", "b", false)])
            .poses()
            .unwrap_err();
        assert!(
            said.contains("map → a, map → b") && said.contains("base_link"),
            "{said}"
        );
        let said = frames(&[("map", "a", false), ("world", "b", false)])
            .poses()
            .unwrap_err();
        assert!(said.contains("leave open"), "{said}");
        // Frames in a circle end too.
        assert!(
            frames(&[("a", "b", false), ("b", "a", false)])
                .poses()
                .is_err()
        );
    }
}
