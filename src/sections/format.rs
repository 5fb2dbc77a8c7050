//! `sections.json`: contours of all planes as a document (the format is fixed, see [`to_json`]).
//!
//! ```
//! let text = r#"{"units":"mm","frame":"LPS","planes":[{"z_mm":0.0,"contours":[[[0,0],[1,0],[0,1]]]}]}"#;
//! let stack = lumenfab::sections::format::from_json(text).unwrap();
//! assert_eq!(stack.planes[0].contours[0].len(), 3);
//! ```

use super::{PlaneSections, SectionStack};
use crate::geom::RigidTransform;
use serde::{Deserialize, Serialize};

/// The document is no contour stack.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// The text is not JSON of this form.
    #[error("not a sections document: {0}")]
    Json(#[from] serde_json::Error),
    /// Other units than mm.
    #[error("units is {0:?}, expected \"mm\": convert the coordinates and say \"units\":\"mm\"")]
    Units(String),
    /// Neither LPS nor stack, or a stack without its place in the patient.
    #[error("frame is {0:?}: expected \"LPS\", or \"stack\" together with \"patient_from_stack\"")]
    Frame(String),
}

#[derive(Serialize, Deserialize)]
struct Document {
    units: String,
    frame: String,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    patient_from_stack: Option<RigidTransform>,
    planes: Vec<PlaneSections>,
}

/// Reads a stack. The geometry itself is not checked here (crossing contours, order of planes): the topology
/// stage does, because it can say what to do about it.
///
/// # Errors
/// [`FormatError`], with line and column where the text is no JSON of this form.
pub fn from_json(text: &str) -> Result<SectionStack, FormatError> {
    let document: Document = serde_json::from_str(text)?;
    if document.units != "mm" {
        return Err(FormatError::Units(document.units));
    }
    let patient_from_stack = match (document.frame.as_str(), document.patient_from_stack) {
        ("LPS", _) => RigidTransform::identity(),
        ("stack", Some(transform)) => transform,
        _ => return Err(FormatError::Frame(document.frame)),
    };
    Ok(SectionStack { planes: document.planes, patient_from_stack })
}

/// Writes a stack as one JSON document: `units` "mm", `frame` "LPS" (or "stack" with the 16 numbers of
/// `patient_from_stack`, row by row), `planes` with `z_mm` and `contours` of `[x, y]`.
///
/// # Errors
/// Where a coordinate is not finite.
pub fn to_json(stack: &SectionStack) -> Result<String, FormatError> {
    let oblique = !stack.patient_from_stack.is_identity();
    let document = Document {
        units: "mm".into(),
        frame: if oblique { "stack" } else { "LPS" }.into(),
        patient_from_stack: oblique.then_some(stack.patient_from_stack),
        planes: stack.planes.clone(),
    };
    Ok(serde_json::to_string(&document)?)
}
