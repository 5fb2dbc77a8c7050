//! Sections that keep a tube steady behind planes that lie close together.
//!
//! One cubic spline in z runs through all sections of a branch. Where two of them follow each other within a fraction of
//! the interval beside them, what they miss of each other by noise is a slope, and the spline carries it on across that
//! interval: 0.02 mm between planes 0.001 mm apart made the next 3 mm swing out by 10 mm. The slope with which a tube
//! enters a long interval should be told by sections that lie about as far apart as that is long. So each such interval
//! is interpolated from its own two sections and the nearest ones that far off (Lagrange's polynomial over corresponding
//! points); where the tube leaves that course, sections of it are added behind the close planes, at distances that grow
//! threefold. The tube stays twice continuously differentiable and runs through every contour.
//!
//! Cost: a few sections of the tube for each interval with a much shorter neighbour, and nothing elsewhere.

use super::between::radius_mm;
use super::skin::{End, GivenSection, Strand};
use crate::geom::{Contour, Point2, Vector2};
use crate::spline::TubeSurface;

/// An interval with a neighbour shorter than this share of it may take a slope from it that it should not.
const SHORT: f64 = 0.2;
/// How far beyond an interval, as a share of it, the sections lie that tell its slope at least.
const SPREAD: f64 = 0.3;
/// How far the tube may leave the course told so, over the radius: less is what courses differ by.
const MOST_OFF: f64 = 0.02;
/// Shares of an interval at which it is looked at.
const SHARES: [f64; 4] = [0.15, 0.35, 0.65, 0.85];
/// Distances of added sections: the first one in lengths of the short interval, each further one in the one before, and
/// up to which share of the long one.
const FIRST: f64 = 1.0;
const GROWTH: f64 = 3.0;
const LAST: f64 = 0.34;
/// Every how many points round a tube it is compared.
const STRIDE: usize = 4;

/// The sections to be added to a tube through those of a strand, which ascend.
pub(super) fn steadying(surface: &TubeSurface, strand: &Strand) -> Vec<GivenSection> {
    let n_intervals = strand.sections.len().saturating_sub(1);
    let intervals = (0..n_intervals).filter_map(|k| Long::of(strand, k));
    intervals.filter(|long| long.is_left_by(surface)).flat_map(|long| long.sections(surface)).collect()
}

/// An interval with a much shorter neighbour.
struct Long<'a> {
    sections: &'a [GivenSection],
    /// Its lower section.
    lower: usize,
    /// Lengths of the neighbours below and above that are much shorter.
    short_mm: [Option<f64>; 2],
    /// The sections that tell its course.
    told_by: Vec<usize>,
}

impl<'a> Long<'a> {
    /// `None` where no neighbour is much shorter, or where the tube leads on into the patches of an event from there: the
    /// sections beside those are close together, and of one field.
    fn of(strand: &'a Strand, lower: usize) -> Option<Self> {
        let sections = strand.sections.as_slice();
        let z = |k: usize| sections[k].0;
        let length_mm = z(lower + 1) - z(lower);
        let below = lower.checked_sub(1).map(|k| z(lower) - z(k));
        let above = sections.get(lower + 2).map(|s| s.0 - z(lower + 1));
        let short_mm = [below, above].map(|mm| mm.filter(|mm| *mm < SHORT * length_mm));
        let far = SPREAD * length_mm;
        let beyond = [
            (0..lower).rev().find(|&k| z(lower) - z(k) >= far),
            (lower + 2..sections.len()).find(|&k| z(k) - z(lower + 1) >= far),
        ];
        let is_known = |side: usize| {
            let end = [strand.bottom, strand.top][side];
            short_mm[side].is_none() || beyond[side].is_some() || end == End::Cap
        };
        let is_long = short_mm.iter().any(Option::is_some) && is_known(0) && is_known(1);
        let told_by = beyond[0].into_iter().chain([lower, lower + 1]).chain(beyond[1]).collect();
        is_long.then_some(Self { sections, lower, short_mm, told_by })
    }

    fn z_mm(&self) -> [f64; 2] {
        [self.sections[self.lower].0, self.sections[self.lower + 1].0]
    }

    /// Corresponding points of the sections that tell the course.
    fn points(&self, surface: &TubeSurface) -> Vec<Vec<Point2>> {
        self.told_by.iter().map(|&k| surface.section(self.sections[k].0).points()).collect()
    }

    /// The course at a height.
    fn course(&self, points: &[Vec<Point2>], z_mm: f64) -> Vec<Point2> {
        let z = |j: usize| self.sections[self.told_by[j]].0;
        let n = self.told_by.len();
        let weight =
            |j: usize| (0..n).filter(|m| *m != j).map(|m| (z_mm - z(m)) / (z(j) - z(m))).product::<f64>();
        let weights: Vec<f64> = (0..n).map(weight).collect();
        let at = |i: usize| points.iter().zip(&weights).map(|(p, w)| p[i].coords * *w).sum::<Vector2>();
        (0..points[0].len()).map(|i| at(i).into()).collect()
    }

    /// Whether the tube leaves the course.
    fn is_left_by(&self, surface: &TubeSurface) -> bool {
        let points = self.points(surface);
        let [low, high] = self.z_mm();
        let most_mm = MOST_OFF * radius_mm(&self.sections[self.lower].1);
        SHARES.into_iter().any(|share| {
            let z_mm = low + share * (high - low);
            let (course, tube) = (self.course(&points, z_mm), surface.section(z_mm).points());
            course.iter().zip(&tube).step_by(STRIDE).any(|(p, q)| (p - q).norm() > most_mm)
        })
    }

    /// Sections of the course behind the close planes.
    fn sections(&self, surface: &TubeSurface) -> Vec<GivenSection> {
        let points = self.points(surface);
        let [low, high] = self.z_mm();
        let last = LAST * (high - low);
        let offsets = |short: Option<f64>| {
            let first = short.map(|mm| (FIRST * mm).min(last));
            std::iter::successors(first, |mm| Some(GROWTH * mm)).take_while(move |mm| *mm <= last)
        };
        let [below, above] = self.short_mm;
        let heights = offsets(below).map(|mm| low + mm).chain(offsets(above).map(|mm| high - mm));
        heights.map(|z_mm| (z_mm, Contour::new(self.course(&points, z_mm)))).collect()
    }
}
