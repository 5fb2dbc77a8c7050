//! The known key that somebody may have meant.

/// Less alike than this (Jaro-Winkler) is no likeness.
const ALIKE: f64 = 0.85;

/// The known dotted key whose last part is likest to that of `key`; none where none is like it.
pub(crate) fn nearest<'a>(key: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let (table, last) = key.rsplit_once('.').unwrap_or(("", key));
    let likeness = |known: &str| {
        let (its_table, its_last) = known.rsplit_once('.').unwrap_or(("", known));
        // Of two that are as like the one in the same table is meant.
        let in_table = if its_table == table { 1e-3 } else { 0.0 };
        strsim::jaro_winkler(last, its_last) + in_table
    };
    let alike =
        known.into_iter().map(|known| (likeness(known), known)).filter(|(likeness, _)| *likeness >= ALIKE);
    // The first of several.
    alike.reduce(|a, b| if b.0 > a.0 { b } else { a }).map(|(_, known)| known)
}

#[cfg(test)]
mod tests {
    use super::*;

    const KNOWN: [&str; 5] =
        ["machine.nozzle_mm", "print.brim_mm", "print.brim_slenderness", "first.fan", "print.fan"];

    #[test]
    fn a_slip_a_missing_unit_and_another_table_are_seen_through() {
        let meant = |key| nearest(key, KNOWN);
        assert_eq!(meant("print.brim_slendernes"), Some("print.brim_slenderness"));
        assert_eq!(meant("print.brim"), Some("print.brim_mm"));
        assert_eq!(meant("nozzle_mm"), Some("machine.nozzle_mm"));
        assert_eq!(meant("print.fna"), None, "too short to tell");
        assert_eq!(meant("fan"), Some("first.fan"));
        assert_eq!(meant("print.fan_"), Some("print.fan"));
        assert_eq!((meant("colour"), meant("print."), meant("")), (None, None, None));
    }
}
