//! What a page shows of one CT plane: its grey values as they were scanned, and every stage's lines over them.
//!
//! Lines are kept in whole units of 0.01 mm from the corner of the frame that all planes share, thinned by at most half a
//! unit, so that they stay crisp at any zoom; no figure is taken from them. Grey values are the pixels of the CT within
//! the frame, as bytes over a range of twice the shown window, so that a reader may move the window.

use super::deviation::Outline;
use super::image::Plane;
use super::picture::{Scene, Window};
use crate::draw;
use crate::geom::{Contour, Point2, SegmentIndex, Vector3};
use geo::{LineString, Simplify};

/// Units of lines a millimetre.
pub(super) const UNITS_PER_MM: f64 = 100.0;
/// Most that thinning may move a line, mm.
const THIN_MM: f64 = 0.005;
/// Distance of the places where the deviation is shown, mm.
const SAMPLE_MM: f64 = 0.2;

/// Vertices of a line, units.
pub(super) type Line = Vec<[i32; 2]>;

/// The parts of a plane.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Plate {
    /// Width and height of the frame, units.
    pub(super) size: [i32; 2],
    /// The CT; `None` where it has no plane here.
    pub(super) grey: Option<Grey>,
    /// Outlines of the deposited material, to be filled by the even-odd rule.
    pub(super) material: Vec<Line>,
    /// Planned toolpaths, open.
    pub(super) paths: Vec<Line>,
    /// Outlines of the solid.
    pub(super) solid: Vec<Line>,
    /// Segmented outlines.
    pub(super) contours: Vec<Line>,
    /// Letters of the patient's sides: left, right, top, bottom of the picture, below and above the plane.
    pub(super) sides: [&'static str; 6],
    /// Deviation along the reference outline.
    pub(super) ring: Vec<Sample>,
    /// Outlines of the scanned replica; none without a scan.
    pub(super) scan: Vec<Line>,
    /// Deviation of the scanned lumen along the solid's.
    pub(super) scan_ring: Vec<Sample>,
}

/// A place on the reference outline. Stack frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sample {
    pub(super) at: Point2,
    /// Which contour of the reference it lies on.
    pub(super) contour_idx: usize,
    /// How far the deposited (or scanned) lumen lies outside, mm; `None` where that is not known.
    pub(super) off_mm: Option<f64>,
}

/// Pixels of the CT.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grey {
    pub(super) n_cols: usize,
    pub(super) n_rows: usize,
    /// Row by row.
    pub(super) values: Vec<u8>,
    /// Left, top, width, height of the pixels together, units.
    pub(super) place: [f64; 4],
    /// Levels of 0 and 255, HU.
    pub(super) range_hu: [f64; 2],
    /// Levels shown black and white at first, HU.
    pub(super) window_hu: [f64; 2],
}

impl Plate {
    pub(super) fn of(scene: &Scene<'_>) -> Self {
        let frame = scene.frame;
        let units = |p: Point2| -> [f64; 2] { ((p - frame.min()) * UNITS_PER_MM).into() };
        let line = |points: &[Point2], closed: bool| thinned(points.iter().map(|&p| units(p)), closed);
        let outlines = |contours: &[Contour]| -> Vec<Line> {
            contours.iter().map(|c| line(&c.points, true)).filter(|l| l.len() > 2).collect()
        };
        let letter = |v: Vector3| draw::side_letter(scene.patient_from_stack.rotate(v), ["H", "F"]);
        let size = frame.size_mm();
        let mut solid = outlines(&scene.solid.outer.contours);
        solid.extend(outlines(&scene.solid.lumen.contours));
        Self {
            size: [round(size[0] * UNITS_PER_MM), round(size[1] * UNITS_PER_MM)],
            grey: scene.image.and_then(|(volume, k)| Grey::of(&Plane::new(volume, k), scene)),
            material: scene.recorded.map_or_else(Vec::new, |r| outlines(&r.contours)),
            paths: scene.centre_lines.iter().map(|l| line(l, false)).filter(|l| l.len() > 1).collect(),
            solid,
            contours: outlines(scene.contours),
            sides: [-Vector3::x(), Vector3::x(), -Vector3::y(), Vector3::y(), -Vector3::z(), Vector3::z()]
                .map(letter),
            ring: scene.reference.map_or_else(Vec::new, |r| ring(r, scene.deposited)),
            scan: scene.scanned.map_or_else(Vec::new, |s| outlines(&s.material.contours)),
            scan_ring: scene.scanned.map_or_else(Vec::new, |s| ring(s.model, Some(s.lumen))),
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "frames are far smaller")]
fn round(units: f64) -> i32 {
    units.round() as i32
}

fn thinned(points: impl Iterator<Item = [f64; 2]>, closed: bool) -> Line {
    let mut line: LineString<f64> = points.collect();
    if closed {
        line.close();
    }
    let mut kept: Line =
        line.simplify(THIN_MM * UNITS_PER_MM).0.iter().map(|c| [round(c.x), round(c.y)]).collect();
    kept.dedup();
    if closed && kept.len() > 1 && kept.first() == kept.last() {
        kept.pop();
    }
    kept
}

/// Walks the reference and measures from each place to the deposited outline.
fn ring(reference: &Outline, deposited: Option<&crate::geom::Region>) -> Vec<Sample> {
    let tested = deposited.and_then(|r| SegmentIndex::try_new(&r.contours));
    let mut samples = Vec::new();
    for (contour_idx, contour) in reference.region.contours.iter().enumerate() {
        let measured = reference.measured.as_ref().and_then(|m| m.get(contour_idx)).filter(|m| !m.is_empty());
        for (i, (a, b)) in contour.edges().enumerate() {
            let known = measured.is_none_or(|m| m[i % m.len()] && m[(i + 1) % m.len()]);
            let off = |at| tested.as_ref().filter(|_| known).map(|t| -t.signed_distance_mm(at));
            let n = ((b - a).norm() / SAMPLE_MM).ceil().max(1.0);
            let mut part = 0.0;
            while part < n {
                let at = a + (b - a) * (part / n);
                samples.push(Sample { at, contour_idx, off_mm: off(at) });
                part += 1.0;
            }
        }
    }
    samples
}

impl Grey {
    /// The pixels that the frame shows and one around them.
    fn of(plane: &Plane<'_>, scene: &Scene<'_>) -> Option<Self> {
        let frame = scene.frame;
        let [cols, rows] = plane.pixels_within(frame.min(), frame.size_mm());
        if cols.is_empty() || rows.is_empty() {
            return None;
        }
        let Window { black_hu, white_hu } = scene.window;
        let beyond = 0.5 * (white_hu - black_hu);
        let wide = Window { black_hu: black_hu - beyond, white_hu: white_hu + beyond };
        let corner = plane.pixel_corner(cols.start, rows.start) - frame.min();
        let [dx, dy] = plane.pixel_mm();
        let place = [corner.x, corner.y, dx * cols.len() as f64, dy * rows.len() as f64];
        let values = rows.clone().flat_map(|j| cols.clone().map(move |i| (i, j)));
        Some(Self {
            n_cols: cols.len(),
            n_rows: rows.len(),
            values: values.map(|(i, j)| wide.grey(plane.at(i, j))).collect(),
            place: place.map(|mm| mm * UNITS_PER_MM),
            range_hu: [wide.black_hu, wide.white_hu],
            window_hu: [black_hu, white_hu],
        })
    }

    /// Half as many pixels each way, means of four.
    pub(super) fn halved(&self) -> Self {
        let (n_cols, n_rows) = (self.n_cols.div_ceil(2), self.n_rows.div_ceil(2));
        let value = |i: usize, j: usize| {
            u32::from(self.values[j.min(self.n_rows - 1) * self.n_cols + i.min(self.n_cols - 1)])
        };
        let mean = |p: usize| {
            let (i, j) = (2 * (p % n_cols), 2 * (p / n_cols));
            let sum = value(i, j) + value(i + 1, j) + value(i, j + 1) + value(i + 1, j + 1);
            u8::try_from((sum + 2) / 4).unwrap_or(u8::MAX)
        };
        let [x, y, width, height] = self.place;
        let grown = |size: f64, half: usize, whole: usize| size * (2 * half) as f64 / whole as f64;
        Self {
            n_cols,
            n_rows,
            values: (0..n_cols * n_rows).map(mean).collect(),
            place: [x, y, grown(width, n_cols, self.n_cols), grown(height, n_rows, self.n_rows)],
            ..*self
        }
    }

    /// As PNG.
    ///
    /// # Errors
    /// Where the encoder refuses.
    pub(super) fn png(&self) -> Result<Vec<u8>, png::EncodingError> {
        draw::encode_bytes(&self.values, self.n_cols, png::ColorType::Grayscale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Region;

    fn circle(radius_mm: f64) -> Contour {
        Contour::circle(Point2::new(4.0, 4.0), radius_mm, 720)
    }

    #[test]
    fn thinning_moves_no_vertex_farther_than_its_rounding() {
        let contour = circle(3.0);
        let line = thinned(contour.points.iter().map(|p| [p.x * UNITS_PER_MM, p.y * UNITS_PER_MM]), true);
        assert!(line.len() < 120 && line.len() > 20, "{}", line.len());
        let mm = |v: i32| f64::from(v) / UNITS_PER_MM;
        let thin = Contour::new(line.iter().map(|&[x, y]| Point2::new(mm(x), mm(y))).collect());
        let index = SegmentIndex::try_new(&[thin]).unwrap();
        let worst = contour.points.iter().map(|&p| index.nearest(p).distance_mm).fold(0.0, f64::max);
        assert!(worst < 0.0125, "{worst}");
    }

    #[test]
    fn a_wider_lumen_deviates_outward_and_what_was_not_measured_is_not_known() {
        let mut reference: Outline = Region::new(vec![circle(3.0)]).into();
        let mut measured = vec![true; 720];
        measured[..100].fill(false);
        reference.measured = Some(vec![measured]);
        let samples = ring(&reference, Some(&Region::new(vec![circle(3.2)])));
        let known: Vec<f64> = samples.iter().filter_map(|s| s.off_mm).collect();
        assert_eq!(samples.len() - known.len(), 101);
        assert!(known.iter().all(|off| (off - 0.2).abs() < 1e-3));
        assert!(ring(&reference, None).iter().all(|s| s.off_mm.is_none()));
    }

    #[test]
    fn halving_keeps_the_place_of_every_pixel() {
        let grey = Grey {
            n_cols: 3,
            n_rows: 2,
            values: vec![10, 20, 30, 30, 40, 50],
            place: [5.0, 6.0, 30.0, 20.0],
            range_hu: [0.0, 255.0],
            window_hu: [0.0, 255.0],
        };
        let half = grey.halved();
        assert_eq!((half.n_cols, half.n_rows, half.values.as_slice()), (2, 1, [25u8, 40].as_slice()));
        assert_eq!(half.place, [5.0, 6.0, 40.0, 20.0]);
    }
}
