//! Beads side by side from each skin to the middle of the wall.
//!
//! Each skin fills the material under it, down to the medial axis, with k beads of equal width depth / k,
//! so that a wall of any local thickness is filled exactly: bead j runs (j + 1/2) pitches below the skin.
//! How many beads is chosen along the whole skin at once (Viterbi's method): widths off the wanted one
//! cost, and so does every change of the count, so the count does not flip to and fro. Where the material
//! is too deep for beads alone, the profile's perimeters are laid and the rest is left to the raster;
//! where it is too thin for two beads, one runs along its middle, owned by one of the two skins.

use super::BeadKind;
use super::change::{self, End, Spot};
use super::flow::BeadModel;
use super::skin::{Contact, Sample, Skin, Skins};
use crate::geom::{Contour, Point2, Region, Vector2};

/// What a change of the bead count costs, mm of skin at double the wanted width.
const FLIP_COST: f64 = 0.3;
/// What a raster costs for each bead's pitch that it has room for, as the square of a relative width: the ends of its lines leave
/// gaps and overlaps at its border, the more the narrower it is.
const RASTER_COST: f64 = 0.05;
/// What a width outside the limits costs more than any inside.
const OUTSIDE_COST: f64 = 100.0;
/// A bead may come this much nearer to the skin than half its width at a trimmed corner, mm.
const TRIM_MM: f64 = 2e-3;
/// How far the ends of inner beads are drawn back, in widths: the round end then reaches to where the bead has its place.
const END_GAP: f64 = 0.5;
/// How far the loops around the rest reach beyond the middle of a wall that beads fill, mm: more than the two sides of it
/// disagree about where the middle is.
const CLOSED_MM: f64 = 0.02;
/// Thin material shorter than this, seen from each side, is the edge of a wedge, mm.
const LONGEST_EDGE_MM: f64 = 0.6;
/// A run of single beads shorter than this is printed with two, mm, and the other way round.
const SHORT_RUN_MM: f64 = 1.0;
/// Where both skins of a wall are to agree on the number of beads, no run of another number is shorter, mm.
const SHORT_DIP_MM: f64 = 0.5;

/// How material is filled in one layer. mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct FillParams {
    pub(super) model: BeadModel,
    /// Wanted width of a bead.
    pub(super) width_mm: f64,
    /// Narrowest and widest bead.
    pub(super) limits_mm: [f64; 2],
    /// Perimeters along each skin where a raster fills the rest.
    pub(super) perimeters: usize,
}

impl FillParams {
    /// Wanted distance of neighbouring beads.
    pub(super) fn pitch_mm(&self) -> f64 {
        self.model.pitch_mm(self.width_mm)
    }

    /// Depth of the raster's border.
    pub(super) fn raster_depth_mm(&self) -> f64 {
        self.model.overlap_mm() / 2.0 + self.perimeters as f64 * self.pitch_mm()
    }

    /// Deeper than this it does not matter how deep the material is.
    pub(super) fn cap_mm(&self) -> f64 {
        self.raster_depth_mm() + 2.5 * self.pitch_mm()
    }

    /// Most beads from a skin to the middle of a wall.
    fn most_beads(&self) -> usize {
        self.perimeters + 2
    }

    /// Less depth than this holds no bead of its own on each side.
    fn single_depth_mm(&self) -> f64 {
        self.limits_mm[0].min(self.limits_mm[1] / 2.0)
    }

    pub(super) fn bead_pitch_mm(&self, depth_mm: f64, n_beads: usize) -> f64 {
        (depth_mm - self.model.overlap_mm() / 2.0) / n_beads as f64
    }
}

/// What a path follows, for order and seams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role {
    Lumen,
    Outer,
    Inner,
    Raster,
}

/// A vertex of a path, the width of the bead there, and how far the bead's own place reaches into the wall.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    pub(super) at: Point2,
    pub(super) width_mm: f64,
    pub(super) room_mm: f64,
}

/// A bead before it got its place in the order; a closed one does not repeat its first vertex.
#[derive(Debug, Clone)]
pub(super) struct Path {
    pub(super) kind: BeadKind,
    pub(super) role: Role,
    pub(super) closed: bool,
    pub(super) vertices: Vec<Vertex>,
}

/// A place where the wall is thinner than the thinnest bead.
#[derive(Debug, Clone, Copy)]
pub(super) struct Thin {
    pub(super) at: Point2,
    pub(super) thickness_mm: f64,
    /// By how much the thinnest bead is wider, mm.
    pub(super) excess_mm: f64,
    /// Whether it lies between a lumen and the outside.
    pub(super) is_round_lumen: bool,
    /// Share of all skins of the layer that is as thin.
    pub(super) share: f64,
}

/// What filling a layer gave.
#[derive(Debug)]
pub(super) struct Filled {
    pub(super) paths: Vec<Path>,
    /// What is left for the raster.
    pub(super) rest: Region,
    pub(super) thin: Option<Thin>,
    /// Skins too small for any bead.
    pub(super) lost: Vec<Point2>,
}

/// How the material under a sample is filled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    Single,
    Beads(usize),
    Raster,
}

/// Fills the material under all skins.
pub(super) fn fill(skins: &Skins, params: &FillParams) -> Filled {
    let filler = Filler { skins, params };
    let mut ways: Vec<Vec<Way>> = skins.skins.iter().map(|s| filler.ways(s)).collect();
    filler.agree(&mut ways);
    let spots = change::spots(skins, &ways, params);
    let mut paths = Vec::new();
    let mut laid = vec![false; skins.skins.len()];
    for level in 0..params.most_beads() {
        let lines = (0..spots.len()).flat_map(|skin| filler.level(skin, &spots[skin], level)).collect();
        for line in joined(lines) {
            laid[line.skin] |= push(&mut paths, line.path);
        }
    }
    let lost = filler.lost(&ways, &laid);
    Filled { paths, rest: filler.rest(&spots), thin: filler.thin(), lost }
}

/// A bead along a skin, and how it begins and ends if it is open.
struct Line {
    skin: usize,
    path: Path,
    ends: [End; 2],
}

struct Filler<'a> {
    skins: &'a Skins,
    params: &'a FillParams,
}

impl Filler<'_> {
    /// How each sample of a skin is filled.
    fn ways(&self, skin: &Skin) -> Vec<Way> {
        let n_ways = self.params.most_beads() + 1;
        let mut costs = Vec::with_capacity(n_ways * skin.samples.len());
        skin.samples.iter().for_each(|s| costs.extend(self.costs(s)));
        let chosen = cheapest_walk(&costs, n_ways, FLIP_COST);
        let way = |i: usize| if i + 1 == n_ways { Way::Raster } else { Way::Beads(i + 1) };
        let single = self.single(skin);
        chosen.iter().zip(single).map(|(&i, s)| if s { Way::Single } else { way(i) }).collect()
    }

    /// Cost of one bead, two, ..., of perimeters and raster; weighted with the length.
    fn costs(&self, s: &Sample) -> impl Iterator<Item = f64> {
        let (p, s) = (*self.params, *s);
        let beads = (1..=p.most_beads()).map(move |n| {
            let width = p.bead_pitch_mm(s.wall_mm, n) + p.model.overlap_mm();
            let outside = (p.limits_mm[0] - width).max(width - p.limits_mm[1]).max(0.0);
            let forbidden = if outside > 0.0 { OUTSIDE_COST } else { 0.0 };
            s.share_mm * ((width / p.width_mm - 1.0).powi(2) + forbidden + OUTSIDE_COST * outside)
        });
        let room = s.wall_mm - p.raster_depth_mm() - 1.5 * p.pitch_mm();
        let raster = if room < 0.0 {
            OUTSIDE_COST * (1.0 - room)
        } else if s.wall_mm > p.cap_mm() - TRIM_MM {
            // How deep it is was not measured: no number of beads is known to fill it.
            0.0
        } else {
            RASTER_COST * p.pitch_mm() / (s.wall_mm - p.raster_depth_mm())
        };
        beads.chain([s.share_mm * raster])
    }

    /// Where one bead fills the wall from skin to skin, short runs smoothed away.
    fn single(&self, skin: &Skin) -> Vec<bool> {
        let limit = self.params.single_depth_mm();
        let mut single: Vec<bool> = skin.samples.iter().map(|s| s.wall_mm < limit).collect();
        for value in [true, false] {
            for run in runs(&single, value) {
                let length: f64 = run.iter().map(|&i| skin.samples[i].share_mm).sum();
                // Where there is hardly room for half a bead, two would stand in the lumen.
                let is_thin = |&i: &usize| 4.0 * skin.samples[i].wall_mm < self.params.limits_mm[0];
                let is_short = length < SHORT_RUN_MM && !(value && run.iter().any(is_thin));
                if is_short && run.len() < single.len() {
                    run.iter().for_each(|&i| single[i] = !value);
                }
            }
        }
        single
    }

    /// Makes both skins of a wall see a single bead where one of them does: else the one leaves its half of the wall
    /// to a bead that the other does not lay.
    fn agree(&self, ways: &mut [Vec<Way>]) {
        let mut joined = Vec::new();
        for (skin_idx, skin) in self.skins.skins.iter().enumerate() {
            for (i, s) in skin.samples.iter().enumerate() {
                let single_there = self.opposite(s).is_some_and(|(k, j)| ways[k][j] == Way::Single);
                if single_there && ways[skin_idx][i] != Way::Single {
                    joined.push((skin_idx, i));
                }
            }
        }
        joined.into_iter().for_each(|(skin_idx, i)| ways[skin_idx][i] = Way::Single);
        (0..ways.len()).for_each(|skin_idx| self.adopt(skin_idx, ways));
    }

    /// Takes the number of beads of the skin across the wall where that decides, so that both change it in the same place.
    fn adopt(&self, skin_idx: usize, ways: &mut [Vec<Way>]) {
        let samples = &self.skins.skins[skin_idx].samples;
        let mut is_changed = false;
        for (i, s) in samples.iter().enumerate().filter(|(_, s)| owns(skin_idx, s)) {
            let Some((k, j)) = self.opposite(s) else { continue };
            let is_as_deep = s.is_about_as_deep(&self.skins.skins[k].samples[j]);
            if let (Way::Beads(own), Way::Beads(other), true) = (ways[skin_idx][i], ways[k][j], is_as_deep) {
                is_changed |= own != other;
                ways[skin_idx][i] = ways[k][j];
            }
        }
        if is_changed {
            level_out(&mut ways[skin_idx], samples);
        }
    }

    /// The sample across the wall: its skin and number.
    fn opposite(&self, s: &Sample) -> Option<(usize, usize)> {
        let Contact::Wall { contour_idx, edge_idx, at } = s.contact else { return None };
        let samples = &self.skins.skins[contour_idx].samples;
        let n = samples.len();
        // The samples of the touched edge and one on either side.
        let first = samples.partition_point(|o| o.edge_idx < edge_idx) + n - 1;
        let last = samples.partition_point(|o| o.edge_idx <= edge_idx) + n;
        let distance = |j: &usize| (samples[*j].at - at).norm_squared();
        (first..=last)
            .map(|j| j % n)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .map(|j| (contour_idx, j))
    }

    /// Skins that have no bead and need one.
    fn lost(&self, ways: &[Vec<Way>], laid: &[bool]) -> Vec<Point2> {
        let is_dust = |skin: &Skin| skin.samples.iter().all(|s| 4.0 * s.depth_mm < self.params.limits_mm[0]);
        let all = self.skins.skins.iter().zip(ways).zip(laid).filter(|(_, laid)| !**laid);
        let lost = all.filter(|((skin, ways), _)| is_dust(skin) || !ways.contains(&Way::Single));
        lost.filter_map(|((skin, _), _)| skin.samples.first().map(|s| s.at)).collect()
    }

    /// The `level`-th bead below a skin, wherever there are as many; where one bead fills a wall, it goes on as that, if the skin
    /// lays it.
    fn level(&self, skin: usize, spots: &[Spot], level: usize) -> Vec<Line> {
        let has = |s: &Spot| match s.way {
            Way::Single => level == 0 && owns(skin, &s.sample),
            way => self.n_beads(way) > level,
        };
        let has: Vec<bool> = spots.iter().map(has).collect();
        let (kind, role) = match (level, self.skins.skins[skin].is_hole) {
            (0, true) => (BeadKind::ExternalPerimeter, Role::Lumen),
            (0, false) => (BeadKind::ExternalPerimeter, Role::Outer),
            _ => (BeadKind::Perimeter, Role::Inner),
        };
        let line = |run: Vec<usize>| {
            let closed = run.len() == has.len();
            let ends = [spots[run[0]].ends[0], spots[run[run.len() - 1]].ends[1]];
            let mut vertices: Vec<Vertex> =
                run.iter().filter_map(|&i| self.vertex(skin, &spots[i], level)).collect();
            if !closed && level > 0 {
                keep_clear(&mut vertices, ends);
            }
            Line { skin, path: Path { kind, role, closed, vertices }, ends }
        };
        runs(&has, true).into_iter().map(line).collect()
    }

    fn n_beads(&self, way: Way) -> usize {
        match way {
            Way::Single => 0,
            Way::Beads(n) => n,
            Way::Raster => self.params.perimeters,
        }
    }

    /// The bead's vertex under a sample, or none where a corner leaves no room for it.
    fn vertex(&self, skin: usize, spot: &Spot, level: usize) -> Option<Vertex> {
        let (p, s) = (self.params, &spot.sample);
        let pitch = match spot.way {
            Way::Single => return self.middle(skin, spot),
            Way::Beads(n) => {
                p.bead_pitch_mm(s.wall_mm - spot.taken_mm, n).max(0.5 * p.pitch_mm().min(p.limits_mm[0]))
            }
            Way::Raster => p.pitch_mm(),
        };
        let overlap = p.model.overlap_mm();
        let depth = overlap / 2.0 + (level as f64 + 0.5) * pitch;
        let at = s.at + s.inward * depth;
        let fits = if s.sharp {
            self.skins.index.nearest(at).distance_mm > depth - 2.0 * TRIM_MM
        } else {
            depth <= s.depth_mm + TRIM_MM
        };
        let width_mm = pitch + overlap;
        let at = if s.sharp && level == 0 { at - into_corner(s.inward, width_mm) } else { at };
        fits.then_some(Vertex { at, width_mm, room_mm: pitch / 2.0 })
    }

    /// The middle of a thin wall, but for what the end of a bead takes of it on the far side. Where it is thinner than the thinnest bead,
    /// that lies against the lumen, which keeps its outline; the skin outside gives way. Where there is no lumen, what is thinner
    /// than half the thinnest bead is left out.
    fn middle(&self, skin: usize, spot: &Spot) -> Option<Vertex> {
        let (s, [thinnest, widest]) = (&spot.sample, self.params.limits_mm);
        let depth_mm = s.depth_mm - spot.taken_mm / 2.0;
        // Short runs beside the thin wall, where it opens into a corner, may be deeper than a bead can fill.
        let width_mm = (2.0 * depth_mm).min(widest).max(thinnest);
        let outward_mm = (thinnest / 2.0 - s.depth_mm).max(0.0);
        let depth_mm = match self.is_of_lumen(skin, s) {
            Some(true) => depth_mm + outward_mm,
            Some(false) => depth_mm - outward_mm,
            None if 4.0 * s.depth_mm < thinnest => return None,
            None => depth_mm,
        };
        Some(Vertex { at: s.at + s.inward * depth_mm, width_mm, room_mm: 0.0 })
    }

    /// Of a wall between a lumen and the outside: whether a sample is on its lumen's side.
    fn is_of_lumen(&self, skin: usize, s: &Sample) -> Option<bool> {
        let Contact::Wall { contour_idx, .. } = s.contact else { return None };
        let [own, other] = [skin, contour_idx].map(|idx| self.skins.skins[idx].is_hole);
        (own != other).then_some(own)
    }

    /// What lies between the innermost beads of all skins.
    fn rest(&self, spots: &[Vec<Spot>]) -> Region {
        if !spots.iter().flatten().any(|s| s.way == Way::Raster) {
            return Region::default();
        }
        let depth = self.params.raster_depth_mm();
        let inner = |spots: &Vec<Spot>| {
            let under = |Spot { sample: s, way, .. }: &Spot| {
                // Not far beyond the medial axis, but so far that loops which meet there leave nothing between them.
                let most = s.depth_mm + CLOSED_MM;
                s.at + s.inward * if *way == Way::Raster { depth.min(most) } else { most }
            };
            Contour::new(spots.iter().map(under).collect())
        };
        Region::from_winding(&spots.iter().map(inner).collect::<Vec<_>>())
    }

    fn thin(&self) -> Option<Thin> {
        let thinnest = self.params.limits_mm[0];
        let skins = || self.skins.skins.iter().enumerate();
        let all = || skins().flat_map(|(skin, s)| s.samples.iter().map(move |s| (skin, s)));
        let is_wall = |s: &Sample| matches!(s.contact, Contact::Wall { .. });
        let thin = || all().filter(|(_, s)| is_wall(s) && 2.0 * s.depth_mm < thinnest - TRIM_MM);
        let (skin, worst) = thin().min_by(|a, b| a.1.depth_mm.total_cmp(&b.1.depth_mm))?;
        let length = |samples: &mut dyn Iterator<Item = (usize, &Sample)>| {
            samples.map(|(_, s)| s.share_mm).sum::<f64>()
        };
        let thin_mm = length(&mut thin());
        let is_round_lumen = self.is_of_lumen(skin, worst).is_some();
        // The sharp edge of a wedge is thin everywhere; only a longer stretch is a thin wall.
        if thin_mm < 2.0 * LONGEST_EDGE_MM && !is_round_lumen {
            return None;
        }
        let share = thin_mm / length(&mut all());
        let thickness_mm = 2.0 * worst.depth_mm;
        Some(Thin { at: worst.at, thickness_mm, excess_mm: thinnest - thickness_mm, is_round_lumen, share })
    }
}

/// How far the outermost bead is led back out at a sharp corner of the skin, whose mitre (of length 1 / cos of half the
/// turn) this is. A round bead leaves the corner's tip empty; led into it, it misses the tip by as much as it then bulges
/// out of the sides: the largest deviation is the least.
fn into_corner(mitre: Vector2, width_mm: f64) -> Vector2 {
    let length = mitre.norm();
    mitre * ((length - 1.0) * width_mm / 2.0 / (length + 1.0))
}

/// Gives short runs of another number of beads than on both sides that one.
fn level_out(ways: &mut [Way], samples: &[Sample]) {
    let n = ways.len();
    let begins: Vec<usize> = (0..n).filter(|&i| ways[i] != ways[(i + n - 1) % n]).collect();
    for (k, &begin) in begins.iter().enumerate() {
        let run = (begins[(k + 1) % begins.len()] + n - begin) % n;
        let (before, behind) = (ways[(begin + n - 1) % n], ways[(begin + run) % n]);
        let length_mm: f64 = (begin..begin + run).map(|i| samples[i % n].share_mm).sum();
        let is_dip = matches!((before, ways[begin]), (Way::Beads(_), Way::Beads(_))) && before == behind;
        let beside = &samples[(begin + n - 1) % n];
        let is_even = (begin..begin + run).all(|i| beside.is_about_as_deep(&samples[i % n]));
        if is_dip && is_even && length_mm < SHORT_DIP_MM {
            (begin..begin + run).for_each(|i| ways[i % n] = before);
        }
    }
}

/// Whether a skin lays the single bead along the middle of a thin wall under a sample: one of the two does.
fn owns(skin: usize, s: &Sample) -> bool {
    match s.contact {
        Contact::Wall { contour_idx, edge_idx, .. } => (contour_idx, edge_idx) < (skin, s.edge_idx),
        _ => false,
    }
}

/// Keeps a path unless it is shorter than it is wide; whether it does.
fn push(paths: &mut Vec<Path>, path: Path) -> bool {
    let Some(first) = path.vertices.first() else { return false };
    let length: f64 = path.vertices.windows(2).map(|p| (p[1].at - p[0].at).norm()).sum();
    let least = if path.closed { 3 } else { 2 };
    let is_kept = path.vertices.len() >= least && length > first.width_mm;
    if is_kept {
        paths.push(path);
    }
    is_kept
}

/// The lines of a level, joined where one turns into another.
fn joined(mut lines: Vec<Line>) -> Vec<Line> {
    let turn_of = |end: End| if let End::Turn(turn) = end { Some(turn) } else { None };
    let is_inner = |line: &Line| line.path.role == Role::Inner && !line.path.closed;
    // Those into which none turns are first; what is left then are loops.
    lines.sort_by_key(|line| turn_of(line.ends[0]).is_none());
    let mut done = Vec::with_capacity(lines.len());
    while let Some(mut line) = lines.pop() {
        while let Some(turn) = turn_of(line.ends[1]).filter(|_| is_inner(&line)) {
            if turn_of(line.ends[0]) == Some(turn) {
                turn_back(&mut line.path.vertices, None);
                line.path.closed = true;
                break;
            }
            let Some(next) = lines.iter().position(|l| turn_of(l.ends[0]) == Some(turn)) else { break };
            let next = lines.remove(next);
            turn_back(&mut line.path.vertices, Some(next.path.vertices));
            line.ends[1] = next.ends[1];
        }
        done.push(line);
    }
    done
}

/// Appends the half circle from the end of a line to the begin of the next, or of itself, and the next.
fn turn_back(line: &mut Vec<Vertex>, next: Option<Vec<Vertex>>) {
    let begin = next.as_ref().unwrap_or(line).first().copied();
    if let (Some(end), Some(begin)) = (line.last().copied(), begin) {
        line.extend(change::half_circle(end.at, begin.at).map(|at| Vertex { at, ..end }));
    }
    line.extend(next.into_iter().flatten());
}

/// Draws the blunt ends of an inner bead back from where it begins to share the wall: the round end of the
/// wider bead there reaches into its place.
fn keep_clear(vertices: &mut Vec<Vertex>, ends: [End; 2]) {
    for end in [ends[1], ends[0]] {
        if let Some(last) = vertices.last().filter(|_| end == End::Blunt) {
            shorten(vertices, END_GAP * last.width_mm);
        }
        vertices.reverse();
    }
}

/// Takes `gap_mm` off the end of a line; of a shorter one a stub is left.
pub(super) fn shorten(vertices: &mut Vec<Vertex>, mut gap_mm: f64) {
    while let [.., from, to] = vertices.as_mut_slice() {
        let length = (to.at - from.at).norm();
        if length > gap_mm + 1e-3 {
            let share = gap_mm / length;
            to.at -= (to.at - from.at) * share;
            to.width_mm -= (to.width_mm - from.width_mm) * share;
            return;
        }
        gap_mm -= length;
        vertices.pop();
    }
}

/// The maximal cyclic runs of indices with the given value; one run of all where there is no other value.
fn runs(values: &[bool], value: bool) -> Vec<Vec<usize>> {
    let n = values.len();
    let Some(break_at) = values.iter().position(|&v| v != value) else {
        return if n == 0 { Vec::new() } else { vec![(0..n).collect()] };
    };
    let mut found: Vec<Vec<usize>> = Vec::new();
    let mut inside = false;
    for i in (0..n).map(|i| (break_at + i) % n) {
        match (values[i] == value, inside) {
            (true, false) => found.push(vec![i]),
            (true, true) => found.last_mut().expect("a run was begun").push(i),
            _ => {}
        }
        inside = values[i] == value;
    }
    found
}

/// The state per step of a closed walk that costs least, each change of state costing `flip` (Viterbi). `costs`: those of all
/// states, step by step. The walk begins where the choice is clearest, and ends in the same state.
fn cheapest_walk(costs: &[f64], n_states: usize, flip: f64) -> Vec<usize> {
    let best_of = |row: &[f64]| (0..row.len()).min_by(|&a, &b| row[a].total_cmp(&row[b])).unwrap_or(0);
    let single: Vec<usize> = costs.chunks_exact(n_states).map(best_of).collect();
    if single.windows(2).all(|p| p[0] == p[1]) {
        return single;
    }
    let n = single.len();
    let row = |i: usize| &costs[i * n_states..(i + 1) * n_states];
    let margin = |i: usize| {
        let others = (0..n_states).filter(|&s| s != single[i]).map(|s| row(i)[s]);
        others.fold(f64::INFINITY, f64::min) - row(i)[single[i]]
    };
    let start = (0..n).max_by(|&a, &b| margin(a).total_cmp(&margin(b))).unwrap_or(0);
    let forced = single[start];
    let mut total = vec![f64::INFINITY; n_states];
    total[forced] = 0.0;
    // From which state each state of each step is reached.
    let mut back = Vec::with_capacity(n * n_states);
    for step in 1..=n {
        let cheapest = best_of(&total);
        let least = total[cheapest];
        for (s, (total, cost)) in total.iter_mut().zip(row((start + step) % n)).enumerate() {
            let stays = *total <= least + flip;
            back.push(if stays { s } else { cheapest });
            *total = if stays { *total + cost } else { least + cost + flip };
        }
    }
    let mut states = vec![forced; n];
    let mut state = forced;
    for step in (1..n).rev() {
        state = back[step * n_states + state];
        states[(start + step) % n] = state;
    }
    states
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_dips_do_not_change_the_state() {
        let cost = |best: usize| if best == 0 { vec![0.0, 0.1] } else { vec![0.1, 0.0] };
        let mut states = [0; 40];
        states[10] = 1;
        (20..35).for_each(|i| states[i] = 1);
        let costs: Vec<f64> = states.iter().flat_map(|&s| cost(s)).collect();
        let walk = cheapest_walk(&costs, 2, 0.3);
        assert_eq!(walk[10], 0);
        assert!(walk[20..35].iter().all(|&s| s == 1));
        assert!(walk[..20].iter().chain(&walk[35..]).all(|&s| s == 0));
    }

    #[test]
    fn a_bead_misses_the_tip_of_a_corner_by_as_much_as_it_bulges_beside_it() {
        for half_turn in [0.3f64, std::f64::consts::FRAC_PI_4] {
            let (radius, mitre) = (0.2, 1.0 / half_turn.cos());
            let out_mm = into_corner(Vector2::new(mitre, 0.0), 2.0 * radius).x;
            let missed_mm = radius * (mitre - 1.0) - out_mm;
            assert!((missed_mm - out_mm * half_turn.cos()).abs() < 1e-12 && missed_mm > 0.0);
        }
    }

    #[test]
    fn shortening_takes_exactly_the_gap() {
        let mut line = [0.0, 1.0, 1.05, 1.1]
            .map(|x| Vertex { at: Point2::new(x, 0.0), width_mm: 0.4, room_mm: 0.0 })
            .to_vec();
        shorten(&mut line, 0.3);
        assert!((line[line.len() - 1].at.x - 0.8).abs() < 1e-12);
        // A bead that tapers does so as before, up to where it ends.
        let mut taper =
            [0.0, 1.0].map(|x| Vertex { at: Point2::new(x, 0.0), width_mm: 0.4 + x, room_mm: 0.0 }).to_vec();
        shorten(&mut taper, 0.25);
        assert!((taper[1].width_mm - 1.15).abs() < 1e-12);
    }

    #[test]
    fn runs_wrap_around_the_end() {
        let values = [true, false, false, true, true];
        assert_eq!(runs(&values, true), [vec![3, 4, 0]]);
        assert_eq!(runs(&values, false), [vec![1, 2]]);
        assert_eq!(runs(&[true; 3], true), [vec![0, 1, 2]]);
        assert!(runs(&[true; 3], false).is_empty());
    }
}
