//! The region that is grown from the seeds, and what is done where it leaves the vessel.
//!
//! For a dark lumen the air around the specimen is kept out (`grow`). What was grown is looked at (`guard`); where it leaves
//! the vessel it is refused with the place named, or cut off there with a warning, as [`OnLeak`] says.

use super::error::{Error, Leak, Place};
use super::grow::{self, Grown, Slab, Voxel};
use super::guard::{self, Beyond, Site};
use super::levels::{self, Levels};
use super::{OnLeak, Params, Polarity, WindowSource};
use crate::ct::Warning;
use crate::geom::Point3;
use crate::progress::Task;

/// The seeds as voxels inside the window. With a found window a neighbour may stand in for a seed that noise
/// has thrown out of it; a given window is taken at its word.
pub(super) fn checked_seeds(
    slab: &Slab<'_>,
    params: &Params,
    seeds: &[Voxel],
    source: WindowSource,
) -> Result<Vec<Voxel>, Error> {
    let stand_in = |&seed: &Voxel| match source {
        WindowSource::Given => slab.selects(seed).then_some(seed),
        WindowSource::Found(_) => slab.selected_near(seed),
    };
    let checked = |(seed, &place): (&Voxel, &Point3)| {
        let [lo, hi] = slab.window_hu(seed[2]);
        stand_in(seed).ok_or_else(|| match slab.value_range_unless_selected() {
            Some([least, most]) => Error::WindowSelectsNothing { lo, hi, least, most },
            None => Error::SeedOutsideWindow { seed: Place(place), hu: slab.hu(*seed), lo, hi },
        })
    };
    seeds.iter().zip(&params.seeds_patient_mm).map(checked).collect()
}

/// What a region is grown from.
pub(super) struct Growth<'a> {
    pub(super) slab: &'a Slab<'a>,
    pub(super) params: &'a Params,
    pub(super) seeds: &'a [Voxel],
    pub(super) source: WindowSource,
}

/// A lumen that was looked at.
pub(super) struct Lumen {
    pub(super) grown: Grown,
    /// [`Polarity::Bright`] or [`Polarity::Dark`].
    pub(super) polarity: Polarity,
    pub(super) warnings: Vec<Warning>,
}

/// A grown region before it was looked at.
struct Raw {
    grown: Grown,
    /// The air around a specimen.
    air: Option<Grown>,
    polarity: Polarity,
    warnings: Vec<Warning>,
}

impl Growth<'_> {
    /// The region around the seeds, looked at.
    ///
    /// # Errors
    /// [`Error::Leaks`], cancellation.
    pub(super) fn lumen(&self, task: &Task<'_>) -> Result<Lumen, Error> {
        let mut raw = self.raw(task)?;
        task.report(2, 4);
        let (polarity, mut warnings) = (raw.polarity, std::mem::take(&mut raw.warnings));
        let (grown, cut) = self.without_leaks(raw, task)?;
        warnings.extend(cut);
        Ok(Lumen { grown, polarity, warnings })
    }

    /// The seeds, and all that was drawn.
    fn from(&self) -> Vec<Voxel> {
        [self.seeds, &self.slab.drawn()].concat()
    }

    fn raw(&self, task: &Task<'_>) -> Result<Raw, Error> {
        let (slab, from) = (self.slab, self.from());
        let known = match (self.params.polarity, self.source) {
            (Polarity::Auto, WindowSource::Found(levels)) => levels.polarity(),
            (polarity, _) => polarity,
        };
        let grown = grow::grow(slab, &from, None, task)?;
        let Some(leak) = grown.leak else {
            let polarity = if known == Polarity::Auto { grow::polarity_at_rim(slab, &grown) } else { known };
            return Ok(Raw { grown, air: None, polarity, warnings: Vec::new() });
        };
        match if known == Polarity::Auto { self.polarity_around_seeds() } else { known } {
            // For a bright lumen the way to the border is looked for.
            Polarity::Bright => {
                Ok(Raw { grown, air: None, polarity: Polarity::Bright, warnings: Vec::new() })
            }
            Polarity::Dark => self.within_air(&grown, leak, task),
            // What is neither brighter nor darker than anything is the background.
            Polarity::Auto => Err(self.border_error(&grown, leak)),
        }
    }

    fn polarity_around_seeds(&self) -> Polarity {
        levels::find(self.slab.volume, self.seeds, Polarity::Auto).map_or(Polarity::Auto, Levels::polarity)
    }

    /// A dark lumen without the air that it is open to.
    fn within_air(&self, leaky: &Grown, leak: Voxel, task: &Task<'_>) -> Result<Raw, Error> {
        let slab = self.slab;
        let air = grow::outside_air(slab, task)?;
        if self.seeds.iter().any(|&s| air.holds(slab, s)) {
            return Err(self.border_error(leaky, leak));
        }
        let grown = grow::grow(slab, &self.from(), Some(&air), task)?;
        if let Some(leak) = grown.leak {
            return Err(self.border_error(&grown, leak));
        }
        let text = format!(
            "the lumen is open to the air around the specimen (reached in plane {}, z {:.3} mm); what is connected to the image border within its plane was taken as outside",
            leak[2], slab.volume.plane_z_mm[leak[2]]
        );
        let warnings = vec![Warning::new("segment.outside_air", text)];
        Ok(Raw { grown, air: Some(air), polarity: Polarity::Dark, warnings })
    }

    /// Refuses a region that leaves the vessel, or cuts off what lies beyond.
    fn without_leaks(&self, raw: Raw, task: &Task<'_>) -> Result<(Grown, Option<Warning>), Error> {
        let Raw { grown, air, polarity, .. } = raw;
        let (slab, sign) = (self.slab, if polarity == Polarity::Dark { -1.0 } else { 1.0 });
        let guard::Inspected { leaks, mut removed } = guard::inspect(slab, &grown, self.seeds, sign);
        task.check()?;
        // What lies behind a passage tells more than the border that is reached through it.
        let tells = |l: &Site| l.into != Beyond::Border;
        let widest =
            leaks.iter().max_by(|a, b| tells(a).cmp(&tells(b)).then(a.neck_mm.total_cmp(&b.neck_mm)));
        let Some(widest) = widest else {
            return match grown.leak {
                Some(at) => Err(self.border_error(&grown, at)),
                None => Ok((grown, None)),
            };
        };
        let can_be_cut = !self.seeds.iter().any(|&s| removed.holds(slab, s));
        if self.params.on_leak == OnLeak::Refuse || !can_be_cut {
            return Err(self.leak_error(&grown, widest, can_be_cut));
        }
        if let Some(air) = &air {
            removed.add(air);
        }
        let kept = grow::grow(slab, &self.from(), Some(&removed), task)?;
        if let Some(leak) = kept.leak {
            return Err(self.border_error(&kept, leak));
        }
        Ok((kept, Some(cut_off(slab, &leaks))))
    }

    fn leak_error(&self, grown: &Grown, site: &Site, can_be_cut: bool) -> Error {
        let slab = self.slab;
        let (z_mm, place) = place_of(slab, site.at);
        let [_, _, k] = site.at;
        let into = (site.into != Beyond::Border).then_some((site.into, site.neck_mm));
        let region = grown.mask_of_plane(slab, k);
        let (window_hu, n_blocks) = (slab.window_hu(k), self.params.corrections.block.len());
        let better_window_hu = match self.source {
            WindowSource::Given => {
                levels::find(slab.volume, self.seeds, self.params.polarity).map(Levels::window_hu)
            }
            WindowSource::Found(_) => None,
        };
        let leak = Leak {
            voxel: site.at,
            z_mm,
            place,
            window_hu,
            into,
            region,
            n_blocks,
            can_be_cut,
            better_window_hu,
        };
        Error::Leaks(Box::new(leak))
    }

    fn border_error(&self, grown: &Grown, at: Voxel) -> Error {
        self.leak_error(grown, &Site { at, into: Beyond::Border, neck_mm: 0.0 }, false)
    }
}

/// Of many leaks so many are named.
const NAMED_LEAKS: usize = 6;

fn cut_off(slab: &Slab<'_>, leaks: &[Site]) -> Warning {
    let place = |leak: &Site| {
        let (z_mm, place) = place_of(slab, leak.at);
        format!(
            "plane {} (z {z_mm:.3} mm) at {place} into {}, {:.1} mm wide",
            leak.at[2], leak.into, leak.neck_mm
        )
    };
    let mut by_width: Vec<&Site> = leaks.iter().collect();
    by_width.sort_by(|a, b| b.neck_mm.total_cmp(&a.neck_mm));
    let mut named: Vec<String> = by_width.iter().take(NAMED_LEAKS).map(|l| place(l)).collect();
    if leaks.len() > NAMED_LEAKS {
        named.push(format!("and {} narrower ones", leaks.len() - NAMED_LEAKS));
    }
    Warning::new(
        "segment.leak_cut",
        format!("the region was cut off where it left the vessel: {}", named.join("; ")),
    )
}

fn place_of(slab: &Slab<'_>, [i, j, k]: Voxel) -> (f64, Place) {
    let in_stack = slab.volume.stack_from_voxel(i as f64, j as f64, k);
    (in_stack.z, Place(slab.volume.patient_from_stack.apply(in_stack)))
}
