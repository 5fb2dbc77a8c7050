//! Where the scanned replica has material that the model has not, and the other way round: body by body, with place and volume.
//!
//! Outlines tell how far a wall lies off; they do not tell a wall that is not there, a strand across the lumen or a lump on the skin.
//! So the model's sections are laid over those of the scan at close heights, between the CT planes, too. A piece counts where it
//! reaches farther into the wall, the lumen or the outside than an outline may lie off; then all of it is measured. Pieces that
//! overlap from height to height are one.

use super::compare::Planes;
use super::registration::Pose;
use crate::geom::{Contour, Point2, Region, SegmentIndex, Vector2};
use crate::progress::{Cancelled, Task};
use crate::report::BodyKind;
use crate::report::anatomy::{Branches, StageLumina};
use crate::report::course::centroid;
use crate::solid::CrossSection;
use rayon::prelude::*;

/// Distance of the sections, mm, or a voxel.
const STEP_MM: f64 = 0.35;
/// Chord error of the sections, mm.
const TOLERANCE_MM: f64 = 5e-3;
/// Chord error of offsets, mm.
const CORNER_MM: f64 = 0.01;
/// Of the wall at most this part is given away to what its outlines may lie off, on each side.
const MOST_OF_WALL: f64 = 0.35;
/// What was found of outlines is given away this many times.
const FOUND: f64 = 1.1;
/// Smaller bodies are noise, mm³, or voxels.
const LEAST_MM3: f64 = 0.5;
const LEAST_VOXELS: f64 = 4.0;
/// A wall of which this part is missing is missing as a whole.
const WHOLE: f64 = 0.7;
/// A body lies in a branch where this part of it does.
const IN_BRANCH: f64 = 0.8;

/// What kind of difference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum What {
    /// The model's material is not there.
    Missing,
    /// Material in the model's lumen.
    InLumen,
    /// Material outside of the model.
    Outside,
}

/// A connected difference.
#[derive(Debug, Clone)]
pub(super) struct Difference {
    pub(super) what: What,
    pub(super) volume_mm3: f64,
    /// The largest of its sections, mm².
    pub(super) area_mm2: f64,
    pub(super) z_mm: [f64; 2],
    /// Where it lies in its largest section.
    pub(super) at: Point2,
    /// The branch that it lies in; `None` where it lies in several.
    pub(super) branch: Option<usize>,
    /// Whether nearly all of that branch's wall is missing there.
    pub(super) is_whole: bool,
}

/// How outlines may lie off at a height without being a difference of material.
#[derive(Debug, Clone)]
pub(super) struct Slack {
    /// What is allowed and not told, mm.
    pub(super) allowed_mm: f64,
    /// The most that was found of outlines moved inward or outward, mm.
    pub(super) offset_mm: f64,
    /// How far outlines were found beside their place, mm.
    pub(super) shifts_mm: Vec<Vector2>,
}

/// The slack at a height; `None` where nothing is to be looked for.
pub(super) type SlackAt<'a> = dyn Fn(f64) -> Option<Slack> + Sync + 'a;

/// The solid's lumina, to name places by.
#[derive(Clone, Copy)]
pub(super) struct Named<'a> {
    pub(super) branches: &'a Branches,
    pub(super) solid: &'a StageLumina,
}

/// A piece of one section.
struct Piece {
    what: What,
    region: Region,
    area_mm2: f64,
    branch: Option<usize>,
    /// Area of the wall that its branch has there, mm².
    wall_mm2: f64,
}

/// All differences, the largest first.
pub(super) fn differences(
    planes: &Planes<'_>,
    pose: &Pose,
    named: Named<'_>,
    slack: &SlackAt<'_>,
    task: &Task<'_>,
) -> Result<Vec<Difference>, Cancelled> {
    let [low, high] = planes.inputs.solid.z_range_mm();
    let within_mm = planes.sampler.largest_mm();
    let [from, to] = [low + within_mm, high - within_mm];
    if to <= from {
        return Ok(Vec::new());
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the height of a part")]
    let n = ((to - from) / STEP_MM.max(planes.sampler.voxel_mm())).ceil().max(1.0) as usize;
    let step_mm = (to - from) / n as f64;
    let at = |i: usize| from + step_mm * (i as f64 + 0.5);
    let sections: Vec<Vec<Piece>> = (0..n)
        .into_par_iter()
        .map(|i| {
            task.check()?;
            Ok(slack(at(i)).map_or_else(Vec::new, |slack| pieces(planes, pose, named, at(i), &slack)))
        })
        .collect::<Result<_, Cancelled>>()?;
    let least_mm3 = LEAST_MM3.max(LEAST_VOXELS * planes.sampler.volume_mm3());
    let mut found = joined(&sections, &at, step_mm);
    found.retain(|d| d.volume_mm3 >= least_mm3);
    found.sort_by(|a, b| b.volume_mm3.total_cmp(&a.volume_mm3));
    Ok(found)
}

impl Slack {
    /// Where the section is found among the places that outlines were found at, its own one among them: where most of it is filled.
    fn shift(&self, model: &Region, scanned: &Region) -> Vector2 {
        let filled_mm2 = |by: Vector2| moved(model, by).intersection(scanned).area_mm2();
        let places = self.shifts_mm.iter().map(|by| (*by, filled_mm2(*by)));
        let own = (Vector2::zeros(), filled_mm2(Vector2::zeros()));
        places.fold(own, |best, place| if place.1 > best.1 { place } else { best }).0
    }

    /// What is left to be given away where the section was moved, mm: outlines of other branches may lie otherwise.
    fn beside(&self, by: Vector2) -> f64 {
        let others = self.shifts_mm.iter().map(|other| (other - by).norm());
        self.allowed_mm + FOUND * others.fold(self.offset_mm, f64::max)
    }
}

fn moved(region: &Region, by: Vector2) -> Region {
    let contour = |c: &Contour| Contour::new(c.points.iter().map(|p| p + by).collect());
    Region::new(region.contours.iter().map(contour).collect())
}

fn shifted(section: &CrossSection, by: Vector2) -> CrossSection {
    CrossSection { outer: moved(&section.outer, by), lumen: moved(&section.lumen, by) }
}

/// The pieces at one height.
fn pieces(planes: &Planes<'_>, pose: &Pose, named: Named<'_>, z_mm: f64, slack: &Slack) -> Vec<Piece> {
    let solid = planes.inputs.solid;
    let section = solid.section(z_mm, TOLERANCE_MM);
    let scanned = planes.material(pose, z_mm, &section);
    let is_cast = planes.inputs.body == BodyKind::Cast;
    let filled = |s: &CrossSection| if is_cast { s.outer.clone() } else { s.material() };
    // What lies beside its place is looked at where it lies: a wider slack would leave nothing of a thin wall.
    let by = slack.shift(&filled(&section), &scanned);
    let slack_mm = slack.beside(by);
    let section = shifted(&section, by);
    let model = filled(&section);
    // Where a skin lies flat it is as uncertain in height as it is aside elsewhere.
    let sections =
        |off_mm: f64| [-off_mm, off_mm].map(|up| shifted(&solid.section(z_mm + up, TOLERANCE_MM), by));
    let beside = sections(slack_mm);
    let plane = nearest(named.branches.z_mm(), z_mm);
    let lumina: Vec<Option<SegmentIndex>> = named.solid.planes[plane]
        .iter()
        .map(|lumen| SegmentIndex::try_new(&lumen.as_ref()?.contours))
        .collect();
    let wall_mm = planes.wall_mm.unwrap_or(f64::INFINITY);
    let walls: Vec<f64> = named.solid.planes[plane]
        .iter()
        .map(|lumen| {
            lumen.as_ref().map_or(0.0, |l| {
                moved(l, by).offset(1.05 * wall_mm.min(1e3), CORNER_MM).intersection(&model).area_mm2()
            })
        })
        .collect();
    let core = |get: &dyn Fn(&CrossSection) -> Region, beside: &[CrossSection], by_mm: f64| {
        let common = beside.iter().fold(get(&section), |common, s| common.intersection(&get(s)));
        common.offset(-by_mm, CORNER_MM)
    };
    let mut pieces = Vec::new();
    // What lies about a piece within twice the slack is its own; what goes on along the skin is not.
    let mut take = |what: What, all: &Region, core: &Region| {
        for region in all.intersection(&core.offset(2.0 * slack_mm, CORNER_MM)).islands() {
            if region.intersection(core).area_mm2() > 0.0 {
                let branch = nearest_branch(&lumina, &region);
                let wall_mm2 = branch.map_or(0.0, |b| walls[b]);
                pieces.push(Piece { what, area_mm2: region.area_mm2(), region, branch, wall_mm2 });
            }
        }
    };
    let missing = model.difference(&scanned);
    // However far outlines are off, the middle of the wall is looked at.
    let most_mm = slack_mm.min(MOST_OF_WALL * wall_mm);
    let of_wall = if most_mm < slack_mm { sections(most_mm) } else { beside.clone() };
    take(What::Missing, &missing, &missing.intersection(&core(&filled, &of_wall, most_mm)));
    if !is_cast {
        let inside = scanned.intersection(&section.lumen);
        take(What::InLumen, &inside, &inside.intersection(&core(&|s| s.lumen.clone(), &beside, slack_mm)));
    }
    let outside = scanned.difference(&section.outer);
    let near =
        beside.iter().fold(section.outer.clone(), |all, s| all.union(&s.outer)).offset(slack_mm, CORNER_MM);
    take(What::Outside, &outside, &outside.difference(&near));
    pieces
}

fn nearest(z_mm: &[f64], at_mm: f64) -> usize {
    let off = |k: &usize| (z_mm[*k] - at_mm).abs();
    (0..z_mm.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0)
}

/// The branch whose lumen is nearest to the middle of a piece.
fn nearest_branch(lumina: &[Option<SegmentIndex>], piece: &Region) -> Option<usize> {
    let middle = centroid(piece)?;
    let off = |b: usize| Some((b, lumina[b].as_ref()?.signed_distance_mm(middle)));
    (0..lumina.len()).filter_map(off).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(b, _)| b)
}

/// Pieces of one kind that overlap from height to height, joined.
fn joined(sections: &[Vec<Piece>], at: &dyn Fn(usize) -> f64, step_mm: f64) -> Vec<Difference> {
    // Body of every piece; bodies that turn out to be one are renamed.
    let mut body_of: Vec<Vec<usize>> = Vec::with_capacity(sections.len());
    let mut n_bodies = 0;
    for (i, own) in sections.iter().enumerate() {
        let mut bodies = Vec::with_capacity(own.len());
        for piece in own {
            let below = i.checked_sub(1).map_or(&[][..], |below| &sections[below][..]);
            let touching: Vec<usize> = (0..below.len())
                .filter(|&j| below[j].what == piece.what)
                .filter(|&j| below[j].region.intersection(&piece.region).area_mm2() > 0.0)
                .map(|j| body_of[i - 1][j])
                .collect();
            let body = touching.first().copied().unwrap_or_else(|| {
                n_bodies += 1;
                n_bodies - 1
            });
            for other in touching {
                for known in body_of.iter_mut().flatten().chain(&mut bodies) {
                    if *known == other {
                        *known = body;
                    }
                }
            }
            bodies.push(body);
        }
        body_of.push(bodies);
    }
    (0..n_bodies).filter_map(|body| body_from(sections, &body_of, body, at, step_mm)).collect()
}

fn body_from(
    sections: &[Vec<Piece>],
    body_of: &[Vec<usize>],
    body: usize,
    at: &dyn Fn(usize) -> f64,
    step_mm: f64,
) -> Option<Difference> {
    let own: Vec<(usize, &Piece)> = sections
        .iter()
        .enumerate()
        .flat_map(|(i, pieces)| pieces.iter().enumerate().map(move |(j, piece)| (i, j, piece)))
        .filter(|&(i, j, _)| body_of[i][j] == body)
        .map(|(i, _, piece)| (i, piece))
        .collect();
    let ((first, _), (last, _)) = (own.first()?, own.last()?);
    let (_, largest) = own.iter().max_by(|a, b| a.1.area_mm2.total_cmp(&b.1.area_mm2))?;
    let area: f64 = own.iter().map(|(_, p)| p.area_mm2).sum();
    let in_branch =
        |b: usize| own.iter().filter(|(_, p)| p.branch == Some(b)).map(|(_, p)| p.area_mm2).sum::<f64>();
    let branch = own.iter().filter_map(|(_, p)| p.branch).find(|&b| in_branch(b) >= IN_BRANCH * area);
    let wall: f64 = {
        let mut heights: Vec<(usize, f64)> = own.iter().map(|(i, p)| (*i, p.wall_mm2)).collect();
        heights.dedup_by_key(|h| h.0);
        heights.iter().map(|h| h.1).sum()
    };
    Some(Difference {
        what: largest.what,
        volume_mm3: area * step_mm,
        area_mm2: largest.area_mm2,
        z_mm: [at(*first) - 0.5 * step_mm, at(*last) + 0.5 * step_mm],
        at: centroid(&largest.region)?,
        branch,
        is_whole: largest.what == What::Missing && branch.is_some() && area >= WHOLE * wall && wall > 0.0,
    })
}
