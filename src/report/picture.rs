//! One CT plane to a picture (PNG): the image in grey, deposited material as a translucent fill, toolpaths blue,
//! section of the solid red, segmented boundary green (dashed, so that the red under it stays visible), scanned replica violet.
//!
//! All planes share one frame and one scale, so that leafing through them moves nothing but the vessel. The image
//! is drawn between the pixels' centres by linear interpolation, which is also how its boundary was measured.
//! Orientation letters follow the patient (R, L, A, P, H, F); the patient's right is on the left of a transaxial
//! plane, as radiologists hold images.

use super::Error;
use super::deviation::{Outline, quantile};
use super::image::Plane;
use super::plate::Plate;
use crate::ct::Volume;
use crate::draw::{self, Ink, add_polyline, px};
use crate::geom::{Bounds2, Contour, Point2, Region, RigidTransform, Vector3};
use crate::solid::CrossSection;
use tiny_skia::{Color, FillRule, Path, PathBuilder, Pixmap, StrokeDash, Transform};

/// Free space around the vessel, mm.
const MARGIN_MM: f64 = 5.0;
/// Wanted length of a picture's longer side, pixels.
const SIDE_PX: f64 = 760.0;

const GREEN: [u8; 4] = [64, 235, 110, 255];
const RED: [u8; 4] = [255, 59, 48, 255];
const BLUE: [u8; 4] = [38, 130, 255, 255];
const AMBER: [u8; 4] = [255, 179, 0, 84];
const VIOLET: [u8; 4] = [213, 128, 255, 255];
/// White on a dark shade: it is read on every grey.
const INK: Ink = Ink { line: [255, 255, 255, 255], shade: [0, 0, 0, 170] };

/// A picture of one CT plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// CT plane.
    pub plane: usize,
    /// The encoded picture.
    pub png: Vec<u8>,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// Pixels per millimetre.
    pub px_per_mm: f64,
    /// Its parts, for pages.
    pub(super) plate: Plate,
}

impl Picture {
    /// Name of its file: `plane-012.png`.
    #[must_use]
    pub fn file_name(&self) -> String {
        format!("plane-{:03}.png", self.plane)
    }
}

/// Which part of the plane is shown, and how large.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    min: Point2,
    size_px: [u32; 2],
    px_per_mm: f64,
}

impl Frame {
    /// The corner with the least coordinates, stack frame.
    pub(super) const fn min(&self) -> Point2 {
        self.min
    }

    /// Width and height, mm.
    pub(super) fn size_mm(&self) -> [f64; 2] {
        self.size_px.map(|px| f64::from(px) / self.px_per_mm)
    }
}

/// Everything around the vessel in all planes.
pub(super) fn frame_of(boxes: impl Iterator<Item = Bounds2>) -> Frame {
    let fallback = Bounds2 { min: Point2::origin(), max: Point2::origin() };
    let shown = boxes.reduce(Bounds2::union).unwrap_or(fallback).grown(MARGIN_MM);
    let size = shown.size();
    let px_per_mm = (SIDE_PX / size.x.max(size.y)).clamp(0.5, 40.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let px = |mm: f64| (mm * px_per_mm).ceil().clamp(64.0, 4096.0) as u32;
    Frame { min: shown.min, size_px: [px(size.x), px(size.y)], px_per_mm }
}

/// Grey values that are shown black and white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    pub(super) black_hu: f64,
    pub(super) white_hu: f64,
}

impl Window {
    /// Half a contrast beyond the levels of lumen and surroundings; without them, nearly all of the volume.
    pub(super) fn of_levels(inner: Option<f64>, outer: Option<f64>, volume: Option<&Volume>) -> Self {
        if let (Some(a), Some(b)) = (inner, outer) {
            let beyond = 0.5 * (a - b).abs().max(1.0);
            return Self { black_hu: a.min(b) - beyond, white_hu: a.max(b) + beyond };
        }
        let mut values: Vec<f64> =
            volume.map_or_else(Vec::new, |v| v.hu.iter().step_by(97).map(f64::from).collect());
        values.retain(|v| v.is_finite());
        values.sort_by(f64::total_cmp);
        if values.is_empty() {
            return Self { black_hu: 0.0, white_hu: 1.0 };
        }
        let black_hu = quantile(&values, 0.01);
        Self { black_hu, white_hu: quantile(&values, 0.99).max(black_hu + 1.0) }
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
    pub(super) fn grey(self, hu: f64) -> u8 {
        let part = (hu - self.black_hu) / (self.white_hu - self.black_hu);
        // Rounds half up, which for positive numbers needs no call.
        (part * 255.0 + 0.5).clamp(0.0, 255.0) as u8
    }
}

/// What one picture shows. Stack frame.
#[derive(Debug)]
pub(super) struct Scene<'a> {
    pub(super) plane: usize,
    pub(super) z_mm: f64,
    pub(super) frame: Frame,
    pub(super) image: Option<(&'a Volume, usize)>,
    pub(super) window: Window,
    pub(super) patient_from_stack: RigidTransform,
    pub(super) recorded: Option<&'a Region>,
    pub(super) centre_lines: Vec<Vec<Point2>>,
    pub(super) solid: &'a CrossSection,
    pub(super) contours: &'a [Contour],
    /// The boundary that the deposited lumen is measured against.
    pub(super) reference: Option<&'a Outline>,
    /// The lumen that the deposited material leaves.
    pub(super) deposited: Option<&'a Region>,
    /// The replica as a scan shows it.
    pub(super) scanned: Option<ScannedScene<'a>>,
}

/// The scanned replica in one plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct ScannedScene<'a> {
    /// The lumen of the solid.
    pub(super) model: &'a Outline,
    /// That of the scan.
    pub(super) lumen: &'a Region,
    /// All that is bright.
    pub(super) material: &'a Region,
}

/// Draws and encodes.
///
/// # Errors
/// [`Error::Picture`] where the canvas or the encoder refuses.
pub(super) fn paint(scene: &Scene<'_>) -> Result<Picture, Error> {
    let [width, height] = scene.frame.size_px;
    let fail = |why: &str| Error::Picture {
        plane: scene.plane,
        why: why.into(),
        width_mm: f64::from(width) / scene.frame.px_per_mm,
        height_mm: f64::from(height) / scene.frame.px_per_mm,
    };
    let canvas = Pixmap::new(width, height).ok_or_else(|| fail("no canvas of this size"))?;
    let mut brush = Brush { canvas, frame: scene.frame };
    brush.background(scene);
    if let Some(recorded) = scene.recorded {
        brush.fill(&recorded.contours, AMBER);
    }
    brush.lines(&scene.centre_lines, BLUE);
    brush.outline(&scene.solid.outer.contours, RED, 2.8, None);
    brush.outline(&scene.solid.lumen.contours, RED, 2.8, None);
    brush.outline(scene.contours, GREEN, 1.6, StrokeDash::new(vec![7.0, 5.0], 0.0));
    if let Some(scanned) = scene.scanned {
        brush.outline(&scanned.material.contours, VIOLET, 1.6, None);
    }
    brush.scale_bar();
    brush.letters(scene);
    let png = draw::encode(&brush.canvas).map_err(|e| fail(&e.to_string()))?;
    let Frame { size_px, px_per_mm, .. } = scene.frame;
    Ok(Picture { plane: scene.plane, png, size_px, px_per_mm, plate: Plate::of(scene) })
}

struct Brush {
    canvas: Pixmap,
    frame: Frame,
}

impl Brush {
    fn place(&self, p: Point2) -> (f32, f32) {
        let offset = (p - self.frame.min) * self.frame.px_per_mm;
        (px(offset.x), px(offset.y))
    }

    fn background(&mut self, scene: &Scene<'_>) {
        self.canvas.fill(Color::from_rgba8(28, 28, 30, 255));
        let Some((volume, k)) = scene.image else { return };
        let plane = Plane::new(volume, k);
        let frame = self.frame;
        let width = frame.size_px[0] as usize;
        let at = |i: usize| (i as f64 + 0.5) / frame.px_per_mm;
        let columns: Vec<_> = (0..width).map(|i| plane.column(frame.min.x + at(i))).collect();
        for (j, row) in self.canvas.data_mut().chunks_exact_mut(4 * width).enumerate() {
            let Some(between) = plane.row(frame.min.y + at(j)) else { continue };
            for (pixel, column) in row.chunks_exact_mut(4).zip(&columns) {
                if let Some(column) = column {
                    let grey = scene.window.grey(plane.value(*column, between));
                    pixel.copy_from_slice(&[grey, grey, grey, 255]);
                }
            }
        }
    }

    fn path(&self, contours: &[Contour]) -> Option<Path> {
        let mut builder = PathBuilder::new();
        for contour in contours.iter().filter(|c| c.len() > 2) {
            add_polyline(&mut builder, contour.points.iter().map(|&p| self.place(p)));
            builder.close();
        }
        builder.finish()
    }

    /// Contours are filled on a canvas of their own, so that the fill is translucent once.
    fn fill(&mut self, contours: &[Contour], colour: [u8; 4]) {
        if let Some(path) = self.path(contours) {
            self.canvas.fill_path(
                &path,
                &draw::paint(colour),
                FillRule::EvenOdd,
                Transform::identity(),
                None,
            );
        }
    }

    fn outline(&mut self, contours: &[Contour], colour: [u8; 4], width: f32, dash: Option<StrokeDash>) {
        if let Some(path) = self.path(contours) {
            self.stroke(&path, colour, width, dash);
        }
    }

    fn lines(&mut self, lines: &[Vec<Point2>], colour: [u8; 4]) {
        let mut builder = PathBuilder::new();
        for line in lines {
            add_polyline(&mut builder, line.iter().map(|&p| self.place(p)));
        }
        if let Some(path) = builder.finish() {
            self.stroke(&path, colour, 1.4, None);
        }
    }

    fn stroke(&mut self, path: &Path, colour: [u8; 4], width: f32, dash: Option<StrokeDash>) {
        draw::stroke(&mut self.canvas, path, colour, width, dash);
    }

    /// A bar of a round length, about a fifth of the picture.
    fn scale_bar(&mut self) {
        let [width, height] = self.frame.size_px.map(f64::from);
        let at = (16.0, px(height - 18.0));
        draw::scale_bar(&mut self.canvas, at, 0.2 * width, self.frame.px_per_mm, INK);
    }

    fn letters(&mut self, scene: &Scene<'_>) {
        let [width, height] = self.frame.size_px.map(|n| px(f64::from(n)));
        let letter = |v: Vector3| draw::side_letter(scene.patient_from_stack.rotate(v), ["H", "F"]);
        let (half, size) = (0.5 * draw::text_width("L", 3.0), 3.0);
        self.text(letter(-Vector3::x()), 10.0, 0.5 * height - 9.0, size);
        self.text(letter(Vector3::x()), width - 24.0, 0.5 * height - 9.0, size);
        self.text(letter(-Vector3::y()), 0.5 * width - half, 34.0, size);
        self.text(letter(Vector3::y()), 0.5 * width - half, height - 30.0, size);
        self.text(&format!("plane {}   z {:.2} mm", scene.plane, scene.z_mm), 12.0, 12.0, 2.0);
    }

    fn text(&mut self, text: &str, x: f32, y: f32, unit: f32) {
        draw::text(&mut self.canvas, text, (x, y), unit, INK);
    }
}
