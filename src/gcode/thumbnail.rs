//! Pictures of the job in comments at its head, as slicers write them and printers' displays read them.
//!
//! `; thumbnail begin 220x124 4321`, the PNG in base 64 (RFC 4648) in lines of 78 characters behind `; `, `; thumbnail end`;
//! the last number is the length of the base-64 text.

/// A picture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Thumbnail {
    /// Pixels across.
    pub width_px: u32,
    /// Pixels down.
    pub height_px: u32,
    /// PNG.
    pub png: Vec<u8>,
}

/// Characters of base 64 a line.
const LINE_CHARS: usize = 78;

impl Thumbnail {
    /// The comment lines.
    pub(super) fn lines(&self) -> Vec<String> {
        let text = base64(&self.png);
        let Self { width_px, height_px, .. } = self;
        let mut lines =
            vec![";".to_owned(), format!("; thumbnail begin {width_px}x{height_px} {}", text.len())];
        let mut rest = text.as_str();
        while !rest.is_empty() {
            let (line, after) = rest.split_at(LINE_CHARS.min(rest.len()));
            lines.push(format!("; {line}"));
            rest = after;
        }
        lines.extend(["; thumbnail end".to_owned(), ";".to_owned()]);
        lines
    }
}

/// RFC 4648 with padding.
fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let byte = |i: usize| u32::from(group.get(i).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for i in 0..4 {
            let sextet = (bits >> (18 - 6 * i)) & 63;
            let is_padding = i > group.len();
            text.push(if is_padding { '=' } else { char::from(ALPHABET[sextet as usize]) });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_standard() {
        // The test vectors of RFC 4648.
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }

    #[test]
    fn a_block_states_its_size_and_the_length_of_its_text() {
        let png: Vec<u8> = (0..=255).collect();
        let lines = Thumbnail { width_px: 32, height_px: 20, png }.lines();
        assert_eq!(lines[1], "; thumbnail begin 32x20 344");
        let text: String = lines[2..lines.len() - 2].iter().map(|l| &l[2..]).collect();
        assert_eq!(text.len(), 344);
        assert!(lines[2..].iter().all(|l| l.len() <= 80));
        assert_eq!(lines[lines.len() - 2], "; thumbnail end");
    }
}
