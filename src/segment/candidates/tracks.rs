//! Round sections linked over the planes, and how much they look like a vessel.

use super::super::graph::root;
use super::super::levels::median;
use super::blobs::Blob;
use std::collections::BTreeMap;
use std::ops::Range;

/// Sections of neighbouring planes belong together where their middles lie closer than this part of the sum of
/// their radii,
const NEAR: f64 = 0.8;
/// and where their areas differ by no more than this factor.
const LIKE: f64 = 4.0;
/// Fewer planes are no vessel's course.
const LEAST_PLANES: usize = 4;
/// A vessel is longer than so many of its diameters; from there on length counts by how much of the stack it spans.
const LONG_DIAMETERS: f64 = 6.0;
/// What a dark candidate counts against a bright one.
const DARK: f64 = 0.4;
/// From the first of these levels on, HU, a bright lumen is ever less likely one; at the second it holds undiluted
/// contrast medium, or is bone or metal, and counts by so much less.
const TOO_BRIGHT_HU: [f64; 2] = [600.0, 1000.0];
const TOO_BRIGHT_COST: f64 = 0.75;
/// How much of its ellipse a section fills where it may be anything, and from where on it is as round as a pixel grid shows an
/// ellipse. Bones and gaps between organs lie below; a vessel cut lengthwise, or two that touch, between.
const FILLED: [f64; 2] = [0.85, 0.97];
/// By how much a section may reach beside its ellipse, of its radius, until it counts nothing: corners are bone's.
const MOST_CORNERS: f64 = 0.15;
/// A section less slender than this counts in full: a vessel that leans by 50 degrees.
const ROUND: f64 = 0.6;
/// An edge of so many standard deviations of the noise counts half: faint vessels stay, noise goes.
const CLEAR_STEP: f64 = 8.0;
/// So many sections a plane count in full; more are a bunch of airways, bone or veins.
const CROWD: f64 = 3.0;
/// What branching adds: less than any clear sign takes away.
const BRANCHING: f64 = 1.1;
/// How fast changes of size from plane to plane cost, against changes of course.
const SWELL_COST: f64 = 3.0;
/// One plane in so many must have several sections where a vessel branches: fewer are noise on its edge.
const BRANCHED_SHARE: usize = 8;
/// What the place of a seed costs at either end of the track against its middle.
const END_COST: f64 = 0.5;
/// A seed's section gains by its size up to so much over the typical one: beyond, it is where the vessel branches.
const SEED_SIZE: f64 = 1.2;
/// A throat is shorter than so many diameters of the vessel,
const THROAT_DIAMETERS: f64 = 2.0;
/// and the vessel goes on behind it in the same line, to this part of its diameter,
const IN_LINE: f64 = 0.5;
/// as wide as before, to this factor,
const AS_WIDE: f64 = 2.0;
/// and at the same level, to this part of the step over a pixel of its edge: the mean of a thin section holds more blur than
/// that of a wide one.
const SAME_LEVEL: f64 = 0.7;
/// Its line is told by so many of its last planes.
const LINE_PLANES: usize = 3;
/// Tracks that share one section in so many are one vessel: those of two levels of grey run in each other over much more, those of
/// two vessels that cross over less.
const SHARED_SHARE: usize = 3;

/// Sections that continue each other.
#[derive(Debug, Clone)]
pub(super) struct Track {
    /// Plane and section, ascending.
    sections: Vec<(usize, Blob)>,
    pub(super) sign: f64,
    pub(super) score: f64,
}

/// All tracks of one level.
pub(super) fn of(by_plane: &[Vec<Blob>], z_mm: &[f64], sign: f64) -> Vec<Track> {
    let all: Vec<(usize, Blob)> =
        by_plane.iter().enumerate().flat_map(|(k, blobs)| blobs.iter().map(move |b| (k, *b))).collect();
    let mut above: Vec<usize> = (0..all.len()).collect();
    let mut starts = vec![0];
    for blobs in by_plane {
        starts.push(starts[starts.len() - 1] + blobs.len());
    }
    for (a, b) in links(&all, &starts) {
        let (a, b) = (root(&mut above, a), root(&mut above, b));
        above[a.max(b)] = a.min(b);
    }
    let mut members: BTreeMap<usize, Vec<(usize, Blob)>> = BTreeMap::new();
    for (n, section) in all.iter().enumerate() {
        members.entry(root(&mut above, n)).or_default().push(*section);
    }
    members.into_values().filter_map(|sections| Track::try_new(sections, z_mm, sign)).collect()
}

/// Sections that continue each other, those of plane k being `starts[k]..starts[k + 1]`: in neighbouring planes, and over one plane
/// in which noise has spoilt the section.
fn links(all: &[(usize, Blob)], starts: &[usize]) -> Vec<(usize, usize)> {
    let pairs = |from: &Range<usize>, to: &Range<usize>| -> Vec<(usize, usize)> {
        let all_pairs = from.clone().flat_map(|a| to.clone().map(move |b| (a, b)));
        all_pairs.filter(|&(a, b)| continues(&all[a].1, &all[b].1)).collect()
    };
    let planes: Vec<Range<usize>> = starts.windows(2).map(|w| w[0]..w[1]).collect();
    let mut found: Vec<(usize, usize)> = planes.windows(2).flat_map(|w| pairs(&w[0], &w[1])).collect();
    let mut goes_on = vec![[false; 2]; all.len()];
    for &(a, b) in &found {
        (goes_on[a][1], goes_on[b][0]) = (true, true);
    }
    for w in planes.windows(3) {
        found.extend(pairs(&w[0], &w[2]).into_iter().filter(|&(a, b)| !goes_on[a][1] && !goes_on[b][0]));
    }
    found
}

fn continues(a: &Blob, b: &Blob) -> bool {
    let reach = NEAR * (a.radius_mm + b.radius_mm);
    let (dx, dy) = (a.x_mm - b.x_mm, a.y_mm - b.y_mm);
    let ratio = (a.radius_mm / b.radius_mm).powi(2);
    dx * dx + dy * dy <= reach * reach && (1.0 / LIKE..=LIKE).contains(&ratio)
}

/// Whether two sections may be of one vessel: they touch, and their areas are of a size.
fn touch(a: &Blob, b: &Blob) -> bool {
    let ratio = (a.radius_mm / b.radius_mm).powi(2);
    let apart_mm = (a.x_mm - b.x_mm).hypot(a.y_mm - b.y_mm);
    apart_mm <= a.radius_mm + b.radius_mm && (1.0 / LIKE..=LIKE).contains(&ratio)
}

impl Track {
    fn try_new(sections: Vec<(usize, Blob)>, z_mm: &[f64], sign: f64) -> Option<Self> {
        let mut track = Self { sections, sign, score: 0.0 };
        let [first, last] = track.ends();
        if last + 1 < first + LEAST_PLANES {
            return None;
        }
        let length_mm = z_mm[last] - z_mm[first];
        let whole_mm = (z_mm[z_mm.len() - 1] - z_mm[0]).max(1e-9);
        track.score = track.scored(length_mm, whole_mm);
        Some(track)
    }

    fn scored(&self, length_mm: f64, whole_mm: f64) -> f64 {
        let diameter_mm = 2.0 * self.radius_mm();
        let long = (length_mm / (LONG_DIAMETERS * diameter_mm)).min(1.0);
        let span = (length_mm / whole_mm).sqrt();
        let fill = self.mean(|b| filled(b.fill) * (1.0 - b.corners / MOST_CORNERS).clamp(0.0, 1.0));
        let round = self.mean(|b| (b.round / ROUND).min(1.0));
        let clear = self.mean(|b| b.step / (b.step + CLEAR_STEP));
        let crowd = self.sections.len() as f64 / self.n_planes() as f64;
        let single = (CROWD / crowd).min(1.0);
        let branching = if self.branches() { BRANCHING } else { 1.0 };
        let polarity = if self.sign > 0.0 { self.likely_level() } else { DARK };
        let all = long * span * fill * round * clear * single * self.smooth() * size(diameter_mm);
        (all * branching * polarity).min(1.0)
    }

    /// How little course and size change abruptly: 1 for a straight even tube.
    fn smooth(&self) -> f64 {
        let course = self.main_course();
        let (mut bend, mut swell, mut n) = (0.0, 0.0, 0.0_f64);
        for w in course.windows(3) {
            let [a, b, c] = [&w[0].1, &w[1].1, &w[2].1];
            let (dx, dy) = (a.x_mm - 2.0 * b.x_mm + c.x_mm, a.y_mm - 2.0 * b.y_mm + c.y_mm);
            bend += dx.hypot(dy) / b.radius_mm;
            swell += (b.radius_mm / c.radius_mm).ln().abs();
            n += 1.0;
        }
        let n = n.max(1.0);
        1.0 / (1.0 + bend / n) * (-SWELL_COST * swell / n).exp()
    }

    /// The largest section of every plane.
    fn main_course(&self) -> Vec<(usize, Blob)> {
        let mut largest: BTreeMap<usize, Blob> = BTreeMap::new();
        for (k, blob) in &self.sections {
            let known = largest.entry(*k).or_insert(*blob);
            if blob.radius_mm > known.radius_mm {
                *known = *blob;
            }
        }
        largest.into_iter().collect()
    }

    fn mean(&self, of: impl Fn(&Blob) -> f64) -> f64 {
        self.sections.iter().map(|(_, b)| of(b)).sum::<f64>() / self.sections.len() as f64
    }

    fn n_planes(&self) -> usize {
        self.sections.chunk_by(|a, b| a.0 == b.0).count()
    }

    /// The first and the last plane.
    pub(super) fn ends(&self) -> [usize; 2] {
        let end = |s: Option<&(usize, Blob)>| s.map_or(0, |(k, _)| *k);
        [end(self.sections.first()), end(self.sections.last())]
    }

    /// Of the median section.
    pub(super) fn radius_mm(&self) -> f64 {
        self.median(|b| b.radius_mm)
    }

    fn median(&self, of: impl Fn(&Blob) -> f64) -> f64 {
        median(self.sections.iter().map(|(_, b)| of(b)).collect()).unwrap_or(0.0)
    }

    /// How likely a bright lumen has this level.
    fn likely_level(&self) -> f64 {
        let level_hu = self.median(|b| b.level_hu);
        let [first, last] = TOO_BRIGHT_HU;
        1.0 - TOO_BRIGHT_COST * ((level_hu - first) / (last - first)).clamp(0.0, 1.0)
    }

    /// Whether some planes have one section and a good part of them two or more.
    pub(super) fn branches(&self) -> bool {
        let several = self.sections.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() > 1).count();
        let n = self.n_planes();
        BRANCHED_SHARE * several >= n && several < n
    }

    /// The section to grow from: round, of full size, with a clear edge, away from the ends.
    pub(super) fn seed(&self) -> (usize, Blob) {
        let [first, last] = self.ends();
        let (middle, half) = (0.5 * (first + last) as f64, (0.5 * (last - first) as f64).max(1.0));
        let typical_mm = self.radius_mm();
        let worth = |(k, b): &(usize, Blob)| {
            let central = 1.0 - END_COST * (*k as f64 - middle).abs() / half;
            b.fill * b.round * (b.radius_mm / typical_mm).min(SEED_SIZE) * central
        };
        let best = self.sections.iter().max_by(|a, b| worth(a).total_cmp(&worth(b)));
        *best.expect("a track has sections in several planes")
    }

    /// Whether the other one goes on, upward or downward, where this one ends: their ends lie within `gap_mm` of each
    /// other, and the sections there touch and are of a size; found at different levels, they may overlap by as much.
    pub(super) fn goes_on_in(&self, other: &Self, upward: bool, z_mm: &[f64], gap_mm: f64) -> bool {
        let (low, high) = if upward { (self, other) } else { (other, self) };
        let [end, start] = [low.ends()[1], high.ends()[0]];
        let is_beyond = high.ends()[1] > end && low.ends()[0] < start;
        let is_near = self.sign == other.sign && is_beyond && (z_mm[start] - z_mm[end]).abs() <= gap_mm;
        is_near && low.at(end.min(start)).any(|a| high.at(start).any(|b| touch(a, b)))
    }

    /// Whether the other one is this vessel again, above a throat too thin to show as a round section: it begins within
    /// some diameters of where this one ends, in the same line, as wide and at the same level.
    pub(super) fn resumes_in(&self, other: &Self, z_mm: &[f64]) -> bool {
        let ([_, end], [start, _]) = (self.ends(), other.ends());
        let diameter_mm = self.radius_mm() + other.radius_mm();
        if self.sign != other.sign || start <= end || z_mm[start] - z_mm[end] > THROAT_DIAMETERS * diameter_mm
        {
            return false;
        }
        let middle_mm = 0.5 * (z_mm[end] + z_mm[start]);
        let (below, above) = (self.main_course(), other.main_course());
        let below = &below[below.len().saturating_sub(LINE_PLANES)..];
        let [ax, ay] = extrapolated(below, z_mm, middle_mm);
        let [bx, by] = extrapolated(&above[..LINE_PLANES.min(above.len())], z_mm, middle_mm);
        let width = self.radius_mm() / other.radius_mm();
        let differ_hu = (self.median(|b| b.level_hu) - other.median(|b| b.level_hu)).abs();
        let step_hu = self.median(|b| b.step_hu).min(other.median(|b| b.step_hu));
        (ax - bx).hypot(ay - by) <= IN_LINE * diameter_mm
            && (1.0 / AS_WIDE..=AS_WIDE).contains(&width)
            && differ_hu <= SAME_LEVEL * step_hu
    }

    fn at(&self, plane: usize) -> impl Iterator<Item = &Blob> {
        self.sections.iter().filter(move |(k, _)| *k == plane).map(|(_, b)| b)
    }

    /// Tracks of one vessel as one.
    pub(super) fn of_parts(parts: &[&Self], z_mm: &[f64]) -> Option<Self> {
        let mut sections: Vec<(usize, Blob)> =
            parts.iter().flat_map(|t| t.sections.iter().copied()).collect();
        sections.sort_by_key(|(k, _)| *k);
        let whole = Self::try_new(sections, z_mm, parts.first()?.sign)?;
        // A whole is no less a vessel than its best part.
        let score = parts.iter().map(|t| t.score).fold(whole.score, f64::max);
        Some(Self { score, ..whole })
    }

    /// Whether two tracks run in each other over a good part of the shorter one.
    pub(super) fn is_same_vessel(&self, other: &Self) -> bool {
        let (a, b) = if self.sections.len() >= other.sections.len() { (self, other) } else { (other, self) };
        let inside = |(k, p): &&(usize, Blob)| {
            let start = a.sections.partition_point(|(l, _)| l < k);
            a.sections[start..]
                .iter()
                .take_while(|(l, _)| l == k)
                .any(|(_, q)| (p.x_mm - q.x_mm).hypot(p.y_mm - q.y_mm) < p.radius_mm.max(q.radius_mm))
        };
        SHARED_SHARE * b.sections.iter().filter(inside).count() >= b.sections.len()
    }
}

/// Where the middle of a course lies at a height, by the straight line of least squares through these planes.
fn extrapolated(course: &[(usize, Blob)], z_mm: &[f64], at_mm: f64) -> [f64; 2] {
    let n = course.len() as f64;
    let mean = |of: &dyn Fn(&(usize, Blob)) -> f64| course.iter().map(of).sum::<f64>() / n;
    let mean_z = mean(&|(k, _)| z_mm[*k]);
    let spread = mean(&|(k, _)| (z_mm[*k] - mean_z).powi(2)).max(1e-12);
    let line = |of: fn(&Blob) -> f64| {
        let slope = mean(&|(k, b)| (z_mm[*k] - mean_z) * of(b)) / spread;
        mean(&|(_, b)| of(b)) + slope * (at_mm - mean_z)
    };
    [line(|b| b.x_mm), line(|b| b.y_mm)]
}

/// How well a section fills its ellipse, 0 to 1.
fn filled(fill: f64) -> f64 {
    let [least, full] = FILLED;
    ((fill - least) / (full - least)).clamp(0.0, 1.0)
}

/// Vessels that are printed: from 2 to 30 mm, less likely down to 1 and up to 50 mm.
fn size(diameter_mm: f64) -> f64 {
    (diameter_mm - 1.0).clamp(0.0, 1.0) * ((50.0 - diameter_mm) / 20.0).clamp(0.0, 1.0)
}
