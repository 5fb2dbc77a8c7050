//! The order of the beads, the places of their seams, and the travels between them.
//!
//! Islands follow each other by nearness; in an island come the loops at the lumen, at the outer skin,
//! the loops inside, the raster. Loops along skins begin where the module `seam` says, those at the lumen as the module `lead` does,
//! every other path at its vertex nearest to the nozzle.

use super::fill::{FillParams, Path, Role, Vertex};
use super::seam::Seams;
use super::travel::{Net, Travel};
use super::{Bead, BeadKind, BeadPoint};
use super::{lead, simplify};
use crate::geom::{Bounds2, Point2, Vector2, Vector3};
use crate::units::on_grid_mm;
use std::collections::HashMap;

/// Largest change of width from one segment to the next before the segment is divided, mm,
const WIDTH_STEP_MM: f64 = 0.006;
/// unless the pieces would be shorter than this, mm;
const SHORTEST_STEP_MM: f64 = 0.05;
/// and before it is divided whatever its length, mm: a quarter of it is how far the wider piece bulges out of the skin where the
/// narrower one begins.
const STEEPEST_STEP_MM: f64 = 0.04;

/// Beads and the travels that lead to them.
#[derive(Debug, Default)]
pub(super) struct Sequence {
    pub(super) beads: Vec<Bead>,
    pub(super) travels: Vec<Travel>,
    /// Where the nozzle is.
    pub(super) at: Option<Point2>,
    /// Where the loops along the skins begin.
    pub(super) seams: Vec<Point2>,
}

/// Puts the paths of a layer in order, beginning at `at`.
pub(super) fn sequence(
    paths: Vec<Path>,
    net: &Net,
    params: &FillParams,
    at: Option<Point2>,
    seams: &Seams<'_>,
) -> Sequence {
    let mut sequence = Sequence { at, ..Sequence::default() };
    let mut islands = by_island(paths, net);
    while let Some((next, _)) =
        nearest(islands.iter().map(|island| island.bounds).enumerate(), sequence.at, |island| {
            islands[island].distance_mm(sequence.at)
        })
    {
        sequence.island(islands.remove(next), net, params, seams);
    }
    sequence
}

/// Puts what stands around the part in order, by nearness. A way that crosses an outline of the part goes round its lumen as
/// any other; every one is retracted.
pub(super) fn around(paths: Vec<Path>, net: Option<&Net>, at: Option<Point2>) -> Sequence {
    let mut sequence = Sequence { at, ..Sequence::default() };
    let mut open = Open::default();
    paths.into_iter().for_each(|path| open.push(path));
    while let Some(path) = open.take_next(sequence.at) {
        let vertices = unrolled(&path, nearest_vertex(&path, sequence.at).0);
        let first = vertices[0].at;
        let way = sequence.at.zip(net).map(|(at, net)| net.travel(at, first)).unwrap_or_default();
        sequence.travels.push(Travel { leaves_material: true, ..way });
        sequence.beads.push(Bead { kind: path.kind, points: bead_points(&vertices) });
        sequence.at = Some(vertices[vertices.len() - 1].at);
    }
    sequence
}

/// The paths of each island, islands in the order of their first paths.
fn by_island(paths: Vec<Path>, net: &Net) -> Vec<Open> {
    let mut numbers: HashMap<usize, usize> = HashMap::new();
    let mut islands: Vec<Open> = Vec::new();
    for path in paths {
        let number = *numbers.entry(net.island_near(path.vertices[0].at)).or_insert(islands.len());
        if number == islands.len() {
            islands.push(Open::default());
        }
        islands[number].push(path);
    }
    islands
}

/// Paths that are not laid yet. What is far away is passed over by its box: a step costs little more than one look at each path.
#[derive(Default)]
struct Open {
    paths: Vec<Path>,
    /// The box of each path as it came here: what is taken off its ends later lies within.
    boxes: Vec<Option<Bounds2>>,
    /// Of all of them.
    bounds: Option<Bounds2>,
}

impl Open {
    fn push(&mut self, path: Path) {
        let bounds = Bounds2::of(path.vertices.iter().map(|v| v.at));
        self.bounds = self.bounds.into_iter().chain(bounds).reduce(Bounds2::union);
        self.boxes.push(bounds);
        self.paths.push(path);
    }

    /// How far away the nearest vertex is at which a path may begin, mm.
    fn distance_mm(&self, at: Option<Point2>) -> f64 {
        self.nearest(at, |_| true).map_or(f64::INFINITY, |(_, mm)| mm)
    }

    /// Takes the nearest path of the first role that is left.
    fn take_next(&mut self, at: Option<Point2>) -> Option<Path> {
        let role = self.paths.iter().map(|path| path.role).min()?;
        let (next, _) = self.nearest(at, |path| path.role == role)?;
        self.boxes.swap_remove(next);
        Some(self.paths.swap_remove(next))
    }

    fn nearest(&self, at: Option<Point2>, is_meant: impl Fn(&Path) -> bool) -> Option<(usize, f64)> {
        let boxes = self.boxes.iter().copied().enumerate().filter(|(i, _)| is_meant(&self.paths[*i]));
        nearest(boxes, at, |i| nearest_vertex(&self.paths[i], at).1)
    }
}

/// The first of the nearest of some things in boxes, and its distance; that of a thing is asked for only where its box is nearer than
/// the best so far.
fn nearest(
    boxes: impl Iterator<Item = (usize, Option<Bounds2>)>,
    at: Option<Point2>,
    distance_mm: impl Fn(usize) -> f64,
) -> Option<(usize, f64)> {
    let mut best: Option<(usize, f64)> = None;
    for (i, bounds) in boxes {
        let least_mm = at.zip(bounds).map_or(0.0, |(at, bounds)| box_distance_mm(bounds, at));
        if best.is_some_and(|(_, mm)| least_mm >= mm) {
            continue;
        }
        let mm = distance_mm(i);
        if best.is_none_or(|(_, nearest_mm)| mm < nearest_mm) {
            best = Some((i, mm));
        }
    }
    best
}

/// How far a place lies from a box, mm; 0 within.
fn box_distance_mm(bounds: Bounds2, p: Point2) -> f64 {
    (bounds.min - p).sup(&(p - bounds.max)).sup(&Vector2::zeros()).norm()
}

/// Index and distance of the vertex at which a path may best begin: any of a loop, the ends of others.
fn nearest_vertex(path: &Path, at: Option<Point2>) -> (usize, f64) {
    let n = path.vertices.len();
    let Some(at) = at else { return (0, 0.0) };
    let distance = |i: usize| (path.vertices[i].at - at).norm();
    let step = if path.closed { 1 } else { (n - 1).max(1) };
    let nearest = (0..n).step_by(step).min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
    (nearest, distance(nearest))
}

impl Sequence {
    /// Lays the paths of an island.
    fn island(&mut self, mut open: Open, net: &Net, params: &FillParams, seams: &Seams<'_>) {
        let (mut n_lumens, mut n_outer) = (0, 0);
        while let Some(path) = open.take_next(self.at) {
            let vertices = match path.role {
                Role::Lumen if path.closed => {
                    n_lumens += 1;
                    let around = seams.begun(&path.vertices, n_lumens);
                    self.seams.push(around[0].at);
                    lead::led(around, &mut open.paths, params)
                }
                Role::Outer if path.closed => {
                    n_outer += 1;
                    let from = self.at.filter(|_| n_lumens > 0);
                    let mut around = seams.outer_begun(&path.vertices, n_outer, from);
                    self.seams.push(around[0].at);
                    around.push(around[0]);
                    around
                }
                _ => unrolled(&path, nearest_vertex(&path, self.at).0),
            };
            self.lay(path.kind, &vertices, net);
        }
    }

    fn lay(&mut self, kind: BeadKind, vertices: &[Vertex], net: &Net) {
        let (first, last) = (vertices[0].at, vertices[vertices.len() - 1].at);
        self.travels.push(self.at.map(|at| net.travel(at, first)).unwrap_or_default());
        self.beads.push(Bead { kind, points: bead_points(vertices) });
        self.at = Some(last);
    }
}

/// The vertices in printing order; a loop's first one again at the end.
fn unrolled(path: &Path, begin: usize) -> Vec<Vertex> {
    let mut vertices = path.vertices.clone();
    if path.closed {
        vertices.rotate_left(begin);
        vertices.push(vertices[0]);
    } else if begin > 0 {
        vertices.reverse();
    }
    vertices
}

/// Widths of segments from widths at vertices; segments along which the width changes much are divided. All points lie on
/// the grid in which places are written: were only the written ones rounded, the length of a short segment would not be
/// the one that its filament is meant for, and the bead would be too wide or too narrow by more than it is misplaced.
pub(super) fn bead_points(vertices: &[Vertex]) -> Vec<BeadPoint> {
    let mut points: Vec<BeadPoint> = Vec::with_capacity(vertices.len());
    let mut push = |point: BeadPoint| match points.last_mut() {
        Some(last) if last.at == point.at => last.width_mm = point.width_mm,
        _ => points.push(point),
    };
    for pair in vertices.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        let change = b.width_mm - a.width_mm;
        let length = (b.at - a.at).norm();
        if length < 1e-6 {
            continue;
        }
        let wanted = (change.abs() / WIDTH_STEP_MM).min(length / SHORTEST_STEP_MM);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "widths are a few mm")]
        let n = wanted.max(change.abs() / STEEPEST_STEP_MM).ceil().max(1.0) as usize;
        (0..n).for_each(|i| {
            push(BeadPoint {
                at: (a.at + (b.at - a.at) * (i as f64 / n as f64)).map(on_grid_mm),
                width_mm: a.width_mm + change * (i as f64 + 0.5) / n as f64,
            });
        });
    }
    let width_mm = points.last().map_or(vertices[0].width_mm, |p| p.width_mm);
    points.push(BeadPoint { at: vertices[vertices.len() - 1].at.map(on_grid_mm), width_mm });
    points
}

/// The path with as few vertices as keep centre line and edges within the tolerance, and enclosing the same area.
pub(super) fn simplified(path: Path, tolerance_mm: f64) -> Path {
    let mut vertices = path.vertices;
    if path.closed {
        vertices.push(vertices[0]);
    }
    let with_width = |v: &Vertex| Vector3::new(v.at.x, v.at.y, v.width_mm / 2.0);
    let points: Vec<Vector3> = vertices.iter().map(with_width).collect();
    let kept = simplify::keep(&points, tolerance_mm);
    let shifts = simplify::area_keeping(&points, &kept, path.closed);
    let moved = |(&i, shift): (&usize, &Vector2)| Vertex { at: vertices[i].at + shift, ..vertices[i] };
    let mut kept: Vec<Vertex> = kept.iter().zip(&shifts).map(moved).collect();
    if path.closed {
        kept.pop();
    }
    Path { vertices: kept, ..path }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vertices(points: &[(f64, f64)]) -> Vec<Vertex> {
        let vertex = |&(x, y): &(f64, f64)| Vertex { at: Point2::new(x, y), width_mm: 0.5, room_mm: 0.25 };
        points.iter().map(vertex).collect()
    }

    #[test]
    fn widths_change_in_small_steps() {
        let mut line = vertices(&[(0., 0.), (1., 0.)]);
        line[1].width_mm = 0.6;
        let points = bead_points(&line);
        let steps = points[..points.len() - 1].windows(2).map(|p| p[1].width_mm - p[0].width_mm);
        assert!(steps.into_iter().all(|step| step > 0.0 && step <= WIDTH_STEP_MM + 1e-12));
        let volume: f64 = points.windows(2).map(|p| p[0].width_mm * (p[1].at - p[0].at).norm()).sum();
        // The grid moves each step by half of its spacing at most.
        assert!((volume - 0.55).abs() < 1e-4, "{volume}");
    }

    #[test]
    fn points_lie_on_the_grid_they_are_written_in() {
        let line = vertices(&[(0.12305, 7.0), (0.12311, 7.0), (3.45678, -1.23456)]);
        let points = bead_points(&line);
        // The second one would be written in the place of the first.
        assert_eq!(points.len(), 2);
        for c in points.iter().flat_map(|p| [p.at.x, p.at.y]) {
            assert_eq!(on_grid_mm(c), c);
        }
    }
}
