//! Critical points at nearly one height, moved apart.
//!
//! Where three branches part at one height, or where two contours part just at a plane, no slab has room. Beside each
//! such critical point the field is then taken from a little higher or lower: its heights are mapped onto each other by a
//! monotone function (a cubic after F. N. Fritsch and R. E. Carlson, 1980) that leaves the planes where they are, and
//! fades sideways before the other critical points. So the point comes to lie where it is wanted, and no other arises.

use super::critical::Critical;
use super::event::{EventSource, Frame};
use super::grid::Jet;
use super::iso;
use super::sweep::Interval;
use crate::geom::{Contour, Point2, Vector2};

/// Least distance in height between critical points, for branches of 3 mm radius, mm: what moving them costs in
/// accuracy, and what the slabs lose in thickness.
const LEAST_APART_MM: f64 = 0.1;
/// Radius within which heights are mapped, in the same unit, mm.
const MOST_RADIUS_MM: f64 = 2.0;
const LEAST_RADIUS_MM: f64 = 0.4;
/// Steps of the contours' grid over those of the source.
const FINER: f64 = 0.3;

/// A place at which heights are mapped.
#[derive(Debug, Clone, Copy)]
struct Warp {
    at: Point2,
    radius: f64,
    /// The lower plane, the wanted height of the critical point, the upper plane.
    sites: [f64; 3],
    /// The critical point's own height.
    own: f64,
}

impl Warp {
    /// How far from w the field is taken at the critical point: a monotone cubic through the planes and the point.
    fn shift(&self, w: f64) -> f64 {
        let [low, middle, high] = self.sites;
        let rise = [(self.own - low) / (middle - low), (high - self.own) / (high - middle)];
        let steepness = 2.0 * rise[0] * rise[1] / (rise[0] + rise[1]);
        let (x0, x1, y0, y1, d0, d1) = if w < middle {
            (low, middle, low, self.own, rise[0], steepness)
        } else {
            (middle, high, self.own, high, steepness, rise[1])
        };
        let (h, t) = (x1 - x0, ((w - x0) / (x1 - x0)).clamp(0.0, 1.0));
        let s = 1.0 - t;
        let mapped =
            y0 * s * s * (1.0 + 2.0 * t) + y1 * t * t * (3.0 - 2.0 * t) + h * t * s * (s * d0 - t * d1);
        mapped - w.clamp(low, high)
    }

    /// 1 at the critical point, fading to 0 at the radius; with its gradient.
    fn share(&self, p: Point2) -> (f64, Vector2) {
        let d = (p - self.at) / self.radius;
        let rest = (1.0 - d.norm_squared()).max(0.0);
        (rest.powi(3), d * (-6.0 * rest * rest / self.radius))
    }
}

/// A source with warped heights.
pub(super) struct Biased<'a> {
    source: &'a dyn EventSource,
    frame: Frame,
    warps: Vec<Warp>,
    step_w: f64,
}

/// The source biased so that its critical points lie far enough from each other and from the planes; `None` where
/// they do already.
pub(super) fn spread<'a>(
    source: &'a dyn EventSource,
    frame: Frame,
    criticals: &[Critical],
    interval: &Interval<'_>,
) -> Option<Biased<'a>> {
    let [low, high] = interval.w;
    let apart = (LEAST_APART_MM * interval.unit).min(0.4 * (high - low) / (criticals.len() + 1) as f64);
    let heights: Vec<f64> = criticals.iter().map(|c| c.w).collect();
    let moved = separated(&heights, apart, [low + 0.5 * apart, high - 0.5 * apart]);
    if heights.iter().zip(&moved).all(|(a, b)| (a - b).abs() < 1e-9) {
        return None;
    }
    let warp = |(k, c): (usize, &Critical)| {
        let others = criticals.iter().enumerate().filter(|(m, _)| *m != k);
        let room = others.map(|(_, o)| (o.at - c.at).norm()).fold(f64::INFINITY, f64::min);
        let radius = (0.7 * room).clamp(LEAST_RADIUS_MM * interval.unit, MOST_RADIUS_MM * interval.unit);
        Warp { at: c.at, radius, sites: [low, moved[k], high], own: c.w }
    };
    let warps = criticals.iter().enumerate().map(warp).collect();
    // Where heights are stretched, gaps are narrower for longer.
    let frame = Frame { bounds: frame.bounds, step_mm: FINER * frame.step_mm };
    Some(Biased { source, frame, warps, step_w: 1e-4 * (high - low) })
}

/// Ascending heights moved as little as possible so that neighbours are apart (isotonic regression of the heights
/// less their due distances, by pooling), and inside the range.
fn separated(heights: &[f64], apart: f64, [low, high]: [f64; 2]) -> Vec<f64> {
    let mut pools: Vec<(f64, usize)> = Vec::new();
    for (k, h) in heights.iter().enumerate() {
        pools.push((h - apart * k as f64, 1));
        while let [.., (a, n), (b, m)] = pools[..] {
            if a <= b {
                break;
            }
            pools.truncate(pools.len() - 2);
            pools.push(((a * n as f64 + b * m as f64) / (n + m) as f64, n + m));
        }
    }
    let last = apart * heights.len().saturating_sub(1) as f64;
    let flat = pools.iter().flat_map(|&(level, n)| std::iter::repeat_n(level.clamp(low, high - last), n));
    flat.enumerate().map(|(k, level)| level + apart * k as f64).collect()
}

impl EventSource for Biased<'_> {
    fn value(&self, p: Point2, w: f64) -> f64 {
        self.jet(p, w).value
    }

    fn jet(&self, p: Point2, w: f64) -> Jet {
        self.slice(w)(p)
    }

    fn slice(&self, w: f64) -> Box<dyn Fn(Point2) -> Jet + '_> {
        let unmoved = self.source.slice(w);
        let shifts: Vec<f64> = self.warps.iter().map(|warp| warp.shift(w)).collect();
        Box::new(move |p| {
            let (mut shift, mut slope) = (0.0, Vector2::zeros());
            for (warp, &by) in self.warps.iter().zip(&shifts) {
                let (share, share_slope) = warp.share(p);
                shift += share * by;
                slope += share_slope * by;
            }
            if shift.abs() < 1e-12 && slope.norm_squared() < 1e-24 {
                return unmoved(p);
            }
            let jet = self.source.jet(p, w + shift);
            let h = self.step_w;
            let along_w =
                (self.source.value(p, w + shift + h) - self.source.value(p, w + shift - h)) / (2.0 * h);
            Jet { value: jet.value, slope: jet.slope + slope * along_w }
        })
    }

    fn frame(&self) -> Option<Frame> {
        Some(self.frame)
    }

    fn contours_on(&self, w: f64, finer: f64) -> Vec<Contour> {
        iso::contours(&*self.slice(w), self.frame.bounds, self.frame.step_mm / finer)
    }

    fn refine(&self, p: Point2, w: f64) -> Point2 {
        iso::project(&*self.slice(w), p, self.frame.step_mm)
    }

    fn anchor(&self, i: usize, w: f64) -> Point2 {
        self.source.anchor(i, w)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_moved_apart_as_little_as_possible() {
        let moved = separated(&[1.0, 1.0, 1.0, 2.0], 0.1, [0.0, 3.0]);
        let expected = [0.9, 1.0, 1.1, 2.0];
        assert!(moved.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{moved:?}");
        assert_eq!(separated(&[0.0, 0.5], 0.1, [0.05, 1.0]), [0.05, 0.5]);
    }

    #[test]
    fn heights_are_mapped_monotonely_and_planes_stay() {
        for own in [0.05, 1.0, 2.9] {
            let warp = Warp { at: Point2::origin(), radius: 1.5, sites: [0.0, 2.0, 3.0], own };
            let mapped = |k: u32| {
                let w = 0.01 * f64::from(k);
                w + warp.shift(w)
            };
            assert!((mapped(200) - own).abs() < 1e-12 && mapped(0).abs() < 1e-12);
            assert!((mapped(300) - 3.0).abs() < 1e-12);
            assert!((0..300).all(|k| mapped(k) < mapped(k + 1)));
        }
    }

    #[test]
    fn a_share_has_the_slope_of_its_value() {
        let warp = Warp { at: Point2::new(1.0, 2.0), radius: 1.5, sites: [0.0, 1.0, 2.0], own: 1.1 };
        let (p, h) = (Point2::new(1.4, 1.3), Vector2::new(1e-6, 0.0));
        let by_x = (warp.share(p + h).0 - warp.share(p - h).0) / 2e-6;
        assert!((by_x - warp.share(p).1.x).abs() < 1e-8);
    }
}
