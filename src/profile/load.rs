//! Profiles from files (IO).

use super::{Error, Profile, builtin, parse};
use std::path::Path;

/// A profile file larger than this is none.
const MAX_PROFILE_BYTES: u64 = 1 << 20;

/// Reads a profile from a TOML file; it may inherit from a built-in one.
///
/// # Errors
/// The file cannot be read, is not TOML, or says something that no printer can be.
pub fn from_file(path: &Path) -> Result<Profile, Error> {
    let file = path.display().to_string();
    let unreadable = |source| Error::Read { path: path.to_owned(), source };
    let n_bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if n_bytes > MAX_PROFILE_BYTES {
        let message = format!("{n_bytes} bytes are too many for a profile");
        return Err(Error::Syntax { file, line: 1, message });
    }
    let text = std::fs::read_to_string(path).map_err(unreadable)?;
    parse(&text, &file)
}

/// A profile by what the operator wrote: the name of a built-in one, or the path of a `.toml` file.
///
/// # Errors
/// As [`builtin`] and [`from_file`].
pub fn by_name(name_or_path: &str) -> Result<Profile, Error> {
    if is_file(name_or_path) { from_file(Path::new(name_or_path)) } else { builtin(name_or_path) }
}

fn is_file(name_or_path: &str) -> bool {
    let path = Path::new(name_or_path);
    path.extension().is_some_and(|e| e == "toml") || path.components().count() > 1
}
