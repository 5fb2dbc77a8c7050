//! A skin from the graph of its contours.
//!
//! Branches run from event to event; at every event virtual sections from the event's field are added to the given
//! ones on both sides, denser towards the apex, so that the lofted tubes meet the patches of the slab on one field.
//! Cost: linear in the number of contours.

use super::dome;
use super::event::{Beyond, EventFault, EventPlanes, EventSource, Plane, Slab};
use super::lean::Leans;
use super::neck;
use super::skin::{Correspondence, End, Skin, Strand, skin};
use super::sound::is_sound;
use super::sweep::{Interval, Joint, LEGS_SIDE_MM, Onward, SLAB_SHARE, Swept, WAIST_SIDE_MM, sweep};
use super::{Error, Place};
use crate::ct::Warning;
use crate::geom::{Contour, Vector2};
use crate::progress::Task;
use crate::spline::ClosedCurve;
use crate::topology::{Graph, Star, meet};
use rayon::prelude::*;

/// Planes on either side that an event looks at.
const EVENT_PLANES: usize = 3;
/// A plane nearer to the one before it than this share of the interval on that one's other side says nothing of the
/// course there: noise between the two would be taken for a slope.
const CLOSE_PLANES: f64 = 0.2;
/// The radius that lengths of slabs and virtual sections are stated for.
const STATED_RADIUS_MM: f64 = 3.0;
/// Virtual sections in the daughters' first full interval and in the parent's last one.
const DAUGHTER_INTERVAL: [f64; 3] = [1.0 / 12.0, 0.25, 0.5];
const PARENT_INTERVAL: [f64; 2] = [1.0 / 3.0, 2.0 / 3.0];
/// Of those, the part that an event may take where the interval's other end is an event, too.
const SHARED_INTERVAL: f64 = 0.3;
/// A scale or shift of an extrapolated end section beyond this is noise, not anatomy.
const MOST_END_CHANGE: f64 = 0.15;
/// Most that an interval beyond the last section is longer than the one before it.
const END_GROWTH: f64 = 2.0;
/// The share of the way to the end up to which sections are put there.
const LAST_SHARE: f64 = 0.67;
/// Sections nearer than this, mm, lie at one height: one of them only stays in the tube.
pub(super) const ONE_HEIGHT_MM: f64 = 1e-6;
const NONE: usize = usize::MAX;

/// A branch of the graph: nodes from the bottom upward.
#[derive(Debug, Clone)]
struct Branch {
    nodes: Vec<usize>,
}

/// Where the fields of events come from, and what happens at the stack's ends.
pub(super) trait Recipe: Sync {
    /// The field around an event seen along w = `sign` z; `None` where its contours are degenerate.
    fn source<'a>(&'a self, planes: &EventPlanes, sign: f64) -> Option<Box<dyn EventSource + 'a>>;
    /// A field to try where no event can be built on the first one.
    fn second_source<'a>(&'a self, _planes: &EventPlanes) -> Option<Box<dyn EventSource + 'a>> {
        None
    }
    /// Whether the sections are measured: every one must be kept, branches that reach the first or last plane
    /// go on by half a plane interval, others end in domes. Sections that were computed may be left out where a slab
    /// needs the room.
    fn is_measured(&self) -> bool;
    /// Two branches that part in a crease instead of a saddle; `None` where they do not. The patches may reach down
    /// to the height w `floor` of the parent.
    fn crease(&self, _planes: &EventPlanes, _upward: bool, _floor: f64) -> Option<Creased> {
        None
    }
    /// Which points of neighbouring sections correspond.
    fn correspondence(&self) -> Correspondence {
        Correspondence::LeastTwist
    }
}

/// A slab with the contours at its borders.
#[derive(Debug, Clone)]
pub(super) struct BuiltSlab {
    pub(super) slab: Slab,
    /// The parent's contour at the waist.
    pub(super) waist: Contour,
    /// The daughters' contours at their ends.
    pub(super) daughters: [Contour; 2],
}

/// The patches of a crease with the sections that lead to them.
#[derive(Debug)]
pub(super) struct Creased {
    pub(super) slab: BuiltSlab,
    /// Further sections of the parent and of the daughters: height w, contour.
    pub(super) parent: Vec<(f64, Contour)>,
    pub(super) daughters: [Vec<(f64, Contour)>; 2],
    /// How near to the slab other sections of the branches are left out, mm.
    pub(super) clearance_mm: f64,
}

impl Creased {
    /// The crease as an event of three parts: the parent, then the daughters.
    fn swept(self) -> (Swept, f64) {
        let [w_waist, w_top] = self.slab.slab.w_mm;
        let mut sections = vec![(0, w_waist, self.slab.waist)];
        sections.extend(self.parent.into_iter().map(|(w, c)| (0, w, c)));
        for (side, (end, further)) in self.slab.daughters.into_iter().zip(self.daughters).enumerate() {
            sections.push((side + 1, w_top, end));
            sections.extend(further.into_iter().map(|(w, c)| (side + 1, w, c)));
        }
        let joints = vec![Joint { waist: 0, legs: [1, 2], slab: self.slab.slab, leans: Leans::default() }];
        (Swept { n_parts: 3, upper: vec![1, 2], joints, sections }, self.clearance_mm)
    }
}

/// The graph with its branches, and for each node what it belongs to.
struct Layout<'a> {
    graph: &'a Graph,
    branches: Vec<Branch>,
    branch_of: Vec<usize>,
    /// Whether a star leads from each branch downward and upward.
    continued: Vec<[bool; 2]>,
    /// Whether the branch is what others join to there.
    is_parent: Vec<[bool; 2]>,
}

impl<'a> Layout<'a> {
    /// The planes given on either side of an interval, which may lie between computed ones.
    fn place(&self, interval: usize) -> Place {
        let given = |plane: usize| self.graph.given[plane];
        let lower = (0..=interval).rev().find_map(given);
        let upper = (interval + 1..self.graph.given.len()).find_map(given);
        Place::Planes {
            lower: lower.unwrap_or(0),
            upper: upper.unwrap_or(interval + 1),
            z_mm: [self.graph.z_mm[interval], self.graph.z_mm[interval + 1]],
        }
    }

    fn of(graph: &'a Graph) -> Self {
        let n = graph.nodes.len();
        let (mut up, mut down) = (vec![NONE; n], vec![NONE; n]);
        for (s, star) in graph.stars.iter().enumerate() {
            star.lower.iter().for_each(|&node| up[node] = s);
            star.upper.iter().for_each(|&node| down[node] = s);
        }
        let plain = |s: usize| s != NONE && !is_event(&graph.stars[s]);
        let (mut branches, mut continued, mut is_parent) = (Vec::new(), Vec::new(), Vec::new());
        let several = |s: usize, side: fn(&Star) -> &[usize]| s != NONE && side(&graph.stars[s]).len() > 1;
        let mut branch_of = vec![NONE; n];
        for node in (0..n).filter(|&node| !plain(down[node])) {
            let mut nodes = vec![node];
            let mut last = node;
            while plain(up[last]) {
                last = graph.stars[up[last]].upper[0];
                nodes.push(last);
            }
            nodes.iter().for_each(|&k| branch_of[k] = branches.len());
            branches.push(Branch { nodes });
            continued.push([down[node] != NONE, up[last] != NONE]);
            is_parent.push([several(down[node], |s| &s.lower), several(up[last], |s| &s.upper)]);
        }
        Self { graph, branches, branch_of, continued, is_parent }
    }

    fn strand(&self, branch: &Branch) -> Strand {
        let section = |&n: &usize| (self.z(n), self.graph.nodes[n].contour.clone());
        Strand { sections: branch.nodes.iter().map(section).collect(), bottom: End::Cap, top: End::Cap }
    }

    fn z(&self, node: usize) -> f64 {
        self.graph.z_mm[self.graph.nodes[node].plane]
    }

    /// How far down along w a crease may reach into its parent: to the parent's end, half of the way where another
    /// event reaches into it from there.
    fn floor(&self, parent: usize, upward: bool) -> f64 {
        let nodes = &self.branches[parent].nodes;
        let (bottom, top) = (self.z(nodes[0]), self.z(nodes[nodes.len() - 1]));
        let (near, far) = if upward { (top, bottom) } else { (-bottom, -top) };
        let opposed = self.is_parent[parent][usize::from(!upward)];
        if opposed { 0.5 * (near + far) } else { far }
    }
}

/// Builds a skin; with what was decided by rule.
pub(super) fn assemble(
    graph: &Graph,
    recipe: &dyn Recipe,
    task: &Task<'_>,
) -> Result<(Skin, Vec<Warning>), Error> {
    let layout = Layout::of(graph);
    let mut strands = Strands::of(layout.branches.iter().map(|b| layout.strand(b)).collect());
    let events: Vec<usize> = (0..graph.stars.len()).filter(|&s| is_event(&graph.stars[s])).collect();
    let built: Vec<Result<Event, Error>> = events
        .par_iter()
        .map(|&star| {
            task.check()?;
            Event::build(&layout, star, recipe)
        })
        .collect();
    let (mut slabs, mut leans) = (Vec::new(), Vec::new());
    // The lowest fault is reported, on any number of threads.
    for event in built {
        event?.install(&mut strands, &mut slabs, &mut leans);
    }
    for (k, branch) in layout.branches.iter().enumerate() {
        if recipe.is_measured() {
            let [from_below, from_above] = layout.continued[k];
            let strand = strands.get(k);
            if !from_below {
                finish(&layout, branch.nodes[0], false, strand);
            }
            if !from_above {
                finish(&layout, branch.nodes[branch.nodes.len() - 1], true, strand);
            }
        }
    }
    let mut strands_left = strands.joined(&slabs);
    let mut warnings = Vec::new();
    if recipe.is_measured() {
        let both = [false, true].into_iter();
        warnings.extend(both.filter_map(|is_top| keep_ends_apart(graph, is_top, &mut strands_left)));
    }
    Ok((skin(strands_left, slabs, &leans, recipe.correspondence(), recipe.is_measured())?, warnings))
}

fn is_event(star: &Star) -> bool {
    star.lower.len() > 1 || star.upper.len() > 1
}

/// Strands of which some turn out to be pieces of one (union-find).
struct Strands {
    strands: Vec<Strand>,
    parent: Vec<usize>,
}

impl Strands {
    fn of(strands: Vec<Strand>) -> Self {
        let parent = (0..strands.len()).collect();
        Self { strands, parent }
    }

    fn root(&mut self, mut k: usize) -> usize {
        while self.parent[k] != k {
            self.parent[k] = self.parent[self.parent[k]];
            k = self.parent[k];
        }
        k
    }

    fn get(&mut self, k: usize) -> &mut Strand {
        let root = self.root(k);
        &mut self.strands[root]
    }

    fn begin(&mut self) -> usize {
        self.strands.push(Strand { sections: Vec::new(), bottom: End::Cap, top: End::Cap });
        self.parent.push(self.parent.len());
        self.parent.len() - 1
    }

    /// Makes two strands one.
    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a == b {
            return;
        }
        let (kept, gone) = (a.min(b), a.max(b));
        let Strand { sections, bottom, top } = std::mem::replace(
            &mut self.strands[gone],
            Strand { sections: Vec::new(), bottom: End::Cap, top: End::Cap },
        );
        self.parent[gone] = kept;
        let strand = &mut self.strands[kept];
        strand.sections.extend(sections);
        if bottom != End::Cap {
            strand.bottom = bottom;
        }
        if top != End::Cap {
            strand.top = top;
        }
    }

    /// The strands that are left, without what lies beyond their slabs: between an apex and a plane that was left
    /// out there may be sections of the other side.
    fn joined(mut self, slabs: &[Slab]) -> Vec<Strand> {
        let n = self.strands.len();
        let is_root: Vec<bool> = (0..n).map(|k| self.root(k) == k).collect();
        let mut left = Vec::new();
        for (mut strand, _) in self.strands.into_iter().zip(is_root).filter(|(_, is_root)| *is_root) {
            let low = strand.bottom.z_mm(slabs).unwrap_or(f64::NEG_INFINITY);
            let high = strand.top.z_mm(slabs).unwrap_or(f64::INFINITY);
            strand.sections.retain(|(z, _)| *z >= low && *z <= high);
            left.push(strand);
        }
        left
    }
}

/// What was swept, and between which heights w.
type Placed = (Swept, [f64; 2]);

/// An event seen along w.
struct Event {
    upward: bool,
    lower: Vec<usize>,
    upper: Vec<usize>,
    swept: Swept,
    /// Heights w between which there are the event's own sections only: of planes left out there are none.
    between: Option<[f64; 2]>,
    /// How near to a slab computed sections are left out, mm.
    clearance_mm: f64,
}

impl Event {
    fn build(layout: &Layout<'_>, star_idx: usize, recipe: &dyn Recipe) -> Result<Self, Error> {
        let star = &layout.graph.stars[star_idx];
        let upward = star.upper.len() > 1;
        let branches = |nodes: &[usize]| nodes.iter().map(|&n| layout.branch_of[n]).collect();
        let (below, above): (Vec<usize>, Vec<usize>) = (branches(&star.lower), branches(&star.upper));
        let (lower, upper) = if upward { (below, above) } else { (above, below) };
        let sign = if upward { 1.0 } else { -1.0 };
        let close = if recipe.is_measured() { CLOSE_PLANES } else { 0.0 };
        let planes = event_planes(layout, [&lower, &upper], upward, close);
        let place = layout.place(star.interval);
        let fault = |fault: EventFault| Error::Event { place, fault };
        if let ([parent], [_, _]) = (&lower[..], &upper[..])
            && let Some(creased) = recipe.crease(&planes, upward, layout.floor(*parent, upward))
        {
            let (swept, clearance_mm) = creased.swept();
            return Ok(Self { upward, lower, upper, swept, between: None, clearance_mm });
        }
        let try_on = |source: Option<Box<dyn EventSource + '_>>, planes: EventPlanes| {
            let source = source.ok_or(EventFault::NoApex)?;
            let planes = if recipe.is_measured() { planes } else { with_room(&*source, planes) };
            let outer = outer_heights(layout, [&lower, &upper], &planes, upward);
            let interval = interval(&planes, outer, upward);
            sweep(&*source, &interval).map(|swept| (swept, interval.w))
        };
        let first = try_on(recipe.source(&planes, sign), planes.clone());
        let swept = better(first, || try_on(Some(recipe.second_source(&planes)?), planes).ok());
        let (swept, between) = swept.map_err(fault)?;
        // Measured sections stay, whatever the event says.
        let between = (!recipe.is_measured()).then_some(between);
        Ok(Self { upward, lower, upper, swept, between, clearance_mm: 0.0 })
    }

    /// Adds slabs and sections to the branches.
    fn install(self, strands: &mut Strands, slabs: &mut Vec<Slab>, leans: &mut Vec<Leans>) {
        let parts: Vec<usize> = (0..self.swept.n_parts).map(|_| strands.begin()).collect();
        self.lower.iter().enumerate().for_each(|(k, &branch)| strands.join(branch, parts[k]));
        for (&branch, &part) in self.upper.iter().zip(&self.swept.upper) {
            strands.join(branch, parts[part]);
        }
        let sign = if self.upward { 1.0 } else { -1.0 };
        if let Some([low, high]) = self.between {
            let is_inside = |z: f64| low < sign * z && sign * z < high;
            for &branch in self.lower.iter().chain(&self.upper) {
                strands.get(branch).sections.retain(|(z, _)| !is_inside(*z));
            }
        }
        let room = self.clearance_mm;
        for joint in self.swept.joints.iter().filter(|_| room > 0.0) {
            let [waist, top] = joint.slab.w_mm;
            strands.get(parts[joint.waist]).sections.retain(|(z, _)| joint.slab.w_of(*z) <= waist - room);
            for leg in joint.legs {
                strands.get(parts[leg]).sections.retain(|(z, _)| joint.slab.w_of(*z) >= top + room);
            }
        }
        for (part, w, contour) in self.swept.sections {
            let sections = &mut strands.get(parts[part]).sections;
            // Sections that all but coincide would make the spline through them steep. The slab's borders, which come
            // first, have room by now.
            if sections.iter().all(|(z, _)| (z - sign * w).abs() >= 0.99 * room) {
                sections.push((sign * w, contour));
            }
        }
        for joint in self.swept.joints {
            let slab = slabs.len();
            let mut set = |part: usize, end: End, is_top: bool| {
                let strand = strands.get(parts[part]);
                if is_top { strand.top = end } else { strand.bottom = end }
            };
            let upward = joint.slab.upward;
            set(joint.waist, End::Waist { slab }, upward);
            for (side, part) in joint.legs.into_iter().enumerate() {
                set(part, End::Daughter { slab, side }, !upward);
            }
            slabs.push(joint.slab);
            leans.push(joint.leans);
        }
    }
}

/// The first event if it is sound; else the second one if there is one, and if the first is no event at all or the second is
/// sound.
fn better(
    first: Result<Placed, EventFault>,
    second: impl FnOnce() -> Option<Placed>,
) -> Result<Placed, EventFault> {
    if first.as_ref().is_ok_and(|(swept, _)| is_sound(swept)) {
        return first;
    }
    second().filter(|(swept, _)| first.is_err() || is_sound(swept)).map_or(first, Ok)
}

fn interval(planes: &EventPlanes, [below, above]: [Onward; 2], upward: bool) -> Interval<'_> {
    Interval {
        w: [planes.parents[0].w, planes.daughters[0].w],
        lower: &planes.parents[0].contours,
        upper: &planes.daughters[0].contours,
        below,
        above,
        unit: planes.mean_radius_mm() / STATED_RADIUS_MM,
        upward,
    }
}

/// Heights of virtual sections in the intervals beside an event, seen along w, which is z where the event is seen `upward`.
fn outer_heights(
    layout: &Layout<'_>,
    sides: [&[usize]; 2],
    planes: &EventPlanes,
    upward: bool,
) -> [Onward; 2] {
    let onward = |planes: &[Plane], branches: &[usize], fractions: &[f64], is_top: bool| -> Onward {
        let Some(second) = next_w(layout, planes, branches, upward, is_top) else { return Onward::default() };
        let first = planes[0].w;
        // A branch of two nodes has an event at the interval's other end, or its own end; one of one has it in there.
        let shared = branches.iter().any(|&b| layout.branches[b].nodes.len() < 3);
        let most = if shared { SHARED_INTERVAL } else { 1.0 };
        let at = |f: f64| first + f * (second - first);
        let known = if planes.len() > 1 { fractions } else { &[] };
        let heights = known.iter().filter(|f| **f <= most).map(|f| at(*f)).collect();
        Onward { heights, limit: Some(at(most)) }
    };
    let [lower, upper] = sides;
    [
        onward(&planes.parents, lower, &PARENT_INTERVAL, !upward),
        onward(&planes.daughters, upper, &DAUGHTER_INTERVAL, upward),
    ]
}

/// Where the interval behind the first of an event's planes ends: at the second one; where there is none because the next
/// event follows at once, at the next plane of the stack. `None` where a branch ends.
fn next_w(
    layout: &Layout<'_>,
    planes: &[Plane],
    branches: &[usize],
    upward: bool,
    is_top: bool,
) -> Option<f64> {
    if let [_, second, ..] = planes {
        return Some(second.w);
    }
    let goes_on = branches.iter().all(|&b| layout.continued[b][usize::from(is_top)]);
    let sign = if upward { 1.0 } else { -1.0 };
    let end_z = sign * planes.first()?.w;
    let behind = |z: &&f64| if is_top { **z > end_z } else { **z < end_z };
    let next = layout.graph.z_mm.iter().filter(behind);
    let nearest = next.min_by(|a, b| (*a - end_z).abs().total_cmp(&(*b - end_z).abs()))?;
    goes_on.then_some(sign * nearest)
}

/// Leaves out computed planes that lie so near to an apex that the slab would become thinner than it should be. The
/// apex is looked for beyond the nearest planes, too: where branches all but touch on one of them, rounding decides
/// on which side of it they seem to part.
fn with_room(source: &dyn EventSource, mut planes: EventPlanes) -> EventPlanes {
    let unit = planes.mean_radius_mm() / STATED_RADIUS_MM;
    let (farthest_parent, farthest_daughters) = (planes.parents.last(), planes.daughters.last());
    let range = [farthest_parent, farthest_daughters].map(|p| p.map_or(0.0, |p| p.w));
    let n = planes.daughters[0].contours.len();
    let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| [i, j]));
    let heights: Vec<f64> = pairs.filter_map(|pair| neck::apex(source, pair, range)).map(|a| a.w).collect();
    let lowest = heights.iter().copied().fold(f64::INFINITY, f64::min);
    let highest = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let room = |half_height: f64| half_height * unit / SLAB_SHARE;
    while planes.parents.len() > 1 && lowest - planes.parents[0].w < room(WAIST_SIDE_MM) {
        planes.parents.remove(0);
    }
    while planes.daughters.len() > 1 && planes.daughters[0].w - highest < room(LEGS_SIDE_MM) {
        planes.daughters.remove(0);
    }
    planes
}

/// The planes that an event looks at: those of the branches themselves, no farther than their next events, and none
/// nearer to the one before it than the share `close` of the interval on that one's other side.
fn event_planes(layout: &Layout<'_>, [lower, upper]: [&[usize]; 2], upward: bool, close: f64) -> EventPlanes {
    let sign = if upward { 1.0 } else { -1.0 };
    // Nodes of a branch, nearest to the event first.
    let ordered = |branch: usize, from_bottom: bool| -> Vec<usize> {
        let nodes = &layout.branches[branch].nodes;
        if from_bottom {
            nodes.iter().take(2 * EVENT_PLANES).copied().collect()
        } else {
            nodes.iter().rev().take(2 * EVENT_PLANES).copied().collect()
        }
    };
    let planes = |branches: &[usize], from_bottom: bool| -> Vec<Plane> {
        let columns: Vec<Vec<usize>> = branches.iter().map(|&b| ordered(b, from_bottom)).collect();
        // A virtual plane holds contours of some branches only: planes count that all of them have a contour on.
        let on_plane = |&first: &usize| -> Option<Plane> {
            let same = |n: &&usize| layout.graph.nodes[**n].plane == layout.graph.nodes[first].plane;
            let nodes: Vec<usize> =
                columns.iter().map(|c| c.iter().find(same).copied()).collect::<Option<_>>()?;
            let contours = nodes.iter().map(|&n| layout.graph.nodes[n].contour.clone()).collect();
            Some(Plane { w: sign * layout.z(first), contours })
        };
        columns[0].iter().filter_map(on_plane).collect()
    };
    let (parents, daughters) = (planes(lower, !upward), planes(upper, upward));
    let (parents, daughters) = (spaced(&parents, &daughters, close), spaced(&daughters, &parents, close));
    let beyond = parted(layout, upper, upward).filter(|_| daughters.len() == 1).and_then(|parted| {
        let (branches, daughter_of): (Vec<usize>, Vec<usize>) = parted.into_iter().unzip();
        let behind = |p: &Plane| daughters[0].w < p.w;
        let planes: Vec<Plane> = planes(&branches, upward).into_iter().filter(behind).collect();
        let planes = spaced(&planes, &daughters, close);
        let is_solid = planes.iter().flat_map(|p| &p.contours).all(Contour::is_ccw);
        (is_solid && !planes.is_empty()).then_some(Beyond { planes, daughter_of })
    });
    let rejoined = rejoined(layout, upper, upward).map_or_else(Vec::new, |branch| planes(&[branch], upward));
    let rejoined = spaced(&rejoined, &daughters, close);
    EventPlanes { parents, daughters, beyond, rejoined }
}

/// The first few planes of one side of an event that are not too close to the one before.
fn spaced(side: &[Plane], other: &[Plane], close: f64) -> Vec<Plane> {
    let mut kept: Vec<Plane> = Vec::new();
    let mut before = other.first().map(|p| p.w);
    for plane in side {
        let last = kept.last().map(|p| p.w);
        let is_close = |(last, before): (f64, f64)| (plane.w - last).abs() < close * (last - before).abs();
        if !last.zip(before).is_some_and(is_close) {
            before = last.or(before);
            kept.push(plane.clone());
        }
    }
    kept.truncate(EVENT_PLANES);
    kept
}

/// The nodes of a star on the side where an event comes from, and on the other.
fn sides(star: &Star, upward: bool) -> [&[usize]; 2] {
    if upward { [&star.lower, &star.upper] } else { [&star.upper, &star.lower] }
}

/// The branch that all daughters, and nothing else, join to next.
fn rejoined(layout: &Layout<'_>, daughters: &[usize], upward: bool) -> Option<usize> {
    let last = |&branch: &usize| {
        let nodes = &layout.branches[branch].nodes;
        if upward { nodes.last() } else { nodes.first() }.copied()
    };
    let mut ends = daughters.iter().map(last).collect::<Option<Vec<usize>>>()?;
    ends.sort_unstable();
    let joins = |star: &&Star| {
        let mut near = sides(star, upward)[0].to_vec();
        near.sort_unstable();
        near == ends
    };
    match sides(layout.graph.stars.iter().find(joins)?, upward)[1] {
        [node] => Some(layout.branch_of[*node]),
        _ => None,
    }
}

/// The branches behind the next events, each with the daughter that it comes from, where daughters of one plane part
/// again. `None` where none does, or one ends.
fn parted(layout: &Layout<'_>, daughters: &[usize], upward: bool) -> Option<Vec<(usize, usize)>> {
    let mut found = Vec::new();
    for (daughter, &branch) in daughters.iter().enumerate() {
        let nodes = &layout.branches[branch].nodes;
        if let [node] = nodes[..] {
            let leads = |star: &&Star| sides(star, upward)[0] == [node];
            let behind = sides(layout.graph.stars.iter().find(leads)?, upward)[1];
            found.extend(behind.iter().map(|&n| (layout.branch_of[n], daughter)));
        } else {
            found.push((branch, daughter));
        }
    }
    (found.len() > daughters.len()).then_some(found)
}

/// Ends a branch that goes no further at a node: half a plane interval beyond the stack's first or last plane, in a
/// dome elsewhere.
fn finish(layout: &Layout<'_>, node: usize, is_top: bool, strand: &mut Strand) {
    let (z_mm, plane) = (&layout.graph.z_mm, layout.graph.nodes[node].plane);
    strand.sections.sort_by(|a, b| a.0.total_cmp(&b.0));
    if is_top {
        strand.sections.reverse();
    }
    // A virtual plane says nothing of branches that do not pass it.
    let given = |plane: &usize| !layout.graph.is_virtual(*plane);
    let below = (0..plane).rev().find(given).map(|k| z_mm[k]);
    let above = (plane + 1..z_mm.len()).find(given).map(|k| z_mm[k]);
    let at_end = strand.sections.iter().position(|s| (s.0 - z_mm[plane]).abs() < 1e-9).unwrap_or(0);
    let sections = &strand.sections[at_end..];
    let added = match (is_top, below, above) {
        (true, Some(before), None) => beyond_stack(sections, 0.5 * (z_mm[plane] - before)),
        (false, None, Some(next)) => beyond_stack(sections, -0.5 * (next - z_mm[plane])),
        (true, _, Some(next)) => dome::towards(sections, next),
        (false, Some(before), _) => dome::towards(sections, before),
        _ => Vec::new(),
    };
    strand.sections.extend(added);
}

/// Branches that lean towards each other would meet beyond the stack's end, where nothing is known of them: those that do
/// go on straight there, which is told.
fn keep_ends_apart(graph: &Graph, is_top: bool, strands: &mut [Strand]) -> Option<Warning> {
    let plane = if is_top { graph.z_mm.len().checked_sub(1)? } else { 0 };
    let plane_z = *graph.z_mm.get(plane)?;
    let is_beyond = |z: f64| if is_top { z > plane_z + ONE_HEIGHT_MM } else { z < plane_z - ONE_HEIGHT_MM };
    let outermost = |strand: &Strand| -> Option<(f64, Contour)> {
        let beyond = strand.sections.iter().filter(|s| is_beyond(s.0));
        beyond.max_by(|a, b| (a.0 - plane_z).abs().total_cmp(&(b.0 - plane_z).abs())).cloned()
    };
    let ends: Vec<Option<(f64, Contour)>> = strands.iter().map(outermost).collect();
    let meets = |i: usize| {
        let others = ends.iter().enumerate().filter(|(j, _)| *j != i).filter_map(|(_, end)| end.as_ref());
        ends[i].as_ref().is_some_and(|(_, own)| others.into_iter().any(|(_, other)| meet(own, other)))
    };
    let met: Vec<bool> = (0..ends.len()).map(meets).collect();
    let mut straightened = Vec::new();
    for (strand, _) in strands.iter_mut().zip(met).filter(|(_, met)| *met) {
        let at_end = strand.sections.iter().find(|s| (s.0 - plane_z).abs() < ONE_HEIGHT_MM);
        let Some(contour) = at_end.map(|s| s.1.clone()) else { continue };
        let beyond = strand.sections.iter_mut().filter(|s| is_beyond(s.0));
        beyond.for_each(|section| section.1 = contour.clone());
        straightened.push(contour);
    }
    (!straightened.is_empty()).then(|| straight_ends(graph, plane, &straightened))
}

fn straight_ends(graph: &Graph, plane: usize, contours: &[Contour]) -> Warning {
    let of_plane = graph.nodes.iter().filter(|node| node.plane == plane && contours.contains(&node.contour));
    let numbers: Vec<String> = of_plane.filter_map(|node| node.number).map(|n| n.to_string()).collect();
    let text = format!(
        "plane {} (z {:.2} mm), contours {}: these branches lean towards each other and would meet beyond the stack's end: \
         they go on straight there",
        graph.given[plane].unwrap_or(plane),
        graph.z_mm[plane],
        numbers.join(", ")
    );
    Warning { code: "solid.straight_ends".into(), text }
}

/// The first section moved on by `by_mm` along the direction to it from the one that lies about as far behind it; by less,
/// too, where the next section lies so near that the spline would run off.
fn beyond_stack(sections: &[(f64, Contour)], by_mm: f64) -> Vec<(f64, Contour)> {
    let end_z = sections[0].0;
    let far = |s: &&(f64, Contour)| (s.0 - end_z).abs() > 1.2 * by_mm.abs();
    let is_apart = |s: &&(f64, Contour)| (s.0 - end_z).abs() > ONE_HEIGHT_MM;
    let neighbour = sections.iter().find(far).or_else(|| sections.iter().find(is_apart)).map(|s| (s.0, &s.1));
    // A virtual section may lie on the plane itself: no interval grows from there.
    let last_interval = sections.iter().find(is_apart).map_or(by_mm, |s| end_z - s.0);
    let moved = |by: f64| extended((end_z, &sections[0].1), neighbour, by);
    let first = last_interval * END_GROWTH;
    let growing = std::iter::successors(Some(first), |by| Some(by * END_GROWTH + first));
    let between = growing.take_while(|by| by.abs() < LAST_SHARE * by_mm.abs());
    between.chain(std::iter::once(by_mm)).map(moved).collect()
}

/// The end contour moved and scaled on by `by_mm` at the rate between it and its neighbour.
fn extended((z, end): (f64, &Contour), neighbour: Option<(f64, &Contour)>, by_mm: f64) -> (f64, Contour) {
    let (shift, scale) = neighbour.map_or((Vector2::zeros(), 1.0), |(z_inner, inner)| {
        let share = by_mm / (z - z_inner);
        let growth = (end.signed_area_mm2() / inner.signed_area_mm2()).sqrt();
        let scale = (1.0 + share * (growth - 1.0)).clamp(1.0 - MOST_END_CHANGE, 1.0 + MOST_END_CHANGE);
        ((end.centroid() - inner.centroid()) * share, scale)
    });
    let centre = end.centroid();
    // On the curve through the points, so that the extension has the same shape as its neighbour.
    let points = ClosedCurve::through(end).map_or_else(|| end.points.clone(), |c| c.resampled(256, 0.0));
    let moved = points.iter().map(|p| centre + shift + (p - centre) * scale).collect();
    (z + by_mm, Contour::new(moved))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point2;

    #[test]
    fn a_section_on_the_last_plane_itself_does_not_hinder_those_beyond() {
        let disk = |x: f64| Contour::circle(Point2::new(x, 0.0), 2.0, 64);
        let sections = [(10.0, disk(1.0)), (10.0, disk(1.0)), (9.8, disk(0.98)), (8.0, disk(0.8))];
        let beyond = beyond_stack(&sections, 1.5);
        assert!(beyond.is_sorted_by(|a, b| a.0 < b.0) && beyond.len() < 8);
        assert!((beyond[0].0 - 10.4).abs() < 1e-9 && beyond[beyond.len() - 1].0 == 11.5);
        // The branch leans by 0.1 mm per mm.
        for (z_mm, contour) in &beyond {
            assert!((contour.centroid().x - (1.0 + 0.1 * (z_mm - 10.0))).abs() < 1e-3, "{z_mm}");
        }
    }
}
