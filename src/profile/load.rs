//! Profiles from files (IO).

use super::{Error, Profile, Whole, builtin_whole, parse_whole};
use std::path::Path;

/// A profile file larger than this is none.
const MAX_PROFILE_BYTES: u64 = 1 << 20;

/// Reads a profile from a TOML file; it may inherit from a built-in one.
///
/// # Errors
/// The file cannot be read, is not TOML, or says something that no printer can be.
pub fn from_file(path: &Path) -> Result<Profile, Error> {
    Ok(whole_from_file(path)?.profile)
}

fn whole_from_file(path: &Path) -> Result<Whole, Error> {
    let file = path.display().to_string();
    let unreadable = |source| Error::Read { path: path.to_owned(), source };
    let n_bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if n_bytes > MAX_PROFILE_BYTES {
        let message = format!("{n_bytes} bytes are too many for a profile");
        return Err(Error::Syntax { file, line: 1, message });
    }
    let text = std::fs::read_to_string(path).map_err(unreadable)?;
    parse_whole(&text, &file)
}

/// A profile by what the operator wrote: the name of a built-in one, or the path of a `.toml` file.
///
/// # Errors
/// As [`builtin`](super::builtin) and [`from_file`].
pub fn by_name(name_or_path: &str) -> Result<Profile, Error> {
    Ok(whole_by_name(name_or_path)?.profile)
}

/// A profile with its gate, named as for [`by_name`].
///
/// # Errors
/// As [`by_name`].
pub fn whole_by_name(name_or_path: &str) -> Result<Whole, Error> {
    if is_file(name_or_path) { whole_from_file(Path::new(name_or_path)) } else { builtin_whole(name_or_path) }
}

fn is_file(name_or_path: &str) -> bool {
    let path = Path::new(name_or_path);
    path.extension().is_some_and(|e| e == "toml") || path.components().count() > 1
}
