//! Sequential JPEG: blocks of 8 x 8 cosine coefficients (ITU-T T.81 annexes A and F).

use super::super::markers::behind_restart;
use super::huffman::{Bits, Table};
use super::{Fault, Size, zeroed};
use std::f32::consts::PI;

/// Samples along the side of a block.
const SIDE: usize = 8;

/// Row and column of the coefficients in the order in which they are coded: along the diagonals, to and fro.
const ZIGZAG: [usize; 64] = zigzag();

const fn zigzag() -> [usize; 64] {
    let mut order = [0; 64];
    let (mut n, mut diagonal) = (0, 0);
    while diagonal < 2 * SIDE - 1 {
        let mut step = 0;
        while step <= diagonal {
            let (row, column) =
                if diagonal % 2 == 0 { (diagonal - step, step) } else { (step, diagonal - step) };
            if row < SIDE && column < SIDE {
                order[n] = row * SIDE + column;
                n += 1;
            }
            step += 1;
        }
        diagonal += 1;
    }
    order
}

/// How an image is coded.
#[derive(Debug)]
pub(super) struct Coding {
    /// Steps of the coefficients, in the order of the zigzag.
    steps: [f32; 64],
    /// `cosines[x][u]`: share of coefficient u in sample x.
    cosines: [[f32; SIDE]; SIDE],
    largest: f32,
    /// Blocks between restart markers.
    interval: usize,
    size: Size,
}

impl Coding {
    /// The coding of 8 or 12 bits; the restart interval counts blocks, and is 0 for none.
    pub(super) fn new(precision_bits: u32, steps: &[u16; 64], restart_interval: usize, size: Size) -> Self {
        let share = |x: usize, u: usize| {
            let norm = if u == 0 { 0.5_f32.sqrt() } else { 1.0 };
            #[expect(clippy::cast_precision_loss, reason = "less than 256")]
            let angle = ((2 * x + 1) * u) as f32 * PI / 16.0;
            0.5 * norm * angle.cos()
        };
        #[expect(clippy::cast_precision_loss, reason = "12 bits")]
        let largest = ((1_u32 << precision_bits) - 1) as f32;
        Self {
            steps: steps.map(f32::from),
            cosines: std::array::from_fn(|x| std::array::from_fn(|u| share(x, u))),
            largest,
            interval: if restart_interval == 0 { usize::MAX } else { restart_interval },
            size,
        }
    }

    /// Samples of a block from its coefficients (T.81 A.3.3), rounded and clamped.
    fn samples(&self, coefficients: &[f32; 64]) -> [u16; 64] {
        // By rows, then by columns: the transform is separable.
        let mut by_rows = [0.0; 64];
        for (from, to) in coefficients.chunks_exact(SIDE).zip(by_rows.chunks_exact_mut(SIDE)) {
            for (sample, shares) in to.iter_mut().zip(&self.cosines) {
                *sample = shares.iter().zip(from).map(|(s, c)| s * c).sum();
            }
        }
        let level = (self.largest + 1.0) / 2.0;
        std::array::from_fn(|i| {
            let (y, x) = (i / SIDE, i % SIDE);
            let value: f32 = (0..SIDE).map(|v| self.cosines[y][v] * by_rows[v * SIDE + x]).sum();
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 12 bits")]
            let sample = (value + level).round().clamp(0.0, self.largest) as u16;
            sample
        })
    }
}

/// Decodes all samples.
pub(super) fn decode(mut bytes: &[u8], dc: &Table, ac: &Table, coding: &Coding) -> Result<Vec<u16>, Fault> {
    let Size { columns, rows } = coding.size;
    let (across, down) = (columns.div_ceil(SIDE), rows.div_ceil(SIDE));
    // Each block takes two codes.
    if bytes.len() < across * down / 4 {
        return Err(Fault::Truncated);
    }
    let mut words = zeroed(coding.size.n_pixels())?;
    let mut bits = Bits::new(bytes);
    let mut mean = 0;
    for block in 0..across * down {
        if block > 0 && block % coding.interval == 0 {
            bytes = behind_restart(bits.rest(), block / coding.interval - 1)?;
            bits = Bits::new(bytes);
            mean = 0;
        }
        let coefficients = coefficients(&mut bits, dc, ac, &mut mean, &coding.steps)?;
        let place = (block % across * SIDE, block / across * SIDE);
        put(&coding.samples(&coefficients), place, coding.size, &mut words);
    }
    Ok(words)
}

/// The coefficients of the next block; `mean` is the first one of the block before, undivided by its step.
fn coefficients(
    bits: &mut Bits<'_>,
    dc: &Table,
    ac: &Table,
    mean: &mut i32,
    steps: &[f32; 64],
) -> Result<[f32; 64], Fault> {
    const OUT_OF_RANGE: Fault = Fault::Damaged("a coefficient of the JPEG pixels is out of range");
    let mut found = [0.0; 64];
    let n_bits = bits.value(dc)?;
    if n_bits > 16 {
        return Err(OUT_OF_RANGE);
    }
    *mean = mean.wrapping_add(bits.signed(n_bits.into())?);
    #[expect(clippy::cast_precision_loss, reason = "damaged where it needs more than 24 bits")]
    let number = |n: i32| n as f32;
    found[0] = number(*mean) * steps[0];
    let mut place = 1;
    while place < 64 {
        let code = bits.value(ac)?;
        let (n_zeros, n_bits) = (usize::from(code >> 4), u32::from(code & 0x0f));
        match (n_zeros, n_bits) {
            (15, 0) => place += 16,
            (_, 0) => break,
            _ => {
                place += n_zeros;
                let at = *ZIGZAG.get(place).ok_or(OUT_OF_RANGE)?;
                found[at] = number(bits.signed(n_bits)?) * steps[place];
                place += 1;
            }
        }
    }
    Ok(found)
}

/// Puts a block in its place, cut at the right and lower edge.
fn put(block: &[u16; 64], (left, top): (usize, usize), size: Size, words: &mut [u16]) {
    let width = SIDE.min(size.columns - left);
    for (row, samples) in block.chunks_exact(SIDE).enumerate().take(size.rows - top) {
        let start = (top + row) * size.columns + left;
        words[start..start + width].copy_from_slice(&samples[..width]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_zigzag_is_that_of_the_standard() {
        // ITU-T T.81 figure A.6: numbers of the first row and the first column.
        let number_of = |at: usize| ZIGZAG.iter().position(|&z| z == at).unwrap();
        assert_eq!([0, 1, 2, 3, 4, 5, 6, 7].map(number_of), [0, 1, 5, 6, 14, 15, 27, 28]);
        assert_eq!([0, 8, 16, 24, 32, 40, 48, 56].map(number_of), [0, 2, 3, 9, 10, 20, 21, 35]);
    }

    #[test]
    fn a_constant_block_is_its_mean() {
        let coding = Coding::new(12, &[1; 64], 0, Size { columns: 8, rows: 8 });
        let mut coefficients = [0.0; 64];
        coefficients[0] = 8.0 * 100.0;
        assert_eq!(coding.samples(&coefficients), [2148; 64]);
        coefficients[0] = -1e6;
        assert_eq!(coding.samples(&coefficients), [0; 64]);
    }
}
