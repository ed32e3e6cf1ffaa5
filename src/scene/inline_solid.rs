//! Analytic solids as users write them: as TOML tables and as `kind:numbers` on the command line.

use glam::DVec3;

use super::toml_file::{SceneError, SceneProblem};
use super::toml_values::Field;
use crate::geometry::Solid;
use crate::geometry::solid::Ball;
pub use crate::geometry::solid::SolidError;

/// The TOML keys of solids. The command line writes `half-space`; otherwise the names are the same.
pub const SOLID_KEYS: [&str; 7] = ["half_space", "box", "sphere", "cylinder", "cone", "torus", "blend"];

/// The extent of a half-space whose author gave none: [`load`](crate::scene::load()) replaces it by one that reaches
/// past everything else in the scene.
pub const EXTENT_OF_THE_SCENE: f64 = f64::INFINITY;

/// The solid in `field`, whose name is one of [`SOLID_KEYS`].
pub(super) fn from_toml(field: &Field) -> Result<Solid, SceneError> {
    let key = field.name.as_str();
    let open = |known: &[&str], form: &str| field.table(format!("`{key}`"), known, form);
    let point = "[x, y, z]";
    let length = "a length";
    let solid = match key {
        "half_space" => {
            let table = open(&["point", "normal", "extent"], "{ point = [x, y, z], normal = [x, y, z] }")?;
            Solid::HalfSpace {
                point: table.require("point", point)?.vector()?,
                normal: table.require("normal", "[x, y, z], pointing out of the material")?.direction()?,
                extent: table.get("extent")?.map_or(Ok(EXTENT_OF_THE_SCENE), |extent| extent.positive())?,
            }
        }
        "box" => {
            let form = "{ min = [x, y, z], max = [x, y, z] } or { centre = [x, y, z], size = [x, y, z] }";
            let table = open(&["min", "max", "centre|center", "size"], form)?;
            match (table.get("min")?, table.get("centre|center")?) {
                (Some(min), Some(centre)) => {
                    return Err(centre.error(SceneProblem::Clash { first: min.name, second: centre.name.clone() }));
                }
                (None, Some(centre)) => {
                    if let Some(max) = table.get("max")? {
                        return Err(max.error(SceneProblem::Clash { first: centre.name, second: max.name.clone() }));
                    }
                    let centre = centre.vector()?;
                    let size = table.require("size", "[x, y, z] or a length")?;
                    let half = 0.5 * if size.is_number() { DVec3::splat(size.positive()?) } else { size.vector()? };
                    Solid::Box { min: centre - half, max: centre + half }
                }
                _ => {
                    if let Some(size) = table.get("size")? {
                        let mend = "write min and max, or centre and size";
                        return Err(size.bad("a size goes with a centre", mend));
                    }
                    Solid::Box {
                        min: table.require("min", point)?.vector()?,
                        max: table.require("max", point)?.vector()?,
                    }
                }
            }
        }
        "sphere" => {
            let table = open(&["centre|center", "radius"], "{ centre = [x, y, z], radius = r }")?;
            Solid::Sphere {
                centre: table.require("centre|center", point)?.vector()?,
                radius: table.require("radius", length)?.positive()?,
            }
        }
        "cylinder" => {
            let table = open(&["from", "to", "radius"], "{ from = [x, y, z], to = [x, y, z], radius = r }")?;
            Solid::Cylinder {
                from: table.require("from", point)?.vector()?,
                to: table.require("to", point)?.vector()?,
                radius: table.require("radius", length)?.positive()?,
            }
        }
        "cone" => {
            let form = "{ from = [x, y, z], to = [x, y, z], radius_from = r, radius_to = r }";
            let table = open(&["from", "to", "radius_from", "radius_to"], form)?;
            Solid::Cone {
                from: table.require("from", point)?.vector()?,
                to: table.require("to", point)?.vector()?,
                radius_from: table.require("radius_from", length)?.number()?,
                radius_to: table.require("radius_to", length)?.number()?,
            }
        }
        "torus" => {
            let form = "{ centre = [x, y, z], axis = [x, y, z], radius = r, tube = r }";
            let table = open(&["centre|center", "axis", "radius", "tube"], form)?;
            Solid::Torus {
                centre: table.require("centre|center", point)?.vector()?,
                axis: table.require("axis", point)?.direction()?,
                radius: table.require("radius", length)?.positive()?,
                tube: table.require("tube", length)?.positive()?,
            }
        }
        _ => {
            let table = open(&["balls", "smoothness"], "{ balls = [[x, y, z, r], …], smoothness = k }")?;
            let form = "[[x, y, z, r], …]";
            let mut balls = Vec::new();
            for ball in table.require("balls", form)?.list(form)? {
                let [x, y, z, radius] = ball.numbers::<4>("[x, y, z, r]")?;
                balls.push(Ball { centre: DVec3::new(x, y, z), radius });
            }
            Solid::Blend { balls, smoothness: table.require("smoothness", length)?.positive()? }
        }
    };
    match validate(&solid) {
        Ok(()) => Ok(solid),
        Err(error) => Err(field.error(SceneProblem::Solid { key: key.to_owned(), error })),
    }
}

/// [`Solid::validate`], but an extent that is still to be found is no mistake.
pub(super) fn validate(solid: &Solid) -> Result<(), SolidError> {
    match solid {
        Solid::HalfSpace { point, normal, extent } if *extent == EXTENT_OF_THE_SCENE => {
            Solid::HalfSpace { point: *point, normal: *normal, extent: 1.0 }.validate()
        }
        _ => solid.validate(),
    }
}

/// Why `kind:numbers` is no solid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InlineSolidError {
    /// Not a number between two commas.
    #[error("`{entry}` in `{text}` is not a finite number: write {form}")]
    Number {
        /// The whole argument.
        text: String,
        /// What stands between the commas.
        entry: String,
        /// What to write.
        form: &'static str,
    },
    /// Another count of numbers than the kind needs.
    #[error("`{text}` has {found} numbers: write {form}")]
    Count {
        /// The whole argument.
        text: String,
        /// Numbers found.
        found: usize,
        /// What to write.
        form: &'static str,
    },
    /// A direction of length zero.
    #[error("`{text}` has a direction of length 0: write {form}")]
    Direction {
        /// The whole argument.
        text: String,
        /// What to write.
        form: &'static str,
    },
    /// No such solid exists.
    #[error("`{text}`: {error}")]
    Solid {
        /// The whole argument.
        text: String,
        /// What is wrong with it.
        error: SolidError,
    },
}

/// How each kind is written on the command line, for messages and help.
pub const INLINE_FORMS: [(&str, &str); 7] = [
    ("sphere", "sphere:x,y,z,radius"),
    ("box", "box:x0,y0,z0,x1,y1,z1"),
    ("cylinder", "cylinder:x0,y0,z0,x1,y1,z1,radius"),
    ("cone", "cone:x0,y0,z0,x1,y1,z1,radius0,radius1"),
    ("torus", "torus:x,y,z,axis-x,axis-y,axis-z,radius,tube"),
    ("half-space", "half-space:x,y,z,normal-x,normal-y,normal-z (and, if you like, its extent)"),
    ("blend", "blend:smoothness,x,y,z,radius,… (four numbers a ball)"),
];

/// The solid that `text` writes as `kind:numbers`; `None` where it begins with no kind, so that it names a file.
///
/// # Errors
/// [`InlineSolidError`] where the kind is known and the numbers do not make one.
pub fn from_text(text: &str) -> Option<Result<Solid, InlineSolidError>> {
    let (kind, numbers) = text.split_once(':')?;
    let (kind, form) = *INLINE_FORMS.iter().find(|(known, _)| *known == kind.replace('_', "-"))?;
    Some(from_numbers(text, kind, form, numbers))
}

fn from_numbers(text: &str, kind: &str, form: &'static str, numbers: &str) -> Result<Solid, InlineSolidError> {
    let mut values = Vec::new();
    for entry in numbers.split(',') {
        match entry.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => values.push(value),
            _ => return Err(InlineSolidError::Number { text: text.into(), entry: entry.into(), form }),
        }
    }
    let v = DVec3::new;
    let unit = |direction: DVec3| {
        direction.try_normalize().ok_or_else(|| InlineSolidError::Direction { text: text.into(), form })
    };
    let solid = match (kind, &values[..]) {
        ("sphere", &[x, y, z, radius]) => Solid::Sphere { centre: v(x, y, z), radius },
        ("box", &[x0, y0, z0, x1, y1, z1]) => Solid::Box { min: v(x0, y0, z0), max: v(x1, y1, z1) },
        ("cylinder", &[x0, y0, z0, x1, y1, z1, radius]) => {
            Solid::Cylinder { from: v(x0, y0, z0), to: v(x1, y1, z1), radius }
        }
        ("cone", &[x0, y0, z0, x1, y1, z1, radius_from, radius_to]) => {
            Solid::Cone { from: v(x0, y0, z0), to: v(x1, y1, z1), radius_from, radius_to }
        }
        ("torus", &[x, y, z, ax, ay, az, radius, tube]) => {
            Solid::Torus { centre: v(x, y, z), axis: unit(v(ax, ay, az))?, radius, tube }
        }
        ("half-space", &[x, y, z, nx, ny, nz]) => {
            Solid::HalfSpace { point: v(x, y, z), normal: unit(v(nx, ny, nz))?, extent: EXTENT_OF_THE_SCENE }
        }
        ("half-space", &[x, y, z, nx, ny, nz, extent]) => {
            Solid::HalfSpace { point: v(x, y, z), normal: unit(v(nx, ny, nz))?, extent }
        }
        ("blend", [smoothness, balls @ ..]) if !balls.is_empty() && balls.len() % 4 == 0 => Solid::Blend {
            balls: balls.chunks_exact(4).map(|b| Ball { centre: v(b[0], b[1], b[2]), radius: b[3] }).collect(),
            smoothness: *smoothness,
        },
        _ => return Err(InlineSolidError::Count { text: text.into(), found: values.len(), form }),
    };
    match validate(&solid) {
        Ok(()) => Ok(solid),
        Err(error) => Err(InlineSolidError::Solid { text: text.into(), error }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_is_read_from_the_command_line() {
        let solid = |text: &str| from_text(text).unwrap().unwrap();
        assert_eq!(solid("sphere:1,2,3,0.5"), Solid::Sphere { centre: DVec3::new(1.0, 2.0, 3.0), radius: 0.5 });
        assert!(matches!(solid("box:0,0,0,1,1,1"), Solid::Box { .. }));
        assert!(matches!(solid("cylinder:0,0,0,0,0,1,.25"), Solid::Cylinder { radius: 0.25, .. }));
        assert!(matches!(solid("cone:0,0,0,0,0,1,1,0"), Solid::Cone { radius_to: 0.0, .. }));
        assert!(matches!(solid("torus:0,0,0,0,0,2,1,.2"), Solid::Torus { axis: DVec3::Z, .. }));
        assert!(matches!(solid("half_space:0,0,0,0,0,9"), Solid::HalfSpace { normal: DVec3::Z, .. }));
        assert!(matches!(solid("half-space:0,0,0,0,0,1,7"), Solid::HalfSpace { extent: 7.0, .. }));
        let Solid::Blend { balls, smoothness } = solid("blend:0.1,0,0,0,1,1,0,0,.5") else { panic!("no blend") };
        assert_eq!((balls.len(), smoothness), (2, 0.1));
    }

    #[test]
    fn files_are_not_taken_for_solids_and_mistakes_show_the_form() {
        assert!(from_text("sphere.ply").is_none());
        assert!(from_text("C:\\scans\\a.ply").is_none());
        let error = |text: &str| from_text(text).unwrap().unwrap_err();
        assert!(matches!(error("sphere:1,2,x,1"), InlineSolidError::Number { entry, .. } if entry == "x"));
        assert!(matches!(error("sphere:1,2,nan,1"), InlineSolidError::Number { .. }));
        assert!(matches!(error("sphere:1,2,3"), InlineSolidError::Count { found: 3, .. }));
        assert!(matches!(error("sphere:1,2,3,-1"), InlineSolidError::Solid { .. }));
        assert!(matches!(error("torus:0,0,0,0,0,0,1,.2"), InlineSolidError::Direction { .. }));
        assert!(error("sphere:1,2").to_string().contains("sphere:x,y,z,radius"));
    }
}
