//! The pixels of one image: read, decoded, unpacked, rescaled.
//!
//! Only the bytes of that image are read, straight to where they are decoded from: a frame of many costs as much as a
//! file of its own. Memory: those bytes, and for compressed images 2 bytes more per pixel (JPEG 2000: 6). A deflated object of many
//! frames has no place to begin at but its first byte: it is inflated once and kept meanwhile ([`Inflated`]).

use super::super::codec::{Codec, Fault, Samples, Size};
use super::super::encoding::{LOSS_CONSEQUENCE, Loss, Packing};
use super::super::series::{Header, PixelFormat};
use super::super::{Error, Warning};
use super::files::unreadable;
use super::header::damaged;
use crate::progress::Task;
use flate2::bufread::DeflateDecoder;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

/// What a CT's padding outside the scanned circle becomes: air, as low as 12 bits go, HU.
const PADDING_HU: f32 = -1024.0;
/// No CT number is larger: metal saturates at 30,710 HU on extended scales.
const LARGEST_HU: f32 = 31_000.0;
/// No CT number is lower: extended scales begin at -10,240 HU.
const LOWEST_HU: f32 = -10_240.0;

/// What was found in the pixels of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Findings {
    /// Pixels that mean "outside the image" and became air.
    pub(super) n_padding: usize,
    /// Pixels with bits set where none is stored, which were left out.
    pub(super) n_foreign_bits: usize,
    /// CT pixels beyond any CT number.
    pub(super) n_beyond: usize,
    /// Images whose files hold more pixels than their headers say.
    pub(super) n_too_long: usize,
    /// Images whose pixels were compressed with loss although their headers say without.
    pub(super) n_lossy: usize,
}

impl Findings {
    /// Findings of two images together.
    pub(super) const fn and(self, other: Self) -> Self {
        Self {
            n_padding: self.n_padding + other.n_padding,
            n_foreign_bits: self.n_foreign_bits + other.n_foreign_bits,
            n_beyond: self.n_beyond + other.n_beyond,
            n_too_long: self.n_too_long + other.n_too_long,
            n_lossy: self.n_lossy + other.n_lossy,
        }
    }

    /// What the operator should know of them; padding is nothing odd.
    pub(super) fn warnings(self) -> Vec<Warning> {
        let mut warnings = Vec::new();
        if self.n_foreign_bits > 0 {
            let text = format!(
                "{} pixel(s) have bits set outside those that the headers call stored (overlays, or a wrong BitsStored); they were left out",
                self.n_foreign_bits
            );
            warnings.push(Warning::new("ct.foreign_bits", text));
        }
        if self.n_beyond > 0 {
            let text = format!(
                "{} pixel(s) are below {LOWEST_HU} or above {LARGEST_HU} HU, which no CT gives: PixelRepresentation, the padding value or the rescaling in the headers may be wrong",
                self.n_beyond
            );
            warnings.push(Warning::new("ct.implausible_values", text));
        }
        if self.n_too_long > 0 {
            let text = format!(
                "{} image(s) hold more pixels than Rows, Columns and NumberOfFrames say: what is left over was not read; one of these may be wrong",
                self.n_too_long
            );
            warnings.push(Warning::new("ct.more_pixels", text));
        }
        if self.n_lossy > 0 {
            let text = format!(
                "{} image(s) are compressed with loss although their headers say that they are not: {LOSS_CONSEQUENCE}",
                self.n_lossy
            );
            warnings.push(Warning::new("ct.lossy", text));
        }
        warnings
    }
}

/// The data sets of deflated files of many frames.
#[derive(Debug, Default)]
pub(super) struct Inflated<'h>(BTreeMap<&'h Path, Vec<u8>>);

impl<'h> Inflated<'h> {
    /// Inflates what those images need, each file once and no farther than to its last image.
    ///
    /// # Errors
    /// [`Error`] where a file cannot be read or is too large, or on interruption.
    pub(super) fn of(images: impl Iterator<Item = &'h Header>, task: &Task<'_>) -> Result<Self, Error> {
        let mut wanted: BTreeMap<&'h Path, (u64, u64)> = BTreeMap::new();
        for header in images.filter(|h| h.frame.number.is_some()) {
            let Some(start) = header.frame.deflated_from else { continue };
            let end = header.frame.pieces.iter().map(|p| p.end).max().unwrap_or(0);
            let file = wanted.entry(&header.path).or_insert((start, end));
            file.1 = file.1.max(end);
        }
        let inflate = |(path, (start, end))| Ok((path, inflated(path, start, end, task)?));
        wanted.into_iter().map(inflate).collect::<Result<_, Error>>().map(Self)
    }
}

/// The first bytes of the data set that a file holds deflated from `start` on.
fn inflated(path: &Path, start: u64, end: u64, task: &Task<'_>) -> Result<Vec<u8>, Error> {
    /// Bytes between two looks at whether to go on.
    const PIECE_BYTES: u64 = 1 << 22;
    let mut bytes = reserved(path, end)?;
    let mut file = File::open(path).map_err(|e| unreadable(path, e))?;
    file.seek(SeekFrom::Start(start)).map_err(|e| unreadable(path, e))?;
    let mut stream = DeflateDecoder::new(BufReader::new(file));
    loop {
        task.check()?;
        let wanted = PIECE_BYTES.min(end - bytes.len() as u64);
        let n = (&mut stream).take(wanted).read_to_end(&mut bytes).map_err(|e| unreadable(path, e))?;
        if n == 0 {
            return Ok(bytes);
        }
    }
}

/// Memory for that many bytes, asked for in a way that may fail.
fn reserved(path: &Path, n_bytes: u64) -> Result<Vec<u8>, Error> {
    let too_many = || damaged(path, "its pixels are too many");
    let n = usize::try_from(n_bytes).ok().ok_or_else(too_many)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(n).ok().ok_or_else(too_many)?;
    Ok(bytes)
}

/// Reads the image of a header into `plane` (row by row), columns and rows reversed as asked.
pub(super) fn read_plane(
    header: &Header,
    inflated: &Inflated<'_>,
    reversed: [bool; 2],
    plane: &mut [f32],
) -> Result<Findings, Error> {
    let mut bytes = stored_bytes(header, inflated)?;
    if header.frame.is_swapped {
        bytes.chunks_exact_mut(2).for_each(|pair| pair.swap(0, 1));
    }
    let findings = match header.syntax.packing {
        Packing::Native { is_big_endian } => native(header, &bytes, is_big_endian, plane)?,
        Packing::Compressed(codec) => {
            let samples = decoded(header, codec, &bytes)?;
            let extend = Extension::of(&samples, header.pixels);
            let found = Intensity::of(header).rescale(samples.words.iter().map(|&w| extend.word(w)), plane);
            // Where the header lets it be lossy, that was told.
            let is_untold = !samples.is_lossless && header.loss == Loss::Nowhere;
            Findings { n_lossy: usize::from(is_untold), ..found }
        }
        Packing::Unknown => {
            return Err(Error::UnsupportedSyntax {
                path: header.path.clone(),
                syntax: header.syntax.name.to_owned(),
            });
        }
    };
    turn_over(plane, header.shape.columns, reversed);
    Ok(Findings { n_too_long: usize::from(header.frame.is_too_long), ..findings })
}

/// The bytes of the image as they stand in the file, or in its inflated data set.
fn stored_bytes(header: &Header, inflated: &Inflated<'_>) -> Result<Vec<u8>, Error> {
    let path = &header.path;
    let length = header.frame.pieces.iter().map(|p| p.end - p.start).sum::<u64>();
    let mut bytes = reserved(path, length)?;
    match inflated.0.get(path.as_path()) {
        Some(data_set) => copy_pieces(header, data_set, &mut bytes),
        None => read_pieces(header, &mut bytes).map_err(|e| unreadable(path, e))?,
    }
    if (bytes.len() as u64) < length {
        return Err(Error::Truncated {
            path: path.clone(),
            found_bytes: bytes.len(),
            expected_bytes: usize::try_from(length).unwrap_or(usize::MAX),
        });
    }
    Ok(bytes)
}

fn copy_pieces(header: &Header, data_set: &[u8], bytes: &mut Vec<u8>) {
    let place = |at: u64| usize::try_from(at).unwrap_or(usize::MAX);
    let pieces = header.frame.pieces.iter().filter_map(|p| data_set.get(place(p.start)..place(p.end)));
    pieces.for_each(|piece| bytes.extend_from_slice(piece));
}

fn read_pieces(header: &Header, bytes: &mut Vec<u8>) -> io::Result<()> {
    let mut file = File::open(&header.path)?;
    let Some(start) = header.frame.deflated_from else {
        for piece in &header.frame.pieces {
            file.seek(SeekFrom::Start(piece.start))?;
            (&file).take(piece.end - piece.start).read_to_end(bytes)?;
        }
        return Ok(());
    };
    file.seek(SeekFrom::Start(start))?;
    let mut inflated = DeflateDecoder::new(BufReader::new(file));
    let mut position = 0;
    for piece in &header.frame.pieces {
        io::copy(&mut (&mut inflated).take(piece.start - position), &mut io::sink())?;
        (&mut inflated).take(piece.end - piece.start).read_to_end(bytes)?;
        position = piece.end;
    }
    Ok(())
}

fn native(header: &Header, bytes: &[u8], is_big_endian: bool, plane: &mut [f32]) -> Result<Findings, Error> {
    let intensity = Intensity::of(header);
    let n_words = bytes.len() / usize::from(header.pixels.bits_allocated / 8);
    if n_words < plane.len() {
        let expected_bytes = plane.len() * usize::from(header.pixels.bits_allocated / 8);
        return Err(Error::Truncated { path: header.path.clone(), found_bytes: bytes.len(), expected_bytes });
    }
    let pairs = bytes.chunks_exact(2).map(|b| [b[0], b[1]]);
    Ok(match (header.pixels.bits_allocated, is_big_endian) {
        (8, _) => intensity.rescale(bytes.iter().map(|&b| b.into()), plane),
        (_, false) => intensity.rescale(pairs.map(u16::from_le_bytes), plane),
        (_, true) => intensity.rescale(pairs.map(u16::from_be_bytes), plane),
    })
}

fn decoded(header: &Header, codec: Codec, bytes: &[u8]) -> Result<Samples, Error> {
    let size = Size { columns: header.shape.columns, rows: header.shape.rows };
    let undecodable = |fault| Error::Undecodable {
        path: header.path.clone(),
        frame: header.frame.number,
        syntax: header.syntax.name,
        fault,
    };
    let samples = codec.decode(bytes, size).map_err(undecodable)?;
    if samples.precision_bits > u32::from(header.pixels.bits_allocated) {
        return Err(undecodable(Fault::Damaged("the compressed pixels have more bits than the header says")));
    }
    Ok(samples)
}

/// How the sign of a sample of few bits reaches a word of more.
#[derive(Debug, Clone, Copy)]
struct Extension {
    shift: u32,
}

impl Extension {
    /// Samples that their stream calls unsigned and the header signed: the highest bit of the stream is the sign.
    fn of(samples: &Samples, format: PixelFormat) -> Self {
        let is_short = samples.precision_bits < u32::from(format.bits_stored);
        let shift =
            if format.is_signed && !samples.is_signed && is_short { 16 - samples.precision_bits } else { 0 };
        Self { shift }
    }

    const fn word(self, word: u16) -> u16 {
        ((word << self.shift).cast_signed() >> self.shift).cast_unsigned()
    }
}

/// How a stored word becomes an intensity.
struct Intensity {
    format: PixelFormat,
    slope: f64,
    intercept: f64,
    /// Stored values that become [`PADDING_HU`].
    padding: Option<[i32; 2]>,
    is_ct: bool,
}

impl Intensity {
    fn of(header: &Header) -> Self {
        let [slope, intercept] = header.rescale.unwrap_or([1.0, 0.0]);
        let is_ct = header.modality == "CT";
        // In other modalities padding is as dark as anything, and has no absolute value to take.
        let padding = header.padding.filter(|_| is_ct);
        Self { format: header.pixels, slope, intercept, padding, is_ct }
    }

    /// Rescales words into a plane.
    fn rescale(&self, words: impl Iterator<Item = u16>, plane: &mut [f32]) -> Findings {
        let mut findings = Findings::default();
        for (hu, word) in plane.iter_mut().zip(words) {
            let stored = self.stored(word);
            if self.is_padding(word, stored) {
                findings.n_padding += 1;
                *hu = PADDING_HU;
                continue;
            }
            findings.n_foreign_bits += usize::from(self.has_foreign_bits(word, stored));
            *hu = self.hu(stored);
            findings.n_beyond += usize::from(self.is_ct && !(LOWEST_HU..=LARGEST_HU).contains(hu));
        }
        findings
    }

    /// The stored value: its bits cut out of the word and its sign extended.
    fn stored(&self, word: u16) -> i32 {
        let PixelFormat { bits_stored, high_bit, is_signed, .. } = self.format;
        let from_low_bit = i32::from(word) >> (high_bit + 1 - bits_stored);
        let value = from_low_bit & ((1 << bits_stored) - 1);
        let is_negative = is_signed && value >> (bits_stored - 1) == 1;
        if is_negative { value - (1 << bits_stored) } else { value }
    }

    /// The value of the whole word.
    fn whole(&self, word: u16) -> i32 {
        match (self.format.is_signed, self.format.bits_allocated) {
            (true, 16) => word.cast_signed().into(),
            _ => word.into(),
        }
    }

    /// Padding may use bits beyond those that are stored: -2000 does in 16 bits, where 12 are stored.
    fn is_padding(&self, word: u16, stored: i32) -> bool {
        self.padding.is_some_and(|[a, b]| (a..=b).contains(&stored) || (a..=b).contains(&self.whole(word)))
    }

    /// Whether the word holds more than the stored value, its sign repeated or not.
    fn has_foreign_bits(&self, word: u16, stored: i32) -> bool {
        let PixelFormat { bits_allocated, bits_stored, high_bit, .. } = self.format;
        let shift = high_bit + 1 - bits_stored;
        let mask = (1_i32 << bits_allocated) - 1;
        let repeated = (stored << shift) & mask;
        let plain = ((stored & ((1 << bits_stored) - 1)) << shift) & mask;
        i32::from(word) != repeated && i32::from(word) != plain
    }

    fn hu(&self, stored: i32) -> f32 {
        #[expect(clippy::cast_possible_truncation, reason = "24 bits hold 16-bit values and their rescaling")]
        let hu = (f64::from(stored) * self.slope + self.intercept) as f32;
        hu
    }
}

fn turn_over(plane: &mut [f32], columns: usize, reversed: [bool; 2]) {
    match reversed {
        [true, true] => plane.reverse(),
        [true, false] => plane.chunks_exact_mut(columns).for_each(<[f32]>::reverse),
        [false, true] => {
            plane.reverse();
            plane.chunks_exact_mut(columns).for_each(<[f32]>::reverse);
        }
        [false, false] => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn intensity(bits_stored: u16, high_bit: u16, is_signed: bool) -> Intensity {
        let format = PixelFormat { bits_allocated: 16, bits_stored, high_bit, is_signed };
        Intensity { format, slope: 2.0, intercept: -1000.0, padding: Some([-2000, -2000]), is_ct: true }
    }

    #[test]
    fn stored_bits_are_cut_out_and_signed() {
        assert_eq!(intensity(12, 11, false).stored(0xf123), 0x123);
        assert_eq!(intensity(12, 15, false).stored(0x1234), 0x123);
        assert_eq!(intensity(12, 11, true).stored(0x0fff), -1);
        assert_eq!(intensity(12, 11, true).stored(0xffff), -1);
        assert_eq!(intensity(12, 11, true).stored(0x07ff), 2047);
        assert_eq!(intensity(16, 15, true).stored(0x8000), -32768);
        assert_eq!(intensity(16, 15, false).stored(0xffff), 65535);
        assert_eq!(intensity(1, 0, false).stored(3), 1);
    }

    #[test]
    fn bits_outside_the_stored_ones_are_told_from_a_repeated_sign() {
        let is_odd = |i: Intensity, word: u16| i.has_foreign_bits(word, i.stored(word));
        assert!(is_odd(intensity(12, 11, false), 0xf123));
        assert!(!is_odd(intensity(12, 11, false), 0x0fff));
        assert!(!is_odd(intensity(12, 11, true), 0xffff));
        assert!(!is_odd(intensity(12, 11, true), 0x0fff));
        assert!(is_odd(intensity(12, 11, true), 0x1fff));
        assert!(is_odd(intensity(12, 15, false), 0x1234));
        assert!(!is_odd(intensity(16, 15, true), 0x8000));
    }

    #[test]
    fn padding_becomes_air_and_the_rest_is_rescaled() {
        let words = [(-2000_i16).cast_unsigned(), 100, 17_000];
        let mut plane = [0.0; 3];
        let findings = intensity(16, 15, true).rescale(words.into_iter(), &mut plane);
        assert_eq!(plane, [-1024.0, -800.0, 33_000.0]);
        assert_eq!(findings, Findings { n_padding: 1, n_beyond: 1, ..Findings::default() });
        let codes: Vec<String> = findings.warnings().into_iter().map(|w| w.code).collect();
        assert_eq!(codes, ["ct.implausible_values"]);
    }

    #[test]
    fn padding_beyond_the_stored_bits_is_padding() {
        let mut plane = [0.0; 2];
        // -2000 in 16 bits would be 2096 in 12 bits without sign: bright as bone.
        let words = [(-2000_i16).cast_unsigned(), 1000];
        let scanner = Intensity { padding: Some([63_536, 63_536]), ..intensity(12, 11, false) };
        let findings = scanner.rescale(words.into_iter(), &mut plane);
        assert_eq!((plane, findings.n_padding), ([-1024.0, 1000.0], 1));
    }

    #[test]
    fn short_samples_take_their_sign_with_them() {
        let format = |is_signed| PixelFormat { bits_allocated: 16, bits_stored: 16, high_bit: 15, is_signed };
        let samples = Samples { words: Vec::new(), precision_bits: 12, is_signed: false, is_lossless: true };
        assert_eq!(Extension::of(&samples, format(true)).word(0x0fff), 0xffff);
        assert_eq!(Extension::of(&samples, format(true)).word(0x07ff), 0x07ff);
        assert_eq!(Extension::of(&samples, format(false)).word(0x0fff), 0x0fff);
    }

    #[test]
    fn images_are_turned_over_by_columns_and_rows() {
        let turned = |reversed| {
            let mut plane = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
            turn_over(&mut plane, 3, reversed);
            plane
        };
        assert_eq!(turned([true, false]), [3.0, 2.0, 1.0, 6.0, 5.0, 4.0]);
        assert_eq!(turned([false, true]), [4.0, 5.0, 6.0, 1.0, 2.0, 3.0]);
        assert_eq!(turned([true, true]), [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]);
    }
}
