//! Segments to outlines.

use crate::geom::{Contour, Point2};

/// Where the plane crosses an edge of the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    /// The edge's vertices, the lower number first.
    pub(super) edge: (u32, u32),
    pub(super) at: Point2,
}

/// What a plane cuts out of a triangle, the material to its left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Segment {
    pub(super) from: Crossing,
    pub(super) to: Crossing,
}

/// Outlines as far as the mesh's edges join them.
#[derive(Debug, Default)]
pub(super) struct Chained {
    contours: Vec<Contour>,
    /// Runs that begin and end on an edge with one triangle only.
    open: Vec<Vec<Point2>>,
}

/// Outlines, all closed.
#[derive(Debug, Default)]
pub(super) struct Closed {
    pub(super) contours: Vec<Contour>,
    /// The widest gap that was closed, mm, and where it begins.
    pub(super) widest: Option<(f64, Point2)>,
    pub(super) n_gaps: usize,
}

/// Joins segments that meet on an edge of the mesh. Where more than two triangles share it, any of those that begin there
/// follows: the winding numbers are the same.
pub(super) fn chained(segments: &[Segment]) -> Chained {
    let mut by_start: Vec<((u32, u32), usize)> =
        segments.iter().enumerate().map(|(n, s)| (s.from.edge, n)).collect();
    by_start.sort_unstable();
    let mut used = vec![false; segments.len()];
    // Of those that begin on an edge the first one that is free.
    let follower = |edge: (u32, u32), used: &[bool]| {
        let first = by_start.partition_point(|(e, _)| *e < edge);
        by_start[first..].iter().take_while(|(e, _)| *e == edge).map(|(_, n)| *n).find(|n| !used[*n])
    };
    let mut ends: Vec<(u32, u32)> = segments.iter().map(|s| s.to.edge).collect();
    ends.sort_unstable();
    let count = |edge: (u32, u32), sorted: &[(u32, u32)]| {
        sorted.partition_point(|e| *e <= edge) - sorted.partition_point(|e| *e < edge)
    };
    let mut chained = Chained::default();
    let mut run = |start: usize, used: &mut [bool], is_open: bool| {
        let mut points = Vec::new();
        let mut at = start;
        loop {
            used[at] = true;
            points.push(segments[at].from.at);
            let edge = segments[at].to.edge;
            if !is_open && edge == segments[start].from.edge {
                return chained.contours.push(Contour::new(points));
            }
            match follower(edge, used) {
                Some(next) => at = next,
                None => break,
            }
        }
        points.push(segments[at].to.at);
        chained.open.push(points);
    };
    // Runs that nothing leads to come first: what is left are loops.
    for starts in by_start.chunk_by(|a, b| a.0 == b.0) {
        let missing = starts.len().saturating_sub(count(starts[0].0, &ends));
        starts[..missing].iter().for_each(|(_, start)| run(*start, &mut used, true));
    }
    for &(_, start) in &by_start {
        if !used[start] {
            run(start, &mut used, false);
        }
    }
    chained
}

/// Closes open runs over gaps of up to `most_mm`, the narrowest first.
///
/// # Errors
/// The narrowest gap of a run that finds no end near enough, and where.
pub(super) fn closed(chained: Chained, most_mm: f64) -> Result<Closed, (f64, Point2)> {
    let Chained { contours, open } = chained;
    let mut closed = Closed { contours, ..Closed::default() };
    closed.contours.retain(|c| c.len() > 2);
    if open.is_empty() {
        return Ok(closed);
    }
    let next = followers(&open, most_mm, &mut closed)?;
    let mut used = vec![false; open.len()];
    for start in 0..open.len() {
        let mut points = Vec::new();
        let mut at = start;
        while !used[at] {
            used[at] = true;
            points.extend_from_slice(&open[at]);
            at = next[at];
        }
        points.dedup();
        if points.len() > 2 {
            closed.contours.push(Contour::new(points));
        }
    }
    Ok(closed)
}

/// For each open run the one that goes on where it ends.
fn followers(open: &[Vec<Point2>], most_mm: f64, closed: &mut Closed) -> Result<Vec<usize>, (f64, Point2)> {
    let begins = Begins::of(open);
    let end = |k: usize| open[k][open[k].len() - 1];
    let mut pairs: Vec<(f64, usize, usize)> = (0..open.len())
        .flat_map(|i| begins.near(end(i), most_mm).into_iter().map(move |(mm, j)| (mm, i, j)))
        .collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut next, mut is_followed) = (vec![usize::MAX; open.len()], vec![false; open.len()]);
    for (gap_mm, i, j) in pairs {
        if next[i] != usize::MAX || is_followed[j] {
            continue;
        }
        (next[i], is_followed[j]) = (j, true);
        closed.n_gaps += 1;
        if closed.widest.is_none_or(|(widest, _)| gap_mm > widest) {
            closed.widest = Some((gap_mm, end(i)));
        }
    }
    let loose = (0..open.len()).filter(|&i| next[i] == usize::MAX).map(end);
    begins.narrowest_gap(loose, &is_followed).map_or(Ok(next), Err)
}

/// How many runs that may follow another one are looked at: more lie close together only where a mesh is no surface at all.
const MOST_FOLLOWERS: usize = 32;

/// Where open runs begin, with their numbers, in the order of x.
struct Begins(Vec<(Point2, usize)>);

impl Begins {
    fn of(open: &[Vec<Point2>]) -> Self {
        let mut begins: Vec<(Point2, usize)> = open.iter().enumerate().map(|(k, run)| (run[0], k)).collect();
        begins.sort_by(|a, b| a.0.x.total_cmp(&b.0.x).then(a.1.cmp(&b.1)));
        Self(begins)
    }

    /// Those within a distance of a place, the nearest ones if there are many: distance in mm, number.
    fn near(&self, p: Point2, most_mm: f64) -> Vec<(f64, usize)> {
        let first = self.0.partition_point(|(q, _)| q.x < p.x - most_mm);
        let beside = self.0[first..].iter().take_while(|(q, _)| q.x <= p.x + most_mm);
        let mut near: Vec<(f64, usize)> =
            beside.map(|&(q, j)| ((q - p).norm(), j)).filter(|&(mm, _)| mm <= most_mm).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(MOST_FOLLOWERS);
        near
    }

    /// The least distance of a loose end from a begin that follows nothing, mm, and that end; none where none is loose.
    fn narrowest_gap(
        &self,
        ends: impl Iterator<Item = Point2>,
        is_followed: &[bool],
    ) -> Option<(f64, Point2)> {
        let free: Vec<Point2> = self.0.iter().filter(|(_, j)| !is_followed[*j]).map(|(q, _)| *q).collect();
        let mut narrowest: Option<(f64, Point2)> = None;
        for end in ends {
            let middle = free.partition_point(|q| q.x < end.x);
            let ways: [&mut dyn Iterator<Item = &Point2>; 2] =
                [&mut free[..middle].iter().rev(), &mut free[middle..].iter()];
            for way in ways {
                let best_mm =
                    |narrowest: Option<(f64, Point2)>| narrowest.map_or(f64::INFINITY, |(mm, _)| mm);
                for begin in way {
                    if (begin.x - end.x).abs() > best_mm(narrowest) {
                        break;
                    }
                    let gap_mm = (begin - end).norm();
                    if gap_mm < best_mm(narrowest) {
                        narrowest = Some((gap_mm, end));
                    }
                }
            }
        }
        narrowest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Vector2;

    /// A run of one segment each, from place to place.
    fn loose(runs: impl Iterator<Item = (Point2, Point2)>) -> Chained {
        Chained { contours: Vec::new(), open: runs.map(|(from, to)| vec![from, to]).collect() }
    }

    #[test]
    fn a_heap_of_loose_pieces_is_refused_by_its_narrowest_gap() {
        // All pairs of them would fill memory. One is nearer to its neighbour than the others.
        let at = |i: u32| Point2::new(f64::from(i % 200), f64::from(i / 200));
        let by = |i: u32| if i == 7_000 { 0.6 } else { 0.5 };
        let heap = loose((0..20_000).map(|i| (at(i), at(i) + Vector2::new(by(i), 0.0))));
        let (gap_mm, end) = closed(heap, 0.2).unwrap_err();
        assert!((gap_mm - 0.4).abs() < 1e-9 && end == at(7_000) + Vector2::new(0.6, 0.0), "{gap_mm}");
    }

    #[test]
    fn gaps_are_closed_the_narrowest_first() {
        let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, y)| Point2::new(x, y));
        let short = 0.05;
        let side =
            |k: usize| (corners[k], corners[(k + 1) % 4] + (corners[k] - corners[(k + 1) % 4]) * short);
        let closed = closed(loose([2, 0, 3, 1].into_iter().map(side)), 0.2).unwrap();
        assert_eq!((closed.contours.len(), closed.n_gaps), (1, 4));
        assert_eq!(closed.contours[0].len(), 8);
        assert!((closed.widest.unwrap().0 - short).abs() < 1e-12);
    }
}
