//! A raft: layers of its own under the part, where the bed holds badly or the part has too little to stand on.
//!
//! It reaches beyond all that stands on it by the profile's margin, as far as the bed does, and is filled through: nothing above
//! it spans air. Its lowest layer is as thick as the machine prints and leaves gaps, so that it holds on to an uneven bed and
//! comes off; the others lie across each other, the uppermost one without gaps. Between it and the part there is air by the
//! profile's gap, so that the part comes off.
//!
//! A skirt runs round it: what primes the nozzle for the part primes it for the raft.
//!
//! In the table of layers it lies below the part: its layers have heights in the stack and no CT plane.

use super::fill::FillParams;
use super::{BeadKind, LayerPaths, adhesion, fill_params, raster, sequence};
use crate::ct::Warning;
use crate::geom::{Bounds2, Contour, Point2, Region};
use crate::profile::Profile;
use crate::slice::LayerSlot;

/// Chord tolerance of its outline, mm: it is no part of the print.
const TOLERANCE_MM: f64 = 0.02;
/// Fill of all layers but the uppermost, percent.
const BODY_PERCENT: f64 = 60.0;

/// The raft that a part stands on.
#[derive(Debug, Clone)]
pub(super) struct Raft {
    /// From the bed upward.
    slots: Vec<LayerSlot>,
    /// Air between it and the part, mm.
    gap_mm: f64,
}

impl Raft {
    /// The raft under a part whose lowest layer is `first`, where the profile asks for one.
    pub(super) fn under(first: &LayerSlot, profile: &Profile) -> Option<Self> {
        let print = &profile.print;
        if print.raft_layers == 0 {
            return None;
        }
        let thickest_mm = profile.machine.layer_height_mm[1];
        let height_mm = |i: u32| if i == 0 { thickest_mm } else { first.height_mm };
        let above_mm: f64 = (0..print.raft_layers).map(height_mm).sum();
        let top_mm = first.z_mid_mm - first.height_mm / 2.0 - print.raft_gap_mm;
        let mut z_mm = top_mm - above_mm;
        let slots = (0..print.raft_layers).map(|i| {
            z_mm += height_mm(i);
            let height_mm = height_mm(i);
            LayerSlot { z_mid_mm: z_mm - height_mm / 2.0, height_mm, ct_plane: None }
        });
        Some(Self { slots: slots.collect(), gap_mm: print.raft_gap_mm })
    }

    /// From the bed to the part, mm.
    pub(super) fn height_mm(&self) -> f64 {
        self.slots.iter().map(|s| s.height_mm).sum::<f64>() + self.gap_mm
    }

    /// Its layers under what stands on it, the lowest one with its skirt; what is to be known of that.
    pub(super) fn layers(&self, standing: &Region, profile: &Profile) -> (Vec<LayerPaths>, Option<Warning>) {
        let margin_mm = profile.print.raft_margin_mm;
        let footprint = standing.without_holes().offset(margin_mm, TOLERANCE_MM).intersection(&bed(profile));
        // Its own holes are filled, too.
        let footprint = footprint.without_holes();
        let first = fill_params(profile, self.slots[0].height_mm);
        let (loops, warning) = adhesion::skirt(&footprint, profile, &first);
        let (mut beads, mut travels) = adhesion::laid(&loops);
        let (mut at, mut z_mm) = (beads.last().map(|bead| bead.points[0].at), 0.0);
        let mut layers = Vec::with_capacity(self.slots.len());
        for (idx, slot) in self.slots.iter().enumerate() {
            z_mm += slot.height_mm;
            let (percent, kind) = if idx + 1 == self.slots.len() {
                (100.0, BeadKind::SupportInterface)
            } else {
                (BODY_PERCENT, BeadKind::SupportMaterial)
            };
            let params: FillParams = fill_params(profile, slot.height_mm);
            let angle_deg: f64 = if idx.is_multiple_of(2) { 0.0 } else { 90.0 };
            let mut paths = raster::raster(&footprint, &params, percent, angle_deg.to_radians());
            paths.iter_mut().for_each(|path| path.kind = kind);
            let sequence = sequence::around(paths, None, at);
            at = sequence.at;
            beads.extend(sequence.beads);
            travels.extend(sequence.travels);
            layers.push(LayerPaths {
                slot: *slot,
                z_mm,
                beads: std::mem::take(&mut beads),
                travels: std::mem::take(&mut travels),
                material: Region::default(),
                lumen: Region::default(),
            });
        }
        (layers, warning)
    }
}

/// Where beads may lie.
fn bed(profile: &Profile) -> Region {
    let half_mm = profile.print.extrusion_width_mm / 2.0;
    let [x, y, _] = profile.machine.bed_mm;
    let all = Bounds2 { min: Point2::new(half_mm, half_mm), max: Point2::new(x - half_mm, y - half_mm) };
    let corners =
        [(all.min.x, all.min.y), (all.max.x, all.min.y), (all.max.x, all.max.y), (all.min.x, all.max.y)];
    Region::new(vec![Contour::new(corners.map(|(x, y)| Point2::new(x, y)).to_vec())])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcode;
    use crate::profile;
    use crate::progress::Task;
    use crate::slice::Layer;
    use crate::toolpath::{Error, Toolpaths, plan};
    use std::f64::consts::PI;

    fn with_raft(n_layers: u32) -> Profile {
        let mut profile = profile::builtin("reference").unwrap();
        profile.print.raft_layers = n_layers;
        (profile.print.raft_margin_mm, profile.print.raft_gap_mm) = (3.0, 0.15);
        profile
    }

    /// A tube of radius 4 with a lumen of radius 3, ten layers of 0.2 mm from z 7 mm.
    fn tube() -> Vec<Layer> {
        let disc = |r: f64| Region::new(vec![Contour::circle(Point2::origin(), r, 360)]);
        let slot = |i: usize| LayerSlot {
            z_mid_mm: 7.1 + 0.2 * i as f64,
            height_mm: 0.2,
            ct_plane: (i == 5).then_some(0),
        };
        let layer = |i| Layer { slot: slot(i), material: disc(4.0).difference(&disc(3.0)), lumen: disc(3.0) };
        (0..10).map(layer).collect()
    }

    fn planned(profile: &Profile) -> Toolpaths {
        let planned = plan(&tube(), profile, &Task::quiet()).unwrap();
        assert_eq!(planned.warnings, []);
        planned.paths
    }

    #[test]
    fn the_part_stands_on_a_raft_of_the_volume_computed_by_hand() {
        let profile = with_raft(3);
        let (plain, raised) = (planned(&with_raft(0)), planned(&profile));
        assert_eq!((plain.layers.len(), raised.layers.len()), (10, 13));
        let thickest_mm = profile.machine.layer_height_mm[1];
        let rise_mm = thickest_mm + 0.2 + 0.2 + 0.15;
        let area_mm2 = PI * 49.0;
        for (layer, (height_mm, share)) in
            raised.layers.iter().zip([(thickest_mm, 0.6), (0.2, 0.6), (0.2, 1.0)])
        {
            let volume = gcode::volume_mm3(layer, &profile);
            let expected = area_mm2 * height_mm * share;
            assert!((volume / expected - 1.0).abs() < 0.04, "{volume} of {expected}");
            assert!(layer.slot.ct_plane.is_none() && layer.beads.iter().all(|b| !b.kind.is_part()));
        }
        for (low, high) in plain.layers.iter().zip(&raised.layers[3..]) {
            assert!((high.z_mm - low.z_mm - rise_mm).abs() < 1e-9);
            assert_eq!((low.slot, &low.material), (high.slot, &high.material));
            let [low, high] = [low, high].map(|l| gcode::volume_mm3(l, &profile));
            assert!((low / high - 1.0).abs() < 2e-3, "{low} {high}");
        }
        let heights = raised.layers.windows(2).map(|p| p[1].slot.z_mid_mm - p[0].slot.z_mid_mm);
        assert!(heights.into_iter().all(|step| step > 0.0), "the table ascends");
        let moved = raised.bed_from_stack.apply(crate::geom::Point3::new(0.0, 0.0, 7.0));
        assert!((moved.z - rise_mm).abs() < 1e-9);
    }

    #[test]
    fn a_skirt_runs_round_the_raft_before_its_first_line() {
        let mut profile = with_raft(2);
        (profile.print.skirt_loops, profile.print.skirt_distance_mm) = (2, 5.0);
        let raft = planned(&profile).layers;
        let is_skirt = |bead: &&crate::toolpath::Bead| bead.kind == BeadKind::SkirtBrim;
        assert_eq!(raft[0].beads.iter().take_while(is_skirt).count(), 2);
        assert_eq!(raft.iter().flat_map(|l| &l.beads).filter(is_skirt).count(), 2);
        let centre = Point2::new(100.0, 100.0);
        // The raft reaches out to 7 mm.
        let nearest = raft[0].beads[..2].iter().flat_map(|b| &b.points).map(|p| (p.at - centre).norm());
        assert!(nearest.fold(f64::INFINITY, f64::min) > 7.0 + 5.0);
    }

    #[test]
    fn the_spread_on_the_bed_is_no_matter_of_a_part_on_a_raft() {
        let radius = |n_layers: u32| {
            let mut profile = with_raft(n_layers);
            profile.print.first_layer_compensation_mm = 0.1;
            let layer = planned(&profile).layers.swap_remove(n_layers as usize);
            (layer.material.bounds().unwrap().size().x) / 2.0
        };
        assert!((radius(0) - 3.9).abs() < 2e-3 && (radius(2) - 4.0).abs() < 2e-3);
    }

    #[test]
    fn a_part_that_is_too_high_with_its_raft_is_refused() {
        let mut profile = with_raft(2);
        profile.machine.bed_mm[2] = 2.3;
        let refused = plan(&tube(), &profile, &Task::quiet());
        assert!(
            matches!(refused, Err(Error::LargerThanBed { part_mm: [.., z], .. }) if z > 2.6),
            "{refused:?}"
        );
    }
}
