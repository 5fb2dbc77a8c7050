//! Where a vessel ends on one plane and begins anew on the next.
//!
//! A contour that nothing continues and, one plane up, a contour that continues nothing are an end and a beginning, or one
//! branch that was displaced or runs too steeply for its sections to overlap. Where they all but touch and are of a size
//! the operator is asked; where nothing at all goes on from a plane to the next, that is said.

use super::check::{Outline, Sheet};
use super::error::Error;
use super::link::MOST_GROWTH;
use super::stars::Joint;
use super::warning;
use crate::ct::Warning;
use crate::geom::{Contour, SegmentIndex};

/// Contours nearer to each other than this part of the smaller one's radius may be one branch: half-way to where a
/// third of its size would lie between them.
const NEAR: f64 = 0.5;

/// Asks about ends beside beginnings, and tells where the vessel is interrupted.
///
/// # Errors
/// [`Error::Undecided`], for the lowest pair.
pub(super) fn check(
    sheets: &[Sheet],
    joints: &[Vec<Joint>],
    warnings: &mut Vec<Warning>,
) -> Result<(), Error> {
    let number = |k: usize| sheets[k].given.unwrap_or(k);
    for (k, interval) in joints.iter().enumerate() {
        let goes_on = |o: usize, up: bool| is_joined(joints, k, o, up);
        // One that continues nothing on either side is an island, which is left out.
        let ends = outer(&sheets[k]).filter(|&o| !goes_on(o, true) && (k == 0 || comes_from(joints, k, o)));
        let last = k + 1 == joints.len();
        let begins = |o: &usize| !goes_on(*o, false) && (last || is_joined(joints, k + 1, *o, true));
        let begins: Vec<usize> = outer(&sheets[k + 1]).filter(begins).collect();
        for (lower, &upper) in ends.flat_map(|lower| begins.iter().map(move |upper| (lower, upper))) {
            let [a, b] = [&sheets[k].outlines[lower], &sheets[k + 1].outlines[upper]];
            let is_decided = interval.iter().any(|j| (j.lower, j.upper) == (lower, upper));
            let Some(gap_mm) = gap_mm(a, b).filter(|_| !is_decided) else { continue };
            let why = format!(
                "the one ends where the other begins, {gap_mm:.2} mm beside it, and nothing else continues either"
            );
            let (lower_plane, upper_plane) = (number(k), number(k + 1));
            return Err(Error::Undecided { lower_plane, upper_plane, lower: a.number, upper: b.number, why });
        }
        if !interval.iter().any(|j| j.joined) {
            let (below, above) = (number(k), number(k + 1));
            let text = format!(
                "planes {below} and {above} (z {:.3} and {:.3} mm): nothing continues from the one to the other: the \
                 vessel is closed there and begins anew; where two contours are one branch say so in case.toml: \
                 [[topology.link]] plane = {below}, lower = .., upper = .., join = true",
                sheets[k].z_mm,
                sheets[k + 1].z_mm
            );
            warnings.push(warning("topology.interrupted", text));
        }
    }
    Ok(())
}

fn outer(sheet: &Sheet) -> impl Iterator<Item = usize> + '_ {
    (0..sheet.outlines.len()).filter(|&o| sheet.outlines[o].contour.is_ccw())
}

/// Whether something in interval k continues the outline: of its lower plane (`up`), or of its upper one.
fn is_joined(joints: &[Vec<Joint>], k: usize, outline: usize, up: bool) -> bool {
    joints[k].iter().any(|j| j.joined && outline == if up { j.lower } else { j.upper })
}

fn comes_from(joints: &[Vec<Joint>], k: usize, outline: usize) -> bool {
    is_joined(joints, k - 1, outline, false)
}

/// How far two contours of a size lie apart, mm (0 where they meet); `None` where that is too far for one branch.
fn gap_mm(a: &Outline, b: &Outline) -> Option<f64> {
    let [a, b] = [&a.contour, &b.contour];
    let areas = [a, b].map(|c| c.signed_area_mm2().abs());
    let ratio = areas[0] / areas[1];
    let radius_mm = (areas[0].min(areas[1]) / std::f64::consts::PI).sqrt();
    let nearest = |from: &Contour, to: &SegmentIndex| {
        from.points.iter().map(|p| to.signed_distance_mm(*p)).fold(f64::INFINITY, f64::min)
    };
    let index = SegmentIndex::try_new(std::slice::from_ref(b))?;
    let gap_mm = nearest(a, &index).max(0.0);
    let is_near = (1.0 / MOST_GROWTH..=MOST_GROWTH).contains(&ratio) && gap_mm <= NEAR * radius_mm;
    is_near.then_some(gap_mm)
}
