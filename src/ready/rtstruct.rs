//! RTSTRUCT contours (PS3.3 A.19) to the regions of one structure, plane by plane.
//!
//! Contours of one plane are combined by the even-odd rule: a contour within another is a hole, and a keyhole contour, which runs to its
//! hole and back along the same line, opens. Planes need not be transaxial: they have the normal of their contours.

use super::dicom::{Place, frame_of_reference, items, numbers, text, whole};
use super::place::SAME_PLANE_MM;
use super::{Absent, Error, Label, Ready, Reference, Structure, chosen};
use crate::ct::quote::without_large_numbers;
use crate::ct::{FrameOfReference, SAME_PLACE_MM, Warning};
use crate::geom::{Bounds2, Contour, Point3, Region, RigidTransform, Vector3};
use crate::progress::{Cancelled, Task};
use crate::sections::ready::{Drawn, DrawnStack};
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, InMemDicomObject};
use std::collections::BTreeMap;

/// A point this far off its contour's plane makes it none, mm.
const FLAT_MM: f64 = 0.1;
/// Contours whose normals differ by more from that of all lie in other planes; those of less than this area (twice, as the area
/// vector counts) have too uncertain normals: only their points tell whether they are flat.
const PARALLEL_DEG: f64 = 1.0;
const LARGE_MM2: f64 = 20.0;
/// A normal this near to the body's axis is that axis.
const TRANSAXIAL_DEG: f64 = 0.02;
/// Planes usually this many times farther apart than what rounding moves are planes of their own.
const FAR_APART: f64 = 10.0;
/// Outlines that lie no farther apart than this are one: what coordinates of one decimal may be off in both directions, mm.
const ROUNDED_MM: f64 = std::f64::consts::SQRT_2 * SAME_PLANE_MM;
/// Contours that overlap by more than this part of what [`ROUNDED_MM`] makes along all of an outline, and leave out as much, cross.
const CROSSING: f64 = 0.25;
/// Heights that a warning names.
const MOST_NAMED: usize = 8;
/// Coordinates beyond this are not believed, and would leave the grid of the boolean operations, mm.
const FARTHEST_MM: f64 = 5000.0;

pub(super) fn ready(
    place: Place<'_>,
    object: &DefaultDicomObject,
    label: Option<&Label>,
    task: &Task<'_>,
) -> Result<Ready, Error> {
    let structures = structures(object);
    let number = chosen(place.0, &structures, label)?.number;
    let own = items(object, tags::ROI_CONTOUR_SEQUENCE)
        .iter()
        .filter(|roi| whole(roi, tags::REFERENCED_ROI_NUMBER) == Some(number))
        .flat_map(|roi| items(roi, tags::CONTOUR_SEQUENCE));
    let (closed, open): (Vec<_>, Vec<_>) = own.partition(|c| is_closed(c));
    let mut polygons = Vec::new();
    for item in closed {
        task.check()?;
        polygons.push(polygon(place, item)?);
    }
    let (frame, pixel_mm) = (frame(place, &polygons)?, typical_step(&polygons));
    let mut warnings: Vec<Warning> = open_contours(&open, &frame).into_iter().collect();
    let planes = planes(place, &polygons, &frame, &mut warnings, task)?;
    let drawn =
        DrawnStack { planes, patient_from_stack: frame, pixel_mm: [pixel_mm; 2], are_outlines: false };
    let reference = Reference::Frame(frame_of(object, number));
    Ok(Ready { number, drawn, warnings, reference, absent: Absent::Undrawn })
}

/// Says what was left out because it encloses nothing.
fn open_contours(open: &[&InMemDicomObject], frame: &RigidTransform) -> Option<Warning> {
    let stack_from_patient = frame.inverse();
    let height = |item: &&InMemDicomObject| match numbers(item, tags::CONTOUR_DATA)?.as_slice() {
        &[x, y, z, ..] => Some(stack_from_patient.apply(Point3::new(x, y, z)).z),
        _ => None,
    };
    let mut z_mm: Vec<f64> = open.iter().filter_map(height).collect();
    z_mm.sort_by(f64::total_cmp);
    let text = format!(
        "{} contour(s) of the structure are open, or points, and were left out{}: close them where the structure was drawn",
        open.len(),
        at_heights(&z_mm)
    );
    (!open.is_empty()).then(|| Warning::new("ready.open_contours", text))
}

/// Heights for a warning; of many the first ones.
fn at_heights(z_mm: &[f64]) -> String {
    if z_mm.is_empty() {
        return String::new();
    }
    let named: Vec<String> = z_mm.iter().take(MOST_NAMED).map(|z| format!("{z:.3}")).collect();
    let more = if z_mm.len() > MOST_NAMED { ", ..." } else { "" };
    format!(" at z = {}{more} mm", named.join(", "))
}

fn is_closed(contour: &InMemDicomObject) -> bool {
    // CLOSEDPLANAR_XOR is the newer word for closed contours combined by the even-odd rule.
    text(contour, tags::CONTOUR_GEOMETRIC_TYPE)
        .is_some_and(|t| matches!(t.trim(), "CLOSED_PLANAR" | "CLOSEDPLANAR_XOR"))
}

/// The structures that have closed contours.
fn structures(object: &DefaultDicomObject) -> Vec<Structure> {
    let name_of = |number: u32| {
        let all = items(object, tags::STRUCTURE_SET_ROI_SEQUENCE);
        let own = all.iter().find(|s| whole(s, tags::ROI_NUMBER) == Some(number))?;
        text(own, tags::ROI_NAME)
    };
    // Several items may hold the contours of one structure.
    let mut sizes: BTreeMap<u32, usize> = BTreeMap::new();
    for roi in items(object, tags::ROI_CONTOUR_SEQUENCE) {
        if let Some(number) = whole(roi, tags::REFERENCED_ROI_NUMBER) {
            let n_closed = items(roi, tags::CONTOUR_SEQUENCE).iter().filter(|c| is_closed(c)).count();
            *sizes.entry(number).or_default() += n_closed;
        }
    }
    let structure = |(number, size)| Structure { number, name: name_of(number), size, unit: "contours" };
    sizes.into_iter().filter(|(_, size)| *size > 0).map(structure).collect()
}

/// The frame that a structure is drawn in: its own, else the only one of the set, else the object's.
fn frame_of(object: &DefaultDicomObject, number: u32) -> FrameOfReference {
    let own = items(object, tags::STRUCTURE_SET_ROI_SEQUENCE)
        .iter()
        .find(|s| whole(s, tags::ROI_NUMBER) == Some(number))
        .map(|s| frame_of_reference(s, tags::REFERENCED_FRAME_OF_REFERENCE_UID));
    let of_set = match items(object, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE) {
        [only] => Some(frame_of_reference(only, tags::FRAME_OF_REFERENCE_UID)),
        _ => None,
    };
    let stated = [own, of_set].into_iter().flatten().find(FrameOfReference::is_known);
    stated.unwrap_or_else(|| frame_of_reference(object, tags::FRAME_OF_REFERENCE_UID))
}

/// The points of a contour, LPS, mm.
fn polygon(place: Place<'_>, item: &InMemDicomObject) -> Result<Vec<Point3>, Error> {
    let coordinates = numbers(item, tags::CONTOUR_DATA).ok_or_else(|| place.missing("ContourData"))?;
    let stated = whole(item, tags::NUMBER_OF_CONTOUR_POINTS);
    let n = coordinates.len() / 3;
    if coordinates.len() % 3 != 0 || stated.is_some_and(|s| s as usize != n) {
        let what = format!(
            "a contour has {} coordinates, expected three for each of its {} points: export the structure again",
            coordinates.len(),
            stated.map_or_else(|| n.to_string(), |s| without_large_numbers(&s.to_string()))
        );
        return Err(place.fault(what));
    }
    if n < 3 {
        return Err(place.fault(format!(
            "a closed contour has {n} points, expected three at least: export the structure again"
        )));
    }
    if let Some(far) = coordinates.iter().find(|c| c.abs() > FARTHEST_MM) {
        let what = format!(
            "a contour has the coordinate {far} mm, expected up to {FARTHEST_MM} mm: export the structure again"
        );
        return Err(place.fault(without_large_numbers(&what)));
    }
    Ok(coordinates.chunks_exact(3).map(|c| Point3::new(c[0], c[1], c[2])).collect())
}

/// Twice the area vector of a polygon (Newell): its direction is the normal.
fn area_vector(polygon: &[Point3]) -> Vector3 {
    let n = polygon.len();
    (0..n).map(|i| (polygon[i] - polygon[0]).cross(&(polygon[(i + 1) % n] - polygon[0]))).sum()
}

/// The frame whose z is the normal of all contours.
fn frame(place: Place<'_>, polygons: &[Vec<Point3>]) -> Result<RigidTransform, Error> {
    let vectors: Vec<Vector3> = polygons.iter().map(|p| area_vector(p)).collect();
    let largest = vectors.iter().max_by(|a, b| a.norm().total_cmp(&b.norm())).copied().unwrap_or_default();
    // All contours together know the normal best, whichever way each of them runs.
    let sum: Vector3 = vectors.iter().map(|v| v * if v.dot(&largest) < 0.0 { -1.0 } else { 1.0 }).sum();
    let normal = sum.try_normalize(1e-9);
    let normal =
        normal.ok_or_else(|| place.fault("its contours enclose nothing: export the structure again"))?;
    let off = vectors
        .iter()
        .filter(|v| v.norm() > LARGE_MM2)
        .map(|v| inclination_deg(v, &largest))
        .fold(0.0, f64::max);
    if off > PARALLEL_DEG {
        return Err(place.fault(format!("its contours lie in planes inclined by {off:.2} degrees against each other: draw them on one stack of planes")));
    }
    if normal.xy().norm() < TRANSAXIAL_DEG.to_radians() {
        return Ok(RigidTransform::identity());
    }
    let upward = normal * normal[normal.iamax()].signum();
    let row =
        [Vector3::x(), Vector3::y()].into_iter().find(|a| a.dot(&upward).abs() < 0.9).unwrap_or_default();
    let row = (row - upward * row.dot(&upward)).normalize();
    Ok(RigidTransform::from_axes(Point3::origin(), row, upward.cross(&row), upward))
}

fn inclination_deg(a: &Vector3, b: &Vector3) -> f64 {
    a.cross(b).norm().atan2(a.dot(b).abs()).to_degrees()
}

/// The usual distance of neighbouring points, mm.
fn typical_step(polygons: &[Vec<Point3>]) -> f64 {
    let mut steps: Vec<f64> =
        polygons.iter().flat_map(|p| p.windows(2).map(|w| (w[1] - w[0]).norm())).collect();
    let middle = steps.len() / 2;
    let step = if steps.is_empty() { 0.5 } else { *steps.select_nth_unstable_by(middle, f64::total_cmp).1 };
    // As fine or as coarse as pixels are: structures smaller than a few of these are noise.
    step.clamp(0.05, 1.0)
}

fn planes(
    place: Place<'_>,
    polygons: &[Vec<Point3>],
    frame: &RigidTransform,
    warnings: &mut Vec<Warning>,
    task: &Task<'_>,
) -> Result<Vec<Drawn>, Error> {
    let stack_from_patient = frame.inverse();
    let mut flat = Vec::with_capacity(polygons.len());
    for polygon in polygons {
        let points: Vec<Point3> = polygon.iter().map(|&p| stack_from_patient.apply(p)).collect();
        let z_mm = points.iter().map(|p| p.z).sum::<f64>() / points.len() as f64;
        let off_mm = points.iter().map(|p| (p.z - z_mm).abs()).fold(0.0, f64::max);
        if off_mm > FLAT_MM {
            return Err(place.fault(format!(
                "a contour near z = {z_mm:.3} mm is {off_mm:.3} mm off its plane: export the structure again"
            )));
        }
        flat.push((z_mm, Contour::new(points.iter().map(Point3::xy).collect())));
    }
    flat.sort_by(|a, b| a.0.total_cmp(&b.0));
    let same: Vec<Group> = flat.chunk_by(|a, b| b.0 - a.0 < SAME_PLACE_MM).map(Group::of).collect();
    let mut planes = with_holes(same);
    warnings.extend(odd_pairs(&mut planes, task)?);
    let one =
        |group: Group| Drawn { z_mm: group.z_mm, contours: Region::from_even_odd(&group.contours).contours };
    Ok(planes.into_iter().map(one).collect())
}

/// Leaves contours out that are in a plane already, which would cancel each other, and says where contours cross.
fn odd_pairs(planes: &mut [Group], task: &Task<'_>) -> Result<Vec<Warning>, Cancelled> {
    let (mut n_doubled, mut doubled_mm, mut crossing_mm) = (0, Vec::new(), Vec::new());
    for plane in planes {
        task.check()?;
        let n_dropped = plane.drop_doubled();
        n_doubled += n_dropped;
        doubled_mm.extend((n_dropped > 0).then_some(plane.z_mm));
        crossing_mm.extend(plane.has_crossing().then_some(plane.z_mm));
    }
    let doubled = (n_doubled > 0).then(|| {
        let text = format!(
            "{n_doubled} contour(s) of the structure are stored twice{}: each was taken once",
            at_heights(&doubled_mm)
        );
        Warning::new("ready.doubled_contours", text)
    });
    let crossing = (!crossing_mm.is_empty()).then(|| {
        let text = format!(
            "contours of the structure cross{}: what lies in two of them is outside (even-odd rule); look at the contours before they are used",
            at_heights(&crossing_mm)
        );
        Warning::new("ready.crossing_contours", text)
    });
    Ok(doubled.into_iter().chain(crossing).collect())
}

/// What a contour encloses.
struct Enclosed {
    bounds: Bounds2,
    region: Region,
    area_mm2: f64,
    perimeter_mm: f64,
}

impl Enclosed {
    fn of(contour: &Contour) -> Option<Self> {
        let region = Region::from_even_odd(std::slice::from_ref(contour));
        let (area_mm2, perimeter_mm) = (region.area_mm2(), contour.perimeter_mm());
        Some(Self { bounds: contour.bounds()?, area_mm2, perimeter_mm, region })
    }

    /// What both enclose, mm2.
    fn shared_mm2(&self, other: &Self) -> f64 {
        let meets = self.bounds.meets(other.bounds);
        if meets { self.region.intersection(&other.region).area_mm2() } else { 0.0 }
    }

    /// Whether both are the same but for rounding, wherever they begin and whichever way they run: what one of them alone encloses
    /// is no wider than that on the whole.
    fn is_alike(&self, other: &Self) -> bool {
        let most_mm2 = ROUNDED_MM * self.perimeter_mm.max(other.perimeter_mm);
        if (self.area_mm2 - other.area_mm2).abs() > most_mm2 {
            return false;
        }
        let shared_mm2 = self.shared_mm2(other);
        // What is no larger than rounding itself has to lie on the other one.
        shared_mm2 > 0.5 * self.area_mm2.min(other.area_mm2)
            && self.area_mm2 + other.area_mm2 - 2.0 * shared_mm2 <= most_mm2
    }

    /// Whether both overlap in part: neither beside nor within each other.
    fn crosses(&self, other: &Self) -> bool {
        let smaller = if self.area_mm2 < other.area_mm2 { self } else { other };
        let least_mm2 = CROSSING * ROUNDED_MM * smaller.perimeter_mm;
        let shared_mm2 = self.shared_mm2(other);
        shared_mm2 > least_mm2 && smaller.area_mm2 - shared_mm2 > least_mm2
    }
}

/// Contours of one height.
struct Group {
    z_mm: f64,
    contours: Vec<Contour>,
}

impl Group {
    fn of(contours: &[(f64, Contour)]) -> Self {
        Self { z_mm: contours[0].0, contours: contours.iter().map(|(_, c)| c.clone()).collect() }
    }

    /// Leaves out what is the same as an earlier contour, whichever way it runs; how many were.
    fn drop_doubled(&mut self) -> usize {
        let n = self.contours.len();
        let mut kept: Vec<Enclosed> = Vec::with_capacity(n);
        self.contours.retain(|contour| {
            let Some(own) = Enclosed::of(contour) else { return true };
            let is_new = !kept.iter().any(|other| other.is_alike(&own));
            kept.extend(is_new.then_some(own));
            is_new
        });
        n - self.contours.len()
    }

    fn has_crossing(&self) -> bool {
        let all: Vec<Enclosed> = self.contours.iter().filter_map(Enclosed::of).collect();
        let mut pairs = (0..all.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
        pairs.any(|(a, b)| all[a].crosses(&all[b]))
    }

    /// Whether each of these contours is one of the other group's once more.
    fn is_copied_from(&self, other: &Self) -> bool {
        let others: Vec<Enclosed> = other.contours.iter().filter_map(Enclosed::of).collect();
        let is_copy = |own: Enclosed| others.iter().any(|o| o.is_alike(&own));
        self.contours.iter().all(|c| Enclosed::of(c).is_some_and(is_copy))
    }

    /// Whether all of these contours are holes in those of the other one: each lies wholly inside one of them, and none meets any.
    fn is_within(&self, outer: &Self) -> bool {
        let inside = |c: &Contour, o: &Contour| c.points.iter().filter(|&&p| o.contains(p)).count();
        let is_hole = |c: &Contour| {
            let n_inside: Vec<usize> = outer.contours.iter().map(|o| inside(c, o)).collect();
            let is_clear = n_inside.iter().all(|&n| n == 0 || n == c.len())
                && outer.contours.iter().all(|o| inside(o, c) == 0);
            is_clear && n_inside.contains(&c.len())
        };
        self.contours.iter().all(is_hole)
    }
}

/// Takes holes, and copies, that rounding has moved off their outlines' plane back into it. Where planes lie that near each other
/// anyway, or contours are neither, nothing is moved.
fn with_holes(groups: Vec<Group>) -> Vec<Group> {
    let apart = groups.windows(2).map(|g| g[1].z_mm - g[0].z_mm);
    let mut steps: Vec<f64> = apart.filter(|&step| step > SAME_PLANE_MM).collect();
    steps.sort_by(f64::total_cmp);
    if steps.get(steps.len() / 2).is_none_or(|&usual| usual < FAR_APART * SAME_PLANE_MM) {
        return groups;
    }
    let mut planes: Vec<Group> = Vec::new();
    for group in groups {
        let near = planes.last_mut().filter(|last| group.z_mm - last.z_mm <= SAME_PLANE_MM);
        match near {
            Some(last) if group.is_within(last) || group.is_copied_from(last) => {
                last.contours.extend(group.contours);
            }
            // The outline's height counts.
            Some(last) if last.is_within(&group) => {
                last.z_mm = group.z_mm;
                last.contours.extend(group.contours);
            }
            _ => planes.push(group),
        }
    }
    planes
}
