//! What tells images of one place from each other: reconstruction, phase, acquisition. Pure.
//!
//! A DICOM series may hold several stacks (phases of the heart, echoes, kernels, projections of the original). Two kinds of
//! attribute tell them apart. Some make another image of the same place whenever they differ ([`Trait::KINDS`]). Others
//! may just as well differ from plane to plane of one stack (a step-and-shoot scanner counts one acquisition a plane): they
//! count only where images lie at the same places ([`Trait::RUNS`]).
//!
//! Values are compared as they stand and shown only in a form that cannot hold anything else: numbers, and codes from a list.

/// An attribute that tells stacks of one series apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trait {
    ImageType,
    Kernel,
    EchoTime,
    TubeVoltage,
    TemporalPosition,
    CardiacPhase,
    TriggerTime,
    Acquisition,
    AcquisitionTime,
}

impl Trait {
    /// Number of attributes.
    pub(super) const COUNT: usize = 9;
    /// Make another image of the same place whenever they differ.
    pub(super) const KINDS: [Self; 4] = [Self::ImageType, Self::Kernel, Self::EchoTime, Self::TubeVoltage];
    /// May differ from plane to plane of one stack too; the surest first.
    pub(super) const RUNS: [Self; 5] = [
        Self::TemporalPosition,
        Self::CardiacPhase,
        Self::TriggerTime,
        Self::Acquisition,
        Self::AcquisitionTime,
    ];

    /// A value for the operator; `None` where nothing of it may be shown.
    pub(super) fn shown(self, value: &str) -> Option<String> {
        // Beyond what the attribute can mean, a number may be a date or that of a record.
        let number = |most: f64| {
            let value = value.parse::<f64>().ok().filter(|v| v.abs() <= most)?;
            // Three decimals tell any two phases apart.
            Some((value * 1000.0).round() / 1000.0)
        };
        match self {
            Self::ImageType => image_type(value),
            Self::Kernel => is_kernel(value).then(|| format!("kernel {value}")),
            Self::EchoTime => number(1000.0).map(|v| format!("echo time {v} ms")),
            Self::TubeVoltage => number(1000.0).map(|v| format!("{v} kV")),
            Self::TemporalPosition => number(9999.0).map(|v| format!("temporal position {v}")),
            Self::CardiacPhase => number(999.0).map(|v| format!("cardiac phase {v} %")),
            Self::TriggerTime => number(9999.0).map(|v| format!("trigger time {v} ms")),
            Self::Acquisition => number(999.0).map(|v| format!("acquisition {v}")),
            // The time of day of an examination is the patient's.
            Self::AcquisitionTime => None,
        }
    }
}

/// The values of one image.
#[derive(Clone, PartialEq, Eq, Default)]
pub(super) struct Traits(pub(super) [String; Trait::COUNT]);

impl std::fmt::Debug for Traits {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Traits(..)")
    }
}

impl Traits {
    /// The value of one attribute, empty where the image has none.
    pub(super) fn get(&self, of: Trait) -> &str {
        &self.0[of as usize]
    }

    /// The values that make another image of the same place.
    pub(super) fn kind(&self) -> [&str; 4] {
        Trait::KINDS.map(|t| self.get(t))
    }

    /// What the image was made by, where it is no reconstruction of the scan.
    pub(super) fn origin(&self) -> Origin {
        let words: Vec<&str> = self.get(Trait::ImageType).split('\\').map(str::trim).collect();
        let has = |names: &[&str]| words.iter().any(|w| names.contains(w));
        if has(&["MIP", "MINIP", "MAX_IP", "MIN_IP", "PROJECTION IMAGE", "VOLUME_RENDER", "VRT", "SSD"]) {
            Origin::Projection
        } else if has(&["MPR", "CSA MPR", "REFORMATTED", "CPR", "CURVED"]) {
            Origin::Reformatted
        } else {
            Origin::Scan
        }
    }
}

/// What an image was made by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Origin {
    /// Reconstruction of the scan.
    Scan,
    /// Computed from another series' planes.
    Reformatted,
    /// Maxima, minima or a rendering over a thickness.
    Projection,
}

/// Words of image types that may be shown.
const IMAGE_TYPES: [&str; 20] = [
    "ORIGINAL",
    "DERIVED",
    "PRIMARY",
    "SECONDARY",
    "AXIAL",
    "MPR",
    "CSA MPR",
    "REFORMATTED",
    "MIP",
    "MINIP",
    "MAX_IP",
    "MIN_IP",
    "MEAN",
    "VOLUME",
    "PROJECTION IMAGE",
    "AVERAGE",
    "SUBTRACTION",
    "M",
    "P",
    "NORM",
];

fn image_type(value: &str) -> Option<String> {
    let known: Vec<&str> = value.split('\\').map(str::trim).filter(|w| IMAGE_TYPES.contains(w)).collect();
    (!known.is_empty()).then(|| known.join(" ").to_lowercase())
}

/// Kernels by name, of the makers that use words.
const KERNELS: [&str; 10] =
    ["STANDARD", "SOFT", "DETAIL", "BONE", "BONEPLUS", "LUNG", "EDGE", "CHEST", "ULTRA", "HD"];

/// What kernels begin with, of the makers that number them.
const KERNEL_LETTERS: [&str; 26] = [
    "B", "D", "H", "I", "J", "S", "T", "U", "Bf", "Bl", "Bp", "Br", "Bv", "FC", "FL", "Hc", "Hf", "Hn", "Hp",
    "Hr", "Hv", "Qr", "Sa", "Sd", "Tr", "Ur",
];

/// Whether a text is the name of a kernel and nothing else: a known word, or known letters, two digits and at most one letter.
fn is_kernel(text: &str) -> bool {
    let is_numbered = |letters: &&str| {
        let Some(rest) = text.strip_prefix(*letters) else { return false };
        let end = rest.trim_start_matches(|c: char| c.is_ascii_digit());
        rest.len() - end.len() == 2 && end.len() <= 1 && end.bytes().all(|b| b.is_ascii_lowercase())
    };
    KERNELS.contains(&text) || KERNEL_LETTERS.iter().any(is_numbered)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_can_be_nothing_else_is_shown() {
        assert_eq!(Trait::Kernel.shown("B30f").as_deref(), Some("kernel B30f"));
        assert_eq!(Trait::Kernel.shown("STANDARD").as_deref(), Some("kernel STANDARD"));
        for name in ["FC13", "Br40d", "Qr36", "J30s"] {
            assert!(Trait::Kernel.shown(name).is_some(), "{name}");
        }
        for name in ["DOE^JANE", "Doe", "19700101", "Jane12", "B3000", "JD123", "JD12", "B3", ""] {
            assert_eq!(Trait::Kernel.shown(name), None, "{name}");
        }
        assert_eq!(Trait::CardiacPhase.shown("70").as_deref(), Some("cardiac phase 70 %"));
        assert_eq!(Trait::Acquisition.shown("2").as_deref(), Some("acquisition 2"));
        for run in Trait::RUNS {
            for value in ["DOE", "19700101", "700101", "471100", "-19700101", "NaN", "inf"] {
                assert_eq!(run.shown(value), None, "{run:?} {value}");
            }
        }
        assert_eq!(Trait::EchoTime.shown("1.9700101").as_deref(), Some("echo time 1.97 ms"));
        assert_eq!(Trait::AcquisitionTime.shown("101112"), None);
        assert_eq!(
            Trait::ImageType.shown("DERIVED\\SECONDARY\\DOE^JANE").as_deref(),
            Some("derived secondary")
        );
    }

    #[test]
    fn images_that_are_no_reconstruction_of_the_scan_are_known() {
        let origin = |text: &str| {
            let mut traits = Traits::default();
            traits.0[Trait::ImageType as usize] = text.into();
            traits.origin()
        };
        assert_eq!(origin("ORIGINAL\\PRIMARY\\AXIAL"), Origin::Scan);
        assert_eq!(origin("DERIVED\\PRIMARY\\AXIAL"), Origin::Scan);
        assert_eq!(origin("DERIVED\\SECONDARY\\MPR"), Origin::Reformatted);
        assert_eq!(origin("DERIVED\\SECONDARY\\PROJECTION IMAGE\\MIP"), Origin::Projection);
    }
}
