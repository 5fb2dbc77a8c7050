//! Compressed grey-scale pixels to samples: bytes in, words out. Pure.
//!
//! RLE (DICOM PS3.5 annex G), JPEG lossless and sequential DCT (ITU-T T.81), JPEG-LS (ITU-T T.87) and JPEG 2000
//! (ITU-T T.800 and T.814, by the `jpeg2k` library). All but the last are written here: of the libraries at hand, that
//! for JPEG takes no restart intervals in lossless streams and no 12 bits in lossy ones, and JPEG-LS would need C++.
//!
//! Nothing that a stream says about its size is believed: the caller says how many columns and rows there must be,
//! and a stream that says otherwise is refused before memory is set aside. [`Codec::least_bytes`] tells how many bytes an
//! image takes at the very least. Damaged streams give a [`Fault`], never a panic.
//!
//! Colour, progressive and arithmetic-coded JPEG are not read. Cost: one pass; memory: the samples, 2 bytes each (JPEG
//! 2000: 4 more).
//!
//! ```
//! use lumenfab::ct::codec::{Codec, Fault, Size};
//!
//! let empty = Codec::JpegLs.decode(b"", Size { columns: 4, rows: 4 });
//! assert_eq!(empty, Err(Fault::Truncated));
//! ```

pub mod jpeg;
mod jpeg2000;
pub mod jpegls;
mod markers;
mod rle;

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Columns and rows that an image must have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Pixels in a row.
    pub columns: usize,
    /// Pixels in a column.
    pub rows: usize,
}

impl Size {
    /// Pixels in all, as many as a machine can count at most.
    #[must_use]
    pub const fn n_pixels(self) -> usize {
        self.columns.saturating_mul(self.rows)
    }
}

/// Decoded pixels.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Samples {
    /// Row by row; the lowest `precision_bits` of each are the sample, those above repeat its sign.
    pub words: Vec<u16>,
    /// Bits of a sample as the stream says, 1 to 16.
    pub precision_bits: u32,
    /// Whether the stream itself says that its samples are signed; only JPEG 2000 can.
    pub is_signed: bool,
    /// Whether its way of coding gives back what was coded, as far as the stream tells.
    pub is_lossless: bool,
}

/// Why a stream gives no samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// It ends before its pixels do.
    #[error("the compressed pixels end early")]
    Truncated,
    /// It cannot have been written so.
    #[error("{0}")]
    Damaged(&'static str),
    /// It holds an image of another size.
    #[error("the compressed image has {} x {} pixels, the header says {} x {}", found.columns, found.rows, expected.columns, expected.rows)]
    OtherSize {
        /// Of the stream.
        found: Size,
        /// Of the header.
        expected: Size,
    },
    /// It is legal but not read.
    #[error("{0} is not supported")]
    Unsupported(&'static str),
}

/// A way of compressing pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Codec {
    /// Byte planes, run-length encoded, of so many bytes (1 or 2) per pixel.
    Rle {
        /// 1 or 2.
        bytes_per_pixel: usize,
    },
    /// Any JPEG process of ITU-T T.81.
    Jpeg,
    /// ITU-T T.87.
    JpegLs,
    /// ITU-T T.800, high-throughput block coding included.
    Jpeg2000,
}

impl Codec {
    /// Decodes one image.
    ///
    /// # Errors
    /// [`Fault`] where the stream is damaged, of another size, or of a kind that is not read.
    pub fn decode(self, bytes: &[u8], size: Size) -> Result<Samples, Fault> {
        match self {
            Self::Rle { bytes_per_pixel } => rle::decode(bytes, size, bytes_per_pixel),
            Self::Jpeg => jpeg::decode(bytes, size),
            Self::JpegLs => jpegls::decode(bytes, size),
            Self::Jpeg2000 => jpeg2000::decode(bytes, size),
        }
    }

    /// Bytes without which a stream cannot hold so many pixels, headers left out: what is shorter need not be tried, nor
    /// memory be set aside for it.
    #[must_use]
    pub const fn least_bytes(self, size: Size) -> usize {
        match self {
            // A run of 128 bytes takes two.
            Self::Rle { bytes_per_pixel } => 64 + size.n_pixels() / 64 * bytes_per_pixel,
            // Two codes of one bit for a block of 8 x 8 pixels, one for a pixel where there is no loss.
            Self::Jpeg => size.n_pixels() / 256,
            // A row that is one run takes a bit.
            Self::JpegLs => size.rows / 8,
            // An empty packet takes one byte; more than this in it is no image of a body.
            Self::Jpeg2000 => size.n_pixels() / 65_536,
        }
    }
}

thread_local! {
    static IS_DECODING: Cell<bool> = const { Cell::new(false) };
}

/// Whether this thread is within a decoder whose panics become a fault: a panic hook need not speak of them.
#[must_use]
pub fn is_decoding() -> bool {
    IS_DECODING.get()
}

/// What the decoder gives; none if it panics.
fn panics_caught<T>(decode: impl FnOnce() -> T) -> Option<T> {
    IS_DECODING.set(true);
    let decoded = catch_unwind(AssertUnwindSafe(decode));
    IS_DECODING.set(false);
    decoded.ok()
}

/// Zeroed memory for so many words, asked for in a way that may fail.
fn zeroed(n: usize) -> Result<Vec<u16>, Fault> {
    let mut words = Vec::new();
    words.try_reserve_exact(n).ok().ok_or(Fault::Damaged("its size is beyond this machine's memory"))?;
    words.resize(n, 0);
    Ok(words)
}

#[cfg(test)]
mod tests;
