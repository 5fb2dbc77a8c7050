//! Beads of a layer to scale, as a picture (PNG) and as SVG, before anything is printed.
//!
//! Colours are those that G-code viewers give the kinds of beads. All layers of a job share one frame and one scale, so
//! that leafing through them moves nothing but the part. Along each bead runs the line that the nozzle follows, from a dot where
//! it begins. What was to be filled lies under the beads in grey: where it
//! shows there is a gap wider than a pixel; ways without extrusion are thin lines. Beside each picture stands what the colours
//! of the job mean.

mod portrait;
mod svg;

pub use portrait::portrait;

use crate::draw::{self, Ink, add_polyline, px};
use crate::geom::{Bounds2, Point2};
use crate::progress::{Cancelled, Task};
use crate::toolpath::{Bead, BeadKind, LayerPaths, Toolpaths};
use rayon::prelude::*;
use std::collections::BTreeSet;
use tiny_skia::{Color, FillRule, Mask, PathBuilder, Pixmap, Rect, Transform};

/// Free space around the part, mm.
const MARGIN_MM: f64 = 2.0;
/// Wanted length of a picture's longer side, pixels.
const SIDE_PX: f64 = 900.0;
/// Widths of a bead that differ by less are drawn as one stroke, mm.
const SAME_WIDTH_MM: f64 = 0.004;
const GROUND: [u8; 4] = [255, 255, 255, 255];
const MATERIAL: [u8; 4] = [205, 205, 205, 255];
const TRAVEL: [u8; 4] = [70, 110, 150, 255];
/// Free space around letters, pixels.
const EDGE_PX: f32 = 12.0;
/// Size of the caption's letters, pixels.
const CAPTION_UNIT: f32 = 2.2;
/// Of the column beside a picture that says what the colours mean: its lines, where its letters begin, and their size, pixels.
const LEGEND_LINE_PX: f32 = 24.0;
const LEGEND_TEXT_PX: f32 = 22.0;
const LEGEND_UNIT: f32 = 1.6;
/// What the colours mean that are no kind of bead's.
const NO_BEADS: [([u8; 4], &str); 2] = [(TRAVEL, "Travel"), (MATERIAL, "Left empty")];
/// Beads that touch are drawn so much wider beneath, pixels: the soft edges of two strokes would let the ground through.
const SEAM_PX: f64 = 1.2;
/// Beads from this width on show the line that the nozzle follows, pixels,
const COURSE_FROM_PX: f64 = 6.0;
/// and where it begins by a dot of this radius, pixels.
const BEGIN_PX: f32 = 2.5;
const INK: Ink = Ink { line: [30, 30, 30, 255], shade: [255, 255, 255, 200] };

/// A layer could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The picture could not be made.
    #[error("the picture of layer {layer} cannot be encoded: {source}")]
    Picture {
        /// The layer, 0 on the bed.
        layer: usize,
        /// Why.
        source: png::EncodingError,
    },
    /// Asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A layer as it will look.
#[derive(Debug, Clone, PartialEq)]
pub struct Preview {
    /// The layer, 0 on the bed.
    pub layer: usize,
    /// The encoded picture.
    pub png: Vec<u8>,
    /// The same as SVG, in millimetres.
    pub svg: String,
}

impl Preview {
    /// Name of its files without the extension: `layer-0012`.
    #[must_use]
    pub fn file_stem(&self) -> String {
        format!("layer-{:04}", self.layer)
    }
}

/// Draws every layer.
///
/// # Errors
/// [`Error`].
pub fn of_layers(paths: &Toolpaths, task: &Task<'_>) -> Result<Vec<Preview>, Error> {
    let frame = Frame::of(&paths.layers);
    let draw = |idx: usize| {
        task.check()?;
        let shown = Shown::of(&paths.layers, idx);
        let png = picture(&shown, &frame).map_err(|source| Error::Picture { layer: idx, source })?;
        Ok(Preview { layer: idx, png, svg: svg::of_layer(&shown, &frame) })
    };
    (0..paths.layers.len()).into_par_iter().map(draw).collect()
}

/// A layer, and where the nozzle comes from.
struct Shown<'a> {
    idx: usize,
    own: &'a LayerPaths,
    /// End of the last bead below.
    from: Option<Point2>,
}

impl<'a> Shown<'a> {
    fn of(layers: &'a [LayerPaths], idx: usize) -> Self {
        let last = layers[..idx].iter().rev().find_map(|below| below.beads.last());
        Self { idx, own: &layers[idx], from: last.and_then(|bead| bead.points.last()).map(|p| p.at) }
    }

    /// The ways without extrusion to each bead, ends included.
    fn travels(&self) -> impl Iterator<Item = Vec<Point2>> + '_ {
        let end = |bead: &Bead| bead.points.last().map(|p| p.at);
        let from = std::iter::once(self.from).chain(self.own.beads.iter().map(end));
        from.zip(&self.own.beads).zip(&self.own.travels).filter_map(|((from, bead), travel)| {
            let to = bead.points.first()?.at;
            Some(std::iter::once(from?).chain(travel.via.iter().copied()).chain([to]).collect())
        })
    }
}

/// The part of the bed that is shown, and how large.
#[derive(Debug, Clone)]
struct Frame {
    shown: Bounds2,
    px_per_mm: f64,
    /// Kinds of beads of the job.
    kinds: Vec<BeadKind>,
    /// Width of the longest caption, pixels.
    caption_px: f32,
}

impl Frame {
    fn of(layers: &[LayerPaths]) -> Self {
        let points = layers.iter().flat_map(|l| &l.beads).flat_map(|b| &b.points).map(|p| p.at);
        let none = Bounds2 { min: Point2::origin(), max: Point2::origin() };
        let shown = Bounds2::of(points).unwrap_or(none).grown(MARGIN_MM);
        let size = shown.size();
        let beads = layers.iter().flat_map(|l| &l.beads);
        let kinds: BTreeSet<BeadKind> = beads.map(|b| b.kind).collect();
        let px_per_mm = (SIDE_PX / size.x.max(size.y)).clamp(0.5, 100.0);
        let captions = layers.iter().enumerate().map(|(idx, layer)| caption(idx, layer));
        let caption_px = captions.map(|c| draw::text_width(&c, CAPTION_UNIT)).fold(0.0, f32::max);
        Self { shown, px_per_mm, kinds: kinds.into_iter().collect(), caption_px }
    }

    /// Width and height of what is shown of the bed, no less than caption and legend need, pixels.
    fn size_px(&self) -> [u32; 2] {
        let size = self.shown.size() * self.px_per_mm;
        let n_lines = self.legend().count();
        let least = [self.caption_px + 2.0 * EDGE_PX, EDGE_PX + n_lines as f32 * LEGEND_LINE_PX];
        [0, 1].map(|axis| whole(px(size[axis]).clamp(64.0, 4096.0).max(least[axis])))
    }

    /// Width of the legend beside it, pixels.
    fn legend_px(&self) -> u32 {
        let names = self.legend().map(|(_, name)| draw::text_width(name, LEGEND_UNIT));
        whole(LEGEND_TEXT_PX + names.fold(0.0, f32::max) + EDGE_PX)
    }

    /// Colours and what they mean, line by line.
    fn legend(&self) -> impl Iterator<Item = ([u8; 4], &'static str)> + '_ {
        let swatch = |kind: &BeadKind| {
            let [r, g, b] = colour(*kind);
            ([r, g, b, 255], kind.name())
        };
        self.kinds.iter().map(swatch).chain(NO_BEADS)
    }

    /// The bed's y runs upward, a picture's downward.
    fn place(&self, p: Point2) -> (f32, f32) {
        let x = (p.x - self.shown.min.x) * self.px_per_mm;
        (px(x), px((self.shown.max.y - p.y) * self.px_per_mm))
    }
}

/// Red, green and blue of a kind of bead.
const fn colour(kind: BeadKind) -> [u8; 3] {
    match kind {
        BeadKind::ExternalPerimeter => [255, 125, 56],
        BeadKind::Perimeter => [255, 230, 77],
        BeadKind::InternalInfill => [176, 48, 41],
        BeadKind::SolidInfill => [150, 84, 204],
        BeadKind::Bridge => [40, 120, 216],
        BeadKind::SkirtBrim => [0, 135, 110],
        BeadKind::SupportMaterial => [0, 190, 0],
        BeadKind::SupportInterface => [0, 127, 0],
        BeadKind::Rib => [150, 210, 60],
    }
}

/// What stands in a layer's corner.
fn caption(layer: usize, own: &LayerPaths) -> String {
    let plane = own.slot.ct_plane.map_or_else(String::new, |plane| format!("  CT plane {plane}"));
    format!("layer {layer}  z {:.2} mm{plane}", own.z_mm)
}

/// Runs of one width: width, points.
fn runs(bead: &Bead) -> Vec<(f64, Vec<Point2>)> {
    let mut all: Vec<(f64, Vec<Point2>)> = Vec::new();
    for pair in bead.points.windows(2) {
        match all.last_mut() {
            Some((width, points)) if (*width - pair[0].width_mm).abs() < SAME_WIDTH_MM => {
                points.push(pair[1].at)
            }
            _ => all.push((pair[0].width_mm, vec![pair[0].at, pair[1].at])),
        }
    }
    all
}

fn picture(shown: &Shown<'_>, frame: &Frame) -> Result<Vec<u8>, png::EncodingError> {
    let own = shown.own;
    let [width, height] = frame.size_px();
    let mut canvas = Pixmap::new(width + frame.legend_px(), height).expect("sides of 64 to 5000 pixels");
    let [r, g, b, a] = GROUND;
    canvas.fill(Color::from_rgba8(r, g, b, a));
    let material = material(own, frame);
    if let Some(path) = &material {
        canvas.fill_path(path, &draw::paint(MATERIAL), FillRule::EvenOdd, Transform::identity(), None);
    }
    let inside = material.and_then(|path| {
        let mut mask = Mask::new(canvas.width(), canvas.height())?;
        mask.fill_path(&path, FillRule::EvenOdd, true, Transform::identity());
        Some(mask)
    });
    let part = own.beads.iter().filter(|b| b.kind.is_part());
    beads(&mut canvas, frame, part, SEAM_PX, inside.as_ref());
    beads(&mut canvas, frame, own.beads.iter(), 0.0, None);
    own.beads.iter().for_each(|bead| course(&mut canvas, frame, bead));
    for way in shown.travels() {
        line(&mut canvas, frame, &way, TRAVEL, 1.0, None);
    }
    legend(&mut canvas, px(f64::from(width)), frame);
    draw::text(&mut canvas, &caption(shown.idx, own), (EDGE_PX, EDGE_PX), CAPTION_UNIT, INK);
    draw::scale_bar(&mut canvas, (EDGE_PX, px(f64::from(height)) - 14.0), 160.0, frame.px_per_mm, INK);
    draw::encode(&canvas)
}

fn material(own: &LayerPaths, frame: &Frame) -> Option<tiny_skia::Path> {
    let mut builder = PathBuilder::new();
    for contour in &own.material.contours {
        add_polyline(&mut builder, contour.points.iter().map(|p| frame.place(*p)));
        builder.close();
    }
    builder.finish()
}

/// Strokes beads, each so many pixels wider than it is.
fn beads<'a>(
    canvas: &mut Pixmap,
    frame: &Frame,
    beads: impl Iterator<Item = &'a Bead>,
    wider_px: f64,
    within: Option<&Mask>,
) {
    for bead in beads {
        let [r, g, b] = colour(bead.kind);
        for (width_mm, points) in runs(bead) {
            line(canvas, frame, &points, [r, g, b, 255], width_mm * frame.px_per_mm + wider_px, within);
        }
    }
}

/// The line that the nozzle follows, and a dot where it begins, so that beads of one kind can be told apart and seams be seen;
/// not where a bead is too thin on the picture to show more than that.
fn course(canvas: &mut Pixmap, frame: &Frame, bead: &Bead) {
    let widest_mm = bead.points.iter().map(|p| p.width_mm).fold(0.0, f64::max);
    let Some(begin) = bead.points.first().filter(|_| widest_mm * frame.px_per_mm >= COURSE_FROM_PX) else {
        return;
    };
    let [r, g, b] = colour(bead.kind).map(|channel| channel / 2);
    let way: Vec<Point2> = bead.points.iter().map(|p| p.at).collect();
    line(canvas, frame, &way, [r, g, b, 255], 1.0, None);
    let (x, y) = frame.place(begin.at);
    if let Some(dot) = PathBuilder::from_circle(x, y, BEGIN_PX) {
        canvas.fill_path(&dot, &draw::paint(INK.line), FillRule::Winding, Transform::identity(), None);
    }
}

fn line(
    canvas: &mut Pixmap,
    frame: &Frame,
    points: &[Point2],
    colour: [u8; 4],
    width_px: f64,
    within: Option<&Mask>,
) {
    let mut builder = PathBuilder::new();
    add_polyline(&mut builder, points.iter().map(|p| frame.place(*p)));
    if let Some(path) = builder.finish() {
        let stroke = draw::plain_stroke(px(width_px));
        canvas.stroke_path(&path, &draw::paint(colour), &stroke, Transform::identity(), within);
    }
}

/// What the colours mean, from `left` on.
fn legend(canvas: &mut Pixmap, left: f32, frame: &Frame) {
    let mut top = EDGE_PX;
    for (colour, name) in frame.legend() {
        if let Some(rect) = Rect::from_xywh(left, top, 14.0, 14.0) {
            canvas.fill_rect(rect, &draw::paint(colour), Transform::identity(), None);
        }
        draw::text(canvas, name, (left + LEGEND_TEXT_PX, top), LEGEND_UNIT, INK);
        top += LEGEND_LINE_PX;
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "sides of pictures")]
fn whole(px: f32) -> u32 {
    px.ceil() as u32
}

#[cfg(test)]
mod tests;
