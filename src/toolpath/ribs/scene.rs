//! What ribs are planned in: the body layer by layer, divided at its joints; where it is to be held, and where struts and posts have
//! room.

use super::super::simplify;
use super::super::supports::Support;
use super::{Circle, Line, strut_mm};
use crate::geom::{Bounds2, Contour, Point2, Region, SegmentIndex, Vector2};
use crate::profile::Profile;
use crate::slice::Layer;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Outlines are thinned to this, mm: ribs are no part of the print.
const TOLERANCE_MM: f64 = 0.02;
/// Height of a strut, mm.
const STRUT_MM: f64 = 0.8;
/// From a strut on the next one follows at this share of the first one's height.
const NEXT_SHARE: f64 = 0.5;
/// A shorter gap is bridged by no strut, mm: the walls are printed nearly together.
const SHORTEST_MM: f64 = 1.0;
/// How far a strut's end is pressed into the skin, mm.
pub(super) const GRIP_MM: f64 = 0.1;
/// The skins that a strut ends at may move so far while it is printed, mm.
const DRIFT_MM: f64 = 1.0;
/// Distance of the places at which a strut is seen to be clear, mm.
const PROBE_MM: f64 = 0.25;
/// A strut parts from its skin at no less than this slope.
const CLEAR_SLOPE: f64 = 0.7;
/// Radius of a post's top, mm.
const POST_TOP_MM: f64 = 1.5;
/// Distances of a post from its branch that are tried, mm,
const POST_REACHES_MM: [f64; 6] = [2.0, 3.0, 4.0, 6.0, 8.0, 10.0];
/// and directions.
const N_DIRECTIONS: u32 = 24;
/// Islands smaller than the square of so many beads are specks: nothing parts or is held there.
const SPECK_BEADS: f64 = 2.0;

/// The body in one layer, and what else is in the way.
pub(super) struct Level {
    islands: Vec<Island>,
    columns: Option<SegmentIndex>,
    /// Height of the layer's top above the body's bottom, and of the layer, mm.
    pub(super) top_mm: f64,
    height_mm: f64,
}

/// An outline with all that it encloses.
pub(super) struct Island {
    pub(super) outline: Contour,
    pub(super) index: SegmentIndex,
    bounds: Bounds2,
    area_mm2: f64,
    width_mm: f64,
}

impl Island {
    fn try_new(outline: &Contour) -> Option<Self> {
        let outline = simplify::contour(outline, TOLERANCE_MM);
        let index = SegmentIndex::try_new(std::slice::from_ref(&outline))?;
        let bounds = outline.bounds()?;
        let area_mm2 = outline.signed_area_mm2();
        let width_mm = Region::new(vec![outline.clone()]).least_width_mm();
        Some(Self { outline, index, bounds, area_mm2, width_mm })
    }

    fn overlaps(&self, other: &Self) -> bool {
        let region = |island: &Self| Region::new(vec![island.outline.clone()]);
        self.bounds.meets(other.bounds) && region(self).intersection(&region(other)).area_mm2() > 0.0
    }

    /// The nearest points of two outlines: on this one, on the other; none where they are farther apart than that.
    pub(super) fn nearest_pair(&self, other: &Self, most_mm: f64) -> Option<(Point2, Point2)> {
        if !self.bounds.grown(most_mm).meets(other.bounds) {
            return None;
        }
        let to = |p: &Point2, of: &Self| of.index.nearest_within(*p, most_mm).map(|foot| (*p, foot.point));
        let here = self.outline.points.iter().filter_map(|p| to(p, other));
        let there = other.outline.points.iter().filter_map(|p| to(p, self)).map(|(p, q)| (q, p));
        here.chain(there).min_by(|a, b| (a.0 - a.1).norm().total_cmp(&(b.0 - b.1).norm()))
    }
}

/// A piece of the body between two joints: from this layer upward one island in each.
pub(super) struct Part {
    pub(super) idx: usize,
    pub(super) first: usize,
    pub(super) islands: Vec<usize>,
}

/// A place in which a part is to be held, and how far from it a strut holds it, too.
#[derive(Debug, Clone, Copy)]
pub(super) struct Want {
    pub(super) layer: usize,
    pub(super) within_mm: f64,
}

/// Where a strut is to lie: from a place on an outline on; it ends at another outline, or at a post.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    pub(super) from: Point2,
    pub(super) along: Vector2,
    pub(super) length_mm: f64,
    to_part: bool,
}

impl Axis {
    pub(super) fn between(from: Point2, to: Point2, to_part: bool) -> Self {
        let length_mm = (to - from).norm();
        Self { from, along: (to - from) / length_mm.max(1e-9), length_mm, to_part }
    }

    fn at(&self, t: f64) -> Point2 {
        self.from + self.along * t
    }

    /// Where it crosses a closed outline.
    fn crossings<'a>(&'a self, outline: &'a Contour) -> impl Iterator<Item = f64> + 'a {
        outline.edges().filter_map(move |(a, b)| {
            let [off_a, off_b] = [a, b].map(|p| self.along.perp(&(p - self.from)));
            let [t_a, t_b] = [a, b].map(|p| self.along.dot(&(p - self.from)));
            ((off_a > 0.0) != (off_b > 0.0)).then(|| t_a + (t_b - t_a) * off_a / (off_a - off_b))
        })
    }
}

/// A strut: its beads from its lowest layer upward.
pub(super) struct Strut {
    pub(super) first: usize,
    pub(super) lines: Vec<Line>,
}

impl Strut {
    pub(super) fn last(&self) -> usize {
        self.first + self.lines.len() - 1
    }

    pub(super) fn line(&self, layer: usize) -> Option<&Line> {
        layer.checked_sub(self.first).and_then(|i| self.lines.get(i))
    }
}

/// A hollow cone that is upright at one place.
pub(super) struct Post {
    /// There, and from there to the middle.
    pub(super) near: Point2,
    pub(super) back: Vector2,
    pub(super) last: usize,
}

/// The body with all that matters of profile and columns. mm.
pub(super) struct Scene {
    pub(super) levels: Vec<Level>,
    slenderness: f64,
    pub(super) span_mm: f64,
    pub(super) gap_mm: f64,
    pub(super) bead_mm: f64,
    pub(super) strut_mm: f64,
    bed_mm: [f64; 2],
}

impl Scene {
    pub(super) fn of(
        layers: &[Layer],
        placed: &[(Region, Region)],
        columns: &[Support],
        profile: &Profile,
    ) -> Self {
        let mut top_mm = 0.0;
        let mut heights = Vec::with_capacity(layers.len());
        for layer in layers {
            top_mm += layer.slot.height_mm;
            heights.push((top_mm, layer.slot.height_mm));
        }
        let level = |(idx, (top_mm, height_mm)): (usize, (f64, f64))| {
            let (material, lumen) = &placed[idx];
            let whole = material.union(lumen).without_holes();
            let column = columns.get(idx).map(Support::area).unwrap_or_default();
            Level {
                islands: whole.contours.iter().filter_map(Island::try_new).collect(),
                columns: SegmentIndex::try_new(&column.contours),
                top_mm,
                height_mm,
            }
        };
        let (machine, print) = (&profile.machine, &profile.print);
        Self {
            levels: heights.into_par_iter().enumerate().map(level).collect(),
            slenderness: print.rib_slenderness,
            span_mm: print.rib_span_mm,
            gap_mm: print.support_gap_mm,
            bead_mm: print.extrusion_width_mm,
            strut_mm: strut_mm(print.extrusion_width_mm, machine.extrusion_width_mm[1]),
            bed_mm: [machine.bed_mm[0], machine.bed_mm[1]],
        }
    }

    pub(super) fn island(&self, part: &Part, layer: usize) -> &Island {
        &self.levels[layer].islands[part.islands[layer - part.first]]
    }

    /// Whether it is more than a speck.
    pub(super) fn is_body(&self, island: &Island) -> bool {
        island.area_mm2 > (SPECK_BEADS * self.bead_mm).powi(2)
    }

    /// The pieces of the body, from the bed upward.
    pub(super) fn parts(&self) -> Vec<Part> {
        let mut parts: Vec<Part> = Vec::new();
        let mut below: (&[Island], Vec<usize>) = (&[], Vec::new());
        for (first, level) in self.levels.iter().enumerate() {
            let under = |island: &Island| -> Vec<usize> {
                let others = below.0.iter().enumerate();
                let touching =
                    others.filter(|(_, b)| self.is_body(island) && self.is_body(b) && island.overlaps(b));
                touching.map(|(i, _)| i).collect()
            };
            let under: Vec<Vec<usize>> = level.islands.iter().map(under).collect();
            let goes_on = |b: usize| under.iter().filter(|all| all.contains(&b)).count() == 1;
            let mut here = Vec::with_capacity(under.len());
            for (i, feet) in under.iter().enumerate() {
                let idx = match feet[..] {
                    [b] if goes_on(b) => below.1[b],
                    _ => {
                        parts.push(Part { idx: parts.len(), first, islands: Vec::new() });
                        parts.len() - 1
                    }
                };
                parts[idx].islands.push(i);
                here.push(idx);
            }
            below = (&level.islands, here);
        }
        parts
    }

    /// Where a part is to be held.
    pub(super) fn wants(&self, part: &Part) -> Vec<Want> {
        let first = &self.levels[part.first];
        let (mut joint_mm, mut share) = (first.top_mm - first.height_mm, 1.0);
        let (mut wants, mut widths_mm) = (Vec::new(), 0.0);
        let end_mm = self.levels[part.first + part.islands.len() - 1].top_mm;
        for (n, layer) in (part.first..part.first + part.islands.len()).enumerate() {
            widths_mm += self.island(part, layer).width_mm;
            let free_mm = self.slenderness * widths_mm / (n + 1) as f64;
            let Level { top_mm, height_mm, .. } = self.levels[layer];
            // At its very top there is no room for a strut, and nothing left to be steadied.
            let goes_on = end_mm - (top_mm - height_mm) >= STRUT_MM;
            if goes_on && top_mm - joint_mm > share * free_mm {
                wants.push(Want { layer, within_mm: NEXT_SHARE / 2.0 * free_mm });
                (joint_mm, share) = (top_mm, NEXT_SHARE);
            }
        }
        wants
    }

    /// A strut whose lowest layer is `first`, where nothing is in the way.
    pub(super) fn strut(&self, first: usize, axis: &Axis) -> Option<Strut> {
        let bottom_mm = self.levels[first].top_mm - self.levels[first].height_mm;
        let high = |level: &Level| level.top_mm - bottom_mm >= STRUT_MM - 1e-9;
        let n_layers = self.levels[first..].iter().position(high)? + 1;
        let lines = (first..first + n_layers).map(|layer| self.line(layer, axis));
        Some(Strut { first, lines: lines.collect::<Option<_>>()? })
    }

    /// The bead of a strut in a layer: between the outlines as they are there.
    fn line(&self, layer: usize, axis: &Axis) -> Option<Line> {
        let islands = &self.levels[layer].islands;
        let middle = axis.length_mm / 2.0;
        if islands.iter().any(|island| island.outline.contains(axis.at(middle))) {
            return None;
        }
        let hits = islands
            .iter()
            .enumerate()
            .flat_map(|(i, island)| axis.crossings(&island.outline).map(move |t| (t, i)));
        let hits: Vec<(f64, usize)> = hits.collect();
        let nearer = |a: &&(f64, usize), b: &&(f64, usize)| a.0.total_cmp(&b.0);
        let &(begin, at) = hits.iter().filter(|hit| hit.0 <= middle).max_by(nearer)?;
        let end = hits.iter().filter(|hit| hit.0 > middle).min_by(nearer);
        let (end, ends) = match end {
            Some(&(end, other)) if axis.to_part => (end, [at, other]),
            Some(&(end, _)) if end < axis.length_mm => return None,
            _ if axis.to_part => return None,
            _ => (axis.length_mm, [at, at]),
        };
        let is_near = begin >= -DRIFT_MM && end <= axis.length_mm + DRIFT_MM;
        let is_long_enough = (SHORTEST_MM..=self.span_mm).contains(&(end - begin));
        if !is_near || !is_long_enough || !self.is_clear(layer, axis, [begin, end], ends) {
            return None;
        }
        let grip_mm = if axis.to_part { GRIP_MM } else { 0.0 };
        let (from, to) = (axis.at(begin - GRIP_MM), axis.at(end + grip_mm));
        Some(Line { from, to, to_part: axis.to_part })
    }

    /// Whether a strut from `begin` to `end` keeps off all but the outlines that it ends at, and off these but at its ends.
    fn is_clear(&self, layer: usize, axis: &Axis, [begin, end]: [f64; 2], ends: [usize; 2]) -> bool {
        let level = &self.levels[layer];
        let half_mm = self.strut_mm / 2.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a span of a few mm")]
        let n_probes = ((end - begin) / PROBE_MM).ceil() as usize;
        (0..=n_probes).all(|k| {
            let t = begin + (end - begin) * k as f64 / n_probes as f64;
            let from_end_mm = if axis.to_part { (t - begin).min(end - t) } else { t - begin };
            let is_off = |(i, island): (usize, &Island)| {
                let air_mm = half_mm + self.gap_mm;
                let air_mm = if ends.contains(&i) { air_mm.min(CLEAR_SLOPE * from_end_mm) } else { air_mm };
                island.index.nearest_within(axis.at(t), air_mm).is_none()
            };
            level.islands.iter().enumerate().all(is_off)
                && level.columns.as_ref().is_none_or(|c| c.signed_distance_mm(axis.at(t)) > half_mm)
        })
    }

    pub(super) fn circle(&self, post: &Post, layer: usize) -> Circle {
        let below_mm = self.levels[post.last].top_mm - self.levels[layer].top_mm;
        let radius_mm = POST_TOP_MM + below_mm / (2.0 * self.slenderness);
        Circle { centre: post.near + post.back * radius_mm, radius_mm }
    }

    /// Whether a post has room in a layer, other ribs left aside.
    pub(super) fn has_room(&self, circle: Circle, layer: usize) -> bool {
        let Circle { centre, radius_mm } = circle;
        let reach_mm = radius_mm + self.bead_mm / 2.0;
        let level = &self.levels[layer];
        let off = |index: &SegmentIndex| index.signed_distance_mm(centre) - reach_mm;
        let on_bed = |place: f64, size: f64| place >= reach_mm && place <= size - reach_mm;
        on_bed(centre.x, self.bed_mm[0])
            && on_bed(centre.y, self.bed_mm[1])
            && level.islands.iter().all(|island| off(&island.index) >= self.gap_mm)
            && level.columns.as_ref().is_none_or(|columns| off(columns) >= self.bead_mm)
    }

    /// Where a post may be upright, the nearest places first, with the direction to its middle.
    pub(super) fn places(&self, island: &Island) -> Vec<(Point2, Vector2)> {
        let centre = island.outline.centroid();
        let reaches = POST_REACHES_MM.iter().filter(|reach| **reach <= self.span_mm);
        let all = reaches.flat_map(|reach| (0..N_DIRECTIONS).map(move |k| (*reach, k)));
        all.filter_map(|(reach_mm, k)| {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(N_DIRECTIONS)).sin_cos();
            let ray = Axis { from: centre, along: Vector2::new(cos, sin), length_mm: 0.0, to_part: true };
            let skin_mm = ray.crossings(&island.outline).fold(0.0, f64::max);
            (skin_mm > 0.0).then(|| (ray.at(skin_mm + reach_mm), ray.along))
        })
        .collect()
    }
}
