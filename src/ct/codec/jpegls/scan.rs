//! Entropy-coded bits to rows of samples (ITU-T T.87 A.4 to A.8).

use super::super::Fault;
use super::super::markers::behind_restart;
use super::bits::Bits;
use super::model::{Context, Model, Neighbours, RUN_BITS};
use super::parameters::Parameters;

/// Decodes all rows of a scan into `words`; `restart_rows` is 0 where no restart markers stand in it.
pub(super) fn decode(
    mut bytes: &[u8],
    parameters: &Parameters,
    restart_rows: usize,
    columns: usize,
    words: &mut [u16],
) -> Result<(), Fault> {
    let n_rows = words.len() / columns;
    let interval = if restart_rows == 0 { n_rows } else { restart_rows };
    for (number, rows) in words.chunks_mut(interval.saturating_mul(columns)).enumerate() {
        if number > 0 {
            bytes = behind_restart(bytes, number - 1)?;
        }
        bytes = decode_interval(bytes, parameters, columns, rows)?;
    }
    Ok(())
}

/// Decodes rows that depend on none before them; returns what follows.
fn decode_interval<'a>(
    bytes: &'a [u8],
    parameters: &Parameters,
    columns: usize,
    words: &mut [u16],
) -> Result<&'a [u8], Fault> {
    let mut decoder = Decoder { bits: Bits::new(bytes), model: Model::new(parameters) };
    let mut above = Row::new(columns);
    let mut row = Row::new(columns);
    for out in words.chunks_exact_mut(columns) {
        row.begin_below(&above);
        decoder.row(&mut row, &above)?;
        row.end();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 65535")]
        out.iter_mut().zip(row.samples()).for_each(|(word, &s)| *word = s as u16);
        std::mem::swap(&mut row, &mut above);
    }
    Ok(decoder.bits.rest())
}

/// A row of samples with one more at each end, as the neighbours of the outermost.
#[derive(Debug)]
pub(super) struct Row(Vec<i32>);

impl Row {
    /// A row of zeros, such as lies above the first.
    pub(super) fn new(columns: usize) -> Self {
        Self(vec![0; columns + 2])
    }

    /// Left of a row stands the first sample of the row above.
    pub(super) fn begin_below(&mut self, above: &Self) {
        self.0[0] = above.0[1];
    }

    /// Right of a row its last sample is repeated.
    pub(super) fn end(&mut self) {
        let n = self.0.len();
        self.0[n - 1] = self.0[n - 2];
    }

    pub(super) fn samples(&self) -> &[i32] {
        &self.0[1..self.0.len() - 1]
    }

    pub(super) fn samples_mut(&mut self) -> &mut [i32] {
        let n = self.0.len();
        &mut self.0[1..n - 1]
    }

    /// Neighbours of the sample in that column, from 0.
    pub(super) fn neighbours(&self, above: &Self, column: usize) -> Neighbours {
        Neighbours { a: self.0[column], b: above.0[column + 1], c: above.0[column], d: above.0[column + 2] }
    }
}

#[derive(Debug)]
struct Decoder<'a, 'm> {
    bits: Bits<'a>,
    model: Model<'m>,
}

impl Decoder<'_, '_> {
    fn row(&mut self, row: &mut Row, above: &Row) -> Result<(), Fault> {
        let n = row.samples().len();
        let mut column = 0;
        while column < n {
            let neighbours = row.neighbours(above, column);
            if let Some(context) = neighbours.context(self.model.parameters) {
                row.samples_mut()[column] = self.sample(&neighbours, context)?;
            } else {
                column = self.run(row, above, column)?;
            }
            column += 1;
        }
        Ok(())
    }

    fn sample(&mut self, neighbours: &Neighbours, context: Context) -> Result<i32, Fault> {
        let prediction = self.model.predict(neighbours, context);
        let (k, is_inverted) = self.model.code(context);
        let code = self.golomb(k, self.model.parameters.limit)?;
        let folded = if code & 1 == 0 { code >> 1 } else { -((code + 1) >> 1) };
        // Bitwise complement: 0 and -1 change places, 1 and -2, and so on.
        let error = self.model.checked(if is_inverted { !folded } else { folded })?;
        self.model.learn(context, error);
        Ok(self.model.parameters.reconstruct(prediction, context.sign * error))
    }

    /// A run and the sample that interrupts it; returns the last column that was decoded.
    fn run(&mut self, row: &mut Row, above: &Row, start: usize) -> Result<usize, Fault> {
        let value = row.neighbours(above, start).a;
        let n_left = row.samples().len() - start;
        let length = self.run_length(n_left)?;
        row.samples_mut()[start..start + length].fill(value);
        if length == n_left {
            return Ok(start + length - 1);
        }
        let column = start + length;
        row.samples_mut()[column] = self.interruption(value, row.neighbours(above, column).b)?;
        self.model.run_index = self.model.run_index.saturating_sub(1);
        Ok(column)
    }

    fn run_length(&mut self, n_left: usize) -> Result<usize, Fault> {
        let mut length = 0;
        while self.bits.bit()? {
            let piece = 1 << RUN_BITS[self.model.run_index];
            if length + piece <= n_left {
                self.model.run_index = (self.model.run_index + 1).min(RUN_BITS.len() - 1);
            }
            length = (length + piece).min(n_left);
            if length == n_left {
                return Ok(length);
            }
        }
        let rest = self.bits.number(RUN_BITS[self.model.run_index])?;
        length += rest.unsigned_abs() as usize;
        if length >= n_left {
            return Err(Fault::Damaged("a run of the JPEG-LS pixels goes beyond its row"));
        }
        Ok(length)
    }

    fn interruption(&mut self, left: i32, above: i32) -> Result<i32, Fault> {
        let parameters = self.model.parameters;
        let is_level = (left - above).abs() <= parameters.near;
        let (k, are_negative_odd) = self.model.interruption_code(is_level);
        let code = self.golomb(k, parameters.limit - RUN_BITS[self.model.run_index] - 1)?;
        let doubled = code + i32::from(is_level);
        let size = (doubled + 1) >> 1;
        let is_negative = (doubled & 1 == 1) == are_negative_odd;
        let error = self.model.checked(if is_negative { -size } else { size })?;
        self.model.learn_interruption(is_level, error, code);
        Ok(match (is_level, left > above) {
            (true, _) => parameters.reconstruct(left, error),
            (false, true) => parameters.reconstruct(above, -error),
            (false, false) => parameters.reconstruct(above, error),
        })
    }

    /// A Golomb code of limited length (T.87 A.5.3).
    fn golomb(&mut self, k: u32, limit: u32) -> Result<i32, Fault> {
        let error_bits = self.model.parameters.error_bits;
        let most = limit.checked_sub(error_bits + 1);
        let most = most.ok_or(Fault::Damaged("the JPEG-LS parameters leave no room for a code"))?;
        let n_zeros = self.bits.zeros(most)?;
        if n_zeros == most {
            return Ok(self.bits.number(error_bits)? + 1);
        }
        let low = self.bits.number(k)?;
        Ok(n_zeros.cast_signed() << k | low)
    }
}
