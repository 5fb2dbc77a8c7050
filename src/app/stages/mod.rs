//! The stages, each from files of the case to files of the case.

pub mod export;
pub mod print;
pub mod report;
pub mod segment;
pub mod slice;
pub mod solid;

use super::atomic;
use super::case::CaseError;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// A document of the case, as it is written.
pub(crate) fn to_json(value: &impl Serialize) -> Vec<u8> {
    let mut bytes =
        serde_json::to_vec(value).expect("documents of a case hold numbers, names and lists of them");
    bytes.push(b'\n');
    bytes
}

/// Reads a document of the case.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, CaseError> {
    let text = atomic::read_text(path)?;
    let problem = |e: serde_json::Error| CaseError::Corrupt { path: path.to_owned(), problem: e.to_string() };
    serde_json::from_str(&text).map_err(problem)
}
