//! The images of a series to a stack of planes: order, geometry, what is wrong with it. Pure.
//!
//! Method: positions are projected on the planes' normal and sorted (DICOM PS3.3 C.7.6.2.1.1; instance numbers and slice
//! locations are not trusted). Planes nearer than [`SAME_PLACE_MM`] count as one; a step of more than one and a half of
//! the median step is a gap; positions that move sideways along the stack are a gantry tilt.

use super::series::{Header, Series, Shape};
use super::{Error, Warning, encoding};
use crate::geom::{Point3, RigidTransform, Vector3};

/// Positions nearer than this are the same place: twice what two decimals in a header may be off, mm.
const SAME_PLACE_MM: f64 = 0.01;
/// Axes this near to the patient's are the patient's: over 500 mm that is 0.005 mm.
const ALIGNED: f64 = 1e-5;
/// A step this many times the median means that planes are missing.
const GAP: f64 = 1.5;

/// A series put in order.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stack {
    /// Index of the image of each plane, ascending in z.
    pub(super) images: Vec<usize>,
    /// Images at the place of another: (kept, other), to be compared once decoded.
    pub(super) duplicates: Vec<(usize, usize)>,
    pub(super) plane_z_mm: Vec<f64>,
    /// Stack coordinates of the first pixel after turning over, mm.
    pub(super) origin_xy_mm: [f64; 2],
    pub(super) slab_thickness_mm: f64,
    pub(super) patient_from_stack: RigidTransform,
    /// Whether columns, rows are to be read in reverse.
    pub(super) reversed: [bool; 2],
    pub(super) warnings: Vec<Warning>,
}

/// Puts a series in order and checks its geometry.
///
/// # Errors
/// Where an image does not fit the others, planes are missing (unless `allow_gaps`), fewer than two, sheared or
/// shifted.
pub(super) fn arrange(series: &Series, allow_gaps: bool) -> Result<Stack, Error> {
    refuse_odd(series)?;
    let frame = Frame::of(&series.images[0].shape);
    let places: Vec<Point3> = series.images.iter().map(|h| frame.first_pixel(h)).collect();
    let (images, duplicates) = order(&places, &series.images);
    if images.len() < 2 {
        return Err(Error::TooFewPlanes(images.len()));
    }
    let mut warnings = header_warnings(series);
    if !duplicates.is_empty() {
        let text = format!("{} image(s) occur twice; one of each was used", duplicates.len());
        warnings.push(Warning::new("ct.duplicate_plane", text));
    }
    let planes: Vec<Point3> = images.iter().map(|&i| places[i]).collect();
    let named = |plane: usize| &series.images[images[plane]];
    check_alignment(&planes, frame.pixel_mm(), named, &mut warnings)?;
    let plane_z_mm: Vec<f64> = planes.iter().map(|p| p.z).collect();
    let step_mm = check_steps(&plane_z_mm, allow_gaps, &mut warnings)?;
    check_stated_spacing(series, step_mm, &mut warnings);
    Ok(Stack {
        origin_xy_mm: [planes[0].x, planes[0].y],
        slab_thickness_mm: slab_thickness(series, step_mm, &mut warnings),
        patient_from_stack: frame.patient_from_stack,
        reversed: frame.reversed,
        images,
        duplicates,
        plane_z_mm,
        warnings,
    })
}

fn refuse_odd(series: &Series) -> Result<(), Error> {
    let Some(odd) = series.odd.first() else { return Ok(()) };
    Err(Error::OddImage {
        path: odd.path.clone(),
        found: odd.shape.describe(),
        expected: series.images[0].shape.describe(),
        n_others: series.images.len(),
    })
}

/// Where the stack lies and how its images are turned over.
struct Frame {
    patient_from_stack: RigidTransform,
    stack_from_patient: RigidTransform,
    reversed: [bool; 2],
    shape: Shape,
}

impl Frame {
    fn of(shape: &Shape) -> Self {
        let [row, column] = shape.axes;
        let (patient_from_stack, reversed) = match [along(row, Vector3::x()), along(column, Vector3::y())] {
            [Some(x), Some(y)] => (RigidTransform::identity(), [!x, !y]),
            _ => (RigidTransform::from_axes(Point3::origin(), row, column, row.cross(&column)), [false; 2]),
        };
        let stack_from_patient = patient_from_stack.inverse();
        Self { patient_from_stack, stack_from_patient, reversed, shape: *shape }
    }

    /// Stack coordinates of the pixel that comes first after turning over.
    fn first_pixel(&self, header: &Header) -> Point3 {
        let mut p = self.stack_from_patient.apply(header.position);
        let [dx, dy] = self.shape.spacing_xy_mm;
        if self.reversed[0] {
            p.x -= dx * (self.shape.columns - 1) as f64;
        }
        if self.reversed[1] {
            p.y -= dy * (self.shape.rows - 1) as f64;
        }
        p
    }

    fn pixel_mm(&self) -> f64 {
        self.shape.spacing_xy_mm[0].min(self.shape.spacing_xy_mm[1])
    }
}

/// Whether a direction is that axis (true) or its opposite (false).
fn along(direction: Vector3, axis: Vector3) -> Option<bool> {
    let is = |d: Vector3| (d - axis).abs().max() < ALIGNED;
    if is(direction) {
        Some(true)
    } else if is(-direction) {
        Some(false)
    } else {
        None
    }
}

/// One image per place, ascending, and the others at the same places.
fn order(places: &[Point3], headers: &[Header]) -> (Vec<usize>, Vec<(usize, usize)>) {
    let mut sorted: Vec<usize> = (0..places.len()).collect();
    sorted.sort_by(|&a, &b| {
        places[a].z.total_cmp(&places[b].z).then_with(|| headers[a].path.cmp(&headers[b].path))
    });
    let mut kept: Vec<usize> = Vec::with_capacity(sorted.len());
    let mut duplicates = Vec::new();
    for image in sorted {
        match kept.last() {
            Some(&last) if places[image].z - places[last].z < SAME_PLACE_MM => duplicates.push((last, image)),
            _ => kept.push(image),
        }
    }
    (kept, duplicates)
}

/// Checks that the planes lie over each other.
fn check_alignment<'a>(
    planes: &[Point3],
    pixel_mm: f64,
    named: impl Fn(usize) -> &'a Header,
    warnings: &mut Vec<Warning>,
) -> Result<(), Error> {
    let (first, last) = (planes[0], planes[planes.len() - 1]);
    let sideways = |p: Point3, from: Point3| (p - from).xy().norm();
    let farthest = planes.iter().map(|&p| sideways(p, first)).fold(0.0, f64::max);
    if farthest <= (0.1 * pixel_mm).max(SAME_PLACE_MM) {
        return Ok(());
    }
    if farthest <= 0.5 * pixel_mm {
        let text = format!("planes lie up to {farthest:.3} mm beside each other; this was ignored");
        warnings.push(Warning::new("ct.plane_offset", text));
        return Ok(());
    }
    let lean = (last - first) / (last.z - first.z);
    let from_line = |p: Point3| sideways(p, first + lean * (p.z - first.z));
    if planes.iter().all(|&p| from_line(p) <= 0.5 * pixel_mm) {
        return Err(Error::GantryTilt { angle_deg: lean.xy().norm().atan().to_degrees() });
    }
    let middle = median_point(planes);
    let offsets = planes.iter().map(|&p| sideways(p, middle)).enumerate();
    let (plane, offset_mm) =
        offsets.max_by(|a, b| a.1.total_cmp(&b.1)).expect("there are two planes at least");
    Err(Error::ShiftedPlane { path: named(plane).path.clone(), offset_mm })
}

fn median_point(points: &[Point3]) -> Point3 {
    Point3::from(Vector3::from_fn(|axis, _| median(points.iter().map(|p| p[axis]))))
}

/// The middle value, the upper of the two middle ones of an even number.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

/// Checks the distances between neighbouring planes and returns their median.
fn check_steps(z: &[f64], allow_gaps: bool, warnings: &mut Vec<Warning>) -> Result<f64, Error> {
    let steps: Vec<f64> = z.windows(2).map(|w| w[1] - w[0]).collect();
    let usual = median(steps.iter().copied());
    let gaps: Vec<usize> = (0..steps.len()).filter(|&i| steps[i] > GAP * usual).collect();
    if let Some(&gap) = gaps.first() {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "more than one, saturates"
        )]
        let n_missing = ((steps[gap] / usual).round() as usize - 1).max(1);
        let (below_mm, above_mm, n_gaps) = (z[gap], z[gap + 1], gaps.len());
        if !allow_gaps {
            return Err(Error::MissingPlanes { below_mm, above_mm, n_missing, step_mm: usual, n_gaps });
        }
        let text = format!(
            "{n_gaps} gap(s) in the stack, the first between z = {below_mm:.3} and {above_mm:.3} mm; the shape there is interpolated"
        );
        warnings.push(Warning::new("ct.missing_planes", text));
    }
    // Headers often round positions to a tenth of a millimetre.
    let tolerance = (0.05 * usual).max(0.11);
    let uneven = steps.iter().filter(|&&s| s <= GAP * usual && (s - usual).abs() > tolerance).count();
    if uneven > 0 {
        let text = format!(
            "{uneven} distance(s) between planes differ from the usual {usual:.3} mm; the true ones were used"
        );
        warnings.push(Warning::new("ct.irregular_spacing", text));
    }
    Ok(usual)
}

/// Every second plane missing shows only against the distance that the headers state.
fn check_stated_spacing(series: &Series, step_mm: f64, warnings: &mut Vec<Warning>) {
    let Some(stated) = series.images[0].spacing_between_mm.map(f64::abs) else { return };
    if (stated - step_mm).abs() > 0.1 * step_mm {
        let text = format!(
            "headers state {stated:.3} mm between planes, positions lie {step_mm:.3} mm apart: planes may be missing"
        );
        warnings.push(Warning::new("ct.spacing_disagrees", text));
    }
}

fn slab_thickness(series: &Series, step_mm: f64, warnings: &mut Vec<Warning>) -> f64 {
    let stated: Vec<f64> = series.images.iter().filter_map(|h| h.slab_thickness_mm).collect();
    if stated.is_empty() {
        let text =
            format!("no slice thickness in the headers; the planes' distance, {step_mm:.3} mm, was taken");
        warnings.push(Warning::new("ct.no_thickness", text));
        return step_mm;
    }
    let usual = median(stated.iter().copied());
    if stated.len() < series.images.len() || stated.iter().any(|t| (t - usual).abs() > 0.01 * usual) {
        let text = format!("slice thickness varies or is missing in some images; {usual:.3} mm was taken");
        warnings.push(Warning::new("ct.thickness_varies", text));
    }
    usual
}

fn header_warnings(series: &Series) -> Vec<Warning> {
    let mut warnings = encoding::warnings(&series.images);
    let modality = &series.images[0].modality;
    if modality != "CT" {
        let text = format!("modality is {modality}, not CT: intensities are not Hounsfield units");
        warnings.push(Warning::new("ct.modality", text));
    } else if series.images.iter().any(|h| h.rescale.is_none()) {
        let text = "images without rescale slope and intercept: stored values were taken as HU";
        warnings.push(Warning::new("ct.no_rescale", text));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::super::series::tests::header;
    use super::*;

    fn series(heights: &[f64]) -> Series {
        let images = heights.iter().enumerate().map(|(i, &z)| header(&format!("im{i}"), z)).collect();
        Series { images, odd: Vec::new() }
    }

    fn codes(stack: &Stack) -> Vec<&str> {
        stack.warnings.iter().map(|w| w.code.as_str()).collect()
    }

    #[test]
    fn planes_are_sorted_by_position() {
        let stack = arrange(&series(&[6.0, 0.0, 3.0]), false).unwrap();
        assert_eq!((stack.images, stack.plane_z_mm), (vec![1, 2, 0], vec![0.0, 3.0, 6.0]));
        assert_eq!((stack.origin_xy_mm, stack.slab_thickness_mm), ([-10.0, 20.0], 2.0));
        assert!(stack.patient_from_stack.is_identity() && stack.warnings.is_empty());
    }

    #[test]
    fn a_gap_is_located_and_may_be_allowed() {
        let gapped = series(&[0.0, 3.0, 6.0, 15.0, 18.0, 21.0]);
        let error = arrange(&gapped, false).unwrap_err();
        let Error::MissingPlanes { below_mm, above_mm, n_missing, n_gaps, .. } = error else {
            panic!("{error}")
        };
        assert_eq!((below_mm, above_mm, n_missing, n_gaps), (6.0, 15.0, 2, 1));
        assert_eq!(codes(&arrange(&gapped, true).unwrap()), ["ct.missing_planes"]);
    }

    #[test]
    fn uneven_steps_are_used_with_a_warning() {
        let stack = arrange(&series(&[0.0, 3.0, 6.4, 9.0]), false).unwrap();
        assert_eq!(codes(&stack), ["ct.irregular_spacing"]);
        let rounded_to_tenths = series(&[0.0, 0.6, 1.2, 1.9, 2.5]);
        assert!(arrange(&rounded_to_tenths, false).unwrap().warnings.is_empty());
    }

    #[test]
    fn duplicates_are_set_aside() {
        let stack = arrange(&series(&[0.0, 3.0, 3.0, 6.0]), false).unwrap();
        assert_eq!(
            (stack.images.as_slice(), stack.duplicates.as_slice()),
            ([0, 1, 3].as_slice(), [(1, 2)].as_slice())
        );
        assert_eq!(codes(&stack), ["ct.duplicate_plane"]);
    }

    #[test]
    fn one_plane_is_no_volume() {
        assert!(matches!(arrange(&series(&[1.0]), false), Err(Error::TooFewPlanes(1))));
        assert!(matches!(arrange(&series(&[1.0, 1.0]), false), Err(Error::TooFewPlanes(1))));
    }

    #[test]
    fn an_odd_image_is_named() {
        let mut odd = series(&[0.0, 3.0]);
        odd.odd.push(header("stray", 6.0));
        let text = arrange(&odd, false).unwrap_err().to_string();
        assert!(text.starts_with("stray: 4 x 3 pixels"), "{text}");
    }

    #[test]
    fn gantry_tilt_is_measured() {
        let mut tilted = series(&[0.0, 3.0, 6.0, 9.0]);
        for header in &mut tilted.images {
            header.position.y += header.position.z * 10_f64.to_radians().tan();
        }
        let error = arrange(&tilted, false).unwrap_err();
        assert!(
            matches!(error, Error::GantryTilt { angle_deg } if (angle_deg - 10.0).abs() < 1e-9),
            "{error}"
        );
    }

    #[test]
    fn a_shifted_plane_is_named() {
        let mut shifted = series(&[0.0, 3.0, 6.0, 9.0]);
        shifted.images[1].position.x += 0.2;
        assert_eq!(codes(&arrange(&shifted, false).unwrap()), ["ct.plane_offset"]);
        shifted.images[1].position.x += 4.8;
        let error = arrange(&shifted, false).unwrap_err();
        assert!(
            matches!(&error, Error::ShiftedPlane { path, offset_mm }
            if path.ends_with("im1") && (offset_mm - 5.0).abs() < 1e-9),
            "{error}"
        );
    }

    #[test]
    fn reversed_transaxial_images_are_turned_over() {
        let mut prone = series(&[0.0, 3.0]);
        for header in &mut prone.images {
            header.shape.axes = [-Vector3::x(), -Vector3::y()];
        }
        let stack = arrange(&prone, false).unwrap();
        assert!(stack.patient_from_stack.is_identity());
        assert_eq!((stack.reversed, stack.origin_xy_mm), ([true, true], [-11.5, 18.4]));
    }

    #[test]
    fn an_oblique_stack_keeps_its_place_in_the_patient() {
        let mut oblique = series(&[0.0, 0.0, 0.0]);
        let (row, column) = (Vector3::y(), Vector3::new(0.6, 0.0, -0.8));
        let normal = row.cross(&column);
        for (i, header) in oblique.images.iter_mut().enumerate() {
            header.shape.axes = [row, column];
            header.position = Point3::new(1.0, 2.0, 3.0) - normal * (2.0 * i as f64);
        }
        let stack = arrange(&oblique, false).unwrap();
        assert_eq!(stack.images, [2, 1, 0]);
        let [x, y] = stack.origin_xy_mm;
        let back = stack.patient_from_stack.apply(Point3::new(x, y, stack.plane_z_mm[2]));
        assert!((back - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
    }

    #[test]
    fn doubtful_headers_are_told() {
        let mut doubtful = series(&[0.0, 3.0, 6.0]);
        for header in &mut doubtful.images {
            header.rescale = None;
            header.slab_thickness_mm = None;
            header.spacing_between_mm = Some(1.5);
        }
        let stack = arrange(&doubtful, false).unwrap();
        assert_eq!(codes(&stack), ["ct.no_rescale", "ct.spacing_disagrees", "ct.no_thickness"]);
        assert_eq!(stack.slab_thickness_mm, 3.0);
        doubtful.images[0].modality = "MR".into();
        doubtful.images[0].slab_thickness_mm = Some(2.0);
        let stack = arrange(&doubtful, false).unwrap();
        assert_eq!(codes(&stack), ["ct.modality", "ct.spacing_disagrees", "ct.thickness_varies"]);
    }
}
