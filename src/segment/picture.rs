//! A picture (PNG) of the plane in which a region left the vessel: the image in grey, the region red, a ring around the
//! place. Rows run downward, as radiologists hold images; letters name the patient's sides.

use super::Leak;
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

/// Draws and encodes; `None` where the picture cannot be held or encoded: it explains an error, and is none itself.
#[must_use]
pub fn picture(volume: &Volume, leak: &Leak) -> Option<Vec<u8>> {
    let [nx, ny, _] = volume.dims;
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    let size_mm = [nx as f64 * sx, ny as f64 * sy];
    let px_per_mm = SIDE_PX / size_mm[0].max(size_mm[1]);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let [width, height] = size_mm.map(|mm| (mm * px_per_mm).round().clamp(64.0, SIDE_PX) as u32);
    let mut canvas = Pixmap::new(width, height)?;
    paint(&mut canvas, volume, leak);
    ring(&mut canvas, volume, leak);
    label(&mut canvas, volume, leak, px_per_mm);
    draw::encode(&canvas).ok()
}

/// Where a row or column of the canvas lies in the image.
fn source(at: u32, of: u32, n: usize) -> usize {
    (at as usize * n / of as usize).min(n - 1)
}

fn paint(canvas: &mut Pixmap, volume: &Volume, leak: &Leak) {
    let [nx, ny, _] = volume.dims;
    let [_, _, k] = leak.voxel;
    let grey = greys(&volume.plane(k));
    let (width, height) = (canvas.width(), canvas.height());
    for (at, pixel) in (0..).zip(canvas.pixels_mut()) {
        let (i, j) = (source(at % width, width, nx), source(at / width, height, ny));
        let value = grey(volume.at(i, j, k));
        let share = if leak.region.contains(i, j, k) { COVER } else { 0.0 };
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

fn ring(canvas: &mut Pixmap, volume: &Volume, leak: &Leak) {
    let [nx, ny, _] = volume.dims;
    let [i, j, _] = leak.voxel;
    let centre = |at: usize, n: usize, of: u32| px((at as f64 + 0.5) / n as f64 * f64::from(of));
    let (x, y) = (centre(i, nx, canvas.width()), centre(j, ny, canvas.height()));
    let [radius, width] = RING_PX;
    if let Some(path) = tiny_skia::PathBuilder::from_circle(x, y, radius) {
        draw::stroke(canvas, &path, INK.shade, 2.0 * width, None);
        draw::stroke(canvas, &path, INK.line, width, None);
    }
}

fn label(canvas: &mut Pixmap, volume: &Volume, leak: &Leak, px_per_mm: f64) {
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
    let title = format!("plane {}   z {:.2} mm", leak.voxel[2], leak.z_mm);
    draw::text(canvas, &title, (12.0, 12.0), 2.0, INK);
    draw::scale_bar(canvas, (16.0, height - 18.0), 0.2 * f64::from(width), px_per_mm, INK);
}
