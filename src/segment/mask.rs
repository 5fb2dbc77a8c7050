//! A set of voxels, kept for the smallest box around it.

use std::ops::Range;

/// Voxels of a volume: one byte each inside their bounding box, nothing outside it.
#[derive(Clone, PartialEq, Eq)]
pub struct Mask {
    columns: Range<usize>,
    rows: Range<usize>,
    planes: Range<usize>,
    inside: Vec<u8>,
}

impl std::fmt::Debug for Mask {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Mask")
            .field("columns", &self.columns)
            .field("rows", &self.rows)
            .field("planes", &self.planes)
            .field("n_voxels", &self.n_voxels())
            .finish_non_exhaustive()
    }
}

impl Mask {
    /// The voxels of the box for which `inside` holds.
    #[must_use]
    pub fn from_fn(
        columns: Range<usize>,
        rows: Range<usize>,
        planes: Range<usize>,
        inside: impl Fn(usize, usize, usize) -> bool,
    ) -> Self {
        let mut bytes = Vec::with_capacity(columns.len() * rows.len() * planes.len());
        for k in planes.clone() {
            for j in rows.clone() {
                bytes.extend(columns.clone().map(|i| u8::from(inside(i, j, k))));
            }
        }
        Self { columns, rows, planes, inside: bytes }
    }

    /// Whether voxel (i, j, k) of the volume belongs to the set; outside the box none does.
    #[must_use]
    pub fn contains(&self, i: usize, j: usize, k: usize) -> bool {
        let in_box = self.columns.contains(&i) && self.rows.contains(&j) && self.planes.contains(&k);
        in_box && {
            let row = (k - self.planes.start) * self.rows.len() + (j - self.rows.start);
            self.inside[row * self.columns.len() + (i - self.columns.start)] != 0
        }
    }

    /// The columns of the box, as indices of the volume.
    #[must_use]
    pub fn columns(&self) -> Range<usize> {
        self.columns.clone()
    }

    /// The rows of the box, as indices of the volume.
    #[must_use]
    pub fn rows(&self) -> Range<usize> {
        self.rows.clone()
    }

    /// The planes of the box, as indices of the volume.
    #[must_use]
    pub fn planes(&self) -> Range<usize> {
        self.planes.clone()
    }

    /// How many voxels the set has.
    #[must_use]
    pub fn n_voxels(&self) -> usize {
        self.inside.iter().filter(|&&v| v != 0).count()
    }

    /// How many of them lie in plane k.
    #[must_use]
    pub fn n_voxels_of(&self, k: usize) -> usize {
        let area = self.columns.len() * self.rows.len();
        let own = self.planes.contains(&k).then(|| &self.inside[(k - self.planes.start) * area..][..area]);
        own.map_or(0, |plane| plane.iter().filter(|&&v| v != 0).count())
    }

    /// The smallest box of columns and rows around the voxels of plane k; `None` where it has none.
    #[must_use]
    pub fn plane_box(&self, k: usize) -> Option<(Range<usize>, Range<usize>)> {
        let k = self.planes.contains(&k).then(|| k - self.planes.start)?;
        let (width, height) = (self.columns.len(), self.rows.len());
        let mut found: Option<[usize; 4]> = None;
        for j in 0..height {
            let row = &self.inside[(k * height + j) * width..][..width];
            let (Some(first), Some(last)) =
                (row.iter().position(|&v| v != 0), row.iter().rposition(|&v| v != 0))
            else {
                continue;
            };
            let b = found.get_or_insert([first, last, j, j]);
            *b = [b[0].min(first), b[1].max(last), b[2], j];
        }
        let [i0, i1, j0, j1] = found?;
        let (i, j) = (self.columns.start, self.rows.start);
        Some((i + i0..i + i1 + 1, j + j0..j + j1 + 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_for_the_whole_volume_and_boxes_each_plane() {
        let mask = Mask::from_fn(3..8, 2..6, 4..6, |i, j, k| k == 4 && (4..6).contains(&i) && j == 3);
        assert!(mask.contains(4, 3, 4) && !mask.contains(6, 3, 4) && !mask.contains(0, 0, 0));
        assert_eq!(mask.n_voxels(), 2);
        assert_eq!([3, 4, 5].map(|k| mask.n_voxels_of(k)), [0, 2, 0]);
        assert_eq!(mask.plane_box(4), Some((4..6, 3..4)));
        assert_eq!(mask.plane_box(5), None);
        assert_eq!(mask.plane_box(9), None);
    }
}
