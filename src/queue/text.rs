//! Short texts that people and profiles bring: bounded, of one line, never empty where they name something.

use super::Refusal;
use serde::{Deserialize, Serialize};

/// Longest name, characters.
const MAX_NAME: usize = 64;
/// Longest reason, characters.
const MAX_REASON: usize = 500;

/// The name of a person, an appliance, a printer or a rule.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Name(String);

impl Name {
    /// A name of 1 to 64 characters without line breaks and other control characters; blanks around it are taken off.
    ///
    /// # Errors
    /// [`Refusal::Text`].
    pub fn try_new(text: &str) -> Result<Self, Refusal> {
        let text = text.trim();
        let is_good =
            !text.is_empty() && text.chars().count() <= MAX_NAME && !text.chars().any(char::is_control);
        if is_good {
            Ok(Self(text.to_owned()))
        } else {
            Err(Refusal::Text { what: "a name", longest: MAX_NAME })
        }
    }

    /// As it was given.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Why something is done, in somebody's own words; may be empty where the change speaks for itself.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Reason(String);

impl Reason {
    /// A reason of at most 500 characters; line breaks and other control characters become blanks.
    ///
    /// # Errors
    /// [`Refusal::Text`] where it is longer.
    pub fn try_new(text: &str) -> Result<Self, Refusal> {
        let text: String = text.trim().chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        let is_good = text.chars().count() <= MAX_REASON;
        if is_good { Ok(Self(text)) } else { Err(Refusal::Text { what: "a reason", longest: MAX_REASON }) }
    }

    /// Whether nothing is said.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// As it was given.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// A material by its trade name (`PLA`, `ABS`), the same however it is spelt.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Material(String);

impl Material {
    /// A material; letters become capitals.
    ///
    /// # Errors
    /// [`Refusal::Text`], as for a name.
    pub fn try_new(text: &str) -> Result<Self, Refusal> {
        Name::try_new(&text.to_uppercase()).map(|name| Self(name.0))
    }
}

macro_rules! a_text {
    ($kind:ident) => {
        impl TryFrom<String> for $kind {
            type Error = Refusal;

            fn try_from(text: String) -> Result<Self, Refusal> {
                Self::try_new(&text)
            }
        }

        impl From<$kind> for String {
            fn from(text: $kind) -> Self {
                text.0
            }
        }

        impl std::fmt::Display for $kind {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(&self.0)
            }
        }
    };
}

a_text!(Name);
a_text!(Reason);
a_text!(Material);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_line_of_something() {
        assert_eq!(Name::try_new("  Dr A. Meyer ").unwrap().as_str(), "Dr A. Meyer");
        for bad in ["", "  ", "a\nb", &"x".repeat(65)] {
            assert!(Name::try_new(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_reason_stays_on_one_line() {
        assert_eq!(Reason::try_new("a\nb").unwrap().as_str(), "a b");
        assert!(Reason::try_new(&"x".repeat(501)).is_err());
        assert!(Reason::try_new(" ").unwrap().is_empty());
    }

    #[test]
    fn materials_are_the_same_however_they_are_spelt() {
        assert_eq!(Material::try_new("pla ").unwrap(), Material::try_new("PLA").unwrap());
    }
}
