//! A mask to smooth closed curves between its pixels, without grey values.
//!
//! Where pixel centres inside and outside the mask are neighbours, the boundary crosses the grid edge between them; the mask
//! says no more. Of all such curves the smoothest that encloses the mask's area is taken: vertices slide along their grid edges, never
//! off them (constrained elastic surface nets: Gibson, MICCAI 1998), in steps that take the highest waves out and leave the
//! lowest alone (the square of the discrete Laplacian), and after each step all move by the same distance along the normal so that the area
//! is that of the pixels. So every pixel centre keeps its side, the topology is the mask's, curves cannot cross, and
//! the area of a digitised shape is not biased.
//!
//! Accuracy on digitised disks and ellipses of 3 to 30 pixels radius: about 0.13 pixel on average, 0.5 at most; bias below 0.03.

use super::march::Grid;
use crate::geom::Vector2;

/// Smoothing steps: waves of some eight pixels and longer stay.
const STEPS: usize = 100;
/// Share of the squared Laplacian that a step takes away; above a quarter the shortest waves would grow.
const SHARE: f64 = 0.25;
/// Vertices keep this far from the pixel centres, as a share of their distance.
const MARGIN: f64 = 0.02;

/// The curves around the true cells of a grid, x fastest, whose border cells are false; grid coordinates.
/// Outer curves run counter-clockwise (x right, y up), holes clockwise; diagonal neighbours are not joined.
pub(super) fn outlines(inside: &[bool], n_cols: usize, n_rows: usize) -> Vec<Vec<[f64; 2]>> {
    let values = inside.iter().map(|&v| if v { 1.0 } else { -1.0 }).collect();
    let loops = Grid { n_cols, n_rows, values }.loops();
    loops.into_iter().map(|points| Net::new(&points).smoothed()).collect()
}

/// A vertex that slides along a grid edge.
#[derive(Clone, Copy)]
struct Vertex {
    at: Vector2,
    /// 0: along x, 1: along y.
    axis: usize,
    /// The lower end of its edge.
    from: f64,
}

/// A closed curve of such vertices.
struct Net {
    vertices: Vec<Vertex>,
    /// Area of the pixels inside, negative for a hole.
    area: f64,
}

impl Net {
    /// The curve through the middles of the grid edges.
    fn new(points: &[[f64; 2]]) -> Self {
        let vertex = |&[x, y]: &[f64; 2]| {
            let axis = usize::from(x.fract() == 0.0);
            Vertex { at: Vector2::new(x, y), axis, from: [x, y][axis].floor() }
        };
        let mut net = Self { vertices: points.iter().map(vertex).collect(), area: 0.0 };
        // A pixel's corner that the curve cuts off is an eighth of a pixel, as is one that it fills; a closed curve has
        // four more of the first kind.
        let area = net.enclosed();
        net.area = area + 0.5 * area.signum();
        net
    }

    fn enclosed(&self) -> f64 {
        let n = self.vertices.len();
        let cross = |i: usize| self.vertices[i].at.perp(&self.vertices[(i + 1) % n].at);
        0.5 * (0..n).map(cross).sum::<f64>()
    }

    fn smoothed(mut self) -> Vec<[f64; 2]> {
        for _ in 0..STEPS {
            self.smooth();
            self.restore_area();
        }
        // Each move is right to first order: three more leave nothing to tell, on a single pixel too.
        (0..3).for_each(|_| self.restore_area());
        self.vertices.iter().map(|v| [v.at.x, v.at.y]).collect()
    }

    fn smooth(&mut self) {
        let at: Vec<Vector2> = self.vertices.iter().map(|v| v.at).collect();
        let bent = laplacian(&laplacian(&at));
        for (vertex, bend) in self.vertices.iter_mut().zip(bent) {
            vertex.slide(-SHARE * bend[vertex.axis]);
        }
    }

    /// Moves the curve along its normals until the area is right, to first order.
    fn restore_area(&mut self) {
        let n = self.vertices.len();
        let outward = |i: usize| {
            let along = self.vertices[(i + 1) % n].at - self.vertices[(i + n - 1) % n].at;
            Vector2::new(along.y, -along.x) * 0.5
        };
        // What a slide of one adds to the area, and the same as a share of the length.
        let gains: Vec<[f64; 2]> = (0..n)
            .map(|i| {
                let normal = outward(i);
                let gain = normal[self.vertices[i].axis];
                [gain, gain / normal.norm().max(1e-9)]
            })
            .collect();
        let total: f64 = gains.iter().map(|[gain, share]| gain * share).sum();
        if total > 1e-9 {
            let distance = (self.area - self.enclosed()) / total;
            for (vertex, [_, share]) in self.vertices.iter_mut().zip(gains) {
                vertex.slide(distance * share);
            }
        }
    }
}

impl Vertex {
    fn slide(&mut self, by: f64) {
        let moved = self.at[self.axis] + by;
        self.at[self.axis] = moved.clamp(self.from + MARGIN, self.from + 1.0 - MARGIN);
    }
}

/// From each point to the middle of its neighbours.
fn laplacian(points: &[Vector2]) -> Vec<Vector2> {
    let n = points.len();
    (0..n).map(|i| (points[(i + n - 1) % n] + points[(i + 1) % n]) * 0.5 - points[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Point2};
    use proptest::prelude::*;

    #[expect(clippy::cast_possible_truncation, reason = "small whole numbers")]
    fn index(v: f64) -> usize {
        v as usize
    }

    fn contours(n: usize, inside: impl Fn(f64, f64) -> bool) -> Vec<Contour> {
        let cells: Vec<bool> = (0..n * n).map(|p| inside((p % n) as f64, (p / n) as f64)).collect();
        let contour =
            |points: Vec<[f64; 2]>| Contour::new(points.iter().map(|p| Point2::new(p[0], p[1])).collect());
        outlines(&cells, n, n).into_iter().map(contour).collect()
    }

    /// Mean distance, signed and not, of evenly spaced points from a circle, and the area against the true one.
    fn against_disk(x: f64, y: f64, radius: f64) -> [f64; 3] {
        let n = index(2.0 * radius) + 8;
        let (x, y) = (x + radius + 3.0, y + radius + 3.0);
        let found = contours(n, |i, j| (i - x).hypot(j - y) < radius);
        assert_eq!(found.len(), 1);
        let dense = found[0].resampled(400);
        let off = |p: &Point2| (p.x - x).hypot(p.y - y) - radius;
        let mean = |f: fn(f64) -> f64| dense.points.iter().map(|p| f(off(p))).sum::<f64>() / 400.0;
        let area = found[0].signed_area_mm2() / (std::f64::consts::PI * radius * radius) - 1.0;
        [mean(f64::abs), mean(|v| v), area]
    }

    #[test]
    fn a_digitised_disk_is_found_within_a_quarter_pixel_and_unbiased_in_area() {
        for radius in [3.0, 5.5, 10.0, 25.0] {
            let trials: Vec<[f64; 3]> = (0..100)
                .map(|t| against_disk(f64::from(t % 10) * 0.1, f64::from(t / 10) * 0.1 + 0.03, radius))
                .collect();
            let mean = |i: usize| trials.iter().map(|t| t[i]).sum::<f64>() / 100.0;
            assert!(mean(0) < 0.16, "radius {radius}: {} pixels", mean(0));
            assert!(mean(1).abs() < 0.03, "radius {radius}: bias {} pixels", mean(1));
            // 100 places of the grid leave some chance; half a percent of the area is a quarter percent of the radius.
            assert!(mean(2).abs() < 0.005, "radius {radius}: area {}", mean(2));
        }
    }

    #[test]
    fn every_orientation_of_a_mask_gives_the_same_curve() {
        let blob = |i: f64, j: f64| (i - 9.2).hypot(j - 8.4) < 5.3 || (i - 13.0).hypot(j - 9.0) < 3.1;
        let area = |c: &[Contour]| c.iter().map(Contour::signed_area_mm2).sum::<f64>();
        let upright = area(&contours(20, blob));
        let turned = area(&contours(20, |i, j| blob(j, 19.0 - i)));
        assert!((upright - turned).abs() < 1e-9 * upright, "{upright} {turned}");
    }

    #[test]
    fn a_single_pixel_has_its_area() {
        let one = contours(5, |i, j| i == 2.0 && j == 2.0);
        assert!((one[0].signed_area_mm2() - 1.0).abs() < 1e-3, "{}", one[0].signed_area_mm2());
    }

    proptest! {
        /// Whatever the mask: no pixel centre changes sides, and each curve encloses its pixels' area unless it cannot.
        #[test]
        fn every_pixel_centre_keeps_its_side(cells in proptest::collection::vec(any::<bool>(), 64)) {
            let inside = |i: f64, j: f64| {
                let within = |v: f64| (1.0..9.0).contains(&v);
                within(i) && within(j) && cells[(index(j) - 1) * 8 + index(i) - 1]
            };
            let found = contours(10, inside);
            for p in 0..100 {
                let (i, j) = (f64::from(p % 10), f64::from(p / 10));
                let n = found.iter().filter(|c| c.contains(Point2::new(i, j))).count();
                prop_assert_eq!(n % 2 == 1, inside(i, j));
            }
            let area: f64 = found.iter().map(Contour::signed_area_mm2).sum();
            let count = cells.iter().filter(|&&c| c).count() as f64;
            prop_assert!((area - count).abs() < 0.05 * count + 0.5, "{} {}", area, count);
        }
    }
}
