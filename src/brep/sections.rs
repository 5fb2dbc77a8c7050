//! Horizontal sections of a boundary representation, as directed polylines with the material to their left.
//!
//! Tubes and laterals are cut along an iso-curve; the saddle, whose height is no parameter, by marching over a grid.

use super::{Brep, Face, Shell, Surface};
use crate::geom::{Point2, Point3, Vector2};
use crate::spline::{PatchSurface, Side, Span};

/// Cells of the grid on which a saddle is cut, each way, for each chord of a lateral. They are closer towards the borders.
const CELLS_PER_CHORD: f64 = 0.25;

/// A polyline of a section.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Piece {
    pub(super) face: usize,
    pub(super) points: Vec<Point2>,
}

impl Piece {
    pub(super) fn edges(&self) -> impl Iterator<Item = (Point2, Point2)> {
        self.points.windows(2).map(|p| (p[0], p[1]))
    }
}

/// Faces made ready to be cut at many heights, each into about `n` chords.
pub(super) struct Cutter<'a> {
    parts: Vec<Part<'a>>,
}

struct Part<'a> {
    face: usize,
    surface: &'a PatchSurface,
    is_outward: bool,
    z_mm: [f64; 2],
    how: How,
}

enum How {
    /// v at a height is found on the first column.
    Rows(Vec<Span>),
    /// Points of the grid, row by row, and how many a row has.
    Grid(Vec<Point3>, usize),
}

impl<'a> Cutter<'a> {
    pub(super) fn new(brep: &'a Brep, faces: impl Iterator<Item = usize>, n: usize) -> Self {
        Self { parts: faces.filter_map(|i| part(i, &brep.faces[i], n)).collect() }
    }

    /// Heights between which each part lies.
    pub(super) fn ranges(&self) -> impl Iterator<Item = [f64; 2]> {
        self.parts.iter().map(|p| p.z_mm)
    }

    /// The section at a height that is no end of a part.
    pub(super) fn cut(&self, z_mm: f64) -> Vec<Piece> {
        let here = self.parts.iter().filter(|p| p.z_mm[0] < z_mm && z_mm < p.z_mm[1]);
        here.flat_map(|p| p.cut(z_mm)).collect()
    }
}

fn part(face: usize, of: &Face, n: usize) -> Option<Part<'_>> {
    let surface = of.surface.spline()?;
    let [u, _] = surface.bases();
    let [from, to] = u.range();
    let how = if let Surface::Saddle(_) = of.surface {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of cells")]
        let cells = (CELLS_PER_CHORD * n as f64).ceil() as usize;
        let cosine = |k: usize| 0.5 * (1.0 - (std::f64::consts::PI * k as f64 / cells as f64).cos());
        let at = |k: usize| from + (to - from) * cosine(k);
        let row = |j: usize| {
            let row = surface.row(at(j));
            (0..=cells).map(|i| row.at(at(i))).collect::<Vec<_>>()
        };
        How::Grid((0..=cells).flat_map(row).collect(), cells + 1)
    } else {
        How::Rows((0..=n).map(|k| u.at(from + (to - from) * k as f64 / n as f64)).collect())
    };
    let z_mm = match &how {
        How::Rows(_) => heights(surface),
        How::Grid(points, _) => {
            let heights = points.iter().map(|p| p.z);
            heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], z| [a.min(z), b.max(z)])
        }
    };
    Some(Part { face, surface, is_outward: of.is_outward, z_mm, how })
}

/// Lowest and highest z of a surface whose height depends on v alone.
fn heights(surface: &PatchSurface) -> [f64; 2] {
    let [a, b] = surface.border_column(Side::First).ends().map(|p| p.z);
    [a.min(b), a.max(b)]
}

impl Part<'_> {
    fn cut(&self, z_mm: f64) -> Vec<Piece> {
        let polylines = match &self.how {
            How::Rows(spans) => {
                let row = self.surface.row(self.v_at(z_mm));
                let mut points: Vec<Point2> =
                    spans.iter().map(|s| Point2::from(row.weighted(*s).xy())).collect();
                if !self.runs_with_material_left() {
                    points.reverse();
                }
                vec![points]
            }
            How::Grid(points, n) => self.cut_grid(points, *n, z_mm),
        };
        polylines.into_iter().map(|points| Piece { face: self.face, points }).collect()
    }

    /// Whether the surface rises with v.
    fn rises(&self) -> bool {
        let [a, b] = self.surface.border_column(Side::First).ends();
        a.z < b.z
    }

    /// With u to the left of the outward normal seen from above, the material is to the left.
    fn runs_with_material_left(&self) -> bool {
        self.is_outward == self.rises()
    }

    fn v_at(&self, z_mm: f64) -> f64 {
        let [mut a, mut b] = self.surface.v_range();
        let is_level = self.surface.bases()[1].range() == self.z_mm;
        if is_level {
            return z_mm;
        }
        let column = self.surface.border_column(Side::First);
        let rises = self.rises();
        for _ in 0..50 {
            let middle = 0.5 * (a + b);
            if (column.at(middle).z < z_mm) == rises { a = middle } else { b = middle }
        }
        0.5 * (a + b)
    }

    /// Segments of the plane's cut through the grid's triangles, each directed by the triangle's own normal.
    fn cut_grid(&self, points: &[Point3], n: usize, z_mm: f64) -> Vec<Vec<Point2>> {
        let mut out = Vec::new();
        for j in 0..n - 1 {
            for i in 0..n - 1 {
                let at = |di: usize, dj: usize| points[(j + dj) * n + i + di];
                let quad = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                for t in [[0, 1, 2], [0, 2, 3]] {
                    out.extend(self.cut_triangle(t.map(|k: usize| quad[k]), z_mm));
                }
            }
        }
        out
    }

    fn cut_triangle(&self, t: [Point3; 3], z_mm: f64) -> Option<Vec<Point2>> {
        let crossing = |a: Point3, b: Point3| {
            ((a.z < z_mm) != (b.z < z_mm)).then(|| (a + (b - a) * ((z_mm - a.z) / (b.z - a.z))).xy())
        };
        let found: Vec<Point2> = (0..3).filter_map(|k| crossing(t[k], t[(k + 1) % 3])).collect();
        let [a, b] = found[..] else { return None };
        let normal = (t[1] - t[0]).cross(&(t[2] - t[0])) * if self.is_outward { 1.0 } else { -1.0 };
        let left_turned = Vector2::new(-normal.y, normal.x);
        Some(if (b - a).dot(&left_turned) >= 0.0 { vec![a, b] } else { vec![b, a] })
    }
}

/// How often the directed polylines go round a point, counter-clockwise.
pub(super) fn winding(pieces: &[Piece], p: Point2) -> f64 {
    let turn = |(a, b): (Point2, Point2)| {
        let (a, b) = (a - p, b - p);
        a.perp(&b).atan2(a.dot(&b))
    };
    pieces.iter().flat_map(Piece::edges).map(turn).sum::<f64>() / std::f64::consts::TAU
}

impl Brep {
    /// Whether a shell lies inside another one, told by a section through it.
    pub(super) fn holds(&self, outer: &Shell, inner: &Shell) -> bool {
        let coarse = 64;
        let cutter = Cutter::new(self, inner.faces.iter().copied(), coarse);
        let Some([low, high]) = cutter.ranges().next() else { return false };
        let z_mm = 0.5 * (low + high) + 1e-3 * (high - low);
        let Some(point) = cutter.cut(z_mm).first().map(|piece| piece.points[0]) else { return false };
        let around = Cutter::new(self, outer.faces.iter().copied(), coarse).cut(z_mm);
        winding(&around, point).abs() > 0.5
    }
}
