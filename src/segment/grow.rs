//! Flood fill through voxel faces, row by row.
//!
//! A run of voxels along x is filled at once and the four neighbouring rows (two in the plane, one below, one
//! above) are searched for runs to go on with (scan-line seed fill: Heckbert, "A seed fill algorithm", Graphics
//! Gems, 1990, here in 3-D). The fill goes on where it meets the border of the image, and remembers the place.

use super::bits::BitRows;
use super::corrections::Rules;
use super::{Mask, Polarity};
use crate::ct::Volume;
use crate::progress::{Cancelled, Task};
use std::ops::Range;

/// Column, row, plane.
pub(super) type Voxel = [usize; 3];

/// How many runs are filled between two looks at the cancel flag: well below 100 ms.
const RUNS_PER_CHECK: usize = 4096;

/// The planes and the intensities that the region may have.
#[derive(Debug, Clone)]
pub(super) struct Slab<'a> {
    /// The image.
    pub(super) volume: &'a Volume,
    /// The planes that may be used.
    pub(super) planes: Range<usize>,
    /// Lowest and highest intensity of each of these planes, HU.
    pub(super) windows_hu: Vec<[f64; 2]>,
    /// What the operator has corrected.
    pub(super) rules: &'a Rules,
}

impl Slab<'_> {
    /// The window of a plane, HU.
    #[must_use]
    pub(super) fn window_hu(&self, k: usize) -> [f64; 2] {
        self.windows_hu[k - self.planes.start]
    }

    /// Value of a voxel, HU.
    #[must_use]
    pub(super) fn hu(&self, [i, j, k]: Voxel) -> f64 {
        f64::from(self.volume.at(i, j, k))
    }

    /// Whether the voxel may be lumen: its value lies in the window and no correction says otherwise; where the
    /// plane's contour was drawn, whether it lies inside.
    #[must_use]
    pub(super) fn selects(&self, voxel: Voxel) -> bool {
        let [i, j, k] = voxel;
        match self.rules.drawn.get(&k) {
            Some(drawn) => drawn.mask.contains(i, j, k),
            None => self.in_window(k, self.hu(voxel)) && !self.rules.blocks(self.volume, voxel),
        }
    }

    fn in_window(&self, k: usize, hu: f64) -> bool {
        let [lo, hi] = self.window_hu(k);
        hu >= lo && hu <= hi
    }

    /// The voxels of all contours that were drawn.
    #[must_use]
    pub(super) fn drawn(&self) -> Vec<Voxel> {
        self.rules.drawn.range(self.planes.clone()).flat_map(|(_, drawn)| drawn.voxels()).collect()
    }

    /// The voxel, or the first of its eight neighbours in the plane that lies in the window.
    #[must_use]
    pub(super) fn selected_near(&self, seed: Voxel) -> Option<Voxel> {
        let [nx, ny, _] = self.volume.dims;
        let around = |c: usize, n: usize| c.saturating_sub(1)..(c + 2).min(n);
        let near = around(seed[1], ny).flat_map(|j| around(seed[0], nx).map(move |i| [i, j, seed[2]]));
        std::iter::once(seed).chain(near).find(|&v| self.selects(v))
    }

    /// Smallest and largest value of the planes, if no voxel at all lies in the window.
    #[must_use]
    pub(super) fn value_range_unless_selected(&self) -> Option<[f64; 2]> {
        let mut range = [f64::INFINITY, f64::NEG_INFINITY];
        for k in self.planes.clone() {
            for &hu in self.volume.plane(k).iter() {
                let hu = f64::from(hu);
                if self.in_window(k, hu) {
                    return None;
                }
                range = [range[0].min(hu), range[1].max(hu)];
            }
        }
        Some(range)
    }

    /// The row of a grid that holds these planes alone.
    fn row(&self, j: usize, k: usize) -> usize {
        (k - self.planes.start) * self.volume.dims[1] + j
    }
}

/// Voxels of a slab: one bit each, and the box they fill.
#[derive(Debug, Clone)]
pub(super) struct Grown {
    inside: BitRows,
    first_plane: usize,
    /// Columns, rows and planes that the voxels span; `None` where there is none.
    extent: Option<[Range<usize>; 3]>,
    /// The first voxel at the border of the image.
    pub(super) leak: Option<Voxel>,
}

impl Grown {
    fn empty(slab: &Slab<'_>) -> Self {
        let [nx, ny, _] = slab.volume.dims;
        let inside = BitRows::new(nx, ny * slab.planes.len());
        Self { inside, first_plane: slab.planes.start, extent: None, leak: None }
    }

    /// Columns, rows and planes that the voxels span.
    #[must_use]
    pub(super) fn extent(&self) -> [Range<usize>; 3] {
        self.extent.clone().unwrap_or([0..0, 0..0, 0..0])
    }

    /// Takes voxels out for which `keep` does not hold.
    pub(super) fn retain(&mut self, slab: &Slab<'_>, keep: impl Fn(Voxel) -> bool) {
        let [columns, rows, planes] = self.extent();
        self.extent = None;
        for k in planes {
            for j in rows.clone() {
                let row = slab.row(j, k);
                let mut ends: Option<[usize; 2]> = None;
                let held: Vec<usize> = self.inside.ones(row, &columns).collect();
                for i in held {
                    if keep([i, j, k]) {
                        ends = Some([ends.map_or(i, |e| e[0]), i + 1]);
                    } else {
                        self.inside.clear(row, i);
                    }
                }
                if let Some([start, end]) = ends {
                    self.widen(&[start..end, j..j + 1, k..k + 1]);
                }
            }
        }
    }

    /// The smallest box of columns and rows, within the given one, around the voxels of plane k.
    #[must_use]
    pub(super) fn plane_box(
        &self,
        slab: &Slab<'_>,
        k: usize,
        columns: &Range<usize>,
        rows: &Range<usize>,
    ) -> (Range<usize>, Range<usize>) {
        let mut found: Option<[usize; 4]> = None;
        for j in rows.clone() {
            let mut held = self.inside.ones(slab.row(j, k), columns);
            let Some(first) = held.next() else { continue };
            let last = held.last().unwrap_or(first);
            let [a, b, top, _] = found.unwrap_or([first, last, j, j]);
            found = Some([a.min(first), b.max(last), top, j]);
        }
        let nothing = [columns.start, columns.start, 0, 0];
        let [a, b, top, bottom] = found.map_or(nothing, |f| [f[0], f[1] + 1, f[2], f[3] + 1]);
        (a..b, top..bottom)
    }

    /// Adds the voxels of another set of the same slab.
    pub(super) fn add(&mut self, other: &Self) {
        self.inside.add(&other.inside);
        if let Some(extent) = &other.extent {
            self.widen(&extent.clone());
        }
    }

    /// All voxels of plane k.
    #[must_use]
    pub(super) fn plane(&self, slab: &Slab<'_>, k: usize) -> Vec<Voxel> {
        let [columns, rows, _] = self.extent();
        let all = rows.flat_map(|j| columns.clone().map(move |i| [i, j, k]));
        all.filter(|&v| self.holds(slab, v)).collect()
    }

    /// The voxels of plane k as a mask of their own.
    #[must_use]
    pub(super) fn mask_of_plane(&self, slab: &Slab<'_>, k: usize) -> Mask {
        let [columns, rows, _] = self.extent();
        Mask::from_fn(columns, rows, k..k + 1, |i, j, k| self.holds(slab, [i, j, k]))
    }

    fn widen(&mut self, by: &[Range<usize>; 3]) {
        let union = |a: Range<usize>, b: &Range<usize>| a.start.min(b.start)..a.end.max(b.end);
        self.extent = Some(match self.extent.take() {
            None => by.clone(),
            Some([i, j, k]) => [union(i, &by[0]), union(j, &by[1]), union(k, &by[2])],
        });
    }

    /// Whether the voxel belongs to the region.
    #[must_use]
    pub(super) fn holds(&self, slab: &Slab<'_>, voxel: Voxel) -> bool {
        let [i, j, k] = voxel;
        self.inside.get(slab.row(j, k), i)
    }

    fn fill(&mut self, slab: &Slab<'_>, run: &Range<usize>, j: usize, k: usize) {
        self.inside.set(slab.row(j, k), run);
        self.widen(&[run.clone(), j..j + 1, k..k + 1]);
    }

    /// The region cut down to its box.
    #[must_use]
    pub(super) fn into_mask(self, [_, ny, _]: [usize; 3]) -> Mask {
        let at = |i: usize, j: usize, k: usize| self.inside.get((k - self.first_plane) * ny + j, i);
        let [columns, rows, planes] = self.extent();
        Mask::from_fn(columns, rows, planes, at)
    }
}

/// Grows from the seeds through voxel faces, around what is `blocked`.
///
/// # Errors
/// [`Cancelled`].
pub(super) fn grow(
    slab: &Slab<'_>,
    seeds: &[Voxel],
    blocked: Option<&Grown>,
    task: &Task<'_>,
) -> Result<Grown, Cancelled> {
    let [nx, ny, _] = slab.volume.dims;
    let mut grown = Grown::empty(slab);
    let mut todo: Vec<Voxel> = seeds.to_vec();
    let mut n_runs = 0_usize;
    while let Some(voxel) = todo.pop() {
        let Some(run) = free_run(slab, &grown, blocked, voxel) else { continue };
        let [_, j, k] = voxel;
        if run.start == 0 || run.end == nx || j == 0 || j + 1 == ny {
            let i = if run.end == nx { nx - 1 } else { run.start };
            grown.leak = grown.leak.or(Some([i, j, k]));
        }
        grown.fill(slab, &run, j, k);
        push_neighbours(slab, &grown, blocked, &run, [j, k], &mut todo);
        n_runs += 1;
        if n_runs.is_multiple_of(RUNS_PER_CHECK) {
            task.check()?;
        }
    }
    task.check()?;
    Ok(grown)
}

fn is_free(slab: &Slab<'_>, grown: &Grown, blocked: Option<&Grown>, voxel: Voxel) -> bool {
    slab.selects(voxel) && !grown.holds(slab, voxel) && !blocked.is_some_and(|b| b.holds(slab, voxel))
}

/// The voxels along the row around this one that may be filled.
fn free_run(
    slab: &Slab<'_>,
    grown: &Grown,
    blocked: Option<&Grown>,
    [i, j, k]: Voxel,
) -> Option<Range<usize>> {
    let free = |i: usize| is_free(slab, grown, blocked, [i, j, k]);
    if !free(i) {
        return None;
    }
    let start = (0..i).rev().take_while(|&i| free(i)).last().unwrap_or(i);
    let end = (i + 1..slab.volume.dims[0]).take_while(|&i| free(i)).last().unwrap_or(i);
    Some(start..end + 1)
}

/// Pushes the first voxel of every run in the four rows beside this one.
fn push_neighbours(
    slab: &Slab<'_>,
    grown: &Grown,
    blocked: Option<&Grown>,
    run: &Range<usize>,
    [j, k]: [usize; 2],
    todo: &mut Vec<Voxel>,
) {
    let ny = slab.volume.dims[1];
    let beside = [
        j.checked_sub(1).map(|j| [j, k]),
        (j + 1 < ny).then_some([j + 1, k]),
        k.checked_sub(1).filter(|k| slab.planes.contains(k)).map(|k| [j, k]),
        slab.planes.contains(&(k + 1)).then_some([j, k + 1]),
    ];
    for [j, k] in beside.into_iter().flatten() {
        let mut in_run = false;
        for i in run.clone() {
            let free = is_free(slab, grown, blocked, [i, j, k]);
            if free && !in_run {
                todo.push([i, j, k]);
            }
            in_run = free;
        }
    }
}

/// What is connected, each plane for itself, to the border of the image: the air around a specimen whose lumen
/// is dark. By planes, because a lumen that is cut open at the specimen's end is connected to it in space.
///
/// # Errors
/// [`Cancelled`].
pub(super) fn outside_air(slab: &Slab<'_>, task: &Task<'_>) -> Result<Grown, Cancelled> {
    let [nx, ny, _] = slab.volume.dims;
    let mut air = Grown::empty(slab);
    for k in slab.planes.clone() {
        let mut todo: Vec<Voxel> = (0..nx).flat_map(|i| [[i, 0, k], [i, ny - 1, k]]).collect();
        todo.extend((0..ny).flat_map(|j| [[0, j, k], [nx - 1, j, k]]));
        while let Some([i, j, _]) = todo.pop() {
            let Some(run) = free_run(slab, &air, None, [i, j, k]) else { continue };
            air.fill(slab, &run, j, k);
            let rows = [j.checked_sub(1), (j + 1 < ny).then_some(j + 1)];
            let beside = rows.into_iter().flatten().flat_map(|j| run.clone().map(move |i| [i, j, k]));
            todo.extend(beside.filter(|&v| is_free(slab, &air, None, v)));
        }
        task.check()?;
    }
    Ok(air)
}

/// Whether what surrounds the region within its planes is mostly below the window (bright lumen) or above it.
#[must_use]
pub(super) fn polarity_at_rim(slab: &Slab<'_>, grown: &Grown) -> Polarity {
    let (mut below, mut above) = (0_usize, 0_usize);
    let [columns, rows, planes] = grown.extent();
    let [nx, ny, _] = slab.volume.dims;
    let inner = |&i: &usize, j: usize| i > 0 && j > 0 && i + 1 < nx && j + 1 < ny;
    for k in planes {
        let [lo, hi] = slab.window_hu(k);
        for j in rows.clone() {
            for i in columns.clone().filter(|i| inner(i, j)).filter(|&i| grown.holds(slab, [i, j, k])) {
                for v in [[i - 1, j, k], [i + 1, j, k], [i, j - 1, k], [i, j + 1, k]] {
                    below += usize::from(slab.hu(v) < lo);
                    above += usize::from(slab.hu(v) > hi);
                }
            }
        }
    }
    if above > below { Polarity::Dark } else { Polarity::Bright }
}
