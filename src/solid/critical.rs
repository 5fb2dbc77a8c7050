//! Where a field's section changes its topology: the heights at which a critical point of the planar field crosses
//! zero (Morse theory). A saddle joins two parts or closes a ring; a lowest point opens or ends a branch, a highest
//! one a hole.
//!
//! Critical points are looked for on a grid at several heights, followed from height to height by Newton steps on
//! the gradient, and where the field changes its sign there the height is found by the regula falsi. Cost: some
//! thousand evaluations of the field an event.

use super::event::{EventSource, Frame};
use super::grid::Jet;
use super::slab::root;
use crate::geom::{Point2, Vector2};
use nalgebra::Matrix2;
use rayon::prelude::*;
use std::cell::Cell;

/// Steps of the frame between neighbouring nodes of the search.
const SEARCH_STEPS: f64 = 4.0;
/// Critical points whose value is farther from zero than so many search steps do not reach it between two heights.
const REACH: f64 = 6.0;
/// Newton steps towards a critical point.
const MOST_STEPS: usize = 25;

/// What a critical point of a planar field is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Saddle,
    Lowest,
    Highest,
}

/// A critical point that lies on the zero of the field.
#[derive(Debug, Clone, Copy)]
pub(super) struct Critical {
    pub(super) at: Point2,
    pub(super) w: f64,
    pub(super) kind: Kind,
    /// Whether the field there rises with w.
    pub(super) rises: bool,
}

type Slice<'a> = dyn Fn(Point2) -> Jet + 'a;

/// A critical point of one height.
#[derive(Debug, Clone, Copy)]
struct Planar {
    at: Point2,
    value: f64,
    kind: Kind,
}

/// All critical points that cross zero between two heights, ascending; looked for at `n_heights` heights.
pub(super) fn criticals(
    source: &dyn EventSource,
    frame: Frame,
    [low, high]: [f64; 2],
    n_heights: usize,
) -> Vec<Critical> {
    let heights: Vec<f64> =
        (0..n_heights).map(|m| low + (high - low) * m as f64 / (n_heights - 1) as f64).collect();
    let step = SEARCH_STEPS * frame.step_mm;
    let found: Vec<Vec<Planar>> =
        heights.par_iter().map(|&w| planar(&*source.slice(w), frame, step)).collect();
    let mut all: Vec<Critical> = Vec::new();
    for m in 0..n_heights - 1 {
        for (from, to) in [(m, m + 1), (m + 1, m)] {
            for point in &found[from] {
                let Some(critical) = crossing(source, point, heights[from], heights[to], step) else {
                    continue;
                };
                let same = |c: &Critical| {
                    c.kind == critical.kind
                        && (c.at - critical.at).norm() < 0.1 * step
                        && (c.w - critical.w).abs() < 0.02 * (high - low)
                };
                if !all.iter().any(same) {
                    all.push(critical);
                }
            }
        }
    }
    all.sort_by(|a, b| a.w.total_cmp(&b.w).then(a.at.x.total_cmp(&b.at.x)));
    all
}

/// The critical point followed from one height to another, where its value changes sign on the way.
fn crossing(source: &dyn EventSource, start: &Planar, from: f64, to: f64, step: f64) -> Option<Critical> {
    let there = settled(&*source.slice(to), start.at, step)?;
    if (there.value < 0.0) == (start.value < 0.0) || there.kind != start.kind {
        return None;
    }
    // From the nearest one found so far: the point moves steadily with the height.
    let last = Cell::new(start.at);
    let rises = (there.value > start.value) == (to > from);
    let sign = if there.value > start.value { 1.0 } else { -1.0 };
    let value = |t: f64| {
        let w = from + (to - from) * t;
        let found = settled(&*source.slice(w), last.get(), step);
        found.map_or(0.0, |p| {
            last.set(p.at);
            sign * p.value
        })
    };
    let w = from + (to - from) * root(value, 0.0, 1.0);
    let at = settled(&*source.slice(w), last.get(), step)?;
    (at.kind == start.kind).then_some(Critical { at: at.at, w, kind: at.kind, rises })
}

/// Critical points of one height that are near enough to zero.
fn planar(slice: &Slice<'_>, frame: Frame, step: f64) -> Vec<Planar> {
    let size = frame.bounds.size();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a size over a step")]
    let count = |extent: f64| (extent / step).ceil() as usize + 1;
    let (n_x, n_y) = (count(size.x), count(size.y));
    let point = |i: usize, j: usize| frame.bounds.min + Vector2::new(i as f64, j as f64) * step;
    let values: Vec<f64> = (0..n_x * n_y).map(|k| slice(point(k % n_x, k / n_x)).value).collect();
    let mut found: Vec<Planar> = Vec::new();
    for j in 1..n_y.saturating_sub(1) {
        for i in 1..n_x.saturating_sub(1) {
            let here = values[j * n_x + i];
            if here.abs() > REACH * step {
                continue;
            }
            let ring = [(2, 1), (2, 2), (1, 2), (0, 2), (0, 1), (0, 0), (1, 0), (2, 0)];
            let above = ring.map(|(di, dj)| values[(j + dj - 1) * n_x + i + di - 1] > here);
            let changes = (0..8).filter(|&k| above[k] != above[(k + 1) % 8]).count();
            if changes == 2 {
                continue;
            }
            let Some(critical) = settled(slice, point(i, j), step) else { continue };
            let close = |p: &Planar| p.kind == critical.kind && (p.at - critical.at).norm() < 1e-3 * step;
            if critical.value.abs() <= REACH * step && !found.iter().any(close) {
                found.push(critical);
            }
        }
    }
    found
}

/// Newton steps on the gradient from a point near a critical one, no farther than three search steps.
fn settled(slice: &Slice<'_>, start: Point2, step: f64) -> Option<Planar> {
    let mut p = start;
    let mut slope = slice(p).slope;
    for _ in 0..MOST_STEPS {
        let bend = hessian(slice, p, 1e-3 * step);
        let mut by = bend.try_inverse()? * slope;
        by *= (0.5 * step / by.norm().max(1e-300)).min(1.0);
        // Where the field is all but creased a whole step would jump to and fro across the crease.
        let shorter = (0..8).map(|k| by * 0.5f64.powi(k)).find_map(|by| {
            let there = slice(p - by).slope;
            (there.norm() < slope.norm()).then_some((by, there))
        });
        let Some((by, there)) = shorter else { break };
        (p, slope) = (p - by, there);
        if (p - start).norm() > 3.0 * step {
            return None;
        }
        if by.norm() < 1e-7 * step {
            break;
        }
    }
    let jet = slice(p);
    // Where lobes begin to blend the second derivative jumps, and the steps may end beside the point.
    if jet.slope.norm() > 1e-3 {
        return None;
    }
    let bend = hessian(slice, p, 1e-2 * step);
    let kind = if bend.determinant() < 0.0 {
        Kind::Saddle
    } else if bend.trace() > 0.0 {
        Kind::Lowest
    } else {
        Kind::Highest
    };
    Some(Planar { at: p, value: jet.value, kind })
}

/// Second derivatives by central differences of the gradient.
pub(super) fn hessian(slice: &Slice<'_>, p: Point2, h: f64) -> Matrix2<f64> {
    let along = |d: Vector2| (slice(p + d).slope - slice(p - d).slope) / (2.0 * h);
    let (x, y) = (along(Vector2::new(h, 0.0)), along(Vector2::new(0.0, h)));
    let mixed = 0.5 * (x.y + y.x);
    Matrix2::new(x.x, mixed, mixed, y.y)
}
