//! Lines, words and numbers of text files, with their places. Bytes, not `str`: a comment in Latin-1 is no error.

use super::error::{Fault, Place, quote};

/// One line without its end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Line<'a> {
    pub bytes: &'a [u8],
    /// From 1.
    pub number: u64,
}

/// The lines of a text; `\n`, `\r\n` and a lone `\r` end one.
#[derive(Debug, Clone)]
pub(super) struct Lines<'a> {
    rest: &'a [u8],
    number: u64,
    total: usize,
}

impl<'a> Lines<'a> {
    /// The lines of `bytes`, the first of which is number `first`.
    pub fn new(bytes: &'a [u8], first: u64) -> Self {
        Self { rest: bytes, number: first - 1, total: bytes.len() }
    }

    /// The lines of a whole file, without a UTF-8 byte order mark.
    pub fn of_file(bytes: &'a [u8]) -> Self {
        Self::new(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes), 1)
    }

    /// Bytes handed out so far.
    pub fn consumed(&self) -> u64 {
        (self.total - self.rest.len()) as u64
    }

    /// The number of the latest line, from 1.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// The next line that holds more than blanks.
    pub fn next_filled(&mut self) -> Option<Line<'a>> {
        self.find(|line| line.bytes.iter().any(|b| !b.is_ascii_whitespace()))
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Line<'a>;

    #[inline]
    fn next(&mut self) -> Option<Line<'a>> {
        if self.rest.is_empty() {
            return None;
        }
        self.number += 1;
        let end = self.rest.iter().position(|&b| b == b'\n' || b == b'\r').unwrap_or(self.rest.len());
        let (bytes, mut rest) = self.rest.split_at(end);
        if let Some(after) = rest.strip_prefix(b"\r") {
            rest = after;
            rest = rest.strip_prefix(b"\n").unwrap_or(rest);
        } else if let Some(after) = rest.strip_prefix(b"\n") {
            rest = after;
        }
        self.rest = rest;
        Some(Line { bytes, number: self.number })
    }
}

/// One word of a line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Word<'a> {
    pub bytes: &'a [u8],
    pub line: u64,
    /// First byte in its line, from 1.
    pub column: u64,
}

/// What separates words.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separators {
    /// Blanks and tabs.
    Blanks,
    /// Blanks, tabs, commas and semicolons. Empty cells vanish; the count of the columns shows it.
    Columns,
}

/// The words of a line.
#[derive(Debug, Clone)]
pub(super) struct Words<'a> {
    line: Line<'a>,
    at: usize,
    separators: Separators,
}

impl<'a> Words<'a> {
    pub fn new(line: Line<'a>, separators: Separators) -> Self {
        Self { line, at: 0, separators }
    }

    /// The place just behind the latest word.
    pub fn place(&self) -> Place {
        Place::Column { line: self.line.number, column: self.at as u64 + 1 }
    }
}

impl<'a> Iterator for Words<'a> {
    type Item = Word<'a>;

    #[inline]
    fn next(&mut self) -> Option<Word<'a>> {
        let columns = self.separators == Separators::Columns;
        let is_separator = |b: u8| b.is_ascii_whitespace() || (columns && (b == b',' || b == b';'));
        let bytes = self.line.bytes;
        let mut start = self.at;
        while start < bytes.len() && is_separator(bytes[start]) {
            start += 1;
        }
        let mut end = start;
        while end < bytes.len() && !is_separator(bytes[end]) {
            end += 1;
        }
        self.at = end;
        (start < end).then(|| Word { bytes: &bytes[start..end], line: self.line.number, column: start as u64 + 1 })
    }
}

impl Word<'_> {
    pub fn place(&self) -> Place {
        Place::Column { line: self.line, column: self.column }
    }

    /// The word as a number; NaN and infinities are numbers here, in the spellings of C and of Microsoft's C.
    #[inline]
    pub fn number(&self) -> Option<f64> {
        number(self.bytes)
    }

    /// The word as a number, or a fault that quotes it.
    #[inline]
    pub fn expect_number(&self) -> Result<f64, Fault> {
        self.number().ok_or_else(|| {
            Fault::malformed(
                self.place(),
                format!("{} is not a number", quote(self.bytes)),
                "correct it, or make the line a comment or take it out",
            )
        })
    }

    /// The word as a whole number.
    #[inline]
    pub fn integer(&self) -> Option<i64> {
        std::str::from_utf8(self.bytes).ok()?.parse().ok()
    }
}

/// Powers of ten that `f64` holds exactly.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// A number in decimal notation, rounded to the nearest `f64`.
///
/// Digits without an exponent, fewer than 2⁵³ as a whole number and with at most 22 decimals, take a short cut: one
/// division of two exact values is correctly rounded. All else goes to the standard library.
#[inline]
pub(super) fn number(bytes: &[u8]) -> Option<f64> {
    /// As many decimal digits always stay below 2⁵³.
    const SAFE_DIGITS: usize = 15;
    let (negative, digits) = match bytes.split_first() {
        Some((b'-', rest)) => (true, rest),
        _ => (false, bytes),
    };
    if digits.len() <= SAFE_DIGITS + 1 {
        let (mut whole, mut decimals, mut any, mut seen_point, mut plain) = (0_u64, 0_usize, false, false, true);
        for &b in digits {
            match b {
                b'0'..=b'9' => {
                    whole = whole * 10 + u64::from(b - b'0');
                    decimals += usize::from(seen_point);
                    any = true;
                }
                b'.' if !seen_point => seen_point = true,
                _ => {
                    plain = false;
                    break;
                }
            }
        }
        // Sixteen digits without a point may pass 2⁵³.
        if plain && any && (seen_point || digits.len() <= SAFE_DIGITS) {
            let value = whole as f64 / EXACT_POWERS[decimals];
            return Some(if negative { -value } else { value });
        }
    }
    let text = std::str::from_utf8(bytes).ok()?;
    if let Ok(value) = text.parse() {
        return Some(value);
    }
    // "-nan(ind)", "1.#QNAN", "-1.#IND": what C libraries print for NaN. "1.#INF" is infinite.
    let lower = text.to_ascii_lowercase();
    if lower.contains("#inf") {
        return Some(f64::INFINITY);
    }
    let is_nan = lower.trim_start_matches(['-', '+']).starts_with("nan(") || lower.contains(".#");
    is_nan.then_some(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_equal_the_standard_library_bit_for_bit() {
        for text in [
            "0",
            "-0",
            "1",
            "-1.5",
            "0.1",
            "123456789012345",
            "9007199254740993",
            "0.123456789012345",
            "1e10",
            "-2.5E-3",
            "3.4028235e38",
            ".5",
            "5.",
            "00012.50",
            "1234567890.1234567",
            "-0.0000001",
            "999999999999999.9",
            "inf",
            "4e-320",
        ] {
            let expected: f64 = text.parse().unwrap();
            assert_eq!(number(text.as_bytes()).map(f64::to_bits), Some(expected.to_bits()), "{text}");
        }
        for text in ["", "-", ".", "-.", "1.2.3", "abc", "1,5", "--1", "0x10", "1e", "é"] {
            assert_eq!(number(text.as_bytes()), None, "{text}");
        }
        for text in ["nan", "-nan", "NaN", "-nan(ind)", "1.#QNAN", "-1.#IND00"] {
            assert!(number(text.as_bytes()).is_some_and(f64::is_nan), "{text}");
        }
        assert_eq!(number(b"1.#INF"), Some(f64::INFINITY));
    }

    #[test]
    fn lines_end_in_every_way_and_are_counted() {
        let lines: Vec<_> = Lines::of_file(b"\xef\xbb\xbfa\nb\r\nc\rd\n\ne").map(|l| (l.bytes, l.number)).collect();
        let expected: [(&[u8], u64); 6] = [(b"a", 1), (b"b", 2), (b"c", 3), (b"d", 4), (b"", 5), (b"e", 6)];
        assert_eq!(lines, expected);
    }

    #[test]
    fn words_know_their_column() {
        let line = Line { bytes: b" 1, 2;3\t4", number: 7 };
        let words: Vec<_> = Words::new(line, Separators::Columns).map(|w| (w.bytes, w.column)).collect();
        let expected: [(&[u8], u64); 4] = [(b"1", 2), (b"2", 5), (b"3", 7), (b"4", 9)];
        assert_eq!(words, expected);
        assert_eq!(Words::new(line, Separators::Blanks).next().map(|w| w.bytes), Some(&b"1,"[..]));
    }
}
