//! Bicubic Bézier patches, and what their control points tell about where they meet.

use super::TOLERANCE_MM;
use crate::geom::{Point3, Vector2, Vector3};
use std::cell::Cell;

/// Halvings until two parts are given up: of a millimetre, then, some ten nanometres are left.
const MOST_HALVINGS: usize = 16;
/// So far around a vertex that two faces share they may lie within a rounding of each other: curves of some millimetres' radius that
/// touch in a point do.
pub(super) const TOUCH_MM: f64 = 5e-3;

/// A patch: rows of control points along u, one after the other in v, whose height they share where it is level.
#[derive(Debug, Clone)]
pub(super) struct Patch {
    rows: [[Point3; 4]; 4],
}

/// The control points of the cubic through four points at thirds of its range.
pub(super) fn cubic_through([a, b, c, d]: [Point3; 4]) -> [Point3; 4] {
    let sum =
        |w: [f64; 4]| Point3::from(a.coords * w[0] + b.coords * w[1] + c.coords * w[2] + d.coords * w[3]);
    let inner = [[-5.0, 18.0, -9.0, 2.0], [2.0, -9.0, 18.0, -5.0]].map(|w| sum(w.map(|w| w / 6.0)));
    [a, inner[0], inner[1], d]
}

/// Both halves of a cubic (de Casteljau).
fn halved([a, b, c, d]: [Point3; 4]) -> [[Point3; 4]; 2] {
    let middle = |p: &Point3, q: &Point3| nalgebra::center(p, q);
    let (ab, bc, cd) = (middle(&a, &b), middle(&b, &c), middle(&c, &d));
    let (abc, bcd) = (middle(&ab, &bc), middle(&bc, &cd));
    let m = middle(&abc, &bcd);
    [[a, ab, abc, m], [m, bcd, cd, d]]
}

fn transposed(rows: [[Point3; 4]; 4]) -> [[Point3; 4]; 4] {
    [0, 1, 2, 3].map(|i| rows.map(|row| row[i]))
}

/// The lesser of two numbers; `f64::min`, which minds what is no number, takes several times as long.
fn least(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}

fn most(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}

pub(super) fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [least(low, v), most(high, v)])
}

/// How the rows of two patches stand to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rows {
    /// At equal parameters v both are at one height.
    Level,
    /// Nothing is known.
    Any,
}

/// Least and largest x, then y, of each row.
pub(super) type Boxes = [[f64; 4]; 4];

/// Boxes that hold nothing.
pub(super) const NOWHERE: Boxes = [[f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY]; 4];

/// The boxes of rows, given by columns of control points.
pub(super) fn boxes(columns: &[[Point3; 4]]) -> Boxes {
    let mut found = NOWHERE;
    for (k, [a, b, c, d]) in found.iter_mut().enumerate() {
        for p in columns.iter().map(|column| column[k]) {
            (*a, *b, *c, *d) = (least(*a, p.x), most(*b, p.x), least(*c, p.y), most(*d, p.y));
        }
    }
    found
}

/// The boxes around two parts.
pub(super) fn united(a: &Boxes, b: &Boxes) -> Boxes {
    [0, 1, 2, 3].map(|k| {
        let ([p, q, r, s], [t, u, v, w]) = (a[k], b[k]);
        [least(p, t), most(q, u), least(r, v), most(s, w)]
    })
}

/// Whether boxes around rows tell that two surfaces are apart.
pub(super) fn are_apart(a: &Boxes, b: &Boxes, rows: Rows) -> bool {
    let on_axis = |k: usize| {
        let ranges = |boxes: &Boxes| boxes.map(|row| [row[2 * k], row[2 * k + 1]]);
        lie_apart(ranges(a), ranges(b), rows)
    };
    on_axis(0) || on_axis(1)
}

/// Whether the ranges of two surfaces' rows along a direction lie apart, those of one always on the same side.
fn lie_apart(a: [[f64; 2]; 4], b: [[f64; 2]; 4], rows: Rows) -> bool {
    let is_below = |a: &[[f64; 2]; 4], b: &[[f64; 2]; 4]| match rows {
        Rows::Level => a.iter().zip(b).all(|(a, b)| a[1] < b[0]),
        Rows::Any => a.iter().all(|a| b.iter().all(|b| a[1] < b[0])),
    };
    is_below(&a, &b) || is_below(&b, &a)
}

impl Patch {
    /// The patch of columns at thirds of its range in u, each of control points along v.
    pub(super) fn through_columns(columns: [[Point3; 4]; 4]) -> Self {
        Self { rows: transposed(columns).map(cubic_through) }
    }

    fn halves_u(&self) -> [Self; 2] {
        let halves = self.rows.map(halved);
        [0, 1].map(|k| Self { rows: halves.map(|row| row[k]) })
    }

    fn halves_v(&self) -> [Self; 2] {
        let halves = transposed(self.rows).map(halved);
        [0, 1].map(|k| Self { rows: transposed(halves.map(|column| column[k])) })
    }

    /// Lowest and highest z of its control points.
    fn z_range(&self) -> [f64; 2] {
        range(self.rows.iter().flatten().map(|p| p.z))
    }

    /// Extent of its control points, mm.
    fn size_mm(&self) -> f64 {
        let extent = |k: usize| {
            let [low, high] = range(self.rows.iter().flatten().map(|p| p[k]));
            high - low
        };
        Vector3::new(extent(0), extent(1), extent(2)).norm()
    }

    fn middle(&self) -> Point3 {
        let [_, below, above, _] = self.rows;
        nalgebra::center(&nalgebra::center(&below[1], &below[2]), &nalgebra::center(&above[1], &above[2]))
    }

    /// From its first column to its last one, in the middle of v.
    fn chord(&self) -> Vector2 {
        (0..4).map(|k| (self.rows[k][3] - self.rows[k][0]).xy()).sum()
    }

    /// Whether it ends in the column in which another one begins.
    pub(super) fn goes_on_as(&self, next: &Self) -> bool {
        (0..4).all(|k| (self.rows[k][3] - next.rows[k][0]).norm() < TOLERANCE_MM)
    }

    fn along(&self, direction: Vector2) -> [[f64; 2]; 4] {
        self.rows.map(|row| range(row.iter().map(|p| p.coords.xy().dot(&direction))))
    }

    fn is_apart_from(&self, other: &Self, rows: Rows) -> bool {
        let is_apart_along = |d: Vector2| lie_apart(self.along(d), other.along(d), rows);
        let turned = |v: Vector2| Vector2::new(-v.y, v.x);
        let chord = self.chord();
        [Vector2::x(), Vector2::y(), turned(chord), chord, (other.middle() - self.middle()).xy()]
            .into_iter()
            .any(is_apart_along)
    }

    /// Whether every step between control points along u, of this patch and of the next one, goes forward.
    fn goes_forward(&self, next: &Self) -> bool {
        let way = self.chord() + next.chord();
        let is_forward = |row: &[Point3; 4]| row.windows(2).all(|p| (p[1] - p[0]).xy().dot(&way) > 0.0);
        self.rows.iter().chain(&next.rows).all(is_forward)
    }
}

/// Whether all steps from one column of control points to the next one go forward in one direction.
pub(super) fn goes_forward(columns: &[[Point3; 4]]) -> bool {
    let (Some(first), Some(last)) = (columns.first(), columns.last()) else { return true };
    let way: Vector2 = (0..4).map(|k| (last[k] - first[k]).xy()).sum();
    let is_forward = |pair: &[[Point3; 4]]| (0..4).all(|k| (pair[1][k] - pair[0][k]).xy().dot(&way) > 0.0);
    columns.windows(2).all(is_forward)
}

/// Two faces of which patches are compared.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pair<'a> {
    /// Comparisons that may still be made: where there are more, the faces are as good as one.
    pub(super) budget: &'a Cell<usize>,
    pub(super) rows: Rows,
    /// Points in which the faces touch because they share them.
    pub(super) shared: &'a [Point3],
}

impl Pair<'_> {
    /// Finds two patches apart, but for shared points.
    ///
    /// # Errors
    /// A place where they cannot be told apart.
    pub(super) fn apart(self, a: &Patch, b: &Patch) -> Result<(), Point3> {
        self.apart_within(a, b, MOST_HALVINGS)
    }

    fn apart_within(self, a: &Patch, b: &Patch, halvings: usize) -> Result<(), Point3> {
        if a.is_apart_from(b, self.rows) || self.is_shared(a) {
            return Ok(());
        }
        if !self.may_go_on(halvings) {
            return Err(a.middle());
        }
        let (lower, upper) = (a.halves_v(), b.halves_v());
        for (i, a) in lower.iter().enumerate() {
            for (j, b) in upper.iter().enumerate() {
                if !self.may_meet_at_a_height([i, j], a, b) {
                    continue;
                }
                let (left, right) = (a.halves_u(), b.halves_u());
                for a in &left {
                    right.iter().try_for_each(|b| self.apart_within(a, b, halvings - 1))?;
                }
            }
        }
        Ok(())
    }

    fn may_meet_at_a_height(self, [i, j]: [usize; 2], a: &Patch, b: &Patch) -> bool {
        match self.rows {
            Rows::Level => i == j,
            Rows::Any => {
                let ([a, b], [c, d]) = (a.z_range(), b.z_range());
                a < d && c < b
            }
        }
    }

    /// Finds two patches, the second of which begins where the first one ends, to meet in that column alone, and neither to
    /// meet itself.
    ///
    /// # Errors
    /// A place where this cannot be told.
    pub(super) fn joined(self, a: &Patch, b: &Patch) -> Result<(), Point3> {
        self.joined_within(a, b, MOST_HALVINGS)
    }

    fn joined_within(self, a: &Patch, b: &Patch, halvings: usize) -> Result<(), Point3> {
        if a.goes_forward(b) || a.size_mm() + b.size_mm() < TOLERANCE_MM {
            return Ok(());
        }
        if !self.may_go_on(halvings) {
            return Err(a.middle());
        }
        let n = halvings - 1;
        for (a, b) in a.halves_v().iter().zip(&b.halves_v()) {
            let ([a, b], [c, d]) = (a.halves_u(), b.halves_u());
            for (p, q) in [(&a, &c), (&a, &d), (&b, &d)] {
                self.apart_within(p, q, n)?;
            }
            for (p, q) in [(&a, &b), (&b, &c), (&c, &d)] {
                self.joined_within(p, q, n)?;
            }
        }
        Ok(())
    }

    /// Finds a patch not to meet itself.
    ///
    /// # Errors
    /// A place where this cannot be told.
    pub(super) fn simple(self, a: &Patch) -> Result<(), Point3> {
        let [first, second] = a.halves_u();
        self.joined(&first, &second)
    }

    /// Whether a comparison more may be made.
    fn may_go_on(self, halvings: usize) -> bool {
        let left = self.budget.get();
        self.budget.set(left.saturating_sub(1));
        halvings > 0 && left > 0
    }

    /// Whether a patch lies where both faces touch.
    fn is_shared(self, a: &Patch) -> bool {
        let beyond_mm = |p: &Point3| (p - a.middle()).norm() + a.size_mm();
        self.shared.iter().any(|p| beyond_mm(p) < TOUCH_MM)
    }
}
