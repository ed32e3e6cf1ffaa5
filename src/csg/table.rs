//! The truth table of an expression over few leaves.
//!
//! *Theory.* With k leaves there are 2^k states. The values of a leaf over all of them are a fixed pattern of bits, those of a
//! node the conjunction or disjunction of its operands', so the whole table takes one operation for 32 states and operand.
//!
//! *Practice.* The states of eight points are looked up by picking a word for each and shifting it, however large the
//! expression. Most expressions have one word.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, u32x8};

/// Expressions over more leaves have no table.
pub(super) const MOST_SLOTS: usize = 7;

/// States of a word of the table, as an exponent.
const SLOTS_A_WORD: usize = 5;

const WORDS: usize = 1 << (MOST_SLOTS - SLOTS_A_WORD);

/// Bit s % 32 of word s / 32 is the value in state s.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Table([u32; WORDS]);

impl Table {
    /// The same in all states.
    pub fn constant(value: bool) -> Self {
        Self([if value { u32::MAX } else { 0 }; WORDS])
    }

    /// Where leaf `slot` is in, or out if `negated`.
    pub fn of_slot(slot: usize, negated: bool) -> Self {
        debug_assert!(slot < MOST_SLOTS);
        const WITHIN: [u32; SLOTS_A_WORD] = [0xaaaa_aaaa, 0xcccc_cccc, 0xf0f0_f0f0, 0xff00_ff00, 0xffff_0000];
        let word = |word: usize| match WITHIN.get(slot) {
            Some(pattern) => *pattern,
            None if word >> (slot - SLOTS_A_WORD) & 1 == 1 => u32::MAX,
            None => 0,
        };
        Self(std::array::from_fn(|w| if negated { !word(w) } else { word(w) }))
    }

    /// Both, or either.
    pub fn and_or(self, other: Self, is_and: bool) -> Self {
        Self(std::array::from_fn(|w| if is_and { self.0[w] & other.0[w] } else { self.0[w] | other.0[w] }))
    }

    /// All bits in the lanes whose state has the value true.
    #[inline(always)]
    pub fn look_up<S: Simd>(&self, simd: S, state: u32x8<S>) -> u32x8<S> {
        let word = |w: usize| u32x8::splat(simd, self.0[w]);
        let mut words = word(0);
        if self.0[1..] != [self.0[0]; WORDS - 1] {
            let is_odd = (state & (1 << SLOTS_A_WORD)).simd_ne(0);
            let is_high = (state & (2 << SLOTS_A_WORD)).simd_ne(0);
            words = is_high.select(is_odd.select(word(3), word(2)), is_odd.select(word(1), words));
        }
        let bit = (words >> (state & ((1 << SLOTS_A_WORD) - 1))) & 1;
        u32x8::splat(simd, 0) - bit
    }
}
