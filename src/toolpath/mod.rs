//! Layers to beads and travels, in the bed frame.
//!
//! [`plan`] puts the layers on the bed (a translation), fills each with beads, and puts these in order:
//!
//! - Along every skin beads whose width follows the local thickness, so that a wall is filled from skin
//!   to skin without gap and overlap. The measure is the depth of the medial axis under each point of the
//!   skin; in place of the axis itself the touching balls are used (after Kuipers, Doubrovski, Wu, Wang:
//!   A framework for adaptive width control of dense contour-parallel toolpaths in fused deposition
//!   modeling, CAD 128, 2020, whose bead counts along a skeleton these are in effect).
//! - A raster in what is too deep for that, at alternating angles; where it is sparse, with solid floors and roofs; along the
//!   span over air.
//! - Order, seams and travels as the modules `sequence`, `seam` and `travel` say. Loops at the lumen begin and
//!   end inside the wall.
//!
//! Outline, spacing and flow follow one bead model ([`BeadModel`]).
//!
//! - Columns under overhangs, where the profile asks for supports.
//!
//! - Ribs that steady slender branches, where the profile asks for them.
//!
//! - A raft below, where the profile asks for one.
//!
//! Layers are filled in parallel, some at a time, while those before them are put in order one after the
//! other: the result is the same on any number of threads. Accuracy: outlines within [`TOLERANCE_MM`] of the layer's.

mod adhesion;
mod change;
mod fill;
mod flow;
mod foot;
mod held;
mod interior;
mod lead;
mod order;
mod place;
mod primed;
mod raft;
mod raster;
mod ribs;
mod ring;
mod seam;
mod sequence;
mod simplify;
mod skin;
mod supports;
mod travel;

pub use flow::BeadModel;
pub use place::{Compensation, StackFromBed};
pub use travel::Travel;

use crate::ct::Warning;
use crate::geom::{Point2, Region, RigidTransform};
use crate::profile::{BeadShape, Profile, SupportStyle};
use crate::progress::{Cancelled, Task};
use crate::slice::{Layer, LayerSlot};
use crate::units::on_grid_mm;
use fill::{FillParams, Path, Thin};
use held::Unheld;
use interior::{Interior, Stack};
use order::Order;
use place::Placement;
use rayon::prelude::*;
use ribs::Rib;
use serde::{Deserialize, Serialize};
use skin::Skins;
use std::sync::atomic::{AtomicU64, Ordering};
use supports::{Slab, Support};

/// What a bead is for; the names are those that G-code viewers know.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum BeadKind {
    /// The contour at the outer skin or at the lumen.
    ExternalPerimeter,
    /// A contour inside the wall.
    Perimeter,
    /// Raster inside.
    InternalInfill,
    /// Raster of a floor or roof, or wherever the fill is 100 %.
    SolidInfill,
    /// Lines over air from side to side.
    Bridge,
    /// Loops around the part that prime the nozzle or hold the part down.
    SkirtBrim,
    /// What holds overhangs up.
    SupportMaterial,
    /// Its uppermost layers.
    SupportInterface,
    /// A bar over air that steadies a slender branch.
    Rib,
}

impl BeadKind {
    /// The text behind `;TYPE:`.
    #[must_use]
    pub const fn gcode_name(self) -> &'static str {
        match self {
            Self::ExternalPerimeter => "External perimeter",
            Self::Perimeter => "Perimeter",
            Self::InternalInfill => "Internal infill",
            Self::SolidInfill => "Solid infill",
            Self::Bridge => "Bridge infill",
            Self::SkirtBrim => "Skirt/Brim",
            Self::SupportMaterial | Self::Rib => "Support material",
            Self::SupportInterface => "Support material interface",
        }
    }

    /// The text in legends: that of G-code, which has no word for ribs, but for these.
    #[must_use]
    pub const fn name(self) -> &'static str {
        if matches!(self, Self::Rib) { "Rib" } else { self.gcode_name() }
    }

    /// Whether it is laid over air.
    #[must_use]
    pub const fn is_over_air(self) -> bool {
        matches!(self, Self::Bridge | Self::Rib)
    }

    /// Whether it belongs to the part: all else is taken away after the print.
    #[must_use]
    pub const fn is_part(self) -> bool {
        !matches!(self, Self::SkirtBrim | Self::SupportMaterial | Self::SupportInterface | Self::Rib)
    }
}

/// A vertex of a bead's centre line, with the width of the bead there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeadPoint {
    /// Place on the bed, mm.
    pub at: Point2,
    /// Extrusion width from here to the next vertex, mm.
    pub width_mm: f64,
}

/// An extruded path. A closed loop repeats its first point at the end.
#[derive(Debug, Clone, PartialEq)]
pub struct Bead {
    /// What it is for.
    pub kind: BeadKind,
    /// Its centre line.
    pub points: Vec<BeadPoint>,
}

/// The beads of one layer in the order in which they are printed.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerPaths {
    /// The layer's place in the grid (stack frame heights).
    pub slot: LayerSlot,
    /// Height of the nozzle above the bed while this layer is printed, mm: the layer's top.
    pub z_mm: f64,
    /// The beads in order.
    pub beads: Vec<Bead>,
    /// The way to each bead from the end of the one before (for the first: of the layer below); a bead
    /// without an entry is reached straight.
    pub travels: Vec<Travel>,
    /// What was to be filled, on the bed, compensations included: for the report and for travels.
    pub material: Region,
    /// The lumen on the bed: travels keep out of it where a way round exists.
    pub lumen: Region,
}

/// A whole job on the bed.
#[derive(Debug, Clone, PartialEq)]
pub struct Toolpaths {
    /// Where the stack lies on the bed: a translation.
    pub bed_from_stack: RigidTransform,
    /// What is not only moved, on purpose.
    pub compensation: Compensation,
    /// Layers from the bed upward.
    pub layers: Vec<LayerPaths>,
}

impl Toolpaths {
    /// From places on the bed back to the stack.
    #[must_use]
    pub fn stack_from_bed(&self) -> StackFromBed {
        StackFromBed::of(&self.bed_from_stack, self.compensation)
    }
}

/// How far a bead's centre line and edges may lie off the exact ones, mm.
pub const TOLERANCE_MM: f64 = 1e-3;
/// Outlines are thinned to this before anything else, mm.
const OUTLINE_TOLERANCE_MM: f64 = 1e-4;
/// Layers that are filled while those before them are put in order: enough for any number of threads, few enough that
/// what is known of them until then takes little memory.
const LAYERS_AT_ONCE: usize = 64;
/// Material below this share of a bead's square is dust from boolean operations, not a feature.
const DUST_SHARE: f64 = 1e-3;
/// A planned job.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// The job.
    pub paths: Toolpaths,
    /// What the operator should know about it.
    pub warnings: Vec<Warning>,
}

/// What keeps layers from becoming toolpaths.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// No layer holds material.
    #[error("no layer holds any material: there is nothing to print; check the solid")]
    Empty,
    /// The part does not fit the machine.
    #[error(
        "the part is {} mm, the build space {} mm; it needs a larger machine, or less of it is to be printed",
        written(part_mm),
        written(bed_mm)
    )]
    LargerThanBed {
        /// Size of the part, mm.
        part_mm: [f64; 3],
        /// Size of the build space, mm.
        bed_mm: [f64; 3],
    },
    /// No bead has room anywhere.
    #[error(
        "no bead has room in any layer, though there is material: it is thinner than half of the thinnest bead, {thinnest_mm} mm, or \
         what the profile moves outlines by (print.squeeze_compensation_mm, print.hole_compensation_mm) leaves nothing of it"
    )]
    NoBead {
        /// Thinnest bead of the profile, mm.
        thinnest_mm: f64,
    },
    /// Most of a layer's wall is thinner than the thinnest bead.
    #[error(
        "the wall is {thickness_mm:.3} mm thin{after} in layer {layer} at z {z_mm:.2} mm (x {x_mm:.2}, y {y_mm:.2} in the model); the \
         thinnest bead is {thinnest_mm} mm: use a thicker wall or a finer nozzle"
    )]
    WallTooThin {
        /// The layer, 0 on the bed.
        layer: usize,
        /// Height of the layer's middle in the stack, mm.
        z_mm: f64,
        /// Place in the stack, mm.
        x_mm: f64,
        /// Place in the stack, mm.
        y_mm: f64,
        /// Thickness found, mm.
        thickness_mm: f64,
        /// What had been taken from it before; empty where nothing was.
        after: String,
        /// Thinnest bead of the profile, mm.
        thinnest_mm: f64,
    },
    /// Asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A size to the step of 1 um: one that is hardly too large shows it.
fn written(size_mm: &[f64; 3]) -> String {
    size_mm.map(|mm| on_grid_mm(mm).to_string()).join(" x ")
}

/// Plans the beads of a job on the profile's machine.
///
/// # Errors
/// Nothing to print, a part larger than the bed (both sizes are told), a wall thinner than the thinnest
/// bead, no room for any bead, cancellation.
pub fn plan(layers: &[Layer], profile: &Profile, task: &Task<'_>) -> Result<Planned, Error> {
    let left_out = foot::bare(layers, profile)?;
    let (below, layers) = layers.split_at(left_out.len());
    let placement = place::place(layers, profile)?;
    let placed = placed(layers, &placement, profile, task)?;
    let brim_mm = adhesion::brim_mm(layers, &placed, profile);
    let compensation = placement.compensation(profile);
    let frame = StackFromBed::of(&placement.bed_from_stack, compensation);
    let (columns, on_part) = columns(layers, &placed, &frame, profile);
    let (ribs, unsteady) = steadied(layers, &placed, &columns, &frame, profile);
    let stack = Stack { layers, placed: &placed, columns: &columns };
    let done = AtomicU64::new(0);
    let total = layers.len() as u64;
    let draft_at = |idx: usize| {
        task.check()?;
        let mut draft = draft(idx, &stack, profile)?;
        draft.supports = columns.get(idx).map(|c| c.paths(idx, &draft.params, profile)).unwrap_or_default();
        if let Some(rib) = ribs.get(idx) {
            draft.supports.extend(rib.posts(idx, &draft.params));
            draft.struts = rib.struts(&draft.params);
        }
        task.report(done.fetch_add(1, Ordering::Relaxed) + 1, total);
        Ok(draft)
    };
    let on_bed = columns.first().map(Support::area).unwrap_or_default();
    let posts = ribs.first().map(|rib| rib.footprint(profile.print.extrusion_width_mm));
    let on_bed = posts.filter(|posts| !posts.is_empty()).map_or(on_bed.clone(), |posts| on_bed.union(&posts));
    let is_steadied = !on_bed.is_empty() || !ribs.is_empty();
    let standing = placed[0].0.union(&on_bed);
    let mut order = Order::of_part(brim_mm, on_bed, frame);
    if let Some(raft) = &placement.raft {
        let (layers, skirt) = raft.layers(&standing, profile);
        order = order.upon(layers, raft.height_mm(), skirt);
    }
    left_out.iter().for_each(|b| order.note_thin(&b.slot, b.thin, &b.params));
    let mut drafts = Vec::new();
    for first in (0..layers.len()).step_by(LAYERS_AT_ONCE) {
        let numbers = first..layers.len().min(first + LAYERS_AT_ONCE);
        let fill = || numbers.into_par_iter().map(draft_at).collect::<Vec<_>>();
        let (filled, ordered) = rayon::join(fill, || order.add(std::mem::take(&mut drafts), profile, task));
        ordered?;
        // Of several faulty layers always the lowest is reported.
        drafts = filled.into_iter().collect::<Result<Vec<Draft<'_>>, Error>>()?;
    }
    order.add(drafts, profile, task)?;
    order.check()?;
    let footing = held::footing(layers, &placed, brim_mm, &frame, profile);
    let slender = held::slender(layers, &placed, brim_mm, is_steadied, profile);
    let bridges = held::bridges(&order.paths, &frame);
    order.outlined(placed);
    let emptied = emptied(&order.paths, layers, profile)?;
    let told = order.warnings(profile).into_iter().chain(foot::warning(below)).chain(emptied);
    let in_the_way = primed::in_the_way(&order.paths, profile);
    let rest = [footing, slender, bridges, on_part, unsteady, in_the_way].into_iter().flatten();
    let warnings = told.chain(rest).collect();
    let paths = Toolpaths { bed_from_stack: placement.bed_from_stack, compensation, layers: order.paths };
    Ok(Planned { paths, warnings })
}

/// What is to be known of layers of which the profile's compensations leave nothing.
///
/// # Errors
/// No layer gets any bead.
fn emptied(paths: &[LayerPaths], layers: &[Layer], profile: &Profile) -> Result<Option<Warning>, Error> {
    let of_part = &paths[paths.len() - layers.len()..];
    let least_mm2 = profile.print.extrusion_width_mm.powi(2);
    let holds = |(layer, _): &(&Layer, &LayerPaths)| layer.material.area_mm2() > least_mm2;
    if !of_part.iter().flat_map(|paths| &paths.beads).any(|bead| bead.kind.is_part()) {
        return Err(Error::NoBead { thinnest_mm: profile.machine.extrusion_width_mm[0] });
    }
    let is_bare = |(_, paths): &(&Layer, &LayerPaths)| paths.material.is_empty();
    let bare: Vec<_> = layers.iter().zip(of_part).filter(holds).filter(is_bare).collect();
    Ok(bare.first().map(|(layer, _)| {
        let text = format!(
            "{} layer(s) get no bead, as what the profile moves outlines by leaves nothing of them, the first at z {:.2} mm: look at \
             print.squeeze_compensation_mm, hole_compensation_mm and first_layer_compensation_mm",
            bare.len(),
            layer.slot.z_mid_mm
        );
        Warning::new("toolpath.bare_layer", text)
    }))
}

/// Material and lumen of all layers on the bed.
fn placed(
    layers: &[Layer],
    placement: &Placement,
    profile: &Profile,
    task: &Task<'_>,
) -> Result<Vec<(Region, Region)>, Cancelled> {
    let place = |(idx, layer): (usize, &Layer)| {
        task.check()?;
        let (material, lumen) = placement.layer(layer, idx == 0, profile);
        let width_mm = fill_params(profile, layer.slot.height_mm).width_mm;
        Ok((without_dust(material, width_mm), lumen))
    };
    let placed: Vec<Result<_, Cancelled>> = layers.par_iter().enumerate().map(place).collect();
    placed.into_iter().collect()
}

/// The supports of all layers, and what is to be known of them; none where the profile wants none. They are planned from the top
/// downward, before any layer.
fn columns(
    layers: &[Layer],
    placed: &[(Region, Region)],
    frame: &StackFromBed,
    profile: &Profile,
) -> (Vec<Support>, Option<Warning>) {
    if profile.print.support == SupportStyle::None {
        return (Vec::new(), None);
    }
    let slabs: Vec<Slab<'_>> = layers.iter().zip(placed).map(|(l, p)| Slab::of(l, p)).collect();
    let columns = supports::columns(&slabs, profile);
    let on_part = supports::on_part(&columns, &slabs, profile).map(|(layer, at)| {
        let text = format!(
            "supports stand on the part, first at {}, and may stand in a bore that no layer shows as a hole; print.support_on_part = \
             false in the profile keeps them on the bed",
            frame.told(at, layers[layer].slot.z_mid_mm)
        );
        Warning::new("toolpath.support_on_part", text)
    });
    (columns, on_part)
}

/// The ribs of all layers, and what is to be known of them; none where the profile wants none.
fn steadied(
    layers: &[Layer],
    placed: &[(Region, Region)],
    columns: &[Support],
    frame: &StackFromBed,
    profile: &Profile,
) -> (Vec<Rib>, Option<Warning>) {
    let (ribs, missing) = ribs::ribs(layers, placed, columns, profile);
    let unsteady = missing.first().map(|&(layer, at)| {
        let text = format!(
            "{} place(s) of slender branches are not steadied, as no rib has room, the first at {}: print more slowly, or take a \
             longer print.rib_span_mm in the profile",
            missing.len(),
            frame.told(at, layers[layer].slot.z_mid_mm)
        );
        Warning::new("toolpath.unsteady", text)
    });
    (ribs, unsteady)
}

/// A layer whose beads are not yet in order.
struct Draft<'a> {
    slot: LayerSlot,
    material: &'a Region,
    params: FillParams,
    supports: Vec<Path>,
    paths: Vec<Path>,
    struts: Vec<Path>,
    net: Option<travel::Net>,
    thin: Option<Thin>,
    lost: Vec<Point2>,
    /// A place on each island that begins in the air.
    floating: Vec<Point2>,
    /// Of the layer above.
    unheld: Option<Unheld>,
}

fn draft<'a>(idx: usize, stack: &Stack<'a>, profile: &Profile) -> Result<Draft<'a>, Error> {
    let slot = stack.layers[idx].slot;
    let params = fill_params(profile, slot.height_mm);
    let mut draft = Draft {
        slot,
        material: &stack.placed[idx].0,
        params,
        supports: vec![],
        paths: vec![],
        struts: vec![],
        net: None,
        thin: None,
        lost: vec![],
        floating: vec![],
        unheld: None,
    };
    let skins = Skins::try_new(draft.material, params.cap_mm(), OUTLINE_TOLERANCE_MM);
    draft.unheld = Unheld::above(idx, skins.as_ref(), stack, profile);
    let Some(skins) = skins else { return Ok(draft) };
    let filled = fill::fill(&skins, &params);
    let angle = if idx.is_multiple_of(2) { 45f64 } else { -45.0 };
    let rest_below = || rest_of(&stack.placed[idx - 1].0, &params);
    let interior = Interior::of(filled.rest, idx, stack, rest_below, &params, profile);
    let raster = interior.paths(&params, profile.print.infill_percent, angle.to_radians());
    let contours = filled.paths.into_iter().map(|p| sequence::simplified(p, TOLERANCE_MM));
    draft.paths = contours.chain(raster).collect();
    let net = travel::Net::new(&skins);
    draft.floating = held::floating(idx, stack, &skins, &net);
    draft.net = Some(net);
    (draft.thin, draft.lost) = (filled.thin, filled.lost);
    Ok(draft)
}

/// What the walls of some material leave.
fn rest_of(material: &Region, params: &FillParams) -> Region {
    let skins = Skins::try_new(material, params.cap_mm(), OUTLINE_TOLERANCE_MM);
    skins.map(|skins| fill::fill(&skins, params).rest).unwrap_or_default()
}

fn fill_params(profile: &Profile, height_mm: f64) -> FillParams {
    let [narrowest, widest] = profile.machine.extrusion_width_mm;
    // A rounded bead is never narrower than it is high.
    let narrowest = match profile.print.bead_shape {
        BeadShape::Rectangle => narrowest,
        BeadShape::Stadium => narrowest.max(height_mm),
    };
    FillParams {
        model: BeadModel::new(profile.print.bead_shape, height_mm),
        width_mm: profile.print.extrusion_width_mm.max(narrowest),
        limits_mm: [narrowest, widest.max(narrowest)],
        perimeters: profile.print.perimeters.max(1) as usize,
    }
}

fn without_dust(region: Region, width_mm: f64) -> Region {
    let least = DUST_SHARE * width_mm * width_mm;
    Region::new(region.contours.into_iter().filter(|c| c.signed_area_mm2().abs() > least).collect())
}

#[cfg(test)]
mod tests;
