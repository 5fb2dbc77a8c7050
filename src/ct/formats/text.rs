//! Headers that are text: lines, numbers and words in them.

use super::Fault;

/// Longest text header that is believed.
pub(super) const LONGEST_HEADER: usize = 1 << 20;

/// Characters of a field that are quoted.
const LONGEST_QUOTE: usize = 40;
/// Longest word of the formats: `left-anterior-superior-time`.
const LONGEST_KEYWORD: usize = 27;

/// Whether a text is numbers, vectors of them and at most one keyword, however often it occurs.
fn is_quotable(text: &str) -> bool {
    let words = text.split(|c: char| c.is_whitespace() || "(),\"".contains(c)).filter(|w| !w.is_empty());
    let mut keywords = words.filter(|w| w.parse::<f64>().is_err());
    let Some(first) = keywords.next() else { return true };
    let is_keyword = |w: &str| {
        w.len() <= LONGEST_KEYWORD && w.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_".contains(&b))
    };
    is_keyword(first) && keywords.all(|w| w == first)
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
    /// A header may hold anything, a patient's name too: numbers and a keyword are quoted, other text is not.
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
