//! What lies on the bed, compared layer by layer: volumes, and the area that the beads cover.

use super::rig::Laid;
use super::vessel::LAYER_MM;
use std::collections::{BTreeMap, HashSet};

/// Side of a pixel, mm.
const PIXEL_MM: f64 = 0.05;

/// Beads of each layer, by height in µm.
fn layers(laid: &[Laid]) -> BTreeMap<i64, Vec<&Laid>> {
    let mut layers: BTreeMap<i64, Vec<&Laid>> = BTreeMap::new();
    for bead in laid {
        layers.entry(height_um(bead)).or_default().push(bead);
    }
    layers
}

fn height_um(bead: &Laid) -> i64 {
    #[expect(clippy::cast_possible_truncation, reason = "heights of a test's print")]
    let um = (bead.1[2] * 1e3).round() as i64;
    um
}

/// mm³ of each layer, by height in µm.
pub(super) fn volumes(laid: &[Laid]) -> BTreeMap<i64, f64> {
    layers(laid).into_iter().map(|(z, beads)| (z, beads.iter().map(|bead| bead.2).sum())).collect()
}

/// The least share that the areas covered have in common, over all layers of either.
pub(super) fn least_iou(a: &[Laid], b: &[Laid]) -> f64 {
    let (a, b) = (layers(a), layers(b));
    let none = Vec::new();
    let heights: HashSet<_> = a.keys().chain(b.keys()).collect();
    heights.into_iter().map(|z| iou(a.get(z).unwrap_or(&none), b.get(z).unwrap_or(&none))).fold(1.0, f64::min)
}

fn iou(a: &[&Laid], b: &[&Laid]) -> f64 {
    let frame = Frame::around(a.iter().chain(b).copied());
    let [a, b] = [a, b].map(|beads| frame.covered(beads));
    let (mut both, mut either) = (0_u32, 0_u32);
    for (a, b) in a.into_iter().zip(b) {
        both += u32::from(a && b);
        either += u32::from(a || b);
    }
    f64::from(both) / f64::from(either.max(1))
}

/// Pixels around some beads.
#[derive(Debug)]
struct Frame {
    low: [usize; 2],
    size: [usize; 2],
}

/// Half the width of any bead of these tests, mm.
const MARGIN_MM: f64 = 1.0;

impl Frame {
    fn around<'a>(beads: impl Iterator<Item = &'a Laid>) -> Self {
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for at in beads.flat_map(|bead| [bead.0, bead.1]) {
            for axis in 0..2 {
                low[axis] = low[axis].min(pixel(at[axis] - MARGIN_MM));
                high[axis] = high[axis].max(pixel(at[axis] + MARGIN_MM));
            }
        }
        Self { low, size: [0, 1].map(|axis| (high[axis] + 1).saturating_sub(low[axis])) }
    }

    /// Pixels whose centre lies within a bead: no farther from its line than half its width.
    fn covered(&self, beads: &[&Laid]) -> Vec<bool> {
        let mut pixels = vec![false; self.size[0] * self.size[1]];
        for (from, to, volume_mm3) in beads {
            let way = [to[0] - from[0], to[1] - from[1]];
            let length_mm = way[0].hypot(way[1]);
            let half_mm = volume_mm3 / (length_mm * LAYER_MM) / 2.0;
            assert!(half_mm < MARGIN_MM, "{half_mm} {from:?} {to:?} {volume_mm3}");
            let range = |axis: usize| {
                let (low, high) = (from[axis].min(to[axis]) - half_mm, from[axis].max(to[axis]) + half_mm);
                pixel(low)..=pixel(high)
            };
            for (i, j) in range(1).flat_map(|j| range(0).map(move |i| (i, j))) {
                let at = [i, j].map(|k| (k as f64 + 0.5) * PIXEL_MM);
                let along = ((at[0] - from[0]) * way[0] + (at[1] - from[1]) * way[1]) / length_mm.powi(2);
                let share = along.clamp(0.0, 1.0);
                let off = [0, 1].map(|axis| at[axis] - way[axis].mul_add(share, from[axis]));
                if off[0].mul_add(off[0], off[1] * off[1]) <= half_mm * half_mm {
                    pixels[(j - self.low[1]) * self.size[0] + i - self.low[0]] = true;
                }
            }
        }
        pixels
    }
}

/// Places on the bed are above 0.
fn pixel(mm: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the bed")]
    let n = (mm.max(0.0) / PIXEL_MM) as usize;
    n
}

#[test]
fn areas_and_volumes_are_those_of_the_beads() {
    let bead = |x: f64, y: f64| -> Laid { ([x, y, 0.2], [x + 10.0, y, 0.2], 10.0 * 0.4 * 0.2) };
    let (a, b) = (vec![bead(5.0, 5.0)], vec![bead(5.0, 5.2)]);
    // Half of the width in common: a third of what both cover.
    assert!((least_iou(&a, &b) - 1.0 / 3.0).abs() < 0.03, "{}", least_iou(&a, &b));
    assert!((least_iou(&a, &a) - 1.0).abs() < 1e-9);
    assert!(least_iou(&a, &[]) < 1e-9, "a layer that is missing has nothing in common");
    assert!((volumes(&a)[&200] - 0.8).abs() < 1e-9);
}
