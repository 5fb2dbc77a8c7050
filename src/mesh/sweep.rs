//! How many triangles a deflection costs, as a table (CSV) and as a plot (SVG, both axes logarithmic).

use super::MeasuredMesh;
use std::fmt::Write;

/// The deflections of the table, mm.
pub const DEFLECTIONS_MM: [f64; 5] = [0.1, 0.05, 0.02, 0.01, 0.005];

const HEADING: &str = "deflection_mm,n_triangles,largest_deviation_mm,volume_mm3,min_angle_p5_deg\n";

/// The table.
#[must_use]
pub fn csv(rows: &[MeasuredMesh]) -> String {
    let mut text = HEADING.to_owned();
    for r in rows {
        put(
            &mut text,
            format_args!(
                "{},{},{:.6},{:.4},{:.2}\n",
                r.deflection_mm, r.n_triangles, r.largest_deviation_mm, r.volume_mm3, r.min_angle_p5_deg
            ),
        );
    }
    text
}

const WIDTH: f64 = 980.0;
const HEIGHT: f64 = 440.0;
const TOP: f64 = 48.0;
const BOTTOM: f64 = 372.0;
const BLUE: &str = "#1f5fa8";
const ORANGE: &str = "#b35a00";

/// The plot: triangles, and measured deviation, each against the deflection asked for. Empty without rows.
#[must_use]
pub fn svg(rows: &[MeasuredMesh]) -> String {
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" \
         height=\"{HEIGHT}\" font-family=\"sans-serif\" font-size=\"14\" fill=\"#222\">\n\
         <title>Triangles and measured deviation against deflection</title>\n\
         <rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"#fff\"/>\n"
    );
    let triangles: Vec<[f64; 2]> = rows.iter().map(|r| [r.deflection_mm, r.n_triangles as f64]).collect();
    let deviations: Vec<[f64; 2]> = rows.iter().map(|r| [r.deflection_mm, r.largest_deviation_mm]).collect();
    let asked: Vec<[f64; 2]> = rows.iter().map(|r| [r.deflection_mm; 2]).collect();
    if let Some(panel) = Panel::of([104.0, 474.0], &[&triangles]) {
        panel.frame(&mut text, "Triangles", "number of triangles");
        panel.curve(&mut text, &triangles, BLUE, false);
        panel.values(&mut text, &triangles);
    }
    if let Some(panel) = Panel::of([594.0, 964.0], &[&deviations, &asked]) {
        panel.frame(&mut text, "Deviation: measured (solid), asked for (dashed)", "largest deviation, mm");
        panel.curve(&mut text, &asked, ORANGE, true);
        panel.curve(&mut text, &deviations, BLUE, false);
    }
    text + "</svg>\n"
}

fn put(text: &mut String, what: std::fmt::Arguments<'_>) {
    text.write_fmt(what).expect("a string takes every text");
}

/// A diagram with logarithmic axes; ranges are in decades.
struct Panel {
    left: f64,
    right: f64,
    x: [f64; 2],
    y: [f64; 2],
}

impl Panel {
    /// Around all curves; `None` where they have no extent or values that have no logarithm.
    fn of([left, right]: [f64; 2], curves: &[&[[f64; 2]]]) -> Option<Self> {
        let range = |k: usize| {
            let values = curves.iter().flat_map(|c| c.iter()).map(|p| p[k].log10());
            let [low, high] =
                values.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)]);
            (low.is_finite() && high.is_finite()).then_some([low - 0.1, high + 0.2])
        };
        Some(Self { left, right, x: range(0)?, y: range(1)? })
    }

    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let part = |v: f64, [low, high]: [f64; 2]| (v.log10() - low) / (high - low);
        let (px, py) = (part(x, self.x), part(y, self.y));
        [self.left + px * (self.right - self.left), BOTTOM - py * (BOTTOM - TOP)]
    }

    fn frame(&self, text: &mut String, title: &str, y_title: &str) {
        let (left, right) = (self.left, self.right);
        let middle = 0.5 * (left + right);
        for v in ticks(self.x) {
            let [x, _] = self.place([v, 1.0]);
            put(text, format_args!("<path d=\"M{x:.1} {TOP}V{BOTTOM}\" stroke=\"#ddd\"/>\n"));
            put(
                text,
                format_args!(
                    "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{v}</text>\n",
                    BOTTOM + 20.0
                ),
            );
        }
        for v in ticks(self.y) {
            let [_, y] = self.place([1.0, v]);
            put(text, format_args!("<path d=\"M{left} {y:.1}H{right}\" stroke=\"#ddd\"/>\n"));
            let label = grouped(v);
            put(
                text,
                format_args!(
                    "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>\n",
                    left - 7.0,
                    y + 5.0
                ),
            );
        }
        let (width, height) = (right - left, BOTTOM - TOP);
        put(
            text,
            format_args!(
                "<rect x=\"{left}\" y=\"{TOP}\" width=\"{width}\" height=\"{height}\" fill=\"none\" stroke=\"#888\"/>\n"
            ),
        );
        put(
            text,
            format_args!(
                "<text x=\"{middle}\" y=\"{:.1}\" text-anchor=\"middle\" font-weight=\"bold\">{title}</text>\n",
                TOP - 16.0
            ),
        );
        put(
            text,
            format_args!(
                "<text x=\"{middle}\" y=\"{:.1}\" text-anchor=\"middle\">deflection asked for, mm</text>\n",
                BOTTOM + 46.0
            ),
        );
        let (x, y) = (left - 76.0, 0.5 * (TOP + BOTTOM));
        put(
            text,
            format_args!(
                "<text transform=\"translate({x} {y}) rotate(-90)\" text-anchor=\"middle\">{y_title}</text>\n"
            ),
        );
    }

    fn curve(&self, text: &mut String, points: &[[f64; 2]], colour: &str, is_dashed: bool) {
        let places: Vec<[f64; 2]> = points.iter().map(|&p| self.place(p)).collect();
        let line: Vec<String> = places.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
        let dash = if is_dashed { " stroke-dasharray=\"7 5\"" } else { "" };
        put(
            text,
            format_args!(
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"{dash}/>\n",
                line.join(" ")
            ),
        );
        for [x, y] in places.iter().filter(|_| !is_dashed) {
            put(text, format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"{colour}\"/>\n"));
        }
    }

    fn values(&self, text: &mut String, points: &[[f64; 2]]) {
        for &p in points {
            let [x, y] = self.place(p);
            put(
                text,
                format_args!(
                    "<text x=\"{:.1}\" y=\"{:.1}\" font-size=\"12\">{}</text>\n",
                    x + 8.0,
                    y - 6.0,
                    grouped(p[1])
                ),
            );
        }
    }
}

/// 1, 2 and 5 of every decade in the range.
fn ticks([low, high]: [f64; 2]) -> Vec<f64> {
    #[expect(clippy::cast_possible_truncation, reason = "decades of lengths and counts")]
    let decades = low.floor() as i32..=high.floor() as i32;
    let of_decade = |d: i32| {
        // Parsed, so that 0.1 is the 0.1 that is written.
        [1, 2, 5].map(|m| format!("{m}e{d}").parse::<f64>().expect("a number"))
    };
    decades.flat_map(of_decade).filter(|v| (low..=high).contains(&v.log10())).collect()
}

/// A number with its thousands apart.
fn grouped(value: f64) -> String {
    let text = value.to_string();
    if value < 1e4 {
        return text;
    }
    let n = text.len();
    text.chars().enumerate().fold(String::new(), |mut out, (i, c)| {
        if i > 0 && (n - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(c);
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Vec<MeasuredMesh> {
        let row = |deflection_mm: f64| MeasuredMesh {
            deflection_mm,
            n_triangles: 12_345,
            largest_deviation_mm: 0.9 * deflection_mm,
            volume_mm3: 100.0,
            min_angle_p5_deg: 41.0,
        };
        DEFLECTIONS_MM.map(row).to_vec()
    }

    #[test]
    fn the_table_has_a_line_a_deflection() {
        let table = csv(&rows());
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!(lines.len(), 6);
        assert_eq!(lines[0], HEADING.trim_end());
        assert_eq!(lines[3], "0.02,12345,0.018000,100.0000,41.00");
    }

    #[test]
    fn the_plot_names_its_axes_and_has_a_point_a_deflection_and_curve() {
        let plot = svg(&rows());
        for text in [
            ">deflection asked for, mm<",
            ">largest deviation, mm<",
            ">number of triangles<",
            ">12 345<",
            ">0.05<",
        ] {
            assert!(plot.contains(text), "{text}");
        }
        assert_eq!(plot.matches("<circle").count(), 10);
        assert!(!plot.contains("NaN") && !plot.contains("inf"));
        assert!(!svg(&[]).contains("circle"));
    }

    #[test]
    fn ticks_are_round_numbers_of_the_range() {
        assert_eq!(ticks([-2.3, -0.9]), [0.01, 0.02, 0.05, 0.1]);
        assert_eq!(grouped(1_234_567.0), "1 234 567");
        assert_eq!(grouped(0.05), "0.05");
    }
}
