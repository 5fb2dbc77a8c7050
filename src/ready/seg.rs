//! DICOM SEG (PS3.3 A.51) to the outlines of one segment.
//!
//! Frames are told apart by the segment they belong to and put in order by their own positions. Binary frames follow each other bit by
//! bit, without padding, the lowest bit of a byte first (PS3.5 8.1.1); fractional ones count from half of their maximum.

use super::dicom::{Place, directions, frame_of_reference, items, numbers, point, text, whole};
use super::{Absent, Error, Label, Ready, Reference, Structure, chosen};
use crate::ct::axes::REFUSED;
use crate::ct::formats::grid::Grid;
use crate::ct::quote::without_large_numbers;
use crate::ct::{LONGEST_SIDE, SAME_PLACE_MM};
use crate::geom::{Point3, Vector3};
use crate::progress::{Cancelled, Task};
use crate::sections::ready::{Drawn, DrawnStack, outlines_mm};
use dicom_core::Tag;
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, InMemDicomObject};
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;

/// Most frames that are believed.
const MOST_FRAMES: u32 = 100_000;
/// Frames of one stack may lie this far beside each other, in pixels.
const BESIDE_PIXELS: f64 = 0.1;

/// How the pixels of all frames are stored.
struct Frames<'a> {
    place: Place<'a>,
    columns: usize,
    rows: usize,
    n_frames: usize,
    /// `None`: binary; the least value that is inside.
    least_inside: Option<u16>,
    bytes: Cow<'a, [u8]>,
}

/// Where one frame lies.
#[derive(Clone, Copy)]
struct Frame {
    index: usize,
    segment: u32,
    position: Point3,
    axes: [Vector3; 2],
    spacing_xy_mm: [f64; 2],
}

pub(super) fn ready(
    place: Place<'_>,
    object: &DefaultDicomObject,
    label: Option<&Label>,
    task: &Task<'_>,
) -> Result<Ready, Error> {
    let pixels = Frames::of(place, object)?;
    let frames = frames(place, object, pixels.n_frames)?;
    let mut voxels: BTreeMap<u32, usize> = BTreeMap::new();
    for frame in &frames {
        *voxels.entry(frame.segment).or_default() += pixels.n_inside(frame.index);
    }
    let structures = structures(object, &voxels);
    let number = chosen(place.0, &structures, label)?.number;
    let mut own: Vec<Frame> = frames.into_iter().filter(|f| f.segment == number).collect();
    let stack = stacked(place, &mut own, pixels.columns, pixels.rows)?;
    let outlined = |(frame, &z_mm): (&Frame, &f64)| {
        task.check()?;
        let mut inside = pixels.inside(frame.index);
        stack.turn(&mut inside, pixels.columns);
        Ok(Drawn {
            z_mm,
            contours: outlines_mm(&inside, pixels.columns, stack.origin_xy_mm, stack.spacing_xy_mm),
        })
    };
    let planes: Result<Vec<Drawn>, Cancelled> = own.par_iter().zip(&stack.plane_z_mm).map(outlined).collect();
    let drawn = DrawnStack {
        planes: planes?,
        patient_from_stack: stack.patient_from_stack,
        pixel_mm: stack.spacing_xy_mm,
        are_outlines: true,
    };
    let reference = Reference::Frame(frame_of_reference(object, tags::FRAME_OF_REFERENCE_UID));
    Ok(Ready { number, drawn, warnings: Vec::new(), reference, absent: Absent::Empty })
}

/// The segments that have voxels.
fn structures(object: &DefaultDicomObject, voxels: &BTreeMap<u32, usize>) -> Vec<Structure> {
    let name_of = |number: u32| {
        let segments = items(object, tags::SEGMENT_SEQUENCE);
        let own = segments.iter().find(|s| whole(s, tags::SEGMENT_NUMBER) == Some(number))?;
        text(own, tags::SEGMENT_LABEL)
    };
    let structure =
        |(&number, &size): (&u32, &usize)| Structure { number, name: name_of(number), size, unit: "voxels" };
    voxels.iter().filter(|(_, n)| **n > 0).map(structure).collect()
}

impl<'a> Frames<'a> {
    fn of(place: Place<'a>, object: &'a DefaultDicomObject) -> Result<Self, Error> {
        let side = |tag, name| {
            let n = whole(object, tag).ok_or_else(|| place.missing(name))?;
            let odd = || {
                place.fault(without_large_numbers(&format!(
                    "attribute {name} is {n}, expected 1 to {LONGEST_SIDE}: export the segmentation again"
                )))
            };
            (1..=LONGEST_SIDE.into()).contains(&n).then_some(n as usize).ok_or_else(odd)
        };
        let (columns, rows) = (side(tags::COLUMNS, "Columns")?, side(tags::ROWS, "Rows")?);
        let n_frames = whole(object, tags::NUMBER_OF_FRAMES).unwrap_or(1);
        if !(1..=MOST_FRAMES).contains(&n_frames) {
            let found = without_large_numbers(&n_frames.to_string());
            let what = format!(
                "attribute NumberOfFrames is {found}, expected 1 to {MOST_FRAMES}: export the segmentation again"
            );
            return Err(place.fault(what));
        }
        let n_frames = n_frames as usize;
        let least_inside = least_inside(place, object)?;
        let n_values = columns * rows * n_frames;
        let needed = if least_inside.is_some() { n_values } else { n_values.div_ceil(8) };
        let bytes = pixel_bytes(place, object)?;
        if bytes.len() < needed {
            let what = format!(
                "truncated: {} bytes of pixels, its {n_frames} frames need {needed}: copy or export it again",
                bytes.len()
            );
            return Err(place.fault(what));
        }
        Ok(Self { place, columns, rows, n_frames, least_inside, bytes })
    }

    /// Places of a frame's pixels, among those of all frames.
    fn pixels(&self, frame: usize) -> Range<usize> {
        debug_assert!(frame < self.n_frames, "{}", self.place.0.display());
        let n = self.columns * self.rows;
        frame * n..(frame + 1) * n
    }

    /// Which pixels of a frame are inside: of one frame at a time, so that a volume of bits stays one.
    fn inside(&self, frame: usize) -> Vec<bool> {
        let values = self.pixels(frame);
        match self.least_inside {
            Some(least) => self.bytes[values].iter().map(|&v| u16::from(v) >= least).collect(),
            None => values.map(|bit| self.bytes[bit / 8] >> (bit % 8) & 1 == 1).collect(),
        }
    }

    /// How many pixels of a frame are inside.
    fn n_inside(&self, frame: usize) -> usize {
        let values = self.pixels(frame);
        match self.least_inside {
            Some(least) => self.bytes[values].iter().filter(|&&v| u16::from(v) >= least).count(),
            None => n_ones(&self.bytes, values),
        }
    }
}

/// How many of these bits are set, the lowest of a byte first.
fn n_ones(bytes: &[u8], bits: Range<usize>) -> usize {
    let below =
        |bit: usize| bytes.get(bit / 8).map_or(0, |b| (b & ((1 << (bit % 8)) - 1)).count_ones() as usize);
    let whole: usize = bytes[bits.start / 8..bits.end / 8].iter().map(|b| b.count_ones() as usize).sum();
    whole + below(bits.end) - below(bits.start)
}

/// What a fractional value must be at least; nothing for bits.
fn least_inside(place: Place<'_>, object: &DefaultDicomObject) -> Result<Option<u16>, Error> {
    let kind = text(object, tags::SEGMENTATION_TYPE).ok_or_else(|| place.missing("SegmentationType"))?;
    let bits = whole(object, tags::BITS_ALLOCATED).ok_or_else(|| place.missing("BitsAllocated"))?;
    match (kind.as_str(), bits) {
        ("BINARY", 1) => Ok(None),
        ("BINARY", 8) => Ok(Some(1)),
        ("FRACTIONAL", 8) => {
            let most = whole(object, tags::MAXIMUM_FRACTIONAL_VALUE).filter(|m| (1..=255).contains(m));
            let most = most.ok_or_else(|| place.missing("MaximumFractionalValue"))?;
            Ok(u16::try_from(most.div_ceil(2)).ok())
        }
        _ => {
            // It may hold anything.
            let known = ["BINARY", "FRACTIONAL", "LABELMAP"].into_iter().find(|known| *known == kind);
            let (kind, bits) = (known.unwrap_or("of another kind"), without_large_numbers(&bits.to_string()));
            Err(place.fault(format!(
                "SegmentationType {kind} with {bits} bits is not read: export it as BINARY with 1 bit or FRACTIONAL with 8"
            )))
        }
    }
}

fn pixel_bytes<'a>(place: Place<'_>, object: &'a DefaultDicomObject) -> Result<Cow<'a, [u8]>, Error> {
    let element = object.get(tags::PIXEL_DATA).ok_or_else(|| place.missing("PixelData"))?;
    match element.value() {
        // Words of either byte order come out lowest byte first, so that bits stand in the order of the pixels.
        dicom_core::DicomValue::Primitive(value) => Ok(value.to_bytes()),
        _ => Err(place.fault("compressed pixels of a SEG are not read: export it uncompressed")),
    }
}

/// Where all frames lie: what a frame does not state itself, the shared groups do.
fn frames(place: Place<'_>, object: &DefaultDicomObject, n_frames: usize) -> Result<Vec<Frame>, Error> {
    let shared = items(object, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE).first();
    let per_frame = items(object, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE);
    if per_frame.len() != n_frames {
        let what = format!(
            "{} frames are described, {n_frames} are stored: export the segmentation again",
            per_frame.len()
        );
        return Err(place.fault(what));
    }
    let frame = |(index, own): (usize, &InMemDicomObject)| {
        let group = |tag: Tag| items(own, tag).first().or_else(|| items(shared?, tag).first());
        let position =
            group(tags::PLANE_POSITION_SEQUENCE).and_then(|g| point(g, tags::IMAGE_POSITION_PATIENT));
        let axes = group(tags::PLANE_ORIENTATION_SEQUENCE)
            .map_or(Err(None), |g| directions(g, tags::IMAGE_ORIENTATION_PATIENT));
        let spacing = group(tags::PIXEL_MEASURES_SEQUENCE).and_then(|g| numbers(g, tags::PIXEL_SPACING));
        let spacing = spacing.filter(|s| s.len() == 2 && s.iter().all(|&v| v > 1e-6)).map(|s| [s[1], s[0]]);
        let segment = group(tags::SEGMENT_IDENTIFICATION_SEQUENCE)
            .and_then(|g| whole(g, tags::REFERENCED_SEGMENT_NUMBER));
        Ok(Frame {
            index,
            segment: segment.ok_or_else(|| place.missing("ReferencedSegmentNumber"))?,
            position: position.ok_or_else(|| place.missing("ImagePositionPatient"))?,
            axes: axes.map_err(|off| bad_axes(place, off))?,
            spacing_xy_mm: spacing.ok_or_else(|| place.missing("PixelSpacing"))?,
        })
    };
    per_frame.iter().enumerate().map(frame).collect()
}

fn bad_axes(place: Place<'_>, off: Option<f64>) -> Error {
    let Some(off) = off else { return place.missing("ImageOrientationPatient") };
    place.fault(format!(
        "attribute ImageOrientationPatient is {off:.4} off two orthogonal unit vectors, expected {REFUSED} at most: export the segmentation again"
    ))
}

/// The frames of a segment as a stack.
struct Stack {
    plane_z_mm: Vec<f64>,
    origin_xy_mm: [f64; 2],
    spacing_xy_mm: [f64; 2],
    patient_from_stack: crate::geom::RigidTransform,
    turned: [bool; 2],
}

impl Stack {
    fn turn(&self, inside: &mut [bool], columns: usize) {
        if self.turned[1] {
            inside.reverse();
            inside.chunks_exact_mut(columns).for_each(<[bool]>::reverse);
        }
        if self.turned[0] {
            inside.chunks_exact_mut(columns).for_each(<[bool]>::reverse);
        }
    }
}

/// Sorts the frames along their normal and finds their frame by that of one plane.
fn stacked(place: Place<'_>, frames: &mut [Frame], columns: usize, rows: usize) -> Result<Stack, Error> {
    let first = frames[0];
    let [row, column] = first.axes;
    let normal = row.cross(&column);
    let alike = |f: &Frame| {
        (0..2).all(|a| {
            (f.axes[a] - first.axes[a]).norm() < 1e-4
                && (f.spacing_xy_mm[a] / first.spacing_xy_mm[a] - 1.0).abs() < 1e-4
        })
    };
    if !frames.iter().all(alike) {
        return Err(place.fault(
            "frames of one segment differ in orientation or pixel spacing: export it as one stack of planes",
        ));
    }
    let [dx, dy] = first.spacing_xy_mm;
    let grid =
        Grid { dims: [columns, rows, 2], origin: first.position, axes_mm: [row * dx, column * dy, normal] };
    let placed = grid.place().map_err(|fault| place.fault(fault.to_string()))?;
    // The first frame's place along the stack is what the others' are measured from.
    let stack_from_patient = placed.patient_from_stack.inverse();
    let z_of = |f: &Frame| stack_from_patient.apply(f.position).z;
    frames.sort_by(|a, b| z_of(a).total_cmp(&z_of(b)).then(a.index.cmp(&b.index)));
    let beside = |f: &Frame| {
        let offset = f.position - first.position;
        (offset - normal * offset.dot(&normal)).norm()
    };
    let farthest = frames.iter().map(beside).fold(0.0, f64::max);
    if farthest > BESIDE_PIXELS * dx.min(dy) {
        return Err(place.fault(format!("frames of one segment lie up to {farthest:.3} mm beside each other: export it as one stack of planes")));
    }
    let plane_z_mm: Vec<f64> = frames.iter().map(z_of).collect();
    if let Some(twice) = plane_z_mm.windows(2).find(|z| z[1] - z[0] < SAME_PLACE_MM) {
        return Err(place.fault(format!(
            "two frames of one segment lie at z = {:.3} mm: export it with one each",
            twice[0]
        )));
    }
    Ok(Stack {
        plane_z_mm,
        origin_xy_mm: placed.origin_xy_mm,
        spacing_xy_mm: first.spacing_xy_mm,
        patient_from_stack: placed.patient_from_stack,
        turned: [placed.turned[0], placed.turned[1]],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_counted_across_bytes() {
        let bytes = [0b1010_0110, 0xff, 0b0000_0001];
        let is_set = |bit: usize| bytes[bit / 8] >> (bit % 8) & 1 == 1;
        for start in 0..=24 {
            for end in start..=24 {
                assert_eq!(n_ones(&bytes, start..end), (start..end).filter(|&b| is_set(b)).count());
            }
        }
    }
}
