//! Heights of the CT planes to the table of layers.
//!
//! The layer at CT plane k has height H_k and is centred on the plane. What remains between two planes,
//! dz - (H_k + H_k+1) / 2, is divided equally; so is what remains below the first and above the last
//! plane. H_k and the numbers of layers come from dynamic programming over the planes: candidates for
//! each H_k are a ladder of heights between the limits plus those that divide the neighbouring intervals
//! evenly, and the cost is the sum of squared logarithms of (height / wanted height), for every layer,
//! and of (height / neighbour's height), for every change. An even spacing that the wanted height divides
//! costs nothing, so it is met exactly. Cost O(planes): 0.15 ms a plane.
//!
//! Not done: adapting heights to the slope of the surface.

use super::{End, Error, LayerGrid, LayerSlot};

/// What the grid is made to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridParams {
    /// Wanted layer height, mm.
    pub layer_mm: f64,
    /// Thinnest and thickest layer that the machine prints, mm.
    pub height_limits_mm: [f64; 2],
}

/// Rungs of the ladder of candidate heights.
const N_RUNGS: usize = 24;
/// How much a change of height between neighbours counts against being off the wanted height.
const CHANGE_WEIGHT: f64 = 4.0;
/// How much a remainder that gets no layer of its own counts.
const REMAINDER_WEIGHT: f64 = 1e4;
/// Heights that agree within this are the same, mm: far below what a printer resolves.
const SAME_MM: f64 = 1e-9;

/// The layers for CT planes at `plane_z_mm` (ascending) and a body that reaches from `z_range_mm[0]` to
/// `z_range_mm[1]`, all in the stack frame. Planes outside the body get no layer; without any plane
/// inside, the body is divided evenly.
///
/// # Errors
/// A height outside the limits, limits or an extent that make no sense, planes out of order, or planes
/// too close for the thinnest layer.
pub fn grid(plane_z_mm: &[f64], z_range_mm: [f64; 2], params: &GridParams) -> Result<LayerGrid, Error> {
    check(plane_z_mm, z_range_mm, params)?;
    let [bottom, top] = z_range_mm;
    let planes: Vec<Plane> = plane_z_mm
        .iter()
        .enumerate()
        .filter(|&(_, z)| (bottom..=top).contains(z))
        .map(|(idx, &z_mm)| Plane { idx, z_mm })
        .collect();
    let slots = if planes.is_empty() {
        even(bottom, top, params)?
    } else {
        Chain { params, planes: &planes, bottom, top }.slots()?
    };
    Ok(LayerGrid { slots })
}

fn check(plane_z_mm: &[f64], [bottom, top]: [f64; 2], params: &GridParams) -> Result<(), Error> {
    let GridParams { layer_mm, height_limits_mm: [thinnest, thickest] } = *params;
    // Written so that NaN is refused too.
    if !(thinnest > 0.0 && thinnest <= thickest && thickest.is_finite()) {
        return Err(Error::HeightLimits { thinnest_mm: thinnest, thickest_mm: thickest });
    }
    if !(layer_mm >= thinnest - SAME_MM && layer_mm <= thickest + SAME_MM) {
        return Err(Error::LayerHeight { layer_mm, thinnest_mm: thinnest, thickest_mm: thickest });
    }
    let extent = top - bottom;
    if !(extent > 0.0 && extent.is_finite()) {
        return Err(Error::Extent { bottom_mm: bottom, top_mm: top });
    }
    if extent / layer_mm > 1e6 {
        return Err(Error::TooManyLayers { extent_mm: extent, layer_mm });
    }
    for (plane, pair) in plane_z_mm.windows(2).enumerate() {
        if pair[0].total_cmp(&pair[1]).is_ge() {
            return Err(Error::PlaneOrder { plane: plane + 1, z_mm: pair[1], below_mm: pair[0] });
        }
    }
    Ok(())
}

/// A body without CT planes in equal layers.
fn even(bottom: f64, top: f64, params: &GridParams) -> Result<Vec<LayerSlot>, Error> {
    let [thinnest, thickest] = params.height_limits_mm;
    let extent = top - bottom;
    let n = layer_counts(extent, params)
        .filter(|&n| n > 0)
        .min_by(|&a, &b| {
            let off = |n: usize| (extent / n as f64 / params.layer_mm).ln().abs();
            off(a).total_cmp(&off(b))
        })
        .ok_or(Error::TooFlat { extent_mm: extent, thinnest_mm: thinnest, thickest_mm: thickest })?;
    let mut slots = Vec::with_capacity(n);
    fill(&mut slots, bottom, top, n);
    Ok(slots)
}

#[derive(Debug, Clone, Copy)]
struct Plane {
    idx: usize,
    z_mm: f64,
}

/// The choice of the heights at the planes and the numbers of layers between them.
struct Chain<'a> {
    params: &'a GridParams,
    planes: &'a [Plane],
    bottom: f64,
    top: f64,
}

/// The best way to a candidate height at a plane.
#[derive(Debug, Clone, Copy)]
struct Best {
    cost: f64,
    from: usize,
    n_below: usize,
}

impl Chain<'_> {
    fn slots(&self) -> Result<Vec<LayerSlot>, Error> {
        let candidates: Vec<Vec<f64>> = (0..self.planes.len()).map(|k| self.candidates(k)).collect();
        let best = self.forward(&candidates)?;
        let last = self.planes.len() - 1;
        let above = self.top - self.planes[last].z_mm;
        let (mut at, n_above) = candidates[last]
            .iter()
            .enumerate()
            .filter_map(|(i, &h)| {
                let (cost, n) = self.cheapest(above - h / 2.0, &[h], true)?;
                Some((i, n, cost + best[last][i]?.cost))
            })
            .min_by(|a, b| a.2.total_cmp(&b.2))
            .map(|(i, n, _)| (i, n))
            .ok_or_else(|| self.end_of_body(End::Above))?;
        let mut heights = vec![(0.0, 0); self.planes.len()];
        for k in (0..self.planes.len()).rev() {
            let b = best[k][at].expect("only heights that a way leads to are chosen");
            heights[k] = (candidates[k][at], b.n_below);
            at = b.from;
        }
        Ok(self.assemble(&heights, n_above))
    }

    fn forward(&self, candidates: &[Vec<f64>]) -> Result<Vec<Vec<Option<Best>>>, Error> {
        let below = self.planes[0].z_mm - self.bottom;
        let start = |&h: &f64| {
            let (cost, n_below) = self.cheapest(below - h / 2.0, &[h], true)?;
            Some(Best { cost: cost + self.off_wanted(h), from: 0, n_below })
        };
        let lowest: Vec<Option<Best>> = candidates[0].iter().map(start).collect();
        if lowest.iter().all(Option::is_none) {
            return Err(self.end_of_body(End::Below));
        }
        let mut best = vec![lowest];
        for k in 1..self.planes.len() {
            let dz = self.planes[k].z_mm - self.planes[k - 1].z_mm;
            let row: Vec<Option<Best>> = candidates[k]
                .iter()
                .map(|&h| {
                    let ways = candidates[k - 1].iter().enumerate().filter_map(|(from, &g)| {
                        let (cost, n_below) = self.cheapest(dz - (h + g) / 2.0, &[g, h], false)?;
                        let before = best[k - 1][from]?.cost;
                        Some(Best { cost: before + cost + self.off_wanted(h), from, n_below })
                    });
                    ways.min_by(|a, b| a.cost.total_cmp(&b.cost))
                })
                .collect();
            if row.iter().all(Option::is_none) {
                return Err(self.too_close(k));
            }
            best.push(row);
        }
        Ok(best)
    }

    /// Heights that the layer at plane `k` may have, the wanted one first, so that it wins ties.
    fn candidates(&self, k: usize) -> Vec<f64> {
        let GridParams { layer_mm, height_limits_mm: [thinnest, thickest] } = *self.params;
        let interval = |k: usize| self.planes.get(k + 1).map(|p| p.z_mm - self.planes[k].z_mm);
        let neighbours = [k.checked_sub(1).and_then(interval), interval(k)];
        let evenly = neighbours.iter().flatten().map(|dz| dz / (dz / layer_mm).round().max(1.0));
        let ladder = (0..N_RUNGS).map(|i| thinnest + (thickest - thinnest) * i as f64 / (N_RUNGS - 1) as f64);
        let mut heights = vec![layer_mm.clamp(thinnest, thickest)];
        heights.extend(evenly.chain(neighbours.iter().flatten().copied()).chain(ladder));
        heights.retain(|h| (thinnest..=thickest).contains(h));
        let mut unique: Vec<f64> = Vec::with_capacity(heights.len());
        for h in heights {
            if unique.iter().all(|u| (u - h).abs() > SAME_MM) {
                unique.push(h);
            }
        }
        unique
    }

    fn off_wanted(&self, height_mm: f64) -> f64 {
        square_log(height_mm / self.params.layer_mm)
    }

    /// The cheapest number of layers for `gap_mm` beside layers of the given heights; at an end of the
    /// body, a remainder thinner than any layer may be given up (or, negative, overshot).
    fn cheapest(&self, gap_mm: f64, beside: &[f64], at_end: bool) -> Option<(f64, usize)> {
        let layered = layer_counts(gap_mm, self.params).map(|n| {
            if n == 0 {
                return (beside.windows(2).map(|p| CHANGE_WEIGHT * square_log(p[0] / p[1])).sum(), 0);
            }
            let height = gap_mm / n as f64;
            let changes: f64 = beside.iter().map(|h| square_log(height / h)).sum();
            (n as f64 * self.off_wanted(height) + CHANGE_WEIGHT * changes, n)
        });
        let given_up = (at_end && gap_mm.abs() < self.params.height_limits_mm[1])
            .then(|| (REMAINDER_WEIGHT * (gap_mm / self.params.layer_mm).powi(2), 0));
        layered.chain(given_up).min_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Plane `k`, not the first, finds no place above its predecessor.
    fn too_close(&self, k: usize) -> Error {
        let below = self.planes[k - 1];
        Error::PlanesTooClose {
            plane: self.planes[k].idx,
            z_mm: self.planes[k].z_mm,
            distance_mm: self.planes[k].z_mm - below.z_mm,
            thinnest_mm: self.params.height_limits_mm[0],
            thickest_mm: self.params.height_limits_mm[1],
        }
    }

    fn end_of_body(&self, end: End) -> Error {
        let [first, last] = [self.planes[0], self.planes[self.planes.len() - 1]];
        let (plane, distance_mm) = match end {
            End::Below => (first, first.z_mm - self.bottom),
            End::Above => (last, self.top - last.z_mm),
        };
        let [thinnest_mm, thickest_mm] = self.params.height_limits_mm;
        Error::EndOfBody { end, plane: plane.idx, z_mm: plane.z_mm, distance_mm, thinnest_mm, thickest_mm }
    }

    /// `heights`: per plane the height of its layer and the number of layers between it and the plane below.
    fn assemble(&self, heights: &[(f64, usize)], n_above: usize) -> Vec<LayerSlot> {
        let mut slots = Vec::new();
        let mut from = self.bottom;
        for (plane, &(height_mm, n_below)) in self.planes.iter().zip(heights) {
            let to = plane.z_mm - height_mm / 2.0;
            fill(&mut slots, from, to, n_below);
            slots.push(LayerSlot { z_mid_mm: plane.z_mm, height_mm, ct_plane: Some(plane.idx) });
            from = plane.z_mm + height_mm / 2.0;
        }
        fill(&mut slots, from, self.top, n_above);
        slots
    }
}

fn square_log(ratio: f64) -> f64 {
    ratio.ln().powi(2)
}

/// The numbers of equal layers within the limits that a gap may be divided into; 0 only where there is no
/// gap. At most the four around the wanted height: others cost more.
fn layer_counts(gap_mm: f64, params: &GridParams) -> impl Iterator<Item = usize> + use<> {
    let GridParams { layer_mm, height_limits_mm: [thinnest, thickest] } = *params;
    let around = (gap_mm / layer_mm).floor().max(0.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at most 1e6 layers, checked"
    )]
    let first = (around as usize).saturating_sub(1);
    (first..first + 4).filter(move |&n| {
        if n == 0 {
            return gap_mm.abs() <= SAME_MM;
        }
        let height = gap_mm / n as f64;
        (thinnest - SAME_MM..=thickest + SAME_MM).contains(&height)
    })
}

/// `n` equal layers from one height to another.
fn fill(slots: &mut Vec<LayerSlot>, from: f64, to: f64, n: usize) {
    let height_mm = (to - from) / n as f64;
    slots.extend((0..n).map(|i| LayerSlot {
        z_mid_mm: from + (i as f64 + 0.5) * height_mm,
        height_mm,
        ct_plane: None,
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PARAMS: GridParams = GridParams { layer_mm: 0.2, height_limits_mm: [0.1, 0.3] };

    fn planes(n: usize, dz: f64) -> Vec<f64> {
        (0..n).map(|k| k as f64 * dz).collect()
    }

    fn assert_sound(grid: &LayerGrid, planes: &[f64], range: [f64; 2], params: &GridParams) {
        let [thinnest, thickest] = params.height_limits_mm;
        let mut bottom = range[0];
        for s in &grid.slots {
            assert!(s.height_mm >= thinnest - 1e-9 && s.height_mm <= thickest + 1e-9, "{s:?}");
            assert!((s.z_mid_mm - s.height_mm / 2.0 - bottom).abs() < 1e-6, "{s:?} begins at {bottom}");
            bottom = s.z_mid_mm + s.height_mm / 2.0;
        }
        assert!((bottom - range[1]).abs() < 1e-6, "ends at {bottom}, not {}", range[1]);
        for (k, z) in planes.iter().enumerate() {
            let slot = grid.slots.iter().find(|s| s.ct_plane == Some(k)).expect("a layer for each plane");
            assert!((slot.z_mid_mm - z).abs() < 1e-12);
        }
    }

    #[test]
    fn reference_case_has_690_equal_layers() {
        let planes = planes(46, 3.0);
        let grid = grid(&planes, [-1.5, 136.5], &PARAMS).unwrap();
        assert_eq!(grid.slots.len(), 690);
        assert!(grid.slots.iter().all(|s| (s.height_mm - 0.2).abs() < 1e-9));
        assert_eq!(grid.slots[7].ct_plane, Some(0));
        assert_eq!(grid.slots[22].ct_plane, Some(1));
        assert_sound(&grid, &planes, [-1.5, 136.5], &PARAMS);
    }

    #[test]
    fn planes_closer_than_two_layers_get_a_layer_each() {
        let planes = planes(30, 0.15);
        let range = [-0.075, 29.0 * 0.15 + 0.075];
        let grid = grid(&planes, range, &PARAMS).unwrap();
        assert_eq!(grid.slots.len(), 30);
        assert_sound(&grid, &planes, range, &PARAMS);
    }

    #[test]
    fn body_without_planes_is_divided_evenly() {
        let grid = grid(&[], [0.0, 10.1], &PARAMS).unwrap();
        assert_eq!(grid.slots.len(), 51);
        assert_sound(&grid, &[], [0.0, 10.1], &PARAMS);
    }

    #[test]
    fn planes_outside_the_body_get_no_layer() {
        let grid = grid(&planes(5, 3.0), [2.0, 7.5], &PARAMS).unwrap();
        let found: Vec<usize> = grid.slots.iter().filter_map(|s| s.ct_plane).collect();
        assert_eq!(found, [1, 2]);
    }

    #[test]
    fn each_misuse_is_named_with_its_sizes() {
        let with = |layer_mm, height_limits_mm| GridParams { layer_mm, height_limits_mm };
        let range = [-1.5, 7.5];
        let text = |e: Result<LayerGrid, Error>| e.unwrap_err().to_string();
        let height = text(grid(&planes(3, 3.0), range, &with(0.5, [0.08, 0.32])));
        assert!(height.contains("0.5") && height.contains("0.08") && height.contains("0.32"), "{height}");
        assert!(text(grid(&[], range, &with(f64::NAN, [0.1, 0.3]))).contains("layer height"));
        assert!(text(grid(&[], range, &with(0.2, [0.3, 0.1]))).contains("limits"));
        assert!(text(grid(&[], [3.0, 3.0], &PARAMS)).contains("3"));
        assert!(text(grid(&[], [0.0, 0.05], &PARAMS)).contains("0.05"));
        assert!(text(grid(&[0.0, 0.0], [-1.0, 1.0], &PARAMS)).contains("plane 1"));
        assert!(text(grid(&[0.0, 1.0], [0.0, 1e9], &PARAMS)).contains("layers"));
        assert!(text(grid(&[0.0, 0.03, 3.0], range, &PARAMS)).contains("0.03"));
    }

    #[test]
    fn an_end_that_no_layers_fill_is_named() {
        let params = GridParams { layer_mm: 0.2, height_limits_mm: [0.2, 0.2] };
        let fault = |planes: &[f64], range| match grid(planes, range, &params).unwrap_err() {
            Error::EndOfBody { end, plane, distance_mm, .. } => {
                (end, plane, (distance_mm * 1e3).round() / 1e3)
            }
            other => panic!("{other}"),
        };
        assert_eq!(fault(&[0.0, 3.0], [-1.33, 4.5]), (End::Below, 0, 1.33));
        assert_eq!(fault(&[0.0, 3.0], [-1.5, 4.33]), (End::Above, 1, 1.33));
        assert_eq!(fault(&[-9.0, 0.0], [-1.33, 1.5]), (End::Below, 1, 1.33));
        let text = grid(&[0.0], [-1.5, 1.33], &params).unwrap_err().to_string();
        assert!(text.starts_with("the body reaches 1.33 mm above CT plane 0 at z 0 mm"), "{text}");
    }

    proptest! {
        #[test]
        fn any_spacing_gives_a_sound_grid(
            steps in prop::collection::vec(0.25..6.0f64, 1..40),
            layer_mm in 0.1..0.3f64,
            start in -900.0..900.0f64,
        ) {
            let mut planes = vec![start];
            planes.extend(steps.iter().scan(start, |z, dz| { *z += dz; Some(*z) }));
            let range = [
                start - 0.5 * steps[0],
                planes[planes.len() - 1] + 0.5 * steps[steps.len() - 1],
            ];
            let params = GridParams { layer_mm, height_limits_mm: [0.1, 0.3] };
            let grid = grid(&planes, range, &params).unwrap();
            // Half an interval may hold no layer beside the plane's own: only then may the ends be a
            // little off.
            let short_end = steps[0] < 0.5 || steps[steps.len() - 1] < 0.5;
            if !short_end {
                assert_sound(&grid, &planes, range, &params);
            }
        }

        #[test]
        fn even_spacing_stays_near_the_wanted_height(n in 2usize..60, dz in 0.6..5.0f64) {
            let planes = planes(n, dz);
            let range = [-dz / 2.0, (n as f64 - 0.5) * dz];
            let grid = grid(&planes, range, &PARAMS).unwrap();
            assert_sound(&grid, &planes, range, &PARAMS);
            for pair in grid.slots.windows(2) {
                let ratio = pair[0].height_mm / pair[1].height_mm;
                prop_assert!((0.6..1.67).contains(&ratio), "{ratio}");
            }
        }
    }
}
