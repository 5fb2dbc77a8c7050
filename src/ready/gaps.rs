//! Planes that a segmentation does not have between those that it has. Pure; mm along the stack's normal.
//!
//! On a CT they are the CT's planes, however far apart these lie; without one, those that would fit between the segmentation's own.
//!
//! A SEG leaves out frames without the segment (PS3.3 C.8.20.2), so that a plane that is missing is empty, as one of a label map is
//! that holds nothing: the vessel is interrupted there. An RTSTRUCT has contours where somebody has drawn them: one that is missing
//! tells nothing, and is refused. With `allow_gaps` the vessel is led across either. A label map has all planes of its grid: where
//! that is coarser than the CT, the vessel is led across.

use super::place::SAME_PLANE_MM;
use super::{Absent, Error};
use crate::ct::{Volume, Warning, gaps_among};
use crate::sections::ready::{Drawn, DrawnStack};

/// Places that are named; of more their number is told.
const MOST_NAMED: usize = 8;

/// What lies between two neighbouring planes of a stack: the heights of those that are missing.
#[derive(Debug, Clone, PartialEq)]
struct Gap {
    /// Of the segmentation's planes below and above.
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
    let z_mm: Vec<f64> = drawn.planes.iter().map(|p| p.z_mm).collect();
    let mut gaps = match ct.and_then(|ct| Some((ct, places_in(&ct.plane_z_mm, &z_mm)?))) {
        Some((ct, places)) => {
            // A SEG may have been made on every second plane; an RTSTRUCT is drawn on all.
            let unit = if absent == Absent::Empty { usual_step(&places) } else { 1 };
            warnings.extend((unit > 1).then(|| coarser(unit)));
            in_places(&ct.plane_z_mm, &places, unit, &z_mm)
        }
        None if absent == Absent::Never => Vec::new(),
        None => by_distance(&z_mm),
    };
    if absent == Absent::Never {
        // Where the label map holds nothing, nothing is led anywhere.
        let is_filled = |z: f64| drawn.planes.iter().any(|p| p.z_mm == z && !p.contours.is_empty());
        gaps.retain(|gap| gap.between_mm.into_iter().all(is_filled));
    }
    if gaps.is_empty() {
        return Ok(drawn);
    }
    let places = named(&gaps);
    if allow_gaps || absent == Absent::Never {
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

/// Which planes of a CT these heights are; `None` where any is none of them.
fn places_in(ct_mm: &[f64], z_mm: &[f64]) -> Option<Vec<usize>> {
    let place = |z: &f64| {
        let above = ct_mm.partition_point(|p| p < z);
        let near = [above.checked_sub(1), Some(above)].into_iter().flatten().filter(|&k| k < ct_mm.len());
        near.min_by(|&a, &b| (ct_mm[a] - z).abs().total_cmp(&(ct_mm[b] - z).abs()))
            .filter(|&k| (ct_mm[k] - z).abs() <= SAME_PLANE_MM)
    };
    z_mm.iter().map(place).collect()
}

/// The usual step from one plane to the next, in planes of the CT: what is missing only ever lengthens it.
fn usual_step(places: &[usize]) -> usize {
    let mut steps: Vec<usize> = places.windows(2).map(|p| p[1] - p[0]).collect();
    steps.sort_unstable();
    steps.get(steps.len().saturating_sub(1) / 2).map_or(1, |&step| step.max(1))
}

fn coarser(step: usize) -> Warning {
    let text = format!(
        "the segmentation has one plane for every {step} of the CT: the vessel is led across the others"
    );
    Warning::new("segment.gap", text)
}

/// The gaps between planes of a CT that lie more than so many apart.
fn in_places(ct_mm: &[f64], places: &[usize], step: usize, z_mm: &[f64]) -> Vec<Gap> {
    let gap = |n: usize| Gap {
        between_mm: [z_mm[n - 1], z_mm[n]],
        missing_mm: (places[n - 1] + step..places[n]).step_by(step).map(|k| ct_mm[k]).collect(),
    };
    (1..places.len()).filter(|&n| places[n] - places[n - 1] > step).map(gap).collect()
}

/// The gaps where other planes would fit, as in a CT.
fn by_distance(z_mm: &[f64]) -> Vec<Gap> {
    let steps: Vec<f64> = z_mm.windows(2).map(|z| z[1] - z[0]).collect();
    let gap = |gap: crate::ct::Gap| {
        let between_mm = [z_mm[gap.after], z_mm[gap.after + 1]];
        Gap { between_mm, missing_mm: evenly(between_mm, gap.n_missing) }
    };
    gaps_among(&steps).into_iter().map(gap).collect()
}

/// So many heights between two others.
fn evenly([below, above]: [f64; 2], n: usize) -> Vec<f64> {
    (1..=n).map(|i| below + (above - below) * i as f64 / (n + 1) as f64).collect()
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
    fn no_gap_fills_the_memory() {
        let (z, _) = resolved(&[0.0, 1e-9, 2e-9, 1e6], Absent::Empty, false).unwrap();
        assert!(z.len() < 10_010);
    }
}
