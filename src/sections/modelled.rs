//! The half-maximum contours of a stack refined under the model of the image, and the close branches told apart.

use super::consistency::Plane;
use super::fit::{Fitted, HalfLevels, Stack, are_simple};
use super::model::{self, Footing, Scan, Start};
use super::parting::{self, LEAST_EVIDENCE};
use crate::geom::Contour;
use crate::progress::Cancelled;

/// Planes fitted to either side of a doubtful one before it is decided.
const AROUND: usize = 4;

/// The image speaks for or against a gap within so many standard deviations of the blur around the contour.
const EVIDENCE_BLURS: f64 = 3.0;

/// An undivided contour of a plane, and what it may be instead.
struct Doubt {
    plane: usize,
    undivided: Contour,
    parts: Vec<Contour>,
}

impl Stack<'_> {
    /// The contours under the model of the image; those of a plane that would cross stay where they were.
    pub(super) fn modelled(&self, half: &HalfLevels, first: Vec<Fitted>) -> Result<Vec<Fitted>, Cancelled> {
        let scan = Scan {
            volume: self.volume,
            sign: self.segmentation.sign(),
            levels: half.levels,
            optics: half.optics,
        };
        let mut starts: Vec<Start> = self
            .planes
            .iter()
            .zip(&first)
            .map(|(plane, fitted)| Start {
                k: plane.k,
                z_mm: plane.z_mm,
                contours: fitted.contours.clone(),
                footing: vec![footing(plane, fitted); fitted.contours.len()],
                levels: half.levels,
            })
            .collect();
        let views: Vec<Vec<Contour>> = starts.iter().map(|s| s.contours.clone()).collect();
        let parted = self.part(scan, &mut starts, &views)?;
        let fit = model::contours(scan, &starts, &views, self.task)?;
        let starts: Vec<(Fitted, Option<Vec<Contour>>)> = first.into_iter().zip(parted).collect();
        let jobs: Vec<(usize, Vec<Contour>)> = fit.into_iter().enumerate().collect();
        self.over(&jobs, [90, 100], |(n, dense)| {
            let (first, parted) = &starts[*n];
            let found = self.chosen(first, parted.as_deref(), dense);
            let n_kept = found.contours.iter().filter(|c| first.contours.contains(c)).count();
            left(found, n_kept, first, &self.planes[*n])
        })
    }

    /// The first of these whose contours do not cross: the stack's fit, the fit in which they were parted, the start.
    fn chosen(&self, first: &Fitted, parted: Option<&[Contour]>, dense: &[Contour]) -> Fitted {
        let n_parted = parted.map_or(0, <[Contour]>::len);
        // What the model has not moved stays as it is.
        let kept = |c: &Contour| first.contours.contains(c).then(|| c.clone());
        let spaced = |dense: &[Contour]| {
            dense.iter().map(|c| kept(c).unwrap_or_else(|| self.spaced(&c.points))).collect::<Vec<_>>()
        };
        // Interpolation may overshoot at a sharp notch, straight lines between the points do not.
        let straight = |dense: &[Contour]| {
            dense.iter().map(|c| kept(c).unwrap_or_else(|| self.unsmoothed(c))).collect::<Vec<_>>()
        };
        let fits = [Some(dense), parted].into_iter().flatten();
        let found = fits.flat_map(|c| [spaced(c), straight(c)]).find(|c| are_simple(c));
        match found {
            Some(contours) => Fitted { n_parted, ..Fitted::at_first(contours) },
            None => Fitted::at_first(first.contours.clone()),
        }
    }

    /// Parts the contours that are several vessels; the contours of each plane where that was done.
    fn part(
        &self,
        scan: Scan<'_>,
        starts: &mut [Start],
        views: &[Vec<Contour>],
    ) -> Result<Vec<Option<Vec<Contour>>>, Cancelled> {
        let mut found = vec![None; starts.len()];
        let mut parted = starts.to_vec();
        let doubts = doubts(scan, &mut parted);
        for group in doubts.chunk_by(|a, b| a.plane.abs_diff(b.plane) <= 1) {
            let planes = group.iter().map(|d| d.plane);
            let (low, high) = planes.fold((usize::MAX, 0), |(l, h), p| (l.min(p), h.max(p)));
            let range = low.saturating_sub(AROUND)..(high + AROUND + 1).min(starts.len());
            let fit = |starts: &[Start]| {
                model::weighed(scan, &starts[range.clone()], &views[range.clone()], self.task)
            };
            let (one, several) = (fit(starts)?, fit(&parted)?);
            for doubt in group {
                let n = doubt.plane - range.start;
                // Another doubtful contour of the plane, or another vessel, has no say.
                let around = doubt.undivided.bounds().map(|b| b.grown(EVIDENCE_BLURS * scan.optics.blur_mm));
                let evidence = around.map_or(0.0, |around| several.evidence_over(&one, n, &around));
                if evidence > LEAST_EVIDENCE && are_simple(&several.contours[n]) {
                    starts[doubt.plane].replace(&doubt.undivided, &doubt.parts);
                    found[doubt.plane] = Some(several.contours[n].clone());
                }
            }
        }
        Ok(found)
    }
}

/// The contours of a plane with how many of them the model has left, `n_kept`, told by what was kept: the window's edge, where
/// they had crossed before, else the level between lumen and wall. Bridges, splits and what was drawn are told elsewhere.
fn left(found: Fitted, n_kept: usize, first: &Fitted, plane: &Plane) -> Fitted {
    if first.n_crossing > 0 {
        return Fitted { n_crossing: n_kept.min(first.n_crossing), ..found };
    }
    let n_image = plane.loops.iter().filter(|l| l.origin.is_image()).count();
    Fitted { n_unmodelled: n_kept.min(n_image), ..found }
}

fn footing(plane: &Plane, fitted: &Fitted) -> Footing {
    match (is_image(plane), fitted.n_crossing) {
        _ if plane.is_drawn() => Footing::Drawn,
        (false, _) => Footing::Made,
        (true, 0) => Footing::Measured,
        _ => Footing::Rough,
    }
}

/// Whether the image shows all contours of a plane: bridges and splits have no edge to be fitted to.
fn is_image(plane: &Plane) -> bool {
    plane.loops.iter().all(|l| l.origin.is_image())
}

/// Contours that may be several, with each plane's neighbour as the witness; `starts` get their parts.
fn doubts(scan: Scan<'_>, starts: &mut [Start]) -> Vec<Doubt> {
    let n = starts.len();
    let mut found = Vec::new();
    let upward = (1..n).map(|k| (k, k - 1));
    let downward = (0..n.saturating_sub(1)).rev().map(|k| (k, k + 1));
    for (plane, witness) in upward.chain(downward) {
        let candidates: Vec<Contour> = starts[plane].undivided().cloned().collect();
        for undivided in candidates {
            let branches: Vec<&Contour> = starts[witness]
                .contours
                .iter()
                .filter(|c| c.is_ccw() && undivided.contains(c.centroid()))
                .collect();
            if branches.len() < 2 {
                continue;
            }
            let image = parting::Image {
                volume: scan.volume,
                k: starts[plane].k,
                sign: scan.sign,
                levels: [scan.levels.wall, scan.levels.lumen],
                blur_mm: scan.optics.blur_mm,
            };
            if let Some(parts) = parting::parted(&undivided, &branches, &image) {
                starts[plane].replace(&undivided, &parts);
                found.push(Doubt { plane, undivided, parts });
            }
        }
    }
    found
}

impl Start {
    /// Outer contours that the image may move and that have no hole.
    fn undivided(&self) -> impl Iterator<Item = &Contour> {
        let holes: Vec<&Contour> = self.contours.iter().filter(|c| !c.is_ccw()).collect();
        let shown = self.contours.iter().zip(&self.footing);
        let shown = shown.filter(|(c, footing)| footing.is_image() && c.is_ccw());
        shown.map(|(c, _)| c).filter(move |c| !holes.iter().any(|h| c.contains(h.points[0])))
    }

    fn replace(&mut self, one: &Contour, by: &[Contour]) {
        let Some(at) = self.contours.iter().position(|c| c == one) else { return };
        self.contours.remove(at);
        self.footing.remove(at);
        self.contours.extend_from_slice(by);
        self.footing.resize(self.contours.len(), Footing::Rough);
    }
}
