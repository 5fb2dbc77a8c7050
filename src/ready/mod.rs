//! Segmentations made elsewhere to contours per plane: label maps, DICOM SEG, RTSTRUCT.
//!
//! A label map becomes curves between its pixels ([`crate::sections::ready`]); contours of an RTSTRUCT are taken as drawn, holes by the even-odd
//! rule, so that keyhole contours open. One structure is taken: the only one, or the one that is chosen by its number or name.
//! With a CT the planes are brought into its frame ([`place`]), without one they stand in their own.
//!
//! Names of structures serve to choose one and are shown to the operator alone, in errors: they may hold anything, so that nothing
//! that is written or sent on has them ([`Error::text_without_path`]).
//!
//! It deliberately moves no boundary: a segmentation is what its maker says. What no vessel can have is resolved as for every
//! other stack, and told: fragments, islands, holes and flicker of a plane or two ([`crate::sections::ready`]). Planes that a file leaves out
//! are empty or refused ([`gaps`]). Encapsulated (compressed) SEG objects and contours off the CT's planes are refused; open contours and
//! points are left out, and told.

mod dicom;
mod error;
pub mod gaps;
mod labels;
pub mod place;
mod rtstruct;
mod seg;
#[cfg(test)]
mod tests;

pub use error::Error;

use crate::ct::{self, FrameOfReference, Warning};
use crate::progress::Task;
use crate::sections::ready::DrawnStack;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Which structure of a file is meant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Label {
    /// By its number.
    Number(u32),
    /// By its name, capitals or not.
    Name(String),
}

/// A structure of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Structure {
    /// Its number.
    pub number: u32,
    /// Its name, where the file gives one.
    pub name: Option<String>,
    /// Voxels or contours that it has.
    pub size: usize,
    /// What `size` counts.
    pub unit: &'static str,
}

/// A ready segmentation.
#[derive(Debug, Clone, PartialEq)]
pub struct Ready {
    /// Number of the structure that was taken.
    pub number: u32,
    /// Its contours, in a stack's frame.
    pub drawn: DrawnStack,
    /// What was odd about the file.
    pub warnings: Vec<Warning>,
    /// What its coordinates refer to, as far as the file says.
    pub reference: Reference,
    /// What a plane is that it does not have.
    pub absent: Absent,
}

/// What a plane is that a file does not have between those that it has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Absent {
    /// The format has them all.
    Never,
    /// Empty: the format leaves such planes out.
    Empty,
    /// Not drawn, for whatever reason.
    Undrawn,
}

/// What tells whether a segmentation was made on a CT.
#[derive(Debug, Clone, PartialEq)]
pub enum Reference {
    /// A frame of reference, as DICOM objects state it or should.
    Frame(FrameOfReference),
    /// The grid of a label map, whose formats state no frame.
    Grid(place::Grid),
}

/// Reads the chosen structure of a file.
///
/// # Errors
/// [`Error`]: no such file, none of the kinds, damaged, several structures and none chosen, interruption.
pub fn load(path: &Path, label: Option<&Label>, task: &Task<'_>) -> Result<Ready, Error> {
    let ready = match ct::reader::load_labels(path, task)? {
        Some(map) => labels::ready(path, map, label, task),
        None => dicom::load(path, label, task),
    }?;
    let is_empty = ready.drawn.planes.iter().all(|p| p.contours.is_empty());
    if is_empty { Err(Error::Nothing(path.to_owned())) } else { Ok(ready) }
}

/// The files that [`load`] reads: the one, and that of a label map's values where they stand apart.
///
/// # Errors
/// [`Error`] where the path is no file, or a label map that cannot be used.
pub fn files_of(path: &Path) -> Result<Vec<PathBuf>, Error> {
    match ct::reader::image_files(path)? {
        Some(files) => Ok(files),
        None if path.is_file() => Ok(vec![path.to_owned()]),
        None => Err(Error::Foreign(path.to_owned())),
    }
}

/// The structure that a label means; without one, the only structure there is.
fn chosen<'a>(path: &Path, all: &'a [Structure], label: Option<&Label>) -> Result<&'a Structure, Error> {
    let is_meant = |s: &&Structure| match label {
        None => true,
        Some(Label::Number(n)) => s.number == *n,
        Some(Label::Name(name)) => {
            s.name.as_ref().is_some_and(|own| own.trim().eq_ignore_ascii_case(name.trim()))
        }
    };
    let mut meant = all.iter().filter(is_meant);
    match (meant.next(), meant.next(), label) {
        (Some(one), None, _) => Ok(one),
        (None, _, None) => Err(Error::Nothing(path.to_owned())),
        (None, _, Some(_)) => Err(Error::NoSuchLabel { path: path.to_owned(), found: all.to_owned() }),
        (Some(_), Some(_), _) => Err(Error::SeveralLabels { path: path.to_owned(), found: all.to_owned() }),
    }
}
