//! Intensities of a grid of planes. A scanner stores whole numbers: planes of them are kept in half the memory of the
//! numbers that everything is computed with.

use rayon::prelude::*;
use std::borrow::Cow;

/// HU of every voxel, plane by plane, each row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Voxels {
    planes: Vec<Plane>,
}

/// Whole wherever all values are whole numbers of 16 bits.
#[derive(Debug, Clone, PartialEq)]
enum Plane {
    Whole(Box<[i16]>),
    Broken(Box<[f32]>),
}

/// Values that are looked at in one go.
const CHECKED_AT_ONCE: usize = 256;

impl Plane {
    fn of(values: Cow<'_, [f32]>) -> Self {
        let mut whole = Vec::new();
        if whole.try_reserve_exact(values.len()).is_err() {
            // What there is takes no more memory as it is.
            return Self::Broken(values.into_owned().into_boxed_slice());
        }
        for chunk in values.chunks(CHECKED_AT_ONCE) {
            #[expect(clippy::cast_possible_truncation, reason = "compared with the value itself")]
            let is_whole = |v: &f32| f32::from(*v as i16).to_bits() == v.to_bits();
            // Without a branch for each value.
            if !chunk.iter().fold(true, |all, v| all & is_whole(v)) {
                return Self::Broken(values.into_owned().into_boxed_slice());
            }
            #[expect(clippy::cast_possible_truncation, reason = "whole, as just seen")]
            whole.extend(chunk.iter().map(|&v| v as i16));
        }
        Self::Whole(whole.into_boxed_slice())
    }

    fn values(&self) -> Cow<'_, [f32]> {
        match self {
            Self::Whole(values) => values.iter().map(|&v| f32::from(v)).collect(),
            Self::Broken(values) => Cow::Borrowed(values),
        }
    }
}

impl Voxels {
    /// The planes in `values`, one after the other, `n_pixels` each.
    #[must_use]
    pub fn new(values: &[f32], n_pixels: usize) -> Self {
        Self { planes: values.par_chunks(n_pixels.max(1)).map(|plane| Plane::of(plane.into())).collect() }
    }

    /// Plane by plane, as `plane` gives their pixels and what it found about them.
    ///
    /// # Errors
    /// The first one of `plane`, in the order of the planes.
    pub fn by_plane<T: Send, E: Send>(
        n_planes: usize,
        plane: impl Fn(usize) -> Result<(Vec<f32>, T), E> + Sync,
    ) -> Result<(Self, Vec<T>), E> {
        let kept = |k| plane(k).map(|(values, found)| (Plane::of(values.into()), found));
        let planes: Vec<Result<(Plane, T), E>> = (0..n_planes).into_par_iter().map(kept).collect();
        let (planes, found) = planes.into_iter().collect::<Result<(Vec<Plane>, Vec<T>), E>>()?;
        Ok((Self { planes }, found))
    }

    /// The pixels of plane k.
    ///
    /// # Panics
    /// Where k is out of range.
    #[must_use]
    pub fn plane(&self, k: usize) -> Cow<'_, [f32]> {
        self.planes[k].values()
    }

    /// Pixel p of plane k.
    ///
    /// # Panics
    /// Where an index is out of range.
    #[must_use]
    pub fn at(&self, p: usize, k: usize) -> f32 {
        match &self.planes[k] {
            Plane::Whole(values) => f32::from(values[p]),
            Plane::Broken(values) => values[p],
        }
    }

    /// All values, x fastest, then y, then z.
    pub fn iter(&self) -> impl Iterator<Item = f32> + '_ {
        self.planes.iter().flat_map(|plane| plane.values().into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_comes_back_whatever_its_plane_is_kept_as() {
        let values = [-1024.0, 32767.0, 5.0, 0.5, 40000.0, f32::NAN, -0.0, -32769.0, 1.0, -2.0];
        let voxels = Voxels::new(&values, 2);
        let is_whole = |k: usize| matches!(voxels.planes[k], Plane::Whole(_));
        assert_eq!([0, 1, 2, 3, 4].map(is_whole), [true, false, false, false, true]);
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
        assert_eq!(bits(&voxels.iter().collect::<Vec<f32>>()), bits(&values));
        for (n, value) in values.iter().enumerate() {
            assert_eq!(voxels.at(n % 2, n / 2).to_bits(), value.to_bits());
            assert_eq!(voxels.plane(n / 2)[n % 2].to_bits(), value.to_bits());
        }
    }

    #[test]
    fn the_first_plane_that_fails_is_named() {
        let failed = Voxels::by_plane(8, |k| if k < 3 { Ok((vec![0.0; 4], ())) } else { Err(k) });
        assert_eq!(failed.unwrap_err(), 3);
    }
}
