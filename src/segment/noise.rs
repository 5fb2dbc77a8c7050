//! Noise of single pixels against the contrast of the vessel, and what is done about it.
//!
//! Where noise reaches half-way from the wall's level to the window's edge, a grown region has spurs, holes and bridges
//! that no later stage can tell from anatomy. Up to [`NOISY`] of the contrast that does not happen. Beyond, the region is grown
//! in a copy of the image, smoothed just enough within its planes; the boundary itself is measured in the image as it is. From
//! [`DOUBTFUL`] on the operator is told what that costs, beyond [`USELESS`] there is nothing to be trusted.
//!
//! Method: the noise and its grain follow from differences of pixels, one and three columns apart ([`super::levels`]): noise
//! that is white but for a Gaussian grain is as alike in neighbours as these tell.
//!
//! What it does not do: it smooths nothing where the operator gave the window, which is taken at its word.

use super::error::{Error, Place};
use super::grow::Voxel;
use super::{Levels, Polarity};
use crate::ct::{Volume, Voxels, Warning};
use crate::geom::{Point3, raster};
use crate::progress::{Cancelled, Task};

/// Up to this part of the contrast noise is left alone: one pixel in 30 000 crosses half the contrast.
const NOISY: f64 = 0.125;
/// What smoothing brings it down to, as part of the contrast.
const WANTED: f64 = 0.09;
/// From this part on the contours are uncertain.
const DOUBTFUL: f64 = 0.25;
/// Beyond this part nothing can be trusted.
const USELESS: f64 = 0.5;
/// Most smoothing, pixels, and as part of the lumen's radius at the seed: more would melt vessels with what lies beside them.
const MOST_SMOOTHING_PIXELS: f64 = 2.0;
const MOST_SMOOTHING_RADII: f64 = 0.12;
/// Less smoothing than this, pixels, changes nothing.
const LEAST_SMOOTHING_PIXELS: f64 = 0.3;
/// Levels are looked for anew in the seed's plane smoothed by this many pixels, where noise may have hidden them.
const CLOSER_PIXELS: f64 = 1.5;
/// But by no more than this, mm: a vessel of two millimetres would lose its contrast.
const MOST_CLOSER_MM: f64 = 0.8;
/// The grain of white noise: as much as pixels blur, pixels squared.
const LEAST_GRAIN2: f64 = 0.25 / std::f64::consts::PI;

/// How noisy a vessel is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Noise {
    /// Standard deviation of a pixel's noise, HU.
    hu: f64,
    /// The same as part of the contrast.
    share: f64,
    /// Variance of the Gaussian that white noise would have to be blurred by to look like it, pixels squared.
    grain2: f64,
    levels: Levels,
}

impl Noise {
    /// Around the seeds.
    pub(super) fn around(volume: &Volume, seeds: &[Voxel], levels: Levels) -> Self {
        let of = |noise: &dyn Fn(Voxel) -> f64| {
            super::levels::median(seeds.iter().map(|&s| noise(s)).collect()).unwrap_or(0.0)
        };
        let hu = of(&|s| super::levels::noise_hu(volume, s));
        let neighbours = of(&|s| super::levels::difference_hu(volume, s, 1));
        // Blurred by a Gaussian of variance g, white noise is correlated by exp(-1 / 4 g) one pixel on.
        let alike = 1.0 - (neighbours / hu.max(f64::MIN_POSITIVE)).powi(2);
        let grain2 = if alike > 0.0 { -0.25 / alike.ln() } else { 0.0 };
        let contrast = (levels.lumen_hu - levels.wall_hu).abs().max(f64::MIN_POSITIVE);
        Self { hu, share: hu / contrast, grain2: grain2.max(LEAST_GRAIN2), levels }
    }

    /// The same against the levels that show once noise is smoothed away, where there is much of it.
    pub(super) fn looked_at_closer(self, volume: &Volume, [i, j, k]: Voxel, polarity: Polarity) -> Self {
        let [sx, sy] = volume.pixel_spacing_xy_mm;
        if self.share <= NOISY || CLOSER_PIXELS * sx.max(sy) > MOST_CLOSER_MM {
            return self;
        }
        let plane = Volume {
            dims: [volume.dims[0], volume.dims[1], 1],
            hu: Voxels::new(&smoothed_plane(volume, k, [CLOSER_PIXELS; 2]), volume.dims[0] * volume.dims[1]),
            plane_z_mm: vec![volume.plane_z_mm[k]],
            ..*volume
        };
        super::levels::find(&plane, &[[i, j, 0]], polarity).map_or(self, |levels| {
            let contrast = (levels.lumen_hu - levels.wall_hu).abs().max(f64::MIN_POSITIVE);
            Self { share: self.hu / contrast, levels, ..self }
        })
    }

    /// Refuses an image that tells nothing, warns of one that tells little.
    pub(super) fn check(self, seed: Point3) -> Result<Option<Warning>, Error> {
        let (noise_hu, percent) = (self.hu, 100.0 * self.share);
        let Levels { lumen_hu, wall_hu } = self.levels;
        if self.share > USELESS {
            return Err(Error::TooNoisy { seed: Place(seed), noise_hu, percent, lumen_hu, wall_hu });
        }
        let text = format!(
            "noise of {noise_hu:.0} HU is {percent:.0} % of the contrast between lumen ({lumen_hu:.0} HU) and wall ({wall_hu:.0} HU): the contours are less certain than usual, and close branches may not be told apart"
        );
        Ok((self.share > DOUBTFUL).then(|| Warning::new("segment.noisy", text)))
    }

    /// How much has to be smoothed within the planes before a region is grown: standard deviation of a Gaussian, mm.
    pub(super) fn smoothing_mm(self, volume: &Volume, seeds: &[Voxel]) -> f64 {
        if self.share <= NOISY {
            return 0.0;
        }
        // Of grain g, smoothed by a variance of s, noise keeps g / (g + s) of its variance.
        let pixels = (self.grain2 * ((self.share / WANTED).powi(2) - 1.0)).sqrt();
        let [sx, sy] = volume.pixel_spacing_xy_mm;
        let radius_mm = super::levels::radius_mm(volume, seeds, self.levels).unwrap_or(0.0);
        let pixel_mm = (sx * sy).sqrt();
        let smoothing_mm =
            (pixels.min(MOST_SMOOTHING_PIXELS) * pixel_mm).min(MOST_SMOOTHING_RADII * radius_mm);
        if smoothing_mm < LEAST_SMOOTHING_PIXELS * pixel_mm { 0.0 } else { smoothing_mm }
    }
}

/// The volume with its planes smoothed.
///
/// # Errors
/// [`Cancelled`].
pub(super) fn smoothed(volume: &Volume, sigma_mm: f64, task: &Task<'_>) -> Result<Volume, Cancelled> {
    let sigma_pixels = volume.pixel_spacing_xy_mm.map(|p| sigma_mm / p);
    let (hu, _) = Voxels::by_plane(volume.dims[2], |k| {
        task.check()?;
        Ok::<_, Cancelled>((smoothed_plane(volume, k, sigma_pixels), ()))
    })?;
    Ok(Volume { hu, plane_z_mm: volume.plane_z_mm.clone(), ..*volume })
}

#[expect(clippy::cast_possible_truncation, reason = "intensities are single precision")]
fn smoothed_plane(volume: &Volume, k: usize, sigma_pixels: [f64; 2]) -> Vec<f32> {
    let values: Vec<f64> = volume.plane(k).iter().map(|&v| f64::from(v)).collect();
    let smooth = raster::blurred_within(&values, volume.dims[0], sigma_pixels);
    smooth.into_iter().map(|v| v as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::super::testing::Scene;
    use super::*;

    const LEVELS: Levels = Levels { lumen_hu: 300.0, wall_hu: 60.0 };

    const SEED: Voxel = [32, 28, 1];

    fn disk(noise_hu: f64) -> Volume {
        let scene = Scene { noise_hu, ..Scene::default() };
        scene.volume(|x, y, _| if (x - 8.0).hypot(y - 7.0) < 3.0 { 300.0 } else { 60.0 })
    }

    fn noise(noise_hu: f64) -> Noise {
        Noise::around(&disk(noise_hu), &[SEED], LEVELS)
    }

    #[test]
    fn noise_is_measured_across_edges() {
        // A vessel's edges within the window add to it, the more the less noise there is.
        for noise_hu in [25.0, 50.0, 150.0] {
            let found = noise(noise_hu).hu / noise_hu;
            assert!((0.9..1.25).contains(&found), "{found} times {noise_hu}");
        }
        assert!(noise(0.0).hu < 1.0);
    }

    #[test]
    fn noise_is_smoothed_warned_of_and_refused_as_it_grows() {
        let volume = disk(50.0);
        let smoothing_mm = |noise_hu: f64| noise(noise_hu).smoothing_mm(&volume, &[SEED]);
        let at = |noise_hu: f64| noise(noise_hu);
        let seed = Point3::new(8.0, 7.0, 1.0);
        assert!(smoothing_mm(20.0).abs() < 1e-12);
        // Of 0.21 of the contrast 0.09 are to be left: white noise, pixels of 0.25 mm.
        assert!((0.1..0.25).contains(&smoothing_mm(50.0)), "{}", smoothing_mm(50.0));
        assert!(at(50.0).check(seed).unwrap().is_none());
        assert!(at(80.0).check(seed).unwrap().unwrap().text.contains("HU is 3"));
        let refused = at(150.0).check(seed).unwrap_err().to_string();
        assert!(refused.contains("noise of 1") && refused.contains("--window-hu"), "{refused}");
    }

    #[test]
    fn smoothing_leaves_a_slope_and_gaps_as_they_are() {
        let mut volume = Scene { blur_mm: 1e-3, ..Scene::default() }.volume(|x, _, _| 10.0 * x);
        let mut hu: Vec<f32> = volume.hu.iter().collect();
        hu[30 * 64 + 30] = f32::NAN;
        volume.hu = Voxels::new(&hu, 64 * 56);
        let smooth = smoothed(&volume, 0.5, &Task::quiet()).unwrap();
        assert!(smooth.at(30, 30, 0).is_nan());
        assert!((smooth.at(40, 20, 2) - volume.at(40, 20, 2)).abs() < 1e-3);
        // The border is a mean of what there is, not of darkness beyond it.
        assert!(smooth.at(0, 0, 0) >= 0.0 && smooth.at(63, 55, 0) > volume.at(55, 55, 0));
    }
}
