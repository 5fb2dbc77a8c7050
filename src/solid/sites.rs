//! Where the points along a lateral patch's rows are set: closer where the splines through them leave the curve.

use crate::geom::Point2;
use crate::spline::Basis;

/// How near the spline through a border's points keeps to the field between them, mm.
const ARC_TOLERANCE_MM: f64 = 3e-4;

/// Sites with one more in the middle of each interval.
pub(super) fn halved(sites: &[f64]) -> Vec<f64> {
    let middles = sites.windows(2).map(|s| 0.5 * (s[0] + s[1])).chain(sites.last().copied());
    sites
        .iter()
        .copied()
        .zip(middles)
        .flat_map(|(site, middle)| [site, middle])
        .take(2 * sites.len() - 1)
        .collect()
}

/// Sites with one more in the middle of each interval that misses the curve, and of those beside it; no interval is more
/// than twice as long as its neighbour.
pub(super) fn closer(sites: &[f64], missed: &[bool]) -> Vec<f64> {
    let n = missed.len();
    let mut split: Vec<bool> =
        (0..n).map(|i| missed[i.saturating_sub(1)..(i + 2).min(n)].contains(&true)).collect();
    let gap = |i: usize, split: &[bool]| (sites[i + 1] - sites[i]) * if split[i] { 0.5 } else { 1.0 };
    for i in (0..n).chain((0..n).rev()) {
        let beside = [i.checked_sub(1), Some(i + 1).filter(|j| *j < n)];
        let least = beside.into_iter().flatten().map(|j| gap(j, &split)).fold(f64::INFINITY, f64::min);
        split[i] |= gap(i, &split) > 2.0 * least;
    }
    let one = |i: usize| {
        let middle = (i < n && split[i]).then(|| 0.5 * (sites[i] + sites[i + 1]));
        std::iter::once(sites[i]).chain(middle)
    };
    (0..=n).flat_map(one).collect()
}

/// For each interval between every second point whether the cubic spline through those keeps away from the other one
/// between them, across the curve.
pub(super) fn misses(points: &[Point2], sites: &[f64]) -> Vec<bool> {
    let coarse: Vec<f64> = sites.iter().copied().step_by(2).collect();
    let inner = (1..points.len() - 1).step_by(2);
    let Ok(basis) = Basis::not_a_knot(&coarse) else { return inner.map(|_| true).collect() };
    let rows: Vec<f64> = points.iter().step_by(2).flat_map(|p| [p.x, p.y]).collect();
    let control = basis.interpolate(&coarse, &rows, 2);
    let mut at = Vec::new();
    let mut is_off = |i: usize| {
        Basis::combine(basis.at(sites[i]), &control, 2, &mut at);
        let along = (points[i + 1] - points[i - 1]).try_normalize(1e-12).unwrap_or_default();
        (points[i] - Point2::new(at[0], at[1])).perp(&along).abs() > ARC_TOLERANCE_MM
    };
    inner.map(is_off).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A straight line with a bump, 0.01 wide, at 0.37.
    fn bump(at: f64) -> Point2 {
        Point2::new(10.0 * at, 0.2 * (-((at - 0.37) / 0.01).powi(2)).exp())
    }

    #[test]
    fn sites_come_closer_where_a_bump_is_and_no_interval_is_more_than_twice_its_neighbour() {
        let mut sites: Vec<f64> = (0..=64).map(|k| f64::from(k) / 64.0).collect();
        for _ in 0..6 {
            let finer = halved(&sites);
            let missed = misses(&finer.iter().map(|t| bump(*t)).collect::<Vec<_>>(), &finer);
            if !missed.contains(&true) {
                break;
            }
            sites = closer(&sites, &missed);
        }
        let finer = halved(&sites);
        assert!(!misses(&finer.iter().map(|t| bump(*t)).collect::<Vec<_>>(), &finer).contains(&true));
        assert!(sites.len() < 140 && sites[0] == 0.0 && sites[sites.len() - 1] == 1.0, "{}", sites.len());
        let gaps: Vec<f64> = sites.windows(2).map(|s| s[1] - s[0]).collect();
        let ratio = |g: &[f64]| (g[0] / g[1]).max(g[1] / g[0]);
        assert!(gaps.windows(2).all(|g| ratio(g) < 2.001), "{gaps:?}");
    }
}
