//! Why a stack makes no graph, in words that name plane and contour.

use super::check::{HIGHEST_MM, MOST_CONTOURS, MOST_PLANES, MOST_POINTS};
use super::decisions::Pick;

/// The stack cannot be turned into a graph.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// Fewer than two planes with contours.
    #[error("a solid needs contours on at least two planes; found {found}: add planes, or widen the z range")]
    TooFewPlanes {
        /// Planes with at least one contour.
        found: usize,
    },
    /// More planes than any scan has.
    #[error("the stack has {found} planes, expected at most {limit}: leave planes out", limit = MOST_PLANES)]
    TooManyPlanes {
        /// Planes in the stack.
        found: usize,
    },
    /// More contours than any vessel has branches.
    #[error(
        "plane {plane} (z {z_mm} mm) has {found} contours, expected at most {limit}: remove those that are not the vessel's",
        limit = MOST_CONTOURS
    )]
    TooManyContours {
        /// Plane, counted from 0.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
        /// Contours of the plane.
        found: usize,
    },
    /// The height of a plane is not a number, or beyond any stack.
    #[error(
        "plane {plane}: its height is {z_mm} mm, expected a number between -{limit} and {limit}: correct z_mm",
        limit = HIGHEST_MM
    )]
    PlaneHeight {
        /// Plane, counted from 0.
        plane: usize,
        /// Its height.
        z_mm: f64,
    },
    /// Two planes at one height.
    #[error("planes {first} and {second} lie at one height, z {z_mm} mm: drop one of them, or correct z_mm")]
    RepeatedPlane {
        /// One plane, counted from 0.
        first: usize,
        /// The other one.
        second: usize,
        /// Their height.
        z_mm: f64,
    },
    /// A contour that bounds no area.
    #[error("plane {plane} (z {z_mm} mm), contour {contour}: {fault}: redraw or remove it")]
    Contour {
        /// Plane, counted from 0.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
        /// Contour, counted from 0.
        contour: usize,
        /// What is wrong with it.
        fault: ContourFault,
    },
    /// Two contours of a plane cross.
    #[error("plane {plane} (z {z_mm} mm): contours {first} and {second} cross: join them or move them apart")]
    Crossing {
        /// Plane, counted from 0.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
        /// One contour, counted from 0.
        first: usize,
        /// The other one.
        second: usize,
    },
    /// Two contours of a plane are the same curve.
    #[error(
        "plane {plane} (z {z_mm} mm): contours {first} and {second} are the same curve: remove one of them"
    )]
    RepeatedContour {
        /// Plane, counted from 0.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
        /// One contour, counted from 0.
        first: usize,
        /// The other one.
        second: usize,
    },
    /// A plane without contours between planes that have some.
    #[error(
        "plane {plane} (z {z_mm} mm) has no contour, but planes below and above it have: draw one, or take the plane out of the stack"
    )]
    EmptyPlane {
        /// Plane, counted from 0.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
    },
    /// No contour is continued on any other plane.
    #[error("no contour overlaps one of the next plane: the planes lie too far apart, or in the wrong order")]
    NothingContinues,
    /// Overlap and drift of the branches contradict each other.
    #[error(
        "planes {lower_plane} and {upper_plane}: whether contour {lower} continues in contour {upper} cannot be \
         decided ({why}): say so in case.toml: [[topology.link]] plane = {lower_plane}, lower = {lower}, \
         upper = {upper}, join = true or false"
    )]
    Undecided {
        /// The lower plane, counted from 0.
        lower_plane: usize,
        /// The upper plane.
        upper_plane: usize,
        /// Contour of the lower plane, counted from 0.
        lower: usize,
        /// Contour of the upper plane.
        upper: usize,
        /// What speaks for and against it.
        why: String,
    },
    /// Several contours meet several others and no section between them parts them.
    #[error(
        "planes {lower_plane} and {upper_plane}: contours {lower:?} meet contours {upper:?} and no order of splits \
         and merges was found: decide in case.toml which belong together ([[topology.link]] plane = {lower_plane})"
    )]
    Meeting {
        /// The lower plane, counted from 0.
        lower_plane: usize,
        /// The upper plane.
        upper_plane: usize,
        /// Contours of the lower plane, counted from 0.
        lower: Vec<usize>,
        /// Contours of the upper plane.
        upper: Vec<usize>,
    },
    /// A decision of the operator names something that is not there.
    #[error("topology.{table} {entry} in case.toml: {fault}")]
    Decision {
        /// `link` or `drop`.
        table: &'static str,
        /// Which entry of the table, counted from 0.
        entry: usize,
        /// What is wrong with it.
        fault: DecisionFault,
    },
}

/// What is wrong with a contour.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ContourFault {
    /// A closed curve through fewer than this many points says nothing about its shape.
    #[error("it has {0} different points, at least 4 are needed")]
    TooFewPoints(usize),
    /// More points than any outline needs.
    #[error("it has {0} points, at most {limit} are expected", limit = MOST_POINTS)]
    TooManyPoints(usize),
    /// NaN, infinite or farther out than 5 m.
    #[error("point {0} is not a finite coordinate within 5 m")]
    NotFinite(usize),
    /// It goes out and comes back the same way.
    #[error("it encloses no area")]
    NoArea,
    /// It crosses itself.
    #[error("it crosses itself near x {0:.3}, y {1:.3} mm")]
    SelfCrossing(f64, f64),
}

/// What is wrong with a decision.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DecisionFault {
    /// No such plane.
    #[error("there is no plane {plane}, the planes are 0 to {last}")]
    NoPlane {
        /// The plane that was named.
        plane: usize,
        /// The last one there is.
        last: usize,
    },
    /// No plane above to link to.
    #[error("plane {0} is the uppermost: name the lower one of the two planes")]
    NoPlaneAbove(usize),
    /// Two entries say the opposite of one pair.
    #[error("an earlier entry says the opposite of these two contours: keep one of both")]
    Contradicted,
    /// One of the contours is left out by another entry.
    #[error("contour {contour} of plane {plane} is left out by [[topology.drop]]: keep one of both entries")]
    Dropped {
        /// The plane.
        plane: usize,
        /// The contour.
        contour: usize,
    },
    /// No such contour.
    #[error("{pick} is no contour of plane {plane}, which has {n_contours}")]
    NoContour {
        /// The plane.
        plane: usize,
        /// The contour that was named.
        pick: Pick,
        /// How many there are.
        n_contours: usize,
    },
}
