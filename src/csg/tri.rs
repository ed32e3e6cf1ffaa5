//! Three-valued truth.

use std::ops::Not;

/// Kleene's strong three-valued logic: `Unknown` is "false or true, not known which".
///
/// A result that is not `Unknown` holds whatever the unknown operands turn out to be. (The converse fails where an
/// unknown operand occurs twice: `u & !u` is `Unknown`, though it is always false.) Wicke's *unknown* is another thing,
/// see [`paper`](crate::csg::paper).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Tri {
    /// Certainly outside.
    False = 0,
    /// Certainly inside.
    True = 1,
    /// Either.
    Unknown = 2,
}

impl Tri {
    /// Kleene's conjunction: false wins, then unknown.
    pub fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::False, _) | (_, Self::False) => Self::False,
            (Self::True, Self::True) => Self::True,
            _ => Self::Unknown,
        }
    }

    /// Kleene's disjunction: true wins, then unknown.
    pub fn or(self, other: Self) -> Self {
        match (self, other) {
            (Self::True, _) | (_, Self::True) => Self::True,
            (Self::False, Self::False) => Self::False,
            _ => Self::Unknown,
        }
    }

    /// The value where it is known.
    pub fn known(self) -> Option<bool> {
        match self {
            Self::False => Some(false),
            Self::True => Some(true),
            Self::Unknown => None,
        }
    }

    /// This value, or its complement where `negated`.
    pub fn negated_if(self, negated: bool) -> Self {
        if negated { !self } else { self }
    }
}

impl Not for Tri {
    type Output = Self;

    /// Kleene's complement: unknown stays unknown.
    fn not(self) -> Self {
        match self {
            Self::False => Self::True,
            Self::True => Self::False,
            Self::Unknown => Self::Unknown,
        }
    }
}

impl From<bool> for Tri {
    fn from(value: bool) -> Self {
        if value { Self::True } else { Self::False }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Tri; 3] = [Tri::False, Tri::True, Tri::Unknown];

    /// The two-valued meanings of a three-valued value.
    fn meanings(value: Tri) -> Vec<bool> {
        value.known().map_or(vec![false, true], |known| vec![known])
    }

    /// The three-valued value that stands for a set of possible results.
    fn summary(results: &[bool]) -> Tri {
        match (results.contains(&true), results.contains(&false)) {
            (true, true) => Tri::Unknown,
            (yes, _) => Tri::from(yes),
        }
    }

    #[test]
    fn kleene_is_the_summary_of_all_meanings() {
        for a in ALL {
            assert_eq!(!a, summary(&meanings(a).iter().map(|x| !x).collect::<Vec<_>>()));
            for b in ALL {
                let pairs = || meanings(a).into_iter().flat_map(move |x| meanings(b).into_iter().map(move |y| (x, y)));
                assert_eq!(a.and(b), summary(&pairs().map(|(x, y)| x && y).collect::<Vec<_>>()));
                assert_eq!(a.or(b), summary(&pairs().map(|(x, y)| x || y).collect::<Vec<_>>()));
            }
        }
    }
}
