//! Which program has a terminal open (IO: reads `/proc`, where there is one).

use std::fs;
use std::path::Path;

/// The program that has the terminal at `path` open, as `NAME, process ID`: the first that this user may see, but this one.
#[must_use]
pub fn of(path: &Path) -> Option<String> {
    let terminal = fs::canonicalize(path).ok()?;
    let own_id = std::process::id();
    let mut ids: Vec<u32> =
        fs::read_dir("/proc").ok()?.filter_map(id_of).filter(|id| *id != own_id).collect();
    ids.sort_unstable();
    let id = ids.into_iter().find(|id| has_open(*id, &terminal))?;
    let name = fs::read_to_string(format!("/proc/{id}/comm")).unwrap_or_default();
    Some(format!("{}, process {id}", name.trim()))
}

fn id_of(entry: std::io::Result<fs::DirEntry>) -> Option<u32> {
    entry.ok()?.file_name().to_str()?.parse().ok()
}

fn has_open(id: u32, terminal: &Path) -> bool {
    let Ok(entries) = fs::read_dir(format!("/proc/{id}/fd")) else { return false };
    entries.filter_map(Result::ok).any(|entry| fs::read_link(entry.path()).is_ok_and(|to| to == terminal))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Command, Stdio};

    #[test]
    fn a_program_is_named_by_what_it_has_open() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("held");
        fs::write(&path, "").unwrap();
        assert_eq!(of(&path), None);
        let held = fs::File::open(&path).unwrap();
        let mut child = Command::new("sleep").arg("60").stdin(Stdio::from(held)).spawn().unwrap();
        let told = of(&path);
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(told, Some(format!("sleep, process {}", child.id())));
    }
}
