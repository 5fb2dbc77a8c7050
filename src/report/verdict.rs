//! Figures against limits.

use super::{Block, Finding, Stage};
use serde::Serialize;

/// The limits that a replica must keep to pass.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Gate {
    /// Total 95th percentile, mm; where the image's pixels are larger, one pixel.
    pub total_p95_mm: f64,
    /// Least IoU of deposited against planned material, each layer.
    pub layer_iou: f64,
    /// Farthest that a stage's outline may lie off the one before on any plane, mm; against the image, half a pixel
    /// where that is more.
    pub outline_mm: f64,
    /// Farthest that a layer may lie beside its place, mm.
    pub layer_shift_mm: f64,
    /// Farthest that a layer's material may be off the planned amount, percent.
    pub flow_percent: f64,
    /// Most material beside the planned beads, outside of the lumen, mm³; in the lumen none is allowed.
    pub extra_mm3: f64,
}

impl Default for Gate {
    /// 0.3 mm: what the best published chains reach on average; 0.97: what a healthy printer does; 0.2 mm: the mean that
    /// each stage may reach; 0.1 mm, 10 %: a quarter of a usual bead, and what a calibrated extruder keeps.
    fn default() -> Self {
        Self {
            total_p95_mm: 0.3,
            layer_iou: 0.97,
            outline_mm: 0.2,
            layer_shift_mm: 0.1,
            flow_percent: 10.0,
            extra_mm3: 1.0,
        }
    }
}

/// Whether the replica passes, and if not, why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether all limits are kept.
    pub passed: bool,
    /// The limits, with the pixel taken into account.
    pub gate: Gate,
    /// One sentence for each limit that is not kept.
    pub failures: Vec<String>,
}

impl Verdict {
    /// `pixel_mm`: size of the image's pixels; none if there is no image.
    pub(super) fn of(gate: Gate, pixel_mm: Option<f64>, blocks: &[Block; 6], findings: &[Finding]) -> Self {
        let gate = Gate { total_p95_mm: gate.total_p95_mm.max(pixel_mm.unwrap_or(0.0)), ..gate };
        let mut failures = Vec::new();
        failures.extend(total_failure(gate, pixel_mm.is_some(), &blocks[Stage::Total as usize]));
        failures.extend(layer_failure(gate, &blocks[Stage::Deposition as usize]));
        failures.extend(missing(&blocks[Stage::Deposition as usize]));
        failures.extend(findings.iter().filter(|f| f.beyond_gate).map(|f| f.text.clone()));
        Self { passed: failures.is_empty(), gate, failures }
    }

    /// With what else fails.
    pub(super) fn with_failures(mut self, further: Vec<String>) -> Self {
        self.failures.extend(further);
        self.passed = self.failures.is_empty();
        self
    }

    /// The verdict in one line.
    #[must_use]
    pub fn sentence(&self) -> String {
        if self.passed {
            return format!(
                "Passed: total 95th percentile within {:.2} mm where it was measured, every layer's IoU at least {:.2}",
                self.gate.total_p95_mm, self.gate.layer_iou
            );
        }
        format!("Not passed: {}", self.failures.join("; "))
    }
}

/// Without an image there is no total; with one, a total that was not measured proves nothing.
fn total_failure(gate: Gate, has_image: bool, total: &Block) -> Option<String> {
    let Some(p95) = total.overall.and_then(|o| o.figures.p95_mm) else {
        return has_image.then(|| "the total deviation from the image was not measured in any plane".into());
    };
    (p95 > gate.total_p95_mm)
        .then(|| format!("the total 95th percentile is {p95:.3} mm, allowed are {:.3} mm", gate.total_p95_mm))
}

fn layer_failure(gate: Gate, deposition: &Block) -> Option<String> {
    let least = deposition.overall.and_then(|o| o.iou_min);
    match least {
        None => Some("nothing was deposited".into()),
        Some(iou) if iou < gate.layer_iou => Some(format!(
            "a layer's deposited material overlaps the planned one by IoU {iou:.3} only, at least {:.2} is asked",
            gate.layer_iou
        )),
        Some(_) => None,
    }
}

fn missing(deposition: &Block) -> Option<String> {
    let planes: Vec<String> = deposition
        .planes
        .iter()
        .filter(|p| p.figures.mean_mm.is_none())
        .map(|p| p.plane.to_string())
        .collect();
    (!planes.is_empty() && !deposition.planes.is_empty())
        .then(|| format!("the lumen was not found in the deposited material of planes {}", planes.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::super::{Figures, Overall};
    use super::*;

    fn blocks(total_p95_mm: Option<f64>, iou_min: Option<f64>) -> [Block; 6] {
        let mut blocks: [Block; 6] = Default::default();
        let figures = Figures { p95_mm: total_p95_mm, ..Figures::default() };
        blocks[Stage::Total as usize].overall =
            total_p95_mm.map(|_| Overall { figures, ..Overall::default() });
        blocks[Stage::Deposition as usize].overall = Some(Overall { iou_min, ..Overall::default() });
        blocks
    }

    #[test]
    fn limits_are_kept_or_named() {
        let gate = Gate::default();
        assert!(Verdict::of(gate, Some(0.2), &blocks(Some(0.29), Some(0.98)), &[]).passed);
        let failed = Verdict::of(gate, Some(0.2), &blocks(Some(0.31), Some(0.96)), &[]);
        assert!(!failed.passed && failed.failures.len() == 2);
        assert!(failed.sentence().contains("0.310 mm") && failed.sentence().contains("IoU 0.960"));
    }

    #[test]
    fn nobody_asks_for_better_than_a_pixel() {
        assert!(Verdict::of(Gate::default(), Some(1.5), &blocks(Some(0.9), Some(0.98)), &[]).passed);
    }

    #[test]
    fn without_a_ct_the_total_is_no_failure_without_deposition_there_is_one() {
        assert!(Verdict::of(Gate::default(), None, &blocks(None, Some(0.98)), &[]).passed);
        assert!(!Verdict::of(Gate::default(), None, &blocks(None, None), &[]).passed);
    }

    #[test]
    fn an_image_without_a_total_is_a_failure_with_its_name() {
        let verdict = Verdict::of(Gate::default(), Some(0.2), &blocks(None, Some(0.98)), &[]);
        assert!(!verdict.passed);
        assert!(verdict.sentence().contains("total deviation"), "{}", verdict.sentence());
    }
}
