//! The layer in which a print will go on, as a picture (SVG): what is done, what may be printed twice, what is to do, and where
//! the nozzle comes down; with a title, a legend, a scale, and the side at which the operator stands.
//!
//! Drawn from the job alone: all beads at the height of the line where it goes on, as wide as the profile's. Frame: the bed, y
//! upwards. Arcs are drawn as their chord. Memory: the beads of one layer.

use super::job::{self, Job};
use super::replay::Modal;
use crate::profile::Profile;
use std::fmt::Write as _;
use std::io::{BufRead, Seek};

/// Heights this close are one layer, mm.
const SAME_HEIGHT_MM: f64 = 1e-3;
/// Width of the picture, and the longer side of the layer in it, units.
const WIDTH: f64 = 1000.0;
const LAYER: f64 = 860.0;
/// Above the layer: title and legend; below it: scale and front.
const HEAD: f64 = 130.0;
const FOOT: f64 = 110.0;
/// Of letters.
const TEXT: f64 = 22.0;
/// Nothing is drawn larger, units a millimetre.
const LARGEST: f64 = 40.0;

/// Beads of one kind: class in the picture, colour, words.
const KINDS: [(&str, &str, &str); 3] = [
    ("done", "#9aa0a8", "printed"),
    ("twice", "#e07b00", "may be printed twice"),
    ("todo", "#1f6fd0", "still to print"),
];

/// The picture for a print of which `n_done` lines are done and the next `n_doubt` may be.
///
/// # Errors
/// The job cannot be read any more.
pub fn svg<R: BufRead + Seek>(
    job: &mut Job<R>,
    profile: &Profile,
    n_done: u64,
    n_doubt: u64,
) -> Result<String, job::Error> {
    let mut modal = Modal::new(profile.firmware.dialect);
    job.replay(n_done, |command| {
        modal.apply(command);
    })?;
    let at = modal.at_mm;
    let mut beads: [Vec<[f64; 4]>; 3] = Default::default();
    let mut follow = Modal::new(profile.firmware.dialect);
    let mut n = 0_u64;
    job.replay(job.n_lines(), |command| {
        let before = follow.at_mm;
        follow.apply(command);
        n += 1;
        if let Some(bead) = bead(before, follow.at_mm, at[2]) {
            let kind = if n <= n_done {
                0
            } else if n <= n_done + n_doubt {
                1
            } else {
                2
            };
            beads[kind].push(bead);
        }
    })?;
    Ok(draw(&beads, at, n_done, n, profile.print.extrusion_width_mm))
}

/// From and to in the plane, where filament is pushed at this height.
fn bead(from: [Option<f64>; 4], to: [Option<f64>; 4], z_mm: Option<f64>) -> Option<[f64; 4]> {
    let is_here = (to[2]? - z_mm?).abs() < SAME_HEIGHT_MM;
    let ends = [from[0]?, from[1]?, to[0]?, to[1]?];
    (is_here && to[3]? > from[3]? && ends[..2] != ends[2..]).then_some(ends)
}

/// Where the layer lies in the picture.
struct Frame {
    low: [f64; 2],
    high: [f64; 2],
    /// Units a millimetre.
    scale: f64,
    height: f64,
}

impl Frame {
    /// Around these beads and the place where it goes on; a centimetre where there is nothing.
    fn around(beads: &[Vec<[f64; 4]>; 3], at: [Option<f64>; 4]) -> Self {
        let [mut low, mut high] = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        let ends = beads.iter().flatten().flat_map(|b| [[b[0], b[1]], [b[2], b[3]]]);
        for point in ends.chain(at[0].zip(at[1]).map(|(x, y)| [x, y])) {
            for axis in 0..2 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
            }
        }
        if !low[0].is_finite() {
            (low, high) = ([0.0; 2], [10.0; 2]);
        }
        let size = [high[0] - low[0], high[1] - low[1]];
        let scale = (LAYER / size[0].max(size[1]).max(1.0)).min(LARGEST);
        Self { low, high, scale, height: HEAD + size[1] * scale + FOOT }
    }

    fn place(&self, x_mm: f64, y_mm: f64) -> [f64; 2] {
        let middle_mm = f64::midpoint(self.low[0], self.high[0]);
        [(x_mm - middle_mm).mul_add(self.scale, WIDTH / 2.0), (self.high[1] - y_mm).mul_add(self.scale, HEAD)]
    }
}

fn draw(
    beads: &[Vec<[f64; 4]>; 3],
    at: [Option<f64>; 4],
    n_done: u64,
    n_lines: u64,
    width_mm: f64,
) -> String {
    let frame = Frame::around(beads, at);
    let z_mm = at[2].unwrap_or(0.0);
    let title = format!("Layer at Z {z_mm:.3} mm: goes on behind line {n_done} of {n_lines}");
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH:.1} {:.1}\" fill=\"none\" \
         font-family=\"sans-serif\" font-size=\"{TEXT}\">\n<title>{title}</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"20\" y=\"40\" fill=\"black\" font-weight=\"bold\">{title}</text>\n",
        frame.height
    );
    legend(&mut text);
    let stroke = (width_mm * frame.scale * 0.85).max(1.5);
    for ((class, colour, words), beads) in KINDS.iter().zip(beads) {
        add(
            &mut text,
            format_args!(
                "<path class=\"{class}\" stroke=\"{colour}\" stroke-width=\"{stroke:.1}\" stroke-linecap=\"round\" d=\""
            ),
        );
        for [x0, y0, x1, y1] in beads {
            let ([x0, y0], [x1, y1]) = (frame.place(*x0, *y0), frame.place(*x1, *y1));
            add(&mut text, format_args!("M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}"));
        }
        add(&mut text, format_args!("\"><title>{words}</title></path>\n"));
    }
    if let [Some(x), Some(y), ..] = at {
        mark(&mut text, frame.place(x, y));
    }
    foot(&mut text, &frame);
    text.push_str("</svg>\n");
    text
}

fn add(text: &mut String, piece: std::fmt::Arguments<'_>) {
    text.write_fmt(piece).expect("writing to a string cannot fail");
}

/// What the colours mean, in one line.
fn legend(text: &mut String) {
    let mut x = 20.0;
    for (_, colour, words) in KINDS {
        add(
            text,
            format_args!(
                "<path stroke=\"{colour}\" stroke-width=\"14\" d=\"M{x} 80h40\"/>\
                 <text x=\"{}\" y=\"89\" fill=\"black\">{words}</text>\n",
                x + 52.0
            ),
        );
        x += 12.2_f64.mul_add(words.len() as f64, 78.0);
    }
    add(
        text,
        format_args!(
            "<circle cx=\"{}\" cy=\"80\" r=\"12\" stroke=\"#d01f3c\" stroke-width=\"5\"/>\
             <text x=\"{}\" y=\"89\" fill=\"black\">goes on here</text>\n",
            x + 12.0,
            x + 34.0
        ),
    );
}

/// A ring and a cross, large enough to be found.
fn mark(text: &mut String, [cx, cy]: [f64; 2]) {
    add(
        text,
        format_args!(
            "<g class=\"here\" stroke=\"white\" stroke-width=\"11\"><circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"22\"/></g>\n\
             <g class=\"here\" stroke=\"#d01f3c\" stroke-width=\"5\"><circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"22\"/>\
             <path d=\"M{:.1} {cy:.1}h-24M{:.1} {cy:.1}h24M{cx:.1} {:.1}v-24M{cx:.1} {:.1}v24\"/></g>\n",
            cx - 22.0,
            cx + 22.0,
            cy - 22.0,
            cy + 22.0
        ),
    );
}

/// A scale, and where the operator stands.
fn foot(text: &mut String, frame: &Frame) {
    let mm = [100.0, 50.0, 20.0, 10.0, 5.0].into_iter().find(|mm| mm * frame.scale <= 300.0).unwrap_or(1.0);
    let y = frame.height - 34.0;
    add(
        text,
        format_args!(
            "<path stroke=\"black\" stroke-width=\"3\" d=\"M20 {:.1}v16m0 -8h{:.1}m0 -8v16\"/>\
             <text x=\"{:.1}\" y=\"{y:.1}\" fill=\"black\">{mm} mm</text>\n\
             <text x=\"{:.1}\" y=\"{y:.1}\" fill=\"black\" text-anchor=\"end\">front of the printer (least y)</text>\n",
            y - 16.0,
            mm * frame.scale,
            mm.mul_add(frame.scale, 36.0),
            WIDTH - 20.0
        ),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(svg: &str, class: &str) -> usize {
        let path = svg.lines().find(|line| line.contains(&format!("class=\"{class}\""))).unwrap();
        path.matches('M').count()
    }

    #[test]
    fn a_layer_shows_what_is_done_in_doubt_and_to_do() {
        let profile = crate::profile::builtin("marlin").unwrap();
        let text = "G90\nM83\nG1 X0 Y0 Z0.2\nG1 X10 E1\nG1 X20 E1\nG1 Z0.4\nG1 X10 E1\nG1 X0 E1\nG1 X1 E1\nG1 X2 E1\nG1 X5\n";
        let mut job = Job::from_text(text, "j", &profile.firmware).unwrap();
        let picture = svg(&mut job, &profile, 7, 2).unwrap();
        assert_eq!([count(&picture, "done"), count(&picture, "twice"), count(&picture, "todo")], [1, 2, 1]);
        assert!(picture.contains("Layer at Z 0.400 mm: goes on behind line 7 of 11"), "{picture}");
        // From X 0 to X 20, 40 units each, in the middle: X 10.
        assert!(picture.contains("cx=\"500.0\""), "{picture}");
        for words in [
            "printed",
            "may be printed twice",
            "still to print",
            "goes on here",
            "front of the printer",
            "5 mm",
        ] {
            assert!(picture.contains(words), "{words}");
        }
    }

    #[test]
    fn a_job_without_beads_there_is_an_empty_picture() {
        let profile = crate::profile::builtin("marlin").unwrap();
        let mut job = Job::from_text("G28\nM84\n", "j", &profile.firmware).unwrap();
        let picture = svg(&mut job, &profile, 1, 0).unwrap();
        assert!(picture.starts_with("<svg") && picture.ends_with("</svg>\n") && !picture.contains("NaN"));
    }
}
