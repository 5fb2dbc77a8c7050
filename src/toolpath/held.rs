//! What nothing holds: islands of a layer under which there is nothing, edges that reach far beyond the layer below, and a part
//! that hardly touches the bed.
//!
//! Outlines are looked at every [`STEP_MM`]; how far a place reaches beyond the layer below is its distance to that layer's
//! outline. As for supports, the lumen below counts as filled unless the profile wants supports in it, so ceilings of cavities
//! are not told.

use super::interior::Stack;
use super::skin::Skins;
use super::{StackFromBed, adhesion, fill_params};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, Region};
use crate::profile::{Profile, SupportStyle};
use crate::slice::Layer;
use crate::units::counted;

/// Distance of places on an outline that are looked at, mm.
const STEP_MM: f64 = 0.5;
/// What reaches less than this beyond the limit is noise of the layers' outlines, mm.
const NOISE_MM: f64 = 0.02;
/// An island with less than this on the layer below does not rest on it, mm².
const LEAST_REST_MM2: f64 = 1e-3;
/// A part is told to have little to stand on if, within this height, mm,
const FOOT_MM: f64 = 1.0;
/// it gets so many times as broad.
const FOOT_GROWTH: f64 = 2.5;

/// What of a layer nothing holds.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unheld {
    /// Height of the layer's middle in the stack, mm.
    z_mm: f64,
    /// A place in each island that begins in the air.
    floating: Vec<Point2>,
    /// Where an edge reaches farthest beyond the layer below, and how far, mm; only beyond the limit.
    overhang: Option<(Point2, f64)>,
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
        let (resting, floating): (Vec<&Region>, Vec<&Region>) = islands.iter().partition(|i| below.holds(i));
        let overhang = below.widest_overhang(&resting, reach_mm + bulge_mm + NOISE_MM);
        let floating: Vec<Point2> = floating.iter().map(|i| i.contours[0].points[0]).collect();
        let unheld = Self { z_mm: layer.slot.z_mid_mm, floating, overhang };
        (!unheld.floating.is_empty() || unheld.overhang.is_some()).then_some(unheld)
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
            || self.placed.0.intersection(island).area_mm2() > LEAST_REST_MM2
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

/// What the operator should know of all that nothing holds.
pub(super) fn warnings(unheld: &[Unheld], frame: &StackFromBed, profile: &Profile) -> Vec<Warning> {
    let floating: Vec<(f64, Point2)> =
        unheld.iter().flat_map(|u| u.floating.iter().map(|&p| (u.z_mm, p))).collect();
    let in_the_air = floating.first().map(|&(z_mm, at)| {
        let text = format!(
            "{} in the air, the first at {}: turn the part, or have it held up (print.support = \"column\" in the profile)",
            if floating.len() == 1 { "1 island begins".to_owned() } else { format!("{} islands begin", floating.len()) },
            frame.told(at, z_mm)
        );
        Warning::new("toolpath.in_the_air", text)
    });
    let overhangs: Vec<(f64, Point2, f64)> =
        unheld.iter().filter_map(|u| u.overhang.map(|(at, width_mm)| (u.z_mm, at, width_mm))).collect();
    let widest = overhangs.iter().copied().reduce(|a, b| if b.2 > a.2 { b } else { a });
    let overhang = widest.map(|(z_mm, at, width_mm)| {
        let text = format!(
            "nothing holds overhangs beyond {} degrees in {}, the widest of {:.2} mm at {}: turn the part, or have them held up \
             (print.support = \"column\" in the profile)",
            profile.print.support_overhang_deg,
            counted(overhangs.len(), "layer"),
            frame.length_mm(width_mm),
            frame.told(at, z_mm)
        );
        Warning::new("toolpath.overhang", text)
    });
    in_the_air.into_iter().chain(overhang).collect()
}

/// Tells of a part that hardly touches the bed, as a ball does or a tube that lies, where neither brim, raft nor supports are
/// beside it.
pub(super) fn footing(
    layers: &[Layer],
    placed: &[(Region, Region)],
    frame: &StackFromBed,
    profile: &Profile,
) -> Option<Warning> {
    let height_mm = layers.iter().map(|l| l.slot.height_mm).sum();
    let (first, foot) = (&layers[0], &placed[0].0);
    let params = fill_params(profile, first.slot.height_mm);
    let is_held = profile.print.raft_layers > 0
        || profile.print.support != SupportStyle::None
        || adhesion::n_brim(foot, height_mm, profile, &params) > 0;
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
