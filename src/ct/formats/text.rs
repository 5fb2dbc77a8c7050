//! Headers that are text: lines, numbers and words in them.

use super::Fault;

/// Longest text header that is believed.
pub(super) const LONGEST_HEADER: usize = 1 << 20;

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
    pub(super) fn fault(&self, expected: &'static str) -> Fault {
        let found: String = self.text.chars().take(40).collect();
        Fault::Field { format: self.format, field: self.name, found: format!("{found:?}"), expected }
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
