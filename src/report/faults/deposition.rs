//! Recorded against planned beads over all layers.

use super::bead::{Piece, planned, shape_of};
use super::heights::{Aligned, align, near_segments};
use super::matched::{Matched, Role, Where, matched};
use super::series::{Span, of_scalars, spans};
use super::{Finding, Kind, Place, Size, told};
use crate::geom::Vector2;
use crate::profile::Gate;
use crate::report::{Inputs, Stage};
use crate::slice::LayerSlot;
use nalgebra::Matrix2;
use rayon::prelude::*;

/// Smaller shifts of layers are none, mm.
const LEAST_SHIFT_MM: f64 = 0.02;
/// Smaller changes of flow are none, as a part.
const LEAST_FLOW: f64 = 0.02;
/// Smaller turns are none, rad.
const LEAST_TURN: f64 = 0.0015;
/// Smaller changes of scale are none, as a part.
const LEAST_SCALE: f64 = 0.002;
/// Less of the planned length than this is not missed, as a part.
const LEAST_MISSING: f64 = 0.03;
/// Less material than this beside the beads is none, mm³ a layer.
const LEAST_EXTRA_MM3: f64 = 0.004;
/// A layer with less of its length than this is missing.
const NEXT_TO_NOTHING: f64 = 0.02;
/// Layers off by less lie at their height, mm.
const LEAST_RISE_MM: f64 = 0.02;
/// Layers thicker by less are as planned, as a part.
const LEAST_THICKER: f64 = 0.1;
/// What a length from moments and rounded coordinates is worth, mm.
const LENGTH_UNCERTAINTY_MM: f64 = 0.001;

/// All findings of the stage, by layer.
pub(in crate::report) fn deposited(inputs: &Inputs<'_>) -> Vec<Finding> {
    let layers = &inputs.paths.layers;
    let aligned = align(inputs.paths, inputs.record);
    let shape = shape_of(aligned.of_layer.iter().flatten().copied());
    let matched: Vec<Matched> = layers
        .par_iter()
        .zip(&aligned.of_layer)
        .map(|(layer, own)| matched(layer, &own.iter().map(|s| Piece::from(*s)).collect::<Vec<_>>(), shape))
        .collect();
    let slots: Vec<LayerSlot> = layers.iter().map(|l| l.slot).collect();
    let view = View { slots: &slots, matched: &matched, aligned: &aligned, gate: inputs.gate };
    let mut findings = view.missing_layers();
    findings.extend(view.motions());
    findings.extend(view.flows());
    findings.extend(view.missing_beads());
    findings.extend(view.extras());
    findings.extend(view.rises(layers.iter().map(|l| l.z_mm).collect()));
    findings.extend(view.unrecognised());
    findings.extend(view.strays());
    findings.sort_by_key(|f| (f.place.layers, f.kind));
    findings
}

/// Material of the planned beads, and recorded near the job, mm³.
pub(in crate::report) fn volumes_mm3(inputs: &Inputs<'_>) -> [f64; 2] {
    let near = near_segments(inputs.paths, inputs.record);
    let shape = shape_of(near.iter().copied());
    let of_layer = |layer| planned(layer, shape).iter().map(|p| p.volume_mm3).sum::<f64>();
    [inputs.paths.layers.iter().map(of_layer).sum(), near.iter().map(|s| s.volume_mm3).sum()]
}

struct View<'a> {
    slots: &'a [LayerSlot],
    matched: &'a [Matched],
    aligned: &'a Aligned<'a>,
    gate: Gate,
}

impl View<'_> {
    fn finding(&self, kind: Kind, [first, last]: [usize; 2], size: Size, text: String) -> Finding {
        let place = Place::of_layers(self.slots, first, last);
        Finding {
            stage: Stage::Deposition.name(),
            kind,
            place,
            size: Some(size),
            vector_mm: None,
            beyond_gate: true,
            judged: true,
            text,
        }
    }

    fn top(&self) -> usize {
        self.slots.len() - 1
    }

    fn is_missing(&self, i: usize) -> bool {
        let m = &self.matched[i];
        m.planned.length_mm > 0.0 && m.recorded.length_mm < NEXT_TO_NOTHING * m.planned.length_mm
    }

    fn missing_layers(&self) -> Vec<Finding> {
        let runs = runs(self.slots.len(), 1, |i| self.is_missing(i));
        let finding = |[first, last]: [usize; 2]| {
            let size = Size { size: (last + 1 - first) as f64, unit: "layers", uncertainty: 0.0 };
            let layers = told("layer", [first, last]);
            if last == self.top() {
                let text = format!(
                    "the print stopped: nothing was deposited from layer {first} to the top (layer {last})"
                );
                self.finding(Kind::PrintStopped, [first, last], size, text)
            } else {
                self.finding(
                    Kind::MissingLayers,
                    [first, last],
                    size,
                    format!("{layers} missing: nothing was deposited there"),
                )
            }
        };
        runs.into_iter().map(finding).collect()
    }

    /// Turned, scaled, mirrored, shifted.
    fn motions(&self) -> Vec<Finding> {
        let linear: Vec<Option<Matrix2<f64>>> =
            self.matched.iter().map(|m| m.motion.map(|m| m.linear)).collect();
        let mut findings = self.mirrored(&linear);
        let mut explained: Vec<Matrix2<f64>> = vec![Matrix2::zeros(); self.slots.len()];
        let whole = |m: &Matrix2<f64>| m.determinant() > 0.0;
        let turn = |m: Matrix2<f64>| (m[(1, 0)] - m[(0, 1)]).atan2(m[(0, 0)] + m[(1, 1)]);
        let turns: Vec<Option<f64>> = linear.iter().map(|l| l.filter(whole).map(turn)).collect();
        let scales: Vec<Option<Vector2>> = linear
            .iter()
            .map(|l| {
                let back = nalgebra::Rotation2::new(-l.filter(whole).map(turn)?);
                let scaled = back.matrix() * (*l)?;
                Some(Vector2::new(scaled[(0, 0)] - 1.0, scaled[(1, 1)] - 1.0))
            })
            .collect();
        for span in of_scalars(&turns, LEAST_TURN) {
            findings.push(self.turned(&span));
            mark(&mut explained, &span, &linear);
        }
        for span in spans(&scales, LEAST_SCALE) {
            findings.push(self.scaled(&span));
            mark(&mut explained, &span, &linear);
        }
        findings.extend(self.shifts(&self.shifts_of(&explained)));
        findings
    }

    /// Shifts of the layers without what a turn or scale about some place makes of them.
    fn shifts_of(&self, explained: &[Matrix2<f64>]) -> Vec<Option<Vector2>> {
        let of = |(m, about): (&Matched, &Matrix2<f64>)| {
            m.motion.filter(|o| o.linear.determinant() > 0.0).map(|o| o.shift - about * m.centroid)
        };
        let shifts: Vec<Option<Vector2>> = self.matched.iter().zip(explained).map(of).collect();
        // Where the place about which all was turned lies is not known: the usual shift of these layers is taken for its doing.
        let turned = |i: &usize| explained[*i] != Matrix2::zeros();
        let of_turned: Vec<Vector2> = (0..shifts.len()).filter(turned).filter_map(|i| shifts[i]).collect();
        let usual =
            |get: fn(&Vector2) -> f64| crate::report::image::median(of_turned.iter().map(get)).unwrap_or(0.0);
        let usual = Vector2::new(usual(|v| v.x), usual(|v| v.y));
        (0..shifts.len()).map(|i| if turned(&i) { shifts[i].map(|s| s - usual) } else { shifts[i] }).collect()
    }

    fn mirrored(&self, linear: &[Option<Matrix2<f64>>]) -> Vec<Finding> {
        let is_mirrored = |i: usize| linear[i].is_some_and(|l| l.determinant() < 0.0);
        let finding = |[first, last]: [usize; 2]| {
            let size = Size { size: (last + 1 - first) as f64, unit: "layers", uncertainty: 0.0 };
            let text = format!(
                "{} mirrored: printed as a mirror image of what was planned",
                told("layer", [first, last])
            );
            self.finding(Kind::Mirrored, [first, last], size, text)
        };
        runs(self.slots.len(), 1, is_mirrored).into_iter().map(finding).collect()
    }

    fn turned(&self, span: &Span) -> Finding {
        let [begin, end] = [span.begin.x, span.end.x].map(f64::to_degrees);
        let layers = told("layer", [span.first, span.last]);
        let text = if span.is_gradual {
            format!("{layers} turned more and more, from {begin:+.2} to {end:+.2} degrees about the vertical")
        } else {
            format!("{layers} turned by {begin:+.2} degrees about the vertical")
        };
        let size = Size {
            size: span.most().x.to_degrees(),
            unit: "degrees",
            uncertainty: span.spread.to_degrees() + 0.01,
        };
        self.finding(Kind::Turned, [span.first, span.last], size, text)
    }

    fn scaled(&self, span: &Span) -> Finding {
        let percent = span.most() * 100.0;
        let even = (percent.x - percent.y).abs() < 0.1 * percent.norm();
        let worst = if even {
            0.5 * (percent.x + percent.y)
        } else if percent.x.abs() > percent.y.abs() {
            percent.x
        } else {
            percent.y
        };
        let text = format!(
            "{} scaled in the bed's plane by {:+.2} % in x and {:+.2} % in y",
            told("layer", [span.first, span.last]),
            percent.x,
            percent.y
        );
        let size = Size { size: worst, unit: "percent", uncertainty: 100.0 * span.spread + 0.01 };
        self.finding(Kind::Scaled, [span.first, span.last], size, text)
    }

    fn shifts(&self, shifts: &[Option<Vector2>]) -> Vec<Finding> {
        let spans = spans(shifts, LEAST_SHIFT_MM);
        let mut findings = Vec::new();
        for (i, span) in spans.iter().enumerate() {
            let before = i.checked_sub(1).map(|b| &spans[b]).filter(|b| b.last + 1 >= span.first);
            let level = before.map_or_else(Vector2::zeros, |b| b.end);
            if span.is_gradual {
                findings.push(self.gradual(span, level));
                continue;
            }
            let by = span.begin - level;
            // A return to where it was before is the end of the shift before it, not a new one.
            let was = i.checked_sub(2).map_or_else(Vector2::zeros, |b| {
                if spans[b].last + 3 >= span.first { spans[b].end } else { Vector2::zeros() }
            });
            if before.is_some() && (span.begin - was).norm() <= LEAST_SHIFT_MM {
                continue;
            }
            let lasts = spans[i + 1..].iter().zip(&spans[i..]).take_while(|(next, own)| {
                next.first <= own.last + 1 && (next.begin - level).norm() > LEAST_SHIFT_MM
            });
            let last = lasts.last().map_or(span.last, |(next, _)| next.last);
            findings.push(self.shifted(span, by, last));
        }
        findings
    }

    fn shifted(&self, span: &Span, by: Vector2, last: usize) -> Finding {
        let to = if last == self.top() {
            format!("to the top (layer {last})")
        } else {
            format!("to layer {last}")
        };
        let text = format!(
            "layer shift: from layer {} {to} all lies {:.3} mm off (x {:+.3}, y {:+.3})",
            span.first,
            by.norm(),
            by.x + 0.0,
            by.y + 0.0
        );
        let size = Size { size: by.norm(), unit: "mm", uncertainty: span.spread.max(LENGTH_UNCERTAINTY_MM) };
        Finding {
            vector_mm: Some([by.x, by.y]),
            beyond_gate: by.norm() > self.gate.layer_shift_mm,
            ..self.finding(Kind::LayerShift, [span.first, last], size, text)
        }
    }

    fn gradual(&self, span: &Span, level: Vector2) -> Finding {
        let far =
            if (span.end - level).norm() >= (span.begin - level).norm() { span.end } else { span.begin };
        let by = far - level;
        let height_mm = (self.slots[span.last].z_mid_mm - self.slots[span.first].z_mid_mm).abs().max(1e-9);
        let lean_deg = ((span.end - span.begin).norm() / height_mm).atan().to_degrees();
        let text = format!(
            "gradual shift: between layer {} and layer {} the layers drift by {:.3} mm (x {:+.3}, y {:+.3}); the part leans by {lean_deg:.2} degrees there",
            span.first,
            span.last,
            by.norm(),
            by.x + 0.0,
            by.y + 0.0
        );
        let size =
            Size { size: by.norm(), unit: "mm", uncertainty: LENGTH_UNCERTAINTY_MM + 0.02 * by.norm() };
        Finding {
            vector_mm: Some([by.x, by.y]),
            beyond_gate: by.norm() > self.gate.layer_shift_mm,
            ..self.finding(Kind::GradualShift, [span.first, span.last], size, text)
        }
    }

    fn flows(&self) -> Vec<Finding> {
        let of = |m: &Matched| {
            let (flow, width) = (m.flow? - 1.0, m.width? - 1.0);
            // Widths tell where volumes do not, unless a missing layer below made the beads higher.
            Some(if flow.abs() > LEAST_FLOW {
                flow
            } else if (flow - width).abs() > LEAST_FLOW {
                width
            } else {
                flow
            })
        };
        let thin_below = |i: usize| i > 0 && self.is_missing(i - 1);
        let flows: Vec<Option<f64>> = (0..self.slots.len())
            .map(|i| if thin_below(i) { self.matched[i].flow.map(|f| f - 1.0) } else { of(&self.matched[i]) })
            .map(|f| f.filter(|f| f.is_finite()))
            .collect();
        of_scalars(&flows, LEAST_FLOW).iter().map(|span| self.flow(span)).collect()
    }

    fn flow(&self, span: &Span) -> Finding {
        let [begin, end, most] = [span.begin, span.end, span.most()].map(|v| 100.0 * v.x);
        let (kind, name) = if most < 0.0 {
            (Kind::UnderExtrusion, "under-extrusion")
        } else {
            (Kind::OverExtrusion, "over-extrusion")
        };
        let less = if most < 0.0 { "less" } else { "more" };
        let layers = told("layer", [span.first, span.last]);
        let text = if span.is_gradual {
            format!(
                "{name}: {less} and {less} material than planned in {layers}, from {begin:+.1} % to {end:+.1} %"
            )
        } else if span.spread > 0.25 * span.begin.norm() {
            format!(
                "{name}: {:.1} % {less} material than planned in {layers} on average, differently from layer to layer",
                most.abs()
            )
        } else {
            format!("{name}: {:.1} % {less} material than planned in {layers}", most.abs())
        };
        let size = Size { size: most.abs(), unit: "percent", uncertainty: 100.0 * span.spread + 0.1 };
        Finding {
            beyond_gate: most.abs() > self.gate.flow_percent,
            ..self.finding(kind, [span.first, span.last], size, text)
        }
    }

    fn missing_beads(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        for role in Role::ALL {
            let part = |i: usize| {
                let [planned, missing] = self.matched[i].roles[role as usize];
                if missing.length_mm > 1.0 { missing.length_mm / planned.length_mm } else { 0.0 }
            };
            for [first, last] in runs(self.slots.len(), 1, |i| part(i) > LEAST_MISSING) {
                let mean = (first..=last).map(part).sum::<f64>() / (last + 1 - first) as f64;
                let what = match role {
                    Role::LumenSkin => "the skin at the lumen",
                    Role::OuterSkin => "the outer skin",
                    Role::Inside => "the beads inside the wall",
                    Role::Around => "what stands beside the part (skirt, brim, supports)",
                };
                let layers = told("layer", [first, last]);
                let text =
                    format!("missing beads: {:.0} % of {what} was not deposited in {layers}", 100.0 * mean);
                let size = Size { size: 100.0 * mean, unit: "percent", uncertainty: 1.0 };
                findings.push(Finding {
                    beyond_gate: role != Role::Around,
                    ..self.finding(Kind::MissingBeads, [first, last], size, text)
                });
            }
        }
        findings
    }

    fn extras(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        for place in Where::ALL {
            let extra = |i: usize| self.matched[i].extra[place as usize];
            let counts = |i: usize| self.matched[i].motion.is_some() && extra(i).volume_mm3 > LEAST_EXTRA_MM3;
            for [first, last] in runs(self.slots.len(), 4, counts) {
                let (length_mm, volume_mm3) = (first..=last)
                    .map(extra)
                    .fold((0.0, 0.0), |(l, v), e| (l + e.length_mm, v + e.volume_mm3));
                let (kind, what) = match place {
                    Where::Lumen => (Kind::MaterialInLumen, "in the open lumen"),
                    Where::Wall => (Kind::MaterialInWall, "in the wall, beside the planned beads"),
                    Where::Outside => (Kind::MaterialOutside, "outside the part"),
                };
                let text = format!(
                    "material that was not planned: {volume_mm3:.3} mm\u{b3} (lines of {length_mm:.1} mm) {what}, {}",
                    told("layer", [first, last])
                );
                let size = Size { size: volume_mm3, unit: "mm3", uncertainty: 0.01 * volume_mm3 + 0.001 };
                findings.push(Finding {
                    beyond_gate: place == Where::Lumen || volume_mm3 > self.gate.extra_mm3,
                    ..self.finding(kind, [first, last], size, text)
                });
            }
        }
        findings
    }

    /// Layers at wrong heights, and of wrong thickness.
    fn rises(&self, planned_z_mm: Vec<f64>) -> Vec<Finding> {
        let rise_mm = &self.aligned.rise_mm;
        let mut findings: Vec<Finding> =
            of_scalars(rise_mm, LEAST_RISE_MM).iter().map(|span| self.rise(span)).collect();
        let z_mm = |i: usize| rise_mm[i].map(|r| planned_z_mm[i] + r);
        let thicker = |i: usize| {
            let own = &self.aligned.of_layer[i];
            let volume: f64 = own.iter().map(|s| s.volume_mm3).sum();
            let mean_mm = own.iter().map(|s| s.volume_mm3 * s.height_mm).sum::<f64>() / volume;
            let below_mm = (0..i).rev().find_map(z_mm).unwrap_or(0.0);
            let raised_mm = z_mm(i)? - below_mm;
            let as_planned = (mean_mm / self.slots[i].height_mm - 1.0).abs() < LEAST_THICKER;
            (!as_planned && raised_mm > 0.0).then(|| mean_mm / raised_mm - 1.0)
        };
        let parts: Vec<Option<f64>> = (0..self.slots.len())
            .map(|i| if self.aligned.of_layer[i].is_empty() { None } else { Some(thicker(i).unwrap_or(0.0)) })
            .collect();
        findings.extend(of_scalars(&parts, LEAST_THICKER).iter().map(|span| self.thickness(span)));
        findings
    }

    fn rise(&self, span: &Span) -> Finding {
        let (begin, end) = (span.begin.x, span.end.x);
        let layers = told("layer", [span.first, span.last]);
        let text = if span.is_gradual {
            let percent = 100.0 * self.rise_per_mm(span);
            format!(
                "wrong height: more and more in {layers}, {end:+.3} mm at layer {}: scaled in z by {percent:+.2} %",
                span.last
            )
        } else {
            format!("wrong height: {begin:+.3} mm in {layers}")
        };
        let size =
            Size { size: span.most().x, unit: "mm", uncertainty: span.spread.max(LENGTH_UNCERTAINTY_MM) };
        Finding {
            beyond_gate: span.most().norm() > self.gate.layer_shift_mm,
            ..self.finding(Kind::WrongHeight, [span.first, span.last], size, text)
        }
    }

    /// Slope of what the layers of a span lie too high over their height.
    fn rise_per_mm(&self, span: &Span) -> f64 {
        let places = || {
            (span.first..=span.last).filter_map(|i| Some((self.slots[i].z_mid_mm, self.aligned.rise_mm[i]?)))
        };
        let n = places().count().max(1) as f64;
        let (z, r) = places().fold((0.0, 0.0), |(a, b), (z, r)| (a + z / n, b + r / n));
        let (zz, zr) =
            places().fold((0.0, 0.0), |(a, b), (x, y)| (a + (x - z) * (x - z), b + (x - z) * (y - r)));
        if zz > 0.0 { zr / zz } else { 0.0 }
    }

    fn thickness(&self, span: &Span) -> Finding {
        let percent = 100.0 * span.most().x;
        let text = format!(
            "wrong thickness: the beads of {} are {percent:+.0} % higher than their layer",
            told("layer", [span.first, span.last])
        );
        let size = Size { size: percent, unit: "percent", uncertainty: 100.0 * span.spread + 0.1 };
        self.finding(Kind::LayerThickness, [span.first, span.last], size, text)
    }

    fn unrecognised(&self) -> Vec<Finding> {
        let is_odd = |i: usize| {
            let m = &self.matched[i];
            m.planned.length_mm > 0.0 && m.motion.is_none() && !self.is_missing(i)
        };
        let finding = |[first, last]: [usize; 2]| {
            let size = Size { size: (last + 1 - first) as f64, unit: "layers", uncertainty: 0.0 };
            let text = format!(
                "{}: what was deposited does not follow the planned beads, wherever it is moved",
                told("layer", [first, last])
            );
            self.finding(Kind::Unrecognised, [first, last], size, text)
        };
        runs(self.slots.len(), 1, is_odd).into_iter().map(finding).collect()
    }

    fn strays(&self) -> Option<Finding> {
        let stray_mm3 = self.aligned.stray_mm3;
        let recorded_mm3: f64 = self.matched.iter().map(|m| m.recorded.volume_mm3).sum();
        (stray_mm3 > self.gate.extra_mm3 || stray_mm3 > 0.01 * recorded_mm3.max(1e-9)).then(|| {
            let size = Size { size: stray_mm3, unit: "mm3", uncertainty: 0.01 * stray_mm3 };
            let text = format!("{stray_mm3:.2} mm\u{b3} were deposited at heights that belong to no layer");
            self.finding(Kind::BetweenLayers, [0, self.top()], size, text)
        })
    }
}

/// Marks the linear part of the layers of a span as explained.
fn mark(explained: &mut [Matrix2<f64>], span: &Span, linear: &[Option<Matrix2<f64>>]) {
    for i in span.first..=span.last {
        if let Some(linear) = linear[i] {
            explained[i] = linear - Matrix2::identity();
        }
    }
}

/// First and last of the stretches for which `holds`, gaps of up to `gap - 1` bridged.
pub(super) fn runs(n: usize, gap: usize, holds: impl Fn(usize) -> bool) -> Vec<[usize; 2]> {
    let mut runs: Vec<[usize; 2]> = Vec::new();
    for i in (0..n).filter(|&i| holds(i)) {
        match runs.last_mut() {
            Some(run) if i <= run[1] + gap => run[1] = i,
            _ => runs.push([i, i]),
        }
    }
    runs
}
