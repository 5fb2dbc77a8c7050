//! An event as a chain of elementary ones: the interval between its planes is swept upward along w, contours are
//! followed from height to height, and at every critical point of the field either a slab joins one contour with two
//! or a dome begins or ends a branch (Morse theory).
//!
//! Critical points at nearly one height would leave no room for their slabs: the field is then biased beside each of
//! them by a hair, so that they come to lie apart ([`super::bias`]).

use super::critical::{Critical, Kind, criticals};
use super::event::{EventFault, EventSource, Slab, contours_expected, contours_finer};
use super::lean::Leans;
use super::slab::{Bordered, build_slab, distance_from};
use super::{bias, neck, tip};
use crate::geom::{Contour, Point2, SegmentIndex};
use rayon::prelude::*;

/// Half-heights of a slab on the waist's and on the legs' side of the apex for branches of 3 mm radius, mm: thin, so
/// that the normals of the interpolated patches agree with the field's; not so thin that the saddle degenerates.
pub(super) const WAIST_SIDE_MM: f64 = 0.3;
pub(super) const LEGS_SIDE_MM: f64 = 0.15;
/// The share of the way to the next plane or critical point that a slab may take.
pub(super) const SLAB_SHARE: f64 = 0.35;
/// A slab thinner than this, mm, is rounding: its patches would have no shape.
const LEAST_SLAB_MM: f64 = 1e-3;
/// Virtual sections beyond the apex on the legs' side, mm.
const LEG_OFFSETS_MM: [f64; 6] = [0.15, 0.25, 0.45, 0.8, 1.3, 2.0];
/// Virtual sections on the way to a waist, as fractions of it.
const WAIST_FRACTIONS: [f64; 5] = [0.2, 0.4, 0.6, 0.75, 0.88];
/// Where a slab is thin, further sections beside it, at distances from the apex that grow by this factor, as far as this
/// share of the way to the next one.
const GRADING: f64 = 2.0;
const GRADED_SHARE: f64 = 0.7;
/// Heights at which critical points are looked for; the second number where the first search missed some.
const SEARCH_HEIGHTS: [usize; 2] = [13, 49];

/// An event to be built: the contours at both ends of the interval, and heights beyond it at which the field holds, too.
#[derive(Debug, Clone)]
pub(super) struct Interval<'a> {
    pub(super) w: [f64; 2],
    pub(super) lower: &'a [Contour],
    pub(super) upper: &'a [Contour],
    pub(super) below: Onward,
    pub(super) above: Onward,
    /// Radius of the branches over 3 mm: the unit of the lengths in this file.
    pub(super) unit: f64,
    /// Whether the source's w is z.
    pub(super) upward: bool,
}

/// Where the field is asked beyond an end of the interval.
#[derive(Debug, Clone, Default)]
pub(super) struct Onward {
    /// Heights of virtual sections.
    pub(super) heights: Vec<f64>,
    /// How far it holds: the next plane; `None` where none follows.
    pub(super) limit: Option<f64>,
}

impl Onward {
    /// The heights, and where an apex lies close to the end of the interval further ones next to that, all of them
    /// outward. A neck opens with the root of the distance from its apex: intervals that grow by more than a factor from
    /// there on would let the spline through the sections run off in the first long one.
    fn graded(&self, end: f64, apex: Option<f64>) -> Vec<f64> {
        let mut heights = self.heights.clone();
        if let (Some(apex), Some(limit)) = (apex, self.limit) {
            let next = heights.iter().map(|w| (w - end).abs()).fold((limit - end).abs(), f64::min);
            let onward = std::iter::successors(Some(GRADING * (end - apex)), |d| Some(GRADING * d));
            let graded = onward.map(|d| apex + d).take_while(|w| (w - end).abs() < GRADED_SHARE * next);
            heights.extend(graded);
            // Contours are followed from height to height: outward.
            heights.sort_by(|a, b| (a - end).abs().total_cmp(&(b - end).abs()));
        }
        heights
    }
}

/// A saddle point with the contours beside it.
#[derive(Debug, Clone)]
pub(super) struct Saddle {
    /// The critical point.
    pub(super) apex: Critical,
    /// 1 where the legs lie above the waist along w, else -1.
    pub(super) along: f64,
    /// Whether the field rises from the waist to the legs: a branch parts. Else an outline closes round a hole.
    pub(super) opens: bool,
    pub(super) w_waist: f64,
    pub(super) w_legs: f64,
    pub(super) waist: Contour,
    pub(super) legs: [Contour; 2],
}

/// What an event is made of. Parts are numbered; the first ones begin at the lower contours.
#[derive(Debug, Default)]
pub(super) struct Swept {
    pub(super) n_parts: usize,
    /// The part that reaches each upper contour.
    pub(super) upper: Vec<usize>,
    pub(super) joints: Vec<Joint>,
    /// Virtual sections: part, height w, contour.
    pub(super) sections: Vec<(usize, f64, Contour)>,
}

/// A slab and the parts that it joins.
#[derive(Debug)]
pub(super) struct Joint {
    pub(super) waist: usize,
    pub(super) legs: [usize; 2],
    pub(super) slab: Slab,
    /// How the parts lean at the slab.
    pub(super) leans: Leans,
}

/// What a zone between two critical points is bounded by.
#[derive(Debug, Clone, Copy)]
enum Border {
    Plane,
    /// A slab's border this far from its apex.
    Waist {
        reach: f64,
    },
    Legs {
        reach: f64,
    },
    Tip,
}

/// A critical point with the heights that its slab or dome takes.
struct Step {
    critical: Critical,
    /// How many contours there are above it.
    n_above: usize,
    /// Borders of its slab; both at the tip for a dome.
    w: [f64; 2],
    /// Contours of a dome, the one nearest to the tip last.
    dome: Vec<(f64, Contour)>,
}

/// Builds the event.
pub(super) fn sweep(source: &dyn EventSource, interval: &Interval<'_>) -> Result<Swept, EventFault> {
    let Some(frame) = source.frame() else {
        return Sweep { source, interval }.run(neck::criticals(source, interval));
    };
    let mut fault = EventFault::NoApex;
    for n_heights in SEARCH_HEIGHTS {
        let found = criticals(source, frame, interval.w, n_heights);
        let result = match bias::spread(source, frame, &found, interval) {
            None => Sweep { source, interval }.run(found),
            Some(biased) => {
                let found = criticals(&biased, frame, interval.w, n_heights);
                Sweep { source: &biased, interval }.run(found)
            }
        };
        match result {
            Ok(swept) => return Ok(swept),
            Err(error) => fault = error,
        }
    }
    // Where branches meet at an angle no smooth critical point lies between them: the neck is found by search.
    Sweep { source, interval }.run(neck::criticals(source, interval)).map_err(|_no_neck| fault)
}

struct Sweep<'a> {
    source: &'a dyn EventSource,
    interval: &'a Interval<'a>,
}

impl Sweep<'_> {
    fn run(&self, criticals: Vec<Critical>) -> Result<Swept, EventFault> {
        let steps = self.steps(criticals)?;
        let zones = self.zones(&steps);
        let (heights, counts) = self.counted(&steps, &zones);
        let contours = self.contours(&heights, &counts)?;
        let at = |w: f64| {
            heights.iter().position(|h| h.to_bits() == w.to_bits()).map_or(&[][..], |k| &contours[k])
        };
        let mut tracks = Tracks::from(self.interval.lower, self.source.frame().is_some());
        let mut saddles = Vec::new();
        for (k, step) in steps.iter().enumerate() {
            self.follow(&mut tracks, &zones[k], &steps, &at)?;
            if step.dome.is_empty() {
                saddles.push(self.pass_saddle(&mut tracks, step, &at)?);
            } else {
                tracks.pass_tip(step)?;
            }
        }
        self.follow(&mut tracks, &zones[steps.len()], &steps, &at)?;
        let w_top = self.interval.w[1];
        let upper = tracks.assigned(self.interval.upper).ok_or_else(|| self.lost(w_top))?;
        self.add_beyond(&mut tracks, &upper, &steps);
        let built: Vec<Result<Bordered, EventFault>> = saddles
            .par_iter()
            .map(|(_, _, saddle)| build_slab(self.source, saddle, self.interval.upward))
            .collect();
        let mut joints = Vec::with_capacity(saddles.len());
        for (built, (waist, legs, saddle)) in built.into_iter().zip(saddles) {
            let Bordered { slab, w: [w_waist, w_legs], waist: waist_curve, legs: leg_curves, beside, leans } =
                built?;
            tracks.replace(waist, saddle.w_waist, (w_waist, waist_curve));
            tracks.add(waist, beside.waist);
            for ((leg, curve), further) in legs.into_iter().zip(leg_curves).zip(beside.legs) {
                tracks.replace(leg, saddle.w_legs, (w_legs, curve));
                tracks.add(leg, further);
            }
            joints.push(Joint { waist, legs, slab, leans });
        }
        Ok(Swept { n_parts: tracks.n_parts, upper, joints, sections: tracks.sections })
    }

    /// The contours at these heights, as many as expected. Finer grids cost most: they are asked from the lowest height on, and
    /// where one does not show what is expected, none is asked any more.
    fn contours(&self, heights: &[f64], counts: &[Option<usize>]) -> Result<Vec<Vec<Contour>>, EventFault> {
        let mut found: Vec<Vec<Contour>> = heights.par_iter().map(|&w| self.source.contours(w)).collect();
        let is_strict = self.source.frame().is_some();
        let is_other = |&k: &usize| is_strict && counts[k].is_some_and(|n| n != found[k].len());
        let mut open: Vec<usize> = (0..heights.len()).filter(is_other).collect();
        open.sort_by(|&a, &b| heights[a].total_cmp(&heights[b]));
        for k in open {
            let is_expected = |n: usize| counts[k].is_none_or(|expected| expected == n);
            found[k] =
                contours_finer(self.source, heights[k], is_expected).ok_or_else(|| self.lost(heights[k]))?;
        }
        Ok(found)
    }

    /// The heights at which contours are looked for, and how many there are; `None` where domes begin or end beside them.
    fn counted(&self, steps: &[Step], zones: &[Vec<f64>]) -> (Vec<f64>, Vec<Option<usize>>) {
        let below = std::iter::once(self.interval.lower.len()).chain(steps.iter().map(|s| s.n_above));
        let all_saddles = steps.iter().all(|s| s.dome.is_empty());
        let count = |n: usize| all_saddles.then_some(n);
        let in_zones =
            zones.iter().zip(below.clone()).flat_map(|(zone, n)| zone.iter().map(move |w| (*w, n)));
        let saddles = steps.iter().zip(below).filter(|(step, _)| step.dome.is_empty());
        let borders = saddles.flat_map(|(step, n)| step.w.into_iter().zip([n, step.n_above]));
        in_zones.chain(borders).map(|(w, n)| (w, count(n))).unzip()
    }

    fn lost(&self, w: f64) -> EventFault {
        EventFault::Lost { z_mm: if self.interval.upward { w } else { -w } }
    }

    /// How many contours there are above each critical point, and how high its slab or dome may be.
    fn steps(&self, criticals: Vec<Critical>) -> Result<Vec<Step>, EventFault> {
        let [low, high] = self.interval.w;
        let unit = self.interval.unit;
        let w: Vec<f64> =
            std::iter::once(low).chain(criticals.iter().map(|c| c.w)).chain(std::iter::once(high)).collect();
        let mut n = self.interval.lower.len();
        let mut steps = Vec::new();
        let last = criticals.len();
        for (k, critical) in criticals.into_iter().enumerate() {
            let (room_below, room_above) = (w[k + 1] - w[k], w[k + 2] - w[k + 1]);
            let born = (critical.kind == Kind::Highest) == critical.rises;
            let n_above = if critical.kind != Kind::Saddle {
                if born { n + 1 } else { n.saturating_sub(1) }
            } else if k + 1 == last {
                self.interval.upper.len()
            } else if self.source.frame().is_none() {
                n + 1
            } else {
                contours_expected(self.source, 0.5 * (w[k + 1] + w[k + 2]), |found| found.abs_diff(n) == 1)
                    .len()
            };
            if n_above.abs_diff(n) != 1 || n_above == 0 {
                return Err(EventFault::Components { found: n_above, expected: n + 1 });
            }
            let (mut borders, mut dome) = ([critical.w; 2], Vec::new());
            if critical.kind == Kind::Saddle {
                let (below, above) =
                    if n_above > n { (WAIST_SIDE_MM, LEGS_SIDE_MM) } else { (LEGS_SIDE_MM, WAIST_SIDE_MM) };
                let below = (below * unit).min(SLAB_SHARE * room_below);
                let above = (above * unit).min(SLAB_SHARE * room_above);
                if below < LEAST_SLAB_MM || above < LEAST_SLAB_MM {
                    let outermost = last == 1;
                    return Err(if outermost { EventFault::NoApex } else { EventFault::Simultaneous });
                }
                borders = [critical.w - below, critical.w + above];
            } else {
                let room = if born { room_above } else { -room_below };
                dome = tip::from_field(self.source, &critical, room).ok_or(EventFault::NoApex)?;
            }
            n = n_above;
            steps.push(Step { critical, n_above, w: borders, dome });
        }
        if n != self.interval.upper.len() {
            return Err(EventFault::NoApex);
        }
        Ok(steps)
    }

    /// Heights of the virtual sections below, between and above the critical points.
    fn zones(&self, steps: &[Step]) -> Vec<Vec<f64>> {
        let [low, high] = self.interval.w;
        let mut n = self.interval.lower.len();
        let mut from = (low, Border::Plane);
        let mut zones = Vec::new();
        for step in steps {
            let splits = step.n_above > n;
            n = step.n_above;
            let apex = step.critical.w;
            let (below, above) = if !step.dome.is_empty() {
                (Border::Tip, Border::Tip)
            } else if splits {
                (Border::Waist { reach: apex - step.w[0] }, Border::Legs { reach: step.w[1] - apex })
            } else {
                (Border::Legs { reach: apex - step.w[0] }, Border::Waist { reach: step.w[1] - apex })
            };
            zones.push(self.heights(from, (step.w[0], below)));
            from = (step.w[1], above);
        }
        zones.push(self.heights(from, (high, Border::Plane)));
        zones
    }

    fn heights(&self, (a, below): (f64, Border), (b, above): (f64, Border)) -> Vec<f64> {
        let unit = self.interval.unit;
        let length = b - a;
        // Distances from each border into the zone.
        let into = |border: Border, is_enough: bool| -> Vec<f64> {
            let mut offsets: Vec<f64> = match border {
                Border::Legs { reach } => LEG_OFFSETS_MM.map(|o| o * unit - reach).to_vec(),
                Border::Waist { .. } if is_enough => Vec::new(),
                Border::Waist { .. } => WAIST_FRACTIONS.map(|f| length - f * length).to_vec(),
                Border::Plane | Border::Tip => Vec::new(),
            };
            if let Border::Waist { reach } | Border::Legs { reach } = border {
                let next = offsets.iter().copied().filter(|o| *o > 0.0).fold(length, f64::min);
                let graded = std::iter::successors(Some(reach), |o| Some(GRADING * (o + reach) - reach));
                offsets.extend(graded.take_while(|o| *o < GRADED_SHARE * next));
            }
            offsets
        };
        let mut heights: Vec<f64> = into(below, false).into_iter().map(|o| a + o).collect();
        heights.extend(into(above, matches!(below, Border::Legs { .. })).into_iter().map(|o| b - o));
        let margin = |border: Border| match border {
            Border::Waist { reach } => (2.0 * 0.05 * unit).min(0.2 * length).min(0.5 * reach),
            Border::Legs { reach } => (0.05 * unit).min(0.1 * length).min(0.5 * reach),
            Border::Plane | Border::Tip => (2.0 * 0.05 * unit).min(0.2 * length),
        };
        heights.retain(|&w| w > a + margin(below) && w < b - margin(above));
        heights.sort_by(f64::total_cmp);
        let least = (0.05 * unit).min(0.1 * length);
        let near = |w: f64| (w - a).min(b - w);
        heights.dedup_by(|b, a| *b - *a < least.min(0.5 * near(*a)));
        heights
    }

    /// Follows all contours through the heights of a zone; a branch near its tip is known from the dome.
    fn follow<'c>(
        &self,
        tracks: &mut Tracks,
        zone: &[f64],
        steps: &[Step],
        at: &impl Fn(f64) -> &'c [Contour],
    ) -> Result<(), EventFault> {
        for &w in zone {
            let domes: Vec<&Step> = steps.iter().filter(|s| s.holds(w)).collect();
            let outside = |c: &&Contour| domes.iter().all(|s| !s.is_dome(c));
            let contours: Vec<Contour> = at(w).iter().filter(outside).cloned().collect();
            tracks.advance(w, &contours, &domes).ok_or_else(|| self.lost(w))?;
        }
        Ok(())
    }

    fn pass_saddle<'c>(
        &self,
        tracks: &mut Tracks,
        step: &Step,
        at: &impl Fn(f64) -> &'c [Contour],
    ) -> Result<(usize, [usize; 2], Saddle), EventFault> {
        let [w_below, w_above] = step.w;
        let splits = step.n_above > tracks.expected;
        tracks.advance(w_below, at(w_below), &[]).ok_or_else(|| self.lost(w_below))?;
        let above = at(w_above);
        let (n_here, n_there) = if splits { (1, 2) } else { (2, 1) };
        let here = tracks.nearest(step.critical.at, n_here);
        let there = nearest(above, step.critical.at, n_there);
        if here.len() != n_here || there.len() != n_there {
            return Err(EventFault::Components { found: above.len(), expected: step.n_above });
        }
        let contours_here: Vec<Contour> = here.iter().map(|&k| tracks.active[k].contour.clone()).collect();
        let contours_there: Vec<Contour> = there.iter().map(|&k| above[k].clone()).collect();
        let ids_here: Vec<usize> = here.iter().map(|&k| tracks.active[k].part).collect();
        tracks.drop_parts(&ids_here);
        let rest: Vec<Contour> =
            above.iter().enumerate().filter(|(k, _)| !there.contains(k)).map(|(_, c)| c.clone()).collect();
        tracks.advance(w_above, &rest, &[]).ok_or_else(|| self.lost(w_above))?;
        let ids_there: Vec<usize> = contours_there.iter().map(|c| tracks.begin(w_above, c.clone())).collect();
        let (waist, legs, ids) = if splits {
            (contours_here, contours_there, (ids_here[0], [ids_there[0], ids_there[1]]))
        } else {
            (contours_there, contours_here, (ids_there[0], [ids_here[0], ids_here[1]]))
        };
        let [Ok(waist), Ok(legs)] =
            [<[Contour; 1]>::try_from(waist).map(|[w]| [w.clone(), w]), legs.try_into()]
        else {
            return Err(EventFault::NoApex);
        };
        let (w_waist, w_legs) = if splits { (w_below, w_above) } else { (w_above, w_below) };
        let along = if splits { 1.0 } else { -1.0 };
        let opens = step.critical.rises == splits;
        let [waist, _] = waist;
        Ok((ids.0, ids.1, Saddle { apex: step.critical, along, opens, w_waist, w_legs, waist, legs }))
    }

    /// Adds sections at the heights beyond the interval where the contours can be followed there.
    fn add_beyond(&self, tracks: &mut Tracks, upper: &[usize], steps: &[Step]) {
        let strict = tracks.strict;
        let Interval { w: [low, high], lower, upper: upper_contours, below, above, .. } = self.interval;
        let apexes = || steps.iter().filter(|s| s.dome.is_empty()).map(|s| s.critical.w);
        let parts_below = (0..lower.len()).collect::<Vec<_>>();
        for (contours, parts, heights) in [
            (*lower, parts_below, below.graded(*low, apexes().next())),
            (*upper_contours, upper.to_vec(), above.graded(*high, apexes().next_back())),
        ] {
            let mut beyond = Tracks::from(contours, strict);
            let found: Vec<Vec<Contour>> = heights.par_iter().map(|&w| self.source.contours(w)).collect();
            for (&w, contours) in heights.iter().zip(&found) {
                if beyond.advance(w, contours, &[]).is_none() {
                    break;
                }
            }
            let renamed = beyond.sections.into_iter().map(|(k, w, c)| (parts[k], w, c));
            tracks.sections.extend(renamed);
        }
    }
}

impl Step {
    /// Whether a height lies in its dome.
    fn holds(&self, w: f64) -> bool {
        self.dome.first().is_some_and(|(far, _)| (w - far) * (w - self.critical.w) <= 0.0)
    }

    /// Whether a contour lies round its tip.
    fn is_dome(&self, contour: &Contour) -> bool {
        let small = self.dome.first().is_some_and(|(_, c)| {
            contour.signed_area_mm2().abs() <= 1.5 * c.signed_area_mm2().abs()
                && contour.is_ccw() == c.is_ccw()
        });
        small && contour.contains(self.critical.at)
    }
}

/// A part at the height reached.
#[derive(Debug, Clone)]
struct Active {
    part: usize,
    contour: Contour,
}

/// Contours followed upward.
#[derive(Debug)]
struct Tracks {
    active: Vec<Active>,
    n_parts: usize,
    /// How many contours were there at the last height that was not inside a dome.
    expected: usize,
    sections: Vec<(usize, f64, Contour)>,
    /// Whether a contour that belongs to no part is a fault.
    strict: bool,
}

impl Tracks {
    /// Puts a better contour, which may be at another height, in the place of a part's section at a height.
    fn replace(&mut self, part: usize, w: f64, better: (f64, Contour)) {
        let is_it = |s: &&mut (usize, f64, Contour)| s.0 == part && s.1.to_bits() == w.to_bits();
        if let Some(section) = self.sections.iter_mut().find(is_it) {
            (section.1, section.2) = better;
        }
    }

    fn add(&mut self, part: usize, sections: Vec<(f64, Contour)>) {
        self.sections.extend(sections.into_iter().map(|(w, c)| (part, w, c)));
    }

    fn from(contours: &[Contour], strict: bool) -> Self {
        let active =
            contours.iter().enumerate().map(|(part, c)| Active { part, contour: c.clone() }).collect();
        Self { active, n_parts: contours.len(), expected: contours.len(), sections: Vec::new(), strict }
    }

    /// Goes on to a height; parts inside one of the domes stay where they are.
    fn advance(&mut self, w: f64, contours: &[Contour], domes: &[&Step]) -> Option<()> {
        let resting: Vec<bool> = self
            .active
            .iter()
            .map(|a| {
                domes
                    .iter()
                    .any(|s| s.dome.first().is_some_and(|(_, c)| *c == a.contour) || s.is_dome(&a.contour))
            })
            .collect();
        let moving: Vec<usize> = (0..self.active.len()).filter(|&k| !resting[k]).collect();
        let from: Vec<&Contour> = moving.iter().map(|&k| &self.active[k].contour).collect();
        let to = matched(&from, contours, self.strict)?;
        for (&k, &found) in moving.iter().zip(&to) {
            self.active[k].contour = contours[found].clone();
            self.sections.push((self.active[k].part, w, contours[found].clone()));
        }
        Some(())
    }

    fn begin(&mut self, w: f64, contour: Contour) -> usize {
        let part = self.n_parts;
        self.n_parts += 1;
        self.sections.push((part, w, contour.clone()));
        self.active.push(Active { part, contour });
        self.expected = self.active.len();
        part
    }

    fn drop_parts(&mut self, parts: &[usize]) {
        self.active.retain(|a| !parts.contains(&a.part));
        self.expected = self.active.len();
    }

    /// Begins or ends a branch at its tip.
    fn pass_tip(&mut self, step: &Step) -> Result<(), EventFault> {
        let far = step.dome.first().map(|(_, c)| c.clone()).ok_or(EventFault::NoApex)?;
        let part = if step.dome[0].0 > step.critical.w {
            let part = self.n_parts;
            self.n_parts += 1;
            self.active.push(Active { part, contour: far });
            part
        } else {
            let cost = |a: &Active| distance_from(&far, &a.contour);
            let same = self.active.iter().filter(|a| a.contour.is_ccw() == far.is_ccw());
            let part = same.min_by(|a, b| cost(a).total_cmp(&cost(b))).ok_or(EventFault::NoApex)?.part;
            self.active.retain(|a| a.part != part);
            part
        };
        self.expected = self.active.len();
        self.sections.extend(step.dome.iter().map(|(w, c)| (part, *w, c.clone())));
        Ok(())
    }

    /// Indices of the active parts nearest to a point.
    fn nearest(&self, at: Point2, n: usize) -> Vec<usize> {
        let contours: Vec<Contour> = self.active.iter().map(|a| a.contour.clone()).collect();
        nearest(&contours, at, n)
    }

    /// The part that reaches each of the contours.
    fn assigned(&self, contours: &[Contour]) -> Option<Vec<usize>> {
        let from: Vec<&Contour> = self.active.iter().map(|a| &a.contour).collect();
        if from.len() != contours.len() {
            return None;
        }
        let to = matched(&from, contours, true)?;
        let mut parts = vec![0; contours.len()];
        to.iter().zip(&self.active).for_each(|(&k, a)| parts[k] = a.part);
        Some(parts)
    }
}

/// The n contours nearest to a point.
fn nearest(contours: &[Contour], at: Point2, n: usize) -> Vec<usize> {
    let distance = |k: &usize| {
        SegmentIndex::try_new(std::slice::from_ref(&contours[*k]))
            .map_or(f64::INFINITY, |i| i.nearest(at).distance_mm)
    };
    let mut order: Vec<usize> = (0..contours.len()).collect();
    order.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    order.truncate(n);
    order
}

/// For each contour the one at the next height that continues it: the nearest pairs first.
fn matched(from: &[&Contour], to: &[Contour], strict: bool) -> Option<Vec<usize>> {
    if to.len() < from.len() || (strict && to.len() > from.len()) {
        return None;
    }
    let mut pairs = Vec::new();
    for (i, a) in from.iter().enumerate() {
        for (j, b) in to.iter().enumerate() {
            if a.is_ccw() == b.is_ccw() {
                pairs.push((distance_from(a, b) + distance_from(b, a), i, j));
            }
        }
    }
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut found = vec![usize::MAX; from.len()];
    let mut used = vec![false; to.len()];
    for (_, i, j) in pairs {
        if found[i] == usize::MAX && !used[j] {
            (found[i], used[j]) = (j, true);
        }
    }
    found.iter().all(|&j| j != usize::MAX).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_beyond_an_end_follow_each_other_outward() {
        let outward = |end: f64, apex: f64, heights: [f64; 2], limit: f64| {
            let found = Onward { heights: heights.to_vec(), limit: Some(limit) }.graded(end, Some(apex));
            let far: Vec<f64> = found.iter().map(|w| (w - end).abs()).collect();
            assert!(far.is_sorted() && found.len() > heights.len(), "{found:?}");
            assert!((far[0] - (end - apex).abs()).abs() < 1e-12, "{found:?}");
            assert!(heights.iter().all(|w| found.contains(w)), "{found:?}");
        };
        outward(0.0, -0.05, [1.0, 2.0], 3.0);
        outward(0.0, 0.05, [-1.0, -2.0], -3.0);
        let unbounded = Onward { heights: vec![1.0, 2.0], limit: None };
        assert_eq!(unbounded.graded(0.0, Some(-0.05)), [1.0, 2.0]);
    }
}
