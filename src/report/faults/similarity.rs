//! One similarity of all planes between two stages, and of their heights.
//!
//! A solid that is too high or too low shows in a plane as its section from another height: beside its place by the vessel's drift
//! there, and wider or narrower by its taper. That is fitted with the similarity where it explains more. Where the vessel is too
//! upright to show it, the solid's ends tell.

use super::outlines::{OutlinePlace, Outlines, StagePair};
use super::{Finding, Kind, Place, Size, told};
use crate::geom::{Point2, Vector2};
use crate::report::Stage;
use nalgebra::{Matrix6, Vector6};

/// A similarity that explains this part of all deviations is one.
const EXPLAINED: f64 = 0.8;
/// Heights are taken for stretched where that leaves less than this part of what is off without it, and at least this part of all.
const LEFT_BY_STRETCH: f64 = 0.3;
const GAIN_OF_STRETCH: f64 = 0.005;
/// Scale, turn and stretch leave at most this part of what a shift of all leaves.
const LEFT_BY_SHIFT: f64 = 0.5;
/// Smaller changes of scale are none, as a part.
pub(super) const LEAST_SCALE: f64 = 0.002;
/// Steps until a fit has settled, and when it has, mm.
pub(super) const MOST_STEPS: usize = 8;
pub(super) const SETTLED_MM: f64 = 2e-3;

/// What a fit of all planes may change.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
enum Freedom {
    Shift,
    Similarity,
    Stretch,
}

/// One similarity of all planes: x + shift + scale (x - about) + turn J (x - about) + drift (lift + stretch (z - middle)).
#[derive(Debug, Clone, Copy)]
pub(super) struct Similarity {
    about: Point2,
    /// The farthest place from there, mm.
    reach_mm: f64,
    shift: Vector2,
    scale: f64,
    turn: f64,
    middle_mm: f64,
    lift_mm: f64,
    stretch: f64,
}

impl Similarity {
    /// From the moved place to where it was, to first order.
    pub(super) fn back(&self, own: &Outlines, place: &OutlinePlace) -> Point2 {
        let p = place.at;
        let arm = p - self.about;
        let rise_mm = self.lift_mm + self.stretch * (own.z_mm - self.middle_mm);
        let aside = (own.drift + place.normal * own.flare) * rise_mm;
        p - self.shift - arm * self.scale - Vector2::new(-arm.y, arm.x) * self.turn - aside
    }

    /// `None` where no similarity explains what is off, or an even offset of all explains it better.
    pub(super) fn of(outlines: &[Vec<Option<Outlines>>], pair: &StagePair<'_>) -> Option<Self> {
        let all: Vec<(&Outlines, OutlinePlace)> =
            outlines.iter().flatten().flatten().flat_map(|o| o.places.iter().map(move |p| (o, *p))).collect();
        let n = all.len().max(1) as f64;
        let about = Point2::from(all.iter().map(|(_, p)| p.at.coords).sum::<Vector2>() / n);
        let middle_mm = all.iter().map(|(o, _)| o.z_mm).sum::<f64>() / n;
        let shift = Vector2::zeros();
        let reach_mm = all.iter().map(|(_, p)| (p.at - about).norm()).fold(0.0, f64::max);
        let same =
            Self { about, reach_mm, shift, scale: 0.0, turn: 0.0, middle_mm, lift_mm: 0.0, stretch: 0.0 };
        let first = same.off_mm(&all);
        let total = squares(&first);
        if (total / n).sqrt() < 0.3 * pair.least_mm {
            return None;
        }
        let (_, beside) = same.settled(&all, Freedom::Shift)?;
        let (mut similarity, mut own) = same.settled(&all, Freedom::Similarity)?;
        if matches!(pair.stage, Stage::Reconstruction | Stage::Slicing | Stage::Scan)
            && let Some((stretched, left)) = same.settled(&all, Freedom::Stretch)
            && left < LEFT_BY_STRETCH * own
            && own - left > GAIN_OF_STRETCH * total
        {
            (similarity, own) = (stretched, left);
        }
        let mean = first.iter().sum::<f64>() / n;
        let of_offset = total - n * mean * mean;
        // A straight round vessel cannot tell an offset from a scale: contours are offset, solids are scaled.
        let tie = 0.02 * total;
        let better =
            if pair.stage == Stage::Segmentation { own + tie < of_offset } else { own <= of_offset + tie };
        let earned = own < LEFT_BY_SHIFT * beside;
        (own < (1.0 - EXPLAINED) * total && better && earned).then_some(similarity)
    }

    /// How far outside all places lie after it was taken back, mm.
    fn off_mm(&self, all: &[(&Outlines, OutlinePlace)]) -> Vec<f64> {
        all.iter().map(|(o, p)| o.off_mm(self.back(o, p))).collect()
    }

    /// The best similarity from here on, and the squares that it leaves.
    fn settled(self, all: &[(&Outlines, OutlinePlace)], freedom: Freedom) -> Option<(Self, f64)> {
        let mut best = self;
        let mut rest = best.off_mm(all);
        for _ in 0..MOST_STEPS {
            let (next, reach_mm) = best.step(all, &rest, freedom)?;
            rest = next.off_mm(all);
            best = next;
            if reach_mm < SETTLED_MM {
                break;
            }
        }
        Some((best, squares(&rest)))
    }

    /// The similarity after a Gauss-Newton step, and how far that moves a place about.
    fn step(
        &self,
        all: &[(&Outlines, OutlinePlace)],
        off_mm: &[f64],
        freedom: Freedom,
    ) -> Option<(Self, f64)> {
        let (mut own, mut right) = (Matrix6::identity() * 1e-9, Vector6::zeros());
        let (mut reach_mm, mut rise_mm): (f64, f64) = (0.0, 0.0);
        for ((o, p), off_mm) in all.iter().zip(off_mm) {
            let arm = p.at - self.about;
            let height_mm = o.z_mm - self.middle_mm;
            let rise = if freedom >= Freedom::Stretch { o.rise(p) } else { 0.0 };
            let similar = if freedom >= Freedom::Similarity { 1.0 } else { 0.0 };
            reach_mm = reach_mm.max(arm.norm());
            rise_mm = rise_mm.max((height_mm * rise).abs());
            let row = Vector6::new(
                p.normal.x,
                p.normal.y,
                similar * p.normal.dot(&arm),
                similar * p.normal.dot(&Vector2::new(-arm.y, arm.x)),
                rise,
                rise * height_mm,
            );
            own += row * row.transpose();
            right += row * *off_mm;
        }
        let x = own.try_inverse()? * right;
        let moved = Self {
            shift: self.shift + Vector2::new(x[0], x[1]),
            scale: self.scale + x[2],
            turn: self.turn + x[3],
            lift_mm: self.lift_mm + x[4],
            stretch: self.stretch + x[5],
            ..*self
        };
        Some((moved, x[0].hypot(x[1]) + reach_mm * x[2].hypot(x[3]) + rise_mm * x[5].abs()))
    }

    pub(super) fn findings(&self, pair: &StagePair<'_>, z_mm: &[f64]) -> Vec<Finding> {
        let range = [0, z_mm.len() - 1];
        let planes = told("plane", range);
        let place = || Place::of_planes(z_mm, range[0], range[1]);
        let [from, to] = pair.stage.sides();
        let mut findings = Vec::new();
        // What is moved back is the enlarged one: its inverse is what was done to it.
        let scale = 1.0 / (1.0 - self.scale) - 1.0;
        if scale.abs() > LEAST_SCALE {
            let percent = 100.0 * scale;
            let size = Size { size: percent, unit: "percent", uncertainty: 0.05 };
            let text = format!("{to} is scaled by {percent:+.2} % against {from}, {planes}");
            let found = pair.finding(Kind::Scaled, place(), size, text);
            findings.push(pair.judged_part(found, percent, self.reach_mm));
        }
        // Where the section stands aside as if from another height, the body was moved there the other way.
        let stretch = 1.0 / (1.0 + self.stretch) - 1.0;
        if stretch.abs() > LEAST_SCALE {
            findings.push(pair.stretched(stretch, z_mm));
        }
        if self.turn.abs() > LEAST_SCALE {
            let degrees = self.turn.to_degrees();
            let size = Size { size: degrees, unit: "degrees", uncertainty: 0.05 };
            let text = format!("{to} is turned by {degrees:+.2} degrees against {from}, {planes}");
            let found = pair.finding(Kind::Turned, place(), size, text);
            // A turn moves the farthest place as much as a growth by the same part.
            findings.push(pair.judged_part(found, 100.0 * self.turn, self.reach_mm));
        }
        findings
    }
}

fn squares(off_mm: &[f64]) -> f64 {
    off_mm.iter().map(|d| d * d).sum()
}
