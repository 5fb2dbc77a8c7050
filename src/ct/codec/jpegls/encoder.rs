//! Samples to JPEG-LS, to test the decoder with. It shares the statistics of contexts with the decoder, not the coding;
//! that both follow the standard is shown by streams of other encoders.

use super::model::{Context, Model, Neighbours, RUN_BITS};
use super::parameters::{Parameters, Preset};
use super::scan::Row;

/// How to encode.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Options {
    pub(super) near: u8,
    pub(super) restart_rows: usize,
    pub(super) preset: Preset,
    /// Whether the number of rows is left to the reader.
    pub(super) is_height_open: bool,
    /// Whether the size stands in a segment of its own.
    pub(super) is_oversize: bool,
}

/// The stream of an image.
pub(super) fn encode(samples: &[u16], columns: usize, bits: u8, options: &Options) -> Vec<u8> {
    let rows = samples.len() / columns;
    let mut out = vec![0xff, 0xd8];
    let [stated_rows, stated_columns] = match (options.is_oversize, options.is_height_open) {
        (true, _) => [0, 0],
        (false, true) => [0, columns],
        _ => [rows, columns],
    };
    segment(
        &mut out,
        0xf7,
        &[&[bits], &word(stated_rows)[..], &word(stated_columns), &[1, 1, 0x11, 0]].concat(),
    );
    if options.preset.max_value != 0 || options.preset.reset != 0 || options.preset.thresholds[0] != 0 {
        let [t1, t2, t3] = options.preset.thresholds;
        let numbers = [options.preset.max_value, t1, t2, t3, options.preset.reset];
        let words: Vec<u8> = numbers.iter().flat_map(|&n| word(n.unsigned_abs() as usize)).collect();
        segment(&mut out, 0xf8, &[&[1], &words[..]].concat());
    }
    if options.is_oversize {
        let long = |n: usize| u32::try_from(n).unwrap().to_be_bytes();
        segment(&mut out, 0xf8, &[&[4, 4], &long(rows)[..], &long(columns)].concat());
    }
    if options.restart_rows > 0 {
        segment(&mut out, 0xdd, &word(options.restart_rows));
    }
    segment(&mut out, 0xda, &[1, 1, 0, options.near, 0, 0]);
    let parameters = Parameters::try_new(bits.into(), options.near.into(), &options.preset).unwrap();
    let interval = if options.restart_rows == 0 { rows } else { options.restart_rows };
    for (number, rows) in samples.chunks(interval * columns).enumerate() {
        if number > 0 {
            out.extend([0xff, 0xd0 + u8::try_from((number - 1) % 8).unwrap()]);
        }
        out.extend(interval_bits(rows, columns, &parameters));
    }
    out.extend([0xff, 0xd9]);
    out
}

fn segment(out: &mut Vec<u8>, marker: u8, body: &[u8]) {
    out.extend([0xff, marker]);
    out.extend(word(body.len() + 2));
    out.extend(body);
}

fn word(n: usize) -> [u8; 2] {
    u16::try_from(n).unwrap().to_be_bytes()
}

fn interval_bits(samples: &[u16], columns: usize, parameters: &Parameters) -> Vec<u8> {
    let mut encoder = Encoder { bits: BitWriter::default(), model: Model::new(parameters) };
    let (mut above, mut row) = (Row::new(columns), Row::new(columns));
    for line in samples.chunks(columns) {
        row.begin_below(&above);
        encoder.row(line, &mut row, &above);
        row.end();
        std::mem::swap(&mut row, &mut above);
    }
    encoder.bits.finish()
}

struct Encoder<'a> {
    bits: BitWriter,
    model: Model<'a>,
}

impl Encoder<'_> {
    fn row(&mut self, line: &[u16], row: &mut Row, above: &Row) {
        let mut column = 0;
        while column < line.len() {
            let neighbours = row.neighbours(above, column);
            match neighbours.context(self.model.parameters) {
                Some(context) => {
                    let value = self.sample(line[column].into(), &neighbours, context);
                    row.samples_mut()[column] = value;
                    column += 1;
                }
                None => column = self.run(line, row, above, column),
            }
        }
    }

    fn sample(&mut self, value: i32, neighbours: &Neighbours, context: Context) -> i32 {
        let prediction = self.model.predict(neighbours, context);
        let error = context.sign * (value - prediction);
        let error = self.steps(error);
        let reconstructed = self.model.parameters.reconstruct(prediction, context.sign * error);
        let error = self.reduced(error);
        let (k, is_inverted) = self.model.code(context);
        let folded = if is_inverted { !error } else { error };
        let code = if folded >= 0 { 2 * folded } else { -2 * folded - 1 };
        self.golomb(code, k, self.model.parameters.limit);
        self.model.learn(context, error);
        reconstructed
    }

    /// The error in steps, to the nearest.
    fn steps(&self, error: i32) -> i32 {
        let (near, step) = (self.model.parameters.near, self.model.parameters.step());
        if error > 0 { (error + near) / step } else { -((near - error) / step) }
    }

    /// The error modulo the range, as small as can be.
    fn reduced(&self, error: i32) -> i32 {
        let range = self.model.parameters.range;
        let error = if error < 0 { error + range } else { error };
        if error >= (range + 1) / 2 { error - range } else { error }
    }

    fn run(&mut self, line: &[u16], row: &mut Row, above: &Row, start: usize) -> usize {
        let value = row.neighbours(above, start).a;
        let near = self.model.parameters.near;
        let length = line[start..].iter().take_while(|&&s| (i32::from(s) - value).abs() <= near).count();
        row.samples_mut()[start..start + length].fill(value);
        let is_whole = start + length == line.len();
        let mut left = length;
        while left >= 1 << RUN_BITS[self.model.run_index] {
            self.bits.put(1, 1);
            left -= 1 << RUN_BITS[self.model.run_index];
            self.model.run_index = (self.model.run_index + 1).min(31);
        }
        if is_whole {
            if left > 0 {
                self.bits.put(1, 1);
            }
            return start + length;
        }
        self.bits.put(0, 1);
        self.bits.put(u32::try_from(left).unwrap(), RUN_BITS[self.model.run_index]);
        let column = start + length;
        let b = row.neighbours(above, column).b;
        row.samples_mut()[column] = self.interruption(line[column].into(), value, b);
        self.model.run_index = self.model.run_index.saturating_sub(1);
        column + 1
    }

    fn interruption(&mut self, value: i32, left: i32, above: i32) -> i32 {
        let parameters = self.model.parameters;
        let is_level = (left - above).abs() <= parameters.near;
        let (prediction, sign) =
            if is_level { (left, 1) } else { (above, if left > above { -1 } else { 1 }) };
        let error = self.steps(sign * (value - prediction));
        let reconstructed = parameters.reconstruct(prediction, sign * error);
        let error = self.reduced(error);
        let (k, are_negative_odd) = self.model.interruption_code(is_level);
        let is_odd = error != 0 && (error < 0) == are_negative_odd;
        let code = 2 * error.abs() - i32::from(is_level) - i32::from(is_odd);
        self.golomb(code, k, parameters.limit - RUN_BITS[self.model.run_index] - 1);
        self.model.learn_interruption(is_level, error, code);
        reconstructed
    }

    fn golomb(&mut self, code: i32, k: u32, limit: u32) {
        let code = code.cast_unsigned();
        let error_bits = self.model.parameters.error_bits;
        let most = limit - error_bits - 1;
        let (zeros, low, n_low) = if code >> k < most {
            (code >> k, code & ((1 << k) - 1), k)
        } else {
            (most, code - 1, error_bits)
        };
        (0..zeros).for_each(|_| self.bits.put(0, 1));
        self.bits.put(1, 1);
        self.bits.put(low, n_low);
    }
}

#[derive(Default)]
struct BitWriter {
    bytes: Vec<u8>,
    current: u8,
    n_bits: u32,
}

impl BitWriter {
    fn put(&mut self, number: u32, n: u32) {
        for i in (0..n).rev() {
            self.current = self.current << 1 | u8::from(number >> i & 1 == 1);
            self.n_bits += 1;
            let whole = if self.bytes.last() == Some(&0xff) { 7 } else { 8 };
            if self.n_bits == whole {
                self.bytes.push(self.current);
                (self.current, self.n_bits) = (0, 0);
            }
        }
    }

    fn finish(mut self) -> Vec<u8> {
        while self.n_bits > 0 || self.bytes.last() == Some(&0xff) {
            self.put(0, 1);
        }
        self.bytes
    }
}
