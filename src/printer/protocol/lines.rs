//! Bytes from the port, cut into lines.

/// Longer lines are noise; they are cut here, so that a stream without line ends takes no memory.
pub const MAX_LINE_BYTES: usize = 512;

/// Collects bytes and gives whole lines; a half line is "not yet", never an error.
#[derive(Debug, Default)]
pub struct LineSplitter {
    pending: Vec<u8>,
}

impl LineSplitter {
    /// Takes `bytes` and calls `line` with every line that is complete, without line end and outer blanks.
    /// Bytes that are not UTF-8 become the replacement character; empty lines are left out.
    pub fn feed(&mut self, bytes: &[u8], mut line: impl FnMut(&str)) {
        for piece in bytes.split_inclusive(|&b| b == b'\n') {
            let whole = piece.ends_with(b"\n");
            if whole && self.pending.is_empty() && piece.len() <= MAX_LINE_BYTES {
                give(piece, &mut line);
                continue;
            }
            for chunk in piece.chunks(MAX_LINE_BYTES) {
                if self.pending.len() + chunk.len() > MAX_LINE_BYTES {
                    give(&self.pending, &mut line);
                    self.pending.clear();
                }
                self.pending.extend_from_slice(chunk);
            }
            if whole {
                give(&self.pending, &mut line);
                self.pending.clear();
            }
        }
    }

    /// Forgets a half line, after the link was lost.
    pub fn clear(&mut self) {
        self.pending.clear();
    }
}

fn give(bytes: &[u8], line: &mut impl FnMut(&str)) {
    let text = String::from_utf8_lossy(bytes);
    let text = text.trim_matches(|c: char| c.is_ascii_whitespace() || c == '\0');
    if !text.is_empty() {
        line(text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(pieces: &[&[u8]]) -> Vec<String> {
        let mut splitter = LineSplitter::default();
        let mut out = Vec::new();
        for piece in pieces {
            splitter.feed(piece, |l| out.push(l.to_owned()));
        }
        out
    }

    #[test]
    fn answers_split_at_any_byte_are_the_same() {
        let text = b"ok T:19.4 /0.0\r\n\nResend: 12\nok";
        let whole = lines(&[text]);
        assert_eq!(whole, ["ok T:19.4 /0.0", "Resend: 12"]);
        for cut in 0..text.len() {
            assert_eq!(lines(&[&text[..cut], &text[cut..]]), whole);
        }
        let bytes: Vec<&[u8]> = text.chunks(1).collect();
        assert_eq!(lines(&bytes), whole);
    }

    #[test]
    fn a_stream_without_line_ends_takes_no_memory() {
        let mut splitter = LineSplitter::default();
        let mut longest = 0;
        for _ in 0..1000 {
            splitter.feed(&[b'x'; 700], |l| longest = longest.max(l.len()));
            assert!(splitter.pending.len() <= MAX_LINE_BYTES);
        }
        assert!(longest <= MAX_LINE_BYTES && longest > 0);
    }

    #[test]
    fn bytes_that_are_no_text_are_kept_as_noise() {
        assert_eq!(lines(&[b"\xff\xfeok\n"]), ["\u{fffd}\u{fffd}ok"]);
    }
}
