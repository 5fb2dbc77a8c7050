//! Slice against CT: everything the run made, plane by plane, to the figures and pictures that say how
//! faithful the replica is.
//!
//! What is compared is the outline of the lumen, at the height of every CT plane, one stage against the one before:
//!
//! | block | reference | tested |
//! |---|---|---|
//! | `segmentation` | boundary in the image ([`image`](self)) | contours |
//! | `reconstruction` | contours | section of the solid |
//! | `slicing` | section of the solid | polygons of the layer |
//! | `toolpath` | polygons of the layer | beads as planned |
//! | `deposition` | beads as planned | beads as recorded |
//! | `total` | boundary in the image | beads as recorded |
//! | `scan` | section of the solid | a scan of the replica, where there is one ([`scan`](self)) |
//!
//! Distances are taken curve to curve, both ways ([`Figures`]); beads are strokes of their width, united. In
//! `deposition` Dice, IoU and area are those of the deposited material, over all layers in `overall`.
//! The registration is the one that the stages carried along (`bed_from_stack`), never fitted; it is checked
//! against the planned geometry, and a job that is off by more than [`REGISTRATION_MM`] is refused.
//!
//! What is wrong is named, with the stage it arose in, place and size ([`Finding`]).
//!
//! [`build`] is pure; [`write()`] and [`filing`] are the only IO.

mod about;
mod amounts;
mod anatomy;
mod course;
mod deviation;
pub mod dicom;
mod faults;
pub mod filing;
mod found;
mod histogram;
mod image;
mod lumen;
mod measures;
mod methods;
mod page;
mod pdf;
mod picture;
mod plate;
pub mod preview;
pub mod record;
mod scan;
pub mod schema;
mod shares;
mod stages;
mod strokes;
mod surface;
mod table;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod thickness;
mod uncertainty;
mod verdict;
mod wall;
mod write;

pub use about::About;
pub use amounts::{Amounts, Job, LumenVolume};
pub use anatomy::{Anatomy, Branch, NORMAL_MM, PlaneMeasures, Reference, StageMeasures, Stenosis, Throat};
pub use course::{Angles, Centreline, DIVISION_MM, Division, STRAIGHT_MM};
pub use deviation::{FigureUncertainty, Figures, STEP_MM};
pub use faults::{Finding, Kind, NOT_SEEN, Place, Size};
pub use histogram::{Histogram, N_BINS};
pub use image::Polarity;
pub use page::html;
pub use picture::Picture;
pub use record::{Origin, Record};
pub use scan::{Refusal, Registration, Scan, ScanGate, ScanLevels, ScanUncertainty};
pub use shares::BranchFigures;
pub use stages::build;
pub use table::csv;
pub use thickness::{PlaneWall, Wall, WallStage, WallUncertainty};
pub use uncertainty::Uncertainty;
pub use verdict::{Basis, Limit, Verdict};
pub use write::write;

use crate::ct::{Volume, Warning};
use crate::profile::Gate;
use crate::progress::Cancelled;
use crate::sections::SectionStack;
use crate::slice::Layer;
use crate::solid::Sectioned;
use crate::toolpath::Toolpaths;
use deviation::rounded;
use serde::{Serialize, Serializer};

/// How far the planned geometry on the bed may be off the layers it was made from, mm.
pub const REGISTRATION_MM: f64 = 0.01;

/// What the report is for, said on every page.
pub const INTENDED_USE: &str = "Models for planning, teaching and research. Not a medical device unless the user's \
institution validates it as one. Figures describe the printed lumen against the images it was made from; they do \
not replace the reading of the images.";

/// What kind of body was printed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BodyKind {
    /// A wall around the open lumen.
    Wall,
    /// The lumen itself, filled.
    Cast,
}

impl From<crate::solid::Body> for BodyKind {
    fn from(body: crate::solid::Body) -> Self {
        match body {
            crate::solid::Body::Wall { .. } => Self::Wall,
            crate::solid::Body::Cast => Self::Cast,
        }
    }
}

/// The CT and what is known about the lumen in it.
#[derive(Debug, Clone, Copy)]
pub struct Image<'a> {
    /// The volume, whole or cropped, in the stack frame.
    pub volume: &'a Volume,
    /// Whether the lumen is the brighter or the darker side.
    pub polarity: Polarity,
}

/// Everything that a report is made from.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// The CT; `None` for a case from ready contours.
    pub image: Option<Image<'a>>,
    /// The segmented contours, stack frame.
    pub sections: &'a SectionStack,
    /// The solid, stack frame.
    pub solid: &'a dyn Sectioned,
    /// Wall or cast.
    pub body: BodyKind,
    /// The layers, stack frame.
    pub layers: &'a [Layer],
    /// The job as planned, bed frame.
    pub paths: &'a Toolpaths,
    /// What the printer deposited, bed frame.
    pub record: &'a Record,
    /// The beads that the job's file commands, bed frame, where what was deposited is not what was planned: what the file has otherwise
    /// was not the printer.
    pub job_beads: Option<&'a Record>,
    /// A scan of the printed replica: bright material in air, any frame.
    pub scan: Option<&'a Volume>,
    /// What earlier stages found odd.
    pub warnings: &'a [Warning],
    /// Time and filament, as far as they are known.
    pub job: Job,
    /// What the lumen's surface takes as triangles, by falling deflection; none where that is not known.
    pub triangles: &'a [Triangles],
    /// The limits of the verdict.
    pub gate: Gate,
    /// What the report is of.
    pub about: &'a About,
}

impl std::fmt::Debug for Inputs<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Inputs")
            .field("image", &self.image.is_some())
            .field("n_planes", &self.sections.planes.len())
            .field("n_layers", &self.paths.layers.len())
            .field("n_segments", &self.record.segments.len())
            .finish_non_exhaustive()
    }
}

/// Why no report could be made.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Nothing was segmented.
    #[error("the case has no contours to report on: segment it first")]
    NoPlanes,
    /// Nothing was planned.
    #[error("the case has no toolpaths to report on: slice it first")]
    NoLayers,
    /// The job was turned away from the CT planes.
    #[error(
        "the job's layers are not parallel to the CT planes (tilted by {tilt_deg:.2} degrees): a report needs a job in the stack's orientation: slice the case again, its part upright as it lies in the CT"
    )]
    Tilted {
        /// Angle between the bed's and the stack's z, degrees.
        tilt_deg: f64,
    },
    /// The planned geometry does not lie where the transform says.
    #[error(
        "the planned job lies {off_mm:.3} mm off its layers (layer {layer}, more than {REGISTRATION_MM} mm): job and case do not belong together, slice the case again"
    )]
    Registration {
        /// The worst layer.
        layer: usize,
        /// By how much, mm.
        off_mm: f64,
    },
    /// No layer of the job can be compared with the case.
    #[error(
        "no layer of the job at a CT plane has a lumen, in the job or in the case: it cannot be checked that the two belong together, slice the case again"
    )]
    Unchecked,
    /// A picture could not be drawn.
    #[error(
        "the picture of plane {plane} could not be made ({why}): the vessel's extent is {width_mm:.0} x {height_mm:.0} mm"
    )]
    Picture {
        /// CT plane.
        plane: usize,
        /// What failed.
        why: String,
        /// Extent of the picture, mm.
        width_mm: f64,
        /// Extent of the picture, mm.
        height_mm: f64,
    },
    /// The page could not be rendered.
    #[error("the page of the report could not be rendered: {0}")]
    Page(#[from] minijinja::Error),
    /// A picture of the page could not be encoded.
    #[error("a picture of the report's page could not be encoded: {0}")]
    Drawing(#[from] png::EncodingError),
    /// The pixels of the document could not be packed.
    #[error("the document of the report (PDF) could not be made: {0}")]
    Pdf(#[from] std::io::Error),
    /// The figures could not be written as JSON.
    #[error("the figures of the report could not be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A file could not be written.
    #[error(
        "cannot write the report into {dir:?}: {source}; check that the disk has room and the folder may be written"
    )]
    Io {
        /// The directory that was to be made.
        dir: std::path::PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The scan of the replica does not fit the model.
    #[error(transparent)]
    Scan(#[from] Refusal),
    /// Interrupted on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// The six error stages of a run, and what a scan of the replica adds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Image boundary against contours.
    Segmentation,
    /// Contours against solid.
    Reconstruction,
    /// Solid against layer polygons.
    Slicing,
    /// Layer polygons against planned beads.
    Toolpath,
    /// Planned beads against recorded beads.
    Deposition,
    /// Image boundary against recorded beads.
    Total,
    /// Solid against a scan of the replica; only where there is one.
    Scan,
}

impl Stage {
    /// Those of every report, in the order of the work.
    pub const ALL: [Self; 6] = [
        Self::Segmentation,
        Self::Reconstruction,
        Self::Slicing,
        Self::Toolpath,
        Self::Deposition,
        Self::Total,
    ];

    /// Its key in `report.json`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Segmentation => "segmentation",
            Self::Reconstruction => "reconstruction",
            Self::Slicing => "slicing",
            Self::Toolpath => "toolpath",
            Self::Deposition => "deposition",
            Self::Total => "total",
            Self::Scan => "scan",
        }
    }

    /// What is compared with what, in the singular: reference and tested.
    #[must_use]
    pub const fn sides(self) -> [&'static str; 2] {
        match self {
            Self::Segmentation => ["the boundary in the image", "the contour"],
            Self::Reconstruction => ["the contour", "the solid"],
            Self::Slicing => ["the solid", "the layer"],
            Self::Toolpath => ["the layer", "the planned lumen"],
            Self::Deposition => ["the planned lumen", "the deposited lumen"],
            Self::Total => ["the boundary in the image", "the deposited lumen"],
            Self::Scan => ["the solid", "the scanned replica"],
        }
    }

    /// What is compared, for the reader.
    #[must_use]
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::Segmentation => "boundary in the image against segmented contour",
            Self::Reconstruction => "segmented contour against section of the solid",
            Self::Slicing => "section of the solid against layer polygon",
            Self::Toolpath => "layer polygon against beads as planned",
            Self::Deposition => "beads as planned against beads as deposited",
            Self::Total => "boundary in the image against beads as deposited",
            Self::Scan => "section of the solid against a scan of the replica",
        }
    }
}

/// The figures of one stage.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Block {
    /// All planes together; `None` where nothing could be measured.
    pub overall: Option<Overall>,
    /// Plane by plane.
    pub planes: Vec<PlaneFigures>,
    /// Branch by branch, those that have figures.
    pub branches: Vec<BranchFigures>,
    /// How the signed distances of all planes are spread.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub histogram: Option<Histogram>,
    /// Why there are no figures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Figures over all planes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Overall {
    /// The figures.
    #[serde(flatten)]
    pub figures: Figures,
    /// Planes that have figures.
    pub n_planes: usize,
    /// Deposition only: the least IoU of deposited against planned material of a layer.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "rounded")]
    pub iou_min: Option<f64>,
    /// Deposition only: the mean IoU of all layers.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "rounded")]
    pub iou_mean: Option<f64>,
    /// Image stages only: which part of the places along the contours showed a clear edge.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "rounded")]
    pub edge_found_part: Option<f64>,
}

/// Figures of one plane.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct PlaneFigures {
    /// CT plane, counted from 0 in the sections.
    pub plane: usize,
    /// Its height in the stack frame, mm.
    pub z_mm: f64,
    /// The figures.
    #[serde(flatten)]
    pub figures: Figures,
    /// Deposition only: IoU of deposited against planned material in this plane's layer.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "rounded")]
    pub iou: Option<f64>,
    /// Why figures are missing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

/// Deposited against planned material of one layer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LayerFigures {
    /// The layer, 0 on the bed.
    pub layer: usize,
    /// Height of its middle in the stack frame, mm.
    pub z_mm: f64,
    /// The CT plane that it stands for.
    pub ct_plane: Option<usize>,
    /// Area of the planned beads, mm².
    #[serde(serialize_with = "rounded")]
    pub planned_area_mm2: Option<f64>,
    /// Area of the deposited beads, mm².
    #[serde(serialize_with = "rounded")]
    pub recorded_area_mm2: Option<f64>,
    /// Intersection over union; `null` where neither has anything.
    #[serde(serialize_with = "rounded")]
    pub iou: Option<f64>,
}

/// How many triangles the lumen's surface takes within a deflection.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Triangles {
    /// Farthest that the surface may be from its triangles, mm.
    pub deflection_mm: f64,
    /// Their number.
    pub n_triangles: usize,
}

/// The whole report: figures, pictures, and what must be said beside them.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// What it is of.
    pub about: About,
    /// Wall or cast.
    pub body: BodyKind,
    /// Blocks in the order of [`Stage::ALL`].
    pub blocks: [Block; 6],
    /// All layers of the job.
    pub layers: Vec<LayerFigures>,
    /// Areas, diameters, stenoses.
    pub anatomy: Anatomy,
    /// The wall, one entry a stage; none for a cast.
    pub walls: Vec<WallStage>,
    /// Volumes, filament, time.
    pub amounts: Amounts,
    /// Where the deposition is known from.
    pub origin: Origin,
    /// The printed replica as a scan shows it, where there is one.
    pub scan: Option<Scan>,
    /// Heights of the CT planes, mm.
    pub plane_z_mm: Vec<f64>,
    /// What limits the accuracy of lengths.
    pub uncertainty: Uncertainty,
    /// The lumen's surface as triangles.
    pub triangles: Vec<Triangles>,
    /// Defects, in the order of the stages.
    pub findings: Vec<Finding>,
    /// What is extrapolated, missing or odd.
    pub notes: Vec<Warning>,
    /// Whether the replica passes.
    pub verdict: Verdict,
    /// One picture a CT plane.
    pub pictures: Vec<Picture>,
    /// The lumen's surface with its deviation, for the page.
    pub(crate) surface: surface::Surface,
}

impl Report {
    /// The figures of a stage; none of the scan where there is no scan.
    #[must_use]
    pub fn block(&self, stage: Stage) -> &Block {
        static NONE: Block =
            Block { overall: None, planes: Vec::new(), branches: Vec::new(), histogram: None, reason: None };
        match stage {
            Stage::Scan => self.scan.as_ref().map_or(&NONE, |s| &s.block),
            _ => &self.blocks[stage as usize],
        }
    }

    /// The stages that it has, in the order of the work.
    pub(crate) fn stages(&self) -> impl Iterator<Item = Stage> {
        Stage::ALL.into_iter().chain(self.scan.as_ref().map(|_| Stage::Scan))
    }

    /// What is compared in a stage, for the reader; where the deposition is only what was commanded, it says so.
    pub(crate) fn meaning(&self, stage: Stage) -> &'static str {
        match (stage, self.origin) {
            (Stage::Deposition, Origin::Commanded) => {
                "beads as planned against beads as commanded, not measured"
            }
            (Stage::Total, Origin::Commanded) => {
                "boundary in the image against beads as commanded, not measured"
            }
            _ => stage.meaning(),
        }
    }

    /// `report.json`.
    ///
    /// # Errors
    /// Where a number cannot be written, which the rounding excludes.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        let mut text = serde_json::to_string_pretty(self)?;
        text.push('\n');
        Ok(text)
    }

    /// The headline figures, one a line, for a terminal.
    #[must_use]
    pub fn headline(&self) -> Vec<String> {
        let stage_line = |stage: Stage| match &self.block(stage).overall {
            Some(o) => format!(
                "{:<14} mean {} mm, 95th percentile {} mm, bias {} mm, Dice {}",
                stage.name(),
                shown(o.figures.mean_mm, 3),
                shown(o.figures.p95_mm, 3),
                shown(o.figures.bias_mm, 3),
                shown(o.figures.dice, 4)
            ),
            None => format!(
                "{:<14} not measured: {}",
                stage.name(),
                self.block(stage).reason.as_deref().unwrap_or("nothing to compare")
            ),
        };
        let deposited = self.block(Stage::Deposition).overall.unwrap_or_default();
        let mut lines: Vec<String> = self.stages().map(stage_line).collect();
        lines.push(format!(
            "layers         {} layers, {} against planned IoU {} at least, {} on average",
            self.layers.len(),
            self.origin.word(),
            shown(deposited.iou_min, 4),
            shown(deposited.iou_mean, 4)
        ));
        if self.origin == Origin::Commanded {
            lines.push("deposited      is what was commanded, not measured".into());
        }
        lines.extend(self.findings.iter().map(|f| format!("defect         {}", f.text)));
        lines.push(self.verdict.sentence());
        lines
    }
}

/// A figure that does not keep its limit, and the limit, with so many decimals that they differ.
fn apart(value: f64, limit: f64, decimals: usize) -> [String; 2] {
    let texts = |n: usize| [value, limit].map(|v| shown(Some(v), n));
    (decimals..9).map(texts).find(|[a, b]| a != b).unwrap_or_else(|| texts(9))
}

/// A figure as text, a dash where there is none.
fn shown(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(
        || "\u{2013}".into(),
        |v| {
            let text = format!("{v:.decimals$}");
            // What rounds to nothing has no sign.
            match text.strip_prefix('-') {
                Some(size) if size.chars().all(|c| matches!(c, '0' | '.')) => size.to_owned(),
                _ => text,
            }
        },
    )
}

impl Serialize for Report {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeMap;
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("format", "lumenfab report 1")?;
        map.serialize_entry("intended_use", INTENDED_USE)?;
        map.serialize_entry("about", &self.about)?;
        map.serialize_entry("body", &self.body)?;
        map.serialize_entry("deposited", &self.origin)?;
        map.serialize_entry("verdict", &self.verdict)?;
        map.serialize_entry("findings", &self.findings)?;
        map.serialize_entry("not_seen", &NOT_SEEN)?;
        for stage in Stage::ALL {
            map.serialize_entry(stage.name(), self.block(stage))?;
        }
        if let Some(scan) = &self.scan {
            map.serialize_entry(Stage::Scan.name(), scan)?;
        }
        map.serialize_entry("anatomy", &self.anatomy)?;
        map.serialize_entry("walls", &self.walls)?;
        map.serialize_entry("amounts", &self.amounts)?;
        map.serialize_entry("uncertainty_mm", &self.uncertainty)?;
        map.serialize_entry("triangles", &self.triangles)?;
        map.serialize_entry("layers", &self.layers)?;
        map.serialize_entry("notes", &self.notes)?;
        let methods = methods::METHODS.map(|(name, text)| format!("{name}: {text}"));
        map.serialize_entry("methods", &methods)?;
        map.end()
    }
}
