//! Opens a DICOM file with the library, once nothing in it can lead that astray.

use super::super::Error;
use super::beginning::{self, Beginning};
use super::files::unreadable;
use super::header::damaged;
use super::lengths::{self, Layout};
use dicom_core::Tag;
use dicom_object::{DefaultDicomObject, OpenFileOptions};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

/// Reads a DICOM file, up to the outermost element `until` where one is named.
///
/// # Errors
/// [`Error::Damaged`] or [`Error::Truncated`] where an element runs beyond the end or nothing can be parsed.
pub(super) fn open(path: &Path, until: Option<Tag>) -> Result<(DefaultDicomObject, Layout), Error> {
    let layout = lengths::check(path)?;
    let file = File::open(path).map_err(|e| unreadable(path, e))?;
    let beginning = beginning::of(path).map_err(|e| unreadable(path, e))?.unwrap_or(Beginning::Marked);
    let rest = Cut { file, position: 0, cuts: layout.cuts.clone(), next: 0 };
    let reader = BufReader::new(io::Cursor::new(beginning.missing()).chain(rest));
    let options = until.into_iter().fold(OpenFileOptions::new(), OpenFileOptions::read_until);
    // The library's own words are left out: they may quote what identifies a patient.
    let object = options.from_reader(reader).ok();
    Ok((object.ok_or_else(|| damaged(path, "its header cannot be parsed"))?, layout))
}

/// A file without some of its parts.
struct Cut {
    file: File,
    position: u64,
    /// Ascending, none within another.
    cuts: Vec<Range<u64>>,
    /// The first of them that lies ahead.
    next: usize,
}

impl Read for Cut {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        // One may begin where another ends.
        while let Some(cut) = self.cuts.get(self.next).filter(|cut| cut.start <= self.position) {
            self.position = self.file.seek(SeekFrom::Start(cut.end.max(self.position)))?;
            self.next += 1;
        }
        let most = self.cuts.get(self.next).map_or(u64::MAX, |cut| cut.start - self.position);
        let n = (&mut self.file).take(most).read(bytes)?;
        self.position += n as u64;
        Ok(n)
    }
}
