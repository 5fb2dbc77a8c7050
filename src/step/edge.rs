//! Edges: a curve in space and, for each use by a spline face, the straight trace it has in the parameters of that face.
//!
//! Traces are part of the body, so they are written and not left for the reader to find by projection: where a face
//! touches itself (the top row of a lateral at a crease begins and ends at one point) a projection cannot tell one end
//! from the other. A trace has the curve's own parameter: at each value both give the same point.

use super::Context;
use super::entities::{Entities, knots, length, logical, parameter, references};
use crate::brep::{Brep, Edge};
use crate::spline::Curve;

/// A coedge of a spline face.
#[derive(Debug, Clone, Copy)]
struct Use {
    surface: usize,
    trace: [[f64; 2]; 2],
    /// Whether it runs along the edge's curve in the loop that goes round the surface's own normal.
    is_forward: bool,
}

/// Writes the edges over their vertices; surfaces are those of the faces.
pub(super) fn write(
    out: &mut Entities,
    brep: &Brep,
    vertices: &[usize],
    surfaces: &[usize],
    context: Context,
) -> Vec<usize> {
    let uses = uses(brep, surfaces);
    let curves = brep.edges.iter().zip(&uses).map(|(e, uses)| traced(out, &e.curve, uses, context));
    let curves: Vec<usize> = curves.collect();
    let edge = |(e, curve): (&Edge, usize)| {
        out.add(&format!("EDGE_CURVE('',#{},#{},#{curve},.T.)", vertices[e.start], vertices[e.end]))
    };
    brep.edges.iter().zip(curves).map(edge).collect()
}

/// The uses of each edge by spline faces; of a seam the one along its curve first.
fn uses(brep: &Brep, surfaces: &[usize]) -> Vec<Vec<Use>> {
    let mut uses = vec![Vec::new(); brep.edges.len()];
    for (face, &surface) in brep.faces.iter().zip(surfaces).filter(|(f, _)| f.surface.spline().is_some()) {
        for c in face.loops.iter().flat_map(|l| &l.coedges) {
            uses[c.edge].push(Use { surface, trace: c.trace, is_forward: c.is_forward == face.is_outward });
        }
    }
    uses.iter_mut().for_each(|u| u.sort_by_key(|u| (u.surface, !u.is_forward)));
    uses
}

/// A curve with its traces.
fn traced(out: &mut Entities, curve: &Curve, uses: &[Use], context: Context) -> usize {
    let in_space = spatial(out, curve);
    let traces: Vec<usize> = uses.iter().map(|u| trace(out, u, curve.range(), context)).collect();
    let kind = match uses {
        [] => return in_space,
        [a, b] if a.surface == b.surface => "SEAM_CURVE",
        _ => "SURFACE_CURVE",
    };
    out.add(&format!("{kind}('',#{in_space},{},.CURVE_3D.)", references(&traces)))
}

fn spatial(out: &mut Entities, curve: &Curve) -> usize {
    let points: Vec<usize> = curve.control().iter().map(|&p| out.point(p)).collect();
    let (times, values) = knots(curve.basis());
    let [start, end] = curve.ends();
    let is_closed = logical(length((end - start).norm()) == "0.");
    out.add(&format!(
        "B_SPLINE_CURVE_WITH_KNOTS('',{},{},.UNSPECIFIED.,{is_closed},.F.,{times},{values},.UNSPECIFIED.)",
        curve.basis().degree(),
        references(&points)
    ))
}

/// A straight line over the range of the edge's curve; a `LINE` would run at unit speed in some readers.
fn trace(out: &mut Entities, of: &Use, range: [f64; 2], context: Context) -> usize {
    let points = of.trace.map(|uv| out.point_on_surface(uv));
    let [first, last] = range.map(parameter);
    let line = out.add(&format!(
        "B_SPLINE_CURVE_WITH_KNOTS('',1,{},.UNSPECIFIED.,.F.,.F.,(2,2),({first},{last}),.UNSPECIFIED.)",
        references(&points)
    ));
    let on_surface = out.add(&format!("DEFINITIONAL_REPRESENTATION('',(#{line}),#{})", context.parameters));
    out.add(&format!("PCURVE('',#{},#{on_surface})", of.surface))
}
