//! Spikes without width: tips at which an outline turns back on itself.
//!
//! A tip is taken out, and so is what then is the same point twice; only its neighbours are looked at again. Cost: linear
//! in the points, however many spikes there are.

use super::check::SAME_POINT_MM;
use crate::geom::Point2;

/// Sine of the angle between the two edges at the tip of a spike.
const SPIKE_SINE: f64 = 0.01;

/// Removes tips at which the line turns back on itself; returns how many. Fewer than four points are left as they are.
pub(super) fn cut_spikes(points: &mut Vec<Point2>) -> usize {
    let mut ring = Ring::of(points);
    let (mut at, mut n_spikes) = (0, 0);
    // How many points in a row, up to this one, are no tips.
    let mut n_sound = 0;
    while ring.n_left >= 4 && n_sound < ring.n_left {
        if ring.is_tip(at) {
            at = ring.cut(at);
            n_spikes += 1;
            // The points on either side have other neighbours now.
            n_sound = n_sound.saturating_sub(1).min(ring.n_left.saturating_sub(2));
        } else {
            at = ring.next[at];
            n_sound += 1;
        }
    }
    let is_left = ring.is_left;
    let mut all = is_left.iter();
    points.retain(|_| *all.next().unwrap_or(&true));
    n_spikes
}

fn is_tip(before: Point2, at: Point2, after: Point2) -> bool {
    let (back, on) = (before - at, after - at);
    back.dot(&on) > 0.0 && back.perp(&on).abs() <= SPIKE_SINE * back.norm() * on.norm()
}

/// The points of an outline, of which some are taken out.
struct Ring {
    points: Vec<Point2>,
    next: Vec<usize>,
    previous: Vec<usize>,
    is_left: Vec<bool>,
    n_left: usize,
}

impl Ring {
    fn of(points: &[Point2]) -> Self {
        let n = points.len();
        Self {
            points: points.to_vec(),
            next: (0..n).map(|i| (i + 1) % n).collect(),
            previous: (0..n).map(|i| (i + n - 1) % n).collect(),
            is_left: vec![true; n],
            n_left: n,
        }
    }

    fn is_tip(&self, at: usize) -> bool {
        is_tip(self.points[self.previous[at]], self.points[at], self.points[self.next[at]])
    }

    /// Takes out a point and what is then the same point twice, of which the first one given stays; returns the point
    /// before it.
    fn cut(&mut self, at: usize) -> usize {
        let (mut before, mut after) = (self.previous[at], self.next[at]);
        self.unlink(at);
        while self.n_left > 1 && (self.points[before] - self.points[after]).norm() <= SAME_POINT_MM {
            self.unlink(before.max(after));
            if before > after {
                before = self.previous[before];
            } else {
                after = self.next[after];
            }
        }
        before
    }

    fn unlink(&mut self, at: usize) {
        let (before, after) = (self.previous[at], self.next[at]);
        (self.next[before], self.previous[after]) = (after, before);
        self.is_left[at] = false;
        self.n_left -= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Contour;

    const CENTRE: Point2 = Point2::new(0.3, -2.0);

    fn circle(n: usize) -> Vec<Point2> {
        Contour::circle(CENTRE, 10.0, n).points
    }

    /// The outline with a spike of several points at every `step`-th of its points.
    fn spiked(points: &[Point2], step: usize) -> Vec<Point2> {
        let spike = |(i, &p): (usize, &Point2)| {
            // Square to the outline: along an edge, nobody could tell the spike from it.
            let out = (p - CENTRE) * (0.1 + 0.05 * (i % 7) as f64);
            if i.is_multiple_of(step) { vec![p, p + out * 0.4, p + out, p + out * 0.7, p] } else { vec![p] }
        };
        points.iter().enumerate().flat_map(spike).collect()
    }

    #[test]
    fn an_outline_is_what_it_was_before_spikes_grew_on_it() {
        for step in [1, 2, 9, 100] {
            let mut points = spiked(&circle(100), step);
            assert!(cut_spikes(&mut points) >= 100_usize.div_ceil(step));
            assert_eq!(points, circle(100), "{step}");
        }
    }

    #[test]
    fn an_outline_without_spikes_stays_and_one_that_is_all_spike_vanishes() {
        let mut points = circle(64);
        assert_eq!((cut_spikes(&mut points), &points), (0, &circle(64)));
        let way: Vec<Point2> = (0..50).map(|i| Point2::new(f64::from(i), 0.0)).collect();
        let mut there_and_back: Vec<Point2> = way.iter().chain(way[1..49].iter().rev()).copied().collect();
        cut_spikes(&mut there_and_back);
        assert!(there_and_back.len() < 4, "{}", there_and_back.len());
    }

    #[test]
    fn many_points_with_many_spikes_take_no_longer_than_many_points() {
        // Quadratic in them, this would take minutes.
        let mut points = spiked(&circle(400_000), 1);
        assert!(cut_spikes(&mut points) >= 400_000);
        assert_eq!(points.len(), 400_000);
    }
}
