//! STL in both of its forms: binary (80 bytes of heading, a count, 50 bytes a triangle) and text (`solid ... endsolid`).
//!
//! Which form a file has, its length tells: where it is that of a binary file of as many triangles as it says, it is one,
//! whatever its heading begins with; some programs begin binary files with `solid`. Normals, attributes and names are
//! not read: the corners say all.

use super::Facet;
use rayon::prelude::*;

const HEADING_BYTES: usize = 80;
const START: usize = HEADING_BYTES + 4;
const TRIANGLE_BYTES: usize = 50;

/// The bytes are no STL.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StlError {
    /// Neither form.
    #[error(
        "it is no STL: it neither begins with `solid` nor has the {expected} bytes that a binary file of {n_triangles} triangles has (found {found}): export the model again as STL"
    )]
    Length {
        /// Triangles that the heading declares.
        n_triangles: u32,
        /// Bytes that so many take.
        expected: u64,
        /// Bytes that there are.
        found: u64,
    },
    /// Too short for a heading.
    #[error("it is no STL: it has only {0} bytes: export the model again as STL")]
    TooShort(usize),
    /// A line of the text form.
    #[error("line {line}: found {found:?}, expected {expected}: export the model again as STL")]
    Line {
        /// The line, counted from 1.
        line: usize,
        /// What it says.
        found: String,
        /// What it should say.
        expected: &'static str,
    },
}

/// The triangles of a file.
///
/// # Errors
/// [`StlError`].
pub fn read(bytes: &[u8]) -> Result<Vec<Facet>, StlError> {
    let binary = declared(bytes);
    if binary.is_some_and(|(_, expected)| expected == bytes.len() as u64) {
        return Ok(bytes[START..].par_chunks_exact(TRIANGLE_BYTES).map(facet).collect());
    }
    if bytes.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid")) {
        return text(&String::from_utf8_lossy(bytes));
    }
    let (n_triangles, expected) = binary.ok_or(StlError::TooShort(bytes.len()))?;
    Err(StlError::Length { n_triangles, expected, found: bytes.len() as u64 })
}

/// How many triangles a binary file would have, and how many bytes.
fn declared(bytes: &[u8]) -> Option<(u32, u64)> {
    let count = bytes.get(HEADING_BYTES..START)?.try_into().ok()?;
    let n = u32::from_le_bytes(count);
    Some((n, START as u64 + TRIANGLE_BYTES as u64 * u64::from(n)))
}

fn facet(record: &[u8]) -> Facet {
    let number = |at: usize| f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]);
    [0, 1, 2].map(|corner| [0, 1, 2].map(|k| number(12 + 12 * corner + 4 * k)))
}

/// The text form: of every line that begins with `vertex` three numbers.
fn text(text: &str) -> Result<Vec<Facet>, StlError> {
    let mut corners: Vec<[f32; 3]> = Vec::new();
    let mut facets = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let fault = |expected| {
            let found = line.trim().chars().take(40).collect();
            Err(StlError::Line { line: number + 1, found, expected })
        };
        let mut words = line.split_ascii_whitespace();
        let Some(word) = words.next() else { continue };
        match word.to_ascii_lowercase().as_str() {
            "vertex" => {
                let numbers: Vec<f32> = words.map_while(|w| w.parse().ok()).collect();
                let Ok(corner) = <[f32; 3]>::try_from(numbers) else {
                    return fault("`vertex` and three numbers");
                };
                corners.push(corner);
            }
            "endloop" => match <[[f32; 3]; 3]>::try_from(std::mem::take(&mut corners)) {
                Ok(triangle) => facets.push(triangle),
                Err(_) => return fault("three `vertex` lines before `endloop`"),
            },
            "solid" | "endsolid" | "facet" | "endfacet" | "outer" => {}
            _ => return fault("solid, facet, outer loop, vertex, endloop, endfacet or endsolid"),
        }
    }
    Ok(facets)
}
