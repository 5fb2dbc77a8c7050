//! How a loop along the lumen begins and ends: inside the wall.
//!
//! A narrow lead-in runs from inside the wall to the line of the loop, and a narrow lead-out from its end back into the wall,
//! so that neither the start's blob nor the end's stands on the line along the lumen. The loop's end stops short of its begin
//! by as much material. The round ends meet all the same: the notch that is left in the lumen is a gap's square over four
//! widths deep, at most 7 um in a bead of 0.45 mm.
//!
//! The lead-in begins at least its own width under the lumen's outline, or as deep as the loop's own place reaches where that
//! is more. Where it is not, its round begin stands in the place of the loop behind, by half a bead at most, and what the loop's
//! own gap does not hold is taken from that one: it begins and ends there, with a gap of as much material. In a wall of
//! two beads the loop behind is the outer skin's. There the lead-in begins in the middle of the wall, and the gap in the outer
//! loop is at most half a bead long (a notch of a sixteenth of a width, 0.02 mm in a wall of 0.61 mm): the lead-out is as much
//! shorter than the lead-in as that takes. Where the loop behind is open already, or another lumen's, the lead-out is as long as
//! the loop's own gap allows, and the lead-in may lay up to 0.02 mm² too much.

use super::fill::{FillParams, Path, Role, Vertex, shorten};
use super::ring;
use crate::geom::{Point2, Vector2};

/// Shortest lead-in and lead-out, mm.
const SHORTEST_MM: f64 = 0.03;
/// Most of its width by which a loop along the lumen stops short of its begin: its ends are round and still meet.
const MOST_GAP: f64 = 0.25;
/// The same for a loop along the outer skin.
const MOST_OUTER_GAP: f64 = 0.5;

/// The loop in printing order, with lead-in and lead-out. `around` begins at the seam and does not repeat it; of the `others`,
/// not yet laid, the one behind may be opened.
pub(super) fn led(mut around: Vec<Vertex>, others: &mut [Path], params: &FillParams) -> Vec<Vertex> {
    let begin = around[0];
    let Some(lead) = Lead::of(begin, params) else {
        around.push(begin);
        return around;
    };
    let into_wall = left_of(around[1].at - around[around.len() - 1].at);
    around.push(begin);
    let start = begin.at + into_wall * lead.in_mm;
    let own_mm3 = MOST_GAP * begin.width_mm * params.model.area_mm2(begin.width_mm);
    let mut behind = lead.leaves_place.then(|| behind(start, others)).flatten();
    let spare_mm3 = behind.as_ref().map_or(0.0, |b| b.spare_mm3(params));
    let out_mm = lead.out_mm(own_mm3 + spare_mm3);
    let laid_mm3 = (lead.in_mm + out_mm) * lead.area_mm2;
    if let Some(behind) = behind.as_mut().filter(|_| laid_mm3 > own_mm3) {
        behind.open((laid_mm3 - own_mm3).min(spare_mm3), params);
    }
    shorten(&mut around, laid_mm3.min(own_mm3) / params.model.area_mm2(begin.width_mm));
    if out_mm > 0.0 {
        lead.out(&mut around, out_mm);
    }
    // The width of a segment is the mean of its ends': a second vertex at the same place makes the lead-in's its own.
    let narrow = |at| Vertex { at, width_mm: lead.width_mm, room_mm: 0.0 };
    around.splice(0..0, [narrow(start), narrow(begin.at)]);
    around
}

/// A lead-in.
struct Lead {
    width_mm: f64,
    in_mm: f64,
    area_mm2: f64,
    /// Whether its round begin reaches beyond the place of the loop.
    leaves_place: bool,
}

impl Lead {
    /// From inside the wall to a vertex of a loop; none where the bead is alone in its wall.
    fn of(at: Vertex, params: &FillParams) -> Option<Self> {
        if at.room_mm <= 0.0 {
            return None;
        }
        let width_mm = params.limits_mm[0].min(at.width_mm);
        let within_mm = at.room_mm - params.model.pitch_mm(width_mm) / 2.0;
        let in_mm = within_mm.max(width_mm - at.width_mm / 2.0);
        let area_mm2 = params.model.area_mm2(width_mm);
        (in_mm >= SHORTEST_MM).then_some(Self { width_mm, in_mm, area_mm2, leaves_place: in_mm > within_mm })
    }

    /// How long the lead-out may be where both have so much material (in a layer of one height, mm³).
    fn out_mm(&self, spare_mm3: f64) -> f64 {
        let out_mm = (spare_mm3 / self.area_mm2 - self.in_mm).min(self.in_mm);
        if out_mm < SHORTEST_MM { 0.0 } else { out_mm }
    }

    /// Appends the lead-out.
    fn out(&self, line: &mut Vec<Vertex>, out_mm: f64) {
        let [.., before, end] = line.as_slice() else { return };
        let into_wall = left_of(end.at - before.at);
        let narrow = |at| Vertex { at, width_mm: self.width_mm, room_mm: 0.0 };
        line.extend([narrow(end.at), narrow(end.at + into_wall * out_mm)]);
    }
}

/// A loop behind that of the lumen.
struct Behind<'a> {
    path: &'a mut Path,
    at: ring::Place,
    width_mm: f64,
}

/// The closed loop in whose place a lead-in begins, but no lumen's.
fn behind(start: Point2, others: &mut [Path]) -> Option<Behind<'_>> {
    let loops = others.iter_mut().filter(|p| p.closed && p.role != Role::Lumen);
    let near = loops.filter_map(|path| {
        let (at, distance_mm) = ring::nearest(&path.vertices, start);
        let width_mm = path.vertices[at.edge].width_mm;
        (distance_mm < width_mm).then_some((distance_mm, Behind { path, at, width_mm }))
    });
    near.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, behind)| behind)
}

impl Behind<'_> {
    /// What a gap in it may hold, mm³.
    fn spare_mm3(&self, params: &FillParams) -> f64 {
        let most = if self.path.role == Role::Outer { MOST_OUTER_GAP } else { 1.0 };
        most * self.width_mm * params.model.area_mm2(self.width_mm)
    }

    /// Makes it begin and end at its place, with a gap that holds so much.
    fn open(&mut self, gap_mm3: f64, params: &FillParams) {
        let mut line = ring::begun_at(&self.path.vertices, self.at);
        line.push(line[0]);
        for _ in 0..2 {
            shorten(&mut line, gap_mm3 / params.model.area_mm2(self.width_mm) / 2.0);
            line.reverse();
        }
        self.path.vertices = line;
        self.path.closed = false;
    }
}

fn left_of(along: Vector2) -> Vector2 {
    Vector2::new(-along.y, along.x).normalize()
}
