//! Figures to the coordinates of small vector charts.

use super::super::{Report, Stage};
use super::spread::{histograms, triangles};
use serde::Serialize;

const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 240.0;
const LEFT: f64 = 112.0;
const BOTTOM: f64 = 30.0;
const TOP: f64 = 22.0;
const RIGHT: f64 = 18.0;
pub(super) const DARK: &str = "#1f5fa8";
const LIGHT: &str = "#a9c8ea";
const WARM: &str = "#b35a00";
const SCANNED: &str = "#7a2fb0";

/// A chart as shapes.
#[derive(Serialize, Default)]
pub(in super::super) struct Chart {
    pub(in super::super) title: &'static str,
    pub(in super::super) description: String,
    pub(in super::super) width: f64,
    pub(in super::super) height: f64,
    pub(in super::super) grid: Vec<Line>,
    pub(in super::super) bars: Vec<Bar>,
    pub(in super::super) curves: Vec<Curve>,
    pub(in super::super) labels: Vec<Label>,
}

#[derive(Serialize)]
pub(in super::super) struct Line {
    pub(in super::super) x0: f64,
    pub(in super::super) y0: f64,
    pub(in super::super) x1: f64,
    pub(in super::super) y1: f64,
}

#[derive(Serialize)]
pub(in super::super) struct Bar {
    pub(in super::super) x: f64,
    pub(in super::super) y: f64,
    pub(in super::super) width: f64,
    pub(in super::super) height: f64,
    pub(in super::super) colour: &'static str,
}

#[derive(Serialize)]
pub(in super::super) struct Curve {
    pub(in super::super) points: String,
    pub(in super::super) colour: &'static str,
    pub(in super::super) dash: Option<&'static str>,
}

#[derive(Serialize)]
pub(in super::super) struct Label {
    pub(in super::super) x: f64,
    pub(in super::super) y: f64,
    pub(in super::super) anchor: &'static str,
    pub(in super::super) colour: Option<&'static str>,
    pub(in super::super) text: String,
}

/// The charts that the report has figures for.
pub(super) fn all(report: &Report) -> Vec<Chart> {
    let charts = [stages(report), histograms(report), along(report), areas(report), triangles(report)];
    charts.into_iter().flatten().collect()
}

/// Mean and 95th percentile of each stage as bars.
fn stages(report: &Report) -> Option<Chart> {
    let figures: Vec<_> = report.stages().map(|s| report.block(s).overall.map(|o| o.figures)).collect();
    let most = figures.iter().flatten().filter_map(|f| f.p95_mm).fold(0.0, f64::max);
    let scale = Scale::new(0.0, most, LEFT, WIDTH - RIGHT)?;
    let mut chart = Chart {
        title: "Mean (dark) and 95th percentile (light) of each step, mm",
        description: "Bars of the mean and the 95th percentile of the distance in each step; the numbers are in the table above.".into(),
        ..blank()
    };
    vertical_grid(&mut chart, &scale);
    let pitch = (HEIGHT - TOP - BOTTOM) / figures.len() as f64;
    for (i, (stage, f)) in report.stages().zip(figures).enumerate() {
        let y = TOP + pitch * i as f64;
        chart.labels.push(Label {
            x: LEFT - 8.0,
            y: y + 0.6 * pitch,
            anchor: "end",
            colour: None,
            text: super::title(stage).into(),
        });
        let f = f.unwrap_or_default();
        for (value, colour, part) in [(f.p95_mm, LIGHT, 0.7), (f.mean_mm, DARK, 0.34)] {
            let width = shape(scale.at(value.unwrap_or(0.0)) - LEFT);
            let height = shape(pitch * part);
            chart.bars.push(Bar { x: LEFT, y: shape(y + 0.5 * (pitch - height)), width, height, colour });
        }
    }
    Some(chart)
}

/// Total mean and 95th percentile along the vessel.
fn along(report: &Report) -> Option<Chart> {
    let planes = &report.block(Stage::Total).planes;
    let of = |value: fn(&super::Figures) -> Option<f64>| -> Vec<(f64, f64)> {
        planes.iter().filter_map(|p| Some((p.z_mm, value(&p.figures)?))).collect()
    };
    let curves =
        [("mean", of(|f| f.mean_mm), DARK, None), ("95th percentile", of(|f| f.p95_mm), WARM, Some("6 3"))];
    let mut chart = curve_chart(&curves)?;
    chart.title = "Total error along the vessel, mm over z in mm";
    chart.description =
        "Curves of the mean and the 95th percentile of the total error over the height of the plane; the numbers are in the table below.".into();
    Some(chart)
}

/// Lumen area along the vessel, all branches of a plane together: contours, recorded, scanned.
fn areas(report: &Report) -> Option<Chart> {
    let of = |stage: &str| -> Vec<(f64, f64)> {
        let at = |(k, &z): (usize, &f64)| {
            let stages = report.anatomy.branches.iter().flat_map(|b| &b.stages).filter(|s| s.stage == stage);
            let measures = stages.flat_map(|s| &s.planes).filter(|p| p.plane == k);
            let areas: Vec<f64> = measures.map(|p| p.lumen_area_mm2).collect();
            (!areas.is_empty()).then(|| (z, areas.iter().sum()))
        };
        report.plane_z_mm.iter().enumerate().filter_map(at).collect()
    };
    let word = report.origin.word();
    let mut curves =
        vec![("contours", of("contours"), DARK, None), (word, of("recorded"), WARM, Some("6 3"))];
    if report.scan.is_some() {
        curves.push(("scanned", of("scanned"), SCANNED, Some("2 3")));
    }
    let mut chart = curve_chart(&curves)?;
    chart.title = "Lumen area along the vessel, mm\u{b2} over z in mm";
    chart.description = format!(
        "Curves of the lumen area over the height of the plane, segmented and {}, all branches together.",
        report.origin.known()
    );
    Some(chart)
}

type Named<'a> = (&'a str, Vec<(f64, f64)>, &'static str, Option<&'static str>);

fn curve_chart(curves: &[Named<'_>]) -> Option<Chart> {
    let points = || curves.iter().flat_map(|c| c.1.iter());
    let (z0, z1) = points().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p.0), b.max(p.0)));
    let most = points().map(|p| p.1).fold(0.0, f64::max);
    let x = Scale { from: z0, to: z1, start: LEFT * 0.6, end: WIDTH - RIGHT };
    let y = Scale::new(0.0, most, HEIGHT - BOTTOM, TOP)?;
    if z1.partial_cmp(&z0) != Some(std::cmp::Ordering::Greater) {
        return None;
    }
    let mut chart = blank();
    for value in y.ticks() {
        let at = shape(y.at(value));
        chart.grid.push(Line { x0: x.start, y0: at, x1: x.end, y1: at });
        chart.labels.push(Label {
            x: x.start - 6.0,
            y: at + 4.0,
            anchor: "end",
            colour: None,
            text: tidy(value),
        });
    }
    for value in [z0, 0.5 * (z0 + z1), z1] {
        let text = format!("{value:.1}");
        chart.labels.push(Label {
            x: shape(x.at(value)),
            y: HEIGHT - 10.0,
            anchor: "middle",
            colour: None,
            text,
        });
    }
    for (i, (name, points, colour, dash)) in curves.iter().enumerate() {
        let text: Vec<String> = points.iter().map(|p| format!("{:.1},{:.1}", x.at(p.0), y.at(p.1))).collect();
        chart.curves.push(Curve { points: text.join(" "), colour, dash: *dash });
        let at = x.start + 10.0 + 110.0 * i as f64;
        chart.curves.push(Curve { points: format!("{at:.1},10 {:.1},10", at + 24.0), colour, dash: *dash });
        chart.labels.push(Label {
            x: at + 30.0,
            y: 14.0,
            anchor: "start",
            colour: Some(colour),
            text: (*name).into(),
        });
    }
    Some(chart)
}

pub(super) fn blank() -> Chart {
    Chart { width: WIDTH, height: HEIGHT, ..Chart::default() }
}

fn vertical_grid(chart: &mut Chart, scale: &Scale) {
    for value in scale.ticks() {
        let x = shape(scale.at(value));
        chart.grid.push(Line { x0: x, y0: TOP, x1: x, y1: HEIGHT - BOTTOM });
        chart.labels.push(Label { x, y: HEIGHT - 10.0, anchor: "middle", colour: None, text: tidy(value) });
    }
}

/// Values to places along an axis.
struct Scale {
    from: f64,
    to: f64,
    start: f64,
    end: f64,
}

impl Scale {
    /// From `from` to a round value beyond `most`; `None` where nothing is above `from`.
    fn new(from: f64, most: f64, start: f64, end: f64) -> Option<Self> {
        if !(most > from && most.is_finite()) {
            return None;
        }
        let power = 10f64.powf((most - from).log10().floor());
        let rounded = [1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0].into_iter().map(|m| from + m * power);
        let to = rounded.clone().find(|to| *to >= most).unwrap_or(from + 10.0 * power);
        Some(Self { from, to, start, end })
    }

    fn at(&self, value: f64) -> f64 {
        self.start + (value - self.from) / (self.to - self.from) * (self.end - self.start)
    }

    fn ticks(&self) -> [f64; 3] {
        [self.from, 0.5 * (self.from + self.to), self.to]
    }
}

/// A coordinate with one decimal.
pub(super) fn shape(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

pub(super) fn tidy(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').into()
}
