//! How the levels of lumen and wall change along the vessel.
//!
//! From the plane of a seed the vessel's section is followed upward and downward: what lies in the window and
//! overlaps the section before. In the middle of every lobe of a section the levels are measured anew
//! ([`super::levels`]); the window of the next plane comes from the median of the last few. A median over some
//! planes on either side and all seeds then gives every plane its levels, so that one bad plane moves nothing.
//!
//! Where a thin branch reaches the border of the image, what lies near the section before is the vessel's. It stops
//! where the section runs out, reaches the border itself, or becomes several times larger at once:
//! where the vessel goes on beyond that, the last levels hold. Where the contrast has faded to a part of what it was
//! at the seed, it says so: what lies beyond is noise.
//!
//! A contour that the operator has drawn stands for the vessel's section, whatever the image shows there; from one that no seed
//! led to, the vessel is followed as from a seed, at the level that the image shows in it.

use super::corrections::Rules;
use super::graph::JUMP;
use super::grow::{self, Grown, Slab, Voxel};
use super::levels::{self, Levels};
use super::lobes;
use crate::ct::Volume;
use crate::progress::{Cancelled, Task};
use std::ops::Range;

/// So many planes on the way tell the next plane's window.
const N_LAST: usize = 5;
/// And so many on either side the plane's own levels.
const N_BESIDE: usize = 2;
/// Contrast below this part of the seed's is lost: nothing is measured there.
const LOST: f64 = 0.3;
/// Below this part the vessel still is followed, but not clear any more: noise that is harmless at the seed's
/// contrast is worth twice as much there.
const CLEAR: f64 = 0.6;
/// It is lost, or not clear, once it was so in that many planes in a row.
const N_FADED: usize = 3;
/// A section that reaches the border of the image is the vessel's up to this part of its radius beyond the section
/// before: a vessel hardly moves or widens more between two planes.
const REACH: f64 = 0.5;
/// A lumen's level that differs from the last planes' by this part of the contrast was measured in something else: contrast
/// medium thins out gently.
const ABRUPT: f64 = 0.35;
/// Levels are measured in the largest lobes of a plane only.
const MOST_LOBES: usize = 3;

/// The levels of every plane of a range.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Followed {
    /// By plane.
    pub(super) levels: Vec<Levels>,
    /// The planes in which the contrast has not faded.
    pub(super) clear: Range<usize>,
}

/// Follows the vessel from all seeds.
///
/// # Errors
/// [`Cancelled`].
pub(super) fn follow(
    volume: &Volume,
    planes: &Range<usize>,
    rules: &Rules,
    seeds: &[Voxel],
    start: Levels,
    task: &Task<'_>,
) -> Result<Followed, Cancelled> {
    let walk = Walk { volume, rules, start, task };
    let mut met = Met {
        planes: planes.clone(),
        measured: vec![Vec::new(); planes.len()],
        seen: vec![false; planes.len()],
    };
    let mut clear: Option<Range<usize>> = None;
    let mut seeds = seeds.to_vec();
    seeds.sort_by_key(|v| v[2]);
    for same_plane in seeds.chunk_by(|a, b| a[2] == b[2]) {
        let [down, up] = walk.both_ways(same_plane, start, &mut met)?;
        let own = down.ended.unwrap_or(planes.start)..up.ended.map_or(planes.end, |k| k + 1);
        clear = Some(clear.map_or(own.clone(), |c| c.start.min(own.start)..c.end.max(own.end)));
    }
    for (&k, drawn) in rules.drawn.range(planes.clone()) {
        if met.has_seen(k) {
            continue;
        }
        let inside = drawn.voxels();
        let [down, up] = walk.both_ways(&inside, walk.level_in(&inside)?, &mut met)?;
        // Nothing but the contour itself may be clear there: beyond it nobody has seen the vessel.
        let own = down.last.unwrap_or(k)..up.last.unwrap_or(k) + 1;
        clear = clear.map(|c| c.start.min(own.start)..c.end.max(own.end));
    }
    Ok(Followed { levels: smoothed(&met.measured, start), clear: clear.unwrap_or_else(|| planes.clone()) })
}

/// What was met on all ways.
struct Met {
    planes: Range<usize>,
    /// By plane.
    measured: Vec<Vec<Levels>>,
    /// Whether the vessel was followed there, by plane.
    seen: Vec<bool>,
}

impl Met {
    fn has_seen(&self, k: usize) -> bool {
        self.seen[k - self.planes.start]
    }
}

struct Walk<'a> {
    volume: &'a Volume,
    rules: &'a Rules,
    start: Levels,
    task: &'a Task<'a>,
}

impl Walk<'_> {
    /// Follows downward and upward from voxels of one plane, at these levels.
    fn both_ways(&self, from: &[Voxel], at: Levels, met: &mut Met) -> Result<[Clear; 2], Cancelled> {
        let (k, planes) = (from[0][2], met.planes.clone());
        let up = self.along(k..planes.end, from, at, met)?;
        let down = self.along((planes.start..k + 1).rev(), from, at, met)?;
        Ok([down, up])
    }

    /// The levels that the image shows in a drawn contour; those of the seeds where it shows none.
    fn level_in(&self, inside: &[Voxel]) -> Result<Levels, Cancelled> {
        let section = self.section(inside[0][2], self.start.window_hu(), inside, None)?;
        Ok(section.and_then(|s| self.measure(&s)).unwrap_or(self.start))
    }

    /// Follows in one direction, how far it is clear.
    fn along(
        &self,
        planes: impl Iterator<Item = usize>,
        seeds: &[Voxel],
        at: Levels,
        met: &mut Met,
    ) -> Result<Clear, Cancelled> {
        let mut last = vec![at];
        let mut from: Vec<Voxel> = seeds.to_vec();
        let (mut reach_mm, mut area, mut n_lost, mut clear) = (None, None, 0, Clear::default());
        for k in planes {
            let is_drawn = self.rules.drawn.contains_key(&k);
            let before = median(&last[last.len().saturating_sub(N_LAST)..]);
            let Some(section) = self.section(k, before.window_hu(), &from, reach_mm)? else { break };
            let is_sudden = |before: usize| section.inside.len() as f64 > JUMP * before as f64;
            if !is_drawn && area.is_some_and(is_sudden) {
                break;
            }
            let is_gentle = |l: &Levels| (l.lumen_hu - before.lumen_hu).abs() < ABRUPT * self.contrast();
            let measured = self.measure(&section).filter(is_gentle);
            let own = k - met.planes.start;
            met.seen[own] = true;
            clear.see(k, is_drawn || measured.is_some_and(|l| self.share(l) >= CLEAR));
            match measured {
                Some(levels) => {
                    met.measured[own].push(levels);
                    last.push(levels);
                    n_lost = 0;
                }
                None if is_drawn => {}
                None => n_lost += 1,
            }
            if n_lost >= N_FADED {
                break;
            }
            area = Some(section.inside.len());
            reach_mm = Some(REACH * section.radius_mm);
            from = section.inside;
        }
        Ok(clear)
    }

    /// The seed's contrast, HU.
    fn contrast(&self) -> f64 {
        (self.start.lumen_hu - self.start.wall_hu).abs()
    }

    /// A contrast as a part of the seed's.
    fn share(&self, levels: Levels) -> f64 {
        (levels.lumen_hu - levels.wall_hu) / (self.start.lumen_hu - self.start.wall_hu)
    }

    /// What lies in the window of plane k and is connected to what the section before covers; where that reaches
    /// the border of the image, what lies near the section before.
    fn section(
        &self,
        k: usize,
        window_hu: [f64; 2],
        from: &[Voxel],
        reach_mm: Option<f64>,
    ) -> Result<Option<Section>, Cancelled> {
        let slab =
            Slab { volume: self.volume, planes: k..k + 1, windows_hu: vec![window_hu], rules: self.rules };
        let seeds: Vec<Voxel> = from.iter().map(|v| [v[0], v[1], k]).filter(|&v| slab.selects(v)).collect();
        if seeds.is_empty() {
            return Ok(None);
        }
        let mut grown = grow::grow(&slab, &seeds, None, self.task)?;
        if grown.leak.is_some() {
            let Some(reach_mm) = reach_mm else { return Ok(None) };
            keep_near(&slab, &mut grown, &seeds, reach_mm);
            if touches_border(&slab, &grown) {
                return Ok(None);
            }
        }
        let [columns, rows, _] = grown.extent();
        let all = rows.clone().flat_map(|j| columns.clone().map(move |i| [i, j, k]));
        let is_inside: Vec<bool> = all.map(|v| grown.holds(&slab, v)).collect();
        let mut lobes = lobes::find(&is_inside, columns.len(), self.volume.pixel_spacing_xy_mm).lobes;
        lobes.sort_by_key(|l| std::cmp::Reverse(l.n_pixels));
        let middle = |at: usize| [columns.start + at % columns.len(), rows.start + at / columns.len(), k];
        let middles = lobes.iter().take(MOST_LOBES).map(|l| middle(l.at)).collect();
        let radius_mm = lobes.iter().map(|l| l.radius_mm).fold(0.0, f64::max);
        Ok(Some(Section { inside: grown.plane(&slab, k), middles, radius_mm }))
    }

    /// The levels of a section, unless its contrast has faded or turned.
    fn measure(&self, section: &Section) -> Option<Levels> {
        let polarity = self.start.polarity();
        let found: Vec<Levels> =
            section.middles.iter().filter_map(|&m| levels::find(self.volume, &[m], polarity)).collect();
        let levels = (!found.is_empty()).then(|| median(&found))?;
        (self.share(levels) >= LOST).then_some(levels)
    }
}

/// How far the vessel is clear.
#[derive(Default)]
struct Clear {
    last: Option<usize>,
    n_unclear: usize,
    /// The last clear plane, once the vessel is not clear any more.
    ended: Option<usize>,
}

impl Clear {
    fn see(&mut self, k: usize, is_clear: bool) {
        self.n_unclear = if is_clear { 0 } else { self.n_unclear + 1 };
        if is_clear && self.ended.is_none() {
            self.last = Some(k);
        }
        if self.n_unclear >= N_FADED {
            self.ended = self.ended.or(self.last);
        }
    }
}

struct Section {
    inside: Vec<Voxel>,
    /// Of its largest lobes.
    middles: Vec<Voxel>,
    /// Of the largest disc in it.
    radius_mm: f64,
}

/// Keeps what lies within so many mm of these voxels, which lie in one plane.
fn keep_near(slab: &Slab<'_>, grown: &mut Grown, voxels: &[Voxel], reach_mm: f64) {
    let [columns, rows, _] = grown.extent();
    let width = columns.len();
    let at = |[i, j, _]: Voxel| (j - rows.start) * width + i - columns.start;
    let mut is_far = vec![true; width * rows.len()];
    for &v in voxels {
        is_far[at(v)] = false;
    }
    let distance_mm = lobes::depth(&is_far, width, slab.volume.pixel_spacing_xy_mm, lobes::Rim::Nothing);
    grown.retain(slab, |v| f64::from(distance_mm[at(v)]) <= reach_mm);
}

fn touches_border(slab: &Slab<'_>, grown: &Grown) -> bool {
    let [columns, rows, _] = grown.extent();
    let [nx, ny, _] = slab.volume.dims;
    columns.start == 0 || rows.start == 0 || columns.end == nx || rows.end == ny
}

fn median(levels: &[Levels]) -> Levels {
    let of = |value: fn(&Levels) -> f64| {
        let mut values: Vec<f64> = levels.iter().map(value).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    Levels { lumen_hu: of(|l| l.lumen_hu), wall_hu: of(|l| l.wall_hu) }
}

/// A level for every plane: the median of those measured around it, else those of the nearest plane that has some.
fn smoothed(measured: &[Vec<Levels>], start: Levels) -> Vec<Levels> {
    let n = measured.len();
    let near = |k: usize| {
        let around = k.saturating_sub(N_BESIDE)..(k + N_BESIDE + 1).min(n);
        let all: Vec<Levels> = measured[around].iter().flatten().copied().collect();
        (!measured[k].is_empty()).then(|| median(&all))
    };
    let known: Vec<(usize, Levels)> = (0..n).filter_map(|k| Some((k, near(k)?))).collect();
    let nearest = |k: usize| {
        let found = known.iter().min_by_key(|(at, _)| at.abs_diff(k));
        found.map_or(start, |(_, levels)| *levels)
    };
    (0..n).map(nearest).collect()
}
