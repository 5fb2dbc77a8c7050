//! Numbers of a header as they may be told: large ones may be dates and numbers of records. Pure.

/// Longest number that is quoted, characters; and the largest: those of six digits and more may be dates and numbers of records.
const LONGEST_NUMBER: usize = 12;
const LARGEST_NUMBER: f64 = 99_999.0;
/// What is told instead.
const INSTEAD: &str = "(a large number)";

/// Whether a word is a number that may be quoted.
pub(super) fn is_plain_number(word: &str) -> bool {
    word.len() <= LONGEST_NUMBER && is_small(word)
}

fn is_small(word: &str) -> bool {
    word.parse::<f64>().is_ok_and(|v| v.abs() <= LARGEST_NUMBER)
}

/// Numbers as they are told.
pub(super) fn told<T: ToString>(numbers: &[T]) -> String {
    let told =
        |n: &T| Some(n.to_string()).filter(|n| is_plain_number(n)).unwrap_or_else(|| INSTEAD.to_owned());
    numbers.iter().map(told).collect::<Vec<_>>().join(" ")
}

/// A text of this program's own with the large numbers in it left out.
pub(crate) fn without_large_numbers(text: &str) -> String {
    let is_of_number = |c: char| c.is_ascii_digit() || c == '.';
    let mut told = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find(|c: char| c.is_ascii_digit()) {
        let (before, from) = rest.split_at(start);
        let mut end = from.find(|c| !is_of_number(c)).unwrap_or(from.len());
        let exponent = from[end..].strip_prefix('e').map_or(0, |digits| {
            let signed = digits.strip_prefix('-').unwrap_or(digits);
            let n = signed.find(|c: char| !c.is_ascii_digit()).unwrap_or(signed.len());
            if n == 0 { 0 } else { 1 + digits.len() - signed.len() + n }
        });
        end += exponent;
        let number = from[..end].trim_end_matches('.');
        told.push_str(before);
        told.push_str(if is_small(number) { number } else { INSTEAD });
        rest = &from[number.len()..];
    }
    told.push_str(rest);
    told
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_numbers_are_not_told() {
        for (text, expected) in [
            ("19330717", "(a large number)"),
            ("[19330717.0, -0.5]", "[(a large number), -0.5]"),
            ("9, with functional groups of 8 frames", "9, with functional groups of 8 frames"),
            ("1e300 and 1e-3, 5e x", "(a large number) and 1e-3, 5e x"),
            ("[-99999.0, 1e5]", "[-99999.0, (a large number)]"),
            ("19.33.0717 ends.", "(a large number) ends."),
            ("off by 0.0123.", "off by 0.0123."),
            ("NaN", "NaN"),
        ] {
            assert_eq!(without_large_numbers(text), expected);
        }
        assert_eq!(told(&[512, 19_330_717]), "512 (a large number)");
    }
}
