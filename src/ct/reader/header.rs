//! One file's header: what it is, where its image lies, how its pixels are stored.

use super::super::Error;
use super::super::axes::orthonormal;
use super::super::series::{Header, PixelFormat, Shape, Syntax};
use super::super::traits::{Trait, Traits};
use super::lengths;
use crate::geom::{Point3, Vector3};
use dicom_core::Tag;
use dicom_dictionary_std::{tags, uids};
use dicom_object::{DefaultDicomObject, OpenFileOptions};
use std::path::Path;

/// What a DICOM file holds.
#[derive(Debug)]
pub(super) enum Content {
    /// An image of a plane in the patient.
    Image(Box<Header>),
    /// A scout view.
    Localizer,
    /// A picture of a screen, or of paper.
    SecondaryCapture,
    /// A report, a directory, an image without a place.
    Other,
}

/// Longest side of an image that is believed.
const LONGEST_SIDE: u16 = 8192;
/// Objects that are images of planes and nothing else.
const IMAGE_CLASSES: [&str; 3] =
    [uids::CT_IMAGE_STORAGE, uids::MR_IMAGE_STORAGE, uids::POSITRON_EMISSION_TOMOGRAPHY_IMAGE_STORAGE];

/// What makes images of planes (PS3.3 C.7.3.1.1.1), and "other".
const MODALITIES: [&str; 12] = ["CT", "MR", "PT", "NM", "XA", "RF", "CR", "DX", "MG", "US", "OPT", "OT"];

/// Explicit VR big endian: retired, but archives still hold such files.
pub(super) const EXPLICIT_BIG_ENDIAN_UID: &str = "1.2.840.10008.1.2.2";

/// Reads a header, up to the pixels.
pub(super) fn read(path: &Path) -> Result<Content, Error> {
    let pixel_bytes = lengths::check(path)?;
    let object = OpenFileOptions::new().read_until(tags::PIXEL_DATA).open_file(path);
    // The library's own words are left out here and below: they may quote what identifies a patient.
    let object = object.ok().ok_or_else(|| damaged(path, "its header cannot be parsed"))?;
    Attributes { path, object: &object, pixel_bytes }.content()
}

pub(super) fn damaged(path: &Path, what: &'static str) -> Error {
    Error::Damaged { path: path.to_owned(), what }
}

/// The syntaxes that occur, by UID; what is not here has no name but may still be decoded.
const SYNTAXES: [(&str, &str, bool); 15] = [
    (uids::IMPLICIT_VR_LITTLE_ENDIAN, "implicit VR little endian", true),
    (uids::EXPLICIT_VR_LITTLE_ENDIAN, "explicit VR little endian", true),
    (EXPLICIT_BIG_ENDIAN_UID, "explicit VR big endian", true),
    (uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN, "deflated explicit VR little endian", true),
    (uids::RLE_LOSSLESS, "RLE", false),
    (uids::JPEG_BASELINE8_BIT, "JPEG baseline (lossy)", false),
    (uids::JPEG_EXTENDED12_BIT, "JPEG extended 12 bit (lossy)", false),
    (uids::JPEG_LOSSLESS, "JPEG lossless", false),
    (uids::JPEG_LOSSLESS_SV1, "JPEG lossless, first-order", false),
    (uids::JPEGLS_LOSSLESS, "JPEG-LS", false),
    (uids::JPEGLS_NEAR_LOSSLESS, "JPEG-LS (near-lossless)", false),
    (uids::JPEG2000_LOSSLESS, "JPEG 2000 lossless", false),
    (uids::JPEG2000, "JPEG 2000", false),
    (uids::HTJ2K_LOSSLESS, "high-throughput JPEG 2000 lossless", false),
    (uids::HTJ2K, "high-throughput JPEG 2000", false),
];

fn syntax_of(object: &DefaultDicomObject) -> Syntax {
    let uid = object.meta().transfer_syntax().trim_end_matches(['\0', ' ']);
    let known = SYNTAXES.into_iter().find(|s| s.0 == uid);
    known.map_or(Syntax { name: "an unknown transfer syntax", is_plain: false }, |(_, name, is_plain)| {
        Syntax { name, is_plain }
    })
}

/// The attributes of one file.
struct Attributes<'a> {
    path: &'a Path,
    object: &'a DefaultDicomObject,
    pixel_bytes: Option<u64>,
}

impl Attributes<'_> {
    fn content(&self) -> Result<Content, Error> {
        let class = self.text(tags::SOP_CLASS_UID);
        let is_image_class = IMAGE_CLASSES.contains(&class.as_str());
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
        self.refuse_unreadable_kinds()?;
        Ok(Content::Image(Box::new(self.header()?)))
    }

    fn refuse_unreadable_kinds(&self) -> Result<(), Error> {
        let n_frames = self.integer(tags::NUMBER_OF_FRAMES)?.unwrap_or(1);
        if n_frames > 1 {
            return Err(self.unsupported(format!("a multi-frame image ({n_frames} frames)")));
        }
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

    fn header(&self) -> Result<Header, Error> {
        Ok(Header {
            path: self.path.to_owned(),
            identity: [tags::SERIES_INSTANCE_UID, tags::FRAME_OF_REFERENCE_UID].map(|t| self.text(t)),
            instance: self.text(tags::SOP_INSTANCE_UID),
            number: self.integer(tags::INSTANCE_NUMBER).unwrap_or(None),
            traits: self.traits(),
            modality: self.modality(),
            shape: self.shape()?,
            axes_fault: self.axes()?.1,
            position: self.position()?,
            slab_thickness_mm: self.positive(tags::SLICE_THICKNESS)?,
            spacing_between_mm: self.number(tags::SPACING_BETWEEN_SLICES)?,
            pixels: self.pixel_format()?,
            rescale: self.rescale()?,
            padding: self.padding()?,
            is_inverted: self.text(tags::PHOTOMETRIC_INTERPRETATION) == "MONOCHROME1",
            syntax: syntax_of(self.object),
            pixel_bytes: self.pixel_bytes,
        })
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
            let found = format!("{:?}, off by {fault:.4}", [a, b, c, d, e, f]);
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
            _ => Ok(Some([slope.unwrap_or(1.0), intercept.unwrap_or(0.0)])),
        }
    }

    fn padding(&self) -> Result<Option<[i32; 2]>, Error> {
        let Some(value) = self.integer(tags::PIXEL_PADDING_VALUE)? else { return Ok(None) };
        let limit = self.integer(tags::PIXEL_PADDING_RANGE_LIMIT)?.unwrap_or(value);
        let is_signed = self.integer(tags::PIXEL_REPRESENTATION)? == Some(1);
        // Implicit VR cannot tell a signed padding value from an unsigned one.
        let signed = |v: i32| if is_signed && v > 0x7fff { v - 0x1_0000 } else { v };
        let (a, b) = (signed(value), signed(limit));
        Ok(Some([a.min(b), a.max(b)]))
    }

    /// The modality, or OT where the header holds anything but the code of one that makes planes.
    fn modality(&self) -> String {
        let code = self.text(tags::MODALITY);
        if MODALITIES.contains(&code.as_str()) { code } else { "OT".into() }
    }

    /// Text of an attribute, empty where it is absent.
    fn text(&self, tag: Tag) -> String {
        let value = self.object.get(tag).and_then(|e| e.to_str().ok());
        value.map(|s| s.trim_matches([' ', '\0']).to_owned()).unwrap_or_default()
    }

    /// An integer; `None` where the attribute is absent or empty.
    fn integer(&self, tag: Tag) -> Result<Option<i32>, Error> {
        let Some(element) = self.object.get(tag).filter(|_| !self.is_blank(tag)) else {
            return Ok(None);
        };
        let value = element.to_int::<i32>().ok();
        value.map(Some).ok_or_else(|| damaged(self.path, "an integer attribute holds something else"))
    }

    /// A finite number; `None` where the attribute is absent or empty.
    fn number(&self, tag: Tag) -> Result<Option<f64>, Error> {
        let Some(element) = self.object.get(tag).filter(|_| !self.is_blank(tag)) else {
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
        let element =
            self.object.get(tag).filter(|_| !self.is_blank(tag)).ok_or_else(|| self.missing(name))?;
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
        Error::BadAttribute { path: self.path.to_owned(), attribute, found: format!("{found:?}"), expected }
    }

    fn unsupported(&self, what: String) -> Error {
        Error::UnsupportedImage { path: self.path.to_owned(), what }
    }
}
