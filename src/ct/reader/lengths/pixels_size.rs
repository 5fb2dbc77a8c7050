//! How many bytes the pixels of a deflated file may have, by what its header states before them. Pure.
//!
//! A few bytes may inflate to as many pixels as an element can claim, 4 GiB: more than the image's own are not waited for.

use dicom_core::Tag;
use dicom_dictionary_std::tags;

/// Most bits of a pixel where the header does not say: three samples of 32.
const MOST_PIXEL_BITS: u64 = 96;
/// Files may hold more pixels than their headers say, which is told; so many times more are none.
const MOST_TIMES: u64 = 2;

/// What a header states of its pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PixelsSize {
    frames: u64,
    rows: u64,
    columns: u64,
    samples: u64,
    /// Of a sample; nothing where the header does not say.
    bits: Option<u64>,
}

impl PixelsSize {
    pub(super) const UNSTATED: Self = Self { frames: 1, rows: 0, columns: 0, samples: 1, bits: None };

    /// Whether the attribute is one of them.
    pub(super) fn has(tag: Tag) -> bool {
        matches!(
            tag,
            tags::NUMBER_OF_FRAMES
                | tags::ROWS
                | tags::COLUMNS
                | tags::SAMPLES_PER_PIXEL
                | tags::BITS_ALLOCATED
        )
    }

    /// Takes the value of such an attribute as it stands in the file, little endian.
    pub(super) fn take(&mut self, tag: Tag, bytes: &[u8]) {
        let text = || std::str::from_utf8(bytes).ok()?.trim_matches(['\0', ' ']).parse().ok();
        let word = || bytes.first_chunk().map(|b| u64::from(u16::from_le_bytes(*b)));
        match tag {
            tags::ROWS => self.rows = word().unwrap_or(0),
            tags::COLUMNS => self.columns = word().unwrap_or(0),
            tags::SAMPLES_PER_PIXEL => self.samples = word().unwrap_or(1),
            tags::BITS_ALLOCATED => self.bits = word(),
            _ => self.frames = text().unwrap_or(1),
        }
    }

    /// The most bytes that such pixels have.
    pub(super) fn most_bytes(&self) -> u64 {
        let stated = |bits: u64| bits.saturating_mul(self.samples).saturating_mul(MOST_TIMES);
        let bits = self.bits.map_or(MOST_PIXEL_BITS, stated);
        let all = [self.frames, self.rows, self.columns].into_iter().fold(bits, u64::saturating_mul);
        // Bits are written in words.
        all.div_ceil(16).saturating_mul(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_have_no_more_bytes_than_their_bits_fill() {
        let mut size = PixelsSize::UNSTATED;
        assert_eq!(size.most_bytes(), 0);
        for (tag, bytes) in
            [(tags::NUMBER_OF_FRAMES, b"40 ".as_slice()), (tags::ROWS, &[0, 2]), (tags::COLUMNS, &[0, 1])]
        {
            assert!(PixelsSize::has(tag));
            size.take(tag, bytes);
        }
        assert_eq!(size.most_bytes(), 40 * 512 * 256 * 12);
        size.take(tags::BITS_ALLOCATED, &[1, 0]);
        assert_eq!(size.most_bytes(), 40 * 512 * 256 / 8 * 2);
        size.take(tags::BITS_ALLOCATED, &[16, 0]);
        size.take(tags::SAMPLES_PER_PIXEL, &[3, 0]);
        assert_eq!(size.most_bytes(), 40 * 512 * 256 * 6 * 2);
        assert!(!PixelsSize::has(tags::PIXEL_DATA));
    }
}
