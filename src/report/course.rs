//! The vessel's course: centrelines, their tortuosity, where branches divide or join and at what angles.
//!
//! The centreline of a branch runs through the centroids of its lumen in the CT planes, by the cubic that has there the slopes of the
//! polynomial through the five nearest of them. Its tortuosity is arc over chord minus one. Directions at a division
//! are those of the straight lines that fit the first [`STRAIGHT_MM`] of each branch best. The place of a division is
//! the height at which the solid's section falls apart, found by bisection, and there the middle between the nearest points
//! of both pieces.

use super::anatomy::{Branches, StageLumina};
use super::deviation::rounded;
use crate::geom::{Contour, Point2, Point3, Region, SegmentIndex, Vector2, Vector3};
use serde::Serialize;

/// Length of a branch that its direction at a division is taken from, mm.
pub const STRAIGHT_MM: f64 = 10.0;
/// The height of a division is known to this, mm.
pub const DIVISION_MM: f64 = 1e-3;
/// Nodes and weights of Gauss's rule on 0..1.
const GAUSS: [(f64, f64); 3] =
    [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];

/// The centreline of a branch. Stack frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Centreline {
    /// Centroids in the CT planes, mm.
    #[serde(serialize_with = "rounded_points")]
    pub points_mm: Vec<[f64; 3]>,
    /// Length along it, mm.
    #[serde(serialize_with = "rounded")]
    pub length_mm: Option<f64>,
    /// Half of what the length changes when every second plane is left out, mm; `null` for fewer than five planes.
    #[serde(serialize_with = "rounded")]
    pub length_uncertainty_mm: Option<f64>,
    /// Distance of its ends, mm.
    #[serde(serialize_with = "rounded")]
    pub chord_mm: Option<f64>,
    /// Length over chord minus one.
    #[serde(serialize_with = "rounded")]
    pub tortuosity: Option<f64>,
    /// Its uncertainty.
    #[serde(serialize_with = "rounded")]
    pub tortuosity_uncertainty: Option<f64>,
}

fn rounded_points<S: serde::Serializer>(points: &[[f64; 3]], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(points.iter().map(|p| p.map(|v| (v * 1e6).round() / 1e6)))
}

/// Where one lumen becomes several, or several one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Division {
    /// `division`, or `junction`, where branches come together upward.
    pub kind: &'static str,
    /// The single branch.
    pub trunk: String,
    /// The several ones.
    pub branches: Vec<String>,
    /// The CT planes between which it lies.
    pub planes: [usize; 2],
    /// Where the section of the solid falls apart, stack frame, mm; `null` where it does not between these planes.
    pub at_mm: Option<[f64; 3]>,
    /// Uncertainty of its height, mm.
    pub uncertainty_mm: f64,
    /// Angles, one entry a stage.
    pub angles: Vec<Angles>,
}

/// The angles of a division as one stage has it, degrees.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Angles {
    /// The stage.
    pub stage: &'static str,
    /// Largest angle between two of the branches.
    #[serde(serialize_with = "rounded")]
    pub between_deg: Option<f64>,
    /// By how much each branch turns off the trunk.
    pub from_trunk_deg: Vec<Option<f64>>,
    /// Uncertainty of each angle: what the centroids scatter about the straight lines, and how well they are known.
    #[serde(serialize_with = "rounded")]
    pub uncertainty_deg: Option<f64>,
    /// Scatter of the directions about their lines, and how much a centroid that is off turns them.
    #[serde(skip)]
    pub(super) directions: Vec<Leverage>,
}

/// How sure the direction of a fitted line is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Leverage {
    /// By the scatter of its points about it, rad.
    pub(super) scatter: f64,
    /// For each mm that a single point is uncertain, rad.
    pub(super) per_mm: f64,
}

/// Area centroid of a region, holes taken off; `None` without area.
pub(super) fn centroid(region: &Region) -> Option<Point2> {
    let area = |c: &Contour| c.signed_area_mm2();
    let total: f64 = region.contours.iter().map(area).sum();
    let moment: Vector2 = region.contours.iter().map(|c| c.centroid().coords * area(c)).sum();
    (total > 0.0).then(|| Point2::from(moment / total))
}

/// The centreline through centroids, ascending in z.
pub(super) fn centreline(points: Vec<Point3>) -> Centreline {
    let last = points.len().saturating_sub(1);
    let every_second = || -> Vec<Point3> {
        points.iter().enumerate().filter(|(i, _)| i % 2 == 0 || *i == last).map(|(_, p)| *p).collect()
    };
    let coarse_mm = (points.len() > 4).then(every_second).and_then(|points| length_mm(&points));
    let length_mm = length_mm(&points);
    let chord_mm = points.first().zip(points.last()).map(|(a, b)| (b - a).norm()).filter(|c| *c > 0.0);
    Centreline {
        length_uncertainty_mm: length_mm.zip(coarse_mm).map(|(l, c)| 0.5 * (l - c).abs()),
        tortuosity: length_mm.zip(chord_mm).map(|(l, c)| (l / c - 1.0).max(0.0)),
        length_mm,
        chord_mm,
        tortuosity_uncertainty: None,
        points_mm: points.into_iter().map(|p| [p.x, p.y, p.z]).collect(),
    }
}

fn length_mm(points: &[Point3]) -> Option<f64> {
    let z: Vec<f64> = points.iter().map(|p| p.z).collect();
    let [x, y] = [0, 1].map(|axis| slopes(&z, &points.iter().map(|p| p[axis]).collect::<Vec<_>>()));
    let piece = |i: usize| {
        let h = z[i + 1] - z[i];
        let slope = |axis: usize, d: &[f64], t: f64| {
            let rise = (points[i + 1][axis] - points[i][axis]) / h;
            6.0 * t * (1.0 - t) * rise + (1.0 - t) * (1.0 - 3.0 * t) * d[i] + t * (3.0 * t - 2.0) * d[i + 1]
        };
        let speed = |t: f64| (1.0 + slope(0, &x, t).powi(2) + slope(1, &y, t).powi(2)).sqrt();
        h * GAUSS.iter().map(|(t, w)| w * speed(*t)).sum::<f64>()
    };
    (points.len() > 1).then(|| (0..points.len() - 1).map(piece).sum())
}

/// Slopes at the nodes, of the polynomials through the five nearest nodes (fewer where there are not so many).
pub(super) fn slopes(at: &[f64], values: &[f64]) -> Vec<f64> {
    let n = at.len();
    let slope = |i: usize| {
        let first = i.saturating_sub(2).min(n.saturating_sub(5));
        let nodes = first..(first + 5).min(n);
        nodes.clone().map(|j| values[j] * lagrange_slope(at, nodes.clone(), i, j)).sum()
    };
    (0..n).map(slope).collect()
}

/// Slope at node i of the polynomial that is 1 at node j and 0 at the other nodes.
fn lagrange_slope(at: &[f64], nodes: std::ops::Range<usize>, i: usize, j: usize) -> f64 {
    if i == j {
        return nodes.filter(|&m| m != i).map(|m| 1.0 / (at[i] - at[m])).sum();
    }
    let others = nodes.filter(|&m| m != i && m != j);
    others.map(|m| (at[i] - at[m]) / (at[j] - at[m])).product::<f64>() / (at[j] - at[i])
}

/// All divisions and junctions; `section` is the lumen of the solid at a height.
pub(super) fn divisions(
    branches: &Branches,
    stages: &[StageLumina],
    section: &dyn Fn(f64) -> Region,
) -> Vec<Division> {
    let place = |meeting: &Meeting| {
        let [below, above] = meeting.planes.map(|k| branches.z_mm()[k]);
        let several = if meeting.is_junction { below } else { above };
        let single = if meeting.is_junction { above } else { below };
        parted(section, single, several, &branches.area_at(meeting))
    };
    let names = branches.names();
    let division = |meeting: Meeting| Division {
        kind: if meeting.is_junction { "junction" } else { "division" },
        trunk: names[meeting.trunk].clone(),
        branches: meeting.branches.iter().map(|&b| names[b].clone()).collect(),
        planes: meeting.planes,
        at_mm: place(&meeting),
        uncertainty_mm: DIVISION_MM,
        angles: stages.iter().map(|stage| angles(branches, stage, &meeting)).collect(),
    };
    branches.meetings().into_iter().map(division).collect()
}

/// A trunk and its branches.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Meeting {
    pub(super) trunk: usize,
    pub(super) branches: Vec<usize>,
    pub(super) planes: [usize; 2],
    pub(super) is_junction: bool,
}

/// Where sections between a height with one piece and one with several fall apart: bisection.
fn parted(section: &dyn Fn(f64) -> Region, single: f64, several: f64, near: &Region) -> Option<[f64; 3]> {
    let pieces = |z_mm: f64| -> Vec<Region> {
        let touches = |island: &Region| island.intersection(near).area_mm2() > 0.0;
        section(z_mm).islands().into_iter().filter(touches).collect()
    };
    let (mut one, mut many) = (single, several);
    let (at_one, mut parts) = (pieces(one).len(), pieces(many));
    if parts.len() <= at_one {
        return None;
    }
    while (many - one).abs() > DIVISION_MM {
        let middle = 0.5 * (one + many);
        let own = pieces(middle);
        if own.len() > at_one {
            (many, parts) = (middle, own);
        } else {
            one = middle;
        }
    }
    let middle = nearest_middle(&parts)?;
    Some([middle.x, middle.y, 0.5 * (one + many)])
}

/// The middle between the nearest points of two of the pieces.
fn nearest_middle(pieces: &[Region]) -> Option<Point2> {
    let mut best: Option<(f64, Point2)> = None;
    for (i, piece) in pieces.iter().enumerate() {
        let Some(index) = SegmentIndex::try_new(&piece.contours) else { continue };
        for p in pieces[i + 1..].iter().flat_map(|o| &o.contours).flat_map(|c| &c.points) {
            let foot = index.nearest(*p);
            if best.is_none_or(|(d, _)| foot.distance_mm < d) {
                best = Some((foot.distance_mm, nalgebra::center(p, &foot.point)));
            }
        }
    }
    best.map(|b| b.1)
}

fn angles(branches: &Branches, stage: &StageLumina, meeting: &Meeting) -> Angles {
    let away = |b: usize, upward: bool| direction(&branches.centroids(stage, b), upward);
    let trunk = away(meeting.trunk, meeting.is_junction);
    let into = trunk.map(|d| -d.0);
    let lines: Vec<Option<(Vector3, Leverage)>> =
        meeting.branches.iter().map(|&b| away(b, !meeting.is_junction)).collect();
    let outward: Vec<Option<Vector3>> = lines.iter().map(|l| l.map(|l| l.0)).collect();
    let degrees = |a: &Vector3, b: &Vector3| a.angle(b).to_degrees();
    let known: Vec<&Vector3> = outward.iter().flatten().collect();
    let between =
        known.iter().enumerate().flat_map(|(i, a)| known[i + 1..].iter().map(move |b| degrees(a, b)));
    Angles {
        stage: stage.stage,
        uncertainty_deg: None,
        directions: lines.iter().chain([&trunk]).flatten().map(|l| l.1).collect(),
        between_deg: between.reduce(f64::max),
        from_trunk_deg: outward
            .iter()
            .map(|o| o.as_ref().zip(into.as_ref()).map(|(o, i)| (degrees(o, i) * 1e4).round() / 1e4))
            .collect(),
    }
}

/// Unit direction away from the lower (`upward`) or upper end, of the line that fits the first [`STRAIGHT_MM`] best.
fn direction(points: &[Point3], upward: bool) -> Option<(Vector3, Leverage)> {
    let end = if upward { points.first()? } else { points.last()? };
    let own: Vec<&Point3> = points.iter().filter(|p| (p.z - end.z).abs() <= STRAIGHT_MM).collect();
    let n = own.len() as f64;
    let mean = own.iter().map(|p| p.coords).sum::<Vector3>() / n;
    let (zz, zv) = own.iter().fold((0.0, Vector3::zeros()), |(zz, zv), p| {
        let off = p.coords - mean;
        (zz + off.z * off.z, zv + off * off.z)
    });
    let slope = (zz > 0.0).then(|| zv / zz)?;
    let along = slope.normalize();
    let off = |p: &&Point3| (p.coords - mean - slope * (p.z - mean.z)).norm_squared();
    // Two points lie on any line; of what three or more scatter, two coordinates tell.
    let scatter_mm =
        if own.len() > 2 { (own.iter().map(off).sum::<f64>() / (2.0 * (n - 2.0))).sqrt() } else { 0.0 };
    // A vertical spread of `zz` seen along the line.
    let per_mm = 1.0 / (zz.sqrt() * slope.norm());
    let leverage = Leverage { scatter: scatter_mm * per_mm, per_mm };
    Some((if upward { along } else { -along }, leverage))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_helix_has_its_length_and_its_tortuosity() {
        // Radius 6 mm, 60 mm a turn, planes 3 mm apart.
        let per_mm = std::f64::consts::TAU / 60.0;
        let points: Vec<Point3> = (0..=40)
            .map(|k| 3.0 * f64::from(k))
            .map(|z| Point3::new(6.0 * (per_mm * z).cos(), 6.0 * (per_mm * z).sin(), z))
            .collect();
        let line = centreline(points);
        let expected = 120.0 * (1.0 + (6.0 * per_mm).powi(2)).sqrt();
        assert!((line.length_mm.unwrap() - expected).abs() < 2e-3, "{:?} {expected}", line.length_mm);
        assert!((line.tortuosity.unwrap() - (expected / 120.0 - 1.0)).abs() < 2e-5);
    }

    #[test]
    fn slopes_of_a_quartic_are_exact_at_uneven_nodes() {
        let at = [0.0, 1.0, 2.5, 3.0, 5.0, 5.5, 7.0];
        let values = at.map(|x: f64| x.powi(4) - 2.0 * x);
        for (x, slope) in at.iter().zip(slopes(&at, &values)) {
            assert!((slope - (4.0 * x.powi(3) - 2.0)).abs() < 1e-9, "{x}: {slope}");
        }
        assert_eq!(slopes(&[1.0], &[3.0]), [0.0]);
    }

    #[test]
    fn sections_that_fall_apart_are_found_at_their_height_and_place() {
        let disk = |x: f64| Region::new(vec![Contour::circle(Point2::new(x, 1.0), 2.0, 720)]);
        let section = |z_mm: f64| disk(-0.8 * z_mm).union(&disk(0.8 * z_mm));
        // The circles part where their centres are two radii apart: z = 2.5.
        let [x, y, z] = parted(&section, 0.0, 3.0, &disk(0.0)).unwrap();
        assert!((z - 2.5).abs() < 2e-3 && x.abs() < 1e-3 && (y - 1.0).abs() < 0.03, "{x} {y} {z}");
        assert_eq!(parted(&section, 0.0, 2.0, &disk(0.0)), None);
    }
}
