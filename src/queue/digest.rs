//! BLAKE3 sums: of specifications, of jobs, of the records of the history.

use serde::{Deserialize, Serialize};

/// A BLAKE3 sum; 64 hexadecimal digits where it is written.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Digest([u8; 32]);

/// Something else was found where a sum was expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("found no sum, expected 64 hexadecimal digits")]
pub struct NoDigest;

impl Digest {
    /// Of some bytes.
    #[must_use]
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }

    /// Of some bytes behind another sum, for one purpose alone: sums of other purposes never are the same.
    #[must_use]
    pub(super) fn chained(purpose: &str, before: &Self, bytes: &[u8]) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key(purpose);
        hasher.update(&before.0).update(bytes);
        Self(*hasher.finalize().as_bytes())
    }

    /// What stands before the first of a chain.
    #[must_use]
    pub const fn zero() -> Self {
        Self([0; 32])
    }
}

impl From<[u8; 32]> for Digest {
    /// A sum that was reckoned piece by piece.
    fn from(sum: [u8; 32]) -> Self {
        Self(sum)
    }
}

impl TryFrom<String> for Digest {
    type Error = NoDigest;

    fn try_from(text: String) -> Result<Self, NoDigest> {
        blake3::Hash::from_hex(text).map(|hash| Self(*hash.as_bytes())).map_err(|_not_hex| NoDigest)
    }
}

impl From<Digest> for String {
    fn from(digest: Digest) -> Self {
        digest.to_string()
    }
}

impl std::fmt::Display for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&blake3::Hash::from_bytes(self.0).to_hex())
    }
}

impl std::fmt::Debug for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        std::fmt::Display::fmt(self, f)
    }
}
