//! The record on disk: `beads.csv`, `events.jsonl`, `summary.json`.
//!
//! Numbers have fixed decimals (lengths 0.1 µm, volumes 1e-6 mm³, times 0.1 ms, temperatures 0.01 °C), so that the same
//! commands give the same bytes. Writing is buffered; the caller flushes at least once a second. Files of an earlier
//! run in the same directory are replaced.

use crate::{
    Error,
    event::{Bead, Event, Summary},
    whole,
};
use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

/// First line of `beads.csv`.
pub const BEADS_HEADER: &str =
    "t_s,x0_mm,y0_mm,z0_mm,x1_mm,y1_mm,z1_mm,volume_mm3,width_mm,height_mm,hotend_c";
/// Name of the table of beads in a record.
pub const BEADS_FILE: &str = "beads.csv";

/// Appends `value` with exactly `decimals` decimals, rounded half away from zero; never `-0`.
pub fn push_fixed(out: &mut Vec<u8>, value: f64, decimals: u32) {
    let unit = 10_u64.pow(decimals);
    // Saturates far beyond any machine's size; NaN cannot occur and would be 0.
    let scaled = whole::to_i64(value * unit as f64);
    if scaled < 0 {
        out.push(b'-');
    }
    let size = scaled.unsigned_abs();
    push_digits(out, size / unit, 1);
    if decimals > 0 {
        out.push(b'.');
        push_digits(out, size % unit, decimals as usize);
    }
}

/// Appends `value` in at least `width` digits.
fn push_digits(out: &mut Vec<u8>, mut value: u64, width: usize) {
    let mut digits = [b'0'; 20];
    let mut at = digits.len();
    while value > 0 || digits.len() - at < width {
        at -= 1;
        digits[at] = b'0' + (value % 10) as u8;
        value /= 10;
    }
    out.extend_from_slice(&digits[at..]);
}

/// One row of `beads.csv`, with its line end.
pub fn push_bead(out: &mut Vec<u8>, bead: &Bead) {
    push_fixed(out, bead.t_s, 4);
    for value in bead.from_mm.iter().chain(&bead.to_mm) {
        out.push(b',');
        push_fixed(out, *value, 4);
    }
    for (value, decimals) in
        [(bead.volume_mm3, 6), (bead.width_mm, 4), (bead.height_mm, 4), (bead.hotend_c, 2)]
    {
        out.push(b',');
        push_fixed(out, value, decimals);
    }
    out.push(b'\n');
}

/// One line of `events.jsonl`, with its line end. Bytes that are no UTF-8 are replaced by U+FFFD.
pub fn push_event(out: &mut Vec<u8>, event: &Event) {
    let (t_s, kind, fields): (f64, &str, [(&str, &str); 2]) = match event {
        Event::Bead(bead) => (bead.t_s, "bead", [("", ""), ("", "")]),
        Event::Command { t_s, text } => {
            return push_json(out, *t_s, "command", &[("text", &String::from_utf8_lossy(text))]);
        }
        Event::Refused { t_s, text, reason } => {
            let text = String::from_utf8_lossy(text);
            return push_json(out, *t_s, "refused", &[("text", &text), ("reason", reason)]);
        }
        Event::Fault { t_s, kind, detail } => (*t_s, "fault", [("kind", kind), ("detail", detail)]),
        Event::State { t_s, state, detail } => (*t_s, "state", [("state", state), ("detail", detail)]),
    };
    push_json(out, t_s, kind, &fields);
}

fn push_json(out: &mut Vec<u8>, t_s: f64, event: &str, fields: &[(&str, &str)]) {
    out.extend_from_slice(b"{\"t_s\":");
    push_fixed(out, t_s, 6);
    for (key, text) in std::iter::once(&("event", event)).chain(fields).filter(|(_, text)| !text.is_empty()) {
        out.extend_from_slice(b",\"");
        out.extend_from_slice(key.as_bytes());
        out.extend_from_slice(b"\":");
        serde_json::to_writer(&mut *out, text).expect("a text written into memory cannot fail");
    }
    out.extend_from_slice(b"}\n");
}

/// The files of a record being written.
#[derive(Debug)]
pub struct Recorder {
    dir: PathBuf,
    beads: BufWriter<File>,
    events: BufWriter<File>,
    row: Vec<u8>,
}

impl Recorder {
    /// Begins a record in `dir`, which is made if it is not there.
    ///
    /// # Errors
    /// [`Error::Io`] where the directory or its files cannot be made.
    pub fn create(dir: &Path) -> Result<Self, Error> {
        fs::create_dir_all(dir).map_err(|error| Error::io("create", dir, error))?;
        // A summary stands for a complete record: the one of an earlier run goes first.
        match fs::remove_file(dir.join("summary.json")) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(Error::io("remove", dir.join("summary.json"), error));
            }
            _ => {}
        }
        let open = |name: &str| {
            let path = dir.join(name);
            let file = File::create(&path).map_err(|error| Error::io("create", path, error))?;
            Ok(BufWriter::with_capacity(1 << 16, file))
        };
        let mut recorder = Self {
            dir: dir.to_owned(),
            beads: open(BEADS_FILE)?,
            events: open("events.jsonl")?,
            row: Vec::with_capacity(256),
        };
        writeln!(recorder.beads, "{BEADS_HEADER}").map_err(|error| Error::io("write", dir, error))?;
        Ok(recorder)
    }

    /// Records one event.
    ///
    /// # Errors
    /// [`Error::Io`] where the file cannot be written.
    pub fn write(&mut self, event: &Event) -> Result<(), Error> {
        self.row.clear();
        let result = if let Event::Bead(bead) = event {
            push_bead(&mut self.row, bead);
            self.beads.write_all(&self.row)
        } else {
            push_event(&mut self.row, event);
            self.events.write_all(&self.row)
        };
        result.map_err(|error| Error::io("write", &self.dir, error))
    }

    /// Hands everything to the operating system.
    ///
    /// # Errors
    /// [`Error::Io`] where the files cannot be written.
    pub fn flush(&mut self) -> Result<(), Error> {
        self.beads
            .flush()
            .and_then(|()| self.events.flush())
            .map_err(|error| Error::io("write", &self.dir, error))
    }

    /// Ends the record with its summary, which appears whole or not at all.
    ///
    /// # Errors
    /// [`Error::Io`] where the files cannot be written.
    pub fn finish(mut self, summary: &Summary) -> Result<(), Error> {
        self.flush()?;
        let mut text = serde_json::to_vec_pretty(summary).expect("a summary has no map with odd keys");
        text.push(b'\n');
        let path = self.dir.join("summary.json");
        let draft = self.dir.join(".summary.json.new");
        fs::write(&draft, text)
            .and_then(|()| fs::rename(&draft, &path))
            .map_err(|error| Error::io("write", path, error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fixed(value: f64, decimals: u32) -> String {
        let mut out = Vec::new();
        push_fixed(&mut out, value, decimals);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn numbers_have_fixed_decimals() {
        assert_eq!(fixed(1.5, 4), "1.5000");
        assert_eq!(fixed(-0.000_01, 4), "0.0000");
        assert_eq!(fixed(-12.345_67, 2), "-12.35");
        assert_eq!(fixed(7.0, 0), "7");
    }

    proptest! {
        #[test]
        fn numbers_agree_with_the_standard_writer(value in -1e6_f64..1e6) {
            let standard: f64 = format!("{value:.4}").parse().unwrap();
            let ours: f64 = fixed(value, 4).parse().unwrap();
            prop_assert!((standard - ours).abs() <= 1.000_01e-4);
            prop_assert!((value - ours).abs() <= 0.500_01e-4);
        }
    }

    #[test]
    fn row_has_the_columns_of_the_header() {
        let bead = Bead {
            t_s: 12.345_678,
            from_mm: [1.0, 2.0, 0.2],
            to_mm: [11.0, 2.0, 0.2],
            volume_mm3: 0.8,
            width_mm: 0.4,
            height_mm: 0.2,
            hotend_c: 205.0,
        };
        let mut row = Vec::new();
        push_bead(&mut row, &bead);
        let row = String::from_utf8(row).unwrap();
        assert_eq!(row, "12.3457,1.0000,2.0000,0.2000,11.0000,2.0000,0.2000,0.800000,0.4000,0.2000,205.00\n");
        assert_eq!(row.split(',').count(), BEADS_HEADER.split(',').count());
    }

    #[test]
    fn events_are_json_whatever_the_line_held() {
        let mut out = Vec::new();
        push_event(&mut out, &Event::Command { t_s: 1.0, text: b"N1 \"\\\xff\x01*3".to_vec() });
        push_event(
            &mut out,
            &Event::Fault { t_s: 2.0, kind: "bit-error", detail: "rx line 3: byte 1, bit 2".to_owned() },
        );
        for line in String::from_utf8(out).unwrap().lines() {
            let value: serde_json::Value = serde_json::from_str(line).unwrap();
            assert!(value["t_s"].is_f64() && value["event"].is_string());
        }
    }

    #[test]
    fn record_is_made_and_its_summary_comes_last() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a/record");
        let recorder = Recorder::create(&path).unwrap();
        assert!(!path.join("summary.json").exists());
        recorder.finish(&Summary { profile: "reference".to_owned(), ..Summary::default() }).unwrap();
        let text = fs::read_to_string(path.join("summary.json")).unwrap();
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(value["profile"], "reference");
        assert_eq!(fs::read_to_string(path.join(BEADS_FILE)).unwrap().trim_end(), BEADS_HEADER);
    }

    #[test]
    fn place_that_cannot_be_written_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("file");
        fs::write(&file, "").unwrap();
        let message = Recorder::create(&file.join("record")).unwrap_err().to_string();
        assert!(message.starts_with("create ") && message.contains("record"), "{message}");
    }
}
