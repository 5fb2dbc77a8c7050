//! The lumen as its outer skin needs it: samples of the whole surface, and for every branch the points
//! "point + t normal" on a grid, from which sections of the raw parallel surface are read column by column.
//!
//! Branches that end openly at the stack's ends are continued by t along their end tangents. The columns are read
//! by cubic interpolation between rings; rings lie a twelfth of the branch's radius apart and at all of its sections,
//! closer where the wall is thin beside the branch: what is rough on the scale of t shapes its outer skin.

use super::feet::{Oriented, Sample, grid_samples};
use crate::geom::{Contour, Point2, Point3, Vector3};
use crate::progress::{Cancelled, Task};
use crate::solid::event::{Crotch, Slab};
use crate::solid::skin::{End, Skin, Tube};
use crate::spline::PatchSurface;
use rayon::prelude::*;

/// Distance of rings in radii of the branch.
const RING_STEP: f64 = 0.08;
/// Farthest that samples lie apart, in t, but for what would only cost time, mm.
const SAMPLE_STEP: f64 = 0.25;
const LEAST_SAMPLE_STEP_MM: f64 = 0.1;
/// How far apart the points of neighbouring rings may lie, in their distance, before further rings are put between them;
/// and how many steps are made of one at most.
const MOST_APART: f64 = 1.5;
/// How far the normal may turn between neighbouring rings, radians, before further rings are put between them: what juts
/// out between two planes is thinner than rings are apart.
const MOST_TURN: f64 = 0.5;
const MOST_BETWEEN: f64 = 16.0;
/// Every how many of a section's points is a column where they are close enough.
const COLUMN_STRIDE: usize = 2;
/// Samples of a slab's patches along each direction.
const ARC_SAMPLES: usize = 96;
const SLAB_SAMPLES: usize = 16;
/// A flat end smaller than this share of the wall is the tip of a dome: its rim is no edge.
const TIP_SHARE: f64 = 0.25;

/// A branch as rings of points and normals, columns aligned.
#[derive(Debug)]
pub(super) struct Branch {
    heights: Vec<f64>,
    rings: Vec<Vec<Oriented>>,
    wall_mm: f64,
    /// Heights of flat ends inside the stack that are no tips.
    pub(super) flat_ends: Vec<f64>,
    /// Heights of all ends inside the stack, and whether the body lies below.
    pub(super) inner_ends: Vec<(f64, bool)>,
    pub(super) radius_mm: f64,
}

/// Whether a tube runs round material inside the lumen: a hole's surface faces the lumen, not the outer skin.
pub(super) fn is_hole(tube: &Tube) -> bool {
    let [low, high] = tube.surface.z_range_mm();
    !Contour::new(tube.surface.section(0.5 * (low + high)).points()).is_ccw()
}

impl Branch {
    /// The branch of a tube in a skin between `low` and `high`.
    pub(super) fn new(tube: &Tube, [low, high]: [f64; 2], wall_mm: f64) -> Self {
        let [bottom, top] = tube.surface.z_range_mm();
        let middle = Contour::new(tube.surface.section(0.5 * (bottom + top)).points());
        let radius_mm = (middle.signed_area_mm2().abs() / std::f64::consts::PI).sqrt();
        let most_mm = (SAMPLE_STEP * wall_mm).max(LEAST_SAMPLE_STEP_MM);
        let step = (RING_STEP * radius_mm.max(0.3 * wall_mm)).min(most_mm);
        let spacing_mm = middle.perimeter_mm() / middle.len() as f64;
        let stride = if COLUMN_STRIDE as f64 * spacing_mm > most_mm { 1 } else { COLUMN_STRIDE };
        let open = |end: End, z: f64, stack_end: f64| end == End::Cap && (z - stack_end).abs() < 1e-9;
        let mut heights = vec![bottom];
        for &z in tube.surface.section_z_mm() {
            fill(&mut heights, z, step);
        }
        let mut flat_ends = Vec::new();
        let mut inner_ends = Vec::new();
        if open(tube.bottom, bottom, low) {
            let mut beyond = vec![bottom - 1.1 * wall_mm];
            fill(&mut beyond, bottom, step);
            beyond.pop();
            heights.splice(0..0, beyond);
        } else if tube.bottom == End::Cap {
            inner_ends.push((bottom, false));
        }
        if open(tube.top, top, high) {
            fill(&mut heights, top + 1.1 * wall_mm, step);
        } else if tube.top == End::Cap {
            inner_ends.push((top, true));
        }
        for (z, _) in &inner_ends {
            let size = Contour::new(tube.surface.section(*z).points()).perimeter_mm() / std::f64::consts::TAU;
            if size > TIP_SHARE * wall_mm {
                flat_ends.push(*z);
            }
        }
        let (heights, rings) = closer(&heights, |z| ring(tube, z, stride), step.max(LEAST_SAMPLE_STEP_MM));
        Self { heights, rings, wall_mm, flat_ends, inner_ends, radius_mm }
    }

    fn samples(&self) -> Vec<Vec<Sample>> {
        grid_samples(&self.rings, true)
    }

    fn offset(&self, ring: usize, column: usize) -> Point3 {
        let (at, normal) = self.rings[ring][column];
        at + normal * self.wall_mm
    }

    /// The raw parallel section at z, column by column; `None` for a column that does not reach z or turns back
    /// there. Empty where no column reaches z.
    pub(super) fn columns(&self, z: f64) -> Vec<Option<Point2>> {
        let last = self.heights.len() - 1;
        if z < self.heights[0] - self.wall_mm || z > self.heights[last] + self.wall_mm {
            return Vec::new();
        }
        let start = self.heights.partition_point(|&h| h <= z).clamp(1, last) - 1;
        let found: Vec<_> = (0..self.rings[0].len()).map(|c| self.column(c, start, z)).collect();
        if found.iter().all(Option::is_none) { Vec::new() } else { found }
    }

    fn column(&self, column: usize, start: usize, z: f64) -> Option<Point2> {
        let last = self.heights.len() - 1;
        let height = |k: usize| self.offset(k, column).z;
        let mut k = start;
        while k > 0 && height(k) > z {
            k -= 1;
        }
        while k + 1 < last && height(k + 1) <= z {
            k += 1;
        }
        let first = k.saturating_sub(1).min(last.saturating_sub(3));
        let nodes: Vec<Point3> = (first..=(first + 3).min(last)).map(|k| self.offset(k, column)).collect();
        let rises = |i: usize| {
            nodes[i + 1].z - nodes[i].z > 0.05 * (self.heights[first + i + 1] - self.heights[first + i])
        };
        let inside = z >= nodes[0].z && z <= nodes[nodes.len() - 1].z;
        if !inside || !(0..nodes.len() - 1).all(rises) {
            return None;
        }
        // Lagrange's polynomial over the height.
        let mut at = Point2::origin();
        for (i, p) in nodes.iter().enumerate() {
            let others = nodes.iter().enumerate().filter(|(j, _)| *j != i);
            let weight: f64 = others.map(|(_, q)| (z - q.z) / (p.z - q.z)).product();
            at += p.xy().coords * weight;
        }
        Some(at)
    }
}

/// Goes on to z in equal steps of at most `most`.
fn fill(heights: &mut Vec<f64>, z: f64, most: f64) {
    let last = heights[heights.len() - 1];
    if z <= last + 1e-9 {
        return;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of steps")]
    let n = ((z - last) / most).ceil().max(1.0) as usize;
    heights.extend((1..=n).map(|k| if k == n { z } else { last + (z - last) * k as f64 / n as f64 }));
}

/// Rings at these heights and at further ones where the surface runs so flat that its points would lie far apart.
fn closer(
    heights: &[f64],
    ring: impl Fn(f64) -> Vec<Oriented> + Sync,
    most_mm: f64,
) -> (Vec<f64>, Vec<Vec<Oriented>>) {
    let rings: Vec<Vec<Oriented>> = heights.par_iter().map(|&z| ring(z)).collect();
    let further = |k: usize| -> Vec<(f64, Vec<Oriented>)> {
        let Some(before) = k.checked_sub(1) else { return Vec::new() };
        let n = steps_between(&rings[before], &rings[k], most_mm);
        let (from, to) = (heights[before], heights[k]);
        (1..n).map(|i| from + (to - from) * i as f64 / n as f64).map(|z| (z, ring(z))).collect()
    };
    let between: Vec<_> = (0..heights.len()).into_par_iter().map(further).collect();
    let given = heights.iter().copied().zip(rings);
    between.into_iter().zip(given).flat_map(|(further, given)| further.into_iter().chain([given])).unzip()
}

/// In how many steps one goes from a ring to the next.
fn steps_between(a: &[Oriented], b: &[Oriented], most_mm: f64) -> usize {
    let apart_mm = a.iter().zip(b).map(|(a, b)| (b.0 - a.0).norm()).fold(0.0, f64::max);
    let turn = a.iter().zip(b).map(|(a, b)| a.1.angle(&b.1)).fold(0.0, f64::max);
    let (share, turns) = (apart_mm / most_mm, turn / MOST_TURN);
    let asked = if share > MOST_APART { share.max(turns) } else { turns };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of steps")]
    let n = asked.ceil().clamp(1.0, MOST_BETWEEN) as usize;
    n
}

/// Every `stride`-th point round a tube at z with its outward normal, beyond its ends along the end tangents.
fn ring(tube: &Tube, z: f64, stride: usize) -> Vec<Oriented> {
    let [bottom, top] = tube.surface.z_range_mm();
    let inside = z.clamp(bottom, top);
    let slopes = tube.surface.section_slope(inside).points();
    let mut points = tube.surface.section(inside).points();
    if z < bottom || z > top {
        points.iter_mut().zip(&slopes).for_each(|(p, s)| *p += s.coords * (z - inside));
    }
    let n = points.len();
    let at = |i: usize| points[i % n].coords;
    (0..n)
        .step_by(stride)
        .map(|i| {
            // Fourth-order difference quotient round the section.
            let du = (at(i + 1) - at(i + n - 1)) * 8.0 - (at(i + 2) - at(i + n - 2));
            let slope = slopes[i].coords;
            let normal = Vector3::new(du.y, -du.x, du.x * slope.y - du.y * slope.x);
            let normal = normal.try_normalize(1e-12).unwrap_or_else(Vector3::z);
            (Point3::new(points[i].x, points[i].y, z), normal)
        })
        .collect()
}

/// The branches of a lumen and the samples of its whole surface, row by row.
pub(super) fn sampled(
    lumen: &Skin,
    wall_mm: f64,
    task: &Task<'_>,
) -> Result<(Vec<Branch>, Vec<Vec<Sample>>), Cancelled> {
    let range = lumen.z_range_mm();
    let outward: Vec<&Tube> = lumen.tubes.iter().filter(|t| !is_hole(t)).collect();
    let branches: Vec<Branch> = outward.par_iter().map(|tube| Branch::new(tube, range, wall_mm)).collect();
    task.check()?;
    let mut rows: Vec<Vec<Sample>> = branches.iter().flat_map(Branch::samples).collect();
    for (branch, tube) in branches.iter().zip(&outward) {
        for &(z, body_below) in &branch.inner_ends {
            rows.extend(flat_end(tube, z, body_below));
        }
    }
    let of_slabs: Vec<_> = lumen.slabs.par_iter().map(slab_samples).collect();
    rows.extend(of_slabs.into_iter().flatten());
    Ok((branches, rows))
}

/// Samples of a flat end: shrunk copies of its rim.
fn flat_end(tube: &Tube, z: f64, body_below: bool) -> Vec<Vec<Sample>> {
    const RINGS: usize = 8;
    let rim = Contour::new(tube.surface.section(z).points());
    let centre = rim.centroid();
    let normal = if body_below { Vector3::z() } else { -Vector3::z() };
    let rows: Vec<Vec<Oriented>> = (0..RINGS)
        .map(|k| {
            let share = (k as f64 + 0.5) / RINGS as f64;
            let shrunk = |p: &Point2| centre + (p - centre) * share;
            rim.points.iter().step_by(4).map(|p| (Point3::new(shrunk(p).x, shrunk(p).y, z), normal)).collect()
        })
        .collect();
    grid_samples(&rows, true)
}

fn slab_samples(slab: &Slab) -> Vec<Vec<Sample>> {
    // Seen along w a merge is mirrored.
    let sign = if slab.upward { 1.0 } else { -1.0 };
    let on = |patch: &PatchSurface, n: [usize; 2]| grid_samples(&patch_grid(patch, n, sign), false);
    let mut rows: Vec<Vec<Sample>> =
        slab.laterals.iter().flat_map(|lateral| on(lateral, [ARC_SAMPLES, SLAB_SAMPLES])).collect();
    if let Crotch::Saddle(saddle) = &slab.crotch {
        rows.extend(on(saddle, [2 * SLAB_SAMPLES; 2]));
    }
    rows
}

/// Points and normals on a grid over a patch.
fn patch_grid(patch: &PatchSurface, [n_u, n_v]: [usize; 2], sign: f64) -> Vec<Vec<Oriented>> {
    const STEP: f64 = 1e-4;
    let ([u0, u1], [v0, v1]) = (patch.u_range(), patch.v_range());
    let (eu, ev) = (STEP * (u1 - u0), STEP * (v1 - v0));
    let row = |j: usize| -> Vec<Oriented> {
        let v = v0 + (v1 - v0) * j as f64 / n_v as f64;
        let [low, high] = [(v - ev).max(v0), (v + ev).min(v1)];
        let (middle, below, above) = (patch.row(v), patch.row(low), patch.row(high));
        (0..=n_u)
            .filter_map(|i| {
                let u = u0 + (u1 - u0) * i as f64 / n_u as f64;
                let du = middle.at((u + eu).min(u1)) - middle.at((u - eu).max(u0));
                let dv = above.at(u) - below.at(u);
                let normal = du.cross(&dv).try_normalize(1e-18)?;
                Some((middle.at(u), normal * sign))
            })
            .collect()
    };
    let rows: Vec<Vec<Oriented>> = (0..=n_v).map(row).collect();
    let full = rows.iter().all(|r| r.len() == n_u + 1);
    if full { rows } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_are_closer_where_the_surface_runs_flat() {
        // Upright up to z 1, then 4 mm outward for every millimetre of height.
        let ring = |z: f64| vec![(Point3::new(4.0 * (z - 1.0).max(0.0), 0.0, z), Vector3::x())];
        let given = [0.0, 0.3, 0.65, 1.0, 1.3, 1.6];
        let (heights, rings) = closer(&given, ring, 0.25);
        assert!(given.iter().all(|z| heights.contains(z)) && heights.is_sorted());
        assert!(heights.iter().filter(|z| **z < 0.9).count() == 3, "{heights:?}");
        let apart = rings.windows(2).map(|r| (r[1][0].0 - r[0][0].0).norm());
        assert!(apart.fold(0.0, f64::max) < 1.5 * 0.25 + 0.1);
    }
}
