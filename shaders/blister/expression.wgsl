// Twin of csg/steps.rs and blister/ties.rs: whether a point is inside the result, who owns a boundary, and whose material is behind.

// Memberships before a peel and after it, a bit for each slot.
var<private> before: array<u32, WORDS>;
var<private> after: array<u32, WORDS>;
// Slots whose uncomplemented occurrences are taken away.
var<private> gone: array<u32, WORDS>;

fn word_of(slot: u32) -> u32 {
    return slot / 32u;
}

fn bit_of(slot: u32) -> u32 {
    return 1u << (slot % 32u);
}

fn is_in_before(slot: u32) -> bool {
    return (before[word_of(slot)] & bit_of(slot)) != 0u;
}

fn is_in_after(slot: u32) -> bool {
    return (after[word_of(slot)] & bit_of(slot)) != 0u;
}

// Where a step leads, given the memberships of its word.
fn next_step(at: u32, inside: u32) -> u32 {
    let step = steps[at];
    let holds = (inside ^ step.negated) & step.mask;
    let decides = select(holds != 0u, holds != step.mask, step.is_and != 0u);
    return select(step.open, step.decided, decides);
}

// Where a walk of a few steps ends, given the memberships of each step's word.
fn is_inside_by_few(inside: vec4<u32>) -> bool {
    let holds = (inside ^ frame.negated) & frame.masks;
    let decides = select(holds != vec4<u32>(0u), holds != frame.masks, frame.are_ands != vec4<u32>(0u));
    let next = select(frame.open, frame.decided, decides);
    var at = next.x;
    if STEPS > 1u {
        at = select(at, next.y, at == 1u);
        at = select(at, next.z, at == 2u);
        at = select(at, next.w, at == 3u);
    }
    return at == STEP_INSIDE;
}

fn few_before() -> vec4<u32> {
    return vec4<u32>(before[frame.words.x], before[frame.words.y], before[frame.words.z], before[frame.words.w]);
}

fn few_after() -> vec4<u32> {
    return vec4<u32>(after[frame.words.x], after[frame.words.y], after[frame.words.z], after[frame.words.w]);
}

fn few_gone() -> vec4<u32> {
    return vec4<u32>(gone[frame.words.x], gone[frame.words.y], gone[frame.words.z], gone[frame.words.w]);
}

fn eval_before() -> bool {
    if STEPS > 0u {
        return is_inside_by_few(few_before());
    }
    var at = 0u;
    while at < STEP_OUTSIDE {
        at = next_step(at, before[steps[at].word]);
    }
    return at == STEP_INSIDE;
}

fn eval_after() -> bool {
    if STEPS > 0u {
        return is_inside_by_few(few_after());
    }
    var at = 0u;
    while at < STEP_OUTSIDE {
        at = next_step(at, after[steps[at].word]);
    }
    return at == STEP_INSIDE;
}

// With the memberships after the peel or before it, less what is gone.
fn eval_without(is_after: bool) -> bool {
    if STEPS > 0u {
        return is_inside_by_few(select(few_before(), few_after(), is_after) & ~(few_gone() & ~frame.negated));
    }
    var at = 0u;
    while at < STEP_OUTSIDE {
        let step = steps[at];
        let inside = select(before[step.word], after[step.word], is_after);
        at = next_step(at, inside & ~(gone[step.word] & ~step.negated));
    }
    return at == STEP_INSIDE;
}

// The result where one slot is turned over.
fn eval_before_turned(slot: u32) -> bool {
    before[word_of(slot)] ^= bit_of(slot);
    let value = eval_before();
    before[word_of(slot)] ^= bit_of(slot);
    return value;
}

fn eval_after_turned(slot: u32) -> bool {
    after[word_of(slot)] ^= bit_of(slot);
    let value = eval_after();
    after[word_of(slot)] ^= bit_of(slot);
    return value;
}

// How good a claim a slot that toggles has to a boundary into `is_inside`: less is better.
fn claim(slot: u32, is_inside: bool) -> u32 {
    let matters = eval_before_turned(slot) == is_inside || eval_after_turned(slot) != is_inside;
    let goes_with = is_in_after(slot) == is_inside;
    return select(2u, 0u, matters) + select(1u, 0u, goes_with);
}

// The body of a boundary whose owner goes against the result, in the state just inside it; NO_SLOT where there is none.
fn body(is_after: bool) -> u32 {
    for (var word = 0u; word < WORDS; word++) {
        gone[word] = 0u;
    }
    for (var word = 0u; word < WORDS; word++) {
        var rest = select(before[word], after[word], is_after);
        while rest != 0u {
            let bit = rest & (~rest + 1u);
            rest &= rest - 1u;
            gone[word] = bit;
            if !eval_without(is_after) {
                return word * 32u + firstTrailingBit(bit);
            }
        }
        gone[word] = 0u;
    }
    // The result could do without any one of them: they are taken away from the last on, as long as it holds.
    for (var from_end = 0u; from_end < WORDS; from_end++) {
        let word = WORDS - 1u - from_end;
        var rest = select(before[word], after[word], is_after);
        while rest != 0u {
            let bit = 1u << firstLeadingBit(rest);
            rest ^= bit;
            gone[word] |= bit;
            if !eval_without(is_after) {
                gone[word] ^= bit;
            }
        }
    }
    for (var word = 0u; word < WORDS; word++) {
        let kept = select(before[word], after[word], is_after) & ~gone[word];
        if kept != 0u {
            return word * 32u + firstTrailingBit(kept);
        }
    }
    return NO_SLOT;
}
