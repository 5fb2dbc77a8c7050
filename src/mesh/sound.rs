//! A solid to a mesh that is fit for files: closed, within the deflection, and meeting itself nowhere.
//!
//! Faces are meshed one by one, each within the deflection of its surface. Where two parts of the skin lie closer
//! together than that, or a surface bends within it, their triangles may still meet. Such places are found (exactly,
//! [`super::intersect`]) and meshed again with a smaller deflection there, which grows again with the distance from them,
//! for as long as fewer triangles meet each time. Where more of them do, it depends on where vertices happen to lie, and
//! everything is meshed again for a somewhat smaller deflection, in the end row by row: how far
//! that mesh is off is measured. What does not become sound then is refused with its place: the finer the mesh of a
//! surface that crosses itself, the more triangles meet.
//!
//! A patch between edges that it shares all round may need more points on them to keep the deflection: it gets them by
//! the same smaller deflection over it.
//!
//! The loop ends: patches are asked three times, the number of meeting triangles falls with every round at one deflection, and of these there are four.

use super::chart::Finer;
use super::intersect::{self, Intersection};
use super::measure::{Deviation, farthest};
use super::tessellate::{Tessellation, mesh_once};
use super::{Deflection, Error, Parted, SkinChoice, TriMesh, closed_in_files, fit_for_files, rows};
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

/// A mesh with more than so many times the triangles of the first one is not refined any more: what meets is no matter of
/// how fine it is.
const MOST_GROWTH: usize = 8;

/// Shares of the deflection at which rows are set, one after the other until their mesh keeps it.
const ROW_SHARES: [f64; 4] = [0.5, 0.25, 0.12, 0.06];

/// Meshes a solid: closed, nowhere meeting itself, no point of the surface farther than the deflection from its
/// triangles. The vertices are as a file of 32-bit floats holds them.
///
/// # Errors
/// A deflection out of range, an interruption, or a solid for which no mesh is sound or none of those keeps the deflection,
/// with the place.
pub fn tessellate(solid: &Solid, how: &Tessellation, task: &Task<'_>) -> Result<TriMesh, Error> {
    Ok(parted(solid, how, task)?.kept(how.deflection)?.mesh)
}

impl Parted {
    /// The mesh, if it keeps the deflection that was asked for. One that is made for a fraction of the size always does.
    ///
    /// # Errors
    /// [`Error::Deviates`].
    pub fn kept(self, asked: Deflection) -> Result<Self, Error> {
        match (self.deviation, asked) {
            (Some(found), Deflection::Absolute { mm: asked_mm }) => Err(Error::Deviates { asked_mm, found }),
            _ => Ok(self),
        }
    }
}

/// The same, and what each triangle bounds. Where no sound mesh is found for a deflection in mm, the solid is meshed row
/// by row, ever finer until that mesh is found to keep the deflection; where none does, the best is taken, and how far it
/// is off is told.
///
/// # Errors
/// A deflection out of range, an interruption, or a solid for which no mesh is sound, with the place.
pub fn parted(solid: &Solid, how: &Tessellation, task: &Task<'_>) -> Result<Parted, Error> {
    how.deflection.check()?;
    // On a thread of the pool: one from outside it would wait for another one to wake at every parallel step.
    rayon::scope(|_| until_sound(solid, how, task))
}

fn until_sound(solid: &Solid, how: &Tessellation, task: &Task<'_>) -> Result<Parted, Error> {
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
        return match (found, how.deflection) {
            (Err(error), Deflection::Absolute { mm }) if is_by_chance => {
                row_by_row(solid, how.skin, mm, task)?.ok_or(error)
            }
            (found, _) => found,
        };
    }
}

/// The last resort, where a surface all but folds: rows of triangles. `None` where those are unsound, too.
pub(super) fn row_by_row(
    solid: &Solid,
    skin: SkinChoice,
    deflection_mm: f64,
    task: &Task<'_>,
) -> Result<Option<Parted>, Error> {
    let mut best: Option<(Parted, Deviation)> = None;
    for share in ROW_SHARES {
        let rows = rows::tessellate(solid, skin, share * deflection_mm, task);
        let rows = match rows.and_then(|rows| Ok((fit_for_files(&rows.mesh, task)?, rows))) {
            Err(Error::Cancelled(why)) => return Err(why.into()),
            Err(_unsound) => continue,
            Ok((mesh, rows)) => rows.with(mesh),
        };
        let found = farthest(solid, skin, &rows.mesh, deflection_mm, task)?;
        if found.mm <= deflection_mm {
            return Ok(Some(rows));
        }
        if best.as_ref().is_none_or(|(_, known)| found.mm < known.mm) {
            best = Some((rows, found));
        }
    }
    Ok(best.map(|(rows, found)| Parted { deviation: Some(found), ..rows }))
}

/// Meshes a solid, again and again with less deflection where triangles meet, while they become fewer.
fn mended(solid: &Solid, how: &Tessellation, task: &Task<'_>) -> Result<Parted, Error> {
    let mut finer = Vec::new();
    let (mut fewest, mut n_most) = (usize::MAX, None);
    loop {
        let made = match mesh_once(solid, how, &finer, task) {
            Err(Error::NotKept { patch: Some(patch), .. }) if densify(&mut finer, patch, how.deflection) => {
                continue;
            }
            found => found?,
        };
        let mesh = closed_in_files(&made.mesh)?;
        let met = intersect::of_closed(&mesh, task)?;
        let Some(first) = met.first() else { return Ok(made.with(mesh)) };
        let most = *n_most.get_or_insert(MOST_GROWTH * mesh.triangles.len());
        if met.len() >= fewest
            || mesh.triangles.len() > most
            || !refine(&mut finer, &mesh, &met, how.deflection)
        {
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
