//! Crossings where the tracing kernel can read them: behind the blocks' lists, in one buffer.
//!
//! *Practice.* WebGPU promises a kernel eight storage buffers, and tracing uses all of them. So what a source told is copied behind
//! what says where each block's lists begin: offsets, what rays begin inside of, and the crossings, all as words.

use super::bins::LISTS;
use super::project::SplatView;
use crate::gpu::crossings::{CROSSING_ENTERS, CROSSING_SHOWS, CrossingRecord, GpuCrossings};
use crate::gpu::shader::Shader;
use crate::gpu::{Commands, GpuError};

/// Bytes of a word.
const WORD: usize = std::mem::size_of::<u32>();

/// Words of a crossing.
const CROSSING_WORDS: usize = std::mem::size_of::<CrossingRecord>() / WORD;

macro_rules! word_of {
    ($field:ident) => {
        (std::mem::offset_of!(CrossingRecord, $field) / WORD) as u32
    };
}

/// The constants that name a crossing's words.
pub(super) fn with_constants(shader: Shader) -> Shader {
    shader
        .with_constant("CROSSING_WORDS", CROSSING_WORDS as u32)
        .with_constant("CROSSING_NORMAL", word_of!(normal))
        .with_constant("CROSSING_DEPTH", word_of!(depth))
        .with_constant("CROSSING_COLOUR", word_of!(colour))
        .with_constant("CROSSING_OPACITY", word_of!(opacity))
        .with_constant("CROSSING_LEAF", word_of!(leaf))
        .with_constant("CROSSING_FLAGS", word_of!(flags))
        .with_constant("CROSSING_ENTERS", CROSSING_ENTERS)
        .with_constant("CROSSING_SHOWS", CROSSING_SHOWS)
}

/// The lists' beginnings, `starts`, of so many blocks, with `crossings` behind them; and `of` with their places.
///
/// # Errors
/// [`GpuError::TooLarge`] where they do not fit one buffer.
pub(super) fn beside(
    commands: &mut Commands,
    starts: &wgpu::Buffer,
    blocks: usize,
    crossings: &GpuCrossings,
    of: &SplatView,
) -> Result<(wgpu::Buffer, SplatView), GpuError> {
    let pixels = crossings.rect.area();
    let parts = [
        (starts, blocks * LISTS as usize + 1),
        (&crossings.offsets, pixels + 1),
        (&crossings.begins, pixels * crossings.begins_words as usize),
        (&crossings.crossings, crossings.count * CROSSING_WORDS),
    ];
    let all = commands.gpu().storage::<u32>("lists and crossings", parts.iter().map(|(_, words)| words).sum())?;
    let mut firsts = [0; 4];
    let mut end = 0;
    for ((buffer, words), first) in parts.into_iter().zip(&mut firsts) {
        *first = end as u32;
        if words > 0 {
            commands.encoder.copy_buffer_to_buffer(buffer, 0, &all, (end * WORD) as u64, (words * WORD) as u64);
        }
        end += words;
    }
    let [_, offsets, begins, first_crossing] = firsts;
    let begins_words = crossings.begins_words;
    Ok((all, SplatView { crossings: offsets, begins, begins_words, first_crossing, ..*of }))
}
