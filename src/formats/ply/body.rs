//! The rows of a PLY file, in its three encodings, as `f64` (which holds every PLY type exactly).

use super::header::{Element, Encoding, Header, Kind, Scalar};
use crate::formats::Progress;
use crate::formats::error::{CUT_OFF, Fault, Place, quote};
use crate::formats::text::{Lines, Words};

/// What is done with a property of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Use {
    Skip,
    /// Stored in `Row::values` at this index.
    Value(usize),
    /// Stored in `Row::list`.
    List,
}

/// The wanted values of one row.
#[derive(Debug)]
pub struct Row<'a> {
    pub values: &'a [f64],
    pub list: &'a [f64],
    pub place: Place,
}

/// Where values come from.
trait Source {
    /// Goes to the next row of `element`.
    fn begin_row(&mut self, element: &Element) -> Result<(), Fault>;
    fn scalar(&mut self, scalar: Scalar, name: &str) -> Result<f64, Fault>;
    fn skip(&mut self, scalar: Scalar, times: usize, name: &str) -> Result<(), Fault>;
    /// Refuses what the row holds beyond its properties.
    fn end_row(&mut self, element: &Element) -> Result<(), Fault>;
    fn place(&self) -> Place;
    /// Bytes from the body's beginning.
    fn consumed(&self) -> u64;
    fn total(&self) -> u64;
    /// The most values of a type that can still follow in this row.
    fn most(&self, scalar: Scalar) -> usize;
}

struct Binary<'a, const BIG: bool> {
    bytes: &'a [u8],
    at: usize,
    row_at: usize,
    body_byte: usize,
}

impl<const BIG: bool> Binary<'_, BIG> {
    #[cold]
    fn ends(&self, name: &str) -> Fault {
        let place = Place::Byte((self.body_byte + self.at) as u64);
        Fault::malformed(place, format!("the file ends within {name}"), CUT_OFF)
    }
}

impl<const BIG: bool> Source for Binary<'_, BIG> {
    #[inline]
    fn begin_row(&mut self, _element: &Element) -> Result<(), Fault> {
        self.row_at = self.at;
        Ok(())
    }

    #[inline]
    fn scalar(&mut self, scalar: Scalar, name: &str) -> Result<f64, Fault> {
        macro_rules! value {
            ($type:ty) => {{
                let Some(bytes) = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk()) else {
                    return Err(self.ends(name));
                };
                self.at += size_of::<$type>();
                if BIG { <$type>::from_be_bytes(*bytes).into() } else { <$type>::from_le_bytes(*bytes).into() }
            }};
        }
        Ok(match scalar {
            Scalar::F32 => value!(f32),
            Scalar::F64 => value!(f64),
            Scalar::U8 => value!(u8),
            Scalar::I32 => value!(i32),
            Scalar::U32 => value!(u32),
            Scalar::I8 => value!(i8),
            Scalar::I16 => value!(i16),
            Scalar::U16 => value!(u16),
        })
    }

    #[inline]
    fn skip(&mut self, scalar: Scalar, times: usize, name: &str) -> Result<(), Fault> {
        // `times` is at most `most`, or 1: no overflow.
        match self.at + scalar.size() * times {
            end if end <= self.bytes.len() => self.at = end,
            _ => return Err(self.ends(name)),
        }
        Ok(())
    }

    #[inline]
    fn end_row(&mut self, _element: &Element) -> Result<(), Fault> {
        Ok(())
    }

    #[inline]
    fn place(&self) -> Place {
        Place::Byte((self.body_byte + self.row_at) as u64)
    }

    fn consumed(&self) -> u64 {
        self.at as u64
    }

    fn total(&self) -> u64 {
        self.bytes.len() as u64
    }

    #[inline]
    fn most(&self, scalar: Scalar) -> usize {
        (self.bytes.len() - self.at) / scalar.size()
    }
}

/// One row a line.
struct Ascii<'a> {
    lines: Lines<'a>,
    words: Words<'a>,
    /// Bytes of the row's line.
    row_bytes: usize,
    total: u64,
}

impl Source for Ascii<'_> {
    #[inline]
    fn begin_row(&mut self, element: &Element) -> Result<(), Fault> {
        let Some(line) = self.lines.next_filled() else {
            let place = Place::Line(self.lines.number());
            return Err(Fault::malformed(place, format!("the file ends within element {}", element.name), CUT_OFF));
        };
        self.row_bytes = line.bytes.len();
        self.words = Words::new(line, crate::formats::text::Separators::Blanks);
        Ok(())
    }

    #[inline]
    fn scalar(&mut self, _scalar: Scalar, name: &str) -> Result<f64, Fault> {
        match self.words.next() {
            Some(word) => word.expect_number(),
            None => Err(missing(&self.words, name)),
        }
    }

    #[inline]
    fn skip(&mut self, _scalar: Scalar, times: usize, name: &str) -> Result<(), Fault> {
        for _ in 0..times {
            self.words.next().ok_or_else(|| missing(&self.words, name))?;
        }
        Ok(())
    }

    #[inline]
    fn end_row(&mut self, element: &Element) -> Result<(), Fault> {
        if let Some(word) = self.words.next() {
            let what = format!("{} follows after the last property of element {}", quote(word.bytes), element.name);
            let mend = "make the header's properties and the rows agree";
            return Err(Fault::malformed(word.place(), what, mend));
        }
        Ok(())
    }

    #[inline]
    fn place(&self) -> Place {
        Place::Line(self.lines.number())
    }

    fn consumed(&self) -> u64 {
        self.lines.consumed()
    }

    fn total(&self) -> u64 {
        self.total
    }

    #[inline]
    fn most(&self, _scalar: Scalar) -> usize {
        self.row_bytes
    }
}

#[cold]
fn missing(words: &Words, name: &str) -> Fault {
    Fault::malformed(
        words.place(),
        format!("the line ends before {name}"),
        "make the header's properties and the rows agree",
    )
}

/// The body of a file, read element by element in the header's order.
pub struct Body<'a> {
    encoding: Encoding,
    /// Only one of the three is in use.
    ascii: Ascii<'a>,
    little: Binary<'a, false>,
    big: Binary<'a, true>,
}

impl<'a> Body<'a> {
    pub fn new(file: &'a [u8], header: &Header) -> Self {
        let bytes = &file[header.body_byte..];
        let lines = Lines::new(bytes, header.body_line);
        let no_line = crate::formats::text::Line { bytes: b"", number: header.body_line };
        let words = Words::new(no_line, crate::formats::text::Separators::Blanks);
        Self {
            encoding: header.encoding,
            ascii: Ascii { lines, words, row_bytes: 0, total: bytes.len() as u64 },
            little: Binary { bytes, at: 0, row_at: 0, body_byte: header.body_byte },
            big: Binary { bytes, at: 0, row_at: 0, body_byte: header.body_byte },
        }
    }

    /// Reads all rows of `element`, the next one of the body, and hands each to `each`. `uses` says what is wanted of each
    /// property; an empty `uses` wants nothing.
    pub fn rows(
        &mut self,
        element: &Element,
        uses: &[Use],
        progress: &dyn Progress,
        each: impl FnMut(&Row) -> Result<(), Fault>,
    ) -> Result<(), Fault> {
        match self.encoding {
            Encoding::Ascii => rows(&mut self.ascii, self.encoding, element, uses, progress, each),
            Encoding::LittleEndian => rows(&mut self.little, self.encoding, element, uses, progress, each),
            Encoding::BigEndian => rows(&mut self.big, self.encoding, element, uses, progress, each),
        }
    }

    /// What follows after the last element: bytes, or lines with something in them.
    pub fn trailing(&mut self) -> u64 {
        match self.encoding {
            Encoding::Ascii => std::iter::from_fn(|| self.ascii.lines.next_filled()).count() as u64,
            Encoding::LittleEndian => self.little.total() - self.little.consumed(),
            Encoding::BigEndian => self.big.total() - self.big.consumed(),
        }
    }
}

fn rows<S: Source>(
    source: &mut S,
    encoding: Encoding,
    element: &Element,
    uses: &[Use],
    progress: &dyn Progress,
    mut each: impl FnMut(&Row) -> Result<(), Fault>,
) -> Result<(), Fault> {
    /// Rows between two reports of progress.
    const REPORT_ROWS: u64 = 8192;
    if element.properties.is_empty() {
        // Its rows are nothing at all (in ascii at most empty lines, which are skipped anyway), however many they are.
        return Ok(());
    }
    element.check_rows(encoding, source.total() - source.consumed())?;
    let is_value = |used: &&Use| matches!(used, Use::Value(_));
    let mut values = vec![0.0; uses.iter().filter(is_value).count()];
    let mut list = Vec::new();
    let mut reported = source.consumed();
    for row in 0..element.rows {
        source.begin_row(element)?;
        for (index, property) in element.properties.iter().enumerate() {
            let name = property.name.as_str();
            match (property.kind, uses.get(index).copied().unwrap_or(Use::Skip)) {
                (Kind::Scalar(scalar), Use::Value(slot)) => values[slot] = source.scalar(scalar, name)?,
                (Kind::Scalar(scalar), _) => source.skip(scalar, 1, name)?,
                (Kind::List { count, item }, used) => {
                    let place = source.place();
                    let length = source.scalar(count, name)?;
                    let most = source.most(item);
                    // Written so that NaN is refused.
                    if !(length >= 0.0 && length.fract() == 0.0 && length <= most as f64) {
                        let what = format!("list {name} claims {length} items, but at most {most} can follow");
                        return Err(Fault::malformed(place, what, CUT_OFF));
                    }
                    let length = length as usize;
                    if used == Use::List {
                        list.clear();
                        for _ in 0..length {
                            list.push(source.scalar(item, name)?);
                        }
                    } else {
                        source.skip(item, length, name)?;
                    }
                }
            }
        }
        source.end_row(element)?;
        each(&Row { values: &values, list: &list, place: source.place() })?;
        if row % REPORT_ROWS == REPORT_ROWS - 1 {
            progress.advance(source.consumed() - reported);
            reported = source.consumed();
        }
    }
    progress.advance(source.consumed() - reported);
    Ok(())
}
