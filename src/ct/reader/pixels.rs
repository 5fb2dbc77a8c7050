//! The pixels of one file: decoded, unpacked, rescaled.

use super::super::Error;
use super::super::series::{Header, PixelFormat};
use super::header::damaged;
use dicom_core::value::{PrimitiveValue, Value};
use dicom_dictionary_std::tags;
use dicom_object::DefaultDicomObject;
use dicom_pixeldata::PixelDecoder;
use std::borrow::Cow;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What a CT's padding outside the scanned circle becomes: air, as low as 12 bits go, HU.
const PADDING_HU: f32 = -1024.0;

/// Reads the image of a header into `plane` (row by row), columns and rows reversed as asked.
pub(super) fn read_plane(header: &Header, reversed: [bool; 2], plane: &mut [f32]) -> Result<(), Error> {
    let object = dicom_object::open_file(&header.path);
    let object = object.ok().ok_or_else(|| damaged(&header.path, "it cannot be parsed behind its header"))?;
    let words =
        if header.syntax.is_plain { plain_words(header, &object)? } else { decoded_words(header, &object)? };
    if words.len() < plane.len() {
        return Err(truncated(header, bytes_of(header, words.len()), plane.len()));
    }
    let intensity = Intensity::of(header);
    for (hu, word) in plane.iter_mut().zip(words.iter()) {
        *hu = intensity.hu(*word);
    }
    turn_over(plane, header.shape.columns, reversed);
    Ok(())
}

fn truncated(header: &Header, found_bytes: usize, n_pixels: usize) -> Error {
    Error::Truncated { path: header.path.clone(), found_bytes, expected_bytes: bytes_of(header, n_pixels) }
}

fn bytes_of(header: &Header, n_pixels: usize) -> usize {
    n_pixels * usize::from(header.pixels.bits_allocated / 8)
}

/// Stored words of an uncompressed image.
fn plain_words<'a>(header: &Header, object: &'a DefaultDicomObject) -> Result<Cow<'a, [u16]>, Error> {
    let element = object.get(tags::PIXEL_DATA).ok_or_else(|| damaged(&header.path, "it holds no pixels"))?;
    match (element.value(), header.pixels.bits_allocated) {
        (Value::Primitive(PrimitiveValue::U16(words)), 16) => Ok(Cow::Borrowed(words)),
        (Value::Primitive(value), bits) => Ok(Cow::Owned(words_of_bytes(&value.to_bytes(), bits))),
        _ => Err(damaged(&header.path, "its pixels are packed in another way than its header says")),
    }
}

/// Stored words of a compressed image.
fn decoded_words<'a>(header: &Header, object: &'a DefaultDicomObject) -> Result<Cow<'a, [u16]>, Error> {
    match panics_caught(|| object.decode_pixel_data()) {
        Some(Ok(pixels)) if pixels.bits_allocated() == header.pixels.bits_allocated => {
            Ok(Cow::Owned(words_of_bytes(pixels.data(), header.pixels.bits_allocated)))
        }
        Some(Err(fault)) if is_unsupported(&fault) => {
            Err(Error::UnsupportedSyntax { path: header.path.clone(), syntax: header.syntax.name.to_owned() })
        }
        _ => Err(damaged(&header.path, "its compressed pixels cannot be decoded")),
    }
}

thread_local! {
    static IS_DECODING: Cell<bool> = const { Cell::new(false) };
}

/// Whether this thread is within a decoder of compressed pixels, whose panics become an error of the file: a panic hook need not
/// speak of them.
#[must_use]
pub fn is_decoding() -> bool {
    IS_DECODING.get()
}

/// What the decoder gives; none if it panics. The JPEG 2000 decoder is a translation from C and may, on a damaged stream.
fn panics_caught<T>(decode: impl FnOnce() -> T) -> Option<T> {
    IS_DECODING.set(true);
    let decoded = catch_unwind(AssertUnwindSafe(decode));
    IS_DECODING.set(false);
    decoded.ok()
}

/// Whether the decoder is not built in; the library tells it in words only.
fn is_unsupported(fault: &dicom_pixeldata::Error) -> bool {
    let text = fault.to_string();
    text.contains("Unsupported") || text.contains("Unknown transfer syntax")
}

/// Little-endian bytes to words; a byte left over is padding.
fn words_of_bytes(bytes: &[u8], bits_allocated: u16) -> Vec<u16> {
    if bits_allocated == 8 {
        return bytes.iter().map(|&b| u16::from(b)).collect();
    }
    bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
}

/// How a stored word becomes an intensity.
struct Intensity {
    format: PixelFormat,
    slope: f64,
    intercept: f64,
    /// Stored values that become [`PADDING_HU`].
    padding: Option<[i32; 2]>,
}

impl Intensity {
    fn of(header: &Header) -> Self {
        let [slope, intercept] = header.rescale.unwrap_or([1.0, 0.0]);
        // In other modalities padding is as dark as anything, and has no absolute value to take.
        let padding = header.padding.filter(|_| header.modality == "CT");
        Self { format: header.pixels, slope, intercept, padding }
    }

    /// The stored value: its bits cut out of the word and its sign extended.
    fn stored(&self, word: u16) -> i32 {
        let PixelFormat { bits_stored, high_bit, is_signed, .. } = self.format;
        let from_low_bit = i32::from(word) >> (high_bit + 1 - bits_stored);
        let value = from_low_bit & ((1 << bits_stored) - 1);
        let is_negative = is_signed && value >> (bits_stored - 1) == 1;
        if is_negative { value - (1 << bits_stored) } else { value }
    }

    fn hu(&self, word: u16) -> f32 {
        let stored = self.stored(word);
        if self.padding.is_some_and(|[a, b]| (a..=b).contains(&stored)) {
            return PADDING_HU;
        }
        #[expect(clippy::cast_possible_truncation, reason = "24 bits hold 16-bit values and their rescaling")]
        let hu = f64::from(stored).mul_add(self.slope, self.intercept) as f32;
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
        Intensity { format, slope: 2.0, intercept: -1000.0, padding: Some([-2000, -2000]) }
    }

    #[test]
    fn a_decoder_that_panics_is_expected_until_it_has_ended() {
        assert_eq!(panics_caught(is_decoding), Some(true));
        assert_eq!(panics_caught::<()>(|| panic!("a damaged stream")), None);
        assert!(!is_decoding());
    }

    #[test]
    fn stored_bits_are_cut_out_and_signed() {
        assert_eq!(intensity(12, 11, false).stored(0xf123), 0x123);
        assert_eq!(intensity(12, 15, false).stored(0x1234), 0x123);
        assert_eq!(intensity(12, 11, true).stored(0x0fff), -1);
        assert_eq!(intensity(12, 11, true).stored(0x07ff), 2047);
        assert_eq!(intensity(16, 15, true).stored(0x8000), -32768);
        assert_eq!(intensity(16, 15, false).stored(0xffff), 65535);
        assert_eq!(intensity(1, 0, false).stored(3), 1);
    }

    #[test]
    fn padding_becomes_air_and_the_rest_is_rescaled() {
        let scanner = intensity(16, 15, true);
        assert_eq!(scanner.hu((-2000_i16).cast_unsigned()), -1024.0);
        assert_eq!(scanner.hu(100), -800.0);
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
