//! Reading typed values out of parsed TOML, every failure with its line and column.
//!
//! A [`Table`] knows which keys may stand in it, so that a mistyped key is an error and never silently ignored; a
//! [`Field`] is one value with the name by which messages call it.

use std::ops::Range;

use glam::DVec3;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::colour;
use super::nearest_name::nearest_name;
use super::toml_file::{Place, SceneError, SceneProblem};

/// The text of a scene file, to turn byte offsets into places.
#[derive(Clone, Copy)]
pub(super) struct Source<'t> {
    /// The whole file.
    pub text: &'t str,
}

impl<'t> Source<'t> {
    /// `problem` at byte offset `byte`.
    pub fn error(self, byte: usize, problem: SceneProblem) -> SceneError {
        SceneError { place: Place::of_byte(self.text, byte), problem }
    }
}

/// A table whose keys have been checked against the known ones.
pub(super) struct Table<'t> {
    source: Source<'t>,
    /// What messages call it: `[leaf.femur]`, `the top level`.
    pub name: String,
    span: Range<usize>,
    entries: &'t DeTable<'t>,
}

impl<'t> Table<'t> {
    /// Checks every key of `entries` against `known`; a known key's other spellings follow it after `|`.
    pub fn open(
        source: Source<'t>,
        name: impl Into<String>,
        span: Range<usize>,
        entries: &'t DeTable<'t>,
        known: &[&str],
    ) -> Result<Self, SceneError> {
        let name = name.into();
        // The first mistake in the file, not in the alphabet.
        let stray = entries
            .keys()
            .filter(|key| !known.iter().any(|k| k.split('|').any(|spelling| spelling == key.get_ref())))
            .min_by_key(|key| key.span().start);
        if let Some(key) = stray {
            let spellings = known.iter().flat_map(|k| k.split('|'));
            return Err(source.error(
                key.span().start,
                SceneProblem::UnknownKey {
                    key: key.get_ref().to_string(),
                    table: name,
                    suggestion: nearest_name(key.get_ref(), spellings).map(str::to_owned),
                    known: known.iter().map(|k| k.split('|').next().unwrap_or(k).to_owned()).collect(),
                },
            ));
        }
        Ok(Self { source, name, span, entries })
    }

    /// The value of a key, by any of its spellings (separated by `|`); two spellings at once are an error.
    pub fn get(&self, spellings: &str) -> Result<Option<Field<'t>>, SceneError> {
        let mut found: Option<Field<'t>> = None;
        for spelling in spellings.split('|') {
            let Some((key, value)) = self.entries.get_key_value(spelling) else { continue };
            if let Some(first) = &found {
                let (a, b) = (first.name.clone(), key.get_ref().to_string());
                return Err(self.source.error(key.span().start, SceneProblem::Clash { first: a, second: b }));
            }
            found = Some(Field { source: self.source, name: spelling.to_owned(), key_start: key.span().start, value });
        }
        Ok(found)
    }

    /// As [`get`](Self::get), for a key that must be there; `form` says what to write.
    pub fn require(&self, spellings: &str, form: &str) -> Result<Field<'t>, SceneError> {
        self.get(spellings)?.ok_or_else(|| {
            let key = spellings.split('|').next().unwrap_or(spellings).to_owned();
            let form = form.to_owned();
            self.error(SceneProblem::MissingKey { table: self.name.clone(), key, form })
        })
    }

    /// `problem`, at the table itself.
    pub fn error(&self, problem: SceneProblem) -> SceneError {
        self.source.error(self.span.start, problem)
    }
}

/// One value with its name.
pub(super) struct Field<'t> {
    source: Source<'t>,
    /// What messages call it.
    pub name: String,
    /// Byte offset of its key.
    pub key_start: usize,
    value: &'t Spanned<DeValue<'t>>,
}

impl<'t> Field<'t> {
    /// `problem`, at the value.
    pub fn error(&self, problem: SceneProblem) -> SceneError {
        self.source.error(self.value.span().start, problem)
    }

    /// The value cannot be used: `problem` says why, `mend` what to write.
    pub fn bad(&self, problem: impl Into<String>, mend: impl Into<String>) -> SceneError {
        self.error(SceneProblem::BadValue { key: self.name.clone(), problem: problem.into(), mend: mend.into() })
    }

    fn wrong_type(&self, wanted: &str) -> SceneError {
        let found = match self.value.get_ref() {
            DeValue::String(_) => "a string",
            DeValue::Integer(_) | DeValue::Float(_) => "a number",
            DeValue::Boolean(_) => "true or false",
            DeValue::Datetime(_) => "a date",
            DeValue::Array(_) => "a list",
            DeValue::Table(_) => "a table",
        };
        self.error(SceneProblem::WrongType { key: self.name.clone(), wanted: wanted.to_owned(), found })
    }

    /// Text.
    pub fn text(&self, wanted: &str) -> Result<&'t str, SceneError> {
        self.value.get_ref().as_str().ok_or_else(|| self.wrong_type(wanted))
    }

    /// True or false.
    pub fn flag(&self) -> Result<bool, SceneError> {
        self.value.get_ref().as_bool().ok_or_else(|| self.wrong_type("true or false"))
    }

    /// A finite number.
    pub fn number(&self) -> Result<f64, SceneError> {
        self.number_or(self.value, "a number")
    }

    fn number_or(&self, value: &Spanned<DeValue<'t>>, wanted: &str) -> Result<f64, SceneError> {
        let number = match value.get_ref() {
            // Beyond i64 no length makes sense, but a float still holds it.
            DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix())
                .map(|n| n as f64)
                .ok()
                .or_else(|| (i.radix() == 10).then(|| i.as_str().parse().ok()).flatten()),
            DeValue::Float(f) => f.as_str().parse().ok(),
            _ => return Err(self.wrong_type(wanted)),
        };
        match number {
            Some(number) if number.is_finite() => Ok(number),
            _ => Err(self.source.error(
                value.span().start,
                SceneProblem::BadValue {
                    key: self.name.clone(),
                    problem: format!("{} is not a finite number", &self.source.text[value.span()]),
                    mend: "write a finite number".into(),
                },
            )),
        }
    }

    /// A finite number above zero.
    pub fn positive(&self) -> Result<f64, SceneError> {
        let number = self.number()?;
        if number > 0.0 {
            Ok(number)
        } else {
            Err(self.bad(format!("{number} is not positive"), "make it larger than 0"))
        }
    }

    /// A number from 0 to 1.
    pub fn share(&self) -> Result<f32, SceneError> {
        let number = self.number()?;
        if (0.0..=1.0).contains(&number) {
            Ok(number as f32)
        } else {
            Err(self.bad(format!("{number} is not a share"), "write a number from 0 to 1"))
        }
    }

    /// Exactly `N` finite numbers.
    pub fn numbers<const N: usize>(&self, wanted: &str) -> Result<[f64; N], SceneError> {
        let array = self.value.get_ref().as_array().ok_or_else(|| self.wrong_type(wanted))?;
        if array.len() != N {
            return Err(self.bad(format!("it has {} entries", array.len()), format!("write {wanted}")));
        }
        let mut numbers = [0.0; N];
        for (number, value) in numbers.iter_mut().zip(array.iter()) {
            *number = self.number_or(value, wanted)?;
        }
        Ok(numbers)
    }

    /// A point or vector `[x, y, z]`.
    pub fn vector(&self) -> Result<DVec3, SceneError> {
        self.numbers::<3>("[x, y, z]").map(DVec3::from_array)
    }

    /// A direction `[x, y, z]`, normalised.
    pub fn direction(&self) -> Result<DVec3, SceneError> {
        let vector = self.vector()?;
        vector.try_normalize().ok_or_else(|| self.bad("its length is 0", "write a direction such as [0, 0, 1]"))
    }

    /// Whether it is a single number, where a list may stand as well.
    pub fn is_number(&self) -> bool {
        self.value.get_ref().is_integer() || self.value.get_ref().is_float()
    }

    /// Whether it is text, where a table may stand as well.
    pub fn is_text(&self) -> bool {
        self.value.get_ref().is_str()
    }

    /// Whether it is a list, where something else may stand as well.
    pub fn is_list(&self) -> bool {
        self.value.get_ref().is_array()
    }

    /// Linear RGB.
    pub fn colour(&self) -> Result<[f32; 3], SceneError> {
        let wanted = colour::COLOUR_FORMS;
        if self.is_list() {
            let srgb = self.numbers::<3>(wanted)?;
            if !srgb.iter().all(|c| (0.0..=1.0).contains(c)) {
                return Err(self.bad("a value lies outside 0 to 1", "write sRGB values from 0 to 1, not 0 to 255"));
            }
            return Ok(srgb.map(|c| colour::linear_from_srgb(c as f32)));
        }
        let text = self.text(wanted)?;
        colour::parse(text).ok_or_else(|| self.bad(format!("\"{text}\" is no colour"), format!("write {wanted}")))
    }

    /// A whole number.
    pub fn whole(&self, wanted: &str) -> Result<[u32; 2], SceneError> {
        let pair = self.numbers::<2>(wanted)?;
        if pair.iter().all(|n| n.fract() == 0.0 && *n >= 0.0 && *n <= f64::from(u32::MAX)) {
            Ok(pair.map(|n| n as u32))
        } else {
            Err(self.bad(format!("[{}, {}] are not two counts", pair[0], pair[1]), format!("write {wanted}")))
        }
    }

    /// The entries of a list, each a field of the same name.
    pub fn list(&self, wanted: &str) -> Result<Vec<Field<'t>>, SceneError> {
        let array = self.value.get_ref().as_array().ok_or_else(|| self.wrong_type(wanted))?;
        let field = |value| Field { source: self.source, name: self.name.clone(), key_start: self.key_start, value };
        Ok(array.iter().map(field).collect())
    }

    /// A table with the given known keys.
    pub fn table(&self, name: impl Into<String>, known: &[&str], wanted: &str) -> Result<Table<'t>, SceneError> {
        let entries = self.value.get_ref().as_table().ok_or_else(|| self.wrong_type(wanted))?;
        Table::open(self.source, name, self.value.span(), entries, known)
    }

    /// A table whose keys are names of the user's own, in the order of the file.
    pub fn named_entries(&self, wanted: &str) -> Result<Vec<(&'t str, Field<'t>)>, SceneError> {
        let entries = self.value.get_ref().as_table().ok_or_else(|| self.wrong_type(wanted))?;
        let mut fields: Vec<_> = entries
            .iter()
            .map(|(key, value)| {
                let name = key.get_ref().to_string();
                (&**key.get_ref(), Field { source: self.source, name, key_start: key.span().start, value })
            })
            .collect();
        fields.sort_by_key(|(_, field)| field.key_start);
        Ok(fields)
    }

    /// The place of byte `offset` of a text value, as exact as escapes in it allow.
    pub fn error_within_text(&self, offset: usize, problem: SceneProblem) -> SceneError {
        let span = self.value.span();
        let text = self.value.get_ref().as_str().unwrap_or_default();
        // Without escapes the file holds the text itself, between its quotes.
        match self.source.text[span.clone()].find(text) {
            Some(start) => self.source.error(span.start + start + offset.min(text.len()), problem),
            None => self.error(problem),
        }
    }
}
