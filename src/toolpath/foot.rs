//! Layers at the foot of a part of which no bead can be printed: specks of another program's model below it, the point of a cone.
//!
//! What is printed has to begin on the bed, so they are left out and the part stands on its lowest layer that has a bead.

use super::fill::{self, FillParams, Thin};
use super::skin::Skins;
use super::{Error, OUTLINE_TOLERANCE_MM, fill_params, place, without_dust};
use crate::ct::Warning;
use crate::profile::Profile;
use crate::slice::{Layer, LayerSlot};
use crate::units::counted;

/// A layer that is left out.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bare {
    pub(super) slot: LayerSlot,
    pub(super) params: FillParams,
    pub(super) thin: Option<Thin>,
}

/// The lowest layers as far as none has a bead; none of a part that has no bead at all, of which all is told as ever.
///
/// # Errors
/// Nothing to print, or a part larger than the bed.
pub(super) fn bare(layers: &[Layer], profile: &Profile) -> Result<Vec<Bare>, Error> {
    let placement = place::place(layers, profile)?;
    let mut bare = Vec::new();
    for layer in layers {
        let params = fill_params(profile, layer.slot.height_mm);
        let (material, _) = placement.layer(layer, true, profile);
        let material = without_dust(material, params.width_mm);
        let skins = Skins::try_new(&material, params.cap_mm(), OUTLINE_TOLERANCE_MM);
        let filled = skins.map(|skins| fill::fill(&skins, &params));
        if filled.as_ref().is_some_and(|f| !f.paths.is_empty()) {
            return Ok(bare);
        }
        bare.push(Bare { slot: layer.slot, params, thin: filled.and_then(|f| f.thin) });
    }
    Ok(Vec::new())
}

/// Tells what was left out.
pub(super) fn warning(left_out: &[Layer]) -> Option<Warning> {
    let (layer, outline) = left_out.iter().find_map(|l| Some((l, l.material.contours.first()?)))?;
    let down_mm: f64 = left_out.iter().map(|l| l.slot.height_mm).sum();
    let text = format!(
        "nothing in the lowest {} is large enough for a bead, the first at {}: left out, and the rest set down by {down_mm:.2} mm, onto the bed",
        counted(left_out.len(), "layer"),
        place::told(outline.points[0], layer.slot.z_mid_mm)
    );
    Some(Warning::new("toolpath.bare_foot", text))
}
