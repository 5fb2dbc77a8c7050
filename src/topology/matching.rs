//! The graph explained: which contour continues which, why, and what happens where. Written as `topology.json`.

use super::{Graph, Link, Reason, Star};
use serde::{Deserialize, Serialize};

/// How much of what there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Summary {
    /// Branches between events and ends, holes not counted.
    pub branches: usize,
    /// Events in which a branch parts, read upward.
    pub splits: usize,
    /// Events in which branches join, read upward.
    pub merges: usize,
    /// Branches that begin inside the stack.
    pub births: usize,
    /// Branches that end inside the stack.
    pub deaths: usize,
    /// Holes, from where one begins to where it ends.
    pub holes: usize,
    /// Planes that were put between the given ones.
    pub virtual_planes: usize,
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let counts = [
            ("splits", self.splits),
            ("merges", self.merges),
            ("births", self.births),
            ("deaths", self.deaths),
            ("holes", self.holes),
            ("virtual planes", self.virtual_planes),
        ];
        write!(f, "branches {}", self.branches)?;
        counts.iter().filter(|(_, n)| *n > 0).try_for_each(|(name, n)| write!(f, ", {name} {n}"))
    }
}

/// A contour as it takes part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContourNote {
    /// Its number in the plane as given; `None` on a virtual plane.
    pub contour: Option<usize>,
    /// The branch it belongs to, counted from 0.
    pub branch: usize,
    /// Whether it bounds a hole.
    pub hole: bool,
    /// What it encloses, mm².
    pub area_mm2: f64,
    /// The middle of what it encloses, mm, stack frame.
    pub centroid_mm: [f64; 2],
}

/// A plane with its contours.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlaneNote {
    /// Its number as given; `None` for a virtual plane, which is computed and not measured.
    pub plane: Option<usize>,
    /// Its height, mm.
    pub z_mm: f64,
    /// The contours that take part.
    pub contours: Vec<ContourNote>,
}

/// Where a contour is found in the document: an entry of `planes`, and an entry of that plane's `contours`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Place {
    /// Entry of `planes`.
    pub plane_entry: usize,
    /// Entry of its `contours`.
    pub contour_entry: usize,
}

/// Two contours that were looked at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinkNote {
    /// The lower one.
    pub lower: Place,
    /// The upper one.
    pub upper: Place,
    /// Whether they belong together.
    pub joined: bool,
    /// Why.
    pub reason: Reason,
    /// The same in words, with the figures.
    pub text: String,
}

/// What happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// A branch parts into several, read upward.
    Split,
    /// Branches join, read upward.
    Merge,
    /// A branch begins inside the stack.
    Birth,
    /// A branch ends inside the stack.
    Death,
    /// A hole begins inside the lumen.
    HoleBegins,
    /// A hole ends inside the lumen.
    HoleEnds,
    /// A C closes to a ring: a hole is cut off from the outside.
    HoleClosesOff,
    /// A ring opens to a C: its hole joins the outside.
    HoleOpens,
    /// A hole parts into several.
    HoleSplits,
    /// Holes join.
    HolesMerge,
    /// What lies in a hole parts from what is around it.
    IslandParts,
    /// What lies in a hole joins what is around it.
    IslandJoins,
}

impl EventKind {
    /// In plain words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Split => "split",
            Self::Merge => "merge",
            Self::Birth => "birth",
            Self::Death => "death",
            Self::HoleBegins => "hole begins",
            Self::HoleEnds => "hole ends",
            Self::HoleClosesOff => "hole closes off",
            Self::HoleOpens => "hole opens",
            Self::HoleSplits => "hole splits",
            Self::HolesMerge => "holes merge",
            Self::IslandParts => "island parts",
            Self::IslandJoins => "island joins",
        }
    }
}

/// Something that happens between two planes, or beyond one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EventNote {
    /// What.
    pub kind: EventKind,
    /// Contours below it; none for a beginning.
    pub lower: Vec<Place>,
    /// Contours above it; none for an end.
    pub upper: Vec<Place>,
    /// The same in words.
    pub text: String,
}

/// The explanation of a graph.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Matching {
    /// How much of what there is.
    pub summary: Summary,
    /// Planes from the lowest upward.
    pub planes: Vec<PlaneNote>,
    /// All pairs that were looked at, from the lowest upward.
    pub links: Vec<LinkNote>,
    /// What happens, from the lowest upward.
    pub events: Vec<EventNote>,
}

impl Matching {
    /// Explains a graph.
    #[must_use]
    pub fn of(graph: &Graph) -> Self {
        let explained = Explained::of(graph);
        let events = explained.events();
        let count = |kind| events.iter().filter(|e| e.kind == kind).count();
        let branches = graph.branches();
        let holes = branches.iter().filter(|b| graph.nodes[b.nodes[0]].is_hole()).count();
        let summary = Summary {
            branches: branches.len() - holes,
            splits: count(EventKind::Split),
            merges: count(EventKind::Merge),
            births: count(EventKind::Birth),
            deaths: count(EventKind::Death),
            holes,
            virtual_planes: graph.given.iter().filter(|g| g.is_none()).count(),
        };
        Self {
            summary,
            planes: explained.planes(),
            links: graph.links.iter().map(|l| explained.link(l)).collect(),
            events,
        }
    }
}

/// To a thousandth: what an operator compares, not what anything is computed from.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

/// A graph with the places of its nodes in the document.
struct Explained<'a> {
    graph: &'a Graph,
    places: Vec<Place>,
    branch: Vec<usize>,
}

impl<'a> Explained<'a> {
    fn of(graph: &'a Graph) -> Self {
        let mut counts = vec![0; graph.z_mm.len()];
        let place = |n: &super::Node| {
            counts[n.plane] += 1;
            Place { plane_entry: n.plane, contour_entry: counts[n.plane] - 1 }
        };
        let places = graph.nodes.iter().map(place).collect();
        let mut branch = vec![0; graph.nodes.len()];
        for (idx, b) in graph.branches().iter().enumerate() {
            b.nodes.iter().for_each(|&n| branch[n] = idx);
        }
        Self { graph, places, branch }
    }

    fn planes(&self) -> Vec<PlaneNote> {
        let note = |(&z_mm, &plane): (&f64, &Option<usize>)| PlaneNote { plane, z_mm, contours: Vec::new() };
        let mut planes: Vec<PlaneNote> = self.graph.z_mm.iter().zip(&self.graph.given).map(note).collect();
        for (node, &branch) in self.graph.nodes.iter().zip(&self.branch) {
            let centroid = node.contour.centroid();
            planes[node.plane].contours.push(ContourNote {
                contour: node.number,
                branch,
                hole: node.is_hole(),
                area_mm2: rounded(node.contour.signed_area_mm2().abs()),
                centroid_mm: [centroid.x, centroid.y].map(rounded),
            });
        }
        planes
    }

    fn link(&self, link: &Link) -> LinkNote {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let overlap = percent(link.overlap);
        let drifted = link.drifted.map(percent);
        let text = match (link.reason, &drifted) {
            (Reason::Overlap, None) => format!("overlap {overlap}"),
            (Reason::Overlap, Some(d)) => format!("overlap {overlap}, after drift {d}"),
            (Reason::Drift, d) => {
                format!("overlap {overlap}, but {} after the branch's drift", d.as_deref().unwrap_or("more"))
            }
            (Reason::Course, d) => {
                format!(
                    "the course from one to the other meets the next plane's ({})",
                    d.as_deref().unwrap_or("?")
                )
            }
            (Reason::HoleOpens, _) => format!("{overlap} of the hole lies outside the other plane's lumen"),
            (Reason::Decided, _) => "decided by the operator".into(),
            (Reason::Virtual, _) => format!("by a virtual plane, overlap {overlap}"),
            (Reason::Elsewhere, _) => format!("kept apart: overlap {overlap}, but both continue elsewhere"),
            (Reason::Sliver, None) => format!("kept apart: only {overlap} overlaps"),
            (Reason::Sliver, Some(d)) => {
                format!("kept apart: overlap {overlap}, but {d} after the branch's drift: neighbours")
            }
        };
        let (lower, upper) = (self.places[link.lower], self.places[link.upper]);
        LinkNote { lower, upper, joined: link.joined, reason: link.reason, text }
    }

    fn events(&self) -> Vec<EventNote> {
        let graph = self.graph;
        let (above, below) = (graph.stars_above(), graph.stars_below());
        let last = graph.z_mm.len().saturating_sub(1);
        let mut events: Vec<(f64, EventNote)> = Vec::new();
        for star in graph.stars.iter().filter(|s| s.is_event()) {
            let (lower, upper) = (self.at(&star.lower), self.at(&star.upper));
            let kind = self.kind(star);
            let text = format!(
                "{}: {} below, {} above",
                kind.words(),
                self.named(&star.lower),
                self.named(&star.upper)
            );
            events.push((graph.z_mm[star.interval], EventNote { kind, lower, upper, text }));
        }
        for (n, node) in graph.nodes.iter().enumerate() {
            let z_mm = graph.z_mm[node.plane];
            if below[n].is_none() && node.plane > 0 {
                let kind = if node.is_hole() { EventKind::HoleBegins } else { EventKind::Birth };
                let text = format!("{}: below {}", kind.words(), self.named(&[n]));
                let event = EventNote { kind, lower: Vec::new(), upper: self.at(&[n]), text };
                events.push((graph.z_mm[node.plane - 1], event));
            }
            if above[n].is_none() && node.plane < last {
                let kind = if node.is_hole() { EventKind::HoleEnds } else { EventKind::Death };
                let text = format!("{}: above {}", kind.words(), self.named(&[n]));
                events.push((z_mm, EventNote { kind, lower: self.at(&[n]), upper: Vec::new(), text }));
            }
        }
        events.sort_by(|a, b| a.0.total_cmp(&b.0));
        events.into_iter().map(|(_, event)| event).collect()
    }

    fn at(&self, nodes: &[usize]) -> Vec<Place> {
        nodes.iter().map(|&n| self.places[n]).collect()
    }

    /// "plane 3 (z 9.00 mm) contours 0, 1".
    fn named(&self, nodes: &[usize]) -> String {
        let Some(&first) = nodes.first() else { return String::new() };
        let plane = self.graph.nodes[first].plane;
        let z_mm = self.graph.z_mm[plane];
        match self.graph.given[plane] {
            None => format!("virtual plane (z {z_mm:.2} mm), {} contour(s)", nodes.len()),
            Some(given) => {
                let number = |&n: &usize| self.graph.nodes[n].number.map_or("?".into(), |i| i.to_string());
                let numbers: Vec<String> = nodes.iter().map(number).collect();
                let s = if nodes.len() > 1 { "s" } else { "" };
                format!("plane {given} (z {z_mm:.2} mm) contour{s} {}", numbers.join(", "))
            }
        }
    }

    /// What a star is, by what its one contour and its several ones bound.
    fn kind(&self, star: &Star) -> EventKind {
        let parts = star.upper.len() > 1;
        let (one, several) = if parts { (&star.lower, &star.upper) } else { (&star.upper, &star.lower) };
        let is_hole = |n: &usize| self.graph.nodes[*n].is_hole();
        let one_is_hole = one.iter().any(is_hole);
        let same = several.iter().all(|n| is_hole(n) == one_is_hole);
        match (one_is_hole, same, parts) {
            (false, true, true) => EventKind::Split,
            (false, true, false) => EventKind::Merge,
            (false, false, true) => EventKind::HoleClosesOff,
            (false, false, false) => EventKind::HoleOpens,
            (true, true, true) => EventKind::HoleSplits,
            (true, true, false) => EventKind::HolesMerge,
            (true, false, true) => EventKind::IslandParts,
            (true, false, false) => EventKind::IslandJoins,
        }
    }
}
