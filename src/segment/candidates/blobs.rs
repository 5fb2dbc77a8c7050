//! A coarse picture of the volume, and what is round in its planes at a level.

use super::super::graph::root;
use crate::ct::Volume;
use rayon::prelude::*;
use std::ops::Range;

/// Coarse pixels are about this wide, mm: the thinnest vessel that is printed has a few of them across.
const COARSE_MM: f64 = 0.8;
/// Fewer pixels have no shape.
const LEAST_PIXELS: f64 = 5.0;
/// Sections from this area on, mm2: 1.6 mm across.
const LEAST_MM2: f64 = 2.0;
/// And up to this: the widest aneurysm that a bed takes.
const MOST_MM2: f64 = 2000.0;
/// A section fills the ellipse of its moments at least to this part.
const LEAST_FILL: f64 = 0.8;
/// Its edge is a step of so many standard deviations of the noise at least.
const LEAST_STEP: f64 = 3.0;
/// Of the sections of a plane at a level so many are kept, those with the clearest edges.
const MOST_BLOBS: usize = 256;

/// Means over squares of pixels.
pub(super) struct Coarse {
    dims: [usize; 3],
    values: Vec<f32>,
    /// Least and largest value of every row.
    ranges: Vec<[f32; 2]>,
    pub(super) pixel_mm: [f64; 2],
    /// Coarse pixel (0, 0)'s centre, stack frame.
    pub(super) origin_mm: [f64; 2],
    /// Standard deviation of the noise that is left.
    pub(super) noise_hu: f64,
}

impl Coarse {
    pub(super) fn of(volume: &Volume, planes: &Range<usize>) -> Self {
        let factor = [0, 1].map(|d| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a handful of pixels"
            )]
            let f = (COARSE_MM / volume.pixel_spacing_xy_mm[d]).floor().clamp(1.0, 64.0) as usize;
            f.min(volume.dims[d].max(1))
        });
        let [nx, ny] = [volume.dims[0] / factor[0], volume.dims[1] / factor[1]];
        let mut values = vec![0.0_f32; nx * ny * planes.len()];
        if nx * ny > 0 {
            values.par_chunks_mut(nx * ny).zip(planes.clone()).for_each(|(out, k)| {
                mean_plane(volume, k, factor, nx, out);
            });
        }
        let pixel_mm = [0, 1].map(|d| volume.pixel_spacing_xy_mm[d] * factor[d] as f64);
        let middle = |d: usize| volume.origin_xy_mm[d] + 0.5 * (pixel_mm[d] - volume.pixel_spacing_xy_mm[d]);
        let noise_hu = noise_of(&values, nx);
        let ranges = values.chunks(nx.max(1)).map(range_of).collect();
        let (dims, origin_mm) = ([nx, ny, planes.len()], [middle(0), middle(1)]);
        Self { dims, values, ranges, pixel_mm, origin_mm, noise_hu }
    }

    pub(super) const fn n_planes(&self) -> usize {
        self.dims[2]
    }

    /// The rows of plane k, each with its range.
    fn rows(&self, k: usize) -> impl Iterator<Item = (&[f32], [f32; 2])> {
        let [nx, ny, _] = self.dims;
        let values = self.values[k * nx * ny..(k + 1) * nx * ny].chunks_exact(nx.max(1));
        values.zip(self.ranges.get(k * ny..).unwrap_or_default().iter().copied())
    }

    /// Evenly spaced levels over the values that occur.
    pub(super) fn levels_hu(&self, n_levels: usize) -> Vec<f64> {
        let every = (self.values.len() / 200_000).max(1);
        let mut sample: Vec<f32> =
            self.values.iter().step_by(every).copied().filter(|v| v.is_finite()).collect();
        sample.sort_by(f32::total_cmp);
        let (Some(&least), Some(&most)) = (
            sample.get(sample.len() / 1000),
            sample.get(sample.len().saturating_sub(1 + sample.len() / 1000)),
        ) else {
            return Vec::new();
        };
        let (least, most) = (f64::from(least), f64::from(most));
        let at = |n: usize| least + (most - least) * (n as f64 + 1.0) / (n_levels as f64 + 1.0);
        if most > least { (0..n_levels).map(at).collect() } else { Vec::new() }
    }

    /// What is round in plane k above (sign +1) or below (-1) a level.
    pub(super) fn blobs(&self, k: usize, level_hu: f64, sign: f64) -> Vec<Blob> {
        let mut labelled = Labelled { sums: Vec::new(), above: Vec::new() };
        labelled.scan(self.rows(k), Cut::of(level_hu, sign));
        let [nx, ny, _] = self.dims;
        let blobs = labelled.merged().into_iter().filter_map(|s| self.blob(&s, sign, nx, ny));
        let mut blobs: Vec<Blob> = blobs.collect();
        if blobs.len() > MOST_BLOBS {
            blobs.sort_by(|a, b| b.step.total_cmp(&a.step).then(a.x_mm.total_cmp(&b.x_mm)));
            blobs.truncate(MOST_BLOBS);
        }
        blobs
    }

    fn blob(&self, sums: &Sums, sign: f64, nx: usize, ny: usize) -> Option<Blob> {
        let [sx, sy] = self.pixel_mm;
        let area_mm2 = sums.n * sx * sy;
        let touches = sums.x[0] == 0 || sums.y[0] == 0 || sums.x[1] + 1 >= nx || sums.y[1] + 1 >= ny;
        if touches || sums.n < LEAST_PIXELS || !(LEAST_MM2..=MOST_MM2).contains(&area_mm2) {
            return None;
        }
        let (mx, my) = (sums.sx / sums.n, sums.sy / sums.n);
        // A pixel is no point: it has moments of its own.
        let xx = (sums.sxx / sums.n - mx * mx + 1.0 / 12.0) * sx * sx;
        let yy = (sums.syy / sums.n - my * my + 1.0 / 12.0) * sy * sy;
        let xy = (sums.sxy / sums.n - mx * my) * sx * sy;
        let determinant = (xx * yy - xy * xy).max(1e-12);
        let half = 0.5 * (xx + yy);
        let apart = (half * half - determinant).max(0.0).sqrt();
        let fill = area_mm2 / (4.0 * std::f64::consts::PI * determinant.sqrt());
        let step = sign * sums.step / sums.n_steps.max(1.0) / self.noise_hu.max(1e-9);
        // An ellipse reaches twice its standard deviations to either side, however it is turned.
        let reach = |[a, b]: [usize; 2], s: f64, variance: f64| {
            let pixels = (b + 1 - a) as f64;
            ((s * pixels / (4.0 * variance.sqrt()) - 1.0).abs() - 1.0 / pixels).max(0.0)
        };
        let corners = reach(sums.x, sx, xx).max(reach(sums.y, sy, yy));
        (fill >= LEAST_FILL && step >= LEAST_STEP).then(|| Blob {
            corners,
            x_mm: self.origin_mm[0] + mx * sx,
            y_mm: self.origin_mm[1] + my * sy,
            radius_mm: (area_mm2 / std::f64::consts::PI).sqrt(),
            fill,
            round: ((half - apart).max(0.0) / (half + apart)).sqrt(),
            step,
            step_hu: step * self.noise_hu,
            level_hu: sums.hu / sums.n,
        })
    }
}

/// Least and largest of the values that are numbers; a range of none where there is none.
fn range_of(row: &[f32]) -> [f32; 2] {
    row.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[lo, hi], &v| [lo.min(v), hi.max(v)])
}

/// What is taken of a plane: all above a value, or all below it, in the numbers that the plane is kept in.
#[derive(Debug, Clone, Copy)]
enum Cut {
    Above(f32),
    Below(f32),
}

impl Cut {
    /// Above (sign +1) or below (-1) a level: the number next to it that parts the same ones.
    fn of(level_hu: f64, sign: f64) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "put right below")]
        let near = level_hu as f32;
        let is_beyond = |v: f32| sign * (f64::from(v) - level_hu) > 0.0;
        match (sign > 0.0, is_beyond(near)) {
            (true, true) => Self::Above(near.next_down()),
            (true, false) => Self::Above(near),
            (false, true) => Self::Below(near.next_up()),
            (false, false) => Self::Below(near),
        }
    }

    /// Whether none of a range is taken.
    fn leaves(self, [lo, hi]: [f32; 2]) -> bool {
        match self {
            Self::Above(level) => hi <= level || lo > hi,
            Self::Below(level) => lo >= level || lo > hi,
        }
    }
}

fn mean_plane(volume: &Volume, k: usize, [fx, fy]: [usize; 2], nx: usize, out: &mut [f32]) {
    let plane = volume.plane(k);
    let width = volume.dims[0];
    let share = 1.0 / (fx * fy) as f32;
    for (y, row) in out.chunks_mut(nx).enumerate() {
        for j in y * fy..(y + 1) * fy {
            let line = &plane[j * width..][..nx * fx];
            for (value, pixels) in row.iter_mut().zip(line.chunks_exact(fx)) {
                *value += share * pixels.iter().sum::<f32>();
            }
        }
    }
}

/// Standard deviation of the noise, from differences of neighbours: the median makes edges harmless.
fn noise_of(values: &[f32], nx: usize) -> f64 {
    let every = (values.len() / 100_000).max(1) | 1;
    let next = |p: usize| (!(p + 1).is_multiple_of(nx.max(1))).then(|| values.get(p + 1)).flatten();
    let differences = (0..values.len()).step_by(every).filter_map(|p| Some((next(p)? - values[p]).abs()));
    let mut differences: Vec<f32> = differences.filter(|d| d.is_finite()).collect();
    differences.sort_by(f32::total_cmp);
    // 1.4826 turns a median of absolute deviations into a standard deviation; two pixels carry noise. Values are
    // whole numbers: where most neighbours are equal, their rounding is the noise.
    let median = differences.get(differences.len() / 2).copied().unwrap_or(0.0);
    (1.4826 / std::f64::consts::SQRT_2 * f64::from(median)).max(0.3)
}

/// A connected piece of a plane at a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Blob {
    pub(super) x_mm: f64,
    pub(super) y_mm: f64,
    /// Of the disc of the same area.
    pub(super) radius_mm: f64,
    /// Its area over that of the ellipse with its moments: 1 for an ellipse, less for all else.
    pub(super) fill: f64,
    /// By how much it reaches farther or less far than that ellipse, beyond what a pixel explains: 0 for an ellipse.
    pub(super) corners: f64,
    /// Shorter over longer axis of that ellipse.
    pub(super) round: f64,
    /// Mean step over its edge, standard deviations of the noise.
    pub(super) step: f64,
    /// The same, HU.
    pub(super) step_hu: f64,
    /// Its mean, HU.
    pub(super) level_hu: f64,
}

#[derive(Clone, Copy, Default)]
struct Sums {
    n: f64,
    sx: f64,
    sy: f64,
    sxx: f64,
    syy: f64,
    sxy: f64,
    hu: f64,
    step: f64,
    n_steps: f64,
    x: [usize; 2],
    y: [usize; 2],
}

impl Sums {
    fn of_run(row: &[f32], x: Range<usize>, y: usize) -> Self {
        let n = x.len() as f64;
        let (a, b) = (x.start as f64, (x.end - 1) as f64);
        let sx = 0.5 * n * (a + b);
        let mean = 0.5 * (a + b);
        let sxx = n * mean * mean + n * (n * n - 1.0) / 12.0;
        let yf = y as f64;
        // What reaches the border is no section: its values tell nothing.
        let is_cut = x.start == 0 || x.end == row.len();
        let mut sums = Self {
            n,
            sx,
            sy: n * yf,
            sxx,
            syy: n * yf * yf,
            sxy: sx * yf,
            hu: if is_cut { 0.0 } else { f64::from(row[x.clone()].iter().sum::<f32>()) },
            step: 0.0,
            n_steps: 0.0,
            x: [x.start, x.end - 1],
            y: [y, y],
        };
        let beside = [x.start.checked_sub(1).map(|o| (x.start, o)), Some((x.end - 1, x.end))];
        for (inner, outer) in beside.into_iter().flatten() {
            if let Some(o) = row.get(outer).filter(|o| o.is_finite()) {
                sums.step += f64::from(row[inner] - o);
                sums.n_steps += 1.0;
            }
        }
        sums
    }

    fn add(&mut self, o: &Self) {
        self.n += o.n;
        self.sx += o.sx;
        self.sy += o.sy;
        self.sxx += o.sxx;
        self.syy += o.syy;
        self.sxy += o.sxy;
        self.hu += o.hu;
        self.step += o.step;
        self.n_steps += o.n_steps;
        self.x = [self.x[0].min(o.x[0]), self.x[1].max(o.x[1])];
        self.y = [self.y[0].min(o.y[0]), self.y[1].max(o.y[1])];
    }
}

/// Runs of selected pixels, joined where they touch through an edge.
struct Labelled {
    sums: Vec<Sums>,
    above: Vec<usize>,
}

impl Labelled {
    fn scan<'a>(&mut self, rows: impl Iterator<Item = (&'a [f32], [f32; 2])>, cut: Cut) {
        let (mut before, mut own): (Vec<(Range<usize>, usize)>, _) = (Vec::new(), Vec::new());
        for (y, (row, range)) in rows.enumerate() {
            own.clear();
            if !cut.leaves(range) {
                match cut {
                    Cut::Above(level) => self.scan_row(row, y, |v| v > level, &before, &mut own),
                    Cut::Below(level) => self.scan_row(row, y, |v| v < level, &before, &mut own),
                }
            }
            std::mem::swap(&mut before, &mut own);
        }
    }

    /// Takes the runs of a row, and joins them to those of the row before.
    fn scan_row(
        &mut self,
        row: &[f32],
        y: usize,
        is_in: impl Fn(f32) -> bool + Copy,
        before: &[(Range<usize>, usize)],
        own: &mut Vec<(Range<usize>, usize)>,
    ) {
        let mut from = 0;
        for run in runs(row, is_in) {
            let id = self.sums.len();
            self.sums.push(Sums::of_run(row, run.clone(), y));
            self.above.push(id);
            while before.get(from).is_some_and(|(r, _)| r.end <= run.start) {
                from += 1;
            }
            for (_, other) in before[from..].iter().take_while(|(r, _)| r.start < run.end) {
                let (a, b) = (root(&mut self.above, id), root(&mut self.above, *other));
                self.above[a.max(b)] = a.min(b);
            }
            own.push((run, id));
        }
    }

    /// The sums of every piece.
    fn merged(mut self) -> Vec<Sums> {
        for id in (0..self.sums.len()).rev() {
            let first = root(&mut self.above, id);
            if first != id {
                let sums = self.sums[id];
                self.sums[first].add(&sums);
            }
        }
        let roots = (0..self.sums.len()).filter(|&id| self.above[id] == id);
        roots.map(|id| self.sums[id]).collect()
    }
}

/// So many pixels are looked at in one go.
const AT_ONCE: usize = 16;

/// The first pixel from one on for which this holds.
fn first_from(row: &[f32], start: usize, is_in: impl Fn(f32) -> bool) -> Option<usize> {
    let (chunks, _) = row[start..].as_chunks::<AT_ONCE>();
    // Without a branch for each pixel.
    let held = chunks.iter().position(|chunk| chunk.iter().fold(false, |any, &v| any | is_in(v)));
    let from = start + held.unwrap_or(chunks.len()) * AT_ONCE;
    row[from..].iter().position(|&v| is_in(v)).map(|n| from + n)
}

fn runs(row: &[f32], is_in: impl Fn(f32) -> bool + Copy) -> impl Iterator<Item = Range<usize>> {
    let mut x = 0;
    std::iter::from_fn(move || {
        let start = first_from(row, x, is_in)?;
        let end = first_from(row, start, |v| !is_in(v)).unwrap_or(row.len());
        x = end;
        Some(start..end)
    })
}
