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
use serde_json::Value;

/// The document is no contour stack.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// The text is not JSON of this form.
    #[error("not a sections document: {0}")]
    Json(#[from] serde_json::Error),
    /// The text is JSON, but not of this form.
    #[error("{place}: found {found}, expected {expected}")]
    Structure {
        /// Where: plane and contour, counted from 0.
        place: String,
        /// What is there.
        found: String,
        /// What should be there.
        expected: &'static str,
    },
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
    let document: Document = serde_json::from_str(text).map_err(|e| diagnosed(text, e))?;
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

/// The plane and contour at which a document departs from the form, where it is JSON at all.
fn diagnosed(text: &str, error: serde_json::Error) -> FormatError {
    if let Ok(document) = serde_json::from_str::<Value>(text) {
        return departure(&document).unwrap_or(FormatError::Json(error));
    }
    // JSON knows no such numbers; some programs write them all the same.
    let nulls = text.replace("-Infinity", "null").replace("Infinity", "null").replace("NaN", "null");
    match serde_json::from_str::<Value>(&nulls).ok().and_then(|document| departure(&document)) {
        Some(FormatError::Structure { place, found, expected }) => {
            FormatError::Structure { place, found: found.replace("null", "NaN or Infinity"), expected }
        }
        _ => FormatError::Json(error),
    }
}

fn departure(document: &Value) -> Option<FormatError> {
    if let Some(units) = document.get("units").and_then(Value::as_str).filter(|u| *u != "mm") {
        return Some(FormatError::Units(units.to_owned()));
    }
    for key in ["units", "frame"] {
        if !document.get(key).is_some_and(Value::is_string) {
            return Some(fault(
                "the document".into(),
                document.get(key),
                if key == "units" {
                    "\"units\":\"mm\""
                } else {
                    "\"frame\":\"LPS\", or \"stack\" together with \"patient_from_stack\""
                },
            ));
        }
    }
    let Some(planes) = document.get("planes").and_then(Value::as_array) else {
        return Some(fault("the document".into(), document.get("planes"), "\"planes\": a list of planes"));
    };
    planes.iter().enumerate().find_map(|(k, plane)| plane_departure(k, plane))
}

fn plane_departure(k: usize, plane: &Value) -> Option<FormatError> {
    if !plane.get("z_mm").is_some_and(Value::is_number) {
        return Some(fault(format!("plane {k}"), plane.get("z_mm"), "\"z_mm\": a height in mm"));
    }
    let Some(contours) = plane.get("contours").and_then(Value::as_array) else {
        return Some(fault(format!("plane {k}"), plane.get("contours"), "\"contours\": a list of contours"));
    };
    contours.iter().enumerate().find_map(|(c, contour)| {
        let Some(points) = contour.as_array() else {
            return Some(fault(format!("plane {k}, contour {c}"), Some(contour), "a list of points [x, y]"));
        };
        let is_point =
            |p: &Value| p.as_array().is_some_and(|p| p.len() == 2 && p.iter().all(Value::is_number));
        let bad = points.iter().position(|p| !is_point(p))?;
        Some(fault(
            format!("plane {k}, contour {c}, point {bad}"),
            points.get(bad),
            "two numbers [x, y] in mm",
        ))
    })
}

fn fault(place: String, found: Option<&Value>, expected: &'static str) -> FormatError {
    let text = found.map_or_else(|| "nothing".to_owned(), Value::to_string);
    let short: String = text.chars().take(40).collect();
    let found = if short.len() < text.len() { format!("{short}...") } else { text };
    FormatError::Structure { place, found, expected }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn document(planes: &str) -> String {
        format!(r#"{{"units":"mm","frame":"LPS","planes":[{{"z_mm":0,"contours":[]}},{planes}]}}"#)
    }

    #[test]
    fn a_damaged_document_is_named_with_plane_and_contour() {
        for (text, message) in [
            (
                document(r#"{"z_mm":3,"contours":[[],[[0,0],[1,"a"]]]}"#),
                r#"plane 1, contour 1, point 1: found [1,"a"], expected two numbers [x, y] in mm"#,
            ),
            (
                document(r#"{"z_mm":3,"contours":[[[0,0],[1,null]]]}"#),
                "plane 1, contour 0, point 1: found [1,null], expected two numbers [x, y] in mm",
            ),
            (
                document(r#"{"z_mm":3,"contours":[{"points":[]}]}"#),
                r#"plane 1, contour 0: found {"points":[]}, expected a list of points [x, y]"#,
            ),
            (
                document(r#"{"z":3,"contours":[]}"#),
                r#"plane 1: found nothing, expected "z_mm": a height in mm"#,
            ),
            (document(r#"{"z_mm":3}"#), r#"plane 1: found nothing, expected "contours": a list of contours"#),
            (
                r#"{"units":"mm","frame":"LPS"}"#.into(),
                r#"the document: found nothing, expected "planes": a list of planes"#,
            ),
            (
                r#"{"frame":"LPS","planes":[]}"#.into(),
                r#"the document: found nothing, expected "units":"mm""#,
            ),
            (
                r#"{"units":"cm","frame":"LPS","planes":[]}"#.into(),
                r#"units is "cm", expected "mm": convert the coordinates and say "units":"mm""#,
            ),
            (
                r#"{"units":"cm","frame":"LPS","planes":7}"#.into(),
                r#"units is "cm", expected "mm": convert the coordinates and say "units":"mm""#,
            ),
            (
                r#"{"units":"mm","frame":"RAS","planes":[]}"#.into(),
                r#"frame is "RAS": expected "LPS", or "stack" together with "patient_from_stack""#,
            ),
            (
                r#"{"units":"mm","frame":"stack","planes":[]}"#.into(),
                r#"frame is "stack": expected "LPS", or "stack" together with "patient_from_stack""#,
            ),
        ] {
            assert_eq!(from_json(&text).unwrap_err().to_string(), message, "{text}");
        }
        let nan = from_json(&document(r#"{"z_mm":NaN,"contours":[]}"#)).unwrap_err().to_string();
        assert_eq!(nan, "plane 1: found NaN or Infinity, expected \"z_mm\": a height in mm");
        let broken = from_json("{]").unwrap_err().to_string();
        assert!(broken.starts_with("not a sections document: ") && broken.contains("line 1"), "{broken}");
    }
}
