//! "Did you mean …?": the known name that a mistyped one is nearest to.

/// The nearest of `known` to `given`, where one is near enough to be meant: at most a third of its letters differ
/// (insertions, deletions, replacements and swapped neighbours count one each, case does not count), or one begins
/// with the other. Ties go to the first.
pub fn nearest_name<'a>(given: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    // Longer inputs are no typing mistake, and the distance costs the product of the lengths.
    const LONGEST: usize = 64;
    // Shorter beginnings match by accident.
    const SHORTEST_BEGINNING: usize = 3;
    let given: Vec<char> = given.to_lowercase().chars().collect();
    if given.is_empty() || given.len() > LONGEST {
        return None;
    }
    let mut best: Option<(usize, &str)> = None;
    for name in known {
        let letters: Vec<char> = name.to_lowercase().chars().collect();
        let length = letters.len().max(given.len());
        if length > LONGEST {
            continue;
        }
        let shorter = letters.len().min(given.len());
        let begins = shorter >= SHORTEST_BEGINNING && letters[..shorter] == given[..shorter];
        let edits = edit_distance(&given, &letters);
        // A name that is nothing but letters replaced (such as one letter for another) shares nothing with it.
        let near = edits * 3 <= length.max(3) && edits < length;
        if (begins || near) && best.is_none_or(|(fewest, _)| edits < fewest) {
            best = Some((edits, name));
        }
    }
    best.map(|(_, name)| name)
}

/// Edits that turn `a` into `b`, swapped neighbours counting one (optimal string alignment).
fn edit_distance(a: &[char], b: &[char]) -> usize {
    let mut before_last = vec![0; b.len() + 1];
    let mut last: Vec<usize> = (0..=b.len()).collect();
    for i in 1..=a.len() {
        let mut row = vec![i; b.len() + 1];
        for j in 1..=b.len() {
            let replaced = last[j - 1] + usize::from(a[i - 1] != b[j - 1]);
            row[j] = replaced.min(last[j] + 1).min(row[j - 1] + 1);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                row[j] = row[j].min(before_last[j - 2] + 1);
            }
        }
        before_last = std::mem::replace(&mut last, row);
    }
    last[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn typing_mistakes_find_what_was_meant() {
        let known = ["translate", "rotate", "scale", "colour", "color", "opacity", "units"];
        for (given, meant) in [
            ("tranlsate", Some("translate")),
            ("Rotate", Some("rotate")),
            ("colr", Some("color")),
            ("opac", Some("opacity")),
            ("unit", Some("units")),
            ("femur", None),
            ("x", None),
            ("", None),
        ] {
            assert_eq!(nearest_name(given, known), meant, "{given}");
        }
    }
}
