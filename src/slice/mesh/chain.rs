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
    let (begin, end) = (|k: usize| open[k][0], |k: usize| open[k][open[k].len() - 1]);
    let all = (0..open.len()).flat_map(|i| (0..open.len()).map(move |j| (i, j)));
    let mut pairs: Vec<(f64, usize, usize)> = all.map(|(i, j)| ((end(i) - begin(j)).norm(), i, j)).collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut next, mut is_followed) = (vec![usize::MAX; open.len()], vec![false; open.len()]);
    for (gap_mm, i, j) in pairs {
        if next[i] != usize::MAX || is_followed[j] {
            continue;
        }
        if gap_mm > most_mm {
            return Err((gap_mm, end(i)));
        }
        (next[i], is_followed[j]) = (j, true);
        closed.n_gaps += 1;
        if closed.widest.is_none_or(|(widest, _)| gap_mm > widest) {
            closed.widest = Some((gap_mm, end(i)));
        }
    }
    Ok(next)
}
