//! What a DICOM file of a segmentation is; the attributes that both kinds share.

use super::{Error, Label, Ready, rtstruct, seg};
use crate::ct::FrameOfReference;
use crate::ct::axes::orthonormal;
use crate::ct::reader::is_dicom;
use crate::geom::{Point3, Vector3};
use crate::progress::Task;
use dicom_core::Tag;
use dicom_dictionary_std::{tags, uids};
use dicom_object::InMemDicomObject;
use std::path::{Path, PathBuf};

/// Reads a DICOM SEG or RTSTRUCT.
pub(super) fn load(path: &Path, label: Option<&Label>, task: &Task<'_>) -> Result<Ready, Error> {
    let unreadable = |source| crate::ct::Error::Read { path: path.to_owned(), source };
    // A pipe or a device may never end.
    if !path.is_file() || !is_dicom(path).map_err(unreadable)? {
        return Err(Error::Foreign(path.to_owned()));
    }
    let place = Place(path);
    let object = crate::ct::reader::open_whole(path)?;
    task.check()?;
    // A file without preamble states it in its data set alone.
    let class = text(&object, tags::SOP_CLASS_UID);
    let stated = object.meta().media_storage_sop_class_uid();
    match class.as_deref().unwrap_or(stated).trim_end_matches(['\0', ' ']) {
        uids::SEGMENTATION_STORAGE => seg::ready(place, &object, label, task),
        uids::RT_STRUCTURE_SET_STORAGE => rtstruct::ready(place, &object, label, task),
        _ => Err(Error::Foreign(path.to_owned())),
    }
}

/// The file, for errors.
#[derive(Clone, Copy)]
pub(super) struct Place<'a>(pub(super) &'a Path);

impl Place<'_> {
    pub(super) fn path(self) -> PathBuf {
        self.0.to_owned()
    }

    pub(super) fn fault(self, what: impl Into<String>) -> Error {
        Error::Dicom { path: self.path(), what: what.into() }
    }

    pub(super) fn missing(self, attribute: &str) -> Error {
        self.fault(format!("attribute {attribute} is missing or unreadable: export the segmentation again"))
    }
}

/// The items of a sequence; none where it is not there.
pub(super) fn items(object: &InMemDicomObject, tag: Tag) -> &[InMemDicomObject] {
    object.get(tag).and_then(|e| e.items()).unwrap_or_default()
}

/// The frame that an attribute names.
pub(super) fn frame_of_reference(object: &InMemDicomObject, tag: Tag) -> FrameOfReference {
    FrameOfReference::new(&text(object, tag).unwrap_or_default())
}

pub(super) fn text(object: &InMemDicomObject, tag: Tag) -> Option<String> {
    object.get(tag)?.to_str().ok().map(|t| t.trim_end_matches(['\0', ' ']).to_owned())
}

/// A whole number from 0, whether it stands in binary or in text.
pub(super) fn whole(object: &InMemDicomObject, tag: Tag) -> Option<u32> {
    let element = object.get(tag)?;
    element.to_int::<i64>().ok().and_then(|n| u32::try_from(n).ok())
}

pub(super) fn numbers(object: &InMemDicomObject, tag: Tag) -> Option<Vec<f64>> {
    let numbers = object.get(tag)?.to_multi_float64().ok()?;
    numbers.iter().all(|v| v.is_finite() && v.abs() < 1e6).then_some(numbers)
}

pub(super) fn point(object: &InMemDicomObject, tag: Tag) -> Option<Point3> {
    match numbers(object, tag)?.as_slice() {
        &[x, y, z] => Some(Point3::new(x, y, z)),
        _ => None,
    }
}

/// Two orthogonal unit vectors: the nearest to those stated, within what is allowed to a CT.
///
/// # Errors
/// How far the stated ones are from such; `None` where they are no six numbers.
pub(super) fn directions(object: &InMemDicomObject, tag: Tag) -> Result<[Vector3; 2], Option<f64>> {
    match numbers(object, tag).as_deref() {
        Some(&[a, b, c, d, e, f]) => {
            orthonormal(Vector3::new(a, b, c), Vector3::new(d, e, f)).map(|(axes, _)| axes).map_err(Some)
        }
        _ => Err(None),
    }
}
