//! The header of a PLY file, bounded against the file's size before anything is allocated by what it says.

use crate::formats::error::{CUT_OFF, Fault, Place, quote};
use crate::formats::text::{Line, Separators, Words};

/// How the body is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// The type of one value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    /// Both spellings of every type: the original ones and those with sizes.
    fn named(name: &[u8]) -> Option<Self> {
        Some(match name {
            b"char" | b"int8" => Self::I8,
            b"uchar" | b"uint8" => Self::U8,
            b"short" | b"int16" => Self::I16,
            b"ushort" | b"uint16" => Self::U16,
            b"int" | b"int32" => Self::I32,
            b"uint" | b"uint32" => Self::U32,
            b"float" | b"float32" => Self::F32,
            b"double" | b"float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of a value.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    pub fn is_real(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

/// What a property holds in each row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Debug, Clone)]
pub struct Property {
    pub name: String,
    pub kind: Kind,
}

#[derive(Debug, Clone)]
pub struct Element {
    pub name: String,
    pub rows: u64,
    pub properties: Vec<Property>,
    /// The header's line that declares it.
    pub line: u64,
}

impl Element {
    /// The least bytes that a row can take in the body; 0 only without properties.
    pub fn least_row_bytes(&self, encoding: Encoding) -> u64 {
        let each = |property: &Property| match (encoding, property.kind) {
            // A digit and a blank or line end. (The file's last row may lack the line end: see `check_rows`.)
            (Encoding::Ascii, _) => 2,
            (_, Kind::Scalar(scalar)) => scalar.size() as u64,
            (_, Kind::List { count, .. }) => count.size() as u64,
        };
        self.properties.iter().map(each).sum()
    }

    /// Refuses more rows than `available` bytes of body can hold.
    pub fn check_rows(&self, encoding: Encoding, available: u64) -> Result<(), Fault> {
        let missing_line_end = u64::from(encoding == Encoding::Ascii);
        let least = self.least_row_bytes(encoding);
        if u128::from(self.rows) * u128::from(least) > u128::from(available) + u128::from(missing_line_end) {
            let what = format!(
                "element {} has {} rows of at least {least} bytes, but only {available} bytes follow",
                self.name, self.rows
            );
            return Err(Fault::malformed(Place::Line(self.line), what, CUT_OFF));
        }
        Ok(())
    }

    pub fn position(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name)
    }
}

#[derive(Debug, Clone)]
pub struct Header {
    pub encoding: Encoding,
    pub elements: Vec<Element>,
    /// Where the body begins.
    pub body_byte: usize,
    /// The body's first line.
    pub body_line: u64,
}

/// The longest header taken. 3DGS files have some 70 lines; a scan's comments a few hundred.
const LONGEST_HEADER: usize = 1 << 20;

/// Lines of a header, which end as its first line does: a `\n` after a lone-`\r` header is the body's first byte.
struct HeaderLines<'a> {
    bytes: &'a [u8],
    at: usize,
    number: u64,
    end: u8,
}

impl<'a> HeaderLines<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        let end = match bytes.iter().position(|b| matches!(b, b'\r' | b'\n')) {
            Some(at) if bytes[at] == b'\r' && bytes.get(at + 1) != Some(&b'\n') => b'\r',
            _ => b'\n',
        };
        Self { bytes: &bytes[..bytes.len().min(LONGEST_HEADER)], at: 0, number: 0, end }
    }

    fn next(&mut self) -> Result<Line<'a>, Fault> {
        let rest = &self.bytes[self.at..];
        self.number += 1;
        let Some(length) = rest.iter().position(|&b| b == self.end) else {
            // `end_header` may be the last line of a file without rows.
            if rest == b"end_header" {
                self.at = self.bytes.len();
                return Ok(Line { bytes: rest, number: self.number });
            }
            let what = format!("the header has no line end_header within its first {} bytes", self.bytes.len());
            return Err(Fault::malformed(Place::Line(self.number), what, CUT_OFF));
        };
        self.at += length + 1;
        Ok(Line { bytes: rest[..length].trim_ascii_end(), number: self.number })
    }
}

/// Reads the header of `bytes` and checks its numbers of rows against the length of `bytes`.
pub fn parse(bytes: &[u8]) -> Result<Header, Fault> {
    let mut lines = HeaderLines::new(bytes);
    let first = lines.next()?;
    if first.bytes != b"ply" {
        let what = format!("the first line is {}, not 'ply'", quote(first.bytes));
        return Err(Fault::malformed(Place::Line(1), what, "this is not a PLY file"));
    }
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let line = lines.next()?;
        let place = Place::Line(line.number);
        let mut words = Words::new(line, Separators::Blanks);
        let Some(keyword) = words.next() else { continue };
        let mut word = || words.next().map_or(&b""[..], |word| word.bytes);
        match keyword.bytes {
            b"comment" | b"obj_info" => {}
            b"end_header" => break,
            b"format" => {
                let (name, version) = (word(), word());
                encoding = Some(match name {
                    b"ascii" => Encoding::Ascii,
                    b"binary_little_endian" => Encoding::LittleEndian,
                    b"binary_big_endian" => Encoding::BigEndian,
                    _ => {
                        let what = format!("unknown format {}", quote(name));
                        let mend = "the formats are ascii, binary_little_endian and binary_big_endian";
                        return Err(Fault::malformed(place, what, mend));
                    }
                });
                if version != b"1.0" {
                    let what = format!("unknown version {}", quote(version));
                    return Err(Fault::malformed(place, what, "only version 1.0 exists"));
                }
            }
            b"element" => elements.push(element(word(), word(), line)?),
            b"property" => {
                let property = property(&mut word, line)?;
                let Some(element) = elements.last_mut() else {
                    let what = format!("property {} comes before any element", property.name);
                    return Err(Fault::malformed(place, what, "declare its element first"));
                };
                element.properties.push(property);
            }
            other => {
                let what = format!("unknown keyword {}", quote(other));
                let mend = "a header has the keywords format, comment, obj_info, element, property and end_header";
                return Err(Fault::malformed(place, what, mend));
            }
        }
    }
    let Some(encoding) = encoding else {
        return Err(Fault::malformed(
            Place::Line(2),
            "the header has no line 'format'",
            "add 'format ascii 1.0' or alike",
        ));
    };
    let header = Header { encoding, elements, body_byte: lines.at, body_line: lines.number + 1 };
    let mut available = (bytes.len() - header.body_byte) as u64;
    for element in &header.elements {
        element.check_rows(encoding, available)?;
        available = available.saturating_sub(element.rows.saturating_mul(element.least_row_bytes(encoding)));
    }
    Ok(header)
}

fn element(name: &[u8], rows: &[u8], line: Line) -> Result<Element, Fault> {
    let parsed = std::str::from_utf8(rows).ok().and_then(|rows| rows.parse().ok());
    match parsed {
        Some(rows) if !name.is_empty() => {
            let name = String::from_utf8_lossy(name).into_owned();
            Ok(Element { name, rows, properties: Vec::new(), line: line.number })
        }
        _ => {
            let what = format!("{} is no element's declaration", quote(line.bytes));
            Err(Fault::malformed(Place::Line(line.number), what, "write 'element NAME NUMBER-OF-ROWS'"))
        }
    }
}

fn property<'a>(word: &mut impl FnMut() -> &'a [u8], line: Line) -> Result<Property, Fault> {
    let scalar = |name: &[u8]| {
        Scalar::named(name).ok_or_else(|| {
            let what = format!("unknown type {} in {}", quote(name), quote(line.bytes));
            let mend = "the types are char uchar short ushort int uint float double, or int8 uint8 … float32 float64";
            Fault::malformed(Place::Line(line.number), what, mend)
        })
    };
    let kind = match word() {
        b"list" => Kind::List { count: scalar(word())?, item: scalar(word())? },
        name => Kind::Scalar(scalar(name)?),
    };
    let name = word();
    if name.is_empty() {
        let what = format!("{} names no property", quote(line.bytes));
        return Err(Fault::malformed(Place::Line(line.number), what, "write 'property TYPE NAME'"));
    }
    if let Kind::List { count, .. } = kind
        && count.is_real()
    {
        let what = format!("list {} is counted by a real number", quote(name));
        return Err(Fault::malformed(Place::Line(line.number), what, "count lists by an integer type"));
    }
    Ok(Property { name: String::from_utf8_lossy(name).into_owned(), kind })
}
