//! The graph from checked sheets and their joints.

use super::check::{self, Sheet};
use super::decisions::{self, Decisions};
use super::error::Error;
use super::link::{Cause, Forced};
use super::stars::{Cluster, Joint, clusters, joints};
use super::{Graph, Link, Node, Reason, Star, warning};
use crate::ct::Warning;
use crate::sections::SectionStack;

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

fn build(stack: &SectionStack, decisions: &Decisions, doubt: Doubt) -> Result<Graph, Error> {
    let order = check::order(stack)?;
    let resolved = decisions::resolve(decisions, stack, &order)?;
    let (sheets, repairs) = check::sheets(stack, &order, &resolved)?;
    let mut warnings = repairs.warnings();
    if order.windows(2).any(|p| p[1] < p[0]) {
        let text = "the planes were not in ascending order of z; they were sorted".into();
        warnings.push(warning("topology.planes_sorted", text));
    }
    for &(plane, contour) in &resolved.dropped {
        let text = format!("plane {plane}: contour {contour} was left out as decided");
        warnings.push(warning("topology.dropped_as_decided", text));
    }
    check_filled(&sheets)?;
    let forced = forced(&sheets, &resolved);
    let joints = joints(&sheets, &forced);
    settle_doubts(&sheets, &joints, doubt, &mut warnings)?;
    let clusters: Vec<Vec<Cluster>> = joints
        .iter()
        .enumerate()
        .map(|(k, j)| clusters(j, sheets[k].outlines.len(), sheets[k + 1].outlines.len()))
        .collect();
    if clusters.iter().all(Vec::is_empty) {
        return Err(Error::NothingContinues);
    }
    let graph = Draft::of(&sheets, &joints, &clusters)?.finished(&mut warnings);
    Ok(Graph { warnings, ..graph })
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
    fn of(sheets: &[Sheet], joints: &[Vec<Joint>], clusters: &[Vec<Cluster>]) -> Result<Self, Error> {
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
        for (k, cluster) in clusters.iter().enumerate().flat_map(|(k, c)| c.iter().map(move |c| (k, c))) {
            let at = |k: usize, all: &[usize]| all.iter().map(|c| first[k] + c).collect::<Vec<usize>>();
            draft.stars.push(Star {
                interval: k,
                lower: at(k, &cluster.lower),
                upper: at(k + 1, &cluster.upper),
            });
        }
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
        Ok(draft)
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
