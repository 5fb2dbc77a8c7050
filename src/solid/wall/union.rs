//! Outlines of the outer skin as unions of grown sections: slower and rounded, but right wherever the lumen has an
//! outline at all: beside flat ends, and where curves cannot be followed.
//!
//! The outer section at height z is the union over dz in (-t, t) of the lumen's section at z + dz grown by
//! sqrt(t² - dz²). Heights lie t / 10 apart, which scallops the union by t (1 + m²) / 800 for a branch of slope m.

use super::lumen::is_hole;
use crate::geom::{Contour, Region, SegmentIndex};
use crate::solid::skin::{End, Skin, Tube};

/// Heights per wall thickness at which the lumen is cut, on either side.
const SAMPLES_PER_WALL: i32 = 10;
/// Points of an outline.
const OUTLINE_POINTS: usize = 512;
/// Chord tolerance of the lumen's sections and of rounded offsets, mm.
const CHORD_MM: f64 = 5e-4;

/// The outer contours at z, evenly resampled; holes are filled.
pub(super) fn outlines(lumen: &Skin, wall_mm: f64, z_mm: f64) -> Vec<Contour> {
    let grown: Vec<(Region, SegmentIndex, f64)> = (1 - SAMPLES_PER_WALL..SAMPLES_PER_WALL)
        .filter_map(|k| {
            let dz = wall_mm * f64::from(k) / f64::from(SAMPLES_PER_WALL);
            let region = Region::new(continued_section(lumen, z_mm + dz));
            let index = SegmentIndex::try_new(&region.contours)?;
            Some((region, index, (wall_mm * wall_mm - dz * dz).max(0.0).sqrt()))
        })
        .collect();
    let parts = grown.iter().map(|(region, index, radius)| (region, index, *radius));
    let union = Region::union_of_grown(parts, CHORD_MM);
    let resampled = resampled(union, wall_mm);
    // Contours that all but touch may cross once they are resampled.
    let clean = Region::union_all([&resampled]);
    if clean.contours.len() == resampled.contours.len() {
        resampled.contours
    } else {
        self::resampled(clean, wall_mm).contours
    }
}

/// The outer contours of a region, evenly resampled. Slivers between arcs are no wall: a true outline encloses at
/// least a lumen.
fn resampled(region: Region, wall_mm: f64) -> Region {
    let least_mm2 = 0.1 * wall_mm * wall_mm;
    let outers = region.contours.into_iter().filter(|c| c.signed_area_mm2() > least_mm2);
    Region::new(outers.map(|c| c.resampled(OUTLINE_POINTS)).collect())
}

/// The lumen's section without its holes, continued along the end tangents beyond the stack's ends.
fn continued_section(lumen: &Skin, z_mm: f64) -> Vec<Contour> {
    let [low, high] = lumen.z_range_mm();
    if z_mm >= low && z_mm <= high {
        let mut contours = lumen.section(z_mm, CHORD_MM);
        contours.retain(Contour::is_ccw);
        return contours;
    }
    let end = z_mm.clamp(low, high);
    let reaches = |t: &&Tube| {
        let [bottom, top] = t.surface.z_range_mm();
        let open = |end: End, z: f64, stack_end: f64| end == End::Cap && (z - stack_end).abs() < 1e-9;
        !is_hole(t) && if z_mm < low { open(t.bottom, bottom, low) } else { open(t.top, top, high) }
    };
    let continued = |t: &Tube| {
        let (points, slopes) = (t.surface.section(end).points(), t.surface.section_slope(end).points());
        Contour::new(points.iter().zip(&slopes).map(|(p, s)| p + s.coords * (z_mm - end)).collect())
    };
    lumen.tubes.iter().filter(reaches).map(continued).collect()
}
