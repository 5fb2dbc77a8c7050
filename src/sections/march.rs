//! The zero line of values on a grid, as closed loops: marching squares.
//!
//! Crossings lie where the linear interpolation along a grid edge vanishes; a saddle is decided by the mean of
//! its four corners (Nielson & Hamann, "The asymptotic decider", IEEE Visualization 1991, in its simple form).
//! The positive side lies to the left, so outer loops run counter-clockwise and holes clockwise. Loops never
//! cross or touch.

/// Values on a grid, x fastest. The outermost rows and columns must be negative, so that all loops close.
#[derive(Debug, Clone)]
pub(crate) struct Grid {
    pub(crate) n_cols: usize,
    pub(crate) n_rows: usize,
    pub(crate) values: Vec<f64>,
}

const NONE: u32 = u32::MAX;

impl Grid {
    fn at(&self, i: usize, j: usize) -> f64 {
        self.values[j * self.n_cols + i]
    }

    /// The closed loops, in grid coordinates, ordered by where they are met first.
    pub(crate) fn loops(&self) -> Vec<Vec<[f64; 2]>> {
        let mut next = vec![NONE; 2 * self.values.len()];
        for j in 0..self.n_rows - 1 {
            for i in 0..self.n_cols - 1 {
                self.link_cell(i, j, &mut next);
            }
        }
        let mut loops = Vec::new();
        for start in 0..next.len() {
            let mut points = Vec::new();
            let mut at = start;
            while next[at] != NONE {
                points.push(self.crossing(at));
                at = std::mem::replace(&mut next[at], NONE) as usize;
            }
            if points.len() > 2 {
                loops.push(points);
            }
        }
        loops
    }

    /// Grid edges are numbered 2 p (from point p along x) and 2 p + 1 (along y). Writes which edge the line goes
    /// to from each edge of the cell.
    fn link_cell(&self, i: usize, j: usize, next: &mut [u32]) {
        let p = j * self.n_cols + i;
        let corners = [self.at(i, j), self.at(i + 1, j), self.at(i + 1, j + 1), self.at(i, j + 1)];
        let inside = corners.map(|v| v > 0.0);
        let edges = [2 * p, 2 * (p + 1) + 1, 2 * (p + self.n_cols), 2 * p + 1];
        // Walking the cell's border counter-clockwise, the line leaves through the edge where the positive side
        // ends and comes to the one where it began.
        let leaves = |e: usize| inside[e] && !inside[(e + 1) % 4];
        let enters = |e: usize| !inside[e] && inside[(e + 1) % 4];
        let joined = corners.iter().sum::<f64>() > 0.0;
        for from in (0..4).filter(|&e| leaves(e)) {
            // A saddle whose middle is positive joins the two positive corners: the line turns round the
            // negative corner ahead instead of the positive one behind.
            let mut ahead = (1..4).map(|s| if joined { (from + s) % 4 } else { (from + 4 - s) % 4 });
            if let Some(to) = ahead.find(|&e| enters(e)) {
                next[edges[from]] = u32::try_from(edges[to]).unwrap_or(NONE);
            }
        }
    }

    fn crossing(&self, edge: usize) -> [f64; 2] {
        let p = edge / 2;
        let (i, j) = (p % self.n_cols, p / self.n_cols);
        let along_x = edge.is_multiple_of(2);
        let a = self.values[p];
        let b = self.values[if along_x { p + 1 } else { p + self.n_cols }];
        let t = a / (a - b);
        if along_x { [i as f64 + t, j as f64] } else { [i as f64, j as f64 + t] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Point2};

    fn grid(n: usize, f: impl Fn(f64, f64) -> f64) -> Grid {
        let values = (0..n * n).map(|p| f((p % n) as f64, (p / n) as f64)).collect();
        Grid { n_cols: n, n_rows: n, values }
    }

    fn contours(grid: &Grid) -> Vec<Contour> {
        let contour =
            |l: Vec<[f64; 2]>| Contour::new(l.into_iter().map(|[x, y]| Point2::new(x, y)).collect());
        grid.loops().into_iter().map(contour).collect()
    }

    #[test]
    fn ring_has_a_ccw_outer_and_a_cw_inner_loop() {
        let ring = contours(&grid(40, |x, y| 4.0 - ((x - 20.3).hypot(y - 19.6) - 10.0).abs()));
        let areas: Vec<f64> = ring.iter().map(Contour::signed_area_mm2).collect();
        assert_eq!(areas.len(), 2);
        assert!((areas[0] - std::f64::consts::PI * 196.0).abs() < 4.0, "{areas:?}");
        assert!((areas[1] + std::f64::consts::PI * 36.0).abs() < 4.0, "{areas:?}");
    }

    #[test]
    fn saddle_is_joined_or_split_by_its_mean() {
        let two = |middle: f64| {
            let mut grid = grid(6, |_, _| -1.0);
            for (p, v) in [(14, 1.0), (21, 1.0), (20, middle), (15, middle)] {
                grid.values[p] = v;
            }
            grid
        };
        assert_eq!(two(-0.5).loops().len(), 1);
        assert_eq!(two(-1.5).loops().len(), 2);
    }
}
