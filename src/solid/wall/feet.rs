//! The nearest point of the lumen's surface: a cloud of samples that know their normal and curvature, in a tree.
//!
//! The surface around a sample is taken as its osculating paraboloid, whose nearest point follows from a 2 x 2
//! system. With samples h apart the distance is wrong by about h³ / 48 times the change of curvature along the
//! surface: 1e-4 mm for a tenth of a millimetre.
//!
//! The tree (median splits along the widest axis, complete, four samples a leaf) finds the samples whose patch of the
//! surface may hold the foot. That is more than the nearest one: where two sheets are all but equally far, which sample
//! is nearest depends on how the sheets happen to be sampled. At a distance d, a foot r beside its sample lies
//! r² (1 + d k) / 2 d nearer than that.

use crate::geom::{Point3, Vector3};
use rayon::prelude::*;
use std::cell::Cell;

/// Samples in a leaf.
const LEAF: usize = 4;
/// Steps from sample to sample towards a foot.
const MOST_DESCENTS: usize = 8;
/// Orderings smaller than this are not worth another thread.
const PARALLEL_FROM: usize = 4096;
/// How far beside its sample a foot lies at most, in steps of the grid: half of one each way, and a margin.
const CELL: f64 = 0.55;
/// Farther aside a paraboloid may bulge out of the surface. What a foot is taken to be farther there, in steps per step;
/// and a little everywhere, so that of samples that agree the nearest one counts.
const BULGE: f64 = 0.3;
const ASIDE: f64 = 1e-3;
/// Farther than any point from a vessel, mm.
const BEYOND_ALL_MM: f64 = 1e9;
/// Most that a surface may turn between neighbouring samples, radians: beyond, they do not know its curvature.
const MOST_BEND: f64 = 1.0;
/// Beyond the centre of curvature a paraboloid has no nearest point: the shrinking of tangential offsets is kept
/// above this.
const LEAST_SHRINK: f64 = 0.1;

/// A point of the surface with its second-order shape.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) at: Point3,
    /// Outward unit normal.
    pub(super) normal: Vector3,
    /// Tangent frame in which the curvature is given.
    axes: [Vector3; 2],
    /// The shape operator k11, k12, k22, positive where the surface is convex, 1/mm.
    curvature: [f64; 3],
    /// How far the paraboloid stands for the surface, mm: the distance of neighbouring samples.
    reach_mm: f64,
    /// One step of the grid along the first axis, and along both for one of its second direction, mm.
    steps_mm: [f64; 3],
}

/// How much nearer, in squares, a surface may be than its samples.
#[derive(Debug, Clone, Copy, Default)]
struct Slack {
    /// Where it is flat, mm².
    flat_mm2: f64,
    /// The more, per mm of distance, as it is convex.
    bent_mm: f64,
}

impl Slack {
    fn joined(self, other: Self) -> Self {
        Self { flat_mm2: self.flat_mm2.max(other.flat_mm2), bent_mm: self.bent_mm.max(other.bent_mm) }
    }

    /// The square of the distance from which on nothing can be nearer than `distance_mm`.
    fn limit2(self, distance_mm: f64) -> f64 {
        distance_mm * distance_mm + self.flat_mm2 + self.bent_mm * distance_mm
    }
}

/// Point and normal of a grid over a patch, before its curvature is known.
pub(super) type Oriented = (Point3, Vector3);

/// The foot of a point on the surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Foot {
    pub(super) at: Point3,
    /// Unit vector from the foot to the point: the gradient of the distance.
    pub(super) normal: Vector3,
    /// Signed distance, mm, positive outside.
    pub(super) distance_mm: f64,
}

impl Sample {
    /// The sample of a grid point from its neighbours along both directions of the grid.
    fn new((at, normal): Oriented, along: [(Vector3, Vector3); 2], steps: [f64; 2]) -> Option<Self> {
        let first = (along[0].0 - normal * normal.dot(&along[0].0)).try_normalize(1e-12)?;
        let axes = [first, normal.cross(&first)];
        let flat = |v: &Vector3| [v.dot(&axes[0]), v.dot(&axes[1])];
        let [du, dv] = [flat(&along[0].0), flat(&along[1].0)];
        let [nu, nv] = [flat(&along[0].1), flat(&along[1].1)];
        let det = du[0] * dv[1] - du[1] * dv[0];
        let curvature = if det.abs() > 1e-14 {
            let k = |i: usize, j: usize| match j {
                0 => (nu[i] * dv[1] - nv[i] * du[1]) / det,
                _ => (nv[i] * du[0] - nu[i] * dv[0]) / det,
            };
            [k(0, 0), 0.5 * (k(0, 1) + k(1, 0)), k(1, 1)]
        } else {
            [0.0; 3]
        };
        let reach_mm = 0.5 * along[0].0.norm().max(along[1].0.norm());
        let strength = curvature.iter().map(|k| k.abs()).fold(0.0, f64::max) * reach_mm;
        let curvature = curvature.map(|k| k * (MOST_BEND / strength.max(1e-300)).min(1.0));
        let second = steps[1] / along[1].0.norm().max(1e-12);
        let steps_mm = [steps[0], dv[0] * second, dv[1] * second];
        Some(Self { at, normal, axes, curvature, reach_mm, steps_mm })
    }

    fn slack(&self) -> Slack {
        let [across, sheared, up] = self.steps_mm;
        let [k11, k12, k22] = self.curvature;
        let (a, b) = (across + sheared.abs(), up);
        let flat_mm2 = CELL * CELL * (a * a + b * b);
        Slack { flat_mm2, bent_mm: flat_mm2 * (k11.max(k22).max(0.0) + k12.abs()) }
    }

    /// The foot of `p` on the paraboloid.
    fn foot(&self, p: Point3) -> Foot {
        let [x, y] = self.aside(p);
        let shrink = (self.reach_mm / x.hypot(y).max(1e-300)).min(1.0);
        self.foot_at(p, [x * shrink, y * shrink])
    }

    /// The foot of `p` on the sample's own part of the paraboloid, no farther aside than its neighbours on the grid, and
    /// how far aside it would lie without that, in steps of the grid. Where a grid is much closer one way than the other
    /// the surface may bend away before the longer step is reached.
    fn placed_foot(&self, p: Point3) -> (Foot, f64) {
        let [x, y] = self.aside(p);
        let [across, sheared, up] = self.steps_mm;
        let up = if up.abs() < 1e-12 { 1e-12 } else { up };
        let across = across.max(1e-12);
        let second = y / up;
        let first = (x - second * sheared) / across;
        let [i, j] = [first, second].map(|step| step.clamp(-1.0, 1.0));
        (self.foot_at(p, [i * across + j * sheared, j * up]), first.abs().max(second.abs()).min(2.0))
    }

    /// Where the foot of `p` lies in the tangent plane.
    fn aside(&self, p: Point3) -> [f64; 2] {
        let r = p - self.at;
        let height = r.dot(&self.normal);
        let (x, y) = (r.dot(&self.axes[0]), r.dot(&self.axes[1]));
        let [k11, k12, k22] = self.curvature;
        // (I + height K) offset = tangential part of r.
        let (a, b, d) = (1.0 + height * k11, height * k12, 1.0 + height * k22);
        let det = (a * d - b * b).max(LEAST_SHRINK * (a.abs() + d.abs()).max(1.0) * 0.5);
        [(d * x - b * y) / det, (a * y - b * x) / det]
    }

    fn foot_at(&self, p: Point3, [x, y]: [f64; 2]) -> Foot {
        let [k11, k12, k22] = self.curvature;
        let sink = 0.5 * (k11 * x * x + 2.0 * k12 * x * y + k22 * y * y);
        let at = self.at + self.axes[0] * x + self.axes[1] * y - self.normal * sink;
        let out = p - at;
        let sign = if out.dot(&self.normal) < 0.0 { -1.0 } else { 1.0 };
        let length = out.norm();
        let normal = if length > 1e-9 { out * (sign / length) } else { self.normal };
        Foot { at, normal, distance_mm: sign * length }
    }
}

/// Samples of a grid of rows of equally many points, row by row; closed rows end where they began.
pub(super) fn grid_samples(rows: &[Vec<Oriented>], closed: bool) -> Vec<Vec<Sample>> {
    (0..rows.len()).into_par_iter().map(|i| row_samples(rows, i, closed)).collect()
}

fn row_samples(rows: &[Vec<Oriented>], i: usize, closed: bool) -> Vec<Sample> {
    let row = &rows[i];
    let (below, above) = (&rows[i.saturating_sub(1)], &rows[(i + 1).min(rows.len() - 1)]);
    let n = row.len();
    let sample = |j: usize| {
        let (before, after) =
            if closed { ((j + n - 1) % n, (j + 1) % n) } else { (j.saturating_sub(1), (j + 1).min(n - 1)) };
        let between = |a: &Oriented, b: &Oriented| (b.0 - a.0, b.1 - a.1);
        let here = row[j].0;
        let step = |a: &Oriented, b: &Oriented| (here - a.0).norm().max((b.0 - here).norm());
        let steps = [step(&row[before], &row[after]), step(&below[j], &above[j])];
        let along = [between(&row[before], &row[after]), between(&below[j], &above[j])];
        Sample::new(row[j], along, steps)
    };
    (0..n).filter_map(sample).collect()
}

#[derive(Debug, Clone, Copy)]
struct Box3 {
    min: Point3,
    max: Point3,
    slack: Slack,
}

impl Box3 {
    fn of(sites: &[Site]) -> Self {
        let (min, max) = (Point3::from([f64::INFINITY; 3]), Point3::from([f64::NEG_INFINITY; 3]));
        let empty = Self { min, max, slack: Slack::default() };
        sites.iter().fold(empty, |b, s| b.joined(Self { min: s.at, max: s.at, slack: s.slack }))
    }

    fn joined(self, other: Self) -> Self {
        Self {
            min: self.min.coords.inf(&other.min.coords).into(),
            max: self.max.coords.sup(&other.max.coords).into(),
            slack: self.slack.joined(other.slack),
        }
    }

    fn distance2(&self, p: Point3) -> f64 {
        let axis = |k: usize| (self.min[k] - p[k]).max(p[k] - self.max[k]).max(0.0);
        let [x, y, z] = [axis(0), axis(1), axis(2)];
        x * x + y * y + z * z
    }
}

/// What a search asks of every sample that it meets.
#[derive(Debug, Clone, Copy)]
struct Site {
    at: Point3,
    slack: Slack,
}

/// The cloud in its tree.
#[derive(Debug)]
pub(super) struct Feet {
    samples: Vec<Sample>,
    /// One for each of the samples, apart from them: a search passes by most.
    sites: Vec<Site>,
    boxes: Vec<Box3>,
}

impl Feet {
    /// Arranges samples given row by row; `None` where there are none.
    pub(super) fn try_new(rows: &[Vec<Sample>]) -> Option<Self> {
        let in_row = |(row, samples): (usize, &Vec<Sample>)| -> Vec<Place> {
            samples.iter().enumerate().map(|(column, s)| Place { at: s.at.into(), row, column }).collect()
        };
        let mut places: Vec<Place> = rows.par_iter().enumerate().flat_map_iter(in_row).collect();
        if places.is_empty() {
            return None;
        }
        let depth = places.len().div_ceil(LEAF).next_power_of_two().trailing_zeros();
        arrange(&mut places, depth);
        let samples: Vec<Sample> = places.par_iter().map(|p| rows[p.row][p.column]).collect();
        let sites: Vec<Site> =
            samples.par_iter().map(|sample| Site { at: sample.at, slack: sample.slack() }).collect();
        let boxes = boxes(&sites, depth);
        Some(Self { samples, sites, boxes })
    }

    /// The sample nearest to a point.
    pub(super) fn nearest(&self, p: Point3) -> &Sample {
        let best = Cell::new((f64::INFINITY, 0));
        self.walk(
            p,
            |_, distance2| distance2 < best.get().0,
            |k| {
                let d2 = (self.sites[k].at - p).norm_squared();
                if d2 < best.get().0 {
                    best.set((d2, k));
                }
            },
        );
        &self.samples[best.get().1]
    }

    /// The foot of a point.
    pub(super) fn foot(&self, p: Point3) -> Foot {
        let mut found = None;
        let least = Cell::new(BEYOND_ALL_MM);
        self.walk(
            p,
            |slack, distance2| distance2 < slack.limit2(least.get()),
            |k| {
                let Site { at, slack } = self.sites[k];
                if (at - p).norm_squared() >= slack.limit2(least.get()) {
                    return;
                }
                let sample = &self.samples[k];
                let (foot, beside) = sample.placed_foot(p);
                let aside = ASIDE * beside * beside + BULGE * (beside - CELL).max(0.0);
                let distance_mm = foot.distance_mm.abs() + aside * sample.reach_mm;
                if found.is_none() || distance_mm < least.get() {
                    least.set(distance_mm);
                    found = Some(foot);
                }
            },
        );
        found.unwrap_or_else(|| self.samples[0].foot(p))
    }

    /// Visits the samples of all leaves that are wanted, told by their slack and the square of their distance; the
    /// nearer half of every node first.
    fn walk(&self, p: Point3, wanted: impl Fn(Slack, f64) -> bool, mut visit: impl FnMut(usize)) {
        let n_leaves = self.boxes.len() / 2;
        let mut stack = [(0usize, 0usize, 0usize, 0.0f64); 48];
        stack[0] = (1, 0, self.samples.len(), 0.0);
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let (node, from, to, distance2) = stack[height];
            if !wanted(self.boxes[node].slack, distance2) {
                continue;
            }
            if node >= n_leaves {
                (from..to).for_each(&mut visit);
                continue;
            }
            let middle = usize::midpoint(from, to);
            let low = (2 * node, from, middle, self.boxes[2 * node].distance2(p));
            let high = (2 * node + 1, middle, to, self.boxes[2 * node + 1].distance2(p));
            let (near, far) = if low.3 <= high.3 { (low, high) } else { (high, low) };
            stack[height] = far;
            stack[height + 1] = near;
            height += 2;
        }
    }

    /// The foot of a point on the part of the surface round `near`, whatever else is nearer: from sample to sample
    /// downhill, because one paraboloid reaches no farther than its neighbours.
    pub(super) fn foot_beside(&self, p: Point3, near: Point3) -> Foot {
        let mut foot = self.nearest(near).foot(p);
        for _ in 0..MOST_DESCENTS {
            let next = self.nearest(foot.at).foot(p);
            if next.distance_mm > foot.distance_mm - 1e-9 {
                break;
            }
            foot = next;
        }
        foot
    }
}

/// Where a sample lies, and which one it is.
#[derive(Debug, Clone, Copy)]
struct Place {
    at: [f64; 3],
    row: usize,
    column: usize,
}

/// Orders samples so that halves, quarters, ... of the slice are separate in space.
fn arrange(places: &mut [Place], depth: u32) {
    if depth == 0 || places.len() < 2 {
        return;
    }
    let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for place in places.iter() {
        for k in 0..3 {
            min[k] = min[k].min(place.at[k]);
            max[k] = max[k].max(place.at[k]);
        }
    }
    let axis = (Point3::from(max) - Point3::from(min)).imax();
    let middle = places.len() / 2;
    places.select_nth_unstable_by(middle, |a, b| a.at[axis].total_cmp(&b.at[axis]));
    let (low, high) = places.split_at_mut(middle);
    if low.len() > PARALLEL_FROM {
        rayon::join(|| arrange(low, depth - 1), || arrange(high, depth - 1));
    } else {
        arrange(low, depth - 1);
        arrange(high, depth - 1);
    }
}

/// The boxes of a complete tree over sites in order: node i has the children 2 i and 2 i + 1, the root is 1.
fn boxes(sites: &[Site], depth: u32) -> Vec<Box3> {
    let leaf = |number: usize| {
        let (mut from, mut to) = (0, sites.len());
        for bit in (0..depth).rev() {
            let middle = usize::midpoint(from, to);
            if (number >> bit) & 1 == 0 { to = middle } else { from = middle }
        }
        Box3::of(&sites[from..to])
    };
    let n_leaves = 1 << depth;
    let mut boxes = vec![Box3::of(&[]); n_leaves];
    boxes.par_extend((0..n_leaves).into_par_iter().map(leaf));
    for node in (1..n_leaves).rev() {
        boxes[node] = boxes[2 * node].joined(boxes[2 * node + 1]);
    }
    boxes
}
