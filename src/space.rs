//! Frames, the camera and the footprint of a pixel.
//!
//! Every spatial name in the crate says its space: `p_in_world`, `world_from_leaf`, `view_from_world`. Frames are
//! right-handed. Three spaces matter:
//!
//! * **leaf**: the coordinates of a leaf's file or solid;
//! * **world**: the scene, `world_from_leaf` is an affine map and may scale unevenly or mirror;
//! * **view**: `x` right, `y` *down* (as pixel rows run), `z` forward. View `z` is the planar depth of a layer.
//!
//! A pixel's ray is `origin + t · dir` with `dir · forward = 1`, so that `t` *is* the planar depth, in world units, for
//! perspective and orthographic cameras alike.

use glam::{DAffine3, DQuat, DVec2, DVec3};

/// How the view volume is projected to pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// `focal_px`: pixels per unit of tangent, `height / (2 tan(fov_y / 2))`.
    Perspective {
        /// Focal length in pixels.
        focal_px: f64,
    },
    /// `px_per_unit`: pixels per world unit at any depth.
    Orthographic {
        /// Pixels per world unit.
        px_per_unit: f64,
    },
}

/// Why a camera cannot be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A coordinate is NaN or infinite.
    #[error("the camera's {0} is not a finite number")]
    NotFinite(&'static str),
    /// `eye` and `target` coincide, so there is no direction to look in.
    #[error("the camera's eye and target are the same point: move one of them")]
    NoDirection,
    /// `up` is parallel to the view direction.
    #[error("the camera's up direction is parallel to its view direction: choose another up")]
    UpIsForward,
    /// The field of view is outside the open interval (0°, 180°).
    #[error("fov_y must lie between 0 and 180 degrees, not {0}")]
    FieldOfView(f64),
    /// The orthographic height is not positive.
    #[error("the orthographic height must be positive, not {0}")]
    Height(f64),
    /// A pixel would be smaller than what coordinates of this size can tell apart.
    #[error(
        "a zoom of {zoom:e} is more than {most:.0e}, where a pixel is as small as the rounding of coordinates: zoom less"
    )]
    Zoom {
        /// What was asked for.
        zoom: f64,
        /// The most.
        most: f64,
    },
    /// The picture has no pixels, or more than an image can hold.
    #[error("the picture's size must be 1 to {max} pixels a side, not {width}x{height}", max = Camera::MAX_SIDE)]
    Size {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
    },
}

/// What a user writes to place a camera: angles in degrees, lengths in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lens {
    /// Perspective with a vertical field of view in degrees.
    FovY(f64),
    /// Orthographic, the picture `height` world units tall.
    Height(f64),
}

/// A pinhole or orthographic camera with its picture size. Pixel (0, 0) is at the top left; pixel centres at +0.5.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Position in world space.
    pub eye: DVec3,
    /// Unit vector to the right of the picture, in world space.
    pub right: DVec3,
    /// Unit vector down the picture, in world space.
    pub down: DVec3,
    /// Unit view direction, in world space.
    pub forward: DVec3,
    /// Projection.
    pub projection: Projection,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
}

/// A ray in world space; `dir · camera.forward = 1`, so its parameter is planar depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where `t = 0`, in world space.
    pub origin: DVec3,
    /// Not of unit length: see the module's text.
    pub dir: DVec3,
}

impl Ray {
    /// The point at planar depth `t`, in world space.
    #[inline]
    pub fn at(&self, t: f64) -> DVec3 {
        self.origin + self.dir * t
    }
}

impl Camera {
    /// The longest side of a picture, in pixels: what a PNG viewer and 32-bit pixel indices still take.
    pub const MAX_SIDE: u32 = 32_768;

    /// A camera at `eye` that looks at `target`, both in world space.
    ///
    /// # Errors
    /// [`CameraError`] says which input is unusable.
    pub fn look_at(
        eye: DVec3,
        target: DVec3,
        up: DVec3,
        lens: Lens,
        width: u32,
        height: u32,
    ) -> Result<Self, CameraError> {
        for (v, name) in [(eye, "eye"), (target, "target"), (up, "up")] {
            if !v.is_finite() {
                return Err(CameraError::NotFinite(name));
            }
        }
        if !(1..=Self::MAX_SIDE).contains(&width) || !(1..=Self::MAX_SIDE).contains(&height) {
            return Err(CameraError::Size { width, height });
        }
        let forward = (target - eye).try_normalize().ok_or(CameraError::NoDirection)?;
        let up = up.try_normalize().ok_or(CameraError::UpIsForward)?;
        // An up vector within 1e-9 of the view direction leaves no significant digits in `right`.
        const LEAST_SINE: f64 = 1e-9;
        let across = forward.cross(up);
        if !(across.length() > LEAST_SINE) {
            return Err(CameraError::UpIsForward);
        }
        let right = across.normalize();
        let projection = match lens {
            Lens::FovY(degrees) => {
                if !(degrees > 0.0 && degrees < 180.0) {
                    return Err(CameraError::FieldOfView(degrees));
                }
                Projection::Perspective { focal_px: 0.5 * f64::from(height) / (0.5 * degrees.to_radians()).tan() }
            }
            Lens::Height(units) => {
                if !(units > 0.0 && units.is_finite()) {
                    return Err(CameraError::Height(units));
                }
                Projection::Orthographic { px_per_unit: f64::from(height) / units }
            }
        };
        Ok(Self { eye, right, down: forward.cross(right), forward, projection, width, height })
    }

    /// The ray through picture position `px` (pixel units, (0, 0) the picture's top left corner).
    #[inline]
    pub fn ray(&self, px: DVec2) -> Ray {
        let across = px.x - 0.5 * f64::from(self.width);
        let along = px.y - 0.5 * f64::from(self.height);
        match self.projection {
            Projection::Perspective { focal_px } => Ray {
                origin: self.eye,
                dir: self.forward + self.right * (across / focal_px) + self.down * (along / focal_px),
            },
            Projection::Orthographic { px_per_unit } => Ray {
                origin: self.eye + self.right * (across / px_per_unit) + self.down * (along / px_per_unit),
                dir: self.forward,
            },
        }
    }

    /// `p_in_world` in view space: right, down, forward (planar depth), in world units.
    #[inline]
    pub fn view_from_world(&self, p_in_world: DVec3) -> DVec3 {
        self.rotate_to_view(p_in_world - self.eye)
    }

    /// A direction of world space in view space.
    #[inline]
    pub fn rotate_to_view(&self, v_in_world: DVec3) -> DVec3 {
        DVec3::new(v_in_world.dot(self.right), v_in_world.dot(self.down), v_in_world.dot(self.forward))
    }

    /// A direction of view space in world space.
    #[inline]
    pub fn rotate_to_world(&self, v_in_view: DVec3) -> DVec3 {
        self.right * v_in_view.x + self.down * v_in_view.y + self.forward * v_in_view.z
    }

    /// Picture position in pixels of a point in view space. Meaningless at depth ≤ 0 of a perspective camera.
    #[inline]
    pub fn px_from_view(&self, p_in_view: DVec3) -> DVec2 {
        let scale = 1.0 / self.footprint(p_in_view.z);
        DVec2::new(
            p_in_view.x * scale + 0.5 * f64::from(self.width),
            p_in_view.y * scale + 0.5 * f64::from(self.height),
        )
    }

    /// The footprint: world size of one pixel at planar depth `depth`.
    #[inline]
    pub fn footprint(&self, depth: f64) -> f64 {
        match self.projection {
            Projection::Perspective { focal_px } => depth / focal_px,
            Projection::Orthographic { px_per_unit } => 1.0 / px_per_unit,
        }
    }

    /// The same camera turned to `target_in_world` and magnified by `zoom` (the eye does not move; an orthographic
    /// camera slides sideways instead of turning).
    ///
    /// # Errors
    /// As [`Camera::look_at`]; and [`CameraError::Zoom`] where a pixel at the target would be smaller than the rounding of
    /// its coordinates.
    pub fn zoomed(&self, target_in_world: DVec3, zoom: f64) -> Result<Self, CameraError> {
        if !(zoom > 0.0 && zoom.is_finite()) {
            return Err(CameraError::NotFinite("zoom"));
        }
        // A few roundings, of the target or of the way to it, to a pixel.
        const ROUNDINGS: f64 = 4.0;
        let depth = self.view_from_world(target_in_world).z;
        let largest = target_in_world.abs().max(self.eye.abs()).max_element().max(depth.abs());
        let most = self.footprint(depth.abs()) / (ROUNDINGS * f64::EPSILON * largest);
        if zoom > most.max(1.0) {
            return Err(CameraError::Zoom { zoom, most: most.max(1.0) });
        }
        match self.projection {
            Projection::Perspective { focal_px } => {
                let any_lens = Lens::FovY(40.0); // replaced below: the focal length is the old one, magnified
                let mut camera =
                    Self::look_at(self.eye, target_in_world, -self.down, any_lens, self.width, self.height)?;
                camera.projection = Projection::Perspective { focal_px: focal_px * zoom };
                Ok(camera)
            }
            Projection::Orthographic { px_per_unit } => {
                let aside = self.view_from_world(target_in_world);
                let eye = self.eye + self.right * aside.x + self.down * aside.y;
                Ok(Self {
                    eye,
                    projection: Projection::Orthographic { px_per_unit: px_per_unit * zoom },
                    ..self.clone()
                })
            }
        }
    }
}

/// A turn, an even scale and a shift of world space: what moves a thing and keeps its shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// The factor of lengths, positive.
    pub scale: f64,
    /// A unit quaternion.
    pub rotation: DQuat,
    /// After both.
    pub translation: DVec3,
}

impl Motion {
    /// No motion.
    pub const REST: Self = Self { scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// Where a point goes, world space.
    #[inline]
    pub fn point(&self, p_in_world: DVec3) -> DVec3 {
        self.vector(p_in_world) + self.translation
    }

    /// What becomes of the difference of two points.
    #[inline]
    pub fn vector(&self, v_in_world: DVec3) -> DVec3 {
        self.rotation * v_in_world * self.scale
    }

    /// The map.
    pub fn affine(&self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(DVec3::splat(self.scale), self.rotation, self.translation)
    }
}

/// A rectangle of pixels: `x0..x1` by `y0..y1`, upper bounds excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelRect {
    /// First column.
    pub x0: u32,
    /// First row.
    pub y0: u32,
    /// One past the last column.
    pub x1: u32,
    /// One past the last row.
    pub y1: u32,
}

impl PixelRect {
    /// Columns.
    pub fn width(&self) -> u32 {
        self.x1 - self.x0
    }
    /// Rows.
    pub fn height(&self) -> u32 {
        self.y1 - self.y0
    }
    /// Pixels.
    pub fn area(&self) -> usize {
        self.width() as usize * self.height() as usize
    }

    /// The tiles of `side` pixels that cover a `width` × `height` picture, row by row; border tiles are smaller.
    pub fn tiles(width: u32, height: u32, side: u32) -> Vec<Self> {
        let mut tiles = Vec::new();
        for y0 in (0..height).step_by(side as usize) {
            for x0 in (0..width).step_by(side as usize) {
                tiles.push(Self { x0, y0, x1: (x0 + side).min(width), y1: (y0 + side).min(height) });
            }
        }
        tiles
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(lens: Lens) -> Camera {
        Camera::look_at(DVec3::new(3.0, -2.0, 1.0), DVec3::ZERO, DVec3::Z, lens, 64, 48).unwrap()
    }

    #[test]
    fn a_ray_passes_through_what_projects_onto_its_pixel() {
        for lens in [Lens::FovY(40.0), Lens::Height(2.0)] {
            let camera = camera(lens);
            for p in [DVec3::new(0.1, 0.2, 0.3), DVec3::new(-0.3, 0.0, -0.2)] {
                let in_view = camera.view_from_world(p);
                let ray = camera.ray(camera.px_from_view(in_view));
                assert!((ray.at(in_view.z) - p).length() < 1e-12);
                assert!((ray.dir.dot(camera.forward) - 1.0).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn view_axes_are_right_handed_and_up_is_up() {
        let camera = camera(Lens::FovY(40.0));
        assert!((camera.right.cross(camera.down) - camera.forward).length() < 1e-12);
        assert!(camera.down.z < 0.0);
    }

    #[test]
    fn zoom_puts_the_target_in_the_middle_and_magnifies() {
        for lens in [Lens::FovY(40.0), Lens::Height(2.0)] {
            let camera = camera(lens);
            let target = DVec3::new(0.2, 0.1, 0.1);
            let near = camera.zoomed(target, 10.0).unwrap();
            let px = near.px_from_view(near.view_from_world(target));
            assert!((px - DVec2::new(32.0, 24.0)).length() < 1e-9);
            let depth = near.view_from_world(target).z;
            assert!((camera.footprint(depth) / near.footprint(depth) - 10.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_zoom_beyond_the_numbers_is_refused() {
        for lens in [Lens::FovY(40.0), Lens::Height(2.0)] {
            let camera = camera(lens);
            camera.zoomed(DVec3::ZERO, 1e9).unwrap();
            let Err(CameraError::Zoom { most, .. }) = camera.zoomed(DVec3::ZERO, 1e30) else { panic!("{lens:?}") };
            // A pixel is about 0.05 wide at a distance of 3.7; coordinates of 3 round by 4e-16.
            assert!(most > 1e12 && most < 1e15, "{most}");
            camera.zoomed(DVec3::ZERO, most).unwrap();
        }
    }

    #[test]
    fn unusable_cameras_are_refused_by_name() {
        let look = |eye, up, lens, w| Camera::look_at(eye, DVec3::ZERO, up, lens, w, 8);
        let nan = DVec3::new(f64::NAN, 0.0, 0.0);
        assert_eq!(look(nan, DVec3::Z, Lens::FovY(40.0), 8), Err(CameraError::NotFinite("eye")));
        assert_eq!(look(DVec3::ZERO, DVec3::Z, Lens::FovY(40.0), 8), Err(CameraError::NoDirection));
        assert_eq!(look(DVec3::Z, DVec3::Z, Lens::FovY(40.0), 8), Err(CameraError::UpIsForward));
        assert!(matches!(look(DVec3::X, DVec3::Z, Lens::FovY(f64::NAN), 8), Err(CameraError::FieldOfView(_))));
        assert!(matches!(look(DVec3::X, DVec3::Z, Lens::Height(0.0), 8), Err(CameraError::Height(_))));
        assert!(matches!(look(DVec3::X, DVec3::Z, Lens::FovY(40.0), 0), Err(CameraError::Size { .. })));
    }

    #[test]
    fn tiles_cover_every_pixel_once() {
        let tiles = PixelRect::tiles(130, 70, 64);
        assert_eq!(tiles.iter().map(PixelRect::area).sum::<usize>(), 130 * 70);
    }
}
