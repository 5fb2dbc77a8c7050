//! Bits of a JPEG-LS scan, most significant first; behind a byte of ones stands a zero bit that means nothing (T.87 A.1).

use super::super::Fault;

/// Reads bits up to the next marker.
#[derive(Debug)]
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    position: usize,
    /// Bits that were fetched, at the upper end; zeros below.
    held: u64,
    n_held: u32,
    is_after_ones: bool,
}

impl<'a> Bits<'a> {
    pub(super) const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, position: 0, held: 0, n_held: 0, is_after_ones: false }
    }

    /// Fetches until more than 56 bits are held, or a marker or the end is reached.
    fn fetch(&mut self) {
        while self.n_held <= 56 {
            let Some(&byte) = self.bytes.get(self.position) else { return };
            if byte == 0xff && self.bytes.get(self.position + 1).is_none_or(|&next| next >= 0x80) {
                return;
            }
            let n_bits = if self.is_after_ones { 7 } else { 8 };
            self.held |= u64::from(byte) << (64 - n_bits) >> self.n_held;
            self.n_held += n_bits;
            self.is_after_ones = byte == 0xff;
            self.position += 1;
        }
    }

    fn need(&mut self, n: u32) -> Result<(), Fault> {
        if self.n_held < n {
            self.fetch();
        }
        if self.n_held < n { Err(Fault::Truncated) } else { Ok(()) }
    }

    /// The next n bits, 24 at most, as a number.
    pub(super) fn number(&mut self, n: u32) -> Result<i32, Fault> {
        debug_assert!(n <= 24, "an error has no more bits");
        if n == 0 {
            return Ok(0);
        }
        self.need(n)?;
        #[expect(clippy::cast_possible_truncation, reason = "24 bits")]
        let number = (self.held >> (64 - n)) as i32;
        self.drop(n);
        Ok(number)
    }

    pub(super) fn bit(&mut self) -> Result<bool, Fault> {
        self.need(1)?;
        let is_one = self.held >> 63 == 1;
        self.drop(1);
        Ok(is_one)
    }

    /// Zeros before the next one, which is read too; more than `most` are an error.
    pub(super) fn zeros(&mut self, most: u32) -> Result<u32, Fault> {
        let mut n_before = 0;
        loop {
            self.need(1)?;
            let n = self.held.leading_zeros().min(self.n_held);
            if n_before + n > most {
                return Err(Fault::Damaged("a code of the JPEG-LS pixels is too long"));
            }
            if n < self.n_held {
                self.drop(n);
                self.drop(1);
                return Ok(n_before + n);
            }
            self.drop(n);
            n_before += n;
        }
    }

    fn drop(&mut self, n: u32) {
        self.held = self.held.checked_shl(n).unwrap_or(0);
        self.n_held -= n;
    }

    /// The next marker and all behind it: filling up to a whole byte is left out.
    pub(super) fn rest(&self) -> &'a [u8] {
        let rest = &self.bytes[self.position..];
        let at = rest.windows(2).position(|w| w[0] == 0xff && w[1] >= 0x80);
        &rest[at.unwrap_or(rest.len())..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bit_behind_a_byte_of_ones_is_left_out() {
        let mut bits = Bits::new(&[0xff, 0x7f, 0x80, 0xff, 0xd9]);
        assert_eq!((bits.number(8), bits.number(7), bits.number(1)), (Ok(255), Ok(127), Ok(1)));
        assert_eq!(bits.zeros(20), Err(Fault::Truncated));
        assert_eq!(bits.rest(), [0xff, 0xd9]);
    }

    #[test]
    fn zeros_are_counted_across_fetches_and_limited() {
        let mut bytes = [0; 20];
        bytes[19] = 1;
        assert_eq!(Bits::new(&bytes).zeros(159), Ok(159));
        assert!(matches!(Bits::new(&bytes).zeros(100), Err(Fault::Damaged(_))));
    }
}
