//! The windows that a region is grown in, plane by plane, and the planes that are clear enough for it.
//!
//! A given window holds in every plane. Else the levels of lumen and wall are found around the seeds (`levels`) and
//! followed along the vessel (`follow`); where the image is too noisy for them, it is smoothed first (`noise`).

use super::corrections::Rules;
use super::error::{Error, Place};
use super::grow::Voxel;
use super::levels::{self, Levels};
use super::noise::{self, Noise};
use super::{OnLeak, Params, Polarity, WindowSource, follow};
use crate::ct::{Volume, Warning};
use crate::progress::Task;
use std::ops::Range;

/// What the region is grown in.
pub(super) struct Chosen {
    /// Of every plane that is used.
    pub(super) windows_hu: Vec<[f64; 2]>,
    /// The planes that are used.
    pub(super) planes: Range<usize>,
    pub(super) source: WindowSource,
    /// What the region is grown in, where the image is too noisy.
    pub(super) smooth: Option<Smooth>,
    pub(super) warnings: Vec<Warning>,
}

/// A smoothed copy of the image.
pub(super) struct Smooth {
    pub(super) image: Volume,
    pub(super) sigma_mm: f64,
}

impl Smooth {
    fn of(volume: &Volume, sigma_mm: f64, task: &Task<'_>) -> Result<Option<Self>, Error> {
        if sigma_mm <= 0.0 {
            return Ok(None);
        }
        Ok(Some(Self { image: noise::smoothed(volume, sigma_mm, task)?, sigma_mm }))
    }
}

/// Chooses the windows: the one that was given, or those found along the vessel from the seeds.
///
/// # Errors
/// [`Error::OtherPolarity`], [`Error::NoContrast`], [`Error::TooNoisy`], cancellation.
pub(super) fn choose(
    volume: &Volume,
    params: &Params,
    rules: &Rules,
    asked: &Range<usize>,
    seeds: &[Voxel],
    task: &Task<'_>,
) -> Result<Chosen, Error> {
    let corrected = |k: usize, found: [f64; 2]| rules.window_hu(k).unwrap_or(found);
    check_polarity(volume, params, seeds)?;
    if let Some(window_hu) = params.window_hu {
        let windows_hu = asked.clone().map(|k| corrected(k, window_hu)).collect();
        return Ok(Chosen {
            windows_hu,
            planes: asked.clone(),
            source: WindowSource::Given,
            smooth: None,
            warnings: Vec::new(),
        });
    }
    let seed = params.seeds_patient_mm[0];
    let levels = levels::find(volume, seeds, params.polarity).ok_or_else(|| Error::NoContrast {
        seed: Place(seed),
        reach_mm: levels::REACH_MM,
        least_hu: levels::least_step_hu(volume, seeds),
    })?;
    let noise = Noise::around(volume, seeds, levels).looked_at_closer(volume, seeds[0], params.polarity);
    let mut warnings: Vec<Warning> = noise.check(seed)?.into_iter().collect();
    let smooth = Smooth::of(volume, noise.smoothing_mm(volume, seeds), task)?;
    let image = smooth.as_ref().map_or(volume, |s| &s.image);
    let followed = follow::follow(image, asked, rules, seeds, levels, task)?;
    // Where somebody attends, or has said which planes, the lumen is looked for in all of them.
    let may_shorten = params.on_leak == OnLeak::Cut && params.z_mm.is_none() && followed.clear.len() > 1;
    let planes = if may_shorten { rules.reaching(followed.clear.clone(), asked) } else { asked.clone() };
    let windows_hu =
        planes.clone().map(|k| corrected(k, followed.levels[k - asked.start].window_hu())).collect();
    warnings.extend(faded(volume, asked, &planes));
    Ok(Chosen { windows_hu, planes, source: WindowSource::Found(levels), smooth, warnings })
}

/// Refuses a polarity that the image around the seeds contradicts: no wall of the kind, and one of the other.
fn check_polarity(volume: &Volume, params: &Params, seeds: &[Voxel]) -> Result<(), Error> {
    let (asked, other, found) = match params.polarity {
        Polarity::Auto => return Ok(()),
        Polarity::Bright => ("bright", Polarity::Dark, "darker"),
        Polarity::Dark => ("dark", Polarity::Bright, "brighter"),
    };
    if levels::find(volume, seeds, params.polarity).is_some() {
        return Ok(());
    }
    levels::find(volume, seeds, other).map_or(Ok(()), |Levels { lumen_hu, wall_hu }| {
        Err(Error::OtherPolarity { seed: Place(params.seeds_patient_mm[0]), asked, found, lumen_hu, wall_hu })
    })
}

/// Says where the vessel has faded.
fn faded(volume: &Volume, asked: &Range<usize>, used: &Range<usize>) -> Option<Warning> {
    let z = |k: usize| format!("z {:.3} mm", volume.plane_z_mm[k]);
    let below = (used.start > asked.start).then(|| format!("below {}", z(used.start)));
    let above = (used.end < asked.end).then(|| format!("above {}", z(used.end - 1)));
    let places: Vec<String> = below.into_iter().chain(above).collect();
    let text = format!("the vessel's contrast fades {}: it ends there", places.join(" and "));
    (!places.is_empty()).then(|| Warning::new("segment.faded", text))
}
