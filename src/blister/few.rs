//! Blocks of few layers, where any boundary is all that its pixel needs and nobody asks whose body lies behind it.
//!
//! *Theory.* As in [`peel`](super::peel).
//!
//! *Practice.* Most blocks of a picture of opaque surfaces are such, so here nothing is gathered, put in order or handed
//! over: keys stay in registers, and what is found goes straight to its place. A peel of several fragments needs the rules of
//! [`ties`](super::ties); a block where such a one changes the result is given back as it was.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x8, mask32x8, u32x8};

use super::fragments::{ABSENT, Fragments, LANES};
use super::survivors::Eight;
use crate::csg::Shrunk;
use crate::csg::flat::SLOTS_A_WORD;

/// The most layers of such a block: two passes over all of them for each peel are still cheap.
pub(super) const FEW: usize = 12;

/// A block of at most [`FEW`] layers, and at most [`SLOTS_A_WORD`] slots. Every ray begins outside of all of them.
pub(super) struct FewLayers<'a> {
    pub shrunk: &'a Shrunk,
    pub fragments: &'a Fragments,
    /// Its layers.
    pub layers: &'a [u32],
    /// Which pixels are to be peeled.
    pub wanted: u8,
    /// Only fragments with greater keys are peeled.
    pub floor: f32,
    /// Only fragments with lesser keys are: the others have been.
    pub ceiling: f32,
}

impl FewLayers<'_> {
    /// Puts each pixel's first boundary into `found`; returns at which pixels there is one. `state`, the pixels' memberships at
    /// the ceiling, becomes that at the floor. `None` where several fragments coincide at a boundary: then nothing has changed.
    #[inline(always)]
    pub fn peel<S: Simd>(
        &self,
        simd: S,
        nodes: &mut [u32x8<S>],
        state: &mut [u32; LANES],
        found: &mut Eight,
    ) -> Option<u8> {
        debug_assert!(self.layers.len() <= FEW && self.shrunk.slots().len() <= SLOTS_A_WORD);
        let (none, absent) = (u32x8::splat(simd, 0), f32x8::splat(simd, ABSENT));
        // Equal to no key, and less than none.
        let never = f32x8::splat(simd, f32::NAN);
        let mut keys = [absent; FEW];
        let mut bits = [0_u32; FEW];
        for ((keys, bit), &layer) in keys.iter_mut().zip(&mut bits).zip(self.layers) {
            let layer = self.fragments.layer(layer);
            *keys = f32x8::from_slice(simd, &layer.keys);
            *bit = 1 << (layer.slot % SLOTS_A_WORD as u32);
        }
        let count = self.layers.len().min(FEW);
        let (keys, bits) = (&keys[..count], &bits[..count]);
        let mut now = u32x8::from_slice(simd, &*state);
        let mut was = self.shrunk.eval_lanes(simd, &[now], nodes);
        let mut last = f32x8::splat(simd, self.ceiling);
        let mut alive = u32::from(self.wanted);
        let mut has = 0;
        let (mut what, mut owners) = (none, none);
        loop {
            let mut next = absent;
            for keys in keys {
                next = next.max(keys.simd_lt(last).select(*keys, absent));
            }
            let is_any = next.simd_gt(self.floor);
            alive &= is_any.to_bitmask() as u32;
            if alive == 0 {
                break;
            }
            // Pixels without more toggle no more: what the state becomes is theirs at the floor.
            next = is_any.select(next, never);
            let mut one = mask32x8::splat(simd, false);
            let mut several = one;
            for (keys, bit) in keys.iter().zip(bits) {
                let here = keys.simd_eq(next);
                now ^= here.select(u32x8::splat(simd, *bit), none);
                several |= one & here;
                one |= here;
            }
            let is = self.shrunk.eval_lanes(simd, &[now], nodes);
            let changes = is.simd_ne(was);
            let changed = changes.to_bitmask() as u32 & alive;
            if changed != 0 {
                if several.to_bitmask() as u32 & changed != 0 {
                    return None;
                }
                let taken = mask32x8::from_bitmask(simd, u64::from(changed));
                for (keys, &layer) in keys.iter().zip(self.layers) {
                    let here = keys.simd_eq(next) & taken;
                    let layer = self.fragments.layer(layer);
                    what = here.select(self.fragments.what_lanes(simd, layer), what);
                    owners = here.select(u32x8::splat(simd, layer.slot), owners);
                }
                has |= changed;
                alive &= !changed;
                if alive == 0 {
                    break;
                }
            }
            (was, last) = (is, next);
        }
        *state = now.into();
        if has != 0 {
            found.put_lanes(simd, mask32x8::from_bitmask(simd, u64::from(has)), what, owners);
        }
        Some(has as u8)
    }
}
