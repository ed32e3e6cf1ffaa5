//! Reads expressions: `a | b` union, `a & b` intersection, `a - b` difference, `!a` complement.
//!
//! `!` binds tightest, then `&`, then `|` and `-`, which are equal; operators are left-associative; parentheses group.
//! A name is letters, digits and `_`, else `"quoted"`, with `\"` and `\\` for a quote and a backslash within. Nothing is
//! implied between two operands.
//!
//! *Practice.* Dijkstra's shunting yard: operators wait on a stack until one that binds less tightly, or a closing
//! parenthesis, calls for them. So nesting costs heap, not call depth, and any text is read in linear time.

use std::borrow::Cow;

use super::tree::is_name_char;
use super::{LeafId, Tree, TreeBuilder};

/// Why an expression cannot be read. Offsets count bytes from the start of the text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ExpressionError {
    /// Nothing but white space.
    #[error("the expression is empty: name at least one leaf")]
    Empty,
    /// Something else stands where an operand must.
    #[error("at byte {offset}: expected a leaf's name, `!` or `(`, but found {found}: {mend}")]
    OperandExpected {
        /// Where.
        offset: usize,
        /// What stands there, ready to print.
        found: String,
        /// What would mend it.
        mend: &'static str,
    },
    /// Something else stands where an operator must.
    #[error("at byte {offset}: expected `|`, `&`, `-` or the end, but found {found}: {mend}")]
    OperatorExpected {
        /// Where.
        offset: usize,
        /// What stands there, ready to print.
        found: String,
        /// What would mend it.
        mend: &'static str,
    },
    /// An opening parenthesis without its closing one.
    #[error("at byte {offset}: this `(` is never closed: add a `)`")]
    UnclosedParenthesis {
        /// Of the innermost such parenthesis.
        offset: usize,
    },
    /// A closing parenthesis without its opening one.
    #[error("at byte {offset}: this `)` closes nothing: remove it, or add the `(` that it should close")]
    UnopenedParenthesis {
        /// Of the closing parenthesis.
        offset: usize,
    },
    /// A quoted name without its closing quote.
    #[error("at byte {offset}: this quoted name never ends: add a `\"`")]
    UnclosedQuote {
        /// Of the opening quote.
        offset: usize,
    },
    /// A backslash in a quoted name before anything but a quote or a backslash.
    #[error("at byte {offset}: only `\\\"` and `\\\\` may follow a backslash here: write `\\\\` for a backslash")]
    UnknownEscape {
        /// Of the backslash.
        offset: usize,
    },
    /// `resolve` knows no such leaf.
    #[error("at byte {offset}: there is no leaf named `{name}`")]
    UnknownLeaf {
        /// Where its name begins (the quote, if it is quoted).
        offset: usize,
        /// The name, without quotes.
        name: String,
    },
    /// More text than node indices can number.
    #[error("the expression is {bytes} bytes long: at most {} can be read", u32::MAX)]
    TooLong {
        /// Its length.
        bytes: usize,
    },
}

impl ExpressionError {
    /// Where in the text the error is, in bytes: 0 for an error of the whole, the text's length for an early end.
    pub fn offset(&self) -> usize {
        match self {
            Self::Empty | Self::TooLong { .. } => 0,
            Self::OperandExpected { offset, .. }
            | Self::OperatorExpected { offset, .. }
            | Self::UnclosedParenthesis { offset }
            | Self::UnopenedParenthesis { offset }
            | Self::UnclosedQuote { offset }
            | Self::UnknownEscape { offset }
            | Self::UnknownLeaf { offset, .. } => *offset,
        }
    }
}

/// Reads an expression. `resolve` turns a name into a leaf; it is asked once per occurrence, from left to right.
///
/// # Errors
/// The first thing wrong in the text, with its place; a parenthesis that is never closed is found at the end.
pub fn parse(text: &str, resolve: &mut dyn FnMut(&str) -> Option<LeafId>) -> Result<Tree, ExpressionError> {
    // Every node takes at least one byte of text, so this also bounds the number of nodes.
    if u32::try_from(text.len()).is_err() {
        return Err(ExpressionError::TooLong { bytes: text.len() });
    }
    let mut reader = Reader { text, at: 0, builder: TreeBuilder::default(), waiting: Vec::new() };
    while reader.operand(resolve)? && reader.operator()? {}
    reader.finish()
}

/// What waits for its right operand, or for its closing parenthesis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Waiting {
    Not,
    And,
    Or,
    Minus,
    Open { offset: usize },
}

impl Waiting {
    /// How tightly an operator binds; parentheses hold everything back.
    fn binding(self) -> u8 {
        match self {
            Self::Open { .. } => 0,
            Self::Or | Self::Minus => 1,
            Self::And => 2,
            Self::Not => 3,
        }
    }
}

struct Reader<'a> {
    text: &'a str,
    /// The offset of the next character.
    at: usize,
    builder: TreeBuilder,
    waiting: Vec<Waiting>,
}

impl<'a> Reader<'a> {
    /// The next character that is no white space, not yet taken.
    fn peek(&mut self) -> Option<char> {
        self.at = self.text.len() - self.text[self.at..].trim_start().len();
        self.text[self.at..].chars().next()
    }

    /// Reads `!`s and `(`s up to a leaf, and the leaf. True unless the text is empty, which [`Self::finish`] reports.
    fn operand(&mut self, resolve: &mut dyn FnMut(&str) -> Option<LeafId>) -> Result<bool, ExpressionError> {
        loop {
            let offset = self.at_next();
            match self.peek() {
                Some('!') => {
                    self.waiting.push(Waiting::Not);
                    self.at += 1;
                }
                Some('(') => {
                    self.waiting.push(Waiting::Open { offset });
                    self.at += 1;
                }
                Some(c) if c == '"' || is_name_char(c) => {
                    let name = if c == '"' { self.quoted_name()? } else { Cow::Borrowed(self.plain_name()) };
                    match resolve(&name) {
                        Some(id) => self.builder.leaf(id),
                        None => return Err(ExpressionError::UnknownLeaf { offset, name: name.into_owned() }),
                    };
                    return Ok(true);
                }
                None if self.text.trim_start().is_empty() => return Err(ExpressionError::Empty),
                found => {
                    let mend = mend_operand(found);
                    return Err(ExpressionError::OperandExpected { offset, found: quote(found), mend });
                }
            }
        }
    }

    /// Reads closing parentheses up to an operator, and the operator. False at the end of the text.
    fn operator(&mut self) -> Result<bool, ExpressionError> {
        loop {
            let offset = self.at_next();
            let operator = match self.peek() {
                Some('|') => Waiting::Or,
                Some('&') => Waiting::And,
                Some('-') => Waiting::Minus,
                Some(')') => {
                    self.release(Waiting::Or.binding());
                    // What is left on top, if anything, is the parenthesis.
                    if self.waiting.pop().is_none() {
                        return Err(ExpressionError::UnopenedParenthesis { offset });
                    }
                    self.at += 1;
                    continue;
                }
                None => return Ok(false),
                found => {
                    let mend = mend_operator(found);
                    return Err(ExpressionError::OperatorExpected { offset, found: quote(found), mend });
                }
            };
            // Equal binding releases too: operators are left-associative.
            self.release(operator.binding());
            self.waiting.push(operator);
            self.at += 1;
            return Ok(true);
        }
    }

    /// Builds every waiting operator that binds at least so tightly, the newest first.
    fn release(&mut self, at_least: u8) {
        while let Some(&operator) = self.waiting.last().filter(|operator| operator.binding() >= at_least) {
            self.waiting.pop();
            match operator {
                Waiting::Not => self.builder.not(),
                Waiting::And => self.builder.and(),
                Waiting::Or => self.builder.or(),
                Waiting::Minus => self.builder.minus(),
                Waiting::Open { .. } => unreachable!("a parenthesis binds less tightly than any operator"),
            };
        }
    }

    fn finish(mut self) -> Result<Tree, ExpressionError> {
        self.release(Waiting::Or.binding());
        match self.waiting.last() {
            Some(Waiting::Open { offset }) => Err(ExpressionError::UnclosedParenthesis { offset: *offset }),
            _ => Ok(self.builder.finish().expect("operands and operators alternate, so one tree is left")),
        }
    }

    /// Skips white space; the offset of what follows.
    fn at_next(&mut self) -> usize {
        self.peek();
        self.at
    }

    /// Takes a name of letters, digits and `_`.
    fn plain_name(&mut self) -> &'a str {
        let rest = &self.text[self.at..];
        let name = &rest[..rest.find(|c| !is_name_char(c)).unwrap_or(rest.len())];
        self.at += name.len();
        name
    }

    /// Takes a quoted name, from its opening quote on.
    fn quoted_name(&mut self) -> Result<Cow<'a, str>, ExpressionError> {
        let opening = self.at;
        let mut start = opening + 1;
        let mut name = Cow::Borrowed("");
        loop {
            let Some(length) = self.text[start..].find(['"', '\\']) else {
                return Err(ExpressionError::UnclosedQuote { offset: opening });
            };
            name += &self.text[start..start + length];
            let special = start + length;
            // Both characters are one byte long, so these indices are character borders.
            if self.text[special..].starts_with('"') {
                self.at = special + 1;
                return Ok(name);
            }
            match self.text[special + 1..].chars().next() {
                Some(escaped @ ('"' | '\\')) => name.to_mut().push(escaped),
                Some(_) => return Err(ExpressionError::UnknownEscape { offset: special }),
                None => return Err(ExpressionError::UnclosedQuote { offset: opening }),
            }
            start = special + 2;
        }
    }
}

/// What was found, ready to print.
fn quote(found: Option<char>) -> String {
    match found {
        None => "the end".into(),
        Some(c) if c.is_control() => format!("the character {}", c.escape_unicode()),
        Some(c) => format!("`{c}`"),
    }
}

/// How to mend what stands in an operand's place.
fn mend_operand(found: Option<char>) -> &'static str {
    match found {
        None => "add the operand that is missing, or remove the operator before it",
        Some('&') => "an `&` stands between two operands, and one is enough",
        Some('|') => "a `|` stands between two operands, and one is enough",
        Some('-') => "a `-` stands between two operands; a complement is written `!`",
        Some(')') => "put an operand before the `)`",
        Some('~' | '¬' | '^') => "a complement is written `!`",
        Some('\'') => "a name is quoted with `\"`",
        Some(_) => "a name with other characters than letters, digits and `_` must be quoted with `\"`",
    }
}

/// How to mend what stands in an operator's place.
fn mend_operator(found: Option<char>) -> &'static str {
    match found {
        Some('+' | '∪' | '∨') => "a union is written `|`",
        Some('*' | '∩' | '∧' | '^' | '×' | '·') => "an intersection is written `&`",
        Some('\\' | '∖' | '−' | '–' | '/') => "a difference is written `-`",
        Some('\'' | '!') => "a complement is written `!`, before its operand and after an operator",
        Some('(') => "write an operator before the `(`",
        Some(c) if c == '"' || is_name_char(c) => {
            "write an operator between two operands, or quote a name that has spaces with `\"`"
        }
        _ => "a name with other characters than letters, digits and `_` must be quoted with `\"`",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Knows one-letter names, and `the "big" \ one` as leaf 100.
    fn known(name: &str) -> Option<LeafId> {
        match name.as_bytes() {
            [letter @ b'a'..=b'z'] => Some(LeafId(u32::from(letter - b'a'))),
            _ => (name == r#"the "big" \ one"#).then_some(LeafId(100)),
        }
    }

    fn read(text: &str) -> Result<Tree, ExpressionError> {
        parse(text, &mut known)
    }

    fn leaf(name: char) -> Tree {
        Tree::leaf(LeafId(u32::from(name) - u32::from('a')))
    }

    #[test]
    fn precedence_and_associativity() {
        let (a, b, c) = (leaf('a'), leaf('b'), leaf('c'));
        let cases = [
            ("a", a.clone()),
            ("a-b-c", Tree::minus(Tree::minus(a.clone(), b.clone()), c.clone())),
            ("a - (b - c)", Tree::minus(a.clone(), Tree::minus(b.clone(), c.clone()))),
            ("a - b | c", Tree::or(Tree::minus(a.clone(), b.clone()), c.clone())),
            ("a | b - c", Tree::minus(Tree::or(a.clone(), b.clone()), c.clone())),
            ("a | b & c", Tree::or(a.clone(), Tree::and(b.clone(), c.clone()))),
            ("a & b - c", Tree::minus(Tree::and(a.clone(), b.clone()), c.clone())),
            ("!a & b", Tree::and(Tree::not(a.clone()), b.clone())),
            ("!(a & b)", Tree::not(Tree::and(a.clone(), b.clone()))),
            ("!!a", Tree::not(Tree::not(a.clone()))),
            ("a - !b", Tree::minus(a.clone(), Tree::not(b.clone()))),
            ("\t( ( a )\n)\u{a0}|\r\nb ", Tree::or(a.clone(), b.clone())),
            ("a&\"b\"", Tree::and(a.clone(), b.clone())),
        ];
        for (text, tree) in cases {
            assert_eq!(read(text), Ok(tree), "{text}");
        }
    }

    #[test]
    fn quoted_names() {
        let text = r#""the \"big\" \\ one""#;
        assert_eq!(read(text), Ok(Tree::leaf(LeafId(100))));
        assert_eq!(Tree::leaf(LeafId(100)).display(|_| r#"the "big" \ one"#).to_string(), text);
    }

    #[test]
    fn names_are_asked_for_from_left_to_right() {
        let mut asked = Vec::new();
        let tree = parse("drill_2 - (\"a b\" | Schäfer)", &mut |name| {
            asked.push(name.to_owned());
            Some(LeafId(0))
        });
        assert!(tree.is_ok());
        assert_eq!(asked, ["drill_2", "a b", "Schäfer"]);
    }

    /// An error's kind, by its offset and a part of its message.
    fn assert_error(text: &str, offset: usize, message: &str) {
        let error = read(text).expect_err(text);
        assert_eq!(error.offset(), offset, "{text}: {error}");
        assert!(error.to_string().contains(message), "{text}: {error}");
    }

    #[test]
    fn errors_say_where_what_and_how_to_mend() {
        assert_error("", 0, "the expression is empty");
        assert_error(" \n ", 0, "the expression is empty");
        assert_error("a |", 3, "but found the end: add the operand");
        assert_error("a |  ", 5, "but found the end");
        assert_error("a || b", 3, "one is enough");
        assert_error("a && b", 3, "one is enough");
        assert_error("-a", 0, "a complement is written `!`");
        assert_error("~a", 0, "a complement is written `!`");
        assert_error("a | ¬b", 4, "found `¬`");
        assert_error("()", 1, "put an operand before");
        assert_error("(", 1, "found the end");
        assert_error("(a", 0, "never closed");
        assert_error("a & ((b | c)", 4, "never closed");
        assert_error("(a | (b & c", 5, "never closed");
        assert_error("a)", 1, "closes nothing");
        assert_error("(a) | b) & c", 7, "closes nothing");
        assert_error("a b", 2, "found `b`: write an operator between");
        assert_error("a (b)", 2, "write an operator before");
        assert_error("(a)(b)", 3, "write an operator before");
        assert_error("a + b", 2, "a union is written `|`");
        assert_error("é", 0, "no leaf named `é`");
        assert_error("a ∩ b", 2, "an intersection is written `&`");
        assert_error("a \\ b", 2, "a difference is written `-`");
        assert_error("a !b", 2, "after an operator");
        assert_error("a' ", 1, "before its operand");
        assert_error("a.ply", 1, "must be quoted");
        assert_error("a\0", 1, "found the character \\u{0}");
        assert_error("a | nose", 4, "no leaf named `nose`");
        assert_error("a | \"b c\"", 4, "no leaf named `b c`");
        assert_error("a - \"\"", 4, "no leaf named ``");
        assert_error("a | \"b", 4, "never ends");
        assert_error("a | \"b\\", 4, "never ends");
        assert_error("a | \"b\\\"", 4, "never ends");
        assert_error("a | \"b\\n\"", 6, "may follow a backslash");
        assert_error("ä | \"b\\é\"", 0, "no leaf named `ä`");
        assert_error("a | \"\\é\"", 5, "may follow a backslash");
    }

    #[test]
    fn an_unknown_leaf_carries_its_name() {
        let error = ExpressionError::UnknownLeaf { offset: 2, name: "no \"se".into() };
        assert_eq!(read("a-\"no \\\"se\""), Err(error));
    }

    #[test]
    fn no_text_makes_it_panic() {
        // Half tokens, half arbitrary bytes made text as a file reader would.
        const TOKENS: [&str; 16] =
            ["a", "b", "!", "(", ")", "|", "&", "-", " ", "\"", "\\", "é", "\u{2003}", "∪", "\0", "zz"];
        let mut state = 1u64;
        let mut random = move |bound: usize| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as usize % bound
        };
        let mut valid = 0;
        for round in 0..200_000 {
            let length = random(12);
            let text = if round % 4 == 0 {
                let bytes: Vec<u8> = (0..length).map(|_| random(256) as u8).collect();
                String::from_utf8_lossy(&bytes).into_owned()
            } else {
                (0..length).map(|_| TOKENS[random(TOKENS.len())]).collect()
            };
            match parse(&text, &mut |_| Some(LeafId(0))) {
                Ok(tree) => {
                    valid += 1;
                    let printed = tree.display(|_| "x").to_string();
                    assert_eq!(parse(&printed, &mut |_| Some(LeafId(0))), Ok(tree), "{text:?}");
                }
                Err(error) => assert!(text.is_char_boundary(error.offset()), "{text:?}: {error}"),
            }
        }
        assert!(valid > 1000, "the tokens must make expressions too: {valid}");
    }
}
