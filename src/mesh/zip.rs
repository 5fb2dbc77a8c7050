//! A ZIP archive in memory (PKWARE, *APPNOTE.TXT*, 6.3): deflated entries, no dates, so that the same contents give the
//! same bytes.
//!
//! What it does not do: archives of 4 GiB and more, names outside ASCII, anything but writing.

use super::Error;
use flate2::{Compression, Crc, write::DeflateEncoder};
use std::io::Write;

const LOCAL_HEADER: u32 = 0x0403_4b50;
const CENTRAL_HEADER: u32 = 0x0201_4b50;
const END: u32 = 0x0605_4b50;
/// Version 2.0 of the format: deflate.
const VERSION: u16 = 20;
const DEFLATED: u16 = 8;
/// The first of January 1980, the earliest that the format knows.
const NO_DATE: u16 = 0x21;

/// An archive being put together.
#[derive(Debug, Default)]
pub(super) struct Archive {
    bytes: Vec<u8>,
    directory: Vec<u8>,
    n_entries: u16,
}

impl Archive {
    /// Adds an entry.
    ///
    /// # Errors
    /// [`Error::TooLarge`] at 4 GiB.
    pub(super) fn add(&mut self, name: &str, contents: &[u8]) -> Result<(), Error> {
        let offset = size(self.bytes.len())?;
        let mut crc = Crc::new();
        crc.update(contents);
        let deflated = deflated(contents);
        let mut header = Vec::new();
        for field in [VERSION, 0, DEFLATED, 0, NO_DATE] {
            header.extend(field.to_le_bytes());
        }
        for field in [crc.sum(), size(deflated.len())?, size(contents.len())?] {
            header.extend(field.to_le_bytes());
        }
        let name_length = u16::try_from(name.len()).or(Err(Error::TooLarge))?;
        header.extend(name_length.to_le_bytes());
        // No extra field.
        header.extend(0_u16.to_le_bytes());
        self.bytes.extend(LOCAL_HEADER.to_le_bytes());
        self.bytes.extend_from_slice(&header);
        self.bytes.extend_from_slice(name.as_bytes());
        self.bytes.extend(deflated);
        self.directory.extend(CENTRAL_HEADER.to_le_bytes());
        self.directory.extend(VERSION.to_le_bytes());
        self.directory.extend_from_slice(&header);
        // No comment, first disk, no attributes within and without.
        self.directory.extend([0; 10]);
        self.directory.extend(offset.to_le_bytes());
        self.directory.extend_from_slice(name.as_bytes());
        self.n_entries += 1;
        Ok(())
    }

    /// The archive's bytes.
    ///
    /// # Errors
    /// [`Error::TooLarge`] at 4 GiB.
    pub(super) fn finish(mut self) -> Result<Vec<u8>, Error> {
        let start = size(self.bytes.len())?;
        self.bytes.extend_from_slice(&self.directory);
        self.bytes.extend(END.to_le_bytes());
        // One disk, this one.
        self.bytes.extend([0; 4]);
        self.bytes.extend(self.n_entries.to_le_bytes());
        self.bytes.extend(self.n_entries.to_le_bytes());
        self.bytes.extend(size(self.directory.len())?.to_le_bytes());
        self.bytes.extend(start.to_le_bytes());
        self.bytes.extend(0_u16.to_le_bytes());
        Ok(self.bytes)
    }
}

fn size(n: usize) -> Result<u32, Error> {
    u32::try_from(n).or(Err(Error::TooLarge))
}

fn deflated(contents: &[u8]) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::with_capacity(contents.len() / 3), Compression::default());
    let written = encoder.write_all(contents).and_then(|()| encoder.finish());
    written.expect("a vector takes every byte")
}

/// The entries of an archive, by way of its directory; what is not as it should be ends the test.
#[cfg(test)]
pub(super) fn entries(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    use std::io::Read;
    let u16_at = |at: usize| usize::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
    let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let size_at = |at: usize| usize::try_from(u32_at(at)).unwrap();
    let end = bytes.len() - 22;
    assert_eq!(u32_at(end), END);
    let mut at = size_at(end + 16);
    let mut found = Vec::new();
    for _ in 0..u16_at(end + 10) {
        assert_eq!(u32_at(at), CENTRAL_HEADER);
        let (name_length, local) = (u16_at(at + 28), size_at(at + 42));
        let name = String::from_utf8(bytes[at + 46..at + 46 + name_length].to_vec()).unwrap();
        assert_eq!(u32_at(local), LOCAL_HEADER);
        assert_eq!(bytes[local + 4..local + 30], bytes[at + 6..at + 32]);
        let data = local + 30 + u16_at(local + 26) + u16_at(local + 28);
        let mut contents = Vec::new();
        let deflated = &bytes[data..data + size_at(at + 20)];
        flate2::read::DeflateDecoder::new(deflated).read_to_end(&mut contents).unwrap();
        let mut crc = Crc::new();
        crc.update(&contents);
        assert_eq!((contents.len(), crc.sum()), (size_at(at + 24), u32_at(at + 16)));
        found.push((name, contents));
        at += 46 + name_length;
    }
    assert_eq!(at, end);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_read_back_and_the_bytes_are_always_the_same() {
        let archive = || {
            let mut archive = Archive::default();
            archive.add("a/b.txt", b"hello hello hello hello").unwrap();
            archive.add("empty", b"").unwrap();
            archive.finish().unwrap()
        };
        let read = entries(&archive());
        assert_eq!(read[0], ("a/b.txt".into(), b"hello hello hello hello".to_vec()));
        assert_eq!(read[1], ("empty".into(), Vec::new()));
        assert_eq!(archive(), archive());
    }
}
