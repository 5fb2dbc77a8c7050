//! Everything to the report: `report/`.

use super::print::{How, PRINT_FILE, RECORD_DIR};
use super::read_json;
use super::segment::{SECTIONS_FILE, VOLUME_FILE, hash_of_source};
use super::slice::{JOB_FILE, LAYERS_FILE};
use super::solid::SOLID_FILE;
use crate::app::atomic;
use crate::app::case::{CaseError, JOURNAL_FILE, MadeFrom};
use crate::app::commanded::{self, Commanded};
use crate::app::error::Error;
use crate::app::event::Stage;
use crate::app::session::{Made, Session, hash_of};
use crate::app::settings::Body;
use crate::ct::{self, SeriesChoice, Volume, Warning};
use crate::geom::Point3;
use crate::mesh::{self, Tessellation};
use crate::profile::{self, Gate, Profile};
use crate::progress::Task;
use crate::report::dicom::Instance;
use crate::report::record::Way;
use crate::report::{self, About, BodyKind, Image, Inputs, Job, Record, Report, Triangles};
use crate::segment::Polarity;
use crate::solid::{SkinChoice, Solid};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The report.
const REPORT_DIR: &str = "report";
/// Its headline figures as text, in [`REPORT_DIR`].
const HEADLINE_FILE: &str = "headline.txt";

/// Where the report is and what it says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReportPlace {
    /// The page to open.
    pub index_html: PathBuf,
    /// The figures.
    pub report_json: PathBuf,
    /// Whether the gate was passed.
    pub passed: bool,
    /// The figures of the block `total`; `null` where they could not be measured.
    pub total: serde_json::Value,
    /// The headline figures, one a line.
    #[serde(skip)]
    pub headline: Vec<String>,
}

/// A scan of the printed replica, as the operator named it. Kept nowhere but in memory; the case holds its hash.
pub(crate) struct NamedScan {
    path: PathBuf,
    choice: SeriesChoice,
    hash: String,
}

/// What is read back from `report.json`.
#[derive(Deserialize)]
struct Figures {
    verdict: Verdict,
    total: Total,
}

#[derive(Deserialize)]
struct Verdict {
    passed: bool,
}

#[derive(Deserialize)]
struct Total {
    overall: serde_json::Value,
}

/// What a record's `summary.json` tells of the whole print.
#[derive(Deserialize)]
struct PrintSummary {
    simulated_s: f64,
    filament_mm: f64,
}

/// The beads of a job's lines.
fn beads_of(commanded: &Commanded, profile: &Profile) -> Record {
    let area_mm2 = std::f64::consts::FRAC_PI_4 * profile.machine.filament_mm.powi(2);
    let ways = commanded.pushes.iter().map(|push| Way {
        from: Point3::from(push.from_mm),
        to: Point3::from(push.to_mm),
        volume_mm3: push.filament_mm * area_mm2,
    });
    Record::commanded(ways, profile.print.bead_shape)
}

/// The beads that a real printer was told to lay, and what must be said of them.
fn record_of(commanded: &Commanded, profile: &Profile) -> Record {
    let mut record = beads_of(commanded, profile);
    let extent = commanded.extent;
    let [n_done, n_all] = extent.n_lines;
    let text = format!(
        "The printer keeps no record of what it lays. What is called deposited or recorded here is commanded, not measured: the {n_done} of {n_all} lines that the printer has acknowledged, followed without their errors. Clogs, lost steps and what was done at the printer are not seen; a scan of the replica shows them (`lumenfab report CASE --scan PATH`)."
    );
    record.warnings.push(Warning::new("report.commanded", text));
    if !extent.is_finished {
        let text = format!(
            "The print had not ended when this was made: {} lines were not acknowledged and count as not printed; of the last ones that were, some may not have been moved any more.",
            n_all - n_done
        );
        record.warnings.push(Warning::new("report.print_not_finished", text));
    }
    if extent.n_twice > 0 {
        let text = format!(
            "Up to {} lines may have been executed twice, after a reset; they count once.",
            extent.n_twice
        );
        record.warnings.push(Warning::new("report.lines_twice", text));
    }
    if commanded.n_arcs > 0 {
        let text = format!("{} arcs of the job are followed as straight lines.", commanded.n_arcs);
        record.warnings.push(Warning::new("report.arcs", text));
    }
    record
}

/// Deflections that the lumen's triangles are counted for, mm.
const DEFLECTIONS_MM: [f64; 4] = [0.1, 0.05, 0.02, 0.01];
/// Meshes that are likely to have more triangles are not made for a chart alone.
const MOST_TRIANGLES: f64 = 6e4;

/// How many triangles the lumen takes. That a mesh cannot be made is no reason to have no report; it is told.
fn triangles(solid: &Solid, warnings: &mut Vec<Warning>, task: &Task<'_>) -> Result<Vec<Triangles>, Error> {
    let counted = counted(solid, task);
    task.check()?;
    Ok(counted.unwrap_or_else(|error| {
        let text = format!("The lumen's triangles were not counted: {error}.");
        warnings.push(Warning { code: "report.no_triangles".into(), text });
        Vec::new()
    }))
}

/// From the coarsest deflection on; their number is about inversely proportional to it.
fn counted(solid: &Solid, task: &Task<'_>) -> Result<Vec<Triangles>, mesh::Error> {
    let count = |&deflection_mm: &f64| -> Result<Triangles, mesh::Error> {
        let mesh = mesh::tessellate(solid, &Tessellation::within(deflection_mm, SkinChoice::Lumen), task)?;
        Ok(Triangles { deflection_mm, n_triangles: mesh.triangles.len() })
    };
    let (coarsest, finer) = DEFLECTIONS_MM.split_first().expect("there are four");
    let first = count(coarsest)?;
    let likely = |deflection_mm: f64| first.n_triangles as f64 * coarsest / deflection_mm;
    let finer: Result<Vec<Triangles>, mesh::Error> =
        finer.par_iter().filter(|mm| likely(**mm) <= MOST_TRIANGLES).map(count).collect();
    Ok(std::iter::once(first).chain(finer?).collect())
}

impl Session<'_> {
    /// Compares image, contours, solid, toolpaths and deposition.
    ///
    /// # Errors
    /// [`Error`] where a stage before it was not done, or where the case cannot be written. A failed gate is none.
    pub fn report(&mut self) -> Result<(), Error> {
        match self.how_printed()? {
            // What was sent before it broke off is in the journal, and no stage of the case yet.
            How::BrokenOff => self.require(Stage::Slice)?,
            How::Simulated | How::ForReal => self.require(Stage::Print)?,
        }
        self.stage(Stage::Report, Self::write_report)?;
        self.report = Some(self.report_place()?);
        Ok(())
    }

    /// The same with a scan of the printed replica: a CT of it in air, any series that can be read. Without a scan, a report that
    /// has one is kept as long as nothing else has changed.
    ///
    /// # Errors
    /// As [`Session::report`]; [`Error::Scan`] where the scan cannot be read, [`Error::Report`] where it does not fit the model.
    pub fn report_with_scan(&mut self, path: &Path, choice: SeriesChoice) -> Result<(), Error> {
        let task = Task::new(&|_, _| {}, self.context.cancel.clone());
        let files = ct::reader::files_of(path, &task).map_err(Error::Scan)?;
        let number = match choice {
            SeriesChoice::Only => 0,
            SeriesChoice::ByNumber(number) => number,
        };
        let of_files = hash_of_source(&files, self.case.id()).map_err(Error::Scan)?;
        let hash = hash_of(&(of_files, number));
        self.scan = Some(NamedScan { path: path.to_owned(), choice, hash });
        self.report()
    }

    /// Files the report's document in the patient's study: an Encapsulated PDF in the folder `dir`, which is its place to be
    /// sent to an archive from. Who the patient is is read from the CT at `source` and kept nowhere else. Gives the file.
    ///
    /// # Errors
    /// [`Error::NotItsCt`] where the case was made from other files, [`Error`] where there is no report or a file cannot be
    /// read or written.
    pub fn file_report(&self, source: &Path, dir: &Path) -> Result<PathBuf, Error> {
        let report_dir = self.case.output(Stage::Report, REPORT_DIR)?;
        self.check_source(source)?;
        let task = Task::new(&|_, _| {}, self.context.cancel.clone());
        let [series, instance] = [uuid::Uuid::now_v7(), uuid::Uuid::now_v7()].map(|id| id.as_u128());
        let new = Instance::of_uuids(series, instance, jiff::Zoned::now().datetime());
        report::filing::file(&report_dir, source, dir, &new, &task).map_err(Error::Filing)
    }

    /// Refuses a CT that the case was not made from.
    ///
    /// # Errors
    /// [`Error::NotItsCt`], or where the CT cannot be read.
    pub fn check_source(&self, source: &Path) -> Result<(), Error> {
        let task = Task::new(&|_, _| {}, self.context.cancel.clone());
        let hash = hash_of_source(&ct::reader::files_of(source, &task)?, self.case.id())?;
        if self.case.made_from(Stage::Segment).and_then(|m| m.get("ct")) == Some(&hash) {
            return Ok(());
        }
        Err(Error::NotItsCt { ct: source.to_owned(), case: self.case.dir().to_owned() })
    }

    /// What the report is of; the time is that of the wall clock now.
    fn about(&self, is_simulated: bool) -> Result<About, Error> {
        let hash = |stage, file| self.case.output_hash(stage, file);
        let record = if is_simulated {
            hash(Stage::Print, RECORD_DIR)?
        } else {
            atomic::hash_of_path(&self.case.path(JOURNAL_FILE))?
        };
        Ok(About {
            case_id: Some(self.case.id().to_owned()),
            made_at: Some(jiff::Timestamp::now().strftime("%Y-%m-%dT%H:%M:%SZ").to_string()),
            profile: Some(self.profile()?.name),
            job_blake3: Some(hash(Stage::Slice, JOB_FILE)?),
            record_blake3: Some(record),
        })
    }

    pub(crate) fn report_made_from(&self) -> Result<MadeFrom, Error> {
        let hash = |stage, file| self.case.output_hash(stage, file);
        let mut made_from = MadeFrom::from([
            ("sections", hash(Stage::Segment, SECTIONS_FILE)?),
            ("solid", hash(Stage::Solid, SOLID_FILE)?),
            ("layers", hash(Stage::Slice, LAYERS_FILE)?),
            ("job", hash(Stage::Slice, JOB_FILE)?),
            ("gate", hash_of(&self.gate()?)),
        ]);
        if self.how_printed()? == How::Simulated {
            made_from.insert("record", hash(Stage::Print, RECORD_DIR)?);
        } else {
            // Another print of the same job is another replica, whatever its lines: its journal has the places and times of its own.
            made_from.insert("journal", atomic::hash_of_path(&self.case.path(JOURNAL_FILE))?);
            let print = self.case.path(PRINT_FILE);
            if print.exists() {
                made_from.insert("print", atomic::hash_of_path(&print)?);
            }
        }
        if self.has_image() {
            made_from.insert("volume", hash(Stage::Segment, VOLUME_FILE)?);
        }
        if let Some(scan) = &self.scan {
            made_from.insert("scan", scan.hash.clone());
        }
        Ok(made_from)
    }

    fn write_report(&mut self, task: &Task<'_>) -> Result<Made, Error> {
        let report = self.build_report(task)?;
        self.note(Stage::Report, "writing pages and pictures");
        let staging = self.case.staging()?;
        let dir = staging.path().join(REPORT_DIR);
        report::write(&report, &dir, task)?;
        atomic::write(&dir.join(HEADLINE_FILE), (report.headline().join("\n") + "\n").as_bytes())?;
        let summary = format!("{} planes: {}", report.plane_z_mm.len(), report.verdict.sentence());
        Ok(Made { staging, summary, warnings: self.scan_left_out().into_iter().collect() })
    }

    /// What to say of a report that had a scan of the replica, and has none now.
    fn scan_left_out(&self) -> Option<Warning> {
        let had_scan = self.case.made_from(Stage::Report).is_some_and(|m| m.contains_key("scan"));
        (had_scan && self.scan.is_none()).then(|| {
            let text = "The report before this one had a scan of the replica. What has changed since is not what was scanned, or is judged otherwise, and scans are not kept: the scan is left out. Give the replica's scan once more: lumenfab report CASE --scan PATH.";
            Warning::new("report.scan_left_out", text)
        })
    }

    fn build_report(&mut self, task: &Task<'_>) -> Result<Report, Error> {
        let mut warnings = self.earlier_warnings()?;
        warnings.extend(self.scan_left_out());
        let polarity = self.segmentation_note()?.map(|n| match n.polarity {
            Polarity::Dark => report::Polarity::Dark,
            Polarity::Bright | Polarity::Auto => report::Polarity::Bright,
        });
        let body = match self.settings().body {
            Body::WallMm(_) => BodyKind::Wall,
            Body::Cast => BodyKind::Cast,
        };
        let commanded = self.commanded()?;
        let record = self.record(commanded.as_ref())?;
        let job = self.job_amounts(commanded.as_ref())?;
        let about = self.about(commanded.is_none())?;
        let scan = self.read_scan(task)?;
        // Filled in first, borrowed together afterwards.
        self.volume()?;
        self.sections()?;
        self.built()?;
        self.sliced(task)?;
        let held = &self.held;
        let sliced = held.sliced.as_ref().expect("planned just now");
        let triangles = triangles(held.solid.as_ref().expect("read just now"), &mut warnings, task)?;
        let inputs = Inputs {
            image: held.volume.as_ref().zip(polarity).map(|(volume, polarity)| Image { volume, polarity }),
            sections: held.sections.as_ref().expect("read just now"),
            solid: held.solid.as_ref().expect("read just now"),
            body,
            layers: &sliced.layers,
            paths: &sliced.paths,
            record: &record,
            job_beads: None,
            scan: scan.as_ref(),
            warnings: &warnings,
            job,
            triangles: &triangles,
            gate: self.gate()?,
            about: &about,
        };
        let report = report::build(&inputs, task)?;
        if report.findings.iter().all(|f| f.stage != report::Stage::Deposition.name()) {
            return Ok(report);
        }
        // Whether it was the printer, or the job's file was not what was sliced, the file tells.
        let profile = self.profile()?;
        let job = commanded::whole(&self.case.output(Stage::Slice, JOB_FILE)?, &profile.firmware)?;
        let beads = beads_of(&job, &profile);
        Ok(report::build(&Inputs { job_beads: Some(&beads), ..inputs }, task)?)
    }

    /// The limits of the case's profile.
    fn gate(&self) -> Result<Gate, Error> {
        Ok(profile::load::whole_by_name(&self.settings().profile)?.gate)
    }

    /// The scan of the replica, where one was named.
    fn read_scan(&self, task: &Task<'_>) -> Result<Option<Volume>, Error> {
        let Some(NamedScan { path, choice, .. }) = &self.scan else { return Ok(None) };
        self.note(Stage::Report, "reading the scan of the replica");
        let loaded = ct::reader::load(path, choice, task).map_err(Error::Scan)?;
        Ok(Some(loaded.volume))
    }

    /// What the acknowledged lines of the job have told a real printer to lay; `None` where the simulated one has a record.
    fn commanded(&self) -> Result<Option<Commanded>, Error> {
        if self.how_printed()? == How::Simulated {
            return Ok(None);
        }
        let job = self.case.output(Stage::Slice, JOB_FILE)?;
        Ok(Some(commanded::read(&job, &self.profile()?.firmware)?))
    }

    fn record(&self, commanded: Option<&Commanded>) -> Result<Record, Error> {
        if let Some(commanded) = commanded {
            return Ok(record_of(commanded, &self.profile()?));
        }
        let path = self.case.output(Stage::Print, RECORD_DIR)?.join("beads.csv");
        let parsed = report::record::parse(&atomic::read_text(&path)?);
        Ok(parsed.map_err(|e| CaseError::Corrupt { path, problem: e.to_string() })?)
    }

    /// Time and filament, planned and recorded.
    fn job_amounts(&self, commanded: Option<&Commanded>) -> Result<Job, Error> {
        let planned = self.layers_document()?;
        if let Some(commanded) = commanded {
            return Ok(Job {
                planned_s: Some(planned.print_time_s),
                recorded_s: self.printed_s()?,
                planned_filament_mm: Some(planned.filament_mm),
                recorded_filament_mm: Some(commanded.filament_mm),
            });
        }
        let path = self.case.output(Stage::Print, RECORD_DIR)?.join("summary.json");
        let recorded: Option<PrintSummary> = if path.is_file() { Some(read_json(&path)?) } else { None };
        Ok(Job {
            planned_s: Some(planned.print_time_s),
            recorded_s: recorded.as_ref().map(|r| r.simulated_s),
            planned_filament_mm: Some(planned.filament_mm),
            recorded_filament_mm: recorded.map(|r| r.filament_mm),
        })
    }

    /// What the stages before the report found odd.
    fn earlier_warnings(&self) -> Result<Vec<Warning>, Error> {
        let mut warnings = self.segmentation_note()?.map(|n| n.warnings).unwrap_or_default();
        warnings.extend(self.solid_warnings()?);
        warnings.extend(self.layers_document()?.warnings);
        Ok(warnings)
    }

    fn report_place(&self) -> Result<ReportPlace, Error> {
        let dir = self.case.output(Stage::Report, REPORT_DIR)?;
        let report_json = dir.join("report.json");
        let figures: Figures = read_json(&report_json)?;
        let headline = atomic::read_text(&dir.join(HEADLINE_FILE))?;
        Ok(ReportPlace {
            index_html: dir.join("index.html"),
            report_json,
            passed: figures.verdict.passed,
            total: figures.total.overall,
            headline: headline.lines().map(str::to_owned).collect(),
        })
    }
}
