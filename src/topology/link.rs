//! Which components of neighbouring planes belong together.
//!
//! Two things speak for it: that they overlap, and that they do after the branch was moved on by its drift. The
//! drift is known where a branch was followed over one or two planes, from below or from above; both are asked, so
//! that the answer is the same when the stack is turned over. Where both agree the pair is linked or not; a contour
//! that neither overlaps anything nor has a drift is followed by a course that the next plane confirms.
//!
//! | overlap | overlap after drift | the pair is |
//! |---|---|---|
//! | 15 % or more | 10 % or more, or not known | linked |
//! | 15 % or more | less | not linked where the drift of a leaning neighbour explains it; else linked, or asked |
//! | less | 30 % or more | linked: a steep branch |
//! | a sliver, neither overlaps anything else | any | linked: nothing else explains either |
//! | a sliver | less than 10 % | not linked: neighbours, one of which begins or ends |
//! | a sliver | between, or not known | asked where a birth or death depends on it |
//!
//! The numbers follow what analytic vessels showed: the least true overlap was 0.06, on a branch 60 degrees off the
//! axis, and 0.98 after its drift.

use super::overlap::Component;
use crate::geom::Vector2;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Overlap from which no more is asked unless the drift of both sides leads elsewhere.
const SURE: f64 = 0.5;
/// Overlap from which a pair without contrary evidence is linked.
const STRONG: f64 = 0.15;
/// Overlap below which contours only touch.
const LEAST: f64 = 0.03;
/// Overlap after drift that makes a link of a sliver, or of no overlap at all.
const DRIFT_OF_SLIVER: f64 = 0.3;
const DRIFT_ALONE: f64 = 0.4;
/// Overlap after drift below which the drift leads elsewhere.
const DRIFT_AGAINST: f64 = 0.1;
/// Overlap after drift with what a branch goes on in, from which its drift explains all that it does.
const DRIFT_PROVEN: f64 = 0.8;
/// Overlap on the next plane that confirms a course, and what the second best course may reach.
const COURSE: f64 = 0.5;
const SECOND_COURSE: f64 = 0.3;
/// Areas of one branch on neighbouring planes differ by less than this factor, where nothing else speaks for it.
pub(super) const MOST_GROWTH: f64 = 4.0;
/// Steepest course that is looked for, sideways over upward (75 degrees), beyond one radius.
const STEEPEST: f64 = 3.7;
/// Planes closer together than this share of the interval that a component is to be moved over tell no drift.
const CLOSE_PLANES: f64 = 0.2;
/// Rounds in which links found by drift help to find further ones.
const ROUNDS: usize = 3;

/// Why a pair was linked, or not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Cause {
    Overlap,
    Drift,
    Course,
    Opens,
    Operator,
    /// The other way round: what spoke against it.
    Elsewhere,
    Sliver,
}

/// A pair that was looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair {
    pub(super) lower: usize,
    pub(super) upper: usize,
    pub(super) overlap: f64,
    pub(super) drifted: Option<f64>,
    pub(super) cause: Cause,
    pub(super) joined: bool,
    /// What contradicts itself, where somebody has to be asked; `joined` then holds the rule's answer.
    pub(super) doubt: Option<&'static str>,
}

/// Decisions of the operator: (interval, lower, upper) and whether they are joined.
pub(super) type Forced = BTreeMap<(usize, usize, usize), bool>;

/// The components of one kind on all planes.
pub(super) struct Layers<'a> {
    pub(super) z_mm: Vec<f64>,
    pub(super) components: Vec<&'a [Component]>,
    pub(super) forced: Forced,
}

/// Where a branch comes from or goes to, where that is one component and no doubt about it.
struct Tracks {
    below: Vec<Vec<Option<usize>>>,
    above: Vec<Vec<Option<usize>>>,
}

/// Overlaps of an interval: lower, upper, share.
type Overlaps = Vec<(usize, usize, f64)>;

/// Decides on all pairs, interval by interval.
pub(super) fn link(layers: &Layers<'_>) -> Vec<Vec<Pair>> {
    let n_intervals = layers.components.len().saturating_sub(1);
    let overlaps: Vec<Overlaps> = (0..n_intervals).into_par_iter().map(|k| layers.overlaps(k)).collect();
    let mut tracks = layers.tracks(&overlaps);
    let mut pairs: Vec<Vec<Pair>> = Vec::new();
    for round in 0..ROUNDS {
        let decide = |k: usize| layers.decided(k, &overlaps[k], &tracks);
        let mut next: Vec<Vec<Pair>> = (0..n_intervals).into_par_iter().map(decide).collect();
        let found: Vec<Vec<Pair>> =
            (0..n_intervals).into_par_iter().map(|k| layers.courses(k, &next, &tracks)).collect();
        for (known, more) in next.iter_mut().zip(found) {
            known.extend(more);
        }
        let settled = pairs == next;
        pairs = next;
        if settled || round + 1 == ROUNDS || !layers.follow(&pairs, &mut tracks) {
            break;
        }
    }
    for interval in &mut pairs {
        interval.sort_by_key(|p| (p.lower, p.upper));
    }
    pairs
}

impl Layers<'_> {
    fn overlaps(&self, k: usize) -> Overlaps {
        let (lowers, uppers) = (self.components[k], self.components[k + 1]);
        let all = (0..lowers.len()).flat_map(|i| (0..uppers.len()).map(move |j| (i, j)));
        let share = |(i, j): (usize, usize)| (i, j, lowers[i].shared(Vector2::zeros(), &uppers[j]));
        all.filter(|&(i, j)| lowers[i].bounds.meets(uppers[j].bounds))
            .map(share)
            .filter(|o| o.2 > 1e-9)
            .collect()
    }

    fn dz(&self, k: usize) -> f64 {
        self.z_mm[k + 1] - self.z_mm[k]
    }

    fn similar(&self, k: usize, i: usize, l: usize, j: usize) -> bool {
        let ratio = self.components[k][i].area_mm2 / self.components[l][j].area_mm2;
        (1.0 / MOST_GROWTH..=MOST_GROWTH).contains(&ratio)
    }

    /// Pairs that are each other's best by far, the best ones first: what is followed already is no rival any more.
    /// Measured by the shared area over the joined one, so that a trunk goes on as a trunk and not as the small branch
    /// that lies where it was.
    fn tracks(&self, overlaps: &[Overlaps]) -> Tracks {
        let none = || self.components.iter().map(|c| vec![None; c.len()]).collect();
        let mut tracks = Tracks { below: none(), above: none() };
        for (k, pairs) in overlaps.iter().enumerate() {
            let mut ranked: Vec<(usize, usize, f64)> = pairs
                .iter()
                .filter(|p| p.2 >= LEAST && (p.2 >= SURE || self.similar(k, p.0, k + 1, p.1)))
                .map(|&(i, j, share)| {
                    let (a, b) = (self.components[k][i].area_mm2, self.components[k + 1][j].area_mm2);
                    let both = share * a.min(b);
                    (i, j, both / (a + b - both))
                })
                .collect();
            ranked.sort_by(|a, b| b.2.total_cmp(&a.2));
            for at in 0..ranked.len() {
                let (i, j, share) = ranked[at];
                let (above, below) = (&tracks.above[k], &tracks.below[k + 1]);
                let taken = |p: &(usize, usize, f64)| above[p.0].is_some() || below[p.1].is_some();
                let rivals = ranked.iter().filter(|p| ((p.0 == i) != (p.1 == j)) && !taken(p));
                if !taken(&ranked[at]) && rivals.map(|p| p.2).fold(0.0, f64::max) < 0.5 * share {
                    tracks.above[k][i] = Some(j);
                    tracks.below[k + 1][j] = Some(i);
                }
            }
        }
        tracks
    }

    /// Adds what was found by drift or course to the tracks; whether there was anything new.
    fn follow(&self, pairs: &[Vec<Pair>], tracks: &mut Tracks) -> bool {
        let mut is_new = false;
        for (k, pairs) in pairs.iter().enumerate() {
            for pair in pairs.iter().filter(|p| p.joined && p.overlap < LEAST) {
                let alone = |p: &&Pair| p.joined && (p.lower == pair.lower || p.upper == pair.upper);
                if pairs.iter().filter(alone).count() == 1 && tracks.above[k][pair.lower].is_none() {
                    tracks.above[k][pair.lower] = Some(pair.upper);
                    tracks.below[k + 1][pair.upper] = Some(pair.lower);
                    is_new = true;
                }
            }
        }
        is_new
    }

    /// Where the drift from below would move component i of plane k by plane k + 1: at constant speed, and with
    /// the speed's change carried on.
    fn shifts_up(&self, k: usize, i: usize, tracks: &Tracks) -> Vec<Vector2> {
        let before = |(k, i): (usize, usize)| k.checked_sub(1).and_then(|b| Some((b, tracks.below[k][i]?)));
        self.shifts((k, i), before, self.dz(k))
    }

    /// The same downward, from plane k + 1.
    fn shifts_down(&self, k: usize, j: usize, tracks: &Tracks) -> Vec<Vector2> {
        let after = |(k, i): (usize, usize)| Some((k + 1, (*tracks.above.get(k)?.get(i)?)?));
        self.shifts((k + 1, j), after, -self.dz(k))
    }

    /// The shifts of a component over `dz` from where it `came` from, plane by plane. Planes much closer together than that
    /// say nothing of a drift: noise between them would be taken for one.
    fn shifts(
        &self,
        at: (usize, usize),
        came: impl Fn((usize, usize)) -> Option<(usize, usize)>,
        dz: f64,
    ) -> Vec<Vector2> {
        let (k, _) = at;
        let centre = |(k, i): (usize, usize)| self.components[k][i].centre;
        let far = |from: (usize, usize)| {
            let is_far =
                |to: &(usize, usize)| (self.z_mm[to.0] - self.z_mm[from.0]).abs() >= CLOSE_PLANES * dz.abs();
            std::iter::successors(came(from), |to| came(*to)).find(is_far)
        };
        let speed = |a: (usize, usize), b: (usize, usize)| {
            (centre(b) - centre(a)) / (self.z_mm[b.0] - self.z_mm[a.0])
        };
        let Some(first) = far(at) else { return Vec::new() };
        let v1 = speed(first, at);
        let mut shifts = vec![v1 * dz];
        if let Some(second) = far(first) {
            let v0 = speed(second, first);
            let middle = 0.5 * (self.z_mm[k] - self.z_mm[second.0]);
            let change = (v1 - v0) / middle;
            let ahead = 0.5 * (self.z_mm[k] - self.z_mm[first.0] + dz);
            shifts.push((v1 + change * ahead) * dz);
        }
        shifts
    }

    /// Overlap after drift, the best of what both sides say; `None` where neither has a drift.
    fn drifted(&self, k: usize, i: usize, j: usize, tracks: &Tracks) -> Option<f64> {
        let (lower, upper) = (&self.components[k][i], &self.components[k + 1][j]);
        let up = self.shifts_up(k, i, tracks).into_iter().map(|s| lower.shared(s, upper));
        let down = self.shifts_down(k, j, tracks).into_iter().map(|s| upper.shared(s, lower));
        up.chain(down).reduce(f64::max)
    }

    /// Whether the drift, as far as it is known, leads from the one to about the other.
    fn drift_agrees(&self, k: usize, i: usize, j: usize, tracks: &Tracks) -> bool {
        let (lower, upper) = (&self.components[k][i], &self.components[k + 1][j]);
        let way = upper.centre - lower.centre;
        let reach = lower.radius_mm().max(upper.radius_mm());
        let up = self.shifts_up(k, i, tracks);
        let down = self.shifts_down(k, j, tracks);
        (up.is_empty() && down.is_empty())
            || up.iter().any(|s| (s - way).norm() < reach)
            || down.iter().any(|s| (s + way).norm() < reach)
    }

    fn decided(&self, k: usize, overlaps: &Overlaps, tracks: &Tracks) -> Vec<Pair> {
        let rival = |i: usize, j: usize| {
            let best = |same: &dyn Fn(&(usize, usize, f64)) -> bool| {
                overlaps.iter().filter(|p| same(p)).map(|p| p.2).fold(0.0, f64::max)
            };
            [best(&|p| p.0 == i && p.1 != j), best(&|p| p.0 != i && p.1 == j)]
        };
        let mut pairs: Vec<Pair> = overlaps
            .iter()
            .filter(|p| p.2 >= LEAST)
            .map(|&(i, j, share)| self.judged(k, (i, j), share, rival(i, j), tracks))
            .collect();
        self.add_drifted(k, overlaps, tracks, &mut pairs);
        self.force(k, &mut pairs);
        pairs
    }

    /// Decides on a pair that overlaps; `rivals`: the best overlap that either has with another one.
    fn judged(
        &self,
        k: usize,
        (i, j): (usize, usize),
        overlap: f64,
        rivals: [f64; 2],
        tracks: &Tracks,
    ) -> Pair {
        let pair = |joined, cause, drifted, doubt| Pair {
            lower: i,
            upper: j,
            overlap,
            drifted,
            cause,
            joined,
            doubt,
        };
        let alone = rivals.iter().all(|r| *r < LEAST);
        if overlap >= SURE && alone && self.drift_agrees(k, i, j, tracks) {
            return pair(true, Cause::Overlap, None, None);
        }
        let drifted = self.drifted(k, i, j, tracks);
        let both_have_others = rivals.iter().all(|r| *r >= STRONG);
        let one_has_others = rivals.iter().any(|r| *r >= STRONG);
        let against = drifted.is_some_and(|d| d < DRIFT_AGAINST);
        if overlap >= STRONG {
            let surely_others = rivals.iter().all(|r| *r >= SURE);
            let is_sliver = overlap < 2.0 * STRONG || self.is_explained(k, i, j, tracks);
            return if overlap < SURE && surely_others && against {
                pair(false, Cause::Elsewhere, drifted, None)
            } else if one_has_others && against && is_sliver {
                pair(false, Cause::Sliver, drifted, None)
            } else if one_has_others && against && self.both_drift(k, i, j, tracks) {
                pair(
                    true,
                    Cause::Overlap,
                    drifted,
                    Some("they overlap, but the drift of both leads elsewhere"),
                )
            } else {
                pair(true, Cause::Overlap, drifted, None)
            };
        }
        match drifted {
            Some(d) if d >= DRIFT_OF_SLIVER => pair(true, Cause::Drift, drifted, None),
            _ if both_have_others => pair(false, Cause::Elsewhere, drifted, None),
            _ if !one_has_others => pair(true, Cause::Overlap, drifted, None),
            Some(d) if d < DRIFT_AGAINST => pair(false, Cause::Sliver, drifted, None),
            Some(_) => pair(
                false,
                Cause::Sliver,
                drifted,
                Some("they hardly overlap, after their drift a little more"),
            ),
            None => pair(true, Cause::Overlap, drifted, Some("they hardly overlap, and no drift is known")),
        }
    }

    /// Whether the one that goes on elsewhere follows its drift there so well that its overlap with this one says
    /// nothing: a leaning trunk covers, plane by plane, what lies beside it.
    fn is_explained(&self, k: usize, i: usize, j: usize, tracks: &Tracks) -> bool {
        let follows =
            |from: usize, to: usize| self.drifted(k, from, to, tracks).is_some_and(|d| d >= DRIFT_PROVEN);
        let by_lower = tracks.above[k][i].is_some_and(|to| to != j && follows(i, to));
        let by_upper = tracks.below[k + 1][j].is_some_and(|from| from != i && follows(from, j));
        (by_lower && by_upper) || ((by_lower || by_upper) && self.both_drift(k, i, j, tracks))
    }

    fn both_drift(&self, k: usize, i: usize, j: usize, tracks: &Tracks) -> bool {
        !self.shifts_up(k, i, tracks).is_empty() && !self.shifts_down(k, j, tracks).is_empty()
    }

    /// Links what overlaps with nothing, by drift alone; the best partner only.
    fn add_drifted(&self, k: usize, overlaps: &Overlaps, tracks: &Tracks, pairs: &mut Vec<Pair>) {
        let (n, m) = (self.components[k].len(), self.components[k + 1].len());
        let open_lower: Vec<bool> = (0..n).map(|i| !pairs.iter().any(|p| p.joined && p.lower == i)).collect();
        let open_upper: Vec<bool> = (0..m).map(|j| !pairs.iter().any(|p| p.joined && p.upper == j)).collect();
        let mut found: Vec<(usize, usize, f64)> = Vec::new();
        for (i, &is_open) in open_lower.iter().enumerate() {
            for j in (0..m).filter(|&j| is_open || open_upper[j]) {
                let known = pairs.iter().any(|p| p.lower == i && p.upper == j);
                let drifted = if known { None } else { self.drifted(k, i, j, tracks) };
                found.extend(drifted.filter(|d| *d >= DRIFT_ALONE).map(|d| (i, j, d)));
            }
        }
        let best = |&(i, j, d): &(usize, usize, f64)| {
            let beaten = |same: bool, e: f64| same && e > d;
            let by_lower = open_lower[i] && !found.iter().any(|f| beaten(f.0 == i, f.2));
            let by_upper = open_upper[j] && !found.iter().any(|f| beaten(f.1 == j, f.2));
            by_lower || by_upper
        };
        let overlap =
            |i: usize, j: usize| overlaps.iter().find(|o| o.0 == i && o.1 == j).map_or(0.0, |o| o.2);
        pairs.extend(found.iter().filter(|f| best(f)).map(|&(i, j, d)| Pair {
            lower: i,
            upper: j,
            overlap: overlap(i, j),
            drifted: Some(d),
            cause: Cause::Drift,
            joined: true,
            doubt: None,
        }));
    }

    /// Puts the operator's decisions in the place of the rules'.
    fn force(&self, k: usize, pairs: &mut Vec<Pair>) {
        for (&(_, lower, upper), &joined) in self.forced.range((k, 0, 0)..=(k, usize::MAX, usize::MAX)) {
            let known = pairs.iter().position(|p| p.lower == lower && p.upper == upper);
            let before = known.map(|at| pairs.remove(at));
            pairs.push(Pair {
                lower,
                upper,
                overlap: before.map_or(0.0, |p| p.overlap),
                drifted: before.and_then(|p| p.drifted),
                cause: Cause::Operator,
                joined,
                doubt: None,
            });
        }
    }

    /// Pairs of contours that nothing links and that have no drift: a course from the one to the other that leads
    /// on to a third one on the plane beyond.
    fn courses(&self, k: usize, pairs: &[Vec<Pair>], tracks: &Tracks) -> Vec<Pair> {
        let open_above = |k: usize, i: usize| !pairs[k].iter().any(|p| p.joined && p.lower == i);
        let open_below = |k: usize, j: usize| !pairs[k].iter().any(|p| p.joined && p.upper == j);
        let lowers: Vec<usize> = (0..self.components[k].len()).filter(|&i| open_above(k, i)).collect();
        let uppers: Vec<usize> = (0..self.components[k + 1].len()).filter(|&j| open_below(k, j)).collect();
        let mut found: Vec<(usize, usize, f64)> = Vec::new();
        for &i in &lowers {
            for &j in &uppers {
                let (lower, upper) = (&self.components[k][i], &self.components[k + 1][j]);
                let way = upper.centre - lower.centre;
                let reach = STEEPEST * self.dz(k) + lower.radius_mm().max(upper.radius_mm());
                let forbidden = self.forced.contains_key(&(k, i, j));
                if forbidden || way.norm() > reach || !self.similar(k, i, k + 1, j) {
                    continue;
                }
                let mut score: f64 = 0.0;
                if k > 0 && tracks.below[k][i].is_none() {
                    let on = way * (self.dz(k - 1) / self.dz(k));
                    let befores = (0..self.components[k - 1].len()).filter(|&p| open_above(k - 1, p));
                    let befores = befores.filter(|&p| self.similar(k - 1, p, k, i));
                    score =
                        befores.map(|p| self.components[k - 1][p].shared(on, lower)).fold(score, f64::max);
                }
                if k + 2 < self.components.len() && tracks.above[k + 1][j].is_none() {
                    let on = way * (-self.dz(k + 1) / self.dz(k));
                    let afters = (0..self.components[k + 2].len()).filter(|&q| open_below(k + 1, q));
                    let afters = afters.filter(|&q| self.similar(k + 1, j, k + 2, q));
                    score = afters.map(|q| self.components[k + 2][q].shared(on, upper)).fold(score, f64::max);
                }
                found.push((i, j, score));
            }
        }
        let clear = |&&(i, j, score): &&(usize, usize, f64)| {
            let second = found.iter().filter(|f| (f.0 == i) != (f.1 == j)).map(|f| f.2).fold(0.0, f64::max);
            score >= COURSE && second < SECOND_COURSE
        };
        let pair = |&(lower, upper, score): &(usize, usize, f64)| Pair {
            lower,
            upper,
            overlap: 0.0,
            drifted: Some(score),
            cause: Cause::Course,
            joined: true,
            doubt: None,
        };
        found.iter().filter(clear).map(pair).collect()
    }
}
