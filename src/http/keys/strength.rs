//! Whether a key could be guessed: an estimate from its characters alone.
//!
//! Entropy of the characters' frequencies (Shannon) times those that do not merely continue the one before (`aaa`, `abc`, `321`): the same
//! for a random key as its real entropy or less, far less for what people type. Words are not looked up; length has to make up for them.

/// Fewest characters.
const MIN_CHARS: usize = 20;
/// Least estimated entropy, bits.
const MIN_BITS: f64 = 64.0;

/// The key is not good enough.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Weak {
    /// Too short.
    #[error("found a key of {found} characters, expected at least {MIN_CHARS}: let lumenfab make one")]
    Short {
        /// Characters.
        found: usize,
    },
    /// Too regular.
    #[error("found a key that is too regular and could be guessed: let lumenfab make one")]
    Regular,
    /// Not fit for a header.
    #[error("found a key with blanks or characters other than ASCII, expected letters, digits and signs")]
    Letters,
}

/// Checks a key.
///
/// # Errors
/// [`Weak`].
pub(super) fn check(key: &str) -> Result<(), Weak> {
    if !key.bytes().all(|byte| byte.is_ascii_graphic()) {
        return Err(Weak::Letters);
    }
    if key.len() < MIN_CHARS {
        return Err(Weak::Short { found: key.len() });
    }
    if bits(key.as_bytes()) < MIN_BITS { Err(Weak::Regular) } else { Ok(()) }
}

fn bits(key: &[u8]) -> f64 {
    let mut counts = [0_u32; 256];
    key.iter().for_each(|&byte| counts[usize::from(byte)] += 1);
    let total: f64 = counts.iter().copied().map(f64::from).sum();
    let of = |count: f64| -(count / total) * (count / total).log2();
    let per_char: f64 = counts.iter().filter(|&&count| count > 0).map(|&count| of(f64::from(count))).sum();
    let n_steps = key.windows(2).filter(|pair| pair[0].abs_diff(pair[1]) > 1).count();
    let n_steps = u32::try_from(n_steps).map_or(f64::MAX, f64::from);
    per_char * n_steps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_that_people_type_are_weak() {
        assert_eq!(check("secret"), Err(Weak::Short { found: 6 }));
        for regular in
            ["aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", "abcdefghijklmnopqrstuvwxyz", "abababababababababababab"]
        {
            assert_eq!(check(regular), Err(Weak::Regular), "{regular}");
        }
        assert_eq!(check("a key with blanks in it, long"), Err(Weak::Letters));
    }

    #[test]
    fn keys_of_32_random_hexadecimal_digits_are_strong() {
        assert_eq!(check("4D1F0E8B93A67C25B0D95E8137AC64F2"), Ok(()));
    }
}
