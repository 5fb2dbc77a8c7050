//! A picture (PNG) of the plane in which a region left the vessel, or was none: the image in grey, the region red, a ring around the
//! place. Rows run downward, as radiologists hold images; letters name the patient's sides.

use super::{Error, Leak, Mask};
use crate::ct::Volume;
use crate::draw::{self, Ink, px};
use crate::geom::Vector3;
use tiny_skia::{Pixmap, PremultipliedColorU8};

/// Wanted length of a picture's longer side, pixels.
const SIDE_PX: f64 = 760.0;
/// The region's colour, and how much of it covers the image.
const RED: [f64; 3] = [255.0, 59.0, 48.0];
const COVER: f64 = 0.45;
/// White on a dark shade: it is read on every grey.
const INK: Ink = Ink { line: [255, 255, 255, 255], shade: [0, 0, 0, 170] };
/// Radius of the ring, and its width, pixels.
const RING_PX: [f32; 2] = [16.0, 2.5];

/// What is drawn: a plane's region, and a place in it.
#[derive(Clone, Copy)]
struct Shown<'a> {
    voxel: [usize; 3],
    z_mm: f64,
    region: &'a Mask,
}

/// The picture of a region that was refused; `None` for another error, or where the picture cannot be held or encoded: it
/// explains an error, and is none itself.
#[must_use]
pub fn of_error(volume: &Volume, error: &Error) -> Option<Vec<u8>> {
    match error.fault() {
        Error::Leaks(leak) => of_leak(volume, leak),
        Error::Background { at, z_mm, region, .. } => {
            drawn(volume, Shown { voxel: *at, z_mm: *z_mm, region })
        }
        _ => None,
    }
}

fn of_leak(volume: &Volume, leak: &Leak) -> Option<Vec<u8>> {
    drawn(volume, Shown { voxel: leak.voxel, z_mm: leak.z_mm, region: &leak.region })
}

/// Draws and encodes.
fn drawn(volume: &Volume, shown: Shown<'_>) -> Option<Vec<u8>> {
    let [nx, ny, _] = volume.dims;
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    let size_mm = [nx as f64 * sx, ny as f64 * sy];
    let px_per_mm = SIDE_PX / size_mm[0].max(size_mm[1]);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let [width, height] = size_mm.map(|mm| (mm * px_per_mm).round().clamp(1.0, SIDE_PX) as u32);
    let mut canvas = Pixmap::new(width, height)?;
    paint(&mut canvas, volume, shown);
    ring(&mut canvas, volume, shown);
    label(&mut canvas, volume, shown, px_per_mm);
    draw::encode(&canvas).ok()
}

/// Where a row or column of the canvas lies in the image.
fn source(at: u32, of: u32, n: usize) -> usize {
    (at as usize * n / of as usize).min(n - 1)
}

fn paint(canvas: &mut Pixmap, volume: &Volume, shown: Shown<'_>) {
    let [nx, ny, _] = volume.dims;
    let [_, _, k] = shown.voxel;
    let grey = greys(&volume.plane(k));
    let (width, height) = (canvas.width(), canvas.height());
    for (at, pixel) in (0..).zip(canvas.pixels_mut()) {
        let (i, j) = (source(at % width, width, nx), source(at / width, height, ny));
        let value = grey(volume.at(i, j, k));
        let share = if shown.region.contains(i, j, k) { COVER } else { 0.0 };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a mean of two bytes")]
        let [r, g, b] = RED.map(|c| (share * c + (1.0 - share) * value).round() as u8);
        if let Some(colour) = PremultipliedColorU8::from_rgba(r, g, b, 255) {
            *pixel = colour;
        }
    }
}

/// Grey from 0 to 255: nearly all values of the plane, black to white.
fn greys(plane: &[f32]) -> impl Fn(f32) -> f64 + use<> {
    let mut values: Vec<f32> = plane.iter().copied().filter(|v| v.is_finite()).collect();
    values.sort_by(f32::total_cmp);
    let at = |share: usize| values.get(values.len() * share / 1000).map_or(0.0, |v| f64::from(*v));
    let (black, white) = (at(10), at(995));
    move |value| 255.0 * ((f64::from(value) - black) / (white - black).max(1.0)).clamp(0.0, 1.0)
}

fn ring(canvas: &mut Pixmap, volume: &Volume, shown: Shown<'_>) {
    let [nx, ny, _] = volume.dims;
    let [i, j, _] = shown.voxel;
    let centre = |at: usize, n: usize, of: u32| px((at as f64 + 0.5) / n as f64 * f64::from(of));
    let (x, y) = (centre(i, nx, canvas.width()), centre(j, ny, canvas.height()));
    let [radius, width] = RING_PX;
    if let Some(path) = tiny_skia::PathBuilder::from_circle(x, y, radius) {
        draw::stroke(canvas, &path, INK.shade, 2.0 * width, None);
        draw::stroke(canvas, &path, INK.line, width, None);
    }
}

fn label(canvas: &mut Pixmap, volume: &Volume, shown: Shown<'_>, px_per_mm: f64) {
    let (width, height) = (canvas.width() as f32, canvas.height() as f32);
    let letter = |v: Vector3| draw::side_letter(volume.patient_from_stack.rotate(v), ["H", "F"]);
    let half = 0.5 * draw::text_width("L", 3.0);
    let sides = [
        (-Vector3::x(), (10.0, 0.5 * height - 9.0)),
        (Vector3::x(), (width - 24.0, 0.5 * height - 9.0)),
        (-Vector3::y(), (0.5 * width - half, 34.0)),
        (Vector3::y(), (0.5 * width - half, height - 30.0)),
    ];
    for (side, at) in sides {
        draw::text(canvas, letter(side), at, 3.0, INK);
    }
    let title = format!("plane {}   z {:.2} mm", shown.voxel[2], shown.z_mm);
    draw::text(canvas, &title, (12.0, 12.0), 2.0, INK);
    draw::scale_bar(canvas, (16.0, height - 18.0), 0.2 * f64::from(width), px_per_mm, INK);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::segment::error::Place;
    use crate::segment::testing::Scene;
    use crate::segment::{Beyond, Mask};

    /// Colours of some places of the picture of a leak at voxel (40, 28, 1), whose region is a box right of column 32.
    fn colours(at: &[(u32, u32)]) -> Vec<[u8; 3]> {
        let volume =
            Scene::default().volume(|x, y, _| if (x - 8.0).hypot(y - 7.0) < 3.0 { 300.0 } else { 60.0 });
        let leak = Leak {
            voxel: [40, 28, 1],
            z_mm: 1.0,
            place: Place(crate::geom::Point3::new(10.0, 7.0, 1.0)),
            window_hu: [100.0, 400.0],
            into: Some((Beyond::Bulk, 1.0)),
            region: Mask::from_fn(32..48, 20..36, 1..2, |_, _, _| true),
            n_blocks: 0,
            can_be_cut: true,
            better_window_hu: None,
        };
        let png = of_leak(&volume, &leak).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
        let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut pixels).unwrap();
        // 64 x 56 pixels of 0.25 mm.
        assert_eq!((info.width, info.height), (760, 665));
        let place = |&(x, y): &(u32, u32)| {
            let at = 3 * (y * info.width + x) as usize;
            [pixels[at], pixels[at + 1], pixels[at + 2]]
        };
        at.iter().map(place).collect()
    }

    #[test]
    fn the_region_is_red_over_grey_with_a_ring_around_the_place() {
        // Pixels are 11.9 of the picture wide: lumen left of the region, lumen and background in it, background outside.
        let found = colours(&[(300, 338), (440, 338), (550, 400), (650, 500), (497, 338)]);
        let is_grey = |[r, g, b]: [u8; 3]| r == g && g == b;
        let is_red = |[r, g, b]: [u8; 3]| r > g + 60 && r > b + 60;
        assert!(is_grey(found[0]) && found[0][0] > 200, "{found:?}");
        assert!(is_red(found[1]) && is_red(found[2]), "{found:?}");
        assert!(is_grey(found[3]) && found[3][0] < 60, "{found:?}");
        assert!(is_grey(found[4]) && found[4][0] > 200, "the ring is white: {found:?}");
    }
}
