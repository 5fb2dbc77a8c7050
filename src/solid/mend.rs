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
//! In the same way a tube crosses itself by micrometres where a corner of its contours wanders round it from section to
//! section by more than its points are apart there: points that do not correspond overtake each other. With half the way
//! from section to section it does so no more.
//!
//! Tubes that are proved to be sound ([`meetings`]) are left as they are. What crosses still is found by `brep::check`.
//!
//! Cost: that of the proof; some thousand distances where a section is added.

use super::Error;
use super::event::{Crotch, Slab};
use super::grid::Jet;
use super::iso;
use super::skin::{End, GivenSection, Strand, Tube, Welded};
use crate::brep::{Meeting, meetings};
use crate::geom::{Contour, Point2, Point3, SegmentIndex, Vector2};
use crate::spline::PatchSurface;
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Times that intervals are halved: a neck's last interval then is as short as those beside it.
const ROUNDS: usize = 7;
/// Least distances of points, as fractions of the way round, that are tried one after the other where halving does not help.
pub(super) const COARSER: [f64; 2] = [1.0 / 512.0, 1.0 / 256.0];
/// Steps of the grid of an added section to its size.
const STEPS: f64 = 160.0;

/// Strands with their tubes, through as many further sections as they cross neither themselves nor each other between
/// them with, or as can be told; joined by `weld`. Where that does not help, `loft` is asked for points that are farther apart
/// than the fractions `coarser` of the way round: a notch that retreats fast parts points that are close in it. What crosses
/// in the fewest places is kept, the first of several.
///
/// # Errors
/// Those of `loft`.
pub(super) fn mended(
    lofted: Vec<(Strand, Tube)>,
    coarser: &[f64],
    loft: impl Fn(&Strand, f64) -> Result<Tube, Error> + Sync,
    weld: impl Fn(Vec<Tube>) -> Welded,
) -> Result<Welded, Error> {
    let first = Attempt::of(lofted, &weld);
    if first.meetings.is_empty() {
        return Ok(first.welded);
    }
    let mut best = first.clone();
    for least in std::iter::once(0.0).chain(coarser.iter().copied()) {
        let mut now = first.clone();
        if least > 0.0 {
            let again = best.meeting().into_iter().map(|meets| meets.then(Vec::new)).collect();
            now = now.changed(again, least, &loft, &weld)?;
        }
        for _ in 0..ROUNDS {
            if now.meetings.len() < best.meetings.len() {
                best = now.clone();
            }
            let further = now.further();
            if further.iter().all(Option::is_none) {
                break;
            }
            now = now.changed(further, least, &loft, &weld)?;
        }
        if now.meetings.len() < best.meetings.len() {
            best = now;
        }
        if best.meetings.is_empty() {
            break;
        }
    }
    Ok(best.welded)
}

/// Tubes through strands, joined, and where they cross.
#[derive(Clone)]
struct Attempt {
    lofted: Vec<(Strand, Tube)>,
    welded: Welded,
    meetings: Vec<Meeting>,
}

impl Attempt {
    fn of(lofted: Vec<(Strand, Tube)>, weld: &impl Fn(Vec<Tube>) -> Welded) -> Self {
        let welded = weld(lofted.iter().map(|(_, tube)| tube.clone()).collect());
        let mut attempt = Self { lofted, welded, meetings: Vec::new() };
        attempt.meetings = attempt.found(&vec![true; attempt.lofted.len()]);
        attempt
    }

    /// Where tubes cross one of these, or one of these itself.
    fn found(&self, is_asked: &[bool]) -> Vec<Meeting> {
        let surfaces: Vec<PatchSurface> =
            self.welded.tubes.par_iter().map(|tube| tube.surface.clamped()).collect();
        meetings(&surfaces, is_asked, |pair| apexes(pair.map(|k| &self.welded.tubes[k]), &self.welded.slabs))
    }

    /// Which strands cross.
    fn meeting(&self) -> Vec<bool> {
        (0..self.lofted.len()).map(|k| self.meetings.iter().any(|(pair, _)| pair.contains(&k))).collect()
    }

    /// The same with further sections of some strands, which are lofted anew.
    fn changed(
        mut self,
        further: Vec<Option<Vec<GivenSection>>>,
        least: f64,
        loft: &(impl Fn(&Strand, f64) -> Result<Tube, Error> + Sync),
        weld: &impl Fn(Vec<Tube>) -> Welded,
    ) -> Result<Self, Error> {
        let is_new: Vec<bool> = further.iter().map(Option::is_some).collect();
        let denser = |((mut strand, tube), further): ((Strand, Tube), Option<Vec<GivenSection>>)| {
            let Some(further) = further else { return Ok((strand, tube)) };
            strand.sections.extend(further);
            strand.sections.sort_by(|a, b| a.0.total_cmp(&b.0));
            loft(&strand, least).map(|tube| (strand, tube))
        };
        let all: Vec<Result<_, _>> = self.lofted.into_par_iter().zip(further).map(denser).collect();
        self.lofted = all.into_iter().collect::<Result<_, _>>()?;
        self.welded = weld(self.lofted.iter().map(|(_, tube)| tube.clone()).collect());
        self.meetings.retain(|(pair, _)| pair.iter().all(|&k| !is_new[k]));
        self.meetings.extend(self.found(&is_new));
        Ok(self)
    }

    /// For each strand that crosses, sections in the middle of the intervals in which it does, if there are any.
    fn further(&self) -> Vec<Option<Vec<GivenSection>>> {
        let mut found = vec![BTreeSet::new(); self.lofted.len()];
        for &(pair, z_mm) in &self.meetings {
            for k in pair {
                let sections = &self.lofted[k].0.sections;
                let above = sections.partition_point(|section| section.0 <= z_mm);
                found[k].insert(above.clamp(1, sections.len() - 1) - 1);
            }
        }
        let halved = |(sections, (strand, _)): (BTreeSet<usize>, &(Strand, Tube))| {
            let pairs = sections.into_iter().map(|k| [&strand.sections[k], &strand.sections[k + 1]]);
            let added: Vec<GivenSection> = pairs.filter_map(|[low, high]| halfway(low, high)).collect();
            (!added.is_empty()).then_some(added)
        };
        found.into_par_iter().zip(&self.lofted).map(halved).collect()
    }
}

/// The apexes of creases in which two tubes touch.
fn apexes([first, second]: [&Tube; 2], slabs: &[Slab]) -> Vec<Point3> {
    let creases = |tube: &Tube| {
        let of_end = |end: End| match end {
            End::Daughter { slab, .. } if slabs[slab].crotch == Crotch::Crease => Some(slab),
            _ => None,
        };
        [tube.bottom, tube.top].map(of_end)
    };
    let others = creases(second);
    let common = creases(first).into_iter().flatten().filter(|slab| others.contains(&Some(*slab)));
    let apex = |slab: usize| {
        let lateral = &slabs[slab].laterals[0];
        lateral.at(lateral.u_range()[0], lateral.v_range()[1])
    };
    common.map(apex).collect()
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
    use super::super::skin::{Correspondence, skin};
    use super::*;
    use crate::topology::meet;

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
