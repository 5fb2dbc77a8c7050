//! Figures against limits.
//!
//! A limit is what the profile asks: it is never widened. Where image or scan cannot tell a figure from its limit (a deviation
//! beyond the limit, but within a pixel or voxel), the figure is not judged; and what is not judged is not passed.

use super::faults::{plane_runs, told};
use super::scan::NO_MODEL;
use super::{Amounts, Anatomy, Block, Finding, Gate, Kind, Origin, Scan, Stage, WallStage, apart};
use serde::Serialize;

/// Planes with a total, of those that have contours, at least.
const LEAST_SEEN: f64 = 0.9;

/// Whether the replica passes, and if not, why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verdict {
    /// Whether all limits are kept, and all could be judged.
    pub passed: bool,
    /// The limits as the profile asks them.
    pub gate: Gate,
    /// What can be told of those that image or scan limit.
    pub limits: Vec<Limit>,
    /// One sentence for each limit that is not kept.
    pub failures: Vec<String>,
    /// One sentence for each limit that may be kept or not: pixels or voxels do not tell.
    pub not_judged: Vec<String>,
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

/// A limit on a length that an image or a scan is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limit {
    /// Its name in the gate.
    pub figure: &'static str,
    /// The stage that it is asked of.
    pub stage: &'static str,
    /// What the profile asks, mm.
    pub asked_mm: f64,
    /// Only what is beyond this fails, mm; what lies between the two is not judged.
    pub used_mm: f64,
}

impl Limit {
    fn new(figure: &'static str, stage: Stage, asked_mm: f64, told_mm: f64) -> Self {
        Self { figure, stage: stage.name(), asked_mm, used_mm: asked_mm.max(told_mm) }
    }
}

/// A limit that is not kept, or that cannot be judged.
struct Missed {
    text: String,
    is_judged: bool,
}

impl Missed {
    fn judged(text: String) -> Self {
        Self { text, is_judged: true }
    }

    /// A length against its limit, and what is smaller than pixels or voxels.
    fn length(limit: Limit, value_mm: f64, what: &str, grain: &str) -> Option<Self> {
        if value_mm <= limit.asked_mm {
            return None;
        }
        let [value, allowed] = apart(value_mm, limit.asked_mm, 3);
        let asked = format!("{what} is {value} mm, allowed are {allowed} mm");
        let is_judged = value_mm > limit.used_mm;
        let text = if is_judged {
            asked
        } else {
            format!("{asked}: {grain} tell no less than {:.3} mm", limit.used_mm)
        };
        Some(Self { text, is_judged })
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
    /// Planes whose total was not measured, or along less than half of the outline.
    pub(super) unseen: &'a [usize],
    pub(super) findings: &'a [Finding],
    pub(super) anatomy: &'a Anatomy,
    pub(super) walls: &'a [WallStage],
    pub(super) amounts: &'a Amounts,
    pub(super) scan: Option<&'a Scan>,
}

/// A lumen that is judged by another one.
#[derive(Debug, Clone, Copy)]
struct Lumina {
    tested: &'static str,
    meant: &'static str,
    /// What the tested one is called.
    words: &'static str,
    /// Lengths below this are not told, mm.
    told_mm: f64,
}

impl Verdict {
    /// Every figure against its limit; what was not measured has none, but for the total and the scan.
    pub(super) fn of(gate: Gate, judged: &Judged<'_>) -> Self {
        let limits = limits(gate, judged);
        let mut missed: Vec<Missed> = Vec::new();
        let is_first =
            |f: &&Finding| matches!(f.kind, Kind::Plugged | Kind::MissingMaterial | Kind::PrintStopped);
        let beyond = || judged.findings.iter().filter(|f| f.beyond_gate);
        let of_finding = |f: &Finding| Missed { text: f.text.clone(), is_judged: f.judged };
        // A branch that is closed or missing says more than all figures.
        missed.extend(beyond().filter(is_first).map(of_finding));
        missed.extend(totals(gate, judged, &limits));
        let deposition = &judged.blocks[Stage::Deposition as usize];
        missed.extend(layer_failure(gate, deposition).map(Missed::judged));
        missed.extend(missing(deposition).map(Missed::judged));
        let deposited = Lumina { tested: "recorded", meant: judged.meant, words: "deposited", told_mm: 0.0 };
        missed.extend(lumina(gate, judged, deposited));
        if let Some(scan) = judged.scan {
            missed.extend(scanned(gate, judged, scan, &limits));
        }
        missed.extend(beyond().filter(|f| !is_first(f)).map(of_finding));
        let (judged, open): (Vec<_>, Vec<_>) = missed.into_iter().partition(|m| m.is_judged);
        let [failures, not_judged] =
            [judged, open].map(|m| m.into_iter().map(|m| m.text).collect::<Vec<_>>());
        Self {
            passed: failures.is_empty() && not_judged.is_empty(),
            gate,
            limits,
            failures,
            not_judged,
            rests_on: Basis::default(),
        }
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
                Basis::Recorded => format!("Passed: {limits}"),
                Basis::Scanned => format!("Passed, the scan of the replica too: {limits}"),
            };
        }
        let (refusal, open) = (self.refusal(), self.not_judged.join("; "));
        match (self.failures.is_empty(), open.is_empty()) {
            (true, _) => format!("{refusal}: {open}"),
            (false, true) => format!("{refusal}: {}", self.failures.join("; ")),
            (false, false) => format!("{refusal}: {}; not judged: {open}", self.failures.join("; ")),
        }
    }

    /// What a verdict begins with that is none of passing.
    pub(super) const fn refusal(&self) -> &'static str {
        match (self.rests_on, self.failures.is_empty()) {
            (Basis::Commanded, false) => "Not passed as commanded, the print itself was not measured",
            (Basis::Commanded, true) => "Not judged as commanded, the print itself was not measured",
            (Basis::Recorded | Basis::Scanned, false) => "Not passed",
            (Basis::Recorded | Basis::Scanned, true) => "Not judged",
        }
    }
}

/// The limits on lengths that pixels or voxels limit.
fn limits(gate: Gate, judged: &Judged<'_>) -> Vec<Limit> {
    let mut limits = Vec::new();
    if let Some(pixel_mm) = judged.pixel_mm {
        limits.extend([
            Limit::new("total_p95_mm", Stage::Total, gate.total_p95_mm, pixel_mm),
            Limit::new("stage_mean_mm", Stage::Total, gate.stage_mean_mm, 0.5 * pixel_mm),
            Limit::new("stage_mean_mm", Stage::Segmentation, gate.stage_mean_mm, 0.5 * pixel_mm),
            Limit::new("outline_mm", Stage::Segmentation, gate.outline_mm, 0.5 * pixel_mm),
        ]);
    }
    if let Some(voxel_mm) = judged.scan.and_then(|s| s.uncertainty_mm.voxel) {
        limits.extend([
            Limit::new("total_p95_mm", Stage::Scan, gate.total_p95_mm, voxel_mm),
            Limit::new("stage_mean_mm", Stage::Scan, gate.stage_mean_mm, 0.5 * voxel_mm),
            Limit::new("outline_mm", Stage::Scan, gate.outline_mm, 0.5 * voxel_mm),
        ]);
    }
    limits
}

fn limit_of(limits: &[Limit], figure: &str, stage: Stage, asked_mm: f64) -> Limit {
    let known = limits.iter().find(|l| l.figure == figure && l.stage == stage.name()).copied();
    known.unwrap_or(Limit { figure: "", stage: stage.name(), asked_mm, used_mm: asked_mm })
}

/// What is judged of the stages' own figures. Without an image there is no total; with one, a total that was not measured proves
/// nothing.
fn totals(gate: Gate, judged: &Judged<'_>, limits: &[Limit]) -> Vec<Missed> {
    const GRAIN: &str = "the image's pixels";
    let total = &judged.blocks[Stage::Total as usize];
    let mut missed = Vec::new();
    let p95 = total.overall.and_then(|o| o.figures.p95_mm);
    match p95 {
        Some(p95) => {
            let limit = limit_of(limits, "total_p95_mm", Stage::Total, gate.total_p95_mm);
            missed.extend(Missed::length(limit, p95, "the total 95th percentile", GRAIN));
        }
        None if judged.pixel_mm.is_some() => missed
            .push(Missed::judged("the total deviation from the image was not measured in any plane".into())),
        None => {}
    }
    let n = total.planes.len();
    if judged.pixel_mm.is_some()
        && p95.is_some()
        && ((n - judged.unseen.len()) as f64) < LEAST_SEEN * n as f64
    {
        let runs: Vec<String> = plane_runs(judged.unseen).into_iter().map(|run| told("plane", run)).collect();
        missed.push(Missed::judged(format!(
            "the total deviation from the image was measured in {} of {n} planes only; it is missing, or known along less than half of the outline, in {}",
            n - judged.unseen.len(),
            runs.join(", ")
        )));
    }
    let mean = |stage: Stage| {
        let limit = limit_of(limits, "stage_mean_mm", stage, gate.stage_mean_mm);
        let mean_mm = judged.blocks[stage as usize].overall?.figures.mean_mm?;
        Missed::length(limit, mean_mm, &format!("{}: the mean distance", stage.name()), GRAIN)
    };
    missed.extend(Stage::ALL.into_iter().filter_map(mean));
    let dice = total.overall.and_then(|o| o.figures.dice).filter(|dice| *dice < gate.total_dice);
    missed.extend(dice.map(|dice| {
        let [dice, asked] = apart(dice, gate.total_dice, 3);
        Missed::judged(format!(
            "the deposited lumen overlaps that of the image by Dice {dice} only, at least {asked} is asked"
        ))
    }));
    missed
}

/// Volume, branches and wall.
fn lumina(gate: Gate, judged: &Judged<'_>, pair: Lumina) -> Vec<Missed> {
    let mut missed: Vec<Missed> = volume(gate, judged, pair).map(Missed::judged).into_iter().collect();
    missed.extend(branches(gate, judged, pair));
    missed.extend(wall(gate, judged, pair));
    missed
}

/// The scan against the same limits.
fn scanned(gate: Gate, judged: &Judged<'_>, scan: &Scan, limits: &[Limit]) -> Vec<Missed> {
    const GRAIN: &str = "the scan's voxels";
    let mut missed: Vec<Missed> =
        scan.not_judged.iter().map(|text| Missed { text: text.clone(), is_judged: false }).collect();
    let Some(overall) = &scan.block.overall else {
        let why = |reason: &String| Missed::judged(format!("scan: {reason}"));
        missed.extend(scan.block.reason.iter().map(why));
        return missed;
    };
    let limit = |figure, asked_mm| limit_of(limits, figure, Stage::Scan, asked_mm);
    let length = |limit, value: Option<f64>, what| Missed::length(limit, value?, what, GRAIN);
    let figures = &overall.figures;
    let p95 = limit("total_p95_mm", gate.total_p95_mm);
    missed.extend(length(p95, figures.p95_mm, "scan: the 95th percentile against the model"));
    let mean = limit("stage_mean_mm", gate.stage_mean_mm);
    missed.extend(length(mean, figures.mean_mm, "scan: the mean distance"));
    missed.extend(figures.dice.filter(|dice| *dice < gate.total_dice).map(|dice| {
        let [dice, asked] = apart(dice, gate.total_dice, 3);
        Missed::judged(format!(
            "scan: the scanned lumen overlaps that of the model by Dice {dice} only, at least {asked} is asked"
        ))
    }));
    let planes = without_lumen(&scan.block);
    if !planes.is_empty() {
        let runs: Vec<String> = plane_runs(&planes).into_iter().map(|run| told("plane", run)).collect();
        missed.push(Missed::judged(format!("scan: the lumen was not found in {}", runs.join(", "))));
    }
    let told_mm = scan.uncertainty_mm.voxel.unwrap_or(0.0);
    missed.extend(lumina(
        gate,
        judged,
        Lumina { tested: "scanned", meant: "solid", words: "scanned", told_mm },
    ));
    // Of a scan that cannot be judged no figure is.
    if scan.not_judged.is_some() {
        for one in &mut missed {
            one.is_judged = false;
        }
    }
    missed
}

/// Planes in which the replica has no lumen, though the model has one.
fn without_lumen(scanned: &Block) -> Vec<usize> {
    let is_missing = |reason: &String| reason != NO_MODEL;
    scanned.planes.iter().filter(|p| p.reason.as_ref().is_some_and(is_missing)).map(|p| p.plane).collect()
}

/// By how much a figure is off another one, percent of that.
fn percent_off(value: f64, meant: f64) -> Option<f64> {
    (meant > 0.0).then(|| 100.0 * (value / meant - 1.0))
}

fn volume(gate: Gate, judged: &Judged<'_>, pair: Lumina) -> Option<String> {
    let of = |stage| judged.amounts.lumen.iter().find(|l| l.stage == stage)?.volume_mm3;
    let off = percent_off(of(pair.tested)?, of(pair.meant)?)?;
    (off.abs() > gate.lumen_volume_percent).then(|| {
        format!(
            "the {} lumen's volume is {off:+.1} % off that of the {}, allowed are {:.1} %",
            pair.words, pair.meant, gate.lumen_volume_percent
        )
    })
}

/// Least diameter and degree of stenosis of every branch.
fn branches(gate: Gate, judged: &Judged<'_>, pair: Lumina) -> Vec<Missed> {
    let of = |branch: &super::Branch| {
        let stage = |name| branch.stages.iter().find(|s| s.stage == name);
        let (tested, meant) = (stage(pair.tested)?, stage(pair.meant)?);
        let diameters = tested.minimum_diameter_mm.zip(meant.minimum_diameter_mm);
        let off = diameters.and_then(|(value, meant)| {
            percent_off(value, meant)
                .filter(|off| off.abs() > gate.diameter_percent)
                .map(|off| (value, meant, off))
        });
        let diameter = off.map(|(value, meant, off)| Missed {
            text: format!(
                "{}: the {} lumen's least diameter is {value:.2} mm instead of {meant:.2} mm ({off:+.1} %, against the {}), allowed are {:.1} %",
                branch.name, pair.words, pair.meant, gate.diameter_percent
            ),
            is_judged: (value - meant).abs() > pair.told_mm,
        });
        let [value, degree] = [tested, meant].map(|s| s.stenosis.stenosis_nascet_percent);
        let off = value.zip(degree).map(|(v, m)| v - m).filter(|off| off.abs() > gate.stenosis_points);
        let reference_mm = meant.stenosis.stenosis_reference.map_or(f64::INFINITY, |r| r.diameter_mm);
        let stenosis = off.map(|off| Missed {
            text: format!(
                "{}: the {} degree of stenosis is {off:+.1} percentage points off that of the {}, allowed are {:.1}",
                branch.name, pair.words, pair.meant, gate.stenosis_points
            ),
            is_judged: pair.told_mm == 0.0 || 0.01 * off.abs() * reference_mm > pair.told_mm,
        });
        Some([diameter, stenosis])
    };
    judged.anatomy.branches.iter().filter_map(of).flatten().flatten().collect()
}

/// The least thickness; of a scan, whose noise makes single places thin, what 5 % of the places do not reach.
fn wall(gate: Gate, judged: &Judged<'_>, pair: Lumina) -> Option<Missed> {
    let of = |stage| judged.walls.iter().find(|w| w.stage == stage)?.overall;
    let thin = |wall: super::Wall| if pair.told_mm > 0.0 { wall.p5_mm } else { wall.min_mm };
    let (tested, solid) = (thin(of(pair.tested)?)?, thin(of("solid")?)?);
    (tested < 0.01 * gate.wall_percent * solid).then(|| Missed {
        text: format!(
            "the {} wall is only {tested:.2} mm thick where it is thinnest, at least {:.0} % of {solid:.2} mm are asked",
            pair.words, gate.wall_percent
        ),
        is_judged: solid - tested > pair.told_mm,
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
            &Judged {
                pixel_mm,
                meant: "contours",
                blocks,
                unseen: &[],
                findings: &[],
                anatomy,
                walls: &[],
                amounts,
                scan: None,
            },
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
        assert!(of(by(Origin::Recorded, false), 0.1).sentence().starts_with("Passed: "));
        let scanned = of(by(Origin::Commanded, true), 0.1).sentence();
        assert!(scanned.starts_with("Passed, the scan of the replica too: "), "{scanned}");
    }

    #[test]
    fn what_pixels_cannot_tell_is_not_judged_and_not_passed() {
        let open = judged(Some(1.5), &blocks(Some(0.9), Some(0.98)));
        assert!(!open.passed && open.failures.is_empty() && open.not_judged.len() == 1, "{open:?}");
        assert!(open.sentence().starts_with("Not judged: the total 95th percentile is 0.900 mm"), "{open:?}");
        assert!(open.sentence().contains("allowed are 0.300 mm") && open.sentence().contains("1.500 mm"));
        let limit = open.limits.iter().find(|l| l.figure == "total_p95_mm").unwrap();
        assert_eq!((limit.stage, limit.asked_mm, limit.used_mm), ("total", 0.3, 1.5));
        // Within what is asked, pixels do not matter; beyond them, it fails.
        assert!(judged(Some(1.5), &blocks(Some(0.25), Some(0.98))).passed);
        assert_eq!(judged(Some(1.5), &blocks(Some(1.6), Some(0.98))).refusal(), "Not passed");
        let mut means = blocks(Some(0.2), Some(0.98));
        means[Stage::Segmentation as usize].overall = Some(Overall {
            figures: Figures { mean_mm: Some(0.4), ..Figures::default() },
            ..Overall::default()
        });
        assert_eq!(judged(Some(1.0), &means).refusal(), "Not judged");
        assert!(judged(Some(0.3), &means).sentence().contains("segmentation: the mean distance is 0.400 mm"));
    }

    #[test]
    fn a_total_of_too_few_planes_fails_with_their_names() {
        let mut blocks = blocks(Some(0.1), Some(0.98));
        blocks[Stage::Total as usize].planes = vec![super::super::PlaneFigures::default(); 46];
        let (anatomy, amounts) = (Anatomy::default(), Amounts::default());
        let seen = |unseen: &[usize]| {
            let judged = Judged {
                pixel_mm: Some(0.2),
                meant: "contours",
                blocks: &blocks,
                unseen,
                findings: &[],
                anatomy: &anatomy,
                walls: &[],
                amounts: &amounts,
                scan: None,
            };
            Verdict::of(gate(), &judged)
        };
        assert!(seen(&[3, 4]).passed);
        let verdict = seen(&(1..46).collect::<Vec<_>>());
        assert_eq!(verdict.failures.len(), 1);
        assert!(
            verdict.sentence().contains("1 of 46 planes only")
                && verdict.sentence().contains("planes 1 to 45"),
            "{}",
            verdict.sentence()
        );
    }

    #[test]
    fn planes_that_the_model_does_not_reach_are_not_missing_in_its_scan() {
        let plane = |plane, reason: Option<&str>| super::super::PlaneFigures {
            plane,
            reason: reason.map(str::to_owned),
            ..super::super::PlaneFigures::default()
        };
        let mut block = blocks(Some(0.1), Some(0.98))[Stage::Total as usize].clone();
        block.planes = vec![plane(0, Some(NO_MODEL)), plane(1, None), plane(2, Some("no lumen in the scan"))];
        assert_eq!(without_lumen(&block), [2]);
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
            unseen: &[],
            findings: &[],
            anatomy: &anatomy,
            walls: &walls,
            amounts: &amounts,
            scan: None,
        };
        Verdict::of(gate(), &judged).failures
    }

    #[test]
    fn every_figure_has_its_limit() {
        assert_eq!(off(4.0, 0.3, -4.0, 0.6), [""; 0]);
        let cases = [
            (off(-6.0, 0.0, 0.0, 1.0), "volume is -6.0 %"),
            (
                off(0.0, -0.5, 0.0, 1.0),
                "branch 1: the deposited lumen's least diameter is 3.50 mm instead of 4.00 mm (-12.5 %",
            ),
            (off(0.0, 0.0, 6.0, 1.0), "degree of stenosis is +6.0 percentage points"),
            (off(0.0, 0.0, 0.0, 0.4), "wall is only 0.40 mm"),
        ];
        for (failures, words) in cases {
            assert!(failures.len() == 1 && failures[0].contains(words), "{words}: {failures:?}");
        }
    }
}
