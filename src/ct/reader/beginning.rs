//! How a DICOM file begins, and what stands for the beginning where there is none.
//!
//! A file of PS3.10 begins with a preamble of 128 bytes, the mark "DICM" and the file meta group. Old scanners and archives wrote
//! the meta group, or the data set, at once. Such a file is known by its first elements: little endian, of one of these groups, in
//! ascending order, with lengths that a header has. The encoding of a bare data set is told from them: where value
//! representations are spelled out it is explicit, else implicit.
//!
//! What it does not do: a bare data set in big endian, deflated or with compressed pixels states that nowhere and is not recognised.

use dicom_core::VR;
use dicom_dictionary_std::uids;
use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

const PREAMBLE_BYTES: usize = 128;
const MARK: &[u8] = b"DICM";
/// So many bytes tell what a file is.
const LOOKED_AT_BYTES: u64 = 4096;
/// So many elements in a row are no accident.
const LEAST_ELEMENTS: usize = 3;
/// The first elements of a data set are names, dates and short codes.
const LONGEST_VALUE: usize = 1024;

/// How a DICOM file begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Beginning {
    /// With preamble, mark and meta group.
    Marked,
    /// With the meta group.
    Meta,
    /// With the data set.
    DataSet {
        /// Whether value representations are spelled out.
        is_explicit: bool,
    },
}

/// How a file begins; `None` where it is no DICOM.
pub(super) fn of(path: &Path) -> io::Result<Option<Beginning>> {
    let mut start = Vec::new();
    File::open(path)?.take(LOOKED_AT_BYTES).read_to_end(&mut start)?;
    Ok(of_bytes(&start))
}

fn of_bytes(start: &[u8]) -> Option<Beginning> {
    if start.get(PREAMBLE_BYTES..PREAMBLE_BYTES + MARK.len()) == Some(MARK) {
        return Some(Beginning::Marked);
    }
    let is_sound = |group, is_explicit| n_elements(start, group, is_explicit) >= LEAST_ELEMENTS;
    if is_sound(2, true) {
        return Some(Beginning::Meta);
    }
    [true, false].into_iter().find(|&e| is_sound(8, e)).map(|is_explicit| Beginning::DataSet { is_explicit })
}

/// How many elements of a group, in ascending order, stand at the beginning.
fn n_elements(start: &[u8], group: u16, is_explicit: bool) -> usize {
    let (mut rest, mut last, mut n) = (start, None, 0);
    while let Some((element, value)) = element_of(rest, group, is_explicit) {
        if last.is_some_and(|last| last >= element) || value > rest.len() {
            break;
        }
        (rest, last, n) = (&rest[value..], Some(element), n + 1);
    }
    n
}

/// The number of the element at the beginning of `bytes`, and how many bytes it has altogether.
fn element_of(bytes: &[u8], group: u16, is_explicit: bool) -> Option<(u16, usize)> {
    let word = |at: usize| Some(u16::from_le_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]));
    let long = |at: usize| Some(usize::from(word(at)?) | usize::from(word(at + 2)?) << 16);
    if word(0)? != group {
        return None;
    }
    let (header, length) = if is_explicit {
        match VR::from_binary([*bytes.get(4)?, *bytes.get(5)?])? {
            VR::OB | VR::OW | VR::UN | VR::SQ | VR::UT | VR::UC | VR::UR => (12, long(8)?),
            _ => (8, usize::from(word(6)?)),
        }
    } else {
        (8, long(4)?)
    };
    (length <= LONGEST_VALUE).then_some((word(2)?, header + length))
}

impl Beginning {
    /// Where the meta group, or the data set, begins in the file.
    pub(super) const fn first_element_at(self) -> u64 {
        match self {
            Self::Marked => (PREAMBLE_BYTES + MARK.len()) as u64,
            Self::Meta | Self::DataSet { .. } => 0,
        }
    }

    /// What the library is shown before the file.
    pub(super) fn missing(self) -> Vec<u8> {
        let mark = || [&[0; PREAMBLE_BYTES], MARK].concat();
        match self {
            Self::Marked => Vec::new(),
            Self::Meta => mark(),
            Self::DataSet { is_explicit: true } => [mark(), meta(uids::EXPLICIT_VR_LITTLE_ENDIAN)].concat(),
            Self::DataSet { is_explicit: false } => [mark(), meta(uids::IMPLICIT_VR_LITTLE_ENDIAN)].concat(),
        }
    }
}

/// A file meta group that states an encoding, and for the rest what says nothing.
fn meta(transfer_syntax: &str) -> Vec<u8> {
    let uid = |element: u16, value: &str| {
        let mut value = value.as_bytes().to_vec();
        value.resize(value.len().next_multiple_of(2), 0);
        let length = u16::try_from(value.len()).unwrap_or(0);
        [&[2, 0], &element.to_le_bytes()[..], b"UI", &length.to_le_bytes(), &value].concat()
    };
    let version: &[u8] = b"\x02\x00\x01\x00OB\x00\x00\x02\x00\x00\x00\x00\x01";
    let rest = [
        version,
        &uid(2, uids::RAW_DATA_STORAGE),
        &uid(3, "2.25.0"),
        &uid(0x10, transfer_syntax),
        &uid(0x12, "2.25.0"),
    ]
    .concat();
    let length = u32::try_from(rest.len()).unwrap_or(0).to_le_bytes();
    [b"\x02\x00\x00\x00UL\x04\x00", &length[..], &rest].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_known_by_their_first_elements() {
        let marked = Beginning::DataSet { is_explicit: true }.missing();
        assert_eq!(of_bytes(&marked), Some(Beginning::Marked));
        assert_eq!(of_bytes(&marked[132..]), Some(Beginning::Meta));
        let explicit =
            b"\x08\x00\x05\x00CS\x02\x00A \x08\x00\x08\x00CS\x00\x00\x08\x00\x16\x00UI\x02\x001\x00";
        assert_eq!(of_bytes(explicit), Some(Beginning::DataSet { is_explicit: true }));
        let implicit = b"\x08\x00\x00\x00\x04\x00\x00\x00\x01\x02\x03\x04\x08\x00\x05\x00\x02\x00\x00\x00A \x08\x00\x16\x00\x00\x00\x00\x00";
        assert_eq!(of_bytes(implicit), Some(Beginning::DataSet { is_explicit: false }));
    }

    #[test]
    fn what_is_something_else_is_none() {
        let explicit = b"\x08\x00\x05\x00CS\x02\x00A \x08\x00\x08\x00CS\x00\x00";
        assert_eq!(of_bytes(explicit), None, "two elements may be an accident");
        let descending = [&explicit[..], b"\x08\x00\x05\x00CS\x00\x00"].concat();
        assert_eq!(of_bytes(&descending), None);
        for other in [&b""[..], b"hello, world", &[0; 200], &[8; 200], &[2, 0, 0, 0].repeat(50)] {
            assert_eq!(of_bytes(other), None, "{other:?}");
        }
    }
}
