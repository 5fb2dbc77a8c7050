//! The values of an image file: unpacked, read as numbers, rescaled.
//!
//! Memory: the values of the one volume that is asked for, and a buffer. What a header declares is compared with the bytes that are
//! there first. Packed bytes tell their length only once they are unpacked: no more is believed than deflate can pack (1032 : 1,
//! RFC 1951), and memory is then taken as values arrive.

use super::{Fault, Header, Skip};
use crate::progress::Task;
use flate2::read::{MultiGzDecoder, ZlibDecoder};
use std::io::{self, Read};

/// Most bytes that a byte of a deflate stream may stand for.
const MOST_DEFLATED: u64 = 1032;
/// A stream that is packed no denser than this gets its memory at once.
const USUAL_DEFLATED: u64 = 64;
/// More bytes of names and comments before packed values are not read.
const MOST_FRAMING: u64 = 1 << 20;
/// Characters of a number in text, with what separates it from the next, over the two that it takes at least.
const LONGEST_NUMBER: u64 = 16;
/// Bytes that are unpacked at a time: a multiple of every scalar's size.
const BUFFER_BYTES: usize = 1 << 16;

/// What a gzip stream begins with.
pub(crate) const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

/// How a value is laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scalar {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

/// Which byte of a value comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Endian {
    /// The lowest.
    Little,
    /// The highest.
    Big,
}

/// How the values are packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Packing {
    Raw,
    /// RFC 1952.
    Gzip,
    /// RFC 1950.
    Zlib,
    /// Decimal numbers.
    Text,
}

impl Scalar {
    pub(crate) const fn n_bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    pub(crate) const fn is_signed(self) -> bool {
        !matches!(self, Self::U8 | Self::U16 | Self::U32 | Self::U64)
    }

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::I8 => "int8",
            Self::U16 => "uint16",
            Self::I16 => "int16",
            Self::U32 => "uint32",
            Self::I32 => "int32",
            Self::U64 => "uint64",
            Self::I64 => "int64",
            Self::F32 => "float32",
            Self::F64 => "float64",
        }
    }
}

impl Packing {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Raw => "raw",
            Self::Gzip => "gzip",
            Self::Zlib => "zlib",
            Self::Text => "text",
        }
    }
}

/// Values of one volume in the file's order, and how many bytes stand behind the last one.
pub(crate) struct Found<T> {
    pub(crate) values: Vec<T>,
    /// Whether the file goes on after the values that its header declares.
    pub(crate) goes_on: bool,
}

/// Reads a volume, numbered from 0, from the bytes of the file that holds the values.
///
/// # Errors
/// [`Fault`]: fewer bytes than declared, a damaged stream, no memory, a value that `convert` refuses, interruption.
pub(crate) fn read<T>(
    header: &Header,
    bytes: &[u8],
    volume: usize,
    task: &Task<'_>,
    convert: impl Fn(f64, usize) -> Result<T, Fault>,
) -> Result<Found<T>, Fault> {
    let source = Source::new(header, bytes)?;
    let mut taken = Taken { header, volume, index: 0, values: source.memory()?, convert };
    let goes_on = match header.place.packing {
        Packing::Text => taken.text(source.packed, task)?,
        Packing::Raw => taken.binary(source.packed, &source, task)?,
        // Some writers of MetaImage wrap their zlib values in gzip.
        Packing::Zlib if source.packed.starts_with(&GZIP_MAGIC) => {
            taken.binary(MultiGzDecoder::new(source.packed), &source, task)?
        }
        Packing::Gzip => taken.binary(MultiGzDecoder::new(source.packed), &source, task)?,
        Packing::Zlib => taken.binary(ZlibDecoder::new(source.packed), &source, task)?,
    };
    Ok(Found { values: taken.values, goes_on })
}

/// Bytes of all values that a header declares; of text, the least that they need.
pub(crate) fn n_declared(header: &Header) -> u64 {
    let n_values = header.n_voxels() as u64 * header.n_volumes as u64;
    // A digit and a blank each, the last one without.
    let is_text = header.place.packing == Packing::Text;
    if is_text { 2 * n_values - 1 } else { n_values * header.scalar.n_bytes() as u64 }
}

/// How many bytes of the file that holds the values may be needed to read all that its header declares, and to see whether more follows;
/// `start` are its first ones.
pub(crate) fn most_bytes(header: &Header, start: &[u8]) -> u64 {
    let declared = n_declared(header);
    let (before, unpacked) = match header.place.skip {
        Skip::File(n) => (n as u64, 0),
        Skip::Lines { start: from, n_lines, n_bytes } => {
            let lines_end = after_lines(start, from, n_lines).unwrap_or(start.len());
            (lines_end.saturating_add(n_bytes) as u64, 0)
        }
        Skip::Unpacked(n) => (0, n),
        Skip::AllButValues => (0, 0),
    };
    let needed = declared.saturating_add(unpacked);
    let packed = match header.place.packing {
        Packing::Raw => needed,
        // What cannot be packed grows by its framing, far less than this.
        Packing::Gzip | Packing::Zlib => needed.saturating_mul(2).saturating_add(MOST_FRAMING),
        Packing::Text => needed.saturating_mul(LONGEST_NUMBER),
    };
    before.saturating_add(packed).saturating_add(1)
}

/// The bytes to unpack, known to be able to hold what the header declares.
struct Source<'a> {
    header: &'a Header,
    packed: &'a [u8],
    /// Bytes to pass over once unpacked.
    skip_unpacked: u64,
    /// Bytes of all values; of text, the least that they need.
    declared: u64,
}

impl<'a> Source<'a> {
    fn new(header: &'a Header, bytes: &'a [u8]) -> Result<Self, Fault> {
        let declared = n_declared(header);
        let truncated = |found| Fault::Truncated { found_bytes: found, expected_bytes: declared };
        let (start, skip_unpacked) = match header.place.skip {
            Skip::File(n) => (n, 0),
            Skip::Lines { start, n_lines, n_bytes } => {
                let lines_end = after_lines(bytes, start, n_lines).ok_or_else(|| truncated(0))?;
                (lines_end.saturating_add(n_bytes), 0)
            }
            Skip::Unpacked(n) => (0, n),
            Skip::AllButValues => {
                let declared = usize::try_from(declared).unwrap_or(usize::MAX);
                (bytes.len().checked_sub(declared).ok_or_else(|| truncated(bytes.len() as u64))?, 0)
            }
        };
        let packed = bytes.get(start..).ok_or_else(|| truncated(0))?;
        let source = Self { header, packed, skip_unpacked, declared };
        source.check_length()?;
        Ok(source)
    }

    fn check_length(&self) -> Result<(), Fault> {
        let (packing, packed) = (self.header.place.packing, self.packed.len() as u64);
        let needed = self.declared.saturating_add(self.skip_unpacked);
        match packing {
            Packing::Raw | Packing::Text if packed < needed => Err(Fault::Truncated {
                found_bytes: packed.saturating_sub(self.skip_unpacked),
                expected_bytes: self.declared,
            }),
            Packing::Gzip | Packing::Zlib if packed * MOST_DEFLATED < needed => Err(Fault::PackedTooShort {
                packed_bytes: self.packed.len(),
                packing: packing.name(),
                expected_bytes: self.declared,
            }),
            _ => Ok(()),
        }
    }

    /// Memory for one volume, asked for in a way that may fail.
    fn memory<T>(&self) -> Result<Vec<T>, Fault> {
        let mut values = Vec::new();
        let is_dense = self.declared > USUAL_DEFLATED * self.packed.len() as u64;
        let n = if is_dense { BUFFER_BYTES } else { self.header.n_voxels() };
        let refused = Fault::TooLarge { dims: self.header.grid.dims };
        values.try_reserve_exact(n).ok().ok_or(refused)?;
        Ok(values)
    }
}

/// Where the lines that begin at `start` end; `None` where there are fewer.
fn after_lines(bytes: &[u8], start: usize, n_lines: usize) -> Option<usize> {
    (0..n_lines).try_fold(start, |at, _| Some(at + 1 + bytes.get(at..)?.iter().position(|&b| b == b'\n')?))
}

/// The values of the wanted volume, gathered.
struct Taken<'a, T, F> {
    header: &'a Header,
    volume: usize,
    /// Of the next value of the file.
    index: usize,
    values: Vec<T>,
    convert: F,
}

impl<T, F: Fn(f64, usize) -> Result<T, Fault>> Taken<'_, T, F> {
    fn n_values(&self) -> usize {
        self.header.n_voxels() * self.header.n_volumes
    }

    fn take(&mut self, value: f64) -> Result<(), Fault> {
        let Header { n_volumes, is_interleaved, rescale: [slope, intercept], .. } = *self.header;
        let of = match (n_volumes, is_interleaved) {
            (1, _) => 0,
            (n, true) => self.index % n,
            (_, false) => self.index / self.header.n_voxels(),
        };
        self.index += 1;
        if of == self.volume {
            let voxel = self.values.len();
            if voxel == self.values.capacity() {
                let refused = Fault::TooLarge { dims: self.header.grid.dims };
                self.values.try_reserve(BUFFER_BYTES).ok().ok_or(refused)?;
            }
            self.values.push((self.convert)(value * slope + intercept, voxel)?);
        }
        Ok(())
    }

    fn binary(&mut self, mut stream: impl Read, source: &Source<'_>, task: &Task<'_>) -> Result<bool, Fault> {
        let damaged = |_unpacking: io::Error| Fault::Damaged { packing: self.header.place.packing.name() };
        let mut buffer = vec![0; BUFFER_BYTES];
        let skipped = io::copy(&mut stream.by_ref().take(source.skip_unpacked), &mut io::sink());
        if skipped.map_err(damaged)? < source.skip_unpacked {
            return Err(Fault::Truncated { found_bytes: 0, expected_bytes: source.declared });
        }
        let size = self.header.scalar.n_bytes();
        while self.index < self.n_values() {
            task.check()?;
            let wanted = (self.n_values() - self.index).saturating_mul(size).min(BUFFER_BYTES);
            let found = fill(&mut stream, &mut buffer[..wanted]).map_err(damaged)?;
            self.scalars(&buffer[..found - found % size])?;
            if found < wanted {
                let found_bytes = (self.index * size + found % size) as u64;
                return Err(Fault::Truncated { found_bytes, expected_bytes: source.declared });
            }
        }
        // Reading on to the end checks the sum that a packed stream ends with.
        Ok(fill(&mut stream, &mut buffer[..1]).map_err(damaged)? > 0)
    }

    #[expect(
        clippy::cast_lossless,
        reason = "one line for all types; 64-bit integers are rounded to 53 bits"
    )]
    fn scalars(&mut self, bytes: &[u8]) -> Result<(), Fault> {
        macro_rules! each {
            ($($name:ident: $type:ty),*) => {
                match self.header.scalar {
                    $(Scalar::$name => {
                        for b in bytes.chunks_exact(size_of::<$type>()) {
                            let b = b.try_into().unwrap_or_default();
                            let v = if self.header.endian == Endian::Little { <$type>::from_le_bytes(b) } else { <$type>::from_be_bytes(b) };
                            self.take(v as f64)?;
                        }
                    })*
                }
            };
        }
        each!(U8: u8, I8: i8, U16: u16, I16: i16, U32: u32, I32: i32, U64: u64, I64: i64, F32: f32, F64: f64);
        Ok(())
    }

    fn text(&mut self, bytes: &[u8], task: &Task<'_>) -> Result<bool, Fault> {
        let is_gap = |b: &u8| b.is_ascii_whitespace() || *b == b',';
        let mut words = bytes.split(is_gap).filter(|w| !w.is_empty());
        while self.index < self.n_values() {
            if self.index.is_multiple_of(BUFFER_BYTES) {
                task.check()?;
            }
            let short = Fault::TooFewValues { found: self.index, expected: self.n_values() };
            let word = words.next().ok_or(short)?;
            let number = std::str::from_utf8(word).ok().and_then(|w| w.parse().ok());
            self.take(number.ok_or(Fault::NotANumber { index: self.index })?)?;
        }
        Ok(words.next().is_some())
    }
}

/// Reads until the buffer is full or the stream ends; how much there was.
fn fill(stream: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut found = 0;
    while found < buffer.len() {
        match stream.read(&mut buffer[found..]) {
            Ok(0) => break,
            Ok(n) => found += n,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
    Ok(found)
}
