//! Sections added where a tube crosses itself or another one between two of its sections.
//!
//! A tube joins points at the same share of their contours' lengths by a spline. Where two neighbouring contours have
//! little in common (a neck has just closed, a steep branch just come out of the trunk), points that do not correspond are
//! joined, and the curves between the two may cross themselves; and a spline may run off in a long interval behind short
//! ones, into another tube. The zero of the signed distances, interpolated linearly between the two contours, knows no
//! correspondence and lies between them: where it is one contour it is added as a section half-way, until no interval is
//! crossed any more. Sections half-way between disjoint ones are disjoint: in no point is the sum of the distances to
//! two disjoint regions negative, and so neither is the mean of two such sums.
//!
//! Tubes that are sound are left as they are. What crosses still is found by `brep::check`.
//!
//! Cost: three curves of each interval, and of each that it overlaps seen along z; some thousand distances where a section
//! is added.

use super::Error;
use super::grid::Jet;
use super::iso;
use super::skin::{GivenSection, Strand, Tube};
use crate::geom::{Bounds2, Contour, Point2, SegmentIndex, Vector2};
use crate::spline::TubeSurface;
use crate::topology::{meet, meets_itself};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Shares of an interval at which it is looked at.
const SHARES: [f64; 3] = [0.5, 0.25, 0.75];
/// Times that intervals are halved: a neck's last interval then is as short as those beside it.
const ROUNDS: usize = 7;
/// Points of a section at which it is looked at first, about: chords may meet where the curves do not.
const POINTS: usize = 256;
/// How far a tube may leave the box around two sections between them, over its size.
const MARGIN: f64 = 0.1;
/// Steps of the grid of an added section to its size.
const STEPS: f64 = 160.0;

/// Strands with their tubes, through as many further sections as they cross neither themselves nor each other between
/// them with, or as can be told.
///
/// # Errors
/// Those of `loft`.
pub(super) fn mended(
    mut lofted: Vec<(Strand, Tube)>,
    loft: impl Fn(&Strand) -> Result<Tube, Error> + Sync,
) -> Result<Vec<Tube>, Error> {
    for _ in 0..ROUNDS {
        let further = further(&lofted);
        if further.iter().all(Vec::is_empty) {
            break;
        }
        let denser = |((mut strand, tube), further): ((Strand, Tube), Vec<GivenSection>)| {
            if further.is_empty() {
                return Ok((strand, tube));
            }
            strand.sections.extend(further);
            strand.sections.sort_by(|a, b| a.0.total_cmp(&b.0));
            loft(&strand).map(|tube| (strand, tube))
        };
        let all: Vec<Result<_, _>> = lofted.into_par_iter().zip(further).map(denser).collect();
        lofted = all.into_iter().collect::<Result<_, _>>()?;
    }
    Ok(lofted.into_iter().map(|(_, tube)| tube).collect())
}

/// For each strand, sections in the middle of the intervals in which its tube crosses itself or another one.
fn further(lofted: &[(Strand, Tube)]) -> Vec<Vec<GivenSection>> {
    let all = Stacked::new((0..lofted.len()).flat_map(|k| Interval::of(lofted, k)), |i| i.z_mm);
    let crossed: Vec<Vec<[usize; 2]>> = all.items.par_iter().map(|i| i.crossed(&all)).collect();
    let mut found = vec![BTreeSet::new(); lofted.len()];
    for [strand, section] in crossed.into_iter().flatten() {
        found[strand].insert(section);
    }
    let halved = |(sections, (strand, _)): (BTreeSet<usize>, &(Strand, Tube))| -> Vec<GivenSection> {
        let pairs = sections.into_iter().map(|k| [&strand.sections[k], &strand.sections[k + 1]]);
        pairs.filter_map(|[low, high]| halfway(low, high)).collect()
    };
    found.into_par_iter().zip(lofted).map(halved).collect()
}

/// Things between two heights each, found by a height.
struct Stacked<T> {
    /// By their lower heights.
    items: Vec<T>,
    z_mm: Vec<[f64; 2]>,
    /// For each the greatest upper height of all up to it.
    highest_mm: Vec<f64>,
}

impl<T> Stacked<T> {
    fn new(items: impl Iterator<Item = T>, z_mm: impl Fn(&T) -> [f64; 2]) -> Self {
        let mut items: Vec<T> = items.collect();
        items.sort_by(|a, b| z_mm(a)[0].total_cmp(&z_mm(b)[0]));
        let z_mm: Vec<[f64; 2]> = items.iter().map(z_mm).collect();
        let mut highest_mm: Vec<f64> = z_mm.iter().map(|z| z[1]).collect();
        (1..highest_mm.len()).for_each(|i| highest_mm[i] = highest_mm[i].max(highest_mm[i - 1]));
        Self { items, z_mm, highest_mm }
    }

    /// Those that a height lies in or at the end of.
    fn at(&self, height_mm: f64) -> impl Iterator<Item = &T> {
        let n = self.z_mm.partition_point(|z| z[0] <= height_mm);
        let near = (0..n).rev().take_while(move |&i| self.highest_mm[i] >= height_mm);
        near.filter(move |&i| self.z_mm[i][1] >= height_mm).map(|i| &self.items[i])
    }
}

/// A tube between two of its sections.
struct Interval<'a> {
    surface: &'a TubeSurface,
    strand: usize,
    /// The lower one of its sections.
    section: usize,
    z_mm: [f64; 2],
    bounds: Bounds2,
}

impl<'a> Interval<'a> {
    fn of(lofted: &'a [(Strand, Tube)], strand: usize) -> impl Iterator<Item = Self> {
        let (Strand { sections, .. }, Tube { surface, .. }) = &lofted[strand];
        sections.windows(2).enumerate().filter_map(move |(section, pair)| {
            let bounds = pair[0].1.bounds()?.union(pair[1].1.bounds()?);
            let bounds = bounds.grown(MARGIN * bounds.size().amax());
            Some(Self { surface, strand, section, z_mm: [pair[0].0, pair[1].0], bounds })
        })
    }

    /// The section at a height: some of its points, or all that the tube has there.
    fn outline(&self, z_mm: f64, most_points: usize) -> Contour {
        let points = self.surface.section(z_mm).points();
        let stride = (points.len() / most_points).max(1);
        Contour::new(points.into_iter().step_by(stride).collect())
    }

    fn crosses_itself(&self, z_mm: f64) -> bool {
        [POINTS, usize::MAX].into_iter().all(|n| meets_itself(&self.outline(z_mm, n)))
    }

    fn crosses(&self, other: &Self, z_mm: f64) -> bool {
        let apart = |n: usize| !meet(&self.outline(z_mm, n), &other.outline(z_mm, n));
        ![POINTS, usize::MAX].into_iter().any(apart)
    }

    /// Strand and section of the intervals that cross at the heights at which this one is looked at; itself, if it
    /// crosses itself.
    fn crossed(&self, all: &Stacked<Self>) -> Vec<[usize; 2]> {
        let [low, high] = self.z_mm;
        let mut found = Vec::new();
        for z_mm in SHARES.map(|share| low + share * (high - low)) {
            if self.crosses_itself(z_mm) {
                found.push([self.strand, self.section]);
            }
            let beside = all.at(z_mm).filter(|other| self.is_beside(other));
            for other in beside.filter(|other| self.crosses(other, z_mm)) {
                found.extend([[self.strand, self.section], [other.strand, other.section]]);
            }
        }
        found
    }

    fn is_beside(&self, other: &Self) -> bool {
        let (a, b) = (self.bounds, other.bounds);
        let apart = a.min.x > b.max.x || b.min.x > a.max.x || a.min.y > b.max.y || b.min.y > a.max.y;
        self.strand != other.strand && !apart
    }
}

/// The zero of the mean of two contours' signed distances; `None` where it is not one contour.
fn halfway((low_z, low): &GivenSection, (high_z, high): &GivenSection) -> Option<GivenSection> {
    // Those of a hole run clockwise: seen from outside, it is negative inside like any other.
    let is_hole = !low.is_ccw();
    let around = |c: &Contour| if is_hole { c.reversed() } else { c.clone() };
    let indices = [low, high].map(|c| SegmentIndex::try_new(std::slice::from_ref(&around(c))));
    let [Some(below), Some(above)] = &indices else { return None };
    let value = |p: Point2| 0.5 * (below.signed_distance_mm(p) + above.signed_distance_mm(p));
    let bounds = low.bounds()?.union(high.bounds()?);
    let step_mm = (bounds.max - bounds.min).amax() / STEPS;
    let field = |p: Point2| {
        let h = 1e-3 * step_mm;
        let along = |d: Vector2| (value(p + d) - value(p - d)) / (2.0 * h);
        let slope = Vector2::new(along(Vector2::new(h, 0.0)), along(Vector2::new(0.0, h)));
        Jet { value: value(p), slope }
    };
    let found = iso::contours(&field, bounds.grown(4.0 * step_mm), step_mm);
    let [contour] = <[Contour; 1]>::try_from(found).ok()?;
    contour.is_ccw().then(|| (0.5 * (low_z + high_z), around(&contour)))
}

#[cfg(test)]
mod tests {
    use super::super::skin::{Correspondence, End, skin};
    use super::*;

    #[test]
    fn the_section_half_way_between_two_disks_lies_between_them() {
        let disk = |x: f64, r: f64| Contour::circle(Point2::new(x, 0.0), r, 128);
        let (z_mm, middle) = halfway(&(1.0, disk(0.0, 2.0)), &(2.0, disk(0.0, 3.0))).expect("a ring between");
        assert!((z_mm - 1.5).abs() < 1e-12);
        assert!(middle.points.iter().all(|p| (p.coords.norm() - 2.5).abs() < 2e-3));
        let hole = |r: f64| disk(0.0, r).reversed();
        let (_, middle) = halfway(&(1.0, hole(2.0)), &(2.0, hole(3.0))).expect("a hole between");
        assert!(
            !middle.is_ccw() && (middle.signed_area_mm2() + 2.5 * 2.5 * std::f64::consts::PI).abs() < 0.05
        );
        assert!(halfway(&(0.0, disk(0.0, 1.0)), &(1.0, disk(9.0, 1.0))).is_none(), "nothing lies between");
    }

    #[test]
    fn what_a_height_lies_in_is_found_and_nothing_else() {
        let ranges: [[f64; 2]; 6] = [[4.0, 5.0], [0.0, 1.0], [1.0, 2.0], [0.5, 9.0], [2.0, 3.0], [0.2, 0.4]];
        let stacked = Stacked::new(ranges.into_iter(), |r| *r);
        for k in -2..=20 {
            let height = 0.5 * f64::from(k);
            let mut found: Vec<[f64; 2]> = stacked.at(height).copied().collect();
            let mut expected: Vec<[f64; 2]> =
                ranges.into_iter().filter(|r| r[0] <= height && height <= r[1]).collect();
            [&mut found, &mut expected].into_iter().for_each(|all| all.sort_by(|a, b| a[0].total_cmp(&b[0])));
            assert_eq!(found, expected, "{height}");
        }
    }

    #[test]
    fn tubes_that_run_towards_each_other_and_stop_are_kept_apart() {
        // Disks that approach each other on near planes and lie apart again on a far one: the splines would run on.
        let strand = |side: f64| {
            let at = |(z_mm, x): (f64, f64)| (z_mm, Contour::circle(Point2::new(side * x, 0.0), 1.0, 128));
            let sections = [(0.0, 1.30), (0.1, 1.21), (0.2, 1.12), (0.3, 1.04), (4.0, 1.5)].map(at).to_vec();
            Strand { sections, bottom: End::Cap, top: End::Cap }
        };
        let skin = skin(vec![strand(1.0), strand(-1.0)], Vec::new(), &[], Correspondence::default(), false);
        let tubes = skin.expect("sound sections").tubes;
        for k in 0..400 {
            let z_mm = 0.01 * f64::from(k);
            let [a, b] = [0, 1].map(|t: usize| Contour::new(tubes[t].surface.section(z_mm).points()));
            assert!(!meet(&a, &b), "{z_mm}");
        }
    }
}
