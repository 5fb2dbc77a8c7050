//! Planes that a DICOM segmentation does not have between those that it has. Pure; mm along the stack's normal.
//!
//! A SEG leaves out frames without the segment (PS3.3 C.8.20.2), so that a plane that is missing is empty, as one of a label map is
//! that holds nothing: the vessel is interrupted there. An RTSTRUCT has contours where somebody has drawn them: one that is missing
//! tells nothing, and is refused. With `allow_gaps` the vessel is led across either.

use super::{Absent, Error};
use crate::ct::{Volume, Warning};
use crate::sections::ready::{Drawn, DrawnStack};

/// A step this many times the usual one means that planes were left out.
const GAP: f64 = 1.5;
/// Places that are named; of more their number is told.
const MOST_NAMED: usize = 8;
/// More planes than this are not put into one gap: its heights are no steps of a scan.
const MOST_PLANES: f64 = 10_000.0;

/// What lies between two neighbouring planes of a stack: the heights of those that are missing.
#[derive(Debug, Clone, PartialEq)]
struct Gap {
    between_mm: [f64; 2],
    missing_mm: Vec<f64>,
}

/// Deals with the gaps of a stack as its kind of file and the operator say.
///
/// # Errors
/// [`Error::MissingPlanes`] where contours are missing and nobody has allowed it.
pub fn resolve(
    mut drawn: DrawnStack,
    absent: Absent,
    ct: Option<&Volume>,
    allow_gaps: bool,
    warnings: &mut Vec<Warning>,
) -> Result<DrawnStack, Error> {
    let gaps = gaps(&drawn, ct);
    if gaps.is_empty() || absent == Absent::Never {
        return Ok(drawn);
    }
    let places = named(&gaps);
    if allow_gaps {
        let text = format!("the segmentation has no plane {places}: the vessel is led across");
        warnings.push(Warning::new("segment.gap", text));
        return Ok(drawn);
    }
    if absent == Absent::Undrawn {
        return Err(Error::MissingPlanes { places });
    }
    let text = format!(
        "the segmentation has no plane {places}: a SEG leaves planes without the structure out, so that the vessel is interrupted there (led across with --allow-gaps)"
    );
    warnings.push(Warning::new("segment.gap", text));
    let empty = gaps.into_iter().flat_map(|gap| gap.missing_mm);
    drawn.planes.extend(empty.map(|z_mm| Drawn { z_mm, contours: Vec::new() }));
    drawn.planes.sort_by(|a, b| a.z_mm.total_cmp(&b.z_mm));
    Ok(drawn)
}

/// The gaps, ascending: with the CT's own planes in them, where there is a CT, else with as many as the usual step puts there.
fn gaps(drawn: &DrawnStack, ct: Option<&Volume>) -> Vec<Gap> {
    let z: Vec<f64> = drawn.planes.iter().map(|p| p.z_mm).collect();
    let mut steps: Vec<f64> = z.windows(2).map(|z| z[1] - z[0]).collect();
    steps.sort_by(f64::total_cmp);
    // What is missing only ever lengthens a step: of two middle ones the lower.
    let Some(&usual_mm) = steps.get(steps.len().saturating_sub(1) / 2) else { return Vec::new() };
    let gap = |z: &[f64]| {
        let between_mm = [z[0], z[1]];
        let of_ct = ct.map(|ct| within(&ct.plane_z_mm, between_mm, usual_mm)).filter(|own| !own.is_empty());
        Gap { between_mm, missing_mm: of_ct.unwrap_or_else(|| evenly(between_mm, usual_mm)) }
    };
    z.windows(2).filter(|z| z[1] - z[0] > GAP * usual_mm).map(gap).collect()
}

/// Heights that lie clearly between two others.
fn within(all_mm: &[f64], [below, above]: [f64; 2], step_mm: f64) -> Vec<f64> {
    let clear_mm = 0.25 * step_mm;
    all_mm.iter().copied().filter(|z| *z > below + clear_mm && *z < above - clear_mm).collect()
}

/// As many heights between two others as the usual step puts there.
fn evenly([below, above]: [f64; 2], step_mm: f64) -> Vec<f64> {
    let parts = ((above - below) / step_mm).round().min(MOST_PLANES);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "bounded, and above 1 for a gap"
    )]
    let n = parts as u32;
    (1..n).map(|i| below + (above - below) * f64::from(i) / parts).collect()
}

fn named(gaps: &[Gap]) -> String {
    let place = |gap: &Gap| {
        let ([a, b], n) = (gap.between_mm, gap.missing_mm.len().max(1));
        format!("between z = {a:.3} and {b:.3} mm ({n} plane{})", if n == 1 { "" } else { "s" })
    };
    let first: Vec<String> = gaps.iter().take(MOST_NAMED).map(place).collect();
    let more = gaps.len().saturating_sub(MOST_NAMED);
    let more = if more > 0 { format!(", and in {more} more places") } else { String::new() };
    format!("{}{more}", first.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::RigidTransform;

    fn stack(z: &[f64]) -> DrawnStack {
        DrawnStack {
            planes: z.iter().map(|&z_mm| Drawn { z_mm, contours: Vec::new() }).collect(),
            patient_from_stack: RigidTransform::identity(),
            pixel_mm: [1.0; 2],
            are_outlines: true,
        }
    }

    fn resolved(z: &[f64], absent: Absent, allow_gaps: bool) -> Result<(Vec<f64>, Vec<String>), String> {
        let mut warnings = Vec::new();
        let drawn = resolve(stack(z), absent, None, allow_gaps, &mut warnings).map_err(|e| e.to_string())?;
        Ok((drawn.planes.iter().map(|p| p.z_mm).collect(), warnings.into_iter().map(|w| w.text).collect()))
    }

    const GAPPED: [f64; 7] = [0.0, 2.0, 4.0, 8.0, 10.0, 16.0, 18.0];

    #[test]
    fn all_gaps_are_named_and_empty_where_the_format_leaves_empty_planes_out() {
        let places = "between z = 4.000 and 8.000 mm (1 plane), between z = 10.000 and 16.000 mm (2 planes)";
        let (z, told) = resolved(&GAPPED, Absent::Empty, false).unwrap();
        assert_eq!(z, [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0]);
        assert_eq!(told.len(), 1);
        assert!(
            told[0].starts_with(&format!("the segmentation has no plane {places}: a SEG leaves")),
            "{told:?}"
        );
        for absent in [Absent::Empty, Absent::Undrawn] {
            let (z, told) = resolved(&GAPPED, absent, true).unwrap();
            assert_eq!(z, GAPPED);
            assert_eq!(told, [format!("the segmentation has no plane {places}: the vessel is led across")]);
        }
        assert_eq!(
            resolved(&GAPPED, Absent::Undrawn, false).unwrap_err(),
            format!(
                "the structure has no contour {places}: draw it there, or have it led across with --allow-gaps"
            )
        );
        assert_eq!(resolved(&GAPPED, Absent::Never, false).unwrap(), (GAPPED.to_vec(), vec![]));
    }

    #[test]
    fn steps_that_are_all_alike_have_no_gap() {
        for z in [&[][..], &[1.0], &[1.0, 9.0], &[0.0, 1.0, 2.0], &[0.0, 1.0, 2.4, 3.5]] {
            assert_eq!(resolved(z, Absent::Undrawn, false).unwrap(), (z.to_vec(), vec![]));
        }
    }

    #[test]
    fn with_a_ct_its_own_planes_are_empty() {
        let inner = within(&[3.9, 4.1, 4.9, 5.8, 7.0, 7.95], [4.0, 8.0], 2.0);
        assert_eq!(inner, [4.9, 5.8, 7.0]);
    }

    #[test]
    fn no_gap_fills_the_memory() {
        let (z, _) = resolved(&[0.0, 1e-9, 2e-9, 1e6], Absent::Empty, false).unwrap();
        assert!(z.len() < 10_010);
    }
}
