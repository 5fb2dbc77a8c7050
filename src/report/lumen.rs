//! The union of a layer's beads to the lumen that they leave open (a hollow wall) or form (a cast).
//!
//! A hollow wall: the lumen is what the beads enclose and leave free. Of the enclosed gaps those count that the
//! planned lumen covers mostly, so that pores between beads are not taken for lumen. Where the ring of beads is
//! open, what lies inside the planned outer outline stands for the enclosure. A cast: the lumen is what the beads
//! cover, with the pores between them. Slits narrower than [`SLIT_MM`] are closed: beads that touch are rounded apart
//! by a micrometre on their way through G-code and record, and no plastic leaves such a slit open.

use super::BodyKind;
use crate::geom::Region;

/// Widest slit between beads that counts as closed, mm.
const SLIT_MM: f64 = 0.02;
/// Chord error of the corners that closing the slits rounds, mm.
const CORNER_MM: f64 = 1e-4;

/// What was meant to be there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expected<'a> {
    /// The lumen.
    pub(super) lumen: &'a Region,
    /// All that is to be filled.
    pub(super) material: &'a Region,
}

/// The lumen as the beads make it.
pub(super) fn of_beads(beads: &Region, expected: Expected<'_>, body: BodyKind) -> Region {
    let (lumen, first_mm) = match body {
        BodyKind::Wall => (hollow(beads, expected), -0.5 * SLIT_MM),
        BodyKind::Cast => (cast(beads, expected.lumen), 0.5 * SLIT_MM),
    };
    lumen.offset(first_mm, CORNER_MM).offset(-first_mm, CORNER_MM)
}

fn hollow(beads: &Region, expected: Expected<'_>) -> Region {
    let lumen = expected.lumen;
    let enclosed = gaps(beads);
    let mut found: Vec<Region> =
        enclosed.iter().filter(|gap| is_lumen(gap, &lumen.islands())).cloned().collect();
    let missing: Vec<Region> =
        lumen.islands().into_iter().filter(|island| !is_open(island, &found)).collect();
    if !missing.is_empty() && !beads.is_empty() {
        let outer = expected.material.union(lumen).without_holes();
        let open = outer.difference(beads).islands();
        found.extend(open.into_iter().filter(|gap| is_lumen(gap, &missing)));
    }
    Region::union_all(&found)
}

fn cast(beads: &Region, lumen: &Region) -> Region {
    let pores = gaps(beads).into_iter().filter(|gap| {
        let area = gap.area_mm2();
        gap.intersection(lumen).area_mm2() > 0.5 * area
    });
    let solid = pores.fold(beads.clone(), |sum, pore| sum.union(&pore));
    let touches = |island: &Region| island.intersection(lumen).area_mm2() > 0.0;
    Region::union_all(&solid.islands().into_iter().filter(touches).collect::<Vec<_>>())
}

/// What the region encloses without containing it, piece by piece.
fn gaps(region: &Region) -> Vec<Region> {
    region.without_holes().difference(region).islands()
}

/// Whether a gap is mostly lumen, or takes most of one of the lumina.
fn is_lumen(gap: &Region, lumina: &[Region]) -> bool {
    let area = gap.area_mm2();
    let common: Vec<f64> = lumina.iter().map(|l| l.intersection(gap).area_mm2()).collect();
    common.iter().sum::<f64>() > 0.5 * area || common.iter().zip(lumina).any(|(c, l)| *c > 0.5 * l.area_mm2())
}

/// Whether most of a lumen is among what was found.
fn is_open(lumen: &Region, found: &[Region]) -> bool {
    let common: f64 = found.iter().map(|f| f.intersection(lumen).area_mm2()).sum();
    common > 0.5 * lumen.area_mm2()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Point2};

    fn disk(x: f64, radius_mm: f64) -> Region {
        Region::new(vec![Contour::circle(Point2::new(x, 0.0), radius_mm, 360)])
    }

    fn ring(x: f64, inner: f64, outer: f64) -> Region {
        disk(x, outer).difference(&disk(x, inner))
    }

    fn bar(x0: f64, x1: f64, y0: f64, y1: f64) -> Region {
        Region::new(vec![Contour::new(
            [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| Point2::new(x, y)).to_vec(),
        )])
    }

    fn lumen_of(beads: &Region) -> Region {
        let (lumen, material) = (disk(0.0, 3.0), ring(0.0, 3.0, 4.0));
        of_beads(beads, Expected { lumen: &lumen, material: &material }, BodyKind::Wall)
    }

    #[test]
    fn a_ring_leaves_its_hole_and_not_its_pores() {
        let pore = disk(3.5, 0.1);
        let lumen = lumen_of(&ring(0.0, 3.0, 4.0).difference(&pore));
        assert!((lumen.area_mm2() - disk(0.0, 3.0).area_mm2()).abs() < 1e-3);
    }

    #[test]
    fn a_shifted_ring_moves_the_lumen() {
        let lumen = lumen_of(&ring(0.4, 3.0, 4.0));
        assert!((lumen.difference(&disk(0.4, 3.0)).area_mm2()).abs() < 1e-3);
        assert!((lumen.area_mm2() - disk(0.0, 3.0).area_mm2()).abs() < 1e-3);
    }

    #[test]
    fn an_open_ring_still_bounds_its_lumen() {
        let lumen = lumen_of(&ring(0.0, 3.0, 4.0).difference(&bar(2.0, 5.0, -0.2, 0.2)));
        let expected = disk(0.0, 3.0).area_mm2() + 0.4;
        assert!((lumen.area_mm2() - expected).abs() < 0.05, "{}", lumen.area_mm2());
    }

    #[test]
    fn a_slit_between_touching_beads_is_no_part_of_the_lumen() {
        let lumen = lumen_of(&ring(0.0, 3.0, 4.0).difference(&bar(2.0, 3.3, -0.002, 0.002)));
        let farthest =
            lumen.contours.iter().flat_map(|c| &c.points).map(|p| p.coords.norm()).fold(0.0, f64::max);
        assert!((farthest - 3.0).abs() < 1e-3, "{farthest}");
        assert!((lumen.area_mm2() - disk(0.0, 3.0).area_mm2()).abs() < 2e-3);
    }

    #[test]
    fn a_plugged_lumen_is_none() {
        assert!(lumen_of(&disk(0.0, 4.0)).is_empty());
        assert!(lumen_of(&Region::default()).is_empty());
    }

    #[test]
    fn a_cast_is_what_is_covered_with_its_pores() {
        let lumen = disk(0.0, 3.0);
        let beads = disk(0.0, 3.0).difference(&disk(1.0, 0.3)).union(&ring(0.0, 8.0, 8.4));
        let cast = of_beads(&beads, Expected { lumen: &lumen, material: &lumen }, BodyKind::Cast);
        assert!((cast.area_mm2() - lumen.area_mm2()).abs() < 1e-3);
    }
}
