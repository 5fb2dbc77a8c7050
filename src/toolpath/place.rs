//! Layers from the stack frame onto the bed, with the compensations of the profile.
//!
//! The part is only moved: its bounding box is centred on the bed, its lowest layer stands on it. Then,
//! where the profile asks for it: scaled up in the bed's plane against shrinkage, the lumen's outline
//! moved against hole shrinkage, the first layer's outlines moved against spreading.

use super::Error;
use crate::geom::{Bounds2, Contour, Point2, Region, RigidTransform, Vector3};
use crate::profile::Profile;
use crate::slice::Layer;

/// Chord tolerance of compensated outlines, mm.
const TOLERANCE_MM: f64 = 1e-3;

/// Where the stack lies on the bed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    pub(super) bed_from_stack: RigidTransform,
    by: Vector3,
    centre: Point2,
    scale: f64,
}

/// Finds the place of the layers on the bed.
pub(super) fn place(layers: &[Layer], profile: &Profile) -> Result<Placement, Error> {
    let bed = profile.machine.bed_mm;
    let bounds =
        layers.iter().filter_map(|l| l.material.bounds()).reduce(Bounds2::union).ok_or(Error::Empty)?;
    let bottom = layers[0].slot.z_mid_mm - layers[0].slot.height_mm / 2.0;
    let height: f64 = layers.iter().map(|l| l.slot.height_mm).sum();
    let scale = 1.0 / (1.0 - profile.filament.shrinkage_percent / 100.0);
    let size = bounds.size() * scale;
    let part_mm = [size.x, size.y, height];
    // Written so that NaN is refused too.
    if !part_mm.iter().zip(bed).all(|(part, bed)| *part <= bed) {
        return Err(Error::LargerThanBed { part_mm, bed_mm: bed });
    }
    let centre = Point2::new(bed[0] / 2.0, bed[1] / 2.0);
    let middle = nalgebra::center(&bounds.min, &bounds.max);
    let by = Vector3::new(centre.x - middle.x, centre.y - middle.y, -bottom);
    Ok(Placement { bed_from_stack: RigidTransform::translation(by), by, centre, scale })
}

impl Placement {
    fn region(&self, region: &Region) -> Region {
        let carry = |p: &Point2| self.centre + (p + self.by.xy() - self.centre) * self.scale;
        let contour = |c: &Contour| Contour::new(c.points.iter().map(carry).collect());
        Region::new(region.contours.iter().map(contour).collect())
    }

    /// Material and lumen of a layer on the bed.
    pub(super) fn layer(&self, layer: &Layer, is_first: bool, profile: &Profile) -> (Region, Region) {
        let (mut material, mut lumen) = (self.region(&layer.material), self.region(&layer.lumen));
        let widen = profile.print.hole_compensation_mm;
        if widen != 0.0 && !lumen.is_empty() {
            let whole = material.union(&lumen);
            lumen = lumen.offset(widen, TOLERANCE_MM);
            material = whole.difference(&lumen);
        }
        let inward = profile.print.first_layer_compensation_mm;
        if is_first && inward != 0.0 {
            material = material.offset(-inward, TOLERANCE_MM);
        }
        (material, lumen)
    }
}
