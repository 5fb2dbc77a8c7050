//! The beads of one layer as pieces, planned and recorded, and what their sums and moments say.

use super::super::record::Segment;
use crate::geom::{Point2, Vector2};
use crate::profile::BeadShape;
use crate::toolpath::{Bead, BeadModel, LayerPaths};

/// A straight piece of a bead. Bed frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    pub(super) from: Point2,
    pub(super) to: Point2,
    pub(super) width_mm: f64,
    pub(super) volume_mm3: f64,
}

impl Piece {
    pub(super) fn length_mm(&self) -> f64 {
        (self.to - self.from).norm()
    }

    pub(super) fn at(&self, part: f64) -> Point2 {
        self.from + (self.to - self.from) * part
    }
}

impl From<&Segment> for Piece {
    fn from(s: &Segment) -> Self {
        Self { from: s.from.xy(), to: s.to.xy(), width_mm: s.width_mm, volume_mm3: s.volume_mm3 }
    }
}

/// The pieces of a planned bead.
pub(super) fn pieces_of(bead: &Bead, model: BeadModel) -> impl Iterator<Item = Piece> + '_ {
    bead.points.windows(2).map(move |pair| {
        let (from, to, width_mm) = (pair[0].at, pair[1].at, pair[0].width_mm);
        Piece { from, to, width_mm, volume_mm3: (to - from).norm() * model.area_mm2(width_mm) }
    })
}

/// The pieces of all planned beads of a layer.
pub(super) fn planned(layer: &LayerPaths, shape: BeadShape) -> Vec<Piece> {
    let model = BeadModel::new(shape, layer.slot.height_mm);
    layer.beads.iter().flat_map(|bead| pieces_of(bead, model)).filter(|p| p.length_mm() > 0.0).collect()
}

/// The cross-section that volume, width and height of most recorded segments belong to.
pub(super) fn shape_of<'a>(segments: impl Iterator<Item = &'a Segment>) -> BeadShape {
    let fits = |shape: BeadShape, s: &Segment| {
        let expected = BeadModel::new(shape, s.height_mm).area_mm2(s.width_mm) * (s.to - s.from).norm();
        (expected - s.volume_mm3).abs() <= 0.02 * s.volume_mm3
    };
    let (mut rectangles, mut stadiums) = (0usize, 0usize);
    for segment in segments {
        rectangles += usize::from(fits(BeadShape::Rectangle, segment));
        stadiums += usize::from(fits(BeadShape::Stadium, segment));
    }
    if stadiums > rectangles { BeadShape::Stadium } else { BeadShape::Rectangle }
}

/// Lengths, volumes and moments of the centre lines of a layer.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Sums {
    pub(super) length_mm: f64,
    pub(super) volume_mm3: f64,
    /// Length times width, mm².
    pub(super) area_mm2: f64,
    /// Centroid of the centre lines.
    pub(super) centroid: Vector2,
    /// Mean squares of the distance from the centroid: xx, xy, yy, mm².
    pub(super) spread_mm2: [f64; 3],
}

impl Sums {
    pub(super) fn of<'a>(pieces: impl Iterator<Item = &'a Piece> + Clone) -> Self {
        let mut sums = Self::default();
        let mut first = Vector2::zeros();
        for piece in pieces.clone() {
            let length = piece.length_mm();
            sums.length_mm += length;
            sums.volume_mm3 += piece.volume_mm3;
            sums.area_mm2 += length * piece.width_mm;
            first += piece.at(0.5).coords * length;
        }
        if sums.length_mm <= 0.0 {
            return sums;
        }
        sums.centroid = first / sums.length_mm;
        for piece in pieces {
            let (along, off) = (piece.to - piece.from, piece.at(0.5).coords - sums.centroid);
            let weight = piece.length_mm() / sums.length_mm;
            let moment = |a: f64, b: f64, c: f64, d: f64| weight * (a * b + c * d / 12.0);
            sums.spread_mm2[0] += moment(off.x, off.x, along.x, along.x);
            sums.spread_mm2[1] += moment(off.x, off.y, along.x, along.y);
            sums.spread_mm2[2] += moment(off.y, off.y, along.y, along.y);
        }
        sums
    }

    pub(super) fn mean_width_mm(&self) -> f64 {
        self.area_mm2 / self.length_mm
    }

    /// Whether two layers have the same centre lines, apart from a shift of all.
    pub(super) fn is_same_shape(&self, other: &Self) -> bool {
        let scale = self.spread_mm2[0] + self.spread_mm2[2];
        let off =
            self.spread_mm2.iter().zip(other.spread_mm2).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        (other.length_mm - self.length_mm).abs() <= 1e-3 * self.length_mm && off <= 1e-3 * scale
    }
}
