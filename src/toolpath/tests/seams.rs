//! Where loops begin and end, and what that leaves of the outlines.

use super::*;
use crate::geom::SegmentIndex;
use crate::geom::distance::nearest_on_segment;

/// Walls of 2 to 6 beads, of 0.30 to 0.6 mm each.
const WALLS_MM: [f64; 11] = [0.61, 0.7, 0.75, 0.85, 1.0, 1.2, 1.3, 1.6, 1.8, 2.0, 2.4];
const RADIUS_MM: f64 = 3.0;

fn ring(wall_mm: f64, layers: f64) -> Vec<LayerPaths> {
    let body = Tubes::new(vec![Tube::upright(0.0, RADIUS_MM)], wall_mm, [0.0, 0.2 * layers]);
    planned(&body, &reference()).paths.layers
}

/// The beads that run along a lumen.
fn along_lumen(layer: &LayerPaths) -> Vec<&Bead> {
    let index = SegmentIndex::try_new(&layer.lumen.contours).unwrap();
    let runs_along = |b: &&Bead| {
        let middle = b.points[b.points.len() / 2];
        index.nearest(middle.at).distance_mm < 0.6 * middle.width_mm
    };
    layer.beads.iter().filter(runs_along).collect()
}

/// Distance from a point to the nearest printed edge, negative inside.
fn free_mm(p: Point2, layer: &LayerPaths) -> f64 {
    let segments = layer.beads.iter().flat_map(|b| b.points.windows(2));
    let free = |s: &[BeadPoint]| (nearest_on_segment(p, s[0].at, s[1].at) - p).norm() - s[0].width_mm / 2.0;
    segments.map(free).fold(f64::INFINITY, f64::min)
}

/// Largest way of the printed edges off the circles, of the lumen and of the outer skin, mm.
fn edges_off_mm(layer: &LayerPaths, wall_mm: f64) -> [f64; 2] {
    let off = |radius_mm: f64, out: f64, angle: f64| {
        let (sin, cos) = angle.sin_cos();
        let ray = nalgebra::Vector2::new(cos, sin);
        // From the side without material towards it.
        let mut at_mm = radius_mm + 0.3 * out;
        while out * (at_mm - radius_mm) > -0.3 {
            let free_mm = free_mm(Point2::new(100.0, 100.0) + ray * at_mm, layer);
            if free_mm < 1e-4 {
                break;
            }
            at_mm -= out * free_mm;
        }
        (at_mm - radius_mm).abs()
    };
    let angles = || (0..900).map(|i| f64::from(i) * std::f64::consts::TAU / 900.0);
    [(RADIUS_MM, -1.0), (RADIUS_MM + wall_mm, 1.0)]
        .map(|(radius, out)| angles().map(|angle| off(radius, out, angle)).fold(0.0, f64::max))
}

#[test]
fn loops_at_the_lumen_begin_and_end_inside_any_wall() {
    for wall_mm in WALLS_MM {
        for layer in ring(wall_mm, 5.0) {
            let index = SegmentIndex::try_new(&layer.lumen.contours).unwrap();
            let depth = |p: BeadPoint| index.nearest(p.at).distance_mm;
            let loops = along_lumen(&layer);
            assert_eq!(loops.len(), 1, "{wall_mm} mm");
            for bead in loops {
                let line_mm = depth(bead.points[bead.points.len() / 2]);
                let (first, last) = (bead.points[0], bead.points[bead.points.len() - 1]);
                // So deep that its round begin reaches the lumen's outline by far not.
                assert!(depth(first) > 0.29, "{wall_mm} mm: begins {} mm deep", depth(first));
                assert!(depth(last) > line_mm + 0.07, "{wall_mm} mm: ends {} mm deep", depth(last));
            }
        }
    }
}

#[test]
fn seams_leave_the_outlines_as_they_are_and_the_wall_full() {
    for wall_mm in WALLS_MM {
        for layer in ring(wall_mm, 3.0) {
            let [lumen_mm, outer_mm] = edges_off_mm(&layer, wall_mm);
            assert!(lumen_mm < 0.01 && outer_mm < 0.025, "{wall_mm} mm: {lumen_mm} {outer_mm}");
            let cover = cover(&layer, &reference());
            assert!(cover.overlap < 0.005 && cover.gap < 0.002, "{wall_mm} mm: {cover:?}");
            assert!((cover.volume_ratio - 1.0).abs() < 0.001, "{wall_mm} mm: {cover:?}");
        }
    }
}
