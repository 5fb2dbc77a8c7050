//! Corrections that can be followed but hardly do what was meant: blocks beside the image, polygons between two planes, and what
//! stands in planes that are not used, or leads nowhere.

use super::super::grow::Slab;
use super::super::mask::Mask;
use super::{Block, Corrections, Drawn, nearest_plane};
use crate::ct::{HEIGHT_SLACK_MM, Volume, Warning};
use crate::geom::Point3;
use std::ops::Range;

/// A polygon further off its plane than this part of the planes' distance was meant for another height.
const OFF_PLANE: f64 = 0.02;
/// A row of voxels that goes on by less than this a voxel along an axis, mm, stands across it: what it gains there in
/// a whole image is rounding.
const ACROSS_MM: f64 = 1e-12;

/// What is to be told of corrections that were resolved.
pub(in crate::segment) fn warnings(volume: &Volume, corrections: &Corrections) -> Vec<Warning> {
    let blocks = (1..).zip(&corrections.block).filter(|(_, block)| !holds_any(block, volume));
    let blocks = blocks.map(|(n, _)| {
        let text = format!(
            "segment.block[{n}] holds no voxel of the image and keeps nothing out: check its numbers (box_mm and point_mm are LPS, z_mm runs along the stack's normal)"
        );
        Warning::new("segment.block_outside", text)
    });
    let contours = (1..)
        .zip(&corrections.contour)
        .filter_map(|(n, drawn)| off_plane(&format!("segment.contour[{n}]"), drawn, volume));
    blocks.chain(contours).collect()
}

/// What is to be told of corrections in planes that are not among those used.
pub(in crate::segment) fn unused(
    volume: &Volume,
    corrections: &Corrections,
    used: &Range<usize>,
) -> Vec<Warning> {
    let z_mm = |k: usize| volume.plane_z_mm[k];
    let reach = || {
        format!(
            "only z {:.3} to {:.3} mm are used: widen or give --z-mm",
            z_mm(used.start),
            z_mm(used.end - 1)
        )
    };
    let contour = |(n, drawn): (usize, &Drawn)| {
        let k = nearest_plane(volume, drawn.in_stack(volume).first()?.z);
        let text = format!("segment.contour[{n}] stands in the plane at z {:.3} mm, {}", z_mm(k), reach());
        (!used.contains(&k)).then(|| Warning::new("segment.contour_unused", text))
    };
    let contours = (1..).zip(&corrections.contour).filter_map(contour);
    let windows = (1..).zip(&corrections.window).filter_map(|(n, window)| {
        let own = volume.planes_between(window.z_mm);
        let is_met = own.start < used.end && used.start < own.end;
        let [lo, hi] = window.z_mm;
        let text = format!("segment.window[{n}] stands for z {lo:.3} to {hi:.3} mm, {}", reach());
        (!is_met).then(|| Warning::new("segment.window_unused", text))
    });
    if used.is_empty() { Vec::new() } else { contours.chain(windows).collect() }
}

/// What is to be told of drawn contours, one or several beside each other, that no other plane's section meets.
pub(in crate::segment) fn alone(slab: &Slab<'_>, lumen: &Mask) -> Vec<Warning> {
    let planes: Vec<usize> = slab.rules.drawn.range(slab.planes.clone()).map(|(&k, _)| k).collect();
    let runs = planes.chunk_by(|a, b| b - a == 1).map(|run| run[0]..run[run.len() - 1] + 1);
    runs.filter(|run| is_alone(slab, lumen, run)).map(|run| stands_alone(slab, &run)).collect()
}

/// Whether there are planes beside these, and the lumen does not go on in them from what was drawn.
fn is_alone(slab: &Slab<'_>, lumen: &Mask, run: &Range<usize>) -> bool {
    let below = run.start.checked_sub(1).map(|k| (run.start, k));
    let ends = below.into_iter().chain([(run.end - 1, run.end)]);
    let mut beside = ends.filter(|(_, k)| slab.planes.contains(k)).peekable();
    let meets = |(own, k): (usize, usize)| {
        slab.rules.drawn[&own].voxels().into_iter().any(|[i, j, _]| lumen.contains(i, j, k))
    };
    beside.peek().is_some() && !beside.any(meets)
}

fn stands_alone(slab: &Slab<'_>, run: &Range<usize>) -> Warning {
    let z_mm = |k: usize| slab.volume.plane_z_mm[k];
    let (first, last) = (z_mm(run.start), z_mm(run.end - 1));
    let [lo, hi] = slab.window_hu(run.start);
    let which = match run.len() {
        1 => format!("the contour drawn at z {first:.3} mm (segment.contour) stands alone"),
        _ => format!("the contours drawn from z {first:.3} to {last:.3} mm (segment.contour) stand alone"),
    };
    let text = format!(
        "{which}: the planes beside hold nothing in their window ({lo:.0} to {hi:.0} HU) that meets what was drawn; draw theirs, too, or give their window (segment.window)"
    );
    Warning::new("segment.contour_alone", text)
}

fn off_plane(key: &str, drawn: &Drawn, volume: &Volume) -> Option<Warning> {
    let corners = drawn.in_stack(volume);
    let k = nearest_plane(volume, corners.first()?.z);
    let plane_z_mm = volume.plane_z_mm[k];
    let off_mm = corners.iter().map(|p| (p.z - plane_z_mm).abs()).fold(0.0, f64::max);
    let mend = if drawn.z_mm.is_some() { "give z_mm" } else { "move its corners" };
    let text = format!(
        "{key} lies {off_mm:.3} mm off the nearest plane, z {plane_z_mm:.3} mm, whose contour it was taken for: {mend} at that height to say so, or draw it for the plane that is meant"
    );
    let most_mm = (OFF_PLANE * volume.plane_interval_mm(k)).max(HEIGHT_SLACK_MM);
    (off_mm > most_mm).then(|| Warning::new("segment.contour_off_plane", text))
}

/// Whether any voxel's centre is blocked. A row of voxels is a line, which a block holds from one place to another.
fn holds_any(block: &Block, volume: &Volume) -> bool {
    let [nx, ny, nz] = volume.dims;
    let at = |i: usize, j: usize, k: usize| {
        let in_stack = volume.stack_from_voxel(i as f64, j as f64, k);
        (in_stack.z, volume.patient_from_stack.apply(in_stack))
    };
    if let Some(corners) = block.box_mm {
        let rows = || (0..nz).flat_map(|k| (0..ny).map(move |j| (j, k)));
        return nx > 0 && rows().any(|(j, k)| is_met(corners, at(0, j, k).1, at(nx - 1, j, k).1, nx - 1));
    }
    // Planes and half-spaces reach to a corner of the image, if to any voxel; planes in the middle are looked at each.
    let ends = |n: usize| [0, n.saturating_sub(1)];
    let corner = |k: usize| ends(nx).into_iter().flat_map(move |i| ends(ny).map(move |j| (i, j, k)));
    (0..nz).flat_map(corner).any(|(i, j, k)| {
        let (z_mm, p) = at(i, j, k);
        block.holds(z_mm, p)
    })
}

/// Whether one of the points that divide a line into `n` equal parts, its ends included, lies in a box of two opposite corners.
fn is_met([a, b]: [[f64; 3]; 2], from: Point3, to: Point3, n: usize) -> bool {
    let mut range = [0.0, n as f64];
    for d in 0..3 {
        let (low, high) = (a[d].min(b[d]), a[d].max(b[d]));
        let step = (to[d] - from[d]) / (n as f64).max(1.0);
        if step.abs() < ACROSS_MM {
            if from[d] < low || from[d] > high {
                return false;
            }
            continue;
        }
        let [s, t] = [(low - from[d]) / step, (high - from[d]) / step];
        range = [range[0].max(s.min(t)), range[1].min(s.max(t))];
    }
    range[0].ceil() <= range[1].floor()
}
