//! A boundary representation as a STEP file (ISO 10303-21, schema AP242).
//!
//! Spline faces are written as `B_SPLINE_SURFACE_WITH_KNOTS` with clamped knots, flat caps as `PLANE`, edges once each as
//! `EDGE_CURVE` on a `B_SPLINE_CURVE_WITH_KNOTS` that both faces share, with a `PCURVE` for each use by a spline face; one
//! `MANIFOLD_SOLID_BREP` (or `BREP_WITH_VOIDS`) a body. Lengths are mm, to 1e-9 mm. The file carries no name, no source and a fixed time stamp:
//! the same body gives the same bytes.
//!
//! Pure: it makes the text; writing it is the caller's.

mod edge;
mod entities;
mod shape;
#[cfg(test)]
mod tests;

use crate::brep::Brep;
use entities::Entities;

/// The text of a STEP file.
#[must_use]
pub fn to_step(brep: &Brep) -> String {
    let mut entities = Entities::default();
    let context = product_context(&mut entities);
    shape::write(&mut entities, brep, context);
    format!("{HEADER}{}ENDSEC;\nEND-ISO-10303-21;\n", entities.into_text())
}

const HEADER: &str = "ISO-10303-21;
HEADER;
FILE_DESCRIPTION(('vessel model'),'2;1');
FILE_NAME('vessel','1970-01-01T00:00:00',(''),(''),'lumenfab','lumenfab','');
FILE_SCHEMA(('AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF { 1 0 10303 442 1 1 4 }'));
ENDSEC;
DATA;
";

/// The contexts of what lies in space and of what lies in the parameters of a surface, and the definition of the shape.
#[derive(Debug, Clone, Copy)]
struct Context {
    geometry: usize,
    parameters: usize,
    product_shape: usize,
}

/// Application, product and units.
fn product_context(out: &mut Entities) -> Context {
    let application = out.add("APPLICATION_CONTEXT('managed model based 3d engineering')");
    out.add(&format!(
        "APPLICATION_PROTOCOL_DEFINITION('international standard','ap242_managed_model_based_3d_engineering',2020,#{application})"
    ));
    let discipline = out.add(&format!("PRODUCT_CONTEXT('',#{application},'mechanical')"));
    let product = out.add(&format!("PRODUCT('vessel','vessel','',(#{discipline}))"));
    out.add(&format!("PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,(#{product}))"));
    let formation = out.add(&format!("PRODUCT_DEFINITION_FORMATION('','',#{product})"));
    let stage = out.add(&format!("PRODUCT_DEFINITION_CONTEXT('part definition',#{application},'design')"));
    let definition = out.add(&format!("PRODUCT_DEFINITION('design','',#{formation},#{stage})"));
    let product_shape = out.add(&format!("PRODUCT_DEFINITION_SHAPE('','',#{definition})"));
    let length = out.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))");
    let angle = out.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))");
    let solid_angle = out.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())");
    // Edges, vertices and surfaces are each within 1e-6 mm of the next ones: two of them, and the rounding of what is written.
    let uncertainty = out.add(&format!(
        "UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-05),#{length},'distance_accuracy_value','')"
    ));
    let geometry = out.add(&format!(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{uncertainty}))\
GLOBAL_UNIT_ASSIGNED_CONTEXT((#{length},#{angle},#{solid_angle}))REPRESENTATION_CONTEXT('',''))"
    ));
    let parameters = out.add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(2)PARAMETRIC_REPRESENTATION_CONTEXT()REPRESENTATION_CONTEXT('',''))",
    );
    Context { geometry, parameters, product_shape }
}
