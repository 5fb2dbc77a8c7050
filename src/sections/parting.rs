//! Branches that lie too close to each other for the level between lumen and wall to part them.
//!
//! Where a gap is narrower than about twice the blur, the image does not fall to the half level in it, and the first
//! contours show one vessel. A plane next to one where the vessel is parted is therefore looked at again: if the
//! blurred image falls apart at a higher level into as many cores, one in each branch, the parted contours are fitted
//! beside the undivided one, and taken where they explain the image much better and leave a gap at the plane's
//! middle: a gap in a part of the slab only belongs to the next plane.

use super::march::Grid;
use crate::ct::Volume;
use crate::geom::{Contour, Point2, Region, raster};

/// Levels tried between the half level and the lumen's, as parts of the contrast.
const LEVELS: [f64; 9] = [0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9];
/// Cores are looked for in the image blurred by this part of its own blur: noise would tear them.
const SEARCH_BLUR: f64 = 0.7;
/// A core has at least this part of the area of the branch that it belongs to.
const LEAST_CORE: f64 = 0.2;
/// The image speaks for a gap when that is so much likelier (twice the logarithm): noise reaches 10 in one of 1000.
pub(super) const LEAST_EVIDENCE: f64 = 16.0;

/// A plane's image for the search for cores.
pub(super) struct Image<'a> {
    pub(super) volume: &'a Volume,
    pub(super) k: usize,
    pub(super) sign: f64,
    /// Levels of wall and lumen, signed.
    pub(super) levels: [f64; 2],
    pub(super) blur_mm: f64,
}

/// The parts of an outer contour, one for each of the branches of the neighbouring plane; `None` where the image shows no
/// trace of a gap.
pub(super) fn parted(contour: &Contour, branches: &[&Contour], image: &Image<'_>) -> Option<Vec<Contour>> {
    let patch = Patch::of(contour, image)?;
    let [wall, lumen] = image.levels;
    let cores = LEVELS.iter().find_map(|part| cores(patch.loops(wall + part * (lumen - wall)), branches))?;
    let whole = Region::new(vec![contour.clone()]);
    let parts = super::consistency::cut(&whole, &cores, contour.perimeter_mm(), 0.5 * image.blur_mm);
    (parts.len() == branches.len()).then_some(parts)
}

/// One core for each branch, in its order.
fn cores(loops: Vec<Contour>, branches: &[&Contour]) -> Option<Vec<Contour>> {
    let outers: Vec<Contour> = loops.into_iter().filter(Contour::is_ccw).collect();
    let nearest = |core: &Contour| {
        let distance = |b: &usize| (branches[*b].centroid() - core.centroid()).norm();
        (0..branches.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
    };
    let of_branch = |b: usize| {
        let least = LEAST_CORE * branches[b].signed_area_mm2();
        let mut own = outers.iter().filter(|c| c.signed_area_mm2() > least && nearest(c) == Some(b));
        own.next().filter(|_| own.next().is_none()).cloned()
    };
    (0..branches.len()).map(of_branch).collect()
}

/// The blurred image within a contour, dark outside.
struct Patch {
    grid: Grid,
    first: [usize; 2],
    origin: Point2,
    pixel_mm: [f64; 2],
    inside: Vec<bool>,
}

impl Patch {
    fn of(contour: &Contour, image: &Image<'_>) -> Option<Self> {
        let bounds = contour.bounds()?;
        let [ox, oy] = image.volume.origin_xy_mm;
        let pixel_mm = image.volume.pixel_spacing_xy_mm;
        let [nx, ny, _] = image.volume.dims;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
        let range = |low: f64, high: f64, origin: f64, pixel: f64, n: usize| {
            let index = |v: f64| ((v - origin) / pixel).clamp(0.0, (n - 1) as f64);
            // What lies outside the contour is part of what blur mixes inside it.
            let margin = raster::blur_reach(SEARCH_BLUR * image.blur_mm, pixel) + 1;
            (index(low).floor() as usize).saturating_sub(margin)
                ..(index(high).ceil() as usize + margin + 1).min(n)
        };
        let columns = range(bounds.min.x, bounds.max.x, ox, pixel_mm[0], nx);
        let rows = range(bounds.min.y, bounds.max.y, oy, pixel_mm[1], ny);
        let at = |i: usize, j: usize| Point2::new(ox + i as f64 * pixel_mm[0], oy + j as f64 * pixel_mm[1]);
        let pixels = || rows.clone().flat_map(|j| columns.clone().map(move |i| (i, j)));
        let values: Vec<f64> =
            pixels().map(|(i, j)| image.sign * f64::from(image.volume.at(i, j, image.k))).collect();
        let inside = pixels().map(|(i, j)| contour.contains(at(i, j))).collect();
        let sigma_pixels = pixel_mm.map(|p| SEARCH_BLUR * image.blur_mm / p);
        let values = raster::blurred_within(&values, columns.len(), sigma_pixels);
        let grid = Grid { n_cols: columns.len(), n_rows: rows.len(), values };
        Some(Self { grid, first: [columns.start, rows.start], origin: Point2::new(ox, oy), pixel_mm, inside })
    }

    fn loops(&self, level: f64) -> Vec<Contour> {
        let (w, h) = (self.grid.n_cols, self.grid.n_rows);
        let border = |p: usize| p.is_multiple_of(w) || p % w == w - 1 || p / w == 0 || p / w == h - 1;
        let above = |(p, v): (usize, &f64)| if self.inside[p] && !border(p) { v - level } else { -1.0 };
        let values = self.grid.values.iter().enumerate().map(above).collect();
        let place = |[x, y]: [f64; 2]| {
            let [i, j] = [x + self.first[0] as f64, y + self.first[1] as f64];
            Point2::new(self.origin.x + i * self.pixel_mm[0], self.origin.y + j * self.pixel_mm[1])
        };
        let loops = Grid { n_cols: w, n_rows: h, values }.loops();
        loops.into_iter().map(|l| Contour::new(l.into_iter().map(place).collect())).collect()
    }
}
