//! Figures against limits.

use super::{Amounts, Anatomy, Block, Finding, Gate, Origin, Stage, WallStage, apart};
use serde::Serialize;

/// Whether the replica passes, and if not, why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether all limits are kept.
    pub passed: bool,
    /// The limits, with the pixel taken into account.
    pub gate: Gate,
    /// One sentence for each limit that is not kept.
    pub failures: Vec<String>,
    /// What the printed part is known by.
    pub rests_on: Basis,
}

/// What is known of the printed part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub enum Basis {
    /// The record of what watched the nozzle.
    #[default]
    #[serde(rename = "recorded")]
    Recorded,
    /// The commands alone.
    #[serde(rename = "commanded, not measured")]
    Commanded,
    /// A scan of the replica.
    #[serde(rename = "scanned")]
    Scanned,
}

impl Basis {
    /// A scan tells more than any record.
    pub(super) const fn of(origin: Origin, has_scan: bool) -> Self {
        match (has_scan, origin) {
            (true, _) => Self::Scanned,
            (false, Origin::Recorded) => Self::Recorded,
            (false, Origin::Commanded) => Self::Commanded,
        }
    }
}

/// What is judged.
#[derive(Debug, Clone, Copy)]
pub(super) struct Judged<'a> {
    /// Size of the image's pixels, mm; none if there is no image.
    pub(super) pixel_mm: Option<f64>,
    /// The stage whose lumen the deposited one is meant to have: `contours`; `planned` where a job compensates.
    pub(super) meant: &'static str,
    pub(super) blocks: &'a [Block; 6],
    pub(super) findings: &'a [Finding],
    pub(super) anatomy: &'a Anatomy,
    pub(super) walls: &'a [WallStage],
    pub(super) amounts: &'a Amounts,
}

impl Verdict {
    /// Every figure against its limit; what was not measured has none, but for the total.
    pub(super) fn of(gate: Gate, judged: &Judged<'_>) -> Self {
        let gate = Gate { total_p95_mm: gate.total_p95_mm.max(judged.pixel_mm.unwrap_or(0.0)), ..gate };
        let deposition = &judged.blocks[Stage::Deposition as usize];
        let mut failures = Vec::new();
        failures.extend(total_failure(
            gate,
            judged.pixel_mm.is_some(),
            &judged.blocks[Stage::Total as usize],
        ));
        failures.extend(means(gate, judged));
        failures.extend(dice(gate, judged));
        failures.extend(layer_failure(gate, deposition));
        failures.extend(missing(deposition));
        failures.extend(volume(gate, judged));
        failures.extend(branches(gate, judged));
        failures.extend(wall(gate, judged));
        failures.extend(judged.findings.iter().filter(|f| f.beyond_gate).map(|f| f.text.clone()));
        Self { passed: failures.is_empty(), gate, failures, rests_on: Basis::default() }
    }

    /// With what else fails.
    pub(super) fn with_failures(mut self, further: Vec<String>) -> Self {
        self.failures.extend(further);
        self.passed = self.failures.is_empty();
        self
    }

    /// With what the part is known by.
    pub(super) fn resting_on(self, rests_on: Basis) -> Self {
        Self { rests_on, ..self }
    }

    /// Whether all limits are kept by what was measured: a part that nothing has watched is no such part.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        self.rests_on != Basis::Commanded
    }

    /// The verdict in one line.
    #[must_use]
    pub fn sentence(&self) -> String {
        if self.passed {
            let limits = format!(
                "total 95th percentile within {:.2} mm where it was measured, every layer's IoU at least {:.2}",
                self.gate.total_p95_mm, self.gate.layer_iou
            );
            return match self.rests_on {
                Basis::Commanded => format!(
                    "Passed as commanded, the print itself was not measured: {limits}; a scan of the replica shows what was made"
                ),
                Basis::Recorded | Basis::Scanned => format!("Passed: {limits}"),
            };
        }
        format!("{}: {}", self.refusal(), self.failures.join("; "))
    }
}

impl Verdict {
    /// What a verdict begins with that is none of passing.
    pub(super) const fn refusal(&self) -> &'static str {
        match self.rests_on {
            Basis::Commanded => "Not passed as commanded, the print itself was not measured",
            Basis::Recorded | Basis::Scanned => "Not passed",
        }
    }
}

fn means(gate: Gate, judged: &Judged<'_>) -> Vec<String> {
    let of = |stage: Stage| {
        let of_image = matches!(stage, Stage::Segmentation | Stage::Total);
        let half_pixel_mm = judged.pixel_mm.filter(|_| of_image).map_or(0.0, |p| 0.5 * p);
        let allowed_mm = gate.stage_mean_mm.max(half_pixel_mm);
        let mean_mm = judged.blocks[stage as usize].overall?.figures.mean_mm?;
        (mean_mm > allowed_mm).then(|| {
            let [mean, allowed] = apart(mean_mm, allowed_mm, 3);
            format!("{}: the mean distance is {mean} mm, allowed are {allowed} mm", stage.name())
        })
    };
    Stage::ALL.into_iter().filter_map(of).collect()
}

fn dice(gate: Gate, judged: &Judged<'_>) -> Option<String> {
    let dice = judged.blocks[Stage::Total as usize].overall?.figures.dice?;
    (dice < gate.total_dice).then(|| {
        let [dice, asked] = apart(dice, gate.total_dice, 3);
        format!(
            "the deposited lumen overlaps that of the image by Dice {dice} only, at least {asked} is asked"
        )
    })
}

/// By how much a figure is off another one, percent of that.
fn percent_off(value: f64, meant: f64) -> Option<f64> {
    (meant > 0.0).then(|| 100.0 * (value / meant - 1.0))
}

fn volume(gate: Gate, judged: &Judged<'_>) -> Option<String> {
    let of = |stage| judged.amounts.lumen.iter().find(|l| l.stage == stage)?.volume_mm3;
    let off = percent_off(of("recorded")?, of(judged.meant)?)?;
    (off.abs() > gate.lumen_volume_percent).then(|| {
        format!(
            "the deposited lumen's volume is {off:+.1} % off that of the {}, allowed are {:.1} %",
            judged.meant, gate.lumen_volume_percent
        )
    })
}

/// Least diameter and degree of stenosis of every branch.
fn branches(gate: Gate, judged: &Judged<'_>) -> Vec<String> {
    let of = |branch: &super::Branch| {
        let stage = |name| branch.stages.iter().find(|s| s.stage == name);
        let (deposited, meant) = (stage("recorded")?, stage(judged.meant)?);
        let off = deposited
            .minimum_diameter_mm
            .zip(meant.minimum_diameter_mm)
            .and_then(|(value, meant)| percent_off(value, meant))
            .filter(|off| off.abs() > gate.diameter_percent);
        let diameter = off.map(|off| {
            format!(
                "{}: the deposited lumen's least diameter is {off:+.1} % off that of the {}, allowed are {:.1} %",
                branch.name, judged.meant, gate.diameter_percent
            )
        });
        let [value, meant] = [deposited, meant].map(|s| s.stenosis.stenosis_nascet_percent);
        let off = value.zip(meant).map(|(v, m)| v - m).filter(|off| off.abs() > gate.stenosis_points);
        let stenosis = off.map(|off| {
            format!(
                "{}: the deposited degree of stenosis is {off:+.1} percentage points off that of the {}, allowed are {:.1}",
                branch.name, judged.meant, gate.stenosis_points
            )
        });
        Some([diameter, stenosis])
    };
    judged.anatomy.branches.iter().filter_map(of).flatten().flatten().collect()
}

fn wall(gate: Gate, judged: &Judged<'_>) -> Option<String> {
    let least = |stage| judged.walls.iter().find(|w| w.stage == stage)?.overall?.min_mm;
    let (deposited, solid) = (least("recorded")?, least("solid")?);
    (deposited < 0.01 * gate.wall_percent * solid).then(|| {
        format!(
            "the deposited wall is only {deposited:.2} mm thick where it is thinnest, at least {:.0} % of {solid:.2} mm are asked",
            gate.wall_percent
        )
    })
}

/// Without an image there is no total; with one, a total that was not measured proves nothing.
fn total_failure(gate: Gate, has_image: bool, total: &Block) -> Option<String> {
    let Some(p95) = total.overall.and_then(|o| o.figures.p95_mm) else {
        return has_image.then(|| "the total deviation from the image was not measured in any plane".into());
    };
    (p95 > gate.total_p95_mm).then(|| {
        let [p95, allowed] = apart(p95, gate.total_p95_mm, 3);
        format!("the total 95th percentile is {p95} mm, allowed are {allowed} mm")
    })
}

fn layer_failure(gate: Gate, deposition: &Block) -> Option<String> {
    let least = deposition.overall.and_then(|o| o.iou_min);
    match least {
        None => Some("nothing was deposited".into()),
        Some(iou) if iou < gate.layer_iou => {
            let [iou, asked] = apart(iou, gate.layer_iou, 3);
            Some(format!(
                "a layer's deposited material overlaps the planned one by IoU {iou} only, at least {asked} is asked"
            ))
        }
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
    use super::super::{Figures, LumenVolume, Overall, Stenosis, Wall};
    use super::*;

    fn gate() -> Gate {
        crate::profile::gate::builtin("marlin").unwrap()
    }

    fn blocks(total_p95_mm: Option<f64>, iou_min: Option<f64>) -> [Block; 6] {
        let mut blocks: [Block; 6] = Default::default();
        let figures = Figures { p95_mm: total_p95_mm, ..Figures::default() };
        blocks[Stage::Total as usize].overall =
            total_p95_mm.map(|_| Overall { figures, ..Overall::default() });
        blocks[Stage::Deposition as usize].overall = Some(Overall { iou_min, ..Overall::default() });
        blocks
    }

    fn judged(pixel_mm: Option<f64>, blocks: &[Block; 6]) -> Verdict {
        let (anatomy, amounts) = (Anatomy::default(), Amounts::default());
        let (anatomy, amounts) = (&anatomy, &amounts);
        Verdict::of(
            gate(),
            &Judged { pixel_mm, meant: "contours", blocks, findings: &[], anatomy, walls: &[], amounts },
        )
    }

    #[test]
    fn limits_are_kept_or_named() {
        assert!(judged(Some(0.2), &blocks(Some(0.29), Some(0.98))).passed);
        let failed = judged(Some(0.2), &blocks(Some(0.31), Some(0.96)));
        assert!(!failed.passed && failed.failures.len() == 2);
        assert!(failed.sentence().contains("0.310 mm") && failed.sentence().contains("IoU 0.960"));
    }

    #[test]
    fn a_figure_and_the_limit_that_it_does_not_keep_are_told_apart() {
        let close = Gate { layer_iou: 0.9998, ..gate() };
        let deposition = &blocks(None, Some(0.999_79))[Stage::Deposition as usize];
        let text = layer_failure(close, deposition).unwrap();
        assert!(text.contains("IoU 0.99979 only, at least 0.99980 is asked"), "{text}");
        let missing = &blocks(None, Some(-0.000_01))[Stage::Deposition as usize];
        assert!(layer_failure(gate(), missing).unwrap().contains("IoU 0.000 only"));
    }

    #[test]
    fn a_print_that_nobody_watched_has_no_bare_verdict() {
        let of = |basis, p95| judged(Some(0.2), &blocks(Some(p95), Some(0.98))).resting_on(basis);
        let by = |origin, scan| Basis::of(origin, scan);
        let commanded = of(by(Origin::Commanded, false), 0.1);
        assert!(commanded.passed && !commanded.is_measured());
        assert!(commanded.sentence().starts_with("Passed as commanded, the print itself was not measured: "));
        let failed = of(Basis::Commanded, 0.5).sentence();
        assert!(
            failed.starts_with("Not passed as commanded, the print itself was not measured: "),
            "{failed}"
        );
        for measured in [by(Origin::Commanded, true), by(Origin::Recorded, false)] {
            assert!(of(measured, 0.1).sentence().starts_with("Passed: "));
        }
    }

    #[test]
    fn nobody_asks_for_better_than_a_pixel() {
        assert!(judged(Some(1.5), &blocks(Some(0.9), Some(0.98))).passed);
        let mut means = blocks(Some(0.2), Some(0.98));
        means[Stage::Segmentation as usize].overall = Some(Overall {
            figures: Figures { mean_mm: Some(0.4), ..Figures::default() },
            ..Overall::default()
        });
        assert!(judged(Some(1.0), &means).passed);
        assert!(judged(Some(0.3), &means).sentence().contains("segmentation: the mean distance is 0.400 mm"));
    }

    #[test]
    fn without_a_ct_the_total_is_no_failure_without_deposition_there_is_one() {
        assert!(judged(None, &blocks(None, Some(0.98))).passed);
        assert!(!judged(None, &blocks(None, None)).passed);
    }

    #[test]
    fn an_image_without_a_total_is_a_failure_with_its_name() {
        let verdict = judged(Some(0.2), &blocks(None, Some(0.98)));
        assert!(!verdict.passed);
        assert!(verdict.sentence().contains("total deviation"), "{}", verdict.sentence());
    }

    /// A case whose deposited lumen, wall and stenosis are off by what is given.
    fn off(volume: f64, diameter: f64, degree: f64, wall: f64) -> Vec<String> {
        let stage = |stage, diameter_mm, percent| super::super::StageMeasures {
            stage,
            minimum_diameter_mm: Some(diameter_mm),
            stenosis: Stenosis { stenosis_nascet_percent: Some(percent), ..Stenosis::default() },
            ..super::super::StageMeasures::default()
        };
        let anatomy = Anatomy {
            branches: vec![super::super::Branch {
                name: "branch 1".into(),
                stages: vec![stage("contours", 4.0, 50.0), stage("recorded", 4.0 + diameter, 50.0 + degree)],
                ..super::super::Branch::default()
            }],
            divisions: Vec::new(),
        };
        let lumen = |stage, volume| LumenVolume { stage, volume_mm3: Some(volume), uncertainty_mm3: None };
        let amounts = Amounts {
            lumen: vec![lumen("contours", 100.0), lumen("recorded", 100.0 + volume)],
            ..Amounts::default()
        };
        let walls = [("solid", 1.0), ("recorded", wall)].map(|(stage, min_mm)| WallStage {
            stage,
            overall: Some(Wall { min_mm: Some(min_mm), ..Wall::default() }),
            planes: Vec::new(),
        });
        let mut blocks = blocks(Some(0.1), Some(0.98));
        blocks[Stage::Total as usize].overall = Some(Overall {
            figures: Figures { dice: Some(0.95), p95_mm: Some(0.1), ..Figures::default() },
            ..Overall::default()
        });
        let judged = Judged {
            pixel_mm: Some(0.2),
            meant: "contours",
            blocks: &blocks,
            findings: &[],
            anatomy: &anatomy,
            walls: &walls,
            amounts: &amounts,
        };
        Verdict::of(gate(), &judged).failures
    }

    #[test]
    fn every_figure_has_its_limit() {
        assert_eq!(off(4.0, 0.3, -4.0, 0.6), [""; 0]);
        let cases = [
            (off(-6.0, 0.0, 0.0, 1.0), "volume is -6.0 %"),
            (off(0.0, -0.5, 0.0, 1.0), "branch 1: the deposited lumen's least diameter is -12.5 %"),
            (off(0.0, 0.0, 6.0, 1.0), "degree of stenosis is +6.0 percentage points"),
            (off(0.0, 0.0, 0.0, 0.4), "wall is only 0.40 mm"),
        ];
        for (failures, words) in cases {
            assert!(failures.len() == 1 && failures[0].contains(words), "{words}: {failures:?}");
        }
    }
}
