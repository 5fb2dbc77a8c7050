//! A picture (PNG) of the contours over the CT: some planes from the lowest to the highest, side by side, so that whoever has them
//! found sees at once whether they are the lumen's. Rows run downward, as radiologists hold images.

use super::{PlaneSections, SectionStack};
use crate::ct::Volume;
use crate::draw::{self, Ink, px};
use crate::geom::{Bounds2, Contour, Point2};
use tiny_skia::{PathBuilder, Pixmap, PixmapPaint, PremultipliedColorU8, Transform};

/// So many planes are shown at most, in rows of so many.
const MOST_SHOWN: usize = 12;
const PER_ROW: usize = 4;
/// Side of a plane's picture, and the space between two, pixels.
const SIDE_PX: u32 = 260;
const SPACE_PX: u32 = 4;
/// What is shown around the contours, mm.
const MARGIN_MM: f64 = 6.0;
const RED: [u8; 4] = [255, 59, 48, 255];
const INK: Ink = Ink { line: [255, 255, 255, 255], shade: [0, 0, 0, 170] };
/// Width of a contour's line, pixels.
const LINE_PX: f32 = 1.5;
/// Grey is black below and white above these parts of the values in a picture.
const BLACK_WHITE: [f64; 2] = [0.01, 0.995];

/// Draws and encodes; `None` where there is no contour, or the picture cannot be held or encoded.
#[must_use]
pub fn of_contours(volume: &Volume, stack: &SectionStack) -> Option<Vec<u8>> {
    let all = stack.planes.iter().flat_map(|p| &p.contours).filter_map(Contour::bounds);
    let window = Window::around(all.reduce(Bounds2::union)?);
    let shown = shown(stack.planes.len());
    let size = |n: usize| Some(u32::try_from(n).ok()? * (SIDE_PX + SPACE_PX) - SPACE_PX);
    let n_rows = shown.len().div_ceil(PER_ROW);
    let mut sheet = Pixmap::new(size(PER_ROW.min(shown.len()))?, size(n_rows)?)?;
    for (n, plane) in shown.into_iter().map(|k| &stack.planes[k]).enumerate() {
        let tile = tile(volume, plane, &window)?;
        let at = |n: usize| i32::try_from(n).ok()?.checked_mul(i32::try_from(SIDE_PX + SPACE_PX).ok()?);
        let (x, y) = (at(n % PER_ROW)?, at(n / PER_ROW)?);
        sheet.draw_pixmap(x, y, tile.as_ref(), &PixmapPaint::default(), Transform::identity(), None);
    }
    draw::encode(&sheet).ok()
}

/// The planes that are shown, of so many: evenly from the first to the last.
fn shown(n_planes: usize) -> Vec<usize> {
    let n = n_planes.min(MOST_SHOWN);
    (0..n).map(|i| if n > 1 { i * (n_planes - 1) / (n - 1) } else { 0 }).collect()
}

/// The square of the image that every picture shows.
struct Window {
    corner: Point2,
    px_per_mm: f64,
}

impl Window {
    fn around(bounds: Bounds2) -> Self {
        let bounds = bounds.grown(MARGIN_MM);
        let (size, middle) = (bounds.size(), nalgebra::center(&bounds.min, &bounds.max));
        let side_mm = size.x.max(size.y);
        let corner = Point2::new(middle.x - 0.5 * side_mm, middle.y - 0.5 * side_mm);
        Self { corner, px_per_mm: f64::from(SIDE_PX) / side_mm }
    }

    fn pixel(&self, p: Point2) -> (f32, f32) {
        let at = (p - self.corner) * self.px_per_mm;
        (px(at.x), px(at.y))
    }

    fn place(&self, x: u32, y: u32) -> Point2 {
        let at = |n: u32| (f64::from(n) + 0.5) / self.px_per_mm;
        Point2::new(self.corner.x + at(x), self.corner.y + at(y))
    }
}

fn tile(volume: &Volume, plane: &PlaneSections, window: &Window) -> Option<Pixmap> {
    let mut canvas = Pixmap::new(SIDE_PX, SIDE_PX)?;
    let values: Vec<Option<f32>> = (0..SIDE_PX * SIDE_PX)
        .map(|at| value_at(volume, window.place(at % SIDE_PX, at / SIDE_PX), plane.z_mm))
        .collect();
    let grey = greys(&values);
    for (value, pixel) in values.iter().zip(canvas.pixels_mut()) {
        let grey = value.map_or(0, &grey);
        *pixel = PremultipliedColorU8::from_rgba(grey, grey, grey, 255)?;
    }
    let mut path = PathBuilder::new();
    for contour in &plane.contours {
        draw::add_polyline(&mut path, contour.points.iter().map(|&p| window.pixel(p)));
        path.close();
    }
    if let Some(path) = path.finish() {
        draw::stroke(&mut canvas, &path, RED, LINE_PX, None);
    }
    draw::text(&mut canvas, &format!("z {:.2} mm", plane.z_mm), (8.0, 8.0), 1.5, INK);
    Some(canvas)
}

/// The value of the voxel around a place of the stack.
fn value_at(volume: &Volume, p: Point2, z_mm: f64) -> Option<f32> {
    let [i, j, k] = volume.voxel_from_stack(crate::geom::Point3::new(p.x, p.y, z_mm))?;
    Some(volume.at(i, j, k))
}

fn greys(values: &[Option<f32>]) -> impl Fn(f32) -> u8 + use<> {
    let mut found: Vec<f32> = values.iter().flatten().copied().filter(|v| v.is_finite()).collect();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index into the values")]
    let mut at = |share: f64| {
        let n = (share * found.len() as f64) as usize;
        if n < found.len() { f64::from(*found.select_nth_unstable_by(n, f32::total_cmp).1) } else { 0.0 }
    };
    let [black, white] = BLACK_WHITE.map(&mut at);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
    move |value| (255.0 * ((f64::from(value) - black) / (white - black).max(1.0)).clamp(0.0, 1.0)) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::testing::Scene;

    #[test]
    fn planes_are_shown_from_the_first_to_the_last() {
        assert_eq!(shown(1), [0]);
        assert_eq!(shown(5), [0, 1, 2, 3, 4]);
        let many = shown(46);
        assert_eq!((many.len(), many[0], many[11]), (12, 0, 45));
        assert!(shown(0).is_empty());
    }

    #[test]
    fn contours_are_red_on_the_grey_of_their_plane() {
        let volume =
            Scene::default().volume(|x, y, _| if (x - 8.0).hypot(y - 7.0) < 3.0 { 300.0 } else { 0.0 });
        let circle = Contour::circle(Point2::new(8.0, 7.0), 3.0, 128);
        let planes = [0.0, 1.0].map(|z_mm| PlaneSections { z_mm, contours: vec![circle.clone()] }).to_vec();
        let stack = SectionStack { planes, patient_from_stack: volume.patient_from_stack };
        let png = of_contours(&volume, &stack).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        assert_eq!((info.width, info.height), (2 * SIDE_PX + SPACE_PX, SIDE_PX));
        let n = pixels.len() / (info.width * info.height) as usize;
        let colour = |x: u32, y: u32| {
            let at = n * (y * info.width + x) as usize;
            [pixels[at], pixels[at + 1], pixels[at + 2]]
        };
        // 18 mm wide around the circle: its middle, its boundary, what surrounds it.
        let half = SIDE_PX / 2;
        let radius = SIDE_PX * 3 / 18;
        assert_eq!(colour(half, half), [255; 3]);
        assert_eq!(colour(half + 2 * radius, half), [0; 3]);
        let [r, g, _] = colour(half + radius, half);
        assert!(r > 200 && g < 160, "{r} {g}");
        assert_eq!(colour(half + SIDE_PX + SPACE_PX, half), [255; 3]);
    }
}
