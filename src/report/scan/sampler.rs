//! Values between the voxels of a scan.

use crate::ct::Volume;
use crate::geom::Point3;

/// A scan, read at any place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sampler<'a> {
    volume: &'a Volume,
}

impl<'a> Sampler<'a> {
    pub(super) const fn new(volume: &'a Volume) -> Self {
        Self { volume }
    }

    /// The largest side of a voxel, mm.
    pub(super) fn largest_mm(&self) -> f64 {
        let intervals = self.volume.plane_z_mm.windows(2).map(|z| z[1] - z[0]);
        let planes = intervals.fold(self.volume.slab_thickness_mm.min(f64::MAX), f64::max);
        self.volume.pixel_spacing_xy_mm.into_iter().fold(planes, f64::max)
    }

    /// The smallest side of a voxel, mm.
    pub(super) fn voxel_mm(&self) -> f64 {
        let intervals = self.volume.plane_z_mm.windows(2).map(|z| z[1] - z[0]);
        self.volume.pixel_spacing_xy_mm.into_iter().chain(intervals).fold(f64::INFINITY, f64::min)
    }

    /// The volume of a voxel, mm³.
    pub(super) fn volume_mm3(&self) -> f64 {
        let [dx, dy] = self.volume.pixel_spacing_xy_mm;
        let intervals = self.volume.plane_z_mm.windows(2).map(|z| z[1] - z[0]);
        dx * dy * intervals.reduce(f64::max).unwrap_or(self.volume.slab_thickness_mm)
    }

    /// Trilinear; `None` outside of the outermost voxels' centres.
    pub(super) fn at(&self, p: Point3) -> Option<f64> {
        let v = self.volume;
        let [i, x] = cell((p.x - v.origin_xy_mm[0]) / v.pixel_spacing_xy_mm[0], v.dims[0])?;
        let [j, y] = cell((p.y - v.origin_xy_mm[1]) / v.pixel_spacing_xy_mm[1], v.dims[1])?;
        let z = &v.plane_z_mm;
        let above = z.partition_point(|&own| own <= p.z);
        let below = above.checked_sub(1)?;
        let top = z.get(above).copied().filter(|_| z.len() > 1);
        let (below, part) = match top {
            Some(top) => (below, (p.z - z[below]) / (top - z[below])),
            None if p.z <= *z.last()? && z.len() > 1 => (below - 1, 1.0),
            None => return None,
        };
        let (i, j) = (index(i), index(j));
        let row =
            |j: usize, k: usize| f64::from(v.at(i, j, k)) * (1.0 - x) + f64::from(v.at(i + 1, j, k)) * x;
        let plane = |k: usize| row(j, k) * (1.0 - y) + row(j + 1, k) * y;
        Some(plane(below) * (1.0 - part) + plane(below + 1) * part)
    }
}

/// The cell of a place on a line of `n` centres, and the part of it that is gone.
fn cell(at: f64, n: usize) -> Option<[f64; 2]> {
    let last = n.checked_sub(2)? as f64;
    if !(0.0..=last + 1.0).contains(&at) {
        return None;
    }
    let below = at.floor().min(last);
    Some([below, at - below])
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a cell of the grid")]
const fn index(at: f64) -> usize {
    at as usize
}
