//! What lumen, wall and tissue measure, how wide the blur is and how thick the wall: by least squares on the image.
//!
//! The image is linear in the levels; blur, wall thickness and a common shift of the boundary are linearised (the change
//! with the blur's variance is half the image's Laplacian, after the heat equation). The shift is solved for
//! so that it does not pull on the levels, then dropped: the boundary has its own, finer equations.

use super::render::{Optics, Shares, View};
use nalgebra::{Cholesky, Const, SMatrix, SVector};

/// Levels of a body and its surroundings, HU; dark lumens have their sign changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::sections) struct Levels {
    pub(in crate::sections) lumen: f64,
    pub(in crate::sections) wall: f64,
    pub(in crate::sections) tissue: f64,
}

impl Levels {
    pub(super) fn contrast(&self) -> f64 {
        self.lumen - self.wall
    }

    /// The level half-way between lumen and wall.
    pub(super) fn half(&self) -> f64 {
        0.5 * (self.lumen + self.wall)
    }

    fn less(&self, other: &Self) -> [f64; 3] {
        [self.lumen - other.lumen, self.wall - other.wall, self.tissue - other.tissue]
    }

    fn plus(&self, d: &SVector<f64, N>) -> Self {
        Self { lumen: self.lumen + d[0], wall: self.wall + d[1], tissue: self.tissue + d[2] }
    }
}

/// Where lumen and wall cover less than this, the image is not the vessel's.
const WALL_SHARE: f64 = 0.05;

/// Lumen, wall, tissue, shift, blur, wall thickness.
const N: usize = 6;
/// How far levels may stray from those of the stack at first, as part of the contrast, and lengths as part of
/// themselves.
const LEVEL_SPREAD: f64 = 0.2;
const LENGTH_SPREAD: f64 = 0.3;
/// A step changes a length by at most this part.
const MOST_STEP: f64 = 0.2;
/// Where the lumen covers less than this, or all but this, there is no edge.
const EDGE_SHARE: f64 = 1e-3;

/// Normal equations for the changes of all parameters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Equations {
    matrix: SMatrix<f64, N, N>,
    right: SVector<f64, N>,
}

impl Equations {
    pub(super) fn none() -> Self {
        Self { matrix: SMatrix::zeros(), right: SVector::zeros() }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.matrix += other.matrix;
        self.right += other.right;
    }

    /// With the wish that the levels stay near `around`, by a variance each, and that the lengths stay as they are.
    fn wishing(mut self, levels: &Levels, around: &Levels, spread: [f64; 3], lengths: [f64; 2]) -> Self {
        let pull = [spread[0], spread[1], spread[2], f64::INFINITY, lengths[0], lengths[1]].map(|v| 1.0 / v);
        let to = around.less(levels);
        for (i, pull) in pull.into_iter().enumerate() {
            self.matrix[(i, i)] += pull + 1e-12;
            self.right[i] += pull * to.get(i).copied().unwrap_or(0.0);
        }
        self
    }

    /// Levels of one body, and the variances of their errors.
    pub(super) fn levels(&self, levels: &Levels, around: &Levels, spread: [f64; 3]) -> (Levels, [f64; 3]) {
        let still = [1e-18; 2];
        let Some(factored) = self.wishing(levels, around, spread, still).factored() else {
            return (*around, spread);
        };
        let variances = factored.0.inverse();
        (levels.plus(&factored.0.solve(&factored.1)), [0, 1, 2].map(|i| variances[(i, i)]))
    }

    fn factored(self) -> Option<(Cholesky<f64, Const<N>>, SVector<f64, N>)> {
        self.matrix.cholesky().map(|m| (m, self.right))
    }

    /// Better levels and lengths of the whole stack.
    pub(super) fn stack(&self, levels: &Levels, optics: Optics, limits: &[Optics; 2]) -> (Levels, Optics) {
        let spread = first_spread(levels);
        let lengths = [optics.blur_mm, optics.wall_mm].map(|mm| (LENGTH_SPREAD * mm).powi(2));
        let factored = self.wishing(levels, levels, spread, lengths).factored();
        let d = factored.map_or_else(SVector::zeros, |(matrix, right)| matrix.solve(&right));
        let moved = |mm: f64, by: f64, low: f64, high: f64| {
            (mm + by.clamp(-MOST_STEP * mm, MOST_STEP * mm)).clamp(low, high)
        };
        let optics = Optics {
            blur_mm: moved(optics.blur_mm, d[4], limits[0].blur_mm, limits[1].blur_mm),
            wall_mm: moved(optics.wall_mm, d[5], limits[0].wall_mm, limits[1].wall_mm),
        };
        (levels.plus(&d), optics)
    }
}

/// Variances of the levels before anything is known of how they vary.
pub(super) fn first_spread(levels: &Levels) -> [f64; 3] {
    [(LEVEL_SPREAD * levels.contrast()).powi(2).max(1e-9); 3]
}

/// Variances of the true levels, from those found with their errors' variances: what is found to vary no more than
/// twice as much as errors would is one and the same.
pub(super) fn spread(found: &[(Levels, [f64; 3])], around: &Levels) -> [f64; 3] {
    let excess = |i: usize| {
        let of = |(l, v): &(Levels, [f64; 3])| l.less(around)[i].powi(2) - 2.0 * v[i];
        found.iter().map(of).sum::<f64>() / found.len().max(1) as f64
    };
    [0, 1, 2].map(|i| excess(i).max(1e-9))
}

/// Whether a pixel is part of the lumen's edge.
pub(super) fn is_edge(share: f64) -> bool {
    share > EDGE_SHARE && share < 1.0 - EDGE_SHARE
}

/// The image that the shares make.
pub(super) fn image(shares: &Shares, owners: &[usize], levels: &[Levels]) -> Vec<f64> {
    let at = |p: usize| {
        let own = &levels[owners[p]];
        let outside = own.tissue + (own.wall - own.tissue) * shares.vessel[p];
        shares.lumen.iter().zip(levels).fold(outside, |sum, (body, l)| sum + (l.lumen - own.wall) * body[p])
    };
    (0..owners.len()).map(at).collect()
}

/// What a plane shows: which part of every pixel is whose, and at what levels.
#[derive(Clone, Copy)]
pub(super) struct Shown<'a> {
    pub(super) view: &'a View,
    pub(super) shares: &'a Shares,
    /// The body that every pixel is nearest to.
    pub(super) owners: &'a [usize],
    pub(super) levels: &'a [Levels],
}

/// The equations of every body of a plane. `weight` is one over the noise that a pixel carries.
pub(super) fn equations(
    Shown { view, shares, owners, levels }: Shown<'_>,
    residual: &[f64],
    optics: Optics,
    weight: f64,
) -> Vec<Equations> {
    let mut all = vec![Equations::none(); levels.len()];
    let total = shares.total();
    let (slope, _) = view.derivatives(&total);
    let (wall_slope, _) = view.derivatives(&shares.vessel);
    let (_, laplacian) = view.derivatives(&image(shares, owners, levels));
    let tells = |p: &usize| is_edge(total[*p]) || (total[*p] <= 0.5 && shares.vessel[*p] > WALL_SHARE);
    for p in (0..owners.len()).filter(tells) {
        let (own, l) = (owners[p], &levels[owners[p]]);
        let basis = SVector::<f64, N>::from([
            shares.lumen[own][p],
            shares.vessel[p] - total[p],
            1.0 - shares.vessel[p],
            l.contrast() * slope[p].norm(),
            optics.blur_mm * laplacian[p],
            (l.wall - l.tissue) * wall_slope[p].norm(),
        ]);
        all[own].matrix += basis * basis.transpose() * weight;
        all[own].right += basis * (residual[p] * weight);
    }
    all
}
