//! Layers on the CT-aligned grid, cut from the exact solid.
//!
//! [`grid()`] turns the heights of the CT planes into the table layer <-> z <-> CT plane; [`slice_solid`]
//! cuts the body at the middle of each layer. All coordinates are in the stack frame; the toolpath stage
//! puts them on the bed.
//!
//! The layers are cut in parallel; each depends on its own height alone, so the result is the same on any
//! number of threads. The section is taken as constant through the layer's thickness.
//!
//! [`slice_mesh`] does the same for a mesh that another program made, in equal layers.

mod area;
mod grid;
mod mesh;
mod tidy;

pub use grid::{GridParams, grid};
pub use mesh::{MeshLayers, slice_mesh};

use crate::geom::{Contour, Region};
use crate::progress::{Cancelled, Task};
use crate::solid::{CrossSection, Sectioned};
use crate::units::{told_mm, told_size_mm};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};

/// One layer of the grid.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LayerSlot {
    /// Height of the layer's middle in the stack frame, mm: where the solid is cut.
    pub z_mid_mm: f64,
    /// Thickness of the layer, mm.
    pub height_mm: f64,
    /// The CT plane whose middle this layer's middle is, counted from 0 in the sections.
    pub ct_plane: Option<usize>,
}

/// The table layer <-> z <-> CT plane, from the bed upward.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LayerGrid {
    /// The layers, from the bed upward; each begins where the one below ends.
    pub slots: Vec<LayerSlot>,
}

/// A layer of the part: what is to be filled with material.
#[derive(Debug, Clone, PartialEq)]
pub struct Layer {
    /// Its place in the grid.
    pub slot: LayerSlot,
    /// What is to be filled; the lumen is its holes (a hollow wall) or all of it (a cast). Stack frame.
    pub material: Region,
    /// The lumen, for reports and for keeping beads and travels out of it; empty for a cast. Stack frame.
    pub lumen: Region,
}

/// An end of the body, seen from the CT plane nearest to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// Towards the bed.
    Below,
    /// Away from the bed.
    Above,
}

impl std::fmt::Display for End {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Below => "below",
            Self::Above => "above",
        })
    }
}

/// What keeps a body from being cut into layers.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The wanted height is none that the machine prints.
    #[error(
        "layer height {layer_mm} mm is out of range: the machine prints layers of {thinnest_mm} to {thickest_mm} mm; choose \
         one within, or another profile"
    )]
    LayerHeight {
        /// Wanted height, mm.
        layer_mm: f64,
        /// Thinnest layer of the machine, mm.
        thinnest_mm: f64,
        /// Thickest layer of the machine, mm.
        thickest_mm: f64,
    },
    /// The machine's limits make no sense.
    #[error(
        "layer height limits {thinnest_mm} to {thickest_mm} mm make no sense: expected 0 < thinnest <= thickest; correct the \
         profile"
    )]
    HeightLimits {
        /// Thinnest layer of the machine, mm.
        thinnest_mm: f64,
        /// Thickest layer of the machine, mm.
        thickest_mm: f64,
    },
    /// The body has no height.
    #[error("the body reaches from z {bottom_mm} to {top_mm} mm: there is nothing to cut; check the z range")]
    Extent {
        /// Lowest z, mm.
        bottom_mm: f64,
        /// Highest z, mm.
        top_mm: f64,
    },
    /// The body is thinner than a layer.
    #[error(
        "the body is {} mm high, which layers of {thinnest_mm} to {thickest_mm} mm cannot make up; widen the z range \
         or the layer height limits", told_mm(*extent_mm)
    )]
    TooFlat {
        /// Height of the body, mm.
        extent_mm: f64,
        /// Thinnest layer of the machine, mm.
        thinnest_mm: f64,
        /// Thickest layer of the machine, mm.
        thickest_mm: f64,
    },
    /// Another program's model is thinner than a layer.
    #[error(
        "the model is {}: too low for layers of {thinnest_mm} to {thickest_mm} mm; are the units millimetres?", told_size_mm(*size_mm)
    )]
    FlatMesh {
        /// Size of the model, mm.
        size_mm: [f64; 3],
        /// Thinnest layer of the machine, mm.
        thinnest_mm: f64,
        /// Thickest layer of the machine, mm.
        thickest_mm: f64,
    },
    /// The job would be absurdly long.
    #[error("{} mm in layers of {layer_mm} mm are more than a million layers; check the units", told_mm(*extent_mm))]
    TooManyLayers {
        /// Height of the body, mm.
        extent_mm: f64,
        /// Wanted height, mm.
        layer_mm: f64,
    },
    /// Planes must ascend.
    #[error(
        "CT plane {plane} at z {z_mm} mm does not lie above its predecessor at {below_mm} mm; sort the planes"
    )]
    PlaneOrder {
        /// The plane, counted from 0.
        plane: usize,
        /// Its height, mm.
        z_mm: f64,
        /// Height of the plane before, mm.
        below_mm: f64,
    },
    /// No heights within the limits make both planes the middle of a layer.
    #[error(
        "CT plane {plane} at z {z_mm} mm lies {distance_mm} mm above its predecessor: no layers of {thinnest_mm} to \
         {thickest_mm} mm have both planes as their middles; use thinner layers or leave planes out"
    )]
    PlanesTooClose {
        /// The upper plane, counted from 0.
        plane: usize,
        /// Its height, mm.
        z_mm: f64,
        /// Distance of the two planes, mm.
        distance_mm: f64,
        /// Thinnest layer of the machine, mm.
        thinnest_mm: f64,
        /// Thickest layer of the machine, mm.
        thickest_mm: f64,
    },
    /// No heights within the limits fill an end of the body.
    #[error(
        "the body reaches {distance_mm} mm {end} CT plane {plane} at z {z_mm} mm: no layers of {thinnest_mm} to {thickest_mm} mm \
         fill that and have the plane as the middle of one; widen the layer height limits or choose another z range"
    )]
    EndOfBody {
        /// Which end.
        end: End,
        /// The plane nearest to it, counted from 0.
        plane: usize,
        /// Its height, mm.
        z_mm: f64,
        /// From the plane to the end, mm.
        distance_mm: f64,
        /// Thinnest layer of the machine, mm.
        thinnest_mm: f64,
        /// Thickest layer of the machine, mm.
        thickest_mm: f64,
    },
    /// A plane cuts nothing out of the body.
    #[error("layer {layer} at z {z_mm} mm holds no material: the body has a gap there; check the solid")]
    EmptyLayer {
        /// The layer, counted from 0 at the bed.
        layer: usize,
        /// Height at which the body was cut, mm.
        z_mm: f64,
    },
    /// A mesh has a hole that no bead covers.
    #[error(
        "the mesh has a hole: in layer {layer} at z {z_mm:.2} mm an outline ends {gap_mm:.2} mm from the next one, at x {:.2}, y \
         {:.2} mm; repair the mesh, whose triangles are missing there or face different ways",
        at_mm[0], at_mm[1]
    )]
    OpenMesh {
        /// The layer, counted from 0 at the bed.
        layer: usize,
        /// Height at which the mesh was cut, mm.
        z_mm: f64,
        /// How far the next outline is, mm.
        gap_mm: f64,
        /// Where the outline ends, mm.
        at_mm: [f64; 2],
    },
    /// The chord tolerance is no length.
    #[error("the slicing tolerance is {tolerance_mm} mm; expected a positive length")]
    Tolerance {
        /// What was given, mm.
        tolerance_mm: f64,
    },
    /// Asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Cuts the body at the middle of each layer of the grid. Outlines stay within `tolerance_mm` of the surface, as much on
/// the one side of it as on the other: they enclose what the sections do.
///
/// A middle that lies a little outside the body (the body ends within the layer) is cut at the body's end.
///
/// # Errors
/// A tolerance that is no positive length, a layer without material, cancellation.
pub fn slice_solid(
    body: &dyn Sectioned,
    grid: &LayerGrid,
    tolerance_mm: f64,
    task: &Task<'_>,
) -> Result<Vec<Layer>, Error> {
    if !(tolerance_mm > 0.0 && tolerance_mm.is_finite()) {
        return Err(Error::Tolerance { tolerance_mm });
    }
    let done = AtomicU64::new(0);
    let total = grid.slots.len() as u64;
    // Collected without a short cut, so that of several faulty layers always the lowest is reported.
    let layers: Vec<Result<Layer, Error>> = grid
        .slots
        .par_iter()
        .enumerate()
        .map(|(layer, slot)| {
            task.check()?;
            let cut = cut(body, layer, *slot, tolerance_mm);
            task.report(done.fetch_add(1, Ordering::Relaxed) + 1, total);
            cut
        })
        .collect();
    layers.into_iter().collect()
}

fn cut(body: &dyn Sectioned, layer: usize, slot: LayerSlot, tolerance_mm: f64) -> Result<Layer, Error> {
    let [bottom, top] = body.z_range_mm();
    let z_mm = slot.z_mid_mm.max(bottom).min(top);
    let CrossSection { outer, lumen } = body.section(z_mm, tolerance_mm);
    let section = CrossSection { outer: kept(&outer, tolerance_mm), lumen: kept(&lumen, tolerance_mm) };
    let material = material(&section);
    if material.is_empty() {
        return Err(Error::EmptyLayer { layer, z_mm });
    }
    Ok(Layer { slot, material, lumen: section.lumen })
}

fn kept(region: &Region, tolerance_mm: f64) -> Region {
    Region::new(region.contours.iter().map(|c| area::kept(c, tolerance_mm)).collect())
}

/// What is to be filled; a boolean operation only where outlines cross.
fn material(section: &CrossSection) -> Region {
    let holes = section.lumen.contours.iter().map(Contour::reversed);
    let contours: Vec<Contour> = section.outer.contours.iter().cloned().chain(holes).collect();
    if tidy::is_sound(&contours) { Region::new(contours) } else { section.material() }
}

#[cfg(test)]
pub(crate) mod analytic;

#[cfg(test)]
mod tests {
    use super::analytic::{Tube, Tubes};
    use super::*;
    use crate::progress::CancelToken;
    use std::f64::consts::PI;

    const PARAMS: GridParams = GridParams { layer_mm: 0.2, height_limits_mm: [0.1, 0.3] };

    fn volume_mm3(layers: &[Layer]) -> f64 {
        layers.iter().map(|l| l.material.area_mm2() * l.slot.height_mm).sum()
    }

    #[test]
    fn ring_has_area_and_volume_of_the_annulus() {
        let body = Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 9.0]);
        let grid = grid(&[1.5, 4.5, 7.5], body.z_range_mm(), &PARAMS).unwrap();
        let layers = slice_solid(&body, &grid, 1e-3, &Task::quiet()).unwrap();
        let area = PI * (16.0 - 9.0);
        assert!(layers.iter().all(|l| (l.material.area_mm2() / area - 1.0).abs() < 2e-5));
        assert!(layers.iter().all(|l| l.material.contours.len() == 2 && l.lumen.contours.len() == 1));
        assert!(layers.iter().all(|l| (l.lumen.area_mm2() / (9.0 * PI) - 1.0).abs() < 2e-5));
        assert!((volume_mm3(&layers) / (area * 9.0) - 1.0).abs() < 2e-5);
    }

    #[test]
    fn slanted_tube_keeps_the_area_and_moves_its_centre() {
        let tube = Tube { slope: [0.5, 0.0], ..Tube::upright(0.0, 3.0) };
        let body = Tubes::new(vec![tube], 1.0, [0.0, 12.0]);
        let grid = grid(&[], body.z_range_mm(), &PARAMS).unwrap();
        let layers = slice_solid(&body, &grid, 1e-3, &Task::quiet()).unwrap();
        for layer in &layers {
            let centre = layer.lumen.contours[0].centroid();
            assert!((centre.x - 0.5 * layer.slot.z_mid_mm).abs() < 1e-4);
            assert!((layer.material.area_mm2() / (7.0 * PI) - 1.0).abs() < 2e-5);
        }
    }

    #[test]
    fn a_cone_that_overhangs_has_the_area_of_its_disk_at_every_middle() {
        let (low, flare, height) = (2.0, 0.9, 5.0);
        let cone = Tubes::new(vec![Tube { flare, ..Tube::upright(1.0, low) }], 0.0, [0.0, height]);
        let grid = grid(&[], cone.z_range_mm(), &PARAMS).unwrap();
        let layers = slice_solid(&cone, &grid, 1e-3, &Task::quiet()).unwrap();
        for layer in &layers {
            let area = PI * (low + flare * layer.slot.z_mid_mm).powi(2);
            assert!((layer.material.area_mm2() / area - 1.0).abs() < 2e-5);
            assert!(layer.material.contours.len() == 1 && layer.material.contours[0].is_ccw());
            assert!(layer.lumen.is_empty());
        }
        let top = low + flare * height;
        let frustum = PI * height / 3.0 * (low * low + low * top + top * top);
        // Of each layer the middle section misses pi (flare h)^2 / 12 of the mean one.
        let missed = PI * height * (flare * 0.2f64).powi(2) / 12.0;
        assert!((volume_mm3(&layers) / (frustum - missed) - 1.0).abs() < 2e-5);
    }

    #[test]
    fn tubes_that_nearly_touch_stay_two_and_those_that_just_do_are_one() {
        let section = |gap: f64| {
            let tubes = vec![Tube::upright(0.0, 3.0), Tube::upright(8.0 + gap, 3.0)];
            let body = Tubes::new(tubes, 1.0, [0.0, 0.2]);
            let grid = grid(&[], body.z_range_mm(), &PARAMS).unwrap();
            slice_solid(&body, &grid, 1e-3, &Task::quiet()).unwrap()[0].material.clone()
        };
        let holes = |r: &Region| r.contours.iter().filter(|c| c.signed_area_mm2() < 0.0).count();
        let (apart, joined) = (section(0.02), section(-0.02));
        assert_eq!((apart.islands().len(), holes(&apart)), (2, 2));
        assert!((apart.area_mm2() / (14.0 * PI) - 1.0).abs() < 2e-5);
        assert_eq!((joined.islands().len(), holes(&joined)), (1, 2));
        let half_angle = (3.99f64 / 4.0).acos();
        let lens = 2.0 * 16.0 * (half_angle - half_angle.sin() * half_angle.cos());
        assert!((joined.area_mm2() / (14.0 * PI - lens) - 1.0).abs() < 2e-5);
    }

    #[test]
    fn merging_tubes_change_from_two_islands_to_one() {
        let body = Tubes::merging([0.0, 20.0]);
        let grid = grid(&[], body.z_range_mm(), &PARAMS).unwrap();
        let layers = slice_solid(&body, &grid, 1e-3, &Task::quiet()).unwrap();
        assert_eq!(layers[0].material.islands().len(), 2);
        assert_eq!(layers[layers.len() - 1].material.islands().len(), 1);
        let holes = |l: &Layer| l.material.contours.iter().filter(|c| !c.is_ccw()).count();
        assert!(layers.iter().any(|l| l.material.islands().len() == 1 && holes(l) == 2));
        assert_eq!(holes(&layers[layers.len() - 1]), 1);
    }

    #[test]
    fn faults_are_named() {
        let body = Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 3.0]);
        let grid = grid(&[], [0.0, 3.0], &PARAMS).unwrap();
        let zero = slice_solid(&body, &grid, 0.0, &Task::quiet());
        assert_eq!(zero, Err(Error::Tolerance { tolerance_mm: 0.0 }));
        let nothing = Tubes::new(vec![], 1.0, [0.0, 3.0]);
        let empty = slice_solid(&nothing, &grid, 1e-3, &Task::quiet());
        assert!(matches!(empty, Err(Error::EmptyLayer { layer: 0, .. })));
        let token = CancelToken::default();
        token.cancel();
        let stopped = slice_solid(&body, &grid, 1e-3, &Task::new(&|_, _| {}, token));
        assert_eq!(stopped, Err(Error::Cancelled(Cancelled)));
    }
}
