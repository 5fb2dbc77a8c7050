//! Bodies in a scan: connected voxels above a level, with their moments and the places of their surface.
//!
//! Voxels are held as runs along the rows, joined where they share a face (union-find), so that a volume costs its runs alone; a level
//! with too many of them lies in the noise and is given up. A place of the surface lies where the values, linear between two neighbouring voxels, pass the level: not on the
//! voxels' faces.

use crate::ct::Volume;
use crate::geom::{Point3, Vector3};
use crate::progress::{Cancelled, Task};
use nalgebra::Matrix3;
use std::collections::BTreeMap;

/// A place of a surface, with the unit normal that points out of the material. Stack frame of the scan, mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct SurfacePoint {
    pub(super) at: Point3,
    pub(super) normal: Vector3,
}

/// Volume, centre and covariance of a body.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moments {
    pub(super) volume_mm3: f64,
    first: Vector3,
    second: Matrix3<f64>,
}

impl Moments {
    /// Adds a piece by its volume and the integrals of place and of place times place.
    pub(super) fn add(&mut self, volume_mm3: f64, first: Vector3, second: Matrix3<f64>) {
        self.volume_mm3 += volume_mm3;
        self.first += first;
        self.second += second;
    }

    pub(super) fn centre(&self) -> Point3 {
        Point3::from(self.first / self.volume_mm3)
    }

    pub(super) fn covariance(&self) -> Matrix3<f64> {
        let centre = self.centre().coords;
        self.second / self.volume_mm3 - centre * centre.transpose()
    }
}

/// Voxels `from..to` of row `row` of plane `plane`.
#[derive(Debug, Clone, Copy)]
struct Run {
    plane: u32,
    row: u32,
    from: u32,
    to: u32,
}

impl Run {
    const fn plane(&self) -> usize {
        self.plane as usize
    }

    const fn row(&self) -> usize {
        self.row as usize
    }

    const fn columns(&self) -> std::ops::Range<usize> {
        self.from as usize..self.to as usize
    }

    fn volume_mm3(&self, volume: &Volume) -> f64 {
        let [dx, dy] = volume.pixel_spacing_xy_mm;
        f64::from(self.to - self.from) * dx * dy * share_mm(volume, self.plane())
    }
}

/// Connected voxels above a level.
#[derive(Debug, Clone, Default)]
pub(super) struct Body {
    runs: Vec<Run>,
    pub(super) moments: Moments,
    /// Whether it goes on beyond the image.
    pub(super) is_cut: bool,
}

/// More runs than this are noise, not bodies: with their sets 100 MB.
const MOST_RUNS: usize = 4_000_000;

/// All bodies above `level` that are larger than `least_mm3`, the largest first; `None` where the level lies in the noise.
///
/// # Errors
/// [`Cancelled`].
pub(super) fn bodies(
    volume: &Volume,
    level: f64,
    least_mm3: f64,
    task: &Task<'_>,
) -> Result<Option<Vec<Body>>, Cancelled> {
    bodies_of(volume, level, least_mm3, MOST_RUNS, task)
}

fn bodies_of(
    volume: &Volume,
    level: f64,
    least_mm3: f64,
    most_runs: usize,
    task: &Task<'_>,
) -> Result<Option<Vec<Body>>, Cancelled> {
    let Some((runs, rows)) = runs_above(volume, level, most_runs, task)? else { return Ok(None) };
    let mut sets = Sets::new(runs.len());
    let [_, n_rows, n_planes] = volume.dims;
    for k in 0..n_planes {
        task.check()?;
        for j in 0..n_rows {
            let own = k * n_rows + j;
            if j > 0 {
                join(&runs, &mut sets, [rows[own - 1], rows[own]], [rows[own], rows[own + 1]]);
            }
            if k > 0 {
                let below = own - n_rows;
                join(&runs, &mut sets, [rows[below], rows[below + 1]], [rows[own], rows[own + 1]]);
            }
        }
    }
    // Specks are counted before anything is made of what is large.
    let mut volumes_mm3 = vec![0.0; runs.len()];
    for (i, run) in runs.iter().enumerate() {
        volumes_mm3[sets.root(i)] += run.volume_mm3(volume);
    }
    let mut bodies: BTreeMap<usize, Body> = BTreeMap::new();
    for (i, run) in runs.iter().enumerate() {
        let root = sets.root(i);
        if volumes_mm3[root] >= least_mm3 {
            bodies.entry(root).or_default().take(volume, *run);
        }
    }
    let mut bodies: Vec<Body> = bodies.into_values().collect();
    bodies.sort_by(|a, b| b.moments.volume_mm3.total_cmp(&a.moments.volume_mm3));
    Ok(Some(bodies))
}

/// Runs row by row, and for every row where its runs begin.
type Rows = (Vec<Run>, Vec<usize>);

/// `None`: they are more than `most_runs`.
fn runs_above(
    volume: &Volume,
    level: f64,
    most_runs: usize,
    task: &Task<'_>,
) -> Result<Option<Rows>, Cancelled> {
    let [n_cols, n_rows, n_planes] = volume.dims;
    let (mut runs, mut rows) = (Vec::new(), Vec::with_capacity(n_rows * n_planes + 1));
    for plane in 0..n_planes {
        task.check()?;
        let values = volume.plane(plane);
        for row in 0..n_rows {
            if runs.len() > most_runs {
                return Ok(None);
            }
            rows.push(runs.len());
            let own = &values[row * n_cols..(row + 1) * n_cols];
            let mut from = None;
            for (i, value) in own.iter().enumerate() {
                match (f64::from(*value) > level, from) {
                    (true, None) => from = Some(i),
                    (false, Some(start)) => {
                        runs.push(Run {
                            plane: small(plane),
                            row: small(row),
                            from: small(start),
                            to: small(i),
                        });
                        from = None;
                    }
                    _ => {}
                }
            }
            if let Some(start) = from {
                runs.push(Run {
                    plane: small(plane),
                    row: small(row),
                    from: small(start),
                    to: small(n_cols),
                });
            }
        }
    }
    rows.push(runs.len());
    Ok(Some((runs, rows)))
}

/// Joins the runs of two neighbouring rows that overlap.
fn join(runs: &[Run], sets: &mut Sets, [mut a, a_end]: [usize; 2], [mut b, b_end]: [usize; 2]) {
    while a < a_end && b < b_end {
        if runs[a].from < runs[b].to && runs[b].from < runs[a].to {
            sets.join(a, b);
        }
        if runs[a].to < runs[b].to {
            a += 1;
        } else {
            b += 1;
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "places in a volume, and its runs, of which there are few millions"
)]
const fn small(n: usize) -> u32 {
    n as u32
}

/// Disjoint sets, each named after its first member.
struct Sets(Vec<u32>);

impl Sets {
    fn new(n: usize) -> Self {
        Self((0..small(n)).collect())
    }

    fn root(&mut self, mut i: usize) -> usize {
        while self.0[i] as usize != i {
            self.0[i] = self.0[self.0[i] as usize];
            i = self.0[i] as usize;
        }
        i
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = small(a.min(b));
    }
}

/// How much of the height belongs to a plane, mm.
fn share_mm(volume: &Volume, k: usize) -> f64 {
    let z = &volume.plane_z_mm;
    match (k.checked_sub(1), k + 1 < z.len()) {
        (Some(below), true) => 0.5 * (z[k + 1] - z[below]),
        (Some(below), false) => z[k] - z[below],
        (None, true) => z[1] - z[0],
        (None, false) => volume.slab_thickness_mm,
    }
}

impl Body {
    fn take(&mut self, volume: &Volume, run: Run) {
        let [dx, _] = volume.pixel_spacing_xy_mm;
        let (columns, row, plane) = (run.columns(), run.row(), run.plane());
        let start = volume.stack_from_voxel(columns.start as f64, row as f64, plane);
        let n = columns.len() as f64;
        let volume_mm3 = run.volume_mm3(volume);
        let middle = Vector3::new(start.x + 0.5 * (n - 1.0) * dx, start.y, start.z);
        let mut second = middle * middle.transpose() * n;
        // Evenly spaced places scatter about their middle by (n² - 1) / 12 of the squared spacing.
        second[(0, 0)] += n * (n * n - 1.0) / 12.0 * dx * dx;
        self.moments.add(volume_mm3, middle * volume_mm3, second * (volume_mm3 / n));
        let [n_cols, n_rows, n_planes] = volume.dims;
        self.is_cut |= columns.start == 0 || columns.end == n_cols || row == 0 || row + 1 == n_rows;
        self.is_cut |= plane == 0 || plane + 1 == n_planes;
        self.runs.push(run);
    }

    /// The places of its surface at `level`, about `n_most` of them, evenly picked in the order of the voxels.
    pub(super) fn surface(&self, volume: &Volume, level: f64, n_most: usize) -> Vec<SurfacePoint> {
        let mut n_faces = 0usize;
        self.each_face(volume, level, |_, _| n_faces += 1);
        let every = n_faces.div_ceil(n_most.max(1)).max(1);
        let mut points = Vec::with_capacity(n_most + 1);
        let mut i = 0;
        self.each_face(volume, level, |inside, outside| {
            if i % every == every / 2 {
                points.extend(surface_point(volume, level, inside, outside));
            }
            i += 1;
        });
        points
    }

    /// Calls `take` for each face between a voxel above and one not above the level.
    fn each_face(&self, volume: &Volume, level: f64, mut take: impl FnMut([usize; 3], [usize; 3])) {
        let [n_cols, n_rows, n_planes] = volume.dims;
        let is_out = |i, j, k| f64::from(volume.at(i, j, k)) <= level;
        for run in &self.runs {
            let (j, k) = (run.row(), run.plane());
            for i in run.columns() {
                if is_out(i, j, k) {
                    continue;
                }
                let around = [
                    (i > 0).then(|| [i - 1, j, k]),
                    (i + 1 < n_cols).then_some([i + 1, j, k]),
                    (j > 0).then(|| [i, j - 1, k]),
                    (j + 1 < n_rows).then_some([i, j + 1, k]),
                    (k > 0).then(|| [i, j, k - 1]),
                    (k + 1 < n_planes).then_some([i, j, k + 1]),
                ];
                for other in around.into_iter().flatten().filter(|&[i, j, k]| is_out(i, j, k)) {
                    take([i, j, k], other);
                }
            }
        }
    }
}

fn surface_point(
    volume: &Volume,
    level: f64,
    inside: [usize; 3],
    outside: [usize; 3],
) -> Option<SurfacePoint> {
    let place = |[i, j, k]: [usize; 3]| volume.stack_from_voxel(i as f64, j as f64, k);
    let value = |[i, j, k]: [usize; 3]| f64::from(volume.at(i, j, k));
    let (a, b) = (value(inside), value(outside));
    let along = (a - level) / (a - b);
    let at = place(inside) + (place(outside) - place(inside)) * along;
    // The slope between the two, and the mean of the slopes at both across it.
    let slope = (gradient(volume, inside) + gradient(volume, outside)) * -0.5;
    let length = slope.norm();
    (length > 0.0).then(|| SurfacePoint { at, normal: slope / length })
}

fn gradient(volume: &Volume, at: [usize; 3]) -> Vector3 {
    let place = |[i, j, k]: [usize; 3]| volume.stack_from_voxel(i as f64, j as f64, k);
    let along = |axis: usize| {
        let (mut low, mut high) = (at, at);
        low[axis] = low[axis].saturating_sub(1);
        high[axis] = (high[axis] + 1).min(volume.dims[axis] - 1);
        let length = place(high)[axis] - place(low)[axis];
        let rise = f64::from(volume.at(high[0], high[1], high[2]) - volume.at(low[0], low[1], low[2]));
        if length > 0.0 { rise / length } else { 0.0 }
    };
    Vector3::new(along(0), along(1), along(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ct::Voxels;
    use crate::geom::RigidTransform;
    use crate::progress::CancelToken;

    /// Noise, and a bright block of 8 x 8 x 8 voxels in it.
    fn noisy() -> Volume {
        let n = 32;
        let mut seed = 7_u64;
        let value = |v: usize| {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let is_block = [v % n, v / n % n, v / (n * n)].iter().all(|i| (12..20).contains(i));
            if is_block { 10.0 } else { f32::from(u8::from(seed >> 63 == 1)) }
        };
        let hu: Vec<f32> = (0..n * n * n).map(value).collect();
        Volume {
            dims: [n; 3],
            hu: Voxels::new(&hu, n * n),
            origin_xy_mm: [0.0; 2],
            pixel_spacing_xy_mm: [0.5; 2],
            plane_z_mm: (0..n).map(|k| 0.5 * k as f64).collect(),
            slab_thickness_mm: 0.5,
            patient_from_stack: RigidTransform::identity(),
        }
    }

    #[test]
    fn a_level_in_the_noise_is_given_up_and_one_above_it_has_its_body() {
        let volume = noisy();
        let found = |level: f64| bodies_of(&volume, level, 10.0, 1000, &Task::quiet()).unwrap();
        assert!(found(0.5).is_none());
        let bodies = found(5.0).unwrap();
        assert!(bodies.len() == 1 && (bodies[0].moments.volume_mm3 - 64.0).abs() < 1e-9);
        assert!(
            !bodies[0].is_cut && (bodies[0].moments.centre() - Point3::new(7.75, 7.75, 7.75)).norm() < 1e-9
        );
        assert!(bodies_of(&volume, 0.5, 1e9, usize::MAX, &Task::quiet()).unwrap().unwrap().is_empty());
    }

    #[test]
    fn a_request_to_stop_is_heard() {
        let cancel = CancelToken::default();
        cancel.cancel();
        assert!(bodies(&noisy(), 5.0, 10.0, &Task::new(&|_, _| {}, cancel)).is_err());
    }
}
