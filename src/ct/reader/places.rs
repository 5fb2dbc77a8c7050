//! Which bytes of a file are the pixels of one of its frames (PS3.5 A.4, PS3.3 C.7.6.3.1.8).
//!
//! Uncompressed frames follow each other. Compressed ones are made of one fragment or several: as many fragments as
//! frames are one each; else a table of frames tells, the extended one before the basic one, and without any the marks with which
//! JPEG images begin.

use super::super::Error;
use super::super::codec::Size;
use super::super::encoding::Packing;
use super::header::damaged;
use super::lengths::{Fragment, Layout, Pixels};
use std::ops::Range;
use std::path::Path;

/// The frame that is looked for.
#[derive(Debug)]
pub(super) struct Wanted<'a> {
    pub(super) path: &'a Path,
    /// From 0.
    pub(super) index: usize,
    pub(super) n_frames: usize,
    pub(super) starts: &'a Starts,
    /// Columns and rows.
    pub(super) n_pixels: [usize; 2],
    pub(super) bytes_per_pixel: u64,
    pub(super) packing: Packing,
}

impl Wanted<'_> {
    /// The bytes of the frame.
    ///
    /// # Errors
    /// [`Error::Truncated`] where the pixels are too few for their size, [`Error::Damaged`] where frames and fragments do not
    /// go together.
    pub(super) fn pieces(&self, layout: &Layout) -> Result<Vec<Range<u64>>, Error> {
        match (&layout.pixels, self.packing) {
            (None, _) => Err(damaged(self.path, "it holds no pixels")),
            (Some(Pixels::Native(range)), Packing::Native { .. }) => Ok(vec![self.native(range)?]),
            (Some(Pixels::Native(_)), _) => {
                Err(damaged(self.path, "its pixels are packed in another way than its header says"))
            }
            (Some(Pixels::Fragments { fragments, .. }), _) => {
                let own = self.fragments(fragments)?;
                self.check_length(own)?;
                Ok(own.iter().map(|f| f.range.clone()).collect())
            }
        }
    }

    fn n_bytes(&self) -> u64 {
        let [columns, rows] = self.n_pixels.map(|n| n as u64);
        columns * rows * self.bytes_per_pixel
    }

    fn native(&self, range: &Range<u64>) -> Result<Range<u64>, Error> {
        let whole = self.n_bytes().saturating_mul(self.n_frames as u64);
        let found = range.end - range.start;
        if found < whole {
            return Err(self.truncated(found, whole));
        }
        let start = range.start + self.n_bytes() * self.index as u64;
        Ok(start..start + self.n_bytes())
    }

    /// Whether uncompressed pixels are more than all frames take, beyond a byte that makes them even.
    pub(super) fn is_too_long(&self, layout: &Layout) -> bool {
        let (Some(Pixels::Native(range)), Packing::Native { .. }) = (&layout.pixels, self.packing) else {
            return false;
        };
        range.end - range.start > self.n_bytes().saturating_mul(self.n_frames as u64).saturating_add(1)
    }

    fn truncated(&self, found: u64, expected: u64) -> Error {
        let number = |n: u64| usize::try_from(n).unwrap_or(usize::MAX);
        Error::Truncated {
            path: self.path.to_owned(),
            found_bytes: number(found),
            expected_bytes: number(expected),
        }
    }

    /// Refuses an image that cannot be in so few bytes, before memory is set aside for it.
    fn check_length(&self, fragments: &[Fragment]) -> Result<(), Error> {
        let found = fragments.iter().map(|f| f.range.end - f.range.start).sum::<u64>();
        let [columns, rows] = self.n_pixels;
        let least = match self.packing {
            Packing::Compressed(codec) => codec.least_bytes(Size { columns, rows }) as u64,
            Packing::Native { .. } => self.n_bytes(),
            Packing::Unknown => 0,
        };
        if found < least { Err(self.truncated(found, least)) } else { Ok(()) }
    }

    fn fragments<'f>(&self, all: &'f [Fragment]) -> Result<&'f [Fragment], Error> {
        match self.starts {
            Starts::All => Ok(all),
            Starts::Each => Ok(&all[self.index..=self.index]),
            Starts::At(starts) => {
                let end = starts.get(self.index + 1).copied().unwrap_or(all.len());
                Ok(&all[starts[self.index]..end])
            }
            Starts::Disordered => Err(damaged(
                self.path,
                "its frames and the pieces of its compressed pixels do not go together",
            )),
        }
    }
}

/// With which fragment each frame of a file begins.
#[derive(Debug)]
pub(super) enum Starts {
    /// The only frame has all.
    All,
    /// Each frame has one.
    Each,
    /// Each frame has those from one on up to the next frame's.
    At(Vec<usize>),
    /// There is no telling.
    Disordered,
}

impl Starts {
    /// Those of a file; `extended` is its table of frames in 64 bits, empty where there is none.
    pub(super) fn of(layout: &Layout, n_frames: usize, extended: &[u64]) -> Self {
        let Some(Pixels::Fragments { offsets, fragments }) = &layout.pixels else { return Self::All };
        let table = if extended.is_empty() { offsets } else { extended };
        match n_frames {
            1 => Self::All,
            n if n == fragments.len() => Self::Each,
            n => {
                let starts = if table.len() == n { by_table(table, fragments) } else { by_marks(fragments) };
                starts.filter(|s| s.len() == n).map_or(Self::Disordered, Self::At)
            }
        }
    }
}

/// Index of the first fragment of each frame, where each offset is that of a fragment and they ascend.
fn by_table(table: &[u64], fragments: &[Fragment]) -> Option<Vec<usize>> {
    let first = fragments.first()?.range.start;
    let place = |&offset: &u64| {
        let start = first.checked_add(offset)?;
        fragments.binary_search_by_key(&start, |f| f.range.start).ok()
    };
    let starts: Vec<usize> = table.iter().map(place).collect::<Option<_>>()?;
    (starts.first() == Some(&0) && starts.is_sorted_by(|a, b| a < b)).then_some(starts)
}

/// Index of each fragment with which an image begins.
fn by_marks(fragments: &[Fragment]) -> Option<Vec<usize>> {
    let starts: Vec<usize> = (0..fragments.len()).filter(|&i| fragments[i].begins_image).collect();
    (starts.first() == Some(&0)).then_some(starts)
}

#[cfg(test)]
mod tests {
    use super::super::super::codec::Codec;
    use super::*;

    /// Header of an item, which offsets count too.
    const ITEM_HEADER: u64 = 8;

    /// Fragments of those lengths, the first item at byte 1000, and which begin an image.
    fn fragments(lengths: &[(u64, bool)]) -> Vec<Fragment> {
        let mut at = 1000;
        let next = |&(length, begins_image): &(u64, bool)| {
            let range = at + ITEM_HEADER..at + ITEM_HEADER + length;
            at = range.end;
            Fragment { range, begins_image }
        };
        lengths.iter().map(next).collect()
    }

    fn wanted(index: usize, n_frames: usize, packing: Packing, starts: &Starts) -> Wanted<'_> {
        Wanted {
            path: Path::new("file"),
            index,
            n_frames,
            starts,
            n_pixels: [4, 2],
            bytes_per_pixel: 2,
            packing,
        }
    }

    /// First byte and number of pieces of each frame.
    fn frames(
        n: usize,
        offsets: &[u64],
        extended: &[u64],
        of: &[Fragment],
    ) -> Result<Vec<(u64, usize)>, String> {
        let pixels = Some(Pixels::Fragments { offsets: offsets.to_vec(), fragments: of.to_vec() });
        let layout = Layout { pixels, ..Layout::default() };
        let starts = Starts::of(&layout, n, extended);
        let frame = |index| {
            let pieces = wanted(index, n, Packing::Compressed(Codec::JpegLs), &starts).pieces(&layout);
            pieces.map(|p| (p[0].start, p.len())).map_err(|e| e.to_string())
        };
        (0..n).map(frame).collect()
    }

    #[test]
    fn native_frames_follow_each_other() {
        let layout = Layout { pixels: Some(Pixels::Native(100..149)), ..Layout::default() };
        let native = Packing::Native { is_big_endian: false };
        let all = Starts::All;
        let third = wanted(2, 3, native, &all).pieces(&layout).unwrap();
        assert_eq!((third.len(), &third[0]), (1, &(132..148)));
        let error = wanted(0, 4, native, &all).pieces(&layout).unwrap_err();
        assert!(matches!(error, Error::Truncated { found_bytes: 49, expected_bytes: 64, .. }));
        assert!(wanted(0, 1, Packing::Compressed(Codec::Jpeg), &all).pieces(&layout).is_err());
        assert!(wanted(0, 1, native, &all).pieces(&Layout::default()).is_err());
    }

    #[test]
    fn as_many_fragments_as_frames_are_one_each() {
        let found = frames(2, &[], &[], &fragments(&[(10, true), (20, true)]));
        assert_eq!(found.unwrap(), [(1008, 1), (1026, 1)]);
        let one = frames(1, &[0], &[], &fragments(&[(10, true), (20, false), (30, false)]));
        assert_eq!(one.unwrap(), [(1008, 3)]);
    }

    #[test]
    fn tables_or_marks_say_which_fragments_make_a_frame() {
        let all = fragments(&[(10, true), (20, false), (30, true)]);
        let expected = [(1008, 2), (1054, 1)];
        assert_eq!(frames(2, &[0, 46], &[], &all).unwrap(), expected);
        assert_eq!(frames(2, &[], &[0, 46], &all).unwrap(), expected);
        assert_eq!(frames(2, &[], &[], &all).unwrap(), expected);
    }

    #[test]
    fn frames_that_fit_no_fragments_are_refused() {
        let all = fragments(&[(10, true), (20, false), (30, true)]);
        for table in [&[0, 45][..], &[18, 46], &[46, 0], &[0, 0]] {
            assert!(frames(2, table, &[], &all).unwrap_err().contains("do not go together"), "{table:?}");
        }
        assert!(frames(4, &[], &[], &all).is_err());
        assert!(frames(2, &[], &[], &[]).is_err());
        assert!(frames(2, &[], &[0, u64::MAX], &all).is_err());
    }
}
