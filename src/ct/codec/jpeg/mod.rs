//! JPEG of one component, Huffman-coded: lossless (process 14) and sequential DCT of 8 or 12 bits (processes 1, 2 and 4).
//!
//! Method: ITU-T T.81, written from the standard. Lossless: all seven predictors, point transform, 2 to 16 bits, restart
//! intervals of whole rows. DCT: the inverse transform in floating point, so that each sample is what the standard's
//! formula gives, rounded.
//!
//! It deliberately reads no colour, no progressive, hierarchical or arithmetic-coded images.
//!
//! Cost: one pass, linear in the samples.
//!
//! ```
//! use lumenfab::ct::codec::{Fault, Size, jpeg};
//!
//! let size = Size { columns: 2, rows: 2 };
//! assert_eq!(jpeg::decode(&[0xff, 0xd8], size), Err(Fault::Truncated));
//! ```

mod dct;
#[cfg(test)]
mod encoder;
mod huffman;
mod lossless;
#[cfg(test)]
mod tests;

use super::markers::{DHT, DQT, DRI, EOI, Fields, SOS, Segments};
use super::{Fault, Samples, Size, zeroed};
use huffman::Table;

/// Frames: baseline and extended sequential DCT; lossless.
const SOF0: u8 = 0xc0;
const SOF1: u8 = 0xc1;
const SOF3: u8 = 0xc3;
/// Frames of the processes that are not read; 0xc4, 0xc8 and 0xcc among them are no frames.
const OTHER_FRAMES: [u8; 10] = [0xc2, 0xc5, 0xc6, 0xc7, 0xc9, 0xca, 0xcb, 0xcd, 0xce, 0xcf];

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
            SOF0 | SOF1 | SOF3 => head.frame = Some(Frame::read(fields, marker == SOF3)?),
            DHT => head.read_huffman_tables(fields)?,
            DQT => head.read_quantisation_tables(fields)?,
            DRI => head.restart_interval = Fields::word(&mut { fields })?.into(),
            SOS => return head.decode_scan(fields, segments.rest(), size),
            EOI => return Err(Fault::Truncated),
            _ if OTHER_FRAMES.contains(&marker) => {
                return Err(Fault::Unsupported("a progressive, hierarchical or arithmetic-coded JPEG image"));
            }
            _ => {}
        }
    }
}

/// What stands before the scan.
#[derive(Debug, Default)]
struct Head {
    frame: Option<Frame>,
    dc_tables: [Option<Table>; 4],
    ac_tables: [Option<Table>; 4],
    /// In the order of the zigzag.
    quantisation: [Option<[u16; 64]>; 4],
    /// Data units between restart markers: samples or blocks; 0 for none.
    restart_interval: usize,
}

/// The frame header.
#[derive(Debug, Clone, Copy)]
struct Frame {
    is_lossless: bool,
    precision_bits: u32,
    size: Size,
    quantisation: usize,
}

impl Frame {
    fn read(mut fields: Fields<'_>, is_lossless: bool) -> Result<Self, Fault> {
        let precision_bits = fields.byte()?.into();
        let is_legal =
            if is_lossless { (2..=16).contains(&precision_bits) } else { [8, 12].contains(&precision_bits) };
        if !is_legal {
            return Err(Fault::Damaged("the JPEG samples have a number of bits that no process has"));
        }
        let [rows, columns] = [fields.word()?.into(), fields.word()?.into()];
        if fields.byte()? != 1 {
            return Err(Fault::Unsupported("a JPEG image in colour"));
        }
        // Its number and its sampling, which means nothing where there is one component.
        fields.take(2)?;
        let quantisation = fields.byte()?.into();
        Ok(Self { is_lossless, precision_bits, size: Size { columns, rows }, quantisation })
    }
}

impl Head {
    fn read_huffman_tables(&mut self, mut fields: Fields<'_>) -> Result<(), Fault> {
        while !fields.is_empty() {
            let kind = fields.byte()?;
            let tables = if kind >> 4 == 0 { &mut self.dc_tables } else { &mut self.ac_tables };
            let place = tables.get_mut(usize::from(kind & 0x0f));
            let place = place.ok_or(Fault::Damaged("a JPEG table has a number above 3"))?;
            let counts = fields.take(16)?;
            let n_codes = counts.iter().map(|&n| usize::from(n)).sum();
            *place = Some(Table::try_new(counts, fields.take(n_codes)?)?);
        }
        Ok(())
    }

    fn read_quantisation_tables(&mut self, mut fields: Fields<'_>) -> Result<(), Fault> {
        while !fields.is_empty() {
            let kind = fields.byte()?;
            let place = self.quantisation.get_mut(usize::from(kind & 0x0f));
            let place = place.ok_or(Fault::Damaged("a JPEG table has a number above 3"))?;
            let mut steps = [0; 64];
            for step in &mut steps {
                *step = if kind >> 4 == 0 { fields.byte()?.into() } else { fields.word()? };
            }
            *place = Some(steps);
        }
        Ok(())
    }

    fn decode_scan(&self, mut fields: Fields<'_>, bytes: &[u8], expected: Size) -> Result<Samples, Fault> {
        let frame = self.frame.ok_or(Fault::Damaged("the JPEG scan has no frame"))?;
        // No rows in the frame: their number follows the scan, and there must be as many as the caller knows.
        let rows = if frame.size.rows == 0 { expected.rows } else { frame.size.rows };
        let found = Size { rows, ..frame.size };
        if found != expected || expected.n_pixels() == 0 {
            return Err(Fault::OtherSize { found, expected });
        }
        if fields.byte()? != 1 {
            return Err(Fault::Unsupported("a JPEG scan of several components"));
        }
        let _component = fields.byte()?;
        let tables = fields.byte()?;
        let (start, _end, low) = (fields.byte()?, fields.byte()?, fields.byte()? & 0x0f);
        let dc = table(&self.dc_tables, tables >> 4)?;
        let words = if frame.is_lossless {
            let coding =
                lossless::Coding::try_new(frame.precision_bits, start, low, self.restart_interval, expected)?;
            lossless::decode(bytes, dc, &coding)?
        } else {
            let ac = table(&self.ac_tables, tables & 0x0f)?;
            let steps = self.quantisation.get(frame.quantisation).copied().flatten();
            let steps = steps.ok_or(Fault::Damaged("the JPEG scan lacks a table"))?;
            let coding = dct::Coding::new(frame.precision_bits, &steps, self.restart_interval, expected);
            dct::decode(bytes, dc, ac, &coding)?
        };
        let (precision_bits, is_lossless) = (frame.precision_bits, frame.is_lossless);
        Ok(Samples { words, precision_bits, is_signed: false, is_lossless })
    }
}

fn table(tables: &[Option<Table>; 4], number: u8) -> Result<&Table, Fault> {
    let table = tables.get(usize::from(number)).and_then(Option::as_ref);
    table.ok_or(Fault::Damaged("the JPEG scan lacks a table"))
}
