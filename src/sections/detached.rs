//! What has lost its connection to the vessel on the way from voxels to contours.
//!
//! A grown region is connected through voxels' faces; where a bridge of a few voxels is dropped as a fragment or a stub,
//! what it led to is left without any contour that joins it to a seed's. The operator asked for the seeds' vessels: such
//! pieces are dropped, and reported, where they are small against what stays: a large one is a vessel of its own, whose only
//! contact with the other was cut. Contours count as joined where they overlap at all, so that the steepest vessel stays whole.

use super::consistency::{self, Outer, Plane};
use super::warnings::SectionWarnings;
use crate::geom::Point2;

/// A piece of less than this part of what stays is small: by the sum of its sections.
const SMALL: f64 = 0.1;

/// A point of the vessel: index of a plane in the volume, place in that plane.
pub(super) type Seed = (usize, Point2);

/// Drops small pieces that no chain of overlapping contours joins to one around a seed; all stay where no contour holds a seed.
pub(super) fn drop_detached(planes: &mut [Plane], seeds: &[Seed], warnings: &mut SectionWarnings) {
    let outers: Vec<Vec<Outer>> = planes.iter().map(|p| consistency::prepared(p, false)).collect();
    let mut kept: Vec<Vec<bool>> = outers
        .iter()
        .zip(&*planes)
        .map(|(outers, plane)| outers.iter().map(|o| holds_seed(o, plane, seeds)).collect())
        .collect();
    if !kept.iter().flatten().any(|&k| k) {
        return;
    }
    while spread(&outers, &mut kept) {}
    keep_large(&outers, &mut kept);
    for ((plane, outers), kept) in planes.iter_mut().zip(&outers).zip(&kept) {
        let gone: Vec<&Outer> = outers.iter().zip(kept).filter(|(_, k)| !**k).map(|(o, _)| o).collect();
        gone.iter().for_each(|o| warnings.detached(plane.z_mm, o.area_mm2));
        consistency::remove_outers(plane, &gone.iter().map(|o| o.at).collect::<Vec<usize>>());
    }
}

/// Keeps the pieces that are no small part of what is kept.
fn keep_large(outers: &[Vec<Outer>], kept: &mut [Vec<bool>]) {
    let area = |marked: &[Vec<bool>]| -> f64 {
        let all = outers.iter().flatten().zip(marked.iter().flatten());
        all.filter(|(_, m)| **m).map(|(o, _)| o.area_mm2).sum()
    };
    let main_mm2 = area(kept);
    let mut seen = kept.to_vec();
    for (k, n) in (0..outers.len()).flat_map(|k| (0..outers[k].len()).map(move |n| (k, n))) {
        if seen[k][n] {
            continue;
        }
        let mut piece: Vec<Vec<bool>> = outers.iter().map(|o| vec![false; o.len()]).collect();
        piece[k][n] = true;
        while spread(outers, &mut piece) {}
        let is_large = area(&piece) >= SMALL * main_mm2;
        for ((seen, kept), piece) in seen.iter_mut().zip(&mut *kept).zip(&piece) {
            for i in (0..piece.len()).filter(|&i| piece[i]) {
                seen[i] = true;
                kept[i] |= is_large;
            }
        }
    }
}

fn holds_seed(outer: &Outer, plane: &Plane, seeds: &[Seed]) -> bool {
    let contour = &plane.loops[outer.at].contour;
    seeds.iter().any(|(k, p)| *k == plane.k && contour.contains(*p))
}

/// Goes up and down through all planes once; true where anything was reached.
fn spread(outers: &[Vec<Outer>], kept: &mut [Vec<bool>]) -> bool {
    let n = outers.len();
    let steps = (1..n).map(|k| (k - 1, k)).chain((1..n).rev().map(|k| (k, k - 1)));
    let mut reached = false;
    for (from, to) in steps {
        for b in (0..outers[to].len()).collect::<Vec<usize>>() {
            let meets =
                |a: usize| kept[from][a] && consistency::overlap_by(&outers[from][a], &outers[to][b], 0.0);
            if !kept[to][b] && (0..outers[from].len()).any(meets) {
                kept[to][b] = true;
                reached = true;
            }
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::super::consistency::{Loop, Origin};
    use super::*;
    use crate::geom::Contour;

    fn plane(k: usize, circles: &[(f64, f64)]) -> Plane {
        let one = |&(x, r): &(f64, f64)| Loop {
            contour: Contour::circle(Point2::new(x, 0.0), r, 40),
            origin: Origin::Image,
        };
        Plane { k, z_mm: k as f64, loops: circles.iter().map(one).collect() }
    }

    fn counts(planes: &[Plane]) -> Vec<usize> {
        planes.iter().map(|p| p.loops.len()).collect()
    }

    #[test]
    fn only_what_is_joined_to_a_seed_stays() {
        let all = || {
            vec![
                plane(4, &[(0.0, 2.0)]),
                plane(5, &[(-1.0, 1.0), (1.5, 1.0), (9.0, 0.5)]),
                plane(6, &[(-1.0, 1.0), (3.4, 1.0), (9.0, 0.5)]),
            ]
        };
        let mut planes = all();
        let mut warnings = SectionWarnings::default();
        drop_detached(&mut planes, &[(6, Point2::new(-1.0, 0.0))], &mut warnings);
        assert_eq!(counts(&planes), [1, 2, 2]);
        assert_eq!(warnings.into_warnings()[0].code, "sections.detached");
        // Sections that are no small part of the whole are a vessel of their own.
        let mut large = all();
        large[2] = plane(6, &[(-1.0, 1.0), (3.4, 1.0), (9.0, 2.0)]);
        drop_detached(&mut large, &[(6, Point2::new(-1.0, 0.0))], &mut SectionWarnings::default());
        assert_eq!(counts(&large), [1, 3, 3]);
        // A seed in each keeps both; none in any leaves all.
        for seeds in
            [vec![(6, Point2::new(-1.0, 0.0)), (5, Point2::new(9.0, 0.0))], vec![(6, Point2::new(50.0, 0.0))]]
        {
            let mut planes = all();
            drop_detached(&mut planes, &seeds, &mut SectionWarnings::default());
            assert_eq!(counts(&planes), [1, 3, 3]);
        }
    }
}
