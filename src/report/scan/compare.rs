//! The scan at the planes of the model: outlines, figures, notes.

use super::levels::Levels;
use super::registration::Pose;
use super::sampler::Sampler;
use super::{Registration, Scan, ScanGate, ScanLevels, ScanUncertainty, Scanned};
use crate::ct::Warning;
use crate::geom::{Contour, Point2, Point3, Region};
use crate::progress::{Cancelled, Task};
use crate::report::anatomy::{Branches, StageLumina};
use crate::report::deviation::{Comparison, Figures, compare};
use crate::report::image::{curvature_per_mm, drawn_inward_mm, outward};
use crate::report::lumen::{Expected, of_beads};
use crate::report::stages::section_lumen;
use crate::report::{Block, BodyKind, Histogram, Inputs, Overall, PlaneFigures};
use crate::sections::march::Grid;
use crate::solid::CrossSection;
use rayon::prelude::*;

/// Why a plane is not compared that the model does not reach: no fault of the replica.
pub(in crate::report) const NO_MODEL: &str = "no lumen of the solid here";
/// The replica is looked for so far around its section, mm.
const AROUND_MM: f64 = 3.0;
/// Sides of the pixels that the scan is read in, mm.
const PIXEL_MM: [f64; 2] = [0.04, 0.5];
/// Specks smaller than this many pixels are noise.
const LEAST_PIXELS: f64 = 6.0;
/// A lumen has this part of its wall, looked at so far outside of it, mm.
const ENCLOSED: f64 = 0.5;
const AT_WALL_MM: f64 = 0.15;

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
    /// Thickness of the model's wall; `None` for a cast.
    pub(super) wall_mm: Option<f64>,
}

impl Planes<'_> {
    /// Larger voxels do not show the part, mm: half the wall, a quarter of the narrowest place of a cast.
    fn finest_mm(&self) -> Option<f64> {
        match self.inputs.body {
            BodyKind::Wall => self.wall_mm.map(|wall| 0.5 * wall),
            BodyKind::Cast => {
                let islands = self.sections.iter().flat_map(|(_, s)| s.outer.islands());
                islands.map(|i| 0.25 * i.least_width_mm()).reduce(f64::min)
            }
        }
    }

    /// The usual distance of the planes, mm.
    pub(super) fn interval_mm(&self) -> f64 {
        crate::report::image::median(self.sections.windows(2).map(|w| w[1].0 - w[0].0)).unwrap_or(0.0)
    }

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
        let mut lumen = of_beads(&material, Expected { lumen: model, material: &filled }, body);
        if body == BodyKind::Wall {
            lumen = Region::union_all(&enclosed(&lumen, &material));
        }
        let comparison = if model.is_empty() {
            Err(NO_MODEL.into())
        } else if lumen.is_empty() {
            Err("no lumen in the scan of the replica here".into())
        } else {
            compare(&model.clone().into(), &lumen.clone().into()).map_err(str::to_owned)
        };
        ScannedPlane { material, lumen, comparison }
    }

    /// What is brighter than half-way near a section, moved back by what blur does to curved outlines.
    pub(super) fn material(&self, pose: &Pose, z_mm: f64, section: &CrossSection) -> Region {
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

/// The lumina that have a wall around them: where most of it is missing, what the model would enclose is no lumen.
fn enclosed(lumen: &Region, material: &Region) -> Vec<Region> {
    let has_wall = |island: &Region| {
        let around = island.offset(AT_WALL_MM, 0.01).difference(island);
        around.intersection(material).area_mm2() > ENCLOSED * around.area_mm2()
    };
    lumen.islands().into_iter().filter(has_wall).collect()
}

impl Scanned<'_> {
    /// The lumina of the scan, given to the branches.
    pub(in crate::report) fn lumina(&self, branches: &Branches) -> Option<StageLumina> {
        (!self.planes.is_empty()).then(|| shared_out(&self.planes, branches))
    }

    /// The block of the report.
    pub(in crate::report) fn stage(&self, z_mm: &[f64]) -> Scan {
        let (r, levels) = (&self.registered, self.levels.as_ref());
        let is_mirrored = r.is_mirrored();
        let known = |value: f64| (value.is_finite() && !is_mirrored).then_some(value);
        Scan {
            block: self.block(z_mm),
            registration: Registration {
                model_from_scan: (!is_mirrored).then(|| r.pose.to_transform()),
                rms_mm: known(r.rms_mm),
                fitted_part: known(r.fitted_part),
                scale_percent: known(100.0 * (1.0 / r.similar.scale - 1.0))
                    .filter(|_| r.scale_sd.is_finite()),
                scale_uncertainty_percent: known(100.0 * r.scale_sd),
                mirrored: is_mirrored,
                mirror_is_told: !r.may_be_mirrored(),
            },
            levels: ScanLevels {
                air_hu: levels.map(|l| l.air),
                material_hu: levels.map(|l| l.material),
                blur_mm: levels.map(|l| l.blur_mm),
            },
            uncertainty_mm: ScanUncertainty {
                voxel: Some(self.largest_mm()),
                scatter: known(r.scatter_mm),
                pose: known(r.pose_mm),
                place: known(self.place_mm()),
            },
            gate: self.gate(),
            not_judged: self.too_coarse(),
        }
    }

    /// Why nothing can be judged by this scan, where its voxels are too large.
    pub(super) fn too_coarse(&self) -> Option<String> {
        let most_mm = self.reader.finest_mm()?;
        let voxel_mm = self.largest_mm();
        (voxel_mm > most_mm).then(|| {
            let part = match self.reader.inputs.body {
                BodyKind::Wall => format!("a wall of {:.2} mm", 2.0 * most_mm),
                BodyKind::Cast => format!("a vessel of {:.2} mm", 4.0 * most_mm),
            };
            format!(
                "scan: voxels of {voxel_mm:.2} mm do not show {part}, at most {most_mm:.2} mm are needed: scan the replica finer"
            )
        })
    }

    /// The largest side of a voxel, mm.
    pub(super) fn largest_mm(&self) -> f64 {
        self.reader.sampler.largest_mm()
    }

    /// Standard uncertainty of a place, mm: the pose, and a voxel of even probability.
    pub(super) fn place_mm(&self) -> f64 {
        self.registered.pose_mm.hypot(self.largest_mm() / 12f64.sqrt())
    }

    pub(super) const fn gate(&self) -> ScanGate {
        ScanGate::of(&self.reader.inputs.gate)
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
            self.largest_mm(),
            100.0 * r.fitted_part,
            r.rms_mm,
            r.pose_mm
        );
        let mut notes = vec![Warning::new("report.scan", text)];
        if self.is_cut {
            let text = "The scanned replica reaches the border of its image: what lies beyond is not seen.";
            notes.push(Warning::new("report.scan_cut", text));
        }
        if self.levels.is_none() {
            let text = "Too few places of the replica's skin show air and material beside each other: the grey levels and the blur of the scan were not measured. Outlines lie at a level guessed from all voxels, and blur is not undone.";
            notes.push(Warning::new("report.scan_levels", text));
        }
        if r.may_be_mirrored() {
            let text = "The shape of the model and its mirror image fit the scan nearly alike: whether the replica is mirrored is not told by the scan.";
            notes.push(Warning::new("report.scan_mirror", text));
        }
        notes
    }
}

pub(super) fn shared_out(planes: &[ScannedPlane], branches: &Branches) -> StageLumina {
    let planes = planes.par_iter().enumerate().map(|(k, p)| branches.share_out(&p.lumen, k)).collect();
    StageLumina { stage: "scanned", planes }
}
