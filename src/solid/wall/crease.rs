//! The crease between two branches of the outer skin: where two sheets of the parallel surface meet.
//!
//! A point of the crease has two feet on the lumen at distance t; Newton steps of least length lead to it. Its apex,
//! where the branches part, is where its tangent, the cross product of both normals, is horizontal. From there it
//! is followed down both ways (front and back) to where the corner fades. Between the two, every section is one
//! arc round each branch from corner to corner: the two lateral patches of the slab, which meet in the crease.

use super::feet::{Feet, Foot};
use super::neck::{self, Neck};
use super::trace::{Tracer, Vertex, at_height, contour};
use crate::geom::{Contour, Point2, Point3, SegmentIndex, Vector2, Vector3};
use crate::solid::assemble::{BuiltSlab, Creased};
use crate::solid::event::{Crotch, EventPlanes, Slab};
use crate::spline::PatchSurface;

/// Intervals along an arc, cosine-spaced.
const ARC_INTERVALS: usize = 96;
/// Rows of the patches at least and at most.
const LEAST_ROWS: usize = 12;
const MOST_ROWS: usize = 96;
/// Further rows beside the waist, in distances of rows: the patches bend there within the first of them to lean as the tube
/// does.
const BESIDE_WAIST: [f64; 2] = [0.25, 0.5];
/// Largest distance of rows in (mean radius of the branches).
const ROW_STEP: f64 = 0.12;
/// A corner that turns less has faded: sine. Rounded over the spacing h of a section's points it errs by h / 130.
const FADED_TURN: f64 = 0.06;
/// A corner must turn by more at the apex for the skin to be creased there, sine of half the turn.
const LEAST_APEX_TURN: f64 = 0.15;
/// How much nearer than t, in t, something else must be to a point of the crease to end it there.
const TRIMMED: f64 = 8e-3;
/// Points at which a crease is given up.
const MOST_POINTS: usize = 4000;
/// The least step along a crease in steps of an outline: where sheets are nearly parallel, its arch is narrow.
const LEAST_STEP: f64 = 1e-3;
/// A slab thinner than this share of the wall has no shape.
const LEAST_HEIGHT: f64 = 0.02;
/// Sections beside the slab, distances in radii.
const PARENT_OFFSETS: [f64; 9] = [0.045, 0.1, 0.165, 0.24, 0.33, 0.44, 0.58, 0.76, 1.0];
const DAUGHTER_OFFSETS: [f64; 4] = [0.06, 0.13, 0.22, 0.36];
/// Sections that were made for planes keep this distance from the slab, radii.
const CLEARANCE: f64 = 0.04;

/// A point of the crease; the first foot is daughter 0's.
#[derive(Debug, Clone, Copy)]
struct CreasePoint {
    at: Point3,
    feet: [Foot; 2],
}

impl CreasePoint {
    fn tangent(&self) -> Vector3 {
        self.feet[0].normal.cross(&self.feet[1].normal)
    }

    /// Angle between the horizontal parts of both normals.
    fn turn(&self) -> f64 {
        let [a, b] = self.feet.map(|f| f.normal.xy());
        a.perp(&b).abs().atan2(a.dot(&b))
    }
}

/// One side of the crease from the apex down.
struct Side {
    points: Vec<CreasePoint>,
    /// Whether it ends because the corner fades.
    fades: bool,
}

/// Builds the slab of a crease.
pub(super) struct CreaseBuilder<'a> {
    pub(super) tracer: Tracer<'a>,
    pub(super) sign: f64,
}

impl CreaseBuilder<'_> {
    pub(super) const fn feet(&self) -> &Feet {
        self.tracer.feet
    }

    /// The crease between the branches of an event, no lower than `floor`; `None` where they do not meet in one.
    pub(super) fn build(&self, planes: &EventPlanes, floor: f64) -> Option<Creased> {
        let apex = self.apex(planes)?;
        let w_top = self.sign * apex.at.z;
        let roof = planes.daughters.last()?.w;
        let unit = planes.mean_radius_mm();
        let clearance_mm = (CLEARANCE * unit).min(0.2 * (roof - w_top)).min(0.1 * (w_top - floor));
        let floor = floor + 1.5 * clearance_mm;
        if clearance_mm <= 1e-4 || w_top - floor < LEAST_HEIGHT * self.tracer.wall_mm {
            return None;
        }
        let across = apex.feet[0].normal.xy();
        let left = Vector2::new(-across.y, across.x);
        let along = apex.tangent() * apex.tangent().xy().dot(&left).signum();
        let (front, back) = rayon::join(|| self.side(apex, along, floor), || self.side(apex, -along, floor));
        let sides = [front?, back?];
        let w_low = self.low_end(&sides, floor);
        if w_top - w_low < LEAST_HEIGHT * self.tracer.wall_mm {
            return None;
        }
        self.slab(&sides, [w_low, w_top], unit, clearance_mm, [floor, roof])
    }

    /// The point of the crease nearest to `start`.
    fn on_crease(&self, start: Point3, feet: [Foot; 2]) -> Option<CreasePoint> {
        let (mut at, mut feet) = (start, feet);
        for _ in 0..20 {
            feet = feet.map(|f| self.feet().foot_beside(at, f.at));
            let errors = feet.map(|f| self.tracer.wall_mm - f.distance_mm);
            if errors[0].abs().max(errors[1].abs()) < 1e-7 {
                break;
            }
            let [a, b] = feet.map(|f| f.normal);
            let dot = a.dot(&b);
            let det = 1.0 - dot * dot;
            if det < 1e-6 {
                return None;
            }
            let step = a * ((errors[0] - dot * errors[1]) / det) + b * ((errors[1] - dot * errors[0]) / det);
            at += step * (0.5 * self.tracer.wall_mm / step.norm().max(1e-300)).min(1.0);
        }
        let settled =
            feet.iter().all(|f| (f.distance_mm - self.tracer.wall_mm).abs() < 1e-3 * self.tracer.wall_mm);
        settled.then_some(CreasePoint { at, feet })
    }

    /// The apex: from the middle between the nearest points of the branches on their first plane.
    fn apex(&self, planes: &EventPlanes) -> Option<CreasePoint> {
        let plane = planes.daughters.first()?;
        let [first, second] = &plane.contours[..] else { return None };
        let (p, q) = nearest_pair(first, second)?;
        let z = self.sign * plane.w;
        let feet = [p, q].map(|x| self.feet().foot(at_height(x, z)));
        let middle = nalgebra::center(&p, &q);
        let point = self.climbed(planes, at_height(middle, z), feet).or_else(|| {
            let radius_mm = planes.mean_radius_mm();
            let start = Neck { at: at_height(middle, z), feet, across: (q - p).try_normalize(1e-12)? };
            neck::apex(self, planes, start, radius_mm).map(|(at, feet)| CreasePoint { at, feet })
        })?;
        let w = self.sign * point.at.z;
        let lowest = planes.parents.last()?.w;
        let between = w > lowest && w < planes.daughters.last()?.w;
        let creased = (0.5 * point.turn()).sin() > LEAST_APEX_TURN;
        (between && creased && self.is_outside(&point)).then_some(point)
    }

    /// The apex by following the crease uphill: quick, but blind where the sheets are nearly parallel.
    fn climbed(&self, planes: &EventPlanes, start: Point3, feet: [Foot; 2]) -> Option<CreasePoint> {
        let reach = 0.5 * (planes.mean_radius_mm() + self.tracer.wall_mm);
        let mut point = self.on_crease(start, feet)?;
        for _ in 0..30 {
            let along = point.tangent().try_normalize(1e-9)?;
            let rise = self.sign * along.z;
            if rise.abs() < 1e-6 {
                break;
            }
            let h = 0.02 * reach;
            let ahead = self.on_crease(point.at + along * h, point.feet)?;
            let bend = (self.sign * ahead.tangent().try_normalize(1e-9)?.z - rise) / h;
            // The arch falls on both sides of its apex; where it does not yet, the way is up.
            let step = if bend < 0.0 { -rise / bend } else { rise.signum() * reach };
            point = self.on_crease(point.at + along * step.clamp(-0.5 * reach, 0.5 * reach), point.feet)?;
        }
        let level = point.tangent().try_normalize(1e-9)?.z.abs() < 1e-3;
        (level && self.is_outside(&point)).then_some(point)
    }

    /// Whether nothing else is nearer than the two feet.
    fn is_outside(&self, point: &CreasePoint) -> bool {
        self.feet().foot(point.at).distance_mm > self.tracer.wall_mm * (1.0 - TRIMMED)
    }

    /// Follows the crease from the apex down.
    fn side(&self, apex: CreasePoint, direction: Vector3, floor: f64) -> Option<Side> {
        let mut points = vec![apex];
        let mut direction = direction.try_normalize(1e-9)?;
        let mut fades = false;
        let mut step = 0.5 * self.tracer.step_mm;
        while points.len() < MOST_POINTS {
            let last = points[points.len() - 1];
            let next = self.on_crease(last.at + direction * step, last.feet);
            let next = next.filter(|n| {
                let moved = n.at - last.at;
                moved.dot(&direction) > 0.3 * step && moved.norm() < 2.0 * step
            });
            let Some(next) = next else {
                fades = last.turn() < 3.0 * FADED_TURN;
                if fades || step < LEAST_STEP * self.tracer.step_mm {
                    break;
                }
                step *= 0.5;
                continue;
            };
            let falls = self.sign * next.at.z < self.sign * last.at.z;
            if !falls || !self.is_outside(&next) {
                break;
            }
            // Both feet have run together: the last point was the end.
            let Some(tangent) = next.tangent().try_normalize(1e-6) else {
                fades = true;
                break;
            };
            direction = tangent * tangent.dot(&direction).signum();
            points.push(next);
            step = (1.5 * step).min(0.5 * self.tracer.step_mm);
            if next.turn() < FADED_TURN {
                fades = true;
                break;
            }
            if self.sign * next.at.z < floor {
                break;
            }
        }
        (points.len() > 2).then_some(Side { points, fades })
    }

    /// The lower end of the slab: where the longer side has faded, or either cannot go on.
    fn low_end(&self, sides: &[Side; 2], floor: f64) -> f64 {
        let ends = sides.each_ref().map(|s| self.sign * s.points[s.points.len() - 1].at.z);
        let stuck = sides.iter().zip(ends).filter(|(s, _)| !s.fades).map(|(_, w)| w);
        let stop = stuck.fold(f64::NEG_INFINITY, f64::max);
        ends[0].min(ends[1]).max(stop).max(floor)
    }

    /// The corner of a side at height w, with both feet; beyond the end of a side that has faded, the outline's point
    /// on the continued crease.
    fn corner(&self, side: &Side, w: f64) -> Option<(Point2, [Foot; 2])> {
        let z = self.sign * w;
        let fallen = |p: &CreasePoint| self.sign * p.at.z > w;
        let i = side.points.partition_point(fallen);
        let points = &side.points;
        if i == 0 {
            return Some((points[0].at.xy(), points[0].feet));
        }
        if i < points.len() {
            let (a, b) = (&points[i - 1], &points[i]);
            let drop = a.at.z - b.at.z;
            // Near its apex the arch is a parabola.
            let share = (a.at.z - z) / drop;
            let share = if i == 1 { share.sqrt() } else { share };
            let start = a.at.xy() + (b.at.xy() - a.at.xy()) * share;
            let nearer = if share < 0.5 { a } else { b };
            return self.tracer.corner(start, z, nearer.feet).or(Some((start, nearer.feet)));
        }
        let (a, b) = (&points[points.len() - 2], &points[points.len() - 1]);
        let slope = (b.at.xy() - a.at.xy()) / (b.at.z - a.at.z);
        let start = b.at.xy() + slope * (z - b.at.z);
        let (p, foot) = self.tracer.settle(start, z, None)?;
        Some((p, [foot; 2]))
    }

    /// Both arcs at height w: points at the given fractions of their lengths.
    fn arcs(&self, sides: &[Side; 2], w: f64, fractions: &[f64]) -> Option<[Vec<Point2>; 2]> {
        let z = self.sign * w;
        let [a, b] = [self.corner(&sides[0], w)?, self.corner(&sides[1], w)?];
        let arc = |from: (Point2, Foot), to: (Point2, Foot)| {
            let start = Vertex { p: from.0, feet: [from.1; 2], is_corner: true };
            let mut vertices = self.tracer.follow(start, Some(to.0), z)?;
            vertices.push(Vertex { p: to.0, feet: [to.1; 2], is_corner: true });
            self.tracer.resampled(&vertices, fractions, z)
        };
        Some([arc((a.0, a.1[0]), (b.0, b.1[0]))?, arc((b.0, b.1[1]), (a.0, a.1[1]))?])
    }

    fn slab(
        &self,
        sides: &[Side; 2],
        w_mm: [f64; 2],
        unit: f64,
        clearance_mm: f64,
        [floor, roof]: [f64; 2],
    ) -> Option<Creased> {
        let height = w_mm[1] - w_mm[0];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n = ((2.0 * height / (ROW_STEP * unit)).ceil() as usize).clamp(LEAST_ROWS, MOST_ROWS);
        let angle = |i: usize| std::f64::consts::PI * i as f64 / ARC_INTERVALS as f64;
        let u: Vec<f64> = (0..=ARC_INTERVALS).map(|i| 0.5 * (1.0 - angle(i).cos())).collect();
        let places = std::iter::once(0.0).chain(BESIDE_WAIST).chain((1..=n).map(|k| k as f64));
        let v: Vec<f64> = places.map(|place| place / n as f64).collect();
        let heights: Vec<f64> = v.iter().map(|v| w_mm[1] - height * (1.0 - v) * (1.0 - v)).collect();
        let rows: Vec<[Vec<Point2>; 2]> = {
            use rayon::prelude::*;
            let rows: Vec<_> = heights.par_iter().map(|&w| self.arcs(sides, w, &u)).collect();
            rows.into_iter().collect::<Option<_>>()?
        };
        let lateral = |side: usize| {
            let lift = |p: &Point2, w: f64| at_height(*p, self.sign * w);
            let grid: Vec<Vec<Point3>> = rows
                .iter()
                .zip(&heights)
                .map(|(r, &w)| r[side].iter().map(|p| lift(p, w)).collect())
                .collect();
            PatchSurface::through(&u, &v, &grid).ok()
        };
        let laterals = [lateral(0)?, lateral(1)?];
        let open = |row: &[Point2]| row[..row.len() - 1].to_vec();
        let waist = Contour::new([open(&rows[0][0]), open(&rows[0][1])].concat());
        let daughters = rows[rows.len() - 1].each_ref().map(|row| Contour::new(open(row)));
        let inside: [Point2; 2] = daughters.each_ref().map(Contour::centroid);
        let beside = |ws: Vec<f64>, at: Point2| self.sections(&ws, at);
        let parent_w = PARENT_OFFSETS.iter().map(|o| w_mm[0] - o * unit).filter(|w| *w > floor).collect();
        let daughter_w: Vec<f64> = DAUGHTER_OFFSETS
            .iter()
            .map(|o| w_mm[1] + o * unit)
            .filter(|w| *w < roof - clearance_mm)
            .collect();
        let slab = Slab { upward: self.sign > 0.0, w_mm, laterals, crotch: Crotch::Crease };
        Some(Creased {
            parent: beside(parent_w, waist.centroid()),
            daughters: inside.map(|at| beside(daughter_w.clone(), at)),
            slab: BuiltSlab { slab, waist, daughters },
            clearance_mm,
        })
    }

    /// The outlines round a point inside at heights w, where they can be followed.
    fn sections(&self, heights: &[f64], inside: Point2) -> Vec<(f64, Contour)> {
        let found = heights.iter().filter_map(|&w| {
            let z = self.sign * w;
            // From inside the lumen outward: any direction meets the outline that encloses the point.
            let reach = self.feet().foot(at_height(inside, z));
            let start = inside - reach.normal.xy() * (reach.distance_mm - self.tracer.wall_mm);
            let outline = contour(&self.tracer.outline(start, z)?);
            outline.contains(inside).then_some((w, outline))
        });
        found.collect()
    }
}

/// The nearest points of two contours.
fn nearest_pair(first: &Contour, second: &Contour) -> Option<(Point2, Point2)> {
    let index = SegmentIndex::try_new(std::slice::from_ref(second))?;
    let other = SegmentIndex::try_new(std::slice::from_ref(first))?;
    let gap = |p: &&Point2| index.nearest(**p).distance_mm;
    let mut p = *first.points.iter().min_by(|a, b| gap(a).total_cmp(&gap(b)))?;
    let mut q = index.nearest(p).point;
    for _ in 0..10 {
        p = other.nearest(q).point;
        q = index.nearest(p).point;
    }
    Some((p, q))
}
