//! Parts of a ZIP archive in memory (PKWARE, *APPNOTE.TXT*, 6.3), stored or deflated.
//!
//! The directory at the end says what there is. Nothing is believed of it: places and lengths are compared with the
//! bytes that are there, a part may be so many times as long as what it is unpacked from and no longer, and one that grows
//! beyond its declared length while it is inflated is refused, so that a small file cannot ask for all memory.
//!
//! What it does not do: archives in several files, encryption, ZIP64.

use flate2::{Crc, read::DeflateDecoder};
use std::io::Read;

const LOCAL_HEADER: u32 = 0x0403_4b50;
const CENTRAL_HEADER: u32 = 0x0201_4b50;
const END: u32 = 0x0605_4b50;
const END_BYTES: usize = 22;
const CENTRAL_BYTES: usize = 46;
const LOCAL_BYTES: usize = 30;
/// Longest comment behind the end record.
const MOST_COMMENT_BYTES: usize = 65_535;
const STORED: u16 = 0;
const DEFLATED: u16 = 8;
/// Largest part that is read, bytes: a model of some twenty million triangles.
const MOST_BYTES: u32 = 1 << 31;
/// How many times as long as its packed form a part may be, and how long in any case: the text of a mesh is some ten times.
const MOST_PACKED: u64 = 100;
const ALWAYS_BYTES: u64 = 1 << 20;
/// What a length or place says in an archive that has it elsewhere, in 64 bits.
const IN_64_BITS: u32 = u32::MAX;

/// The bytes are no archive that can be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ZipError {
    /// There is no directory at the end.
    #[error("it is no ZIP archive, or its end is missing")]
    NoEnd,
    /// A place in the archive does not hold what it should.
    #[error("byte {at}: expected {expected}: the archive is damaged")]
    Damaged {
        /// The place, bytes from the beginning.
        at: usize,
        /// What should be there.
        expected: &'static str,
    },
    /// A part of another kind.
    #[error("the part {name:?} is packed by method {method}; expected 0 (stored) or 8 (deflated)")]
    Method {
        /// The part.
        name: String,
        /// Number of the method.
        method: u16,
    },
    /// The part is too large.
    #[error("the part {name:?} has {n_bytes} bytes; at most {MOST_BYTES} are read: reduce the mesh")]
    TooLarge {
        /// The part.
        name: String,
        /// Its declared length.
        n_bytes: u32,
    },
    /// The part is longer than what it is made from explains.
    #[error("the part {name:?} claims {n_bytes} bytes from {n_packed}: no model is packed so closely")]
    Bomb {
        /// The part.
        name: String,
        /// Its declared length.
        n_bytes: u32,
        /// The length of its packed form.
        n_packed: u32,
    },
    /// An archive of the larger kind.
    #[error("it is a ZIP64 archive, which is not read: save it anew without ZIP64, or as STL")]
    Zip64,
    /// The part does not give what was declared.
    #[error(
        "the part {name:?} does not unpack to the {n_bytes} bytes and the checksum that were declared: the archive is damaged"
    )]
    Contents {
        /// The part.
        name: String,
        /// Its declared length.
        n_bytes: u32,
    },
}

/// A part as the directory describes it.
struct Entry {
    name: String,
    method: u16,
    crc: u32,
    n_packed: u32,
    n_bytes: u32,
    local: u32,
}

/// The contents of a part, or `None` where there is none of this name; letters count as equal in either case.
///
/// # Errors
/// [`ZipError`].
pub(super) fn part(bytes: &[u8], name: &str) -> Result<Option<Vec<u8>>, ZipError> {
    let name = name.trim_start_matches('/');
    let entries = directory(bytes)?;
    entries.into_iter().find(|e| e.name.eq_ignore_ascii_case(name)).map(|e| contents(bytes, &e)).transpose()
}

fn directory(bytes: &[u8]) -> Result<Vec<Entry>, ZipError> {
    let last = bytes.len().checked_sub(END_BYTES).ok_or(ZipError::NoEnd)?;
    let first = last.saturating_sub(MOST_COMMENT_BYTES);
    let is_end = |at: &usize| u32_at(bytes, *at) == Some(END);
    let end = (first..=last).rev().find(is_end).ok_or(ZipError::NoEnd)?;
    let n_entries = u16_at(bytes, end + 10).ok_or(ZipError::NoEnd)?;
    let first = u32_at(bytes, end + 16).ok_or(ZipError::NoEnd)?;
    if first == IN_64_BITS {
        return Err(ZipError::Zip64);
    }
    let mut at = to_place(first);
    let mut entries = Vec::new();
    for _ in 0..n_entries {
        let (entry, next) =
            entry(bytes, at).ok_or(ZipError::Damaged { at, expected: "an entry of the directory" })?;
        entries.push(entry);
        at = next;
    }
    Ok(entries)
}

/// The entry at a place of the directory, and the place of the next one.
fn entry(bytes: &[u8], at: usize) -> Option<(Entry, usize)> {
    let header = bytes.get(at..at.checked_add(CENTRAL_BYTES)?)?;
    if u32_at(header, 0)? != CENTRAL_HEADER {
        return None;
    }
    let length = |at| u16_at(header, at).map(usize::from);
    let (n_name, n_extra, n_comment) = (length(28)?, length(30)?, length(32)?);
    let name_at = at + CENTRAL_BYTES;
    let name = String::from_utf8_lossy(bytes.get(name_at..name_at + n_name)?).into_owned();
    let entry = Entry {
        name,
        method: u16_at(header, 10)?,
        crc: u32_at(header, 16)?,
        n_packed: u32_at(header, 20)?,
        n_bytes: u32_at(header, 24)?,
        local: u32_at(header, 42)?,
    };
    Some((entry, name_at + n_name + n_extra + n_comment))
}

fn contents(bytes: &[u8], entry: &Entry) -> Result<Vec<u8>, ZipError> {
    let Entry { method, n_bytes, n_packed, .. } = *entry;
    let name = || entry.name.clone();
    if [n_bytes, n_packed, entry.local].contains(&IN_64_BITS) {
        return Err(ZipError::Zip64);
    }
    if u64::from(n_bytes) > MOST_PACKED * u64::from(n_packed) + ALWAYS_BYTES {
        return Err(ZipError::Bomb { name: name(), n_bytes, n_packed });
    }
    if n_bytes > MOST_BYTES {
        return Err(ZipError::TooLarge { name: name(), n_bytes });
    }
    let at = to_place(entry.local);
    let packed = packed(bytes, entry).ok_or(ZipError::Damaged { at, expected: "the part's contents" })?;
    let mut contents = Vec::new();
    let most = u64::from(n_bytes) + 1;
    let read = match method {
        STORED => packed.take(most).read_to_end(&mut contents),
        DEFLATED => DeflateDecoder::new(packed).take(most).read_to_end(&mut contents),
        _ => return Err(ZipError::Method { name: name(), method }),
    };
    let mut crc = Crc::new();
    crc.update(&contents);
    if read.is_err() || contents.len() as u64 != u64::from(n_bytes) || crc.sum() != entry.crc {
        return Err(ZipError::Contents { name: name(), n_bytes });
    }
    Ok(contents)
}

fn packed<'a>(bytes: &'a [u8], entry: &Entry) -> Option<&'a [u8]> {
    let at = to_place(entry.local);
    if u32_at(bytes, at)? != LOCAL_HEADER {
        return None;
    }
    let length = |offset| u16_at(bytes, at + offset).map(usize::from);
    let begin = at + LOCAL_BYTES + length(26)? + length(28)?;
    bytes.get(begin..begin.checked_add(to_place(entry.n_packed))?)
}

/// A place from its 32 bits; beyond all bytes where the machine has fewer.
fn to_place(bits: u32) -> usize {
    usize::try_from(bits).unwrap_or(usize::MAX / 2)
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_le_bytes(bytes.get(at..at.checked_add(2)?)?.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
}
