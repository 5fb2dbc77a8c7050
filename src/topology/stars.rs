//! From linked components to linked contours.
//!
//! A contour is the border between a component of lumen and one of what is not lumen. Two contours of neighbouring
//! planes continue each other where both of their sides do. That one rule gives tubes, splits and merges (lumen
//! parts, the outside is one), holes that go on (both go on), and holes that open: the hole of one plane and the
//! outside of the next are one, so that the C-shaped contour there continues in the ring's outer contour and in its
//! hole. Contours without a partner begin or end.

use super::check::Sheet;
use super::link::{Cause, Forced, Layers, Pair, link};
use crate::geom::{Contour, Region};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A hole opens where at least this share of it lies outside the next plane's lumen.
const OPENS: f64 = 0.15;
const OPENS_SLIVER: f64 = 0.03;
/// A hole that goes on as a hole opens besides only if this much of it comes to lie outside.
const OPENS_BESIDES: f64 = 0.5;

/// Two contours that continue each other, or that were kept apart: outlines of the lower and the upper sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Joint {
    pub(super) lower: usize,
    pub(super) upper: usize,
    pub(super) overlap: f64,
    pub(super) drifted: Option<f64>,
    pub(super) cause: Cause,
    pub(super) joined: bool,
    pub(super) doubt: Option<&'static str>,
}

/// Contours that hang together across an interval; sorted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Cluster {
    pub(super) lower: Vec<usize>,
    pub(super) upper: Vec<usize>,
}

/// All joints, interval by interval. `forced`: (interval, lower outline, upper outline).
pub(super) fn joints(sheets: &[Sheet], forced: &Forced) -> Vec<Vec<Joint>> {
    let (mut materials, mut gaps, mut openings) = (Forced::new(), Forced::new(), Forced::new());
    for (&(k, lower, upper), &join) in forced {
        let (a, b) = (&sheets[k].outlines[lower], &sheets[k + 1].outlines[upper]);
        match (a.gap, b.gap) {
            _ if a.contour.is_ccw() && b.contour.is_ccw() => {
                materials.insert((k, a.material, b.material), join)
            }
            (Some(g), Some(h)) => gaps.insert((k, g, h), join),
            _ => openings.insert((k, lower, upper), join),
        };
    }
    let z_mm: Vec<f64> = sheets.iter().map(|s| s.z_mm).collect();
    let of_materials = Layers {
        z_mm: z_mm.clone(),
        components: sheets.iter().map(|s| &s.materials[..]).collect(),
        forced: materials,
    };
    let of_gaps = Layers { z_mm, components: sheets.iter().map(|s| &s.gaps[..]).collect(), forced: gaps };
    let (materials, gaps) = (link(&of_materials), link(&of_gaps));
    (0..sheets.len().saturating_sub(1))
        .into_par_iter()
        .map(|k| {
            let interval = Interval {
                lower: &sheets[k],
                upper: &sheets[k + 1],
                materials: &materials[k],
                gaps: &gaps[k],
            };
            let mut found = interval.joints();
            for (&(_, lower, upper), &joined) in openings.range((k, 0, 0)..=(k, usize::MAX, usize::MAX)) {
                found.retain(|j| (j.lower, j.upper) != (lower, upper));
                let (overlap, drifted, cause, doubt) = (0.0, None, Cause::Operator, None);
                found.push(Joint { lower, upper, overlap, drifted, cause, joined, doubt });
            }
            found.sort_by_key(|j| (j.lower, j.upper));
            found
        })
        .collect()
}

/// The joints between two sheets that are known to be near each other, by overlap alone.
pub(super) fn joints_of_two(lower: &Sheet, upper: &Sheet) -> Vec<Joint> {
    let two = |kind: fn(&Sheet) -> &[super::overlap::Component]| Layers {
        z_mm: vec![lower.z_mm, upper.z_mm],
        components: vec![kind(lower), kind(upper)],
        forced: Forced::new(),
    };
    let materials = link(&two(|s| &s.materials)).pop().unwrap_or_default();
    let gaps = link(&two(|s| &s.gaps)).pop().unwrap_or_default();
    Interval { lower, upper, materials: &materials, gaps: &gaps }.joints()
}

struct Interval<'a> {
    lower: &'a Sheet,
    upper: &'a Sheet,
    materials: &'a [Pair],
    gaps: &'a [Pair],
}

impl Interval<'_> {
    fn joints(&self) -> Vec<Joint> {
        let from_below =
            opened(self.lower, self.upper, |h| self.gaps.iter().any(|p| p.joined && p.lower == h));
        let from_above =
            opened(self.upper, self.lower, |h| self.gaps.iter().any(|p| p.joined && p.upper == h));
        let mut found = Vec::new();
        for material in self.materials {
            let of = |sheet: &Sheet, m: usize| -> Vec<usize> {
                (0..sheet.outlines.len()).filter(|&c| sheet.outlines[c].material == m).collect()
            };
            for &lower in &of(self.lower, material.lower) {
                for &upper in &of(self.upper, material.upper) {
                    let gaps = (self.lower.outlines[lower].gap, self.upper.outlines[upper].gap);
                    let joint = |p: &Pair, joined: bool, cause: Cause| Joint {
                        lower,
                        upper,
                        overlap: p.overlap,
                        drifted: p.drifted,
                        cause,
                        joined,
                        doubt: p.doubt.or(material.doubt),
                    };
                    let is_outer = |sheet: &Sheet, c: usize| sheet.outlines[c].contour.is_ccw();
                    let both_outer = is_outer(self.lower, lower) && is_outer(self.upper, upper);
                    let gap = match gaps {
                        (None, None) => {
                            found.push(joint(material, material.joined, material.cause));
                            continue;
                        }
                        (Some(g), Some(h)) => self.gaps.iter().find(|p| (p.lower, p.upper) == (g, h)),
                        (Some(g), None) => from_below.get(&g),
                        (None, Some(h)) => from_above.get(&h),
                    };
                    if let Some(gap) = gap {
                        let said = if both_outer { material } else { gap };
                        found.push(joint(said, gap.joined && material.joined, said.cause));
                    }
                }
            }
        }
        found
    }
}

/// Which holes of one sheet open to the outside of the other.
fn opened(holed: &Sheet, other: &Sheet, goes_on: impl Fn(usize) -> bool) -> BTreeMap<usize, Pair> {
    if holed.gaps.is_empty() {
        return BTreeMap::new();
    }
    let outer = other.outlines.iter().filter(|o| o.gap.is_none()).map(|o| o.contour.clone());
    let filled = Region::new(outer.collect::<Vec<Contour>>());
    let judged = |(hole, component): (usize, &super::overlap::Component)| {
        let share = component.share_outside(crate::geom::Vector2::zeros(), &filled);
        let joined = if goes_on(hole) { share >= OPENS_BESIDES } else { share >= OPENS };
        let pair = Pair {
            lower: hole,
            upper: hole,
            overlap: share,
            drifted: None,
            cause: if joined { Cause::Opens } else { Cause::Sliver },
            joined,
            doubt: None,
        };
        (share >= OPENS_SLIVER).then_some((hole, pair))
    };
    holed.gaps.iter().enumerate().filter_map(judged).collect()
}

/// The contours that joints tie together; contours without a joint are in none.
pub(super) fn clusters(joints: &[Joint], n_lower: usize, n_upper: usize) -> Vec<Cluster> {
    let mut root: Vec<usize> = (0..n_lower + n_upper).collect();
    fn find(root: &mut [usize], mut at: usize) -> usize {
        while root[at] != at {
            root[at] = root[root[at]];
            at = root[at];
        }
        at
    }
    let mut tied = vec![false; root.len()];
    for joint in joints.iter().filter(|j| j.joined) {
        let (a, b) = (find(&mut root, joint.lower), find(&mut root, n_lower + joint.upper));
        root[a.max(b)] = a.min(b);
        tied[joint.lower] = true;
        tied[n_lower + joint.upper] = true;
    }
    let mut found: BTreeMap<usize, Cluster> = BTreeMap::new();
    for at in (0..root.len()).filter(|&at| tied[at]) {
        let cluster = found.entry(find(&mut root, at)).or_default();
        if at < n_lower { cluster.lower.push(at) } else { cluster.upper.push(at - n_lower) }
    }
    found.into_values().collect()
}
