//! What pictures have in common: strokes, letters without a font file, scale bars, sides of the patient, PNG.
//!
//! Sizes are in pixels, y downward.

mod glyphs;

use crate::geom::Vector3;
use tiny_skia::{Color, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, StrokeDash, Transform};

/// The colours of letters and bars: a line on a wider shade, so that both stand out from whatever is under them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Ink {
    pub(crate) line: [u8; 4],
    pub(crate) shade: [u8; 4],
}

pub(crate) fn paint([r, g, b, a]: [u8; 4]) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color(Color::from_rgba8(r, g, b, a));
    paint
}

#[expect(clippy::cast_possible_truncation, reason = "pixels fit into f32")]
pub(crate) fn px(value: f64) -> f32 {
    value as f32
}

pub(crate) fn add_polyline(builder: &mut PathBuilder, points: impl Iterator<Item = (f32, f32)>) {
    for (i, (x, y)) in points.enumerate() {
        if i == 0 { builder.move_to(x, y) } else { builder.line_to(x, y) }
    }
}

pub(crate) fn stroke(
    canvas: &mut Pixmap,
    path: &Path,
    colour: [u8; 4],
    width: f32,
    dash: Option<StrokeDash>,
) {
    let stroke = tiny_skia::Stroke { dash, ..plain_stroke(width) };
    canvas.stroke_path(path, &paint(colour), &stroke, Transform::identity(), None);
}

/// A line with blunt ends and round corners.
pub(crate) fn plain_stroke(width: f32) -> tiny_skia::Stroke {
    tiny_skia::Stroke {
        width,
        line_cap: LineCap::Butt,
        line_join: LineJoin::Round,
        ..tiny_skia::Stroke::default()
    }
}

/// Writes a line of text, its upper left corner at the given place, `unit` pixels a glyph unit (a sixth of a capital's height).
pub(crate) fn text(canvas: &mut Pixmap, text: &str, (x, y): (f32, f32), unit: f32, ink: Ink) {
    let mut builder = PathBuilder::new();
    let mut left = x;
    for c in text.chars() {
        for line in glyphs::strokes(c) {
            add_polyline(&mut builder, line.iter().map(|(u, v)| (left + u * unit, y + v * unit)));
        }
        left += advance(c) * unit;
    }
    if let Some(path) = builder.finish() {
        stroke(canvas, &path, ink.shade, 2.2 * unit, None);
        stroke(canvas, &path, ink.line, 0.75 * unit, None);
    }
}

/// How wide a line of text is, pixels.
pub(crate) fn text_width(text: &str, unit: f32) -> f32 {
    text.chars().map(advance).sum::<f32>() * unit
}

/// Whether every character of a text is drawn.
#[cfg(test)]
pub(crate) fn is_drawn(text: &str) -> bool {
    text.chars().all(|c| c == ' ' || !glyphs::strokes(c).is_empty())
}

fn advance(c: char) -> f32 {
    if c == ' ' { 0.55 * glyphs::ADVANCE } else { glyphs::ADVANCE }
}

/// A bar of a round length, at most `most_px` pixels, its left end at the given place, its length above it.
pub(crate) fn scale_bar(canvas: &mut Pixmap, (x0, y): (f32, f32), most_px: f64, px_per_mm: f64, ink: Ink) {
    let wanted = most_px / px_per_mm;
    let length_mm =
        [100.0, 50.0, 20.0, 10.0, 5.0, 2.0, 1.0].into_iter().find(|l| *l <= wanted).unwrap_or(0.5);
    let x1 = x0 + px(length_mm * px_per_mm);
    let mut builder = PathBuilder::new();
    add_polyline(&mut builder, [(x0, y - 5.0), (x0, y), (x1, y), (x1, y - 5.0)].into_iter());
    if let Some(path) = builder.finish() {
        stroke(canvas, &path, ink.shade, 5.0, None);
        stroke(canvas, &path, ink.line, 2.2, None);
    }
    text(canvas, &format!("{length_mm} mm"), (x0, y - 24.0), 2.2, ink);
}

/// The letter of the patient's side that a direction (LPS) mostly points to; `upper_lower` name the ends along z.
pub(crate) fn side_letter(v: Vector3, upper_lower: [&'static str; 2]) -> &'static str {
    let [upper, lower] = upper_lower;
    let sides = [("L", "R", v.x), ("P", "A", v.y), (upper, lower, v.z)];
    let main = sides.into_iter().max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()));
    main.map_or("", |(plus, minus, part)| if part > 0.0 { plus } else { minus })
}

/// The picture as PNG. Every pixel has to be opaque.
pub(crate) fn encode(canvas: &Pixmap) -> Result<Vec<u8>, png::EncodingError> {
    // Premultiplied colours are the colours.
    let rgb: Vec<u8> = canvas.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    encode_bytes(&rgb, canvas.width() as usize, png::ColorType::Rgb)
}

/// Rows of pixels of `width`, each of as many bytes as the colour type has samples, as PNG.
pub(crate) fn encode_bytes(
    pixels: &[u8],
    width: usize,
    colour: png::ColorType,
) -> Result<Vec<u8>, png::EncodingError> {
    let height = pixels.len() / (width.max(1) * colour.samples());
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    let mut bytes = Vec::with_capacity(pixels.len() / 2);
    let mut encoder = png::Encoder::new(&mut bytes, side(width), side(height));
    encoder.set_color(colour);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.write_header()?.write_image_data(pixels)?;
    Ok(bytes)
}
