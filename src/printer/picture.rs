//! The layer in which a print will go on, as a picture (SVG): what is done, what may be printed twice, what is to do.
//!
//! Drawn from the job alone: all beads at the height of the line where it goes on. Frame: the bed, y upwards, 10 units a
//! millimetre. Arcs are drawn as their chord. Memory: the beads of one layer.

use super::job::{self, Job};
use super::replay::Modal;
use crate::profile::Profile;
use std::fmt::Write as _;
use std::io::{BufRead, Seek};

/// Heights this close are one layer, mm.
const SAME_HEIGHT_MM: f64 = 1e-3;
/// Units a millimetre.
const SCALE: f64 = 10.0;
/// Around the layer, mm.
const MARGIN_MM: f64 = 4.0;

/// Beads of one kind: class in the picture, colour, words.
const KINDS: [(&str, &str, &str); 3] =
    [("done", "#8a8f98", "done"), ("twice", "#e07b00", "may be printed twice"), ("todo", "#1f6fd0", "to do")];

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
    Ok(draw(&beads, at, n_done, n))
}

/// From and to in the plane, where filament is pushed at this height.
fn bead(from: [Option<f64>; 4], to: [Option<f64>; 4], z_mm: Option<f64>) -> Option<[f64; 4]> {
    let is_here = (to[2]? - z_mm?).abs() < SAME_HEIGHT_MM;
    let ends = [from[0]?, from[1]?, to[0]?, to[1]?];
    (is_here && to[3]? > from[3]? && ends[..2] != ends[2..]).then_some(ends)
}

fn draw(beads: &[Vec<[f64; 4]>; 3], at: [Option<f64>; 4], n_done: u64, n_lines: u64) -> String {
    let [mut low, mut high] = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    for (axis, value) in beads.iter().flatten().flat_map(|b| [(0, b[0]), (1, b[1]), (0, b[2]), (1, b[3])]) {
        low[axis] = low[axis].min(value);
        high[axis] = high[axis].max(value);
    }
    if !low[0].is_finite() {
        (low, high) = ([0.0; 2], [10.0; 2]);
    }
    let left = low[0] - MARGIN_MM;
    let top = high[1] + MARGIN_MM;
    let size = [high[0] - low[0] + 2.0 * MARGIN_MM, high[1] - low[1] + 2.0 * MARGIN_MM].map(|mm| mm * SCALE);
    let place = |x: f64, y: f64| format!("{:.2} {:.2}", (x - left) * SCALE, (top - y) * SCALE);
    let z_mm = at[2].unwrap_or(0.0);
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {:.1} {:.1}\" fill=\"none\" stroke-width=\"3\" \
         stroke-linecap=\"round\">\n<title>Z {z_mm:.3} mm, behind line {n_done} of {n_lines}</title>\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        size[0], size[1]
    );
    for ((class, colour, words), beads) in KINDS.iter().zip(beads) {
        write!(text, "<path class=\"{class}\" stroke=\"{colour}\" d=\"")
            .expect("writing to a string cannot fail");
        for [x0, y0, x1, y1] in beads {
            write!(text, "M{}L{}", place(*x0, *y0), place(*x1, *y1))
                .expect("writing to a string cannot fail");
        }
        writeln!(text, "\"><title>{words}</title></path>").expect("writing to a string cannot fail");
    }
    if let [Some(x), Some(y), ..] = at {
        let [cx, cy] = [(x - left) * SCALE, (top - y) * SCALE];
        writeln!(text, "<circle class=\"here\" cx=\"{cx:.2}\" cy=\"{cy:.2}\" r=\"8\" stroke=\"#d01f3c\"/>")
            .expect("writing to a string cannot fail");
    }
    text.push_str("</svg>\n");
    text
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
        assert!(picture.contains("Z 0.400 mm, behind line 7 of 11"), "{picture}");
        // X 10 is 14 mm from the left edge: the margin and the way from the leftmost place.
        assert!(picture.contains("cx=\"140.00\""), "{picture}");
    }

    #[test]
    fn a_job_without_beads_there_is_an_empty_picture() {
        let profile = crate::profile::builtin("marlin").unwrap();
        let mut job = Job::from_text("G28\nM84\n", "j", &profile.firmware).unwrap();
        let picture = svg(&mut job, &profile, 1, 0).unwrap();
        assert!(picture.starts_with("<svg") && picture.ends_with("</svg>\n") && !picture.contains("NaN"));
    }
}
