//! RLE: one byte plane after the other, the most significant first, each PackBits-coded (DICOM PS3.5 annex G).

use super::{Fault, Samples, Size, zeroed};

/// Bytes of the header: a count and fifteen offsets.
const HEADER: usize = 64;

/// Decodes one image of 1 or 2 bytes per pixel.
pub(super) fn decode(bytes: &[u8], size: Size, bytes_per_pixel: usize) -> Result<Samples, Fault> {
    let header = bytes.get(..HEADER).ok_or(Fault::Truncated)?;
    let numbers: Vec<usize> =
        header.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize).collect();
    if numbers[0] != bytes_per_pixel || !(1..=2).contains(&bytes_per_pixel) {
        return Err(Fault::Damaged(
            "the run-length pixels have another number of segments than bytes per pixel",
        ));
    }
    let mut words = zeroed(size.n_pixels())?;
    for plane in 0..bytes_per_pixel {
        let start = numbers[1 + plane];
        let end = if plane + 1 < bytes_per_pixel { numbers[2 + plane] } else { bytes.len() };
        if start < HEADER || start > end {
            return Err(Fault::Damaged("the segments of the run-length pixels are out of order"));
        }
        let segment = bytes.get(start..end).ok_or(Fault::Truncated)?;
        unpack(segment, &mut words)?;
    }
    Ok(Samples { words, precision_bits: 8 * u32::from(bytes_per_pixel == 2) + 8, is_signed: false })
}

/// Shifts the next byte of each word in; a run that goes on beyond the last word is cut.
fn unpack(mut segment: &[u8], words: &mut [u16]) -> Result<(), Fault> {
    let mut words = words.iter_mut();
    while words.len() > 0 {
        let (&control, rest) = segment.split_first().ok_or(Fault::Truncated)?;
        let n = usize::from(control.wrapping_neg()) + 1;
        segment = match control {
            0..=127 => {
                let n = usize::from(control) + 1;
                let (literal, rest) = rest.split_at_checked(n).ok_or(Fault::Truncated)?;
                literal.iter().zip(words.by_ref()).for_each(|(&b, word)| shift_in(word, b));
                rest
            }
            128 => rest,
            _ => {
                let (&byte, rest) = rest.split_first().ok_or(Fault::Truncated)?;
                words.by_ref().take(n).for_each(|word| shift_in(word, byte));
                rest
            }
        };
    }
    Ok(())
}

fn shift_in(word: &mut u16, byte: u8) {
    *word = *word << 8 | u16::from(byte);
}
