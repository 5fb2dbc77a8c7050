//! The graph from checked sheets and their joints.

use super::between::{self, Meeting, Slice};
use super::check::{self, Sheet};
use super::decisions::{self, Decisions};
use super::error::Error;
use super::interrupted;
use super::link::{Cause, Forced};
use super::stars::{Cluster, Joint, clusters, joints, joints_of_two};
use super::{Graph, Link, Node, Reason, Star, warning};
use crate::ct::Warning;
use crate::geom::Contour;
use crate::sections::{PlaneSections, SectionStack};

/// What happens where overlap and drift contradict each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Doubt {
    Ask,
    Rule,
}

/// Builds the graph of a stack; what is doubtful is decided by rule.
///
/// # Errors
/// [`Error`], naming plane and contour.
pub fn graph(stack: &SectionStack) -> Result<Graph, Error> {
    build(stack, &Decisions::default(), Doubt::Rule)
}

/// Builds the graph of a stack as far as it can be decided, and as the operator has decided.
///
/// # Errors
/// [`Error`], naming plane and contour; [`Error::Undecided`] where the operator is asked, [`Error::Decision`] where a
/// decision names something that is not there.
pub fn graph_decided_by(stack: &SectionStack, decisions: &Decisions) -> Result<Graph, Error> {
    build(stack, decisions, Doubt::Ask)
}

/// The stack as it was meant: planes in ascending order, contours without repeated points, spikes and tiny loops, outer ones
/// counter-clockwise and holes clockwise; with what was repaired. Numbers of contours stay. Where something is wrong
/// that cannot be repaired the stack comes back as it was: building it says what.
#[must_use]
pub fn repaired(stack: SectionStack) -> (SectionStack, Vec<Warning>) {
    let Ok(order) = check::order(&stack) else { return (stack, Vec::new()) };
    let Ok((sheets, repairs)) = check::sheets(&stack, &order, &decisions::Resolved::default()) else {
        return (stack, Vec::new());
    };
    let mut warnings = repairs.warnings();
    warnings.extend(sorted_warning(&order));
    let contours = |s: Sheet| s.outlines.into_iter().map(|o| o.contour).collect();
    let planes = sheets.into_iter().map(|s| PlaneSections { z_mm: s.z_mm, contours: contours(s) }).collect();
    (SectionStack { planes, ..stack }, warnings)
}

fn sorted_warning(order: &[usize]) -> Option<Warning> {
    let text = "the planes were not in ascending order of z; they were sorted".to_owned();
    order.windows(2).any(|p| p[1] < p[0]).then(|| warning("topology.planes_sorted", text))
}

fn build(stack: &SectionStack, decisions: &Decisions, doubt: Doubt) -> Result<Graph, Error> {
    let order = check::order(stack)?;
    let resolved = decisions::resolve(decisions, stack, &order)?;
    let (sheets, repairs) = check::sheets(stack, &order, &resolved)?;
    let mut warnings = repairs.warnings();
    warnings.extend(sorted_warning(&order));
    for &(plane, contour) in &resolved.dropped {
        let text = format!("plane {plane}: contour {contour} was left out as decided");
        warnings.push(warning("topology.dropped_as_decided", text));
    }
    check_filled(&sheets)?;
    let forced = forced(&sheets, &resolved);
    let joints = joints(&sheets, &forced);
    settle_doubts(&sheets, &joints, doubt, &mut warnings)?;
    if doubt == Doubt::Ask {
        interrupted::check(&sheets, &joints, &mut warnings)?;
    }
    let clusters: Vec<Vec<Cluster>> = joints
        .iter()
        .enumerate()
        .map(|(k, j)| clusters(j, sheets[k].outlines.len(), sheets[k + 1].outlines.len()))
        .collect();
    if clusters.iter().all(Vec::is_empty) {
        return Err(Error::NothingContinues);
    }
    warn_of_ring_ends(&sheets, &clusters, &mut warnings);
    let graph = Draft::of(&sheets, &joints, &clusters, &mut warnings)?.sorted().finished(&mut warnings);
    Ok(Graph { warnings, ..graph })
}

/// Says where a ring begins or ends at once: lumen round a hole that is open to the outside on the plane where the lumen is
/// not. Which side of the ring came first no section says; both contours are closed on their own.
fn warn_of_ring_ends(sheets: &[Sheet], clusters: &[Vec<Cluster>], warnings: &mut Vec<Warning>) {
    for (k, sheet) in sheets.iter().enumerate() {
        let holes = sheet.outlines.iter().filter(|o| !o.contour.is_ccw());
        for hole in holes {
            let ends = |side: fn(&Cluster) -> &Vec<usize>, interval: Option<usize>| {
                let interval = interval.and_then(|i| clusters.get(i));
                let of_ring = |o: &usize| sheet.outlines[*o].material == hole.material;
                interval.is_some_and(|all| !all.iter().any(|c| side(c).iter().any(of_ring)))
            };
            let sides =
                [("begins", ends(|c| &c.upper, k.checked_sub(1))), ("ends", ends(|c| &c.lower, Some(k)))];
            for (what, _) in sides.into_iter().filter(|(_, ends)| *ends) {
                let plane = sheet.given.unwrap_or(k);
                let text = format!(
                    "plane {plane} (z {:.3} mm): the ring round contour {} {what} at once; its outline and its hole are closed on their own",
                    sheet.z_mm, hole.number
                );
                warnings.push(warning("topology.ring_end", text));
            }
        }
    }
}

/// Refuses stacks with too few planes and planes without contours between others.
fn check_filled(sheets: &[Sheet]) -> Result<(), Error> {
    let filled: Vec<usize> = (0..sheets.len()).filter(|&k| !sheets[k].outlines.is_empty()).collect();
    if filled.len() < 2 {
        return Err(Error::TooFewPlanes { found: filled.len() });
    }
    match filled.windows(2).find(|p| p[1] - p[0] > 1) {
        Some(pair) => {
            let empty = &sheets[pair[0] + 1];
            Err(Error::EmptyPlane { plane: empty.given.unwrap_or(pair[0] + 1), z_mm: empty.z_mm })
        }
        None => Ok(()),
    }
}

/// The operator's links by interval and outline. A link to a contour that was dropped is no link.
fn forced(sheets: &[Sheet], resolved: &decisions::Resolved) -> Forced {
    let mut forced = Forced::new();
    for (k, pair) in sheets.windows(2).enumerate() {
        let Some(plane) = pair[0].given else { continue };
        let decided = resolved.joined.range((plane, 0, 0)..=(plane, usize::MAX, usize::MAX));
        for (&(_, lower, upper), &join) in decided {
            let find = |sheet: &Sheet, number| sheet.outlines.iter().position(|o| o.number == number);
            if let (Some(lower), Some(upper)) = (find(&pair[0], lower), find(&pair[1], upper)) {
                forced.insert((k, lower, upper), join);
            }
        }
    }
    forced
}

fn settle_doubts(
    sheets: &[Sheet],
    joints: &[Vec<Joint>],
    doubt: Doubt,
    warnings: &mut Vec<Warning>,
) -> Result<(), Error> {
    for (k, joint) in joints.iter().enumerate().flat_map(|(k, j)| j.iter().map(move |j| (k, j))) {
        let Some(why) = joint.doubt else { continue };
        let (below, above) = (&sheets[k], &sheets[k + 1]);
        let (lower_plane, upper_plane) = (below.given.unwrap_or(k), above.given.unwrap_or(k + 1));
        let (lower, upper) = (below.outlines[joint.lower].number, above.outlines[joint.upper].number);
        let share = |s: f64| format!("{:.0} %", 100.0 * s);
        let drifted = joint.drifted.map_or_else(String::new, |d| format!(", after drift {}", share(d)));
        let why = format!("{why}: overlap {}{drifted}", share(joint.overlap));
        if doubt == Doubt::Ask {
            return Err(Error::Undecided { lower_plane, upper_plane, lower, upper, why });
        }
        let verdict = if joint.joined { "joined" } else { "kept apart" };
        let text = format!(
            "planes {lower_plane} and {upper_plane}: contours {lower} and {upper} were {verdict} by rule ({why})"
        );
        warnings.push(warning("topology.decided_by_rule", text));
    }
    Ok(())
}

/// The graph while it is put together: contours by height, not yet numbered.
struct Draft {
    planes: Vec<(f64, Option<usize>)>,
    nodes: Vec<Node>,
    stars: Vec<Star>,
    links: Vec<Link>,
}

impl Draft {
    fn of(
        sheets: &[Sheet],
        joints: &[Vec<Joint>],
        clusters: &[Vec<Cluster>],
        warnings: &mut Vec<Warning>,
    ) -> Result<Self, Error> {
        let mut first = Vec::with_capacity(sheets.len());
        let mut nodes = Vec::new();
        for (plane, sheet) in sheets.iter().enumerate() {
            first.push(nodes.len());
            let node =
                |o: &check::Outline| Node { plane, contour: o.contour.clone(), number: Some(o.number) };
            nodes.extend(sheet.outlines.iter().map(node));
        }
        let planes = sheets.iter().map(|s| (s.z_mm, s.given)).collect();
        let mut draft = Self { planes, nodes, stars: Vec::new(), links: Vec::new() };
        for (k, joint) in joints.iter().enumerate().flat_map(|(k, j)| j.iter().map(move |j| (k, j))) {
            draft.links.push(Link {
                lower: first[k] + joint.lower,
                upper: first[k + 1] + joint.upper,
                overlap: joint.overlap,
                drifted: joint.drifted,
                reason: reason(joint.cause),
                joined: joint.joined,
            });
        }
        for (k, cluster) in clusters.iter().enumerate().flat_map(|(k, c)| c.iter().map(move |c| (k, c))) {
            let star = Star {
                interval: k,
                lower: cluster.lower.iter().map(|c| first[k] + c).collect(),
                upper: cluster.upper.iter().map(|c| first[k + 1] + c).collect(),
            };
            if cluster.lower.len() < 2 || cluster.upper.len() < 2 {
                draft.stars.push(star);
                continue;
            }
            let meeting = Meeting {
                before: k.checked_sub(1).and_then(|b| {
                    let far = beyond(&clusters[b], |c| [&c.upper, &c.lower], &cluster.lower)?;
                    Some(slice(&sheets[b], &far))
                }),
                lower: slice(&sheets[k], &cluster.lower),
                upper: slice(&sheets[k + 1], &cluster.upper),
                after: clusters.get(k + 1).and_then(|above| {
                    let far = beyond(above, |c| [&c.lower, &c.upper], &cluster.upper)?;
                    Some(slice(&sheets[k + 2], &far))
                }),
            };
            draft.part(&star, &meeting, warnings)?;
        }
        Ok(draft)
    }

    /// Puts sections into a star of several contours below and several above.
    fn part(&mut self, star: &Star, meeting: &Meeting, warnings: &mut Vec<Warning>) -> Result<(), Error> {
        let given = |plane: usize| self.planes[plane].1.unwrap_or(plane);
        let (lower_plane, upper_plane) = (given(star.interval), given(star.interval + 1));
        let number = |nodes: &[usize]| nodes.iter().filter_map(|&n| self.nodes[n].number).collect::<Vec<_>>();
        let (lower, upper) = (number(&star.lower), number(&star.upper));
        let refused =
            || Error::Meeting { lower_plane, upper_plane, lower: lower.clone(), upper: upper.clone() };
        let parted = between::part(meeting).ok_or_else(refused)?;
        let heights: Vec<String> = parted.sections.iter().map(|s| format!("{:.2}", s.z_mm)).collect();
        let text = format!(
            "planes {lower_plane} and {upper_plane}: contours {lower:?} meet contours {upper:?}; they were parted by {} at z {} mm",
            if parted.by_union { "the union of all of them" } else { "interpolated sections" },
            heights.join(", ")
        );
        warnings.push(warning("topology.virtual_plane", text));
        let mut below = (star.interval, star.lower.clone(), between::sheet_of(&meeting.lower));
        for section in &parted.sections {
            let sheet = between::sheet_of(section).ok_or_else(refused)?;
            let plane = self.planes.len();
            self.planes.push((section.z_mm, None));
            let nodes: Vec<usize> = (self.nodes.len()..).take(sheet.outlines.len()).collect();
            let node = |c: &Contour| Node { plane, contour: c.clone(), number: None };
            self.nodes.extend(section.contours.iter().map(node));
            self.tie((&below.1, below.2.as_ref()), (&nodes, &sheet));
            below = (plane, nodes, Some(sheet));
        }
        let top = between::sheet_of(&meeting.upper).ok_or_else(refused)?;
        self.tie((&below.1, below.2.as_ref()), (&star.upper, &top));
        Ok(())
    }

    fn tie(
        &mut self,
        (lower_nodes, lower): (&[usize], Option<&Sheet>),
        (upper_nodes, upper): (&[usize], &Sheet),
    ) {
        let Some(lower) = lower else { return };
        let joints = joints_of_two(lower, upper);
        for joint in joints.iter().filter(|j| j.joined) {
            self.links.push(Link {
                lower: lower_nodes[joint.lower],
                upper: upper_nodes[joint.upper],
                overlap: joint.overlap,
                drifted: None,
                reason: Reason::Virtual,
                joined: true,
            });
        }
        for cluster in clusters(&joints, lower_nodes.len(), upper_nodes.len()) {
            self.stars.push(Star {
                interval: self.nodes[lower_nodes[0]].plane,
                lower: cluster.lower.iter().map(|&c| lower_nodes[c]).collect(),
                upper: cluster.upper.iter().map(|&c| upper_nodes[c]).collect(),
            });
        }
    }

    /// Brings virtual planes to their heights: planes ascending, nodes plane by plane, stars by their planes.
    fn sorted(self) -> Self {
        let mut order: Vec<usize> = (0..self.planes.len()).collect();
        order.sort_by(|&a, &b| self.planes[a].0.total_cmp(&self.planes[b].0));
        let mut planes: Vec<(f64, Option<usize>)> = Vec::with_capacity(order.len());
        let mut new_plane = vec![0; order.len()];
        for &old in &order {
            let (z_mm, given) = self.planes[old];
            // Virtual sections of several meetings at one height share a plane.
            let shared = planes.last().is_some_and(|last| given.is_none() && z_mm - last.0 < 1e-9);
            if !shared {
                planes.push((z_mm, given));
            }
            new_plane[old] = planes.len() - 1;
        }
        let mut by_plane: Vec<usize> = (0..self.nodes.len()).collect();
        by_plane.sort_by_key(|&n| new_plane[self.nodes[n].plane]);
        let mut new_node = vec![0; self.nodes.len()];
        by_plane.iter().enumerate().for_each(|(new, &old)| new_node[old] = new);
        let renumbered = |nodes: &[usize]| {
            let mut nodes: Vec<usize> = nodes.iter().map(|&n| new_node[n]).collect();
            nodes.sort_unstable();
            nodes
        };
        let mut stars: Vec<Star> = self
            .stars
            .iter()
            .map(|s| Star {
                interval: new_plane[s.interval],
                lower: renumbered(&s.lower),
                upper: renumbered(&s.upper),
            })
            .collect();
        stars.sort_by(|a, b| (a.interval, &a.lower, &a.upper).cmp(&(b.interval, &b.lower, &b.upper)));
        let mut links: Vec<Link> = self
            .links
            .iter()
            .map(|l| Link { lower: new_node[l.lower], upper: new_node[l.upper], ..*l })
            .collect();
        links.sort_by_key(|l| (l.lower, l.upper));
        let mut nodes: Vec<Option<Node>> = self.nodes.into_iter().map(Some).collect();
        let nodes = by_plane
            .iter()
            .filter_map(|&old| nodes[old].take())
            .map(|n| Node { plane: new_plane[n.plane], ..n })
            .collect();
        Self { planes, nodes, stars, links }
    }

    /// Leaves out contours that continue nowhere and numbers what stays.
    fn finished(self, warnings: &mut Vec<Warning>) -> Graph {
        let mut linked = vec![false; self.nodes.len()];
        for star in &self.stars {
            star.lower.iter().chain(&star.upper).for_each(|&n| linked[n] = true);
        }
        for (node, _) in self.nodes.iter().zip(&linked).filter(|(_, linked)| !**linked) {
            let (z_mm, given) = self.planes[node.plane];
            let plane = given.unwrap_or(node.plane);
            let what = if node.is_hole() { "hole" } else { "contour" };
            let (code, done) = if node.is_hole() {
                ("topology.hole_filled", "was filled")
            } else {
                ("topology.island_dropped", "was left out")
            };
            let text = format!(
                "plane {plane} (z {z_mm:.3} mm): a {what} of {:.2} mm2 continues on no other plane and {done}",
                node.contour.signed_area_mm2().abs()
            );
            warnings.push(warning(code, text));
        }
        let mut number = 0;
        let new: Vec<Option<usize>> = linked
            .iter()
            .map(|&is_linked| {
                is_linked.then(|| {
                    number += 1;
                    number - 1
                })
            })
            .collect();
        let renumbered = |nodes: &[usize]| nodes.iter().filter_map(|&n| new[n]).collect();
        let stars = self.stars.iter().map(|s| Star {
            interval: s.interval,
            lower: renumbered(&s.lower),
            upper: renumbered(&s.upper),
        });
        let stars = stars.collect();
        let links =
            self.links.iter().filter_map(|l| Some(Link { lower: new[l.lower]?, upper: new[l.upper]?, ..*l }));
        let links = links.collect();
        let nodes = self.nodes.into_iter().zip(&linked).filter(|(_, l)| **l).map(|(n, _)| n).collect();
        let (z_mm, given) = self.planes.into_iter().unzip();
        Graph { z_mm, given, nodes, stars, links, warnings: Vec::new() }
    }
}

fn slice(sheet: &Sheet, outlines: &[usize]) -> Slice {
    Slice {
        z_mm: sheet.z_mm,
        contours: outlines.iter().map(|&o| sheet.outlines[o].contour.clone()).collect(),
    }
}

/// The contours that all of `near` are linked to in the next interval; `None` where one of them ends. `sides` says which
/// side of a cluster is the near one and which the far one.
fn beyond(
    clusters: &[Cluster],
    sides: fn(&Cluster) -> [&Vec<usize>; 2],
    near: &[usize],
) -> Option<Vec<usize>> {
    let mut far: Vec<usize> = Vec::new();
    for outline in near {
        far.extend(sides(clusters.iter().find(|c| sides(c)[0].contains(outline))?)[1]);
    }
    far.sort_unstable();
    far.dedup();
    Some(far)
}

const fn reason(cause: Cause) -> Reason {
    match cause {
        Cause::Overlap => Reason::Overlap,
        Cause::Drift => Reason::Drift,
        Cause::Course => Reason::Course,
        Cause::Opens => Reason::HoleOpens,
        Cause::Operator => Reason::Decided,
        Cause::Elsewhere => Reason::Elsewhere,
        Cause::Sliver => Reason::Sliver,
    }
}
