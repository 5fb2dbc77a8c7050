//! Contours as they were given to contours that can be linked: refused, repaired with a note, or taken as they are;
//! then arranged in nested components of lumen and of what is not lumen.

use super::decisions::Resolved;
use super::error::{ContourFault, Error};
use super::overlap::{Component, overlap_mm2};
use super::spikes::cut_spikes;
use super::{crossing, warning};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, Region};
use crate::sections::SectionStack;
use rayon::prelude::*;

/// Farthest coordinate, mm: beyond it no scanner reaches.
const FARTHEST_MM: f64 = 5000.0;
/// Height of a plane beyond which it is a slip of the pen: stacks of thousands of planes are still lower.
pub(super) const HIGHEST_MM: f64 = 1e5;
/// Most planes of a stack, contours of a plane and points of a contour: far more than any scan has, and few enough that
/// comparing all with all ends.
pub(super) const MOST_PLANES: usize = 20_000;
pub(super) const MOST_CONTOURS: usize = 1000;
pub(super) const MOST_POINTS: usize = 50_000;
/// Points nearer to each other than this are one point, mm: less than the grid on which regions are computed.
pub(super) const SAME_POINT_MM: f64 = 1e-6;
/// A contour whose area is below this share of its squared perimeter goes out and comes back the same way. A circle has
/// 0.08, an ellipse with axes 1 : 1000 has 2e-4.
const LEAST_FULLNESS: f64 = 1e-5;
/// A loop or an overlap of less than this share of the perimeter (times 1 mm) is rounding.
const ROUNDING_AREA_PER_MM: f64 = 1e-4;
/// How much longer than every other edge the closing one must be to be taken for a gap.
const GAP_RATIO: f64 = 3.0;

/// A contour of a plane, outer ones counter-clockwise, holes clockwise.
#[derive(Debug, Clone)]
pub(super) struct Outline {
    pub(super) contour: Contour,
    /// Its number in the plane as given.
    pub(super) number: usize,
    /// The component of lumen it bounds.
    pub(super) material: usize,
    /// The hole it bounds; `None`: it borders on the outside.
    pub(super) gap: Option<usize>,
}

/// A plane: its contours and the components they part it into.
#[derive(Debug, Clone)]
pub(super) struct Sheet {
    pub(super) z_mm: f64,
    /// Number of the plane as given; `None` where it was computed.
    pub(super) given: Option<usize>,
    pub(super) outlines: Vec<Outline>,
    pub(super) materials: Vec<Component>,
    /// Holes; the outside is none of them.
    pub(super) gaps: Vec<Component>,
}

/// Something that was repaired: where and how often.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    n: usize,
    first: Option<(usize, usize)>,
}

impl Tally {
    fn add(&mut self, n: usize, plane: usize, contour: usize) {
        if n > 0 {
            self.n += n;
            self.first.get_or_insert((plane, contour));
        }
    }

    fn join(&mut self, other: Self) {
        self.n += other.n;
        self.first = self.first.or(other.first);
    }

    fn warning(self, code: &str, what: &str) -> Option<Warning> {
        let (plane, contour) = self.first?;
        Some(warning(code, format!("{} {what}; the first: plane {plane}, contour {contour}", self.n)))
    }
}

/// What was repaired.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Repairs {
    repeated_points: Tally,
    spikes: Tally,
    loops: Tally,
    turned: Tally,
    gaps: Tally,
}

impl Repairs {
    fn join(&mut self, other: Self) {
        self.repeated_points.join(other.repeated_points);
        self.spikes.join(other.spikes);
        self.loops.join(other.loops);
        self.turned.join(other.turned);
        self.gaps.join(other.gaps);
    }

    pub(super) fn warnings(self) -> Vec<Warning> {
        [
            self.repeated_points.warning("topology.repeated_points", "repeated point(s) were dropped"),
            self.spikes.warning("topology.spikes", "spike(s) without width were cut off"),
            self.loops.warning("topology.loops", "contour(s) touched themselves; the tiny loops were cut off"),
            self.turned.warning(
                "topology.turned_round",
                "contour(s) ran the wrong way (outer ones run counter-clockwise, holes clockwise) and were turned round",
            ),
            self.gaps.warning(
                "topology.open_contour",
                "contour(s) seem open: last and first point lie far apart and were joined by a straight line",
            ),
        ]
        .into_iter()
        .flatten()
        .collect()
    }
}

/// Numbers of the planes from the lowest upward.
///
/// # Errors
/// Where there are too many planes, where two lie at one height, or where a height is no number.
pub(super) fn order(stack: &SectionStack) -> Result<Vec<usize>, Error> {
    if stack.planes.len() > MOST_PLANES {
        return Err(Error::TooManyPlanes { found: stack.planes.len() });
    }
    let z = |plane: usize| stack.planes[plane].z_mm;
    if let Some(plane) = (0..stack.planes.len()).find(|&p| !z(p).is_finite() || z(p).abs() > HIGHEST_MM) {
        return Err(Error::PlaneHeight { plane, z_mm: z(plane) });
    }
    let mut order: Vec<usize> = (0..stack.planes.len()).collect();
    order.sort_by(|&a, &b| z(a).total_cmp(&z(b)));
    // Planes closer than a millionth of a millimetre are one plane twice.
    if let Some(pair) = order.windows(2).find(|p| z(p[1]) - z(p[0]) < 1e-6) {
        let (first, second) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
        return Err(Error::RepeatedPlane { first, second, z_mm: z(first) });
    }
    Ok(order)
}

/// All planes, checked and repaired, the lowest first; with what was repaired.
///
/// # Errors
/// The fault of the lowest plane that has one.
pub(super) fn sheets(
    stack: &SectionStack,
    order: &[usize],
    resolved: &Resolved,
) -> Result<(Vec<Sheet>, Repairs), Error> {
    let checked: Vec<Result<(Sheet, Repairs), Error>> =
        order.par_iter().map(|&plane| sheet(stack, plane, resolved)).collect();
    let mut repairs = Repairs::default();
    let mut sheets = Vec::with_capacity(checked.len());
    for result in checked {
        let (sheet, made) = result?;
        sheets.push(sheet);
        repairs.join(made);
    }
    Ok((sheets, repairs))
}

fn sheet(stack: &SectionStack, plane: usize, resolved: &Resolved) -> Result<(Sheet, Repairs), Error> {
    let sections = &stack.planes[plane];
    let z_mm = sections.z_mm;
    if sections.contours.len() > MOST_CONTOURS {
        return Err(Error::TooManyContours { plane, z_mm, found: sections.contours.len() });
    }
    let mut repairs = Repairs::default();
    let mut kept = Vec::new();
    for (contour, given) in sections.contours.iter().enumerate() {
        if resolved.dropped.contains(&(plane, contour)) {
            continue;
        }
        let fault = |fault| Error::Contour { plane, z_mm, contour, fault };
        kept.push((contour, tidied(given, plane, contour, &mut repairs).map_err(fault)?));
    }
    let contours: Vec<&Contour> = kept.iter().map(|(_, c)| c).collect();
    let around = nesting(&contours).map_err(|meeting| {
        let [first, second] = meeting.pair.map(|i| kept[i].0);
        if meeting.same {
            Error::RepeatedContour { plane, z_mm, first, second }
        } else {
            Error::Crossing { plane, z_mm, first, second }
        }
    })?;
    for (i, (number, contour)) in kept.iter_mut().enumerate() {
        let is_outer = depth(&around, i).is_multiple_of(2);
        if contour.is_ccw() != is_outer {
            *contour = contour.reversed();
            repairs.turned.add(1, plane, *number);
        }
    }
    let numbered = kept.into_iter().map(|(number, contour)| (contour, number)).collect();
    Ok((arranged(z_mm, Some(plane), numbered, &around), repairs))
}

/// A computed plane: contours that do not cross, outer ones counter-clockwise.
pub(super) fn computed(z_mm: f64, contours: Vec<Contour>) -> Option<Sheet> {
    let around = nesting(&contours.iter().collect::<Vec<_>>()).ok()?;
    let numbered = contours.into_iter().enumerate().map(|(i, c)| (c, i)).collect();
    Some(arranged(z_mm, None, numbered, &around))
}

fn depth(around: &[Option<usize>], contour: usize) -> usize {
    std::iter::successors(around[contour], |&c| around[c]).count()
}

/// Components from contours and the next contour around each.
fn arranged(
    z_mm: f64,
    given: Option<usize>,
    contours: Vec<(Contour, usize)>,
    around: &[Option<usize>],
) -> Sheet {
    let n = contours.len();
    let is_outer: Vec<bool> = (0..n).map(|i| depth(around, i).is_multiple_of(2)).collect();
    // Each component is named by the contour around it, in their order.
    let mut own = vec![0; n];
    let mut counts = [0usize; 2];
    for i in 0..n {
        let count = &mut counts[usize::from(is_outer[i])];
        own[i] = *count;
        *count += 1;
    }
    let component = |i: usize| {
        let inner = (0..n).filter(|&j| around[j] == Some(i)).map(|j| contours[j].0.clone());
        let mut region: Vec<Contour> = std::iter::once(contours[i].0.clone()).chain(inner).collect();
        if !is_outer[i] {
            region = region.iter().map(Contour::reversed).collect();
        }
        Component::new(Region::new(region))
    };
    let of_kind = |outer: bool| (0..n).filter(|&i| is_outer[i] == outer).map(component).collect();
    let (materials, gaps) = (of_kind(true), of_kind(false));
    let parent = |i: usize| around[i].map(|p| own[p]);
    let outlines = contours
        .iter()
        .enumerate()
        .map(|(i, (contour, number))| {
            let (material, gap) =
                if is_outer[i] { (own[i], parent(i)) } else { (parent(i).unwrap_or(0), Some(own[i])) };
            Outline { contour: contour.clone(), number: *number, material, gap }
        })
        .collect();
    Sheet { z_mm, given, outlines, materials, gaps }
}

/// Two contours that cross, or that are one.
struct Meeting {
    pair: [usize; 2],
    same: bool,
}

/// For every contour the smallest one around it.
fn nesting(contours: &[&Contour]) -> Result<Vec<Option<usize>>, Meeting> {
    let areas: Vec<f64> = contours.iter().map(|c| c.signed_area_mm2().abs()).collect();
    let bounds: Vec<_> = contours.iter().map(|c| c.bounds()).collect();
    let mut around: Vec<Option<usize>> = vec![None; contours.len()];
    for i in 0..contours.len() {
        for j in i + 1..contours.len() {
            let (Some(a), Some(b)) = (bounds[i], bounds[j]) else { continue };
            if !a.meets(b) {
                continue;
            }
            let (inner, outer) = if areas[i] < areas[j] { (i, j) } else { (j, i) };
            let inside = if crossing::of_two(contours[i], contours[j]).is_some() {
                let shared = overlap_mm2(&filled(contours[i]), &filled(contours[j]));
                let rounding = 1e-6 * areas[inner];
                if shared > rounding && areas[inner] - shared > rounding {
                    return Err(Meeting { pair: [i, j], same: false });
                }
                if shared > rounding && areas[outer] - areas[inner] <= 1e-6 * areas[outer] {
                    return Err(Meeting { pair: [i, j], same: true });
                }
                shared > rounding
            } else {
                contours[outer].contains(contours[inner].points[0])
            };
            if inside && around[inner].is_none_or(|known| areas[outer] < areas[known]) {
                around[inner] = Some(outer);
            }
        }
    }
    Ok(around)
}

/// The region within a contour of either direction.
fn filled(contour: &Contour) -> Region {
    Region::new(vec![if contour.is_ccw() { contour.clone() } else { contour.reversed() }])
}

/// A contour without what carries no shape: repeated points, spikes without width, loops of rounding.
fn tidied(
    given: &Contour,
    plane: usize,
    number: usize,
    repairs: &mut Repairs,
) -> Result<Contour, ContourFault> {
    if given.len() > MOST_POINTS {
        return Err(ContourFault::TooManyPoints(given.len()));
    }
    let usable = |c: f64| c.is_finite() && c.abs() <= FARTHEST_MM;
    if let Some(i) = given.points.iter().position(|p| !usable(p.x) || !usable(p.y)) {
        return Err(ContourFault::NotFinite(i));
    }
    let mut points = without_repeats(&given.points);
    let closed_by_hand =
        given.len() > 1 && (given.points[0] - given.points[given.len() - 1]).norm() <= SAME_POINT_MM;
    let n_repeated = given.len() - points.len();
    // Many programs repeat the first point at the end: nothing is lost, nothing to be told.
    repairs.repeated_points.add(n_repeated.saturating_sub(usize::from(closed_by_hand)), plane, number);
    if points.len() < 4 {
        return Err(ContourFault::TooFewPoints(points.len()));
    }
    let n_spikes = cut_spikes(&mut points);
    if points.len() < 4 {
        return Err(ContourFault::NoArea);
    }
    repairs.spikes.add(n_spikes, plane, number);
    repairs.gaps.add(usize::from(has_gap(&points)), plane, number);
    let contour = Contour::new(points);
    let Some(met) = crossing::within(&contour) else {
        let fullness = contour.signed_area_mm2().abs() / contour.perimeter_mm().powi(2);
        return if fullness < LEAST_FULLNESS { Err(ContourFault::NoArea) } else { Ok(contour) };
    };
    let cleaned = without_loops(&contour).ok_or(ContourFault::SelfCrossing(met.x, met.y))?;
    repairs.loops.add(usize::from(cleaned != contour), plane, number);
    Ok(cleaned)
}

fn without_repeats(points: &[Point2]) -> Vec<Point2> {
    let mut kept: Vec<Point2> = Vec::with_capacity(points.len());
    for &p in points {
        if kept.last().is_none_or(|last| (p - last).norm() > SAME_POINT_MM) {
            kept.push(p);
        }
    }
    while kept.len() > 1 && (kept[0] - kept[kept.len() - 1]).norm() <= SAME_POINT_MM {
        kept.pop();
    }
    kept
}

fn has_gap(points: &[Point2]) -> bool {
    let closing = (points[0] - points[points.len() - 1]).norm();
    let longest = points.windows(2).map(|p| (p[1] - p[0]).norm()).fold(0.0, f64::max);
    closing > GAP_RATIO * longest
}

/// The contour itself where it only touches itself, its greatest loop where the others are rounding; `None` where
/// it crosses itself.
fn without_loops(contour: &Contour) -> Option<Contour> {
    let area = contour.signed_area_mm2();
    let rounding = ROUNDING_AREA_PER_MM * contour.perimeter_mm();
    let simple = Region::from_even_odd(std::slice::from_ref(contour));
    let greatest =
        simple.contours.iter().max_by(|a, b| a.signed_area_mm2().total_cmp(&b.signed_area_mm2()))?;
    // A loop lies inside (the even-odd area shrinks) or outside (the signed area cancels).
    let same = |a: f64| (a - area.abs()).abs() <= rounding;
    if !same(greatest.signed_area_mm2()) || !same(simple.area_mm2()) {
        return None;
    }
    if simple.contours.len() == 1 {
        return Some(contour.clone());
    }
    Some(if area > 0.0 { greatest.clone() } else { greatest.reversed() })
}
