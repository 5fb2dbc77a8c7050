//! Horizontal sections of a skin as polylines: vertices on the surface at the height asked for, chords within a tolerance.
//!
//! Tubes and laterals are cut along an iso-curve, in steps of the parameter that follow from its second derivative. The
//! saddle, whose height is no parameter, is cut where the edges of a grid over it pass the height, found on each edge to
//! rounding; between those points the curve is halved until its chords keep the tolerance.
//!
//! Limits: a part of a saddle's section smaller than a cell of the grid is not seen.

use super::event::{Crotch, Slab};
use super::skin::Skin;
use super::slab::root;
use crate::geom::{Contour, Point2, Vector2};
use crate::spline::{PatchRow, PatchSurface, SectionCurve};

/// Most chords of a curve: beyond it a tolerance below what contours know.
const MOST_CHORDS: f64 = 4096.0;
/// Fewest chords of a tube's curve, and of a lateral's.
const FEWEST_CHORDS: f64 = 16.0;
/// Grid on which the saddle patch is cut by a plane.
const SADDLE_GRID: usize = 48;
/// How often a piece of its curve is halved at most, and the share of the tolerance that samples of it may use.
const MOST_HALVINGS: u32 = 10;
const SAMPLE_SHARE: f64 = 0.8;
/// How near to its height a point of the saddle is brought, mm.
const LEVEL_MM: f64 = 1e-10;

impl Skin {
    /// The closed curves at height z as polylines with chords within the tolerance: outlines run counter-clockwise,
    /// holes clockwise.
    #[must_use]
    pub fn section(&self, z_mm: f64, tolerance_mm: f64) -> Vec<Contour> {
        let mut contours: Vec<Contour> = self
            .tubes
            .iter()
            .filter(|t| {
                let [low, high] = t.surface.z_range_mm();
                z_mm >= low && z_mm <= high
            })
            .map(|t| polyline(&t.surface.section(z_mm), tolerance_mm))
            .collect();
        for slab in &self.slabs {
            let w = slab.w_of(z_mm);
            // At its borders the tubes have the section already.
            if w > slab.w_mm[0] && w < slab.w_mm[1] {
                contours.extend(slab.section(w, tolerance_mm));
            }
        }
        contours
    }
}

/// How many equal steps of the parameter keep a curve within the tolerance of its chords, from its largest second
/// derivative over a parameter from 0 to 1: a chord over a step h leaves the curve by at most bend h² / 8.
fn n_chords(bend_mm: f64, tolerance_mm: f64, fewest: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let n = (bend_mm / (8.0 * tolerance_mm)).sqrt().ceil().clamp(fewest, MOST_CHORDS) as usize;
    n
}

fn polyline(curve: &SectionCurve, tolerance_mm: f64) -> Contour {
    let n = n_chords(curve.bend_mm(), tolerance_mm, FEWEST_CHORDS);
    if (n as f64) < MOST_CHORDS {
        return Contour::new((0..n).map(|i| curve.at(i as f64 / n as f64)).collect());
    }
    // One sharp bend must not cost as many chords everywhere, nor have too few itself.
    let length = 1.0 / curve.len() as f64;
    let piece = |(i, bend): (usize, f64)| {
        let n = n_chords(bend * length * length, tolerance_mm, 1.0);
        (0..n).map(move |k| curve.at((i as f64 + k as f64 / n as f64) * length))
    };
    Contour::new(curve.bends_mm().enumerate().flat_map(piece).collect())
}

/// A lateral's row: chords over as many pieces between its knots as keep the tolerance, or over parts of one.
fn arc(row: &PatchRow<'_>, tolerance_mm: f64) -> Vec<Point2> {
    let pieces = row.bends();
    let [first, last] = row.range();
    let most = (last - first) / FEWEST_CHORDS;
    let mut points = vec![row.at(first).xy()];
    let (mut at, mut i) = (first, 0);
    while i < pieces.len() {
        let (mut bend, mut end) = (0.0f64, i);
        while let Some(([_, to], of_piece)) = pieces.get(end) {
            bend = bend.max(*of_piece);
            if to - at > most || bend * (to - at) * (to - at) > 8.0 * tolerance_mm {
                break;
            }
            end += 1;
        }
        // Not even one piece: it is divided.
        let whole = end.max(i + 1);
        let ([_, to], bend) = (pieces[whole - 1].0, pieces[i].1);
        let length = to - at;
        let fewest = (length / most).ceil().max(1.0);
        let n = if end > i { 1 } else { n_chords(bend * length * length, tolerance_mm, fewest) };
        points.extend((1..=n).map(|k| row.at(at + length * k as f64 / n as f64).xy()));
        (at, i) = (to, whole);
    }
    points
}

impl Slab {
    /// The closed curves at height w inside the slab, vertices on its patches, chords within the tolerance.
    #[must_use]
    pub fn section(&self, w: f64, tolerance_mm: f64) -> Vec<Contour> {
        let laterals = self.laterals.each_ref().map(|patch| arc(&patch.row(self.v_of(w)), tolerance_mm));
        let between = match &self.crotch {
            Crotch::Saddle(saddle) => Cut { saddle, z_mm: self.z_of(w), tolerance_mm }.curves(),
            Crotch::Crease => Vec::new(),
        };
        close_loops(laterals.to_vec(), between)
    }
}

/// A saddle patch and the plane that cuts it.
struct Cut<'a> {
    saddle: &'a PatchSurface,
    z_mm: f64,
    tolerance_mm: f64,
}

impl Cut<'_> {
    /// The curves in which the plane cuts the patch.
    fn curves(&self) -> Vec<Vec<Point2>> {
        chained(self.pieces()).iter().map(|parameters| self.followed(parameters)).collect()
    }

    /// The plane's pieces between the edges of the grid, as parameters of the patch.
    fn pieces(&self) -> Vec<Vec<Point2>> {
        let n = SADDLE_GRID;
        let parameter = |i: usize| i as f64 / n as f64;
        let row = |j: usize| -> Vec<f64> {
            let row = self.saddle.row(parameter(j));
            (0..=n).map(|i| row.at(parameter(i)).z - self.z_mm).collect()
        };
        let heights: Vec<Vec<f64>> = (0..=n).map(row).collect();
        let place = |(i, j): (usize, usize)| Point2::new(parameter(i), parameter(j));
        // Both triangles of an edge must find the same point, to the last bit.
        let on_edge = |a: (usize, usize), b: (usize, usize)| if a < b { [a, b] } else { [b, a] };
        let cross = |[a, b]: [(usize, usize); 2]| {
            let (fa, fb) = (heights[a.1][a.0], heights[b.1][b.0]);
            ((fa < 0.0) != (fb < 0.0)).then(|| self.on_line([place(a), place(b)], fa < 0.0))
        };
        let mut pieces = Vec::new();
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            // Two triangles a cell: no ambiguous case.
            for triangle in [[(i, j), (i + 1, j), (i + 1, j + 1)], [(i, j), (i + 1, j + 1), (i, j + 1)]] {
                let edges = (0..3).map(|k| on_edge(triangle[k], triangle[(k + 1) % 3]));
                let ends: Vec<Point2> = edges.filter_map(cross).collect();
                if let [a, b] = ends[..] {
                    pieces.push(vec![a, b]);
                }
            }
        }
        pieces
    }

    fn height(&self, at: Point2) -> f64 {
        self.saddle.at(at.x, at.y).z - self.z_mm
    }

    /// Where the patch passes the plane on a straight line in its parameters, which rises through it or falls.
    fn on_line(&self, [a, b]: [Point2; 2], rises: bool) -> Point2 {
        let sign = if rises { 1.0 } else { -1.0 };
        a + (b - a) * root(|t| sign * self.height(a + (b - a) * t), 0.0, 1.0)
    }

    /// The curve through these parameters, with as many points between them as the tolerance asks for.
    fn followed(&self, parameters: &[Point2]) -> Vec<Point2> {
        let mut points = vec![self.place(parameters[0])];
        for pair in parameters.windows(2) {
            self.halve([pair[0], pair[1]], MOST_HALVINGS, &mut points);
            points.push(self.place(pair[1]));
        }
        points
    }

    fn place(&self, at: Point2) -> Point2 {
        self.saddle.at(at.x, at.y).xy()
    }

    /// Points between two of the curve, until chords are within the tolerance.
    fn halve(&self, [a, b]: [Point2; 2], most: u32, points: &mut Vec<Point2>) {
        let between = [0.25, 0.5, 0.75].map(|share| self.settled(a + (b - a) * share, (b - a).norm()));
        let [Some(_), Some(middle), Some(_)] = between else { return };
        let (from, to) = (self.place(a), self.place(b));
        let off = |p: &Option<Point2>| p.map_or(0.0, |p| distance_mm(self.place(p), [from, to]));
        let farthest_mm = between.iter().map(off).fold(0.0, f64::max);
        if most == 0 || farthest_mm <= SAMPLE_SHARE * self.tolerance_mm {
            return;
        }
        self.halve([a, middle], most - 1, points);
        points.push(self.place(middle));
        self.halve([middle, b], most - 1, points);
    }

    /// Newton steps up or down the patch onto the plane; `None` where they lead farther than `most`.
    fn settled(&self, start: Point2, most: f64) -> Option<Point2> {
        let mut at = start;
        for _ in 0..12 {
            let jet = self.saddle.jet(at.x, at.y);
            let (off, slope) = (jet.point.z - self.z_mm, Vector2::new(jet.by_u.z, jet.by_v.z));
            if off.abs() < LEVEL_MM {
                return Some(at);
            }
            let next = at - slope * (off / slope.norm_squared().max(f64::MIN_POSITIVE));
            at = next.coords.map(|t| t.clamp(0.0, 1.0)).into();
            if (at - start).norm() > most {
                return None;
            }
        }
        None
    }
}

/// Distance of a point from a segment.
fn distance_mm(p: Point2, [from, to]: [Point2; 2]) -> f64 {
    let along = to - from;
    let share = ((p - from).dot(&along) / along.norm_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    (p - from - along * share).norm()
}

/// Joins polylines that share end points into longer ones.
fn chained(mut pieces: Vec<Vec<Point2>>) -> Vec<Vec<Point2>> {
    let mut curves = Vec::new();
    while let Some(mut curve) = pieces.pop() {
        loop {
            let (head, tail) = (curve[0], curve[curve.len() - 1]);
            let joins = |piece: &Vec<Point2>| {
                let (a, b) = (piece[0], piece[piece.len() - 1]);
                a == tail || b == tail || a == head || b == head
            };
            let Some(i) = pieces.iter().position(joins) else { break };
            let mut piece = pieces.swap_remove(i);
            if piece[0] == head || piece[piece.len() - 1] == head {
                curve.reverse();
            }
            if piece[piece.len() - 1] == curve[curve.len() - 1] {
                piece.reverse();
            }
            curve.extend_from_slice(&piece[1..]);
        }
        curves.push(curve);
    }
    curves
}

/// Joins directed open curves, by bridges of either direction, to closed contours, nearest ends first.
fn close_loops(mut open: Vec<Vec<Point2>>, mut bridges: Vec<Vec<Point2>>) -> Vec<Contour> {
    let mut closed = Vec::new();
    while let Some(mut contour) = open.pop() {
        loop {
            let (head, tail) = (contour[0], contour[contour.len() - 1]);
            let candidates = open.iter().chain(&bridges);
            let gap =
                |curve: &Vec<Point2>| (curve[0] - tail).norm().min((curve[curve.len() - 1] - tail).norm());
            let nearest = candidates.enumerate().min_by(|a, b| gap(a.1).total_cmp(&gap(b.1)));
            let Some((i, curve)) = nearest else { break };
            if gap(curve) >= (head - tail).norm() && contour.len() > 2 {
                break;
            }
            let mut next =
                if i < open.len() { open.swap_remove(i) } else { bridges.swap_remove(i - open.len()) };
            if (next[0] - tail).norm() > (next[next.len() - 1] - tail).norm() {
                next.reverse();
            }
            contour.extend(next);
        }
        contour.dedup_by(|a, b| (*a - *b).norm() < 1e-7);
        if contour.len() > 1 && (contour[0] - contour[contour.len() - 1]).norm() < 1e-7 {
            contour.pop();
        }
        let contour = Contour::new(contour);
        if contour.len() >= 3 {
            closed.push(contour);
        }
    }
    closed
}

#[cfg(test)]
mod tests {
    use super::super::tests::{cast, phantom_stack, stack};
    use super::*;
    use crate::geom::SegmentIndex;
    use crate::phantom::Kind;
    use crate::progress::Task;
    use crate::solid::{Body, Params, Sectioned, Solid, build};

    /// How far a point of the plane z is from the slab's patches at that height, mm: from the saddle where it lies over
    /// that, by Newton steps in its parameters, else from a lateral's row.
    fn off_mm(slab: &Slab, p: Point2, z_mm: f64) -> f64 {
        let rows = slab.laterals.each_ref().map(|l| l.row(slab.v_of(slab.w_of(z_mm))));
        let from_row = |row: &PatchRow<'_>| {
            let off = |u: f64| (row.at(u).xy() - p).norm();
            let nearest = (0..=400).map(|k| f64::from(k) / 400.0).min_by(|a, b| off(*a).total_cmp(&off(*b)));
            let mut u = nearest.unwrap_or(0.0);
            for _ in 0..20 {
                let (at, along) = (row.at(u).xy(), row.derivative_at(u).xy());
                u = (u + (p - at).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
            }
            off(u)
        };
        let of_rows = rows.iter().map(from_row).fold(f64::INFINITY, f64::min);
        let Crotch::Saddle(saddle) = &slab.crotch else { return of_rows };
        let grid = (0..=20).flat_map(|i| (0..=20).map(move |j| (f64::from(i) / 20.0, f64::from(j) / 20.0)));
        let off = |(u, v): &(f64, f64)| (saddle.at(*u, *v).xy() - p).norm();
        let (mut u, mut v) = grid.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or_default();
        for _ in 0..30 {
            let jet = saddle.jet(u, v);
            let (by_u, by_v, to) = (jet.by_u.xy(), jet.by_v.xy(), p - jet.point.xy());
            let area = by_u.perp(&by_v);
            u = (u + to.perp(&by_v) / area).clamp(0.0, 1.0);
            v = (v + by_u.perp(&to) / area).clamp(0.0, 1.0);
        }
        let at = saddle.at(u, v);
        of_rows.min((at.xy() - p).norm().max((at.z - z_mm).abs()))
    }

    fn assert_contract(solid: &Solid) {
        let skins = std::iter::once(&solid.lumen).chain(&solid.outer);
        for (skin, slab) in skins.flat_map(|skin| skin.slabs.iter().map(move |slab| (skin, slab))) {
            for share in [0.003, 0.11, 0.37, 0.52, 0.74, 0.96] {
                let w = slab.w_mm[0] + share * (slab.w_mm[1] - slab.w_mm[0]);
                let z_mm = slab.z_of(w);
                let fine = SegmentIndex::try_new(&slab.section(w, 1e-7)).unwrap();
                for tolerance_mm in [0.02, 1e-3] {
                    for contour in slab.section(w, tolerance_mm) {
                        let middles = contour.edges().map(|(a, b)| nalgebra::center(&a, &b));
                        let off = middles.map(|p| fine.nearest(p).distance_mm).fold(0.0, f64::max);
                        assert!(off <= tolerance_mm, "z {z_mm}, {tolerance_mm} mm: chords {off}");
                        let off = contour.points.iter().map(|&p| off_mm(slab, p, z_mm)).fold(0.0, f64::max);
                        assert!(off < 1e-6, "z {z_mm}, {tolerance_mm} mm: vertices {off}");
                    }
                }
            }
            assert!(skin.moved_mm.is_finite());
        }
    }

    #[test]
    fn vertices_lie_on_the_patches_and_chords_keep_the_tolerance_across_splits_and_merges() {
        for kind in [Kind::Carotid, Kind::Merge] {
            assert_contract(&cast(&phantom_stack(kind)));
        }
    }

    #[test]
    fn the_same_holds_across_a_crease() {
        let mut planes = phantom_stack(Kind::Carotid).planes;
        planes.truncate(30);
        let body = Body::Wall { wall_mm: 1.0 };
        let solid = build(&stack(planes), &Params::new(body), &Task::quiet()).unwrap().solid;
        assert!(solid.outer.iter().flat_map(|s| &s.slabs).any(|slab| slab.crotch == Crotch::Crease));
        assert_contract(&solid);
    }

    #[test]
    fn a_section_through_a_slab_is_as_large_as_those_beside_it() {
        let solid = cast(&phantom_stack(Kind::Carotid));
        let slab = &solid.lumen.slabs[0];
        let area = |w: f64| solid.section(slab.z_of(w), 1e-4).outer.area_mm2();
        for (border, inward) in [(slab.w_mm[0], 1e-5), (slab.w_mm[1], -1e-5)] {
            assert!((area(border + inward) - area(border - inward)).abs() < 1e-3);
        }
    }
}
