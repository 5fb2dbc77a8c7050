//! A skin from the graph of its contours.
//!
//! Branches run from event to event; at every event virtual sections from the event's field are added to the given
//! ones on both sides, denser towards the apex, so that the lofted tubes meet the patches of the slab on one field.

use super::event::{
    Apex, BuiltSlab, EventFault, EventPlanes, EventSource, Plane, apex, build_slab, component,
};
use super::skin::{End, Skin, Strand, skin};
use super::{Error, Place};
use crate::geom::{Contour, Vector2};
use crate::progress::Task;
use crate::spline::ClosedCurve;
use crate::topology::{Graph, Star};
use rayon::prelude::*;

/// Planes on either side that an event looks at.
const EVENT_PLANES: usize = 3;
/// Half-heights of the slab below and above the apex for daughters of 3 mm radius, mm: thin, so that the normals
/// of the interpolated patches agree with the field's; not so thin that the saddle degenerates.
const SLAB_BELOW_MM: f64 = 0.3;
const SLAB_ABOVE_MM: f64 = 0.15;
/// The share of the way to the next plane that a slab may take.
const SLAB_SHARE: f64 = 0.35;
/// A slab thinner than this, mm, is rounding: its patches would have no shape.
const LEAST_SLAB_MM: f64 = 1e-3;
/// The radius that lengths in this file are stated for.
const STATED_RADIUS_MM: f64 = 3.0;
/// Virtual sections of a daughter above the apex, mm.
const DAUGHTER_OFFSETS_MM: [f64; 6] = [0.15, 0.25, 0.45, 0.8, 1.3, 2.0];
/// Virtual sections of the parent, as fractions of the way from its last plane to the waist.
const PARENT_FRACTIONS: [f64; 6] = [0.2, 0.4, 0.6, 0.75, 0.88, 1.0];
/// Virtual sections in the daughters' first full interval and in the parent's last one.
const DAUGHTER_INTERVAL: [f64; 3] = [1.0 / 12.0, 0.25, 0.5];
const PARENT_INTERVAL: [f64; 2] = [1.0 / 3.0, 2.0 / 3.0];
/// A scale or shift of an extrapolated end section beyond this is noise, not anatomy.
const MOST_END_CHANGE: f64 = 0.15;

/// A branch of the graph: nodes from the bottom upward.
#[derive(Debug, Clone)]
struct Branch {
    nodes: Vec<usize>,
}

/// Where the fields of events come from, and what happens at the stack's ends.
pub(super) trait Recipe: Sync {
    /// The field around an event seen along w = `sign` z; `None` where its contours are degenerate.
    fn source<'a>(&'a self, planes: &EventPlanes, sign: f64) -> Option<Box<dyn EventSource + 'a>>;
    /// Whether the sections are measured: every one must be kept, and branches that reach the first or last plane
    /// go on by half a plane interval. Sections that were computed may be left out where a slab needs the room.
    fn is_measured(&self) -> bool;
    /// Two branches that part in a crease instead of a saddle; `None` where they do not. The patches may reach down
    /// to the height w `floor` of the parent.
    fn crease(&self, _planes: &EventPlanes, _upward: bool, _floor: f64) -> Option<Creased> {
        None
    }
}

/// The patches of a crease with the sections that lead to them.
pub(super) struct Creased {
    pub(super) slab: BuiltSlab,
    /// Further sections of the parent and of the daughters: height w, contour.
    pub(super) parent: Vec<(f64, Contour)>,
    pub(super) daughters: [Vec<(f64, Contour)>; 2],
    /// How near to the slab other sections of the branches are left out, mm.
    pub(super) clearance_mm: f64,
}

/// Builds a skin.
pub(super) fn assemble(graph: &Graph, recipe: &dyn Recipe, task: &Task<'_>) -> Result<Skin, Error> {
    let branches = branches(graph);
    let mut strands: Vec<Strand> = branches.iter().map(|b| strand(graph, b)).collect();
    let events: Vec<usize> = (0..graph.stars.len()).filter(|&s| is_event(&graph.stars[s])).collect();
    let built: Vec<Result<Event, Error>> = events
        .par_iter()
        .map(|&star| {
            task.check()?;
            Event::build(graph, &branches, star, recipe)
        })
        .collect();
    let mut slabs = Vec::new();
    // The lowest fault is reported, on any number of threads.
    for event in built {
        event?.install(&mut strands, &mut slabs);
    }
    if recipe.is_measured() {
        branches.iter().zip(&mut strands).for_each(|(b, s)| extend_ends(graph, b, s));
    }
    skin(strands, slabs).map_err(Error::Spline)
}

fn is_event(star: &Star) -> bool {
    star.lower.len() > 1 || star.upper.len() > 1
}

fn star_at(graph: &Graph, node: usize, upward: bool) -> Option<usize> {
    graph.stars.iter().position(|s| if upward { s.lower.contains(&node) } else { s.upper.contains(&node) })
}

fn branches(graph: &Graph) -> Vec<Branch> {
    let mut found = Vec::new();
    for node in 0..graph.nodes.len() {
        let down = star_at(graph, node, false);
        if down.is_some_and(|s| !is_event(&graph.stars[s])) {
            continue;
        }
        let mut nodes = vec![node];
        while let Some(s) = star_at(graph, nodes[nodes.len() - 1], true) {
            if is_event(&graph.stars[s]) {
                break;
            }
            nodes.push(graph.stars[s].upper[0]);
        }
        found.push(Branch { nodes });
    }
    found
}

fn strand(graph: &Graph, branch: &Branch) -> Strand {
    let section = |&n: &usize| (graph.z_mm[graph.nodes[n].plane], graph.nodes[n].contour.clone());
    Strand { sections: branch.nodes.iter().map(section).collect(), bottom: End::Cap, top: End::Cap }
}

/// An event seen along w: one branch parts into several.
struct Event {
    upward: bool,
    parent: usize,
    daughters: Vec<usize>,
    slabs: Vec<(Joint, BuiltSlab)>,
    /// Virtual sections: of which part, height w, contour.
    sections: Vec<(Part, f64, Contour)>,
    /// How many new branches lie between chained slabs.
    n_between: usize,
    /// How near to a slab computed sections are left out, mm.
    clearance_mm: f64,
}

/// A branch of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Part {
    Parent,
    Daughter(usize),
    /// A branch between two slabs of one event.
    Between(usize),
}

/// Which parts a slab joins.
#[derive(Debug, Clone, Copy)]
struct Joint {
    parent: Part,
    daughters: [Part; 2],
}

/// A set of daughters that are joined at the height reached so far.
#[derive(Debug, Clone)]
struct Cluster {
    lobes: Vec<usize>,
    part: Part,
    /// Lowest height w at which the part is known: its first CT plane or the waist above.
    w_top: f64,
}

impl Event {
    fn build(
        graph: &Graph,
        branches: &[Branch],
        star_idx: usize,
        recipe: &dyn Recipe,
    ) -> Result<Self, Error> {
        let star = &graph.stars[star_idx];
        let upward = star.upper.len() > 1;
        let (single, several) =
            if upward { (star.lower[0], &star.upper) } else { (star.upper[0], &star.lower) };
        let branch_of =
            |n: usize| branches.iter().position(|b| b.nodes.contains(&n)).expect("every node is in a branch");
        let parent = branch_of(single);
        let daughters: Vec<usize> = several.iter().map(|&n| branch_of(n)).collect();
        let sign = if upward { 1.0 } else { -1.0 };
        let planes = event_planes(graph, branches, parent, &daughters, upward, sign);
        let place = Place::Planes { lower: star.interval, upper: star.interval + 1 };
        let fault = |fault: EventFault| Error::Event { place, fault };
        let mut event = Self {
            upward,
            parent,
            daughters,
            slabs: Vec::new(),
            sections: Vec::new(),
            n_between: 0,
            clearance_mm: 0.0,
        };
        if event.daughters.len() == 2
            && let Some(creased) = recipe.crease(&planes, upward, event.floor(graph, branches))
        {
            event.add_crease(creased);
            return Ok(event);
        }
        let source = recipe.source(&planes, sign).ok_or_else(|| fault(EventFault::NoApex))?;
        let planes = if recipe.is_measured() { planes } else { with_room(&*source, planes) };
        event.join_clusters(&*source, &planes).map_err(fault)?;
        Ok(event)
    }

    /// How far down along w a slab may reach into the parent: to its end, half of the way where another event
    /// reaches into it from there.
    fn floor(&self, graph: &Graph, branches: &[Branch]) -> f64 {
        let nodes = &branches[self.parent].nodes;
        let (near, far) =
            if self.upward { (nodes[nodes.len() - 1], nodes[0]) } else { (nodes[0], nodes[nodes.len() - 1]) };
        let sign = if self.upward { 1.0 } else { -1.0 };
        let w = |node: usize| sign * graph.z_mm[graph.nodes[node].plane];
        let opposed = star_at(graph, far, !self.upward).is_some_and(|s| {
            let star = &graph.stars[s];
            (if self.upward { &star.lower } else { &star.upper }).len() > 1
        });
        if opposed { 0.5 * (w(near) + w(far)) } else { w(far) }
    }

    fn add_crease(&mut self, creased: Creased) {
        let [waist_w, top_w] = creased.slab.slab.w_mm;
        self.clearance_mm = creased.clearance_mm;
        self.sections.push((Part::Parent, waist_w, creased.slab.waist.clone()));
        self.sections.extend(creased.parent.into_iter().map(|(w, c)| (Part::Parent, w, c)));
        for (side, sections) in creased.daughters.into_iter().enumerate() {
            self.sections.push((Part::Daughter(side), top_w, creased.slab.daughters[side].clone()));
            self.sections.extend(sections.into_iter().map(|(w, c)| (Part::Daughter(side), w, c)));
        }
        let joint = Joint { parent: Part::Parent, daughters: [Part::Daughter(0), Part::Daughter(1)] };
        self.slabs.push((joint, creased.slab));
    }

    /// Joins the daughters pair by pair, highest apex first, until one branch is left: the parent.
    fn join_clusters(&mut self, source: &dyn EventSource, planes: &EventPlanes) -> Result<(), EventFault> {
        let unit = planes.mean_radius_mm() / STATED_RADIUS_MM;
        let (w_parent, w_daughter) = (planes.parents[0].w, planes.daughters[0].w);
        let n = planes.daughters[0].contours.len();
        let mut clusters: Vec<Cluster> =
            (0..n).map(|i| Cluster { lobes: vec![i], part: Part::Daughter(i), w_top: w_daughter }).collect();
        let mut apexes: Vec<Apex> = Vec::new();
        for i in 0..n {
            for j in i + 1..n {
                apexes.extend(apex(source, [i, j], [w_parent, w_daughter]));
            }
        }
        apexes.sort_by(|a, b| b.w.total_cmp(&a.w));
        for (k, apex) in apexes.iter().enumerate() {
            let find = |lobe: usize| clusters.iter().position(|c| c.lobes.contains(&lobe));
            let (Some(x), Some(y)) = (find(apex.lobes[0]), find(apex.lobes[1])) else { continue };
            if x == y {
                continue;
            }
            let last = clusters.len() == 2;
            let third = |a: &&Apex| {
                let joins = |c: &Cluster| a.lobes.iter().filter(|l| c.lobes.contains(l)).count();
                joins(&clusters[x]) + joins(&clusters[y]) == 1
            };
            let floor = apexes[k + 1..].iter().find(third).map_or(w_parent, |next| next.w);
            let roof = clusters[x].w_top.min(clusters[y].w_top);
            let below = (SLAB_BELOW_MM * unit).min(SLAB_SHARE * (apex.w - floor));
            let above = (SLAB_ABOVE_MM * unit).min(SLAB_SHARE * (roof - apex.w));
            if below < LEAST_SLAB_MM || above < LEAST_SLAB_MM {
                return Err(if floor > w_parent { EventFault::Simultaneous } else { EventFault::NoApex });
            }
            let slab = build_slab(source, *apex, [apex.w - below, apex.w + above], self.upward)?;
            let part = if last {
                Part::Parent
            } else {
                self.n_between += 1;
                Part::Between(self.n_between - 1)
            };
            let joint = Joint { parent: part, daughters: [clusters[x].part, clusters[y].part] };
            for (side, c) in [x, y].into_iter().enumerate() {
                self.sections.push((clusters[c].part, apex.w + above, slab.daughters[side].clone()));
                self.add_daughter_sections(source, planes, &clusters[c], [apex.w, above], unit);
            }
            self.sections.push((part, apex.w - below, slab.waist.clone()));
            self.slabs.push((joint, slab));
            let joined = clusters.remove(x.max(y));
            let kept = &mut clusters[x.min(y)];
            kept.lobes.extend(joined.lobes);
            kept.part = part;
            kept.w_top = apex.w - below;
        }
        if clusters.len() != 1 {
            return Err(EventFault::NoApex);
        }
        let w_waist = clusters[0].w_top;
        self.add_parent_sections(source, planes, w_waist);
        Ok(())
    }

    /// Virtual sections between an apex and the top of a cluster.
    fn add_daughter_sections(
        &mut self,
        source: &dyn EventSource,
        planes: &EventPlanes,
        cluster: &Cluster,
        [w_apex, above]: [f64; 2],
        unit: f64,
    ) {
        let mut heights: Vec<f64> = DAUGHTER_OFFSETS_MM
            .iter()
            .map(|o| w_apex + o * unit)
            .filter(|w| *w > w_apex + above + 0.05 * unit && *w < cluster.w_top - 0.1 * unit)
            .collect();
        if let (Part::Daughter(_), [first, second, ..]) = (cluster.part, &planes.daughters[..]) {
            heights.extend(DAUGHTER_INTERVAL.iter().map(|f| first.w + f * (second.w - first.w)));
        }
        self.add_sections(source, cluster.part, cluster.lobes[0], &heights);
    }

    fn add_parent_sections(&mut self, source: &dyn EventSource, planes: &EventPlanes, w_waist: f64) {
        let last = planes.parents[0].w;
        let inner = &PARENT_FRACTIONS[..PARENT_FRACTIONS.len() - 1];
        let mut heights: Vec<f64> = inner.iter().map(|f| last + f * (w_waist - last)).collect();
        if let Some(before) = planes.parents.get(1) {
            heights.extend(PARENT_INTERVAL.iter().map(|f| before.w + f * (last - before.w)));
        }
        self.add_sections(source, Part::Parent, 0, &heights);
    }

    fn add_sections(&mut self, source: &dyn EventSource, part: Part, lobe: usize, heights: &[f64]) {
        let found: Vec<_> = heights
            .par_iter()
            .filter_map(|&w| {
                let contours = source.contours(w);
                component(&contours, source.anchor(lobe, w)).map(|(_, c)| (part, w, c.clone()))
            })
            .collect();
        self.sections.extend(found);
    }

    /// Adds slabs and sections to the branches.
    fn install(self, strands: &mut Vec<Strand>, slabs: &mut Vec<BuiltSlab>) {
        let first_between = strands.len();
        let empty = || Strand { sections: Vec::new(), bottom: End::Cap, top: End::Cap };
        strands.extend(std::iter::repeat_with(empty).take(self.n_between));
        let strand_of = |part: Part| match part {
            Part::Parent => self.parent,
            Part::Daughter(i) => self.daughters[i],
            Part::Between(i) => first_between + i,
        };
        let sign = if self.upward { 1.0 } else { -1.0 };
        for (joint, slab) in &self.slabs {
            // Between the apex and a plane that was left out there may be sections of the other side.
            let [waist, top] = slab.slab.w_mm;
            let room = self.clearance_mm;
            strands[strand_of(joint.parent)].sections.retain(|(z, _)| sign * z <= waist - room);
            for part in joint.daughters {
                strands[strand_of(part)].sections.retain(|(z, _)| sign * z >= top + room);
            }
        }
        let room = self.clearance_mm;
        for (part, w, contour) in self.sections {
            let sections = &mut strands[strand_of(part)].sections;
            // Sections that all but coincide would make the spline through them steep. The slab's borders, which come
            // first, have room by now.
            if sections.iter().all(|(z, _)| (z - sign * w).abs() >= 0.99 * room) {
                sections.push((sign * w, contour));
            }
        }
        for (joint, slab) in self.slabs {
            let idx = slabs.len();
            let mut set = |part: Part, end: End, towards_daughters: bool| {
                let strand = &mut strands[strand_of(part)];
                if towards_daughters == self.upward { strand.top = end } else { strand.bottom = end }
            };
            set(joint.parent, End::Waist { slab: idx }, true);
            for (side, part) in joint.daughters.into_iter().enumerate() {
                set(part, End::Daughter { slab: idx, side }, false);
            }
            slabs.push(slab);
        }
    }
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
    let heights: Vec<f64> = pairs.filter_map(|pair| apex(source, pair, range)).map(|a| a.w).collect();
    let lowest = heights.iter().copied().fold(f64::INFINITY, f64::min);
    let highest = heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let room = |half_height: f64| half_height * unit / SLAB_SHARE;
    while planes.parents.len() > 1 && lowest - planes.parents[0].w < room(SLAB_BELOW_MM) {
        planes.parents.remove(0);
    }
    while planes.daughters.len() > 1 && planes.daughters[0].w - highest < room(SLAB_ABOVE_MM) {
        planes.daughters.remove(0);
    }
    planes
}

/// The planes that an event looks at: those of the branch itself, no farther than its next event.
fn event_planes(
    graph: &Graph,
    branches: &[Branch],
    parent: usize,
    daughters: &[usize],
    upward: bool,
    sign: f64,
) -> EventPlanes {
    let height = |n: usize| sign * graph.z_mm[graph.nodes[n].plane];
    // Nodes of a branch, nearest to the event first.
    let ordered = |branch: usize, from_bottom: bool| -> Vec<usize> {
        let nodes = &branches[branch].nodes;
        if from_bottom { nodes.clone() } else { nodes.iter().rev().copied().collect() }
    };
    let parents = ordered(parent, !upward)
        .into_iter()
        .take(EVENT_PLANES)
        .map(|n| Plane { w: height(n), contours: vec![graph.nodes[n].contour.clone()] })
        .collect();
    let columns: Vec<Vec<usize>> = daughters.iter().map(|&d| ordered(d, upward)).collect();
    let depth = columns.iter().map(Vec::len).min().unwrap_or(0).min(EVENT_PLANES);
    let daughters = (0..depth)
        .map(|k| Plane {
            w: height(columns[0][k]),
            contours: columns.iter().map(|c| graph.nodes[c[k]].contour.clone()).collect(),
        })
        .collect();
    EventPlanes { parents, daughters }
}

/// Continues a branch that reaches the stack's first or last plane by half a plane interval along its end tangent.
fn extend_ends(graph: &Graph, branch: &Branch, strand: &mut Strand) {
    let last_plane = graph.z_mm.len() - 1;
    let plane = |i: usize| graph.nodes[branch.nodes[i]].plane;
    let n = branch.nodes.len();
    let contour = |i: usize| (graph.z_mm[plane(i)], &graph.nodes[branch.nodes[i]].contour);
    if strand.bottom == End::Cap && plane(0) == 0 {
        let half = 0.5 * (graph.z_mm[1] - graph.z_mm[0]);
        let section = extended(contour(0), (n > 1).then(|| contour(1)), -half);
        strand.sections.push(section);
    }
    if strand.top == End::Cap && plane(n - 1) == last_plane {
        let half = 0.5 * (graph.z_mm[last_plane] - graph.z_mm[last_plane - 1]);
        let section = extended(contour(n - 1), (n > 1).then(|| contour(n - 2)), half);
        strand.sections.push(section);
    }
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
