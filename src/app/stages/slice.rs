//! Solid to print job: `job.gcode`, `layers.json`.

use super::export::check_target;
use super::layer_pictures::check_folder;
use super::segment::SECTIONS_FILE;
use super::solid::SOLID_FILE;
use super::{read_json, to_json};
use crate::app::atomic;
use crate::app::case::MadeFrom;
use crate::app::error::Error;
use crate::app::event::Stage;
use crate::app::session::{Made, Session, hash_of};
use crate::ct::Warning;
use crate::gcode;
use crate::geom::RigidTransform;
use crate::motion;
use crate::preview;
use crate::printer::paper;
use crate::profile::{self, Profile};
use crate::progress::Task;
use crate::slice::{self, GridParams, Layer, LayerSlot};
use crate::toolpath::{self, Toolpaths};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The print job.
pub(crate) const JOB_FILE: &str = "job.gcode";
/// Layers against CT planes.
pub(crate) const LAYERS_FILE: &str = "layers.json";

/// Sides of the pictures at a job's head, those that printers' displays and print servers look for.
const THUMBNAILS_PX: [u32; 2] = [32, 300];

/// How far a layer's outline may be from the solid's section, mm: by as much on the one side as on the other, so that areas
/// are kept; the moves are then as long as the wire and the planner can take.
const OUTLINE_TOLERANCE_MM: f64 = 0.003;

/// Layers and toolpaths of a job.
pub(crate) struct Sliced {
    /// Stack frame.
    pub(crate) layers: Vec<Layer>,
    /// Bed frame.
    pub(crate) paths: Toolpaths,
}

/// `layers.json`: the table layer <-> z <-> CT plane, the job's place on the bed, what it takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct LayersDocument {
    /// 16 numbers, row by row.
    pub(crate) bed_from_stack: RigidTransform,
    /// From the bed upward.
    pub(crate) layers: Vec<LayerSlot>,
    /// Time that the job is estimated to take, s.
    pub(crate) print_time_s: f64,
    /// Filament that it takes, mm.
    pub(crate) filament_mm: f64,
    /// Filament that it takes, g.
    pub(crate) filament_g: f64,
    /// What was odd.
    pub(crate) warnings: Vec<Warning>,
}

impl Session<'_> {
    /// Cuts the solid into layers, plans their toolpaths, writes the G-code.
    ///
    /// # Errors
    /// [`Error`] where there is no solid, where it does not fit the printer, or where the case cannot be written.
    pub fn slice(&mut self) -> Result<(), Error> {
        self.spare_the_print(Stage::Slice)?;
        self.require(Stage::Solid)?;
        let profile = self.profile()?;
        // Written into the job, so that a printout can be traced to what it was made from.
        let settings = format!("{:?}", self.made_from(Stage::Slice)?);
        self.stage(Stage::Slice, |session, task| session.write_job(&profile, settings, task))
    }

    pub(crate) fn slice_made_from(&self) -> Result<MadeFrom, Error> {
        Ok(MadeFrom::from([
            ("sections", self.case.output_hash(Stage::Segment, SECTIONS_FILE)?),
            ("solid", self.case.output_hash(Stage::Solid, SOLID_FILE)?),
            ("layer_mm", hash_of(&self.settings().layer_mm)),
            ("profile", hash_of(&self.profile()?)),
        ]))
    }

    /// Refuses places for the job and its pictures that cannot be used, before any work is done.
    ///
    /// # Errors
    /// [`Error`] that names the place.
    pub fn check_targets(&self, job: Option<&Path>, pictures: Option<&Path>) -> Result<(), Error> {
        pictures.map_or(Ok(()), check_folder)?;
        job.map_or(Ok(()), |job| check_target("out", job, self.case.dir()))
    }

    /// Copies the G-code to a file of the operator's.
    ///
    /// # Errors
    /// [`Error`] where there is none yet or the file cannot be written.
    pub fn copy_job(&self, to: &Path) -> Result<(), Error> {
        check_target("out", to, self.case.dir())?;
        paper::refuse_replacing(to, self.gives_up_print)?;
        let job = self.case.output(Stage::Slice, JOB_FILE)?;
        let bytes = std::fs::read(&job).map_err(atomic::failed("read", &job))?;
        Ok(atomic::write_export(to, &bytes)?)
    }

    /// The profile that the case names.
    pub(crate) fn profile(&self) -> Result<Profile, Error> {
        Ok(profile::load::by_name(&self.settings().profile)?)
    }

    fn write_job(&mut self, profile: &Profile, settings: String, task: &Task<'_>) -> Result<Made, Error> {
        let warnings = self.plan(profile, task)?;
        self.note(Stage::Slice, "writing G-code");
        let sliced = self.held.sliced.as_ref().expect("planned just now");
        let (job, estimate) = job_text(&sliced.paths, profile, settings, task)?;
        let document = LayersDocument {
            bed_from_stack: sliced.paths.bed_from_stack,
            layers: sliced.paths.layers.iter().map(|l| l.slot).collect(),
            print_time_s: estimate.total_s,
            filament_mm: estimate.filament_mm,
            filament_g: estimate.filament_g,
            warnings: warnings.clone(),
        };
        // A print of the old one may have begun meanwhile.
        paper::refuse_replacing(&self.case.path(JOB_FILE), self.gives_up_print)?;
        let staging = self.case.staging()?;
        staging.write(JOB_FILE, job.as_bytes())?;
        staging.write(LAYERS_FILE, &to_json(&document))?;
        let summary = format!(
            "{} layers, {} lines, {} of printing, {:.2} m ({:.1} g) of filament",
            document.layers.len(),
            job.lines().count(),
            hours_and_minutes(estimate.total_s),
            estimate.filament_mm / 1e3,
            estimate.filament_g
        );
        Ok(Made { staging, summary, warnings })
    }

    /// Layers and toolpaths in memory.
    fn plan(&mut self, profile: &Profile, task: &Task<'_>) -> Result<Vec<Warning>, Error> {
        let params = GridParams {
            layer_mm: self.settings().layer_mm,
            height_limits_mm: profile.machine.layer_height_mm,
        };
        let plane_z_mm = self.sections()?.plane_z_mm();
        let solid = self.built()?;
        let grid = slice::grid(&plane_z_mm, crate::solid::Sectioned::z_range_mm(solid), &params)?;
        let layers = slice::slice_solid(solid, &grid, OUTLINE_TOLERANCE_MM, task)?;
        self.note(Stage::Slice, "planning toolpaths");
        let planned = toolpath::plan(&layers, profile, task)?;
        self.held.sliced = Some(Sliced { layers, paths: planned.paths });
        Ok(planned.warnings)
    }

    /// Layers and toolpaths; planned again unless this process has just done it, which gives the same.
    pub(crate) fn sliced(&mut self, task: &Task<'_>) -> Result<&Sliced, Error> {
        if self.held.sliced.is_none() {
            let profile = self.profile()?;
            self.plan(&profile, task)?;
        }
        Ok(self.held.sliced.as_ref().expect("planned just now"))
    }

    /// The table of layers.
    pub(crate) fn layers_document(&self) -> Result<LayersDocument, Error> {
        Ok(read_json(&self.case.output(Stage::Slice, LAYERS_FILE)?)?)
    }
}

/// The text of a job with its pictures, its time and its progress; what it takes. `settings` goes into its hash.
pub(super) fn job_text(
    paths: &Toolpaths,
    profile: &Profile,
    settings: String,
    task: &Task<'_>,
) -> Result<(String, motion::Estimate), Error> {
    let thumbnail = |side_px| {
        let png = preview::portrait(paths, side_px, task)?;
        Ok(gcode::Thumbnail { width_px: side_px, height_px: side_px, png })
    };
    let thumbnails = THUMBNAILS_PX.into_iter().map(thumbnail).collect::<Result<_, preview::Error>>()?;
    let draft = gcode::write(paths, profile, &gcode::Header { settings, thumbnails });
    let estimate = motion::estimate(&draft, profile, task)?;
    Ok((gcode::timed(&draft, estimate.timing(), profile), estimate))
}

/// A time as `7 h 12 min`, or `43 min`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a print takes less than centuries"
)]
pub(super) fn hours_and_minutes(time_s: f64) -> String {
    let minutes = (time_s / 60.0).round().max(0.0) as u64;
    if minutes < 60 { format!("{minutes} min") } else { format!("{} h {} min", minutes / 60, minutes % 60) }
}
