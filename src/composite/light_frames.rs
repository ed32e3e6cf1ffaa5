//! Frames of the light that are ready: the last few.
//!
//! *Practice.* A frame holds all leaves as a pipeline prepares them for one camera, so for a dense model it is as large as the model.
//! A picture needs many: one for each block of the light's grid that it asks, at each size of texels. Only the last
//! [`MOST_FRAMES`] are kept, and others are prepared again where they are missed.

use super::light_grid::LightBlock;

/// Frames that are kept: some pixels side by side ask for texels of about two sizes, each from the four blocks around a corner at
/// most.
pub(crate) const MOST_FRAMES: usize = 8;

/// Frames by block.
pub(crate) struct LightFrames<T> {
    /// That which was used last is the last one.
    kept: Vec<(LightBlock, T)>,
}

impl<T> Default for LightFrames<T> {
    fn default() -> Self {
        Self { kept: Vec::new() }
    }
}

impl<T> LightFrames<T> {
    /// Whether that of `block` is ready. Who needs several frames takes these first: in any other order, each that is prepared may
    /// take the place of one that is about to be needed.
    pub fn is_ready(&self, block: LightBlock) -> bool {
        self.kept.iter().any(|(known, _)| *known == block)
    }

    /// The frame of `block`, by `prepare` where it is not ready.
    ///
    /// # Errors
    /// Those of `prepare`.
    pub fn get<E>(&mut self, block: LightBlock, prepare: impl FnOnce() -> Result<T, E>) -> Result<&mut T, E> {
        let frame = match self.kept.iter().position(|(known, _)| *known == block) {
            Some(at) => self.kept.remove(at),
            None => {
                // Room is made before, so that there is never one too many.
                self.kept.drain(..(self.kept.len() + 1).saturating_sub(MOST_FRAMES));
                (block, prepare()?)
            }
        };
        let last = self.kept.len();
        self.kept.push(frame);
        Ok(&mut self.kept[last].1)
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::convert::Infallible;

    use super::*;

    /// A frame that counts how many there are.
    struct Counted<'a>(&'a Cell<usize>);

    impl<'a> Counted<'a> {
        fn new(alive: &'a Cell<usize>) -> Self {
            alive.set(alive.get() + 1);
            assert!(alive.get() <= MOST_FRAMES);
            Self(alive)
        }
    }

    impl Drop for Counted<'_> {
        fn drop(&mut self) {
            self.0.set(self.0.get() - 1);
        }
    }

    #[test]
    fn those_used_last_are_kept_and_never_more_than_a_few_live() {
        let (alive, prepared) = (Cell::new(0), Cell::new(0));
        let mut frames = LightFrames::default();
        let block = |x: i32| LightBlock { level: -7, x, y: 3 };
        let mut ask = |x: i32| {
            let prepare = || {
                prepared.set(prepared.get() + 1);
                Ok::<_, Infallible>(Counted::new(&alive))
            };
            let before = prepared.get();
            let is_ready = frames.is_ready(block(x));
            let Ok(_) = frames.get(block(x), prepare);
            assert_eq!(is_ready, prepared.get() == before);
            is_ready
        };
        let most = MOST_FRAMES as i32;
        assert!((0..most).all(|x| !ask(x)));
        assert!((0..most).all(&mut ask));
        // The first is the freshest now, so the second makes room.
        assert!(ask(0) && !ask(most) && ask(0) && !ask(1));
        assert!((0..100).all(|x| !ask(1000 + x)));
        assert_eq!(alive.get(), MOST_FRAMES);
    }

    #[test]
    fn what_could_not_be_prepared_is_tried_again() {
        let mut frames = LightFrames::default();
        let block = LightBlock { level: 0, x: 0, y: 0 };
        assert!(frames.get(block, || Err::<u8, _>("no")).is_err() && !frames.is_ready(block));
        assert_eq!(frames.get(block, || Ok::<_, Infallible>(7)), Ok(&mut 7));
    }
}
