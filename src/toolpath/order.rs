//! The beads of all layers in the order in which they are printed, and what the operator should know of them.

use super::fill::{FillParams, Thin};
use super::held::{self, Unheld};
use super::seam::Seams;
use super::travel::Travel;
use super::{Bead, Draft, Error, LayerPaths, StackFromBed, adhesion, sequence};
use crate::ct::Warning;
use crate::geom::{Point2, Region};
use crate::profile::Profile;
use crate::progress::{Cancelled, Task};
use crate::slice::LayerSlot;
use crate::units::counted;

/// Share of a layer's skins from which on too thin a wall makes the layer impossible.
const MOST_THIN_SHARE: f64 = 0.5;
/// One layer in so many may be impossible: where a leaning body begins or ends there is but a sliver.
const A_SLIVER_IN: usize = 20;
/// Layers whose beads are in order, each begun where the one below ended.
pub(super) struct Order {
    pub(super) paths: Vec<LayerPaths>,
    /// Where places on the bed lie in the model.
    frame: StackFromBed,
    /// Where the nozzle is.
    at: Option<Point2>,
    /// Where the loops along the skins of the layer below begin.
    seams: Vec<Point2>,
    z_mm: f64,
    /// Walls that are too thin, and features that no bead covers, with the heights of their layers in the stack.
    thin: Vec<(f64, Thin)>,
    lost: Vec<(f64, Point2)>,
    /// The first layer that is too thin nearly everywhere, and how many there are.
    sliver: Option<Error>,
    n_slivers: usize,
    /// Islands of material that begin in the air: heights in the stack and places.
    floating: Vec<(f64, Point2)>,
    unheld: Vec<Unheld>,
    adhesion: Option<Warning>,
    /// Layers that are a raft's.
    n_raft: usize,
    /// How wide its brim is, mm, and what of its supports stands on the bed.
    brim_mm: f64,
    on_bed: Region,
}

impl Order {
    /// Of a part with so wide a brim, and supports that stand on this part of the bed.
    pub(super) const fn of_part(brim_mm: f64, on_bed: Region, frame: StackFromBed) -> Self {
        Self {
            paths: Vec::new(),
            frame,
            at: None,
            seams: Vec::new(),
            z_mm: 0.0,
            thin: Vec::new(),
            lost: Vec::new(),
            sliver: None,
            n_slivers: 0,
            floating: Vec::new(),
            unheld: Vec::new(),
            adhesion: None,
            n_raft: 0,
            brim_mm,
            on_bed,
        }
    }

    /// All of it on a raft, which with its air is so high; what is to be known of the skirt round it.
    pub(super) fn upon(self, raft: Vec<LayerPaths>, raft_mm: f64, skirt: Option<Warning>) -> Self {
        let at = raft.iter().flat_map(|l| &l.beads).last().and_then(|b| b.points.last()).map(|p| p.at);
        Self { at, z_mm: raft_mm, n_raft: raft.len(), paths: raft, adhesion: skirt, ..self }
    }

    /// Puts the next layers in order.
    pub(super) fn add(
        &mut self,
        drafts: Vec<Draft<'_>>,
        profile: &Profile,
        task: &Task<'_>,
    ) -> Result<(), Cancelled> {
        for draft in drafts {
            task.check()?;
            self.layer(draft, profile);
        }
        Ok(())
    }

    fn layer(&mut self, mut draft: Draft<'_>, profile: &Profile) {
        let idx = self.paths.len();
        self.z_mm += draft.slot.height_mm;
        self.note_thin(&draft.slot, draft.thin, &draft.params);
        self.lost.extend(draft.lost.iter().map(|&p| (draft.slot.z_mid_mm, p)));
        self.floating.extend(draft.floating.iter().map(|&at| (draft.slot.z_mid_mm, at)));
        self.unheld.extend(draft.unheld.take());
        let mut beads = Vec::new();
        let mut travels = Vec::new();
        if idx == 0 {
            self.hold_down(&draft, profile, &mut beads, &mut travels);
        }
        let around = sequence::around(draft.supports, draft.net.as_ref(), self.at);
        self.at = around.at;
        beads.extend(around.beads);
        travels.extend(around.travels);
        if let Some(net) = &draft.net {
            let sequence =
                sequence::sequence(draft.paths, net, &draft.params, self.at, &Seams::of(idx, &self.seams));
            (self.at, self.seams) = (sequence.at, sequence.seams);
            beads.extend(sequence.beads);
            travels.extend(sequence.travels);
        }
        let struts = sequence::around(draft.struts, draft.net.as_ref(), self.at);
        self.at = struts.at;
        beads.extend(struts.beads);
        travels.extend(struts.travels);
        let (material, lumen) = Default::default();
        self.paths.push(LayerPaths { slot: draft.slot, z_mm: self.z_mm, beads, travels, material, lumen });
    }

    /// Gives the part's layers, once all are in order, the outlines that they fill: material and lumen of each.
    pub(super) fn outlined(&mut self, outlines: Vec<(Region, Region)>) {
        for (layer, outlines) in self.paths[self.n_raft..].iter_mut().zip(outlines) {
            (layer.material, layer.lumen) = outlines;
        }
    }

    /// Notes where the wall of the next layer, or of one that is left out before the first, is too thin.
    pub(super) fn note_thin(&mut self, slot: &LayerSlot, thin: Option<Thin>, params: &FillParams) {
        self.thin.extend(thin.map(|t| (slot.z_mid_mm, t)));
        if let Some(thin) = thin.filter(|t| t.share > MOST_THIN_SHARE) {
            self.n_slivers += 1;
            let at = self.frame.point(thin.at);
            self.sliver.get_or_insert(Error::WallTooThin {
                layer: self.paths.len(),
                z_mm: slot.z_mid_mm,
                x_mm: at.x,
                y_mm: at.y,
                thickness_mm: thin.thickness_mm,
                after: self.frame.taken(self.paths.is_empty()),
                thinnest_mm: params.limits_mm[0],
            });
        }
    }

    /// Refuses a part whose wall is too thin.
    ///
    /// # Errors
    /// The lowest layer that cannot be printed, where there are many.
    pub(super) fn check(&self) -> Result<(), Error> {
        let is_refused = self.n_slivers * A_SLIVER_IN > self.paths.len() - self.n_raft;
        self.sliver.clone().filter(|_| is_refused).map_or(Ok(()), Err)
    }

    /// Skirt and brim.
    fn hold_down(
        &mut self,
        draft: &Draft<'_>,
        profile: &Profile,
        beads: &mut Vec<Bead>,
        travels: &mut Vec<Travel>,
    ) {
        let (loops, warning) =
            adhesion::loops(draft.material, &self.on_bed, self.brim_mm, profile, &draft.params);
        self.adhesion = warning;
        let (laid, ways) = adhesion::laid(&loops);
        self.at = laid.last().map_or(self.at, |bead| Some(bead.points[0].at));
        beads.extend(laid);
        travels.extend(ways);
    }

    /// What the operator should know of all layers.
    pub(super) fn warnings(&self, profile: &Profile) -> Vec<Warning> {
        let beads = [self.thin_walls(), self.lost_features(), held::in_the_air(&self.floating, &self.frame)];
        let overhang = held::overhang(&self.unheld, &self.frame, profile);
        beads.into_iter().chain([overhang, self.adhesion.clone()]).flatten().collect()
    }

    fn thin_walls(&self) -> Option<Warning> {
        let worst = self.thin.iter().min_by(|a, b| a.1.thickness_mm.total_cmp(&b.1.thickness_mm));
        let (z_mm, Thin { at, thickness_mm, excess_mm, is_round_lumen, .. }) = worst?;
        let how = if *is_round_lumen {
            format!("printed {excess_mm:.3} mm too thick there, on the outside: the lumen keeps its outline")
        } else {
            "printed too thick there, or not at all below half a bead".to_owned()
        };
        let text = format!(
            "material thinner than the thinnest bead in {}, worst {thickness_mm:.3} mm at {}: {how}",
            counted(self.thin.len(), "layer"),
            self.frame.told(*at, *z_mm)
        );
        Some(Warning::new("toolpath.thin_wall", text))
    }

    fn lost_features(&self) -> Option<Warning> {
        let &(z_mm, at) = self.lost.first()?;
        let text = format!(
            "{} too small for a bead and left out, the first at {}",
            if self.lost.len() == 1 {
                "1 outline is".to_owned()
            } else {
                format!("{} outlines are", self.lost.len())
            },
            self.frame.told(at, z_mm)
        );
        Some(Warning::new("toolpath.lost_feature", text))
    }
}

#[cfg(test)]
mod tests {
    use crate::geom::{Contour, Point2, Region};
    use crate::profile::{self, Profile, SupportStyle};
    use crate::progress::Task;
    use crate::slice::{Layer, LayerSlot};
    use crate::toolpath::{Error, plan};

    fn rectangle(x: [f64; 2], y: [f64; 2]) -> Region {
        let corners = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])];
        Region::new(vec![Contour::new(corners.map(|(x, y)| Point2::new(x, y)).to_vec())])
    }

    fn disc(radius: f64) -> Region {
        Region::new(vec![Contour::circle(Point2::origin(), radius, 120)])
    }

    fn layers(materials: Vec<Region>) -> Vec<Layer> {
        let slot = |i: usize| LayerSlot { z_mid_mm: 0.2 * (i as f64 + 0.5), height_mm: 0.2, ct_plane: None };
        let layer = |(i, material)| Layer { slot: slot(i), material, lumen: Region::default() };
        materials.into_iter().enumerate().map(layer).collect()
    }

    fn told(materials: Vec<Region>, profile: &Profile) -> Vec<String> {
        let planned = plan(&layers(materials), profile, &Task::quiet()).unwrap();
        let air = planned.warnings.into_iter().filter(|w| w.code == "toolpath.in_the_air");
        air.map(|w| w.text).collect()
    }

    #[test]
    fn what_stands_on_its_like_or_lies_across_does_not_begin_in_the_air() {
        let profile = profile::builtin("reference").unwrap();
        let square = rectangle([0.0, 10.0], [0.0, 10.0]);
        let across = vec![rectangle([-20.0, 20.0], [-2.0, 2.0]), rectangle([-2.0, 2.0], [-20.0, 20.0])];
        // A wall of which the next layer covers half, and a thin one that moves on by most of its width.
        let steps = (0..4).map(|i| rectangle([0.5 * f64::from(i), 1.0 + 0.5 * f64::from(i)], [0.0, 10.0]));
        let thin = (0..4).map(|i| rectangle([0.55 * f64::from(i), 0.6 + 0.55 * f64::from(i)], [0.0, 10.0]));
        for materials in [vec![square; 10], across, steps.collect(), thin.collect()] {
            assert_eq!(told(materials, &profile), Vec::<String>::new());
        }
    }

    #[test]
    fn what_touches_by_its_border_alone_begins_in_the_air() {
        let profile = profile::builtin("reference").unwrap();
        let beside = vec![rectangle([0.0, 10.0], [0.0, 10.0]), rectangle([10.0, 20.0], [0.0, 10.0])];
        assert!(told(beside, &profile)[0].starts_with("1 island begins in the air"));
        // A rod in the bore of a tube rests on nothing, though the tube's outer outline goes round it.
        let tube = disc(6.0).difference(&disc(5.0));
        let with_rod = tube.union(&disc(2.0));
        assert!(told(vec![tube, with_rod], &profile)[0].starts_with("1 island begins in the air"));
    }

    #[test]
    fn what_supports_do_not_hold_up_is_told_with_supports_on() {
        // A disc in the air above a wide foot: held up by columns that stand on the foot, or not at all.
        let materials: Vec<Region> = (0..30)
            .map(|i| {
                if i < 5 {
                    disc(10.0)
                } else if i < 20 {
                    Region::default()
                } else {
                    disc(1.5)
                }
            })
            .collect();
        let mut profile = profile::builtin("reference").unwrap();
        profile.print.support = SupportStyle::Column;
        profile.print.support_on_part = true;
        assert_eq!(told(materials.clone(), &profile), Vec::<String>::new());
        profile.print.support_on_part = false;
        assert!(told(materials, &profile)[0].starts_with("1 island begins in the air, the first at z 4.10"));
    }

    #[test]
    fn a_job_without_a_bead_is_refused() {
        let profile = profile::builtin("reference").unwrap();
        let dust = plan(&layers(vec![disc(0.04); 5]), &profile, &Task::quiet());
        assert_eq!(dust, Err(Error::NoBead { thinnest_mm: profile.machine.extrusion_width_mm[0] }));
    }

    #[test]
    fn a_wanted_width_that_no_bead_of_the_layer_can_have_is_raised() {
        // Rounded beads, far narrower than the layers of raft and part are high.
        let mut profile = profile::builtin("marlin").unwrap();
        (profile.machine.extrusion_width_mm[0], profile.print.extrusion_width_mm) = (0.06, 0.06);
        profile.print.raft_layers = 2;
        let planned = plan(&layers(vec![disc(4.0); 3]), &profile, &Task::quiet()).unwrap();
        let beads = planned.paths.layers.iter().flat_map(|l| &l.beads);
        assert!(beads.flat_map(|b| &b.points).all(|p| p.width_mm > 0.1));
    }
}
