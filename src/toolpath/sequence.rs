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
use crate::geom::{Point2, Vector2, Vector3};

/// Largest change of width from one segment to the next before the segment is divided, mm,
const WIDTH_STEP_MM: f64 = 0.006;
/// unless the pieces would be shorter than this, mm;
const SHORTEST_STEP_MM: f64 = 0.05;
/// and before it is divided whatever its length, mm: a quarter of it is how far the wider piece bulges out of the skin where the
/// narrower one begins.
const STEEPEST_STEP_MM: f64 = 0.04;

/// The grid in which places on the bed are written, mm.
const GRID_MM: f64 = 1e-3;

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
    mut paths: Vec<Path>,
    net: &Net,
    params: &FillParams,
    at: Option<Point2>,
    seams: &Seams<'_>,
) -> Sequence {
    let mut sequence = Sequence { at, ..Sequence::default() };
    let islands: Vec<usize> = paths.iter().map(|p| net.island_near(p.vertices[0].at)).collect();
    let mut open: Vec<(usize, Path)> = islands.into_iter().zip(paths.drain(..)).collect();
    while let Some(island) = nearest_island(&open, sequence.at) {
        let (mut here, rest): (Vec<_>, Vec<_>) = open.into_iter().partition(|(i, _)| *i == island);
        open = rest;
        let (mut n_lumens, mut n_outer) = (0, 0);
        while let Some(next) = next_path(&here, sequence.at) {
            let (_, path) = here.swap_remove(next);
            let vertices = match path.role {
                Role::Lumen if path.closed => {
                    n_lumens += 1;
                    let around = seams.begun(&path.vertices, n_lumens);
                    sequence.seams.push(around[0].at);
                    lead::led(around, &mut here, params)
                }
                Role::Outer if path.closed => {
                    n_outer += 1;
                    let from = sequence.at.filter(|_| n_lumens > 0);
                    let mut around = seams.outer_begun(&path.vertices, n_outer, from);
                    sequence.seams.push(around[0].at);
                    around.push(around[0]);
                    around
                }
                _ => unrolled(&path, nearest_vertex(&path, sequence.at).0),
            };
            sequence.lay(path.kind, &vertices, net);
        }
    }
    sequence
}

/// Puts what stands around the part in order, by nearness. A way that crosses an outline of the part goes round its lumen as
/// any other; every one is retracted.
pub(super) fn around(paths: Vec<Path>, net: Option<&Net>, at: Option<Point2>) -> Sequence {
    let mut sequence = Sequence { at, ..Sequence::default() };
    let mut open: Vec<(usize, Path)> = paths.into_iter().map(|path| (0, path)).collect();
    while let Some(next) = next_path(&open, sequence.at) {
        let (_, path) = open.swap_remove(next);
        let begin = nearest_vertex(&path, sequence.at).0;
        let vertices = unrolled(&path, begin);
        let first = vertices[0].at;
        let way = sequence.at.zip(net).map(|(at, net)| net.travel(at, first)).unwrap_or_default();
        sequence.travels.push(Travel { leaves_material: true, ..way });
        sequence.beads.push(Bead { kind: path.kind, points: bead_points(&vertices) });
        sequence.at = Some(vertices[vertices.len() - 1].at);
    }
    sequence
}

fn nearest_island(open: &[(usize, Path)], at: Option<Point2>) -> Option<usize> {
    let distance = |p: &Path| nearest_vertex(p, at).1;
    open.iter().min_by(|a, b| distance(&a.1).total_cmp(&distance(&b.1))).map(|(island, _)| *island)
}

/// The nearest path of the first role that is left.
fn next_path(open: &[(usize, Path)], at: Option<Point2>) -> Option<usize> {
    (0..open.len()).min_by(|&a, &b| {
        let key = |i: usize| (open[i].1.role, nearest_vertex(&open[i].1, at).1);
        let (a, b) = (key(a), key(b));
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
    })
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
                at: on_grid(a.at + (b.at - a.at) * (i as f64 / n as f64)),
                width_mm: a.width_mm + change * (i as f64 + 0.5) / n as f64,
            });
        });
    }
    let width_mm = points.last().map_or(vertices[0].width_mm, |p| p.width_mm);
    points.push(BeadPoint { at: on_grid(vertices[vertices.len() - 1].at), width_mm });
    points
}

fn on_grid(p: Point2) -> Point2 {
    p.map(|c| (c / GRID_MM).round() * GRID_MM)
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
        assert!((volume - 0.55).abs() < 0.1 * GRID_MM, "{volume}");
    }

    #[test]
    fn points_lie_on_the_grid_they_are_written_in() {
        let line = vertices(&[(0.12305, 7.0), (0.12311, 7.0), (3.45678, -1.23456)]);
        let points = bead_points(&line);
        // The second one would be written in the place of the first.
        assert_eq!(points.len(), 2);
        for c in points.iter().flat_map(|p| [p.at.x, p.at.y]) {
            assert!(((c / GRID_MM).round() * GRID_MM - c).abs() < 1e-12, "{c}");
        }
    }
}
