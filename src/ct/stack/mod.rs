//! The images of a series to a stack of planes: order, geometry, what is wrong with it. Pure.
//!
//! Method: positions are projected on the planes' normal and sorted (DICOM PS3.3 C.7.6.2.1.1; instance numbers and slice
//! locations are not trusted). Planes nearer than [`SAME_PLACE_MM`] count as one. Distances between planes are those along the
//! normal ([`steps`]); what planes lie beside each other ([`sideways`]) says how each is moved in its plane, so that all share
//! one grid. A gantry tilt is undone by that: the stack's z runs along the normal, not along the line of the planes.

mod sideways;
mod steps;

use super::axes::{self, along};
use super::encoding;
use super::quote::without_large_numbers;
use super::series::{Header, Series, Shape};
use super::shift::Shift;
use super::slabs;
use super::traits::Origin;
use super::{Error, SAME_PLACE_MM, Warning};
use crate::geom::{Point2, Point3, RigidTransform, Vector2, Vector3};
use sideways::Sideways;
pub(super) use steps::Gaps;
use steps::Slab;
pub(crate) use steps::{Gap, gaps_among};

/// Turns that misplace no pixel by more, as a share of its side, are not told: cosines of four decimals do at 500 pixels.
const TURNED_PIXELS: f64 = 0.1;
/// Longest side of a plane once the planes of a tilted stack are put beside each other.
const LONGEST_SIDE: f64 = 16_384.0;

/// A series put in order.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stack {
    /// Index of the image of each plane, ascending in z.
    pub(super) images: Vec<usize>,
    /// Images at the place of another: (kept, other), to be compared once decoded.
    pub(super) duplicates: Vec<(usize, usize)>,
    pub(super) plane_z_mm: Vec<f64>,
    /// Columns and rows of the common grid.
    pub(super) size: [usize; 2],
    /// Stack coordinates of its first pixel, mm.
    pub(super) origin_xy_mm: [f64; 2],
    /// How each plane gets on that grid; empty where all lie on it.
    pub(super) shifts: Vec<Shift>,
    /// Angle of the gantry against the line of the planes, where there is one.
    pub(super) tilt_deg: Option<f64>,
    pub(super) slab_thickness_mm: f64,
    pub(super) patient_from_stack: RigidTransform,
    /// Whether columns, rows are to be read in reverse.
    pub(super) reversed: [bool; 2],
    pub(super) warnings: Vec<Warning>,
}

/// Puts a series in order and checks its geometry.
///
/// # Errors
/// Where an image does not fit the others, planes are missing (unless `gaps` lets it pass), fewer than two, or one lies beside the
/// others.
pub(super) fn arrange(series: &Series, gaps: impl Into<Gaps>) -> Result<Stack, Error> {
    refuse_odd(series)?;
    let mut warnings = header_warnings(series);
    let mut frame = Frame::of(&series.images[0].shape);
    let (images, duplicates) = order(series, &frame);
    if images.len() < 2 {
        return Err(Error::TooFewPlanes(images.len()));
    }
    warnings.extend(duplicates_warning(&duplicates));
    warnings.extend(order_warning(series, &images));
    warnings.extend(turn_warning(series, &images));
    let mut sideways = judge(series, &images, &frame, &mut warnings)?;
    if let Sideways::Turned { lean, .. } = sideways {
        frame = frame.turned(lean);
        sideways = judge(series, &images, &frame, &mut Vec::new())?;
    }
    let planes = places(series, &images, &frame);
    let slab =
        |(&i, p): (&usize, &Point3)| Slab { z_mm: p.z, thickness_mm: series.images[i].believed_slab_mm() };
    let slabs: Vec<Slab> = images.iter().zip(&planes).map(slab).collect();
    let step_mm = steps::check(&slabs, gaps, &mut warnings)?;
    check_stated_spacing(series, step_mm, &mut warnings);
    let Grid { size, origin, shifts, tilt_deg } = Grid::of(&frame.shape, &sideways, images.len())?;
    warnings.extend(tilt_deg.map(tilt_warning));
    Ok(Stack {
        size,
        origin_xy_mm: [origin.x, origin.y],
        shifts,
        tilt_deg,
        slab_thickness_mm: slab_thickness(series, step_mm, &mut warnings),
        patient_from_stack: frame.patient_from_stack,
        reversed: frame.reversed,
        images,
        duplicates,
        plane_z_mm: planes.iter().map(|p| p.z).collect(),
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

    /// The frame whose z runs along planes that lean by so much against this one.
    fn turned(&self, lean: Vector2) -> Self {
        let normal = self.patient_from_stack.rotate(Vector3::new(lean.x, lean.y, 1.0).normalize());
        let within = |axis: Vector3| axis - normal * axis.dot(&normal);
        let [row, column] = self.shape.axes.map(within);
        // A tenth of a degree at most: far within what can be made orthonormal.
        let axes = axes::orthonormal(row, column).map_or(self.shape.axes, |(axes, _)| axes);
        Self::of(&Shape { axes, ..self.shape })
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

/// One image per place, ascending, and the others at the same places.
fn order(series: &Series, frame: &Frame) -> (Vec<usize>, Vec<(usize, usize)>) {
    let headers = &series.images;
    let z: Vec<f64> = headers.iter().map(|h| frame.first_pixel(h).z).collect();
    let mut sorted: Vec<usize> = (0..z.len()).collect();
    sorted.sort_by(|&a, &b| z[a].total_cmp(&z[b]).then_with(|| headers[a].path.cmp(&headers[b].path)));
    let mut kept: Vec<usize> = Vec::with_capacity(sorted.len());
    let mut duplicates = Vec::new();
    for image in sorted {
        match kept.last() {
            Some(&last) if z[image] - z[last] < SAME_PLACE_MM => duplicates.push((last, image)),
            _ => kept.push(image),
        }
    }
    (kept, duplicates)
}

fn places(series: &Series, images: &[usize], frame: &Frame) -> Vec<Point3> {
    images.iter().map(|&i| frame.first_pixel(&series.images[i])).collect()
}

fn judge(
    series: &Series,
    images: &[usize],
    frame: &Frame,
    warnings: &mut Vec<Warning>,
) -> Result<Sideways, Error> {
    let planes = places(series, images, frame);
    sideways::judge(&planes, frame.pixel_mm(), warnings)?.map_err(|out| Error::ShiftedPlane {
        path: series.images[images[out.plane]].path.clone(),
        offset_mm: out.offset_mm,
    })
}

/// The pixels that all planes share.
struct Grid {
    size: [usize; 2],
    origin: Point2,
    shifts: Vec<Shift>,
    tilt_deg: Option<f64>,
}

impl Grid {
    /// A grid that holds every pixel of every plane.
    fn of(shape: &Shape, sideways: &Sideways, n_planes: usize) -> Result<Self, Error> {
        let size = [shape.columns, shape.rows];
        let (origins, tilt_deg) = match sideways {
            // Turned once already: what is left is rounding.
            Sideways::Straight { origin } | Sideways::Turned { origin, .. } => {
                return Ok(Self { size, origin: *origin, shifts: Vec::new(), tilt_deg: None });
            }
            Sideways::Moved { origins, tilt_deg } => (origins, *tilt_deg),
        };
        let lowest = |axis: usize| origins.iter().map(|o| o[axis]).fold(f64::INFINITY, f64::min);
        let origin = Point2::new(lowest(0), lowest(1));
        let pixels = |o: &Point2, axis: usize| (origin[axis] - o[axis]) / shape.spacing_xy_mm[axis];
        let widened = |axis: usize| -> Result<usize, Error> {
            let most = origins.iter().map(|o| -pixels(o, axis)).fold(0.0, f64::max);
            let side = size[axis] as f64 + (most - 1e-6).ceil();
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "checked to be in range"
            )]
            let whole = (side <= LONGEST_SIDE).then_some(side as usize);
            whole.ok_or(Error::TooLarge { dims: [size[0], size[1], n_planes] })
        };
        let shifts = origins.iter().map(|o| Shift::new([pixels(o, 0), pixels(o, 1)])).collect();
        Ok(Self { size: [widened(0)?, widened(1)?], origin, shifts, tilt_deg })
    }
}

/// The middle value, the lower of the two middle ones of an even number; NaN of none.
pub(super) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len().saturating_sub(1) / 2).copied().unwrap_or(f64::NAN)
}

/// Every second plane missing shows only against the distance that the headers state.
fn check_stated_spacing(series: &Series, step_mm: f64, warnings: &mut Vec<Warning>) {
    let Some(stated) = series.images[0].spacing_between_mm.map(f64::abs) else { return };
    if (stated - step_mm).abs() > 0.1 * step_mm {
        let stated = without_large_numbers(&format!("{stated:.3}"));
        let text = format!(
            "headers state {stated} mm between planes, positions lie {step_mm:.3} mm apart: planes may be missing"
        );
        warnings.push(Warning::new("ct.spacing_disagrees", text));
    }
}

fn slab_thickness(series: &Series, step_mm: f64, warnings: &mut Vec<Warning>) -> f64 {
    let stated: Vec<f64> = series.images.iter().filter_map(Header::believed_slab_mm).collect();
    if series.images.iter().filter_map(|h| h.slab_thickness_mm).any(|t| !slabs::is_believed(t)) {
        warnings.push(slabs::not_believed(step_mm));
        if stated.is_empty() {
            return step_mm;
        }
    }
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
    warnings.extend(slabs::overlap(usual, step_mm));
    usual
}

fn duplicates_warning(duplicates: &[(usize, usize)]) -> Option<Warning> {
    let text = format!("{} image(s) occur twice; one of each was used", duplicates.len());
    (!duplicates.is_empty()).then(|| Warning::new("ct.duplicate_plane", text))
}

/// Instance numbers that go up and down along the stack.
fn order_warning(series: &Series, images: &[usize]) -> Option<Warning> {
    let numbers: Option<Vec<i32>> = images.iter().map(|&i| series.images[i].number).collect();
    let numbers = numbers?;
    let is_sorted = numbers.is_sorted() || numbers.iter().rev().is_sorted();
    let text = "the images' numbers do not follow their positions; the positions were used";
    (!is_sorted).then(|| Warning::new("ct.instance_order", text))
}

/// Images of one stack are taken to lie as its first one does: tells where that misplaces a pixel.
fn turn_warning(series: &Series, images: &[usize]) -> Option<Warning> {
    let shape = &series.images[0].shape;
    // An image hangs on its first pixel: the one farthest from that is misplaced most.
    let reach_mm = [shape.columns - 1, shape.rows - 1].map(|n| n as f64);
    let off_mm = |&i: &usize| {
        let other = &series.images[i].shape;
        let off = |axis: usize| {
            let reach_mm = reach_mm[axis] * shape.spacing_xy_mm[axis];
            (other.axes[axis] - shape.axes[axis]).norm() * reach_mm
        };
        off(0) + off(1)
    };
    let most_mm = images.iter().map(off_mm).fold(0.0, f64::max);
    let pixel_mm = shape.spacing_xy_mm[0].min(shape.spacing_xy_mm[1]);
    let text = format!(
        "the images are turned against each other by up to {most_mm:.3} mm at their far edges; all were taken to lie as the first one does"
    );
    (most_mm > TURNED_PIXELS * pixel_mm).then(|| Warning::new("ct.turned", text))
}

fn tilt_warning(angle_deg: f64) -> Warning {
    let text = format!(
        "the gantry was tilted by {angle_deg:.2} degrees; each plane was moved back to its place in the patient"
    );
    Warning::new("ct.gantry_tilt", text)
}

fn header_warnings(series: &Series) -> Vec<Warning> {
    let told = [intensities(series), rounded_axes(series), inverted(series), origin(series)];
    let left_out = [
        (series.n_across, "ct.localizer", "image(s) across the planes (scout views) left out"),
        (
            series.n_other_kind,
            "ct.other_kind",
            "image(s) of another kind or reconstruction in the series left out",
        ),
    ];
    let left_out = left_out
        .into_iter()
        .filter(|(n, ..)| *n > 0)
        .map(|(n, code, what)| Warning::new(code, format!("{n} {what}")));
    encoding::warnings(&series.images).into_iter().chain(told.into_iter().flatten()).chain(left_out).collect()
}

/// Whether the values are Hounsfield units.
fn intensities(series: &Series) -> Option<Warning> {
    let modality = &series.images[0].modality;
    if modality != "CT" {
        let text = format!("modality is {modality}, not CT: intensities are not Hounsfield units");
        return Some(Warning::new("ct.modality", text));
    }
    series.images.iter().any(|h| h.rescale.is_none()).then(|| {
        Warning::new(
            "ct.no_rescale",
            "images without rescale slope and intercept: stored values were taken as HU",
        )
    })
}

fn rounded_axes(series: &Series) -> Option<Warning> {
    let fault = series.images.iter().map(|h| h.axes_fault).fold(0.0, f64::max);
    (fault > axes::TOLD).then(|| {
        let text =
            format!("direction cosines are off by {fault:.4}; the nearest right-angled axes were taken");
        Warning::new("ct.rounded_axes", text)
    })
}

fn inverted(series: &Series) -> Option<Warning> {
    series.images.iter().any(|h| h.is_inverted).then(|| {
        let text =
            "the images are meant to be shown inverted (MONOCHROME1); their values were taken as they are";
        Warning::new("ct.inverted", text)
    })
}

/// Whether the images are what the scanner saw.
fn origin(series: &Series) -> Option<Warning> {
    let (code, text) = match series.images[0].traits.origin() {
        Origin::Scan => return None,
        Origin::Reformatted => (
            "ct.reformatted",
            "the planes were computed from another series (MPR): prefer the original where you have it",
        ),
        Origin::Projection => (
            "ct.projection",
            "the images are projections or renderings, not planes: what they show has no true size",
        ),
    };
    Some(Warning::new(code, text))
}

#[cfg(test)]
mod tests;
