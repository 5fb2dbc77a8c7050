//! Lossless JPEG: differences to predictions (ITU-T T.81 annex H).

use super::super::markers::behind_restart;
use super::huffman::{Bits, Table};
use super::{Fault, Size, zeroed};

/// How an image is coded.
#[derive(Debug)]
pub(super) struct Coding {
    /// Number of the predictor, 1 to 7.
    predictor: u8,
    /// What the first sample is predicted as.
    first: i32,
    /// Low bits that were left out.
    n_left_out: u32,
    rows_per_interval: usize,
    size: Size,
}

impl Coding {
    /// The coding that the scan header states; the restart interval counts samples, and is 0 for none.
    pub(super) fn try_new(
        precision_bits: u32,
        predictor: u8,
        point_transform: u8,
        restart_interval: usize,
        size: Size,
    ) -> Result<Self, Fault> {
        if !(1..=7).contains(&predictor) {
            return Err(Fault::Damaged("the lossless JPEG pixels have no predictor"));
        }
        let n_left_out = u32::from(point_transform);
        if n_left_out >= precision_bits {
            return Err(Fault::Damaged("the lossless JPEG pixels leave out all bits"));
        }
        if !restart_interval.is_multiple_of(size.columns) {
            return Err(Fault::Damaged(
                "the restart interval of the lossless JPEG pixels is no number of rows",
            ));
        }
        let rows_per_interval = match restart_interval / size.columns {
            0 => size.rows,
            rows => rows,
        };
        Ok(Self {
            predictor,
            first: 1 << (precision_bits - n_left_out - 1),
            n_left_out,
            rows_per_interval,
            size,
        })
    }

    fn predict(&self, left: i32, above: i32, above_left: i32) -> i32 {
        match self.predictor {
            1 => left,
            2 => above,
            3 => above_left,
            4 => left + above - above_left,
            5 => left + ((above - above_left) >> 1),
            6 => above + ((left - above_left) >> 1),
            _ => (left + above) >> 1,
        }
    }
}

/// Decodes all samples.
pub(super) fn decode(mut bytes: &[u8], table: &Table, coding: &Coding) -> Result<Vec<u16>, Fault> {
    // Each sample takes a bit at least.
    if bytes.len() < coding.size.n_pixels() / 8 {
        return Err(Fault::Truncated);
    }
    let mut words = zeroed(coding.size.n_pixels())?;
    let interval = coding.rows_per_interval.saturating_mul(coding.size.columns);
    for (number, rows) in words.chunks_mut(interval).enumerate() {
        if number > 0 {
            bytes = behind_restart(bytes, number - 1)?;
        }
        let mut bits = Bits::new(bytes);
        decode_interval(&mut bits, table, coding, rows)?;
        bytes = bits.rest();
    }
    words.iter_mut().for_each(|w| *w <<= coding.n_left_out);
    Ok(words)
}

/// Decodes rows that depend on none before them.
fn decode_interval(
    bits: &mut Bits<'_>,
    table: &Table,
    coding: &Coding,
    words: &mut [u16],
) -> Result<(), Fault> {
    let columns = coding.size.columns;
    let (first_row, others) = words.split_at_mut(columns);
    let mut left = coding.first;
    for word in &mut *first_row {
        *word = sum(left, difference(bits, table)?);
        left = (*word).into();
    }
    let mut above: &[u16] = first_row;
    for row in others.chunks_exact_mut(columns) {
        decode_row(bits, table, coding, above, row)?;
        above = row;
    }
    Ok(())
}

fn decode_row(
    bits: &mut Bits<'_>,
    table: &Table,
    coding: &Coding,
    above: &[u16],
    row: &mut [u16],
) -> Result<(), Fault> {
    let mut left = 0;
    let mut above_left = 0;
    for (column, (word, &above)) in row.iter_mut().zip(above).enumerate() {
        let above = above.into();
        let prediction = if column == 0 { above } else { coding.predict(left, above, above_left) };
        *word = sum(prediction, difference(bits, table)?);
        left = (*word).into();
        above_left = above;
    }
    Ok(())
}

/// Modulo 2^16 (T.81 H.1.2.1).
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the remainder is meant")]
const fn sum(prediction: i32, difference: i32) -> u16 {
    (prediction + difference) as u16
}

fn difference(bits: &mut Bits<'_>, table: &Table) -> Result<i32, Fault> {
    match bits.value(table)? {
        n @ 0..=15 => bits.signed(n.into()),
        16 => Ok(1 << 15),
        _ => Err(Fault::Damaged("a difference of the lossless JPEG pixels has more than 16 bits")),
    }
}
