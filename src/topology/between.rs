//! Virtual sections: where several contours meet several others, planes are put between them on which they are
//! parted one after the other.
//!
//! The section at a height is the zero line of the planes' signed distances, interpolated in z: by a cubic through
//! four planes where the contours go on beyond both, else linearly (Raya & Udupa 1990; Herman, Zheng & Bucholtz, "Shape-based
//! interpolation", IEEE CG&A 1992). Heights are tried from the middle outward until what lies below and above is only
//! 1 -> n and n -> 1, level ones before tilted ones, which part what happens at one height; where one section is not
//! enough, the halves are parted in turn. Where no section helps, the union of
//! all contours stands in the middle: everything joins and parts again, and a warning says so.

use super::check::{Sheet, computed};
use super::stars::{clusters, joints_of_two};
use crate::geom::{Bounds2, Contour, Point2, Region, SegmentIndex, Vector2};
use crate::sections::march::Grid;
use crate::spline::ClosedCurve;
use rayon::prelude::*;

/// Shares of the way up at which a section is tried, and how often a part is halved.
const TRIED: [f64; 5] = [0.5, 0.4, 0.6, 0.3, 0.7];
const MOST_HALVINGS: usize = 2;
/// How far a section is tilted where two things happen at one height (shares of the interval over the size of the
/// meeting, along x and y): in directions that no symmetry of a drawing has.
const TILTS: [[f64; 2]; 4] = [[0.27, 0.41], [-0.41, 0.27], [0.7, 1.1], [-1.1, 0.7]];
/// Grid cells over the smallest contour's radius, and the most there may be along a side.
const CELLS_PER_RADIUS: f64 = 12.0;
const MOST_CELLS: f64 = 240.0;
/// Points of a virtual section where the given contours have fewer.
const LEAST_POINTS: usize = 128;
/// The least share of the smallest given contour's area that is a section and not a speck.
const SPECK: f64 = 0.01;

/// The contours of a part of the vessel on one plane.
#[derive(Debug, Clone)]
pub(super) struct Slice {
    pub(super) z_mm: f64,
    pub(super) contours: Vec<Contour>,
}

impl Slice {
    fn reversed(&self) -> Self {
        Self { z_mm: self.z_mm, contours: self.contours.iter().map(Contour::reversed).collect() }
    }
}

/// Several contours that meet several others, and how they go on.
pub(super) struct Meeting {
    pub(super) before: Option<Slice>,
    pub(super) lower: Slice,
    pub(super) upper: Slice,
    pub(super) after: Option<Slice>,
}

/// Sections between two planes, the lowest first, and whether they are the union of all contours.
pub(super) struct Parted {
    pub(super) sections: Vec<Slice>,
    pub(super) by_union: bool,
}

/// Finds sections that part a meeting; `None` where even the union of all contours does not.
pub(super) fn part(meeting: &Meeting) -> Option<Parted> {
    let turned = |s: &Slice| if is_of_holes(s) { s.reversed() } else { s.clone() };
    // Holes alone are parted like what they are missing from, turned inside out.
    let is_turned = is_of_holes(&meeting.lower);
    let meeting = Meeting {
        before: meeting.before.as_ref().map(turned),
        lower: turned(&meeting.lower),
        upper: turned(&meeting.upper),
        after: meeting.after.as_ref().map(turned),
    };
    let parted = by_distances(&meeting, 0).map(|sections| Parted { sections, by_union: false });
    let mut parted =
        parted.or_else(|| Some(Parted { sections: vec![by_union(&meeting)?], by_union: true }))?;
    if is_turned {
        parted.sections = parted.sections.iter().map(Slice::reversed).collect();
    }
    Some(parted)
}

/// Whether the outermost contours are holes.
fn is_of_holes(slice: &Slice) -> bool {
    let area = |c: &&Contour| c.signed_area_mm2();
    let greatest = slice.contours.iter().max_by(|a, b| area(a).abs().total_cmp(&area(b).abs()));
    greatest.is_some_and(|c| !c.is_ccw())
}

/// The slice as a sheet whose outermost contours are outlines, in their order; holes alone are turned inside out.
pub(super) fn sheet_of(slice: &Slice) -> Option<Sheet> {
    let turned = if is_of_holes(slice) { slice.reversed() } else { slice.clone() };
    computed(turned.z_mm, turned.contours)
}

/// How many contours meet several others between two slices; `None` where a contour would begin or end.
fn meetings(lower: &Slice, upper: &Slice) -> Option<usize> {
    let (below, above) = (sheet_of(lower)?, sheet_of(upper)?);
    let joints = joints_of_two(&below, &above);
    let (n_lower, n_upper) = (below.outlines.len(), above.outlines.len());
    let clusters = clusters(&joints, n_lower, n_upper);
    let (tied_lower, tied_upper) =
        clusters.iter().fold((0, 0), |(l, u), c| (l + c.lower.len(), u + c.upper.len()));
    let is_meeting = |c: &&super::stars::Cluster| c.lower.len() > 1 && c.upper.len() > 1;
    (tied_lower == n_lower && tied_upper == n_upper).then(|| clusters.iter().filter(is_meeting).count())
}

fn by_distances(meeting: &Meeting, halvings: usize) -> Option<Vec<Slice>> {
    let fields = Fields::of(meeting)?;
    let mut halved: Option<Slice> = None;
    let dz_mm = meeting.upper.z_mm - meeting.lower.z_mm;
    let level = |cubic: bool| TRIED.map(|share| Cut { share, cubic, tilt: Vector2::zeros() });
    let tilted = TILTS.into_iter().flat_map(|[x, y]| {
        let tilt = Vector2::new(x, y) / fields.bounds.size().norm();
        TRIED.map(|share| Cut { share, cubic: false, tilt })
    });
    for cut in level(true).into_iter().chain(level(false)).chain(tilted) {
        let Some(contours) = fields.section(meeting.lower.z_mm, dz_mm, cut) else { continue };
        let middle = Slice { z_mm: meeting.lower.z_mm + cut.share * dz_mm, contours };
        let (Some(below), Some(above)) =
            (meetings(&meeting.lower, &middle), meetings(&middle, &meeting.upper))
        else {
            continue;
        };
        if below + above == 0 {
            return Some(vec![middle]);
        }
        halved.get_or_insert(middle);
    }
    let middle = halved.filter(|_| halvings < MOST_HALVINGS)?;
    let half = |lower: &Slice, upper: &Slice| -> Option<Vec<Slice>> {
        if meetings(lower, upper)? == 0 {
            return Some(Vec::new());
        }
        let part = Meeting { before: None, lower: lower.clone(), upper: upper.clone(), after: None };
        by_distances(&part, halvings + 1)
    };
    let mut sections = half(&meeting.lower, &middle)?;
    let above = half(&middle, &meeting.upper)?;
    sections.push(middle);
    sections.extend(above);
    Some(sections)
}

/// The union of all contours in the middle of the interval, its notches rounded.
fn by_union(meeting: &Meeting) -> Option<Slice> {
    let (lower, upper) = (&meeting.lower, &meeting.upper);
    let region = |s: &Slice| Region::from_even_odd(&s.contours);
    let union = region(lower).union(&region(upper));
    let rounding = 0.2 * smallest_radius(lower.contours.iter().chain(&upper.contours))?;
    let rounded = union.offset(rounding, 1e-3).offset(-rounding, 1e-3);
    let contours = rounded.contours.iter().map(|c| smooth(c, LEAST_POINTS)).collect();
    let middle = Slice { z_mm: 0.5 * (lower.z_mm + upper.z_mm), contours };
    let parts = meetings(lower, &middle)? + meetings(&middle, upper)?;
    (parts == 0).then_some(middle)
}

fn smallest_radius<'a>(contours: impl Iterator<Item = &'a Contour>) -> Option<f64> {
    let radius = |c: &Contour| (c.signed_area_mm2().abs() / std::f64::consts::PI).sqrt();
    contours.map(radius).min_by(f64::total_cmp)
}

/// The contour evenly resampled on the curve through its points.
fn smooth(contour: &Contour, n_points: usize) -> Contour {
    ClosedCurve::through(contour)
        .map_or_else(|| contour.resampled(n_points), |c| Contour::new(c.resampled(n_points, 0.0)))
}

/// A section between two planes: at a share of the way up, by a cubic or linearly, tilted by so much per mm.
#[derive(Debug, Clone, Copy)]
struct Cut {
    share: f64,
    cubic: bool,
    tilt: Vector2,
}

/// Signed distances of the planes of a meeting.
struct Fields {
    planes: Vec<(f64, SegmentIndex)>,
    /// Which two of them the meeting lies between.
    inner: [usize; 2],
    bounds: Bounds2,
    step_mm: f64,
    least_area_mm2: f64,
    n_points: usize,
}

impl Fields {
    fn of(meeting: &Meeting) -> Option<Self> {
        let inner = [&meeting.lower, &meeting.upper];
        let all = || inner.iter().flat_map(|s| &s.contours);
        let radius = smallest_radius(all())?;
        let bounds = all().filter_map(Contour::bounds).reduce(Bounds2::union)?;
        let step_mm = (radius / CELLS_PER_RADIUS).max(bounds.size().max() / MOST_CELLS);
        let slices = meeting.before.iter().chain(inner).chain(&meeting.after);
        let planes: Option<Vec<(f64, SegmentIndex)>> =
            slices.map(|s| Some((s.z_mm, SegmentIndex::try_new(&s.contours)?))).collect();
        let first = usize::from(meeting.before.is_some());
        Some(Self {
            planes: planes?,
            inner: [first, first + 1],
            bounds: bounds.grown(2.0 * step_mm + 0.25 * radius),
            step_mm,
            least_area_mm2: SPECK * std::f64::consts::PI * radius * radius,
            n_points: all().map(Contour::len).max().unwrap_or(0).max(LEAST_POINTS),
        })
    }

    /// Depth under the surface at a height by Lagrange's weights of the planes: of all of them, or of the two that it
    /// lies between.
    fn depth(&self, p: Point2, z_mm: f64, cubic: bool) -> f64 {
        let used = if cubic { 0..self.planes.len() } else { self.inner[0]..self.inner[1] + 1 };
        let z = |p: usize| self.planes[p].0;
        let weight = |p: usize| -> f64 {
            used.clone().filter(|&q| q != p).map(|q| (z_mm - z(q)) / (z(p) - z(q))).product()
        };
        used.clone().map(|i| -weight(i) * self.planes[i].1.signed_distance_mm(p)).sum()
    }

    /// The zero line at a share of the way up; `None` where there is none, and for the cubic where a neighbour is
    /// missing.
    fn section(&self, low_mm: f64, dz_mm: f64, cut: Cut) -> Option<Vec<Contour>> {
        if cut.cubic && self.planes.len() < 4 {
            return None;
        }
        let centre = nalgebra::center(&self.bounds.min, &self.bounds.max);
        let depth = |p: Point2| -> f64 {
            let share = (cut.share + cut.tilt.dot(&(p - centre))).clamp(0.0, 1.0);
            self.depth(p, low_mm + share * dz_mm, cut.cubic)
        };
        let size = self.bounds.size() / self.step_mm;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of cells")]
        let [n_cols, n_rows] = [size.x, size.y].map(|n| n.ceil() as usize + 1);
        let at = |x: f64, y: f64| self.bounds.min + Vector2::new(x, y) * self.step_mm;
        let is_border = |i: usize, j: usize| i == 0 || j == 0 || i + 1 == n_cols || j + 1 == n_rows;
        let values: Vec<f64> = (0..n_cols * n_rows)
            .into_par_iter()
            .map(|p| {
                let (i, j) = (p % n_cols, p / n_cols);
                let value = depth(at(i as f64, j as f64));
                // Loops have to close within the grid; an exact zero would be no side at all.
                if is_border(i, j) {
                    value.min(-1e-9)
                } else if value.abs() < 1e-12 {
                    1e-12
                } else {
                    value
                }
            })
            .collect();
        let polished = |[x, y]: [f64; 2]| self.polished(at(x, y), &depth);
        let contours: Vec<Contour> = Grid { n_cols, n_rows, values }
            .loops()
            .into_iter()
            .map(|points| Contour::new(points.into_iter().map(polished).collect()))
            .filter(|c| c.signed_area_mm2().abs() >= self.least_area_mm2)
            .map(|c| smooth(&c, self.n_points))
            .collect();
        (!contours.is_empty()).then_some(contours)
    }

    /// A point on the zero line by Newton's method along the slope, no farther than a grid step away.
    fn polished(&self, start: Point2, depth: &impl Fn(Point2) -> f64) -> Point2 {
        let h = 0.05 * self.step_mm;
        let mut p = start;
        for _ in 0..3 {
            let slope = Vector2::new(
                depth(p + Vector2::new(h, 0.0)) - depth(p - Vector2::new(h, 0.0)),
                depth(p + Vector2::new(0.0, h)) - depth(p - Vector2::new(0.0, h)),
            ) / (2.0 * h);
            let steepness = slope.norm_squared();
            if steepness < 0.01 {
                return start;
            }
            p -= slope * (depth(p) / steepness);
        }
        if (p - start).norm() <= self.step_mm { p } else { start }
    }
}
