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
//! Not so where more than one bead begins at once, or a raster: beads end bluntly there. Nor at a corner, nor where the skins see the
//! change more than [`APART_MM`] apart or disagree about the wall's depth: each skin then ends its bead by itself, with a round end.
//!
//! Limits: a change is taken to be in a straight wall of even depth. In tubes of lumens below 2 mm radius what is beside a turn
//! is bent, and up to 1 % of the ring's section is left empty there, half as much is laid twice.
//!
//! Cost: a look at each spot, and for each change a search of the place across the wall (logarithmic) and an insertion among the
//! spots of its skin (linear in them).
//!
//! Accuracy: beads that give way follow the parabola in [`N_STEPS`] steps.

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
        let mut from = 0;
        while let Some(change) = self.unsettled(skin, from).or_else(|| self.unsettled(skin, 0)) {
            from = change.spot;
            // Marked first, so that the other skin of the wall, which may be the same, does not move it.
            *self.end_mut(&change) = End::Round;
            if let Some(opposite) = self.opposite(&change) {
                *self.end_mut(&change) = End::Turn(self.n_turns);
                self.move_to(opposite, &change);
                self.n_turns += 1;
            }
        }
    }

    fn unsettled(&self, skin: usize, from: usize) -> Option<Change> {
        self.changes(skin, from).find(|c| *self.end(c) == End::Blunt)
    }

    /// Where the number of beads falls by one along a skin, from a spot on.
    fn changes(&self, skin: usize, from: usize) -> impl Iterator<Item = Change> + '_ {
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
        (from..spots.len()).flat_map(|i| [(i, Side::Before), (i, Side::Behind)]).filter_map(change)
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
        let settled = self.changes(skin, 0).filter(|c| *self.end(c) != End::Blunt);
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
        // Of n beads of radius r the innermost is a disc f r under the skin, f = 2 n - 1, which touches the circle, of radius c and u
        // under the skin: away^2 + (u - f r)^2 = (r + c)^2, of which this is the lesser root, written without cancellation.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Region};
    use crate::profile::BeadShape;
    use crate::toolpath::flow::BeadModel;

    fn params() -> FillParams {
        let model = BeadModel::new(BeadShape::Rectangle, 0.2);
        FillParams { model, width_mm: 0.45, limits_mm: [0.3, 0.8], perimeters: 2 }
    }

    fn sample(x: f64) -> Sample {
        Sample {
            at: Point2::new(x, 0.0),
            inward: Vector2::new(0.0, 1.0),
            share_mm: 0.3,
            depth_mm: 0.6,
            wall_mm: 0.6 + x,
            contact: Contact::Deep,
            edge_idx: 0,
            sharp: true,
        }
    }

    #[test]
    fn beads_give_way_so_that_the_innermost_touches_the_turn() {
        for n_beads in [1.0, 2.0, 3.0] {
            let (depth_mm, circle_mm) = (0.9, [0.75, 0.15]);
            let (side, fewer, middle) = (Side::Behind, Way::Beads(1), Point2::new(0.0, depth_mm));
            let giving =
                Giving { spot: 0, side, fewer, middle, depth_mm, n_beads, circle_mm, length_mm: 1.0 };
            for x in [0.0, 0.1, 0.2] {
                let taken_mm = giving.taken_mm(Point2::new(x, depth_mm));
                let radius_mm = (depth_mm - taken_mm) / (2.0 * n_beads);
                let under_mm = (2.0 * n_beads - 1.0) * radius_mm;
                let between_mm = (x + OVER_MM).hypot(circle_mm[0] - under_mm);
                assert!(
                    taken_mm > 0.0 && (between_mm - radius_mm - circle_mm[1]).abs() < 1e-9,
                    "{n_beads} {x}"
                );
            }
            assert_eq!(giving.taken_mm(Point2::new(3.0, depth_mm)), 0.0);
        }
    }

    #[test]
    fn spots_between_two_are_evenly_apart_and_no_corners() {
        let spot =
            |x: f64, n: usize, ends| Spot { sample: sample(x), way: Way::Beads(n), taken_mm: 0.0, ends };
        let ended = [End::Blunt, End::Round];
        for (ends, way) in [([End::Blunt; 2], Way::Beads(2)), (ended, Way::Beads(1))] {
            let mut spots = Vec::new();
            between(&spot(0.0, 2, ends), &spot(0.4, 1, [End::Blunt; 2]), 0.11, &mut spots);
            let places: Vec<f64> = spots.iter().map(|s| s.sample.at.x).collect();
            let is_even = places.iter().zip([0.1, 0.2, 0.3]).all(|(a, b)| (a - b).abs() < 1e-12);
            assert!(is_even && places.len() == 3, "{places:?}");
            assert!(spots.iter().all(|s| s.way == way && !s.sample.sharp && s.ends == [End::Blunt; 2]));
            assert!(spots.iter().all(|s| (s.sample.wall_mm - 0.6 - s.sample.at.x).abs() < 1e-12));
        }
    }

    /// The spots of a ring whose lumen lies off its middle, and of which the number of beads falls from `more` where the wall is
    /// less than `limit_mm` deep; seen `apart_mm` later by the outer skin.
    fn settled(limit_mm: f64, apart_mm: f64) -> Vec<Vec<Spot>> {
        let hole = Contour::circle(Point2::new(0.3, 0.0), 3.0, 120).reversed();
        let ring = Region::new(vec![Contour::circle(Point2::origin(), 4.2, 150), hole]);
        let skins = Skins::try_new(&ring, 2.0, 1e-6).unwrap();
        let way = |(skin, s): (usize, &Sample)| {
            let late_mm = if skin == 0 { apart_mm } else { 0.0 };
            Way::Beads(if s.wall_mm < limit_mm + late_mm { 1 } else { 2 })
        };
        let ways = |(skin, s): (usize, &super::super::skin::Skin)| {
            s.samples.iter().map(|s| way((skin, s))).collect()
        };
        let ways: Vec<Vec<Way>> = skins.skins.iter().enumerate().map(ways).collect();
        spots(&skins, &ways, &params())
    }

    fn turns(spots: &[Spot]) -> Vec<(usize, Point2)> {
        let turn = |s: &Spot| {
            s.ends
                .iter()
                .find_map(|e| if let End::Turn(k) = e { Some((*k, middle(&s.sample))) } else { None })
        };
        let mut turns: Vec<_> = spots.iter().filter_map(turn).collect();
        turns.sort_by_key(|turn| turn.0);
        turns
    }

    #[test]
    fn skins_that_see_a_change_far_apart_end_their_beads_each_by_itself() {
        let spots = settled(0.6, 0.12);
        assert!(spots.iter().all(|s| turns(s).is_empty()));
        let n_round = |s: &[Spot]| s.iter().flat_map(|s| s.ends).filter(|e| *e == End::Round).count();
        assert_eq!([n_round(&spots[0]), n_round(&spots[1])], [2, 2]);
    }

    #[test]
    fn a_half_circle_has_its_ends_opposite() {
        let (end, begin) = (Point2::new(0.0, 0.0), Point2::new(0.0, 1.0));
        let points: Vec<Point2> = half_circle(end, begin).collect();
        assert!(points.iter().all(|p| ((p - Point2::new(0.0, 0.5)).norm() - 0.5).abs() < 1e-12 && p.x > 0.0));
        assert!((points[3] - Point2::new(0.5, 0.5)).norm() < 1e-12);
    }
}
