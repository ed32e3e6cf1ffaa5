//! Which meshlets a picture may show: told by a ball around each, before any of its vertices is looked at.
//!
//! *Theory.* Clark 1976, "Hierarchical geometric models for visible surface algorithms": what bounds a group lies aside of the picture, so
//! the group does; and where what bounds a group of groups lies aside, or wholly on the picture, nobody has to ask for each.
//!
//! *Practice.* A ball holds whatever its meshlet draws, also where vertices are snapped, so what is left out would have drawn nothing:
//! pictures are the same bits. A camera that looks at a part of a scan projects and bins that part.

use glam::{DVec2, DVec3};

use super::model::MeshModel;
use super::project::View;

/// A ball in world space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ball {
    centre: DVec3,
    radius: f64,
}

/// Bits of a position that rounding may cost on its way to the picture, as a share of the largest number on that way: some hundred
/// roundings of `f64`.
const ROUNDINGS: f64 = 256.0 * f64::EPSILON;

/// The greater distance; infinity where one is not a number.
fn farther(a: f64, b: f64) -> f64 {
    if b.is_nan() { f64::INFINITY } else { a.max(b) }
}

impl Ball {
    /// One that holds all of `points`.
    pub fn around(points: impl Iterator<Item = DVec3> + Clone) -> Self {
        let nothing = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) = points.clone().fold(nothing, |(low, high), p| (low.min(p), high.max(p)));
        let centre = 0.5 * (low + high);
        let radius = points.map(|p| p.distance(centre)).fold(0.0, farther);
        Self { centre, radius }
    }

    /// One that holds all of `balls`.
    fn around_balls(balls: &[Self]) -> Self {
        let centre = Self::around(balls.iter().map(|ball| ball.centre)).centre;
        let reach = |ball: &Self| ball.centre.distance(centre) + ball.radius;
        Self { centre, radius: balls.iter().map(reach).fold(0.0, farther) }
    }

    /// How much of it lies on the picture.
    fn shown(&self, view: &View) -> Shown {
        let centre = view.camera.view_from_world(self.centre);
        let largest = self.centre.abs().max(view.camera.eye.abs()).max_element() + self.radius;
        let radius = self.radius + ROUNDINGS * largest;
        let (near, far) = (centre.z - radius, centre.z + radius);
        if far <= 0.0 {
            return Shown::Nothing;
        }
        // Through the eye's plane, or not a number.
        if !(near > 0.0) {
            return Shown::Perhaps;
        }
        let least = |v: f64| view.on_picture(v - radius, if v < radius { near } else { far });
        let most = |v: f64| view.on_picture(v + radius, if v > -radius { near } else { far });
        let middle = view.middle();
        let low = DVec2::new(least(centre.x), least(centre.y)) + middle;
        let high = DVec2::new(most(centre.x), most(centre.y)) + middle;
        // Snapping moves a vertex by half a position of the grid; a pixel is far more.
        let size = 2.0 * middle;
        if high.cmplt(DVec2::NEG_ONE).any() || low.cmpgt(size + DVec2::ONE).any() {
            Shown::Nothing
        } else if low.cmpge(DVec2::ZERO).all() && high.cmple(size).all() {
            Shown::Everything
        } else {
            Shown::Perhaps
        }
    }
}

/// How much of a ball a picture shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shown {
    Nothing,
    /// Some of it, or it is not known.
    Perhaps,
    Everything,
}

/// Meshlets that are asked for together first: they follow each other, so they lie close together.
const A_GROUP: usize = 64;

/// The balls around each [`A_GROUP`] of meshlets.
pub(super) fn groups(balls: &[Ball]) -> Vec<Ball> {
    balls.chunks(A_GROUP).map(Ball::around_balls).collect()
}

/// The numbers of the meshlets that the picture may show, in their order.
pub(super) fn meshlets(view: &View, model: &MeshModel) -> Vec<u32> {
    let mut visible = Vec::with_capacity(model.balls.len());
    for (number, (balls, around)) in model.balls.chunks(A_GROUP).zip(&model.groups).enumerate() {
        let first = (number * A_GROUP) as u32;
        let numbers = first..first + balls.len() as u32;
        match around.shown(view) {
            Shown::Nothing => {}
            Shown::Everything => visible.extend(numbers),
            Shown::Perhaps => {
                let may_show = numbers.zip(balls).filter(|(_, ball)| ball.shown(view) != Shown::Nothing);
                visible.extend(may_show.map(|(number, _)| number));
            }
        }
    }
    visible
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::{Camera, Lens};

    /// Points on a ball, all over it.
    fn points(ball: Ball) -> impl Iterator<Item = DVec3> {
        const COUNT: u32 = 200;
        /// Turns the points of a spiral so that none lies above another.
        const GOLDEN_ANGLE: f64 = 2.399_963;
        (0..COUNT).map(move |i| {
            let (height, turn) = (2.0 * (f64::from(i) + 0.5) / f64::from(COUNT) - 1.0, f64::from(i) * GOLDEN_ANGLE);
            let aside = (1.0 - height * height).sqrt();
            ball.centre + ball.radius * DVec3::new(aside * turn.cos(), aside * turn.sin(), height)
        })
    }

    #[test]
    fn a_ball_is_left_out_only_where_no_point_of_it_is_on_the_picture_and_wholly_in_only_where_all_are() {
        let (width, height) = (8, 6);
        for lens in [Lens::FovY(40.0), Lens::Height(2.9)] {
            let camera =
                Camera::look_at(DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z, lens, width, height).unwrap();
            let view = View::new(camera);
            let on_picture = |p: DVec3| {
                let p = view.camera.view_from_world(p);
                let px = DVec2::new(view.on_picture(p.x, p.z), view.on_picture(p.y, p.z)) + view.middle();
                p.z > 0.0 && px.cmpge(DVec2::ZERO).all() && px.cmple(2.0 * view.middle()).all()
            };
            let mut count = [0; 3];
            for step in 0..20_000_u32 {
                // Positions all around the picture, of all sizes: irrational steps come everywhere.
                let at = |rate: f64| (f64::from(step) * rate).fract() - 0.5;
                let centre = DVec3::new(6.0 * at(0.754_877), 8.0 * at(0.569_840), 5.0 * at(0.430_597));
                let ball = Ball { centre, radius: 10_f64.powf(4.0 * at(0.319_323) - 2.0) };
                let shown = ball.shown(&view);
                count[shown as usize] += 1;
                match shown {
                    Shown::Nothing => assert!(!points(ball).any(on_picture), "{ball:?}"),
                    Shown::Everything => assert!(points(ball).all(on_picture), "{ball:?}"),
                    Shown::Perhaps => {}
                }
            }
            assert!(count.iter().all(|count| *count > 1_000), "{count:?}");
        }
    }

    #[test]
    fn a_ball_holds_what_it_is_around() {
        let balls = [(0.0, 1.0), (5.0, 0.5), (-3.0, 2.0)]
            .map(|(x, radius)| Ball { centre: DVec3::new(x, 0.3 * x, 7.0), radius });
        let all = Ball::around_balls(&balls);
        for p in balls.into_iter().flat_map(points) {
            assert!(p.distance(all.centre) <= all.radius * (1.0 + ROUNDINGS));
        }
    }
}
