//! Where the CT of a case, or its ready segmentation, lies: kept in the user's state directory, not in the case.
//!
//! A path may hold a patient's name (`/ct/DOE_JANE/...`), and case directories are handed on. So a case has a
//! generated id, and `$XDG_STATE_HOME/lumenfab/sources/<id>.toml` (readable by its owner alone) knows its CT. On a machine
//! that does not know it, everything after the segmentation still works.

use super::atomic::{self, FileError, failed};
use super::seal::KeyFile;
use serde::{Deserialize, Serialize};
use std::fs::{DirBuilder, Permissions};
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::PathBuf;

/// What a case was made from.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Places {
    /// The CT.
    pub ct: Option<PathBuf>,
    /// The segmentation made elsewhere.
    pub segmentation: Option<PathBuf>,
}

/// The directory that knows where the CTs lie.
#[derive(Debug, Clone)]
pub struct Sources(Option<PathBuf>);

impl Sources {
    /// The one of this user: `$XDG_STATE_HOME`, else `~/.local/state`; where neither is set, nothing is remembered.
    #[must_use]
    pub fn of_user() -> Self {
        let absolute = |name| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
        let state = absolute("XDG_STATE_HOME").or_else(|| Some(absolute("HOME")?.join(".local/state")));
        Self(state.map(|s| s.join("lumenfab/sources")))
    }

    /// One in the given directory.
    #[must_use]
    pub const fn in_dir(dir: PathBuf) -> Self {
        Self(Some(dir))
    }

    /// Where the key lies that cases are sealed with.
    #[must_use]
    pub fn key_file(&self) -> Option<KeyFile> {
        self.0.as_ref().map(|dir| KeyFile::at(dir.with_file_name("signing.key")))
    }

    /// Remembers what a case was made from.
    ///
    /// # Errors
    /// [`FileError`] where the directory cannot be written.
    pub fn remember(&self, case_id: &str, places: &Places) -> Result<(), FileError> {
        let Some(dir) = &self.0 else { return Ok(()) };
        DirBuilder::new().recursive(true).mode(0o700).create(dir).map_err(failed("create", dir))?;
        // It may have been there before, open to all.
        std::fs::set_permissions(dir, Permissions::from_mode(0o700)).map_err(failed("close", dir))?;
        let absolute = |place: &Option<PathBuf>| {
            place.as_ref().map(|p| std::path::absolute(p).map_err(failed("find", p))).transpose()
        };
        let places = Places { ct: absolute(&places.ct)?, segmentation: absolute(&places.segmentation)? };
        let file = dir.join(format!("{case_id}.toml"));
        // A path that is no UTF-8 cannot be written down; the case then asks for --ct again.
        let Ok(text) = toml::to_string(&places) else { return Ok(()) };
        atomic::write(&file, text.as_bytes())
    }

    /// What a case was made from, where this user's machine knows it.
    #[must_use]
    pub fn recall(&self, case_id: &str) -> Places {
        let known = self.0.as_ref().map(|dir| dir.join(format!("{case_id}.toml")));
        let text = known.and_then(|file| atomic::read_text(&file).ok());
        text.and_then(|t| toml::from_str(&t).ok()).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_source_is_recalled_and_readable_by_its_owner_alone() {
        let dir = tempfile::tempdir().unwrap();
        let state = dir.path().join("lumenfab/sources");
        let sources = Sources::in_dir(state.clone());
        assert_eq!(sources.recall("a"), Places::default());
        std::fs::create_dir_all(&state).unwrap();
        std::fs::set_permissions(&state, Permissions::from_mode(0o755)).unwrap();
        let places = Places { ct: Some("/ct/DOE_JANE".into()), segmentation: None };
        sources.remember("a", &places).unwrap();
        assert_eq!(sources.recall("a"), places);
        let mode = |p: &Path| std::fs::metadata(p).unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&state), mode(&state.join("a.toml"))), (0o700, 0o600));
    }

    #[test]
    fn without_a_state_directory_nothing_is_remembered() {
        let none = Sources(None);
        none.remember("a", &Places { ct: Some("/ct".into()), segmentation: None }).unwrap();
        assert_eq!(none.recall("a"), Places::default());
    }
}
