//! One file's header: what it is, where its images lie, how their pixels are stored.
//!
//! A multi-frame object (Enhanced CT and its like, PS3.3 A.38, C.7.6.16) gives one header for each of its frames: what
//! differs between frames stands in per-frame functional groups, what does not in shared ones, the rest at the top.

use super::super::axes::orthonormal;
use super::super::encoding::{Frame, Loss, Packing};
use super::super::quote::without_large_numbers;
use super::super::series::{Header, PixelFormat, Shape};
use super::super::traits::{Trait, Traits};
use super::super::{Error, LARGEST_RESCALE, LONGEST_SIDE};
use super::lengths::Layout;
use super::open::open;
use super::places;
use super::stacks::{self, Dimensions};
use super::syntax::syntax_of;
use crate::geom::{Point3, Vector3};
use crate::progress::Task;
use dicom_core::Tag;
use dicom_dictionary_std::{tags, uids};
use dicom_object::{DefaultDicomObject, InMemDicomObject};
use std::path::Path;

pub(super) use super::syntax::EXPLICIT_BIG_ENDIAN_UID;

/// What a DICOM file holds.
#[derive(Debug)]
pub(super) enum Content {
    /// Images of planes in the patient, one for each frame.
    Images(Vec<Header>),
    /// A scout view.
    Localizer,
    /// A picture of a screen, or of paper.
    SecondaryCapture,
    /// The files of a medium: of each the components of its path, from the directory's folder on.
    Directory(Vec<Vec<String>>),
    /// A report, an image without a place.
    Other,
}

/// Objects that are images of planes and nothing else.
const IMAGE_CLASSES: [&str; 3] =
    [uids::CT_IMAGE_STORAGE, uids::MR_IMAGE_STORAGE, uids::POSITRON_EMISSION_TOMOGRAPHY_IMAGE_STORAGE];
/// The same with many frames and functional groups.
const ENHANCED_CLASSES: [&str; 8] = [
    uids::ENHANCED_CT_IMAGE_STORAGE,
    uids::LEGACY_CONVERTED_ENHANCED_CT_IMAGE_STORAGE,
    uids::ENHANCED_MR_IMAGE_STORAGE,
    uids::LEGACY_CONVERTED_ENHANCED_MR_IMAGE_STORAGE,
    uids::ENHANCED_PET_IMAGE_STORAGE,
    uids::LEGACY_CONVERTED_ENHANCED_PET_IMAGE_STORAGE,
    uids::X_RAY3_D_ANGIOGRAPHIC_IMAGE_STORAGE,
    uids::X_RAY3_D_CRANIOFACIAL_IMAGE_STORAGE,
];

/// What makes images of planes (PS3.3 C.7.3.1.1.1), and "other".
const MODALITIES: [&str; 12] = ["CT", "MR", "PT", "NM", "XA", "RF", "CR", "DX", "MG", "US", "OPT", "OT"];

/// Reads a header, up to the pixels.
pub(super) fn read(path: &Path, task: &Task<'_>) -> Result<Content, Error> {
    // The library's own words are left out here and below: they may quote what identifies a patient.
    let (object, layout) = open(path, Some(tags::PIXEL_DATA))?;
    Attributes { path, object: &object, frame: None }.content(&layout, task)
}

pub(super) fn damaged(path: &Path, what: &'static str) -> Error {
    Error::Damaged { path: path.to_owned(), what }
}

/// The functional group that an attribute stands in where an object has such groups.
const fn group_of(tag: Tag) -> Option<Tag> {
    Some(match tag {
        tags::IMAGE_POSITION_PATIENT => tags::PLANE_POSITION_SEQUENCE,
        tags::IMAGE_ORIENTATION_PATIENT => tags::PLANE_ORIENTATION_SEQUENCE,
        tags::PIXEL_SPACING | tags::SLICE_THICKNESS | tags::SPACING_BETWEEN_SLICES => {
            tags::PIXEL_MEASURES_SEQUENCE
        }
        tags::RESCALE_SLOPE | tags::RESCALE_INTERCEPT => tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE,
        tags::CONVOLUTION_KERNEL => tags::CT_RECONSTRUCTION_SEQUENCE,
        tags::KVP => tags::CTX_RAY_DETAILS_SEQUENCE,
        tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE => tags::CARDIAC_SYNCHRONIZATION_SEQUENCE,
        tags::STACK_ID | tags::TEMPORAL_POSITION_INDEX | tags::DIMENSION_INDEX_VALUES => {
            tags::FRAME_CONTENT_SEQUENCE
        }
        _ => return None,
    })
}

/// Groups that hold the type of a frame, one for each modality.
const FRAME_TYPE_GROUPS: [Tag; 4] = [
    tags::CT_IMAGE_FRAME_TYPE_SEQUENCE,
    tags::MR_IMAGE_FRAME_TYPE_SEQUENCE,
    tags::PET_FRAME_TYPE_SEQUENCE,
    tags::X_RAY3_D_FRAME_TYPE_SEQUENCE,
];

/// The functional groups that hold for one frame.
#[derive(Clone, Copy)]
struct Groups<'a> {
    /// From 1.
    number: usize,
    own: &'a InMemDicomObject,
    shared: Option<&'a InMemDicomObject>,
}

impl<'a> Groups<'a> {
    /// An attribute in a group, the frame's own before the shared one.
    fn find(&self, group: Tag, tag: Tag) -> Option<&'a dicom_object::mem::InMemElement> {
        let in_scope = |scope: &'a InMemDicomObject| scope.get(group)?.items()?.first()?.get(tag);
        in_scope(self.own).or_else(|| self.shared.and_then(in_scope))
    }
}

/// What the frames of a file share about their pixels: found once for all of them.
struct Stored<'l> {
    layout: &'l Layout,
    n_frames: usize,
    starts: places::Starts,
}

/// The attributes of one file, or of one frame of it.
#[derive(Clone, Copy)]
struct Attributes<'a> {
    path: &'a Path,
    object: &'a DefaultDicomObject,
    frame: Option<Groups<'a>>,
}

impl<'a> Attributes<'a> {
    fn content(&self, layout: &Layout, task: &Task<'_>) -> Result<Content, Error> {
        let class = self.text(tags::SOP_CLASS_UID);
        if class == uids::MEDIA_STORAGE_DIRECTORY_STORAGE
            || self.object.get(tags::DIRECTORY_RECORD_SEQUENCE).is_some()
        {
            return Ok(Content::Directory(self.records()));
        }
        let is_enhanced = ENHANCED_CLASSES.contains(&class.as_str());
        let is_image_class = is_enhanced || IMAGE_CLASSES.contains(&class.as_str());
        if !is_image_class && self.object.get(tags::ROWS).is_none() {
            return Ok(Content::Other);
        }
        let image_type = self.text(tags::IMAGE_TYPE);
        if image_type.contains("LOCALIZER") {
            return Ok(Content::Localizer);
        }
        if class.starts_with(uids::SECONDARY_CAPTURE_IMAGE_STORAGE) || image_type.contains("SCREEN SAVE") {
            return Ok(Content::SecondaryCapture);
        }
        let has_place = [tags::IMAGE_POSITION_PATIENT, tags::IMAGE_ORIENTATION_PATIENT]
            .into_iter()
            .all(|t| self.object.get(t).is_some());
        if !is_image_class && !has_place {
            return Ok(Content::Other);
        }
        if is_enhanced {
            return self.frames(layout, task);
        }
        let n_frames = self.n_frames()?;
        if n_frames > 1 {
            return Err(self.unsupported(format!("a multi-frame image ({n_frames} frames)")));
        }
        Ok(Content::Images(vec![self.header(&self.stored(layout, 1))?]))
    }

    /// Headers of all frames that are no scout views.
    fn frames(&self, layout: &Layout, task: &Task<'_>) -> Result<Content, Error> {
        let items = self.object.get(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).and_then(|e| e.items());
        let items = items.ok_or_else(|| self.missing("PerFrameFunctionalGroupsSequence"))?;
        let shared = self.object.get(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE);
        let shared = shared.and_then(|e| e.items()).and_then(<[_]>::first);
        let n_frames = self.n_frames()?;
        if items.len() != n_frames {
            let found = format!("{n_frames}, with functional groups of {} frames", items.len());
            return Err(self.bad("NumberOfFrames", &format_args!("{found}"), "groups for each frame"));
        }
        let stored = self.stored(layout, n_frames);
        let mut images = Vec::new();
        let mut dimensions = Vec::new();
        for (own, number) in items.iter().zip(1..) {
            task.check()?;
            let frame = Self { frame: Some(Groups { number, own, shared }), ..*self };
            if !frame.is_localizer() {
                images.push(frame.header(&stored)?);
                dimensions.push(frame.dimensions());
            }
        }
        if images.is_empty() {
            return Ok(Content::Localizer);
        }
        stacks::tell_apart(&mut images, &dimensions, &self.pointers());
        Ok(Content::Images(images))
    }

    fn is_localizer(&self) -> bool {
        self.frame_types().any(|t| t.contains("LOCALIZER"))
    }

    /// The type of the frame, one for each modality that states one; none for a file of one image.
    fn frame_types(&self) -> impl Iterator<Item = String> + use<'a> {
        let frame = self.frame;
        let types = FRAME_TYPE_GROUPS.into_iter().filter_map(move |g| frame?.find(g, tags::FRAME_TYPE));
        types.filter_map(|e| e.to_str().ok()).map(|t| t.trim_matches([' ', '\0']).to_owned())
    }

    /// What tells the stacks and phases of an object apart.
    fn dimensions(&self) -> Dimensions {
        let indices = self.get(tags::DIMENSION_INDEX_VALUES).and_then(|e| e.to_multi_int::<u32>().ok());
        Dimensions {
            stack: self.text(tags::STACK_ID),
            phase: self.text(tags::TEMPORAL_POSITION_INDEX),
            indices: indices.unwrap_or_default(),
        }
    }

    /// What each of the dimension indices counts.
    fn pointers(&self) -> Vec<Option<Tag>> {
        let items = self.object.get(tags::DIMENSION_INDEX_SEQUENCE).and_then(|e| e.items());
        let pointer =
            |item: &InMemDicomObject| item.get(tags::DIMENSION_INDEX_POINTER)?.value().to_tag().ok();
        items.unwrap_or_default().iter().map(pointer).collect()
    }

    /// Paths of the images that a directory names, by their components.
    fn records(&self) -> Vec<Vec<String>> {
        let items = self.object.get(tags::DIRECTORY_RECORD_SEQUENCE).and_then(|e| e.items());
        let is_image = |item: &&InMemDicomObject| {
            let kind = item.get(tags::DIRECTORY_RECORD_TYPE).and_then(|e| e.to_str().ok());
            kind.is_some_and(|k| k.trim_matches([' ', '\0']) == "IMAGE")
        };
        let components = |item: &InMemDicomObject| -> Option<Vec<String>> {
            let parts = item.get(tags::REFERENCED_FILE_ID)?.to_multi_str().ok()?;
            Some(parts.iter().map(|p| p.trim_matches([' ', '\0']).to_owned()).collect())
        };
        items.unwrap_or_default().iter().filter(is_image).filter_map(components).collect()
    }

    fn n_frames(&self) -> Result<usize, Error> {
        let n = self.integer(tags::NUMBER_OF_FRAMES)?.unwrap_or(1);
        usize::try_from(n).ok().filter(|&n| n > 0).ok_or_else(|| self.bad("NumberOfFrames", &n, "1 or more"))
    }

    fn refuse_unreadable_kinds(&self) -> Result<(), Error> {
        let samples = self.integer(tags::SAMPLES_PER_PIXEL)?.unwrap_or(1);
        if samples != 1 {
            return Err(self.unsupported(format!("an image of {samples} samples per pixel (colour)")));
        }
        if self.text(tags::PHOTOMETRIC_INTERPRETATION) == "PALETTE COLOR" {
            return Err(self.unsupported("an image of palette colours".into()));
        }
        if self.object.get(tags::MODALITY_LUT_SEQUENCE).is_some() {
            return Err(self.unsupported("an image with a modality look-up table".into()));
        }
        Ok(())
    }

    fn header(&self, stored: &Stored<'_>) -> Result<Header, Error> {
        self.refuse_unreadable_kinds()?;
        let (shape, pixels) = (self.shape()?, self.pixel_format()?);
        let syntax = syntax_of(self.object.meta().transfer_syntax(), pixels);
        let frame = self.frame_of(stored, &shape, pixels, syntax.packing)?;
        Ok(Header {
            path: self.path.to_owned(),
            identity: [tags::SERIES_INSTANCE_UID, tags::FRAME_OF_REFERENCE_UID].map(|t| self.text(t)),
            instance: self.instance(),
            number: self.number_in_series(),
            traits: self.traits(),
            modality: self.modality(),
            axes_fault: self.axes()?.1,
            position: self.position()?,
            slab_thickness_mm: self.positive(tags::SLICE_THICKNESS)?,
            spacing_between_mm: self.number(tags::SPACING_BETWEEN_SLICES)?,
            rescale: self.rescale()?,
            padding: self.padding()?,
            is_inverted: self.text(tags::PHOTOMETRIC_INTERPRETATION) == "MONOCHROME1",
            loss: Loss::of(syntax.loss, self.said_loss()),
            frame,
            shape,
            pixels,
            syntax,
        })
    }

    /// The UID of the image; frames of one object add their number.
    fn instance(&self) -> String {
        let uid = self.text(tags::SOP_INSTANCE_UID);
        self.frame.map_or(uid.clone(), |frame| format!("{uid}#{}", frame.number))
    }

    /// Its place in the series as the scanner counts; frames are in no order that a scanner made.
    fn number_in_series(&self) -> Option<i32> {
        if self.frame.is_some() { None } else { self.integer(tags::INSTANCE_NUMBER).unwrap_or(None) }
    }

    /// Whether LossyImageCompression says so; `None` where it says nothing.
    fn said_loss(&self) -> Option<bool> {
        match self.text(tags::LOSSY_IMAGE_COMPRESSION).as_str() {
            "00" => Some(false),
            "01" => Some(true),
            _ => None,
        }
    }

    /// Where the pixels of all images of the file stand.
    fn stored<'l>(&self, layout: &'l Layout, n_frames: usize) -> Stored<'l> {
        Stored { layout, n_frames, starts: places::Starts::of(layout, n_frames, &self.extended_offsets()) }
    }

    /// Where the pixels of the image stand.
    fn frame_of(
        &self,
        &Stored { layout, n_frames, ref starts }: &Stored<'_>,
        shape: &Shape,
        pixels: PixelFormat,
        packing: Packing,
    ) -> Result<Frame, Error> {
        let index = self.frame.map_or(0, |g| g.number - 1);
        let wanted = places::Wanted {
            path: self.path,
            index,
            n_frames,
            starts,
            n_pixels: [shape.columns, shape.rows],
            bytes_per_pixel: u64::from(pixels.bits_allocated / 8),
            packing,
        };
        let is_swapped = layout.is_in_words
            && pixels.bits_allocated == 8
            && matches!(packing, Packing::Native { is_big_endian: true });
        Ok(Frame {
            number: self.frame.map(|g| g.number),
            pieces: wanted.pieces(layout)?,
            deflated_from: layout.deflated_from,
            is_swapped,
            is_too_long: wanted.is_too_long(layout),
        })
    }

    /// The table of frames in 64 bits, where there is one.
    fn extended_offsets(&self) -> Vec<u64> {
        let element = self.object.get(tags::EXTENDED_OFFSET_TABLE);
        let bytes = element.and_then(|e| e.to_bytes().ok()).unwrap_or_default();
        let number = |b: &[u8]| b.iter().rev().fold(0, |n, &b| n << 8 | u64::from(b));
        bytes.chunks_exact(8).map(number).collect()
    }

    fn shape(&self) -> Result<Shape, Error> {
        let side = |tag, name| -> Result<usize, Error> {
            let n = self.integer(tag)?.ok_or_else(|| self.missing(name))?;
            let is_believed = (1..=i32::from(LONGEST_SIDE)).contains(&n);
            let size = usize::try_from(n).ok().filter(|_| is_believed);
            size.ok_or_else(|| self.bad(name, &n, "1 to 8192"))
        };
        let spacing = self.numbers::<2>(tags::PIXEL_SPACING, "PixelSpacing")?;
        if !spacing.iter().all(|s| (1e-3..=100.0).contains(s)) {
            return Err(self.bad("PixelSpacing", &spacing, "0.001 to 100 mm"));
        }
        Ok(Shape {
            columns: side(tags::COLUMNS, "Columns")?,
            rows: side(tags::ROWS, "Rows")?,
            // The header states the distance between rows, along y, first.
            spacing_xy_mm: [spacing[1], spacing[0]],
            axes: self.axes()?.0,
        })
    }

    /// Directions of rows and columns, and how far the cosines are from orthonormal.
    fn axes(&self) -> Result<([Vector3; 2], f64), Error> {
        const NAME: &str = "ImageOrientationPatient";
        let [a, b, c, d, e, f] = self.numbers::<6>(tags::IMAGE_ORIENTATION_PATIENT, NAME)?;
        orthonormal(Vector3::new(a, b, c), Vector3::new(d, e, f)).map_err(|fault| {
            let found = without_large_numbers(&format!("{:?}, off by {fault:.4}", [a, b, c, d, e, f]));
            // The figure is `axes::REFUSED`.
            let expected = "two orthogonal unit vectors within 0.01";
            Error::BadAttribute { path: self.path.to_owned(), attribute: NAME, found, expected }
        })
    }

    /// What tells images of one place apart.
    fn traits(&self) -> Traits {
        let mut traits = Traits::default();
        for (of, tag) in [
            (Trait::ImageType, tags::IMAGE_TYPE),
            (Trait::Kernel, tags::CONVOLUTION_KERNEL),
            (Trait::EchoTime, tags::ECHO_TIME),
            (Trait::TubeVoltage, tags::KVP),
            (Trait::TemporalPosition, tags::TEMPORAL_POSITION_IDENTIFIER),
            (Trait::CardiacPhase, tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE),
            (Trait::TriggerTime, tags::TRIGGER_TIME),
            (Trait::Acquisition, tags::ACQUISITION_NUMBER),
            (Trait::AcquisitionTime, tags::ACQUISITION_TIME),
        ] {
            traits.0[of as usize] = self.text(tag);
        }
        // What a frame is made by stands in a group of its own.
        if let Some(kind) = self.frame_types().next() {
            traits.0[Trait::ImageType as usize] = kind;
        }
        traits
    }

    fn position(&self) -> Result<Point3, Error> {
        const NAME: &str = "ImagePositionPatient";
        let position = self.numbers::<3>(tags::IMAGE_POSITION_PATIENT, NAME)?;
        if position.iter().any(|v| v.abs() > 1e5) {
            return Err(self.bad(NAME, &position, "coordinates within 100 m"));
        }
        Ok(Point3::from(position))
    }

    fn pixel_format(&self) -> Result<PixelFormat, Error> {
        let word = |tag, name| -> Result<u16, Error> {
            let n = self.integer(tag)?.ok_or_else(|| self.missing(name))?;
            u16::try_from(n).ok().filter(|&n| n <= 64).ok_or_else(|| self.bad(name, &n, "0 to 64"))
        };
        let bits_allocated = word(tags::BITS_ALLOCATED, "BitsAllocated")?;
        if bits_allocated != 8 && bits_allocated != 16 {
            return Err(self.unsupported(format!("an image of {bits_allocated} bits per pixel")));
        }
        let bits_stored = word(tags::BITS_STORED, "BitsStored")?;
        let high_bit = self.integer(tags::HIGH_BIT)?.map_or(i32::from(bits_stored) - 1, |n| n);
        let is_signed = word(tags::PIXEL_REPRESENTATION, "PixelRepresentation")? == 1;
        if !(1..=bits_allocated).contains(&bits_stored) {
            return Err(self.bad("BitsStored", &bits_stored, "1 to BitsAllocated"));
        }
        let fits = |h: &u16| (bits_stored - 1..bits_allocated).contains(h);
        let high_bit = u16::try_from(high_bit)
            .ok()
            .filter(fits)
            .ok_or_else(|| self.bad("HighBit", &high_bit, "BitsStored - 1 to BitsAllocated - 1"))?;
        Ok(PixelFormat { bits_allocated, bits_stored, high_bit, is_signed })
    }

    fn rescale(&self) -> Result<Option<[f64; 2]>, Error> {
        let (slope, intercept) = (self.number(tags::RESCALE_SLOPE)?, self.number(tags::RESCALE_INTERCEPT)?);
        match (slope, intercept) {
            (None, None) => Ok(None),
            (Some(slope), _) if slope.abs() < 1e-9 => Err(self.bad("RescaleSlope", &slope, "other than 0")),
            (Some(slope), _) if slope.abs() > LARGEST_RESCALE => {
                Err(self.bad("RescaleSlope", &slope, "up to 1000000"))
            }
            (_, Some(intercept)) if intercept.abs() > LARGEST_RESCALE => {
                Err(self.bad("RescaleIntercept", &intercept, "within 1000000"))
            }
            _ => Ok(Some([slope.unwrap_or(1.0), intercept.unwrap_or(0.0)])),
        }
    }

    fn padding(&self) -> Result<Option<[i32; 2]>, Error> {
        // What no word can hold pads no pixel.
        let fits = |v: &i32| (-0x8000..0x1_0000).contains(v);
        let Some(value) = self.integer(tags::PIXEL_PADDING_VALUE)?.filter(fits) else { return Ok(None) };
        let limit = self.integer(tags::PIXEL_PADDING_RANGE_LIMIT)?.filter(fits).unwrap_or(value);
        let is_signed = self.integer(tags::PIXEL_REPRESENTATION)? == Some(1);
        // Implicit VR cannot tell a signed padding value from an unsigned one, and writers confuse the two.
        let as_stored = |v: i32| match is_signed {
            true if v > 0x7fff => v - 0x1_0000,
            false if v < 0 => v + 0x1_0000,
            _ => v,
        };
        let (a, b) = (as_stored(value), as_stored(limit));
        Ok(Some([a.min(b), a.max(b)]))
    }

    /// The modality, or OT where the header holds anything but the code of one that makes planes.
    fn modality(&self) -> String {
        let code = self.text(tags::MODALITY);
        if MODALITIES.contains(&code.as_str()) { code } else { "OT".into() }
    }

    /// An attribute: of the frame, of all frames, or of the file.
    fn get(&self, tag: Tag) -> Option<&'a dicom_object::mem::InMemElement> {
        let in_group = group_of(tag).and_then(|group| self.frame?.find(group, tag));
        in_group.or_else(|| self.object.get(tag))
    }

    /// Text of an attribute, empty where it is absent.
    fn text(&self, tag: Tag) -> String {
        let value = self.get(tag).and_then(|e| e.to_str().ok());
        value.map(|s| s.trim_matches([' ', '\0']).to_owned()).unwrap_or_default()
    }

    /// An integer; `None` where the attribute is absent or empty.
    fn integer(&self, tag: Tag) -> Result<Option<i32>, Error> {
        let Some(element) = self.get(tag).filter(|_| !self.is_blank(tag)) else {
            return Ok(None);
        };
        let value = element.to_int::<i32>().ok();
        value.map(Some).ok_or_else(|| damaged(self.path, "an integer attribute holds something else"))
    }

    /// A finite number; `None` where the attribute is absent or empty.
    fn number(&self, tag: Tag) -> Result<Option<f64>, Error> {
        let Some(element) = self.get(tag).filter(|_| !self.is_blank(tag)) else {
            return Ok(None);
        };
        let value = element.to_float64().ok().filter(|v| v.is_finite());
        value.map(Some).ok_or_else(|| damaged(self.path, "a decimal attribute holds no number"))
    }

    /// A number above zero; `None` where there is no such.
    fn positive(&self, tag: Tag) -> Result<Option<f64>, Error> {
        Ok(self.number(tag)?.filter(|&v| v > 0.0))
    }

    /// Exactly N finite numbers.
    fn numbers<const N: usize>(&self, tag: Tag, name: &'static str) -> Result<[f64; N], Error> {
        let element = self.get(tag).filter(|_| !self.is_blank(tag)).ok_or_else(|| self.missing(name))?;
        let values = element
            .to_multi_float64()
            .ok()
            .ok_or_else(|| damaged(self.path, "a decimal attribute holds no number"))?;
        let count = values.len();
        let exact = <[f64; N]>::try_from(values).ok().filter(|v| v.iter().all(|x| x.is_finite()));
        exact.ok_or_else(|| {
            self.bad(name, &format_args!("{count} numbers"), "the right count of finite numbers")
        })
    }

    fn is_blank(&self, tag: Tag) -> bool {
        self.text(tag).is_empty()
    }

    fn missing(&self, attribute: &'static str) -> Error {
        Error::MissingAttribute { path: self.path.to_owned(), attribute }
    }

    fn bad(&self, attribute: &'static str, found: &dyn std::fmt::Debug, expected: &'static str) -> Error {
        let found = without_large_numbers(&format!("{found:?}"));
        Error::BadAttribute { path: self.path.to_owned(), attribute, found, expected }
    }

    fn unsupported(&self, what: String) -> Error {
        Error::UnsupportedImage { path: self.path.to_owned(), what: without_large_numbers(&what) }
    }
}
