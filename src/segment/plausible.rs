//! Whether a region may be a vessel's at all, by its size in the image.
//!
//! A seed beside the vessel grows over what surrounds it: soft tissue, a specimen's embedding. That leaks nowhere where
//! air bounds it, and nothing in it is larger than itself, so the guard lets it pass. But no vessel that is printed has
//! a section of [`MOST_SECTION_MM2`], and none fills a good part of an image whose border it may not touch.
//!
//! What it does not do: it does not tell one vessel from another, nor a vessel from a gut of its size.

use super::error::{Error, Place};
use super::mask::Mask;
use super::{Params, Polarity};
use crate::ct::{Volume, Warning};

/// Section of the widest aneurysm that is worth a print, 100 mm across.
const MOST_SECTION_MM2: f64 = 2500.0 * std::f64::consts::PI;
/// A region that covers this share of a plane is its background: a disc that touches all four borders covers 79 %.
const MOST_SHARE: f64 = 0.4;
/// From this share on it is worth a word; a vessel may reach it in a tightly cut image.
const LARGE_SHARE: f64 = 0.2;

/// The plane that a region covers most of.
struct Fullest {
    k: usize,
    share: f64,
    area_mm2: f64,
}

/// Refuses a region that is no vessel's, and warns of one that hardly is.
///
/// # Errors
/// [`Error::Background`].
pub(super) fn check(volume: &Volume, mask: &Mask, params: &Params) -> Result<Option<Warning>, Error> {
    let Some(Fullest { k, share, area_mm2 }) = fullest(volume, mask) else { return Ok(None) };
    let (seed, z_mm, share_percent) =
        (Place(params.seeds_patient_mm[0]), volume.plane_z_mm[k], 100.0 * share);
    if share > MOST_SHARE || area_mm2 > MOST_SECTION_MM2 {
        return Err(Error::Background {
            seed,
            plane: k,
            z_mm,
            share_percent,
            area_mm2,
            polarity_given: params.polarity != Polarity::Auto,
            at: above_seed(volume, seed, k),
            region: Box::new(Mask::from_fn(mask.columns(), mask.rows(), k..k + 1, |i, j, k| {
                mask.contains(i, j, k)
            })),
        });
    }
    let text = format!(
        "the region covers {share_percent:.0} % of the image in plane {k} (z {z_mm:.3} mm): make sure that seed {seed} lies inside the lumen and not beside it"
    );
    Ok((share > LARGE_SHARE).then(|| Warning::new("segment.large", text)))
}

/// The voxel of plane k at the seed's column and row.
fn above_seed(volume: &Volume, Place(seed): Place, k: usize) -> [usize; 3] {
    let in_stack = volume.patient_from_stack.inverse().apply(seed);
    let [i, j, _] = volume.voxel_from_stack(in_stack).unwrap_or([0, 0, k]);
    [i, j, k]
}

fn fullest(volume: &Volume, mask: &Mask) -> Option<Fullest> {
    let [nx, ny, _] = volume.dims;
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    let (k, n) =
        mask.planes().map(|k| (k, mask.n_voxels_of(k))).max_by_key(|&(k, n)| (n, std::cmp::Reverse(k)))?;
    Some(Fullest { k, share: n as f64 / (nx * ny) as f64, area_mm2: n as f64 * sx * sy })
}
