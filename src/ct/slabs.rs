//! The thickness that headers state of their planes: what is believed of it, and what is told. Pure; mm.

use super::Warning;

/// No scanner makes thicker planes, mm.
const THICKEST_MM: f64 = 20.0;
/// Slabs usually meet, or overlap by half: planes half a slab apart, and what rounding adds.
const USUAL_OVERLAP: f64 = 2.05;

/// Whether a plane may be so thick.
pub(super) fn is_believed(thickness_mm: f64) -> bool {
    thickness_mm <= THICKEST_MM
}

/// Says that a thickness is not believed; `step_mm` is taken for it.
pub(super) fn not_believed(step_mm: f64) -> Warning {
    let text = format!(
        "headers state a slice thickness of more than {THICKEST_MM} mm, which no scanner makes; the planes' distance, {step_mm:.3} mm, was taken"
    );
    Warning::new("ct.thickness_not_believed", text)
}

/// Says where planes lie much nearer to each other than they are thick, which hides what is missing and blurs what is slanted.
pub(super) fn overlap(thickness_mm: f64, step_mm: f64) -> Option<Warning> {
    let text = format!(
        "headers state slices {thickness_mm:.3} mm thick, {step_mm:.3} mm apart: planes that were resampled may keep the thickness of their original; it is taken into account where the vessel is slanted (--boundary half-maximum does without it)"
    );
    (thickness_mm > USUAL_OVERLAP * step_mm).then(|| Warning::new("ct.slabs_overlap", text))
}
