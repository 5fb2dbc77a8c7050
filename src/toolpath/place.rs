//! Layers from the stack frame onto the bed, with the compensations of the profile.
//!
//! The part is only moved: its bounding box is centred on the bed, its lowest layer stands on it, or on
//! its raft. Then,
//! where the profile asks for it: scaled up in the bed's plane against shrinkage, all outlines moved against
//! the bulge of beads, the lumen's besides against hole shrinkage, the first layer's against spreading.

use super::Error;
use super::raft::Raft;
use crate::geom::{Bounds2, Contour, Point2, Point3, Region, RigidTransform, SegmentIndex, Vector3};
use crate::profile::Profile;
use crate::slice::Layer;
use crate::units::on_grid_mm;

/// Chord tolerance of compensated outlines, mm.
const TOLERANCE_MM: f64 = 1e-3;

/// Where the stack lies on the bed.
#[derive(Debug, Clone)]
pub(super) struct Placement {
    pub(super) bed_from_stack: RigidTransform,
    pub(super) raft: Option<Raft>,
    by: Vector3,
    centre: Point2,
    scale: f64,
}

/// What the profile has changed of the part on the bed besides moving it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compensation {
    /// Against shrinkage the part is printed so many times as large in the bed's plane,
    pub enlarged: f64,
    /// around this place on the bed.
    pub around: Point2,
    /// The lumen's outline was moved so far into the wall, mm.
    pub lumen_mm: f64,
    /// All outlines were moved so far into the material, mm.
    pub material_mm: f64,
    /// And those of the layer on the bed so far besides, mm.
    pub first_layer_mm: f64,
}

impl Default for Compensation {
    fn default() -> Self {
        Self { enlarged: 1.0, around: Point2::origin(), lumen_mm: 0.0, material_mm: 0.0, first_layer_mm: 0.0 }
    }
}

/// Places on the bed to places in the stack, of the part as it is when it has cooled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StackFromBed {
    moved: RigidTransform,
    compensation: Compensation,
}

impl StackFromBed {
    pub(super) fn of(bed_from_stack: &RigidTransform, compensation: Compensation) -> Self {
        Self { moved: bed_from_stack.inverse(), compensation }
    }

    /// A place in the bed's plane.
    #[must_use]
    pub fn point(&self, p: Point2) -> Point2 {
        let Compensation { enlarged, around, .. } = self.compensation;
        let cooled = around + (p - around) / enlarged;
        self.moved.apply(Point3::new(cooled.x, cooled.y, 0.0)).xy()
    }

    /// What the profile has taken from a wall, as it is told; empty where it takes nothing.
    pub(super) fn taken(&self, is_first: bool) -> String {
        let Compensation { lumen_mm, material_mm, first_layer_mm, .. } = self.compensation;
        let taken = [
            (lumen_mm, "print.hole_compensation_mm"),
            (material_mm, "print.squeeze_compensation_mm"),
            (if is_first { first_layer_mm } else { 0.0 }, "print.first_layer_compensation_mm"),
        ];
        let keys: Vec<_> = taken.iter().filter(|(mm, _)| *mm > 0.0).map(|(_, key)| *key).collect();
        if keys.is_empty() { String::new() } else { format!(" after what {} takes", keys.join(" and ")) }
    }

    /// A place as it is told: in the model's own coordinates, as in the file or the CT that it comes from; the height is theirs.
    pub(super) fn told(&self, on_bed: Point2, z_mm: f64) -> String {
        told(self.point(on_bed), z_mm)
    }

    /// A length in the bed's plane, mm.
    #[must_use]
    pub fn length_mm(&self, mm: f64) -> f64 {
        mm / self.compensation.enlarged
    }
}

/// A place in the stack as it is told.
pub(super) fn told(at: Point2, z_mm: f64) -> String {
    format!("z {z_mm:.2} mm (x {:.2}, y {:.2} in the model)", at.x, at.y)
}

/// Finds the place of the layers on the bed.
pub(super) fn place(layers: &[Layer], profile: &Profile) -> Result<Placement, Error> {
    let bed = profile.machine.bed_mm;
    let bounds =
        layers.iter().filter_map(|l| l.material.bounds()).reduce(Bounds2::union).ok_or(Error::Empty)?;
    let bottom = layers[0].slot.z_mid_mm - layers[0].slot.height_mm / 2.0;
    let raft = Raft::under(&layers[0].slot, profile);
    let raft_mm = raft.as_ref().map_or(0.0, Raft::height_mm);
    let height: f64 = layers.iter().map(|l| l.slot.height_mm).sum::<f64>() + raft_mm;
    let scale = 1.0 / (1.0 - profile.filament.shrinkage_percent / 100.0);
    let size = bounds.size() * scale;
    // Outlines that the profile moves outward need room, too.
    let print = &profile.print;
    let outward_mm = [0.0, print.first_layer_compensation_mm]
        .map(|first_mm| -(print.squeeze_compensation_mm + first_mm))
        .into_iter()
        .fold(0.0, f64::max);
    let part_mm = [size.x + 2.0 * outward_mm, size.y + 2.0 * outward_mm, height];
    // In the steps in which places are written: heights that add up to a breath more are none. Written so that NaN is refused too.
    if !part_mm.iter().zip(bed).all(|(part, bed)| on_grid_mm(*part) <= bed) {
        return Err(Error::LargerThanBed { part_mm, bed_mm: bed });
    }
    let centre = Point2::new(bed[0] / 2.0, bed[1] / 2.0);
    let middle = nalgebra::center(&bounds.min, &bounds.max);
    let by = Vector3::new(centre.x - middle.x, centre.y - middle.y, raft_mm - bottom);
    Ok(Placement { bed_from_stack: RigidTransform::translation(by), raft, by, centre, scale })
}

/// The islands of some material that lie in a lumen: of another program's model that is all that an outline encloses.
fn within(material: &Region, lumen: &Region) -> Region {
    let Some(index) = SegmentIndex::try_new(&lumen.contours) else { return Region::default() };
    let is_within = |island: &Region| {
        let first = island.contours.first().and_then(|c| c.points.first());
        first.is_some_and(|&p| index.signed_distance_mm(p) < -TOLERANCE_MM)
    };
    Region::new(material.islands().into_iter().filter(is_within).flat_map(|island| island.contours).collect())
}

impl Placement {
    /// What is done to the part besides moving it.
    pub(super) fn compensation(&self, profile: &Profile) -> Compensation {
        Compensation {
            enlarged: self.scale,
            around: self.centre,
            lumen_mm: profile.print.hole_compensation_mm,
            material_mm: profile.print.squeeze_compensation_mm,
            first_layer_mm: if self.raft.is_none() { profile.print.first_layer_compensation_mm } else { 0.0 },
        }
    }

    fn region(&self, region: &Region) -> Region {
        let carry = |p: &Point2| self.centre + (p + self.by.xy() - self.centre) * self.scale;
        let contour = |c: &Contour| Contour::new(c.points.iter().map(carry).collect());
        Region::new(region.contours.iter().map(contour).collect())
    }

    /// Material and lumen of a layer on the bed.
    pub(super) fn layer(&self, layer: &Layer, is_first: bool, profile: &Profile) -> (Region, Region) {
        let (mut material, mut lumen) = (self.region(&layer.material), self.region(&layer.lumen));
        let print = &profile.print;
        let widen = print.hole_compensation_mm;
        if widen != 0.0 && !lumen.is_empty() {
            let whole = material.union(&lumen);
            let within = within(&material, &lumen);
            lumen = lumen.offset(widen, TOLERANCE_MM);
            material = Region::union_all([&whole.difference(&lumen), &within]);
        }
        let Compensation { material_mm, first_layer_mm, .. } = self.compensation(profile);
        let inward = material_mm + if is_first { first_layer_mm } else { 0.0 };
        if inward != 0.0 {
            material = material.offset(-inward, TOLERANCE_MM);
        }
        (material, lumen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile;
    use crate::slice::LayerSlot;

    #[test]
    fn a_part_as_high_as_the_machine_fits_whatever_its_layers_add_up_to() {
        // In binary fractions 5000 times 0.05 mm is more than 250 mm.
        let slot =
            |i: u32| LayerSlot { z_mid_mm: 0.05 * (f64::from(i) + 0.5), height_mm: 0.05, ct_plane: None };
        let material = Region::new(vec![Contour::circle(Point2::origin(), 5.0, 60)]);
        let layer = |i| Layer { slot: slot(i), material: material.clone(), lumen: Region::default() };
        let layers = |n: u32| (0..n).map(layer).collect::<Vec<_>>();
        let profile = profile::builtin("marlin").unwrap();
        assert!(layers(5000).iter().map(|l| l.slot.height_mm).sum::<f64>() > profile.machine.bed_mm[2]);
        assert!(place(&layers(5000), &profile).is_ok());
        let refused = place(&layers(5001), &profile).unwrap_err().to_string();
        assert!(refused.contains("10 x 10 x 250.05 mm, the build space 220 x 220 x 250 mm"), "{refused}");
    }

    #[test]
    fn outlines_that_are_moved_outward_need_room_on_the_bed() {
        let slot = LayerSlot { z_mid_mm: 0.1, height_mm: 0.2, ct_plane: None };
        let corners = [(-9.9, -9.9), (9.9, -9.9), (9.9, 9.9), (-9.9, 9.9)].map(|(x, y)| Point2::new(x, y));
        let material = Region::new(vec![Contour::new(corners.to_vec())]);
        let layers = [Layer { slot, material, lumen: Region::default() }];
        let mut profile = profile::builtin("reference").unwrap();
        profile.machine.bed_mm = [20.0, 20.0, 20.0];
        assert!(place(&layers, &profile).is_ok());
        profile.print.squeeze_compensation_mm = -0.2;
        let refused = place(&layers, &profile).unwrap_err();
        assert!(matches!(refused, Error::LargerThanBed { part_mm: [x, ..], .. } if (x - 20.2).abs() < 1e-9));
        (profile.print.squeeze_compensation_mm, profile.print.first_layer_compensation_mm) = (0.1, -0.25);
        assert!(place(&layers, &profile).is_err(), "the first layer reaches beyond the bed");
    }
}
