//! Analytic vessels and their synthetic CT: the built-in case, with exact truth.
//!
//! [`Vessel`] is the shape: tubes along z joined by a smooth minimum, with exact contours at any height.
//! [`volume`] turns it into intensities as a scanner would see them; [`series::write`] into a DICOM series with
//! `truth.json` beside it. Patient frame (LPS), mm, HU; z towards the head.
//!
//! Method: each plane is the mean over its slab of the exact area coverage of the sections, blurred by a Gaussian point
//! spread function, with white Gaussian noise, rounded to whole HU as scanners store them.
//! The vessel lies in a cylinder of tissue with air around it.
//!
//! It deliberately knows no scanner physics (beam hardening, streaks, noise correlation, motion).
//!
//! Limits: the noise of a pixel depends on the seed, the plane and the pixel alone, so the same parameters give the same
//! volume on any number of threads. 46 planes of 512 x 512 take well under a second on two cores.
//!
//! ```
//! use lumenfab::phantom::{Kind, Vessel};
//! let vessel = Vessel::new(Kind::Carotid);
//! assert_eq!(vessel.region_at(30.0, 128).contours.len(), 1);
//! assert_eq!(vessel.region_at(110.0, 128).contours.len(), 2);
//! ```

mod anatomy;
mod contours;
mod image;
pub mod series;
mod spline;
mod vessel;

pub use image::{try_volume, volume};
pub use vessel::Vessel;

use crate::geom::Point3;
use crate::progress::Cancelled;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Which vessel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The reference case: a common carotid that splits into the internal artery, with its bulb, and the external.
    #[default]
    Carotid,
    /// One vessel into three at one level.
    Trifurcation,
    /// One vessel that splits in two, which join again (a fenestrated artery).
    Merge,
    /// The carotid with a 70 % stenosis (NASCET) of the internal artery.
    Stenosis,
    /// One bent tube with circular sections.
    Tube,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 5] = [Self::Carotid, Self::Trifurcation, Self::Merge, Self::Stenosis, Self::Tube];

    /// The name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Carotid => "carotid",
            Self::Trifurcation => "trifurcation",
            Self::Merge => "merge",
            Self::Stenosis => "stenosis",
            Self::Tube => "tube",
        }
    }
}

impl std::str::FromStr for Kind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        Self::ALL.into_iter().find(|k| k.name() == name).ok_or_else(|| Error::UnknownKind(name.to_owned()))
    }
}

/// How the lumen shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Contrast {
    /// Filled with contrast medium in a living neck: brighter than everything around it.
    #[default]
    Bright,
    /// A specimen, emptied and embedded: darker than its wall.
    Dark,
}

/// Intensities of what the image shows, HU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tissue {
    pub(crate) lumen_hu: f64,
    pub(crate) wall_hu: f64,
    pub(crate) around_hu: f64,
}

impl Contrast {
    pub(crate) const fn tissue(self) -> Tissue {
        match self {
            Self::Bright => Tissue { lumen_hu: 350.0, wall_hu: 50.0, around_hu: 50.0 },
            Self::Dark => Tissue { lumen_hu: -950.0, wall_hu: 80.0, around_hu: 0.0 },
        }
    }
}

/// What the synthetic scan is like.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Params {
    /// The vessel.
    pub kind: Kind,
    /// How its lumen shows.
    pub polarity: Contrast,
    /// Standard deviation of the noise of a pixel, HU, 0..=500.
    pub noise_hu: f64,
    /// Seed of the noise.
    pub seed: u64,
    /// Number of planes, 1..=2000.
    pub n_planes: usize,
    /// z of the first plane, mm. The vessels are drawn for 0..138.
    pub first_plane_z_mm: f64,
    /// Distance of neighbouring planes, mm, 0.05..=50.
    pub plane_step_mm: f64,
    /// Thickness of the slab that a plane averages over, mm, 0..=20.
    pub slab_mm: f64,
    /// Side of a pixel, mm, 0.02..=10.
    pub pixel_mm: f64,
    /// Pixels along each side of the image, 8..=2048. The image is centred on the vessel's middle.
    pub n_pixels: usize,
    /// Standard deviation of the point spread function in the plane, mm, 0..=5.
    pub psf_sigma_mm: f64,
    /// Thickness of the wall around a dark lumen, mm, 0..=5.
    pub wall_mm: f64,
    /// Tilt of the gantry about the x axis, degrees, -30..=30: the planes lean towards the head at the back while the
    /// table advances along z.
    pub tilt_deg: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            kind: Kind::Carotid,
            polarity: Contrast::Bright,
            noise_hu: 12.0,
            seed: 1,
            n_planes: 46,
            first_plane_z_mm: 0.0,
            plane_step_mm: 3.0,
            slab_mm: 2.0,
            pixel_mm: 0.2,
            n_pixels: 512,
            psf_sigma_mm: 0.35,
            wall_mm: 1.0,
            tilt_deg: 0.0,
        }
    }
}

impl Params {
    /// Middle of each plane's slab, mm.
    #[must_use]
    pub fn plane_z_mm(&self) -> Vec<f64> {
        (0..self.n_planes)
            .map(|k| to_nanometre(self.first_plane_z_mm + k as f64 * self.plane_step_mm))
            .collect()
    }

    /// Refuses an image that shows nothing of the vessel.
    ///
    /// # Errors
    /// [`Error::WithoutVessel`].
    pub fn check_vessel(&self) -> Result<(), Error> {
        if shows_vessel(self) {
            return Ok(());
        }
        let (from_mm, n) = (self.first_plane_z_mm, self.n_planes.saturating_sub(1));
        let to_mm = from_mm + n as f64 * self.plane_step_mm;
        Err(Error::WithoutVessel { from_mm, to_mm, side_mm: self.n_pixels as f64 * self.pixel_mm })
    }

    /// Checks every field against its range.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] naming the first field that is outside, [`Error::TooLarge`] for too many voxels.
    pub fn check(&self) -> Result<(), Error> {
        check("noise_hu", self.noise_hu, NOISE_HU)?;
        check("n_planes", self.n_planes as f64, [1.0, 2000.0])?;
        check("first_plane_z_mm", self.first_plane_z_mm, [-1e4, 1e4])?;
        check("plane_step_mm", self.plane_step_mm, PLANE_STEP_MM)?;
        check("slab_mm", self.slab_mm, SLAB_MM)?;
        check("pixel_mm", self.pixel_mm, PIXEL_MM)?;
        check("n_pixels", self.n_pixels as f64, [8.0, 2048.0])?;
        check("psf_sigma_mm", self.psf_sigma_mm, PSF_SIGMA_MM)?;
        check("wall_mm", self.wall_mm, [0.0, 5.0])?;
        check("tilt_deg", self.tilt_deg, TILT_DEG)?;
        // Each side is far below what would overflow.
        let n_voxels = self.n_pixels * self.n_pixels * self.n_planes;
        if n_voxels > MOST_VOXELS { Err(Error::TooLarge { n_voxels, most: MOST_VOXELS }) } else { Ok(()) }
    }
}

/// Most voxels of all planes together: 4 GiB of them in memory.
pub const MOST_VOXELS: usize = 1 << 30;
/// Least and largest noise of a pixel, HU.
pub const NOISE_HU: [f64; 2] = [0.0, 500.0];
/// Least and largest distance of planes, mm.
pub const PLANE_STEP_MM: [f64; 2] = [0.05, 50.0];
/// Least and largest thickness of the slab, mm.
pub const SLAB_MM: [f64; 2] = [0.0, 20.0];
/// Least and largest side of a pixel, mm.
pub const PIXEL_MM: [f64; 2] = [0.02, 10.0];
/// Least and largest standard deviation of the blur, mm.
pub const PSF_SIGMA_MM: [f64; 2] = [0.0, 5.0];
/// Least and largest tilt of the gantry, degrees: what scanners can do.
pub const TILT_DEG: [f64; 2] = [-30.0, 30.0];

fn check(field: &'static str, found: f64, [least, most]: [f64; 2]) -> Result<(), Error> {
    // Written so that NaN is refused too.
    if (least..=most).contains(&found) {
        Ok(())
    } else {
        Err(Error::OutOfRange { field, found, least, most })
    }
}

/// Rounds to a nanometre, so that a coordinate survives DICOM's decimal strings of 16 characters unchanged.
fn to_nanometre(mm: f64) -> f64 {
    (mm * 1e6).round() / 1e6
}

/// The heights that the vessels are drawn for, mm.
const DRAWN_Z_MM: [f64; 2] = [0.0, 138.0];

/// A point in the lumen of the phantom, on one of its planes: where segmentation may start. LPS, mm. It is the one at a quarter of
/// the planes, or the nearest to that in the image; where the image shows no vessel ([`shows_vessel`]), it lies outside.
#[must_use]
pub fn default_seed(params: &Params) -> Point3 {
    let quarter = params.n_planes / 4;
    let in_image = (0..params.n_planes).filter(|&k| lies_in_image(params, inner_point(params, k)));
    let nearest = in_image.min_by_key(|k| k.abs_diff(quarter));
    inner_point(params, nearest.unwrap_or(quarter))
}

/// Whether the image shows the vessel at all.
#[must_use]
pub fn shows_vessel(params: &Params) -> bool {
    lies_in_image(params, default_seed(params))
}

fn inner_point(params: &Params, plane: usize) -> Point3 {
    let z_mm = params.first_plane_z_mm + plane as f64 * params.plane_step_mm;
    Vessel::new(params.kind).inner_point_at(to_nanometre(z_mm))
}

fn lies_in_image(params: &Params, p: Point3) -> bool {
    let half_mm = 0.5 * params.n_pixels as f64 * params.pixel_mm;
    let from_middle = p.xy() - Vessel::new(params.kind).middle;
    from_middle.x.abs() < half_mm
        && from_middle.y.abs() < half_mm
        && (DRAWN_Z_MM[0]..=DRAWN_Z_MM[1]).contains(&p.z)
}

/// Why no phantom was made.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A parameter is outside its range.
    #[error("phantom parameter {field} is {found}: choose a value from {least} to {most}")]
    OutOfRange {
        /// The parameter's name.
        field: &'static str,
        /// Its value.
        found: f64,
        /// The least allowed.
        least: f64,
        /// The largest allowed.
        most: f64,
    },
    /// Each side is within its range, all together are too many.
    #[error(
        "the phantom would have {n_voxels} voxels, at most {most} are made: choose fewer pixels or planes"
    )]
    TooLarge {
        /// Voxels asked for.
        n_voxels: usize,
        /// Most that are made.
        most: usize,
    },
    /// The image lies beside the vessel, or ends before it.
    #[error(
        "the phantom's planes, from z {from_mm} to {to_mm} mm and {side_mm} mm wide, show nothing of the vessel, which lies between z 0 and 138 mm: choose more or larger pixels, or planes there"
    )]
    WithoutVessel {
        /// Height of the first plane, mm.
        from_mm: f64,
        /// Height of the last plane, mm.
        to_mm: f64,
        /// Width of the image, mm.
        side_mm: f64,
    },
    /// The system gives no memory for them.
    #[error("there is no memory for the {n_voxels} voxels of the phantom: choose fewer pixels or planes")]
    NoMemory {
        /// Voxels asked for.
        n_voxels: usize,
    },
    /// Tilted planes make no rectangular volume.
    #[error("planes tilted by {0} degrees are sheared against each other and make no volume: write a series")]
    Tilted(f64),
    /// There is no vessel of that name.
    #[error("there is no phantom named {0:?}: choose carotid, trifurcation, merge, stenosis or tube")]
    UnknownKind(String),
    /// The directory to write already holds something.
    #[error("{} exists and is not empty: name a new directory or empty this one", .0.display())]
    NotEmpty(PathBuf),
    /// Writing failed.
    #[error("cannot write {}: {source}: choose a place that can be written and has room", path.display())]
    Write {
        /// The file or directory.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The work was interrupted; nothing was left behind.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::OutOfRange { .. } => "phantom.out_of_range",
            Self::TooLarge { .. } => "phantom.too_large",
            Self::WithoutVessel { .. } => "phantom.without_vessel",
            Self::NoMemory { .. } => "phantom.no_memory",
            Self::Tilted(_) => "phantom.tilted",
            Self::UnknownKind(_) => "phantom.unknown_kind",
            Self::NotEmpty(_) => "phantom.not_empty",
            Self::Write { .. } => "phantom.write",
            Self::Cancelled(_) => "phantom.cancelled",
        }
    }
}

#[cfg(test)]
mod tests;
