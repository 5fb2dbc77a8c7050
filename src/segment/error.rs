//! Why there is no mask, in the operator's words: what was found, what was expected, what to do.

use super::corrections::Fault;
use super::guard::Beyond;
use super::mask::Mask;
use crate::ct::Warning;
use crate::geom::Point3;
use crate::progress::Cancelled;

/// Why there is no mask. Coordinates are patient LPS, mm, unless they say otherwise.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No seed at all.
    #[error("no seed was given: give a point inside the lumen with --seed-mm X,Y,Z (patient LPS, mm)")]
    NoSeed,
    /// The window is empty or not a number.
    #[error("window {lo} to {hi} HU is empty: give --window-hu LOW,HIGH with LOW below HIGH")]
    BadWindow {
        /// Lower end.
        lo: f64,
        /// Upper end.
        hi: f64,
    },
    /// The z range is empty or not a number.
    #[error("z range {lo} to {hi} mm is empty: give --z-mm LOW,HIGH with LOW below HIGH")]
    BadZRange {
        /// Lower end.
        lo: f64,
        /// Upper end.
        hi: f64,
    },
    /// The seed is not in the image.
    #[error(
        "seed {seed} lies outside the volume, whose box reaches from {lo} to {hi} mm (patient LPS): give a seed inside the lumen"
    )]
    SeedOutsideVolume {
        /// The seed.
        seed: Place,
        /// Smallest coordinates of the volume's box.
        lo: Place,
        /// Largest coordinates of the volume's box.
        hi: Place,
    },
    /// The seed's plane is not between the heights.
    #[error(
        "seed {seed} lies at z {z_mm:.3} mm along the stack, outside the z range {lo} to {hi} mm: move the seed or widen --z-mm"
    )]
    SeedOutsideZRange {
        /// The seed.
        seed: Place,
        /// Its height in the stack frame, mm.
        z_mm: f64,
        /// Lower end of the range, mm.
        lo: f64,
        /// Upper end of the range, mm.
        hi: f64,
    },
    /// The seed is not lumen by the window.
    #[error(
        "seed {seed} has {hu:.0} HU, outside the window {lo:.0} to {hi:.0} HU: put the seed inside the lumen or widen --window-hu"
    )]
    SeedOutsideWindow {
        /// The seed.
        seed: Place,
        /// Value of its voxel, HU.
        hu: f64,
        /// Lower end of the window.
        lo: f64,
        /// Upper end of the window.
        hi: f64,
    },
    /// A correction takes the seed away.
    #[error(
        "seed {seed} lies in what segment.block[{block}] keeps out: move the seed, or change or remove that block"
    )]
    SeedBlocked {
        /// The seed.
        seed: Place,
        /// Which block, counted from 1.
        block: usize,
    },
    /// The seed is beside the contour that was drawn for its plane.
    #[error(
        "seed {seed} lies outside the contour drawn for its plane (segment.contour, z {z_mm:.3} mm): move the seed inside it, or draw it around the seed"
    )]
    SeedOutsideDrawn {
        /// The seed.
        seed: Place,
        /// Height of the plane in the stack frame, mm.
        z_mm: f64,
    },
    /// What was grown is no vessel but what surrounds it.
    #[error(
        "the region grown from seed {seed} covers {area_mm2:.0} mm2, {share_percent:.0} % of the image, in plane {plane} (z {z_mm:.3} mm): that is no vessel but what surrounds it; {}",
        if *polarity_given { "put the seed inside the lumen" } else { "put the seed inside the lumen, or say --polarity bright or dark" }
    )]
    Background {
        /// The first seed.
        seed: Place,
        /// The plane in which it covers most, from 0.
        plane: usize,
        /// Its height in the stack frame, mm.
        z_mm: f64,
        /// Share of the image, percent.
        share_percent: f64,
        /// Its section there, mm2.
        area_mm2: f64,
        /// Whether it was said that the lumen is bright, or dark.
        polarity_given: bool,
        /// The voxel of that plane at the seed's column and row.
        at: [usize; 3],
        /// What the region fills in this plane.
        region: Box<Mask>,
    },
    /// No voxel of the planes lies in the window.
    #[error(
        "window {lo:.0} to {hi:.0} HU selects nothing: the planes hold values from {least:.0} to {most:.0} HU, change --window-hu"
    )]
    WindowSelectsNothing {
        /// Lower end of the window.
        lo: f64,
        /// Upper end of the window.
        hi: f64,
        /// Smallest value of the planes, HU.
        least: f64,
        /// Largest value of the planes, HU.
        most: f64,
    },
    /// No window was given and none could be found.
    #[error(
        "no wall was found within {reach_mm:.0} mm of seed {seed}, where one has to stand out by {least_hu:.0} HU, three times the noise: put the seed inside the lumen or give --window-hu LOW,HIGH"
    )]
    NoContrast {
        /// The first seed.
        seed: Place,
        /// How far was searched, mm.
        reach_mm: f64,
        /// Three times the noise, HU.
        least_hu: f64,
    },
    /// The lumen is not what it was said to be.
    #[error(
        "the lumen at seed {seed} ({lumen_hu:.0} HU) is {found} than what surrounds it ({wall_hu:.0} HU), although --polarity {asked} was given: leave --polarity out, or put the seed inside the lumen"
    )]
    OtherPolarity {
        /// The first seed.
        seed: Place,
        /// "bright" or "dark".
        asked: &'static str,
        /// "brighter" or "darker".
        found: &'static str,
        /// Level of the lumen, HU.
        lumen_hu: f64,
        /// Level of what surrounds it, HU.
        wall_hu: f64,
    },
    /// Noise hides the boundary.
    #[error(
        "noise of {noise_hu:.0} HU around seed {seed} is {percent:.0} % of the contrast between lumen ({lumen_hu:.0} HU) and wall ({wall_hu:.0} HU): no boundary can be trusted beyond 50 %; take a smoother reconstruction or thicker slices, or give --window-hu LOW,HIGH to go on all the same"
    )]
    TooNoisy {
        /// The first seed.
        seed: Place,
        /// Standard deviation of a pixel's noise, HU.
        noise_hu: f64,
        /// The same as part of the contrast, percent.
        percent: f64,
        /// Level of the lumen, HU.
        lumen_hu: f64,
        /// Level of the wall, HU.
        wall_hu: f64,
    },
    /// The region leaves the vessel, or runs out of the image.
    #[error("{0}")]
    Leaks(Box<Leak>),
    /// No vessel was found by itself.
    #[error(
        "no vessel was found by itself in {planes} planes: give a point inside the lumen with --seed-mm X,Y,Z (patient LPS, mm), or --polarity, --z-mm to look elsewhere"
    )]
    NoCandidate {
        /// How many planes were searched.
        planes: usize,
    },
    /// What was found by itself is too small to have a boundary.
    #[error(
        "what was found at {seed} is {across:.1} pixels wide, a vessel found by itself {least} at least: take an image of smaller pixels, or give its seed with --seed-mm all the same"
    )]
    TooFewPixels {
        /// A point in it.
        seed: Place,
        /// How many pixels it has across.
        across: f64,
        /// How many are wanted.
        least: f64,
    },
    /// Something is wrong, and there are corrections that hardly do what was meant.
    #[error("{fault}; of the corrections in the case file: {}", told(doubts))]
    Doubted {
        /// What is wrong.
        fault: Box<Self>,
        /// What is to be told of the corrections.
        doubts: Vec<Warning>,
    },
    /// A correction does not fit the image.
    #[error(transparent)]
    Correction(#[from] Fault),
    /// The z range misses every plane.
    #[error(
        "no plane lies between z {lo} and {hi} mm: the planes reach from {first:.3} to {last:.3} mm, change --z-mm"
    )]
    NoPlaneInRange {
        /// Lower end of the range, mm.
        lo: f64,
        /// Upper end of the range, mm.
        hi: f64,
        /// Lowest plane, mm.
        first: f64,
        /// Highest plane, mm.
        last: f64,
    },
    /// The z range holds one plane only.
    #[error("only {found} plane lies in the z range, at least 2 are needed: widen --z-mm")]
    TooFewPlanes {
        /// How many were found.
        found: usize,
    },
    /// The region does not leave the seed's plane.
    #[error(
        "the region covers only {found} plane (z {z_mm:.3} mm), at least 2 are needed: widen --window-hu or move the seed"
    )]
    RegionTooFlat {
        /// How many planes it covers.
        found: usize,
        /// Height of the lowest of them, mm.
        z_mm: f64,
    },
    /// Interrupted on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

fn told(doubts: &[Warning]) -> String {
    doubts.iter().map(|w| w.text.as_str()).collect::<Vec<_>>().join("; ")
}

impl Error {
    /// The same with what is to be told of the corrections, once; an interruption, and a correction that is wrong itself, stay alone.
    pub(super) fn beside(self, doubts: Vec<Warning>) -> Self {
        let is_alone = matches!(self, Self::Cancelled(_) | Self::Correction(_) | Self::Doubted { .. });
        if is_alone || doubts.is_empty() { self } else { Self::Doubted { fault: Box::new(self), doubts } }
    }

    /// What is wrong, whatever is to be told of the corrections.
    #[must_use]
    pub const fn fault(&self) -> &Self {
        match self {
            Self::Doubted { fault, .. } => fault,
            fault => fault,
        }
    }

    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::NoSeed => "segment.no_seed",
            Self::BadWindow { .. } => "segment.bad_window",
            Self::BadZRange { .. } => "segment.bad_z_range",
            Self::SeedOutsideVolume { .. } => "segment.seed_outside_volume",
            Self::SeedOutsideZRange { .. } => "segment.seed_outside_z_range",
            Self::SeedOutsideWindow { .. } => "segment.seed_outside_window",
            Self::SeedBlocked { .. } => "segment.seed_blocked",
            Self::SeedOutsideDrawn { .. } => "segment.seed_outside_drawn",
            Self::Background { .. } => "segment.background",
            Self::WindowSelectsNothing { .. } => "segment.window_selects_nothing",
            Self::NoContrast { .. } => "segment.no_contrast",
            Self::OtherPolarity { .. } => "segment.other_polarity",
            Self::TooNoisy { .. } => "segment.too_noisy",
            Self::Leaks(_) => "segment.leak",
            Self::NoCandidate { .. } => "segment.no_candidate",
            Self::TooFewPixels { .. } => "segment.too_few_pixels",
            Self::Doubted { fault, .. } => fault.code(),
            Self::Correction(_) => "segment.bad_correction",
            Self::NoPlaneInRange { .. } => "segment.no_plane_in_range",
            Self::TooFewPlanes { .. } => "segment.too_few_planes",
            Self::RegionTooFlat { .. } => "segment.region_too_flat",
            Self::Cancelled(_) => "segment.cancelled",
        }
    }

    /// Whether what was asked for is at fault, whatever the grey values are: seeds and heights that lie elsewhere, empty ranges,
    /// corrections that cannot be used.
    #[must_use]
    pub const fn is_choice(&self) -> bool {
        matches!(
            self.fault(),
            Self::NoSeed
                | Self::BadWindow { .. }
                | Self::BadZRange { .. }
                | Self::SeedOutsideVolume { .. }
                | Self::SeedOutsideZRange { .. }
                | Self::SeedBlocked { .. }
                | Self::SeedOutsideDrawn { .. }
                | Self::NoPlaneInRange { .. }
                | Self::TooFewPlanes { .. }
                | Self::Correction(_)
        )
    }
}

/// A point in patient coordinates (LPS, mm), printed with one micrometre's digits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place(pub Point3);

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "({:.3}, {:.3}, {:.3})", self.0.x, self.0.y, self.0.z)
    }
}

/// Where a region leaves the vessel.
#[derive(Debug, Clone, PartialEq)]
pub struct Leak {
    /// A voxel in the passage, or at the image's border: column, row, plane.
    pub voxel: [usize; 3],
    /// Height of its plane in the stack frame, mm.
    pub z_mm: f64,
    /// The same place for the operator.
    pub place: Place,
    /// The window of the plane, HU.
    pub window_hu: [f64; 2],
    /// What lies behind it, and how wide the passage to it is, mm; `None` where the region reaches the image's border.
    pub into: Option<(Beyond, f64)>,
    /// What the region fills in this plane.
    pub region: Mask,
    /// Blocks that there are; none of them holds the place.
    pub n_blocks: usize,
    /// Whether the vessel could end there: the seeds lie on its side.
    pub can_be_cut: bool,
    /// Half-way between the levels around the seeds, HU, where another window was given.
    pub better_window_hu: Option<[f64; 2]>,
}

impl std::fmt::Display for Leak {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { voxel: [_, _, plane], z_mm, place, window_hu: [lo, hi], .. } = self;
        write!(f, "the region leaks ")?;
        if self.into.is_none() {
            write!(f, "to the image border ")?;
        }
        write!(f, "in plane {plane} (z {z_mm:.3} mm) at {place} ")?;
        if let Some((into, neck_mm)) = &self.into {
            write!(f, "into {into}, through a passage {neck_mm:.1} mm wide ")?;
        }
        write!(f, "(window {lo:.0} to {hi:.0} HU): ")?;
        match self.better_window_hu {
            Some([lo, hi]) => write!(
                f,
                "try --window-hu={lo:.0},{hi:.0}, half-way between lumen and wall around the seed, or another --z-mm, "
            )?,
            None => write!(f, "give a narrower --window-hu or --z-mm, ")?,
        }
        if self.can_be_cut {
            write!(f, "end the vessel there with --on-leak cut, ")?;
        }
        match self.into {
            None => write!(f, "move the seed, or keep the region out of there with {}", self.block()),
            Some(_) => write!(
                f,
                "keep it out with {}, or, if it is part of the vessel, give a seed behind the passage as well",
                self.block()
            ),
        }
    }
}

impl Leak {
    /// The correction that would keep the region out.
    fn block(&self) -> String {
        match self.n_blocks {
            0 => "[[segment.block]] in the case file".into(),
            1 => {
                "a [[segment.block]] in the case file that holds this place (the one that is given does not)"
                    .into()
            }
            n => format!(
                "a [[segment.block]] in the case file that holds this place (none of the {n} given does)"
            ),
        }
    }
}
