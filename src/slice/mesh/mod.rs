//! Layers from a foreign mesh.
//!
//! A plane cuts every triangle that has a vertex below it and one at or above it: a vertex in the plane counts as above,
//! so that no case is special. A triangle gives a segment with the material to its left, from the edge that goes down to
//! the edge that goes up; a segment ends on the edge on which the next one begins ([`chain`]). Points on an edge are
//! computed from its lower-numbered vertex: both triangles find the same bits.
//!
//! Small defects: ends that lie within [`MOST_GAP_MM`] of each other are joined; bodies that overlap, touch, lie in each
//! other or face inward are united by winding number, in the layers where that is so (`tidy`).
//!
//! The layers are cut in parallel, each from the list of triangles that reach it. Cost: O(triangles + crossings), and a
//! sort of each layer's edges.

mod chain;

use super::{Error, GridParams, Layer, LayerGrid, LayerSlot, grid, tidy};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, Point3, Region};
use crate::mesh::TriMesh;
use crate::progress::Task;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Widest gap of an outline that is closed, mm: a bead covers it.
const MOST_GAP_MM: f64 = 0.3;

/// The layers of a mesh, in its own frame; holes of the material count as lumen.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshLayers {
    /// From the bed upward; a layer may hold nothing.
    pub layers: Vec<Layer>,
    /// What was mended.
    pub warnings: Vec<Warning>,
}

/// Cuts a mesh at the middle of each of equal layers.
///
/// # Errors
/// A height outside the machine's limits, a mesh that is flat or open by more than a bead can cover, cancellation.
pub fn slice_mesh(mesh: &TriMesh, params: &GridParams, task: &Task<'_>) -> Result<MeshLayers, Error> {
    let grid = even_grid(mesh, params)?;
    let cutter = Cutter::new(mesh, &grid);
    let done = AtomicU64::new(0);
    let total = grid.slots.len() as u64;
    let cut = |layer: usize| {
        task.check()?;
        let cut = cutter.cut(layer)?;
        task.report(done.fetch_add(1, Ordering::Relaxed) + 1, total);
        Ok(cut)
    };
    // Of several faulty layers always the lowest is reported.
    let cuts: Vec<Result<Cut, Error>> = (0..grid.slots.len()).into_par_iter().map(cut).collect();
    let cuts = cuts.into_iter().collect::<Result<Vec<Cut>, Error>>()?;
    let warnings = warnings(&cuts);
    Ok(MeshLayers { layers: cuts.into_iter().map(|c| c.layer).collect(), warnings })
}

/// The layers that a mesh is cut into.
fn even_grid(mesh: &TriMesh, params: &GridParams) -> Result<LayerGrid, Error> {
    let extent_mm = mesh.extent_mm();
    grid(&[], extent_mm[2], params).map_err(|error| match error {
        Error::TooFlat { thinnest_mm, thickest_mm, .. } => {
            Error::FlatMesh { size_mm: extent_mm.map(|[low, high]| high - low), thinnest_mm, thickest_mm }
        }
        other => other,
    })
}

/// A layer and what was mended in it.
struct Cut {
    layer: Layer,
    /// Widest gap that was closed, mm, and where.
    gap: Option<(f64, Point2)>,
    n_gaps: usize,
    is_united: bool,
}

/// The mesh and which of its triangles reach which layer.
struct Cutter<'a> {
    mesh: &'a TriMesh,
    slots: &'a [LayerSlot],
    /// Where each layer's triangles begin in `triangles`.
    starts: Vec<usize>,
    triangles: Vec<u32>,
}

impl<'a> Cutter<'a> {
    fn new(mesh: &'a TriMesh, grid: &'a LayerGrid) -> Self {
        let slots = &grid.slots;
        let heights: Vec<f64> = slots.iter().map(|s| s.z_mid_mm).collect();
        // Layers whose plane lies above the lowest vertex and not above the highest one.
        let reach = |t: &[u32; 3]| {
            let z = t.map(|v| mesh.vertices[v as usize].z);
            let (low, high) = (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]));
            heights.partition_point(|h| *h <= low)..heights.partition_point(|h| *h <= high)
        };
        let ranges: Vec<std::ops::Range<usize>> = mesh.triangles.par_iter().map(reach).collect();
        let mut starts = vec![0_usize; slots.len() + 1];
        for range in &ranges {
            range.clone().for_each(|layer| starts[layer + 1] += 1);
        }
        for layer in 0..slots.len() {
            starts[layer + 1] += starts[layer];
        }
        let mut next = starts.clone();
        let mut triangles = vec![0_u32; starts[slots.len()]];
        for (range, triangle) in ranges.into_iter().zip(0_u32..) {
            for layer in range {
                triangles[next[layer]] = triangle;
                next[layer] += 1;
            }
        }
        Self { mesh, slots, starts, triangles }
    }

    fn cut(&self, layer: usize) -> Result<Cut, Error> {
        let slot = self.slots[layer];
        let own = &self.triangles[self.starts[layer]..self.starts[layer + 1]];
        let segments: Vec<chain::Segment> =
            own.iter().map(|&t| self.segment(self.mesh.triangles[t as usize], slot.z_mid_mm)).collect();
        let chained = chain::chained(&segments);
        let closed = chain::closed(chained, MOST_GAP_MM).map_err(|(gap_mm, at)| Error::OpenMesh {
            layer,
            z_mm: slot.z_mid_mm,
            gap_mm,
            at_mm: [at.x, at.y],
        })?;
        let (material, is_united) = tidy::tidied(closed.contours);
        let lumen = holes(&material);
        let layer = Layer { slot, material, lumen };
        Ok(Cut { layer, gap: closed.widest, n_gaps: closed.n_gaps, is_united })
    }

    /// Where the plane cuts a triangle that reaches from below it to at or above it.
    fn segment(&self, triangle: [u32; 3], z_mm: f64) -> chain::Segment {
        let is_above = triangle.map(|v| self.mesh.vertices[v as usize].z >= z_mm);
        // The vertex that lies alone on its side is put first.
        let alone = match is_above {
            [a, b, c] if b == c && a != b => 0,
            [a, b, c] if a == c && a != b => 1,
            _ => 2,
        };
        let [a, b, c] = [0, 1, 2].map(|k| triangle[(alone + k) % 3]);
        let (first, second) = (self.crossing(a, b, z_mm), self.crossing(c, a, z_mm));
        // From a alone above, the edge a-b goes down and c-a goes up.
        if is_above[alone] {
            chain::Segment { from: first, to: second }
        } else {
            chain::Segment { from: second, to: first }
        }
    }

    fn crossing(&self, a: u32, b: u32, z_mm: f64) -> chain::Crossing {
        let (low, high) = (a.min(b), a.max(b));
        let [p, q]: [&Point3; 2] = [low, high].map(|v| &self.mesh.vertices[v as usize]);
        let t = (z_mm - p.z) / (q.z - p.z);
        let at = Point2::new(p.x + t * (q.x - p.x), p.y + t * (q.y - p.y));
        chain::Crossing { edge: (low, high), at }
    }
}

/// The holes of a region, filled.
fn holes(material: &Region) -> Region {
    Region::new(material.contours.iter().filter(|c| !c.is_ccw()).map(Contour::reversed).collect())
}

fn warnings(cuts: &[Cut]) -> Vec<Warning> {
    let gaps = cuts.iter().filter_map(|c| Some((c.gap?, c.layer.slot.z_mid_mm)));
    let widest = gaps.max_by(|a, b| a.0.0.total_cmp(&b.0.0));
    let n_gaps: usize = cuts.iter().map(|c| c.n_gaps).sum();
    let open = widest.map(|((gap_mm, at), z_mm)| {
        let text = format!(
            "the mesh is open: {n_gaps} gap(s) in its outlines were closed, the widest of {gap_mm:.3} mm at x {:.2}, y \
             {:.2}, z {z_mm:.2} mm",
            at.x, at.y
        );
        Warning::new("model.open", text)
    });
    let united: Vec<f64> = cuts.iter().filter(|c| c.is_united).map(|c| c.layer.slot.z_mid_mm).collect();
    let overlaps = united.first().map(|z_mm| {
        let text = format!(
            "surfaces of the mesh meet, lie in each other or face inward in {} layer(s), the first at z {z_mm:.2} mm: what \
             they enclose was united",
            united.len()
        );
        Warning::new("model.overlaps", text)
    });
    open.into_iter().chain(overlaps).collect()
}

#[cfg(test)]
mod tests;
