//! What the operator has corrected, as data in `case.toml`.
//!
//! ```toml
//! [[segment.block]]      # nothing in this box (two corners, LPS) is lumen
//! box_mm = [[-30.0, -180.0, 760.0], [-10.0, -160.0, 775.0]]
//!
//! [[segment.block]]      # nothing on the side of the point that the normal points to (LPS)
//! point_mm = [-25.0, -170.0, 768.0]
//! normal = [1.0, 0.0, 0.0]
//!
//! [[segment.block]]      # nothing in these planes (heights along the stack's normal)
//! z_mm = [790.0, 800.0]
//!
//! [[segment.window]]     # other intensities in these planes; of several the last one counts
//! z_mm = [751.0, 757.0]
//! window_hu = [200.0, 700.0]
//!
//! [[segment.contour]]    # the contour of this plane is this polygon; several a plane, holes clockwise
//! z_mm = 760.2
//! points_mm = [[12.0, -175.0], [18.0, -175.0], [18.0, -169.0], [12.0, -169.0]]
//! ```
//!
//! A polygon may be given in LPS instead: `points_lps_mm`, three numbers a point, all on one plane. [`Corrections`]
//! is the document, [`Corrections::resolve`] turns it into voxels of a volume.

pub(super) mod doubts;

use super::Mask;
use super::error::Error;
use crate::ct::{HEIGHT_SLACK_MM, Volume};
use crate::geom::{Bounds2, Contour, Point2, Point3, Region, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;

/// A drawn contour has at least as many points as one that is found.
const LEAST_POINTS: usize = 128;

/// Everything the operator has corrected.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Corrections {
    /// Where no lumen is.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub block: Vec<Block>,
    /// Intensities of single planes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub window: Vec<PlaneWindow>,
    /// Contours drawn by hand.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub contour: Vec<Drawn>,
}

/// A part of space without lumen: a box, planes, or a half-space; exactly one of them.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Two opposite corners of a box, LPS, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub box_mm: Option<[[f64; 3]; 2]>,
    /// Heights along the stack's normal, mm, both included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z_mm: Option<[f64; 2]>,
    /// A point on a half-space's plane, LPS, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_mm: Option<[f64; 3]>,
    /// Points into the half-space, LPS, of any length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normal: Option<[f64; 3]>,
}

/// Intensities of the lumen in some planes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaneWindow {
    /// Heights along the stack's normal, mm, both included.
    pub z_mm: [f64; 2],
    /// Lowest and highest intensity, HU.
    pub window_hu: [f64; 2],
}

/// A polygon that stands for the contour of a plane.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drawn {
    /// Height of the plane along the stack's normal, mm; with `points_mm` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub z_mm: Option<f64>,
    /// Corners in the stack frame, mm: counter-clockwise seen from +z, a hole clockwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points_mm: Option<Vec<[f64; 2]>>,
    /// Corners in the patient frame (LPS), mm, all on one plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub points_lps_mm: Option<Vec<[f64; 3]>>,
}

/// A correction that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: found {found}, expected {expected}")]
pub struct Fault {
    /// The key in `case.toml`; entries are counted from 1.
    pub key: String,
    /// What was written.
    pub found: String,
    /// What would be right.
    pub expected: String,
}

fn fault(key: String, found: impl Into<String>, expected: &str) -> Fault {
    Fault { key, found: found.into(), expected: expected.to_owned() }
}

fn are_finite<'a>(numbers: impl IntoIterator<Item = &'a f64>) -> bool {
    numbers.into_iter().all(|n| n.is_finite())
}

const HEIGHTS: &str = "two finite heights in mm, the first not above the second";

impl Corrections {
    /// Whether nothing was corrected.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.block.is_empty() && self.window.is_empty() && self.contour.is_empty()
    }

    /// Checks all that can be checked without an image.
    ///
    /// # Errors
    /// The first [`Fault`].
    pub fn check(&self) -> Result<(), Fault> {
        let numbered = |key: &str, n: usize| format!("segment.{key}[{}]", n + 1);
        (0..).zip(&self.block).try_for_each(|(n, b)| b.check(&numbered("block", n)))?;
        (0..).zip(&self.window).try_for_each(|(n, w)| w.check(&numbered("window", n)))?;
        (0..).zip(&self.contour).try_for_each(|(n, c)| c.check(&numbered("contour", n)))
    }
}

impl Block {
    fn check(&self, key: &str) -> Result<(), Fault> {
        const ONE: &str = "exactly one of box_mm, z_mm, or point_mm with normal";
        let half_space = (self.point_mm.is_some(), self.normal.is_some());
        let n = usize::from(self.box_mm.is_some()) + usize::from(self.z_mm.is_some());
        match (n, half_space) {
            (1, (false, false)) | (0, (true, true)) => {}
            (0, (true, false)) => return Err(fault(key.into(), "point_mm without normal", ONE)),
            (0, (false, true)) => return Err(fault(key.into(), "normal without point_mm", ONE)),
            (0, _) => return Err(fault(key.into(), "none of them", ONE)),
            _ => return Err(fault(key.into(), "several of them", ONE)),
        }
        if let Some(corners) = self.box_mm.filter(|b| !are_finite(b.iter().flatten())) {
            return Err(fault(
                format!("{key}.box_mm"),
                format!("{corners:?}"),
                "two corners, finite, LPS, mm",
            ));
        }
        if let Some([a, b]) = self.z_mm.filter(|z| !(are_finite(z) && z[0] <= z[1])) {
            return Err(fault(format!("{key}.z_mm"), format!("{a},{b}"), HEIGHTS));
        }
        if let Some(p) = self.point_mm.filter(|p| !are_finite(p)) {
            return Err(fault(format!("{key}.point_mm"), format!("{p:?}"), "three finite numbers, LPS, mm"));
        }
        let is_direction = |v: &[f64; 3]| are_finite(v) && v.iter().any(|c| c.abs() > 1e-9);
        match self.normal.filter(|v| !is_direction(v)) {
            Some(v) => Err(fault(
                format!("{key}.normal"),
                format!("{v:?}"),
                "a direction: three finite numbers, not all 0",
            )),
            None => Ok(()),
        }
    }

    /// Whether a voxel at this place is blocked; a height in the stack frame, a point in LPS.
    fn holds(&self, z_mm: f64, p: Point3) -> bool {
        if let Some([lo, hi]) = self.z_mm {
            return z_mm >= lo - HEIGHT_SLACK_MM && z_mm <= hi + HEIGHT_SLACK_MM;
        }
        if let Some([a, b]) = self.box_mm {
            return (0..3).all(|d| p[d] >= a[d].min(b[d]) && p[d] <= a[d].max(b[d]));
        }
        let (Some(point), Some(normal)) = (self.point_mm, self.normal) else { return false };
        (p - Point3::from(point)).dot(&Vector3::from(normal)) > 0.0
    }
}

impl PlaneWindow {
    fn check(&self, key: &str) -> Result<(), Fault> {
        let [a, b] = self.z_mm;
        if !(are_finite(&self.z_mm) && a <= b) {
            return Err(fault(format!("{key}.z_mm"), format!("{a},{b}"), HEIGHTS));
        }
        let [lo, hi] = self.window_hu;
        if are_finite(&self.window_hu) && lo < hi {
            return Ok(());
        }
        Err(fault(
            format!("{key}.window_hu"),
            format!("{lo},{hi}"),
            "two finite numbers in HU, the first less than the second",
        ))
    }
}

impl Drawn {
    fn check(&self, key: &str) -> Result<(), Fault> {
        const ONE: &str = "z_mm with points_mm (stack), or points_lps_mm alone";
        match (self.z_mm, &self.points_mm, &self.points_lps_mm) {
            (Some(z), Some(points), None) => {
                if !z.is_finite() {
                    return Err(fault(format!("{key}.z_mm"), z.to_string(), "a finite height in mm"));
                }
                check_points(&format!("{key}.points_mm"), points)
            }
            (None, None, Some(points)) => check_points(&format!("{key}.points_lps_mm"), points),
            (None, Some(_), None) => Err(fault(key.into(), "points_mm without z_mm", ONE)),
            (_, None, None) => Err(fault(key.into(), "no points", ONE)),
            _ => Err(fault(key.into(), "z_mm or points_mm beside points_lps_mm", ONE)),
        }
    }

    /// Corners in the stack frame.
    fn in_stack(&self, volume: &Volume) -> Vec<Point3> {
        if let (Some(z), Some(points)) = (self.z_mm, &self.points_mm) {
            return points.iter().map(|&[x, y]| Point3::new(x, y, z)).collect();
        }
        let stack_from_patient = volume.patient_from_stack.inverse();
        let points = self.points_lps_mm.iter().flatten();
        points.map(|&p| stack_from_patient.apply(Point3::from(p))).collect()
    }
}

fn check_points<const N: usize>(key: &str, points: &[[f64; N]]) -> Result<(), Fault> {
    if points.len() < 3 {
        return Err(fault(key.into(), format!("{} points", points.len()), "at least 3 corners"));
    }
    match points.iter().find(|p| !are_finite(*p)) {
        Some(p) => Err(fault(key.into(), format!("{p:?}"), "finite numbers, mm")),
        None => Ok(()),
    }
}

/// A plane whose contours were drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnPlane {
    /// Outer contours counter-clockwise, holes clockwise; stack frame, mm.
    pub contours: Vec<Contour>,
    /// The voxels inside.
    pub mask: Mask,
}

impl DrawnPlane {
    /// The voxels inside, row by row: at least one.
    #[must_use]
    pub fn voxels(&self) -> Vec<[usize; 3]> {
        let mask = &self.mask;
        let all =
            mask.planes().flat_map(|k| mask.rows().flat_map(move |j| mask.columns().map(move |i| [i, j, k])));
        all.filter(|&[i, j, k]| mask.contains(i, j, k)).collect()
    }
}

/// The corrections as they apply to one volume.
#[derive(Debug, Clone, Default)]
pub struct Rules {
    blocks: Vec<Block>,
    windows: Vec<(Range<usize>, [f64; 2])>,
    /// By plane.
    pub drawn: BTreeMap<usize, DrawnPlane>,
}

impl Rules {
    /// Whether a voxel may not be lumen.
    #[must_use]
    pub fn blocks(&self, volume: &Volume, voxel: [usize; 3]) -> bool {
        self.block_at(volume, voxel).is_some()
    }

    /// Which block takes a voxel away, counted from 0.
    #[must_use]
    pub fn block_at(&self, volume: &Volume, [i, j, k]: [usize; 3]) -> Option<usize> {
        if self.blocks.is_empty() {
            return None;
        }
        let in_stack = volume.stack_from_voxel(i as f64, j as f64, k);
        let p = volume.patient_from_stack.apply(in_stack);
        self.blocks.iter().position(|b| b.holds(in_stack.z, p))
    }

    /// The window that was given for a plane.
    #[must_use]
    pub fn window_hu(&self, k: usize) -> Option<[f64; 2]> {
        self.windows.iter().rev().find(|(planes, _)| planes.contains(&k)).map(|(_, window)| *window)
    }
}

impl Rules {
    /// These planes, and on to all of those asked for whose contours were drawn: there the operator has seen the vessel.
    #[must_use]
    pub fn reaching(&self, planes: Range<usize>, asked: &Range<usize>) -> Range<usize> {
        let drawn = self.drawn.keys().copied().filter(|k| asked.contains(k));
        drawn.fold(planes, |planes, k| planes.start.min(k)..planes.end.max(k + 1))
    }
}

impl Corrections {
    /// The corrections as voxels and planes of this volume.
    ///
    /// # Errors
    /// [`Error::Correction`]: a polygon that meets no plane, leaves the image, crosses itself or another one, or a
    /// hole in nothing; windows without a plane.
    pub fn resolve(&self, volume: &Volume) -> Result<Rules, Error> {
        self.check()?;
        let mut by_plane: BTreeMap<usize, Vec<(usize, Contour)>> = BTreeMap::new();
        for (n, drawn) in self.contour.iter().enumerate() {
            let key = format!("segment.contour[{}]", n + 1);
            let (k, contour) = on_plane(volume, drawn, &key)?;
            by_plane.entry(k).or_default().push((n, contour));
        }
        let drawn = by_plane.into_iter().map(|(k, contours)| Ok((k, drawn_plane(volume, k, contours)?)));
        let drawn = drawn.collect::<Result<_, Error>>()?;
        let windows = (0..).zip(&self.window).map(|(n, w)| planes_of(volume, n, w));
        Ok(Rules { blocks: self.block.clone(), windows: windows.collect::<Result<_, _>>()?, drawn })
    }
}

fn planes_of(volume: &Volume, n: usize, window: &PlaneWindow) -> Result<(Range<usize>, [f64; 2]), Fault> {
    let planes = volume.planes_between(window.z_mm);
    if !planes.is_empty() {
        return Ok((planes, window.window_hu));
    }
    let [lo, hi] = window.z_mm;
    let expected = format!("heights with a plane between them; {}", reach(volume));
    Err(fault(format!("segment.window[{}].z_mm", n + 1), format!("{lo},{hi}"), &expected))
}

fn reach(volume: &Volume) -> String {
    let z = &volume.plane_z_mm;
    let (first, last) = (z.first().copied().unwrap_or_default(), z.last().copied().unwrap_or_default());
    format!("the planes reach from {first:.3} to {last:.3} mm")
}

/// The plane nearest to a height in the stack frame, mm.
fn nearest_plane(volume: &Volume, z_mm: f64) -> usize {
    let distance = |k: &usize| (volume.plane_z_mm[*k] - z_mm).abs();
    (0..volume.dims[2]).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or_default()
}

/// The plane that a polygon lies on, and the polygon in the stack frame.
fn on_plane(volume: &Volume, drawn: &Drawn, key: &str) -> Result<(usize, Contour), Fault> {
    let points = drawn.in_stack(volume);
    let k = points.first().map_or(0, |p| nearest_plane(volume, p.z));
    let is_off = |p: &&Point3| (volume.plane_z_mm[k] - p.z).abs() > 0.5 * volume.plane_interval_mm(k);
    if let Some(p) = points.iter().find(is_off) {
        let expected = format!("all corners within half an interval of one plane; {}", reach(volume));
        return Err(fault(key.into(), format!("a corner at z {:.3} mm", p.z), &expected));
    }
    let contour = Contour::new(points.iter().map(|p| Point2::new(p.x, p.y)).collect());
    let inner = inner_box(volume);
    match contour.points.iter().find(|p| !inner.contains(**p)) {
        Some(p) => {
            let (a, b) = (inner.min, inner.max);
            let expected =
                format!("corners within x {:.3} to {:.3}, y {:.3} to {:.3} mm (stack)", a.x, b.x, a.y, b.y);
            Err(fault(key.into(), format!("a corner at x {:.3}, y {:.3} mm", p.x, p.y), &expected))
        }
        None => Ok((k, contour)),
    }
}

/// All pixel centres but those at the border, to which no lumen may come.
fn inner_box(volume: &Volume) -> Bounds2 {
    let at = |i: usize, j: usize| {
        let p = volume.stack_from_voxel(i as f64, j as f64, 0);
        Point2::new(p.x, p.y)
    };
    let [nx, ny, _] = volume.dims;
    Bounds2 { min: at(1, 1), max: at(nx.saturating_sub(2), ny.saturating_sub(2)) }
}

fn drawn_plane(volume: &Volume, k: usize, numbered: Vec<(usize, Contour)>) -> Result<DrawnPlane, Fault> {
    let key = |n: usize| format!("segment.contour[{}]", n + 1);
    let first = numbered.first().map_or(0, |(n, _)| *n);
    for (n, contour) in &numbered {
        if !is_simple(std::slice::from_ref(contour)) {
            return Err(fault(key(*n), "a polygon that crosses itself or has no area", "a simple polygon"));
        }
        let is_in = |(_, outer): &&(usize, Contour)| outer.is_ccw() && outer.contains(contour.points[0]);
        if !contour.is_ccw() && !numbered.iter().any(|c| is_in(&c)) {
            let expected = "a hole (clockwise seen from +z) inside an outer contour: reverse the points for an outer one";
            return Err(fault(key(*n), "a hole in nothing", expected));
        }
    }
    let contours: Vec<Contour> = numbered.into_iter().map(|(_, c)| c).collect();
    if !is_simple(&contours) {
        let expected =
            "polygons of a plane that neither cross nor overlap, holes clockwise inside outer ones";
        return Err(fault(key(first), "polygons that cross or overlap", expected));
    }
    let mask = rasterised(volume, k, &contours);
    if mask.n_voxels() == 0 {
        return Err(fault(
            key(first),
            "a polygon without a pixel centre in it",
            "a contour larger than a pixel",
        ));
    }
    Ok(DrawnPlane { contours: contours.iter().map(finely).collect(), mask })
}

/// Whether the contours are just the boundary of their even-odd region.
fn is_simple(contours: &[Contour]) -> bool {
    let region = Region::from_even_odd(contours);
    let area: f64 = contours.iter().map(Contour::signed_area_mm2).sum();
    let length: f64 = contours.iter().map(Contour::perimeter_mm).sum();
    let expected = if contours.len() == 1 { area.abs() } else { area };
    let is_area = expected > 1e-9 && (region.area_mm2() - expected).abs() < 2e-5 * length + 1e-9;
    region.contours.len() == contours.len() && is_area
}

fn rasterised(volume: &Volume, k: usize, contours: &[Contour]) -> Mask {
    let region = Region::from_even_odd(contours);
    let Some(bounds) = region.bounds() else { return Mask::from_fn(0..0, 0..0, 0..0, |_, _, _| false) };
    let [columns, rows] = [0, 1].map(|d| {
        let (o, s, n) = (volume.origin_xy_mm[d], volume.pixel_spacing_xy_mm[d], volume.dims[d]);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the pixels")]
        let index = |at: f64| ((at - o) / s).clamp(0.0, n as f64 - 1.0) as usize;
        index(bounds.min[d])..index(bounds.max[d]) + 1
    });
    Mask::from_fn(columns, rows, k..k + 1, |i, j, k| {
        let p = volume.stack_from_voxel(i as f64, j as f64, k);
        region.contains(Point2::new(p.x, p.y))
    })
}

/// The polygon with points between its corners, from the leftmost corner on.
fn finely(contour: &Contour) -> Contour {
    let step_mm = contour.perimeter_mm() / LEAST_POINTS as f64;
    let points = &contour.points;
    let start = (0..points.len()).min_by(|&a, &b| points[a].x.total_cmp(&points[b].x)).unwrap_or(0);
    let edge = |n: usize| {
        let (a, b) = (points[(start + n) % points.len()], points[(start + n + 1) % points.len()]);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most the point count"
        )]
        let parts = ((b - a).norm() / step_mm).ceil().max(1.0) as usize;
        (0..parts).map(move |m| a + (b - a) * (m as f64 / parts as f64))
    };
    Contour::new((0..points.len()).flat_map(edge).collect())
}
