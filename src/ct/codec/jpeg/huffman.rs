//! Huffman codes and the bits they stand in (ITU-T T.81 annex C, F.2.2).

use super::Fault;

/// Codes up to this long are looked up, longer ones searched.
const LOOKUP_BITS: u32 = 9;

/// A table of codes of up to 16 bits.
#[derive(Debug, Clone)]
pub(super) struct Table {
    values: Vec<u8>,
    /// By the next bits: length of the code, 0 where it is longer, and its value.
    lookup: Vec<(u8, u8)>,
    /// By length: one more than the largest code, filled up to 16 bits; how far codes lie from their values.
    ends: [u32; 17],
    offsets: [i32; 17],
}

impl Table {
    /// The table with so many codes of each length, 1 to 16, for those values.
    pub(super) fn try_new(counts: &[u8], values: &[u8]) -> Result<Self, Fault> {
        let mut table = Self {
            values: values.to_vec(),
            lookup: vec![(0, 0); 1 << LOOKUP_BITS],
            ends: [0; 17],
            offsets: [0; 17],
        };
        let (mut code, mut n_before) = (0_u32, 0_u32);
        for (length, &count) in (1_u32..).zip(counts) {
            let end = code + u32::from(count);
            if end > 1 << length {
                return Err(Fault::Damaged("a JPEG table has more codes than there can be"));
            }
            table.offsets[length as usize] = n_before.cast_signed() - code.cast_signed();
            table.ends[length as usize] = end << (16 - length);
            table.fill_lookup(length, code..end, n_before as usize);
            n_before += u32::from(count);
            code = end << 1;
        }
        Ok(table)
    }

    fn fill_lookup(&mut self, length: u32, codes: std::ops::Range<u32>, first_value: usize) {
        let Some(spare) = LOOKUP_BITS.checked_sub(length) else { return };
        for (code, &value) in codes.zip(&self.values[first_value..]) {
            let start = (code << spare) as usize;
            #[expect(clippy::cast_possible_truncation, reason = "9 at most")]
            self.lookup[start..start + (1 << spare)].fill((length as u8, value));
        }
    }
}

/// Reads bits up to the next marker; behind a byte of ones stands a byte of zeros that means nothing.
#[derive(Debug)]
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    position: usize,
    held: u64,
    n_held: u32,
}

impl<'a> Bits<'a> {
    pub(super) const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, position: 0, held: 0, n_held: 0 }
    }

    fn fetch(&mut self) {
        while self.n_held <= 56 {
            let Some(&byte) = self.bytes.get(self.position) else { return };
            if byte == 0xff {
                if self.bytes.get(self.position + 1) != Some(&0) {
                    return;
                }
                self.position += 1;
            }
            self.held |= u64::from(byte) << 56 >> self.n_held;
            self.n_held += 8;
            self.position += 1;
        }
    }

    fn drop(&mut self, n: u32) -> Result<(), Fault> {
        self.n_held = self.n_held.checked_sub(n).ok_or(Fault::Truncated)?;
        self.held <<= n;
        Ok(())
    }

    /// The value of the next code.
    pub(super) fn value(&mut self, table: &Table) -> Result<u8, Fault> {
        if self.n_held < 16 {
            self.fetch();
        }
        let next = (self.held >> (64 - LOOKUP_BITS)) as usize;
        let (length, value) = table.lookup[next];
        if length > 0 {
            self.drop(length.into())?;
            return Ok(value);
        }
        self.long_value(table)
    }

    fn long_value(&mut self, table: &Table) -> Result<u8, Fault> {
        let next = (self.held >> 48) as u32;
        let length = (LOOKUP_BITS + 1..=16).find(|&l| next < table.ends[l as usize]);
        let Some(length) = length else {
            let is_end = self.n_held < 16;
            return Err(if is_end {
                Fault::Truncated
            } else {
                Fault::Damaged("a code of the JPEG pixels is in no table")
            });
        };
        self.drop(length)?;
        let code = (next >> (16 - length)).cast_signed();
        let index = usize::try_from(code + table.offsets[length as usize]).ok();
        let value = index.and_then(|i| table.values.get(i)).copied();
        value.ok_or(Fault::Damaged("a code of the JPEG pixels is in no table"))
    }

    /// A signed number of n bits, 16 at most: those that begin with a zero are negative (T.81 F.2.2.1).
    pub(super) fn signed(&mut self, n: u32) -> Result<i32, Fault> {
        if n == 0 {
            return Ok(0);
        }
        if self.n_held < n {
            self.fetch();
        }
        #[expect(clippy::cast_possible_truncation, reason = "16 bits")]
        let bits = (self.held >> (64 - n)) as i32;
        self.drop(n)?;
        Ok(if bits >> (n - 1) == 0 { bits - (1 << n) + 1 } else { bits })
    }

    /// The next marker and all behind it: filling up to a whole byte is left out.
    pub(super) fn rest(&self) -> &'a [u8] {
        let rest = &self.bytes[self.position..];
        let at = rest.windows(2).position(|w| w[0] == 0xff && w[1] != 0);
        &rest[at.unwrap_or(rest.len())..]
    }
}
