//! Whether a boundary representation is a valid solid.
//!
//! Tested is what the definition asks: every edge used twice in opposite directions, loops closed in their vertices and
//! in space, curves on their surfaces, no edge without length, surfaces that do not fold, no two faces that meet other
//! than at shared edges, material on the inner side, shells in one piece, and the Euler-Poincare formula with the number
//! of handles that the branches make (Mäntylä, *An Introduction to Solid Modeling*, 1988).
//!
//! Crossings and orientation are tested in horizontal sections at all knots of all tubes, half-way between them and
//! across every event: there all curves must be simple and apart, and go round the material once. That tubes keep clear of
//! themselves and each other between those heights, too, is proved (`clearance`); where it cannot be, they are looked at from
//! near by, and what does not cross there either is told by [`examined`]. What the three patches of one event do between them a
//! triangle test of the mesh sees.

use super::fault::MOST_FAULTS;
use super::near::crossing_near;
use super::sections::{Cutter, Piece, winding};
use super::{Brep, Edge, Face, Fault, Invalid, Kind, Surface, TOLERANCE_MM, along, clearance};
use crate::geom::{Point2, Point3, Vector2};
use crate::spline::PatchSurface;
use rayon::prelude::*;

/// Points of an edge that are tested.
const EDGE_SAMPLES: usize = 32;
/// Chords of a section, and of one that is looked at again because two of them seemed to cross.
const CHORDS: usize = 128;
const FINE_CHORDS: usize = 1024;
/// Sections through an event.
const EVENT_SECTIONS: usize = 8;
/// A chord shorter than this share of the mean one is where a surface degenerates.
const LEAST_CHORD: f64 = 1e-3;
/// What heights are rounded by, in themselves: some dozen units in the last place.
const ROUNDING: f64 = 64.0 * f64::EPSILON;
/// Intervals, each way, at which a saddle is tested for folds.
const SADDLE_SAMPLES: usize = 16;

/// Tests a boundary representation.
///
/// # Errors
/// [`Invalid`] with the faults found, a hundred at most: kind, face and place.
pub fn check(brep: &Brep) -> Result<(), Invalid> {
    examined(brep).map(drop)
}

/// The same, and where faces of a valid solid are not proved to keep clear of themselves and each other at every height
/// (`clearance`): there they lie closer than can be told apart.
///
/// # Errors
/// Those of [`check`].
pub fn examined(brep: &Brep) -> Result<Vec<Fault>, Invalid> {
    // On a thread of the pool: one from outside it would wait for another one to wake at every parallel step.
    rayon::scope(|_| looked_at(brep))
}

fn looked_at(brep: &Brep) -> Result<Vec<Fault>, Invalid> {
    let mut faults = references(brep);
    // What follows would stumble over missing edges.
    if faults.is_empty() {
        faults.extend(uses(brep));
        faults.par_extend(brep.faces.par_iter().enumerate().flat_map_iter(|(i, f)| loops(brep, i, f)));
        faults.par_extend(brep.edges.par_iter().flat_map_iter(|e| edge(brep, e)));
        faults.par_extend(brep.faces.par_iter().enumerate().filter_map(|(i, f)| fold(i, f)));
        faults.extend(shells(brep));
        faults.extend(euler(brep));
        faults.extend(sections(brep, &Corners::of(brep)));
    }
    let mut unproved = Vec::new();
    if faults.is_empty() {
        let corners = Corners::of(brep);
        unproved = clearance::crossings(brep, &corners);
        let near: Vec<Option<Fault>> =
            unproved.par_iter().take(MOST_FAULTS).map(|place| crossing_near(brep, &corners, place)).collect();
        faults.extend(near.into_iter().flatten());
    }
    faults.truncate(MOST_FAULTS);
    if faults.is_empty() { Ok(unproved) } else { Err(Invalid(faults)) }
}

impl Brep {
    pub(super) fn fault(&self, kind: Kind, face: Option<usize>, at: Point3) -> Fault {
        let part = face.and_then(|i| self.faces.get(i)).map_or("solid", |f| f.surface.name());
        Fault { kind, face, part, at }
    }

    /// Some point of a face.
    fn somewhere(&self, face: usize) -> Point3 {
        let first = self.faces.get(face).and_then(|f| f.loops.first()?.coedges.first());
        let edge = first.and_then(|c| self.edges.get(c.edge));
        edge.map_or_else(Point3::origin, |e| e.curve.ends()[0])
    }

    /// Faces that use an edge, with the direction.
    fn users(&self) -> Vec<Vec<(usize, bool)>> {
        let mut users = vec![Vec::new(); self.edges.len()];
        for (i, face) in self.faces.iter().enumerate() {
            for c in face.loops.iter().flat_map(|l| &l.coedges) {
                users[c.edge].push((i, c.is_forward));
            }
        }
        users
    }
}

/// Faces without borders, and indices that name nothing.
fn references(brep: &Brep) -> Vec<Fault> {
    let (n_vertices, n_edges, n_faces) = (brep.vertices.len(), brep.edges.len(), brep.faces.len());
    let incomplete = |i: usize| brep.fault(Kind::Incomplete, Some(i), brep.somewhere(i));
    let is_whole = |face: &Face| {
        let whole = |l: &super::Loop| !l.coedges.is_empty() && l.coedges.iter().all(|c| c.edge < n_edges);
        !face.loops.is_empty() && face.loops.iter().all(whole)
    };
    let mut faults: Vec<Fault> =
        brep.faces.iter().enumerate().filter(|(_, f)| !is_whole(f)).map(|(i, _)| incomplete(i)).collect();
    let dangling = brep.edges.iter().filter(|e| e.start.max(e.end) >= n_vertices);
    faults.extend(dangling.map(|e| brep.fault(Kind::Incomplete, None, e.curve.ends()[0])));
    let mut owners = vec![0; n_faces];
    for &face in brep.shells().flat_map(|s| &s.faces) {
        match owners.get_mut(face) {
            Some(n) => *n += 1,
            None => faults.push(incomplete(face)),
        }
    }
    faults.extend((0..n_faces).filter(|&i| owners[i] != 1).map(incomplete));
    faults
}

/// Edges that are not used twice, once each way.
fn uses(brep: &Brep) -> Vec<Fault> {
    let fault = |(edge, users): (&Edge, &Vec<(usize, bool)>)| {
        let kind = match users[..] {
            [(_, a), (_, b)] if a != b => return None,
            [_, _] => Kind::Misoriented,
            _ => Kind::EdgeUses(users.len()),
        };
        let [a, b] = edge.curve.range();
        Some(brep.fault(kind, users.first().map(|u| u.0), edge.curve.at(0.5 * (a + b))))
    };
    brep.edges.iter().zip(&brep.users()).filter_map(fault).collect()
}

/// Loops that are open, and curves that are not on the face.
fn loops(brep: &Brep, index: usize, face: &Face) -> Vec<Fault> {
    let mut faults = Vec::new();
    for l in &face.loops {
        for (k, coedge) in l.coedges.iter().enumerate() {
            let next = &l.coedges[(k + 1) % l.coedges.len()];
            let edge = &brep.edges[coedge.edge];
            let (end, start) =
                (edge.ends(coedge.is_forward)[1], brep.edges[next.edge].ends(next.is_forward)[0]);
            if end != start {
                faults.push(brep.fault(Kind::LoopOpen, Some(index), brep.vertices[end].point));
            }
            let gap = |k: usize| {
                let share = k as f64 / EDGE_SAMPLES as f64;
                let [a, b] = edge.curve.range();
                let on_curve = edge.curve.at(a + (b - a) * share);
                let off = match &face.surface {
                    Surface::Plane(z_mm) => (on_curve.z - z_mm).abs(),
                    Surface::Tube(s) | Surface::Lateral(s) | Surface::Saddle(s) => {
                        let [u, v] = along(coedge.trace, share);
                        (s.at(u, v) - on_curve).norm()
                    }
                };
                (off, on_curve)
            };
            let worst = (0..=EDGE_SAMPLES).map(gap).max_by(|a, b| a.0.total_cmp(&b.0));
            // Not a number is off, too.
            if let Some((off, at)) = worst.filter(|w| exceeds(w.0, TOLERANCE_MM)) {
                faults.push(brep.fault(Kind::OffSurface(off), Some(index), at));
            }
        }
    }
    faults
}

/// Whether a value is above a limit; what is not a number is.
fn exceeds(value: f64, limit: f64) -> bool {
    value > limit || value.is_nan() || limit.is_nan()
}

fn edge(brep: &Brep, edge: &Edge) -> Vec<Fault> {
    let places = [edge.start, edge.end].map(|v| brep.vertices[v].point);
    let mut faults = Vec::new();
    for (place, end) in places.into_iter().zip(edge.curve.ends()) {
        let gap = (place - end).norm();
        if exceeds(gap, TOLERANCE_MM) {
            faults.push(brep.fault(Kind::OffVertex(gap), None, end));
        }
    }
    if edge.curve.polygon_length_mm() <= TOLERANCE_MM {
        faults.push(brep.fault(Kind::ZeroLength, None, places[0]));
    }
    faults
}

/// Where a surface folds: a tube or lateral whose rows are not level or do not rise one after the other, a saddle that
/// turns over.
fn fold(index: usize, face: &Face) -> Option<Fault> {
    let at = match &face.surface {
        Surface::Plane(_) => None,
        Surface::Tube(s) | Surface::Lateral(s) => uneven_row(s),
        Surface::Saddle(s) => turned_over(s),
    };
    at.map(|at| Fault { kind: Kind::Folded, face: Some(index), part: face.surface.name(), at })
}

fn uneven_row(surface: &PatchSurface) -> Option<Point3> {
    let points: Vec<Point3> = surface.control().collect();
    let rows: Vec<&[Point3]> = points.chunks_exact(surface.bases()[0].len()).collect();
    let [first, last] = [rows[0][0].z, rows[rows.len() - 1][0].z];
    let way = last - first;
    let rounding = ROUNDING * first.abs().max(last.abs());
    let tilted = |row: &&[Point3]| row.iter().any(|p| exceeds((p.z - row[0].z).abs(), TOLERANCE_MM));
    // Towards a crease's apex rows may lie at one height, but never sink.
    let sinks = |pair: &[&[Point3]]| {
        exceeds((pair[0][0].z - pair[1][0].z) * way.signum(), 1e-12 * way.abs() + rounding)
    };
    let bad = rows.iter().find(|r| tilted(r)).map(|r| r[0]);
    bad.or_else(|| rows.windows(2).find(|p| sinks(p)).map(|p| p[1][0]))
}

fn turned_over(saddle: &PatchSurface) -> Option<Point3> {
    let at = |k: usize, [a, b]: [f64; 2]| a + (b - a) * k as f64 / SADDLE_SAMPLES as f64;
    let areas: Vec<(f64, Point3)> = (0..=SADDLE_SAMPLES)
        .flat_map(|j| (0..=SADDLE_SAMPLES).map(move |i| (i, j)))
        .map(|(i, j)| {
            let jet = saddle.jet(at(i, saddle.u_range()), at(j, saddle.v_range()));
            (jet.by_u.xy().perp(&jet.by_v.xy()), jet.point)
        })
        .collect();
    let mean = areas.iter().map(|a| a.0).sum::<f64>() / areas.len() as f64;
    // Seen along z it covers its place once: it is a graph over the plane.
    areas.into_iter().find(|(area, _)| exceeds(-area * mean.signum(), 1e-3 * mean.abs())).map(|a| a.1)
}

/// Shells that fall apart, bodies that are inside out, hollows outside every body.
fn shells(brep: &Brep) -> Vec<Fault> {
    let mut faults = Vec::new();
    for shell in brep.shells() {
        let parts = brep.components(|i| shell.faces.binary_search(&i).is_ok());
        for part in parts.iter().skip(1) {
            faults.push(brep.fault(Kind::Disconnected, Some(part[0]), brep.somewhere(part[0])));
        }
    }
    for body in &brep.bodies {
        let wrong = |shell: &super::Shell, kind: Kind| {
            let face = shell.faces.first().copied();
            brep.fault(kind, face, face.map_or_else(Point3::origin, |i| brep.somewhere(i)))
        };
        if brep.volume_of_mm3(&body.outer.faces) <= 0.0 {
            faults.push(wrong(&body.outer, Kind::InsideOut));
        }
        for hollow in &body.voids {
            if brep.volume_of_mm3(&hollow.faces) >= 0.0 {
                faults.push(wrong(hollow, Kind::InsideOut));
            } else if !brep.holds(&body.outer, hollow) {
                faults.push(wrong(hollow, Kind::StrayVoid));
            }
        }
    }
    faults
}

/// The Euler-Poincare formula. Tubes are the arcs, and what joins or ends them are the nodes of a graph; a closed surface has as
/// many handles as that graph has independent cycles.
fn euler(brep: &Brep) -> Option<Fault> {
    let count = |n: usize| i64::try_from(n).unwrap_or(i64::MAX);
    let is_tube = |i: usize| matches!(brep.faces[i].surface, Surface::Tube(_));
    let n_shells = count(brep.shells().count());
    let n_rings: usize = brep.faces.iter().map(|f| f.loops.len() - 1).sum();
    let n_nodes = count(brep.components(|i| !is_tube(i)).len());
    let n_tubes = count((0..brep.faces.len()).filter(|&i| is_tube(i)).count());
    let handles = n_tubes - n_nodes + n_shells;
    let found =
        count(brep.vertices.len()) - count(brep.edges.len()) + count(brep.faces.len()) - count(n_rings);
    let expected = 2 * (n_shells - handles);
    (found != expected).then(|| brep.fault(Kind::Euler { found, expected }, None, brep.somewhere(0)))
}

/// Heights at which sections are looked at: every knot of a tube, half-way between, and across the events.
fn heights(brep: &Brep) -> Vec<f64> {
    let mut all = Vec::new();
    for face in &brep.faces {
        match &face.surface {
            Surface::Tube(s) => {
                let mut knots = s.bases()[1].knots().to_vec();
                knots.dedup();
                all.extend(knots.windows(2).map(|k| 0.5 * (k[0] + k[1])));
                all.extend_from_slice(knots.get(1..knots.len() - 1).unwrap_or_default());
            }
            Surface::Lateral(s) => {
                let [a, b] = s.border_column(crate::spline::Side::First).ends().map(|p| p.z);
                let at = |k: usize| a + (b - a) * (k as f64 + 0.5) / EVENT_SECTIONS as f64;
                all.extend((0..EVENT_SECTIONS).map(at));
            }
            Surface::Saddle(_) | Surface::Plane(_) => {}
        }
    }
    all.sort_by(f64::total_cmp);
    all.dedup_by(|a, b| *a - *b < TOLERANCE_MM);
    all
}

fn sections(brep: &Brep, corners: &Corners) -> Vec<Fault> {
    let n = brep.faces.len();
    let coarse = Cutter::new(brep, 0..n, CHORDS);
    let ends: Vec<f64> = coarse.ranges().flatten().collect();
    // At the end of a face it is not settled which one is cut.
    let inside = |z: &f64| ends.iter().all(|e| (e - z).abs() > TOLERANCE_MM);
    let levels: Vec<f64> = heights(brep).into_iter().filter(inside).collect();
    let suspect: Vec<f64> =
        levels.into_par_iter().filter(|&z| section_fault(&coarse.cut(z), corners).is_some()).collect();
    if suspect.is_empty() {
        return Vec::new();
    }
    let fine = Cutter::new(brep, 0..n, FINE_CHORDS);
    let place = |&z: &f64| {
        let (kind, face, p) = section_fault(&fine.cut(z), corners)?;
        Some(brep.fault(kind, Some(face), Point3::new(p.x, p.y, z)))
    };
    suspect.par_iter().filter_map(place).collect()
}

/// The first fault of a section: a curve that degenerates, curves that cross, material on the wrong side.
fn section_fault(pieces: &[Piece], corners: &Corners) -> Option<(Kind, usize, Point2)> {
    degenerate(pieces).or_else(|| crossing(pieces, corners)).or_else(|| wrong_side(pieces))
}

fn degenerate(pieces: &[Piece]) -> Option<(Kind, usize, Point2)> {
    // Pieces of a saddle are single segments of any length.
    pieces.iter().filter(|p| p.points.len() > 2).find_map(|piece| {
        let chords: Vec<f64> = piece.edges().map(|(a, b)| (b - a).norm()).collect();
        let mean = chords.iter().sum::<f64>() / chords.len() as f64;
        let i = chords.iter().position(|c| exceeds(LEAST_CHORD * mean, *c))?;
        Some((Kind::Folded, piece.face, piece.points[i]))
    })
}

/// The vertices of each face, sorted.
pub(super) struct Corners(Vec<Vec<usize>>);

impl Corners {
    pub(super) fn of(brep: &Brep) -> Self {
        let of_face = |face: &Face| {
            let edges = face.loops.iter().flat_map(|l| &l.coedges).map(|c| &brep.edges[c.edge]);
            let mut vertices: Vec<usize> = edges.flat_map(|e| [e.start, e.end]).collect();
            vertices.sort_unstable();
            vertices.dedup();
            vertices
        };
        Self(brep.faces.iter().map(of_face).collect())
    }

    /// Whether two faces are one or have a vertex in common.
    pub(super) fn meet(&self, a: usize, b: usize) -> bool {
        a == b || self.common(a, b).next().is_some()
    }

    /// The vertices that two faces have in common.
    pub(super) fn common(&self, a: usize, b: usize) -> impl Iterator<Item = usize> {
        self.0[a].iter().copied().filter(move |v| self.0[b].binary_search(v).is_ok())
    }
}

/// A chord of a section.
pub(super) struct Chord {
    pub(super) from: Point2,
    pub(super) to: Point2,
    pub(super) piece: usize,
    pub(super) index: usize,
}

fn crossing(pieces: &[Piece], corners: &Corners) -> Option<(Kind, usize, Point2)> {
    let mut chords: Vec<Chord> = Vec::new();
    for (piece, p) in pieces.iter().enumerate() {
        chords.extend(p.edges().enumerate().map(|(index, (from, to))| Chord { from, to, piece, index }));
    }
    chords.sort_by(|a, b| a.from.x.min(a.to.x).total_cmp(&b.from.x.min(b.to.x)));
    for (i, a) in chords.iter().enumerate() {
        let (right, low, high) = (a.from.x.max(a.to.x), a.from.y.min(a.to.y), a.from.y.max(a.to.y));
        let reached = chords[i + 1..].iter().take_while(|b| b.from.x.min(b.to.x) <= right);
        for b in reached.filter(|b| b.from.y.max(b.to.y) >= low && b.from.y.min(b.to.y) <= high) {
            if let Some(at) = cross(a, b).filter(|at| !joins(pieces, corners, a, b, *at)) {
                return Some((Kind::Crossing, pieces[a.piece].face, at));
            }
        }
    }
    None
}

/// Where two chords properly cross.
pub(super) fn cross(a: &Chord, b: &Chord) -> Option<Point2> {
    let (along, other) = (a.to - a.from, b.to - b.from);
    let side = |p: Point2| along.perp(&(p - a.from));
    let (s, t) = (side(b.from), side(b.to));
    let other_side = |p: Point2| other.perp(&(p - b.from));
    let (q, r) = (other_side(a.from), other_side(a.to));
    ((s < 0.0) != (t < 0.0) && (q < 0.0) != (r < 0.0)).then(|| a.from + along * (q / (q - r)))
}

/// Whether chords are neighbours on a curve, or meet where one face's curve goes on as the next one's: there they only
/// touch, up to the sag of a chord.
fn joins(pieces: &[Piece], corners: &Corners, a: &Chord, b: &Chord, at: Point2) -> bool {
    if a.piece == b.piece {
        let n = pieces[a.piece].points.len() - 1;
        let apart = a.index.abs_diff(b.index);
        return apart <= 1 || apart + 1 == n;
    }
    if !corners.meet(pieces[a.piece].face, pieces[b.piece].face) {
        return false;
    }
    let near_end = |c: &Chord| {
        let points = &pieces[c.piece].points;
        let reach = (c.to - c.from).norm() + TOLERANCE_MM;
        [points[0], points[points.len() - 1]].iter().any(|end| (end - at).norm() <= reach)
    };
    let is_tube = |c: &Chord| {
        let points = &pieces[c.piece].points;
        // A piece of a saddle may be as short as it likes and is still open.
        points.len() > 2 && (points[0] - points[points.len() - 1]).norm() < TOLERANCE_MM
    };
    !is_tube(a) && !is_tube(b) && near_end(a) && near_end(b)
}

/// Beside the middle of every curve: the section goes round what is to its left once, and not round what is to its right.
fn wrong_side(pieces: &[Piece]) -> Option<(Kind, usize, Point2)> {
    pieces.iter().filter(|p| p.points.len() > 2).find_map(|piece| {
        let i = piece.points.len() / 2;
        let (a, b) = (piece.points[i - 1], piece.points[i]);
        let along = b - a;
        let left = Vector2::new(-along.y, along.x) * 0.05;
        let middle = nalgebra::center(&a, &b);
        let turns = [middle + left, middle - left].map(|p| winding(pieces, p).round());
        let right_way = (turns[0] - 1.0).abs() < 0.5 && turns[1].abs() < 0.5;
        (!right_way).then_some((Kind::InsideOut, piece.face, middle))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spline::Basis;

    #[test]
    fn rows_that_sink_fold_and_rounding_at_great_heights_does_not() {
        let patch = |z_mm: f64, sunk_mm: f64| {
            let heights = [0.0, 1.0, 1.5, 2.0, 2.0 - sunk_mm].map(|z| z_mm + z);
            let row = |z: f64| (0..4).map(move |k| Point3::new(f64::from(k), 0.0, z));
            let bases = [Basis::clamped(3, [0.0, 1.0], &[]), Basis::clamped(3, [0.0, 1.0], &[0.5])];
            let [u, v] = bases;
            PatchSurface::with_control(u, v, &heights.into_iter().flat_map(row).collect::<Vec<_>>())
        };
        assert!(uneven_row(&patch(0.0, 0.0)).is_none() && uneven_row(&patch(9000.0, 4e-12)).is_none());
        assert!(uneven_row(&patch(0.0, 1e-10)).is_some() && uneven_row(&patch(9000.0, 1e-8)).is_some());
    }
}
