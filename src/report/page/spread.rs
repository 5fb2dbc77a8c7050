//! Histograms of the stages, and what triangles cost, as charts.

use super::super::{Histogram, Report};
use super::chart::{Bar, Chart, Curve, DARK, Label, Line, blank, shape, tidy};

const WIDTH: f64 = 560.0;
/// Height of a row of panels, and of the drawing in it.
const ROW: f64 = 112.0;
const PANEL: f64 = 62.0;
const PITCH: f64 = WIDTH / 3.0;
const TOP: f64 = 26.0;

/// How the signed distances of every stage are spread: a panel each.
pub(super) fn histograms(report: &Report) -> Option<Chart> {
    let mut chart = Chart {
        title: "Spread of the error of each step: samples over signed distance, mm",
        description:
            "Histograms of the signed distance, one a step, positive outside; the numbers are in report.json."
                .into(),
        height: (if report.scan.is_some() { 3.0 } else { 2.0 }) * ROW,
        ..blank()
    };
    let mut n_panels = 0;
    for (i, stage) in report.stages().enumerate() {
        let Some(histogram) = &report.block(stage).histogram else { continue };
        let at = [PITCH * (i % 3) as f64 + 10.0, ROW * (i / 3) as f64 + TOP];
        panel(&mut chart, super::title(stage), histogram, at);
        n_panels += 1;
    }
    (n_panels > 0).then_some(chart)
}

fn panel(chart: &mut Chart, title: &str, histogram: &Histogram, [left, top]: [f64; 2]) {
    let (n, right) = (histogram.counts.len(), left + PITCH - 20.0);
    let most = histogram.counts.iter().copied().max().unwrap_or(0).max(1);
    let all = histogram.counts.iter().chain(&histogram.beyond).sum::<usize>().max(1);
    let mut label = |x: f64, y: f64, anchor, text: String| {
        chart.labels.push(Label { x: shape(x), y: shape(y), anchor, colour: None, text });
    };
    label(left, top - 8.0, "start", title.into());
    label(right, top - 8.0, "end", format!("highest {:.0} %", 100.0 * most as f64 / all as f64));
    let end_mm = -histogram.from_mm;
    label(left, top + PANEL + 14.0, "start", format!("-{}", tidy(end_mm)));
    label(0.5 * (left + right), top + PANEL + 14.0, "middle", "0".into());
    label(right, top + PANEL + 14.0, "end", format!("+{}", tidy(end_mm)));
    let step = (right - left) / n as f64;
    for (i, &count) in histogram.counts.iter().enumerate().filter(|(_, c)| **c > 0) {
        let height = (PANEL * count as f64 / most as f64).max(0.6);
        chart.bars.push(Bar {
            x: shape(left + step * i as f64),
            y: shape(top + PANEL - height),
            width: shape(step * 0.9),
            height: shape(height),
            colour: DARK,
        });
    }
    let bottom = shape(top + PANEL);
    chart.grid.push(Line { x0: shape(left), y0: bottom, x1: shape(right), y1: bottom });
}

/// Triangles of the lumen against deflection, both logarithmic.
pub(super) fn triangles(report: &Report) -> Option<Chart> {
    let rows: Vec<[f64; 2]> = report
        .triangles
        .iter()
        .filter(|t| t.deflection_mm > 0.0 && t.n_triangles > 0)
        .map(|t| [t.deflection_mm, t.n_triangles as f64])
        .collect();
    let [x, y] = [0, 1].map(|axis| Decades::of(rows.iter().map(|r| r[axis])));
    let (x, y) = (x?.along(70.0, WIDTH - 30.0), y?.along(200.0, 24.0));
    let mut chart = Chart {
        title: "What fineness costs: triangles of the lumen over deflection, mm",
        description: "Number of triangles over the farthest distance of surface and triangles, both axes logarithmic; the numbers are in report.json."
            .into(),
        ..blank()
    };
    let mut points = Vec::new();
    for &[deflection_mm, n] in &rows {
        let (px, py) = (shape(x.at(deflection_mm)), shape(y.at(n)));
        points.push(format!("{px},{py}"));
        chart.grid.push(Line { x0: px, y0: 24.0, x1: px, y1: 200.0 });
        chart.bars.push(Bar {
            x: shape(px - 2.5),
            y: shape(py - 2.5),
            width: 5.0,
            height: 5.0,
            colour: DARK,
        });
        let mut label = |y: f64, text: String| {
            chart.labels.push(Label { x: px, y, anchor: "middle", colour: None, text });
        };
        label(218.0, tidy(deflection_mm));
        label(shape(py - 8.0), format!("{n:.0}"));
    }
    chart.curves.push(Curve { points: points.join(" "), colour: DARK, dash: None });
    Some(chart)
}

/// A logarithmic range; places along an axis.
struct Decades {
    low: f64,
    high: f64,
    start: f64,
    end: f64,
}

impl Decades {
    /// Around values; `None` where they have no extent.
    fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        let [low, high] =
            values.map(f64::log10).fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)]);
        (high > low).then_some(Self { low, high, start: 0.0, end: 1.0 })
    }

    const fn along(self, start: f64, end: f64) -> Self {
        Self { start, end, ..self }
    }

    fn at(&self, value: f64) -> f64 {
        self.start + (value.log10() - self.low) / (self.high - self.low) * (self.end - self.start)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::{build, testing::Case, testing::inputs};
    use super::*;
    use crate::progress::Task;
    use crate::report::Stage;

    #[test]
    fn every_step_has_its_histogram_and_fineness_its_curve() {
        let report = build(&inputs(&Case::new(3)), &Task::quiet()).unwrap();
        let chart = histograms(&report).unwrap();
        let titles =
            chart.labels.iter().filter(|l| Stage::ALL.iter().any(|&s| super::super::title(s) == l.text));
        assert_eq!(titles.count(), 6);
        assert!(chart.bars.iter().all(|b| b.height <= PANEL && b.x >= 0.0 && b.x + b.width <= WIDTH));
        let chart = triangles(&report).unwrap();
        // Ten times finer, ten times the triangles: from one corner to the other.
        assert_eq!(chart.curves[0].points, "530,200 70,24");
        let none = Report { triangles: Vec::new(), ..report };
        assert!(triangles(&none).is_none());
    }
}
