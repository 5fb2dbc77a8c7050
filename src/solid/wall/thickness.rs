//! How thick a wall really is: the distance of its outer skin, as built, from the lumen.
//!
//! The outer skin's surfaces are sampled between the sections and points that they were made through, each sample with
//! the area it stands for, and measured to the nearest point of the lumen ([`Feet`]; beyond open ends: of the lumen
//! as continued there). A true parallel skin measures t everywhere. The feet have placed the skin, too: the thinnest and the
//! thickest samples and as many of the others are measured again on the lumen's surfaces ([`verify`]), and how far the
//! feet were off there is told. Cost: about a thousand samples a square centimetre at half a microsecond.

use super::feet::Feet;
use super::verify;
use crate::ct::Warning;
use crate::geom::{Point3, Region};
use crate::progress::{Cancelled, Task};
use crate::solid::Error;
use crate::solid::event::{Crotch, Slab};
use crate::solid::skin::{Skin, Tube};
use crate::spline::PatchSurface;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Samples round a tube's section, and between two of its sections.
const ROUND: usize = 72;
const BETWEEN: [f64; 2] = [0.25, 0.75];
/// Samples of a patch along each direction.
const ARC: usize = 48;
const ROWS: usize = 12;
/// Chord tolerance of the lumen's sections in which a point is looked for, mm.
const CHORD_MM: f64 = 1e-3;
/// Of the thinnest and of the thickest samples, and twice that of all others, so many are measured again.
const AGAIN: usize = 24;
/// What is looked at then, in distances.
const REACH: f64 = 1.1;
/// How far the feet may be off before it is said, in t.
const FEET_OFF: f64 = 5e-3;
/// How much the thickness may differ from what was asked before it is said, in t.
const TOLERANCE: f64 = 0.02;
/// A wall thinner than this anywhere, in t, is refused.
const LEAST_THICKNESS: f64 = 0.5;
/// Where it differs by more than this, in t, sections are added.
const SLACK: f64 = 0.01;

/// The thickness of a wall over the whole of its outer skin, mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Thickness {
    /// What was asked for.
    pub asked_mm: f64,
    /// Least of all samples.
    pub least_mm: f64,
    /// Where that is, stack frame.
    pub least_at_mm: [f64; 3],
    /// Not reached on 5 % of the area.
    pub p5_mm: f64,
    /// Mean over the area.
    pub mean_mm: f64,
    /// Exceeded on 5 % of the area.
    pub p95_mm: f64,
    /// Greatest of all samples.
    pub most_mm: f64,
    /// Where that is, stack frame.
    pub most_at_mm: [f64; 3],
    /// Share of the area on which it is within 2 % of what was asked.
    pub within_percent: f64,
    /// Number of samples.
    pub n_samples: usize,
    /// Number of those that were measured again on the lumen's surfaces: the thinnest, the thickest, and others.
    pub n_again: usize,
    /// Farthest that one of these is off what was told of it at first.
    pub off_mm: f64,
}

/// The thickness with what tells whether another skin is better, and where this one should be.
#[derive(Debug, Clone)]
pub(super) struct Measured {
    pub(super) thickness: Thickness,
    /// How much material is too much or missing beyond [`SLACK`].
    pub(super) excess_mm3: f64,
    /// Heights at which some is, ascending.
    pub(super) off_z_mm: Vec<f64>,
}

impl Measured {
    fn of(all: Vec<Sample>, asked_mm: f64, again: Again) -> Option<Self> {
        let excess = |s: &Sample| ((s.distance_mm - asked_mm).abs() - SLACK * asked_mm).max(0.0) * s.area_mm2;
        let excess_mm3 = all.iter().map(excess).sum();
        let mut off_z_mm: Vec<f64> = all.iter().filter(|s| excess(s) > 0.0).map(|s| s.at.z).collect();
        off_z_mm.sort_by(f64::total_cmp);
        off_z_mm.dedup();
        Some(Self { thickness: Thickness::of(all, asked_mm, again)?, excess_mm3, off_z_mm })
    }
}

/// A point of the outer skin with the area it stands for, and its distance.
#[derive(Debug, Clone, Copy)]
struct Sample {
    at: Point3,
    area_mm2: f64,
    distance_mm: f64,
}

impl Thickness {
    fn of(mut all: Vec<Sample>, asked_mm: f64, again: Again) -> Option<Self> {
        all.par_sort_by(|a, b| a.distance_mm.total_cmp(&b.distance_mm));
        let (least, most) = (*all.first()?, *all.last()?);
        let whole: f64 = all.iter().map(|m| m.area_mm2).sum();
        let below = |share: f64| {
            let mut passed = 0.0;
            let reached = |m: &&Sample| {
                passed += m.area_mm2;
                passed >= share * whole
            };
            all.iter().find(reached).map_or(most.distance_mm, |m| m.distance_mm)
        };
        let within = |m: &&Sample| (m.distance_mm - asked_mm).abs() <= TOLERANCE * asked_mm;
        let sum = |of: &dyn Fn(&Sample) -> f64| all.iter().map(of).sum::<f64>() / whole;
        Some(Self {
            asked_mm,
            least_mm: least.distance_mm,
            least_at_mm: least.at.into(),
            p5_mm: below(0.05),
            mean_mm: sum(&|m| m.distance_mm * m.area_mm2),
            p95_mm: below(0.95),
            most_mm: most.distance_mm,
            most_at_mm: most.at.into(),
            within_percent: 100.0 * all.iter().filter(within).map(|m| m.area_mm2).sum::<f64>() / whole,
            n_samples: all.len(),
            n_again: again.n,
            off_mm: again.off_mm,
        })
    }

    /// Whether the wall is within 2 % of what was asked, everywhere.
    #[must_use]
    pub fn is_as_asked(&self) -> bool {
        let off = |mm: f64| (mm - self.asked_mm).abs();
        off(self.least_mm).max(off(self.most_mm)) <= TOLERANCE * self.asked_mm
    }

    fn is_off(&self) -> bool {
        self.off_mm > FEET_OFF * self.asked_mm
    }

    /// Refuses a wall that is far too thin somewhere.
    pub(super) fn check(&self) -> Result<(), Error> {
        let Self { asked_mm, least_mm, least_at_mm: at_mm, .. } = *self;
        // What is not a number is too thin, too.
        if least_mm >= LEAST_THICKNESS * asked_mm && self.most_mm.is_finite() {
            Ok(())
        } else {
            Err(Error::ThinWall { asked_mm, least_mm, at_mm })
        }
    }

    /// What is to be said of a wall that is not as thick as asked.
    pub(super) fn warning(&self) -> Option<Warning> {
        let place = |[x, y, z]: [f64; 3]| format!("z {z:.2}, x {x:.2}, y {y:.2}");
        let text = || {
            format!(
                "the wall is {:.3} mm ({}) to {:.3} mm ({}) thick where {:.3} mm were asked; {:.2} % of it are within 2 %",
                self.least_mm,
                place(self.least_at_mm),
                self.most_mm,
                place(self.most_at_mm),
                self.asked_mm,
                // All of it would need no word.
                (self.within_percent * 100.0).floor() / 100.0
            )
        };
        let told = || {
            let off = format!(
                "; measured again in {} places it is up to {:.3} mm off that",
                self.n_again, self.off_mm
            );
            if self.is_off() { text() + &off } else { text() }
        };
        (!self.is_as_asked() || self.is_off()).then(|| Warning::new("solid.wall_thickness", told()))
    }
}

/// Measures the wall between an outer skin and the lumen; `None` where there is none.
pub(super) fn measure(
    outer: &Skin,
    lumen: &Skin,
    feet: &Feet,
    wall_mm: f64,
    task: &Task<'_>,
) -> Result<Option<Measured>, Cancelled> {
    task.check()?;
    let measured = |(at, area_mm2)| Sample { at, area_mm2, distance_mm: distance_mm(lumen, feet, at) };
    let rings: Vec<_> = outer.tubes.iter().flat_map(rings).collect();
    let on_tubes = rings.par_iter().flat_map_iter(|(tube, band)| on_ring(tube, *band));
    let on_slabs = outer.slabs.par_iter().flat_map_iter(on_slab);
    let mut all: Vec<Sample> = on_tubes.chain(on_slabs).map(measured).collect();
    all.par_sort_by(|a, b| a.distance_mm.total_cmp(&b.distance_mm));
    let again = again(&mut all, lumen);
    Ok(Measured::of(all, wall_mm, again))
}

/// What samples showed that were measured again.
#[derive(Debug, Clone, Copy)]
struct Again {
    n: usize,
    off_mm: f64,
}

/// Measures some of the samples, ascending, again on the lumen's surfaces; where one of these is nearer than told, that
/// counts. Samples whose nearest point may lie where the lumen was continued beyond an open end are passed over.
fn again(all: &mut [Sample], lumen: &Skin) -> Again {
    let [low, high] = lumen.z_range_mm();
    let is_known = |s: &Sample| {
        let reach_mm = REACH * s.distance_mm;
        s.distance_mm > 0.0 && s.at.z - reach_mm > low && s.at.z + reach_mm < high
    };
    let known: Vec<usize> = (0..all.len()).filter(|&k| is_known(&all[k])).collect();
    let n = known.len();
    let inner = (0..2 * AGAIN).map(|k| k * n / (2 * AGAIN));
    let mut chosen: Vec<usize> =
        (0..n.min(AGAIN)).chain(inner).chain(n.saturating_sub(AGAIN)..n).filter(|&k| k < n).collect();
    chosen.sort_unstable();
    chosen.dedup();
    let measure = |&k: &usize| {
        let Sample { at, distance_mm, .. } = all[known[k]];
        (known[k], verify::distance_mm(lumen, at, REACH * distance_mm))
    };
    let found: Vec<(usize, f64)> = chosen.par_iter().map(measure).collect();
    let off_mm = found.iter().map(|&(k, mm)| (mm - all[k].distance_mm).abs()).fold(0.0, f64::max);
    for &(k, mm) in &found {
        all[k].distance_mm = all[k].distance_mm.min(mm);
    }
    Again { n: found.len(), off_mm }
}

/// The signed distance of a point from the lumen. Where the nearest sample says that it is inside, the lumen itself is
/// asked: beside a sharp ridge, a point before it may lie behind the tangent plane of a sample on it.
fn distance_mm(lumen: &Skin, feet: &Feet, at: Point3) -> f64 {
    let told = feet.foot(at).distance_mm;
    if told >= 0.0 {
        return told;
    }
    let region = Region::new(lumen.section(at.z, CHORD_MM));
    if region.contains(at.xy()) { told } else { -told }
}

/// A height of a tube, and how much of it a ring there stands for, mm.
type Band = (f64, f64);

/// Rings between the sections of a tube.
fn rings(tube: &Tube) -> impl Iterator<Item = (&Tube, Band)> {
    let between = |pair: &[f64]| {
        let height_mm = pair[1] - pair[0];
        BETWEEN.map(|share| (pair[0] + share * height_mm, height_mm / BETWEEN.len() as f64))
    };
    tube.surface.section_z_mm().windows(2).flat_map(between).map(move |band| (tube, band))
}

/// Samples round a tube, each with the area that it stands for.
fn on_ring(tube: &Tube, (z_mm, height_mm): Band) -> Vec<(Point3, f64)> {
    let ring = tube.surface.net().ring(z_mm, height_mm);
    let one = |k: usize| {
        let jet = ring.jet((k as f64 + 0.5) / ROUND as f64);
        (jet.at, jet.du.cross(&jet.dz).norm() * height_mm / ROUND as f64)
    };
    (0..ROUND).map(one).collect()
}

fn on_slab(slab: &Slab) -> Vec<(Point3, f64)> {
    let mut samples: Vec<_> = slab.laterals.iter().flat_map(|l| on_patch(l, [ARC, ROWS])).collect();
    if let Crotch::Saddle(saddle) = &slab.crotch {
        samples.extend(on_patch(saddle, [ROWS, ROWS]));
    }
    samples
}

fn on_patch(patch: &PatchSurface, [n_u, n_v]: [usize; 2]) -> Vec<(Point3, f64)> {
    let cell = |k: usize, n: usize, [a, b]: [f64; 2]| a + (b - a) * (k as f64 + 0.5) / n as f64;
    let size = |[a, b]: [f64; 2], n: usize| (b - a) / n as f64;
    let one = |(i, j): (usize, usize)| {
        let jet = patch.jet(cell(i, n_u, patch.u_range()), cell(j, n_v, patch.v_range()));
        let area = jet.by_u.cross(&jet.by_v).norm() * size(patch.u_range(), n_u) * size(patch.v_range(), n_v);
        (jet.point, area)
    };
    (0..n_v).flat_map(|j| (0..n_u).map(move |i| (i, j))).map(one).collect()
}
