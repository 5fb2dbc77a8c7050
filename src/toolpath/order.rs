//! The beads of all layers in the order in which they are printed, and what the operator should know of them.

use super::fill::Thin;
use super::seam::Seams;
use super::travel::Travel;
use super::{Bead, Draft, Error, LayerPaths, StackFromBed, adhesion, sequence};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, Region};
use crate::profile::{Profile, SupportStyle};
use crate::progress::{Cancelled, Task};

/// Share of a layer's skins from which on too thin a wall makes the layer impossible.
const MOST_THIN_SHARE: f64 = 0.5;
/// One layer in so many may be impossible: where a leaning body begins or ends there is but a sliver.
const A_SLIVER_IN: usize = 20;
/// Every how many points of an outline are looked at to see whether it rests on something.
const REST_STRIDE: usize = 4;

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
    /// Islands of material that begin in the air, and the first one's height in the stack and place.
    n_floating: usize,
    floating: Option<(f64, Point2)>,
    adhesion: Option<Warning>,
    /// Layers that are a raft's.
    n_raft: usize,
    /// How high the part is, mm, and what of its supports stands on the bed.
    height_mm: f64,
    on_bed: Region,
}

impl Order {
    /// Of a part so high, with supports that stand on this part of the bed.
    pub(super) const fn of_part(height_mm: f64, on_bed: Region, frame: StackFromBed) -> Self {
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
            n_floating: 0,
            floating: None,
            adhesion: None,
            n_raft: 0,
            height_mm,
            on_bed,
        }
    }

    /// All of it on a raft, which with its air is so high.
    pub(super) fn upon(self, raft: Vec<LayerPaths>, raft_mm: f64) -> Self {
        let at = raft.iter().flat_map(|l| &l.beads).last().and_then(|b| b.points.last()).map(|p| p.at);
        Self { at, z_mm: raft_mm, n_raft: raft.len(), paths: raft, ..self }
    }

    /// Puts the next layers in order.
    pub(super) fn add(
        &mut self,
        drafts: Vec<Draft>,
        profile: &Profile,
        task: &Task<'_>,
    ) -> Result<(), Cancelled> {
        for draft in drafts {
            task.check()?;
            self.layer(draft, profile);
        }
        Ok(())
    }

    fn layer(&mut self, draft: Draft, profile: &Profile) {
        let idx = self.paths.len();
        self.z_mm += draft.slot.height_mm;
        self.thin.extend(draft.thin.map(|t| (draft.slot.z_mid_mm, t)));
        if let Some(thin) = draft.thin.filter(|t| t.share > MOST_THIN_SHARE) {
            self.n_slivers += 1;
            let at = self.frame.point(thin.at);
            self.sliver.get_or_insert(Error::WallTooThin {
                layer: idx,
                z_mm: draft.slot.z_mid_mm,
                x_mm: at.x,
                y_mm: at.y,
                thickness_mm: thin.thickness_mm,
                thinnest_mm: draft.params.limits_mm[0],
            });
        }
        self.lost.extend(draft.lost.iter().map(|&p| (draft.slot.z_mid_mm, p)));
        if profile.print.support == SupportStyle::None {
            self.find_floating(&draft);
        }
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
        let Draft { slot, material, lumen, .. } = draft;
        self.paths.push(LayerPaths { slot, z_mm: self.z_mm, beads, travels, material, lumen });
    }

    /// Looks for islands of a layer under which there is nothing.
    fn find_floating(&mut self, draft: &Draft) {
        if self.paths.len() == self.n_raft {
            return;
        }
        let Some(below) = self.paths.last().map(|layer| &layer.material) else { return };
        let outers = draft.material.contours.iter().filter(|c| c.is_ccw());
        for island in outers.filter(|c| !rests(c, below)) {
            self.n_floating += 1;
            self.floating.get_or_insert((draft.slot.z_mid_mm, island.points[0]));
        }
    }

    /// Refuses a part whose wall is too thin.
    ///
    /// # Errors
    /// The lowest layer that cannot be printed, where there are many.
    pub(super) fn check(&self) -> Result<(), Error> {
        let is_refused = self.n_slivers * A_SLIVER_IN > self.paths.len();
        self.sliver.clone().filter(|_| is_refused).map_or(Ok(()), Err)
    }

    /// Skirt and brim.
    fn hold_down(
        &mut self,
        draft: &Draft,
        profile: &Profile,
        beads: &mut Vec<Bead>,
        travels: &mut Vec<Travel>,
    ) {
        let (loops, warning) =
            adhesion::loops(&draft.material, &self.on_bed, self.height_mm, profile, &draft.params);
        self.adhesion = warning;
        for path in &loops {
            let mut vertices = path.vertices.clone();
            vertices.push(vertices[0]);
            self.at = Some(vertices[0].at);
            beads.push(Bead { kind: path.kind, points: sequence::bead_points(&vertices) });
            travels.push(Travel { via: Vec::new(), leaves_material: true });
        }
    }

    /// What the operator should know of all layers.
    pub(super) fn warnings(&self) -> Vec<Warning> {
        let all = [self.thin_walls(), self.lost_features(), self.in_the_air(), self.adhesion.clone()];
        all.into_iter().flatten().collect()
    }

    fn in_the_air(&self) -> Option<Warning> {
        let (z_mm, at) = self.floating?;
        let text = format!(
            "{} island(s) begin in the air, the first at {}: turn the part, or have it held up (print.support in the profile)",
            self.n_floating,
            self.frame.told(at, z_mm)
        );
        Some(Warning::new("toolpath.in_the_air", text))
    }

    fn thin_walls(&self) -> Option<Warning> {
        let worst = self.thin.iter().min_by(|a, b| a.1.thickness_mm.total_cmp(&b.1.thickness_mm));
        let (z_mm, Thin { at, thickness_mm, .. }) = worst?;
        let text = format!(
            "material thinner than the thinnest bead in {} layers, worst {thickness_mm:.3} mm at {}: printed too thick there, or not \
             at all below half a bead",
            self.thin.len(),
            self.frame.told(*at, *z_mm)
        );
        Some(Warning::new("toolpath.thin_wall", text))
    }

    fn lost_features(&self) -> Option<Warning> {
        let &(z_mm, at) = self.lost.first()?;
        let text = format!(
            "{} outlines are too small for a bead and left out, the first at {}",
            self.lost.len(),
            self.frame.told(at, z_mm)
        );
        Some(Warning::new("toolpath.lost_feature", text))
    }
}

/// Whether an island lies on material: one of its points does, or one of the material's lies in it.
fn rests(island: &Contour, below: &Region) -> bool {
    let some = |c: &Contour| c.points.iter().step_by(REST_STRIDE).copied().collect::<Vec<_>>();
    some(island).into_iter().any(|p| below.contains(p))
        || below.contours.iter().flat_map(some).any(|p| island.contains(p))
}
