//! Operand stacks for walks over post-order arenas, a few bits an entry.
//!
//! A walk needs as many entries as the tree leans to the right. The first word's worth lives in the stack itself, so
//! ordinary expressions evaluate without touching the heap; a tree a million deep spills 16 kB per 2^17 levels of bits.

use crate::csg::Tri;

/// A stack of values below `2^BITS`, packed into words.
#[derive(Debug, Default)]
pub(super) struct PackedStack<const BITS: u32> {
    /// The newest entries, the last pushed in the lowest bits.
    top: u64,
    /// Entries in `top`.
    in_top: u32,
    /// Full words, oldest first.
    below: Vec<u64>,
}

impl<const BITS: u32> PackedStack<BITS> {
    /// Entries a word.
    const PER_WORD: u32 = u64::BITS / BITS;
    /// The bits of one entry.
    const MASK: u64 = (1 << BITS) - 1;

    /// Pushes one value, below `2^BITS`.
    pub(super) fn push(&mut self, value: u64) {
        if self.in_top == Self::PER_WORD {
            self.below.push(self.top);
            self.in_top = 0;
        }
        self.top = (self.top << BITS) | value;
        self.in_top += 1;
    }

    /// The newest entry, removed. A walk over a sound arena never pops an empty stack.
    pub(super) fn pop(&mut self) -> u64 {
        if self.in_top == 0 {
            self.top = self.below.pop().expect("a post-order arena has two operands before each operator");
            self.in_top = Self::PER_WORD;
        }
        let value = self.top & Self::MASK;
        self.top >>= BITS;
        self.in_top -= 1;
        value
    }
}

/// A stack of Booleans: 64 without an allocation.
#[derive(Debug, Default)]
pub(super) struct BitStack(PackedStack<1>);

impl BitStack {
    /// Pushes one value.
    pub(super) fn push(&mut self, value: bool) {
        self.0.push(u64::from(value));
    }

    /// Removes and returns the newest value.
    pub(super) fn pop(&mut self) -> bool {
        self.0.pop() != 0
    }
}

/// A stack of three-valued truths: 32 without an allocation.
#[derive(Debug, Default)]
pub(super) struct TriStack(PackedStack<2>);

impl TriStack {
    /// Pushes one value.
    pub(super) fn push(&mut self, value: Tri) {
        self.0.push(value as u64);
    }

    /// Removes and returns the newest value.
    pub(super) fn pop(&mut self) -> Tri {
        match self.0.pop() {
            0 => Tri::False,
            1 => Tri::True,
            _ => Tri::Unknown,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_in_first_out_across_word_borders() {
        let (mut bits, mut tris, mut truth) = (BitStack::default(), TriStack::default(), Vec::new());
        for i in 0..1000u32 {
            // Three pushes to each pop: the stack grows through several words and crosses each border both ways.
            let tri = [Tri::False, Tri::True, Tri::Unknown][(i.wrapping_mul(2654435761) >> 20) as usize % 3];
            bits.push(tri == Tri::True);
            tris.push(tri);
            truth.push(tri);
            if i % 3 == 2 {
                let expected = truth.pop().unwrap();
                assert_eq!((bits.pop(), tris.pop()), (expected == Tri::True, expected));
            }
        }
        while let Some(expected) = truth.pop() {
            assert_eq!((bits.pop(), tris.pop()), (expected == Tri::True, expected));
        }
    }
}
