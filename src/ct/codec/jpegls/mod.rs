//! JPEG-LS, lossless and near-lossless: a compressed grey-scale image to samples of 2 to 16 bits.
//!
//! Method: ITU-T T.87 (ISO/IEC 14495-1), written from the standard: each sample is predicted from four neighbours by the
//! median of three guesses, corrected by what its context has learnt, and the error is Golomb-coded; where the
//! neighbours agree, a run is coded instead. Preset parameters (LSE), restart intervals, oversize dimensions and an
//! image height given behind the scan (DNL) are taken.
//!
//! It deliberately reads one component: no colour, no mapping tables, no point transform.
//!
//! In near-lossless streams each sample differs from the original by NEAR at most. Cost: one pass, linear in the samples.
//!
//! ```
//! use lumenfab::ct::codec::{Fault, Size, jpegls};
//!
//! let size = Size { columns: 2, rows: 2 };
//! assert_eq!(jpegls::decode(&[0xff, 0xd8], size), Err(Fault::Truncated));
//! ```

mod bits;
#[cfg(test)]
mod encoder;
mod model;
mod parameters;
mod scan;
#[cfg(test)]
mod tests;

use super::markers::{DRI, EOI, Fields, SOS, Segments};
use super::{Codec, Fault, Samples, Size, zeroed};
use parameters::{Parameters, Preset};

/// Start of a JPEG-LS frame; preset parameters.
const SOF55: u8 = 0xf7;
const LSE: u8 = 0xf8;
/// Markers of the frames of other JPEG processes.
const OTHER_FRAMES: std::ops::RangeInclusive<u8> = 0xc0..=0xcf;

/// Decodes one image of exactly that size.
///
/// # Errors
/// [`Fault`] where the stream is damaged, ends early, is of another size or of a kind that is not read.
pub fn decode(bytes: &[u8], size: Size) -> Result<Samples, Fault> {
    let mut segments = Segments::of(bytes)?;
    let mut head = Head::default();
    loop {
        let (marker, fields) = segments.next()?;
        match marker {
            SOF55 => head.frame = Some(Frame::read(fields)?),
            LSE => head.read_preset(fields)?,
            DRI => head.restart_rows = restart_rows(fields)?,
            SOS => {
                let parameters = head.start_scan(fields, size)?;
                return decode_scan(segments.rest(), &parameters, head.restart_rows, size);
            }
            EOI => return Err(Fault::Truncated),
            _ if OTHER_FRAMES.contains(&marker) => {
                return Err(Fault::Damaged("the compressed pixels are JPEG but not JPEG-LS"));
            }
            _ => {}
        }
    }
}

/// What stands before the scan.
#[derive(Debug, Default)]
struct Head {
    frame: Option<Frame>,
    preset: Preset,
    oversize: Option<Size>,
    /// Rows between restart markers; 0 for none.
    restart_rows: usize,
}

/// The frame header.
#[derive(Debug, Clone, Copy)]
struct Frame {
    precision_bits: u32,
    size: Size,
}

impl Frame {
    fn read(mut fields: Fields<'_>) -> Result<Self, Fault> {
        let precision_bits = fields.byte()?.into();
        if !(2..=16).contains(&precision_bits) {
            return Err(Fault::Damaged(
                "the JPEG-LS samples have neither 2 nor 16 bits nor any number between",
            ));
        }
        let [rows, columns] = [fields.word()?.into(), fields.word()?.into()];
        if fields.byte()? != 1 {
            return Err(Fault::Unsupported("a JPEG-LS image in colour"));
        }
        Ok(Self { precision_bits, size: Size { columns, rows } })
    }
}

impl Head {
    fn read_preset(&mut self, mut fields: Fields<'_>) -> Result<(), Fault> {
        match fields.byte()? {
            1 => self.preset = Preset::read(fields)?,
            4 => self.oversize = Some(oversize(fields)?),
            // Mapping tables matter only to a scan that names one.
            _ => {}
        }
        Ok(())
    }

    /// Checks frame and scan headers against what is expected.
    fn start_scan(&self, mut fields: Fields<'_>, expected: Size) -> Result<Parameters, Fault> {
        let frame = self.frame.ok_or(Fault::Damaged("the JPEG-LS scan has no frame"))?;
        self.check_size(frame.size, expected)?;
        if fields.byte()? != 1 {
            return Err(Fault::Unsupported("a JPEG-LS scan of several components"));
        }
        let _component = fields.byte()?;
        if fields.byte()? != 0 {
            return Err(Fault::Unsupported("a JPEG-LS mapping table"));
        }
        let near = fields.byte()?;
        // How components are interleaved means nothing where there is one.
        let _interleaving = fields.byte()?;
        if fields.byte()? & 0x0f != 0 {
            return Err(Fault::Unsupported("a JPEG-LS point transform"));
        }
        Parameters::try_new(frame.precision_bits, near.into(), &self.preset)
    }

    fn check_size(&self, in_frame: Size, expected: Size) -> Result<(), Fault> {
        let stated = self.oversize.unwrap_or(in_frame);
        // No rows: their number follows the scan, and there must be as many as the caller knows.
        let rows = if stated.rows == 0 { expected.rows } else { stated.rows };
        let found = Size { rows, ..stated };
        if found != expected || expected.n_pixels() == 0 {
            return Err(Fault::OtherSize { found, expected });
        }
        Ok(())
    }
}

/// Dimensions of 2 to 4 bytes each.
fn oversize(mut fields: Fields<'_>) -> Result<Size, Fault> {
    let n_bytes = fields.byte()?.into();
    let mut dimension = || -> Result<usize, Fault> { big_endian(fields.take(n_bytes)?) };
    let (rows, columns) = (dimension()?, dimension()?);
    Ok(Size { columns, rows })
}

/// The restart interval, of 2 to 4 bytes: a number of rows, as a scan of one component counts.
fn restart_rows(mut fields: Fields<'_>) -> Result<usize, Fault> {
    big_endian(fields.take(fields.len())?)
}

fn big_endian(bytes: &[u8]) -> Result<usize, Fault> {
    if !(2..=4).contains(&bytes.len()) {
        return Err(Fault::Damaged("a number in the JPEG-LS header has an odd length"));
    }
    Ok(bytes.iter().fold(0, |n, &b| n << 8 | usize::from(b)))
}

fn decode_scan(
    bytes: &[u8],
    parameters: &Parameters,
    restart_rows: usize,
    size: Size,
) -> Result<Samples, Fault> {
    if bytes.len() < Codec::JpegLs.least_bytes(size) {
        return Err(Fault::Truncated);
    }
    let mut words = zeroed(size.n_pixels())?;
    scan::decode(bytes, parameters, restart_rows, size.columns, &mut words)?;
    let is_lossless = parameters.near == 0;
    Ok(Samples { words, precision_bits: parameters.precision_bits, is_signed: false, is_lossless })
}
