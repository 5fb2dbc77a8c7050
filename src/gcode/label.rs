//! What belongs to the object, in the firmware's words, so that it can be left out of a print that goes on.

use crate::geom::Bounds2;
use crate::profile::ObjectLabels;
use crate::toolpath::Toolpaths;

/// The object's name: a job has one, and it tells nothing of the patient.
const NAME: &str = "part";

/// Said once, before the first layer.
pub(super) fn defined(style: ObjectLabels, paths: &Toolpaths) -> Option<String> {
    match style {
        ObjectLabels::M486 => Some("M486 T1".to_owned()),
        ObjectLabels::ExcludeObject => {
            let bounds = paths.layers.iter().filter_map(|l| l.material.bounds()).reduce(Bounds2::union)?;
            let (low, high) = (bounds.min, bounds.max);
            let middle = nalgebra::center(&low, &high);
            Some(format!(
                "EXCLUDE_OBJECT_DEFINE NAME={NAME} CENTER={:.3},{:.3} \
                 POLYGON=[[{x0:.3},{y0:.3}],[{x1:.3},{y0:.3}],[{x1:.3},{y1:.3}],[{x0:.3},{y1:.3}]]",
                middle.x,
                middle.y,
                x0 = low.x,
                y0 = low.y,
                x1 = high.x,
                y1 = high.y,
            ))
        }
        ObjectLabels::None => None,
    }
}

/// Said where the object begins in a layer.
pub(super) fn begin(style: ObjectLabels) -> Option<String> {
    match style {
        ObjectLabels::M486 => Some("M486 S0".to_owned()),
        ObjectLabels::ExcludeObject => Some(format!("EXCLUDE_OBJECT_START NAME={NAME}")),
        ObjectLabels::None => None,
    }
}

/// Said where it ends.
pub(super) fn end(style: ObjectLabels) -> Option<String> {
    match style {
        ObjectLabels::M486 => Some("M486 S-1".to_owned()),
        ObjectLabels::ExcludeObject => Some(format!("EXCLUDE_OBJECT_END NAME={NAME}")),
        ObjectLabels::None => None,
    }
}
