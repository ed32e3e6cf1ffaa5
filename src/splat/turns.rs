//! Crossings of a ray with one leaf put in turn: those that were taken for silhouettes found again, and those of stray surfels
//! left out.
//!
//! # Theory
//! A ray enters and leaves a closed leaf by turns. On a noisy surface that the ray grazes they are found out of turn, for two
//! reasons, and the far side of the leaf, or what lies behind it, shows through as a speck.
//! * A group of candidates whose quadratic has no root is a ray that passes the surface ([`super::rows`], *Practice*) and is
//!   dropped, although the ray crosses it. Where a crossing is out of turn and a group that would go before it was dropped, that
//!   group was a crossing: the one whose nearest surfel proves most, and the ray has that surfel's hit.
//!   (A crossing is out of turn only if the side before it, by the leaf's winding number, is the one that was left behind.)
//! * One surfel that stands out of the surface is crossed once, and at a silhouette one of two crossings may be found and the other
//!   missed. Where no dropped group goes before a crossing out of turn, it is the crossing itself that is left out if it is met
//!   edge-on or lies less than three radii above the surface that is crossed next.
//!
//! # Practice
//! A ray that misses both sides of the leaf passes a silhouette and is left alone: its crossings take turns without them. A scan
//! with real holes shows its inside as before, since what is seen through a hole has no other side close behind it: to leave out
//! whatever is left from outside took the rim off an open wrist, where the winding number is less than half. Where only
//! the nearest surface is wanted, crossings behind it are not looked for, and what is out of turn behind the last one found is not
//! known.

/// A stray surfel stands out of the surface behind it by less than this many of its radii: further off it would be a surface of
/// its own.
pub(crate) const MOST_STRAY_IN_RADII: f32 = 3.0;

/// Surfaces that rays meet less steeply than this, 6° off edge-on, may end there; and are taken to be as steep, so that a radius off
/// them is not far away.
pub(crate) const LEAST_STEEPNESS: f32 = 0.1;

/// A crossing of one ray with a leaf.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Depth less the tile's anchor.
    pub t: f32,
    /// Whether the leaf is entered.
    pub enters: bool,
    /// Radius of the nearest surfel.
    pub radius: f32,
    /// How far a step of one in depth takes along the surface's normal.
    pub steepness: f32,
}

/// A group of candidates that was dropped.
#[derive(Debug, Clone, Copy)]
pub struct Dropped {
    /// What its nearest surfel says.
    pub crossing: Found,
    /// How near that surfel is to the ray.
    pub weight: f32,
    /// Which group.
    pub slot: usize,
}

/// What puts the crossings of a ray in turn.
#[derive(Debug, Default, PartialEq)]
pub struct Mended {
    /// The dropped groups that are crossings.
    pub needed: Vec<usize>,
    /// Depths of crossings that are none.
    pub stray: Vec<f32>,
}

/// Sorts the crossings `found` of a ray and tells whether they take turns, if the ray begins outside of the leaf.
pub fn are_taken(found: &mut [Found]) -> bool {
    if found.len() > 1 {
        found.sort_by(|a, b| a.t.total_cmp(&b.t));
    }
    found.iter().enumerate().all(|(place, crossing)| crossing.enters == (place % 2 == 0))
}

/// Mends the crossings `found` of a ray, sorted, with groups of `dropped`. Depths begin with that of the eye, `from`; `holds` tells
/// whether the ray's point at a depth that is not near a surface is inside of the leaf, and `shows` whether the crossing at a depth
/// is on the result: only such a one is left out.
pub fn mend(
    found: &[Found],
    dropped: &[Dropped],
    from: f32,
    mut holds: impl FnMut(f32) -> bool,
    shows: impl Fn(f32) -> bool,
    mended: &mut Mended,
) {
    mended.needed.clear();
    mended.stray.clear();
    let (mut inside, mut nearest) = (holds(from), from);
    for (place, crossing) in found.iter().enumerate() {
        // Two groups may have found one crossing.
        if place > 0 && (crossing.t, crossing.enters) == (found[place - 1].t, found[place - 1].enters) {
            continue;
        }
        if crossing.enters == inside {
            let lies_between = |d: &&Dropped| d.crossing.t > nearest && d.crossing.t < crossing.t;
            let turns = |d: &&Dropped| d.crossing.enters != crossing.enters;
            let candidates = dropped.iter().filter(lies_between).filter(turns);
            let surest = candidates.max_by(|a, b| a.weight.total_cmp(&b.weight));
            let follows = |next: &Found| {
                let out_of_surface = (next.t - crossing.t) * next.steepness;
                next.enters != crossing.enters && out_of_surface < crossing.radius * MOST_STRAY_IN_RADII
            };
            let may_end = crossing.steepness < LEAST_STEEPNESS || found.get(place + 1).is_some_and(follows);
            let may_be_stray = surest.is_none() && may_end && shows(crossing.t);
            // Where a leaf is not on the result its surfels are not looked for: then a crossing went before that nobody found. To ask
            // is dear, and most walls of a cavity have nothing to mend.
            if (surest.is_some() || may_be_stray) && holds(depth_before(crossing, nearest)) == inside {
                if may_be_stray {
                    mended.stray.push(crossing.t);
                    continue;
                }
                mended.needed.extend(surest.map(|group| group.slot));
            }
        }
        (inside, nearest) = (crossing.enters, crossing.t);
    }
}

/// A depth before a crossing that is a radius off its surface, or, where another is nearer, halfway to that.
fn depth_before(crossing: &Found, nearest: f32) -> f32 {
    let off = crossing.radius / crossing.steepness.max(LEAST_STEEPNESS);
    (crossing.t - off).max(0.5 * (nearest + crossing.t))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn enters(t: f32) -> Found {
        Found { t, enters: true, radius: 0.1, steepness: 0.4 }
    }

    fn leaves(t: f32) -> Found {
        Found { t, enters: false, radius: 0.1, steepness: 0.4 }
    }

    /// Mends with a leaf whose side is everywhere as where the ray `begins`, at depth 0.
    fn of(found: &[Found], dropped: &[(Found, f32)], begins: bool) -> Mended {
        mended(found, dropped, |_| begins)
    }

    fn mended(found: &[Found], dropped: &[(Found, f32)], holds: impl FnMut(f32) -> bool) -> Mended {
        let of_slot = |(slot, &(crossing, weight)): (usize, &(Found, f32))| Dropped { crossing, weight, slot };
        let dropped: Vec<Dropped> = dropped.iter().enumerate().map(of_slot).collect();
        let mut mended = Mended::default();
        let mut found = found.to_vec();
        are_taken(&mut found);
        mend(&found, &dropped, 0.0, holds, |_| true, &mut mended);
        mended
    }

    fn needs(slots: &[usize]) -> Mended {
        Mended { needed: slots.to_vec(), stray: Vec::new() }
    }

    #[test]
    fn crossings_that_take_turns_need_nothing() {
        let silhouette = [(enters(0.5), 1.0), (leaves(0.6), 1.0), (enters(2.5), 1.0), (leaves(4.0), 1.0)];
        assert_eq!(of(&[enters(1.0), leaves(2.0), enters(3.0)], &silhouette, false), needs(&[]));
        assert_eq!(of(&[leaves(2.0), enters(3.0)], &silhouette, true), needs(&[]));
        assert_eq!(of(&[], &silhouette, false), needs(&[]));
    }

    #[test]
    fn the_surest_group_between_two_of_one_kind_comes_back() {
        let dropped = [(enters(0.5), 0.3), (enters(0.7), 0.6), (leaves(0.8), 0.9), (enters(1.5), 0.9)];
        assert_eq!(of(&[leaves(1.0)], &dropped, false), needs(&[1]));
        // Crossings may be found in any order.
        assert_eq!(mended(&[leaves(2.0), leaves(1.0)], &dropped, |t| t < 1.0), needs(&[3]));
        assert_eq!(mended(&[enters(0.1), enters(1.0)], &dropped, |t| t > 0.1 && t < 0.8), needs(&[2]));
    }

    #[test]
    fn a_gap_that_no_group_fills_stays() {
        assert_eq!(of(&[leaves(1.0)], &[(leaves(0.5), 1.0), (enters(1.5), 1.0)], false), needs(&[]));
        assert_eq!(of(&[leaves(1.0)], &[], false), needs(&[]));
        // Through a hole: the next surface lies far below.
        assert_eq!(of(&[leaves(1.0), enters(2.0), leaves(3.0)], &[], false), needs(&[]));
    }

    #[test]
    fn a_crossing_that_two_groups_found_is_one() {
        let dropped = [(leaves(0.5), 1.0)];
        assert_eq!(of(&[enters(1.0), enters(1.0), leaves(1.2)], &[], false), needs(&[]));
        assert_eq!(of(&[enters(1.0), enters(1.0), leaves(1.2)], &dropped, false), needs(&[]));
    }

    #[test]
    fn crossings_that_are_not_looked_for_are_not_missed() {
        // The leaf is entered at 0.5, off the result, and neither is its back stray nor the silhouette at 0.4 a crossing.
        let found = [leaves(1.0), enters(1.2), leaves(3.0)];
        assert_eq!(mended(&found, &[(enters(0.4), 1.0)], |t| t > 0.5), needs(&[]));
    }

    #[test]
    fn the_back_of_a_surfel_that_stands_out_is_left_out() {
        let stray = Mended { needed: Vec::new(), stray: vec![1.0] };
        assert_eq!(of(&[leaves(1.0), enters(1.2), leaves(3.0)], &[], false), stray);
        // Unless its front was dropped.
        assert_eq!(of(&[leaves(1.0), enters(1.2), leaves(3.0)], &[(enters(0.9), 0.5)], false), needs(&[0]));
    }

    #[test]
    fn one_crossing_at_a_silhouette_is_left_out() {
        let stray = Mended { needed: Vec::new(), stray: vec![1.0] };
        let edge_on = Found { steepness: 0.05, ..leaves(1.0) };
        assert_eq!(of(&[edge_on], &[], false), stray);
        assert_eq!(of(&[edge_on, enters(5.0), leaves(9.0)], &[], false), stray);
        // Unless it is seen through a hole.
        assert_eq!(mended(&[edge_on], &[], |t| t > 0.3), needs(&[]));
    }
}
