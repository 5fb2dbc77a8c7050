//! Where the real scans lie, for the tests that look at them.

use std::path::{Path, PathBuf};

/// A file or folder of the real cases; says why where there is none.
#[allow(dead_code, reason = "not every suite looks at them")]
pub(crate) fn real(below: &str) -> Option<PathBuf> {
    beside(&format!("data/real/{below}"))
}

/// A file or folder beside the sources that is no part of them; says why where there is none.
pub(crate) fn beside(below: &str) -> Option<PathBuf> {
    let root = std::env::var_os("LUMENFAB_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let path = root.join(below);
    if path.exists() {
        return Some(path);
    }
    // Who says where they are means them to be looked at.
    assert!(std::env::var_os("LUMENFAB_SHARED").is_none(), "there is no {}", path.display());
    eprintln!("skipped: there is no {}", path.display());
    None
}
