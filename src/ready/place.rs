//! Contours in their own stack's frame to the frame of a CT. Pure.
//!
//! Both stacks must be parallel; the contours then keep their planes and are turned and shifted within them. Where both state a frame of
//! reference it has to be the same one. Where a plane of the
//! segmentation is one of the CT's, it takes that one's height exactly.

use super::{Error, Reference};
use crate::ct::{FrameOfReference, LabelMap, Volume, Warning};
use crate::geom::{Contour, Point2, Point3, RigidTransform, Vector3};
use crate::sections::ready::{Drawn, DrawnStack};

/// Normals that differ by less are parallel: over 100 mm that is 0.02 mm.
const PARALLEL_DEG: f64 = 0.01;
/// Planes nearer than this are one: what headers of one decimal may be off, mm.
pub(super) const SAME_PLANE_MM: f64 = 0.051;
/// Code of the warning that nothing says whether segmentation and CT belong together.
const FRAME_UNKNOWN: &str = "segment.frame_unknown";

/// Where the voxels of a stack lie.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    dims: [usize; 3],
    /// Centres of the first voxel, of the ends of its row and its column, and of the last voxel; LPS, mm.
    corners: [Point3; 4],
}

impl Grid {
    /// That of a label map.
    #[must_use]
    pub fn of_labels(map: &LabelMap) -> Self {
        let LabelMap { origin_xy_mm: [x, y], pixel_spacing_xy_mm: [dx, dy], .. } = *map;
        Self::of(map.dims, &map.patient_from_stack, |i, j, k| {
            Point3::new(x + i as f64 * dx, y + j as f64 * dy, map.plane_z_mm[k])
        })
    }

    fn of_volume(ct: &Volume) -> Self {
        Self::of(ct.dims, &ct.patient_from_stack, |i, j, k| ct.stack_from_voxel(i as f64, j as f64, k))
    }

    fn of(
        dims: [usize; 3],
        patient_from_stack: &RigidTransform,
        centre: impl Fn(usize, usize, usize) -> Point3,
    ) -> Self {
        let [i, j, k] = dims.map(|n| n - 1);
        let corners = [[0, 0, 0], [i, 0, 0], [0, j, 0], [i, j, k]];
        Self { dims, corners: corners.map(|[i, j, k]| patient_from_stack.apply(centre(i, j, k))) }
    }

    fn is_like(&self, other: &Self) -> bool {
        let is_near = |(a, b): (&Point3, &Point3)| (a - b).norm() <= SAME_PLANE_MM;
        self.dims == other.dims && self.corners.iter().zip(&other.corners).all(is_near)
    }

    fn describe(&self) -> String {
        let ([nx, ny, nz], at) = (self.dims, self.corners[0]);
        format!("{nx} x {ny} x {nz} voxels from ({:.1}, {:.1}, {:.1}) mm on", at.x, at.y, at.z)
    }
}

/// Checks, as far as both say, that a segmentation was made on a CT.
///
/// # Errors
/// [`Error::OtherFrame`].
pub fn check_reference(
    ct: &Volume,
    ct_frame: &FrameOfReference,
    own: &Reference,
    warnings: &mut Vec<Warning>,
) -> Result<(), Error> {
    match own {
        Reference::Frame(own) => check_frame(ct_frame, own, warnings),
        Reference::Grid(own) => {
            let grid = Grid::of_volume(ct);
            if !own.is_like(&grid) {
                let (own, grid) = (own.describe(), grid.describe());
                let text = format!(
                    "the label map states no frame of reference, and its grid ({own}) is not the CT's ({grid}): check by eye that it was made on this CT"
                );
                warnings.push(Warning::new(FRAME_UNKNOWN, text));
            }
            Ok(())
        }
    }
}

/// Refuses a segmentation that states another frame of reference than the CT; tells where one of them states none.
///
/// # Errors
/// [`Error::OtherFrame`].
pub(super) fn check_frame(
    ct: &FrameOfReference,
    own: &FrameOfReference,
    warnings: &mut Vec<Warning>,
) -> Result<(), Error> {
    let silent = match (ct.is_known(), own.is_known()) {
        (true, true) if ct == own => return Ok(()),
        (true, true) => return Err(Error::OtherFrame),
        (true, false) => "the segmentation",
        (false, true) => "the CT",
        (false, false) => "neither the CT nor the segmentation",
    };
    let does = if ct.is_known() == own.is_known() { "states" } else { "does not state" };
    let text = format!(
        "{silent} {does} its frame of reference: check by eye that the segmentation was made on this CT"
    );
    warnings.push(Warning::new(FRAME_UNKNOWN, text));
    Ok(())
}

/// Brings contours into the frame of the CT.
///
/// # Errors
/// [`Error::Inclined`], [`Error::SamePlane`], [`Error::Elsewhere`]; [`Error::OffPlane`] for drawn contours, whose planes are the CT's or nobody's.
pub fn onto(ct: &Volume, drawn: DrawnStack, warnings: &mut Vec<Warning>) -> Result<DrawnStack, Error> {
    let ct_from_own = ct.patient_from_stack.inverse().after(&drawn.patient_from_stack);
    let normal = ct_from_own.rotate(Vector3::z());
    let angle_deg = normal.xy().norm().atan2(normal.z.abs()).to_degrees();
    if angle_deg > PARALLEL_DEG {
        return Err(Error::Inclined { angle_deg });
    }
    let mut planes: Vec<Drawn> =
        drawn.planes.iter().map(|p| moved(p, &ct_from_own, normal.z < 0.0)).collect();
    planes.sort_by(|a, b| a.z_mm.total_cmp(&b.z_mm));
    let n_off = snapped(ct, &mut planes, drawn.are_outlines)?;
    if n_off > 0 {
        let text = format!(
            "{n_off} plane(s) of the segmentation lie between the CT's; they are used as they stand and not compared with the image"
        );
        warnings.push(Warning::new("segment.other_planes", text));
    }
    if let Some(twice) = planes.windows(2).find(|p| p[1].z_mm <= p[0].z_mm) {
        return Err(Error::SamePlane { z_mm: twice[1].z_mm });
    }
    check_overlap(ct, &planes)?;
    Ok(DrawnStack { planes, patient_from_stack: ct.patient_from_stack, ..drawn })
}

fn moved(plane: &Drawn, by: &RigidTransform, is_turned_over: bool) -> Drawn {
    let place = |p: &Point2| by.apply(Point3::new(p.x, p.y, plane.z_mm));
    let contour = |c: &Contour| {
        let moved = Contour::new(c.points.iter().map(|p| place(p).xy()).collect());
        // Seen from the other side, contours run the other way round.
        if is_turned_over { moved.reversed() } else { moved }
    };
    Drawn { z_mm: place(&Point2::origin()).z, contours: plane.contours.iter().map(contour).collect() }
}

/// Gives planes the heights of the CT's that they are; how many are none of them.
fn snapped(ct: &Volume, planes: &mut [Drawn], may_lie_between: bool) -> Result<usize, Error> {
    let mut n_off = 0;
    for plane in planes.iter_mut().filter(|p| !p.contours.is_empty()) {
        let apart = |z: &&f64| (**z - plane.z_mm).abs();
        let nearest = ct.plane_z_mm.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
        let Some(&nearest) = nearest else { continue };
        let off_mm = (nearest - plane.z_mm).abs();
        if off_mm <= SAME_PLANE_MM {
            plane.z_mm = nearest;
        } else if may_lie_between {
            n_off += 1;
        } else {
            return Err(Error::OffPlane { z_mm: plane.z_mm, off_mm });
        }
    }
    Ok(n_off)
}

fn check_overlap(ct: &Volume, planes: &[Drawn]) -> Result<(), Error> {
    let points = planes
        .iter()
        .flat_map(|p| p.contours.iter().flat_map(move |c| c.points.iter().map(move |q| (q, p.z_mm))));
    let mut boxed = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
    for (q, z) in points {
        for (axis, v) in [q.x, q.y, z].into_iter().enumerate() {
            boxed[0][axis] = boxed[0][axis].min(v);
            boxed[1][axis] = boxed[1][axis].max(v);
        }
    }
    let [nx, ny, nz] = ct.dims.map(|n| n - 1);
    let (lo, hi) = (ct.stack_from_voxel(0.0, 0.0, 0), ct.stack_from_voxel(nx as f64, ny as f64, nz));
    // Without a point there is nothing to lie elsewhere.
    if boxed[0][0] > boxed[1][0] {
        return Ok(());
    }
    let axis = |a: usize| boxed[1][a] < lo[a] || boxed[0][a] > hi[a];
    match (0..3).find(|&a| axis(a)) {
        None => Ok(()),
        Some(a) => {
            let name = ["x", "y", "z"][a];
            let what = format!(
                "{name} from {:.1} to {:.1} mm against {:.1} to {:.1} mm",
                boxed[0][a], boxed[1][a], lo[a], hi[a]
            );
            Err(Error::Elsewhere { what })
        }
    }
}
