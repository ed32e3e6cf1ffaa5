//! Gaussian splats (3DGS and 2DGS layouts) as oriented ellipses.
//!
//! # Theory
//! Kerbl et al. 2023, "3D Gaussian Splatting", stores per Gaussian the *logarithms* of the three standard deviations
//! (`scale_0..2`), a quaternion w x y z (`rot_0..3`, not normalised), the *logit* of the opacity, and the colour as spherical
//! harmonics, of which degree 0 is the constant term: colour = ½ + Y₀·f_dc with Y₀ = ½√(1/π). Huang et al. 2024, "2D
//! Gaussian Splatting", has two scales: the third axis is the normal.
//!
//! # Practice
//! A Gaussian that represents a surface is flat: its least axis is the normal, the other two span the ellipse. The ellipse's
//! semi-axes are one standard deviation long. The normal's sign is arbitrary, so a note says that such a cloud is unoriented.
//! An opacity logit of ±∞ is an opacity of 1 or 0, which other formats' decoders do write; a scale of −∞ is flat.

use glam::{DMat3, DQuat, Vec3};

use super::Wanted;
use crate::formats::gather::Gather;
use crate::geometry::Ellipse;

/// Y₀, the constant spherical harmonic: ½√(1/π).
const CONSTANT_HARMONIC: f64 = 0.5 * std::f64::consts::FRAC_2_SQRT_PI * 0.5;

/// Where the values of a splat are in a row.
pub struct Splats {
    scales: [usize; 2],
    third_scale: Option<usize>,
    rotation: [usize; 4],
    opacity: Option<usize>,
    colour: Option<[usize; 3]>,
}

/// One splat; vectors in leaf space.
pub struct Splat {
    normal: Vec3,
    ellipse: Ellipse,
    opacity: f32,
    colour: [f32; 3],
}

impl Default for Splat {
    fn default() -> Self {
        let ellipse = Ellipse { axis_u: Vec3::X, axis_v: Vec3::Y };
        Self { normal: Vec3::Z, ellipse, opacity: 0.0, colour: [0.0; 3] }
    }
}

impl Splats {
    /// The splat properties of an element, if it has at least scales and rotations.
    pub fn find(wanted: &mut Wanted, has_colour: bool) -> Option<Self> {
        const ROTATION: [&str; 4] = ["rot_0", "rot_1", "rot_2", "rot_3"];
        if !ROTATION.iter().all(|name| wanted.has(name)) {
            return None;
        }
        let scales = wanted.take_all(["scale_0", "scale_1"])?;
        Some(Self {
            scales,
            third_scale: wanted.take("scale_2"),
            rotation: wanted.take_all(ROTATION)?,
            opacity: wanted.take("opacity"),
            colour: if has_colour { None } else { wanted.take_all(["f_dc_0", "f_dc_1", "f_dc_2"]) },
        })
    }

    pub fn has_colour(&self) -> bool {
        self.colour.is_some()
    }

    pub fn has_opacity(&self) -> bool {
        self.opacity.is_some()
    }

    /// The splat of a row, or what is wrong with it.
    pub fn decode(&self, values: &[f64]) -> Result<Splat, String> {
        let logs = [Some(self.scales[0]), Some(self.scales[1]), self.third_scale];
        let deviations = logs.map(|slot| slot.map_or(0.0, |slot| values[slot].exp()));
        for (axis, (deviation, slot)) in deviations.iter().zip(logs).enumerate() {
            if !deviation.is_finite() {
                return Err(format!("scale_{axis} is {}", slot.map_or(f64::NAN, |slot| values[slot])));
            }
        }
        let [w, x, y, z] = self.rotation.map(|slot| values[slot]);
        let rotation = DQuat::from_xyzw(x, y, z, w);
        let length = rotation.length();
        if !(length > 0.0 && length.is_finite()) {
            return Err(format!("rot_0..3 is {w} {x} {y} {z}, which is no rotation"));
        }
        let axes = DMat3::from_quat(rotation / length);
        // The first of equals, so that the choice is always the same.
        let flattest = (0..3).fold(0, |least, i| if deviations[i] < deviations[least] { i } else { least });
        // For two scales the third is 0 and so the least, unless both others are 0 too, which is refused below.
        let (u, v) = ((flattest + 1) % 3, (flattest + 2) % 3);
        let axis = |i: usize| (axes.col(i) * deviations[i]).as_vec3();
        let ellipse = Ellipse { axis_u: axis(u), axis_v: axis(v) };
        let has_length = |axis: Vec3| axis.is_finite() && axis != Vec3::ZERO;
        if !(has_length(ellipse.axis_u) && has_length(ellipse.axis_v)) {
            return Err(format!("its axes are {} and {} long", deviations[u], deviations[v]));
        }
        let opacity = self.opacity.map_or(1.0, |slot| 1.0 / (1.0 + (-values[slot]).exp()));
        if !opacity.is_finite() {
            return Err("opacity is NaN".to_owned());
        }
        let colour = self.colour.map_or([0.0; 3], |slots| slots.map(|slot| 0.5 + CONSTANT_HARMONIC * values[slot]));
        if !colour.iter().all(|c| c.is_finite()) {
            return Err("f_dc_0..2 is not finite".to_owned());
        }
        Ok(Splat {
            normal: axes.col(flattest).as_vec3(),
            ellipse,
            opacity: opacity as f32,
            // Harmonics overshoot 0 and 1 as a matter of course: no reason for a note.
            colour: colour.map(|c| c.clamp(0.0, 1.0) as f32),
        })
    }

    /// Adds a splat to all columns but the positions.
    pub fn push(&self, splat: Splat, gather: &mut Gather) {
        gather.normals.iter_mut().for_each(|normals| normals.push(splat.normal));
        gather.ellipses.iter_mut().for_each(|ellipses| ellipses.push(splat.ellipse));
        if self.opacity.is_some() {
            gather.opacities.iter_mut().for_each(|opacities| opacities.push(splat.opacity));
        }
        if self.colour.is_some() {
            gather.colours.iter_mut().for_each(|colours| colours.push(splat.colour));
        }
    }
}
