//! The boundary representation of the vessel and its exact sections.
//!
//! Contours of all planes become one or two closed skins of B-spline surfaces: a tube for every branch (C2, z is
//! its parameter v), three patches in a thin slab at every split, merge or closing ring, flat caps at the stack's ends,
//! domes where branches or holes begin and end inside it. The method is
//! the published three-patch construction (lateral, lateral, saddle) on an implicit field that is fitted to the
//! sections on both sides of the event, so that the crotch lies where they say.
//!
//! The outer skin of a wall goes through the same steps with sections of the parallel surface.
//!
//! What it does not do: test what it made (that is `brep::check`).

mod assemble;
mod between;
mod bias;
mod corners;
mod critical;
mod distance;
mod dome;
mod event;
mod fit;
mod grid;
mod iso;
mod lean;
mod lobes;
mod lumen;
mod mend;
mod neck;
mod notch;
mod section;
mod sites;
mod skin;
mod slab;
mod sound;
mod spacing;
mod steady;
mod stored;
mod sweep;
mod tangent;
mod tip;
mod wall;
mod weld;

pub use event::{Crotch, EventFault, Slab};
pub use skin::{BranchFault, Correspondence, End, Skin, Tube};
pub use wall::Thickness;
pub use weld::Weld;

use crate::ct::Warning;
use crate::geom::Region;
use crate::progress::{Cancelled, Task};
use crate::sections::SectionStack;
use crate::topology;
use serde::{Deserialize, Serialize};

/// What a horizontal plane cuts out of the body. Stack frame, mm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CrossSection {
    /// What is enclosed by the outer skin (for a cast: by the lumen's skin, which is then the outer one).
    pub outer: Region,
    /// The lumen inside a hollow wall; empty for a cast.
    pub lumen: Region,
}

impl CrossSection {
    /// What is to be filled with material: the outer region without the lumen.
    #[must_use]
    pub fn material(&self) -> Region {
        self.outer.difference(&self.lumen)
    }
}

/// A body that can be cut at any height.
pub trait Sectioned: Sync {
    /// Lowest and highest z of the body in the stack frame, mm.
    fn z_range_mm(&self) -> [f64; 2];

    /// The section at `z_mm`; the polygons' vertices lie on the surface, their chords within `tolerance_mm` of it.
    /// Empty outside the z range.
    fn section(&self, z_mm: f64, tolerance_mm: f64) -> CrossSection;
}

/// What is built around the lumen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Body {
    /// A wall of this thickness around the open lumen.
    Wall {
        /// Thickness, mm.
        wall_mm: f64,
    },
    /// The lumen as a solid body.
    Cast,
}

/// What to build, and how contours are put together where that is not the same for all.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Params {
    /// Hollow wall or cast.
    pub body: Body,
    /// Which points of neighbouring sections correspond.
    pub correspondence: Correspondence,
    /// What the operator has decided about the topology.
    pub decisions: topology::Decisions,
}

impl Params {
    /// The body, everything else by default.
    #[must_use]
    pub fn new(body: Body) -> Self {
        Self { body, correspondence: Correspondence::default(), decisions: topology::Decisions::default() }
    }
}

/// Where in the stack a fault lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Place {
    /// Between two CT planes, counted from 0 as they were given.
    Planes {
        /// The lower plane.
        lower: usize,
        /// The upper plane.
        upper: usize,
        /// Heights that the fault lies between, mm; those of computed planes where there are some in between.
        z_mm: [f64; 2],
    },
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Planes { lower, upper, z_mm: [low, high] } => {
                write!(f, "between planes {lower} and {upper} (z {low:.2} to {high:.2} mm)")
            }
        }
    }
}

/// No solid can be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The contours do not make a graph.
    #[error(transparent)]
    Topology(#[from] topology::Error),
    /// An event cannot be built.
    #[error("{place}: {fault}: look at the contours of these planes and correct them")]
    Event {
        /// Where.
        place: Place,
        /// Why.
        fault: EventFault,
    },
    /// A branch has no surface.
    #[error(
        "the branch from z {:.2} to {:.2} mm: {fault}: look at the contours there and correct them",
        z_mm[0], z_mm[1]
    )]
    Branch {
        /// Its lowest and highest section, or the events that it lies between.
        z_mm: [f64; 2],
        /// Why.
        fault: BranchFault,
    },
    /// The skin does not run through a contour.
    #[error(
        "plane {plane} (z {z_mm} mm): the surface misses a contour by {off_mm:.4} mm where at most 0.001 mm are allowed: look for a contour with a sharp spike there, and smooth or redraw it"
    )]
    Missed {
        /// Plane, counted from 0 as it was given.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
        /// How far the farthest of its points lies from the surface, mm.
        off_mm: f64,
    },
    /// A wall thickness that no printer and no vessel has.
    #[error("wall thickness is {0} mm: it must lie between 0.1 and 20 mm")]
    WallThickness(f64),
    /// The outer skin cannot be built.
    #[error(
        "outer skin of the wall, z {:.2} to {:.2} mm: {fault}: look at the contours there, or choose another wall thickness",
        z_mm[0], z_mm[1]
    )]
    Outer {
        /// Heights between which the fault lies, where it is known.
        z_mm: [f64; 2],
        /// Why.
        fault: EventFault,
    },
    /// A branch of the outer skin has no surface.
    #[error(
        "outer skin of the wall, the branch from z {:.2} to {:.2} mm: {fault}: look at the contours there, or choose \
         another wall thickness",
        z_mm[0], z_mm[1]
    )]
    OuterBranch {
        /// Its lowest and highest section, or the events that it lies between.
        z_mm: [f64; 2],
        /// Why.
        fault: BranchFault,
    },
    /// The outer skin comes far too near to the lumen, or lies inside it.
    #[error(
        "z {:.2} mm, x {:.2}, y {:.2}: the wall would be {least_mm:.2} mm thick{} where {asked_mm:.2} mm were asked: choose another wall thickness, add planes near this height, or look at the contours there",
        at_mm[2], at_mm[0], at_mm[1], if *least_mm <= 0.0 { " (its outer skin lies inside the lumen)" } else { "" }
    )]
    ThinWall {
        /// What was asked for, mm.
        asked_mm: f64,
        /// What it would be, mm.
        least_mm: f64,
        /// Where, stack frame.
        at_mm: [f64; 3],
    },
    /// The lumen has no surface that a wall could be put around.
    #[error("the lumen has no surface to put a wall around: look at the contours")]
    NoOuterSkin,
    /// The outer skin's sections make no graph.
    #[error(
        "the outlines of the wall make no skin (of computed planes and contours: {0}): look at the lumen's contours near that height, or choose another wall thickness"
    )]
    OuterTopology(topology::Error),
    /// The work was interrupted.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Which skins of a solid are looked at: those of the whole body or the lumen's alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SkinChoice {
    /// The body as printed: the wall between both skins, or the cast.
    All,
    /// The lumen alone, closed by its caps.
    Lumen,
}

/// A vessel as a solid: one skin (a cast) or two (a wall around the open lumen).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Solid {
    /// The lumen's skin.
    pub lumen: Skin,
    /// The outer skin of a wall.
    pub outer: Option<Skin>,
}

/// A solid and what was decided by rule on the way to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Built {
    /// The solid.
    pub solid: Solid,
    /// Which contour continues which in the lumen, and why.
    pub matching: topology::Matching,
    /// What was left out or decided by rule, and where the wall is not as thick as asked.
    pub warnings: Vec<Warning>,
    /// How thick the wall is, as built.
    pub thickness: Option<Thickness>,
}

/// Builds the solid through all sections of a stack.
///
/// # Errors
/// [`Error`], naming the planes.
pub fn build(stack: &SectionStack, params: &Params, task: &Task<'_>) -> Result<Built, Error> {
    // On a thread of the pool: one from outside it would wait for another one to wake at every parallel step.
    rayon::scope(|_| built(stack, params, task))
}

fn built(stack: &SectionStack, params: &Params, task: &Task<'_>) -> Result<Built, Error> {
    let wall_mm = match params.body {
        Body::Cast => None,
        Body::Wall { wall_mm } if (0.1..=20.0).contains(&wall_mm) => Some(wall_mm),
        Body::Wall { wall_mm } => return Err(Error::WallThickness(wall_mm)),
    };
    let graph = topology::graph_decided_by(stack, &params.decisions)?;
    let (lumen, about_lumen) = lumen::build(&graph, params.correspondence, task)?;
    let matching = topology::Matching::of(&graph);
    let mut warnings = graph.warnings;
    warnings.extend(about_lumen);
    let (mut outer, mut thickness) = (None, None);
    if let Some(wall_mm) = wall_mm {
        let built = wall::build(&lumen, wall_mm, task)?;
        outer = Some(built.skin);
        thickness = built.thickness;
        warnings.extend(built.warnings);
    }
    Ok(Built { solid: Solid { lumen, outer }, matching, warnings, thickness })
}

impl Sectioned for Solid {
    fn z_range_mm(&self) -> [f64; 2] {
        self.outer.as_ref().unwrap_or(&self.lumen).z_range_mm()
    }

    fn section(&self, z_mm: f64, tolerance_mm: f64) -> CrossSection {
        let lumen = Region::new(self.lumen.section(z_mm, tolerance_mm));
        match &self.outer {
            None => CrossSection { outer: lumen, lumen: Region::default() },
            Some(outer) => CrossSection { outer: Region::new(outer.section(z_mm, tolerance_mm)), lumen },
        }
    }
}

#[cfg(test)]
mod tests;
