//! Files that are there whole or not at all.
//!
//! Everything is written under a temporary name in the directory it is meant for, flushed to the disk and then
//! renamed; a reader, or whoever finds the directory after a power cut, sees the old file or the new one.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// A file or directory could not be read or written.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} {}: {}", path.display(), plain(source))]
pub struct FileError {
    /// What was tried: `read`, `write`, `create`, ...
    pub action: &'static str,
    /// The file or directory.
    pub path: PathBuf,
    /// What the operating system said.
    pub source: io::Error,
}

/// The system's words without the error number that means nothing to an operator.
fn plain(error: &io::Error) -> String {
    let text = error.to_string();
    text.split(" (os error").next().unwrap_or(&text).to_lowercase()
}

/// Turns an [`io::Error`] into one that says what was done to which file.
pub(crate) fn failed<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(io::Error) -> FileError + 'a {
    move |source| FileError { action, path: path.to_owned(), source }
}

/// Reads a file of text.
///
/// # Errors
/// [`FileError`] where it is missing, unreadable or no UTF-8.
pub fn read_text(path: &Path) -> Result<String, FileError> {
    fs::read_to_string(path).map_err(failed("read", path))
}

/// Writes a file whole or not at all; readable by its owner alone.
///
/// # Errors
/// [`FileError`] where the directory cannot be written or the disk is full; the old file is then untouched.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_with_mode(path, bytes, 0o600)
}

/// Writes a file that the operator named whole or not at all; its rights are those of every other new file (umask).
///
/// # Errors
/// As [`write()`].
pub fn write_export(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    Pending::write(path, bytes, EXPORT_MODE)?.publish()
}

/// Writes several files that the operator named, all of them or none: all are on the disk before the first one appears under its
/// name, and where one cannot take its name, those before it give theirs back to what was there.
///
/// # Errors
/// As [`write()`].
pub fn write_exports(files: &[(&Path, &[u8])]) -> Result<(), FileError> {
    let pending: Result<Vec<Pending<'_>>, FileError> =
        files.iter().map(|(path, bytes)| Pending::write(path, bytes, EXPORT_MODE)).collect();
    let mut replaced: Vec<Replaced<'_>> = Vec::new();
    let n = files.len();
    for (k, pending) in pending?.into_iter().enumerate() {
        // Behind the last one nothing can fail.
        let kept = if k + 1 < n { Replaced::keep(pending.path).map(Some) } else { Ok(None) };
        let published = kept.and_then(|kept| pending.publish().map(|()| kept));
        match published {
            Ok(kept) => replaced.extend(kept),
            Err(error) => {
                replaced.into_iter().rev().try_for_each(Replaced::put_back)?;
                return Err(error);
            }
        }
    }
    Ok(())
}

/// Whether a file could be written there, before any work is done for it.
///
/// # Errors
/// [`FileError`] where the path is a directory or its own directory cannot be written.
pub fn check_export(path: &Path) -> Result<(), FileError> {
    if path.is_dir() {
        return Err(failed("write", path)(io::ErrorKind::IsADirectory.into()));
    }
    if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        let text = "a device or a pipe is there, which a file would replace: choose another name";
        return Err(failed("write", path)(io::Error::other(text)));
    }
    let dir = parent(path);
    let probed = || -> io::Result<u32> {
        let probe = tempfile::Builder::new().prefix(".lumenfab-").tempfile_in(dir)?;
        let own = probe.as_file().metadata()?.uid();
        probe.close().map(|()| own)
    };
    let own = probed().map_err(failed("create a file in", dir))?;
    if let (Ok(folder), Ok(file)) = (fs::metadata(dir), fs::symlink_metadata(path))
        && !may_replace(own, folder.mode(), [folder.uid(), file.uid()])
    {
        let text = "the file there is another user's, and in this directory only he may replace it: choose another name";
        return Err(failed("write", path)(io::Error::other(text)));
    }
    Ok(())
}

/// Whether a user may replace a file in a directory that he can write: in one with the sticky bit only the owners of the
/// directory and of the file, and the superuser.
fn may_replace(user: u32, mode_of_dir: u32, owners: [u32; 2]) -> bool {
    mode_of_dir & 0o1000 == 0 || user == 0 || owners.contains(&user)
}

/// Rights of a file that the operator named, before the umask.
const EXPORT_MODE: u32 = 0o666;

fn write_with_mode(path: &Path, bytes: &[u8], mode: u32) -> Result<(), FileError> {
    Pending::write(path, bytes, mode)?.publish()
}

/// A file that is on the disk, but under another name; removed unless it is published.
struct Pending<'a> {
    path: &'a Path,
    file: tempfile::NamedTempFile,
}

impl<'a> Pending<'a> {
    fn write(path: &'a Path, bytes: &[u8], mode: u32) -> Result<Self, FileError> {
        let dir = parent(path);
        let mut file = tempfile::Builder::new()
            .prefix(".lumenfab-")
            .permissions(fs::Permissions::from_mode(mode))
            .tempfile_in(dir)
            .map_err(failed("create a file in", dir))?;
        file.write_all(bytes).and_then(|()| file.as_file().sync_all()).map_err(failed("write", path))?;
        Ok(Self { path, file })
    }

    fn publish(self) -> Result<(), FileError> {
        self.file.persist(self.path).map_err(|e| failed("write", self.path)(e.error))?;
        sync_dir(parent(self.path))
    }
}

/// What a file was before another one took its name; forgotten when dropped.
struct Replaced<'a> {
    path: &'a Path,
    /// A second name of the old file; none where there was no file.
    old: Option<tempfile::NamedTempFile<()>>,
}

impl<'a> Replaced<'a> {
    fn keep(path: &'a Path) -> Result<Self, FileError> {
        // Where the file system knows no second names, or the file is another user's, its bytes are kept.
        let second = |name: &Path| match fs::hard_link(path, name) {
            Err(e) if !matches!(e.kind(), io::ErrorKind::AlreadyExists | io::ErrorKind::NotFound) => {
                fs::copy(path, name).map(drop)
            }
            linked => linked,
        };
        match tempfile::Builder::new().prefix(".lumenfab-").make_in(parent(path), second) {
            Ok(old) => Ok(Self { path, old: Some(old) }),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(Self { path, old: None }),
            Err(e) => Err(failed("keep the old", path)(e)),
        }
    }

    fn put_back(self) -> Result<(), FileError> {
        match self.old {
            Some(old) => {
                old.persist(self.path).map(drop).map_err(|e| failed("put back", self.path)(e.error))?
            }
            None => remove(self.path)?,
        }
        sync_dir(parent(self.path))
    }
}

/// The directory a path lies in; the current one for a bare name.
#[must_use]
pub fn parent(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Flushes a directory's own entries to the disk, so that a rename in it survives a power cut.
pub(crate) fn sync_dir(dir: &Path) -> Result<(), FileError> {
    File::open(dir).and_then(|d| d.sync_all()).map_err(failed("flush", dir))
}

/// Flushes a file, or a directory with all that is in it, to the disk.
pub(crate) fn sync_tree(path: &Path) -> Result<(), FileError> {
    if !path.is_dir() {
        return File::open(path).and_then(|f| f.sync_all()).map_err(failed("flush", path));
    }
    entries(path)?.iter().try_for_each(|entry| sync_tree(entry))?;
    sync_dir(path)
}

/// What lies in a directory, sorted by name.
pub(crate) fn entries(dir: &Path) -> Result<Vec<PathBuf>, FileError> {
    let read = || fs::read_dir(dir)?.map(|e| e.map(|e| e.path())).collect::<io::Result<Vec<_>>>();
    let mut entries = read().map_err(failed("list", dir))?;
    entries.sort();
    Ok(entries)
}

/// Removes a file, or a directory with all that is in it; what is not there is no error.
pub(crate) fn remove(path: &Path) -> Result<(), FileError> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        other => other.map_err(failed("remove", path)),
    }
}

/// BLAKE3 of some bytes, in hexadecimal.
#[must_use]
pub fn hash_of_bytes(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// BLAKE3 of some bytes under a salt, in hexadecimal: can be compared only with what was made under the same one.
#[must_use]
pub fn hash_under(salt: &str, bytes: &[u8]) -> String {
    let key = blake3::derive_key("lumenfab source check 1", salt.as_bytes());
    blake3::keyed_hash(&key, bytes).to_hex().to_string()
}

/// BLAKE3 of a file, in hexadecimal; of a directory: of the names and hashes of all that is in it.
///
/// # Errors
/// [`FileError`] where something in it cannot be read.
pub fn hash_of_path(path: &Path) -> Result<String, FileError> {
    if path.is_dir() {
        let mut hasher = blake3::Hasher::new();
        for entry in entries(path)? {
            let name = entry.file_name().unwrap_or_default().to_string_lossy().into_owned();
            hasher.update(format!("{name}\0{}\n", hash_of_path(&entry)?).as_bytes());
        }
        return Ok(hasher.finalize().to_hex().to_string());
    }
    let hash = || -> io::Result<String> {
        let mut file = File::open(path)?;
        let mut hasher = blake3::Hasher::new();
        let mut buffer = vec![0; 1 << 20];
        loop {
            let n = file.read(&mut buffer)?;
            if n == 0 {
                return Ok(hasher.finalize().to_hex().to_string());
            }
            hasher.update(&buffer[..n]);
        }
    };
    hash().map_err(failed("read", path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_else_is_left() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.txt");
        write(&path, b"one").unwrap();
        write(&path, b"two").unwrap();
        assert_eq!(read_text(&path).unwrap(), "two");
        assert_eq!(entries(dir.path()).unwrap(), [path]);
    }

    #[test]
    fn what_is_exported_has_the_rights_of_any_new_file_and_the_rest_is_private() {
        let dir = tempfile::tempdir().unwrap();
        let [plain, exported, private] = ["a", "b", "c"].map(|n| dir.path().join(n));
        fs::write(&plain, "").unwrap();
        write_export(&exported, b"").unwrap();
        write(&private, b"").unwrap();
        let mode = |p: &Path| fs::metadata(p).unwrap().permissions().mode() & 0o777;
        assert_eq!((mode(&exported), mode(&private)), (mode(&plain), 0o600));
    }

    #[test]
    fn of_several_files_none_appears_where_one_cannot_be_written() {
        let dir = tempfile::tempdir().unwrap();
        let [good, bad] = [dir.path().join("a"), dir.path().join("none/b")];
        let error = write_exports(&[(&good, b"1"), (&bad, b"2")]).unwrap_err().to_string();
        assert!(error.contains("/none: no such file or directory"), "{error}");
        assert!(entries(dir.path()).unwrap().is_empty());
        write_exports(&[(&good, b"1")]).unwrap();
        assert_eq!(read_text(&good).unwrap(), "1");
    }

    #[test]
    fn files_that_have_their_names_already_give_them_back_where_a_later_one_fails() {
        let dir = tempfile::tempdir().unwrap();
        let [old, new, bad] = ["a", "b", "c"].map(|n| dir.path().join(n));
        write(&old, b"old").unwrap();
        // A file cannot take the name of a directory.
        fs::create_dir(&bad).unwrap();
        let error = write_exports(&[(&old, b"1"), (&new, b"2"), (&bad, b"3")]).unwrap_err().to_string();
        assert!(error.starts_with("cannot write ") && error.contains("/c: "), "{error}");
        assert_eq!(read_text(&old).unwrap(), "old");
        assert_eq!(entries(dir.path()).unwrap(), [old.clone(), bad.clone()]);
        fs::remove_dir(&bad).unwrap();
        write_exports(&[(&old, b"1"), (&new, b"2"), (&bad, b"3")]).unwrap();
        assert_eq!([&old, &new, &bad].map(|p| read_text(p).unwrap()), ["1", "2", "3"]);
        assert_eq!(entries(dir.path()).unwrap(), [old, new, bad]);
    }

    #[test]
    fn in_a_sticky_directory_only_owners_replace_a_file() {
        let (me, other) = (1000, 1001);
        assert!(may_replace(me, 0o40_777, [other, other]));
        assert!(!may_replace(me, 0o41_777, [0, other]));
        assert!(may_replace(me, 0o41_777, [0, me]) && may_replace(me, 0o41_777, [me, other]));
        assert!(may_replace(0, 0o41_777, [other, other]));
    }

    #[test]
    fn a_directory_is_no_place_for_a_file() {
        let dir = tempfile::tempdir().unwrap();
        for refused in [check_export(dir.path()), write_export(dir.path(), b"1")] {
            let message = refused.unwrap_err().to_string();
            assert!(
                message.starts_with("cannot write ") && message.ends_with(": is a directory"),
                "{message}"
            );
        }
        check_export(&dir.path().join("a")).unwrap();
        assert!(entries(dir.path()).unwrap().is_empty());
        let missing = check_export(&dir.path().join("none/a")).unwrap_err().to_string();
        assert!(missing.starts_with("cannot create a file in "), "{missing}");
    }

    #[test]
    fn a_failure_names_the_file_in_plain_words() {
        let error = read_text(Path::new("/nonexistent/file.txt")).unwrap_err();
        assert_eq!(error.to_string(), "cannot read /nonexistent/file.txt: no such file or directory");
    }

    #[test]
    fn a_directory_hash_follows_names_and_contents() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("a"), "1").unwrap();
        let before = hash_of_path(dir.path()).unwrap();
        fs::rename(dir.path().join("a"), dir.path().join("b")).unwrap();
        let renamed = hash_of_path(dir.path()).unwrap();
        fs::write(dir.path().join("b"), "2").unwrap();
        assert_ne!(before, renamed);
        assert_ne!(renamed, hash_of_path(dir.path()).unwrap());
        assert_eq!(hash_of_path(&dir.path().join("b")).unwrap(), hash_of_bytes(b"2"));
    }
}
