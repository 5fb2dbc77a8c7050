//! Cases and volumes in the state directory, under names of chance (IO).
//!
//! ```text
//! cases/ID/      case directories
//! volumes/ID     CTs to look at, as volume files; the last ones alone, and none from before the start
//! sources/       which CT a case is of
//! ```

use super::super::error::Problem;
use super::super::wire::case::{CaseEstimate, CaseView, Handle, Notice, StageView, VolumeView};
use super::{new_handle, nothing_of_this_name};
use crate::app::case::{self, Look};
use crate::app::errand::Hidden;
use crate::app::settings::CaseFile;
use crate::app::volume_file::Planes;
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Volumes that are kept.
const MOST_VOLUMES: usize = 2;
/// Pictures of planes that are shown.
const MOST_PICTURES: usize = 2000;
/// Documents and pictures of a case, by the names that they are asked for.
const FILES: [(&str, &str); 9] = [
    ("sections.json", "sections.json"),
    ("segmentation.json", "segmentation.json"),
    ("topology.json", "topology.json"),
    ("wall.json", "wall.json"),
    ("layers.json", "layers.json"),
    ("contours.png", "contours.png"),
    ("leak.png", "leak.png"),
    ("report.json", "report/report.json"),
    ("report.html", "report/index.html"),
];

#[derive(Debug)]
pub(super) struct Kept {
    state: PathBuf,
    /// The oldest first.
    volumes: Mutex<VecDeque<Handle>>,
}

impl Kept {
    pub(super) fn open(state: &Path) -> io::Result<Self> {
        let kept = Self { state: state.to_owned(), volumes: Mutex::default() };
        if kept.volumes_dir().exists() {
            fs::remove_dir_all(kept.volumes_dir())?;
        }
        for dir in [kept.volumes_dir(), kept.cases_dir()] {
            DirBuilder::new().recursive(true).mode(0o700).create(dir)?;
        }
        Ok(kept)
    }

    fn volumes_dir(&self) -> PathBuf {
        self.state.join("volumes")
    }

    fn cases_dir(&self) -> PathBuf {
        self.state.join("cases")
    }

    /// Where it is kept which CT a case is of.
    pub(super) fn sources(&self) -> PathBuf {
        self.state.join("sources")
    }

    /// A name for a new case, and where it will be.
    pub(super) fn new_case(&self) -> Result<(Handle, PathBuf), Problem> {
        let case = new_handle()?;
        let dir = self.cases_dir().join(case.to_string());
        Ok((case, dir))
    }

    /// Where a case is. Blocks.
    pub(super) fn case(&self, case: &Handle) -> Result<PathBuf, Problem> {
        let dir = self.cases_dir().join(case.to_string());
        if case::is_case(&dir) { Ok(dir) } else { Err(nothing_of_this_name()) }
    }

    /// Removes a case. Blocks.
    pub(super) fn remove(&self, case: &Handle) -> Result<(), Problem> {
        fs::remove_dir_all(self.case(case)?).map_err(|e| Problem::inside("removing a case", &e.kind()))
    }

    /// All cases. Blocks.
    pub(super) fn cases(&self) -> Result<Vec<CaseView>, Problem> {
        let failed = |e: io::Error| Problem::inside("listing the cases", &e.kind());
        let mut cases = Vec::new();
        for entry in fs::read_dir(self.cases_dir()).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            let handle: Option<Handle> = name.to_str().and_then(|name| name.parse().ok());
            cases.extend(handle.filter(|handle| self.case(handle).is_ok()));
        }
        cases.sort();
        cases.iter().map(|handle| self.view(handle)).collect()
    }

    /// A case as it is now. Blocks.
    pub(super) fn view(&self, handle: &Handle) -> Result<CaseView, Problem> {
        let dir = self.case(handle)?;
        let hidden = Hidden::new([(&*dir, "the case")]);
        let Look { parameters, told } = case::look(&dir)
            .map_err(|error| Problem::conflict("http.case_damaged", hidden.text(&error.to_string())))?;
        let notice = |w: &crate::ct::Warning| Notice { code: w.code.to_string(), text: hidden.text(&w.text) };
        let stage = |(stage, told): &(_, case::Told)| StageView {
            stage: *stage,
            summary: hidden.text(&told.summary),
            warnings: told.warnings.iter().map(notice).collect(),
        };
        Ok(CaseView {
            id: handle.clone(),
            parameters: said(&parameters),
            stages: told.iter().map(stage).collect(),
            estimate: estimate(&dir),
            files: files(&dir),
            task: None,
        })
    }

    /// A document or picture of a case, with its type. Blocks.
    pub(super) fn file(&self, case: &Handle, name: &str) -> Result<(Vec<u8>, &'static str), Problem> {
        let dir = self.case(case)?;
        let path = path_of(name).map(|path| dir.join(path)).ok_or_else(nothing_of_this_name)?;
        let kind = match path.extension().and_then(|ending| ending.to_str()) {
            Some("png") => "image/png",
            Some("html") => "text/html; charset=utf-8",
            _ => "application/json",
        };
        match fs::read(path) {
            Ok(bytes) => Ok((bytes, kind)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Err(nothing_of_this_name()),
            Err(e) => Err(Problem::inside("reading a file of a case", &e.kind())),
        }
    }

    /// A name for a new volume, and where it will be.
    pub(super) fn new_volume(&self) -> Result<(Handle, PathBuf), Problem> {
        let volume = new_handle()?;
        let path = self.volumes_dir().join(volume.to_string());
        Ok((volume, path))
    }

    /// A volume is there: the oldest ones go. Blocks.
    pub(super) fn keep_volume(&self, volume: &Handle) -> Result<VolumeView, Problem> {
        let view = self.volume(volume)?;
        let mut volumes = self.volumes.lock().unwrap_or_else(PoisonError::into_inner);
        volumes.push_back(volume.clone());
        while volumes.len() > MOST_VOLUMES {
            if let Some(oldest) = volumes.pop_front()
                && let Err(error) = fs::remove_file(self.volumes_dir().join(oldest.to_string()))
            {
                tracing::warn!("cases: a volume cannot be removed: {}", error.kind());
            }
        }
        Ok(view)
    }

    /// Its geometry. Blocks.
    pub(super) fn volume(&self, volume: &Handle) -> Result<VolumeView, Problem> {
        let planes = self.planes(volume)?;
        let (origin_xy_mm, patient_from_stack) = planes.place();
        Ok(VolumeView {
            id: volume.clone(),
            dims: planes.dims(),
            pixel_spacing_xy_mm: planes.pixel_spacing_xy_mm(),
            plane_z_mm: planes.plane_z_mm().to_vec(),
            origin_xy_mm,
            patient_from_stack: json!(patient_from_stack),
        })
    }

    /// Its planes. Blocks.
    pub(super) fn planes(&self, volume: &Handle) -> Result<Planes, Problem> {
        match Planes::open(&self.volumes_dir().join(volume.to_string())) {
            Ok(planes) => Ok(planes),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Err(nothing_of_this_name()),
            Err(e) => Err(Problem::inside("reading a volume", &e.kind())),
        }
    }
}

/// Parameters as they may be said again.
fn said(parameters: &CaseFile) -> Value {
    let shown =
        CaseFile { format: None, id: None, source: None, label: None, port: None, ..parameters.clone() };
    let mut value = json!(shown);
    if let Some(keys) = value.as_object_mut() {
        keys.retain(|_, value| !value.is_null());
    }
    value
}

/// Where something lies that is asked for by this name.
fn path_of(name: &str) -> Option<String> {
    let known = FILES.iter().find(|(known, _)| *known == name).map(|(_, path)| (*path).to_owned());
    let is_plane = || {
        let number = name.strip_prefix("plane-")?.strip_suffix(".png")?;
        let is_number = number.len() == 3 && number.bytes().all(|b| b.is_ascii_digit());
        is_number.then(|| format!("planes/{name}"))
    };
    known.or_else(is_plane)
}

fn files(dir: &Path) -> Vec<String> {
    let known = FILES.iter().filter(|(_, path)| dir.join(path).is_file()).map(|(name, _)| (*name).to_owned());
    let pictures = fs::read_dir(dir.join("planes")).into_iter().flatten().take(MOST_PICTURES);
    let pictures = pictures.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut pictures: Vec<_> = pictures.filter(|name| path_of(name).is_some()).collect();
    pictures.sort();
    known.chain(pictures).collect()
}

fn estimate(dir: &Path) -> Option<CaseEstimate> {
    #[derive(Deserialize)]
    struct Sliced {
        print_time_s: f64,
        filament_mm: f64,
        filament_g: f64,
    }
    let text = fs::read_to_string(dir.join("layers.json")).ok()?;
    let Sliced { print_time_s, filament_mm, filament_g } = serde_json::from_str(&text).ok()?;
    Some(CaseEstimate { print_time_s, filament_mm, filament_g })
}
