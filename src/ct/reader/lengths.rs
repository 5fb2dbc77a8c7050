//! Where the pixels of a DICOM file stand, and whether its elements end within it, before anything believes their lengths.
//!
//! The DICOM library sets memory aside for as many bytes as an element claims to have: one wrong byte could ask for
//! 4 GB. So the headers of all elements are walked first (PS3.5 7.1 to 7.5, A.4), values skipped; which also tells exactly how
//! many bytes a truncated file lacks, and where each fragment of compressed pixels lies, so that one frame of many can
//! be read alone. A deflated file is inflated for that, piece by piece. Sequences in sequences beyond a depth that nobody writes
//! are refused: the library calls itself for each.
//!
//! The walk takes every byte for what the library takes it for, and refuses what leaves that open; else a length
//! could hide where the two differ. One thing the library reads wrongly: elements of unknown kind and undefined length, which are
//! implicit VR little endian in any file (PS3.5 6.2.2). Their places are told, so that it is not shown them.

mod pixels_size;

use super::super::Error;
use super::beginning::{self, Beginning};
use super::files::unreadable;
use super::header::damaged;
use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry};
use dicom_core::{Tag, VR};
use dicom_dictionary_std::{StandardDataDictionary, tags, uids};
use flate2::bufread::DeflateDecoder;
use pixels_size::PixelsSize;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::ops::Range;
use std::path::Path;

/// Length of what ends with a delimiter instead.
const UNDEFINED: u32 = u32::MAX;
/// Starts an item; ends one of undefined length; ends a sequence of undefined length.
const ITEM: Tag = Tag(0xfffe, 0xe000);
const ITEM_END: Tag = Tag(0xfffe, 0xe00d);
const SEQUENCE_END: Tag = Tag(0xfffe, 0xe0dd);
/// Tag, VR, two bytes that mean nothing, length.
const LONG_HEADER_BYTES: u64 = 12;
/// Longest UID there is.
const LONGEST_UID: u32 = 64;
/// Deepest nesting that is believed.
const DEEPEST: usize = 32;
/// Longest value of a header, bytes: deflated files may grow a thousandfold.
const LONGEST_VALUE: u32 = 1 << 28;
/// The most that all of a deflated file but its pixels may inflate to, bytes: what states its length nowhere else.
const MOST_INFLATED: u64 = 1 << 28;
/// Longest offset table, bytes: one entry for each of a million frames.
const LONGEST_TABLE: u32 = 1 << 22;

/// Where the pixels of a file stand.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Layout {
    /// `None` where there are none.
    pub(super) pixels: Option<Pixels>,
    /// Where in the file the deflated data set begins, from where the places of the pixels are counted then.
    pub(super) deflated_from: Option<u64>,
    /// Whether pixels of 8 bits stand in words.
    pub(super) is_in_words: bool,
    /// Elements that the library must not see, ascending.
    pub(super) cuts: Vec<Range<u64>>,
}

/// The pixel data element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Pixels {
    /// All frames, one after the other.
    Native(Range<u64>),
    /// Compressed, in pieces.
    Fragments {
        /// Where each frame begins, from the first fragment on; may be empty.
        offsets: Vec<u64>,
        fragments: Vec<Fragment>,
    },
}

/// A piece of compressed pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Fragment {
    pub(super) range: Range<u64>,
    /// Whether it begins as a JPEG or JPEG 2000 image does.
    pub(super) begins_image: bool,
}

/// Checks that every element of a DICOM file lies within it, and finds its pixels.
///
/// # Errors
/// [`Error::Truncated`] where the pixels run beyond the end, [`Error::Damaged`] where anything else does.
pub(super) fn check(path: &Path) -> Result<Layout, Error> {
    let Start { mut walk, encoding, deflated_from } = start(path)?;
    walk.data_set(encoding)?;
    Ok(Layout { pixels: walk.pixels, deflated_from, is_in_words: walk.is_in_words, cuts: walk.cuts })
}

/// The SeriesInstanceUID of a file, damaged or not, where one can be read before any damage.
pub(super) fn series_of(path: &Path) -> Option<String> {
    let Start { mut walk, encoding, .. } = start(path).ok()?;
    // How far it comes is what there is to tell from.
    walk.data_set(encoding).ok();
    let [uid] = walk.series.as_slice() else { return None };
    let uid = std::str::from_utf8(uid).ok()?.trim_end_matches(['\0', ' ']);
    let is_uid = !uid.is_empty() && uid.chars().all(|c| c.is_ascii_digit() || c == '.');
    is_uid.then(|| uid.to_owned())
}

/// A walk at the first element of a data set.
struct Start<'a> {
    walk: Walk<'a>,
    encoding: Encoding,
    deflated_from: Option<u64>,
}

fn start(path: &Path) -> Result<Start<'_>, Error> {
    let file = File::open(path).map_err(|e| unreadable(path, e))?;
    let length = file.metadata().map_err(|e| unreadable(path, e))?.len();
    let mut walk = Walk::new(path, Input::Plain { reader: BufReader::new(file), length });
    let beginning = beginning::of(path).map_err(|e| unreadable(path, e))?.unwrap_or(Beginning::Marked);
    walk.skip(beginning.first_element_at())?;
    let encoding = match beginning {
        Beginning::Marked | Beginning::Meta => walk.meta_group()?,
        Beginning::DataSet { is_explicit: true } => EXPLICIT,
        Beginning::DataSet { is_explicit: false } => IMPLICIT,
    };
    let deflated_from = encoding.is_deflated.then_some(walk.position);
    if encoding.is_deflated {
        walk = Walk::new(path, walk.input.inflated());
    }
    Ok(Start { walk, encoding, deflated_from })
}

/// How element headers are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Encoding {
    is_explicit: bool,
    is_big_endian: bool,
    is_deflated: bool,
}

const EXPLICIT: Encoding = Encoding { is_explicit: true, is_big_endian: false, is_deflated: false };
const IMPLICIT: Encoding = Encoding { is_explicit: false, is_big_endian: false, is_deflated: false };

/// The header of an element.
struct Element {
    tag: Tag,
    vr: VR,
    length: u32,
}

/// Bytes of a file, as they are or inflated.
enum Input {
    Plain { reader: BufReader<File>, length: u64 },
    Inflated(BufReader<DeflateDecoder<BufReader<File>>>),
}

impl Input {
    fn inflated(self) -> Self {
        match self {
            Self::Plain { reader, .. } => Self::Inflated(BufReader::new(DeflateDecoder::new(reader))),
            inflated @ Self::Inflated(_) => inflated,
        }
    }

    /// Bytes left from a position on, as far as is known.
    fn left(&self, position: u64) -> Option<u64> {
        match self {
            Self::Plain { length, .. } => Some(length.saturating_sub(position)),
            Self::Inflated(_) => None,
        }
    }

    fn read(&mut self, bytes: &mut [u8]) -> io::Result<()> {
        match self {
            Self::Plain { reader, .. } => reader.read_exact(bytes),
            Self::Inflated(reader) => reader.read_exact(bytes),
        }
    }

    /// Goes on by so many bytes; returns how many there were.
    fn skip(&mut self, n: u64) -> io::Result<u64> {
        match self {
            Self::Plain { reader, .. } => {
                let offset = i64::try_from(n).map_err(io::Error::other)?;
                reader.seek_relative(offset).map(|()| n)
            }
            Self::Inflated(reader) => io::copy(&mut reader.take(n), &mut io::sink()),
        }
    }

    fn peek(&mut self) -> io::Result<Option<u8>> {
        let bytes = match self {
            Self::Plain { reader, .. } => reader.fill_buf(),
            Self::Inflated(reader) => reader.fill_buf(),
        };
        bytes.map(|b| b.first().copied())
    }
}

/// A sequence, an item or fragments that were entered.
#[derive(Clone, Copy)]
struct Level {
    /// Where it ends, if it says so.
    end: Option<u64>,
    /// How its elements are written.
    encoding: Encoding,
    kind: LevelKind,
    /// Where the element begins that is to be cut out with it.
    cut_from: Option<u64>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum LevelKind {
    Sequence,
    Item,
    Fragments,
}

struct Walk<'a> {
    path: &'a Path,
    input: Input,
    position: u64,
    levels: Vec<Level>,
    pixels: Option<Pixels>,
    is_in_words: bool,
    /// Whether the first item of the pixels, the table of frames, was passed.
    is_table_read: bool,
    cuts: Vec<Range<u64>>,
    /// Every SeriesInstanceUID of the data set itself; a sound file has one.
    series: Vec<Vec<u8>>,
    /// What a deflated file states of its pixels, before them.
    size: PixelsSize,
}

impl<'a> Walk<'a> {
    const fn new(path: &'a Path, input: Input) -> Self {
        Self {
            path,
            input,
            position: 0,
            levels: Vec::new(),
            pixels: None,
            is_in_words: false,
            is_table_read: false,
            cuts: Vec::new(),
            series: Vec::new(),
            size: PixelsSize::UNSTATED,
        }
    }

    /// Walks the file meta group; returns how the data set behind it is encoded.
    fn meta_group(&mut self) -> Result<Encoding, Error> {
        let mut syntax = Vec::new();
        let mut end = None;
        while self.is_in_meta_group(end)? {
            let element = self.element(EXPLICIT)?;
            match element.tag {
                tags::FILE_META_INFORMATION_GROUP_LENGTH if element.length == 4 => {
                    let length = u32::from_le_bytes(self.array()?);
                    end = Some(self.position + u64::from(length));
                }
                tags::TRANSFER_SYNTAX_UID if element.length <= LONGEST_UID => {
                    syntax = self.read_bytes(element.length as usize)?;
                }
                _ => {
                    self.check_whole(&element)?;
                    self.skip_value(&element)?;
                }
            }
        }
        let name = String::from_utf8_lossy(&syntax);
        Ok(match name.trim_end_matches(['\0', ' ']) {
            uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN => Encoding { is_deflated: true, ..EXPLICIT },
            uids::IMPLICIT_VR_LITTLE_ENDIAN => IMPLICIT,
            super::header::EXPLICIT_BIG_ENDIAN_UID => Encoding { is_big_endian: true, ..EXPLICIT },
            _ => EXPLICIT,
        })
    }

    /// Whether another element of the file meta group follows: up to its end where that is said.
    fn is_in_meta_group(&mut self, end: Option<u64>) -> Result<bool, Error> {
        match end {
            Some(end) => Ok(self.position < end),
            // Tags are little endian here: the group's low byte stands first.
            None => Ok(self.peek()? == Some(2)),
        }
    }

    fn data_set(&mut self, encoding: Encoding) -> Result<(), Error> {
        while self.peek()?.is_some() {
            while self.levels.last().is_some_and(|l| l.end.is_some_and(|end| end <= self.position)) {
                self.levels.pop();
            }
            let encoding = self.levels.last().map_or(encoding, |l| l.encoding);
            let element = self.element(encoding)?;
            self.visit(&element, encoding)?;
        }
        if self.levels.iter().any(|l| l.cut_from.is_some()) { Err(self.ends_early()) } else { Ok(()) }
    }

    fn visit(&mut self, element: &Element, encoding: Encoding) -> Result<(), Error> {
        use LevelKind::{Fragments, Item, Sequence};
        match (self.levels.last().map(|l| l.kind), element.tag) {
            (Some(Fragments), ITEM) => self.fragment(element),
            (Some(Sequence), ITEM) => self.enter(element, encoding, Item),
            (Some(Sequence | Fragments), SEQUENCE_END) | (Some(Item), ITEM_END) => {
                self.leave();
                Ok(())
            }
            (Some(Sequence | Fragments), _) => {
                Err(damaged(self.path, "something stands between the items of a sequence"))
            }
            // Ends of what was never begun do no harm.
            (None, ITEM_END) | (_, SEQUENCE_END) if element.length == 0 => Ok(()),
            (_, ITEM | ITEM_END | SEQUENCE_END) => {
                Err(damaged(self.path, "an item stands outside of a sequence"))
            }
            // Without a VR, as items are, and yet none: its length would be taken for one of any kind.
            (_, Tag(0xfffe, _)) => Err(damaged(self.path, "a mark of items is none that there is")),
            _ => self.visit_value(element, encoding),
        }
    }

    fn visit_value(&mut self, element: &Element, encoding: Encoding) -> Result<(), Error> {
        match element.tag {
            tags::PIXEL_DATA => self.pixel_data(element, encoding),
            _ if element.vr == VR::SQ => self.enter(element, encoding, LevelKind::Sequence),
            _ if element.length == UNDEFINED => self.enter_unknown(element, encoding),
            tags::SERIES_INSTANCE_UID if self.levels.is_empty() && element.length <= LONGEST_UID => {
                self.check_within(element)?;
                let uid = self.read_bytes(element.length as usize)?;
                self.series.push(uid);
                Ok(())
            }
            tag if PixelsSize::has(tag) && self.is_inflated_value(element) => self.size_of_pixels(element),
            _ if element.length > LONGEST_VALUE => {
                self.check_within(element)?;
                Err(damaged(self.path, "an element of its header has more than 256 MiB"))
            }
            _ => {
                self.check_whole(element)?;
                self.skip_value(element)
            }
        }
    }

    /// Whether it is a short value of an inflated data set itself.
    fn is_inflated_value(&self, element: &Element) -> bool {
        let is_inflated = matches!(self.input, Input::Inflated(_));
        is_inflated && self.levels.is_empty() && element.length <= LONGEST_UID
    }

    fn size_of_pixels(&mut self, element: &Element) -> Result<(), Error> {
        self.check_whole(element)?;
        let bytes = self.read_bytes(element.length as usize)?;
        self.size.take(element.tag, &bytes);
        Ok(())
    }

    /// Checks the pixels of a deflated data set itself by its image's size; those within a sequence (an icon) and in pieces, whose
    /// size nothing states, by what a header's value may have.
    fn check_inflated_pixels(&self, length: u32, has_size: bool) -> Result<(), Error> {
        let most = if has_size { self.size.most_bytes() } else { LONGEST_VALUE.into() };
        if matches!(self.input, Input::Inflated(_)) && u64::from(length) > most {
            return Err(damaged(self.path, "its pixels have more bytes than its rows and columns may have"));
        }
        Ok(())
    }

    /// Of a value of numbers the library takes those that are whole, and would go on in the middle of what is left.
    fn check_whole(&self, element: &Element) -> Result<(), Error> {
        let n_bytes = match element.vr {
            VR::US | VR::SS | VR::OW => 2,
            VR::UL | VR::SL | VR::FL | VR::AT | VR::OF | VR::OL => 4,
            VR::FD | VR::OD | VR::SV | VR::UV | VR::OV => 8,
            _ => 1,
        };
        if element.length.is_multiple_of(n_bytes) {
            return Ok(());
        }
        Err(damaged(self.path, "the length of an element is no whole number of its values"))
    }

    /// Enters a sequence that is not called one.
    fn enter_unknown(&mut self, element: &Element, encoding: Encoding) -> Result<(), Error> {
        // Within what states its length nothing can be left out, nor in what is inflated on the way.
        let can_be_cut = encoding.is_explicit
            && element.vr == VR::UN
            && matches!(self.input, Input::Plain { .. })
            && self.levels.iter().all(|l| l.end.is_none());
        if !can_be_cut {
            return self.enter(element, encoding, LevelKind::Sequence);
        }
        let cut_from = self.position - LONG_HEADER_BYTES;
        self.enter(element, IMPLICIT, LevelKind::Sequence)?;
        if let Some(level) = self.levels.last_mut() {
            level.cut_from = Some(cut_from);
        }
        Ok(())
    }

    fn pixel_data(&mut self, element: &Element, encoding: Encoding) -> Result<(), Error> {
        let is_outermost = self.levels.is_empty();
        if element.length == UNDEFINED {
            if is_outermost {
                self.pixels = Some(Pixels::Fragments { offsets: Vec::new(), fragments: Vec::new() });
            }
            return self.enter(element, encoding, LevelKind::Fragments);
        }
        self.check_inflated_pixels(element.length, is_outermost)?;
        let start = self.position;
        self.skip_value(element)?;
        if is_outermost {
            self.pixels = Some(Pixels::Native(start..self.position));
            self.is_in_words = element.vr == VR::OW;
        }
        Ok(())
    }

    fn enter(&mut self, element: &Element, encoding: Encoding, kind: LevelKind) -> Result<(), Error> {
        // Writers get the lengths of items wrong, which does no harm: their elements follow one by one.
        if kind == LevelKind::Sequence {
            self.check_within(element)?;
        }
        if self.levels.len() >= DEEPEST {
            return Err(damaged(self.path, "its sequences are nested too deep"));
        }
        let end = (element.length != UNDEFINED).then(|| self.position + u64::from(element.length));
        self.levels.push(Level { end, encoding, kind, cut_from: None });
        Ok(())
    }

    fn leave(&mut self) {
        let cut_from = self.levels.pop().and_then(|l| l.cut_from);
        self.cuts.extend(cut_from.map(|start| start..self.position));
    }

    /// An item of compressed pixels: the offset table if it is the first, else a fragment.
    fn fragment(&mut self, element: &Element) -> Result<(), Error> {
        self.check_pixels_within(element.length)?;
        self.check_inflated_pixels(element.length, false)?;
        let start = self.position;
        if self.levels.len() > 1 {
            return self.skip(element.length.into());
        }
        if !std::mem::replace(&mut self.is_table_read, true) {
            return self.offset_table(element.length);
        }
        let mut head = [0; 4];
        let head = &mut head[..(element.length as usize).min(4)];
        self.fill(head)?;
        let begins_image = matches!(head, [0xff, 0xd8, ..] | [0xff, 0x4f, 0xff, 0x51] | [0, 0, 0, 12]);
        self.skip(u64::from(element.length) - head.len() as u64)?;
        if let Some(Pixels::Fragments { fragments, .. }) = &mut self.pixels {
            fragments.push(Fragment { range: start..self.position, begins_image });
        }
        Ok(())
    }

    fn offset_table(&mut self, length: u32) -> Result<(), Error> {
        if length > LONGEST_TABLE {
            return Err(damaged(self.path, "its table of frames is too long"));
        }
        let bytes = self.read_bytes(length as usize)?;
        let numbers = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]).into());
        if let Some(Pixels::Fragments { offsets, .. }) = &mut self.pixels {
            *offsets = numbers.collect();
        }
        Ok(())
    }

    fn element(&mut self, encoding: Encoding) -> Result<Element, Error> {
        self.check_inflated()?;
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

    /// A few bytes may inflate to anything: what stands beside the pixels, whose length is checked against the image's size, must
    /// stay within bounds.
    fn check_inflated(&self) -> Result<(), Error> {
        let of_pixels = match &self.pixels {
            Some(Pixels::Native(range)) => range.end - range.start,
            _ => 0,
        };
        if matches!(self.input, Input::Inflated(_))
            && self.position - of_pixels.min(self.position) > MOST_INFLATED
        {
            return Err(damaged(self.path, "its deflated elements inflate beyond any header's length"));
        }
        Ok(())
    }

    fn peek(&mut self) -> Result<Option<u8>, Error> {
        self.input.peek().map_err(|e| self.unreadable(e))
    }

    fn check_within(&self, element: &Element) -> Result<(), Error> {
        let is_within = self.input.left(self.position).is_none_or(|left| u64::from(element.length) <= left);
        if element.length == UNDEFINED || is_within {
            return Ok(());
        }
        if element.tag == tags::PIXEL_DATA {
            return self.check_pixels_within(element.length);
        }
        Err(damaged(self.path, "an element runs beyond the end of the file"))
    }

    fn check_pixels_within(&self, length: u32) -> Result<(), Error> {
        match self.input.left(self.position) {
            Some(left) if left < u64::from(length) => Err(self.truncated(left, length)),
            _ => Ok(()),
        }
    }

    fn truncated(&self, found: u64, expected: u32) -> Error {
        Error::Truncated {
            path: self.path.to_owned(),
            found_bytes: usize::try_from(found).unwrap_or(usize::MAX),
            expected_bytes: expected as usize,
        }
    }

    fn skip_value(&mut self, element: &Element) -> Result<(), Error> {
        self.check_within(element)?;
        self.skip(element.length.into())
    }

    fn skip(&mut self, n: u64) -> Result<(), Error> {
        if self.input.left(self.position).is_some_and(|left| n > left) {
            return Err(self.ends_early());
        }
        let n_skipped = self.input.skip(n).map_err(|e| self.unreadable(e))?;
        self.position += n_skipped;
        if n_skipped < n { Err(self.ends_early()) } else { Ok(()) }
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
        self.input.read(bytes).map_err(|e| self.unreadable(e))
    }

    fn unreadable(&self, e: io::Error) -> Error {
        match e.kind() {
            io::ErrorKind::UnexpectedEof => self.ends_early(),
            // What cannot be inflated is damaged; its text says no more.
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => {
                damaged(self.path, "its deflated elements cannot be inflated")
            }
            _ => unreadable(self.path, e),
        }
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
