//! Vessels found without an operator.
//!
//! On a coarse picture of the volume, every plane is cut at many levels, brighter and darker than each; what is
//! round there (fills the ellipse of its moments, has a clear edge, keeps off the border) is linked over the planes
//! by overlap into tracks. A track is a candidate by how far it runs along z, how round its sections are, how clear
//! its edge, how smooth its course and its size; a vessel may branch. Bone, heart and body are larger or not round,
//! a table is flat, noise is short. Of candidates that are the same vessel at different levels the best one stays.
//! Where bright and dark ones compete, bright ones count more: a lumen filled with contrast medium is what a
//! patient's CT shows, and a windpipe is round and long as well.
//!
//! What it does not do: it does not tell an artery from a vein, nor one vessel from another: the others are listed.
//!
//! Cost: two passes over the coarse picture for each level of intensity.

mod blobs;
mod tracks;

use super::corrections::doubts;
use super::error::{Error, Place};
use super::graph::root;
use super::levels::median;
use super::mask::Mask;
use super::{OnLeak, Params, Polarity, Segmentation};
use crate::ct::{Volume, Warning};
use crate::geom::Point3;
use crate::progress::Task;
use blobs::Coarse;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;
use tracks::Track;

/// How many levels are looked at.
const N_LEVELS: usize = 24;
/// How many candidates are named.
const MOST_CANDIDATES: usize = 8;
/// Where a trunk parts, its branches are seen as round again within this many of its diameters.
const PARTING_DIAMETERS: f64 = 2.0;
/// And how many courses are looked at for parts of one vessel.
const MOST_COURSES: usize = 4 * MOST_CANDIDATES;
/// Below this score, of 1, nothing is taken for a vessel.
const LEAST_SCORE: f64 = 0.02;

/// Unattended, a vessel is followed for this many of its diameters beyond the planes that it was seen in as one: where no
/// level shows it as a round section any more, what goes on there is another's or noise.
const BEYOND_DIAMETERS: f64 = 1.0;

/// A vessel that was found by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// A point in its lumen, LPS, mm.
    pub seed_mm: [f64; 3],
    /// Brighter or darker than what surrounds it.
    pub polarity: Polarity,
    /// How much it looks like a vessel, 0 to 1.
    pub score: f64,
    /// Heights that it was seen between, along the stack's normal, mm.
    pub z_mm: [f64; 2],
    /// Diameter of the disc with its median section's area, mm.
    pub diameter_mm: f64,
    /// Whether it has branches.
    pub branches: bool,
    /// Level of its lumen, HU.
    pub level_hu: f64,
}

impl std::fmt::Display for Candidate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let ([x, y, z], [lo, hi]) = (self.seed_mm, self.z_mm);
        let kind = if self.polarity == Polarity::Dark { "dark" } else { "bright" };
        let branches = if self.branches { ", branches" } else { "" };
        let (width, score) = (self.diameter_mm, self.score);
        write!(
            f,
            "--seed-mm={x:.3},{y:.3},{z:.3}  {kind}, z {lo:.3} to {hi:.3} mm, {width:.1} mm wide{branches}, score {score:.2}"
        )
    }
}

impl Candidate {
    /// The planes that it may be followed in.
    fn reach(&self, volume: &Volume) -> Range<usize> {
        let beyond_mm = BEYOND_DIAMETERS * self.diameter_mm;
        let (lo, hi) = (self.z_mm[0] - beyond_mm, self.z_mm[1] + beyond_mm);
        let z = &volume.plane_z_mm;
        z.partition_point(|&p| p < lo)..z.partition_point(|&p| p <= hi)
    }
}

/// Says how far a candidate was followed, and where it was left although it goes on.
fn followed_only(volume: &Volume, planes: &Range<usize>, asked: &Range<usize>, mask: &Mask) -> Warning {
    let [lo, hi] = [planes.start, planes.end - 1].map(|k| volume.plane_z_mm[k]);
    let is_left = |k: usize| k != asked.start && k + 1 != asked.end && mask.n_voxels_of(k) > 0;
    let left = [planes.start, planes.end - 1].into_iter().filter(|&k| is_left(k));
    let left: Vec<String> = left.map(|k| left_open(volume, mask, k)).collect();
    let left = if left.is_empty() { String::new() } else { format!("; it was left {}", left.join(" and ")) };
    let text = format!(
        "the vessel was followed from z {lo:.3} to {hi:.3} mm: beyond, it does not show as one round section any more{left}; to go on there, give its seed with --seed-mm, or --z-mm"
    );
    Warning::new("segment.followed", text)
}

fn left_open(volume: &Volume, mask: &Mask, k: usize) -> String {
    let all = mask.rows().flat_map(|j| mask.columns().map(move |i| (i, j)));
    let (mut n, mut sums) = (0.0_f64, [0.0; 2]);
    for (i, j) in all.filter(|&(i, j)| mask.contains(i, j, k)) {
        (n, sums) = (n + 1.0, [sums[0] + i as f64, sums[1] + j as f64]);
    }
    let middle = volume.stack_from_voxel(sums[0] / n, sums[1] / n, k);
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    let place = Place(volume.patient_from_stack.apply(middle));
    format!("at {place}, where its section is {:.1} mm2", n * sx * sy)
}

/// Below this score, of 1, what was taken may be anything that is round and long.
const DOUBTFUL_SCORE: f64 = 0.1;
/// From this level on, HU, a bright lumen is hardly one: contrast medium in an artery measures less.
const HARD_HU: f64 = 700.0;
/// A lumen of so few pixels across has no boundary better than a guess;
const LEAST_PIXELS_ACROSS: f64 = 3.0;
/// and one of fewer than these a poor one.
const FEW_PIXELS_ACROSS: f64 = 6.0;

/// How many pixels the usual section of a lumen has across.
fn pixels_across(mask: &Mask) -> f64 {
    let sections = mask.planes().map(|k| mask.n_voxels_of(k) as f64).collect();
    2.0 * (median(sections).unwrap_or(0.0) / std::f64::consts::PI).sqrt()
}

/// A lumen that is wide enough for a boundary, with how many pixels it has across.
fn no_speck(found: Segmentation, seed: Point3) -> Result<(Segmentation, f64), Error> {
    let across = pixels_across(&found.mask);
    if across < LEAST_PIXELS_ACROSS {
        return Err(Error::TooFewPixels { seed: Place(seed), across, least: LEAST_PIXELS_ACROSS });
    }
    Ok((found, across))
}

/// Says what is doubtful about the candidate that was taken.
fn doubts(candidate: &Candidate, across: f64) -> Vec<Warning> {
    let look = "look at its contours before they are used, or give a seed with --seed-mm";
    let (place, score) = (Place(Point3::from(candidate.seed_mm)), candidate.score);
    let faint = (score < DOUBTFUL_SCORE).then(|| {
        let text =
            format!("what was found at {place} hardly looks like a vessel (score {score:.2} of 1): {look}");
        Warning::new("segment.doubtful_candidate", text)
    });
    let thin = (across < FEW_PIXELS_ACROSS).then(|| {
        let text = format!(
            "the vessel found at {place} is {across:.1} pixels wide: its boundary may be off by a good part of a pixel; {look}, or take an image of smaller pixels"
        );
        Warning::new("segment.few_pixels", text)
    });
    let level_hu = candidate.level_hu;
    let hard = (candidate.polarity != Polarity::Dark && level_hu > HARD_HU).then(|| {
        let text = format!(
            "what was found at {place} measures {level_hu:.0} HU: that may be calcium, bone or metal; {look}"
        );
        Warning::new("segment.doubtful_candidate", text)
    });
    faint.into_iter().chain(hard).chain(thin).collect()
}

/// The lumen of the best candidate, and all of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// The lumen.
    pub segmentation: Segmentation,
    /// All candidates, the best first.
    pub candidates: Vec<Candidate>,
    /// Which one the lumen was grown from.
    pub chosen: usize,
}

/// Finds candidates, and the lumen of the best one that can be grown; leaks are cut off, seeds are not looked at.
///
/// # Errors
/// [`Error::NoCandidate`] where nothing looks like a vessel; that of the best candidate where none can be grown;
/// those of [`super::segment`] for ranges and corrections.
pub fn find_unattended(volume: &Volume, params: &Params, task: &Task<'_>) -> Result<Found, Error> {
    super::check_windows(params)?;
    let asked = super::planes_in_range(volume, params.z_mm)?;
    let rules = params.corrections.resolve(volume)?;
    let candidates = find(volume, params, task)?;
    let mut refused: Option<Error> = None;
    let mut passed_over = Vec::new();
    for (chosen, candidate) in candidates.iter().enumerate() {
        let own = Params {
            seeds_patient_mm: vec![Point3::from(candidate.seed_mm)],
            polarity: candidate.polarity,
            on_leak: OnLeak::Cut,
            ..params.clone()
        };
        let reach = || rules.reaching(candidate.reach(volume), &asked);
        let planes = if params.z_mm.is_some() { asked.clone() } else { reach() };
        let found = super::segment_in(volume, &own, planes.clone(), task);
        match found.and_then(|found| no_speck(found, own.seeds_patient_mm[0])) {
            Ok((mut segmentation, across)) => {
                passed_over.extend(doubts(candidate, across));
                passed_over.extend(
                    (planes != asked).then(|| followed_only(volume, &planes, &asked, &segmentation.mask)),
                );
                segmentation.warnings.splice(0..0, passed_over);
                return Ok(Found { segmentation, candidates, chosen });
            }
            Err(Error::Cancelled(c)) => return Err(c.into()),
            Err(e) => {
                let text = format!(
                    "the candidate at {} was passed over: {e}",
                    Place(Point3::from(candidate.seed_mm))
                );
                passed_over.push(Warning::new("segment.candidate_passed_over", text));
                refused = refused.or(Some(e));
            }
        }
    }
    let refused = refused.unwrap_or(Error::NoCandidate { planes: asked.len() });
    Err(refused.beside(doubts::warnings(volume, &params.corrections)))
}

/// Finds what looks like a vessel, the best first.
///
/// # Errors
/// [`Error`] for a z range without planes, or cancellation.
pub fn find(volume: &Volume, params: &Params, task: &Task<'_>) -> Result<Vec<Candidate>, Error> {
    let planes = super::planes_in_range(volume, params.z_mm)?;
    let coarse = Coarse::of(volume, &planes);
    task.check()?;
    let signs = match params.polarity {
        Polarity::Bright => vec![1.0],
        Polarity::Dark => vec![-1.0],
        Polarity::Auto => vec![1.0, -1.0],
    };
    let levels = coarse.levels_hu(N_LEVELS);
    let jobs: Vec<(f64, f64)> = signs.iter().flat_map(|&s| levels.iter().map(move |&l| (l, s))).collect();
    let z_mm = &volume.plane_z_mm[planes.clone()];
    let at_level = |&(level, sign): &(f64, f64)| {
        task.check()?;
        let by_plane: Vec<_> = (0..coarse.n_planes()).map(|k| coarse.blobs(k, level, sign)).collect();
        Ok(tracks::of(&by_plane, z_mm, sign))
    };
    let found: Result<Vec<Vec<Track>>, Error> = jobs.par_iter().map(at_level).collect();
    let mut tracks: Vec<Track> = found?.into_iter().flatten().filter(|t| t.score >= LEAST_SCORE).collect();
    tracks.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut kept: Vec<Track> = Vec::new();
    for track in tracks {
        if kept.len() < MOST_COURSES
            && !kept.iter().any(|k| k.is_same_vessel(&track))
            && is_wanted(volume, params, &planes, &track)
        {
            kept.push(track);
        }
    }
    let mut kept = joined(&kept, z_mm);
    kept.truncate(MOST_CANDIDATES);
    Ok(kept.iter().map(|t| candidate(volume, &planes, t)).collect())
}

/// Courses made one where a trunk parts into several, or several join: a split whose lobes no level shows as round
/// sections cuts the one from the others; and where a vessel goes on behind a throat. The best first.
fn joined(tracks: &[Track], z_mm: &[f64]) -> Vec<Track> {
    let mut above: Vec<usize> = (0..tracks.len()).collect();
    for (trunk, upward) in (0..tracks.len()).flat_map(|n| [(n, false), (n, true)]) {
        let gap_mm = 2.0 * PARTING_DIAMETERS * tracks[trunk].radius_mm();
        let goes_on = |n: &usize| *n != trunk && tracks[trunk].goes_on_in(&tracks[*n], upward, z_mm, gap_mm);
        let branches: Vec<usize> = (0..tracks.len()).filter(goes_on).collect();
        if branches.len() < 2 {
            continue;
        }
        for branch in branches {
            let (a, b) = (root(&mut above, trunk), root(&mut above, branch));
            above[a.max(b)] = a.min(b);
        }
    }
    for (n, below) in tracks.iter().enumerate() {
        for m in (0..tracks.len()).filter(|&m| below.resumes_in(&tracks[m], z_mm)) {
            let (a, b) = (root(&mut above, n), root(&mut above, m));
            above[a.max(b)] = a.min(b);
        }
    }
    let mut parts: BTreeMap<usize, Vec<&Track>> = BTreeMap::new();
    for (n, track) in tracks.iter().enumerate() {
        parts.entry(root(&mut above, n)).or_default().push(track);
    }
    let mut whole: Vec<Track> = parts.values().filter_map(|p| Track::of_parts(p, z_mm)).collect();
    whole.sort_by(|a, b| b.score.total_cmp(&a.score));
    whole
}

/// Whether the operator's window, where there is one, holds the seed, and no correction takes it away.
fn is_wanted(volume: &Volume, params: &Params, planes: &Range<usize>, track: &Track) -> bool {
    let Some([i, j, k]) = volume.voxel_from_stack(seed_in_stack(volume, planes, track)) else { return false };
    let hu = f64::from(volume.at(i, j, k));
    let Ok(rules) = params.corrections.resolve(volume) else { return true };
    let window = rules.window_hu(k).or(params.window_hu);
    window.is_none_or(|[lo, hi]| hu >= lo && hu <= hi) && !rules.blocks(volume, [i, j, k])
}

fn seed_in_stack(volume: &Volume, planes: &Range<usize>, track: &Track) -> Point3 {
    let (n, blob) = track.seed();
    Point3::new(blob.x_mm, blob.y_mm, volume.plane_z_mm[planes.start + n])
}

fn candidate(volume: &Volume, planes: &Range<usize>, track: &Track) -> Candidate {
    let p = volume.patient_from_stack.apply(seed_in_stack(volume, planes, track));
    // Micrometres: what is shown is what is used.
    let rounded = |v: f64| (v * 1e3).round() / 1e3;
    let [first, last] = track.ends();
    let z = |n: usize| rounded(volume.plane_z_mm[planes.start + n]);
    Candidate {
        seed_mm: [rounded(p.x), rounded(p.y), rounded(p.z)],
        polarity: if track.sign > 0.0 { Polarity::Bright } else { Polarity::Dark },
        score: rounded(track.score),
        z_mm: [z(first), z(last)],
        diameter_mm: rounded(2.0 * track.radius_mm()),
        branches: track.branches(),
        level_hu: track.seed().1.level_hu.round(),
    }
}
