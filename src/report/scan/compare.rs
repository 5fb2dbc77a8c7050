//! The scan at the planes of the model: outlines, figures, findings.

use super::levels::Levels;
use super::registration::Pose;
use super::sampler::Sampler;
use super::{Registration, Scan, ScanGate, ScanLevels, ScanUncertainty, Scanned};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, Point3, Region};
use crate::progress::{Cancelled, Task};
use crate::report::anatomy::{Branches, StageLumina};
use crate::report::deviation::{Comparison, Figures, compare};
use crate::report::faults::{Made, Place, Size, StagePair, moved, plugged};
use crate::report::image::{curvature_per_mm, drawn_inward_mm, outward};
use crate::report::lumen::{Expected, of_beads};
use crate::report::stages::section_lumen;
use crate::report::{Block, BodyKind, Finding, Histogram, Inputs, Kind, Overall, PlaneFigures, Stage};
use crate::sections::march::Grid;
use crate::solid::CrossSection;
use rayon::prelude::*;

/// The replica is looked for so far around its section, mm.
const AROUND_MM: f64 = 3.0;
/// Sides of the pixels that the scan is read in, mm.
const PIXEL_MM: [f64; 2] = [0.04, 0.5];
/// Specks smaller than this many pixels are noise.
const LEAST_PIXELS: f64 = 6.0;
/// Smaller deviations of outlines are none, mm, or this part of a voxel.
const LEAST_MM: f64 = 0.06;
const LEAST_VOXEL: f64 = 0.25;
/// A lumen is plugged where this part of it is filled; otherwise there is no replica.
const FILLED: f64 = 0.5;

/// The replica at one plane, stack frame of the model.
#[derive(Debug)]
pub(in crate::report) struct ScannedPlane {
    /// All that is bright there.
    pub(in crate::report) material: Region,
    /// Its lumen; for a cast what it fills.
    pub(in crate::report) lumen: Region,
    comparison: Result<Comparison, String>,
}

impl ScannedPlane {
    /// Its distances from the model, where it has any.
    pub(in crate::report) fn comparison(&self) -> Option<&Comparison> {
        self.comparison.as_ref().ok()
    }
}

/// What is needed to read the scan at planes.
#[derive(Clone, Copy)]
pub(super) struct Planes<'a> {
    pub(super) inputs: &'a Inputs<'a>,
    pub(super) sampler: Sampler<'a>,
    pub(super) levels: Levels,
    /// Height and section of every plane.
    pub(super) sections: &'a [(f64, &'a CrossSection)],
}

impl Planes<'_> {
    /// All planes, the scan lying as `pose` says.
    pub(super) fn read(&self, pose: &Pose, task: &Task<'_>) -> Result<Vec<ScannedPlane>, Cancelled> {
        let plane = |(z_mm, section): &(f64, &CrossSection)| {
            task.check()?;
            Ok(self.plane(pose, *z_mm, section))
        };
        self.sections.par_iter().map(plane).collect()
    }

    fn plane(&self, pose: &Pose, z_mm: f64, section: &CrossSection) -> ScannedPlane {
        let body = self.inputs.body;
        let model = section_lumen(section, body);
        let material = self.material(pose, z_mm, section);
        let filled = if body == BodyKind::Cast { section.outer.clone() } else { section.material() };
        let lumen = of_beads(&material, Expected { lumen: model, material: &filled }, body);
        let comparison = if model.is_empty() {
            Err("no lumen of the solid here".into())
        } else if lumen.is_empty() {
            Err("no lumen in the scan of the replica here".into())
        } else {
            compare(&model.clone().into(), &lumen.clone().into()).map_err(str::to_owned)
        };
        ScannedPlane { material, lumen, comparison }
    }

    /// What is brighter than half-way near a section, moved back by what blur does to curved outlines.
    fn material(&self, pose: &Pose, z_mm: f64, section: &CrossSection) -> Region {
        let Some(bounds) = section.outer.bounds().map(|b| b.grown(AROUND_MM)) else {
            return Region::default();
        };
        let pixel_mm = (0.5 * self.sampler.voxel_mm()).clamp(PIXEL_MM[0], PIXEL_MM[1]);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the extent of a vessel")]
        let [n_cols, n_rows] = [bounds.size().x, bounds.size().y].map(|l| (l / pixel_mm).ceil() as usize + 2);
        let half = self.levels.half();
        let at = |p: usize| {
            let (i, j) = (p % n_cols, p / n_cols);
            if i == 0 || j == 0 || i + 1 == n_cols || j + 1 == n_rows {
                return -1.0;
            }
            let x = bounds.min.x + pixel_mm * i as f64;
            let y = bounds.min.y + pixel_mm * j as f64;
            // Beyond the image there is air.
            self.sampler.at(pose.back(Point3::new(x, y, z_mm))).map_or(-1.0, |v| v - half)
        };
        let grid = Grid { n_cols, n_rows, values: (0..n_cols * n_rows).map(at).collect() };
        let place = |[i, j]: [f64; 2]| bounds.min + crate::geom::Vector2::new(i, j) * pixel_mm;
        let contours = grid.loops().into_iter().map(|l| Contour::new(l.into_iter().map(place).collect()));
        let least_mm2 = LEAST_PIXELS * pixel_mm * pixel_mm;
        let large = contours.filter(|c| c.signed_area_mm2().abs() >= least_mm2);
        let seen: Vec<Contour> = large.map(|c| self.unblurred(&c, pixel_mm)).collect();
        Region::from_even_odd(&seen)
    }

    fn unblurred(&self, contour: &Contour, pixel_mm: f64) -> Contour {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the length of an outline"
        )]
        let n = (contour.perimeter_mm() / pixel_mm).ceil().max(12.0) as usize;
        let points = contour.resampled(n).points;
        let blur_mm = self.levels.blur_mm;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few pixels")]
        let span = (2.0 * blur_mm / pixel_mm).clamp(4.0, 40.0) as usize;
        let moved = |i: usize| -> Point2 {
            points[i] + outward(&points, i, 2) * drawn_inward_mm(blur_mm, curvature_per_mm(&points, i, span))
        };
        Contour::new((0..n).map(moved).collect())
    }
}

impl Scanned {
    /// The lumina of the scan, given to the branches.
    pub(in crate::report) fn lumina(&self, branches: &Branches) -> Option<StageLumina> {
        (!self.planes.is_empty()).then(|| shared_out(&self.planes, branches))
    }

    /// What is off: mirrored, scaled, moved, plugged.
    pub(in crate::report) fn findings(
        &self,
        solid: &StageLumina,
        branches: &Branches,
        sections: &[&CrossSection],
        body: BodyKind,
    ) -> Vec<Finding> {
        let z_mm = branches.z_mm();
        let last = z_mm.len() - 1;
        let gate = ScanGate::of_voxels(self.largest_mm);
        let whole = |kind, size, beyond_gate, text: String| Finding {
            stage: Stage::Scan.name(),
            kind,
            place: Place::of_planes(z_mm, 0, last),
            size,
            vector_mm: None,
            beyond_gate,
            text: format!("scan: {text}"),
        };
        if self.registered.is_mirrored() {
            let text = format!(
                "the scan is a mirror image of the model: mirrored it fits to {:.3} mm, as it is to {:.3} mm; either the replica was printed mirrored, or the scan was exported so",
                self.registered.mirrored_off_mm, self.registered.off_mm
            );
            return vec![whole(Kind::Mirrored, None, true, text)];
        }
        let mut findings = Vec::new();
        if let Some(percent) = self.registered.scaled_percent() {
            let size = Size { size: percent, unit: "percent", uncertainty: 100.0 * self.registered.scale_sd };
            let text = format!("the scanned replica is scaled by {percent:+.2} % against the solid");
            findings.push(whole(Kind::Scaled, Some(size), percent.abs() > gate.scale_percent, text));
        }
        let tested = shared_out(self.unscaled.as_ref().unwrap_or(&self.planes), branches);
        let pair = StagePair {
            stage: Stage::Scan,
            reference: &solid.planes,
            tested: &tested.planes,
            meant_mm: 0.0,
            least_mm: LEAST_MM.max(LEAST_VOXEL * self.largest_mm),
            gate_mm: gate.outline_mm,
            ends_mm: None,
        };
        let names = branches.names();
        findings.extend(moved(&pair, &names, z_mm));
        let made = [Made { stage: Stage::Scan, lumina: &tested.planes }];
        let is_filled = |f: &Finding| {
            let [first, last] = f.place.planes.unwrap_or_default();
            body == BodyKind::Cast || (first..=last).any(|k| self.fills(k, sections[k], solid, branches, f))
        };
        findings.extend(plugged(&solid.planes, &made, &names, z_mm).into_iter().filter(is_filled));
        findings
    }

    /// Whether material fills the lumen of a finding's branch in a plane.
    fn fills(
        &self,
        k: usize,
        section: &CrossSection,
        solid: &StageLumina,
        branches: &Branches,
        finding: &Finding,
    ) -> bool {
        let branch = branches.names().iter().position(|n| Some(n) == finding.place.branch.as_ref());
        let lumen = branch.and_then(|b| solid.planes[k][b].as_ref()).unwrap_or(&section.lumen);
        let area = lumen.area_mm2();
        area > 0.0 && self.planes[k].material.intersection(lumen).area_mm2() > FILLED * area
    }

    /// The block of the report, and what fails.
    pub(in crate::report) fn stage(&self, z_mm: &[f64]) -> (Scan, Vec<String>) {
        let (r, levels) = (&self.registered, &self.levels);
        let is_mirrored = r.is_mirrored();
        let known = |value: f64| (value.is_finite() && !is_mirrored).then_some(value);
        let scan = Scan {
            block: self.block(z_mm),
            registration: Registration {
                model_from_scan: (!is_mirrored).then(|| r.pose.to_transform()),
                rms_mm: known(r.rms_mm),
                fitted_part: known(r.fitted_part),
                scale_percent: known(100.0 * (1.0 / r.similar.scale - 1.0)),
                scale_uncertainty_percent: known(100.0 * r.scale_sd),
                mirrored: is_mirrored,
                mirror_is_told: !r.may_be_mirrored(),
            },
            levels: ScanLevels {
                air_hu: Some(levels.air),
                material_hu: Some(levels.material),
                blur_mm: Some(levels.blur_mm),
            },
            uncertainty_mm: ScanUncertainty {
                voxel: Some(self.largest_mm),
                scatter: known(r.scatter_mm),
                pose: known(r.pose_mm),
                place: known(r.pose_mm.hypot(self.largest_mm / 12f64.sqrt())),
            },
            gate: ScanGate::of_voxels(self.largest_mm),
        };
        let failures = failures(&scan);
        (scan, failures)
    }

    fn block(&self, z_mm: &[f64]) -> Block {
        if self.planes.is_empty() {
            let reason = "the scan is a mirror image of the model, no place of it can be compared".into();
            return Block { reason: Some(reason), ..Block::default() };
        }
        let measured = self.planes.iter().filter_map(|p| p.comparison.as_ref().ok());
        let n_planes = measured.clone().count();
        let plane = |(plane, (own, z_mm)): (usize, (&ScannedPlane, &f64))| {
            let mut figures = PlaneFigures { plane, z_mm: *z_mm, ..PlaneFigures::default() };
            match &own.comparison {
                Ok(comparison) => figures.figures = Figures::of(std::iter::once(comparison)),
                Err(reason) => figures.reason = Some(reason.clone()),
            }
            figures
        };
        let histogram = Histogram::of(measured.clone());
        let overall = Overall { figures: Figures::of(measured), n_planes, ..Overall::default() };
        Block {
            histogram,
            branches: Vec::new(),
            overall: (n_planes > 0).then_some(overall),
            planes: self.planes.iter().zip(z_mm).enumerate().map(plane).collect(),
            reason: (n_planes == 0).then(|| "no plane could be measured in the scan".into()),
        }
    }

    /// What the reader must know of it.
    pub(in crate::report) fn notes(&self) -> Vec<Warning> {
        if self.registered.is_mirrored() {
            return Vec::new();
        }
        let r = &self.registered;
        let text = format!(
            "A scan of the printed replica was laid over the model by a rigid fit (voxels up to {:.2} mm; {:.0} % of its surface lie {:.3} mm off, root mean square; a corner of the part may lie {:.3} mm off by the fit). The fit follows what agrees: a shift of all of the replica as one piece is not seen.",
            self.largest_mm,
            100.0 * r.fitted_part,
            r.rms_mm,
            r.pose_mm
        );
        let mut notes = vec![Warning::new("report.scan", text)];
        if self.is_cut {
            let text = "The scanned replica reaches the border of its image: what lies beyond is not seen.";
            notes.push(Warning::new("report.scan_cut", text));
        }
        if r.may_be_mirrored() {
            let text = "The shape of the model and its mirror image fit the scan nearly alike: whether the replica is mirrored is not told by the scan.";
            notes.push(Warning::new("report.scan_mirror", text));
        }
        notes
    }
}

fn shared_out(planes: &[ScannedPlane], branches: &Branches) -> StageLumina {
    let planes = planes.par_iter().enumerate().map(|(k, p)| branches.share_out(&p.lumen, k)).collect();
    StageLumina { stage: "scanned", planes }
}

/// A sentence for each limit that the scan does not keep.
fn failures(scan: &Scan) -> Vec<String> {
    let mut failures = Vec::new();
    let Some(overall) = &scan.block.overall else {
        return scan.block.reason.iter().map(|r| format!("scan: {r}")).collect();
    };
    let p95 = overall.figures.p95_mm;
    if let Some(p95) = p95.filter(|p| *p > scan.gate.p95_mm) {
        failures.push(format!(
            "scan: the 95th percentile against the model is {p95:.3} mm, allowed are {:.3} mm",
            scan.gate.p95_mm
        ));
    }
    let missing: Vec<String> = scan
        .block
        .planes
        .iter()
        .filter(|p| p.figures.mean_mm.is_none())
        .map(|p| p.plane.to_string())
        .collect();
    if !missing.is_empty() {
        failures.push(format!("scan: the lumen was not found in planes {}", missing.join(", ")));
    }
    failures
}
