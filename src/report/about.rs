//! What a report is a report of: enough to tell two of them apart, and to find what they were made from. Nothing of the patient.

use serde::Serialize;

/// The program that makes reports, with its version.
const PROGRAM: &str = concat!("lumenfab ", env!("CARGO_PKG_VERSION"));
/// Digits of a hash that are shown on a page; all of them are in `report.json`.
const DIGITS: usize = 16;

/// Where a report comes from. The time is given to it, as everything else: nothing here reads a clock.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct About {
    /// The case's own id.
    pub case_id: Option<String>,
    /// When it was made: RFC 3339, UTC.
    pub made_at: Option<String>,
    /// Name of the machine's profile.
    pub profile: Option<String>,
    /// BLAKE3 of the G-code.
    pub job_blake3: Option<String>,
    /// BLAKE3 of what the deposition was read from: the printer's record, or the journal of the print.
    pub record_blake3: Option<String>,
}

impl About {
    /// A report of which nothing is known.
    pub const UNKNOWN: Self =
        Self { case_id: None, made_at: None, profile: None, job_blake3: None, record_blake3: None };

    /// Names and values for the reader, as far as they are known.
    pub(super) fn rows(&self) -> Vec<(&'static str, String)> {
        let short = |hash: &Option<String>| hash.as_ref().map(|h| h.chars().take(DIGITS).collect::<String>());
        let rows = [
            ("Case", self.case_id.clone()),
            ("Made", self.made_at.as_deref().map(plain)),
            ("Program", Some(PROGRAM.to_owned())),
            ("Profile", self.profile.clone()),
            ("Job (BLAKE3)", short(&self.job_blake3)),
            ("Record (BLAKE3)", short(&self.record_blake3)),
        ];
        rows.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
    }

    /// Case, time and program in a line for every sheet: plain letters alone, whatever the id is.
    pub(super) fn running(&self) -> String {
        let shown = self.rows().into_iter().take_while(|row| row.0 != "Profile");
        let line = shown.map(|(name, value)| match name {
            "Case" => format!("case {value}"),
            "Made" => format!("made {value}"),
            _ => value,
        });
        let line = line.collect::<Vec<_>>().join(", ");
        line.chars().filter(|c| c.is_ascii_alphanumeric() || " ,.:-_".contains(*c)).collect()
    }
}

/// `2026-05-06T07:08:09Z` as a reader writes it.
fn plain(rfc_3339: &str) -> String {
    let minutes = rfc_3339.get(..16).unwrap_or(rfc_3339);
    format!("{} UTC", minutes.replace('T', " "))
}

impl Serialize for About {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeStruct;
        let mut fields = serializer.serialize_struct("About", 6)?;
        fields.serialize_field("case_id", &self.case_id)?;
        fields.serialize_field("made_at", &self.made_at)?;
        fields.serialize_field("program", PROGRAM)?;
        fields.serialize_field("profile", &self.profile)?;
        fields.serialize_field("job_blake3", &self.job_blake3)?;
        fields.serialize_field("record_blake3", &self.record_blake3)?;
        fields.end()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::report) fn example() -> About {
        let text = |text: &str| Some(text.to_owned());
        About {
            case_id: text("0192-case"),
            made_at: text("2026-05-06T07:08:09Z"),
            profile: text("Marlin <b>"),
            job_blake3: text(&"ab".repeat(32)),
            record_blake3: text(&"cd".repeat(32)),
        }
    }

    #[test]
    fn a_report_says_what_it_is_of() {
        let rows = example().rows();
        assert_eq!(rows[1], ("Made", "2026-05-06 07:08 UTC".into()));
        assert_eq!(rows[4], ("Job (BLAKE3)", "ab".repeat(8)));
        let running = example().running();
        assert!(running.starts_with("case 0192-case, made 2026-05-06 07:08 UTC, lumenfab "), "{running}");
        let odd = About { case_id: Some("a\"}</style>".into()), ..About::UNKNOWN };
        assert!(odd.running().starts_with("case astyle, lumenfab "), "{}", odd.running());
        assert_eq!(About::UNKNOWN.rows().len(), 1);
    }
}
