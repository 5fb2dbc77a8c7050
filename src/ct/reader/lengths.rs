//! Whether the elements of a DICOM file end within it, looked at before anything believes their lengths.
//!
//! The DICOM library sets memory aside for as many bytes as an element claims to have: one wrong byte could ask for
//! 4 GB. So the headers of all elements are walked first (PS3.5 7.1 to 7.5, A.4), values skipped; which also tells exactly how
//! many bytes a truncated file lacks. Items of sequences are walked as if they stood in the open. A deflated file, and
//! what follows an element of unknown meaning and undefined length, is not walked.

use super::super::Error;
use super::files::unreadable;
use super::header::damaged;
use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_core::{Tag, VR};
use dicom_dictionary_std::{StandardDataDictionary, tags, uids};
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

/// Preamble and mark.
const START_BYTES: u64 = 132;
/// Length of what ends with a delimiter instead.
const UNDEFINED: u32 = u32::MAX;
/// Starts an item; ends one of undefined length; ends a sequence of undefined length.
const ITEM: Tag = Tag(0xfffe, 0xe000);
const ITEM_END: Tag = Tag(0xfffe, 0xe00d);
const SEQUENCE_END: Tag = Tag(0xfffe, 0xe0dd);
/// Longest UID there is.
const LONGEST_UID: u32 = 64;

/// Checks that every element of a file that carries the DICOM mark lies within it.
///
/// Returns the bytes of its pixels, of compressed ones the bytes to the end of the file; `None` where the file is not walked to them.
///
/// # Errors
/// [`Error::Truncated`] where the pixels run beyond the end, [`Error::Damaged`] where anything else does.
pub(super) fn check(path: &Path) -> Result<Option<u64>, Error> {
    let file = File::open(path).map_err(|e| unreadable(path, e))?;
    let length = file.metadata().map_err(|e| unreadable(path, e))?.len();
    let mut walk = Walk { path, reader: BufReader::new(file), position: 0, length, pixel_bytes: None };
    walk.skip(START_BYTES)?;
    let Some(encoding) = walk.meta_group()? else { return Ok(None) };
    walk.data_set(encoding)?;
    Ok(walk.pixel_bytes)
}

/// How element headers are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Encoding {
    is_explicit: bool,
    is_big_endian: bool,
}

/// The header of an element.
struct Element {
    tag: Tag,
    vr: VR,
    length: u32,
}

struct Walk<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    position: u64,
    length: u64,
    /// Of the last element of pixels: those of an icon come before those of the image.
    pixel_bytes: Option<u64>,
}

impl Walk<'_> {
    /// Walks the file meta group; returns how the data set behind it is encoded, `None` where it is deflated.
    fn meta_group(&mut self) -> Result<Option<Encoding>, Error> {
        const META: Encoding = Encoding { is_explicit: true, is_big_endian: false };
        let mut syntax = Vec::new();
        while self.next_group()? == Some(2) {
            let element = self.element(META)?;
            if element.tag == tags::TRANSFER_SYNTAX_UID && element.length <= LONGEST_UID {
                syntax = self.read_bytes(element.length as usize)?;
            } else {
                self.skip_value(&element)?;
            }
        }
        let name = String::from_utf8_lossy(&syntax);
        Ok(match name.trim_end_matches(['\0', ' ']) {
            uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN => None,
            uids::IMPLICIT_VR_LITTLE_ENDIAN => Some(Encoding { is_explicit: false, is_big_endian: false }),
            super::header::EXPLICIT_BIG_ENDIAN_UID => {
                Some(Encoding { is_explicit: true, is_big_endian: true })
            }
            _ => Some(META),
        })
    }

    fn data_set(&mut self, encoding: Encoding) -> Result<(), Error> {
        let mut is_in_fragments = false;
        while self.position < self.length {
            let element = self.element(encoding)?;
            if element.tag == tags::PIXEL_DATA {
                let is_plain = element.length != UNDEFINED;
                // Compressed pixels end where the file does, but for what may stand behind them.
                let bytes = if is_plain { element.length.into() } else { self.length - self.position };
                self.pixel_bytes = Some(bytes);
            }
            match element.tag {
                ITEM if !is_in_fragments => {}
                ITEM_END => {}
                SEQUENCE_END => is_in_fragments = false,
                _ if element.length == UNDEFINED && element.tag == tags::PIXEL_DATA => is_in_fragments = true,
                _ if element.vr == VR::SQ => self.check_within(&element)?,
                _ if element.length == UNDEFINED => return Ok(()),
                _ => self.skip_value(&element)?,
            }
        }
        Ok(())
    }

    fn element(&mut self, encoding: Encoding) -> Result<Element, Error> {
        let start = self.array::<4>()?;
        let tag = Tag(encoding.u16([start[0], start[1]]), encoding.u16([start[2], start[3]]));
        if tag.0 == 0xfffe || !encoding.is_explicit {
            let length = encoding.u32(self.array()?);
            return Ok(Element { tag, vr: vr_of(tag), length });
        }
        let [a, b, c, d] = self.array::<4>()?;
        let vr = VR::from_binary([a, b]).unwrap_or(VR::UN);
        let length =
            if has_long_length(vr) { encoding.u32(self.array()?) } else { encoding.u16([c, d]).into() };
        Ok(Element { tag, vr, length })
    }

    /// The group of the next element without reading on; `None` at the end.
    fn next_group(&mut self) -> Result<Option<u16>, Error> {
        if self.length.saturating_sub(self.position) < 2 {
            return Ok(None);
        }
        let bytes = self.array::<2>()?;
        self.reader.seek_relative(-2).map_err(|e| unreadable(self.path, e))?;
        self.position -= 2;
        Ok(Some(u16::from_le_bytes(bytes)))
    }

    fn check_within(&self, element: &Element) -> Result<(), Error> {
        let left = self.length.saturating_sub(self.position);
        if element.length == UNDEFINED || u64::from(element.length) <= left {
            return Ok(());
        }
        if element.tag == tags::PIXEL_DATA {
            return Err(Error::Truncated {
                path: self.path.to_owned(),
                found_bytes: usize::try_from(left).unwrap_or(usize::MAX),
                expected_bytes: element.length as usize,
            });
        }
        Err(damaged(self.path, "an element runs beyond the end of the file"))
    }

    fn skip_value(&mut self, element: &Element) -> Result<(), Error> {
        self.check_within(element)?;
        self.skip(element.length.into())
    }

    fn skip(&mut self, n: u64) -> Result<(), Error> {
        if n > self.length.saturating_sub(self.position) {
            return Err(self.ends_early());
        }
        let offset = i64::try_from(n).expect("no more than the file's length");
        self.reader.seek_relative(offset).map_err(|e| unreadable(self.path, e))?;
        self.position += n;
        Ok(())
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Error> {
        let mut bytes = [0; N];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    fn read_bytes(&mut self, n: usize) -> Result<Vec<u8>, Error> {
        let mut bytes = vec![0; n];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), Error> {
        self.position += bytes.len() as u64;
        self.reader.read_exact(bytes).map_err(|e| match e.kind() {
            io::ErrorKind::UnexpectedEof => self.ends_early(),
            _ => unreadable(self.path, e),
        })
    }

    fn ends_early(&self) -> Error {
        damaged(self.path, "it ends within its header")
    }
}

impl Encoding {
    fn u16(self, bytes: [u8; 2]) -> u16 {
        if self.is_big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) }
    }

    fn u32(self, bytes: [u8; 4]) -> u32 {
        if self.is_big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) }
    }
}

/// What implicit encodings leave to the dictionary.
fn vr_of(tag: Tag) -> VR {
    StandardDataDictionary.by_tag(tag).map_or(VR::UN, |e| e.vr().relaxed())
}

/// Whether the length has 32 bits, behind two bytes that mean nothing (PS3.5 table 7.1-1).
fn has_long_length(vr: VR) -> bool {
    use VR::{OB, OD, OF, OL, OV, OW, SQ, SV, UC, UN, UR, UT, UV};
    matches!(vr, OB | OD | OF | OL | OV | OW | SQ | SV | UC | UN | UR | UT | UV)
}
