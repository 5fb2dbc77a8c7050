//! Samples to JPEG, to test the decoder with: lossless by any predictor, and DCT with every step 1.

use std::f64::consts::PI;

/// How to encode without loss.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lossless {
    pub(super) predictor: u8,
    pub(super) point_transform: u8,
    pub(super) restart_rows: usize,
}

/// The lossless stream of an image; bits that the point transform leaves out must be 0.
pub(super) fn lossless(samples: &[u16], columns: usize, bits: u8, how: Lossless) -> Vec<u8> {
    let mut out = head(0xc3, samples.len() / columns, columns, bits);
    // Seventeen codes of 5 bits: any difference can be coded.
    segment(&mut out, 0xc4, &[&[0, 0, 0, 0, 0, 17], &[0; 11][..], &(0..17).collect::<Vec<u8>>()].concat());
    restart(&mut out, how.restart_rows * columns);
    segment(&mut out, 0xda, &[1, 1, 0, how.predictor, 0, how.point_transform]);
    let shifted: Vec<i32> = samples.iter().map(|&s| i32::from(s >> how.point_transform)).collect();
    let n_rows = samples.len() / columns;
    let interval = if how.restart_rows == 0 { n_rows } else { how.restart_rows };
    let first = 1 << (bits - how.point_transform - 1);
    for (number, rows) in shifted.chunks(interval * columns).enumerate() {
        restart_marker(&mut out, number);
        let mut bits = BitWriter::default();
        for i in 0..rows.len() {
            let (x, y) = (i % columns, i / columns);
            let prediction = match (x, y) {
                (0, 0) => first,
                (_, 0) => rows[i - 1],
                (0, _) => rows[i - columns],
                _ => predicted(how.predictor, rows[i - 1], rows[i - columns], rows[i - columns - 1]),
            };
            bits.difference(rows[i] - prediction);
        }
        out.extend(bits.finish());
    }
    out.extend([0xff, 0xd9]);
    out
}

fn predicted(predictor: u8, a: i32, b: i32, c: i32) -> i32 {
    [a, b, c, a + b - c, a + ((b - c) >> 1), b + ((a - c) >> 1), (a + b) >> 1][usize::from(predictor) - 1]
}

/// The sequential DCT stream of an image of 8 or 12 bits.
pub(super) fn sequential(samples: &[u16], columns: usize, bits: u8, restart_blocks: usize) -> Vec<u8> {
    let rows = samples.len() / columns;
    let mut out = head(0xc1, rows, columns, bits);
    segment(&mut out, 0xdb, &[&[0][..], &[1; 64]].concat());
    segment(&mut out, 0xc4, &[&[0, 0, 0, 0, 0, 17], &[0; 11][..], &(0..17).collect::<Vec<u8>>()].concat());
    // Codes of 8 bits for no zeros or end, and of 16 bits for some or sixteen zeros.
    let long = after_zeros();
    let mut counts = [0; 16];
    (counts[7], counts[15]) = (16, u8::try_from(long.len()).unwrap());
    segment(&mut out, 0xc4, &[&[0x10][..], &counts, &(0..16).collect::<Vec<u8>>(), &long].concat());
    restart(&mut out, restart_blocks);
    segment(&mut out, 0xda, &[1, 1, 0, 0, 63, 0]);
    let (across, down) = (columns.div_ceil(8), rows.div_ceil(8));
    let interval = if restart_blocks == 0 { across * down } else { restart_blocks };
    let blocks: Vec<[i32; 64]> = (0..across * down)
        .map(|b| transformed(samples, columns, [b % across * 8, b / across * 8], 1 << (bits - 1)))
        .collect();
    for (number, blocks) in blocks.chunks(interval).enumerate() {
        restart_marker(&mut out, number);
        let mut bits = BitWriter::default();
        let mut mean = 0;
        for block in blocks {
            bits.difference(block[0] - mean);
            mean = block[0];
            bits.coefficients(&block[1..]);
        }
        out.extend(bits.finish());
    }
    out.extend([0xff, 0xd9]);
    out
}

/// Coefficients of a block in the order of the zigzag; what lies beyond the edge repeats it.
fn transformed(samples: &[u16], columns: usize, [left, top]: [usize; 2], level: i32) -> [i32; 64] {
    let rows = samples.len() / columns;
    let at = |x: usize, y: usize| {
        f64::from(i32::from(samples[(top + y).min(rows - 1) * columns + (left + x).min(columns - 1)]) - level)
    };
    let norm = |u: usize| if u == 0 { 0.5_f64.sqrt() } else { 1.0 };
    let cosine = |x: usize, u: usize| (((2 * x + 1) * u) as f64 * PI / 16.0).cos();
    let coefficient = |u: usize, v: usize| {
        let sum: f64 = (0..64).map(|i| at(i % 8, i / 8) * cosine(i % 8, u) * cosine(i / 8, v)).sum();
        #[expect(clippy::cast_possible_truncation, reason = "16 bits")]
        let coefficient = (0.25 * norm(u) * norm(v) * sum).round() as i32;
        coefficient
    };
    let mut order: Vec<(usize, usize)> = (0..64).map(|i| (i % 8, i / 8)).collect();
    order.sort_by_key(|&(u, v)| (u + v, if (u + v) % 2 == 0 { u } else { v }));
    std::array::from_fn(|i| coefficient(order[i].0, order[i].1))
}

fn head(frame: u8, rows: usize, columns: usize, bits: u8) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8];
    segment(&mut out, frame, &[&[bits], &word(rows)[..], &word(columns), &[1, 1, 0x11, 0]].concat());
    out
}

fn restart(out: &mut Vec<u8>, interval: usize) {
    if interval > 0 {
        segment(out, 0xdd, &word(interval));
    }
}

fn restart_marker(out: &mut Vec<u8>, number: usize) {
    if number > 0 {
        out.extend([0xff, 0xd0 + u8::try_from((number - 1) % 8).unwrap()]);
    }
}

fn segment(out: &mut Vec<u8>, marker: u8, body: &[u8]) {
    out.extend([0xff, marker]);
    out.extend(word(body.len() + 2));
    out.extend(body);
}

fn word(n: usize) -> [u8; 2] {
    u16::try_from(n).unwrap().to_be_bytes()
}

/// What the codes of 16 bits stand for: sixteen zeros; 1 to 15 zeros before a coefficient of 1 to 15 bits.
fn after_zeros() -> Vec<u8> {
    let some = (1..16_u8).flat_map(|n_zeros| (1..16_u8).map(move |n_bits| n_zeros << 4 | n_bits));
    std::iter::once(0xf0).chain(some).collect()
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
            if self.n_bits == 8 {
                self.bytes.push(self.current);
                if self.current == 0xff {
                    self.bytes.push(0);
                }
                (self.current, self.n_bits) = (0, 0);
            }
        }
    }

    /// Its number of bits by a code of 5, then those bits; modulo 2^16.
    fn difference(&mut self, difference: i32) {
        let difference = (difference + 0x8000).rem_euclid(0x1_0000) - 0x8000;
        if difference == -0x8000 {
            return self.put(16, 5);
        }
        let n_bits = 32 - difference.unsigned_abs().leading_zeros();
        self.put(n_bits, 5);
        self.signed(difference, n_bits);
    }

    fn signed(&mut self, number: i32, n_bits: u32) {
        let raw = if number < 0 { number + (1 << n_bits) - 1 } else { number };
        self.put(raw.cast_unsigned(), n_bits);
    }

    /// All coefficients of a block but the first, the last zeros by the code for the end.
    fn coefficients(&mut self, coefficients: &[i32]) {
        let mut n_zeros = 0;
        for &value in coefficients {
            if value == 0 {
                n_zeros += 1;
                continue;
            }
            for _ in 0..n_zeros / 16 {
                self.after_zeros(0xf0);
            }
            let n_bits = 32 - value.unsigned_abs().leading_zeros();
            match n_zeros % 16 {
                0 => self.put(n_bits, 8),
                n => self.after_zeros(n << 4 | n_bits),
            }
            self.signed(value, n_bits);
            n_zeros = 0;
        }
        if n_zeros > 0 {
            self.put(0, 8);
        }
    }

    /// One of the long codes.
    fn after_zeros(&mut self, symbol: u32) {
        let at = after_zeros().iter().position(|&s| u32::from(s) == symbol).unwrap();
        self.put(0x1000 + u32::try_from(at).unwrap(), 16);
    }

    fn finish(mut self) -> Vec<u8> {
        while self.n_bits > 0 {
            self.put(1, 1);
        }
        self.bytes
    }
}
