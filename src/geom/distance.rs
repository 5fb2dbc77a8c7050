//! Distance of points from contours, through a uniform grid of buckets.
//!
//! Building is O(n); a query visits rings of cells outward until no nearer segment can exist, O(1) on
//! average for points near the contour. Inside or outside is decided by the crossing rule along a row of cells.

use super::{Bounds2, Contour, Point2};

/// The foot point of a query on the indexed contours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// The nearest point of the contours.
    pub point: Point2,
    /// Its distance, mm, unsigned.
    pub distance_mm: f64,
    /// Which contour it lies on.
    pub contour_idx: usize,
    /// Which edge of that contour.
    pub edge_idx: usize,
}

#[derive(Debug, Clone, Copy)]
struct Segment {
    a: Point2,
    b: Point2,
    contour_idx: u32,
    edge_idx: u32,
}

/// The edges of a set of contours, arranged for distance queries.
#[derive(Debug, Clone)]
pub struct SegmentIndex {
    segments: Vec<Segment>,
    cells: Vec<Vec<u32>>,
    bounds: Bounds2,
    cell_mm: f64,
    n_cols: usize,
    n_rows: usize,
}

impl SegmentIndex {
    /// Indexes all edges of the contours; `None` where there is no edge.
    #[must_use]
    pub fn try_new(contours: &[Contour]) -> Option<Self> {
        let bounds = contours.iter().filter_map(Contour::bounds).reduce(Bounds2::union)?;
        let segments: Vec<Segment> = contours
            .iter()
            .enumerate()
            .flat_map(|(c, contour)| {
                contour.edges().enumerate().map(move |(e, (a, b))| Segment {
                    a,
                    b,
                    contour_idx: u32::try_from(c).unwrap_or(u32::MAX),
                    edge_idx: u32::try_from(e).unwrap_or(u32::MAX),
                })
            })
            .collect();
        let mean_edge_mm = contours.iter().map(Contour::perimeter_mm).sum::<f64>() / segments.len() as f64;
        let size = bounds.size();
        // Two edges a cell near the contour; never more cells than 4 an edge, so that memory stays O(n).
        let most = (4.0 * segments.len() as f64).max(16.0);
        let cell_mm = (2.0 * mean_edge_mm).max((size.x.max(1e-6) * size.y.max(1e-6) / most).sqrt()).max(1e-9);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "bounded by 4 cells an edge"
        )]
        let count = |extent: f64| ((extent / cell_mm).ceil() as usize).clamp(1, 1 << 16);
        let (n_cols, n_rows) = (count(size.x), count(size.y));
        let mut index =
            Self { segments, cells: vec![Vec::new(); n_cols * n_rows], bounds, cell_mm, n_cols, n_rows };
        index.fill();
        Some(index)
    }

    fn fill(&mut self) {
        for (i, s) in self.segments.iter().enumerate() {
            let (c0, r0) = self.cell_of(s.a.coords.inf(&s.b.coords).into());
            let (c1, r1) = self.cell_of(s.a.coords.sup(&s.b.coords).into());
            for row in r0..=r1 {
                for col in c0..=c1 {
                    self.cells[row * self.n_cols + col].push(u32::try_from(i).unwrap_or(u32::MAX));
                }
            }
        }
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid")]
    fn cell_of(&self, p: Point2) -> (usize, usize) {
        let at = |offset: f64, n: usize| ((offset / self.cell_mm).max(0.0) as usize).min(n - 1);
        (at(p.x - self.bounds.min.x, self.n_cols), at(p.y - self.bounds.min.y, self.n_rows))
    }

    /// The nearest point of the contours.
    #[must_use]
    pub fn nearest(&self, p: Point2) -> Foot {
        let (col, row) = self.cell_of(p);
        let mut best = Foot { point: p, distance_mm: f64::INFINITY, contour_idx: 0, edge_idx: 0 };
        for ring in 0..self.n_cols.max(self.n_rows) {
            self.visit_ring(p, (col, row), ring, &mut best);
            // What is not yet visited lies at least `ring` whole cells away from the point of the bounds that
            // is nearest to `p`, and so at least as far from `p` (projection onto a convex set).
            if best.distance_mm <= ring as f64 * self.cell_mm {
                break;
            }
        }
        best
    }

    fn visit_ring(&self, p: Point2, (col, row): (usize, usize), ring: usize, best: &mut Foot) {
        let r0 = row.saturating_sub(ring);
        let r1 = (row + ring).min(self.n_rows - 1);
        let c0 = col.saturating_sub(ring);
        let c1 = (col + ring).min(self.n_cols - 1);
        for r in r0..=r1 {
            let whole_row = r + ring == row || r == row + ring;
            if whole_row {
                (c0..=c1).for_each(|c| self.visit_cell(p, c, r, best));
            } else {
                if col >= ring {
                    self.visit_cell(p, col - ring, r, best);
                }
                if ring > 0 && col + ring < self.n_cols {
                    self.visit_cell(p, col + ring, r, best);
                }
            }
        }
    }

    fn visit_cell(&self, p: Point2, col: usize, row: usize, best: &mut Foot) {
        for &i in &self.cells[row * self.n_cols + col] {
            let s = &self.segments[i as usize];
            let foot = nearest_on_segment(p, s.a, s.b);
            let distance_mm = (foot - p).norm();
            if distance_mm < best.distance_mm {
                *best = Foot {
                    point: foot,
                    distance_mm,
                    contour_idx: s.contour_idx as usize,
                    edge_idx: s.edge_idx as usize,
                };
            }
        }
    }

    /// Distance to the nearest contour, mm: negative inside, positive outside (crossing rule over all contours).
    #[must_use]
    pub fn signed_distance_mm(&self, p: Point2) -> f64 {
        let distance = self.nearest(p).distance_mm;
        if self.contains(p) { -distance } else { distance }
    }

    /// Whether the point is enclosed by an odd number of contours.
    #[must_use]
    pub fn contains(&self, p: Point2) -> bool {
        if !self.bounds.contains(p) {
            return false;
        }
        let (col, row) = self.cell_of(p);
        let mut inside = false;
        for c in col..self.n_cols {
            for &i in &self.cells[row * self.n_cols + c] {
                let Segment { a, b, .. } = self.segments[i as usize];
                if (a.y > p.y) == (b.y > p.y) {
                    continue;
                }
                let x = (b.x - a.x) * (p.y - a.y) / (b.y - a.y) + a.x;
                // A segment stands in several cells of the row: it counts in the one its crossing lies in.
                if x > p.x && self.cell_of(Point2::new(x, p.y)).0 == c {
                    inside = !inside;
                }
            }
        }
        inside
    }
}

/// The point of the segment `a`..`b` nearest to `p`.
#[must_use]
pub fn nearest_on_segment(p: Point2, a: Point2, b: Point2) -> Point2 {
    let along = b - a;
    let length2 = along.norm_squared();
    if length2 <= 0.0 {
        return a;
    }
    a + along * ((p - a).dot(&along) / length2).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute_force(contours: &[Contour], p: Point2) -> f64 {
        let edges = contours.iter().flat_map(Contour::edges);
        let nearest =
            edges.map(|(a, b)| (nearest_on_segment(p, a, b) - p).norm()).fold(f64::INFINITY, f64::min);
        let inside = contours.iter().filter(|c| c.contains(p)).count() % 2 == 1;
        if inside { -nearest } else { nearest }
    }

    proptest! {
        #[test]
        fn agrees_with_brute_force(x in -12.0..12.0f64, y in -12.0..12.0f64, n in 3usize..80, r in 0.5..4.0f64) {
            let contours = [
                Contour::circle(Point2::new(0.3, 0.1), r, n),
                Contour::circle(Point2::new(5.5, -1.0), 1.2, 7),
            ];
            let index = SegmentIndex::try_new(&contours).unwrap();
            let p = Point2::new(x, y);
            prop_assert!((index.signed_distance_mm(p) - brute_force(&contours, p)).abs() < 1e-9);
        }
    }
}
