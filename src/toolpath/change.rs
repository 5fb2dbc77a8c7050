//! Where the number of beads under a skin changes.
//!
//! At a change from n to n + 1 beads from each skin to the middle of a wall, the two new beads, one from either side, are one
//! path that turns back there: a half circle about the middle of the wall. Beside it the n others give up, of the depth that
//! they fill, as much as the turn takes: what is left to them is the disc between the skin and the circle of the turn, so their
//! middle runs along a parabola. What no bead reaches is the cusp between those from both sides, in front of the turn; they go
//! on by [`OVER_MM`] so that it is small, and reach over the turn by as little. Both skins change at the same place.
//!
//! A bead that ends alone, as it has no other to turn into or where two beads become one, has a round end, and the others give
//! up what that takes in the same way.
//!
//! Not so where more than one bead begins at once, or a raster: beads end bluntly there.

use super::fill::{FillParams, Way};
use super::skin::{Contact, Sample, Skins};
use crate::geom::distance::nearest_on_segment;
use crate::geom::{Point2, Vector2};

/// How much later than their discs touch a turn the beads beside it give way, mm: more leaves a smaller gap in front of the
/// turn and overlaps more.
const OVER_MM: f64 = 0.05;
/// Beads give way over no shorter a length than this, mm: the narrowest do so at once.
const LEAST_LENGTH_MM: f64 = 0.06;
/// Steps in which beads give way.
const N_STEPS: u32 = 6;
/// The two skins of a wall may see a change so far apart, mm.
const APART_MM: f64 = 1.5;

/// How the run of the innermost bead ends at a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
    /// Drawn back, so that its round end keeps off what lies beyond.
    Blunt,
    /// With its round end, for which the others make room.
    Round,
    /// Where it turns into the bead from the other side.
    Turn(usize),
}

/// A sample of a skin, and how the material under it is filled.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spot {
    pub(super) sample: Sample,
    pub(super) way: Way,
    /// What of the depth the end of a bead takes, mm.
    pub(super) taken_mm: f64,
    /// How the innermost bead ends if the spot before, the spot behind has fewer.
    pub(super) ends: [End; 2],
}

/// Towards which spot there are fewer beads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Before,
    Behind,
}

impl Side {
    const fn other(self) -> Self {
        match self {
            Self::Before => Self::Behind,
            Self::Behind => Self::Before,
        }
    }

    /// The neighbour of a place in a ring of `n`.
    const fn step(self, i: usize, n: usize) -> usize {
        match self {
            Self::Before => (i + n - 1) % n,
            Self::Behind => (i + 1) % n,
        }
    }
}

/// A place where the number of beads falls by one.
#[derive(Debug, Clone, Copy)]
struct Change {
    skin: usize,
    /// The last spot with more beads.
    spot: usize,
    side: Side,
    more: Way,
    fewer: Way,
}

/// The spots of all skins, with the changes of the number of beads in their places.
pub(super) fn spots(skins: &Skins, ways: &[Vec<Way>], params: &FillParams) -> Vec<Vec<Spot>> {
    let spot = |(&sample, &way): (&Sample, &Way)| Spot { sample, way, taken_mm: 0.0, ends: [End::Blunt; 2] };
    let spots = skins.skins.iter().zip(ways).map(|(s, w)| s.samples.iter().zip(w).map(spot).collect());
    let mut rings = Rings { spots: spots.collect(), params, n_turns: 0 };
    if ways.iter().any(|ways| ways.windows(2).any(|w| w[0] != w[1])) {
        (0..rings.spots.len()).for_each(|skin| rings.settle(skin));
        (0..rings.spots.len()).for_each(|skin| rings.give_way(skin));
    }
    rings.spots
}

struct Rings<'a> {
    spots: Vec<Vec<Spot>>,
    params: &'a FillParams,
    n_turns: usize,
}

impl Rings<'_> {
    /// Gives all changes along a skin their ends.
    fn settle(&mut self, skin: usize) {
        while let Some(change) = self.unsettled(skin) {
            // Marked first, so that the other skin of the wall, which may be the same, does not move it.
            *self.end_mut(&change) = End::Round;
            if let Some(opposite) = self.opposite(&change) {
                *self.end_mut(&change) = End::Turn(self.n_turns);
                self.move_to(opposite, &change);
                self.n_turns += 1;
            }
        }
    }

    fn unsettled(&self, skin: usize) -> Option<Change> {
        self.changes(skin).find(|c| *self.end(c) == End::Blunt)
    }

    /// Where the number of beads falls by one along a skin.
    fn changes(&self, skin: usize) -> impl Iterator<Item = Change> + '_ {
        let spots = &self.spots[skin];
        let change = move |(spot, side): (usize, Side)| {
            let (more, fewer) = (spots[spot].way, spots[side.step(spot, spots.len())].way);
            let is_one = match (more, fewer) {
                (Way::Beads(more), Way::Beads(fewer)) => more == fewer + 1,
                (Way::Beads(more), Way::Single) => more == 1,
                _ => false,
            };
            is_one.then_some(Change { skin, spot, side, more, fewer })
        };
        (0..spots.len()).flat_map(|i| [(i, Side::Before), (i, Side::Behind)]).filter_map(change)
    }

    fn end(&self, change: &Change) -> &End {
        &self.spots[change.skin][change.spot].ends[change.side as usize]
    }

    fn end_mut(&mut self, change: &Change) -> &mut End {
        &mut self.spots[change.skin][change.spot].ends[change.side as usize]
    }

    /// The same change across the wall, where that has a place there.
    fn opposite(&self, change: &Change) -> Option<Opposite> {
        let s = &self.spots[change.skin][change.spot].sample;
        let Contact::Wall { contour_idx: skin, edge_idx, at } = s.contact else { return None };
        if s.sharp {
            return None;
        }
        let spots = &self.spots[skin];
        let n = spots.len();
        // From the last spot before the touched edge to the first beyond it.
        let first = spots.partition_point(|o| o.sample.edge_idx < edge_idx) + n - 1;
        let last = spots.partition_point(|o| o.sample.edge_idx <= edge_idx) + n;
        let foot = |i: usize| {
            let (a, b) = (spots[i % n].sample.at, spots[(i + 1) % n].sample.at);
            (nearest_on_segment(at, a, b) - at).norm()
        };
        let before = (first..last).min_by(|&a, &b| foot(a).total_cmp(&foot(b)))? % n;
        let middle = s.at + s.inward * s.depth_mm;
        let radius = (middle - at).norm();
        let sample = Sample {
            at,
            inward: (middle - at) / radius.max(1e-9),
            share_mm: 0.0,
            depth_mm: radius,
            wall_mm: radius,
            contact: Contact::Wall { contour_idx: change.skin, edge_idx: s.edge_idx, at: s.at },
            edge_idx: spots[before].sample.edge_idx,
            sharp: false,
        };
        // The skins of a wall run in opposite directions.
        let side = change.side.other();
        let beyond = |from: Side| if from == Side::Behind { (before + 1) % n } else { before };
        let reset = [
            self.passed(skin, beyond(side), side, [change.more, change.fewer], &sample)?,
            self.passed(skin, beyond(side.other()), side.other(), [change.fewer, change.more], &sample)?,
        ];
        Some(Opposite { skin, before, reset, sample })
    }

    /// The spots on one side of a place that are filled in the first way and are to be in the second, as those beyond them are.
    fn passed(
        &self,
        skin: usize,
        first: usize,
        side: Side,
        [from, to]: [Way; 2],
        place: &Sample,
    ) -> Option<Vec<usize>> {
        let spots = &self.spots[skin];
        let mut passed = Vec::new();
        let mut i = first;
        while spots[i].way == from && passed.len() < spots.len() {
            let s = &spots[i].sample;
            let is_near = (s.at - place.at).norm() < APART_MM && place.is_about_as_deep(s);
            if !is_near || spots[i].ends != [End::Blunt; 2] {
                return None;
            }
            passed.push(i);
            i = side.step(i, spots.len());
        }
        let is_settled = spots[i].ends[side.other() as usize] != End::Blunt;
        (spots[i].way == to && !is_settled).then_some(passed)
    }

    /// Moves the change of the other skin to its place.
    fn move_to(&mut self, to: Opposite, change: &Change) {
        let Opposite { skin, before, reset: [fewer, more], sample } = to;
        let spots = &mut self.spots[skin];
        fewer.into_iter().for_each(|i| spots[i].way = change.fewer);
        more.into_iter().for_each(|i| spots[i].way = change.more);
        let mut ends = [End::Blunt; 2];
        ends[change.side.other() as usize] = End::Turn(self.n_turns);
        spots.insert(before + 1, Spot { sample, way: change.more, taken_mm: 0.0, ends });
    }

    /// Makes the beads beside the ends of others give way.
    fn give_way(&mut self, skin: usize) {
        let givings: Vec<Giving> = self.givings(skin);
        if givings.is_empty() {
            return;
        }
        let spots = &self.spots[skin];
        let n = spots.len();
        let mut step_mm = vec![f64::INFINITY; n];
        for giving in &givings {
            for i in giving.reached(spots) {
                let edge = if giving.side == Side::Behind { Side::Before.step(i, n) } else { i };
                step_mm[edge] = step_mm[edge].min(giving.length_mm / f64::from(N_STEPS));
            }
        }
        let mut finer = Vec::with_capacity(n + 12 * givings.len());
        for (i, &step_mm) in step_mm.iter().enumerate() {
            let (from, to) = (&spots[i], &spots[(i + 1) % n]);
            finer.push(*from);
            between(from, to, step_mm, &mut finer);
        }
        self.spots[skin] = finer;
        for giving in self.givings(skin) {
            for i in giving.reached(&self.spots[skin]) {
                let spot = &mut self.spots[skin][i];
                spot.taken_mm = spot.taken_mm.max(giving.taken_mm(middle(&spot.sample)));
            }
        }
    }

    fn givings(&self, skin: usize) -> Vec<Giving> {
        let settled = self.changes(skin).filter(|c| *self.end(c) != End::Blunt);
        settled.map(|c| Giving::of(&c, &self.spots[skin][c.spot], *self.end(&c), self.params)).collect()
    }
}

/// Where a change is to be on the other skin.
struct Opposite {
    skin: usize,
    /// It is to have a spot behind this one.
    before: usize,
    /// What is to have fewer beads, and what more.
    reset: [Vec<usize>; 2],
    sample: Sample,
}

/// How beads give way to the end of another.
struct Giving {
    spot: usize,
    side: Side,
    fewer: Way,
    /// The middle of the wall at the end.
    middle: Point2,
    /// The depth that the beads fill, and how many do.
    depth_mm: f64,
    n_beads: f64,
    /// The circle to which they give way: its depth under the skin, and its radius.
    circle_mm: [f64; 2],
    length_mm: f64,
}

impl Giving {
    fn of(change: &Change, spot: &Spot, end: End, params: &FillParams) -> Self {
        let n_more = if let Way::Beads(n) = change.more { n } else { 1 };
        let end_mm = params.bead_pitch_mm(spot.sample.wall_mm, n_more);
        let is_single = change.fewer == Way::Single;
        let depth_mm = spot.sample.wall_mm * if is_single { 2.0 } else { 1.0 };
        let n_beads = if is_single { 1.0 } else { (n_more - 1) as f64 };
        let turns = !is_single && matches!(end, End::Turn(_));
        let radius_mm = if turns { end_mm } else { end_mm / 2.0 };
        let circle_mm = [depth_mm - end_mm + radius_mm, radius_mm];
        let reach_mm = if turns { end_mm + depth_mm / n_beads } else { depth_mm / n_beads };
        let length_mm = ((end_mm * reach_mm).sqrt() - OVER_MM).max(LEAST_LENGTH_MM);
        let middle = middle(&spot.sample);
        let (spot, side, fewer) = (change.spot, change.side, change.fewer);
        Self { spot, side, fewer, middle, depth_mm, n_beads, circle_mm, length_mm }
    }

    /// The spots that give way, and the first beyond.
    fn reached(&self, spots: &[Spot]) -> Vec<usize> {
        let mut reached = Vec::new();
        let mut i = self.side.step(self.spot, spots.len());
        while spots[i].way == self.fewer && !spots[i].sample.sharp && reached.len() < spots.len() {
            reached.push(i);
            if (middle(&spots[i].sample) - self.middle).norm() > self.length_mm {
                break;
            }
            i = self.side.step(i, spots.len());
        }
        reached
    }

    /// What is taken of the depth at a place in the middle of the wall.
    fn taken_mm(&self, at: Point2) -> f64 {
        // Of n beads of radius r the innermost is a disc (2 n - 1) r under the skin, which touches the circle.
        let away_mm = (at - self.middle).norm() + OVER_MM;
        let [under_mm, circle_mm] = self.circle_mm;
        let factor = 2.0 * self.n_beads - 1.0;
        let half = factor * under_mm + circle_mm;
        let rest = away_mm.powi(2) + under_mm.powi(2) - circle_mm.powi(2);
        let radius_mm = rest / (half + (half.powi(2) - (factor.powi(2) - 1.0) * rest).max(0.0).sqrt());
        (self.depth_mm - 2.0 * self.n_beads * radius_mm).max(0.0)
    }
}

fn middle(s: &Sample) -> Point2 {
    s.at + s.inward * s.depth_mm
}

/// Appends spots between two neighbours, with the way of the one that has fewer beads.
fn between(from: &Spot, to: &Spot, step_mm: f64, spots: &mut Vec<Spot>) {
    let (a, b) = (&from.sample, &to.sample);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a skin's pieces are short")]
    let n = ((b.at - a.at).norm() / step_mm).ceil() as usize;
    let way = if from.ends[Side::Behind as usize] == End::Blunt { from.way } else { to.way };
    for i in 1..n {
        let share = i as f64 / n as f64;
        let mix = |a: f64, b: f64| a + (b - a) * share;
        let sample = Sample {
            at: a.at + (b.at - a.at) * share,
            inward: a.inward + (b.inward - a.inward) * share,
            share_mm: 0.0,
            depth_mm: mix(a.depth_mm, b.depth_mm),
            wall_mm: mix(a.wall_mm, b.wall_mm),
            // A corner is at a vertex of the skin alone.
            sharp: false,
            ..*a
        };
        spots.push(Spot { sample, way, taken_mm: 0.0, ends: [End::Blunt; 2] });
    }
}

/// The half circle in which a bead turns into another, without its ends; the new bead runs on its left.
pub(super) fn half_circle(end: Point2, begin: Point2) -> impl Iterator<Item = Point2> {
    const N: u32 = 8;
    let middle = nalgebra::center(&end, &begin);
    let radius: Vector2 = end - middle;
    (1..N).map(move |k| {
        middle + nalgebra::Rotation2::new(std::f64::consts::PI * f64::from(k) / f64::from(N)) * radius
    })
}
