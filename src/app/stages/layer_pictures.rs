//! Pictures of a job's layers, to a folder that the operator names: `layer-0000.png`, `layer-0000.svg`, ...

use crate::app::atomic;
use crate::app::error::Error;
use crate::app::event::{Event, Stage};
use crate::app::session::Session;
use crate::preview;
use crate::progress::Task;
use crate::toolpath::Toolpaths;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

impl Session<'_> {
    /// Draws every layer of the job into a new or empty folder.
    ///
    /// # Errors
    /// [`Error`] where there is no job, where the folder holds something, or where it cannot be written.
    pub fn draw_layers(&mut self, dir: &Path) -> Result<(), Error> {
        check_folder(dir)?;
        self.require(Stage::Slice)?;
        let events = self.context.events;
        let sink = move |done, total| events(Event::Progress { stage: Stage::Slice, done, total });
        let task = Task::new(&sink, self.context.cancel.clone());
        self.note(Stage::Slice, "drawing the layers");
        write(dir, &self.sliced(&task)?.paths, &task)
    }
}

/// Refuses a folder that holds something: its pictures and those of another job would be mixed.
pub(super) fn check_folder(dir: &Path) -> Result<(), Error> {
    match std::fs::read_dir(dir).map(|mut entries| entries.next().is_none()) {
        Ok(true) => Ok(()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        _ => Err(Error::PreviewFolder(dir.to_owned())),
    }
}

/// Writes the pictures; the folder appears with all of them or not at all.
pub(super) fn write(dir: &Path, paths: &Toolpaths, task: &Task<'_>) -> Result<(), Error> {
    let parent = atomic::parent(dir);
    std::fs::create_dir_all(parent).map_err(atomic::failed("create", parent))?;
    let previews = preview::of_layers(paths, task)?;
    // The rights of any other new folder: a temporary one is private.
    let mode = std::fs::Permissions::from_mode(0o777);
    let fresh = tempfile::Builder::new().prefix(".lumenfab-").permissions(mode).tempdir_in(parent);
    let fresh = fresh.map_err(atomic::failed("create a directory in", parent))?;
    for preview in &previews {
        let stem = preview.file_stem();
        for (extension, bytes) in [("png", preview.png.as_slice()), ("svg", preview.svg.as_bytes())] {
            let path = fresh.path().join(format!("{stem}.{extension}"));
            std::fs::write(&path, bytes).map_err(atomic::failed("write", &path))?;
        }
        task.check()?;
    }
    std::fs::rename(fresh.path(), dir).map_err(atomic::failed("create", dir))?;
    // Renamed away: there is nothing left to be removed under the temporary name.
    let _path = fresh.keep();
    Ok(())
}
