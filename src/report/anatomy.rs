//! Lumina of all planes and stages to what a vascular surgeon reads: area and diameters along each branch, and
//! the degree of stenosis.
//!
//! Branches are followed through the contours by overlap (else by the nearest centroid); a branch ends where the
//! vessel divides or joins. Diameters are measured in the CT plane: the equivalent one is that of the circle of
//! the same area; the minimum one is the smallest distance of two parallel lines that touch the lumen from outside
//! (rotating calipers on the convex hull), which for a round vessel that crosses the plane obliquely is still its
//! true width, while area and equivalent diameter grow with the obliquity; the maximum one is the largest distance of
//! two points.
//!
//! NASCET: 100 (1 - throat / reference), minimum diameters; the throat is the narrowest place with a wider one
//! before it, the reference the first normal segment beyond it: at least [`NORMAL_MM`] long, its diameters within
//! 5 % of their mean. Which way is beyond follows from the branching; where nothing branches it is not known, and no
//! degree is given. The area stenosis is 100 (1 - area / area) of the same throat and the same reference.

use super::course::{self, Centreline, Division, Meeting};
use super::deviation::rounded;
use crate::geom::{Contour, Point2, Point3, Region};
use crate::sections::SectionStack;
use serde::Serialize;

/// Shortest stretch that counts as a normal segment, mm.
pub const NORMAL_MM: f64 = 5.0;
/// How far a diameter may be off the mean of a normal segment, as a part of it.
const NORMAL_PART: f64 = 0.05;
/// A narrowing of less than this is none, percent.
const LEAST_PERCENT: f64 = 10.0;

/// The vessel's measures.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Anatomy {
    /// Branches by first plane, then from the patient's right to left.
    pub branches: Vec<Branch>,
    /// Where branches divide and join.
    pub divisions: Vec<Division>,
}

/// A stretch of the vessel without division.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Branch {
    /// `branch 1`, ...
    pub name: String,
    /// First and last CT plane.
    pub planes: [usize; 2],
    /// Their heights, mm.
    pub z_mm: [f64; 2],
    /// Which way the blood flows as far as the branching tells: `+z`, `-z` or null.
    pub distal: Option<&'static str>,
    /// The measures, one entry a stage.
    pub stages: Vec<StageMeasures>,
}

/// The measures of a branch as one stage has it. Uncertainties are standard ones, of the outline as this stage has it; what lies
/// between two stages is told by their block.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct StageMeasures {
    /// `image`, `contours`, `solid`, `layers`, `planned`, `recorded` or `scanned`.
    pub stage: &'static str,
    /// Mean lumen area, mm².
    #[serde(serialize_with = "rounded")]
    pub lumen_area_mm2: Option<f64>,
    /// Mean equivalent diameter, mm.
    #[serde(serialize_with = "rounded")]
    pub equivalent_diameter_mm: Option<f64>,
    /// Least minimum diameter, mm.
    #[serde(serialize_with = "rounded")]
    pub minimum_diameter_mm: Option<f64>,
    /// Largest maximum diameter, mm.
    #[serde(serialize_with = "rounded")]
    pub maximum_diameter_mm: Option<f64>,
    /// Uncertainty of the lumen area, mm².
    #[serde(serialize_with = "rounded")]
    pub lumen_area_uncertainty_mm2: Option<f64>,
    /// Uncertainty of each diameter, mm.
    #[serde(serialize_with = "rounded")]
    pub diameter_uncertainty_mm: Option<f64>,
    /// Its centreline.
    pub centreline: Centreline,
    /// The degree of stenosis, or why there is none.
    #[serde(flatten)]
    pub stenosis: Stenosis,
    /// Plane by plane.
    pub planes: Vec<PlaneMeasures>,
}

/// The lumen of one branch in one plane.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlaneMeasures {
    /// CT plane.
    pub plane: usize,
    /// Its height, mm.
    pub z_mm: f64,
    /// Lumen area, mm².
    #[serde(serialize_with = "rounded_value")]
    pub lumen_area_mm2: f64,
    /// Diameter of the circle of this area, mm.
    #[serde(serialize_with = "rounded_value")]
    pub equivalent_diameter_mm: f64,
    /// Least width between parallel lines, mm.
    #[serde(serialize_with = "rounded_value")]
    pub minimum_diameter_mm: f64,
    /// Largest distance of two points of the lumen, mm.
    #[serde(serialize_with = "rounded_value")]
    pub maximum_diameter_mm: f64,
    /// Centre of its area in the stack frame, mm.
    pub centre_xy_mm: [f64; 2],
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn rounded_value<S: serde::Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    rounded(&Some(*value), serializer)
}

/// A degree of stenosis, or why there is none.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Stenosis {
    /// NASCET, percent.
    #[serde(serialize_with = "rounded")]
    pub stenosis_nascet_percent: Option<f64>,
    /// Its uncertainty, percentage points.
    #[serde(serialize_with = "rounded")]
    pub stenosis_uncertainty_percent: Option<f64>,
    /// By areas of the same two places, percent.
    #[serde(serialize_with = "rounded")]
    pub stenosis_area_percent: Option<f64>,
    /// Its uncertainty, percentage points.
    #[serde(serialize_with = "rounded")]
    pub stenosis_area_uncertainty_percent: Option<f64>,
    /// The narrowest place.
    pub stenosis_throat: Option<Throat>,
    /// The segment that it is compared with.
    pub stenosis_reference: Option<Reference>,
    /// Why there is no degree.
    pub stenosis_reason: Option<String>,
}

/// The narrowest place of a branch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Throat {
    /// CT plane.
    pub plane: usize,
    /// Its height, mm.
    pub z_mm: f64,
    /// Minimum diameter, mm.
    #[serde(serialize_with = "rounded_value")]
    pub diameter_mm: f64,
    /// Lumen area, mm².
    #[serde(serialize_with = "rounded_value")]
    pub lumen_area_mm2: f64,
}

/// The normal segment beyond a narrowing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Reference {
    /// First and last CT plane, in the direction of flow.
    pub planes: [usize; 2],
    /// Mean minimum diameter, mm.
    #[serde(serialize_with = "rounded_value")]
    pub diameter_mm: f64,
    /// Mean lumen area, mm².
    #[serde(serialize_with = "rounded_value")]
    pub lumen_area_mm2: f64,
}

/// The lumina of one stage: plane by plane, branch by branch.
#[derive(Debug)]
pub(super) struct StageLumina {
    pub(super) stage: &'static str,
    pub(super) planes: Vec<Vec<Option<Region>>>,
}

/// The branches of a stack of contours.
#[derive(Debug)]
pub(super) struct Branches {
    tracks: Vec<Track>,
    z_mm: Vec<f64>,
}

impl Branches {
    /// Follows the contours.
    pub(super) fn of(sections: &SectionStack) -> Self {
        Self { tracks: tracks(sections), z_mm: sections.plane_z_mm() }
    }

    /// Their names, in their order.
    pub(super) fn names(&self) -> Vec<String> {
        (1..=self.tracks.len()).map(|i| format!("branch {i}")).collect()
    }

    /// The pieces of a lumen in plane `k`, each given to the branch that it overlaps most; of several the largest.
    pub(super) fn share_out(&self, lumen: &Region, k: usize) -> Vec<Option<Region>> {
        let own: Vec<usize> = (0..self.tracks.len()).filter(|&b| self.tracks[b].covers(k)).collect();
        let mut best: Vec<Option<(f64, Region)>> = vec![None; self.tracks.len()];
        for island in lumen.islands() {
            let shared = own.iter().map(|&b| {
                let track = &self.tracks[b];
                (b, island.intersection(&track.lumina[k - track.first]).area_mm2())
            });
            let Some((b, most)) = shared.rev().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|s| s.1 > 0.0)
            else {
                continue;
            };
            if best[b].as_ref().is_none_or(|(area, _)| most > *area) {
                best[b] = Some((most, island));
            }
        }
        best.into_iter().map(|b| b.map(|(_, island)| island)).collect()
    }

    /// The branches that run through plane `k`, each with its contour there.
    pub(super) fn at(&self, k: usize) -> Vec<(usize, &Region)> {
        let tracks = self.tracks.iter().enumerate().filter(|(_, t)| t.covers(k));
        tracks.map(|(b, t)| (b, &t.lumina[k - t.first])).collect()
    }

    /// Heights of the planes, mm.
    pub(super) fn z_mm(&self) -> &[f64] {
        &self.z_mm
    }

    /// Centroids of a branch as a stage has it, upward.
    pub(super) fn centroids(&self, stage: &StageLumina, branch: usize) -> Vec<Point3> {
        let at = |(lumina, z): (&Vec<Option<Region>>, &f64)| {
            let c = course::centroid(lumina[branch].as_ref()?)?;
            Some(Point3::new(c.x, c.y, *z))
        };
        stage.planes.iter().zip(&self.z_mm).filter_map(at).collect()
    }

    /// Where one branch becomes several, or several one.
    pub(super) fn meetings(&self) -> Vec<Meeting> {
        let touch = |a: &Region, b: &Region| a.intersection(b).area_mm2() > 0.0;
        let mut meetings = Vec::new();
        for (trunk, own) in self.tracks.iter().enumerate() {
            let ends = |is_junction: bool| {
                let of = |(_, other): &(usize, &Track)| {
                    if is_junction {
                        other.joins_above && other.last() + 1 == own.first && touch(other.top(), own.bottom())
                    } else {
                        other.splits_off_below
                            && other.first == own.last() + 1
                            && touch(own.top(), other.bottom())
                    }
                };
                self.tracks.iter().enumerate().filter(of).map(|(b, _)| b).collect::<Vec<_>>()
            };
            if own.formed_below {
                let planes = [own.first - 1, own.first];
                meetings.push(Meeting { trunk, branches: ends(true), planes, is_junction: true });
            }
            if own.divides_above {
                let planes = [own.last(), own.last() + 1];
                meetings.push(Meeting { trunk, branches: ends(false), planes, is_junction: false });
            }
        }
        meetings.retain(|m| m.branches.len() > 1);
        meetings
    }

    /// What trunk and branches cover in the planes where they meet.
    pub(super) fn area_at(&self, meeting: &Meeting) -> Region {
        let trunk = &self.tracks[meeting.trunk];
        let end = |t: &Track, is_top: bool| if is_top { t.top().clone() } else { t.bottom().clone() };
        let branches = meeting.branches.iter().map(|&b| end(&self.tracks[b], meeting.is_junction));
        let all: Vec<Region> = branches.chain([end(trunk, !meeting.is_junction)]).collect();
        Region::union_all(&all)
    }

    /// Measures every branch in every stage; `section` is the lumen of the solid at a height.
    pub(super) fn measure(&self, stages: &[StageLumina], section: &dyn Fn(f64) -> Region) -> Anatomy {
        let branch = |(i, track): (usize, &Track)| Branch {
            name: format!("branch {}", i + 1),
            planes: [track.first, track.last()],
            z_mm: [self.z_mm[track.first], self.z_mm[track.last()]],
            distal: track.distal(),
            stages: stages.iter().map(|stage| self.measure_stage(stage, i)).collect(),
        };
        Anatomy {
            branches: self.tracks.iter().enumerate().map(branch).collect(),
            divisions: course::divisions(self, stages, section),
        }
    }

    fn measure_stage(&self, stage: &StageLumina, branch: usize) -> StageMeasures {
        let track = &self.tracks[branch];
        let at = |k: usize| measures(stage.planes[k][branch].as_ref()?, k, self.z_mm[k]);
        let planes: Vec<PlaneMeasures> = (track.first..=track.last()).filter_map(at).collect();
        let mean = |value: fn(&PlaneMeasures) -> f64| {
            (!planes.is_empty()).then(|| planes.iter().map(value).sum::<f64>() / planes.len() as f64)
        };
        StageMeasures {
            stage: stage.stage,
            lumen_area_mm2: mean(|p| p.lumen_area_mm2),
            equivalent_diameter_mm: mean(|p| p.equivalent_diameter_mm),
            minimum_diameter_mm: planes.iter().map(|p| p.minimum_diameter_mm).reduce(f64::min),
            maximum_diameter_mm: planes.iter().map(|p| p.maximum_diameter_mm).reduce(f64::max),
            centreline: course::centreline(self.centroids(stage, branch)),
            stenosis: stenosis(&planes, track.distal()),
            planes,
            ..StageMeasures::default()
        }
    }
}

fn measures(lumen: &Region, plane: usize, z_mm: f64) -> Option<PlaneMeasures> {
    let lumen_area_mm2 = lumen.area_mm2();
    (lumen_area_mm2 > 0.0).then(|| PlaneMeasures {
        plane,
        z_mm,
        lumen_area_mm2,
        equivalent_diameter_mm: 2.0 * (lumen_area_mm2 / std::f64::consts::PI).sqrt(),
        minimum_diameter_mm: lumen.least_width_mm(),
        maximum_diameter_mm: largest_width_mm(lumen),
        centre_xy_mm: centre(lumen),
    })
}

/// Centre of the area of a region that has one, to a micrometre.
fn centre(region: &Region) -> [f64; 2] {
    let weighed =
        region.contours.iter().filter(|c| !c.is_empty()).map(|c| (c.signed_area_mm2(), c.centroid()));
    let (area, sum) =
        weighed.fold((0.0, [0.0; 2]), |(area, [x, y]), (a, c)| (area + a, [x + a * c.x, y + a * c.y]));
    sum.map(|s| (s / area * 1e3).round() / 1e3)
}

/// The largest distance of two points of a region: corners of its convex hull, of which there are few.
fn largest_width_mm(region: &Region) -> f64 {
    let hull = region.convex_hull();
    let points: Vec<Point2> = hull.contours.iter().flat_map(|c| c.points.iter().copied()).collect();
    let from = |(i, p): (usize, &Point2)| points[..i].iter().map(|q| (q - p).norm()).fold(0.0, f64::max);
    points.iter().enumerate().map(from).fold(0.0, f64::max)
}

/// A branch: one lumen a plane from `first` on.
#[derive(Debug)]
struct Track {
    first: usize,
    lumina: Vec<Region>,
    /// Whether it begins, ends at a place where several branches meet, as one of several.
    splits_off_below: bool,
    joins_above: bool,
    /// Whether it is the single one on its side of such a place.
    divides_above: bool,
    formed_below: bool,
}

impl Track {
    fn top(&self) -> &Region {
        &self.lumina[self.lumina.len() - 1]
    }

    fn bottom(&self) -> &Region {
        &self.lumina[0]
    }

    fn last(&self) -> usize {
        self.first + self.lumina.len() - 1
    }

    fn covers(&self, k: usize) -> bool {
        (self.first..=self.last()).contains(&k)
    }

    fn distal(&self) -> Option<&'static str> {
        match (self.splits_off_below || self.divides_above, self.joins_above || self.formed_below) {
            (true, false) => Some("+z"),
            (false, true) => Some("-z"),
            _ => None,
        }
    }
}

/// Follows the lumina from plane to plane.
fn tracks(sections: &SectionStack) -> Vec<Track> {
    let mut done: Vec<Track> = Vec::new();
    let mut open: Vec<Track> = Vec::new();
    for (k, plane) in sections.planes.iter().enumerate() {
        let mut islands = plane.region().islands();
        islands.sort_by(|a, b| centroid(a).x.total_cmp(&centroid(b).x));
        let links = links(&open, &islands);
        let of_island = |j: usize| links.iter().filter(|l| l.1 == j).count();
        let of_track = |i: usize| links.iter().filter(|l| l.0 == i).count();
        let continues = |i: usize, j: usize| of_track(i) == 1 && of_island(j) == 1;
        let mut next: Vec<Track> = Vec::new();
        for (i, mut track) in std::mem::take(&mut open).into_iter().enumerate() {
            match links.iter().find(|l| l.0 == i) {
                Some(&(_, j)) if continues(i, j) => {
                    track.lumina.push(islands[j].clone());
                    next.push(track);
                    continue;
                }
                Some(&(_, j)) => {
                    track.divides_above = of_track(i) > 1;
                    track.joins_above = of_island(j) > 1;
                }
                None => {}
            }
            done.push(track);
        }
        for (j, island) in islands.iter().enumerate() {
            let below: Vec<usize> = links.iter().filter(|l| l.1 == j).map(|l| l.0).collect();
            if matches!(below[..], [i] if continues(i, j)) {
                continue;
            }
            next.push(Track {
                first: k,
                lumina: vec![island.clone()],
                splits_off_below: below.iter().any(|&i| of_track(i) > 1),
                formed_below: below.len() > 1,
                divides_above: false,
                joins_above: false,
            });
        }
        open = next;
    }
    done.append(&mut open);
    done.sort_by(|a, b| {
        a.first.cmp(&b.first).then(centroid(&a.lumina[0]).x.total_cmp(&centroid(&b.lumina[0]).x))
    });
    done
}

/// Pairs (track, island) that continue each other.
fn links(open: &[Track], islands: &[Region]) -> Vec<(usize, usize)> {
    let tips: Vec<&Region> = open.iter().filter_map(|t| t.lumina.last()).collect();
    let mut links = Vec::new();
    for (i, tip) in tips.iter().enumerate() {
        links.extend(
            (0..islands.len()).filter(|&j| tip.intersection(&islands[j]).area_mm2() > 0.0).map(|j| (i, j)),
        );
    }
    // A slanting branch may not overlap itself: then the nearest free one within a diameter is its continuation.
    for (j, island) in islands.iter().enumerate() {
        let free = |i: &usize| !links.iter().any(|l| l.0 == *i);
        if links.iter().any(|l| l.1 == j) {
            continue;
        }
        let distance = |i: usize| (centroid(tips[i]) - centroid(island)).norm();
        let reach = 2.0 * (island.area_mm2() / std::f64::consts::PI).sqrt();
        let nearest = (0..tips.len()).filter(free).min_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        if let Some(i) = nearest.filter(|&i| distance(i) <= reach) {
            links.push((i, j));
        }
    }
    links
}

fn centroid(island: &Region) -> Point2 {
    island.contours.first().filter(|c| !c.is_empty()).map_or_else(Point2::origin, Contour::centroid)
}

/// The degree of stenosis of a branch whose diameters are given in ascending z.
fn stenosis(planes: &[PlaneMeasures], distal: Option<&'static str>) -> Stenosis {
    let refuse = |reason: &str| Stenosis { stenosis_reason: Some(reason.into()), ..Stenosis::default() };
    let mut flow = planes.to_vec();
    match distal {
        None => return refuse("the direction of flow is not known: no single division in the scan tells it"),
        Some("-z") => flow.reverse(),
        Some(_) => {}
    }
    if flow.len() < 5 {
        return refuse("the branch is too short to tell a narrowing from its normal width");
    }
    let worst = (1..flow.len() - 1).filter_map(|m| candidate(&flow, m));
    let best = worst.max_by(|a, b| a.0.total_cmp(&b.0));
    match best {
        Some((percent, throat, reference)) if percent >= LEAST_PERCENT => Stenosis {
            stenosis_nascet_percent: Some(percent),
            stenosis_area_percent: Some(100.0 * (1.0 - throat.lumen_area_mm2 / reference.lumen_area_mm2)),
            stenosis_throat: Some(throat),
            stenosis_reference: Some(reference),
            ..Stenosis::default()
        },
        Some(_) => refuse("no narrowing of 10 % or more"),
        None => {
            refuse("no narrowing with a wider place before it and a normal segment beyond it in the scan")
        }
    }
}

/// The degree at plane `m` in the order of flow, where it is narrower than both neighbours' stretches.
fn candidate(flow: &[PlaneMeasures], m: usize) -> Option<(f64, Throat, Reference)> {
    let throat = flow[m].minimum_diameter_mm;
    let wider_before = flow[..m].iter().any(|p| p.minimum_diameter_mm > 1.03 * throat);
    let is_least = flow[m - 1].minimum_diameter_mm >= throat && flow[m + 1].minimum_diameter_mm >= throat;
    if !wider_before || !is_least {
        return None;
    }
    let reference = normal_segment(&flow[m + 1..], throat)?;
    let percent = 100.0 * (1.0 - throat / reference.diameter_mm);
    let PlaneMeasures { plane, z_mm, lumen_area_mm2, .. } = flow[m];
    Some((percent, Throat { plane, z_mm, diameter_mm: throat, lumen_area_mm2 }, reference))
}

/// The first stretch that is long enough, even and wider than the throat.
fn normal_segment(beyond: &[PlaneMeasures], throat_mm: f64) -> Option<Reference> {
    (0..beyond.len()).find_map(|start| {
        let n = (start..beyond.len())
            .position(|end| (beyond[end].z_mm - beyond[start].z_mm).abs() >= NORMAL_MM - 1e-6)?;
        let stretch = &beyond[start..=start + n];
        let of =
            |value: fn(&PlaneMeasures) -> f64| stretch.iter().map(value).sum::<f64>() / stretch.len() as f64;
        let (mean, lumen_area_mm2) = (of(|p| p.minimum_diameter_mm), of(|p| p.lumen_area_mm2));
        let even = stretch.iter().all(|p| (p.minimum_diameter_mm - mean).abs() <= NORMAL_PART * mean);
        (stretch.len() >= 3 && even && mean > throat_mm).then(|| Reference {
            planes: [stretch[0].plane, stretch[n].plane],
            diameter_mm: mean,
            lumen_area_mm2,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{RigidTransform, Vector2};
    use crate::sections::PlaneSections;

    fn stack(planes: Vec<Vec<Contour>>) -> SectionStack {
        let planes = planes
            .into_iter()
            .enumerate()
            .map(|(k, contours)| PlaneSections { z_mm: 3.0 * k as f64, contours })
            .collect();
        SectionStack { planes, patient_from_stack: RigidTransform::identity() }
    }

    fn disk(x: f64, diameter_mm: f64) -> Contour {
        Contour::circle(Point2::new(x, 0.0), 0.5 * diameter_mm, 256)
    }

    /// A trunk of 8 mm that divides at plane 6; the right daughter narrows from 5 to 1.5 mm.
    fn carotid() -> SectionStack {
        let narrow = [5.0, 5.0, 4.0, 1.5, 3.0, 4.8, 5.0, 5.0, 5.0, 5.0];
        let trunk = (0..6).map(|_| vec![disk(0.0, 8.0)]);
        let daughters = narrow.iter().map(|d| vec![disk(-3.0, *d), disk(3.0, 4.0)]);
        stack(trunk.chain(daughters).collect())
    }

    fn measure_contours(sections: &SectionStack) -> Anatomy {
        let branches = Branches::of(sections);
        let shared = |(k, plane): (usize, &PlaneSections)| branches.share_out(&plane.region(), k);
        let planes = sections.planes.iter().enumerate().map(shared).collect();
        branches.measure(&[StageLumina { stage: "contours", planes }], &|_| Region::default())
    }

    #[test]
    fn a_division_gives_three_branches_and_the_stenosis_its_degree() {
        let anatomy = measure_contours(&carotid());
        let planes: Vec<[usize; 2]> = anatomy.branches.iter().map(|b| b.planes).collect();
        assert_eq!(planes, [[0, 5], [6, 15], [6, 15]]);
        assert!(anatomy.branches.iter().all(|b| b.distal == Some("+z")));
        let narrow = &anatomy.branches[1].stages[0];
        let s = &narrow.stenosis;
        // The first normal segment: 4.8, 5, 5 mm.
        let expected = 100.0 * (1.0 - 1.5 / ((4.8 + 5.0 + 5.0) / 3.0));
        assert!((s.stenosis_nascet_percent.unwrap() - expected).abs() < 0.1, "{s:?}");
        // The same places by their areas.
        let by_area = 100.0 * (1.0 - 1.5f64.powi(2) / ((4.8f64.powi(2) + 50.0) / 3.0));
        assert!((s.stenosis_area_percent.unwrap() - by_area).abs() < 0.1, "{s:?}");
        assert_eq!(s.stenosis_throat.unwrap().plane, 9);
        assert_eq!(s.stenosis_reference.unwrap().planes, [11, 13]);
        assert!(anatomy.branches[2].stages[0].stenosis.stenosis_nascet_percent.is_none());
        assert!((narrow.minimum_diameter_mm.unwrap() - 1.5).abs() < 1e-3);
    }

    /// The greatest degree of stenosis of any branch, percent.
    fn degree(sections: &SectionStack) -> f64 {
        let anatomy = measure_contours(sections);
        let of = |b: &Branch| b.stages[0].stenosis.stenosis_nascet_percent;
        anatomy.branches.iter().filter_map(of).fold(0.0, f64::max)
    }

    #[test]
    fn a_phantoms_stenosis_is_measured_within_one_point_of_its_truth() {
        use crate::phantom::{self, Contrast, Kind, Vessel};
        use crate::progress::Task;
        use crate::{sections, segment};
        for polarity in [Contrast::Bright, Contrast::Dark] {
            let params = phantom::Params {
                kind: Kind::Stenosis,
                polarity,
                noise_hu: 25.0,
                n_pixels: 200,
                ..phantom::Params::default()
            };
            let volume = phantom::volume(&params, &Task::quiet());
            let seeds_patient_mm = vec![phantom::default_seed(&params)];
            let found = segment::segment(
                &volume,
                &segment::Params { seeds_patient_mm, ..segment::Params::default() },
                &Task::quiet(),
            );
            let extracted =
                sections::extract(&volume, &found.unwrap(), &sections::Params::default(), &Task::quiet());
            let measured = extracted.unwrap().stack;
            let vessel = Vessel::new(Kind::Stenosis);
            let exact = |p: &PlaneSections| PlaneSections {
                z_mm: p.z_mm,
                contours: vessel.region_at(p.z_mm, 256).contours,
            };
            let truth = SectionStack {
                planes: measured.planes.iter().map(exact).collect(),
                patient_from_stack: measured.patient_from_stack,
            };
            let (found, exact) = (degree(&measured), degree(&truth));
            assert!(exact > 60.0 && (found - exact).abs() < 1.0, "{polarity:?}: {found} of {exact}");
        }
    }

    #[test]
    fn read_upside_down_the_degree_is_the_same() {
        let mut planes: Vec<Vec<Contour>> = carotid().planes.into_iter().map(|p| p.contours).collect();
        planes.reverse();
        let anatomy = measure_contours(&stack(planes));
        assert!(anatomy.branches.iter().all(|b| b.distal == Some("-z")));
        assert!(
            anatomy
                .branches
                .iter()
                .any(|b| b.stages[0].stenosis.stenosis_nascet_percent.is_some_and(|p| p > 69.0))
        );
    }

    #[test]
    fn a_single_tube_has_measures_and_a_reason() {
        let anatomy = measure_contours(&stack(vec![vec![disk(0.0, 6.0)]; 8]));
        let stage = &anatomy.branches[0].stages[0];
        assert!((stage.lumen_area_mm2.unwrap() - 9.0 * std::f64::consts::PI).abs() < 0.01);
        assert!(stage.stenosis.stenosis_reason.as_ref().unwrap().contains("flow"));
    }

    #[test]
    fn a_slanting_branch_is_one_branch() {
        let planes = (0..8).map(|k| vec![disk(3.5 * f64::from(k), 4.0)]).collect();
        assert_eq!(measure_contours(&stack(planes)).branches.len(), 1);
    }

    #[test]
    fn the_minimum_width_of_an_ellipse_is_its_minor_axis() {
        let circle = Contour::circle(Point2::origin(), 1.0, 720);
        let ellipse = circle.points.iter().map(|p| {
            let v = Vector2::new(3.0 * p.x, 2.0 * p.y);
            Point2::from(nalgebra::Rotation2::new(0.7) * v)
        });
        let region = Region::new(vec![Contour::new(ellipse.collect())]);
        assert!((region.least_width_mm() - 4.0).abs() < 1e-3);
    }
}
