//! What belongs together over the planes: small fragments, islands, pinholes and one-plane flicker are resolved
//! here, so that the number of contours changes between planes only by true splits, merges, births and deaths.
//!
//! The rules, in this order, until none of them applies any more; every change is reported with its plane's z:
//! 1. An outer contour of less than [`LEAST_AREA_PIXELS`] pixels is dropped, a hole of less is filled.
//! 2. A hole is kept only if holes overlap it through at least [`LEAST_HOLE_PLANES`] planes in a row; a hole
//!    goes with its outer contour.
//! 3. An island, which overlaps nothing in the planes below and above, is dropped.
//! 4. A stub, which hangs on a contour of one neighbouring plane beside a sibling, but meets nothing in the other
//!    neighbouring plane, is dropped, the smallest first, as long as a sibling stays: a branch must be seen in two planes.
//! 5. One-two-one: contours that all overlap the same single contour below and the same one above are bridged
//!    (closing by the least distance that joins them); where that would take more than their own radius, all
//!    but the largest are dropped.
//! 6. Two-one-two: a contour that overlaps two below and two above, of which each overlaps just one of the
//!    others, is split by a slit of a quarter pixel across its neck (the neck is where it parts when shrunk by
//!    the least distance that parts it); where no shrinking parts it, it stays and is reported.
//!
//! What the operator has drawn stands: it counts for its neighbours, and none of the rules changes it.
//!
//! That ends: rule 6 makes a contour of the image one that was made or left unparted, and nothing makes contours of the image;
//! all other rules leave fewer contours. Cost: overlaps are found once, and again beside the planes that changed.

use super::extract::Error;
use super::warnings::SectionWarnings;
use crate::geom::{Bounds2, Contour, Point2, Region, SegmentIndex, Vector2};

/// Fewer pixels than this are noise.
pub(super) const LEAST_AREA_PIXELS: f64 = 4.0;
/// A hole that lasts fewer planes is noise or a passing artefact.
const LEAST_HOLE_PLANES: usize = 3;
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
    /// The operator's hand: no rule changes it, and it is fitted to nothing.
    Drawn,
}

impl Origin {
    /// Whether the image shows an edge that the contour can be fitted to.
    pub(super) const fn is_image(self) -> bool {
        matches!(self, Self::Image | Self::ImageUnparted)
    }
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

impl Plane {
    /// Whether its contours are the operator's: all of a plane are, or none.
    pub(super) fn is_drawn(&self) -> bool {
        self.loops.iter().any(|l| l.origin == Origin::Drawn)
    }
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
    for plane in planes.iter_mut().filter(|p| !p.is_drawn()) {
        drop_fragments(plane, LEAST_AREA_PIXELS * pixel_area_mm2, warnings);
    }
    drop_passing_holes(planes, warnings);
    if planes.len() < 2 {
        return;
    }
    let mut links = linked(planes);
    let mut is_due = vec![true; planes.len()];
    while is_due.contains(&true) {
        let changed = walk(planes, &links, &is_due, pixel_area_mm2, warnings);
        relink(planes, &mut links, &changed);
        // What a rule says of a plane depends on its neighbours too, and on nothing else.
        is_due = (0..planes.len()).map(|k| changed.iter().any(|&c| c.abs_diff(k) <= 1)).collect();
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

/// One walk through the planes that are due; those that changed.
fn walk(
    planes: &mut [Plane],
    links: &[Vec<Outer>],
    is_due: &[bool],
    pixel_area_mm2: f64,
    warnings: &mut SectionWarnings,
) -> Vec<usize> {
    let mut changed: Vec<usize> = Vec::new();
    for k in (0..planes.len()).filter(|&k| is_due[k]) {
        // Links to a plane that has just changed are out of date: its neighbour waits for the next walk.
        let waits = changed.last().is_some_and(|&c| c + 1 == k);
        if !waits && !planes[k].is_drawn() && resolve_plane(planes, links, k, pixel_area_mm2, warnings) {
            changed.push(k);
        }
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
    let is_pinhole = |l: &Loop| l.is_hole() && small(l);
    let n_pinholes = plane.loops.iter().filter(|l| is_pinhole(l)).count();
    if n_pinholes > 0 {
        warnings.pinholes(plane.z_mm, n_pinholes);
    }
    plane.loops.retain(|l| !is_pinhole(l));
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
    for (k, plane) in planes.iter_mut().enumerate().filter(|(_, p)| !p.is_drawn()) {
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
    (1..outers.len()).for_each(|k| link(&mut outers, k));
    outers
}

/// Finds the links between plane k and the one below it.
fn link(outers: &mut [Vec<Outer>], k: usize) {
    let (lower, upper) = outers.split_at_mut(k);
    let (lower, upper) = (&mut lower[k - 1], &mut upper[0]);
    lower.iter_mut().for_each(|under| under.above.clear());
    upper.iter_mut().for_each(|over| over.below.clear());
    for (b, over) in upper.iter_mut().enumerate() {
        for (a, under) in lower.iter_mut().enumerate() {
            if overlap(under, over) {
                under.above.push(b);
                over.below.push(a);
            }
        }
    }
}

/// Brings the links up to date where planes have changed, no two of them neighbours.
fn relink(planes: &[Plane], outers: &mut [Vec<Outer>], changed: &[usize]) {
    for &k in changed {
        outers[k] = prepared(&planes[k], false);
        if k > 0 {
            link(outers, k);
        }
        if k + 1 < outers.len() {
            link(outers, k + 1);
        }
    }
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
    let islands: Vec<&Outer> = here.iter().filter(|o| o.below.is_empty() && o.above.is_empty()).collect();
    if !islands.is_empty() {
        islands.iter().for_each(|o| warnings.island(plane.z_mm, o.area_mm2));
        remove_outers(plane, &places(&islands));
        return true;
    }
    if k == 0 || k + 1 == links.len() {
        return false;
    }
    let stubs = stubs(here, &links[k - 1], &links[k + 1]);
    if !stubs.is_empty() {
        stubs.iter().for_each(|o| warnings.stub(plane.z_mm, o.area_mm2));
        remove_outers(plane, &places(&stubs));
        return true;
    }
    if let Some(group) = one_two_one(here, &links[k - 1], &links[k + 1]) {
        bridge(plane, here, &group, pixel_area_mm2, warnings);
        return true;
    }
    let is_doubtful = |o: &&Outer| {
        plane.loops[o.at].origin == Origin::Image && two_one_two(o, &links[k - 1], &links[k + 1])
    };
    let doubtful: Vec<&Outer> = here.iter().filter(is_doubtful).collect();
    doubtful.into_iter().any(|o| split(plane, o, pixel_area_mm2, warnings))
}

fn places(outers: &[&Outer]) -> Vec<usize> {
    outers.iter().map(|o| o.at).collect()
}

/// Those that hang on one side on a contour which a sibling hangs on too, and end at once on the other; the smallest first, so that
/// of several that have only each other the largest stays.
fn stubs<'a>(here: &'a [Outer], lower: &[Outer], upper: &[Outer]) -> Vec<&'a Outer> {
    // How many of this plane hang on each contour of its neighbours.
    let mut hang_on_lower: Vec<usize> = lower.iter().map(|o| o.above.len()).collect();
    let mut hang_on_upper: Vec<usize> = upper.iter().map(|o| o.below.len()).collect();
    let mut outers: Vec<&Outer> = here.iter().collect();
    outers.sort_by(|a, b| a.area_mm2.total_cmp(&b.area_mm2));
    outers.retain(|o| {
        let (on, n_hanging) = match (o.below.as_slice(), o.above.as_slice()) {
            ([], above) => (above, &mut hang_on_upper),
            (below, []) => (below, &mut hang_on_lower),
            _ => return false,
        };
        let is_stub = on.iter().any(|&n| n_hanging[n] > 1);
        if is_stub {
            on.iter().for_each(|&n| n_hanging[n] -= 1);
        }
        is_stub
    });
    outers
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn disk(x: f64, y: f64, radius: f64) -> Loop {
        let point = |n: u32| {
            let (sin, cos) = (f64::from(n) * std::f64::consts::TAU / 32.0).sin_cos();
            Point2::new(x + radius * cos, y + radius * sin)
        };
        Loop { contour: Contour::new((0..32).map(point).collect()), origin: Origin::Image }
    }

    fn hole(x: f64, y: f64, radius: f64) -> Loop {
        let disk = disk(x, y, radius);
        Loop { contour: disk.contour.reversed(), ..disk }
    }

    /// The planes after the rules, with pixels of 1 mm, and how often each kind of change was made.
    fn resolved(planes: Vec<Vec<Loop>>) -> (Vec<usize>, BTreeMap<&'static str, usize>) {
        let plane = |(k, loops): (usize, Vec<Loop>)| Plane { k, z_mm: k as f64, loops };
        let mut planes: Vec<Plane> = planes.into_iter().enumerate().map(plane).collect();
        let mut warnings = SectionWarnings::default();
        resolve(&mut planes, 1.0, &mut warnings);
        (planes.iter().map(|p| p.loops.len()).collect(), warnings.counts())
    }

    fn vessel() -> Loop {
        disk(0.0, 0.0, 8.0)
    }

    #[test]
    fn all_islands_of_neighbouring_planes_are_dropped_and_told() {
        let islands =
            |y: f64| (0..40).map(move |i| disk(f64::from(i) * 10.0, y, 3.0)).chain([vessel()]).collect();
        let (left, told) = resolved(vec![vec![vessel()], islands(50.0), islands(100.0), vec![vessel()]]);
        assert_eq!((left, told["sections.island"]), (vec![1; 4], 80));
    }

    #[test]
    fn all_twigs_of_a_plane_are_dropped_beside_what_goes_on() {
        let twig = |i: u32| {
            let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 40.0).sin_cos();
            disk(40.0 * cos, 40.0 * sin, 2.5)
        };
        let with_twigs = (0..40).map(twig).chain([vessel()]).collect();
        let broad = || vec![disk(0.0, 0.0, 60.0)];
        let (left, told) = resolved(vec![vec![vessel()], with_twigs, broad(), broad()]);
        assert_eq!((left, told["sections.stub"]), (vec![1; 4], 40));
    }

    #[test]
    fn of_stubs_that_have_only_each_other_the_largest_stays() {
        let row = (0..20).map(|i| disk(f64::from(i) * 10.0 - 95.0, 0.0, 3.0 + 0.05 * f64::from(i))).collect();
        let broad = || vec![disk(0.0, 0.0, 120.0)];
        let (left, told) = resolved(vec![Vec::new(), row, broad(), broad()]);
        assert_eq!((left, told["sections.stub"]), (vec![0, 1, 1, 1], 19));
    }

    #[test]
    fn what_was_drawn_stays_and_counts_for_its_neighbours() {
        let by_hand =
            |loops: Vec<Loop>| loops.into_iter().map(|l| Loop { origin: Origin::Drawn, ..l }).collect();
        // A fragment, an island, a hole of one plane.
        let odd = || by_hand(vec![vessel(), disk(50.0, 0.0, 1.0), disk(90.0, 0.0, 5.0), hole(2.0, 0.0, 2.0)]);
        let (left, told) = resolved(vec![vec![vessel()], odd(), vec![vessel()]]);
        assert_eq!((left, told), (vec![1, 4, 1], BTreeMap::new()));
        // Between two drawn planes a flicker is bridged; a drawn one is none.
        let two = || vec![disk(-4.0, 0.0, 3.0), disk(4.0, 0.0, 3.0)];
        let (left, told) = resolved(vec![by_hand(vec![vessel()]), two(), by_hand(vec![vessel()])]);
        assert_eq!((left, told["sections.bridged"]), (vec![1; 3], 1));
        let (left, told) = resolved(vec![vec![vessel()], by_hand(two()), vec![vessel()]]);
        assert_eq!((left, told), (vec![1, 2, 1], BTreeMap::new()));
    }

    #[test]
    fn pinholes_are_filled_and_told() {
        let holed = || vec![vessel(), hole(0.0, 0.0, 1.0), hole(4.0, 0.0, 0.9)];
        let (left, told) = resolved(vec![vec![vessel()], holed(), vec![vessel()]]);
        assert_eq!((left, told["sections.pinhole"]), (vec![1; 3], 1));
    }
}
