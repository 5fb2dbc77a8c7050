//! The outer skin of a wall: parallel to the lumen at distance t.
//!
//! The outer section at height z is where the distance to the lumen is t. Where nothing is trimmed it is read off
//! "point + t normal" ([`lumen`]); beside events and where branches come near each other it is followed as a level
//! curve of the exact distance ([`trace`]), corners included. The sections (at most a millimetre apart, closer where
//! several outlines part or join) go through the same steps as the lumen's: graph, branches, patches at the events. Where two branches part, the parallel
//! surface has a crease: two patches that meet in it as an explicit edge ([`crease`]).
//!
//! Where no crease can be followed (three branches that part within about t of each other) the event is built on the
//! distance smoothed over a few tenths of a millimetre instead ([`mollified`]), where that has no apex on outlines
//! interpolated between the planes, as the lumen's are; planes beside it are left out until the skin is sound
//! ([`sound`]).
//!
//! The wall so built is measured over its whole outer skin ([`thickness`]), and samples of that, the thinnest and thickest among
//! them, again on the lumen's surfaces themselves ([`verify`]). Where it is not as thick as asked, sections
//! are added between the planes, then events without a crease are built on the exact distance itself, and what is
//! nearest to the thickness asked for is kept; what is still off is told with its place, and a wall of less than half of
//! t is refused.
//!
//! Limits: a hole of a ring-shaped lumen is filled, however wide it is; where the wall would leave some of it open,
//! that is told ([`hole`]). What is interpolated is no true parallel surface: up to half of t too thick in the pocket
//! between three branches, and somewhat too thin beside it. Where a crease ends before it fades, the rest of it is
//! rounded over the spacing of the sections' points. Where a lumen ends flat beside another branch, the true outer skin
//! has a horizontal ledge on that branch's wall; here it slopes over about half a millimetre, from the union of grown
//! sections ([`union`]), which is also what is left when a curve cannot be followed.

mod crease;
mod feet;
mod hole;
mod lumen;
mod mollified;
mod neck;
mod sound;
mod thickness;
mod trace;
mod union;
mod verify;

pub use thickness::Thickness;

use super::assemble::{Creased, Recipe, assemble};
use super::distance::DistanceSource;
use super::event::{Crotch, EventPlanes, EventSource};
use super::grid::Jet;
use super::lobes::LobeSource;
use super::skin::Skin;
use super::{Error, Place};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, RigidTransform, SegmentIndex};
use crate::progress::{Cancelled, Task};
use crate::sections::{PlaneSections, SectionStack};
use crate::topology::{self, Graph};
use feet::Feet;
use lumen::Branch;
use mollified::Mollified;
use rayon::prelude::*;
use thickness::Measured;
use trace::{Tracer, at_height};

/// Farthest that neighbouring outer sections lie apart, mm.
const MOST_STEP_MM: f64 = 1.0;
/// Where the outer skin closes over a lumen that ends inside the stack: heights beyond its end, in units of t.
const DOME_HEIGHTS: [f64; 10] = [0.0, 0.25, 0.45, 0.62, 0.76, 0.87, 0.94, 0.978, 0.994, 0.999];
/// Step along an outline in units of the mean outer radius.
const TRACE_STEP: f64 = 0.05;
/// How much nearer than t a point of the raw parallel surface may be to the lumen, in t.
const TRIM_SLACK: f64 = 1e-3;
/// Every how many columns the raw section is checked, and gives a point from which to follow the outline.
const CHECK_STRIDE: usize = 2;
const SEED_STRIDE: usize = 8;
/// How often planes beside a fault are left out before it is accepted.
const MOST_WIDENINGS: usize = 8;
/// Outlines nearer to each other than this, in t, have no gap that a plane could tell.
const LEAST_GAP: f64 = 0.02;
/// How near to each other planes come, in t, between which several outlines part; and how many are added between two at
/// most.
const BRACKET: f64 = 0.1;
const MOST_BRACKETS: usize = 12;
/// How often sections are added where the wall is not as thick as asked; no closer than this, mm.
const MOST_REFINEMENTS: usize = 3;
const LEAST_STEP_MM: f64 = 0.1;
/// Points of an outline that are enough to see how outlines overlap.
const GRAPH_POINTS: usize = 64;

/// The lumen as the outer skin sees it.
struct Wall<'a> {
    lumen: &'a Skin,
    wall_mm: f64,
    branches: Vec<Branch>,
    feet: Feet,
    step_mm: f64,
    /// Heights at which a skin with creases was unsound: there are none there.
    barred: Vec<f64>,
    way: Way,
}

/// How events of the outer skin are built.
#[derive(Debug, Clone, Copy, Default)]
struct Way {
    /// Whether events without a crease take the distance to the lumen itself, not smoothed.
    is_exact: bool,
    /// Whether all creases are rounded.
    is_rounded: bool,
}

/// An outer skin.
#[derive(Debug, Default)]
pub(super) struct Outer {
    pub(super) skin: Skin,
    pub(super) warnings: Vec<Warning>,
    /// How far it is from the lumen; `None` where there is none.
    pub(super) thickness: Option<Thickness>,
}

/// A skin, and what was decided by rule on the way to it.
type Lofted = (Skin, Vec<Warning>);

/// A skin through certain planes, how unsound it is, and how thick it makes the wall.
struct Attempt {
    lofted: Lofted,
    planes: Vec<PlaneSections>,
    n_faults: usize,
    measured: Measured,
}

impl Attempt {
    /// Whether nothing speaks against it.
    fn is_valid(&self) -> bool {
        self.n_faults == 0 && self.measured.thickness.check().is_ok()
    }

    /// Less unsound than another one; as sound, and not refused for its thickness; alike in that, and nearer to the
    /// thickness asked for.
    fn is_better_than(&self, other: &Self) -> bool {
        let is_refused = |a: &Self| a.measured.thickness.check().is_err();
        let faults = (self.n_faults, is_refused(self)).cmp(&(other.n_faults, is_refused(other)));
        faults.then(self.measured.excess_mm3.total_cmp(&other.measured.excess_mm3)).is_lt()
    }

    /// Whether some event has no crease.
    fn is_rounded(&self) -> bool {
        self.lofted.0.slabs.iter().any(|slab| slab.crotch != Crotch::Crease)
    }
}

/// Builds the outer skin around a lumen, and measures the wall in between.
///
/// Where it is not as thick as asked, sections are added; where events were interpolated, they are built on the
/// distance itself instead, and where the skin is unsound or refused, its creases are rounded. The best is kept.
pub(super) fn build(lumen: &Skin, wall_mm: f64, task: &Task<'_>) -> Result<Outer, Error> {
    let Some(mut wall) = Wall::around(lumen, wall_mm, task)? else { return Ok(Outer::default()) };
    let planes = wall.bracketed(wall.planes(&wall.heights(), task)?, task)?;
    let planes = decided(planes, wall_mm);
    let mut best = wall.attempt(planes.clone(), task);
    for is_rounded in [false, true] {
        let other = match &best {
            Ok(known) if !known.is_valid() => true,
            Ok(known) => !known.measured.thickness.is_as_asked() && known.is_rounded() && !is_rounded,
            Err(error) => !matches!(error, Error::Cancelled(_)),
        };
        if !other {
            break;
        }
        (wall.way, wall.barred) = (Way { is_exact: true, is_rounded }, Vec::new());
        match (wall.attempt(planes.clone(), task), &best) {
            (Ok(next), Ok(known)) if !next.is_better_than(known) => {}
            (Ok(next), _) => best = Ok(next),
            (Err(Error::Cancelled(why)), _) => return Err(why.into()),
            (Err(_), _) => {}
        }
    }
    let Attempt { lofted: (skin, mut warnings), measured: Measured { thickness, .. }, .. } = best?;
    thickness.check()?;
    warnings.extend(thickness.warning());
    warnings.extend(hole::filled(lumen, wall_mm));
    Ok(Outer { skin, warnings, thickness: Some(thickness) })
}

impl Wall<'_> {
    /// The best skin that the way set makes of these planes and of further ones.
    fn attempt(&mut self, planes: Vec<PlaneSections>, task: &Task<'_>) -> Result<Attempt, Error> {
        let (lofted, planes) = self.sound(planes, task)?;
        let first = self.measured(lofted, planes, task)?;
        self.refined(first, task)
    }

    /// The planes with further ones where several outlines part or join between two: which does so first is seen from
    /// near by only.
    fn bracketed(
        &self,
        planes: Vec<PlaneSections>,
        task: &Task<'_>,
    ) -> Result<Vec<PlaneSections>, Cancelled> {
        let least_mm = BRACKET * self.wall_mm;
        let found: Vec<Result<Vec<PlaneSections>, Cancelled>> = planes
            .par_windows(2)
            .map(|pair| {
                let mut further = Vec::new();
                let mut open = vec![[0, 1].map(|k| (pair[k].z_mm, pair[k].contours.len()))];
                while let Some([low, high]) = open.pop() {
                    let parts = low.1.abs_diff(high.1) > 1;
                    if !parts || high.0 - low.0 < least_mm || further.len() >= MOST_BRACKETS {
                        continue;
                    }
                    task.check()?;
                    let z_mm = 0.5 * (low.0 + high.0);
                    let contours = self.outlines(z_mm);
                    let middle = (z_mm, contours.len());
                    further.push(PlaneSections { z_mm, contours });
                    open.extend([[low, middle], [middle, high]]);
                }
                Ok(further)
            })
            .collect();
        let mut all = planes;
        for further in found {
            all.extend(further?);
        }
        all.sort_by(|a, b| a.z_mm.total_cmp(&b.z_mm));
        Ok(all)
    }

    /// The outlines at these heights.
    fn planes(&self, heights: &[f64], task: &Task<'_>) -> Result<Vec<PlaneSections>, Cancelled> {
        let plane = |&z_mm: &f64| {
            task.check()?;
            Ok(PlaneSections { z_mm, contours: self.outlines(z_mm) })
        };
        let planes: Vec<Result<PlaneSections, Cancelled>> = heights.par_iter().map(plane).collect();
        planes.into_iter().collect()
    }

    fn measured(
        &self,
        lofted: Lofted,
        planes: Vec<PlaneSections>,
        task: &Task<'_>,
    ) -> Result<Attempt, Error> {
        let measured = thickness::measure(&lofted.0, self.lumen, &self.feet, self.wall_mm, task)?
            .ok_or(Error::NoOuterSkin)?;
        let n_faults = sound::faults(&lofted.0, self.wall_mm).len();
        Ok(Attempt { lofted, planes, n_faults, measured })
    }

    /// A sound skin through the planes, and those of them that it runs through: where they do not make a sound one, they
    /// are looked at from farther apart. An unsound one where that does not help.
    fn sound(
        &mut self,
        mut planes: Vec<PlaneSections>,
        task: &Task<'_>,
    ) -> Result<(Lofted, Vec<PlaneSections>), Error> {
        for _ in 0..MOST_WIDENINGS {
            let n_planes = planes.len();
            let mut changes = false;
            let result = lofted(self, &planes, task);
            let faults = match &result {
                Err(Error::Outer { z_mm, .. }) => z_mm.to_vec(),
                Ok((skin, _)) => {
                    let faults = sound::faults(skin, self.wall_mm);
                    changes = faults.iter().any(|z| !self.barred.contains(z));
                    self.barred.extend(&faults);
                    faults
                }
                // Creases that leave a branch between them no section are too close together: none is built then.
                Err(Error::OuterBranch { .. }) if !self.way.is_rounded => {
                    (self.way.is_rounded, changes) = (true, true);
                    Vec::new()
                }
                Err(_) => Vec::new(),
            };
            planes = widened(planes, &faults);
            if !changes && planes.len() == n_planes {
                return result.map(|lofted| (lofted, planes));
            }
        }
        Ok((lofted(self, &planes, task)?, planes))
    }

    /// The same skin with further sections where the wall is not as thick as asked, as long as they make it better:
    /// corners of the outlines that wander round the section are cut short between sections.
    fn refined(&self, mut best: Attempt, task: &Task<'_>) -> Result<Attempt, Error> {
        for _ in 0..MOST_REFINEMENTS {
            let heights = between(&best.planes, &best.measured.off_z_mm);
            if heights.is_empty() || best.measured.thickness.is_as_asked() {
                break;
            }
            let mut planes = decided(self.planes(&heights, task)?, self.wall_mm);
            planes.extend(best.planes.iter().cloned());
            planes.sort_by(|a, b| a.z_mm.total_cmp(&b.z_mm));
            let next = match lofted(self, &planes, task) {
                Err(Error::Cancelled(why)) => return Err(why.into()),
                Err(_worse) => break,
                Ok(lofted) => self.measured(lofted, planes, task)?,
            };
            if !next.is_better_than(&best) {
                break;
            }
            best = next;
        }
        Ok(best)
    }
}

/// Heights in the middle of the intervals of planes in which these heights lie.
fn between(planes: &[PlaneSections], off_z_mm: &[f64]) -> Vec<f64> {
    let holds = |low: f64, high: f64| {
        let first = off_z_mm.partition_point(|z| *z <= low);
        off_z_mm.get(first).is_some_and(|z| *z < high)
    };
    let pairs = planes.windows(2).map(|p| (p[0].z_mm, p[1].z_mm));
    let asked = pairs.filter(|&(low, high)| high - low > 2.0 * LEAST_STEP_MM && holds(low, high));
    asked.map(|(low, high)| 0.5 * (low + high)).collect()
}

/// The skin through the planes.
fn lofted(wall: &Wall<'_>, planes: &[PlaneSections], task: &Task<'_>) -> Result<Lofted, Error> {
    let graph = outer_graph(planes.to_vec()).map_err(Error::OuterTopology)?;
    let (skin, _) = assemble(&graph, wall, task).map_err(|error| match error {
        // The planes of the outer skin are its own: their heights say more than their numbers.
        Error::Event { place: Place::Planes { z_mm, .. }, fault } => Error::Outer { z_mm, fault },
        Error::Branch { z_mm, fault } => Error::OuterBranch { z_mm, fault },
        other => other,
    })?;
    let about_wall =
        |w: &Warning| Warning { text: format!("outer skin of the wall: {}", w.text), code: w.code.clone() };
    Ok((skin, graph.warnings.iter().map(about_wall).collect()))
}

/// The planes without those on either side of each fault; the first and the last stay.
fn widened(planes: Vec<PlaneSections>, faults: &[f64]) -> Vec<PlaneSections> {
    let last = planes.len() - 1;
    let mut keep = vec![true; planes.len()];
    for z in faults {
        let above = planes.partition_point(|p| p.z_mm < z - 1e-9);
        let exact = planes.get(above).is_some_and(|p| p.z_mm < z + 1e-9);
        for k in [if exact { above } else { above.saturating_sub(1) }, above] {
            if k > 0 && k < last {
                keep[k] = false;
            }
        }
    }
    planes.into_iter().zip(keep).filter_map(|(p, keep)| keep.then_some(p)).collect()
}

/// The planes without those on which outlines all but touch: whether they are one there, rounding decides, and a gap
/// of that width says nothing. The first and the last plane stay.
fn decided(planes: Vec<PlaneSections>, wall_mm: f64) -> Vec<PlaneSections> {
    let last = planes.len().saturating_sub(1);
    let touching: Vec<bool> = planes.par_iter().map(|p| touch(&p.contours, LEAST_GAP * wall_mm)).collect();
    let keep = |k: usize| k == 0 || k == last || !touching[k];
    planes.into_iter().enumerate().filter(|(k, _)| keep(*k)).map(|(_, p)| p).collect()
}

/// Whether two of the contours are nearer to each other than `gap_mm`, or cross.
fn touch(contours: &[Contour], gap_mm: f64) -> bool {
    let apart = |a: &Contour, b: &Contour| {
        let (Some(a), Some(b)) = (a.bounds(), b.bounds()) else { return true };
        (0..2).any(|k| a.min[k] > b.max[k] + gap_mm || b.min[k] > a.max[k] + gap_mm)
    };
    let meets = |a: &Contour, b: &Contour| {
        let index = SegmentIndex::try_new(std::slice::from_ref(b));
        index.is_some_and(|i| a.points.iter().step_by(2).any(|p| i.signed_distance_mm(*p) < gap_mm))
    };
    let pairs = contours.iter().enumerate().flat_map(|(i, a)| contours[i + 1..].iter().map(move |b| (a, b)));
    pairs.into_iter().any(|(a, b)| !apart(a, b) && meets(a, b))
}

/// The graph of the outlines. What overlaps what is seen from few of their points; where those do not decide, from all.
fn outer_graph(planes: Vec<PlaneSections>) -> Result<Graph, topology::Error> {
    let stack =
        |planes: Vec<PlaneSections>| SectionStack { planes, patient_from_stack: RigidTransform::identity() };
    let thinned = |c: &Contour| {
        let stride = (c.len() / GRAPH_POINTS).max(1);
        Contour::new(c.points.iter().step_by(stride).copied().collect())
    };
    let thin: Vec<PlaneSections> = planes
        .iter()
        .map(|p| PlaneSections { z_mm: p.z_mm, contours: p.contours.iter().map(thinned).collect() })
        .collect();
    let n_contours: usize = planes.iter().map(|p| p.contours.len()).sum();
    match topology::graph(&stack(thin)) {
        // Every outline is a node, in its order.
        Ok(mut graph) if graph.nodes.len() == n_contours => {
            let whole = planes.into_iter().flat_map(|p| p.contours);
            graph.nodes.iter_mut().zip(whole).for_each(|(node, contour)| node.contour = contour);
            Ok(graph)
        }
        _ => topology::graph(&stack(planes)),
    }
}

impl<'a> Wall<'a> {
    /// `None` where the lumen has no surface.
    fn around(lumen: &'a Skin, wall_mm: f64, task: &Task<'_>) -> Result<Option<Self>, Cancelled> {
        let (branches, samples) = lumen::sampled(lumen, wall_mm, task)?;
        let radius = branches.iter().map(|b| b.radius_mm).fold(f64::INFINITY, f64::min);
        let step_mm = TRACE_STEP * (radius + wall_mm);
        let whole =
            |feet| Self { lumen, wall_mm, branches, feet, step_mm, barred: Vec::new(), way: Way::default() };
        Ok(Feet::try_new(&samples).map(whole))
    }

    const fn tracer(&self) -> Tracer<'_> {
        Tracer { feet: &self.feet, wall_mm: self.wall_mm, step_mm: self.step_mm }
    }

    /// Heights of the outer sections, ascending: between the lumen's own, and closely over ends inside the stack.
    fn heights(&self) -> Vec<f64> {
        let [low, high] = self.lumen.z_range_mm();
        let mut all: Vec<f64> = vec![low, high];
        for tube in &self.lumen.tubes {
            all.extend(tube.surface.section_z_mm());
        }
        let mut ends = Vec::new();
        for (z, body_below) in self.branches.iter().flat_map(|b| &b.inner_ends) {
            let towards = if *body_below { self.wall_mm } else { -self.wall_mm };
            ends.extend(DOME_HEIGHTS.map(|h| z + h * towards));
        }
        all.retain(|z| (low..=high).contains(z));
        all.sort_by(f64::total_cmp);
        // Virtual sections of the lumen lie closer than the outer skin needs.
        let least = 0.2 * MOST_STEP_MM.min(self.wall_mm);
        let mut spread = vec![low];
        for z in all {
            let last = spread[spread.len() - 1];
            if z - last >= least && high - z >= least {
                fill(&mut spread, z);
            }
        }
        fill(&mut spread, high);
        // Over an end they are what its shape needs.
        ends.retain(|z| *z > low && *z < high);
        let clear = |z: &f64| ends.iter().all(|e| (e - z).abs() > 0.02 * self.wall_mm);
        spread.retain(|z| *z <= low || *z >= high || clear(z));
        spread.extend(&ends);
        spread.sort_by(f64::total_cmp);
        spread.dedup_by(|b, a| *b - *a < 1e-4 * self.wall_mm);
        spread
    }

    /// The outer contours at z; holes are filled.
    fn outlines(&self, z: f64) -> Vec<Contour> {
        let flat = self.branches.iter().flat_map(|b| &b.flat_ends).any(|end| (end - z).abs() < self.wall_mm);
        if flat {
            return union::outlines(self.lumen, self.wall_mm, z);
        }
        self.followed(z).unwrap_or_else(|| union::outlines(self.lumen, self.wall_mm, z))
    }

    /// The outer contours at z from the surface itself; `None` where one cannot be followed.
    fn followed(&self, z: f64) -> Option<Vec<Contour>> {
        let mut found: Vec<Contour> = Vec::new();
        let mut seeds: Vec<Point2> = Vec::new();
        for branch in &self.branches {
            let columns = branch.columns(z);
            let whole: Option<Vec<Point2>> = columns.iter().copied().collect();
            let whole = whole.filter(|w| !w.is_empty());
            if let Some(points) = whole
                && points.iter().step_by(CHECK_STRIDE).all(|&p| self.is_outside(p, z))
            {
                found.push(Contour::new(points));
            } else {
                seeds.extend(columns.iter().step_by(SEED_STRIDE).flatten());
            }
        }
        for seed in seeds {
            let Some((p, _)) = self.tracer().settle(seed, z, None) else { continue };
            let known = SegmentIndex::try_new(&found);
            if known.is_none_or(|k| k.nearest(p).distance_mm > 0.5 * self.step_mm) {
                found.push(trace::contour(&self.tracer().outline(p, z)?));
            }
        }
        let outlines = outermost(found);
        self.hold_lumen(&outlines, z).then_some(outlines)
    }

    /// Whether the lumen at z lies in the outlines, the events' part of it, too: none may have been lost.
    fn hold_lumen(&self, outlines: &[Contour], z: f64) -> bool {
        let held = |p: Point2| outlines.iter().any(|c| c.contains(p));
        let is_cut = |[low, high]: [f64; 2], at: f64| low < at && at < high;
        let tubes = self.lumen.tubes.iter().map(|t| t.surface.net()).filter(|n| is_cut(n.z_range_mm(), z));
        let slabs = self.lumen.slabs.iter().filter(|s| is_cut(s.w_mm, s.w_of(z)));
        tubes.map(|net| net.at(0.0, z).xy()).all(held)
            && slabs.flat_map(|slab| slab.sides_at(slab.w_of(z))).all(held)
    }

    /// Whether a point of the raw parallel surface is on the skin.
    fn is_outside(&self, p: Point2, z: f64) -> bool {
        self.feet.foot(at_height(p, z)).distance_mm > self.wall_mm * (1.0 - TRIM_SLACK)
    }
}

/// Contours that run counter-clockwise and lie in no other one. Of two that seem to lie in each other, the same outline
/// followed twice, the first one counts.
fn outermost(mut contours: Vec<Contour>) -> Vec<Contour> {
    contours.retain(|c| c.len() > 3 && c.is_ccw());
    let holds = |j: usize, i: usize| contours[j].contains(contours[i].points[0]);
    let inside = |i: usize| (0..contours.len()).any(|j| j != i && holds(j, i) && !(i < j && holds(i, j)));
    let keep: Vec<bool> = (0..contours.len()).map(|i| !inside(i)).collect();
    contours.into_iter().zip(keep).filter_map(|(c, keep)| keep.then_some(c)).collect()
}

/// Goes on to z in equal steps of at most a millimetre.
fn fill(heights: &mut Vec<f64>, z: f64) {
    let last = heights[heights.len() - 1];
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of steps")]
    let n = ((z - last) / MOST_STEP_MM).ceil().max(1.0) as usize;
    heights.extend((1..=n).map(|k| if k == n { z } else { last + (z - last) * k as f64 / n as f64 }));
}

/// The outer surface around an event that has no crease.
struct WallSource<'a> {
    wall: &'a Wall<'a>,
    sign: f64,
    anchors: Vec<Point2>,
}

impl EventSource for WallSource<'_> {
    fn value(&self, p: Point2, w: f64) -> f64 {
        self.wall.feet.foot(at_height(p, self.sign * w)).distance_mm - self.wall.wall_mm
    }

    fn jet(&self, p: Point2, w: f64) -> Jet {
        let foot = self.wall.feet.foot(at_height(p, self.sign * w));
        Jet { value: foot.distance_mm - self.wall.wall_mm, slope: foot.normal.xy() }
    }

    fn contours_on(&self, w: f64, _finer: f64) -> Vec<Contour> {
        self.wall.outlines(self.sign * w)
    }

    fn refine(&self, p: Point2, w: f64) -> Point2 {
        let settled = self.wall.tracer().settle(p, self.sign * w, None);
        settled.map_or(p, |(q, _)| if (q - p).norm() < self.wall.step_mm { q } else { p })
    }

    fn anchor(&self, i: usize, _w: f64) -> Point2 {
        self.anchors[i]
    }
}

fn distances<'a>(planes: &EventPlanes) -> Option<Box<dyn EventSource + 'a>> {
    DistanceSource::through(planes).map(|s| Box::new(s) as Box<dyn EventSource>)
}

fn lobes<'a>(planes: &EventPlanes) -> Option<Box<dyn EventSource + 'a>> {
    LobeSource::fit(planes).map(|s| Box::new(s) as Box<dyn EventSource>)
}

impl Wall<'_> {
    fn mollified<'a>(&'a self, planes: &EventPlanes, sign: f64) -> Option<Box<dyn EventSource + 'a>> {
        let distance = |p, w: f64| self.feet.foot(at_height(p, sign * w)).distance_mm - self.wall_mm;
        Mollified::around(planes, distance).map(|s| Box::new(s) as Box<dyn EventSource>)
    }

    fn exact<'a>(&'a self, planes: &EventPlanes, sign: f64) -> Option<Box<dyn EventSource + 'a>> {
        let anchors = planes.daughters[0].contours.iter().map(Contour::centroid).collect();
        Some(Box::new(WallSource { wall: self, sign, anchors }))
    }
}

impl Recipe for Wall<'_> {
    /// The distance smoothed, as the exact one may have a ridge in the crotch, which no patch follows.
    fn source<'a>(&'a self, planes: &EventPlanes, sign: f64) -> Option<Box<dyn EventSource + 'a>> {
        if self.way.is_exact {
            return self.exact(planes, sign);
        }
        self.mollified(planes, sign).or_else(|| self.exact(planes, sign))
    }

    fn second_source<'a>(&'a self, planes: &EventPlanes) -> Option<Box<dyn EventSource + 'a>> {
        // Two branches are found from farther apart; three at one height need a field that tells them apart.
        match planes.daughters[0].contours.len() {
            0..=2 => distances(planes),
            _ => lobes(planes),
        }
    }

    fn is_measured(&self) -> bool {
        false
    }

    fn crease(&self, planes: &EventPlanes, upward: bool, floor: f64) -> Option<Creased> {
        if self.way.is_rounded {
            return None;
        }
        let sign = if upward { 1.0 } else { -1.0 };
        let creased = crease::CreaseBuilder { tracer: self.tracer(), sign }.build(planes, floor)?;
        let [low, high] = creased.slab.slab.w_mm;
        let beside = |z: &f64| (low - 2.0 * self.wall_mm..high + self.wall_mm).contains(&(sign * z));
        (!self.barred.iter().any(beside)).then_some(creased)
    }
}

#[cfg(test)]
mod tests;
