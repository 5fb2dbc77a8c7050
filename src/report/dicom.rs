//! The document of a report as a DICOM object for the patient's study: Encapsulated PDF (PS3.3 A.45.1).
//!
//! Whose study it is is read from the CT's own headers at that moment, goes into the object and nowhere else: the document
//! itself names nobody. The object is a series and an instance of its own, refers to the images that it was made from, and is
//! not verified by anybody. Text is written as UTF-8.
//!
//! Not done here: sending it to an archive.

use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::mem::InMemElement;
use dicom_object::{DefaultDicomObject, FileMetaTableBuilder, InMemDicomObject};

/// What is copied from the CT: patient and study. Those of type 2 are there even where the CT says nothing.
const IDENTITY: [(Tag, VR, bool); 11] = [
    (tags::STUDY_DATE, VR::DA, true),
    (tags::STUDY_TIME, VR::TM, true),
    (tags::ACCESSION_NUMBER, VR::SH, true),
    (tags::REFERRING_PHYSICIAN_NAME, VR::PN, true),
    (tags::STUDY_DESCRIPTION, VR::LO, false),
    (tags::PATIENT_NAME, VR::PN, true),
    (tags::PATIENT_ID, VR::LO, true),
    (tags::ISSUER_OF_PATIENT_ID, VR::LO, false),
    (tags::PATIENT_BIRTH_DATE, VR::DA, true),
    (tags::PATIENT_SEX, VR::CS, true),
    (tags::STUDY_ID, VR::SH, true),
];
/// Far behind the series of a scanner, so that it is not taken for one.
const SERIES_NUMBER: &str = "9001";
const TITLE: &str = "Quality report of a lumen replica";

/// Why no object could be made. None of these says who the patient is.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no header.
    #[error("--source: found no DICOM image there, expected the CT that the case was made from")]
    NoImage,
    /// A header belongs to no study.
    #[error(
        "--source: an image has no study instance UID (0020,000D): a report can be filed in a study only"
    )]
    NoStudy,
    /// More than one patient or study.
    #[error(
        "--source: found the images of {n} studies or patients there, expected those of one: name the folder of the CT's series"
    )]
    SeveralStudies {
        /// How many.
        n: usize,
    },
    /// The library could not write the object.
    #[error("the report's DICOM object could not be written: {0}")]
    Object(String),
}

/// New identifiers of a series with one instance, and when it is made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Instance {
    /// The series.
    pub series_uid: String,
    /// The object.
    pub instance_uid: String,
    /// Local time.
    pub created: jiff::civil::DateTime,
}

impl Instance {
    /// UIDs of 128 bits under 2.25 (PS3.5 B.2).
    #[must_use]
    pub fn of_uuids(series: u128, instance: u128, created: jiff::civil::DateTime) -> Self {
        Self { series_uid: format!("2.25.{series}"), instance_uid: format!("2.25.{instance}"), created }
    }
}

/// The document as an object of the study that the headers belong to. `sources` are the headers of the CT's images.
///
/// # Errors
/// [`Error`]: no header, headers of no study or of several, an object that cannot be written.
pub fn encapsulated(
    sources: &[InMemDicomObject],
    pdf: &[u8],
    instance: &Instance,
) -> Result<DefaultDicomObject, Error> {
    let first = sources.first().ok_or(Error::NoImage)?;
    let study = value(first, tags::STUDY_INSTANCE_UID).ok_or(Error::NoStudy)?;
    check_one_study(sources)?;
    let copied = IDENTITY.into_iter().filter_map(|(tag, vr, always)| {
        let found = value(first, tag);
        (always || found.is_some()).then(|| text(tag, vr, found.unwrap_or_default()))
    });
    let elements = copied
        .chain([text(tags::STUDY_INSTANCE_UID, VR::UI, study)])
        .chain(own(instance))
        .chain(document(pdf))
        .chain(references(sources));
    let meta = FileMetaTableBuilder::new().transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
    // The library's words may quote what identifies a patient.
    InMemDicomObject::from_element_iter(elements)
        .with_meta(meta)
        .map_err(|_private| Error::Object("its header is not complete".into()))
}

/// A text of a header without padding; `None` where it is missing or empty.
fn value(header: &InMemDicomObject, tag: Tag) -> Option<String> {
    let text = header.get(tag)?.to_str().ok()?.trim_matches(['\0', ' ']).to_owned();
    (!text.is_empty()).then_some(text)
}

fn check_one_study(sources: &[InMemDicomObject]) -> Result<(), Error> {
    let whose = |header: &InMemDicomObject| {
        [tags::STUDY_INSTANCE_UID, tags::PATIENT_ID, tags::PATIENT_NAME].map(|tag| value(header, tag))
    };
    let mut found: Vec<_> = sources.iter().map(whose).collect();
    found.sort();
    found.dedup();
    if found.iter().any(|w| w[0].is_none()) {
        return Err(Error::NoStudy);
    }
    if found.len() > 1 { Err(Error::SeveralStudies { n: found.len() }) } else { Ok(()) }
}

fn text(tag: Tag, vr: VR, value: impl Into<String>) -> InMemElement {
    DataElement::new(tag, vr, PrimitiveValue::from(value.into()))
}

/// Series, equipment and the object itself.
fn own(instance: &Instance) -> Vec<InMemElement> {
    let (date, time) =
        (instance.created.strftime("%Y%m%d").to_string(), instance.created.strftime("%H%M%S").to_string());
    vec![
        text(tags::SPECIFIC_CHARACTER_SET, VR::CS, "ISO_IR 192"),
        text(tags::SOP_CLASS_UID, VR::UI, uids::ENCAPSULATED_PDF_STORAGE),
        text(tags::SOP_INSTANCE_UID, VR::UI, instance.instance_uid.as_str()),
        text(tags::INSTANCE_CREATION_DATE, VR::DA, date.as_str()),
        text(tags::INSTANCE_CREATION_TIME, VR::TM, time.as_str()),
        text(tags::CONTENT_DATE, VR::DA, date),
        text(tags::CONTENT_TIME, VR::TM, time),
        text(tags::ACQUISITION_DATE_TIME, VR::DT, ""),
        text(tags::MODALITY, VR::CS, "DOC"),
        text(tags::CONVERSION_TYPE, VR::CS, "SYN"),
        text(tags::MANUFACTURER, VR::LO, "lumenfab"),
        text(tags::SOFTWARE_VERSIONS, VR::LO, env!("CARGO_PKG_VERSION")),
        text(tags::SERIES_DESCRIPTION, VR::LO, TITLE),
        text(tags::SERIES_INSTANCE_UID, VR::UI, instance.series_uid.as_str()),
        text(tags::SERIES_NUMBER, VR::IS, SERIES_NUMBER),
        text(tags::INSTANCE_NUMBER, VR::IS, "1"),
    ]
}

fn document(pdf: &[u8]) -> Vec<InMemElement> {
    let mut padded = pdf.to_vec();
    // Values have even lengths; how long the document is without its padding stands beside it.
    padded.resize(pdf.len().next_multiple_of(2), 0);
    let length = u32::try_from(pdf.len()).unwrap_or(u32::MAX);
    let nothing = DataSetSequence::from(Vec::<InMemDicomObject>::new());
    vec![
        // The document names nobody.
        text(tags::BURNED_IN_ANNOTATION, VR::CS, "NO"),
        text(tags::VERIFICATION_FLAG, VR::CS, "UNVERIFIED"),
        text(tags::DOCUMENT_TITLE, VR::ST, TITLE),
        DataElement::new(tags::CONCEPT_NAME_CODE_SEQUENCE, VR::SQ, nothing),
        text(tags::MIME_TYPE_OF_ENCAPSULATED_DOCUMENT, VR::LO, "application/pdf"),
        DataElement::new(tags::ENCAPSULATED_DOCUMENT, VR::OB, PrimitiveValue::from(padded)),
        DataElement::new(tags::ENCAPSULATED_DOCUMENT_LENGTH, VR::UL, PrimitiveValue::from(length)),
    ]
}

/// The images that the report was made from.
fn references(sources: &[InMemDicomObject]) -> Option<InMemElement> {
    let reference = |header: &InMemDicomObject| {
        let (class, instance) = (value(header, tags::SOP_CLASS_UID)?, value(header, tags::SOP_INSTANCE_UID)?);
        Some(InMemDicomObject::from_element_iter([
            text(tags::REFERENCED_SOP_CLASS_UID, VR::UI, class),
            text(tags::REFERENCED_SOP_INSTANCE_UID, VR::UI, instance),
        ]))
    };
    let items: Vec<InMemDicomObject> = sources.iter().filter_map(reference).collect();
    (!items.is_empty())
        .then(|| DataElement::new(tags::SOURCE_INSTANCE_SEQUENCE, VR::SQ, DataSetSequence::from(items)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(changes: &[(Tag, VR, &str)]) -> InMemDicomObject {
        let usual = [
            (tags::SOP_CLASS_UID, VR::UI, uids::CT_IMAGE_STORAGE),
            (tags::SOP_INSTANCE_UID, VR::UI, "1.2.3.4"),
            (tags::STUDY_INSTANCE_UID, VR::UI, "1.2.3"),
            (tags::STUDY_DATE, VR::DA, "20260401"),
            (tags::PATIENT_NAME, VR::PN, "M\u{fc}ller^Ada"),
            (tags::PATIENT_ID, VR::LO, "P 17"),
            (tags::PATIENT_BIRTH_DATE, VR::DA, "19500102"),
            (tags::ACCESSION_NUMBER, VR::SH, "A9"),
        ];
        let all = usual.iter().chain(changes).map(|&(tag, vr, value)| text(tag, vr, value));
        InMemDicomObject::from_element_iter(all)
    }

    fn instance() -> Instance {
        Instance::of_uuids(7, 8, jiff::civil::date(2026, 5, 6).at(7, 8, 9, 0))
    }

    fn said(object: &InMemDicomObject, tag: Tag) -> String {
        object.element(tag).unwrap().to_str().unwrap().into_owned()
    }

    #[test]
    fn the_object_belongs_to_the_patient_s_study_and_to_a_series_of_its_own() {
        let object = encapsulated(&[header(&[])], b"%PDF-1", &instance()).unwrap();
        let same = [tags::STUDY_INSTANCE_UID, tags::PATIENT_NAME, tags::PATIENT_ID, tags::PATIENT_BIRTH_DATE];
        for tag in same.into_iter().chain([tags::STUDY_DATE, tags::ACCESSION_NUMBER]) {
            assert_eq!(said(&object, tag), said(&header(&[]), tag));
        }
        for tag in [tags::STUDY_TIME, tags::REFERRING_PHYSICIAN_NAME, tags::PATIENT_SEX, tags::STUDY_ID] {
            assert_eq!(said(&object, tag), "");
        }
        assert!(object.get(tags::STUDY_DESCRIPTION).is_none());
        assert_eq!(said(&object, tags::SERIES_INSTANCE_UID), "2.25.7");
        assert_eq!(object.meta().media_storage_sop_instance_uid.trim_end_matches('\0'), "2.25.8");
        assert_eq!(
            object.meta().media_storage_sop_class_uid.trim_end_matches('\0'),
            "1.2.840.10008.5.1.4.1.1.104.1"
        );
        assert_eq!(
            (said(&object, tags::CONTENT_DATE), said(&object, tags::CONTENT_TIME)),
            ("20260506".into(), "070809".into())
        );
    }

    #[test]
    fn the_document_comes_back_from_the_file_with_its_length() {
        let object = encapsulated(&[header(&[]), header(&[])], b"%PDF-odd!", &instance()).unwrap();
        let mut file = Vec::new();
        object.write_all(&mut file).unwrap();
        let read = dicom_object::from_reader(file.as_slice()).unwrap();
        assert_eq!(
            read.element(tags::ENCAPSULATED_DOCUMENT).unwrap().to_bytes().unwrap()[..],
            b"%PDF-odd!\0"[..]
        );
        assert_eq!(read.element(tags::ENCAPSULATED_DOCUMENT_LENGTH).unwrap().to_int::<u32>().unwrap(), 9);
        assert_eq!(said(&read, tags::PATIENT_NAME), "M\u{fc}ller^Ada");
        assert_eq!(read.element(tags::SOURCE_INSTANCE_SEQUENCE).unwrap().items().unwrap().len(), 2);
    }

    #[test]
    fn it_goes_into_one_study_or_nowhere() {
        let made = |sources: &[InMemDicomObject]| encapsulated(sources, b"%PDF", &instance());
        assert!(matches!(made(&[]), Err(Error::NoImage)));
        let without = header(&[(tags::STUDY_INSTANCE_UID, VR::UI, "")]);
        assert!(matches!(made(std::slice::from_ref(&without)), Err(Error::NoStudy)));
        assert!(matches!(made(&[header(&[]), without]), Err(Error::NoStudy)));
        let of_another = header(&[(tags::PATIENT_ID, VR::LO, "P 18")]);
        let error = made(&[header(&[]), of_another]).unwrap_err();
        assert!(matches!(error, Error::SeveralStudies { n: 2 }));
        assert!(!error.to_string().contains("P 1"));
    }
}
