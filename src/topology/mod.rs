//! Which contour continues which: the graph over the stack (a discrete Reeb graph).
//!
//! Contours of neighbouring planes are linked where their areas overlap, or where they do after the branch was
//! moved on by its drift (steep branches). Links between several contours below and several above are reduced to
//! stars, weakest overlap first, so that only 1 -> n and n -> 1 remain as events.
//!
//! What it does not do: it keeps no holes (they are reported and filled), and it does not invent planes between
//! the given ones.

use crate::ct::Warning;
use crate::geom::{Contour, Region, Vector2};
use crate::sections::SectionStack;

/// Overlap of two contours, as a fraction of the smaller one's area, from which they are taken for one branch.
/// The smallest true overlap seen on branches 60 degrees off the axis, 3 mm planes, was 0.06; contours of
/// different branches touch, if at all, with less than half of that.
const LEAST_OVERLAP: f64 = 0.03;
/// The same after moving the branch by its drift, where the plain overlap failed: then nearly all of it overlaps.
const LEAST_DRIFTED_OVERLAP: f64 = 0.4;

/// The stack cannot be turned into a graph.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// Fewer than two planes with contours.
    #[error("a solid needs contours on at least two planes; found {found}: add planes, or widen the z range")]
    TooFewPlanes {
        /// Planes with at least one contour.
        found: usize,
    },
    /// Planes out of order, repeated, or not a number.
    #[error(
        "plane {plane}: z {z_mm} mm does not lie above the plane before it ({before_mm} mm): sort the planes and drop repeated ones"
    )]
    PlaneOrder {
        /// Plane, counted from 0.
        plane: usize,
        /// Its height.
        z_mm: f64,
        /// The height of the plane before.
        before_mm: f64,
    },
    /// A contour that bounds no area.
    #[error("plane {plane} (z {z_mm} mm), contour {contour}: {fault}: redraw or remove it")]
    Contour {
        /// Plane, counted from 0.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
        /// Contour, counted from 0.
        contour: usize,
        /// What is wrong with it.
        fault: ContourFault,
    },
    /// Two outer contours of a plane overlap.
    #[error("plane {plane} (z {z_mm} mm): contours {first} and {second} cross: join them or move them apart")]
    Crossing {
        /// Plane, counted from 0.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
        /// One contour, counted from 0.
        first: usize,
        /// The other one.
        second: usize,
    },
    /// A plane without contours between planes that have some.
    #[error(
        "plane {plane} (z {z_mm} mm) has no contour, but planes below and above it have: draw one, or leave the plane out"
    )]
    EmptyPlane {
        /// Plane, counted from 0.
        plane: usize,
        /// Height of the plane.
        z_mm: f64,
    },
    /// No contour is continued on any other plane.
    #[error("no contour overlaps one of the next plane: the planes lie too far apart, or in the wrong order")]
    NothingContinues,
}

/// What is wrong with a contour.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ContourFault {
    /// A closed curve through fewer than this many points says nothing about its shape.
    #[error("it has {0} different points, at least 4 are needed")]
    TooFewPoints(usize),
    /// NaN, infinite or farther out than 5 m.
    #[error("point {0} is not a finite coordinate within 5 m")]
    NotFinite(usize),
    /// It crosses itself.
    #[error("it crosses itself")]
    SelfCrossing,
}

/// A contour of the stack: plane and number in the plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// Plane, counted from 0 in [`Graph::z_mm`].
    pub plane: usize,
    /// The outer contour, counter-clockwise.
    pub contour: Contour,
}

/// Contours of two neighbouring planes that belong together: one below or one above.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Star {
    /// The lower plane.
    pub interval: usize,
    /// Nodes on the lower plane.
    pub lower: Vec<usize>,
    /// Nodes on the upper plane.
    pub upper: Vec<usize>,
}

/// Contours and how they continue each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Graph {
    /// Heights of the planes, mm, ascending.
    pub z_mm: Vec<f64>,
    /// All contours that take part, plane by plane.
    pub nodes: Vec<Node>,
    /// All connections, from the bottom upward; each node is in at most one star downward and one upward.
    pub stars: Vec<Star>,
    /// What was left out or decided by rule.
    pub warnings: Vec<Warning>,
}

/// Builds the graph of a stack.
///
/// # Errors
/// [`Error`], naming plane and contour.
pub fn graph(stack: &SectionStack) -> Result<Graph, Error> {
    let mut warnings = Vec::new();
    check_planes(stack)?;
    let mut nodes = Vec::new();
    for (plane, sections) in stack.planes.iter().enumerate() {
        let outers = checked_outers(stack, plane)?;
        let n_holes = sections.contours.len() - outers.len();
        if n_holes > 0 {
            warnings
                .push(warning("topology.hole_filled", format!("plane {plane}: {n_holes} hole(s) filled")));
        }
        nodes.extend(outers.into_iter().map(|contour| Node { plane, contour }));
    }
    let planes: std::collections::BTreeSet<usize> = nodes.iter().map(|n| n.plane).collect();
    if planes.len() < 2 {
        return Err(Error::TooFewPlanes { found: planes.len() });
    }
    if let Some(plane) =
        planes.iter().zip(planes.iter().skip(1)).find_map(|(a, b)| (b - a > 1).then_some(a + 1))
    {
        return Err(Error::EmptyPlane { plane, z_mm: stack.planes[plane].z_mm });
    }
    let mut links = Vec::new();
    for interval in 0..stack.planes.len() - 1 {
        link_interval(&nodes, interval, &mut links);
        reduce_to_stars(&nodes, stack.planes[interval].z_mm, interval, &mut links, &mut warnings);
    }
    if links.is_empty() {
        return Err(Error::NothingContinues);
    }
    let graph = Graph { z_mm: stack.plane_z_mm(), stars: stars(&nodes, &links), nodes, warnings };
    Ok(without_islands(graph))
}

fn warning(code: &str, text: String) -> Warning {
    Warning { code: code.into(), text }
}

fn check_planes(stack: &SectionStack) -> Result<(), Error> {
    for (plane, pair) in stack.planes.windows(2).enumerate() {
        let (before_mm, z_mm) = (pair[0].z_mm, pair[1].z_mm);
        if !before_mm.is_finite() || !z_mm.is_finite() || z_mm <= before_mm {
            return Err(Error::PlaneOrder { plane: plane + 1, z_mm, before_mm });
        }
    }
    Ok(())
}

/// The outer contours of a plane, counter-clockwise. Contours that lie in another one are holes.
fn checked_outers(stack: &SectionStack, plane: usize) -> Result<Vec<Contour>, Error> {
    let sections = &stack.planes[plane];
    let z_mm = sections.z_mm;
    for (contour, c) in sections.contours.iter().enumerate() {
        check_contour(c).map_err(|fault| Error::Contour { plane, z_mm, contour, fault })?;
    }
    let inside = |i: usize, j: usize| {
        let (a, b) = (&sections.contours[i], &sections.contours[j]);
        b.signed_area_mm2().abs() > a.signed_area_mm2().abs() && b.contains(a.points[0])
    };
    let n = sections.contours.len();
    let depth = |i: usize| (0..n).filter(|&j| j != i && inside(i, j)).count();
    let outer_idx: Vec<usize> = (0..n).filter(|&i| depth(i) % 2 == 0).collect();
    let outers: Vec<Contour> = outer_idx.iter().map(|&i| counter_clockwise(&sections.contours[i])).collect();
    for (a, first) in outers.iter().enumerate() {
        for (b, second) in outers.iter().enumerate().skip(a + 1) {
            if overlap_mm2(first, second) > 1e-6 * first.signed_area_mm2().min(second.signed_area_mm2()) {
                return Err(Error::Crossing { plane, z_mm, first: outer_idx[a], second: outer_idx[b] });
            }
        }
    }
    Ok(outers)
}

fn check_contour(contour: &Contour) -> Result<(), ContourFault> {
    let usable = |c: f64| c.is_finite() && c.abs() <= 5000.0;
    if let Some(i) = contour.points.iter().position(|p| !usable(p.x) || !usable(p.y)) {
        return Err(ContourFault::NotFinite(i));
    }
    let distinct = contour.edges().filter(|(a, b)| (b - a).norm() > 1e-9).count();
    if distinct < 4 {
        return Err(ContourFault::TooFewPoints(distinct));
    }
    let area = contour.signed_area_mm2().abs();
    let simple = Region::from_even_odd(std::slice::from_ref(contour));
    // A loop lies inside (the even-odd area shrinks) or outside (the signed area cancels).
    let same_area = (simple.area_mm2() - area).abs() <= 1e-4 * contour.perimeter_mm().max(1e-3);
    if simple.contours.len() != 1 || !same_area {
        return Err(ContourFault::SelfCrossing);
    }
    Ok(())
}

fn counter_clockwise(contour: &Contour) -> Contour {
    if contour.is_ccw() { contour.clone() } else { contour.reversed() }
}

fn overlap_mm2(a: &Contour, b: &Contour) -> f64 {
    let (Some(ba), Some(bb)) = (a.bounds(), b.bounds()) else { return 0.0 };
    let apart = ba.min.x > bb.max.x || bb.min.x > ba.max.x || ba.min.y > bb.max.y || bb.min.y > ba.max.y;
    if apart {
        return 0.0;
    }
    Region::new(vec![a.clone()]).intersection(&Region::new(vec![b.clone()])).area_mm2()
}

/// Two contours that continue each other, with their overlap as a fraction of the smaller area.
#[derive(Debug, Clone, Copy)]
struct Link {
    lower: usize,
    upper: usize,
    overlap: f64,
}

fn of_plane(nodes: &[Node], plane: usize) -> std::ops::Range<usize> {
    nodes.partition_point(|n| n.plane < plane)..nodes.partition_point(|n| n.plane <= plane)
}

fn overlap_fraction(a: &Contour, b: &Contour) -> f64 {
    overlap_mm2(a, b) / a.signed_area_mm2().min(b.signed_area_mm2())
}

fn link_interval(nodes: &[Node], interval: usize, links: &mut Vec<Link>) {
    let start = links.len();
    let (lowers, uppers) = (of_plane(nodes, interval), of_plane(nodes, interval + 1));
    for lower in lowers.clone() {
        for upper in uppers.clone() {
            let overlap = overlap_fraction(&nodes[lower].contour, &nodes[upper].contour);
            if overlap >= LEAST_OVERLAP {
                links.push(Link { lower, upper, overlap });
            }
        }
    }
    for lower in lowers {
        if links[start..].iter().any(|l| l.lower == lower) {
            continue;
        }
        let moved = moved_on(&nodes[lower].contour, drift(nodes, links, lower));
        let best = uppers
            .clone()
            .map(|upper| Link { lower, upper, overlap: overlap_fraction(&moved, &nodes[upper].contour) })
            .max_by(|a, b| a.overlap.total_cmp(&b.overlap));
        links.extend(best.filter(|l| l.overlap >= LEAST_DRIFTED_OVERLAP));
    }
}

/// How far the branch moved from the plane below to this node; zero where it begins here.
fn drift(nodes: &[Node], links: &[Link], node: usize) -> Vector2 {
    let before = links.iter().find(|l| l.upper == node);
    before.map_or_else(Vector2::zeros, |l| nodes[node].contour.centroid() - nodes[l.lower].contour.centroid())
}

fn moved_on(contour: &Contour, by: Vector2) -> Contour {
    Contour::new(contour.points.iter().map(|p| p + by).collect())
}

/// Drops the weakest links between nodes that both have others, until only stars are left.
fn reduce_to_stars(
    nodes: &[Node],
    z_mm: f64,
    interval: usize,
    links: &mut Vec<Link>,
    warnings: &mut Vec<Warning>,
) {
    loop {
        let here = |l: &&Link| nodes[l.lower].plane == interval;
        let degree_lower = |n: usize| links.iter().filter(here).filter(|l| l.lower == n).count();
        let degree_upper = |n: usize| links.iter().filter(here).filter(|l| l.upper == n).count();
        let weakest = links
            .iter()
            .enumerate()
            .filter(|(_, l)| here(l) && degree_lower(l.lower) > 1 && degree_upper(l.upper) > 1)
            .min_by(|a, b| a.1.overlap.total_cmp(&b.1.overlap))
            .map(|(i, _)| i);
        let Some(i) = weakest else { return };
        let link = links.remove(i);
        warnings.push(warning(
            "topology.link_dropped",
            format!(
                "planes {interval} and {} (z {z_mm:.3} mm): several contours meet several others; the link with the least overlap ({:.0} %) was dropped",
                interval + 1,
                100.0 * link.overlap
            ),
        ));
    }
}

fn stars(nodes: &[Node], links: &[Link]) -> Vec<Star> {
    let mut stars: Vec<Star> = Vec::new();
    for link in links {
        let interval = nodes[link.lower].plane;
        let joins = |s: &&mut Star| {
            s.interval == interval && (s.lower.contains(&link.lower) || s.upper.contains(&link.upper))
        };
        if let Some(star) = stars.iter_mut().find(joins) {
            if !star.lower.contains(&link.lower) {
                star.lower.push(link.lower);
            }
            if !star.upper.contains(&link.upper) {
                star.upper.push(link.upper);
            }
        } else {
            stars.push(Star { interval, lower: vec![link.lower], upper: vec![link.upper] });
        }
    }
    stars
}

/// Drops contours that are linked to nothing, and says so.
fn without_islands(graph: Graph) -> Graph {
    let linked = |i: usize| graph.stars.iter().any(|s| s.lower.contains(&i) || s.upper.contains(&i));
    let kept: Vec<usize> = (0..graph.nodes.len()).filter(|&i| linked(i)).collect();
    let mut warnings = graph.warnings.clone();
    for (_, node) in graph.nodes.iter().enumerate().filter(|(i, _)| !linked(*i)) {
        let area = node.contour.signed_area_mm2();
        warnings.push(warning(
            "topology.island_dropped",
            format!("plane {} (z {:.3} mm): a contour of {area:.2} mm2 continues on no other plane and was left out", node.plane, graph.z_mm[node.plane]),
        ));
    }
    let renumbered = |old: &[usize]| old.iter().filter_map(|o| kept.binary_search(o).ok()).collect();
    let stars = graph
        .stars
        .iter()
        .map(|s| Star { interval: s.interval, lower: renumbered(&s.lower), upper: renumbered(&s.upper) })
        .collect();
    let nodes = kept.iter().map(|&i| graph.nodes[i].clone()).collect();
    Graph { z_mm: graph.z_mm, nodes, stars, warnings }
}

#[cfg(test)]
mod tests;
