//! A layer as SVG: lengths are millimetres on the bed, y upward as on the bed.

use super::{Frame, Shown, caption, colour, runs};
use crate::geom::Point2;
use std::fmt::Write;

/// Width of a way without extrusion, mm.
const TRAVEL_MM: f64 = 0.03;

pub(super) fn of_layer(shown: &Shown<'_>, frame: &Frame) -> String {
    let own = shown.own;
    let (min, size) = (frame.shown.min, frame.shown.size());
    let mut text = String::with_capacity(64 * own.beads.iter().map(|b| b.points.len()).sum::<usize>() + 1024);
    put(
        &mut text,
        format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{w:.3}mm\" height=\"{h:.3}mm\" viewBox=\"{x:.3} {y:.3} {w:.3} \
             {h:.3}\">\n<title>{}</title>\n<g transform=\"scale(1,-1)\" fill=\"none\" stroke-linejoin=\"round\">\n",
            caption(shown.idx, own),
            x = min.x,
            y = -frame.shown.max.y,
            w = size.x,
            h = size.y
        ),
    );
    put(&mut text, format_args!("<path fill=\"#cdcdcd\" fill-rule=\"evenodd\" d=\""));
    for contour in &own.material.contours {
        put(&mut text, format_args!("M"));
        points(&mut text, &contour.points);
        put(&mut text, format_args!("Z"));
    }
    put(&mut text, format_args!("\"/>\n"));
    for bead in &own.beads {
        let [r, g, b] = colour(bead.kind);
        for (width_mm, run) in runs(bead) {
            let name = bead.kind.gcode_name();
            put(
                &mut text,
                format_args!(
                    "<polyline data-type=\"{name}\" stroke=\"#{r:02x}{g:02x}{b:02x}\" stroke-width=\"{width_mm:.3}\" points=\""
                ),
            );
            points(&mut text, &run);
            put(&mut text, format_args!("\"/>\n"));
        }
    }
    for way in shown.travels() {
        put(&mut text, format_args!("<polyline stroke=\"#466e96\" stroke-width=\"{TRAVEL_MM}\" points=\""));
        points(&mut text, &way);
        put(&mut text, format_args!("\"/>\n"));
    }
    text += "</g>\n</svg>\n";
    text
}

fn points(text: &mut String, points: &[Point2]) {
    for (n, p) in points.iter().enumerate() {
        let gap = if n == 0 { "" } else { " " };
        put(text, format_args!("{gap}{:.3},{:.3}", p.x, p.y));
    }
}

fn put(text: &mut String, what: std::fmt::Arguments<'_>) {
    text.write_fmt(what).expect("a string takes every text");
}
