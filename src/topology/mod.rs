//! Which contour continues which: the graph over the stack (a discrete Reeb graph of the lumen's surface).
//!
//! Contours are checked and, where that is harmless, repaired ([`Error`] and [`Graph::warnings`] say what). Every plane is
//! then parted into components of lumen and of what is not lumen. Components of neighbouring planes are linked where
//! they overlap, or where they do after their branch was moved on by its drift; a contour continues in another where
//! both of its sides do. That gives tubes, splits and merges, births and deaths, holes that begin, go on, split,
//! open to the outside and end. Where several contours meet several others, sections are put between the planes
//! (interpolated signed distances, after Raya & Udupa, "Shape-based interpolation of multidimensional objects", IEEE
//! TMI 1990) until only 1 -> n and n -> 1 are left.
//!
//! What cannot be decided is asked of the operator ([`Decisions`], [`Error::Undecided`]); sections that were computed
//! are decided by rule.
//!
//! What it does not do: it does not say at which height anything happens, and a contour that continues on no other
//! plane is left out. Cost: linear in the number of planes; about 0.1 ms a plane of 128 points.
//!
//! ```
//! use lumenfab::geom::{Contour, Point2, RigidTransform};
//! use lumenfab::sections::{PlaneSections, SectionStack};
//! let disk = |x, r| Contour::circle(Point2::new(x, 0.0), r, 64);
//! let planes = vec![
//!     PlaneSections { z_mm: 0.0, contours: vec![disk(0.0, 4.0)] },
//!     PlaneSections { z_mm: 3.0, contours: vec![disk(-2.5, 2.0), disk(2.5, 2.0)] },
//! ];
//! let stack = SectionStack { planes, patient_from_stack: RigidTransform::identity() };
//! let graph = lumenfab::topology::graph(&stack).unwrap();
//! assert_eq!((&graph.stars[0].lower[..], &graph.stars[0].upper[..]), (&[0][..], &[1, 2][..]));
//! ```

mod between;
mod build;
mod check;
mod crossing;
mod decisions;
pub mod drawing;
mod error;
mod interrupted;
mod link;
pub mod matching;
mod overlap;
mod spikes;
mod stars;

pub use build::{graph, graph_decided_by, repaired};
pub use decisions::{Decisions, DropDecision, LinkDecision, Pick};
pub use error::{ContourFault, DecisionFault, Error};
pub use matching::{Matching, Summary};

use crate::ct::Warning;
use crate::geom::Contour;

/// A contour of the stack.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// Plane, counted from 0 in [`Graph::z_mm`].
    pub plane: usize,
    /// Counter-clockwise; that of a hole clockwise.
    pub contour: Contour,
    /// Its number in the plane as it was given, from 0; `None` on a virtual plane.
    pub number: Option<usize>,
}

impl Node {
    /// Whether the contour bounds a hole in the lumen.
    #[must_use]
    pub fn is_hole(&self) -> bool {
        !self.contour.is_ccw()
    }
}

/// Contours of two neighbouring planes that belong together: one below or one above.
///
/// Where a hole opens, the one is the C-shaped outer contour and the several are the ring's outer contour and its
/// hole. The planes are neighbours but for virtual planes between them that this part of the vessel has no contour on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Star {
    /// The plane of the lower nodes.
    pub interval: usize,
    /// Nodes on the lower plane, ascending.
    pub lower: Vec<usize>,
    /// Nodes on the upper plane, ascending.
    pub upper: Vec<usize>,
}

impl Star {
    /// Whether it is more than one contour continuing in one.
    #[must_use]
    pub const fn is_event(&self) -> bool {
        self.lower.len() > 1 || self.upper.len() > 1
    }
}

/// Why two contours were joined, or kept apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// They overlap.
    Overlap,
    /// They overlap after the branch was moved on by its drift.
    Drift,
    /// The course from one to the other leads on to a third on the plane beyond.
    Course,
    /// A hole of one plane lies outside the lumen of the other.
    HoleOpens,
    /// The operator said so.
    Decided,
    /// A section was put between them.
    Virtual,
    /// Kept apart: both continue elsewhere.
    Elsewhere,
    /// Kept apart: they overlap by a sliver only, and their drift says that they are neighbours.
    Sliver,
}

/// A pair of contours that was looked at, and what came of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Link {
    /// Node of the lower plane.
    pub lower: usize,
    /// Node of the upper plane.
    pub upper: usize,
    /// Area that both share, as a fraction of the smaller one's.
    pub overlap: f64,
    /// The same after moving by the drift; `None` where it was not needed or no drift is known.
    pub drifted: Option<f64>,
    /// Why.
    pub reason: Reason,
    /// Whether they belong together.
    pub joined: bool,
}

/// Contours and how they continue each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Graph {
    /// Heights of the planes, mm, ascending; virtual planes among them.
    pub z_mm: Vec<f64>,
    /// Number of each plane as it was given, from 0; `None`: a virtual plane, computed and not measured.
    pub given: Vec<Option<usize>>,
    /// All contours that take part, plane by plane.
    pub nodes: Vec<Node>,
    /// All connections, from the bottom upward; each node is in at most one star downward and one upward.
    pub stars: Vec<Star>,
    /// Every pair that was looked at, with the reason for what came of it.
    pub links: Vec<Link>,
    /// What was repaired, left out or decided by rule.
    pub warnings: Vec<Warning>,
}

/// A chain of nodes between events or ends, from the bottom upward.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Branch {
    /// Its nodes.
    pub nodes: Vec<usize>,
}

impl Graph {
    /// Whether a plane was computed to part several contours that meet several others.
    #[must_use]
    pub fn is_virtual(&self, plane: usize) -> bool {
        self.given[plane].is_none()
    }

    /// Distances between the lowest two and between the uppermost two planes that were given, mm.
    #[must_use]
    pub fn end_intervals_mm(&self) -> [f64; 2] {
        let given = self.z_mm.iter().zip(&self.given).filter(|(_, g)| g.is_some()).map(|(z, _)| *z);
        let z_mm: Vec<f64> = given.collect();
        match z_mm[..] {
            [first, second, .., before, last] => [second - first, last - before],
            [first, .., last] => [last - first; 2],
            _ => [0.0; 2],
        }
    }

    /// For every node the star that it is a lower node of.
    #[must_use]
    pub fn stars_above(&self) -> Vec<Option<usize>> {
        self.stars_of(|s| &s.lower)
    }

    /// For every node the star that it is an upper node of.
    #[must_use]
    pub fn stars_below(&self) -> Vec<Option<usize>> {
        self.stars_of(|s| &s.upper)
    }

    fn stars_of(&self, side: fn(&Star) -> &[usize]) -> Vec<Option<usize>> {
        let mut of_node = vec![None; self.nodes.len()];
        for (idx, star) in self.stars.iter().enumerate() {
            for &node in side(star) {
                of_node[node] = Some(idx);
            }
        }
        of_node
    }

    /// The chains of nodes between events, births and deaths, in the order of their lowest nodes.
    #[must_use]
    pub fn branches(&self) -> Vec<Branch> {
        let (above, below) = (self.stars_above(), self.stars_below());
        let goes_on = |star: Option<usize>| star.map(|s| &self.stars[s]).filter(|s| !s.is_event());
        (0..self.nodes.len())
            .filter(|&node| goes_on(below[node]).is_none())
            .map(|first| {
                let next = |&node: &usize| goes_on(above[node]).map(|s| s.upper[0]);
                Branch { nodes: std::iter::successors(Some(first), next).collect() }
            })
            .collect()
    }
}

/// Whether a contour meets itself other than in the joints of neighbouring edges.
pub(crate) fn meets_itself(contour: &Contour) -> bool {
    crossing::within(contour).is_some()
}

/// Whether two polygons meet or touch.
pub(crate) fn meet(a: &Contour, b: &Contour) -> bool {
    crossing::of_two(a, b).is_some()
}

fn warning(code: &str, text: String) -> Warning {
    Warning { code: code.into(), text }
}

#[cfg(test)]
mod tests;
