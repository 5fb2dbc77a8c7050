//! A solid to a mesh that is fit for files: closed, within the deflection, and meeting itself nowhere.
//!
//! Faces are meshed one by one, each within the deflection of its surface. Where two parts of the skin lie closer
//! together than that, or a surface bends within it, their triangles may still meet. Such places are found (exactly,
//! [`super::intersect`]) and meshed again with a smaller deflection there, which grows again with the distance from them,
//! for as long as fewer triangles meet each time. Where more of them do, it depends on where vertices happen to lie, and
//! everything is meshed again for a somewhat smaller deflection, in the end row by row. What does not become sound then is refused with its
//! place: the finer the mesh of a surface that crosses itself, the more triangles meet.
//!
//! A patch between edges that it shares all round may need more points on them to keep the deflection: it gets them by
//! the same smaller deflection over it.
//!
//! The loop ends: patches are asked three times, the number of meeting triangles falls with every round at one deflection, and of these there are four.

use super::chart::Finer;
use super::intersect::{self, Intersection};
use super::tessellate::{Tessellation, mesh_once};
use super::{Deflection, Error, TriMesh, closed_in_files, fit_for_files, rows};
use crate::geom::Point3;
use crate::progress::Task;
use crate::solid::Solid;

/// By how much the deflection falls at a place where triangles meet.
const FALL: f64 = 0.25;
/// By how much it falls everywhere, where that does not help.
const FALL_EVERYWHERE: f64 = 0.8;
/// Least share of the deflection, everywhere.
const LEAST_EVERYWHERE: f64 = 0.5;
/// A smaller deflection than this at some place, mm, is lost in the rounding of a file's coordinates.
const LEAST_MM: f64 = 1e-5;
/// Least share of the deflection on the edges of a patch that does not keep it.
const LEAST_ON_PATCH: f64 = 0.01;
/// A place reaches so many times as far as the triangles that meet there.
const REACH: f64 = 1.0;

/// Meshes a solid: closed, nowhere meeting itself, no point of the surface farther than the deflection from its
/// triangles. The vertices are as a file of 32-bit floats holds them. Where no such mesh is found for a deflection in mm,
/// the solid is meshed row by row: sound as well, but with chords within the deflection only.
///
/// # Errors
/// A deflection out of range, an interruption, or a solid for which no mesh is sound, with the place.
pub fn tessellate(solid: &Solid, how: &Tessellation, task: &Task<'_>) -> Result<TriMesh, Error> {
    how.deflection.check()?;
    let mut share = 1.0;
    loop {
        let deflection = how.deflection.times(share);
        let found = mended(solid, &Tessellation { deflection, ..*how }, task);
        share *= FALL_EVERYWHERE;
        let is_by_chance =
            matches!(found, Err(Error::NotKept { .. } | Error::Open(_) | Error::SelfIntersecting { .. }));
        if is_by_chance && share >= LEAST_EVERYWHERE {
            continue;
        }
        return if is_by_chance { found.or_else(|error| row_by_row(solid, how, task, error)) } else { found };
    }
}

/// The last resort, where a surface all but folds: rows of triangles at half the deflection, with chords within it only.
fn row_by_row(solid: &Solid, how: &Tessellation, task: &Task<'_>, error: Error) -> Result<TriMesh, Error> {
    let Deflection::Absolute { mm } = how.deflection else { return Err(error) };
    match rows::tessellate(solid, how.skin, 0.5 * mm, task).and_then(|mesh| fit_for_files(&mesh, task)) {
        Err(Error::Cancelled(c)) => Err(Error::Cancelled(c)),
        found => found.map_err(|_unsound| error),
    }
}

/// Meshes a solid, again and again with less deflection where triangles meet, while they become fewer.
fn mended(solid: &Solid, how: &Tessellation, task: &Task<'_>) -> Result<TriMesh, Error> {
    let mut finer = Vec::new();
    let mut fewest = usize::MAX;
    loop {
        let mesh = match mesh_once(solid, how, &finer, task) {
            Err(Error::NotKept { patch: Some(patch), .. }) if densify(&mut finer, patch, how.deflection) => {
                continue;
            }
            found => closed_in_files(&found?)?,
        };
        let met = intersect::of_closed(&mesh, task)?;
        let Some(first) = met.first() else { return Ok(mesh) };
        if met.len() >= fewest || !refine(&mut finer, &mesh, &met, how.deflection) {
            return Err(Error::SelfIntersecting { n: met.len(), at: first.at });
        }
        fewest = met.len();
    }
}

/// Asks for less deflection over a patch that did not keep it, so that the edges that it shares get more points: they
/// cannot be divided later. `false` where that did not help before.
fn densify(finer: &mut Vec<Finer>, (at, radius_mm): (Point3, f64), asked: Deflection) -> bool {
    let asked_mm = asked.near_mm(radius_mm);
    let deflection_mm = FALL * finer.iter().map(|f| f.allows(at)).fold(asked_mm, f64::min);
    finer.push(Finer { at, radius_mm, deflection_mm });
    deflection_mm >= LEAST_ON_PATCH * asked_mm
}

/// Asks for less deflection where triangles meet; `false` where it would be too little.
fn refine(finer: &mut Vec<Finer>, mesh: &TriMesh, met: &[Intersection], asked: Deflection) -> bool {
    let mut added: Vec<Finer> = Vec::new();
    for m in met {
        let longest_mm = m.triangles.iter().map(|&t| longest_mm(mesh, t)).fold(0.0, f64::max);
        let present_mm = finer.iter().map(|f| f.allows(m.at)).fold(asked.near_mm(longest_mm), f64::min);
        let place = Finer { at: m.at, radius_mm: REACH * longest_mm, deflection_mm: FALL * present_mm };
        // One place serves all that meet close by.
        let serves = |f: &Finer| (f.at - place.at).norm() + 0.5 * place.radius_mm <= f.radius_mm;
        if !added.iter().any(serves) {
            added.push(place);
        }
    }
    let is_enough = added.iter().all(|f| f.deflection_mm >= LEAST_MM);
    finer.extend(added);
    is_enough
}

/// The longest edge of a triangle, mm.
fn longest_mm(mesh: &TriMesh, t: u32) -> f64 {
    let corners = mesh.triangles[t as usize].map(|v| mesh.vertices[v as usize]);
    (0..3).map(|i| (corners[(i + 1) % 3] - corners[i]).norm()).fold(0.0, f64::max)
}
