//! What the operator has decided about the topology, in `case.toml`.
//!
//! ```toml
//! [[topology.link]]      # contour 0 of plane 12 does not continue in contour 1 of plane 13
//! plane = 12
//! lower = 0
//! upper = 1
//! join = false
//!
//! [[topology.drop]]      # the contour around x 31.5, y -4 mm of plane 3 is left out
//! plane = 3
//! contour = [31.5, -4.0]
//! ```
//!
//! Planes and contours are counted from 0 as in `sections.json`.

use super::error::{DecisionFault, Error};
use crate::geom::{Contour, Point2};
use crate::sections::SectionStack;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Which contour of a plane: by its number, or by a point that it encloses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected the number of a contour, or a point [x, y] in mm inside it")]
pub enum Pick {
    /// Counted from 0, as in `sections.json`.
    Number(usize),
    /// The innermost contour around this point, mm, stack frame.
    Point([f64; 2]),
}

impl std::fmt::Display for Pick {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Point([x, y]) => write!(f, "the point [{x}, {y}]"),
        }
    }
}

/// Whether a contour continues in one of the next plane.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkDecision {
    /// The lower one of the two planes.
    pub plane: usize,
    /// Contour of the lower plane.
    pub lower: Pick,
    /// Contour of the next plane above.
    pub upper: Pick,
    /// Whether they belong together.
    pub join: bool,
}

/// A contour that is left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DropDecision {
    /// The plane.
    pub plane: usize,
    /// The contour.
    pub contour: Pick,
}

/// All that the operator has decided; empty where nothing had to be.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Decisions {
    /// Which contours continue each other.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub link: Vec<LinkDecision>,
    /// Which contours are left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub drop: Vec<DropDecision>,
}

impl Decisions {
    /// Whether nothing was decided.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.link.is_empty() && self.drop.is_empty()
    }
}

/// Decisions as numbers of planes and contours. A plane is named by its number in the document.
#[derive(Debug, Clone, Default)]
pub(super) struct Resolved {
    /// (plane, contour) to leave out.
    pub(super) dropped: BTreeSet<(usize, usize)>,
    /// (lower plane, lower contour, upper contour) and whether they are joined.
    pub(super) joined: BTreeMap<(usize, usize, usize), bool>,
}

/// Looks the decisions up in the stack. `order` holds the planes' numbers from the lowest upward.
pub(super) fn resolve(
    decisions: &Decisions,
    stack: &SectionStack,
    order: &[usize],
) -> Result<Resolved, Error> {
    let mut resolved = Resolved::default();
    for (entry, drop) in decisions.drop.iter().enumerate() {
        let fault = |fault| Error::Decision { table: "drop", entry, fault };
        resolved.dropped.insert((drop.plane, pick(stack, drop.plane, drop.contour).map_err(fault)?));
    }
    for (entry, link) in decisions.link.iter().enumerate() {
        let fault = |fault| Error::Decision { table: "link", entry, fault };
        let lower = pick(stack, link.plane, link.lower).map_err(fault)?;
        let above = order.iter().position(|&p| p == link.plane).and_then(|at| order.get(at + 1));
        let above = *above.ok_or(DecisionFault::NoPlaneAbove(link.plane)).map_err(fault)?;
        let upper = pick(stack, above, link.upper).map_err(fault)?;
        if let Some(&(plane, contour)) =
            [(link.plane, lower), (above, upper)].iter().find(|c| resolved.dropped.contains(c))
        {
            return Err(fault(DecisionFault::Dropped { plane, contour }));
        }
        let before = resolved.joined.insert((link.plane, lower, upper), link.join);
        if before.is_some_and(|join| join != link.join) {
            return Err(fault(DecisionFault::Contradicted));
        }
    }
    Ok(resolved)
}

fn pick(stack: &SectionStack, plane: usize, pick: Pick) -> Result<usize, DecisionFault> {
    let last = stack.planes.len().saturating_sub(1);
    let sections = stack.planes.get(plane).ok_or(DecisionFault::NoPlane { plane, last })?;
    let n_contours = sections.contours.len();
    let found = match pick {
        Pick::Number(number) => (number < n_contours).then_some(number),
        Pick::Point([x, y]) => innermost(&sections.contours, Point2::new(x, y)),
    };
    found.ok_or(DecisionFault::NoContour { plane, pick, n_contours })
}

fn innermost(contours: &[Contour], p: Point2) -> Option<usize> {
    let around = contours.iter().enumerate().filter(|(_, c)| c.contains(p));
    let area = |c: &Contour| c.signed_area_mm2().abs();
    around.min_by(|a, b| area(a.1).total_cmp(&area(b.1))).map(|(i, _)| i)
}
