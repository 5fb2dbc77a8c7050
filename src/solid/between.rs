//! Sections half-way between given ones where neighbouring contours differ too much for points to correspond.
//!
//! A tube joins points at the same share of their contours' lengths. Where one contour has a bump that its neighbours
//! do not have, that shifts all points round it. Signed distances know no correspondence: the zero of their cubic
//! interpolation from the two contours on either side (as in G. T. Herman, J. Zheng, C. A. Bucholtz, "Shape-based
//! interpolation", 1992) is added as a section. On smooth vessels, and where a radius changes fast, the tube is the
//! better one; which of them holds is asked of the sections themselves: each is predicted both ways from the two on
//! either side of it, and where distances come much nearer, points do not correspond.
//!
//! Cost: linear in the sections; eight distances a point, fifty where a section is added.

use super::skin::{GivenSection, Strand};
use crate::geom::{Contour, Point2, SegmentIndex, Vector2};
use crate::spline::TubeSurface;
use crate::topology::meets_itself;

/// How far, over the radius, corresponding points must miss a section left out, and how much nearer to it the
/// distances must come, for points not to correspond: on smooth vessels distances come no nearer.
const LEAST_OFF: f64 = 0.05;
const LEAST_GAIN: f64 = 0.8;
/// Farthest that an added section lies from the tube, over the radius.
const MOST_MOVED: f64 = 0.25;
/// An interval shorter than this share of the longest one, or with a neighbour shorter than this share of itself, has
/// sections enough.
const LEAST_INTERVAL: f64 = 0.6;
/// Planes nearer to each other than this share of the radius leave nothing to be told between them.
const LEAST_APART: f64 = 0.3;
/// Where in an interval sections are added, as shares of it.
const SHARES: [f64; 3] = [0.25, 0.5, 0.75];
/// Steps from the tube to the zero of the distances.
const STEPS: usize = 4;

/// The contours round an interval with their weights at a height in it.
struct Stencil {
    contours: [(SegmentIndex, f64); 4],
}

impl Stencil {
    fn at(sections: [&GivenSection; 4], z_mm: f64) -> Option<Self> {
        let z = sections.map(|s| s.0);
        // Lagrange's polynomials.
        let weight =
            |i: usize| -> f64 { (0..4).filter(|j| *j != i).map(|j| (z_mm - z[j]) / (z[i] - z[j])).product() };
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| {
            let contour = std::slice::from_ref(&sections[i].1);
            SegmentIndex::try_new(contour).map(|index| (index, weight(i)))
        });
        Some(Self { contours: [a?, b?, c?, d?] })
    }

    fn value(&self, p: Point2) -> f64 {
        self.contours.iter().map(|(index, weight)| weight * index.signed_distance_mm(p)).sum()
    }

    /// Corresponding points of the four contours, interpolated with the same weights.
    fn corresponding(&self, points: &[Vec<Point2>; 4]) -> Vec<Point2> {
        let weighted = |i: usize| -> Vector2 {
            points.iter().zip(&self.contours).map(|(at, c)| at[i].coords * c.1).sum()
        };
        (0..points[0].len()).map(|i| Point2::from(weighted(i))).collect()
    }

    /// The way from a point to the zero, no longer than `most_mm`.
    fn way(&self, start: Point2, most_mm: f64) -> Vector2 {
        let mut p = start;
        for _ in 0..STEPS {
            const H: f64 = 1e-4;
            let value = self.value(p);
            let along = |d: Vector2| (self.value(p + d) - value) / H;
            let slope = Vector2::new(along(Vector2::new(H, 0.0)), along(Vector2::new(0.0, H)));
            p -= slope * (value / slope.norm_squared().max(0.25));
        }
        let by = p - start;
        by * (most_mm / by.norm().max(1e-300)).min(1.0)
    }
}

/// How far a section left out is missed by what the two on either side say of it, root mean square, mm.
#[derive(Debug, Clone, Copy, Default)]
struct Missed {
    by_distances: f64,
    by_points: f64,
}

impl Missed {
    fn at(surface: &TubeSurface, sections: &[GivenSection], k: usize) -> Option<Self> {
        let around = [k.checked_sub(2)?, k - 1, k + 1, k + 2].map(|i| sections.get(i));
        let [Some(a), Some(b), Some(c), Some(d)] = around else { return None };
        let around = [a, b, c, d];
        let (z_mm, contour) = &sections[k];
        let stencil = Stencil::at(around, *z_mm)?;
        let itself = SegmentIndex::try_new(std::slice::from_ref(contour))?;
        let points = around.map(|s| surface.section(s.0).points());
        let alike = stencil.corresponding(&points);
        let by_points = alike.iter().step_by(4).map(|p| itself.nearest(*p).distance_mm);
        let by_distances = surface.section(*z_mm).points().into_iter().step_by(4).map(|p| stencil.value(p));
        Some(Self { by_distances: root_mean_square(by_distances), by_points: root_mean_square(by_points) })
    }
}

/// Radius of the disk of a contour's area.
pub(super) fn radius_mm(contour: &Contour) -> f64 {
    (contour.signed_area_mm2().abs() / std::f64::consts::PI).sqrt()
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
    (sum / f64::max(n, 1.0)).sqrt()
}

/// The sections to be added to a tube through those of a strand, which ascend.
pub(super) fn between(surface: &TubeSurface, strand: &Strand) -> Vec<GivenSection> {
    let sections = strand.sections.as_slice();
    let gap = |k: usize| sections[k + 1].0 - sections[k].0;
    let widest = (0..sections.len().saturating_sub(1)).map(gap).fold(0.0, f64::max);
    let wide = |k: &usize| {
        gap(*k) >= LEAST_APART * radius_mm(&sections[*k].1)
            && gap(*k) >= LEAST_INTERVAL * widest
            && gap(k - 1).min(gap(k + 1)) >= LEAST_INTERVAL * gap(*k)
    };
    let is_misled: Vec<bool> = (0..sections.len())
        .map(|k| {
            Missed::at(surface, sections, k).is_some_and(|missed| {
                missed.by_points > LEAST_OFF * radius_mm(&sections[k].1)
                    && missed.by_distances < LEAST_GAIN * missed.by_points
            })
        })
        .collect();
    // A section left out is predicted from two on either side: it speaks of the intervals between those.
    let is_doubtful = |k: &usize| is_misled[k - 1..=(k + 2).min(is_misled.len() - 1)].contains(&true);
    let added = |k: usize| {
        let around = [0, 1, 2, 3].map(|i| &sections[k + i - 1]);
        let most_mm = MOST_MOVED * radius_mm(&sections[k].1);
        SHARES.into_iter().filter_map(move |share| moved(surface, around, share, most_mm))
    };
    (1..sections.len().saturating_sub(2)).filter(wide).filter(is_doubtful).flat_map(added).collect()
}

/// The tube's section at a share of the way between the middle two of four, moved onto the zero of the interpolated
/// distances.
fn moved(
    surface: &TubeSurface,
    around: [&GivenSection; 4],
    share: f64,
    most_mm: f64,
) -> Option<GivenSection> {
    let z_mm = around[1].0 + share * (around[2].0 - around[1].0);
    let stencil = Stencil::at(around, z_mm)?;
    let points = surface.section(z_mm).points();
    let moved = Contour::new(points.iter().map(|p| p + stencil.way(*p, most_mm)).collect());
    // Where distances have creases points may overtake each other: such a curve tells nothing.
    (!meets_itself(&moved)).then_some((z_mm, moved))
}
