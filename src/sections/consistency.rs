//! What belongs together over the planes: small fragments, islands, pinholes and one-plane flicker are resolved
//! here, so that the number of contours changes between planes only by true splits, merges, births and deaths.
//!
//! The rules, in this order; every change is reported with its plane's z:
//! 1. An outer contour of less than [`LEAST_AREA_PIXELS`] pixels is dropped.
//! 2. A hole is kept only if holes overlap it through at least [`LEAST_HOLE_PLANES`] planes in a row; a hole
//!    goes with its outer contour.
//! 3. An island, which overlaps nothing in the planes below and above, is dropped.
//! 4. A stub, which hangs on a contour of one neighbouring plane beside a sibling that goes on, but meets
//!    nothing in the other neighbouring plane, is dropped: a branch must be seen in two planes.
//! 5. One-two-one: contours that all overlap the same single contour below and the same one above are bridged
//!    (closing by the least distance that joins them); where that would take more than their own radius, all
//!    but the largest are dropped.
//! 6. Two-one-two: a contour that overlaps two below and two above, of which each overlaps just one of the
//!    others, is split by a slit of a quarter pixel across its neck (the neck is where it parts when shrunk by
//!    the least distance that parts it); where no shrinking parts it, it stays and is reported.

use super::extract::Error;
use super::warnings::SectionWarnings;
use crate::geom::{Bounds2, Contour, Point2, Region, SegmentIndex, Vector2};

/// Fewer pixels than this are noise.
pub(super) const LEAST_AREA_PIXELS: f64 = 4.0;
/// A hole that lasts fewer planes is noise or a passing artefact.
const LEAST_HOLE_PLANES: usize = 3;
/// A removal may leave a new stub behind; more rounds than this mean that there is nothing stable to find.
const MOST_ROUNDS: usize = 32;
/// Contours overlap from this share of the smaller one's area on.
const LEAST_OVERLAP: f64 = 0.02;

/// A contour of a plane on its way to the result.
#[derive(Debug, Clone)]
pub(super) struct Loop {
    pub(super) contour: Contour,
    pub(super) origin: Origin,
}

/// Where a contour comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Origin {
    /// The image.
    Image,
    /// The image; rule 6 was tried on it and could not part it.
    ImageUnparted,
    /// A bridge or a split: there is no edge in the image that it could be fitted to.
    Made,
}

impl Loop {
    fn is_hole(&self) -> bool {
        !self.contour.is_ccw()
    }
}

/// The contours of one plane.
#[derive(Debug, Clone)]
pub(super) struct Plane {
    /// Index in the volume.
    pub(super) k: usize,
    pub(super) z_mm: f64,
    pub(super) loops: Vec<Loop>,
}

/// An outer contour ready for overlap tests.
pub(super) struct Outer {
    /// Where it stands among the plane's loops.
    pub(super) at: usize,
    bounds: Bounds2,
    region: Region,
    pub(super) area_mm2: f64,
    below: Vec<usize>,
    above: Vec<usize>,
}

/// Applies the rules to a stack of planes.
pub(super) fn resolve(planes: &mut [Plane], pixel_area_mm2: f64, warnings: &mut SectionWarnings) {
    for plane in planes.iter_mut() {
        drop_fragments(plane, LEAST_AREA_PIXELS * pixel_area_mm2, warnings);
    }
    drop_passing_holes(planes, warnings);
    if planes.len() < 2 {
        return;
    }
    for _ in 0..MOST_ROUNDS {
        if !resolve_once(planes, pixel_area_mm2, warnings) {
            break;
        }
    }
}

/// The planes from the first to the last that has a contour; those between without any are reported.
pub(super) fn without_empty_ends(
    mut planes: Vec<Plane>,
    warnings: &mut SectionWarnings,
) -> Result<Vec<Plane>, Error> {
    let found = planes.iter().filter(|p| !p.loops.is_empty()).count();
    if found < 2 {
        return Err(Error::TooFewPlanes { found, dropped: warnings.len() });
    }
    let start = planes.iter().position(|p| !p.loops.is_empty()).unwrap_or(0);
    let end = planes.iter().rposition(|p| !p.loops.is_empty()).map_or(0, |k| k + 1);
    let planes = planes.drain(start..end).collect::<Vec<Plane>>();
    for gap in planes.iter().filter(|p| p.loops.is_empty()) {
        warnings.gap(gap.z_mm);
    }
    Ok(planes)
}

/// One walk through the planes; true where something changed.
fn resolve_once(planes: &mut [Plane], pixel_area_mm2: f64, warnings: &mut SectionWarnings) -> bool {
    let links = linked(planes);
    let (mut changed, mut k) = (false, 0);
    while k < planes.len() {
        let here = resolve_plane(planes, &links, k, pixel_area_mm2, warnings);
        changed |= here;
        // The next plane's links are out of date then: it waits for the next walk.
        k += if here { 2 } else { 1 };
    }
    changed
}

fn drop_fragments(plane: &mut Plane, least_mm2: f64, warnings: &mut SectionWarnings) {
    let small = |l: &Loop| l.contour.signed_area_mm2().abs() < least_mm2;
    let dropped: Vec<usize> =
        (0..plane.loops.len()).filter(|&i| !plane.loops[i].is_hole() && small(&plane.loops[i])).collect();
    for &i in &dropped {
        warnings.fragment(plane.z_mm, plane.loops[i].contour.signed_area_mm2());
    }
    remove_outers(plane, &dropped);
    // Pinholes of less than the least area are noise inside the lumen and not worth a word.
    plane.loops.retain(|l| !(l.is_hole() && small(l)));
}

/// Removes outer contours together with their holes.
pub(super) fn remove_outers(plane: &mut Plane, outers: &[usize]) {
    if outers.is_empty() {
        return;
    }
    let gone: Vec<Contour> = outers.iter().map(|&i| plane.loops[i].contour.clone()).collect();
    let in_gone = |l: &Loop| gone.iter().any(|o| o.contains(l.contour.points[0]));
    let mut at = 0;
    plane.loops.retain(|l| {
        let keep = if l.is_hole() { !in_gone(l) } else { !outers.contains(&at) };
        at += 1;
        keep
    });
}

fn drop_passing_holes(planes: &mut [Plane], warnings: &mut SectionWarnings) {
    let holes: Vec<Vec<Outer>> = planes.iter().map(|p| prepared(p, true)).collect();
    // How many planes in a row up to this one (and from this one on) hold a hole that goes on from it.
    let mut up: Vec<Vec<usize>> = holes.iter().map(|h| vec![1; h.len()]).collect();
    let mut down = up.clone();
    for k in 1..planes.len() {
        for n in 0..holes[k].len() {
            let longest = overlapping(&holes[k][n], &holes[k - 1]).map(|o| up[k - 1][o]).max();
            up[k][n] = 1 + longest.unwrap_or(0);
        }
    }
    for k in (0..planes.len().saturating_sub(1)).rev() {
        for n in 0..holes[k].len() {
            let longest = overlapping(&holes[k][n], &holes[k + 1]).map(|o| down[k + 1][o]).max();
            down[k][n] = 1 + longest.unwrap_or(0);
        }
    }
    for (k, plane) in planes.iter_mut().enumerate() {
        let passing = |n: usize| up[k][n] + down[k][n] - 1 < LEAST_HOLE_PLANES;
        let mut gone: Vec<usize> =
            (0..holes[k].len()).filter(|&n| passing(n)).map(|n| holes[k][n].at).collect();
        gone.sort_unstable();
        for &i in gone.iter().rev() {
            warnings.hole(plane.z_mm, -plane.loops[i].contour.signed_area_mm2());
            plane.loops.remove(i);
        }
    }
}

fn overlapping<'a>(one: &'a Outer, others: &'a [Outer]) -> impl Iterator<Item = usize> + 'a {
    (0..others.len()).filter(move |&o| overlap(one, &others[o]))
}

pub(super) fn prepared(plane: &Plane, holes: bool) -> Vec<Outer> {
    let wanted = plane.loops.iter().enumerate().filter(|(_, l)| l.is_hole() == holes);
    wanted
        .filter_map(|(at, l)| {
            let contour = if holes { l.contour.reversed() } else { l.contour.clone() };
            let (bounds, area_mm2) = (contour.bounds()?, contour.signed_area_mm2());
            let region = Region::new(vec![contour]);
            Some(Outer { at, bounds, region, area_mm2, below: Vec::new(), above: Vec::new() })
        })
        .collect()
}

fn overlap(a: &Outer, b: &Outer) -> bool {
    overlap_by(a, b, LEAST_OVERLAP)
}

/// Whether they overlap by more than this share of the smaller one.
pub(super) fn overlap_by(a: &Outer, b: &Outer, least: f64) -> bool {
    let apart = a.bounds.min.x > b.bounds.max.x
        || b.bounds.min.x > a.bounds.max.x
        || a.bounds.min.y > b.bounds.max.y
        || b.bounds.min.y > a.bounds.max.y;
    !apart && a.region.intersection(&b.region).area_mm2() > least * a.area_mm2.min(b.area_mm2)
}

fn linked(planes: &[Plane]) -> Vec<Vec<Outer>> {
    let mut outers: Vec<Vec<Outer>> = planes.iter().map(|p| prepared(p, false)).collect();
    for k in 1..outers.len() {
        let (lower, upper) = outers.split_at_mut(k);
        let (lower, upper) = (&mut lower[k - 1], &mut upper[0]);
        for (b, over) in upper.iter_mut().enumerate() {
            for (a, under) in lower.iter_mut().enumerate() {
                if overlap(under, over) {
                    under.above.push(b);
                    over.below.push(a);
                }
            }
        }
    }
    outers
}

/// Applies rules 3 to 6 to plane k; true as soon as one of them changed it.
fn resolve_plane(
    planes: &mut [Plane],
    links: &[Vec<Outer>],
    k: usize,
    pixel_area_mm2: f64,
    warnings: &mut SectionWarnings,
) -> bool {
    let here = &links[k];
    let plane = &mut planes[k];
    if let Some(island) = here.iter().find(|o| o.below.is_empty() && o.above.is_empty()) {
        warnings.island(plane.z_mm, island.area_mm2);
        remove_outers(plane, &[island.at]);
        return true;
    }
    if k == 0 || k + 1 == links.len() {
        return false;
    }
    if let Some(stub) = here.iter().find(|o| is_stub(o, &links[k - 1], &links[k + 1])) {
        warnings.stub(plane.z_mm, stub.area_mm2);
        remove_outers(plane, &[stub.at]);
        return true;
    }
    if let Some(group) = one_two_one(here, &links[k - 1], &links[k + 1]) {
        bridge(plane, here, &group, pixel_area_mm2, warnings);
        return true;
    }
    let doubtful = here
        .iter()
        .find(|o| plane.loops[o.at].origin == Origin::Image && two_one_two(o, &links[k - 1], &links[k + 1]));
    doubtful.is_some_and(|o| split(plane, o, pixel_area_mm2, warnings))
}

/// Hangs on one side on a contour that also goes on elsewhere, and ends at once on the other.
fn is_stub(o: &Outer, lower: &[Outer], upper: &[Outer]) -> bool {
    match (o.below.as_slice(), o.above.as_slice()) {
        ([], above) => above.iter().any(|&a| upper[a].below.len() > 1),
        (below, []) => below.iter().any(|&b| lower[b].above.len() > 1),
        _ => false,
    }
}

/// Contours of this plane that share their only neighbour below and their only one above.
fn one_two_one(here: &[Outer], lower: &[Outer], upper: &[Outer]) -> Option<Vec<usize>> {
    let same = |a: &Outer, b: &Outer| a.below == b.below && a.above == b.above;
    let alone = |o: &Outer| o.below.len() == 1 && o.above.len() == 1;
    let group_of = |o: &Outer| (0..here.len()).filter(|&i| same(o, &here[i])).collect::<Vec<usize>>();
    let closed = |group: &Vec<usize>| {
        let first = &here[group[0]];
        group.len() > 1
            && lower[first.below[0]].above.len() == group.len()
            && upper[first.above[0]].below.len() == group.len()
    };
    here.iter().filter(|o| alone(o)).map(group_of).find(closed)
}

/// Two come in from below and go on above, each for itself, but are one in this plane.
fn two_one_two(o: &Outer, lower: &[Outer], upper: &[Outer]) -> bool {
    if o.below.len() < 2 || o.below.len() != o.above.len() {
        return false;
    }
    let partners = |b: usize| o.above.iter().filter(|&&a| overlap(&lower[b], &upper[a])).count();
    let partners_above = |a: usize| o.below.iter().filter(|&&b| overlap(&lower[b], &upper[a])).count();
    o.below.iter().all(|&b| partners(b) == 1) && o.above.iter().all(|&a| partners_above(a) == 1)
}

fn bridge(
    plane: &mut Plane,
    here: &[Outer],
    group: &[usize],
    pixel_mm2: f64,
    warnings: &mut SectionWarnings,
) {
    let step_mm = 0.25 * pixel_mm2.sqrt();
    let all = Region::union_all(group.iter().map(|&i| &here[i].region));
    let smallest = group.iter().map(|&i| here[i].area_mm2).fold(f64::INFINITY, f64::min);
    let most_mm = (smallest / std::f64::consts::PI).sqrt();
    let distances = (1..).map(|s| f64::from(s) * step_mm).take_while(|&d| d <= most_mm);
    let closed = |d: f64| {
        let joined = all.offset(d, 0.1 * step_mm).offset(-d, 0.1 * step_mm).union(&all);
        (joined.contours.iter().filter(|c| c.is_ccw()).count() == 1).then_some(joined)
    };
    // A quarter pixel more than just enough, so that the neck is more than a thread.
    let joined = distances.map(|d| d + step_mm).find_map(closed);
    let members: Vec<usize> = group.iter().map(|&i| here[i].at).collect();
    match joined.and_then(|r| r.contours.into_iter().find(Contour::is_ccw)) {
        Some(contour) => {
            warnings.bridged(plane.z_mm, group.len());
            replace(plane, &members, vec![contour]);
        }
        None => {
            let largest = group.iter().max_by(|&&a, &&b| here[a].area_mm2.total_cmp(&here[b].area_mm2));
            let rest: Vec<usize> =
                members.into_iter().filter(|&m| largest.is_none_or(|&l| here[l].at != m)).collect();
            warnings.unbridged(plane.z_mm, rest.len());
            remove_outers(plane, &rest);
        }
    }
}

/// Parts the contour at its neck; false where that cannot be done (it is then left alone and reported).
fn split(plane: &mut Plane, o: &Outer, pixel_mm2: f64, warnings: &mut SectionWarnings) -> bool {
    let n_wanted = o.below.len();
    let step_mm = 0.25 * pixel_mm2.sqrt();
    let most_mm = (o.area_mm2 / std::f64::consts::PI).sqrt();
    let least_mm2 = LEAST_AREA_PIXELS * pixel_mm2;
    let parted = |d: f64| {
        let cores = o.region.offset(-d, 0.1 * step_mm).contours;
        let parts = (cores.len() == n_wanted).then(|| cut(&o.region, &cores, 2.0 * d + step_mm, step_mm))?;
        let large = parts.iter().filter(|c| c.signed_area_mm2() >= least_mm2).count();
        (parts.len() == n_wanted && large == n_wanted).then_some(parts)
    };
    let mut distances = (1..).map(|s| f64::from(s) * step_mm).take_while(|&d| d <= most_mm);
    match distances.find_map(parted) {
        Some(parts) => {
            warnings.split(plane.z_mm, n_wanted);
            replace(plane, &[o.at], parts);
            true
        }
        None => {
            plane.loops[o.at].origin = Origin::ImageUnparted;
            warnings.unsplit(plane.z_mm, n_wanted);
            false
        }
    }
}

/// The outer contours left of a region after slits across the shortest way between any two cores.
pub(super) fn cut(region: &Region, cores: &[Contour], half_length_mm: f64, width_mm: f64) -> Vec<Contour> {
    let pairs = (0..cores.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
    let slits: Vec<Region> =
        pairs.filter_map(|(a, b)| slit(&cores[a], &cores[b], half_length_mm, width_mm)).collect();
    let rest = region.difference(&Region::union_all(&slits));
    rest.contours.into_iter().filter(Contour::is_ccw).collect()
}

fn slit(a: &Contour, b: &Contour, half_length_mm: f64, width_mm: f64) -> Option<Region> {
    let index = SegmentIndex::try_new(std::slice::from_ref(b))?;
    let nearest = |&p: &Point2| (p, index.nearest(p));
    let (p, foot) =
        a.points.iter().map(nearest).min_by(|x, y| x.1.distance_mm.total_cmp(&y.1.distance_mm))?;
    // Cores further apart than a slit is long do not share a neck.
    let across = (foot.distance_mm > 0.0 && foot.distance_mm < 2.0 * half_length_mm)
        .then(|| (foot.point - p) / foot.distance_mm)?;
    let along = Vector2::new(-across.y, across.x) * half_length_mm;
    let middle = nalgebra::center(&p, &foot.point);
    let half = across * (0.5 * width_mm);
    let corners =
        vec![middle - along - half, middle - along + half, middle + along + half, middle + along - half];
    let corners = Contour::new(corners);
    Some(Region::new(vec![if corners.is_ccw() { corners } else { corners.reversed() }]))
}

/// Puts made contours in the place of others; holes stay only where they lie in one of the new ones.
fn replace(plane: &mut Plane, gone: &[usize], by: Vec<Contour>) {
    let mut at = 0;
    plane.loops.retain(|_| {
        at += 1;
        !gone.contains(&(at - 1))
    });
    plane.loops.extend(by.into_iter().map(|contour| Loop { contour, origin: Origin::Made }));
    let outers: Vec<Contour> =
        plane.loops.iter().filter(|l| !l.is_hole()).map(|l| l.contour.clone()).collect();
    plane.loops.retain(|l| !l.is_hole() || outers.iter().any(|o| o.contains(l.contour.points[0])));
}
