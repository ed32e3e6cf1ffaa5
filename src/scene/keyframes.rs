//! `[[keyframe]]` tables: where a scene file says how the camera and the leaves move.

use std::collections::BTreeMap;

use super::Leaf;
use super::animation::{Animation, CameraKeys, Keys, LeafKeys, Placement, TimeUnit};
use super::nearest_name::nearest_name;
use super::toml_file::{SceneError, SceneProblem, parse_rotate, parse_scale, quoted};
use super::toml_values::{Field, Table};
use crate::csg::LeafId;

/// A keyframe's `scale` is a multiple of its leaf's own up to this share: more would change the leaf's shape.
const SAME_SHAPE: f64 = 1e-9;

/// The keys of one leaf so far.
#[derive(Default)]
struct LeafTracks {
    translate: Vec<(f64, glam::DVec3)>,
    rotate: Vec<(f64, glam::DQuat)>,
    growth: Vec<(f64, f64)>,
}

/// The keys of the camera so far.
#[derive(Default)]
struct CameraTracks {
    eye: Vec<(f64, glam::DVec3)>,
    target: Vec<(f64, glam::DVec3)>,
    up: Vec<(f64, glam::DVec3)>,
    fov_y: Vec<(f64, f64)>,
    height: Vec<(f64, f64)>,
}

/// The animation in the list `field`, over `leaves` with their `placements` (`None` where a leaf has a matrix).
pub(super) fn parse(field: &Field, leaves: &[Leaf], placements: &[Option<Placement>]) -> Result<Animation, SceneError> {
    let frames = field.list("tables headed `[[keyframe]]`")?;
    if frames.len() < 2 {
        return Err(field.bad("there is only one", "write two or more, or remove it"));
    }
    let mut camera = CameraTracks::default();
    let mut tracks: BTreeMap<usize, LeafTracks> = BTreeMap::new();
    let mut times: Vec<(TimeUnit, f64)> = Vec::new();
    for frame in &frames {
        let table = frame.table("[[keyframe]]", &["time", "frame", "camera", "leaf"], "a table with `time`")?;
        let (unit, when) = when(&table)?;
        let time = when.number()?;
        match times.last() {
            Some((other, _)) if *other != unit => {
                return Err(when.bad("other keyframes count otherwise", "give all of them `time`, or all `frame`"));
            }
            Some((_, before)) if !(time > *before) => {
                let mend = "give keyframes in the order of their times, each its own";
                return Err(when.bad(format!("{time} is not after {before}"), mend));
            }
            _ => times.push((unit, time)),
        }
        if let Some(field) = table.get("camera")? {
            camera.add(time, &field)?;
        }
        if let Some(field) = table.get("leaf")? {
            for (name, entry) in field.named_entries("tables such as `leaf.drill = { translate = [0, 0, 1] }`")? {
                let index =
                    leaves.iter().position(|leaf| leaf.name == name).ok_or_else(|| unknown(&entry, name, leaves))?;
                let Some(own) = &placements[index] else {
                    let mend = "write its own transform as `translate`, `rotate` and `scale`";
                    return Err(entry.bad("the leaf has a `matrix`, between which and keys nothing goes", mend));
                };
                tracks.entry(index).or_default().add(time, &entry, own)?;
            }
        }
    }
    let (unit, start) = times[0];
    let leaves = tracks.into_iter().filter_map(|(index, tracks)| {
        let own = placements[index]?;
        Some(LeafKeys {
            leaf: LeafId(index as u32),
            own,
            translate: Keys::new(tracks.translate).map(|keys| keys.beginning(start, own.translate)),
            rotate: Keys::new(tracks.rotate).map(|keys| keys.beginning(start, own.rotate)),
            growth: Keys::new(tracks.growth).map(|keys| keys.beginning(start, 1.0)),
        })
    });
    let leaves = leaves.collect();
    let end = times[times.len() - 1].1;
    Ok(Animation { unit, start, end, camera: camera.finish(), leaves })
}

fn when<'t>(table: &Table<'t>) -> Result<(TimeUnit, Field<'t>), SceneError> {
    match (table.get("time")?, table.get("frame")?) {
        (Some(time), Some(frame)) => {
            Err(frame.error(SceneProblem::Clash { first: time.name, second: frame.name.clone() }))
        }
        (Some(time), None) => Ok((TimeUnit::Seconds, time)),
        (None, Some(frame)) => Ok((TimeUnit::Frames, frame)),
        (None, None) => Ok((TimeUnit::Seconds, table.require("time", "seconds")?)),
    }
}

fn unknown(entry: &Field, name: &str, leaves: &[Leaf]) -> SceneError {
    let known = leaves.iter().map(|leaf| leaf.name.as_str());
    entry.error(SceneProblem::UnknownLeaf {
        name: name.to_owned(),
        suggestion: nearest_name(name, known.clone()).map(str::to_owned),
        known: known.map(str::to_owned).collect(),
    })
}

impl LeafTracks {
    fn add(&mut self, time: f64, entry: &Field, own: &Placement) -> Result<(), SceneError> {
        let name = format!("`leaf.{}`", quoted(&entry.name));
        let table =
            entry.table(name, &["translate", "rotate", "scale"], "a table such as { translate = [0, 0, 1] }")?;
        if let Some(field) = table.get("translate")? {
            self.translate.push((time, field.vector()?));
        }
        if let Some(field) = table.get("rotate")? {
            self.rotate.push((time, parse_rotate(&field)?));
        }
        if let Some(field) = table.get("scale")? {
            let growth = parse_scale(&field)? / own.scale;
            let is_even = (growth - growth.x).abs().max_element() <= SAME_SHAPE * growth.x.abs();
            if !(growth.x > 0.0 && is_even) {
                let mend = "make it a positive multiple of the leaf's own `scale`, as a moving leaf keeps its shape";
                return Err(field.bad("it would change the leaf's shape", mend));
            }
            self.growth.push((time, growth.x));
        }
        Ok(())
    }
}

impl CameraTracks {
    fn add(&mut self, time: f64, field: &Field) -> Result<(), SceneError> {
        let known = ["eye", "target", "up", "fov_y", "height"];
        let table = field.table("`camera`", &known, "a table such as { eye = [0, -9, 3] }")?;
        for (key, track) in [("eye", &mut self.eye), ("target", &mut self.target), ("up", &mut self.up)] {
            if let Some(field) = table.get(key)? {
                track.push((time, field.vector()?));
            }
        }
        for (key, track) in [("fov_y", &mut self.fov_y), ("height", &mut self.height)] {
            if let Some(field) = table.get(key)? {
                track.push((time, field.positive()?));
            }
        }
        if !self.fov_y.is_empty() && !self.height.is_empty() {
            let clash = SceneProblem::Clash { first: "fov_y".into(), second: "height".into() };
            return Err(field.error(clash));
        }
        Ok(())
    }

    fn finish(self) -> CameraKeys {
        CameraKeys {
            eye: Keys::new(self.eye),
            target: Keys::new(self.target),
            up: Keys::new(self.up),
            fov_y: Keys::new(self.fov_y),
            height: Keys::new(self.height),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use glam::DVec3;

    use super::super::toml_file;
    use super::*;
    use crate::space::Lens;

    const HEAD: &str = "csg = 'a - b'\n[leaf.a]\nsphere = { centre = [0, 0, 0], radius = 1 }\n\
        [leaf.b]\nsphere = { centre = [1, 0, 0], radius = 1 }\ntranslate = [0, 0, 1]\nscale = 2\n";

    fn parsed(text: &str) -> Result<Animation, SceneError> {
        toml_file::parse(&format!("{HEAD}{text}"), Path::new("")).map(|scene| scene.animation.unwrap())
    }

    #[test]
    fn every_quantity_has_its_own_keys() {
        let animation = parsed(
            "[[keyframe]]\ntime = 1\nleaf.b.translate = [0, 0, 3]\ncamera = { eye = [9, 0, 0] }\n\
             [[keyframe]]\ntime = 2\ncamera = { height = 4 }\n\
             [[keyframe]]\ntime = 5\ncamera = { eye = [0, 9, 0] }\nleaf.b = { translate = [0, 0, 7], scale = [4, 4, 4] }\n",
        )
        .unwrap();
        assert_eq!((animation.start, animation.end, animation.frames(10.0)), (1.0, 5.0, 41.0));
        assert!(animation.moves(LeafId(1)) && !animation.moves(LeafId(0)));
        let keys = &animation.leaves[0];
        assert_eq!(keys.translate.as_ref().unwrap().keys().len(), 2);
        assert_eq!(keys.growth.as_ref().unwrap().keys(), [(1.0, 1.0), (5.0, 2.0)]);
        assert!(keys.rotate.is_none());
        let own =
            crate::scene::CameraSpec { eye: DVec3::ONE, target: DVec3::ZERO, up: DVec3::Z, lens: Lens::FovY(30.0) };
        // What has no key at the start begins as the scene has it; a lens of the other kind cannot.
        let at = animation.camera_at(own, 1.0);
        assert_eq!((at.eye, at.target, at.lens), (DVec3::new(9.0, 0.0, 0.0), DVec3::ZERO, Lens::Height(4.0)));
    }

    #[test]
    fn the_first_keyframe_is_the_scene_as_it_is() {
        let animation = parsed(
            "[[keyframe]]\ntime = 0\n[[keyframe]]\ntime = 2\nleaf.b.translate = [0, 0, 5]\ncamera = { eye = [4, 0, 0], fov_y = 40 }\n",
        )
        .unwrap();
        let own = crate::scene::CameraSpec { eye: DVec3::Y, target: DVec3::ZERO, up: DVec3::Z, lens: Lens::FovY(20.0) };
        assert_eq!(animation.camera_at(own, 0.0), own);
        assert_eq!(animation.camera_at(own, 1.0).lens, Lens::FovY(30.0));
        assert_eq!(animation.camera_at(own, 2.0).eye, DVec3::new(4.0, 0.0, 0.0));
        assert_eq!(animation.motion(LeafId(1), 1.0).translation, DVec3::new(0.0, 0.0, 2.0));
        assert_eq!(animation.motion(LeafId(0), 1.0), crate::space::Motion::REST);
    }

    #[test]
    fn mistakes_are_told_with_their_place() {
        for (text, part) in [
            ("[[keyframe]]\ntime = 1\n", "two or more"),
            ("[[keyframe]]\ntime = 1\n[[keyframe]]\ntime = 1\n", "1 is not after 1"),
            ("[[keyframe]]\ntime = 1\n[[keyframe]]\nframe = 2\n", "all `frame`"),
            ("[[keyframe]]\ntime = 1\n[[keyframe]]\n", "lacks `time`"),
            ("[[keyframe]]\ntime = 1\nleaf.bb.translate = [0, 0, 0]\n[[keyframe]]\ntime = 2\n", "did you mean `b`"),
            ("[[keyframe]]\ntime = 1\nleaf.b.scale = [2, 2, 3]\n[[keyframe]]\ntime = 2\n", "change the leaf's shape"),
            ("[[keyframe]]\ntime = 1\nleaf.b.scale = -2\n[[keyframe]]\ntime = 2\n", "change the leaf's shape"),
            (
                "[[keyframe]]\ntime = 1\ncamera.fov_y = 3\n[[keyframe]]\ntime = 2\ncamera.height = 3\n",
                "cannot stand together",
            ),
        ] {
            let error = parsed(text).unwrap_err();
            assert!(error.to_string().contains(part), "{error}");
            assert!(error.place.line >= 8, "{error}");
        }
    }
}
