//! A contour as radii around a centre, and the contours of all planes that follow one another.

use super::harmonics::Circle;
use crate::geom::{Contour, Point2, Vector2};
use crate::sections::curve::{gaussian, smoothed_closed};
use std::borrow::Cow;
use std::f64::consts::TAU;

/// A ray that meets the contour at a flatter angle than this cosine makes no good coordinate.
const LEAST_COSINE: f64 = 0.15;
/// Contours that follow one another differ in area by no more than this factor.
const LIKE_AREA: f64 = 3.0;
/// Bends of the contours along the vessel are taken into account up to this part of the radius over a slab.
const MOST_TRAVEL: f64 = 0.8;
/// A contour that no centre sees whole is seen without its details, smoothed over these parts of what may go, the least first.
const ROUGHNESS: [f64; 4] = [0.5, 0.7, 1.0, 1.4];
/// Points of it on the shortest of these lengths.
const POINTS_PER_LENGTH: f64 = 4.0;
const MOST_POINTS: f64 = 4096.0;

/// A closed curve that every ray from its centre meets once.
#[derive(Debug, Clone)]
pub(super) struct Ring {
    pub(super) centre: Point2,
    /// Distances along the rays of a [`Circle`], mm.
    pub(super) radii: Vec<f64>,
    pub(super) is_hole: bool,
}

impl Ring {
    /// `None` where a ray from the centroid meets the contour more than once, or nearly.
    pub(super) fn of(contour: &Contour, circle: &Circle) -> Option<Self> {
        let is_hole = !contour.is_ccw();
        let points = if is_hole { contour.reversed().points } else { contour.points.clone() };
        let centre = contour.centroid();
        Self::around(&points, centre, circle).map(|radii| Self { centre, radii, is_hole })
    }

    /// The contour without details, where these alone hide parts of it: a cut's corners, the noise's bumps. `None` where it
    /// would have to move by more than `detail_mm`.
    pub(super) fn roughly(contour: &Contour, circle: &Circle, detail_mm: f64) -> Option<Self> {
        let length_mm = contour.perimeter_mm();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n =
            (POINTS_PER_LENGTH * length_mm / (ROUGHNESS[0] * detail_mm)).clamp(48.0, MOST_POINTS) as usize;
        let fine: Vec<Vector2> = contour.resampled(n).points.iter().map(|p| p.coords).collect();
        let smoothed = |part: &f64| {
            let kernel = gaussian(part * detail_mm * n as f64 / length_mm);
            smoothed_closed(&fine, &kernel)
        };
        let moved_mm =
            |smooth: &[Vector2]| fine.iter().zip(smooth).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        ROUGHNESS.iter().map(smoothed).filter(|smooth| moved_mm(smooth) <= detail_mm).find_map(|smooth| {
            Self::of(&Contour::new(smooth.into_iter().map(Point2::from).collect()), circle)
        })
    }

    /// The same curve seen from another centre.
    pub(super) fn recentred(&self, centre: Point2, circle: &Circle) -> Option<Self> {
        let radii = Self::around(&self.points(circle), centre, circle)?;
        Some(Self { centre, radii, is_hole: self.is_hole })
    }

    fn around(points: &[Point2], centre: Point2, circle: &Circle) -> Option<Vec<f64>> {
        let n = points.len();
        if n < 8 || !is_seen_whole(points, centre) {
            return None;
        }
        let turn = |p: &Point2| (p - centre).y.atan2((p - centre).x).rem_euclid(TAU);
        let start = (0..n).min_by(|&a, &b| turn(&points[a]).total_cmp(&turn(&points[b])))?;
        let turns: Vec<f64> = (0..n).map(|i| turn(&points[(start + i) % n])).collect();
        let mut passed = 0;
        let mut radius = |j: usize| {
            let theta = TAU * j as f64 / circle.len() as f64;
            while passed < n && turns[passed] <= theta {
                passed += 1;
            }
            let [a, b] = [start + passed + n - 1, start + passed].map(|i| points[i % n] - centre);
            let [cos, sin] = circle.at(j);
            a.perp(&(b - a)) / Vector2::new(cos, sin).perp(&(b - a))
        };
        let radii: Vec<f64> = (0..circle.len()).map(&mut radius).collect();
        radii.iter().all(|r| r.is_finite() && *r > 0.0).then_some(radii)
    }

    /// The points on the rays, counter-clockwise.
    pub(super) fn points(&self, circle: &Circle) -> Vec<Point2> {
        let at = |(j, r): (usize, &f64)| {
            let [cos, sin] = circle.at(j);
            self.centre + Vector2::new(cos, sin) * *r
        };
        self.radii.iter().enumerate().map(at).collect()
    }

    pub(super) fn mean_radius_mm(&self) -> f64 {
        self.radii.iter().sum::<f64>() / self.radii.len() as f64
    }

    pub(super) fn area_mm2(&self) -> f64 {
        let square = self.radii.iter().map(|r| r * r).sum::<f64>() / self.radii.len() as f64;
        std::f64::consts::PI * square
    }

    /// Whether the other ring lies at least partly on the same place.
    fn overlaps(&self, other: &Self, circle: &Circle) -> bool {
        let d = other.centre - self.centre;
        d.norm() < self.reach(d, circle) + other.reach(-d, circle)
    }

    /// Radius in a direction.
    fn reach(&self, direction: Vector2, circle: &Circle) -> f64 {
        let turn = direction.y.atan2(direction.x).rem_euclid(TAU) / TAU;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index of a ray")]
        let ray = (turn * circle.len() as f64) as usize % circle.len();
        self.radii[ray]
    }

    fn may_follow(&self, other: &Self, circle: &Circle) -> bool {
        let (a, b) = (self.area_mm2(), other.area_mm2());
        self.is_hole == other.is_hole
            && a < LIKE_AREA * b
            && b < LIKE_AREA * a
            && self.overlaps(other, circle)
    }
}

/// Whether rays from the centre meet all edges in order, none of them too flatly.
fn is_seen_whole(points: &[Point2], centre: Point2) -> bool {
    let n = points.len();
    (0..n).all(|i| {
        let (a, b) = (points[i] - centre, points[(i + 1) % n] - centre);
        a.perp(&b) > LEAST_COSINE * a.norm() * (b - a).norm()
    })
}

/// What a plane shows on one of its places: a curve that the model moves, or one that stays.
#[derive(Debug, Clone)]
pub(super) enum Outline {
    /// To be fitted.
    Free(Ring),
    /// Taken as it is, and known to be the vessel: what was drawn. Its ring leads from the plane below to the one above.
    Held(Ring, Contour),
    /// Taken as it is: bridges, splits, and contours without an edge or that no centre sees whole.
    Fixed(Contour),
}

impl Outline {
    pub(super) fn ring(&self) -> Option<&Ring> {
        match self {
            Self::Free(ring) | Self::Held(ring, _) => Some(ring),
            Self::Fixed(_) => None,
        }
    }

    /// The ring that the image moves.
    pub(super) const fn free(&self) -> Option<&Ring> {
        if let Self::Free(ring) = self { Some(ring) } else { None }
    }

    /// Puts the same curve seen from another centre in the place of the ring.
    pub(super) fn set_ring(&mut self, other: Ring) {
        if let Self::Free(ring) | Self::Held(ring, _) = self {
            *ring = other;
        }
    }

    /// The ring, or the disk of the same area.
    fn stand_in(&self, circle: &Circle) -> Cow<'_, Ring> {
        match self {
            Self::Free(ring) | Self::Held(ring, _) => Cow::Borrowed(ring),
            Self::Fixed(contour) => {
                let radius_mm = (contour.signed_area_mm2().abs() / std::f64::consts::PI).sqrt();
                let radii = vec![radius_mm; circle.len()];
                Cow::Owned(Ring { centre: contour.centroid(), radii, is_hole: !contour.is_ccw() })
            }
        }
    }
}

/// Place of a contour: plane, then contour of the plane.
pub(super) type At = (usize, usize);

/// Runs of rings that follow one another one to one, each ascending; every ring is in just one.
pub(super) fn runs(planes: &[Vec<Outline>], circle: &Circle) -> Vec<Vec<At>> {
    let mut open: Vec<Vec<At>> = Vec::new();
    let mut done = Vec::new();
    for k in 0..planes.len() {
        let pairs = if k > 0 { followers(&planes[k - 1], &planes[k], circle) } else { Vec::new() };
        let mut next = Vec::new();
        for (i, _) in planes[k].iter().enumerate().filter(|(_, o)| o.ring().is_some()) {
            let from = pairs.iter().find(|(_, upper)| *upper == i).map(|(lower, _)| *lower);
            let run =
                from.and_then(|lower| open.iter().position(|r: &Vec<At>| r.last() == Some(&(k - 1, lower))));
            let mut run = run.map_or_else(Vec::new, |at| open.swap_remove(at));
            run.push((k, i));
            next.push(run);
        }
        done.append(&mut open);
        open = next;
    }
    done.append(&mut open);
    done.sort();
    done
}

/// Pairs of rings of two planes that overlap each other and nothing else, be it a ring or not.
fn followers(lower: &[Outline], upper: &[Outline], circle: &Circle) -> Vec<(usize, usize)> {
    let [below, above] = [lower, upper].map(|o| o.iter().map(|o| o.stand_in(circle)).collect::<Vec<_>>());
    let meets =
        |a: usize, b: usize| below[a].is_hole == above[b].is_hole && below[a].overlaps(&above[b], circle);
    let only = |n: usize, meets: &dyn Fn(usize) -> bool| {
        let mut found = (0..n).filter(|&o| meets(o));
        found.next().filter(|_| found.next().is_none())
    };
    let pair = |a: usize| {
        let b = only(above.len(), &|b| meets(a, b))?;
        let back = only(below.len(), &|a| meets(a, b))?;
        let like = lower[a].ring()?.may_follow(upper[b].ring()?, circle);
        (back == a && like).then_some((a, b))
    };
    (0..lower.len()).filter_map(pair).collect()
}

/// How a ring's points move with height: first and second derivative, 1 and 1/mm.
#[derive(Debug, Clone)]
pub(super) struct Course {
    pub(super) slope: Vec<Vector2>,
    pub(super) bend: Vec<Vector2>,
}

impl Course {
    /// From the neighbours in the run: a parabola through three planes, a line at an end.
    pub(super) fn of(
        here: &[Point2],
        below: Option<(f64, &[Point2])>,
        above: Option<(f64, &[Point2])>,
    ) -> Option<Self> {
        let zero = || vec![Vector2::zeros(); here.len()];
        match (below, above) {
            (None, None) => None,
            (Some((dz, other)), None) | (None, Some((dz, other))) => {
                let slope = here.iter().zip(other).map(|(p, q)| (q - p) / dz).collect();
                Some(Self { slope, bend: zero() })
            }
            (Some((za, a)), Some((zb, b))) => {
                let (mut slope, mut bend) = (zero(), zero());
                for j in 0..here.len() {
                    let (da, db) = ((a[j] - here[j]) / za, (b[j] - here[j]) / zb);
                    bend[j] = (db - da) * (2.0 / (zb - za));
                    slope[j] = (da * zb - db * za) / (zb - za);
                }
                Some(Self { slope, bend })
            }
        }
    }

    /// The points at a height above the plane.
    pub(super) fn at(&self, here: &[Point2], h: f64, radius_mm: f64) -> Vec<Point2> {
        let most = MOST_TRAVEL * radius_mm;
        let travel = |j: usize| {
            let t = self.slope[j] * h + self.bend[j] * (0.5 * h * h);
            if t.norm() > most { t * (most / t.norm()) } else { t }
        };
        here.iter().enumerate().map(|(j, p)| p + travel(j)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_goes_through_its_contour() {
        let circle = Circle::new(96);
        let ellipse: Vec<Point2> = Contour::circle(Point2::origin(), 1.0, 300)
            .points
            .iter()
            .map(|p| Point2::new(4.0 + 3.0 * p.x, -1.0 + 2.0 * p.y))
            .collect();
        for contour in [Contour::new(ellipse.clone()), Contour::new(ellipse).reversed()] {
            let ring = Ring::of(&contour, &circle).unwrap();
            assert_eq!(ring.is_hole, !contour.is_ccw());
            for p in ring.points(&circle) {
                let at = ((p.x - 4.0) / 3.0).hypot((p.y + 1.0) / 2.0);
                assert!((at - 1.0).abs() < 1e-3, "{at}");
            }
        }
    }

    fn crescent() -> Contour {
        let point = |i: i32| {
            let (t, outer) = (f64::from(i % 40) / 39.0, i < 40);
            let (angle, r) = if outer { (5.0 * t, 3.0) } else { (5.0 * (1.0 - t), 2.0) };
            Point2::new(r * angle.cos(), r * angle.sin())
        };
        Contour::new((0..80).map(point).collect())
    }

    #[test]
    fn a_crescent_is_no_ring() {
        assert!(Ring::of(&crescent(), &Circle::new(64)).is_none());
    }

    /// A circle of 2 mm with a square lug of 0.6 mm and a given length.
    fn with_lug(depth_mm: f64) -> Contour {
        let (r, half) = (2.0_f64, 0.3_f64);
        let turn = (half / r).asin();
        let arc = (0..=160).map(|i| turn + (TAU - 2.0 * turn) * f64::from(i) / 160.0);
        let mut points: Vec<Point2> = arc.map(|t| Point2::new(r * t.cos(), r * t.sin())).collect();
        points.extend([Point2::new(r + depth_mm, -half), Point2::new(r + depth_mm, half)]);
        Contour::new(points)
    }

    #[test]
    fn corners_of_a_cut_do_not_hide_a_contour() {
        let circle = Circle::new(64);
        let contour = with_lug(0.3);
        assert!(Ring::of(&contour, &circle).is_none());
        let ring = Ring::roughly(&contour, &circle, 0.35).unwrap();
        for (j, p) in ring.points(&circle).iter().enumerate() {
            assert!((p.coords.norm() - 2.0).abs() < 0.35, "{j}: {p}");
        }
    }

    #[test]
    fn what_is_larger_than_a_detail_is_no_ring() {
        let circle = Circle::new(64);
        assert!(Ring::roughly(&with_lug(0.3), &circle, 0.02).is_none());
        assert!(Ring::roughly(&crescent(), &circle, 0.35).is_none());
    }

    #[test]
    fn a_split_ends_a_run_where_one_branch_is_no_ring() {
        let circle = Circle::new(64);
        let ring = |x: f64, r: f64| {
            Outline::Free(Ring::of(&Contour::circle(Point2::new(x, 0.0), r, 200), &circle).unwrap())
        };
        let fixed = Outline::Fixed(Contour::circle(Point2::new(1.9, 0.0), 1.2, 200));
        let planes = [vec![ring(0.0, 2.5)], vec![ring(-1.0, 1.6), fixed]];
        assert_eq!(runs(&planes, &circle), [vec![(0, 0)], vec![(1, 0)]]);
    }

    #[test]
    fn runs_end_where_rings_split() {
        let circle = Circle::new(64);
        let ring = |x: f64, r: f64| {
            Outline::Free(Ring::of(&Contour::circle(Point2::new(x, 0.0), r, 200), &circle).unwrap())
        };
        let planes = [
            vec![ring(0.0, 3.0)],
            vec![ring(0.1, 3.1)],
            vec![ring(-1.9, 1.6), ring(1.9, 1.6)],
            vec![ring(-2.2, 1.6), ring(2.2, 1.6)],
        ];
        assert_eq!(
            runs(&planes, &circle),
            [vec![(0, 0), (1, 0)], vec![(2, 0), (3, 0)], vec![(2, 1), (3, 1)]]
        );
    }

    #[test]
    fn the_course_of_a_parabola_is_exact() {
        let at = |z: f64| vec![Point2::new(1.0 + 0.3 * z + 0.05 * z * z, -0.2 * z)];
        let (here, below, above) = (at(0.0), at(-2.0), at(3.0));
        let course = Course::of(&here, Some((-2.0, &below)), Some((3.0, &above))).unwrap();
        assert!((course.at(&here, 0.7, 9.0)[0] - at(0.7)[0]).norm() < 1e-12);
    }
}
