//! Cubic B-splines: knot vectors, interpolation, curves and surfaces.
//!
//! Two kinds of interpolation are used by the solid (de Boor, *A Practical Guide to Splines*, 2001):
//!
//! - along z and inside patches: not-a-knot cubic splines through given parameters ([`Basis::not_a_knot`]); they
//!   reproduce cubics and, with z as parameter, z itself, so that a section at any height is an iso-curve;
//! - round a contour: closed cubic splines, uniform in the surface's u ([`periodic_control_points`]) and by chord
//!   length through measured points ([`ClosedCurve`]).
//!
//! All solves are banded and O(n). Curves and surfaces can be refined and cut exactly ([`Basis::refinement`]), so that
//! two faces share one curve and not two that are alike.

mod basis;
mod closed;
mod curve;
mod surface;

pub use basis::{Basis, Malformed, Span, SplineError};
pub use closed::{ClosedCurve, periodic_control_points};
pub use curve::Curve;
pub use surface::{Jet, PatchRow, PatchSurface, SectionCurve, Side, TubeJet, TubeNet, TubeRing, TubeSurface};
