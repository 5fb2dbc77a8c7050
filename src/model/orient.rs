//! Triangles that face the other way than their neighbours, as programs write them that do not keep the order of corners.
//!
//! Two triangles that share an edge run along it in opposite directions, or one of them is to be turned. What hangs together by
//! such edges is a piece; inside it all follow its first triangle. A piece of which any had to be turned says nothing of what
//! is outside: it is turned outward by the sign of its volume, and inward where it lies in an odd number of closed pieces: a
//! cavity or a bore stays one. A piece that agrees with itself keeps its direction.
//!
//! A piece lies in another one where all of some of its vertices do: a ray upward goes through the other one's surface an odd
//! number of times (exact predicates of Shewchuk, *Adaptive Precision Floating-Point Arithmetic*, 1997).
//!
//! Not turned: a surface with one side only (a Möbius strip). Not followed: edges of more than two triangles.
//!
//! Cost: a sort of the edges; all else is linear, but for the rays, of which there are a few a piece.

use super::edges;
use crate::geom::Point3;
use crate::mesh::TriMesh;
use rayon::prelude::*;
use robust::{Coord, Coord3D, orient2d, orient3d};

/// No neighbour, no piece.
const NONE: u32 = u32::MAX;
/// Vertices of a piece that are looked at to see what it lies in.
const SAMPLES: u32 = 8;

/// What was done about triangles that face different ways.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Turned {
    /// Triangles that were turned.
    pub(super) n_turned: usize,
    /// Edges beside which triangles still face different ways.
    pub(super) n_torn: usize,
}

/// An edge as a triangle uses it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Side {
    /// The edge's vertices, the lesser one first.
    edge: [u32; 2],
    triangle: u32,
    /// Whether the triangle runs from the lesser to the greater one.
    is_up: bool,
}

/// What hangs together by edges of two triangles.
#[derive(Debug, Clone, Copy, Default)]
struct Piece {
    n_triangles: u32,
    /// Triangles that face the other way than the first.
    n_turned: u32,
    is_open: bool,
    is_one_sided: bool,
}

/// All pieces, and for each triangle its own and whether it faces the other way than that one's first.
struct Pieces {
    pieces: Vec<Piece>,
    of: Vec<u32>,
    is_turned: Vec<bool>,
}

/// Turns triangles so that those of a piece face one way, outward.
pub(super) fn oriented(mesh: &mut TriMesh) -> Turned {
    let sides = sides(mesh);
    let mut pieces = Pieces::of(mesh, &sides);
    pieces.face_outward(mesh);
    let is_turned = &pieces.is_turned;
    let is_up = |side: &Side| side.is_up != is_turned[side.triangle as usize];
    let is_torn = |same: &&[Side]| {
        same.len().is_multiple_of(2) && 2 * same.iter().filter(|s| is_up(s)).count() != same.len()
    };
    let n_torn = sides.chunk_by(|a, b| a.edge == b.edge).filter(is_torn).count();
    let n_turned = is_turned.iter().filter(|t| **t).count();
    let turned = mesh.triangles.par_iter().zip(is_turned);
    mesh.triangles = turned.map(|(&[a, b, c], &turned)| if turned { [a, c, b] } else { [a, b, c] }).collect();
    mesh.triangles.par_sort_unstable();
    Turned { n_turned, n_torn }
}

/// Whether there is no piece that faces outward.
pub(super) fn all_face_inward(mesh: &TriMesh) -> bool {
    let pieces = Pieces::of(mesh, &sides(mesh));
    pieces.volumes_mm3(mesh).iter().all(|v| *v <= 0.0)
}

/// All edges of all triangles, those of one edge beside each other.
fn sides(mesh: &TriMesh) -> Vec<Side> {
    let of = |(triangle, t): (usize, &[u32; 3])| {
        edges(t).map(|[a, b]| {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "no more triangles than corners, which are numbered"
            )]
            let triangle = triangle as u32;
            Side { edge: [a.min(b), a.max(b)], triangle, is_up: a < b }
        })
    };
    let mut sides: Vec<Side> = mesh.triangles.par_iter().enumerate().flat_map_iter(of).collect();
    sides.par_sort_unstable();
    sides
}

/// For each triangle its neighbours, and whether they face the other way than it.
fn neighbours(n_triangles: usize, sides: &[Side]) -> Vec<[(u32, bool); 3]> {
    let mut neighbours = vec![[(NONE, false); 3]; n_triangles];
    let mut link = |from: u32, to: u32, faces_away: bool| {
        let places = &mut neighbours[from as usize];
        if let Some(free) = places.iter_mut().find(|(t, _)| *t == NONE) {
            *free = (to, faces_away);
        }
    };
    for same in sides.chunk_by(|a, b| a.edge == b.edge) {
        if let [a, b] = same {
            link(a.triangle, b.triangle, a.is_up == b.is_up);
            link(b.triangle, a.triangle, a.is_up == b.is_up);
        }
    }
    neighbours
}

impl Pieces {
    fn of(mesh: &TriMesh, sides: &[Side]) -> Self {
        let n = mesh.triangles.len();
        let neighbours = neighbours(n, sides);
        let mut all = Self { pieces: Vec::new(), of: vec![NONE; n], is_turned: vec![false; n] };
        for first in 0..n {
            if all.of[first] == NONE {
                all.flood(first, &neighbours);
            }
        }
        all
    }

    /// Finds what hangs together with a triangle.
    fn flood(&mut self, first: usize, neighbours: &[[(u32, bool); 3]]) {
        #[expect(clippy::cast_possible_truncation, reason = "no more pieces than triangles")]
        let number = self.pieces.len() as u32;
        let mut piece = Piece::default();
        let mut next = vec![first];
        self.of[first] = number;
        while let Some(t) = next.pop() {
            piece.n_triangles += 1;
            piece.n_turned += u32::from(self.is_turned[t]);
            for &(other, faces_away) in &neighbours[t] {
                if other == NONE {
                    piece.is_open = true;
                    continue;
                }
                let (other, is_turned) = (other as usize, self.is_turned[t] != faces_away);
                if self.of[other] == NONE {
                    (self.of[other], self.is_turned[other]) = (number, is_turned);
                    next.push(other);
                } else {
                    piece.is_one_sided |= self.is_turned[other] != is_turned;
                }
            }
        }
        self.pieces.push(piece);
    }

    /// Turns what disagreed with itself outward, and nothing else.
    fn face_outward(&mut self, mesh: &TriMesh) {
        let volumes_mm3 = self.volumes_mm3(mesh);
        let depths = self.depths(mesh);
        for (piece, is_turned) in self.of.iter().map(|p| *p as usize).zip(&mut self.is_turned) {
            let is_outward = (volumes_mm3[piece] >= 0.0) == depths[piece].is_multiple_of(2);
            *is_turned = self.pieces[piece].is_mixed() && *is_turned == is_outward;
        }
    }

    /// What each piece encloses once its triangles face as its first, mm³; of an open one, with cones to one of its corners.
    fn volumes_mm3(&self, mesh: &TriMesh) -> Vec<f64> {
        let mut origins: Vec<Option<Point3>> = vec![None; self.pieces.len()];
        let mut volumes_mm3 = vec![0.0; self.pieces.len()];
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            let piece = self.of[t] as usize;
            let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize]);
            let origin = *origins[piece].get_or_insert(a);
            let volume_mm3 = (a - origin).dot(&(b - origin).cross(&(c - origin))) / 6.0;
            volumes_mm3[piece] += if self.is_turned[t] { -volume_mm3 } else { volume_mm3 };
        }
        volumes_mm3
    }

    /// In how many closed pieces each one lies that is closed and has to be turned outward.
    fn depths(&self, mesh: &TriMesh) -> Vec<u32> {
        let samples = self.samples(mesh);
        let mut depths = vec![0; self.pieces.len()];
        let crossed = |(t, triangle): (usize, &[u32; 3])| {
            let corners = triangle.map(|v| mesh.vertices[v as usize]);
            let y = corners.map(|p| p.y);
            let (low, high) = (y[0].min(y[1]).min(y[2]), y[0].max(y[1]).max(y[2]));
            let first = samples.partition_point(|s| s.at.y < low);
            let near = samples[first..].iter().take_while(move |s| s.at.y <= high);
            let piece = self.of[t];
            let is_closed = !self.pieces[piece as usize].is_open;
            near.filter(move |s| is_closed && s.piece != piece && is_below(&s.at, &corners))
                .map(move |s| (s.piece, piece, s.number))
        };
        let mut crossed: Vec<(u32, u32, u32)> =
            mesh.triangles.par_iter().enumerate().flat_map_iter(crossed).collect();
        crossed.par_sort_unstable();
        for pair in crossed.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let inside = pair.chunk_by(|a, b| a.2 == b.2).filter(|same| same.len() % 2 == 1).count();
            let inner = pair[0].0;
            depths[inner as usize] += u32::from(inside == self.pieces[inner as usize].n_samples());
        }
        depths
    }

    /// Vertices of pieces that are closed and have to be turned outward, by y.
    fn samples(&self, mesh: &TriMesh) -> Vec<Sample> {
        let mut seen = vec![0_u32; self.pieces.len()];
        let mut samples = Vec::new();
        for (t, &piece) in self.of.iter().enumerate() {
            let Piece { is_open, n_triangles, .. } = self.pieces[piece as usize];
            let number = seen[piece as usize];
            seen[piece as usize] += 1;
            let stride = n_triangles.div_ceil(SAMPLES);
            if !is_open && self.pieces[piece as usize].is_mixed() && number.is_multiple_of(stride) {
                samples.push(Sample { at: mesh.vertices[mesh.triangles[t][0] as usize], piece, number });
            }
        }
        samples.sort_by(|a, b| a.at.y.total_cmp(&b.at.y));
        samples
    }
}

/// A vertex of a piece.
struct Sample {
    at: Point3,
    piece: u32,
    number: u32,
}

impl Piece {
    /// Whether it disagreed with itself and can be turned so that it does not.
    const fn is_mixed(&self) -> bool {
        self.n_turned > 0 && !self.is_one_sided
    }

    const fn n_samples(&self) -> usize {
        self.n_triangles.div_ceil(self.n_triangles.div_ceil(SAMPLES)) as usize
    }
}

/// Whether a triangle lies above a point. Of the triangles around a vertex or an edge above it, it is those that lie at greater
/// x, then y: a closed surface is met as often as it is crossed.
fn is_below(p: &Point3, corners: &[Point3; 3]) -> bool {
    let flat = |q: &Point3| Coord { x: q.x, y: q.y };
    let solid = |q: &Point3| Coord3D { x: q.x, y: q.y, z: q.z };
    let is_left_of = |a: &Point3, b: &Point3| {
        let (low, high) = if a.y <= b.y { (a, b) } else { (b, a) };
        low.y <= p.y && p.y < high.y && orient2d(flat(low), flat(high), flat(p)) > 0.0
    };
    let [a, b, c] = corners;
    let n_right = [(a, b), (b, c), (c, a)].into_iter().filter(|(a, b)| is_left_of(a, b)).count();
    let up = || orient2d(flat(a), flat(b), flat(c));
    n_right == 1 && up() * orient3d(solid(a), solid(b), solid(c), solid(p)) > 0.0
}
