//! Bodies, shells, faces and their surfaces.

use super::entities::{Entities, knots, list, logical, references};
use super::{Context, edge};
use crate::brep::{Body, Brep, Face, Loop, Shell, Surface};
use crate::geom::{Point3, Vector3};
use crate::spline::PatchSurface;

/// Writes all bodies as one shape of the product.
pub(super) fn write(out: &mut Entities, brep: &Brep, context: Context) {
    let vertices: Vec<usize> = brep
        .vertices
        .iter()
        .map(|v| {
            let point = out.point(v.point);
            out.add(&format!("VERTEX_POINT('',#{point})"))
        })
        .collect();
    let surfaces: Vec<usize> = brep.faces.iter().map(|f| surface(out, &f.surface)).collect();
    let edges = edge::write(out, brep, &vertices, &surfaces, context);
    let faces: Vec<usize> =
        brep.faces.iter().zip(surfaces).map(|(f, surface)| face(out, f, surface, &edges)).collect();
    let mut items = vec![placement(out, Point3::origin())];
    items.extend(brep.bodies.iter().map(|b| body(out, b, &faces)));
    let shape = out.add(&format!(
        "ADVANCED_BREP_SHAPE_REPRESENTATION('',{},#{})",
        references(&items),
        context.geometry
    ));
    out.add(&format!("SHAPE_DEFINITION_REPRESENTATION(#{},#{shape})", context.product_shape));
}

fn body(out: &mut Entities, body: &Body, faces: &[usize]) -> usize {
    let shell = |out: &mut Entities, shell: &Shell| {
        let faces: Vec<usize> = shell.faces.iter().map(|&i| faces[i]).collect();
        out.add(&format!("CLOSED_SHELL('',{})", references(&faces)))
    };
    let outer = shell(out, &body.outer);
    if body.voids.is_empty() {
        return out.add(&format!("MANIFOLD_SOLID_BREP('',#{outer})"));
    }
    // Faces of a hollow point into it already: away from the material.
    let voids: Vec<usize> = body
        .voids
        .iter()
        .map(|hollow| {
            let shell = shell(out, hollow);
            out.add(&format!("ORIENTED_CLOSED_SHELL('',*,#{shell},.T.)"))
        })
        .collect();
    out.add(&format!("BREP_WITH_VOIDS('',#{outer},{})", references(&voids)))
}

fn face(out: &mut Entities, face: &Face, surface: usize, edges: &[usize]) -> usize {
    let bounds: Vec<usize> =
        face.loops.iter().enumerate().map(|(i, l)| bound(out, l, edges, i == 0)).collect();
    out.add(&format!("ADVANCED_FACE('',{},#{surface},{})", references(&bounds), logical(face.is_outward)))
}

fn bound(out: &mut Entities, of: &Loop, edges: &[usize], is_outer: bool) -> usize {
    let uses: Vec<usize> = of
        .coedges
        .iter()
        .map(|c| out.add(&format!("ORIENTED_EDGE('',*,*,#{},{})", edges[c.edge], logical(c.is_forward))))
        .collect();
    let edge_loop = out.add(&format!("EDGE_LOOP('',{})", references(&uses)));
    let kind = if is_outer { "FACE_OUTER_BOUND" } else { "FACE_BOUND" };
    out.add(&format!("{kind}('',#{edge_loop},.T.)"))
}

/// A horizontal placement, its axis up.
fn placement(out: &mut Entities, at: Point3) -> usize {
    let (origin, up, along) = (out.point(at), out.direction(Vector3::z()), out.direction(Vector3::x()));
    out.add(&format!("AXIS2_PLACEMENT_3D('',#{origin},#{up},#{along})"))
}

fn surface(out: &mut Entities, surface: &Surface) -> usize {
    match surface {
        Surface::Plane(z_mm) => {
            let at = placement(out, Point3::new(0.0, 0.0, *z_mm));
            out.add(&format!("PLANE('',#{at})"))
        }
        Surface::Tube(s) => spline(out, s, true),
        Surface::Lateral(s) | Surface::Saddle(s) => spline(out, s, false),
    }
}

fn spline(out: &mut Entities, surface: &PatchSurface, is_closed: bool) -> usize {
    let [u, v] = surface.bases();
    let points: Vec<usize> = surface.control().map(|p| out.point(p)).collect();
    let columns = (0..u.len())
        .map(|i| references(&points.iter().copied().skip(i).step_by(u.len()).collect::<Vec<_>>()));
    let control = list(columns);
    let ((u_times, u_values), (v_times, v_values)) = (knots(u), knots(v));
    out.add(&format!(
        "B_SPLINE_SURFACE_WITH_KNOTS('',{},{},{control},.UNSPECIFIED.,{},.F.,.F.,{u_times},{v_times},{u_values},{v_values},.UNSPECIFIED.)",
        u.degree(),
        v.degree(),
        logical(is_closed)
    ))
}
