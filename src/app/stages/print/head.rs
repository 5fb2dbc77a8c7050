//! The profile that a file of G-code was made for, against the one that it is to be printed with.

use crate::app::atomic;
use crate::app::error::Error;
use crate::app::settings::{DEFAULT_PROFILE, Fault, SettingError};
use crate::gcode;
use crate::profile::{self, Profile};
use std::borrow::Cow;
use std::io::Read;
use std::path::Path;

/// The head names its profile within its first few hundred bytes.
const HEAD_BYTES: u64 = 4096;

/// The name of the profile that a job was made for; none where another program wrote it.
pub(super) fn profile_of(job: &Path) -> Result<Option<String>, Error> {
    let mut head = Vec::new();
    std::fs::File::open(job)
        .and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head))
        .map_err(atomic::failed("read", job))?;
    Ok(gcode::profile_in_head(&String::from_utf8_lossy(&head)).map(str::to_owned))
}

/// The profile to print with: the one that was asked for, else the one that the job was made for.
pub(super) fn profile_wanted<'a>(
    asked: Option<&'a str>,
    made_for: Option<&'a str>,
) -> Result<Cow<'a, str>, SettingError> {
    match (asked, made_for) {
        (Some(name), _) => Ok(name.into()),
        (None, Some(name)) if !profile::builtin_names().contains(&name) => Err(SettingError {
            name: "profile".into(),
            fault: Fault {
                found: format!("none, and a job that was made for {name}, which is no built-in profile"),
                expected: "the file of that profile".into(),
            },
        }),
        (None, Some(name)) => Ok(name.into()),
        (None, None) => Ok(DEFAULT_PROFILE.into()),
    }
}

/// What the operator should know where a job goes to a printer of another profile.
pub(super) fn misfit(made_for: &str, profile: &Profile) -> Option<String> {
    (made_for != profile.name).then(|| {
        format!(
            "the job was made for the profile {made_for} and is printed with {}: heat, start and limits are those of {made_for}",
            profile.name
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_decides_where_no_profile_is_named() {
        assert_eq!(profile_wanted(None, Some("klipper")).unwrap(), "klipper");
        assert_eq!(profile_wanted(Some("marlin"), Some("klipper")).unwrap(), "marlin");
        assert_eq!(profile_wanted(None, None).unwrap(), DEFAULT_PROFILE);
        let refused = profile_wanted(None, Some("lab-2")).unwrap_err().to_string();
        assert!(
            refused.contains("made for lab-2") && refused.contains("the file of that profile"),
            "{refused}"
        );
    }

    #[test]
    fn another_profile_than_the_job_s_is_told() {
        let klipper = profile::builtin("klipper").unwrap();
        assert_eq!(misfit("klipper", &klipper), None);
        assert!(misfit("marlin", &klipper).unwrap().starts_with("the job was made for the profile marlin"));
    }
}
