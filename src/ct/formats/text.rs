//! Headers that are text: lines, numbers and words in them.

use super::Fault;
use crate::ct::quote::is_plain_number;

/// Longest text header that is believed.
pub(super) const LONGEST_HEADER: usize = 1 << 20;

/// Characters of a field that are quoted.
const LONGEST_QUOTE: usize = 40;
/// Words of the formats and of their relatives, and what is taken for one: nothing else is quoted.
#[rustfmt::skip]
const WORDS: [&str; 95] = [
    // Types.
    "bool", "signed", "unsigned", "char", "uchar", "short", "ushort", "int", "uint", "long", "ulong", "longlong", "ulonglong",
    "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float", "double", "half", "block", "complex",
    "met_char", "met_uchar", "met_short", "met_ushort", "met_int", "met_uint", "met_long", "met_ulong", "met_long_long",
    "met_ulong_long", "met_float", "met_double", "met_string", "met_none", "met_other", "met_char_array", "met_uchar_array",
    // Encodings.
    "raw", "txt", "text", "ascii", "hex", "gz", "gzip", "bz2", "bzip2", "zip", "zlib", "little", "big", "middle", "true", "false",
    // Spaces.
    "left-posterior-superior", "right-anterior-superior", "left-anterior-superior", "left-posterior", "lps", "ras", "las",
    "right-anterior-superior-time", "left-anterior-superior-time", "left-posterior-superior-time", "scanner-xyz",
    "scanner-xyz-time", "3d-right-handed", "3d-left-handed",
    // Axes and units.
    "none", "???", "x", "domain", "space", "time", "list", "vector", "rgb-color", "point", "nan", "inf", "-inf", "m", "cm", "mm",
    "um", "nm", "km", "in", "inch", "ft",
];

/// Whether a text is short numbers, vectors of them and words of the formats.
fn is_quotable(text: &str) -> bool {
    let mut words = text.split(|c: char| c.is_whitespace() || "(),\"".contains(c)).filter(|w| !w.is_empty());
    words.all(|w| is_plain_number(w) || WORDS.iter().any(|known| w.eq_ignore_ascii_case(known)))
}

/// The lines of a header, each with the place where the next one begins; what is not UTF-8 is replaced.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (String, usize)> + '_ {
    let mut at = 0;
    let bytes = &bytes[..bytes.len().min(LONGEST_HEADER)];
    std::iter::from_fn(move || {
        let rest = &bytes[at..];
        let end = rest.iter().position(|&b| b == b'\n')?;
        at += end + 1;
        Some((String::from_utf8_lossy(&rest[..end]).trim_end_matches('\r').to_owned(), at))
    })
}

/// A field of a header, for errors.
#[derive(Clone, Copy)]
pub(super) struct Field<'a> {
    pub(super) format: &'static str,
    pub(super) name: &'static str,
    pub(super) text: &'a str,
}

impl Field<'_> {
    /// A header may hold anything, a patient's name too: short numbers and words of the format are quoted, other text is not.
    pub(super) fn fault(&self, expected: &'static str) -> Fault {
        let short: String = self.text.chars().take(LONGEST_QUOTE).collect();
        let found = if is_quotable(self.text) { format!("{short:?}") } else { "some text".to_owned() };
        Fault::Field { format: self.format, field: self.name, found, expected }
    }

    /// Numbers separated by blanks.
    pub(super) fn numbers(&self) -> Result<Vec<f64>, Fault> {
        let parsed: Option<Vec<f64>> = self.text.split_whitespace().map(|t| t.parse().ok()).collect();
        parsed.filter(|n| n.iter().all(|v: &f64| v.is_finite())).ok_or_else(|| self.fault("finite numbers"))
    }

    /// Whole numbers separated by blanks.
    pub(super) fn whole_numbers(&self) -> Result<Vec<i64>, Fault> {
        let parsed: Option<Vec<i64>> = self.text.split_whitespace().map(|t| t.parse().ok()).collect();
        parsed.ok_or_else(|| self.fault("whole numbers"))
    }
}
