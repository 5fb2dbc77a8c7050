//! The vertices of a tube before they are measured: columns along it, staggered.
//!
//! On a tube that bends round its axis only, triangles with one edge along the axis may be a third larger at the same
//! deflection than those with one edge round it: the edge along the axis has no sag. So the vertices lie on columns, as
//! far apart as the deflection allows, those of every second one half a step higher. The number of columns follows the
//! section's size: it is constant over zones, between which lies a plain ring. Steps along the tube follow the
//! length on its surface, not z, and how it bends there; both curvatures come from the surface's second fundamental
//! form, so that a dome, whose sections shrink to nothing while it lies flat, gets rings evenly spaced on it.

use super::chart::Allowed;
use super::keep::peak;
use crate::geom::Vector3;
use crate::spline::{TubeJet, TubeNet};

/// Samples round a section.
const ROUND: usize = 48;
/// Profile heights between two sections of the tube.
const PER_INTERVAL: usize = 3;
/// Length of an edge along the tube over the distance of the columns: 2 / sqrt(3) for equilateral triangles, and a
/// fifth more, which costs few degrees and saves triangles.
const STEP_RATIO: f64 = 1.3 * 2.0 / 1.732_050_807_568_877_2;
/// Share of the deflection for which the lattice is laid out; where the rest is not enough triangles are split.
const LAYOUT_SHARE: f64 = 0.9;
/// Distance of columns at most, in units of the mean one.
const MOST_STRETCH: f64 = 1.6;
/// Distance of columns at least, in units of the mean one: sharper bends are left to splitting.
const LEAST_STRETCH: f64 = 0.3;
/// The number of columns may be this factor larger than a row needs.
const SPARE_COLUMNS: f64 = 1.1;
/// Columns that lean more are joined otherwise, by flips.
const MOST_SHEAR: f64 = 0.5;
/// Fewest vertices of a ring.
const FEWEST: usize = 6;
/// Distance of two plain rings, in steps.
const PLAIN_STEP: f64 = 0.75;
/// Rings shorter than this many column distances end in a point.
const POINT_BELOW: f64 = 1.5;

/// What is known at one height.
#[derive(Debug, Clone)]
struct Level {
    z_mm: f64,
    /// Columns needed.
    n_columns: f64,
    /// Cumulated share of columns from u = 0, at u = j / ROUND.
    share: [f64; ROUND + 1],
    /// Steps along the tube per mm of z.
    steps_per_mm: f64,
    /// Steps up to here.
    steps: f64,
}

/// How a tube's columns and steps run along z.
#[derive(Debug, Clone)]
pub(super) struct Profile {
    levels: Vec<Level>,
}

/// A row of vertices.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Row {
    /// Where, in steps.
    pub(super) step: f64,
    /// How many.
    pub(super) n: usize,
    /// Whether every second vertex lies half a step higher.
    pub(super) is_staggered: bool,
    /// Whether it is turned by half the distance of its vertices.
    pub(super) is_turned: bool,
}

impl Profile {
    /// Measures a tube.
    pub(super) fn of(net: &TubeNet<'_>, allowed: &Allowed<'_>) -> Self {
        let sites = net.section_z_mm();
        let mut heights = Vec::with_capacity(PER_INTERVAL * sites.len());
        for pair in sites.windows(2) {
            let part = |k: usize| pair[0] + (pair[1] - pair[0]) * k as f64 / PER_INTERVAL as f64;
            heights.extend((0..PER_INTERVAL).map(part));
        }
        heights.push(sites[sites.len() - 1]);
        let mut levels: Vec<Level> = Vec::with_capacity(heights.len());
        for (i, &z_mm) in heights.iter().enumerate() {
            let near = heights[i.max(1)] - heights[i.max(1) - 1];
            let mut level = level(net, z_mm, 0.05 * near, allowed.asked.at(z_mm));
            if let Some(below) = levels.last() {
                let mean = 0.5 * (below.steps_per_mm + level.steps_per_mm);
                level.steps = below.steps + (z_mm - below.z_mm) * mean;
            }
            levels.push(level);
        }
        Self { levels }
    }

    /// Steps from end to end.
    fn steps(&self) -> f64 {
        self.levels[self.levels.len() - 1].steps
    }

    /// Levels round the given number of steps, and the share between them.
    fn between(&self, steps: f64) -> (&Level, &Level, f64) {
        let i = self.levels.partition_point(|l| l.steps <= steps).clamp(1, self.levels.len() - 1);
        let (a, b) = (&self.levels[i - 1], &self.levels[i]);
        (a, b, ((steps - a.steps) / (b.steps - a.steps).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0))
    }

    /// Height after a number of steps.
    pub(super) fn z_mm(&self, steps: f64) -> f64 {
        let (a, b, t) = self.between(steps);
        a.z_mm + (b.z_mm - a.z_mm) * t
    }

    fn n_columns(&self, steps: f64) -> f64 {
        let (a, b, t) = self.between(steps);
        a.n_columns + (b.n_columns - a.n_columns) * t
    }

    /// Whether the bottom and the top ring are so small that they are a point.
    pub(super) fn ends_in_points(&self) -> [bool; 2] {
        let most = self.levels.iter().map(|l| l.n_columns).fold(0.0, f64::max);
        let is_point = |l: &Level| l.n_columns < POINT_BELOW && l.n_columns < 0.1 * most;
        [is_point(&self.levels[0]), is_point(&self.levels[self.levels.len() - 1])]
    }

    /// Parameter u of a share of the columns after a number of steps.
    pub(super) fn u(&self, steps: f64, share: f64) -> f64 {
        let (a, b, t) = self.between(steps);
        let at = |j: usize| a.share[j] + (b.share[j] - a.share[j]) * t;
        let (mut low, mut high) = (0, ROUND);
        while high - low > 1 {
            let middle = usize::midpoint(low, high);
            if at(middle) <= share { low = middle } else { high = middle }
        }
        let part = (share - at(low)) / (at(high) - at(low)).max(f64::MIN_POSITIVE);
        (low as f64 + part) / ROUND as f64
    }

    /// Rows between the ends (those not included), given whether the ends are points.
    pub(super) fn rows(&self, points: [bool; 2]) -> Vec<Row> {
        let whole = self.steps();
        let mut rows: Vec<Row> = Vec::new();
        let mut at = 0.0;
        // Natural distance of the next row from the one before.
        let advance =
            |rows: &[Row]| if rows.last().is_some_and(|r| r.is_staggered) { 1.0 } else { PLAIN_STEP };
        let mut turned = false;
        loop {
            let zone = self.zone(at, whole);
            if zone.n_rows >= 3 {
                for _ in 0..zone.n_rows {
                    at += 1.0;
                    rows.push(Row { step: at, n: zone.n_columns, is_staggered: true, is_turned: false });
                }
                turned = false;
                if whole - at < 1.6 {
                    break;
                }
                at += 1.0;
            } else {
                if whole - at < 1.5 * PLAIN_STEP {
                    break;
                }
                at += PLAIN_STEP;
                turned = !turned;
            }
            let n = even(self.n_columns(at));
            rows.push(Row { step: at, n, is_staggered: false, is_turned: turned });
            if whole - at < 1.2 * PLAIN_STEP {
                break;
            }
        }
        if rows.is_empty() && points != [false; 2] {
            rows.push(Row { step: 0.5 * whole, n: FEWEST, is_staggered: false, is_turned: false });
            return rows;
        }
        let natural = at + advance(&rows);
        rows.iter_mut().for_each(|r| r.step *= whole / natural);
        rows
    }

    /// The longest zone above `from` that one number of columns serves.
    fn zone(&self, from: f64, whole: f64) -> Zone {
        let (mut least, mut most) = (f64::INFINITY, 0.0f64);
        let mut n_rows = 0usize;
        loop {
            let at = from + 1.0 + n_rows as f64;
            let needed = self.n_columns(at).max(FEWEST as f64);
            least = least.min(needed);
            if most.max(needed) > SPARE_COLUMNS * least + 1.0 || at + 0.9 > whole {
                return Zone { n_rows, n_columns: even(most) };
            }
            most = most.max(needed);
            n_rows += 1;
        }
    }

    /// Columns that a ring at an end needs.
    pub(super) fn end_columns(&self, top: bool) -> usize {
        let level = if top { &self.levels[self.levels.len() - 1] } else { &self.levels[0] };
        even(level.n_columns)
    }
}

struct Zone {
    n_rows: usize,
    n_columns: usize,
}

/// The least even number of vertices that is enough.
fn even(n: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of vertices")]
    let half = (0.5 * n).min(1e6).ceil() as usize;
    (2 * half).max(FEWEST)
}

fn level(net: &TubeNet<'_>, z_mm: f64, h_mm: f64, allowed_mm: f64) -> Level {
    let ring = net.ring(z_mm, h_mm);
    let bends: [Bend; ROUND] = std::array::from_fn(|j| Bend::of(&ring.jet(j as f64 / ROUND as f64)));
    let layout_mm = LAYOUT_SHARE * allowed_mm;
    let mut wanted = bends.map(|b| b.columns_per_mm(layout_mm));
    let length: f64 = bends.iter().map(|b| b.speed).sum();
    let mean =
        wanted.iter().zip(&bends).map(|(w, b)| w * b.speed).sum::<f64>() / length.max(f64::MIN_POSITIVE);
    let mean = mean.max(f64::MIN_POSITIVE);
    wanted.iter_mut().for_each(|w| *w = w.clamp(mean / MOST_STRETCH, mean / LEAST_STRETCH));
    let mut share = [0.0; ROUND + 1];
    for j in 0..ROUND {
        let piece =
            0.5 * (wanted[j] * bends[j].speed + wanted[(j + 1) % ROUND] * bends[(j + 1) % ROUND].speed);
        share[j + 1] = share[j] + piece / ROUND as f64;
    }
    let n_columns = share[ROUND];
    share.iter_mut().for_each(|s| *s /= n_columns.max(f64::MIN_POSITIVE));
    share[ROUND] = 1.0;
    // The step that suits the mean column, not the mean place, and the sharpest bend along the tube.
    let suits = wanted.iter().zip(&bends).map(|(w, b)| b.speed * b.rise * w * w).sum::<f64>()
        / wanted.iter().zip(&bends).map(|(w, b)| b.speed * w).sum::<f64>().max(f64::MIN_POSITIVE);
    let bent = bends.iter().map(|b| b.rise * (b.along.abs() / (8.0 * layout_mm)).sqrt()).fold(0.0, f64::max);
    let steps_per_mm = (suits / STEP_RATIO).max(bent);
    Level { z_mm, n_columns, share, steps_per_mm, steps: 0.0 }
}

/// Speeds and normal curvatures of a tube at a point, round it and square to that, 1/mm.
#[derive(Debug, Clone, Copy, Default)]
struct Bend {
    /// Length of the derivative along u.
    speed: f64,
    /// Length on the surface, square to the section, over the rise.
    rise: f64,
    round: f64,
    along: f64,
    twist: f64,
    /// How far a column leans to the side, over the length along the tube.
    shear: f64,
}

impl Bend {
    fn of(jet: &TubeJet) -> Self {
        let speed = jet.du.norm();
        let Some(first) = jet.du.try_normalize(1e-12) else { return Self::default() };
        let Some(normal) = jet.du.cross(&jet.dz).try_normalize(1e-12) else { return Self::default() };
        let second: Vector3 = normal.cross(&first);
        let (p, q) = (jet.dz.dot(&first), jet.dz.dot(&second));
        let round = jet.duu.dot(&normal) / (speed * speed);
        let twist = (jet.duz.dot(&normal) / speed - p * round) / q;
        let along = (jet.dzz.dot(&normal) - p * p * round - 2.0 * p * q * twist) / (q * q);
        Self { speed, rise: q.abs(), round, along, twist, shear: p / q }
    }

    /// Columns per mm that keep the deflection: sag of a lattice triangle with columns 1 mm apart, edge by edge and
    /// in its middle.
    fn columns_per_mm(&self, layout_mm: f64) -> f64 {
        let a = STEP_RATIO;
        let sag = |x: f64, y: f64| {
            let across = x + self.shear.clamp(-MOST_SHEAR, MOST_SHEAR) * y;
            (self.round * across * across + 2.0 * self.twist * across * y + self.along * y * y) / 8.0
        };
        (peak([sag(0.0, a), sag(1.0, 0.5 * a), sag(1.0, -0.5 * a)]) / layout_mm).sqrt()
    }
}
