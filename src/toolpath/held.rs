//! What nothing holds: islands of a layer under which there is nothing, edges that reach far beyond the layer below, and a part
//! that hardly touches the bed.
//!
//! Outlines are looked at every [`STEP_MM`]; how far a place reaches beyond the layer below is its distance to that layer's
//! outline. As for supports, the lumen below counts as filled unless the profile wants supports in it, so ceilings of cavities
//! are not told.

use super::interior::Stack;
use super::skin::Skins;
use super::supports::{AIR_LAYERS, Support};
use super::travel::{Island, Net};
use super::{BeadKind, LayerPaths, StackFromBed, adhesion, fill_params};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, Region, SegmentIndex};
use crate::profile::{Profile, SupportStyle};
use crate::slice::Layer;
use crate::units::counted;

/// Distance of places on an outline that are looked at, mm.
const STEP_MM: f64 = 0.5;
/// What reaches less than this beyond the limit is noise of the layers' outlines, mm.
const NOISE_MM: f64 = 0.02;
/// Every how many nodes of an island are looked at to see whether it rests on something.
const REST_STRIDE: usize = 4;
/// It rests where one of them lies so deep in what is below, mm,
const WELL_WITHIN_MM: f64 = 0.06;
/// or where they share so much, mm², or half of a smaller island: less is the noise of borders that touch.
const LEAST_CONTACT_MM2: f64 = 0.01;
/// A part is told to have little to stand on if, within this height, mm,
const FOOT_MM: f64 = 1.0;
/// it gets so many times as broad.
const FOOT_GROWTH: f64 = 2.5;
/// A part so many times as high as its foot is wide sways under the nozzle; the built-in vessel is 17 times as high.
const MOST_SLENDER: f64 = 25.0;
/// Lines over air hold so far by themselves, mm.
const LONGEST_BRIDGE_MM: f64 = 20.0;

/// Where a layer reaches farther beyond the one below than the profile's limit.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unheld {
    /// Height of the layer's middle in the stack, mm.
    z_mm: f64,
    /// Where an edge reaches farthest beyond the layer below,
    at: Point2,
    /// and how far, mm.
    width_mm: f64,
}

impl Unheld {
    /// What of the layer above one of these skins is not held; nothing where the profile wants supports.
    pub(super) fn above(
        idx: usize,
        skins: Option<&Skins>,
        stack: &Stack<'_>,
        profile: &Profile,
    ) -> Option<Self> {
        if profile.print.support != SupportStyle::None {
            return None;
        }
        let (layer, (material, _)) = (stack.layers.get(idx + 1)?, stack.placed.get(idx + 1)?);
        let below = Below { skins, placed: &stack.placed[idx], in_lumen: profile.print.support_in_lumen };
        // What was taken from the first layer so that it does not bulge is not missing.
        let bulge_mm = if idx == 0 { profile.print.first_layer_compensation_mm.max(0.0) } else { 0.0 };
        let reach_mm = layer.slot.height_mm * profile.print.support_overhang_deg.to_radians().tan();
        let islands = material.islands();
        // What begins in the air is told as such.
        let resting: Vec<&Region> = islands.iter().filter(|island| below.holds(island)).collect();
        let (at, width_mm) = below.widest_overhang(&resting, reach_mm + bulge_mm + NOISE_MM)?;
        Some(Self { z_mm: layer.slot.z_mid_mm, at, width_mm })
    }
}

/// The layer below.
struct Below<'a> {
    skins: Option<&'a Skins>,
    placed: &'a (Region, Region),
    /// Whether its lumen is to be taken for empty.
    in_lumen: bool,
}

impl Below<'_> {
    /// Whether an island lies on material.
    fn holds(&self, island: &Region) -> bool {
        let Some(skins) = self.skins else { return false };
        // Some of its outline does nearly always; what is built straight up runs along the outline below.
        island.contours.iter().flat_map(along).any(|p| skins.index.contains(p))
            || touches(island, &self.placed.0, None)
    }

    /// The place that reaches farthest beyond this layer, and how far, if that is more than `reach_mm`.
    fn widest_overhang(&self, islands: &[&Region], reach_mm: f64) -> Option<(Point2, f64)> {
        let index = &self.skins?.index;
        let places = islands.iter().flat_map(|i| &i.contours).flat_map(along);
        let over = |p: &Point2| index.nearest_within(*p, reach_mm).is_none() && !self.has(*p);
        places
            .filter(over)
            .map(|p| (p, index.nearest(p).distance_mm))
            .reduce(|widest, next| if next.1 > widest.1 { next } else { widest })
    }

    /// Whether a place is filled, or counts as filled.
    fn has(&self, p: Point2) -> bool {
        self.placed.0.contains(p) || !self.in_lumen && self.placed.1.contains(p)
    }
}

/// Places along an outline.
fn along(contour: &Contour) -> impl Iterator<Item = Point2> {
    let mut due_mm = 0.0;
    contour.edges().flat_map(move |(a, b)| {
        let (edge, first_mm) = (b - a, due_mm);
        let length_mm = edge.norm();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "few, and not negative")]
        let n = ((length_mm - first_mm) / STEP_MM + 1.0).max(0.0) as u32;
        due_mm = first_mm + f64::from(n) * STEP_MM - length_mm;
        (0..n)
            .map(move |k| a + edge * ((first_mm + f64::from(k) * STEP_MM) / length_mm.max(f64::MIN_POSITIVE)))
    })
}

/// A place on each island of a layer that begins in the air: on neither material nor, with their air, supports.
pub(super) fn floating(idx: usize, stack: &Stack<'_>, skins: &Skins, net: &Net) -> Vec<Point2> {
    let Some(below) = idx.checked_sub(1).map(|j| &stack.placed[j].0) else { return Vec::new() };
    let index = SegmentIndex::try_new(&below.contours);
    let is_deep = |p: Point2| {
        let deep =
            |index: &SegmentIndex| index.contains(p) && index.nearest_within(p, WELL_WITHIN_MM).is_none();
        index.as_ref().is_some_and(deep)
    };
    let held = || idx.checked_sub(1 + AIR_LAYERS).and_then(|j| stack.columns.get(j)).map(Support::area);
    let rests = |island: &&Island| {
        let places: Vec<Point2> = net.places_in(island).step_by(REST_STRIDE).collect();
        places.into_iter().any(is_deep) || touches(&region(island, skins), below, held())
    };
    let in_the_air = net.islands().iter().filter(|island| !rests(island));
    in_the_air.filter_map(|island| skins.contours[island.contours[0]].points.first().copied()).collect()
}

fn region(island: &Island, skins: &Skins) -> Region {
    Region::new(island.contours.iter().map(|&c| skins.contours[c].clone()).collect())
}

/// Whether an island lies on material or supports, by the area that they share.
fn touches(island: &Region, below: &Region, held: Option<Region>) -> bool {
    let least_mm2 = LEAST_CONTACT_MM2.min(island.area_mm2() / 2.0);
    let shares = |other: &Region| island.intersection(other).area_mm2() > least_mm2;
    shares(below) || held.is_some_and(|held| shares(&held))
}

/// Tells of islands that begin in the air: heights in the stack and places.
pub(super) fn in_the_air(floating: &[(f64, Point2)], frame: &StackFromBed) -> Option<Warning> {
    let &(z_mm, at) = floating.first()?;
    let text = format!(
        "{} in the air, the first at {}: turn the part, or have it held up (print.support = \"column\", support_on_part and \
         support_in_lumen in the profile)",
        if floating.len() == 1 {
            "1 island begins".to_owned()
        } else {
            format!("{} islands begin", floating.len())
        },
        frame.told(at, z_mm)
    );
    Some(Warning::new("toolpath.in_the_air", text))
}

/// Tells of edges that reach too far over nothing.
pub(super) fn overhang(unheld: &[Unheld], frame: &StackFromBed, profile: &Profile) -> Option<Warning> {
    let widest = unheld.iter().reduce(|a, b| if b.width_mm > a.width_mm { b } else { a })?;
    let text = format!(
        "nothing holds overhangs beyond {} degrees in {}, the widest of {:.2} mm at {}: turn the part, or have them held up \
         (print.support = \"column\" in the profile)",
        profile.print.support_overhang_deg,
        counted(unheld.len(), "layer"),
        frame.length_mm(widest.width_mm),
        frame.told(widest.at, widest.z_mm)
    );
    Some(Warning::new("toolpath.overhang", text))
}

/// Tells of lines that span far over air, as roofs over an inside without fill do.
pub(super) fn bridges(paths: &[LayerPaths], frame: &StackFromBed) -> Option<Warning> {
    let spans = paths.iter().flat_map(|layer| {
        let lines = layer.beads.iter().filter(|bead| bead.kind == BeadKind::Bridge);
        let ends = lines.flat_map(|bead| bead.points.windows(2).map(|p| (p[0].at, p[1].at)));
        ends.map(move |(a, b)| ((b - a).norm(), nalgebra::center(&a, &b), layer.slot.z_mid_mm))
    });
    let (longest_mm, at, z_mm) = spans.reduce(|a, b| if b.0 > a.0 { b } else { a })?;
    (longest_mm > LONGEST_BRIDGE_MM).then(|| {
        let text = format!(
            "lines span up to {:.0} mm over air, the longest at {}: they may sag or fall; give the inside some fill (--infill-percent, \
             print.infill_percent in the profile) or turn the part",
            frame.length_mm(longest_mm),
            frame.told(at, z_mm)
        );
        Warning::new("toolpath.long_bridge", text)
    })
}

/// Tells of what is far higher than what it stands on is wide, where nothing steadies it. `is_steadied`: whether columns or ribs
/// stand beside the part.
pub(super) fn slender(
    layers: &[Layer],
    placed: &[(Region, Region)],
    brim_mm: f64,
    is_steadied: bool,
    profile: &Profile,
) -> Option<Warning> {
    let params = fill_params(profile, layers[0].slot.height_mm);
    let is_steadied = is_steadied || profile.print.raft_layers > 0 || adhesion::n_brim(brim_mm, &params) > 0;
    let height_mm: f64 = layers.iter().map(|l| l.slot.height_mm).sum();
    let is_slender = |foot: &Region, height_mm: f64| height_mm > MOST_SLENDER * foot.least_width_mm();
    // Nothing is higher than the part, nothing narrower than an island of its foot.
    if is_steadied || !placed[0].0.islands().iter().any(|island| is_slender(island, height_mm)) {
        return None;
    }
    let standing = adhesion::standing(layers, placed).into_iter();
    let slender = standing.filter(|(foot, height_mm)| is_slender(foot, *height_mm));
    let (foot, height_mm) =
        slender.max_by(|a, b| (a.1 / a.0.least_width_mm()).total_cmp(&(b.1 / b.0.least_width_mm())))?;
    let text = format!(
        "a part is {height_mm:.0} mm high by itself and stands on {:.1} mm: it may topple or sway; print.brim_slenderness or print.brim_mm in \
         the profile gives it a brim",
        foot.least_width_mm()
    );
    Some(Warning::new("toolpath.slender", text))
}

/// Tells of a part that hardly touches the bed, as a ball does or a tube that lies, where neither brim, raft nor supports are
/// beside it.
pub(super) fn footing(
    layers: &[Layer],
    placed: &[(Region, Region)],
    brim_mm: f64,
    frame: &StackFromBed,
    profile: &Profile,
) -> Option<Warning> {
    let (first, foot) = (&layers[0], &placed[0].0);
    let params = fill_params(profile, first.slot.height_mm);
    let is_held = profile.print.raft_layers > 0
        || profile.print.support != SupportStyle::None
        || adhesion::n_brim(brim_mm, &params) > 0;
    let near =
        layers.iter().zip(placed).take_while(|(l, _)| l.slot.z_mid_mm <= first.slot.z_mid_mm + FOOT_MM);
    let area_mm2 = foot.area_mm2();
    let above_mm2 = near.map(|(_, (material, _))| material.area_mm2()).fold(0.0, f64::max);
    let at = foot.contours.first()?.centroid();
    (!is_held && above_mm2 > FOOT_GROWTH * area_mm2).then(|| {
        let text = format!(
            "only {area_mm2:.1} mm2 of the part lie on the bed, at {}, under {above_mm2:.1} mm2 no more than {FOOT_MM} mm above: it may come \
             off; turn it, or have it held down (print.brim_mm in the profile)",
            frame.told(at, first.slot.z_mid_mm)
        );
        Warning::new("toolpath.footing", text)
    })
}
