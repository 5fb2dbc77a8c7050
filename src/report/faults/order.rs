//! Planes in a wrong order, and mirror images.
//!
//! Between stages: where outlines do not fit, those of other planes, and their mirror images, are tried. Against the image:
//! where the grey values show no edge along the contours, the contours of other planes and their mirror images are tried on them,
//! by the contrast across the outline. Along the contours alone: two planes whose exchange (or a stretch whose reversal) makes the
//! vessel's course much shorter were exchanged before the segmentation.

use super::outlines::plane_runs;
use super::{Finding, Kind, Place, Size, told};
use crate::ct::Volume;
use crate::geom::{Contour, Point2, Region, SegmentIndex, Vector2};
use crate::report::Stage;
use crate::report::image::{Plane, Polarity, median};

/// Outlines farther off than this on average do not fit, mm.
const POOR_MM: f64 = 0.15;
/// Those of another plane fit when they are off by less than this part.
const FITS: f64 = 0.35;
/// Places along an outline.
const N_POINTS: usize = 48;
/// A mirrored or reordered contour explains the image when it has this many times the contrast.
const CONTRAST: f64 = 2.5;
/// The course is broken when an exchange shortens it by this, mm, and by this part of what it touches.
const SHORTER_MM: f64 = 0.5;
const SHORTER: f64 = 0.35;
/// It was if the image's planes then differ by less than this part; without an image, if the course is shorter than this part and as
/// even as elsewhere.
const IMAGE_SHORTER: f64 = 0.9;
const COURSE_SHORTER: f64 = 0.5;
/// What is compared of the image around the vessel, mm.
const AROUND_MM: f64 = 5.0;

/// How a plane's outlines compare, by the figures of the report.
#[derive(Debug, Clone, Copy)]
pub(in crate::report) struct Compared<'a> {
    pub(in crate::report) reference: Option<&'a Region>,
    pub(in crate::report) tested: Option<&'a Region>,
}

/// What explains that outlines do not fit.
#[derive(Debug, Clone, PartialEq)]
enum Cause {
    /// Plane by plane (place in the list, place of the outline that fits).
    Order(Vec<(usize, usize)>),
    /// Mirrored in x, or in y.
    Mirror(usize),
}

/// Findings of a pair of stages, plane by plane.
pub(in crate::report) fn out_of_order(
    stage: Stage,
    planes: &[Compared<'_>],
    z_mm: &[f64],
) -> Option<Finding> {
    let indices: Vec<Option<SegmentIndex>> =
        planes.iter().map(|p| SegmentIndex::try_new(&p.reference?.contours)).collect();
    let points: Vec<Vec<Point2>> = planes.iter().map(|p| p.tested.map_or_else(Vec::new, sampled)).collect();
    let off_mm = |k: usize, points: &[Point2]| {
        let index = indices[k].as_ref()?;
        (!points.is_empty())
            .then(|| points.iter().map(|p| index.nearest(*p).distance_mm).sum::<f64>() / points.len() as f64)
    };
    let poor: Vec<(usize, f64)> = (0..planes.len())
        .filter_map(|k| Some((k, off_mm(k, &points[k])?)))
        .filter(|(_, off)| *off > POOR_MM)
        .collect();
    if poor.len() < 2 {
        return None;
    }
    let order: Vec<(usize, usize)> = poor
        .iter()
        .filter_map(|&(k, own)| {
            let others =
                poor.iter().filter(|(j, _)| *j != k).filter_map(|&(j, _)| Some((j, off_mm(k, &points[j])?)));
            let (j, best) = others.min_by(|a, b| a.1.total_cmp(&b.1))?;
            (best < FITS * own).then_some((k, j))
        })
        .collect();
    let mirrored = (0..2).find(|&axis| {
        let middles = poor.iter().filter_map(|&(k, _)| {
            let (a, b) = (planes[k].reference?.bounds()?, planes[k].tested?.bounds()?);
            Some(0.25 * (a.min[axis] + a.max[axis] + b.min[axis] + b.max[axis]))
        });
        let Some(about) = median(middles) else { return false };
        let fits = poor.iter().filter(|&&(k, own)| {
            let turned: Vec<Point2> = points[k].iter().map(|p| mirror(*p, axis, about)).collect();
            off_mm(k, &turned).is_some_and(|off| off < FITS * own)
        });
        10 * fits.count() >= 8 * poor.len()
    });
    let bad: Vec<usize> = poor.iter().map(|p| p.0).collect();
    let cause = match mirrored {
        Some(axis) if 10 * order.len() < 8 * poor.len() => Cause::Mirror(axis),
        _ if order.len() >= 2 && 2 * order.len() >= poor.len() => Cause::Order(order),
        _ => return None,
    };
    Some(finding(stage.name(), stage.sides(), &cause, &bad, z_mm))
}

fn sampled(region: &Region) -> Vec<Point2> {
    region.contours.iter().flat_map(|c| c.resampled(N_POINTS).points).collect()
}

fn mirror(mut p: Point2, axis: usize, about: f64) -> Point2 {
    p[axis] = 2.0 * about - p[axis];
    p
}

fn finding(
    stage: &'static str,
    [from, to]: [&str; 2],
    cause: &Cause,
    bad: &[usize],
    z_mm: &[f64],
) -> Finding {
    let (first, last) = (bad.iter().copied().min().unwrap_or(0), bad.iter().copied().max().unwrap_or(0));
    let place = Place::of_planes(z_mm, first, last);
    let (kind, text, n) = match cause {
        Cause::Mirror(axis) => {
            let text = format!(
                "{to} is a mirror image (in {}) of {from}, {}",
                ["x", "y"][*axis],
                told("plane", [first, last])
            );
            (Kind::Mirrored, text, bad.len())
        }
        Cause::Order(order) => {
            let text =
                format!("wrong order of planes: {to} fits {from} of another plane: {}", order_told(order));
            (Kind::WrongPlaneOrder, text, order.len())
        }
    };
    Finding {
        stage,
        kind,
        place,
        size: Some(Size { size: n as f64, unit: "planes", uncertainty: 0.0 }),
        vector_mm: None,
        beyond_gate: true,
        judged: true,
        text: format!("{stage}: {text}"),
    }
}

fn order_told(order: &[(usize, usize)]) -> String {
    let planes: Vec<usize> = order.iter().map(|o| o.0).collect();
    if let [(a, b), (c, d)] = order
        && a == d
        && b == c
    {
        return format!("planes {a} and {b} are exchanged");
    }
    let sum = order[0].0 + order[0].1;
    if order.iter().all(|(a, b)| a + b == sum) {
        let runs: Vec<String> = plane_runs(&planes).into_iter().map(|run| told("plane", run)).collect();
        return format!("{} are in reverse order", runs.join(", "));
    }
    let shown: Vec<String> = order.iter().take(12).map(|(a, b)| format!("{a} has that of {b}")).collect();
    format!("plane {}{}", shown.join(", "), if order.len() > 12 { ", ..." } else { "" })
}

/// The image and the contours that were made from it.
#[derive(Debug, Clone, Copy)]
pub(in crate::report) struct Seen<'a> {
    pub(in crate::report) volume: &'a Volume,
    pub(in crate::report) polarity: Polarity,
    /// Plane of the volume for every plane of the contours.
    pub(in crate::report) volume_planes: &'a [Option<usize>],
    /// Whether the boundary found in the image fits the contours.
    pub(in crate::report) fits: &'a [bool],
    pub(in crate::report) contours: &'a [&'a [Contour]],
    pub(in crate::report) z_mm: &'a [f64],
}

/// Contours that lie on no edge of their image, but do on that of another plane, or mirrored.
pub(in crate::report) fn unlike_image(seen: &Seen<'_>) -> Option<Finding> {
    let n = seen.z_mm.len();
    let poor: Vec<usize> = (0..n).filter(|&k| seen.volume_planes[k].is_some() && !seen.fits[k]).collect();
    if poor.len() < 2 {
        return None;
    }
    let images: Vec<Option<Plane<'_>>> =
        seen.volume_planes.iter().map(|v| v.map(|v| Plane::new(seen.volume, v))).collect();
    let probes: Vec<Vec<Probe>> = seen.contours.iter().map(|c| probes(c, seen.volume)).collect();
    let sign = if seen.polarity == Polarity::Bright { 1.0 } else { -1.0 };
    let contrast =
        |k: usize, probes: &[Probe]| images[k].as_ref().map_or(0.0, |image| sign * contrast(image, probes));
    let own: Vec<f64> = (0..n).map(|k| contrast(k, &probes[k])).collect();
    let mean_own = poor.iter().map(|&k| own[k]).sum::<f64>() / poor.len() as f64;
    let order = order_in_image(&poor, &own, &probes, &contrast);
    let mean_order =
        poor.iter().map(|k| order.iter().find(|o| o.0 == *k).map_or(own[*k], |o| o.2)).sum::<f64>()
            / poor.len() as f64;
    let mirrored = (0..2).map(|axis| (axis, mirrored_in_image(&poor, axis, seen.volume, &probes, &contrast)));
    let (axis, mean_mirror) = mirrored.max_by(|a, b| a.1.total_cmp(&b.1))?;
    let enough = |mean: f64| mean > 0.0 && mean > CONTRAST * mean_own;
    let sides = Stage::Segmentation.sides();
    let name = Stage::Segmentation.name();
    if enough(mean_mirror) && mean_mirror > 1.1 * mean_order {
        return Some(finding(name, sides, &Cause::Mirror(axis), &poor, seen.z_mm));
    }
    let order: Vec<(usize, usize)> = order.into_iter().map(|(k, j, _)| (k, j)).collect();
    (enough(mean_order) && order.len() >= 2).then(|| {
        finding(
            name,
            sides,
            &Cause::Order(order.clone()),
            &order.iter().map(|o| o.0).collect::<Vec<_>>(),
            seen.z_mm,
        )
    })
}

/// For planes that do not fit: whose contours do, and their contrast.
fn order_in_image(
    poor: &[usize],
    own: &[f64],
    probes: &[Vec<Probe>],
    contrast: &dyn Fn(usize, &[Probe]) -> f64,
) -> Vec<(usize, usize, f64)> {
    let best = |&k: &usize| {
        let others = poor.iter().filter(|j| **j != k).map(|&j| (k, j, contrast(k, &probes[j])));
        others.max_by(|a, b| a.2.total_cmp(&b.2)).filter(|b| b.2 > 1.5 * own[k].max(0.0) && b.2 > 0.0)
    };
    poor.iter().filter_map(best).collect()
}

/// The mean contrast of the contours that are mirrored about the place that suits them best.
fn mirrored_in_image(
    poor: &[usize],
    axis: usize,
    volume: &Volume,
    probes: &[Vec<Probe>],
    contrast: &dyn Fn(usize, &[Probe]) -> f64,
) -> f64 {
    let some: Vec<usize> = poor.iter().copied().step_by(poor.len().div_ceil(8)).collect();
    let mean = |planes: &[usize], about: f64| {
        let of =
            |&k: &usize| contrast(k, &probes[k].iter().map(|p| p.mirrored(axis, about)).collect::<Vec<_>>());
        planes.iter().map(of).sum::<f64>() / planes.len() as f64
    };
    let pixel_mm = volume.pixel_spacing_xy_mm[axis];
    let n_steps = 4 * volume.dims[axis];
    let place = |i: usize| volume.origin_xy_mm[axis] + 0.25 * pixel_mm * i as f64;
    let best = (0..n_steps).map(|i| (place(i), mean(&some, place(i)))).max_by(|a, b| a.1.total_cmp(&b.1));
    best.map_or(0.0, |(about, _)| mean(poor, about))
}

/// A place on a contour and the way across it, as far as the contrast is looked for.
#[derive(Debug, Clone, Copy)]
struct Probe {
    at: Point2,
    across: Vector2,
}

impl Probe {
    fn mirrored(self, axis: usize, about: f64) -> Self {
        let mut across = self.across;
        across[axis] = -across[axis];
        Self { at: mirror(self.at, axis, about), across }
    }
}

fn probes(contours: &[Contour], volume: &Volume) -> Vec<Probe> {
    let reach_mm = volume.pixel_mm().clamp(0.3, 1.0);
    let mut probes = Vec::new();
    for contour in contours {
        let points = contour.resampled(N_POINTS).points;
        let n = points.len();
        for i in 0..n {
            let along = points[(i + 1) % n] - points[(i + n - 1) % n];
            if along.norm() > 0.0 {
                probes.push(Probe {
                    at: points[i],
                    across: Vector2::new(along.y, -along.x) * (reach_mm / along.norm()),
                });
            }
        }
    }
    probes
}

/// Mean difference of the grey values inside and outside.
fn contrast(image: &Plane<'_>, probes: &[Probe]) -> f64 {
    let differences =
        probes.iter().map(|p| image.bilinear(p.at - p.across) - image.bilinear(p.at + p.across));
    let (sum, n) =
        differences.fold((0.0, 0usize), |(s, n), d| if d.is_nan() { (s, n + 1) } else { (s + d, n + 1) });
    if n > 0 { sum / n as f64 } else { 0.0 }
}

/// Planes that seem to have been exchanged before the segmentation: the vessel's course breaks there.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::report) struct BrokenCourse {
    /// What it would be.
    pub(in crate::report) finding: Finding,
    /// Whether it is: the image says so, too, or without an image the course is put right altogether.
    pub(in crate::report) is_sure: bool,
}

/// A stretch of planes that may stand in another order.
#[derive(Debug, Clone, Copy)]
struct Suspect {
    planes: [usize; 2],
    is_swap: bool,
    /// Length of the course as it is and as it would be, mm.
    long_mm: f64,
    short_mm: f64,
}

/// Looks for planes whose exchange, or the reversal of a stretch, makes the course much shorter. Uneven contours and branches that run
/// obliquely break the course, too: `unlike` is how much two planes of the image differ, and what it contradicts is nothing.
pub(in crate::report) fn broken_course(
    regions: &[Region],
    z_mm: &[f64],
    unlike: Option<&dyn Fn(usize, usize) -> f64>,
) -> Option<BrokenCourse> {
    let course: Vec<Course> = regions.iter().map(Course::of).collect();
    let step = |a: usize, b: usize| course[a].step_mm(&course[b]);
    let n = course.len();
    let usual_mm = median((1..n).map(|k| step(k - 1, k)))?;
    let suspect = suspect(n, usual_mm, &step)?;
    let is_sure = match unlike {
        Some(unlike) => {
            let [as_it_is, put_right] = lengths(n, suspect, unlike);
            if put_right >= as_it_is {
                return None;
            }
            put_right < IMAGE_SHORTER * as_it_is
        }
        None => {
            let n_steps = if suspect.is_swap { 4.0 } else { 2.0 };
            suspect.short_mm < COURSE_SHORTER * suspect.long_mm && suspect.short_mm < 2.0 * n_steps * usual_mm
        }
    };
    let [i, j] = suspect.planes;
    let which = if suspect.is_swap {
        format!("planes {i} and {j} seem to be exchanged")
    } else {
        format!("planes {i} to {j} seem to be in reverse order")
    };
    let n_planes = if suspect.is_swap { 2.0 } else { (j + 1 - i) as f64 };
    let finding = Finding {
        stage: "image",
        kind: Kind::WrongPlaneOrder,
        place: Place::of_planes(z_mm, i, j),
        size: Some(Size { size: n_planes, unit: "planes", uncertainty: 0.0 }),
        vector_mm: None,
        beyond_gate: true,
        judged: true,
        text: format!(
            "image: wrong order of planes: {which}: put right, the vessel's course is {:.1} mm shorter there",
            suspect.long_mm - suspect.short_mm
        ),
    };
    Some(BrokenCourse { finding, is_sure })
}

/// The stretch that gains most.
fn suspect(n: usize, usual_mm: f64, step: &dyn Fn(usize, usize) -> f64) -> Option<Suspect> {
    let within = |a: usize, b: usize| if a < n && b < n { step(a, b) } else { 0.0 };
    let mut best: Option<Suspect> = None;
    for i in 0..n {
        for j in i + 1..n {
            if within(i.wrapping_sub(1), i) + within(j, j + 1) < 2.0 * usual_mm {
                continue;
            }
            // At an end of the stack a stretch has one neighbour only, and may be nearer to it the other way round.
            let is_inside = i > 0 && j + 1 < n;
            for is_swap in [false, true] {
                // Of two or three planes an exchange is a reversal.
                let is_short = j <= i + 2;
                if !is_swap && (is_short || !is_inside) {
                    continue;
                }
                let tried = Suspect { planes: [i, j], is_swap, long_mm: 0.0, short_mm: 0.0 };
                let [long_mm, short_mm] = lengths(n, tried, step);
                let gain = long_mm - short_mm;
                if gain > SHORTER_MM
                    && gain > SHORTER * long_mm
                    && best.is_none_or(|b| gain > b.long_mm - b.short_mm)
                {
                    best = Some(Suspect { long_mm, short_mm, ..tried });
                }
            }
        }
    }
    best
}

/// Sum of the steps that an exchange touches, as it is and put right.
fn lengths(n: usize, suspect: Suspect, step: &dyn Fn(usize, usize) -> f64) -> [f64; 2] {
    let step = |a: usize, b: usize| if a < n && b < n { step(a, b) } else { 0.0 };
    let [i, j] = suspect.planes;
    let (before, after) = (i.wrapping_sub(1), j + 1);
    let ends = step(before, i) + step(j, after);
    if suspect.is_swap && j > i + 2 {
        let inner = step(i, i + 1) + step(j - 1, j);
        [ends + inner, step(before, j) + step(j, i + 1) + step(j - 1, i) + step(i, after)]
    } else {
        [ends, step(before, j) + step(i, after)]
    }
}

/// Mean squared difference of two planes of an image around what is segmented in them; noise adds the same to any pair.
pub(in crate::report) fn unlike(
    volume: &Volume,
    volume_planes: &[Option<usize>],
    regions: &[Region],
    [a, b]: [usize; 2],
) -> f64 {
    let (Some(one), Some(other)) = (volume_planes[a], volume_planes[b]) else { return 0.0 };
    let bounds = [a, b].into_iter().filter_map(|k| regions[k].bounds()).reduce(crate::geom::Bounds2::union);
    let Some(bounds) = bounds.map(|b| b.grown(AROUND_MM)) else { return 0.0 };
    let range = |axis: usize| {
        let at = |mm: f64| (mm - volume.origin_xy_mm[axis]) / volume.pixel_spacing_xy_mm[axis];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
        let clamped = |v: f64| v.clamp(0.0, volume.dims[axis] as f64) as usize;
        clamped(at(bounds.min[axis]).floor())..clamped(at(bounds.max[axis]).ceil())
    };
    let (rows, columns) = (range(1), range(0));
    let n = (rows.len() * columns.len()).max(1) as f64;
    let pixels = rows.flat_map(|j| columns.clone().map(move |i| (i, j)));
    pixels.map(|(i, j)| f64::from(volume.at(i, j, one) - volume.at(i, j, other)).powi(2)).sum::<f64>() / n
}

/// Where the vessel is in a plane, and how wide.
#[derive(Debug, Clone, Copy)]
struct Course {
    centroid: Vector2,
    radius_mm: f64,
}

impl Course {
    fn of(region: &Region) -> Self {
        let islands = region.islands();
        let areas: Vec<f64> = islands.iter().map(Region::area_mm2).collect();
        let total: f64 = areas.iter().sum();
        let weighted = |(island, area): (&Region, &f64)| {
            island.contours[0].centroid().coords * (area / total.max(1e-12))
        };
        Self {
            centroid: islands.iter().zip(&areas).map(weighted).sum(),
            radius_mm: (total / std::f64::consts::PI).sqrt(),
        }
    }

    fn step_mm(&self, other: &Self) -> f64 {
        (self.centroid - other.centroid).norm() + (self.radius_mm - other.radius_mm).abs()
    }
}
