//! Keyframes: where the camera and the leaves are at some times, and from those where they are at any.
//!
//! *Theory.* Three interpolants, each through its keys and with a speed that does not jump:
//!
//! * What moves *things* (a leaf's place, its size, a field of view) is the monotone cubic of Fritsch and Butland 1984, one
//!   coordinate at a time: it never leaves the interval between two keys. A drill that is keyed to stop at a depth does not
//!   dip below it, and between two equal keys it rests.
//! * What moves the *camera* (eye, target, up) is the Catmull-Rom spline for keys at uneven times: it rounds the corners of its
//!   path, where the monotone cubic would slow down at each extreme of a coordinate and fly an orbit as a square. It may go
//!   wide of its keys, which harms nothing; between two equal keys it rests too.
//! * Rotations go from key to key along the shorter great arc (slerp, Shoemake 1985), and *how far* they are along all the
//!   arcs is a monotone cubic of time. Slerp alone would change its speed with a jerk at every key.
//!
//! *Practice.* Every quantity has keys of its own: a keyframe that does not name it does not stop it. The first keyframe
//! stands for the scene as it is wherever it says nothing else. What no keyframe names stays as the scene has it. A leaf may turn, move and change its size evenly; it keeps its shape, so that its surfels can be
//! moved rather than made again. A turn of more than 180° needs a key on its way.

use glam::{DAffine3, DQuat, DVec3};

use super::CameraSpec;
use crate::csg::LeafId;
use crate::space::{Lens, Motion};

/// Values at ascending times, at least one.
#[derive(Debug, Clone, PartialEq)]
pub struct Keys<T> {
    keys: Vec<(f64, T)>,
}

impl<T: Copy> Keys<T> {
    /// From values with their times; `None` where there is none, or the times do not ascend.
    pub fn new(keys: Vec<(f64, T)>) -> Option<Self> {
        let ascend = keys.windows(2).all(|pair| pair[0].0 < pair[1].0);
        (!keys.is_empty() && ascend).then_some(Self { keys })
    }

    /// The same, beginning at `start` with `value` where they begin later.
    pub fn beginning(mut self, start: f64, value: T) -> Self {
        if self.keys[0].0 > start {
            self.keys.insert(0, (start, value));
        }
        self
    }

    /// The values with their times.
    pub fn keys(&self) -> &[(f64, T)] {
        &self.keys
    }

    /// The key before `time` and the share of the way from it to the next one; `Err` with the value where `time` is outside.
    fn segment(&self, time: f64) -> Result<usize, T> {
        let (first, last) = (self.keys[0], self.keys[self.keys.len() - 1]);
        if !(time > first.0) {
            return Err(first.1);
        }
        if time >= last.0 {
            return Err(last.1);
        }
        Ok(self.keys.partition_point(|key| key.0 <= time) - 1)
    }
}

/// The cubic from `a` to `b` over `length`, with the slopes `from` and `to`, at the share `u` of the way.
fn hermite(a: f64, b: f64, from: f64, to: f64, length: f64, u: f64) -> f64 {
    let (u2, u3) = (u * u, u * u * u);
    let rise = 3.0 * u2 - 2.0 * u3;
    a + (b - a) * rise + length * (from * (u3 - 2.0 * u2 + u) + to * (u3 - u2))
}

/// The slope of the monotone cubic at a key between two steps: (length, mean slope) of each.
fn monotone_slope((before, d_before): (f64, f64), (after, d_after): (f64, f64)) -> f64 {
    if !(d_before * d_after > 0.0) {
        return 0.0;
    }
    // The weighted harmonic mean.
    let (w_before, w_after) = (2.0 * after + before, after + 2.0 * before);
    (w_before + w_after) / (w_before / d_before + w_after / d_after)
}

/// The slope of the Catmull-Rom spline at a key between two steps: that of the parabola through the three keys, or none
/// beside a pause.
fn round_slope((before, d_before): (f64, DVec3), (after, d_after): (f64, DVec3)) -> DVec3 {
    let rests = d_before == DVec3::ZERO || d_after == DVec3::ZERO;
    if rests { DVec3::ZERO } else { (d_before * after + d_after * before) / (before + after) }
}

/// The slopes at both ends of a segment: those of keys between segments, `outer` of the other at the first and last key, the
/// `mean` where the segment is all there is.
fn both_slopes<T: Copy>(from: Option<T>, to: Option<T>, outer: impl Fn(T) -> T, mean: T) -> (T, T) {
    match (from, to) {
        (Some(from), Some(to)) => (from, to),
        (None, Some(to)) => (outer(to), to),
        (Some(from), None) => (from, outer(from)),
        (None, None) => (mean, mean),
    }
}

impl Keys<f64> {
    /// The value at `time`, monotone between keys.
    pub fn monotone(&self, time: f64) -> f64 {
        let i = match self.segment(time) {
            Ok(i) => i,
            Err(outside) => return outside,
        };
        let keys = &self.keys;
        let step = |i: usize| {
            let length = keys[i + 1].0 - keys[i].0;
            (length, (keys[i + 1].1 - keys[i].1) / length)
        };
        let (length, mean) = step(i);
        let inner = |i: usize| (i > 0 && i + 1 < keys.len()).then(|| monotone_slope(step(i - 1), step(i)));
        // It sets out without bending; between 0 and three times the mean slope no cubic overshoots.
        let outer = |other: f64| (1.5 * mean - 0.5 * other).clamp((3.0 * mean).min(0.0), (3.0 * mean).max(0.0));
        let (from, to) = both_slopes(inner(i), inner(i + 1), outer, mean);
        hermite(keys[i].1, keys[i + 1].1, from, to, length, (time - keys[i].0) / length)
    }
}

impl Keys<DVec3> {
    /// The point at `time`, each coordinate monotone between keys.
    pub fn monotone(&self, time: f64) -> DVec3 {
        let of_axis = |axis: usize| Keys { keys: self.keys.iter().map(|(time, p)| (*time, p[axis])).collect() };
        DVec3::from_array(std::array::from_fn(|axis| of_axis(axis).monotone(time)))
    }

    /// The point at `time` on a path that rounds its corners; it rests between equal keys.
    pub fn round(&self, time: f64) -> DVec3 {
        let i = match self.segment(time) {
            Ok(i) => i,
            Err(outside) => return outside,
        };
        let keys = &self.keys;
        let step = |i: usize| {
            let length = keys[i + 1].0 - keys[i].0;
            (length, (keys[i + 1].1 - keys[i].1) / length)
        };
        let (length, mean) = step(i);
        let inner = |i: usize| (i > 0 && i + 1 < keys.len()).then(|| round_slope(step(i - 1), step(i)));
        // It sets out without bending.
        let outer = |other: DVec3| if mean == DVec3::ZERO { mean } else { 1.5 * mean - 0.5 * other };
        let (from, to) = both_slopes(inner(i), inner(i + 1), outer, mean);
        let u = (time - keys[i].0) / length;
        DVec3::from_array(std::array::from_fn(|axis| {
            hermite(keys[i].1[axis], keys[i + 1].1[axis], from[axis], to[axis], length, u)
        }))
    }
}

impl Keys<DQuat> {
    /// The rotation at `time`.
    pub fn slerp(&self, time: f64) -> DQuat {
        let i = match self.segment(time) {
            Ok(i) => i,
            Err(outside) => return outside,
        };
        let mut way = 0.0;
        let mut ways = Vec::with_capacity(self.keys.len());
        for (k, key) in self.keys.iter().enumerate() {
            if k > 0 {
                way += self.keys[k - 1].1.angle_between(key.1);
            }
            ways.push((key.0, way));
        }
        let arc = ways[i + 1].1 - ways[i].1;
        let along = Keys { keys: ways }.monotone(time);
        let before: f64 = (0..i).map(|k| self.keys[k].1.angle_between(self.keys[k + 1].1)).sum();
        if arc > 0.0 { self.keys[i].1.slerp(self.keys[i + 1].1, (along - before) / arc) } else { self.keys[i].1 }
    }
}

/// What a leaf's transform is made of: `translate · rotate · scale`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// After scale and rotation.
    pub translate: DVec3,
    /// A unit quaternion.
    pub rotate: DQuat,
    /// Along the leaf's axes; no factor is 0.
    pub scale: DVec3,
}

impl Placement {
    /// The map that it stands for.
    pub fn world_from_leaf(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(self.scale, self.rotate, self.translate)
    }
}

/// How one leaf moves.
#[derive(Debug, Clone, PartialEq)]
pub struct LeafKeys {
    /// Which.
    pub leaf: LeafId,
    /// Where the scene has it.
    pub own: Placement,
    /// Its `translate`.
    pub translate: Option<Keys<DVec3>>,
    /// Its `rotate`.
    pub rotate: Option<Keys<DQuat>>,
    /// Its `scale`, as multiples of its own; positive.
    pub growth: Option<Keys<f64>>,
}

impl LeafKeys {
    /// What moves the leaf from where the scene has it to where it is at `time`, in world space.
    pub fn motion(&self, time: f64) -> Motion {
        let own = &self.own;
        let scale = self.growth.as_ref().map_or(1.0, |keys| keys.monotone(time));
        let rotation = match self.rotate.as_ref().map(|keys| keys.slerp(time)) {
            Some(rotate) if rotate != own.rotate => (rotate * own.rotate.inverse()).normalize(),
            _ => DQuat::IDENTITY,
        };
        let translate = self.translate.as_ref().map_or(own.translate, |keys| keys.monotone(time));
        // Its origin goes from its own place to the keyed one.
        Motion { scale, rotation, translation: translate - rotation * own.translate * scale }
    }
}

/// How the camera moves; what has no keys stays.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraKeys {
    /// World space.
    pub eye: Option<Keys<DVec3>>,
    /// World space.
    pub target: Option<Keys<DVec3>>,
    /// World space.
    pub up: Option<Keys<DVec3>>,
    /// Degrees; there are no `height` keys beside.
    pub fov_y: Option<Keys<f64>>,
    /// World units; there are no `fov_y` keys beside.
    pub height: Option<Keys<f64>>,
}

impl CameraKeys {
    /// The camera at `time`, where `own` is the one without keys, and the one at `start` of what has no key there.
    pub fn at(&self, own: CameraSpec, start: f64, time: f64) -> CameraSpec {
        let point = |keys: &Option<Keys<DVec3>>, own: DVec3| {
            keys.as_ref().map_or(own, |keys| keys.clone().beginning(start, own).round(time))
        };
        // A lens of the other kind cannot become the keyed one bit by bit.
        let number = |keys: &Keys<f64>, own: Option<f64>| match own {
            Some(own) => keys.clone().beginning(start, own).monotone(time),
            None => keys.monotone(time),
        };
        let (own_fov_y, own_height) = match own.lens {
            Lens::FovY(degrees) => (Some(degrees), None),
            Lens::Height(height) => (None, Some(height)),
        };
        let lens = match (&self.fov_y, &self.height) {
            (Some(degrees), _) => Lens::FovY(number(degrees, own_fov_y)),
            (None, Some(height)) => Lens::Height(number(height, own_height)),
            (None, None) => own.lens,
        };
        CameraSpec {
            eye: point(&self.eye, own.eye),
            target: point(&self.target, own.target),
            up: point(&self.up, own.up),
            lens,
        }
    }
}

/// What the keyframes' times count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeUnit {
    /// Seconds: the film's length is the same at any rate.
    Seconds,
    /// Frames.
    Frames,
}

/// How a scene moves.
#[derive(Debug, Clone, PartialEq)]
pub struct Animation {
    /// What times count.
    pub unit: TimeUnit,
    /// The time of the first keyframe.
    pub start: f64,
    /// The time of the last keyframe, not before the first.
    pub end: f64,
    /// The camera.
    pub camera: CameraKeys,
    /// The leaves that have keys, each once.
    pub leaves: Vec<LeafKeys>,
}

impl Animation {
    /// How many frames there are from the first keyframe to the last at `fps` frames a second, both included.
    pub fn frames(&self, fps: f64) -> f64 {
        let length = self.end - self.start;
        1.0 + match self.unit {
            TimeUnit::Seconds => (length * fps).round(),
            TimeUnit::Frames => length.round(),
        }
    }

    /// The time of frame `frame`, counted from 0.
    pub fn time_of(&self, frame: usize, fps: f64) -> f64 {
        self.start
            + match self.unit {
                TimeUnit::Seconds => frame as f64 / fps,
                TimeUnit::Frames => frame as f64,
            }
    }

    /// The camera at `time`, where `own` is the scene's.
    pub fn camera_at(&self, own: CameraSpec, time: f64) -> CameraSpec {
        self.camera.at(own, self.start, time)
    }

    /// Times that no leaf moves far between: some in each step between two keys.
    pub fn sample_times(&self) -> Vec<f64> {
        const STEPS: usize = 16;
        let mut keys = vec![self.start, self.end];
        for leaf in &self.leaves {
            keys.extend(leaf.translate.iter().flat_map(|keys| keys.keys().iter().map(|key| key.0)));
            keys.extend(leaf.rotate.iter().flat_map(|keys| keys.keys().iter().map(|key| key.0)));
            keys.extend(leaf.growth.iter().flat_map(|keys| keys.keys().iter().map(|key| key.0)));
        }
        keys.sort_by(f64::total_cmp);
        keys.dedup();
        let between = |pair: &[f64]| {
            let (from, to) = (pair[0], pair[1]);
            (0..STEPS).map(move |step| from + (to - from) * step as f64 / STEPS as f64).collect::<Vec<_>>()
        };
        keys.windows(2).flat_map(between).chain([self.end]).collect()
    }

    /// What moves a leaf at `time`.
    pub fn motion(&self, leaf: LeafId, time: f64) -> Motion {
        self.leaves.iter().find(|keys| keys.leaf == leaf).map_or(Motion::REST, |keys| keys.motion(time))
    }

    /// Whether a leaf has keys.
    pub fn moves(&self, leaf: LeafId) -> bool {
        self.leaves.iter().any(|keys| keys.leaf == leaf)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys<T: Copy>(keys: &[(f64, T)]) -> Keys<T> {
        Keys::new(keys.to_vec()).unwrap()
    }

    /// Times from 0 to 10 in small steps.
    fn times() -> impl Iterator<Item = f64> {
        (0..=1000).map(|i| f64::from(i) / 100.0)
    }

    /// The largest jump of speed between neighbouring steps, as a share of the largest speed.
    fn roughness(at: impl Fn(f64) -> DVec3) -> f64 {
        let points: Vec<DVec3> = times().map(at).collect();
        let speeds: Vec<DVec3> = points.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let most = speeds.iter().map(|speed| speed.length()).fold(0.0, f64::max);
        speeds.windows(2).map(|pair| pair[0].distance(pair[1])).fold(0.0, f64::max) / most
    }

    #[test]
    fn a_leaf_passes_its_keys_never_overshoots_and_rests() {
        let depth = [(0.0, 5.0), (2.0, 0.0), (3.0, 1.0), (5.0, 1.0), (10.0, 4.0)];
        let track = keys(&depth);
        for (time, value) in depth {
            assert!((track.monotone(time) - value).abs() < 1e-12);
        }
        for pair in depth.windows(2) {
            let (low, high) = (pair[0].1.min(pair[1].1), pair[0].1.max(pair[1].1));
            for time in times().filter(|time| (pair[0].0..pair[1].0).contains(time)) {
                let value = track.monotone(time);
                assert!(value >= low - 1e-12 && value <= high + 1e-12, "{value} at {time}");
            }
        }
        assert_eq!((track.monotone(-1.0), track.monotone(20.0)), (5.0, 4.0));
        assert!(roughness(|time| DVec3::X * track.monotone(time)) < 0.05);
        // Two keys are a straight way.
        assert!((keys(&[(0.0, 1.0), (10.0, 3.0)]).monotone(2.5) - 1.5).abs() < 1e-12);
    }

    #[test]
    fn a_camera_rounds_its_corners_and_rests_in_a_pause() {
        let on_circle = |i: i32| {
            let (sin, cos) = (f64::from(i) * std::f64::consts::FRAC_PI_4).sin_cos();
            DVec3::new(cos, sin, 0.0)
        };
        let orbit = keys(&(0..=8).map(|i| (f64::from(i) * 1.25, on_circle(i))).collect::<Vec<_>>());
        for time in times() {
            let radius = orbit.round(time).length();
            assert!((radius - 1.0).abs() < 0.03, "{radius} at {time}");
        }
        assert!(roughness(|time| orbit.round(time)) < 0.05);
        let pause = keys(&[(0.0, DVec3::ZERO), (2.0, DVec3::X), (6.0, DVec3::X), (10.0, DVec3::new(1.0, 3.0, 0.0))]);
        for time in times().filter(|time| (2.0..6.0).contains(time)) {
            assert_eq!(pause.round(time), DVec3::X);
        }
        assert!(roughness(|time| pause.round(time)) < 0.05);
    }

    #[test]
    fn a_rotation_keeps_its_axis_and_its_speed_does_not_jump() {
        let turn = |degrees: f64| DQuat::from_rotation_z(degrees.to_radians());
        let track = keys(&[(0.0, turn(0.0)), (2.0, turn(120.0)), (6.0, turn(180.0)), (10.0, turn(300.0))]);
        for time in times() {
            let turned = track.slerp(time);
            assert!((turned * DVec3::Z - DVec3::Z).length() < 1e-12 && turned.is_normalized());
        }
        assert!(roughness(|time| track.slerp(time) * DVec3::X) < 0.05);
        assert!((track.slerp(6.0) * DVec3::X - DVec3::NEG_X).length() < 1e-12);
        assert_eq!(keys(&[(0.0, turn(40.0)), (1.0, turn(40.0))]).slerp(0.5), turn(40.0));
    }

    #[test]
    fn a_motion_takes_the_leaf_from_its_place_to_the_keyed_one() {
        let own = Placement {
            translate: DVec3::new(3.0, -1.0, 2.0),
            rotate: DQuat::from_rotation_x(0.4),
            scale: DVec3::new(1.0, 2.0, 0.5),
        };
        let there = Placement {
            translate: DVec3::new(0.0, 4.0, 1.0),
            rotate: DQuat::from_rotation_y(1.2),
            scale: own.scale * 3.0,
        };
        let leaf_keys = LeafKeys {
            leaf: LeafId(0),
            own,
            translate: Some(keys(&[(0.0, own.translate), (1.0, there.translate)])),
            rotate: Some(keys(&[(0.0, own.rotate), (1.0, there.rotate)])),
            growth: Some(keys(&[(0.0, 1.0), (1.0, 3.0)])),
        };
        assert_eq!(leaf_keys.motion(0.0), Motion::REST);
        let moved = leaf_keys.motion(1.0).affine() * own.world_from_leaf();
        assert!(moved.abs_diff_eq(there.world_from_leaf(), 1e-12));
        // Half way it is half as large again.
        assert!((leaf_keys.motion(0.5).scale - 2.0).abs() < 1e-12);
    }

    #[test]
    fn times_in_seconds_keep_the_length_and_times_in_frames_the_count() {
        let animation =
            |unit| Animation { unit, start: 1.0, end: 3.0, camera: CameraKeys::default(), leaves: Vec::new() };
        let (seconds, frames) = (animation(TimeUnit::Seconds), animation(TimeUnit::Frames));
        assert_eq!((seconds.frames(24.0), seconds.frames(12.0), frames.frames(24.0)), (49.0, 25.0, 3.0));
        assert_eq!((seconds.time_of(48, 24.0), frames.time_of(2, 24.0)), (3.0, 3.0));
    }
}
