//! Places on a closed loop, between its vertices too.

use super::fill::Vertex;
use crate::geom::Point2;
use crate::geom::distance::nearest_on_segment;

/// Nearer to a vertex than this a place is the vertex, mm.
const SNAP_MM: f64 = 0.03;

/// A place on a loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// The vertex before it.
    pub(super) edge: usize,
    /// How far on the way to the next one, 0 to 1.
    pub(super) share: f64,
}

/// How long a loop is, mm.
pub(super) fn around_mm(vertices: &[Vertex]) -> f64 {
    (0..vertices.len()).map(|i| edge_mm(vertices, i)).sum()
}

/// The place so far along a loop from a vertex, at most once around.
pub(super) fn along(vertices: &[Vertex], from: usize, mut mm: f64) -> Place {
    let n = vertices.len();
    for edge in (from..from + n).map(|i| i % n) {
        let length = edge_mm(vertices, edge);
        if mm < length {
            return Place { edge, share: mm / length };
        }
        mm -= length;
    }
    Place { edge: from % n, share: 0.0 }
}

/// The place of a loop that is nearest to a point, and how far away it is, mm.
pub(super) fn nearest(vertices: &[Vertex], p: Point2) -> (Place, f64) {
    let n = vertices.len();
    let foot = |edge: usize| {
        let (a, b) = (vertices[edge].at, vertices[(edge + 1) % n].at);
        let foot = nearest_on_segment(p, a, b);
        let share = (foot - a).norm() / (b - a).norm().max(1e-12);
        (Place { edge, share }, (foot - p).norm())
    };
    let first = (Place { edge: 0, share: 0.0 }, f64::INFINITY);
    (0..n).map(foot).fold(first, |best, next| if next.1 < best.1 { next } else { best })
}

/// The same loop beginning at a place, with a vertex there.
pub(super) fn begun_at(vertices: &[Vertex], place: Place) -> Vec<Vertex> {
    let n = vertices.len();
    let (from, to) = (vertices[place.edge], vertices[(place.edge + 1) % n]);
    let (mut begun, length) = (vertices.to_vec(), edge_mm(vertices, place.edge));
    begun.rotate_left((place.edge + 1) % n);
    if place.share * length < SNAP_MM {
        begun.rotate_right(1);
    } else if (1.0 - place.share) * length >= SNAP_MM {
        let between = |a: f64, b: f64| a + (b - a) * place.share;
        begun.insert(
            0,
            Vertex {
                at: from.at + (to.at - from.at) * place.share,
                width_mm: between(from.width_mm, to.width_mm),
                room_mm: between(from.room_mm, to.room_mm),
            },
        );
    }
    begun
}

fn edge_mm(vertices: &[Vertex], edge: usize) -> f64 {
    (vertices[(edge + 1) % vertices.len()].at - vertices[edge].at).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Vec<Vertex> {
        let vertex = |(x, y, width_mm)| Vertex { at: Point2::new(x, y), width_mm, room_mm: width_mm / 2.0 };
        [(0., 0., 0.4), (4., 0., 0.6), (4., 4., 0.4), (0., 4., 0.4)].map(vertex).to_vec()
    }

    #[test]
    fn a_place_between_vertices_gets_one_of_its_own() {
        let begun = begun_at(&square(), along(&square(), 0, 1.0));
        assert_eq!(begun.len(), 5);
        assert!((begun[0].at - Point2::new(1.0, 0.0)).norm() < 1e-12);
        assert!((begun[0].width_mm - 0.45).abs() < 1e-12 && (begun[0].room_mm - 0.225).abs() < 1e-12);
        assert!((around_mm(&begun) - 16.0).abs() < 1e-12);
        assert_eq!((begun[1].at, begun[4].at), (Point2::new(4.0, 0.0), Point2::new(0.0, 0.0)));
    }

    #[test]
    fn a_place_at_a_vertex_is_the_vertex() {
        for (mm, at) in
            [(4.01, Point2::new(4.0, 0.0)), (7.99, Point2::new(4.0, 4.0)), (0.0, Point2::origin())]
        {
            let begun = begun_at(&square(), along(&square(), 0, mm));
            assert!(begun.len() == 4 && begun[0].at == at, "{mm}");
        }
    }

    #[test]
    fn the_nearest_place_is_the_foot() {
        let (place, distance_mm) = nearest(&square(), Point2::new(5.0, 3.0));
        assert!(place.edge == 1 && (place.share - 0.75).abs() < 1e-12 && (distance_mm - 1.0).abs() < 1e-12);
    }
}
