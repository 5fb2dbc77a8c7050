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
    Ok(Samples {
        words,
        precision_bits: 8 * u32::from(bytes_per_pixel == 2) + 8,
        is_signed: false,
        is_lossless: true,
    })
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A byte plane as runs of two to 128 equal bytes, and literals of 128 at most.
    fn packed(plane: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        let mut left = plane;
        while let Some(&first) = left.first() {
            let n = left.iter().take(128).take_while(|&&b| b == first).count();
            if n > 1 {
                out.extend([u8::try_from(257 - n).unwrap(), first]);
            } else {
                out.extend([0, first]);
            }
            left = &left[n..];
        }
        out
    }

    fn encoded(words: &[u16], bytes_per_pixel: usize) -> Vec<u8> {
        let plane =
            |i: usize| packed(&words.iter().map(|w| (w >> (8 * i)).to_le_bytes()[0]).collect::<Vec<_>>());
        let planes: Vec<Vec<u8>> = (0..bytes_per_pixel).rev().map(plane).collect();
        let mut header = vec![u32::try_from(bytes_per_pixel).unwrap()];
        let mut at = HEADER;
        for plane in &planes {
            header.push(u32::try_from(at).unwrap());
            at += plane.len();
        }
        header.resize(16, 0);
        [header.into_iter().flat_map(u32::to_le_bytes).collect(), planes.concat()].concat()
    }

    fn images() -> impl Strategy<Value = (Vec<u16>, usize)> {
        let value = prop_oneof![Just(0_u16), Just(1000), any::<u16>()];
        (prop::collection::vec(value, 1..300), 1_usize..=2).prop_map(|(mut words, n)| {
            words.iter_mut().filter(|_| n == 1).for_each(|w| *w &= 0xff);
            (words, n)
        })
    }

    proptest! {
        #[test]
        fn what_was_packed_is_unpacked((words, n) in images()) {
            let size = Size { columns: words.len(), rows: 1 };
            let samples = decode(&encoded(&words, n), size, n).unwrap();
            prop_assert_eq!((samples.words, samples.precision_bits), (words, if n == 2 { 16 } else { 8 }));
        }

        #[test]
        fn damaged_streams_never_panic(
            (words, n) in images(),
            at in any::<prop::sample::Index>(),
            byte in any::<u8>(),
            is_cut in any::<bool>(),
        ) {
            let mut bytes = encoded(&words, n);
            let at = at.index(bytes.len());
            bytes[at] ^= byte;
            if is_cut {
                bytes.truncate(at);
            }
            let size = Size { columns: words.len(), rows: 1 };
            if let Ok(samples) = decode(&bytes, size, n) {
                prop_assert_eq!(samples.words.len(), words.len());
            }
        }
    }

    #[test]
    fn segments_that_end_early_or_are_too_many_are_refused() {
        let bytes = encoded(&[7; 50], 2);
        let size = Size { columns: 50, rows: 1 };
        assert_eq!(decode(&bytes[..bytes.len() - 1], size, 2), Err(Fault::Truncated));
        assert!(matches!(decode(&bytes, size, 1), Err(Fault::Damaged(_))));
    }
}
