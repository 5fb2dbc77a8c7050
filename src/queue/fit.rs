//! What a job needs against what a printer has loaded.
//!
//! Amounts are whole cubic millimetres and micrometres, so that they are equal or not. A reel of 1 kg holds about
//! 806 000 mm³ of PLA or 960 000 mm³ of ABS.

use super::text::{Material, Name};
use serde::{Deserialize, Serialize};

/// What a job asks of the printer that prints it; `None`: any will do.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Needs {
    /// The profile its G-code is made for.
    pub profile: Option<Name>,
    /// The material.
    pub material: Option<Material>,
    /// Diameter of the nozzle, µm.
    pub nozzle_um: Option<u32>,
}

/// How long a copy takes and what it uses up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Estimate {
    /// Print time, s.
    pub print_s: u32,
    /// Filament, mm³.
    pub filament_mm3: u64,
}

/// What a printer is fitted with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loaded {
    /// Its profile.
    pub profile: Name,
    /// The material.
    pub material: Material,
    /// Diameter of the nozzle, µm.
    pub nozzle_um: u32,
    /// Filament left on the spool, mm³; `None`: nobody keeps track.
    pub left_mm3: Option<u64>,
}

/// Why a job does not fit a printer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Misfit {
    /// Nobody has said what is loaded.
    #[error("it is not known what the printer has loaded")]
    NothingLoaded,
    /// Its G-code is for another printer.
    #[error("it is made for the profile {needed}, the printer's is {found}")]
    Profile {
        /// What the job needs.
        needed: Name,
        /// What there is.
        found: Name,
    },
    /// Another material is loaded.
    #[error("it needs {needed}, {found} is loaded")]
    Material {
        /// What the job needs.
        needed: Material,
        /// What there is.
        found: Material,
    },
    /// Another nozzle is fitted.
    #[error("it needs a nozzle of {} mm, one of {} mm is fitted", mm(*.needed_um), mm(*.found_um))]
    Nozzle {
        /// What the job needs, µm.
        needed_um: u32,
        /// What there is, µm.
        found_um: u32,
    },
    /// The spool will run out.
    #[error("it needs {} cm³ of filament, {} cm³ are left on the spool", cm3(*.needed_mm3), cm3(*.left_mm3))]
    Filament {
        /// What the job needs, mm³.
        needed_mm3: u64,
        /// What there is, mm³.
        left_mm3: u64,
    },
}

fn mm(micrometres: u32) -> String {
    format!("{}.{:02}", micrometres / 1000, micrometres % 1000 / 10)
}

fn cm3(cubic_mm: u64) -> String {
    format!("{}.{}", cubic_mm / 1000, cubic_mm % 1000 / 100)
}

impl Needs {
    /// Whether a printer is of the kind that the job needs; how much is on its spool does not matter here.
    ///
    /// # Errors
    /// [`Misfit`], the first in the order profile, material, nozzle.
    pub fn check_kind(&self, loaded: Option<&Loaded>) -> Result<(), Misfit> {
        let loaded = loaded.ok_or(Misfit::NothingLoaded)?;
        if let Some(needed) = self.profile.as_ref().filter(|&needed| *needed != loaded.profile) {
            return Err(Misfit::Profile { needed: needed.clone(), found: loaded.profile.clone() });
        }
        if let Some(needed) = self.material.as_ref().filter(|&needed| *needed != loaded.material) {
            return Err(Misfit::Material { needed: needed.clone(), found: loaded.material.clone() });
        }
        match self.nozzle_um {
            Some(needed_um) if needed_um != loaded.nozzle_um => {
                Err(Misfit::Nozzle { needed_um, found_um: loaded.nozzle_um })
            }
            _ => Ok(()),
        }
    }
}

/// Whether one copy of a job can be printed with what is loaded. A spool that nobody keeps track of is taken to be full enough.
///
/// # Errors
/// [`Misfit`].
pub fn check(needs: &Needs, estimate: &Estimate, loaded: Option<&Loaded>) -> Result<(), Misfit> {
    needs.check_kind(loaded)?;
    match loaded.and_then(|loaded| loaded.left_mm3) {
        Some(left_mm3) if left_mm3 < estimate.filament_mm3 => {
            Err(Misfit::Filament { needed_mm3: estimate.filament_mm3, left_mm3 })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loaded() -> Loaded {
        let (profile, material) = (Name::try_new("abs-enclosed").unwrap(), Material::try_new("ABS").unwrap());
        Loaded { profile, material, nozzle_um: 400, left_mm3: Some(20_000) }
    }

    fn said(needs: &Needs, filament_mm3: u64, loaded: Option<&Loaded>) -> String {
        let checked = check(needs, &Estimate { print_s: 1, filament_mm3 }, loaded);
        checked.map_or_else(|misfit| misfit.to_string(), |()| "fits".to_owned())
    }

    #[test]
    fn what_does_not_fit_is_said_in_plain_words() {
        let any = Needs::default();
        assert_eq!(said(&any, 20_000, Some(&loaded())), "fits");
        let short = said(&any, 20_100, Some(&loaded()));
        assert_eq!(short, "it needs 20.1 cm³ of filament, 20.0 cm³ are left on the spool");
        let pla = Needs { material: Material::try_new("pla").ok(), ..Needs::default() };
        assert_eq!(said(&pla, 1, Some(&loaded())), "it needs PLA, ABS is loaded");
        let fine = Needs { nozzle_um: Some(250), ..Needs::default() };
        let nozzle = said(&fine, 1, Some(&loaded()));
        assert_eq!(nozzle, "it needs a nozzle of 0.25 mm, one of 0.40 mm is fitted");
        let other = Needs { profile: Name::try_new("marlin").ok(), ..Needs::default() };
        let profile = said(&other, 1, Some(&loaded()));
        assert_eq!(profile, "it is made for the profile marlin, the printer's is abs-enclosed");
        assert_eq!(said(&any, 1, None), "it is not known what the printer has loaded");
    }

    #[test]
    fn a_spool_that_nobody_keeps_track_of_is_full_enough() {
        let untracked = Loaded { left_mm3: None, ..loaded() };
        assert_eq!(said(&Needs::default(), u64::MAX, Some(&untracked)), "fits");
    }
}
