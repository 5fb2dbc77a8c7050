//! What can be wrong with a boundary representation, and where.

use crate::geom::Point3;

/// A fault of a boundary representation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// An edge is not used by exactly two coedges.
    EdgeUses(usize),
    /// Both uses of an edge run the same way.
    Misoriented,
    /// A coedge does not begin where the one before ends.
    LoopOpen,
    /// A face without a border, or an index that names nothing.
    Incomplete,
    /// The end of an edge's curve is not at its vertex, mm.
    OffVertex(f64),
    /// An edge's curve is not on the surface of its face, mm.
    OffSurface(f64),
    /// An edge of no length.
    ZeroLength,
    /// A surface folds or degenerates.
    Folded,
    /// Faces cross, or come through each other.
    Crossing,
    /// Material lies on the wrong side.
    InsideOut,
    /// A shell's faces do not hang together.
    Disconnected,
    /// A hollow that lies in no body.
    StrayVoid,
    /// V - E + F - R and 2 (S - G).
    Euler {
        /// Vertices less edges plus faces less inner loops.
        found: i64,
        /// Twice the shells less the handles that the branches make.
        expected: i64,
    },
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::EdgeUses(n) => write!(f, "an edge is used {n} times instead of twice"),
            Self::Misoriented => write!(f, "both faces of an edge run along it the same way"),
            Self::LoopOpen => write!(f, "the border of a face is not closed"),
            Self::Incomplete => write!(f, "a face has no border or names a missing edge"),
            Self::OffVertex(mm) => write!(f, "an edge ends {mm:.2e} mm from its vertex"),
            Self::OffSurface(mm) => write!(f, "an edge lies {mm:.2e} mm off its face"),
            Self::ZeroLength => write!(f, "an edge has no length"),
            Self::Folded => write!(f, "the surface folds over"),
            Self::Crossing => write!(f, "the surface crosses itself or another one"),
            Self::InsideOut => write!(f, "the surface is inside out"),
            Self::Disconnected => write!(f, "a shell falls apart"),
            Self::StrayVoid => write!(f, "a hollow lies outside every body"),
            Self::Euler { found, expected } => {
                write!(f, "V - E + F - R is {found}, but 2 (S - G) is {expected}")
            }
        }
    }
}

/// A fault with its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// What is wrong.
    pub kind: Kind,
    /// Index of the face, where one can be named.
    pub face: Option<usize>,
    /// What that face is.
    pub part: &'static str,
    /// Where, mm, stack frame.
    pub at: Point3,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Point3 { coords } = self.at;
        write!(f, "z {:.2} mm, x {:.2}, y {:.2} ({}", coords.z, coords.x, coords.y, self.part)?;
        match self.face {
            Some(face) => write!(f, ", face {face}): {}", self.kind),
            None => write!(f, "): {}", self.kind),
        }
    }
}

/// More faults than this say nothing more: no more are listed.
pub(super) const MOST_FAULTS: usize = 100;

/// The faults of an invalid solid; at least one, at most a hundred.
#[derive(Debug, Clone, PartialEq)]
pub struct Invalid(pub Vec<Fault>);

impl std::fmt::Display for Invalid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the solid is not valid: ")?;
        if let Some(first) = self.0.first() {
            write!(f, "{first}")?;
        }
        if self.0.len() > 1 {
            let or_more = if self.0.len() < MOST_FAULTS { "" } else { "at least " };
            write!(f, "; and {or_more}{} more", self.0.len() - 1)?;
        }
        write!(f, ": look at the contours at this height and correct them")
    }
}

impl std::error::Error for Invalid {}
