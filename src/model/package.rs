//! Parts of a ZIP archive in memory.
//!
//! Lengths are not believed: a part may be so many times as long as what it is unpacked from and no longer, so that a small
//! file cannot ask for all memory.

use std::io::{Cursor, Read};
use zip::ZipArchive;

/// Largest part that is read, bytes: a model of some twenty million triangles.
const MOST_BYTES: u64 = 1 << 31;
/// How many times as long as its packed form a part may be, and how long in any case: the text of a mesh is some ten times.
const MOST_PACKED: u64 = 100;
const ALWAYS_BYTES: u64 = 1 << 20;

/// The bytes are no archive that can be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PackageError {
    /// The directory cannot be read.
    #[error("it is no ZIP archive, or a damaged one ({0})")]
    Directory(String),
    /// A part of a kind that is not read, such as an encrypted one, or a damaged one.
    #[error(
        "the part {name:?} cannot be read ({fault}): save it anew, neither encrypted nor packed by other means than deflate"
    )]
    Part {
        /// The part.
        name: String,
        /// What is wrong with it.
        fault: String,
    },
    /// The part is too large.
    #[error("the part {name:?} has {n_bytes} bytes; at most {MOST_BYTES} are read: reduce the mesh")]
    TooLarge {
        /// The part.
        name: String,
        /// Its declared length.
        n_bytes: u64,
    },
    /// The part is longer than what it is made from explains.
    #[error("the part {name:?} claims {n_bytes} bytes from {n_packed}: no model is packed so closely")]
    Bomb {
        /// The part.
        name: String,
        /// Its declared length.
        n_bytes: u64,
        /// The length of its packed form.
        n_packed: u64,
    },
    /// The part does not give what was declared.
    #[error(
        "the part {name:?} does not unpack to the {n_bytes} bytes and the checksum that were declared: the archive is damaged"
    )]
    Contents {
        /// The part.
        name: String,
        /// Its declared length.
        n_bytes: u64,
    },
}

/// The contents of a part, or `None` where there is none of this name; letters count as equal in either case.
///
/// # Errors
/// [`PackageError`].
pub(super) fn part(bytes: &[u8], name: &str) -> Result<Option<Vec<u8>>, PackageError> {
    let name = name.trim_start_matches('/');
    let mut archive =
        ZipArchive::new(Cursor::new(bytes)).map_err(|e| PackageError::Directory(e.to_string()))?;
    let wanted = name.as_bytes();
    let found = archive.file_names_raw().position(|raw| raw.eq_ignore_ascii_case(wanted));
    let Some(index) = found else { return Ok(None) };
    let name = || name.to_owned();
    let part =
        archive.by_index(index).map_err(|e| PackageError::Part { name: name(), fault: e.to_string() })?;
    let (n_bytes, n_packed) = (part.size(), part.compressed_size());
    if n_bytes > MOST_PACKED.saturating_mul(n_packed).saturating_add(ALWAYS_BYTES) {
        return Err(PackageError::Bomb { name: name(), n_bytes, n_packed });
    }
    if n_bytes > MOST_BYTES {
        return Err(PackageError::TooLarge { name: name(), n_bytes });
    }
    let mut contents = Vec::new();
    // The checksum is compared where the part ends; one byte more than declared shows what goes on.
    let read = part.take(n_bytes + 1).read_to_end(&mut contents);
    if read.is_err() || contents.len() as u64 != n_bytes {
        return Err(PackageError::Contents { name: name(), n_bytes });
    }
    Ok(Some(contents))
}
