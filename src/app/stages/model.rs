//! A foreign model to a print job, without a case.

use super::export::check_target;
use super::layer_pictures;
use crate::app::atomic;
use crate::app::error::Error;
use crate::app::event::{Event, Stage};
use crate::app::session::Context;
use crate::ct::Warning;
use crate::model::{self, Axis, Contents, Model};
use crate::motion;
use crate::printer::paper;
use crate::profile::{self, Profile};
use crate::progress::Task;
use crate::slice::{self, GridParams};
use crate::toolpath::{self, Toolpaths};
use crate::units::{counted, told_size_mm};
use serde::Serialize;
use std::path::Path;

/// Extensions of files that are models; everything else is a case.
const EXTENSIONS: [&str; 2] = ["stl", "3mf"];

/// What is asked of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelJob<'a> {
    /// Wanted height of the layers, mm.
    pub layer_mm: f64,
    /// A name, or the path of a profile file.
    pub profile_name: &'a str,
    /// Perimeters instead of the profile's.
    pub perimeters: Option<u32>,
    /// Fill instead of the profile's, percent.
    pub infill_percent: Option<f64>,
    /// A turn about an axis by an angle in degrees before all else.
    pub turn: Option<(Axis, f64)>,
    /// A new or empty folder for a picture of every layer.
    pub preview: Option<&'a Path>,
    /// Whether the last print of the job in its place, should it have broken off, is given up.
    pub gives_up_print: bool,
}

/// What became of a model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SlicedModel {
    /// Triangles of the file.
    pub n_triangles: usize,
    /// Size of the model as it lies on the bed, mm.
    pub size_mm: [f64; 3],
    /// Layers of the job.
    pub n_layers: usize,
    /// Lines of the job.
    pub n_lines: usize,
    /// Time that the job is estimated to take, s.
    pub print_time_s: f64,
    /// Filament that it takes, mm.
    pub filament_mm: f64,
    /// Filament that it takes, g.
    pub filament_g: f64,
    /// Where the model's origin lies on the bed, mm.
    pub bed_from_model_mm: [f64; 3],
    /// What the operator should look at.
    pub warnings: Vec<Warning>,
}

impl std::fmt::Display for SlicedModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { n_triangles, size_mm, n_layers, n_lines, print_time_s, filament_mm, filament_g, .. } =
            self;
        let [x, y, z] = self.bed_from_model_mm;
        write!(
            f,
            "{}, {}, {}, {n_lines} lines, {} of printing, {:.2} m ({filament_g:.1} g) of filament; the model's \
             origin lies at x {x:.3}, y {y:.3}, z {z:.3} mm",
            told_size_mm(*size_mm),
            counted(*n_triangles, "triangle"),
            counted(*n_layers, "layer"),
            super::slice::hours_and_minutes(*print_time_s),
            filament_mm / 1e3
        )
    }
}

/// Whether a path names a model, by its extension.
#[must_use]
pub fn is_model(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    EXTENSIONS.iter().any(|known| extension.eq_ignore_ascii_case(known))
}

/// Slices a model and writes its G-code.
///
/// # Errors
/// [`Error`] where the model, the profile or the job's file cannot be used, and where the model does not fit the machine.
pub fn slice_model(
    path: &Path,
    out: &Path,
    job: &ModelJob<'_>,
    context: &Context<'_>,
) -> Result<SlicedModel, Error> {
    job.preview.map_or(Ok(()), layer_pictures::check_folder)?;
    check_target("out", out, path)?;
    paper::refuse_replacing(out, job.gives_up_print)?;
    let profile = wanted(profile::load::by_name(job.profile_name)?, job);
    let events = context.events;
    let sink = move |done, total| events(Event::Progress { stage: Stage::Slice, done, total });
    let task = Task::new(&sink, context.cancel.clone());
    events(Event::Started(Stage::Slice));
    if job.turn.is_some() {
        let text = "places are told of the model as --orient turns it".to_owned();
        events(Event::Told { stage: Stage::Slice, code: "model.orient", text });
    }
    let planned = OnBed::of(path, job, &profile, &task)?;
    let (text, estimate) = super::slice::job_text(&planned.paths, &profile, settings(job), &task)?;
    paper::refuse_replacing(out, job.gives_up_print)?;
    atomic::write_export(out, text.as_bytes())?;
    job.preview.map_or(Ok(()), |dir| layer_pictures::write(dir, &planned.paths, &task))?;
    let told = planned.told(&text, &estimate);
    for warning in &told.warnings {
        events(Event::Warned { stage: Stage::Slice, warning: warning.clone() });
    }
    Ok(told)
}

/// A model's toolpaths, and what is told of it.
struct OnBed {
    n_triangles: usize,
    size_mm: [f64; 3],
    paths: Toolpaths,
    warnings: Vec<Warning>,
}

impl OnBed {
    /// Reads, cuts and plans; what the next step does not need is let go before it.
    fn of(path: &Path, job: &ModelJob<'_>, profile: &Profile, task: &Task<'_>) -> Result<Self, Error> {
        let (n_triangles, Model { mesh, mut warnings }) = model_of(path, job)?;
        let params = GridParams { layer_mm: job.layer_mm, height_limits_mm: profile.machine.layer_height_mm };
        let sliced = slice::slice_mesh(&mesh, &params, task).map_err(|e| Error::from(e).of_model(path))?;
        let size_mm = mesh.extent_mm().map(|[low, high]| high - low);
        drop(mesh);
        let planned =
            toolpath::plan(&sliced.layers, profile, task).map_err(|e| Error::from(e).of_model(path))?;
        warnings.extend(sliced.warnings);
        warnings.extend(planned.warnings);
        Ok(Self { n_triangles, size_mm, paths: planned.paths, warnings })
    }

    fn told(&self, text: &str, estimate: &motion::Estimate) -> SlicedModel {
        let by = self.paths.bed_from_stack.apply(crate::geom::Point3::origin());
        SlicedModel {
            n_triangles: self.n_triangles,
            size_mm: self.size_mm,
            n_layers: self.paths.layers.len(),
            n_lines: text.lines().count(),
            print_time_s: estimate.total_s,
            filament_mm: estimate.filament_mm,
            filament_g: estimate.filament_g,
            bed_from_model_mm: [by.x, by.y, by.z],
            warnings: self.warnings.clone(),
        }
    }
}

/// The model of a file, turned as it is asked for, and how many triangles the file has.
fn model_of(path: &Path, job: &ModelJob<'_>) -> Result<(usize, Model), Error> {
    let bytes = std::fs::read(path).map_err(atomic::failed("read", path))?;
    let bad = |source: model::Error| Error::Model { path: path.to_owned(), source };
    let is_named_3mf = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("3mf"));
    if is_named_3mf && !model::threemf::is_package(&bytes) {
        return Err(bad(model::Error::NoPackage));
    }
    let Contents { facets, warnings } = model::read(&bytes).map_err(bad)?;
    drop(bytes);
    let mut model = Model::of(&facets).map_err(bad)?;
    model.warnings.splice(0..0, warnings);
    if let Some((axis, angle_deg)) = job.turn {
        model = model.turned(axis, angle_deg);
    }
    Ok((facets.len(), model))
}

/// What goes into the job's hash besides the profile.
fn settings(job: &ModelJob<'_>) -> String {
    let ModelJob { layer_mm, perimeters, infill_percent, turn, .. } = job;
    format!("{:?}", (layer_mm, perimeters, infill_percent, turn))
}

fn wanted(mut profile: Profile, job: &ModelJob<'_>) -> Profile {
    profile.print.perimeters = job.perimeters.unwrap_or(profile.print.perimeters);
    profile.print.infill_percent = job.infill_percent.unwrap_or(profile.print.infill_percent);
    profile
}
