//! CT to contours: `sections.json`, `segmentation.json`, `volume.bin`, `contours.png`.

use super::{read_json, to_json};
use crate::app::atomic::{self, FileError};
use crate::app::case::{CONTOURS_FILE, CaseError, MadeFrom, PARAMETERS, Refused};
use crate::app::error::Error;
use crate::app::event::{Event, Stage};
use crate::app::session::{Made, Session, hash_of};
use crate::app::settings::{SegmentSettings, Source};
use crate::app::volume_file::{self, MARGIN_MM};
use crate::ct::{self, FrameOfReference, Loaded, SeriesChoice, SeriesMark, SeriesName, Volume, Warning};
use crate::geom::{Bounds2, Contour, Point3};
use crate::phantom;
use crate::progress::Task;
use crate::sections::{self, SectionStack};
use crate::segment::{self, Candidate, Polarity, Segmentation};
use crate::topology;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Contours per CT plane.
pub(crate) const SECTIONS_FILE: &str = CONTOURS_FILE;
/// The plane in which the region left the vessel, where it did.
const LEAK_FILE: &str = "leak.png";
/// How the lumen was found.
pub(crate) const SEGMENTATION_FILE: &str = "segmentation.json";
/// Contours over the CT, in some planes.
pub(super) const CONTOURS_PICTURE: &str = "contours.png";
/// The CT around the lumen.
pub(crate) const VOLUME_FILE: &str = "volume.bin";

/// `segmentation.json`: how the lumen was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct SegmentationNote {
    /// The window that was used; none for a ready segmentation.
    pub(crate) window_hu: Option<[f64; 2]>,
    /// Bright or dark.
    pub(crate) polarity: Polarity,
    /// Number of planes with lumen.
    pub(crate) n_planes: usize,
    /// Heights of the lowest and the highest of them, stack frame.
    pub(crate) z_mm: [f64; 2],
    /// Voxels of the lumen; none for a ready segmentation.
    pub(crate) n_voxels: Option<usize>,
    /// The series, where one of several was chosen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) series: Option<SeriesMark>,
    /// Where growing began, LPS.
    #[serde(default)]
    pub(crate) seed_mm: Vec<[f64; 3]>,
    /// The window of each of these planes.
    #[serde(default)]
    pub(crate) plane_windows_hu: Vec<[f64; 2]>,
    /// Vessels that were found by themselves, the one that was taken first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) candidates: Vec<Candidate>,
    /// What was odd about CT, lumen and contours.
    pub(crate) warnings: Vec<Warning>,
}

/// A CT that was read.
pub(super) struct Image {
    pub(super) volume: Volume,
    pub(super) warnings: Vec<Warning>,
    /// Which one of several series it is.
    pub(super) series: Option<SeriesMark>,
    /// What its coordinates refer to, to be compared with a segmentation's.
    pub(super) frame: FrameOfReference,
}

impl Session<'_> {
    /// Finds the contours of the lumen in the CT.
    ///
    /// # Errors
    /// [`Error`] where the CT cannot be read, the lumen not be found, or the case not be written.
    pub fn segment(&mut self) -> Result<(), Error> {
        self.spare_the_print(Stage::Segment)?;
        if matches!(self.settings().source, Source::Sections) {
            self.require_contours()?;
            return self.skip(Stage::Segment);
        }
        if matches!(self.settings().source, Source::Ready { .. }) {
            return self.take_ready();
        }
        self.stage(Stage::Segment, |session, task| {
            // That of another attempt.
            atomic::remove(&session.case.path(LEAK_FILE))?;
            session.find_contours(task)
        })?;
        if self.settings().segment.auto_seed {
            self.candidates = self.segmentation_note()?.map(|n| n.candidates).unwrap_or_default();
        }
        Ok(())
    }

    /// Refuses to go on without the ready contours that a case was started from.
    pub(crate) fn require_contours(&self) -> Result<(), Error> {
        match self.case.outdated(Stage::Segment, &MadeFrom::new())? {
            None => Ok(()),
            Some(_gone) => Err(CaseError::ContoursLost(self.case.dir().to_owned()).into()),
        }
    }

    /// Takes ready contours into a new case, or back into the one they were taken into before.
    ///
    /// # Errors
    /// [`Error`] where the file cannot be read or is no document of contours, or where the case has other ones.
    pub fn import_sections(&mut self, file: &Path) -> Result<(), Error> {
        let text = atomic::read_text(file).map_err(Error::InputFile)?;
        let made_from = MadeFrom::from([("sections", atomic::hash_of_bytes(text.as_bytes()))]);
        let known = self.case.made_from(Stage::Segment).and_then(|m| m.get("sections"));
        // Contours that no solid came about from may be corrected.
        let is_begun = self.case.made_from(Stage::Solid).is_some();
        if is_begun && known.is_some_and(|known| *known != made_from["sections"]) {
            return Err(CaseError::OtherSource(self.case.dir().to_owned()).into());
        }
        let Some(because_of) = self.case.outdated(Stage::Segment, &made_from)? else {
            return self.skip(Stage::Segment);
        };
        self.redo(Stage::Segment, &made_from, because_of, |session, _| {
            let bad = |source| Error::InputSections { path: file.to_owned(), source };
            let (stack, warnings) = topology::repaired(sections::format::from_json(&text).map_err(bad)?);
            let staging = session.case.staging()?;
            staging.write(SECTIONS_FILE, sections::format::to_json(&stack).map_err(bad)?.as_bytes())?;
            let summary = format!("{} planes of ready contours", stack.planes.len());
            session.held.sections = Some(stack);
            Ok(Made { staging, summary, warnings })
        })
    }

    pub(crate) fn segment_made_from(&self) -> Result<MadeFrom, Error> {
        if let Source::Ready { has_ct, label } = &self.settings().source {
            return self.ready_made_from(*has_ct, label.as_ref());
        }
        let image = match &self.settings().source {
            Source::Phantom(params) => ("phantom", hash_of(params)),
            _ => ("ct", self.ct_hash()?),
        };
        Ok(MadeFrom::from([image, (PARAMETERS, hash_of(&self.settings().segment))]))
    }

    /// The hash of the CT's files; that of the last time where nobody knows where they are.
    pub(crate) fn ct_hash(&self) -> Result<String, Error> {
        if let Some(known) = self.ct_hash.get() {
            return Ok(known.clone());
        }
        if let Some(ct) = self.ct.as_deref().filter(|ct| ct.exists()) {
            let task = Task::new(&|_, _| {}, self.context.cancel.clone());
            let hash = hash_of_source(&ct::reader::files_of(ct, &task)?, self.case.id())?;
            return Ok(self.ct_hash.get_or_init(|| hash).clone());
        }
        let before = self.case.made_from(Stage::Segment).and_then(|m| m.get("ct"));
        before.cloned().ok_or_else(|| Error::CtUnknown(self.case.dir().to_owned()))
    }

    fn find_contours(&mut self, task: &Task<'_>) -> Result<Made, Error> {
        let Image { volume, mut warnings, series, .. } = self.load_image(task)?;
        self.note(Stage::Segment, "finding the lumen");
        let settings = self.settings();
        let seeds_mm = seeds_mm(&settings.segment, &settings.source);
        let lumen = match find_lumen(&volume, &settings.segment, &seeds_mm, task) {
            Err(e) => return Err(self.refused(&volume, e)),
            Ok(lumen) => lumen,
        };
        let found = &lumen.segmentation;
        self.note(Stage::Segment, "drawing its contours");
        let contours = sections::Params { boundary: settings.segment.boundary, ..Default::default() };
        let extracted = sections::extract(&volume, found, &contours, task)?;
        warnings.extend(found.warnings.iter().chain(&extracted.warnings).cloned());
        // Kept under the number that was asked for, whatever number it has by now.
        let asked = self.settings().segment.series;
        let series = series.zip(asked).map(|(mark, number)| SeriesMark { number, ..mark });
        let planes = found.planes.clone();
        let note = note(&volume, lumen, series, warnings);
        let kept = volume_file::crop(&volume, lumen_bounds(&extracted.stack), planes);
        self.keep(extracted.stack, kept, note)
    }

    /// Keeps the case with a picture of a region that is no vessel's or leaves it, as far as that can be written.
    fn refused(&mut self, volume: &Volume, leak: segment::Error) -> Error {
        let picture = segment::picture::of_error(volume, &leak);
        match picture.map(|bytes| self.keep_leak(&bytes)) {
            Some(Ok(())) => Error::Leaked { leak, picture: self.case.path(LEAK_FILE) },
            Some(Err(e)) => {
                let text = format!("no picture of the region could be kept: {e}");
                let warning = Warning::new("app.leak_not_kept", text);
                (self.context.events)(Event::Warned { stage: Stage::Segment, warning });
                leak.into()
            }
            None => leak.into(),
        }
    }

    fn keep_leak(&mut self, picture: &[u8]) -> Result<(), Error> {
        let made_from = self.segment_made_from()?;
        let refused = Refused { stage: Stage::Segment, made_from: &made_from };
        self.case.keep_refused(LEAK_FILE, picture, refused)?;
        self.remember_ct();
        Ok(())
    }

    fn load_image(&self, task: &Task<'_>) -> Result<Image, Error> {
        match &self.settings().source {
            Source::Phantom(params) => {
                self.note(Stage::Segment, "making a synthetic CT");
                let dir = tempfile::tempdir()
                    .map_err(atomic::failed("create a directory in", &std::env::temp_dir()))?;
                let series = dir.path().join("series");
                phantom::series::write(&series, params, task)?;
                self.load_ct(&series, task)
            }
            _ => {
                let unknown = || Error::CtUnknown(self.case.dir().to_owned());
                let ct = self.ct.as_deref().filter(|ct| ct.exists()).ok_or_else(unknown)?;
                self.load_ct(ct, task)
            }
        }
    }

    pub(super) fn load_ct(&self, path: &Path, task: &Task<'_>) -> Result<Image, Error> {
        self.note(Stage::Segment, "reading the CT");
        let series = self.chosen_series(path, task)?;
        let choice = series.as_ref().map_or(SeriesChoice::Only, |mark| SeriesChoice::ByNumber(mark.number));
        let SegmentSettings { allow_gaps, z_mm, .. } = self.settings().segment;
        let Loaded { volume, warnings, frame, .. } =
            ct::reader::load_with(path, &ct::reader::Options { choice, allow_gaps, z_mm }, task)?;
        Ok(Image { volume, warnings, series, frame })
    }

    /// The chosen series as it lies in the folder now: the one that the case was made from, whatever its number has become,
    /// where it was made from one of the number asked for.
    fn chosen_series(&self, path: &Path, task: &Task<'_>) -> Result<Option<SeriesMark>, Error> {
        let Some(number) = self.settings().segment.series else { return Ok(None) };
        let before = self.series_before().filter(|mark| mark.number == number);
        let name = before.map_or(SeriesName::Number(number), SeriesName::Mark);
        Ok(Some(ct::reader::find(path, &name, self.case.id(), task)?))
    }

    /// What an earlier segmentation kept of its series.
    fn series_before(&self) -> Option<SeriesMark> {
        let note: SegmentationNote = read_json(&self.case.path(SEGMENTATION_FILE)).ok()?;
        note.series
    }

    fn keep(&mut self, stack: SectionStack, kept: Volume, note: SegmentationNote) -> Result<Made, Error> {
        let unwritable = |source| Error::SectionsFile { path: self.case.path(SECTIONS_FILE), source };
        let document = sections::format::to_json(&stack).map_err(unwritable)?;
        let staging = self.case.staging()?;
        staging.write(SECTIONS_FILE, document.as_bytes())?;
        staging.write(SEGMENTATION_FILE, &to_json(&note))?;
        staging.write(VOLUME_FILE, &volume_file::to_bytes(&kept))?;
        if let Some(picture) = sections::picture::of_contours(&kept, &stack) {
            staging.write(CONTOURS_PICTURE, &picture)?;
        }
        let n_contours: usize = stack.planes.iter().map(|p| p.contours.len()).sum();
        let [lo, hi] = note.window_hu.unwrap_or_default();
        let summary =
            format!("{} planes, {n_contours} contours, window {lo:.0} to {hi:.0} HU", stack.planes.len());
        self.held.sections = Some(stack);
        self.held.volume = Some(kept);
        Ok(Made { staging, summary, warnings: note.warnings })
    }

    /// The contours, read unless this process has just made them.
    pub(crate) fn sections(&mut self) -> Result<&SectionStack, Error> {
        if self.held.sections.is_none() {
            let path = self.case.output(Stage::Segment, SECTIONS_FILE)?;
            let stack = sections::format::from_json(&atomic::read_text(&path)?);
            self.held.sections = Some(stack.map_err(|source| Error::SectionsFile { path, source })?);
        }
        Ok(self.held.sections.as_ref().expect("read just now"))
    }

    /// The kept part of the CT, read unless this process has just made it; `None` for a case without an image.
    pub(crate) fn volume(&mut self) -> Result<Option<&Volume>, Error> {
        if self.held.volume.is_none() && self.has_image() {
            let path = self.case.output(Stage::Segment, VOLUME_FILE)?;
            let bytes = std::fs::read(&path).map_err(atomic::failed("read", &path))?;
            let volume = volume_file::from_bytes(&bytes);
            self.held.volume = Some(volume.map_err(|source| Error::Volume { path, source })?);
        }
        Ok(self.held.volume.as_ref())
    }

    /// How the lumen was found; `None` for a case of ready contours.
    pub(crate) fn segmentation_note(&self) -> Result<Option<SegmentationNote>, Error> {
        if self.brings_contours() {
            return Ok(None);
        }
        let path = self.case.output(Stage::Segment, SEGMENTATION_FILE)?;
        Ok(Some(read_json(&path)?))
    }
}

/// The points that growing begins at; none where the vessel is to be found.
fn seeds_mm(settings: &SegmentSettings, source: &Source) -> Vec<[f64; 3]> {
    match source {
        Source::Phantom(params) if settings.seed_mm.is_empty() && !settings.auto_seed => {
            let seed = phantom::default_seed(params);
            vec![[seed.x, seed.y, seed.z]]
        }
        _ => settings.seed_mm.clone(),
    }
}

fn find_lumen(
    volume: &Volume,
    settings: &SegmentSettings,
    seeds_mm: &[[f64; 3]],
    task: &Task<'_>,
) -> Result<Lumen, segment::Error> {
    let params = segment::Params {
        seeds_patient_mm: seeds_mm.iter().map(|&p| Point3::from(p)).collect(),
        window_hu: settings.window_hu,
        polarity: settings.polarity,
        z_mm: settings.z_mm,
        corrections: settings.corrections.clone(),
        on_leak: settings.on_leak,
    };
    if !settings.auto_seed {
        let segmentation = segment::segment(volume, &params, task)?;
        return Ok(Lumen { segmentation, seed_mm: seeds_mm.to_vec(), candidates: Vec::new() });
    }
    let segment::Found { segmentation, mut candidates, chosen } =
        segment::find_unattended(volume, &params, task)?;
    // The one that was taken stands first.
    candidates[..=chosen].rotate_right(1);
    let seed_mm = candidates.first().map(|c| c.seed_mm).into_iter().collect();
    Ok(Lumen { segmentation, seed_mm, candidates })
}

/// The lumen, and what it was grown from.
struct Lumen {
    segmentation: Segmentation,
    seed_mm: Vec<[f64; 3]>,
    candidates: Vec<Candidate>,
}

fn note(
    volume: &Volume,
    lumen: Lumen,
    series: Option<SeriesMark>,
    warnings: Vec<Warning>,
) -> SegmentationNote {
    let found = lumen.segmentation;
    let z = &volume.plane_z_mm[found.planes.clone()];
    SegmentationNote {
        window_hu: Some(found.window_hu),
        polarity: found.polarity,
        n_planes: z.len(),
        z_mm: [z.first().copied().unwrap_or_default(), z.last().copied().unwrap_or_default()],
        n_voxels: Some(found.mask.n_voxels()),
        series,
        seed_mm: lumen.seed_mm,
        plane_windows_hu: found.plane_windows_hu,
        candidates: lumen.candidates,
        warnings,
    }
}

/// The box around all contours and what a report shows beside them.
pub(super) fn lumen_bounds(stack: &SectionStack) -> Bounds2 {
    let all = stack.planes.iter().flat_map(|p| &p.contours).filter_map(Contour::bounds);
    all.reduce(Bounds2::union).expect("the contours of a segmentation are not empty").grown(MARGIN_MM)
}

/// The hash of files of a source, whatever they are called and in whatever order they lie, under the case's own salt: it tells
/// whether they are the same again, and leads from no other case and no archive to this one.
///
/// # Errors
/// As for a CT that cannot be read: the path may hold a patient's name, as that of no other file does.
pub(super) fn hash_of_source(files: &[PathBuf], salt: &str) -> Result<String, ct::Error> {
    let hashes: Result<Vec<String>, FileError> = files.par_iter().map(|f| atomic::hash_of_path(f)).collect();
    let mut hashes = hashes.map_err(|e| ct::Error::Read { path: e.path, source: e.source })?;
    hashes.sort();
    Ok(atomic::hash_under(salt, hashes.concat().as_bytes()))
}
