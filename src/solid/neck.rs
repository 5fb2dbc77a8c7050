//! Where two branches of a computed surface part, for sources too costly to be searched for all critical points.

use super::critical::{Critical, Kind};
use super::event::EventSource;
use super::sweep::Interval;
use crate::geom::{Point2, Vector2};

/// The saddles between the branches, lowest first: for each branch the highest that joins it with others.
pub(super) fn criticals(source: &dyn EventSource, interval: &Interval<'_>) -> Vec<Critical> {
    let n = interval.upper.len();
    let pairs = (0..n).flat_map(|i| (i + 1..n).map(move |j| [i, j]));
    let mut apexes: Vec<Apex> = pairs.filter_map(|pair| apex(source, pair, interval.w)).collect();
    apexes.sort_by(|a, b| b.w.total_cmp(&a.w));
    let mut cluster: Vec<usize> = (0..n).collect();
    let mut found = Vec::new();
    for apex in apexes {
        let [a, b] = apex.lobes.map(|l| cluster[l]);
        if a != b {
            cluster.iter_mut().filter(|c| **c == b).for_each(|c| *c = a);
            let at = neck(source, apex.lobes, apex.w).1;
            found.push(Critical { at, w: apex.w, kind: Kind::Saddle, rises: true });
        }
    }
    found.reverse();
    found
}

/// The saddle point between two daughters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Apex {
    pub(super) w: f64,
    pub(super) lobes: [usize; 2],
}

/// The apex between lobes i and j in (low, high); `None` where the field has no sign change there.
pub(super) fn apex(source: &dyn EventSource, lobes: [usize; 2], [low, high]: [f64; 2]) -> Option<Apex> {
    let neck = |w: f64| neck(source, lobes, w).0;
    let (mut a, mut b) = (low, high);
    let (mut fa, mut fb) = (neck(a), neck(b));
    if fa >= 0.0 || fb <= 0.0 {
        return None;
    }
    // Illinois variant of the regula falsi: an end that stays twice counts for half, so that both ends close in.
    let mut root = a;
    let mut low_end_moved = None;
    for _ in 0..40 {
        root = (a * fb - b * fa) / (fb - fa);
        let f = neck(root);
        if f.abs() < 1e-6 || b - a < 1e-6 {
            break;
        }
        if f < 0.0 {
            (a, fa) = (root, f);
            fb *= if low_end_moved == Some(true) { 0.5 } else { 1.0 };
        } else {
            (b, fb) = (root, f);
            fa *= if low_end_moved == Some(false) { 0.5 } else { 1.0 };
        }
        low_end_moved = Some(f < 0.0);
    }
    Some(Apex { w: root, lobes })
}

/// The field's value at its saddle in the plane w, the highest value that a path from branch to branch must cross,
/// and where. Nested golden sections, because the field may have a crease there.
fn neck(source: &dyn EventSource, [i, j]: [usize; 2], w: f64) -> (f64, Point2) {
    let (from, to) = (source.anchor(i, w), source.anchor(j, w));
    let along = to - from;
    let across = Vector2::new(-along.y, along.x);
    let ridge = |y: f64| {
        let value = |x: f64| source.value(from + along * x + across * y, w);
        let best = (1..24)
            .map(|k| f64::from(k) / 24.0)
            .max_by(|a, b| value(*a).total_cmp(&value(*b)))
            .unwrap_or(0.5);
        let (x, lowest) = minimum(|x| -value(x), best - 1.0 / 24.0, best + 1.0 / 24.0);
        (x, -lowest)
    };
    let lowest = (-6..=6)
        .map(|k| f64::from(k) / 15.0)
        .min_by(|a, b| ridge(*a).1.total_cmp(&ridge(*b).1))
        .unwrap_or(0.0);
    let (y, value) = minimum(|y| ridge(y).1, lowest - 1.0 / 15.0, lowest + 1.0 / 15.0);
    (value, from + along * ridge(y).0 + across * y)
}

/// Where a unimodal function is least on an interval, and its value there, by golden section.
fn minimum(f: impl Fn(f64) -> f64, mut a: f64, mut b: f64) -> (f64, f64) {
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let (mut c, mut d) = (b - RATIO * (b - a), a + RATIO * (b - a));
    let (mut fc, mut fd) = (f(c), f(d));
    for _ in 0..18 {
        if fc < fd {
            (b, d, fd) = (d, c, fc);
            c = b - RATIO * (b - a);
            fc = f(c);
        } else {
            (a, c, fc) = (c, d, fd);
            d = a + RATIO * (b - a);
            fd = f(d);
        }
    }
    if fc < fd { (c, fc) } else { (d, fd) }
}
