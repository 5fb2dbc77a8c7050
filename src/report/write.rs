//! The report to files: `index.html`, `report.pdf`, `report.json` and its schema, `planes.csv`, `plane-000.png`, ...
//! The only IO of this room.

use super::{Error, Report, page, pdf, schema, table};
use crate::progress::Task;
use rayon::prelude::*;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Writes the report as the directory `dir`, which appears complete or not at all; an older one is replaced.
///
/// # Errors
/// [`Error::Io`] where the system refuses, [`Error::Page`], [`Error::Json`], [`Error::Cancelled`].
pub fn write(report: &Report, dir: &Path, task: &Task<'_>) -> Result<(), Error> {
    let fail = |source| Error::Io { dir: dir.to_owned(), source };
    let view = page::view(report)?;
    let (html, document) = rayon::join(|| page::render(&view), || pdf::document(report, &view));
    let (html, document, json) = (html?, document?, report.to_json()?);
    let parent = match dir.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(parent).map_err(fail)?;
    let fresh = tempfile::Builder::new().prefix(".report-").tempdir_in(parent).map_err(fail)?;
    let csv = table::csv(report);
    let texts = [
        ("report.json", json.as_bytes()),
        ("report.schema.json", schema::REPORT.as_bytes()),
        ("planes.csv", csv.as_bytes()),
        ("report.pdf", &document),
        ("index.html", html.as_bytes()),
    ];
    let n_files = report.pictures.len() as u64 + texts.len() as u64;
    let n_done = AtomicU64::new(0);
    // Side by side: each file waits for the disk.
    report.pictures.par_iter().try_for_each(|picture| {
        task.check()?;
        put(&fresh.path().join(picture.file_name()), &picture.png).map_err(fail)?;
        task.report(n_done.fetch_add(1, Ordering::Relaxed) + 1, n_files);
        Ok::<(), Error>(())
    })?;
    for (name, text) in texts {
        put(&fresh.path().join(name), text).map_err(fail)?;
    }
    replace(dir, parent, fresh).map_err(fail)?;
    task.report(n_files, n_files);
    Ok(())
}

fn put(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = std::fs::File::create(path)?;
    file.write_all(bytes)?;
    file.sync_data()
}

/// Puts the finished directory into the place of the old one, which is removed last.
fn replace(dir: &Path, parent: &Path, fresh: tempfile::TempDir) -> std::io::Result<()> {
    readable_by_others(fresh.path())?;
    let old = tempfile::Builder::new().prefix(".report-old-").tempdir_in(parent)?;
    let had_old = dir.symlink_metadata().is_ok();
    if had_old {
        std::fs::rename(dir, old.path().join("report"))?;
    }
    if let Err(error) = std::fs::rename(fresh.path(), dir) {
        if had_old {
            std::fs::rename(old.path().join("report"), dir)?;
        }
        return Err(error);
    }
    // Renamed away: there is nothing left to be removed under the temporary name.
    let _path = fresh.keep();
    old.close()
}

/// A temporary directory is private; the report has the rights that any new directory would have.
#[cfg(unix)]
fn readable_by_others(dir: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(dir, std::fs::Permissions::from_mode(0o755))
}

#[cfg(not(unix))]
fn readable_by_others(_dir: &Path) -> std::io::Result<()> {
    Ok(())
}
